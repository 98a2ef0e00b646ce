"""PX4 and ArduPilot with our flight as their simulator, played by fakes that follow the documented exchange."""

import json
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_serve import differences, prepare, served

from ahrs_sim import attitude, cli
from ahrs_sim.log.flight_reader import FlightReader

FAKE = Path(__file__).parent / "autopilots.py"


def free(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as made:
        made.bind(("127.0.0.1", 0))
        return int(made.getsockname()[1])


def fly(folder: Path, simulator: str, answers: int) -> dict[str, dict[str, dict[str, float]]]:
    path = prepare(folder, "mavlink")
    known = json.loads((folder / "known.json").read_text())
    (folder / "known.json").write_text(json.dumps({**known, "epoch": 1780308000.0}))
    options = [
        "--simulator",
        simulator,
        "--port",
        "0",
        "--mavlink",
        str(answers),
        "-o",
        str(folder / "x.mcap"),
        "--json",
    ]
    with served(path, *options) as (process, where):
        port = where.removeprefix("udp:")
        fake = subprocess.Popen([sys.executable, str(FAKE), simulator, port, str(answers), str(folder / "known.json")])
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        assert fake.wait(10) == 0
    result: dict[str, dict[str, dict[str, float]]] = json.loads(out)
    return result


def test_px4_in_lockstep_has_the_figures_of_the_same_estimator_in_process(tmp_path: Path) -> None:
    result = fly(tmp_path, "px4", free(socket.SOCK_DGRAM))
    timing = result["timing"]
    assert timing["sent"] == 1501 and timing["foreign"] == timing["damaged"] == 0 and timing["answers"] > 800
    inside, px4 = result["estimators"]["inside"], result["estimators"]["px4"]
    assert px4["tilt_rmse_deg"] == pytest.approx(inside["tilt_rmse_deg"], rel=0.02)
    assert differences(tmp_path / "x.mcap", name="px4").max() < 1e-3


@pytest.mark.long
def test_ardupilot_gets_the_flight_and_its_attitude_has_the_right_time(tmp_path: Path) -> None:
    result = fly(tmp_path, "ardupilot", free(socket.SOCK_STREAM))
    timing = result["timing"]
    assert timing["sent"] == 1501 and timing["foreign"] == 0 and timing["answers"] > 550
    assert result["estimators"]["ardupilot"]["tilt_rmse_deg"] < 0.05  # it was given the truth
    with FlightReader(tmp_path / "x.mcap") as reader:
        given, truth = reader.estimates("ardupilot"), reader.truth()
    known = np.isfinite(given.q_nb[:, 0])
    off = attitude.rotation_vector(given.q_nb[known], attitude.interpolate(truth.t, truth.q_nb, given.t[known]))
    assert np.degrees(np.linalg.norm(off, axis=1)).max() < 0.3  # the truth's row next to the sample's time


def test_a_simulator_and_a_wire_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["serve", "takeoff", "-o", "none.mcap"]
    assert cli.main(command) == 2
    assert cli.main([*command, "--serial", "pty"]) == 2
    assert cli.main([*command, "--serial", "pty", "--protocol", "sbg", "--simulator", "px4"]) == 2
    assert cli.main([*command, "--simulator", "px4", "--rate", "2"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert (
        len(lines) == 4
        and len(set(lines[:3])) == 1
        and "--simulator px4|ardupilot" in lines[0]
        and "lockstep" in lines[3]
    )


@pytest.mark.parametrize(
    ("simulator", "option", "kind"),
    [
        ("px4", "--port", socket.SOCK_STREAM),
        ("px4", "--mavlink", socket.SOCK_DGRAM),
        ("ardupilot", "--port", socket.SOCK_DGRAM),
    ],
)
def test_a_port_in_use_is_one_line(
    simulator: str, option: str, kind: socket.SocketKind, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        if kind is socket.SOCK_STREAM:
            taken.listen()
        port = str(taken.getsockname()[1])
        ports = {"--port": "0", "--mavlink": "0", option: port}
        asked = [x for pair in ports.items() for x in pair]
        assert cli.main(["serve", "takeoff", "--simulator", simulator, *asked, "-o", "none.mcap"]) == 2
    line = capsys.readouterr().err
    assert re.fullmatch(rf"ahrs-sim: {option} (tcp:)?{port}: Address already in use; choose another port\n", line)


@pytest.mark.long
def test_px4_that_leaves_ends_the_flight_with_a_complete_log(tmp_path: Path) -> None:
    path = prepare(tmp_path, "mavlink")
    options = ["--simulator", "px4", "--port", "0", "--mavlink", "0", "-o", str(tmp_path / "x.mcap")]
    with served(path, *options) as (process, where):
        with socket.create_connection(("127.0.0.1", int(where))) as wire:
            wire.recv(1000)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 1 and err.count("\n") == 1
    assert re.search(r"px4: link lost at \d+\.\d s of flight \(.*\); the log is complete up to there", err)
    with FlightReader(tmp_path / "x.mcap") as reader:
        assert any("link lost" in e.text for e in reader.events())
