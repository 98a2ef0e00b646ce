"""Campaigns: what is varied, what is written, and that nothing is lost when something dies."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import scenario
from ahrs_sim.cli import main
from ahrs_sim.errors import InputError
from ahrs_sim.evaluation.bootstrap import interval
from ahrs_sim.runs import campaign, campaign_report
from ahrs_sim.runs import pool as runs
from ahrs_sim.runs.campaign import Plan, Store
from ahrs_sim.runs.pool import Outcome, Run
from ahrs_sim.runs.tuning import Knob
from ahrs_sim.runs.variation import Variation, put

SHORT = """
seed = 7
duration_s = 24.0
[motion]
kind = "sway"
still_s = 21.0
[suite.chr]
grade = "chr_6dm"
instruments = ["imu", "magnetometer"]
[estimator.ekf]
method = "marg-ekf"
suite = "chr"
"""


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """A scenario that flies in a tenth of a second."""
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return path


def fly(path: Path, count: int, place: str, vary: list[str] | None = None, workers: int = 1) -> Store:
    plan = Plan.make(scenario.load(str(path)), count, vary or [])
    store = Store(place)
    with runs.local_pool(workers) as pool:
        campaign.fly(plan, store, pool)
    return store


def rows(store: Store) -> list[dict]:
    return store.table().to_pylist()


def same(a: list[dict], b: list[dict]) -> bool:
    return repr(a) == repr(b)  # NaN equals NaN


# ----------------------------------------------------------------------------------------------- plan


def test_values_depend_on_seed_key_and_run_alone(short: Path) -> None:
    vary = ["wind.speed_mps=uniform:0..8", "suite.chr.rate_hz=choice:50,100"]
    loaded = scenario.load(str(short))
    few, many = Plan.make(loaded, 3, vary[:1]).values(), Plan.make(loaded, 50, vary).values()
    assert [few(k)["wind.speed_mps"] for k in range(3)] == [many(k)["wind.speed_mps"] for k in range(3)]
    drawn = np.array([many(k)["wind.speed_mps"] for k in range(50)])
    assert 0 <= drawn.min() < 1.5
    assert 6.5 < drawn.max() <= 8
    assert {many(k)["suite.chr.rate_hz"] for k in range(50)} == {50, 100}
    assert [Plan.make(loaded, 3).run(k).data["seed"] for k in range(3)] == [7, 8, 9]


def test_grids_are_combined_and_a_hypercube_fills_every_cell(short: Path) -> None:
    vary = ["a.x=grid:1,2,3", "a.y=grid:4,5", "u=lhs:0..10", "v=lhs:-1..1"]
    of = Plan("x", "x", {}, 3, 20, tuple(vary), 1.0).values()
    assert len({(of(k)["a.x"], of(k)["a.y"]) for k in range(6)}) == 6
    for key, low, width in (("u", 0.0, 10.0), ("v", -1.0, 2.0)):
        cells = sorted(int((of(k)[key] - low) / width * 20) for k in range(20))
        assert cells == list(range(20))


def test_normal_values_have_their_moments() -> None:
    normal = Variation.read("x=normal:5,2")
    values = [normal.draw(1, k) for k in range(1000)]
    assert np.mean(values) == pytest.approx(5, abs=0.25)
    assert np.std(values) == pytest.approx(2, rel=0.1)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("wind.speed_mps", "KEY=KIND"),
        ("x=unifrom:0..1", "did you mean 'uniform'"),
        ("x=uniform:3..1", "LOW..HIGH"),
        ("x=uniform:0..inf", "LOW..HIGH"),
        ("x=normal:1", "MEAN,SIGMA"),
        ("x=normal:a,b", "MEAN,SIGMA"),
    ],
)
def test_bad_variations(text: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        Variation.read(text)


def test_keys_reach_into_tables_and_lists(short: Path) -> None:
    data = {"step": [{"do": "wait"}, {"do": "turn"}], "wind": {"speed_mps": 1.0}}
    put(data, "step.2.bank_deg", 20.0)
    put(data, "wind.from_deg", 3.0)
    assert data == {"step": [{"do": "wait"}, {"do": "turn", "bank_deg": 20.0}], "wind": {"speed_mps": 1.0, "from_deg": 3.0}}  # fmt: skip  # noqa: E501
    for key in ("step.3.bank_deg", "wind.speed_mps.x", "step.x"):
        with pytest.raises(InputError, match=r"nothing|not in a table"):
            put(data, key, 1.0)
    for vary, word in ((["seed=grid:1,2"], "own seed"), (["wind.sped_mps=uniform:0..1"], "speed_mps"), (["a=grid:1"] * 2, "twice")):  # fmt: skip  # noqa: E501
        with pytest.raises(InputError, match=word):
            Plan.make(scenario.load(str(short)), 5, vary)


def test_the_manifest_gives_the_same_runs(short: Path, tmp_path: Path) -> None:
    plan = Plan.make(scenario.load(str(short)), 5, ["wind.speed_mps=lhs:0..8"])
    store = Store(str(tmp_path / "out"))
    store.begin(plan)
    again = store.plan()
    for k in range(5):
        assert again.run(k).scenario().toml() == plan.run(k).scenario().toml()


# ----------------------------------------------------------------------------------------------- store


def test_places_files_and_schema(tmp_path: Path, short: Path) -> None:
    plan = Plan(
        "short",
        "short",
        scenario.load(str(short)).data,
        7,
        6,
        ("wind.turbulence=choice:none,light", "x=choice:1,a"),
        1.0,
    )
    figures = {"ekf": {"tilt_rmse_deg": 1.0, "straight.tilt_rmse_deg": float("nan"), "bands.tilt": [1.0, float("nan")]}}
    for place in (str(tmp_path / "local"), f"file://{tmp_path}/url", f"memory://{tmp_path.name}/x"):
        store = Store(place)
        store.begin(plan)
        store.add(0, [Outcome(1, figures), Outcome(0, error="crash")], plan)
        store.add(1, [Outcome(2, {"ekf": {"tilt_rmse_deg": 2.0, "turning.tilt_rmse_deg": 3.0}})], plan)
        table = store.table()
        assert store.files() == ["runs-000000.parquet", "runs-000001.parquet"]
        assert table["run"].to_pylist() == [0, 1, 2]
        assert table["seed"].to_pylist() == [7, 8, 9]
        assert table["error"].to_pylist() == ["crash", None, None]
        assert table["turning.tilt_rmse_deg"].to_pylist() == [None, None, 3.0]
        assert set(table["vary.wind.turbulence"].to_pylist()) <= {"none", "light"}
        assert set(table["vary.x"].to_pylist()) <= {"1", "a"}
        assert store.done() == {0, 1, 2}
        report = campaign_report.make(store)
        assert report["failed"] == 1
        assert "crash" in campaign_report.text(report)
        json.dumps(report, allow_nan=False)


def _two_estimators(store: Store, plan: Plan) -> None:
    """Ten runs; `bad` is worse by 0.5 deg in each, but for the last, in which `good` has failed to align."""
    store.begin(plan)
    for k in range(10):
        good = {"tilt_rmse_deg": 1.0 + k if k < 9 else float("nan"), "availability": 1.0}
        store.add(k, [Outcome(k, {"bad": {"tilt_rmse_deg": 1.5 + k, "availability": 1.0}, "good": good})], plan)


def test_paired_differences_and_worst_runs(tmp_path: Path, short: Path) -> None:
    store = Store(str(tmp_path / "out"))
    _two_estimators(store, Plan("short", "short", scenario.load(str(short)).data, 7, 10, (), 1.0))
    found = campaign_report.make(store, against="good")
    difference = found["paired"]["estimators"]["bad"]["tilt_rmse_deg"]
    assert difference["change"] == pytest.approx(0.5)
    assert (difference["pairs"], difference["smaller"], difference["result"]) == (9, 0, "worse")
    assert [(row["run"], row["estimator"]) for row in found["worst"][:2]] == [(9, "bad"), (8, "bad")]
    assert "0 of 9  worse" in campaign_report.text(found)
    assert campaign_report.make(store)["paired"]["against"] == "good"  # the more accurate one
    of_good = campaign_report.make(store, worst_of="good")
    assert [(row["run"], row["estimator"]) for row in of_good["worst"][:2]] == [(8, "good"), (7, "good")]
    assert campaign_report.worst_runs(store, "tilt_rmse_deg", 2, "good") == [8, 7]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--metric", "tilt_rms_deg"], "did you mean 'tilt_rmse_deg'"),
        (["--metric", "flying.tilt_rmse_deg"], "no such figure"),
        (["--against", "efk"], "did you mean 'ekf'"),
        (["--worst-of", "ckf"], "no such estimator"),
    ],
)
def test_wrong_names_are_reported_before_anything_flies(
    options: list[str], words: str, short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["campaign", str(short), "--runs", "2", "-o", str(out), *options]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_a_campaign_whose_first_run_has_bad_input_leaves_nothing(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """That there is no such grade is known when the suite is made."""
    out = tmp_path / "out"
    short.write_text(SHORT.replace("chr_6dm", "chr_7dm"))
    assert main(["campaign", str(short), "--runs", "2", "--workers", "1", "-o", str(out)]) == 2
    assert "'chr_7dm' is unknown" in capsys.readouterr().err
    assert not (out / "manifest.json").exists()


def test_figures_by_phase_rank_runs() -> None:
    campaign_report.check_metric("turning.heading_p95_deg")
    campaign_report.check_metric("nees")


def test_another_campaign_is_not_mixed_in(short: Path, tmp_path: Path) -> None:
    loaded = scenario.load(str(short))
    store = Store(str(tmp_path / "out"))
    store.begin(Plan.make(loaded, 5))
    store.begin(Plan.make(loaded, 9))  # more of the same
    assert store.plan().runs == 9
    with pytest.raises(InputError, match="a different campaign"):
        store.begin(Plan.make(loaded, 5, ["wind.speed_mps=uniform:0..1"]))
    with pytest.raises(InputError, match="no campaign"):
        Store(str(tmp_path / "none")).plan()


# ----------------------------------------------------------------------------------------------- flying


@pytest.mark.long
def test_fly_interrupt_and_repeat(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    vary = ["--vary", "suite.chr.gyro.noise_density_dps_rthz=uniform:0.01..0.1"]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    common = ["campaign", str(short), *vary, "--workers", "1", "--quiet"]
    assert main([*common, "--runs", "5", "-o", str(whole), "--keep-logs", "worst:1"]) == 0
    assert main([*common, "--runs", "2", "-o", str(parts)]) == 0
    capsys.readouterr()
    assert main([*common[:-1], "--runs", "5", "-o", str(parts)]) == 0
    assert "2 of 5 runs are there, 3 to fly" in capsys.readouterr().err
    assert len(Store(str(parts)).files()) == 2
    assert same(rows(Store(str(whole))), rows(Store(str(parts))))
    (log,) = (whole / "logs").iterdir()
    number = log.stem.removeprefix("run-").lstrip("0") or "0"
    again = tmp_path / "again.mcap"
    assert main(["fly", "--from", str(whole), "--run", number, "-o", str(again), "--quiet"]) == 0
    assert again.read_bytes() == log.read_bytes()
    assert "worst runs" in (whole / "report.txt").read_text()
    assert (whole / "report.png").read_bytes().startswith(b"\x89PNG")
    assert main(["fly", "--from", str(whole), "--run", "5", "-o", str(again), "--force"]) == 2
    assert "runs are 0 to 4" in capsys.readouterr().err


@pytest.mark.usefixtures("pool_here")
def test_a_run_that_fails_is_recorded_and_stops_nothing(tmp_path: Path) -> None:
    path = tmp_path / "crash.toml"
    path.write_text(
        'duration_s = 4.0\n[start]\non_ground = false\nheight_m = 100.0\n[suite.chr]\ngrade = "chr_6dm"\n'
        '[estimator.ekf]\nmethod = "marg-ekf"\nsuite = "chr"\n[[step]]\ndo = "straight"\n'
    )
    store = fly(path, 3, str(tmp_path / "out"), ["start.height_m=grid:100,0.05,100"])
    found = rows(store)
    assert [r["run"] for r in found] == [0, 1, 2]
    assert [r["error"] is None for r in found] == [True, False, True]
    assert "crash" in found[1]["error"]


def _die_once(run: Run) -> Outcome:
    """Do nothing, but some runs kill their worker, one of them every time."""
    flag = Path(str(run.data["folder"])) / f"{run.key}"
    if run.key == 3 or (run.key == 1 and not flag.exists()):
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return Outcome(run.key)


@pytest.mark.long
def test_dead_workers_take_no_run_with_them(tmp_path: Path) -> None:
    with runs.local_pool(2) as pool:
        made = (Run(k, "", "", {"folder": str(tmp_path)}) for k in range(8))
        outcomes = list(runs.fly_all(pool, made, task=_die_once))
    assert sorted(o.key for o in outcomes) == list(range(8))
    assert [o.key for o in outcomes if o.error] == [3]


def test_interval_is_of_the_mean_and_repeatable() -> None:
    differences = np.random.default_rng(1).normal(0.5, 1.0, 200)
    low, high = interval(differences)
    half = 1.96 * differences.std() / np.sqrt(200)
    assert low == pytest.approx(differences.mean() - half, abs=0.03)
    assert high == pytest.approx(differences.mean() + half, abs=0.03)
    assert interval(differences) == (low, high)


def test_knobs(short: Path) -> None:
    loaded = scenario.load(str(short))
    assert Knob.read("ekf.accel_sigma=0.1..10", loaded).value(0.5) == pytest.approx(1.0)  # by its logarithm
    assert Knob.read("ekf.accel_sigma=1..3", loaded).value(0.5) == pytest.approx(2.0)
    for text, word in (
        ("ekf=1..2", "ESTIMATOR.SETTING"),
        ("efk.x=1..2", "did you mean 'ekf'"),
        ("ekf.x=2..1", "is not a range"),
    ):
        with pytest.raises(InputError, match=word):
            Knob.read(text, loaded)


@pytest.mark.long
def test_tuning_finds_the_better_setting(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A filter set to rates that hardly change lags behind; the search must find that they do."""
    text = short.read_text().replace("duration_s = 24.0", "duration_s = 40.0")
    short.write_text(text + 'noise = "practical"\nrate_noise = 1e-4\n')
    tune = ["--tune", "ekf.rate_noise=1e-4..1", "--metric", "total_rmse_deg", "--json", "--workers", "2"]
    assert main(["campaign", str(short), "--runs", "8", *tune]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["settings"]["ekf.rate_noise"] > 1e-3
    assert found["low"] > 0
    assert found["after"] < found["before"]
    scores = {trial["ekf.rate_noise"]: trial["score"] for trial in found["trials"]}
    assert scores[found["settings"]["ekf.rate_noise"]] == min(scores.values())
    assert len(scores) > 3


def test_an_interrupt_keeps_the_runs_and_names_them(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = campaign.flights.fly_all

    def stopped(pool: runs.Pool, todo: Iterator[Run], ahead: int | None = None) -> Iterator[Outcome]:
        for outcome in flown(pool, todo, ahead):
            yield outcome
            if outcome.key == 2:
                raise KeyboardInterrupt

    monkeypatch.setattr(campaign.flights, "warm_up", lambda *_: None)
    monkeypatch.setattr(campaign.flights, "fly_all", stopped)
    out = tmp_path / "out"
    assert main(["campaign", str(short), "--runs", "5", "-o", str(out), "--workers", "1"]) == 130
    assert f"stopped; 3 of 5 runs are in {out}; the same command flies the rest" in capsys.readouterr().err
    assert Store(str(out)).done() == {0, 1, 2}


@pytest.mark.long
def test_killed_campaign_goes_on_to_exactly_n_runs(short: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "ahrs_sim", "campaign", str(short), "--runs", "200", "-o", str(out), "--quiet"]
    process = subprocess.Popen(command, start_new_session=True)
    deadline = time.monotonic() + 100
    while len(list(out.glob("runs-*.parquet"))) < 1 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = len(Store(str(out)).done())
    assert 0 < before < 200
    assert subprocess.run(command, check=False).returncode == 0
    table = Store(str(out)).table(["run"])
    assert table["run"].to_pylist() == list(range(200))


# ----------------------------------------------------------------------------------------------- cluster


@pytest.fixture
def cluster() -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and two workers of Dask's in processes of their own."""
    pytest.importorskip("distributed")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    base = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port)]
    scheduler = subprocess.Popen([*base, "--no-dashboard"], **quiet)  # type: ignore[call-overload]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]  # fmt: skip  # noqa: E501
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
        time.sleep(0.1)
    workers = [subprocess.Popen(worker, **quiet) for _ in range(2)]  # type: ignore[call-overload]
    try:
        yield address, workers
    finally:
        for process in [*workers, scheduler]:
            process.kill()
            process.wait()


@pytest.mark.long
@pytest.mark.filterwarnings("default")
def test_a_cluster_gives_the_same_table_though_a_worker_is_killed(
    short: Path, tmp_path: Path, cluster: tuple[str, list[subprocess.Popen[bytes]]]
) -> None:
    address, workers = cluster
    vary = ["suite.chr.gyro.noise_density_dps_rthz=uniform:0.01..0.1"]
    count = 100
    plan = Plan.make(scenario.load(str(short)), count, vary)
    store = Store(str(tmp_path / "cluster"))
    done: list[int] = []

    def progress(now: int, of: int) -> None:
        done.append(now)
        if now == count // 4:
            workers[0].kill()

    with runs.dask_pool(address) as pool:
        deadline = time.monotonic() + 60
        client = pool.executor._client  # type: ignore[attr-defined]
        while len(client.scheduler_info()["workers"]) < 2 and time.monotonic() < deadline:
            time.sleep(0.1)
        campaign.fly(plan, store, pool, progress)
    assert workers[0].poll() is not None
    assert done == list(range(1, count + 1))
    local = fly(short, count, str(tmp_path / "local"), vary, workers=2)
    assert same(rows(store), rows(local))
    assert [r["run"] for r in rows(local)] == list(range(count))
