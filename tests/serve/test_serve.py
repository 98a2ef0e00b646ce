"""A flight for a unit on a wire: the same estimator there and in process gives the same attitudes."""

import dataclasses
import json
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import attitude, cli, scenario
from ahrs_sim.chain import site
from ahrs_sim.flight import open_flight
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.reader import stamps
from ahrs_sim.sensors import make_suite

CLIENT = Path(__file__).parent / "client.py"
FLIGHT = """
extends = "takeoff"
duration_s = 20.0
estimators = ["inside"]
[estimator.inside]
method = "{method}"
suite = "chr"
align_s = 5.0
[[step]]
do = "wait"
for_s = 6.0
[[step]]
do = "takeoff"
to_height_m = 40.0
[[step]]
do = "turn"
bank_deg = 30.0
through_deg = 180.0
"""


def prepare(folder: Path, method: str = "marg-ekf") -> str:
    """A scenario, and beside it what the unit has to know."""
    path = folder / "flight.toml"
    path.write_text(FLIGHT.format(method=method))
    made = scenario.load(str(path))
    flight = open_flight(made)
    place = site(flight.start_lla, made.epoch)
    suite = make_suite(made.suites[0], seed=made.seed, dt=flight.dt, epoch=made.epoch, start_lla=np.array(place.lla))
    known = {"site": dataclasses.asdict(place), "sensors": dataclasses.asdict(suite.info)}
    known |= {"method": method, "settings": {"align_s": 5.0}}
    (folder / "known.json").write_text(json.dumps(known))
    return str(path)


@contextmanager
def served(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command in a process of its own, and the wire it waits at."""
    command = [sys.executable, "-m", "ahrs_sim", "serve", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        line = process.stderr.readline()
        found = re.search(r"waiting for the unit at (\S+)", line)
        assert found, line + process.stderr.read()
        try:
            yield process, found[1].removeprefix("tcp:")
        finally:
            process.kill()


def fly_with_unit(folder: Path, protocol: str, serial: str, method: str = "marg-ekf") -> dict[str, object]:
    """Serve a flight to the client; the printed result."""
    path = prepare(folder, method)
    options = ["--serial", serial, "--protocol", protocol, "--rate", "4", "-o", str(folder / "x.mcap"), "--json"]
    with served(path, *options) as (process, wire):
        unit = subprocess.Popen([sys.executable, str(CLIENT), wire, protocol, str(folder / "known.json")])
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        unit.wait(10)
    result: dict[str, object] = json.loads(out)
    return result


def differences(log: Path) -> np.ndarray:
    """Angles (n,) deg between the attitudes of the unit and in process, of the same samples."""
    with FlightReader(log) as reader:
        inside, unit = reader.estimates("inside"), reader.estimates("unit")
    known = np.isfinite(unit.q_nb[:, 0])
    rows = np.searchsorted(inside.t, unit.t[known] - 1e-7)
    np.testing.assert_allclose(inside.t[rows], unit.t[known], atol=1e-8)
    turn = attitude.rotation_vector(unit.q_nb[known], inside.q_nb[rows])
    assert np.isfinite(turn).all() and np.ptp(attitude.euler(inside.q_nb[rows])[:, 1]) > 0.1
    return np.degrees(np.linalg.norm(turn, axis=1))


@pytest.mark.parametrize(("protocol", "serial", "most"), [("mavlink", "pty", 1e-3), ("mavlink", "tcp:0", 1e-3)])
def test_a_unit_on_the_wire_has_the_figures_of_the_same_estimator_in_process(
    tmp_path: Path, protocol: str, serial: str, most: float
) -> None:
    result = fly_with_unit(tmp_path, protocol, serial)
    timing = result["timing"]
    assert timing["sent"] == 2001 and timing["foreign"] == timing["damaged"] == 0
    assert timing["answers"] > 1000 and 0.0 < timing["latency_s"][0] < timing["latency_s"][-1]
    off = differences(tmp_path / "x.mcap")
    assert len(off) == timing["answers"]
    print(f"{protocol}: largest difference {off.max():.2e} deg, latency {timing['latency_s'][0] * 1e3:.2f} ms")
    assert off.max() < most
    inside, unit = result["estimators"]["inside"], result["estimators"]["unit"]
    assert unit["tilt_rmse_deg"] == pytest.approx(inside["tilt_rmse_deg"], rel=0.05)
    with FlightReader(tmp_path / "x.mcap") as reader:
        messages = reader.read("/est/unit/state")
        late = (messages["log_time"] - stamps(messages)) / 1e9
        assert (late >= 0.0).all() and 0.0 < np.median(late[late > 0.0]) < 2.0
        lines = [e.text for e in reader.events() if e.name == "unit"]
    assert any("latency" in line for line in lines) and any("#" in line for line in lines)


@pytest.mark.parametrize(
    ("serial", "protocol", "line"),
    [
        ("tcp:{taken}", "mavlink", r"--serial tcp:\d+: Address already in use; choose another port"),
        ("tcp:99999", "mavlink", r"--serial tcp:99999: .*; choose another port"),
        ("pty", "mavlnik", r"--protocol mavlnik: unknown; did you mean 'mavlink'\?"),
        ("ttyUSB0", "mavlink", r"--serial ttyUSB0: unknown; give pty, tcp:PORT or a device .*"),
        ("/dev/ttyNone", "mavlink", r"--serial /dev/ttyNone: no such device; .*"),
        ("/dev/null", "mavlink", r"--serial /dev/null: is no serial device; .*"),
        ("/dev/null@12345", "mavlink", r"--serial /dev/null@12345: no such speed; .*"),
    ],
)
def test_a_wire_or_protocol_that_is_none_is_one_line(
    tmp_path: Path, serial: str, protocol: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        serial = serial.replace("{taken}", str(taken.getsockname()[1]))
        log = str(tmp_path / "x.mcap")
        assert cli.main(["serve", "takeoff", "--serial", serial, "--protocol", protocol, "-o", log]) == 2
    assert re.fullmatch(f"ahrs-sim: {line}\n", capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_names_and_suites_that_do_not_fit_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["serve", "takeoff", "--serial", "pty", "--protocol", "mavlink", "-o", "none.mcap"]
    assert cli.main([*command, "--suite", "cher"]) == 2
    assert cli.main([*command, "--name", "ekf-chr"]) == 2
    assert cli.main([*command, "--name", "1/2"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3 and "did you mean 'chr'" in lines[0]
    assert "an estimator of the scenario has this name" in lines[1] and "a letter first" in lines[2]


@pytest.mark.parametrize("serial", ["pty", "tcp:0"])
def test_a_link_that_is_lost_ends_the_flight_with_a_complete_log(tmp_path: Path, serial: str) -> None:
    path, log = prepare(tmp_path), tmp_path / "x.mcap"
    options = ["--serial", serial, "--protocol", "mavlink", "--rate", "4", "-o", str(log)]
    with served(path, *options) as (process, wire):
        # leaves after 1000 samples
        subprocess.run([sys.executable, str(CLIENT), wire, "mavlink", str(tmp_path / "known.json"), "1000"], check=True)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert re.search(
        r"ahrs-sim: \S+flight.toml: \S+: link lost at \d+\.\d s of flight \(.*\); the log is complete", err
    )
    assert err.count("\n") == 1 and "unit" in out and "samples sent" in out
    with FlightReader(log) as reader:
        t = reader.estimates("unit").t
        assert 9.0 < t[-1] < 13.0
        assert any(e.level == "error" and "link lost" in e.text for e in reader.events())
