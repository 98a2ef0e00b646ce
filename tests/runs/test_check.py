"""Regression checks: what counts as worse, what the baseline keeps, and that planted faults are caught."""

import json
import math
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from ahrs_sim.cli import main
from ahrs_sim.errors import CheckError, InputError
from ahrs_sim.runs import check, check_baseline, check_report, check_suite
from ahrs_sim.runs.check_baseline import Found
from ahrs_sim.scenario import load
from ahrs_sim.scenario.shipped import scenario_dir

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.usefixtures("pool_here")

SUITE = """
[estimator.ekf]
method = "marg-ekf"
suite = "chr"
[estimator.ckf]
method = "marg-ckf"
suite = "chr"
[[flight]]
scenario = "sway"
duration_s = 24.0
seeds = [1, 2, 3]
"""

SAMPLES = "certify-", "airliner"  # of the standard suite: two estimators, one seed
Values = dict[str, list[float]]


@pytest.fixture
def suite(tmp_path: Path) -> check_suite.Suite:
    """A suite of one short flight with a baseline that says 1 deg, and 2 deg of heading."""
    path = tmp_path / "mine.toml"
    path.write_text(SUITE)
    loaded = check_suite.load(str(path))
    check_baseline.renew(loaded, found(), "first")
    return loaded


def found(change: Callable[[Values], object] = lambda values: None) -> Found:
    values: Values = {
        "all.availability": [0.9, 0.9, 0.9],
        "all.tilt": [1.0, 1.1, 0.9],
        "all.heading": [2.0, 2.0, 2.0],
        "straight.tilt": [1.0, math.nan, math.nan],
    }
    other = {name: list(numbers) for name, numbers in values.items()}
    change(other)
    return Found({"sway": {"ekf": other, "ckf": dict(values)}}, {})


def results(suite: check_suite.Suite, change: Callable[[Values], object]) -> dict[str, str]:
    result = check.compare(suite, found(change))
    return {row.figure: row.result for row in result.rows if row.estimator == "ekf"} | {"passed": str(result.passed)}


def test_the_standard_suite_samples_certification_and_aircraft() -> None:
    """Flights of the certification standard keep figures of its rows; an airliner turns on the derived autopilot."""
    flights = {f.name: f for f in check_suite.load().flights}
    assert [s.name for s in flights["certify-outages"].run.spans] == [
        "no_air_data", "gnss_loss", "interruption", "spoofing",
    ]  # fmt: skip
    assert list(flights["certify-restart"].run.data["estimator"]) == ["marg-ckf-chr", "ins21-sbg"]
    assert flights["airliner"].run.data["aircraft"] == "737"
    assert sum(len(f.seeds) for name, f in flights.items() if name.startswith(SAMPLES)) == 3


def test_a_flight_of_the_certification_standard_keeps_its_rows() -> None:
    values = {"availability": 1.0, "tilt_rmse_deg": 0.5, "restart.roll_rmse_deg": 0.2, "restart.tilt_p95_deg": 1.0}
    kept = dict(check._kept(values, ["restart"]))
    assert kept == {"all.availability": 1.0, "all.tilt": 0.5, "restart.roll": 0.2}


@pytest.mark.parametrize(
    ("flight", "message"),
    [
        ('certification = "restrat"\nestimators = ["ins21@sbg"]', r"certification: .*restrat.*did you mean 'restart'"),
        ('certification = "restart"\nestimators = ["ins21@sbg"]\nduration_s = 5.0', r"duration_s: unknown key"),
        ('certification = "restart"', r"estimators: missing"),
    ],
)
def test_a_wrong_flight_of_the_standard_gets_one_line(tmp_path: Path, flight: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f"[[flight]]\n{flight}\n")
    with pytest.raises(InputError, match=message):
        check_suite.load(str(path))


def test_nothing_has_changed(suite: check_suite.Suite) -> None:
    assert set(results(suite, lambda v: None).values()) == {"same", "True"}


@pytest.mark.parametrize(
    ("name", "now", "expected"),
    [
        ("all.tilt", [1.2, 1.3, 1.1], "worse"),
        ("all.tilt", [0.8, 0.9, 0.7], "better"),
        ("all.tilt", [1.04, 1.14, 0.94], "same"),  # all worse, but within 0.05 deg
        ("all.tilt", [1.9, 1.0, 0.85], "same"),  # larger, but one seed only
        ("all.heading", [2.09, 2.09, 2.09], "same"),
        ("all.heading", [2.2, 2.2, 2.2], "worse"),
        ("all.availability", [0.8, 0.8, 0.8], "worse"),
        ("all.availability", [0.95, 0.95, 0.95], "better"),
        ("all.tilt", [1.0, math.nan, 0.9], "worse"),  # one seed has no figure any more
        ("all.tilt", [math.nan] * 3, "gone"),
        ("straight.tilt", [1.5, math.nan, math.nan], "worse"),
        ("turning.tilt", [1.0, 1.0, 1.0], "new"),
    ],
)
def test_results(suite: check_suite.Suite, name: str, now: list[float], expected: str) -> None:
    result = results(suite, lambda v: v.update({name: now}))
    assert result[name] == expected
    assert result["passed"] == str(expected not in ("worse", "gone"))
    assert {v for k, v in result.items() if k not in (name, "passed")} == {"same"}


def test_an_estimator_that_is_gone_and_a_flight_that_failed(suite: check_suite.Suite) -> None:
    less = found()
    del less.figures["sway"]["ckf"]
    result = check.compare(suite, less)
    assert not result.passed
    assert {r.result for r in result.rows if r.estimator == "ckf"} == {"gone"}
    failed = check.compare(suite, Found(found().figures, {"sway, seed 2": "crash"}))
    assert not failed.passed
    assert "crash" in check_report.table(failed)
    with pytest.raises(CheckError, match="not renewed: sway, seed 2: crash"):
        check_baseline.renew(suite, Found(found().figures, {"sway, seed 2": "crash"}), "no")


def test_renewal_keeps_the_history(suite: check_suite.Suite) -> None:
    check_baseline.renew(suite, found(lambda v: v.update({"all.tilt": [0.5, 0.5, 0.5]})), "a better filter")
    kept = json.loads(suite.baseline.read_text())
    assert [h["why"] for h in kept["history"]] == ["first", "a better filter"]
    assert kept["flights"]["sway"]["estimators"]["ekf"]["all.tilt"] == [0.5, 0.5, 0.5]
    assert kept["flights"]["sway"]["estimators"]["ekf"]["straight.tilt"] == [1.0, None, None]
    assert '"all.tilt": [0.5, 0.5, 0.5],\n' in suite.baseline.read_text(), "a line per figure"


def test_forms_of_the_result(suite: check_suite.Suite) -> None:
    result = check.compare(suite, found(lambda v: v.update({"all.tilt": [2.0, 2.1, 1.9]})))
    text, comment = check_report.table(result), check_report.markdown(result)
    assert "FAILED" in text
    assert "+1.000" in text
    assert "**worse**" in comment
    data = json.loads(json.dumps(check_report.as_json(result), allow_nan=False))
    assert not data["passed"]
    (row,) = [r for r in data["rows"] if r["result"] == "worse"]
    assert row["change"] == pytest.approx(1.0)
    xml = ElementTree.fromstring(check_report.junit(result))
    assert (xml.get("tests"), xml.get("failures")) == ("2", "1")
    (failure,) = xml.iter("failure")
    assert "all.tilt" in str(failure.text)


def test_junit_has_the_same_cases_with_times_when_a_flight_fails(suite: check_suite.Suite) -> None:
    reason = "estimator 'ckf' ValueError: no (mine.py, line 7)"
    for figures in (found().figures, {"sway": {}}):  # one seed failed, or all
        failed = Found(figures, {"sway, seed 2": reason}, {"sway": 3.0})
        xml = ElementTree.fromstring(check_report.junit(check.compare(suite, failed)))
        cases = [(c.get("classname"), c.get("name"), c.get("time")) for c in xml.iter("testcase")]
        assert cases == [("sway", "ekf", "1.500"), ("sway", "ckf", "1.500")]
        assert xml.get("time") == "3.000"
        assert [f.get("message") for f in xml.iter("failure")] == [f"seed 2: {reason}"] * 2


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "flight: missing"),
        ('[[flight]]\nscenario = "sway"\nseed = [1]\n', "did you mean 'seeds'"),
        ('[[flight]]\nscenario = "swya"\n', "did you mean 'sway'"),
        ('[[flight]]\nscenario = "sway"\nseeds = []\n', "seeds"),
        ('[[flight]]\nscenario = "sway"\nseeds = [1, 1]\n', "twice"),
        ('[[flight]]\nscenario = "sway"\n' * 2, "twice"),
        ('[tolerance]\nrelativ = 0.1\n[[flight]]\nscenario = "sway"\n', "did you mean 'relative'"),
        ('[[flight]]\nscenario = "sway"\nestimators = ["x"]\n', "estimator"),
    ],
)
def test_bad_suites(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=word):
        check_suite.load(str(path))


def test_bad_baselines(suite: check_suite.Suite) -> None:
    for content in ("", "{}", "[1", '{"flights": 3, "history": []}'):
        suite.baseline.write_text(content)
        with pytest.raises(InputError, match="not a baseline"):
            check.compare(suite, found())
    suite.baseline.unlink()
    with pytest.raises(InputError, match="--renew --why"):
        check.compare(suite, found())


def test_the_command_flies_renews_and_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, report = tmp_path / "mine.toml", tmp_path / "junit.xml"
    path.write_text(SUITE)
    assert main(["check", str(path), "--renew"]) == 2
    assert "--why" in capsys.readouterr().err
    assert main(["check", str(path), "--renew", "--why", "first", "--workers", "1"]) == 0
    capsys.readouterr()
    assert main(["check", str(path), "--json", "--junit", str(report), "--workers", "1"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["passed"]
    assert {r["result"] for r in result["rows"]} == {"same"}
    assert ElementTree.parse(report).getroot().get("failures") == "0"


def test_the_standard_suite_has_every_scenario_and_method() -> None:
    import estimators

    suite = check_suite.load()
    shipped = [load(str(p)) for p in scenario_dir().glob("*.toml")]
    fed = {s.name for s in shipped if s.estimators and "chr" in s.data["suite"] and s.pilot_attitude == "truth"}
    assert {f.run.name for f in suite.flights} >= fed
    listed = tomllib.loads(check_suite.STANDARD.read_text(encoding="utf-8"))["flight"]
    some = {str(f.get("scenario")) for f in listed if "estimators" in f}  # flights that are meant for a few of them
    for flight in suite.flights:
        if "chr" not in flight.run.data["suite"] or flight.name in some or flight.name.startswith(SAMPLES):
            continue
        flown = {e["method"] for e in flight.run.data["estimator"].values()}
        assert flown >= {m.name for m in estimators.describe() if m.own}


# ----------------------------------------------------------------------------------------------- planted faults

MARG, ERROR, TILT, INS9 = (f"estimators/models/{m}.py" for m in ("marg", "attitude_error", "tilt", "ins9"))
INS = "estimators/models/ins/mechanisation.py"
FAULTS: dict[str, list[tuple[str, str, str, str]]] = {  # one in a model, and the method that it harms
    "sign of a Jacobian term": [
        (MARG, "= a * dd + b * dc - c * db + d * da", "= -(a * dd + b * dc - c * db + d * da)", "marg-ekf"),
        (INS, "F[V, PHI + 2] = down, -east", "F[V, PHI + 2] = -down, -east", "ins21"),
        (ERROR, "F[i, 3 + j] = -0.5 * dt * J[i, j]", "F[i, 3 + j] = 0.5 * dt * J[i, j]", "fakf"),
        (TILT, "H[i, j] = 1.0 if i == j else 0.0", "H[i, j] = (1.0 if i else -1.0) if i == j else 0.0", "sekf"),
        (INS9, "H[i, j] = 1.0 if j == 3 + i else 0.0", "H[i, j] = -1.0 if j == 3 + i else 0.0", "ins9-ekf"),
    ],
    "noise 3 x off": [
        (MARG, "settings.accel_sigma**2,", "settings.accel_sigma**2 * 9.0,", "marg-ckf"),
        # None in the navigator: three times any of its noises moves the tilt by less than the tolerance (3 to 9 % on
        # three seeds), so that the suite cannot tell.
        (ERROR, "gyro_psd = 0.5 * max(", "gyro_psd = 4.5 * max(", "fakf"),
        (TILT, "= settings.accel_sigma**2", "= settings.accel_sigma**2 * 9.0", "sekf"),
        (INS9, "(settings.velocity_share", "(3.0 * settings.velocity_share", "ins9-ekf"),
    ],
    "lost bias": [
        (MARG, "y[i] = w[i] + x.gyro_bias[i]", "y[i] = w[i]", "marg-cdkf"),
        (INS, "(w[0] - e[0]), 0.5 * dt * (w[1] - e[1]), ", "w[0], 0.5 * dt * w[1], ", "air-ins"),
        (ERROR, "turn(x.q_nb, (w[0] - e[0]) * dt, (w[1] - e[1]) * dt,", "turn(x.q_nb, w[0] * dt, w[1] * dt,", "fakf"),
        (TILT, "u.rate_b[i] -= memory.gyro_bias[i]", "u.rate_b[i] -= 0.0", "sekf"),
        (INS9, "u.rate_b[i] -= model.gyro_bias[i]", "u.rate_b[i] -= 0.0", "ins9-ukf"),
    ],
}


def _run(folder: Path, suite: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "ahrs_sim", "check", str(suite), *arguments]
    env = {**os.environ, "PYTHONPATH": str(folder), **environment}
    # `-m` looks into the working folder first
    return subprocess.run(command, capture_output=True, text=True, check=False, env=env, cwd=folder)


# Each kind once, in the models that compile soonest and in one copy of the sources: what a fault costs is its
# compilation. The check compares figures without regard to the model, so that these three show its power as all
# fourteen do.
MIXED = [("sign of a Jacobian term", "ins9-ekf"), ("lost bias", "sekf"), ("noise 3 x off", "fakf")]
FAULTS["of all kinds"] = [fault for kind, method in MIXED for fault in FAULTS[kind] if fault[-1] == method]


@pytest.mark.long
@pytest.mark.parametrize(
    "fault", [pytest.param(f, marks=[] if f == "of all kinds" else [pytest.mark.exhaustive]) for f in FAULTS]
)
def test_a_planted_fault_is_caught(tmp_path: Path, fault: str) -> None:
    suite = tmp_path / "suite.toml"
    text = '[[flight]]\nscenario = "turns"\nduration_s = 140.0\nseeds = [1, 2, 3]\n'
    for *_, method in FAULTS[fault]:
        text += f'[estimator.{method}]\nmethod = "{method}"\nsuite = "chr"\n'
        text += 'aiding = "airspeed"\n' if method.startswith("marg") else ""
    suite.write_text(text)
    done = _run(ROOT, suite, "--renew", "--why", "the sources as they are")
    assert done.returncode == 0, done.stderr

    planted = tmp_path / "planted"
    for package in ("ahrs_sim", "estimators"):
        shutil.copytree(ROOT / package, planted / package, ignore=shutil.ignore_patterns("__pycache__"))
    for data in ("aircraft", "scenarios"):
        (planted / data).symlink_to(ROOT / data)
    for file, good, bad, _ in FAULTS[fault]:
        source = (planted / file).read_text()
        assert source.count(good) == 1, f"{file} has changed: plant '{fault}' elsewhere"
        (planted / file).write_text(source.replace(good, bad))
    done = _run(planted, suite, "--json", NUMBA_OPT="1")  # compiled once and used for minutes only
    assert done.returncode == 1, done.stdout + done.stderr
    rows = json.loads(done.stdout)["rows"]
    caught = {r["estimator"] for r in rows if r["result"] in ("worse", "gone")}
    missed = {method for *_, method in FAULTS[fault]} - caught
    assert not missed, [(r["estimator"], r["figure"], r["before"], r["now"]) for r in rows if r["estimator"] in missed]
