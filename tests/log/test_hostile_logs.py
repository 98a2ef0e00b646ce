"""Logs made to harm: definitions that promise gigabytes, other types under our names, times far off."""

import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mcap.writer
import numpy as np
import pytest
from log_helpers import EPOCH

from ahrs_sim import cli
from ahrs_sim.errors import InputError
from ahrs_sim.log import messages
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.cdr import CdrError, encode, parse_definitions
from ahrs_sim.log.mcap.reader import LogReader
from ahrs_sim.log.mcap.recover import recover


def written(
    path: Path,
    topics: Mapping[str, tuple[str, str, Mapping[str, Any]]],
    n: int = 50,
    times: Any = lambda k: (EPOCH + k * 10**7,) * 2,
) -> Path:
    """A log by the mcap package.

    Args:
        path: where.
        topics: type, definition (empty: ours) and values of each message, by topic.
        n: messages of each.
        times: log time and stamp of the k-th.
    """
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start(profile="ros2")
        for topic, (kind, definition, value) in topics.items():
            text = definition or messages.schema_text(kind)
            channel = writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", text.encode()))
            definitions = parse_definitions(kind, text)
            for k in range(n):
                at, stamp = times(k)
                plain = "std_msgs/Header header" in text and "Time stamp" in text
                header = {"header": {"stamp": stamp}} if plain else {}
                known = {f.name for f in definitions[kind.replace("/msg/", "/")]}
                payload, _ = encode(definitions, kind, {k: v for k, v in {**header, **value}.items() if k in known})
                writer.add_message(channel, at, payload, at)
        writer.finish()
    return path


TURNING = {"orientation": (1.0, 0, 0, 0), "angular_velocity": (0.1, 0, 0)}
TRUTH = {
    "/truth/imu": ("sensor_msgs/msg/Imu", "", TURNING),
    "/truth/state": ("ahrs_sim_msgs/msg/TruthState", "", {}),
    "/truth/air": ("ahrs_sim_msgs/msg/TruthAir", "", {}),
    "/est/a/state": ("ahrs_sim_msgs/msg/EstimatorState", "", {"orientation": (1.0, 0, 0, 0)}),
}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("uint8[2000000000] a", "bytes of fixed arrays"),
        ("T[1000] a\nMSG: p/T\nfloat64[1000] b", "bytes of fixed arrays"),
        ("uint8[-5] a", "is not understood"),
        (f"uint8[{'9' * 6000}] a", "is not understood"),
        ("T0 a\n" + "".join(f"MSG: p/T{k}\nT{k + 1} a\n" for k in range(5000)) + "MSG: p/T5000\nint8 a", "levels deep"),
        ("T0 a\n" + "".join(f"MSG: p/T{k}\nT{k + 1}[9] a\n" for k in range(20)) + "MSG: p/T20\nint8 a", "fields"),
        ("M a", "fields"),
    ],
    ids=["array", "arrays", "negative", "digits", "deep", "wide", "circle"],
)
def test_definitions_are_not_trusted(text: str, words: str) -> None:
    with pytest.raises(CdrError, match=words):
        parse_definitions("p/msg/M", text)


def test_many_types_take_their_time_once() -> None:
    n = 30_000
    text = "\n".join(f"T{k} a{k}" for k in range(n)) + "\n" + "".join(f"MSG: p/T{k}\nint8 a\n" for k in range(n))
    begun = time.process_time()
    assert len(parse_definitions("p/msg/M", text)) == n + 1
    assert time.process_time() - begun < 5.0


def commands(path: Path, out: Path) -> list[list[str]]:
    return [
        ["compare", str(path)],
        ["compare", str(path), "--lag"],
        ["compare", str(path), "--report", str(out / "r.html")],
        ["compare", str(path), "--reference", "a", "--sync", "--align", "frames"],
        ["export", str(path), "--to", "csv", "-o", str(out / "csv")],
        ["replay", str(path), "--estimator", "marg-ekf"],
        ["info", str(path)],
    ]


def replaced(topic: str, kind: str, definition: str = "", **value: Any) -> dict[str, Any]:
    return {**TRUTH, topic: (kind, definition, value)}


KIND, STATE = "ahrs_sim_msgs/msg/EstimatorState", messages.schema_text("ahrs_sim_msgs/msg/EstimatorState")
IMU = messages.schema_text("sensor_msgs/msg/Imu")


def imu(old: str, new: str) -> dict[str, Any]:
    assert old in IMU
    return replaced("/truth/imu", "sensor_msgs/msg/Imu", IMU.replace(old, new), **TURNING)


def state(old: str, new: str) -> dict[str, Any]:
    assert old in STATE
    return replaced("/est/a/state", KIND, STATE.replace(old, new, 1))


HOSTILE = {
    "another type": replaced("/truth/imu", "std_msgs/msg/X", "int8 data"),
    "a number as header": imu("std_msgs/Header header", "int32 header"),
    "a text as stamp": state("builtin_interfaces/Time stamp", "string stamp"),
    "a field renamed": imu("Quaternion orientation", "Quaternion q"),
    "a field of another shape": state("float32[12] innovation", "float32[3] innovation"),
    "an element renamed": imu("float64 w", "float64 v"),
    "an array of headers": imu("std_msgs/Header header", "std_msgs/Header[2] header"),
}


@pytest.mark.parametrize("how", HOSTILE)
def test_other_types_under_our_names_are_one_line(how: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path / "a.mcap", HOSTILE[how])
    for command in commands(path, tmp_path):
        code = cli.main(command)
        lines = capsys.readouterr().err
        assert code == 0 or (code == 2 and lines.count("\n") == 1), (command, lines)
    assert cli.main(["compare", str(path)]) == 2


def test_the_known_type_with_more_in_it_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path / "a.mcap", imu("float64[9] orientation_cov", "string comment\nfloat32[9] orientation_cov"))
    assert cli.main(["compare", str(path)]) == 0, capsys.readouterr()


@pytest.mark.parametrize("far", [(0, 3 * 10**17), (0, -EPOCH), (2**62, 0), (2**62, 3 * 10**17), (2**63, 0)])
def test_times_far_off_make_no_grids(far: tuple[int, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path / "a.mcap", TRUTH, times=lambda k: [EPOCH + k * 10**7 + (x if k == 49 else 0) for x in far])
    for command in commands(path, tmp_path):
        code = cli.main(command)
        lines = capsys.readouterr().err
        assert code == 0 or (code == 2 and lines.count("\n") == 1), (command, lines)
    code = cli.main(["compare", str(path), "--report", str(tmp_path / "r.html")])
    assert code == (2 if far[1] or far[0] > 2**62 else 0)  # stamps count, not when they were logged
    assert far[0] > 2**62 or not code or "days from the beginning of the log" in capsys.readouterr().err


def test_an_epoch_that_is_no_time_is_passed_over(tmp_path: Path) -> None:
    for stated in ("9" * 5000, "9" * 30, "-1", "x"):
        path = tmp_path / "a.mcap"
        with path.open("wb") as stream:
            writer = mcap.writer.Writer(stream)
            writer.start(profile="ros2")
            channel = writer.register_channel("/a", "cdr", writer.register_schema("p/msg/M", "ros2msg", b"int8 a"))
            writer.add_metadata("log", {"epoch_ns": stated})
            writer.add_message(channel, EPOCH, b"\0\1\0\0\1", EPOCH)
            writer.finish()
        with FlightReader(path) as log:
            assert log.epoch_ns == EPOCH


def test_a_recovery_follows_no_link(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", TRUTH)
    treasure = tmp_path / "treasure"
    treasure.write_text("mine")
    (tmp_path / "out.mcap.recovering").symlink_to(treasure)
    with pytest.raises(InputError, match="exists already"):
        recover(path, tmp_path / "out.mcap")
    recover(path, tmp_path / "out.mcap", force=True)
    assert treasure.read_text() == "mine"
    assert not (tmp_path / "out.mcap").is_symlink()
    with LogReader(tmp_path / "out.mcap") as log:
        assert log.message_count == 200


def test_cells_of_a_table_are_no_formulas(tmp_path: Path) -> None:
    bad = '=cmd|" /C calc"!A0'
    events = {"/events": ("ahrs_sim_msgs/msg/Event", "", {"level": "+1", "name": "@x", "text": bad})}
    path = written(tmp_path / "a.mcap", {**TRUTH, **events, "/est/=a,b/state": TRUTH["/est/a/state"]})
    assert cli.main(["export", str(path), "--to", "csv", "-o", str(tmp_path / "csv"), "--topic", "/events"]) == 0
    import csv

    rows = list(csv.reader((tmp_path / "csv" / "events.csv").read_text().splitlines()))
    assert rows[1][1:] == ["'+1", "'@x", f"'{bad}"]
    from ahrs_sim.review import compare

    table = list(csv.reader(compare.csv(compare.compare(path)).splitlines()))
    assert {len(row) for row in table} == {len(table[0])}
    assert {row[0] for row in table[1:]} == {"a", "'=a,b"}


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
def test_millions_of_tiny_messages_cost_what_their_bytes_cost(tmp_path: Path) -> None:
    n = 1_000_000
    record = np.zeros(n, [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
                          ("log_time", "<u8"), ("publish_time", "<u8"), ("data", "u1", 5)])  # fmt: skip
    record["opcode"], record["length"], record["channel"], record["log_time"] = 5, record.itemsize - 9, 1, EPOCH
    record["data"] = [0, 1, 0, 0, 7]
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream, index_types=mcap.writer.IndexType.NONE, use_chunking=False)
        writer.start(profile="ros2")
        writer.register_channel("/a", "cdr", writer.register_schema("p/msg/M", "ros2msg", b"int8 a"))
        writer.finish()
    content = path.read_bytes()
    at = content.index(b"\x0f\x04" + bytes(7))  # data end
    footer = b"\x02\x14" + bytes(27)
    path.write_bytes(content[:at] + record.tobytes() + content[at : at + 13] + footer + content[:8])
    code = (
        "import re, time; from pathlib import Path; from ahrs_sim import cli; begun = time.process_time();"
        f"code = cli.main(['info', {str(path)!r}]);"
        "peak = re.search(r'VmHWM:\\s+(\\d+)', Path('/proc/self/status').read_text());"
        "print(code, time.process_time() - begun, int(peak[1]) // 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=dict(os.environ))
    exit_code, seconds, megabytes = done.stdout.splitlines()[-1].split()
    assert exit_code == "0", done.stderr
    assert f"{n} messages" in done.stdout
    assert float(seconds) < 5.0
    assert float(megabytes) < 150.0
