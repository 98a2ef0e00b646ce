"""Whole flights through the command line, as a user runs them.

One flight of 75 s (all estimators of the circuit; standing, take-off, climb) and one whole circuit serve most tests.
"""

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import pipeline, scenario
from ahrs_sim.cli import main
from ahrs_sim.log.mcap.reader import LogReader

ROOT = Path(__file__).parents[1]


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "ahrs_sim", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def fly(*arguments: str | Path) -> int:
    return main(["fly", *map(str, arguments), "--quiet"])


def compare(log: Path, *arguments: str) -> dict:
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main(["compare", str(log), "--json", *arguments]) == 0
    return json.loads(out.getvalue())


def read(log: Path, topic: str) -> np.ndarray:
    with LogReader(log) as reader:
        return reader.read(topic)


@pytest.fixture(scope="module")
def circuit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole circuit."""
    log = tmp_path_factory.mktemp("circuit") / "circuit.mcap"
    assert fly("circuit", "-o", log, "--seed", "1") == 0
    return log


SHORT_S = 75.0
Short = tuple[Path, subprocess.CompletedProcess[str]]
"""A log, and the command that flew it."""


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Short:
    """The circuit's beginning."""
    log = tmp_path_factory.mktemp("short") / "short.mcap"
    done = run("fly", "circuit", "--duration", str(SHORT_S), "-o", log, "--json")
    assert done.returncode == 0, done.stderr
    return log, done


def test_fly_prints_the_table_and_the_path(short: Short, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """And nothing else: `short` has compiled the estimators."""
    log = tmp_path / "a.mcap"
    assert main(["fly", "circuit", "--duration", "30", "-o", str(log)]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    for name in ("ekf-chr", "ckf-chr", "cdkf-chr", "ekf-sbg"):
        assert re.search(rf"^{name} +\d", out, re.MULTILINE), out
    assert out.rstrip().endswith(str(log))


def test_fly_and_compare_report_the_same(short: Short) -> None:
    log, done = short
    assert json.loads(done.stdout) == compare(log)


def test_same_seed_same_bytes_whatever_the_block(short: Short, tmp_path: Path) -> None:
    log, other, seed_2 = short[0], tmp_path / "block.mcap", tmp_path / "seed.mcap"
    assert fly("circuit", "--duration", str(SHORT_S), "-o", other, "--block", "0.37") == 0
    assert log.read_bytes() == other.read_bytes()
    assert fly("circuit", "--duration", "10", "-o", seed_2, "--seed", "2") == 0
    a, b = (read(x, "/chr/imu/data_raw")["angular_velocity"][:900] for x in (log, seed_2))
    assert (a != b).mean() > 0.9


def test_a_process_of_its_own_flies_the_same(short: Short, tmp_path: Path) -> None:
    here = tmp_path / "here.mcap"
    pipeline.fly(scenario.load("circuit", duration=SHORT_S), here)
    assert short[0].read_bytes() == here.read_bytes()


@pytest.mark.long
def test_one_sample_blocks_are_the_same_code(tmp_path: Path) -> None:
    """The closed loop works sample by sample; flying on the truth that way changes nothing."""
    logs, scene = [tmp_path / "open.mcap", tmp_path / "sample.mcap"], tmp_path / "soon.toml"
    soon = 'extends = "takeoff"\nestimators = ["a", "b"]\nduration_s = 20.0\n'
    soon += '[estimator.a]\nmethod = "marg-ckf"\nsuite = "chr"\naiding = "airspeed"\nalign_s = 6.0\n'
    soon += '[estimator.b]\nmethod = "ins21"\nsuite = "sbg"\nalign_s = 6.0\n'
    soon += '[[step]]\ndo = "wait"\nfor_s = 8.0\n[[step]]\ndo = "takeoff"\n'
    scene.write_text(soon)
    assert fly(scene, "-o", logs[0]) == 0
    assert read(logs[0], "/truth/attitude")["pitch"].max() > 0.05, "it has taken off"
    assert fly(scene, "-o", logs[1], "--block", "0.01") == 0
    assert logs[0].read_bytes() == logs[1].read_bytes()


def test_estimators_asked_for_do_not_change_the_flight(short: Short, tmp_path: Path) -> None:
    """Noise depends on the seed and the sensor's name alone."""
    one = tmp_path / "one.mcap"
    assert fly("circuit", "--duration", "30", "-o", one, "--estimator", "ckf-chr") == 0
    for topic in ("/chr/imu/data_raw", "/est/ckf-chr/state", "/truth/odometry"):
        fewer, all_ = read(one, topic), read(short[0], topic)
        assert len(fewer) > 2900
        assert fewer.tobytes() == all_[: len(fewer)].tobytes()


@pytest.mark.long
def test_circuit_on_the_ground_and_straight(circuit: Path) -> None:
    result = compare(circuit)
    assert result["reference"] == "truth"
    practical = {"ckf-air-chr", "air-ins-chr", "ins21-chr", "ins21-sbg"}
    assert set(result["estimators"]) == {"ekf-chr", "ckf-chr", "cdkf-chr", "ekf-sbg"} | practical
    for name in practical:
        phases = result["estimators"][name]["phases"]
        assert max(phases[p]["tilt_rmse_deg"] for p in ("ground", "straight", "turning")) < 2.0, name
    for name, values in result["estimators"].items():
        if name in practical:
            continue
        for key in ("roll_rmse_deg", "pitch_rmse_deg", "heading_rmse_deg", "tilt_rmse_deg", "total_rmse_deg"):
            assert 0 < values[key] < 180, (name, key)
            assert values[key] <= values[key.replace("rmse", "max")]
        phases = values["phases"]
        assert phases["ground"]["tilt_rmse_deg"] < 1.0, name
        # Gusts move the apparent vertical by a degree, and the low-cost unit's filters follow it soonest.
        assert phases["straight"]["tilt_rmse_deg"] < (1.4 if name == "ekf-sbg" else 2.0), name
        assert phases["turning"]["tilt_rmse_deg"] > 5.0, "without aiding a turn reads as level flight"


def test_compare_with_the_papers_reference(short: Short) -> None:
    result = compare(short[0], "--reference", "ekf-sbg")
    assert result["reference"] == "ekf-sbg"
    assert result["estimators"]["ekf-sbg"]["total_max_deg"] < 1e-6
    assert result["estimators"]["ckf-chr"]["total_rmse_deg"] > 0.1


def test_kill_and_recover(short: Short, tmp_path: Path) -> None:
    log, part, back = tmp_path / "k.mcap", tmp_path / "k.mcap.part", tmp_path / "back.mcap"
    process = subprocess.Popen(
        [sys.executable, "-m", "ahrs_sim", "fly", "circuit", "--estimator", "ekf-chr", "-o", str(log)],
        stdout=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 120
    while not (part.exists() and part.stat().st_size > 3e6) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not log.exists()
    assert main(["compare", str(part)]) == 2
    assert main(["recover", str(part), "-o", str(back)]) == 0
    assert compare(back)["to_s"] > 5
    a, b = (read(x, "/truth/odometry") for x in (back, short[0]))
    n = min(len(a), len(b))
    assert n > 500
    assert a[:n].tobytes() == b[:n].tobytes()


@pytest.mark.long
def test_interrupt_closes_the_log(tmp_path: Path) -> None:
    log, part = tmp_path / "i.mcap", tmp_path / "i.mcap.part"
    process = subprocess.Popen(
        [sys.executable, "-m", "ahrs_sim", "fly", "circuit", "--estimator", "ekf-chr", "-o", str(log)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while not (part.exists() and part.stat().st_size > 1e6) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert log.exists()
    assert not part.exists()
    assert compare(log)["to_s"] > 1


BAD = {
    "unknown key": ('extends = "circuit"\nsede = 3\n', "sede"),
    "unknown aircraft": ('aircraft = "trainr"\n[[step]]\ndo = "wait"\nfor_s = 1.0\n', "trainer"),
    "unknown manoeuvre": ('[[step]]\ndo = "trun"\nbank_deg = 30.0\n', "turn"),
    "unknown manoeuvre key": ('[[step]]\ndo = "wait"\nfor_d = 30.0\n', "for_s"),
    "unknown property": ('[[step]]\ndo = "set"\nproperty = "fcs/nothing"\nvalue = 1.0\n', "fcs/nothing"),
    "negative duration": ('[[step]]\ndo = "wait"\nfor_s = -1.0\n', "for_s"),
    "nan": ('[[step]]\ndo = "turn"\nbank_deg = nan\n', "bank_deg"),
    "unknown grade": ('extends = "circuit"\n[suite.chr]\ngrade = "chr_6dn"\n', "chr_6dm"),
    "unknown method": ('extends = "circuit"\n[estimator.x]\nmethod = "marg-ckff"\nsuite = "chr"\n', "marg-ckf"),
    "unknown setting": ('extends = "circuit"\n[estimator.ckf-chr]\nnoize = "given"\n', "noise"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_scenarios_get_one_line_and_leave_nothing(
    tmp_path: Path, case: str, capfd: pytest.CaptureFixture[str]
) -> None:
    text, word = BAD[case]
    scene, log = tmp_path / "bad.toml", tmp_path / "bad.mcap"
    scene.write_text(text)
    assert main(["fly", str(scene), "-o", str(log)]) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1, error
    assert "bad.toml" in error
    assert word in error
    assert list(tmp_path.iterdir()) == [scene]


def test_what_jsbsim_refuses_in_its_process_is_one_line(tmp_path: Path) -> None:
    scene = tmp_path / "bad.toml"
    scene.write_text(BAD["unknown property"][0])
    done = run("fly", scene, "-o", tmp_path / "bad.mcap")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "fcs/nothing" in done.stderr
    assert list(tmp_path.iterdir()) == [scene]


def test_existing_and_unwritable_output(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "kept.mcap"
    log.write_bytes(b"precious")
    assert main(["fly", "circuit", "-o", str(log)]) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "--force" in error
    assert log.read_bytes() == b"precious"
    assert main(["fly", "circuit", "-o", str(log / "x.mcap")]) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "kept.mcap" in error


@pytest.mark.parametrize("content", [b"", b"hello, not a log", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + os.urandom(500)])
def test_compare_refuses_what_is_no_log(tmp_path: Path, content: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    for command in ("compare", "info"):
        assert main([command, str(path)]) == 2
        error = capfd.readouterr().err
        assert error.count("\n") == 1, error
        assert "x.mcap" in error


def test_truncated_log(short: Short, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(short[0].read_bytes()[:2_000_000])
    assert main(["compare", str(path)]) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "recover" in error


def test_help_is_quick_because_imports_are_lazy() -> None:
    code = "import sys, ahrs_sim.cli as c\ntry: c.main(['--help'])\nexcept SystemExit: pass\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not loaded & {"numba", "jsbsim", "pandas", "scipy", "matplotlib", "mcap", "numpy"}


def test_fly_does_not_import_what_it_does_not_need(tmp_path: Path) -> None:
    code = (
        "import sys, ahrs_sim.cli as c\n"
        "asked = ['fly', 'circuit', '--estimator', 'ekf-chr', '--duration', '2', '--quiet']\n"
        f"assert c.main([*asked, '-o', {str(tmp_path / 'x.mcap')!r}]) == 0\n"
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & {"pandas", "scipy.signal", "matplotlib", "rosbags"}
