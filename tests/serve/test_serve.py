"""A flight for a unit on a wire: the same estimator there and in process gives the same attitudes."""

import dataclasses
import json
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ahrs_sim import attitude, cli, scenario
from ahrs_sim.chain import site
from ahrs_sim.flight import open_flight
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.reader import stamps
from ahrs_sim.sensors import make_suite
from ahrs_sim.sensors.assemble import Assembler
from estimators import create
from estimators.types import Estimates, Samples, SensorInfo, Site

CLIENT = Path(__file__).parent / "client.py"
FLIGHT = """
extends = "takeoff"
duration_s = 15.0
estimators = ["inside"]
[suite.chr]
instruments = ["imu", "magnetometer", "gnss", "air_data"]
[estimator.inside]
method = "marg-ekf"
suite = "chr"
align_s = 5.0
aiding = "airspeed"
[[step]]
do = "wait"
for_s = 6.0
[[step]]
do = "takeoff"
to_height_m = 10.0
[[step]]
do = "turn"
bank_deg = 30.0
through_deg = 180.0
"""


# u-blox has no magnetometer and no air data: a navigator, which finds its heading in motion
OTHER = {
    "ubx+nmea": {"instruments": ["imu", "gnss"], "method": "ins15", "settings": {"align_s": 5.0, "heading_aid": False}},
    "mavlink": {"settings": {"align_s": 5.0}},  # of MAVLink's sensor messages none has the airspeed
    "vectornav": {"settings": {"align_s": 5.0}},
}


def prepare(folder: Path, protocol: str = "sbg") -> str:
    """A scenario, and beside it what the unit has to know."""
    import tomllib

    import tomli_w

    path = folder / "flight.toml"
    data = tomllib.loads(FLIGHT)
    other = OTHER.get(protocol, {})
    settings = other.get("settings", {"align_s": 5.0, "aiding": "airspeed"})
    method = other.get("method", "marg-ekf")
    data["suite"]["chr"]["instruments"] = other.get("instruments", data["suite"]["chr"]["instruments"])
    data["estimator"]["inside"] = {"method": method, "suite": "chr", **settings}
    path.write_text(tomli_w.dumps(data))
    made = scenario.load(str(path))
    flight = open_flight(made)
    place = site(flight.start_lla, made.epoch)
    component = next(c for c in made.suites if c.name == "chr")
    suite = make_suite(component, seed=made.seed, dt=flight.dt, epoch=made.epoch, start_lla=np.array(place.lla))
    known = {"site": dataclasses.asdict(place), "sensors": dataclasses.asdict(suite.info)}
    (folder / "known.json").write_text(json.dumps({**known, "method": method, "settings": settings}))
    return str(path)


@contextmanager
def served(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command in a process of its own, and the wire it waits at."""
    command = [sys.executable, "-m", "ahrs_sim", "serve", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        line = process.stderr.readline()
        found = re.search(r"waiting for the \w+ at (\S+)", line)
        assert found, line + process.stderr.read()
        try:
            yield process, found[1].removeprefix("tcp:")
        finally:
            process.kill()


def fly_with_unit(folder: Path, protocol: str, serial: str) -> dict[str, Any]:
    """Serve a flight to the client; the printed result."""
    path = prepare(folder, protocol)
    rate = "2" if protocol == "ubx+nmea" else "4"  # pyubx2 takes its time
    options = ["--serial", serial, "--protocol", protocol, "--rate", rate, "-o", str(folder / "x.mcap"), "--json"]
    with served(path, *options) as (process, wire):
        unit = subprocess.Popen([sys.executable, str(CLIENT), wire, protocol, str(folder / "known.json")])
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        unit.wait(10)
    result: dict[str, Any] = json.loads(out)
    return result


def differences(log: Path, inside: Estimates | None = None, name: str = "unit") -> np.ndarray:
    """Angles (n,) deg between the attitudes of the unit and in process, of the same samples."""
    with FlightReader(log) as reader:
        unit = reader.estimates(name)
        inside = inside or reader.estimates("inside")
    known = np.isfinite(unit.q_nb[:, 0])
    rows = np.searchsorted(inside.t, unit.t[known] - 6e-4)
    np.testing.assert_allclose(inside.t[rows], unit.t[known], atol=6e-4)
    turn = attitude.rotation_vector(unit.q_nb[known], inside.q_nb[rows])
    both = np.isfinite(turn[:, 0])
    assert both.sum() > len(both) - 3 and np.ptp(attitude.euler(inside.q_nb[rows[both]])[:, 1]) > 0.1
    return np.degrees(np.linalg.norm(turn[both], axis=1))


def through_ubx(folder: Path) -> Estimates:
    """What the estimator makes of the log's samples in the resolution of UBX."""
    known = json.loads((folder / "known.json").read_text())
    with FlightReader(folder / "x.mcap") as reader:
        assembler = Assembler()
        blocks = [assembler.assemble(block["chr"]) for block in reader.suite_blocks(["chr"])]
    s = Samples.concatenate(blocks)
    lla = np.column_stack(
        [np.radians(np.rint(np.degrees(s.lla[:, :2]) * 1e7) * 1e-7), np.rint(s.lla[:, 2] * 1e3) * 1e-3]
    )
    coarse = dataclasses.replace(
        s,
        t=np.rint(s.t * 1e3) * 1e-3,
        gyro_b=np.radians(np.rint(np.degrees(s.gyro_b) * 4096) / 4096),
        accel_b=np.rint(s.accel_b * 1024) / 1024,
        lla=lla,
        vel_n=np.rint(s.vel_n * 1e3) * 1e-3,
        gnss_t=np.rint(s.gnss_t * 1e3) * 1e-3,
    )
    given = [{k: tuple(v) if isinstance(v, list) else v for k, v in known[key].items()} for key in ("site", "sensors")]
    made = create(known["method"], site=Site(**given[0]), sensors=SensorInfo(**given[1]), **known["settings"])
    return made.process(coarse)


@pytest.mark.parametrize(
    ("protocol", "serial", "most"),
    [
        ("mavlink", "pty", 1e-3),
        pytest.param("mavlink", "tcp:0", 1e-3, marks=pytest.mark.long),
        pytest.param("vectornav", "pty", 1e-3, marks=pytest.mark.long),
        pytest.param("sbg", "pty", 1e-3, marks=pytest.mark.long),
        pytest.param("ubx+nmea", "pty", 1e-3, marks=pytest.mark.long),
    ],
)
def test_a_unit_on_the_wire_has_the_figures_of_the_same_estimator_in_process(
    tmp_path: Path, protocol: str, serial: str, most: float
) -> None:
    result = fly_with_unit(tmp_path, protocol, serial)
    timing = result["timing"]
    assert timing["sent"] == 1501 and timing["foreign"] == timing["damaged"] == 0
    assert timing["answers"] > 500 and 0.0 < timing["latency_s"][0] < timing["latency_s"][-1]
    off = differences(tmp_path / "x.mcap")
    if protocol == "ubx+nmea":
        print(f"{protocol}: resolution costs {np.sqrt(np.mean(off**2)):.2e} deg RMS")
        off = differences(tmp_path / "x.mcap", through_ubx(tmp_path))
    assert len(off) > timing["answers"] - 3
    print(f"{protocol}: largest difference {off.max():.2e} deg, latency {timing['latency_s'][0] * 1e3:.2f} ms", timing)
    assert off.max() < most
    inside, unit = result["estimators"]["inside"], result["estimators"]["unit"]
    if timing["late"] == 0:  # else a busy machine: the figures are of fewer answers
        near = 0.2 if protocol == "ubx+nmea" else 0.01  # its resolution costs more than the others'
        assert unit["tilt_rmse_deg"] == pytest.approx(inside["tilt_rmse_deg"], rel=near)
        assert unit["availability"] == pytest.approx(inside["availability"], abs=0.02)
    assert (unit["nees"] is not None) == (protocol in ("sbg", "ubx+nmea"))  # the client sends sigmas there
    with FlightReader(tmp_path / "x.mcap") as reader:
        messages = reader.read("/est/unit/state")
        late = (messages["log_time"] - stamps(messages)) / 1e9
        assert (late >= 0.0).all() and 0.0 < np.median(late[late > 0.0]) < 2.0
        lines = [e.text for e in reader.events() if e.name == "unit"]
    assert {"latency, ms", "jitter, ms"} <= set(lines) and lines[0].startswith("chr at ")


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


@pytest.mark.parametrize(
    ("options", "awaited"),
    [
        (["--serial", "tcp:0", "--protocol", "sbg"], r"unit at tcp:\d+"),
        (["--serial", "pty", "--protocol", "sbg"], r"unit at /dev/\S+"),
        (["--simulator", "px4", "--port", "0", "--mavlink", "0"], r"px4 at \S+"),
        (["--simulator", "ardupilot", "--port", "0", "--mavlink", "0"], r"ardupilot at udp:\d+"),
    ],
)
def test_a_unit_that_never_comes_is_one_line(
    tmp_path: Path, options: list[str], awaited: str, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "x.mcap"
    assert cli.main(["serve", "takeoff", *options, "--wait", "0.3", "-o", str(log)]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert re.fullmatch(rf"ahrs-sim: serve: no {awaited} after 0.3 s; start it, or --wait longer", line)
    assert not log.exists()


def test_a_unit_that_leaves_before_the_first_sample_ends_the_flight(tmp_path: Path) -> None:
    path, log = prepare(tmp_path, "mavlink"), tmp_path / "x.mcap"
    with served(path, "--serial", "tcp:0", "--protocol", "mavlink", "-o", str(log)) as (process, port):
        socket.create_connection(("127.0.0.1", int(port))).close()
        _, err = process.communicate(timeout=60)
    assert process.returncode == 1 and err.count("\n") == 1
    assert re.search(r"tcp:\d+: link lost at 0\.\d s of flight \(.*\); the log is complete up to there", err)


def test_names_and_suites_that_do_not_fit_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["serve", "takeoff", "--serial", "pty", "--protocol", "mavlink", "-o", "none.mcap"]
    assert cli.main([*command, "--suite", "cher"]) == 2
    assert cli.main([*command, "--name", "ekf-chr"]) == 2
    assert cli.main([*command, "--name", "1/2"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3 and "did you mean 'chr'" in lines[0]
    assert "an estimator of the scenario has this name" in lines[1] and "a letter first" in lines[2]


@pytest.mark.parametrize("serial", ["pty", pytest.param("tcp:0", marks=pytest.mark.long)])
def test_a_link_that_is_lost_ends_the_flight_with_a_complete_log(tmp_path: Path, serial: str) -> None:
    path, log = prepare(tmp_path, "mavlink"), tmp_path / "x.mcap"
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


@pytest.mark.long
def test_a_serial_device(tmp_path: Path) -> None:
    path, (ours, theirs) = prepare(tmp_path, "sbg"), os.openpty()
    device = os.ttyname(theirs)
    options = ["--serial", f"{device}@921600", "--protocol", "sbg", "--rate", "4", "--duration", "12", "--json"]
    known = str(tmp_path / "known.json")
    with subprocess.Popen([sys.executable, str(CLIENT), f"fd:{ours}", "sbg", known], pass_fds=[ours]) as unit:
        with served(path, *options, "-o", str(tmp_path / "x.mcap")) as (process, wire):
            assert wire == device
            out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        os.close(theirs)
        os.close(ours)
        unit.wait(10)
    assert json.loads(out)["timing"]["answers"] > 200


@pytest.mark.long
def test_a_device_that_is_too_slow_is_one_line(tmp_path: Path) -> None:
    path, (ours, theirs) = prepare(tmp_path, "sbg"), os.openpty()
    os.set_blocking(ours, False)
    options = ["--serial", f"{os.ttyname(theirs)}@38400", "--protocol", "sbg", "-o", str(tmp_path / "x.mcap")]
    with served(path, *options) as (process, _):
        while process.poll() is None:
            with suppress(BlockingIOError):
                os.read(ours, 4096)
            time.sleep(0.01)
        _, err = process.communicate()
    os.close(ours)
    os.close(theirs)
    assert process.returncode == 1 and err.count("\n") == 1
    assert "the stream takes more than 38400 baud; use a faster one, or a lower rate_hz" in err


@pytest.mark.long
def test_the_log_gives_the_figures_that_were_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = fly_with_unit(tmp_path, "vectornav", "pty")["estimators"]
    assert cli.main(["compare", str(tmp_path / "x.mcap"), "--json"]) == 0
    compared = json.loads(capsys.readouterr().out)["estimators"]
    for name in ("inside", "unit"):
        assert compared[name]["tilt_rmse_deg"] == pytest.approx(printed[name]["tilt_rmse_deg"], rel=1e-3)
    replayed = str(tmp_path / "y.mcap")
    assert cli.main(["replay", str(tmp_path / "x.mcap"), "-o", replayed, "--estimator", "inside", "--json"]) == 0
    again = json.loads(capsys.readouterr().out)["estimators"]
    assert again["unit"]["tilt_rmse_deg"] == compared["unit"]["tilt_rmse_deg"]
