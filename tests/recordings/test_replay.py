"""Replay: the same bytes from a log of ours, figures of recordings of others."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_helpers import motion, write_bag, write_ulog

import estimators
from ahrs_sim import pipeline, playback, scenario
from ahrs_sim.attitude import interpolate, wrap
from ahrs_sim.cli import main
from ahrs_sim.errors import InputError
from ahrs_sim.evaluation import consistency, metrics
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.reader import LogReader
from ahrs_sim.review import compare, report, traces
from ahrs_sim.testing import FlyScenario

DATA = Path(__file__).parents[2].parent / "shared" / "data"
real = pytest.mark.skipif(not DATA.is_dir(), reason=f"real recordings are not there: {DATA}")


@pytest.fixture(scope="session")
def flown(fly_scenario: FlyScenario) -> Path:
    """A short log with two suites and two estimators."""
    return fly_scenario("circuit", duration=24.0, estimators=["ekf-chr", "ckf-chr", "ekf-sbg"])


def messages(path: Path, topic: str) -> bytes:
    """All records of a topic but for the channel's number: times, sequence and content."""
    with LogReader(path) as log:
        blocks = log.raw_blocks(log.carried([topic]))
        return b"".join(rows[:, 11:].tobytes() for _, found in blocks for batch in found.values() for rows in batch)


def test_own_log_gives_the_same_bytes(flown: Path, tmp_path: Path) -> None:
    out = tmp_path / "again.mcap"
    playback.replay(flown, out)
    with FlightReader(flown) as before, FlightReader(out) as after:
        assert before.topics.keys() == after.topics.keys()
        assert before.message_count == after.message_count
        assert before.metadata.keys() == after.metadata.keys()
        assert before.attachments == after.attachments
        topics = list(before.topics)
    for topic in topics:
        assert messages(flown, topic) == messages(out, topic), topic


@pytest.mark.long
def test_a_flight_with_smoothed_estimates_which_are_a_reference(tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out.mcap"
    asked = ["fly", "circuit", "--duration", "100", "--estimator", "ins-cal@chr", "-o", str(out), "--json"]
    assert main([*asked, "--smooth"]) == 0
    figures = json.loads(capsys.readouterr().out)["estimators"]
    assert set(figures) == {"ins-cal-chr", "ins-cal-chr_smoothed"}
    assert list(tmp_path.iterdir()) == [out]
    assert main(["compare", str(out), "--reference", "smoothed", "--json"]) == 0
    against = json.loads(capsys.readouterr().out)["estimators"]
    assert against["ins-cal-chr_smoothed"]["total_rmse_deg"] == pytest.approx(0.0, abs=1e-4)
    assert against["ins-cal-chr"]["total_rmse_deg"] > 0.01
    assert main(["fly", "circuit", "--estimator", "ekf-chr", "-o", str(tmp_path / "none.mcap"), "--smooth"]) == 2
    assert "none of the estimators can be smoothed" in capsys.readouterr().err
    assert main([*asked, "--force"]) == 0
    capsys.readouterr()
    assert main(["compare", str(out), "--reference", "smoothed"]) == 2
    assert "no smoothed estimates in this log" in capsys.readouterr().err


def test_smoothed_estimates_beside_the_filtered_ones(tmp_path: Path) -> None:
    flight, out = tmp_path / "flight.mcap", tmp_path / "out.mcap"
    pipeline.fly(scenario.load("circuit", duration=110.0, estimators=["ekf-chr"]), flight)
    playback.replay(flight, out, estimators=["ins-cal@chr"], smooth=True)
    with FlightReader(out) as log:
        filtered, smoothed = log.estimates("ins-cal-chr"), log.estimates("ins-cal-chr_smoothed")
    np.testing.assert_array_equal(filtered.t, smoothed.t)
    assert (np.diff(smoothed.t) > 0.0).all()
    known = np.isfinite(filtered.q_nb[:, 0])
    spread = [np.trace(e.att_cov[known], axis1=1, axis2=2).mean() for e in (filtered, smoothed)]
    assert spread[1] < 0.8 * spread[0]
    assert smoothed.q_nb[-1] == pytest.approx(filtered.q_nb[-1], abs=1e-9)
    assert "ins-cal-chr_smoothed" in compare.compare(out, start=25.0)["estimators"]
    with pytest.raises(InputError, match="none of the estimators can be smoothed"):
        playback.replay(flight, tmp_path / "none.mcap", smooth=True)
    assert not (tmp_path / "none.mcap").exists()


def test_attitudes_and_errors_for_plots(flown: Path) -> None:
    with FlightReader(flown) as log:
        truth = log.truth()
        for name in log.estimators:
            estimates = log.estimates(name)
            errors, attitude = log.read(f"/est/{name}/errors"), log.read(f"/est/{name}/attitude")
            rows = np.searchsorted(estimates.t, log.seconds(errors["log_time"]) - 1e-6)
            known = np.isfinite(estimates.down_b).all(axis=1)
            assert len(errors) == len(attitude) == pytest.approx(10 * (24.0 - estimates.t[known][0]), abs=2)
            wanted = metrics.attitude_errors(
                estimates.q_nb[rows],
                estimates.down_b[rows],
                interpolate(truth.t, truth.q_nb, estimates.t[rows]),
            )
            for measure, values in zip(metrics.MEASURES, wanted.T, strict=True):
                assert errors[measure] == pytest.approx(values, abs=1e-12, nan_ok=True)
            sigma = consistency.euler_sigma(estimates.q_nb[rows], estimates.att_cov[rows])
            assert errors["heading_sigma"] == pytest.approx(sigma[:, 2], rel=1e-5, nan_ok=True)
            true_heading = np.interp(errors["log_time"], *_heading(log))
            difference = wrap(attitude["heading"] - errors["heading"] - true_heading)
            assert np.nanmax(np.abs(difference)) < 1e-5


def _heading(log: FlightReader) -> tuple[np.ndarray, np.ndarray]:
    true = log.read("/truth/attitude")
    assert len(true) == 241
    assert true["heading"].min() >= 0
    return true["log_time"], np.unwrap(true["heading"])


def test_other_estimators_on_request(flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "more.mcap"
    assert main(["replay", str(flown), "-o", str(out), "--estimator", "marg-cdkf@sbg", "--estimator", "ekf-chr"]) == 0
    assert "marg-cdkf-sbg" in capsys.readouterr().out
    with FlightReader(out) as log:
        assert set(log.estimators) == {"ekf-chr", "ckf-chr", "ekf-sbg", "marg-cdkf-sbg"}
        assert log.metadata["estimator marg-cdkf-sbg"]["method"] == "marg-cdkf"
    assert main(["replay", str(flown), "--estimator", "ekf-sbg", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["estimators"]) == ["ekf-sbg"]


def test_without_a_new_log_the_figures_are_the_same(flown: Path, tmp_path: Path) -> None:
    playback.replay(flown, tmp_path / "again.mcap")
    kept = playback.accuracy(tmp_path / "again.mcap", start=21.0)
    found = playback.evaluate(flown, start=21.0)
    assert kept is not None
    assert found is not None
    assert list(found["estimators"]) == ["ekf-chr", "ckf-chr", "ekf-sbg"]
    assert found | {"log": ""} == kept | {"log": ""}
    with pytest.raises(InputError, match="the log spans"):
        playback.evaluate(flown, start=30.0)


def test_a_part_of_a_log_of_ours_and_of_a_recording(flown: Path, tmp_path: Path, capsys: Any) -> None:
    """What lies outside of --skip and --until reaches no estimator; --from and --to only choose errors."""
    write_bag(tmp_path / "a.mcap", motion(24.0, still=8.0), with_place=False)
    for log, suite in ((flown, "@chr"), (tmp_path / "a.mcap", "")):
        out = tmp_path / "out.mcap"
        asked = ["replay", str(log), "-o", str(out), "--force", "--estimator", f"marg-ekf{suite}"]
        assert main([*asked, "--skip", "9", "--until", "21", "--from", "10"]) == 0, capsys.readouterr().err
        with FlightReader(out) as after:
            (name,) = (n for n in after.estimators if n.startswith("marg-ekf"))
            t = after.estimates(name).t
        assert t[0] == pytest.approx(9.0, abs=0.03)
        assert t[-1] == pytest.approx(21.0, abs=0.03)
    assert main(["replay", str(flown), "--skip", "5", "--until", "4"]) == 2
    assert "nothing is left between them" in capsys.readouterr().err


def test_what_estimators_are_told_survives_exactly(flown: Path) -> None:
    loaded = scenario.load("circuit", duration=24.0)
    with FlightReader(flown) as log:
        recording = playback.of_flight(log)
        assert pipeline.exactly(recording.site) == log.metadata["site"]
    for component in loaded.suites:
        from ahrs_sim.sensors import make_suite

        suite = make_suite(component, seed=loaded.seed, dt=1 / 400, epoch=loaded.epoch,
                           start_lla=np.array(recording.site.lla))  # fmt: skip
        assert recording.sensors[component.name] == suite.info
    assert recording.site.lla[:2] == pytest.approx((loaded.start.latitude, loaded.start.longitude), abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{log}", "-o", "{log}", "--force"], "is the recording itself"),
        (["{log}", "--calibrate", "mag"], "leave them out"),
        (["{log}", "--estimator", "ekf-chrr"], "did you mean 'ekf-chr'?"),
        (["{log}", "--estimator", "marg-ekf@gone"], "gone"),
        (["none.mcap"], "none.mcap: cannot be read"),
        (["{log}", "-o", "{taken}"], "exists"),
    ],
)
def test_errors_are_one_line(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    taken = tmp_path / "taken.mcap"
    taken.write_bytes(b"x")
    assert main(["replay", *(a.format(log=flown, taken=taken) for a in arguments)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_an_ideal_bag_gives_a_tiny_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, out, map_file = tmp_path / "a.mcap", tmp_path / "out.mcap", tmp_path / "m.toml"
    write_bag(bag, motion(60.0, still=25.0), with_place=False)
    declination = np.degrees(np.arctan2(0.05, 2.4))
    map_file.write_text(f'[place]\ndeclination_deg = {declination}\n[topics]\nvelocity = ""\ndiff_pressure = ""\n')
    exact = "bag_helpers-Triad"
    arguments = ["--estimator", "marg-ekf", "--estimator", "bag_helpers:Triad", "--map", str(map_file), "--from", "26"]
    assert main(["replay", str(bag), "-o", str(out), *arguments]) == 0
    assert "reference       /truth/odom" in capsys.readouterr().out
    result = playback.accuracy(out, start=26.0)
    assert result is not None
    assert result["reference"] == "/reference/imu"
    assert result["estimators"]["marg-ekf"]["total_rmse_deg"] < 0.4  # its rate lags a little
    for topic in ("/truth/odom", "/reference/imu"):
        against = compare.compare(out, reference=topic, start=26.0)
        assert against["estimators"][exact]["total_max_deg"] < 1e-3, topic
    for topic in ("/imu/data_raw", "/gps/fix", "/truth/odom"):
        assert messages(bag, topic) == messages(out, topic)
    with LogReader(out) as log:
        assert log.metadata["replay"]["topic imu"] == "/imu/data_raw FLU ENU"
        errors = log.read(f"/est/{exact}/errors")
        assert len(errors) > 500
        assert np.abs(errors["total"][-300:]).max() < 1e-4

    # The report of a log without a truth: no phases, no true track.
    seen = traces.gather(out, start=26.0)
    assert seen.reference == "/reference/imu"
    assert len(seen.truth_t) == 0
    (run,) = report.page([seen]).split('id="data">')[1:]
    shown = json.loads(run.split("</script>")[0])["runs"][0]
    assert shown["phase"] == [] and shown["truth"]["north"] is None and shown["truth"]["attitude"][0]
    for estimator in shown["estimators"]:
        wanted = result["estimators"][estimator["name"]]["total_rmse_deg"]
        assert estimator["summary"]["total_rmse_deg"] == pytest.approx(wanted, rel=1e-3, abs=1e-4)
    aligned = traces.gather(out, reference="/truth/odom", start=26.0, align="heading", sync=True)
    assert "of 0 deg was taken out" in traces.finding(aligned, aligned.estimators[exact])


def test_compare_takes_out_delay_and_rotation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, out = tmp_path / "a.mcap", tmp_path / "out.mcap"
    write_bag(bag, motion(60.0, still=25.0), with_place=False, reference_delay=0.1)
    (tmp_path / "m.toml").write_text("[topics]\nvelocity = ''\ndiff_pressure = ''\n")
    playback.replay(bag, out, estimators=["marg-ekf"], map_file=tmp_path / "m.toml")
    plain = compare.compare(out, start=26.0)["estimators"]["marg-ekf"]
    adjusted = compare.compare(out, start=26.0, sync=True, align="heading")["estimators"]["marg-ekf"]
    assert plain["total_rmse_deg"] > 3.0
    assert adjusted["total_rmse_deg"] < 0.4
    assert adjusted["delay_s"] == pytest.approx(-0.1, abs=0.01)
    assert adjusted["aligned_deg"][0] == pytest.approx(np.degrees(np.arctan2(0.05, 2.4)), abs=0.2)
    assert main(["compare", str(out), "--from", "26", "--sync", "--align", "frames"]) == 0
    assert re.search(r"delay of -0\.(09|10)\d* s and .* deg removed before comparing", capsys.readouterr().out)
    assert main(["compare", str(out), "--reference", "/truth/odm"]) == 2
    assert "did you mean '/truth/odom'?" in capsys.readouterr().err
    assert main(["compare", str(out), "--reference", "/imu/mag"]) == 2
    assert "has no orientation" in capsys.readouterr().err


def unexplained(out: str) -> list[str]:
    """Rows of the table with a dash of which no line says why."""
    lines = out.splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("RMS error against"))
    rows = [line.split() for line in lines[head + 2 :] if re.search(r" -( |$)", line)]
    assert rows
    return [row[0] for row in rows if not any(re.match(rf"{re.escape(row[0])}: no \w+", line) for line in lines)]


def test_every_dash_comes_with_its_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No heading, no covariance, no attitude within the reference's time, none at all."""
    bag = tmp_path / "a.mcap"
    write_bag(bag, motion(30.0, still=10.0), with_place=False)
    methods = [x for m in ("marg-ekf", "sekf", "bag_helpers:Triad") for x in ("--estimator", m)]
    assert main(["replay", str(bag), *methods]) == 0
    out = capsys.readouterr().out
    assert unexplained(out) == []
    assert re.search(r"^sekf: no heading", out, re.MULTILINE)
    assert re.search(r"^bag_helpers-Triad: no NEES: it states no covariance", out, re.MULTILINE)
    m = motion(30.0, still=10.0)
    rows = m.t >= 25.7  # turns all the time, and is over before that is an alignment
    write_bag(bag, type(m)(*(column[rows] for column in m))._replace(t=m.t[rows] - 25.7), with_place=False)
    assert main(["replay", str(bag), "--estimator", "marg-ekf", "--estimator", "sekf"]) == 0
    out = capsys.readouterr().out
    assert unexplained(out) == []
    assert out.count("no attitude: never aligned in 4 s") == 2


def test_other_formats_leave_their_measurements(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ulog(tmp_path / "a.ulg", motion(30.0))
    out = tmp_path / "out.mcap"
    assert main(["replay", str(tmp_path / "a.ulg"), "-o", str(out), "--estimator", "marg-ekf@bag"]) == 0
    with FlightReader(out) as log:
        assert log.suites == {"bag": ["imu", "mag"]}
        assert len(log.record("bag", "mag")) == 3000
    assert "RMS error against /reference/imu" in capsys.readouterr().out


def test_a_bag_without_reference_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_bag(tmp_path / "a.mcap", motion(5.0, still=2.0))
    (tmp_path / "m.toml").write_text('[topics]\nreference = ""\n')
    out = tmp_path / "out.mcap"
    assert main(["replay", str(tmp_path / "a.mcap"), "--map", str(tmp_path / "m.toml"), "-o", str(out)]) == 0
    assert "nothing to compare with" in capsys.readouterr().err
    assert main(["compare", str(out), "--report", str(tmp_path / "out.html")]) == 2
    assert "nothing to compare with" in capsys.readouterr().err
    seen = traces.gather(out, reference="/truth/odom")  # what the map did not want, a report may
    assert len(seen.suites["bag"].fix) == pytest.approx(25, abs=1)
    assert np.abs(seen.suites["bag"].fix).max() < 1e-3


def test_the_guide_describes_every_table_of_a_map() -> None:
    guide = (Path(__file__).parents[2] / "docs" / "replay.md").read_text()
    from ahrs_sim.recordings import mapping

    for table in re.findall(r"^    (\[[a-z]+)", mapping.__doc__ or "", re.MULTILINE):
        assert table in guide, table


# ----------------------------------------------------------------------------------------------- real recordings


def figures(path: Path, *arguments: str) -> dict[str, Any]:
    """Errors of the one estimator, as the command line gives them."""
    command = [sys.executable, "-m", "ahrs_sim", "replay", str(path), "--json", *arguments]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    values: dict[str, Any] = next(iter(json.loads(out)["estimators"].values()))
    return values


@real
@pytest.mark.long
@pytest.mark.parametrize(("method", "limits"), [("ins21", (0.6, 0.5, 1.6)), ("air-ins", (1.3, 1.1, 5.0))])
def test_thor(method: str, limits: tuple[float, float, float]) -> None:
    if method not in estimators.names():
        pytest.skip(f"no {method}")
    found = figures(
        DATA / "thor_flight75" / "thor_flight75.mcap", "--estimator", method, "--from", "240", "--to", "575",
        "--calibrate", "mag", "--sync",
    )  # fmt: skip
    for angle, limit in zip(("roll", "pitch", "heading"), limits, strict=True):
        assert found[f"{angle}_rmse_deg"] < limit, angle


@real
@pytest.mark.long
@pytest.mark.parametrize(("trial", "with_iron", "without", "limit"), [("01", 0.94, 0.83, 1.0), ("21", 2.17, 2.24, 2.3),
                                                                       ("28", 2.41, 2.58, 2.6)])  # fmt: skip
def test_broad(trial: str, with_iron: float, without: float, limit: float) -> None:
    """As it comes no worse than with a whole ellipsoid taken out, or nothing, as measured when these stood apart."""
    path = next((DATA / "broad").glob(f"broad_{trial}_*.mcap"))
    found = figures(path, "--estimator", "hand-ins", "--sync", "--align", "heading")
    assert found["total_rmse_deg"] < min(with_iron, without) + 0.1
    assert found["total_rmse_deg"] < limit


@real
@pytest.mark.long
@pytest.mark.parametrize(("method", "better"), [("ins21", 1.05), ("air-ins", 2.87)])
def test_thor_by_itself(method: str, better: float) -> None:
    found = figures(
        DATA / "thor_flight75" / "thor_flight75.mcap", "--estimator", method, "--from", "240", "--to", "575", "--sync",
    )  # fmt: skip
    assert found["heading_rmse_deg"] < better + 0.1


@real
def test_thor_s_reference_is_aligned_in_the_take_off() -> None:
    """It has no magnetometer: its heading comes with the first motion. The hand-held ones are aligned all along."""
    from ahrs_sim.recordings.recording import open_bag

    with open_bag(DATA / "thor_flight75" / "thor_flight75.mcap", map_file=None) as bag:
        (line,) = [note for note in bag.notes if "heading of the reference" in note]
    found = re.search(r"turns by (\d+) deg .* --from (\d+) leaves", line)
    assert found is not None
    assert 150 < int(found[1]) < 250
    assert 180 <= int(found[2]) <= 212  # it is airborne from then on
    for path in (DATA / "broad").glob("*.mcap"):
        with open_bag(path, map_file=None) as bag:
            assert not [note for note in bag.notes if "heading of the reference" in note]


@real
@pytest.mark.long
def test_hard_iron_of_thor_is_found(capsys: pytest.CaptureFixture[str]) -> None:
    bag = str(DATA / "thor_flight75" / "thor_flight75.mcap")
    assert main(["replay", bag, "--calibrate", "mag", "--estimator", "marg-ekf"]) == 0
    out = capsys.readouterr().out
    assert "magnetometer calibration kept" in out
    line = re.search(r"hard_iron = \[(.*?)\]", out)
    assert line is not None
    assert [1e6 * float(x) for x in line[1].split(",")] == pytest.approx([39.2, 16.1, -39.6], abs=3.0)
