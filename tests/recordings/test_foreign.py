"""ROS 1, JSON, protobuf and other schemas; one topic that cannot be read stops no other; times that are no dates."""

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_helpers import EPOCH, LLA, Motion, motion, ns, write_bag
from foreign_helpers import write_json, write_protobuf, write_ros1_bag, write_ros1_mcap
from mcap.writer import Writer

from ahrs_sim.errors import InputError
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.writer import LogWriter
from ahrs_sim.recordings.recording import open_bag
from ahrs_sim.recordings.sources import open_source
from ahrs_sim.scenario.table import Table
from ahrs_sim.sensors.assemble import Assembler
from ahrs_sim.world import magnetic
from estimators.types import Samples

FLU = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def moving() -> Motion:
    return motion(20.0, still=5.0)


def samples_of(path: Path, **options: Any) -> tuple[Samples, list[str]]:
    with open_bag(path, **{"map_file": None, **options}) as bag:
        assembler = Assembler()
        return Samples.concatenate([assembler.assemble(block["bag"]) for block in bag.blocks()]), bag.notes


def check(s: Samples, m: Motion) -> None:
    np.testing.assert_allclose(s.t, m.t, atol=1e-9)
    np.testing.assert_allclose(s.gyro_b, m.gyro_b, atol=1e-12)
    np.testing.assert_allclose(s.accel_b, m.accel_b, atol=1e-11)
    known = np.isfinite(s.lla[:, 0]) & s.gnss_new
    assert known.sum() == len(m.t) // 20
    np.testing.assert_allclose(np.degrees(s.lla[known, :2]), np.tile(LLA[:2], (known.sum(), 1)), atol=1e-9)


@pytest.mark.parametrize("form", ["json.mcap", "protobuf.mcap", "ros1.mcap", "ros1.bag"])
def test_standard_types_in_other_encodings(tmp_path: Path, moving: Motion, form: str) -> None:
    write = {"json.mcap": write_json, "protobuf.mcap": write_protobuf, "ros1.mcap": write_ros1_mcap,
             "ros1.bag": write_ros1_bag}[form]  # fmt: skip
    write(tmp_path / form, moving)
    s, notes = samples_of(tmp_path / form)
    check(s, moving)
    assert not any(note.startswith("check") and "measures heading" not in note for note in notes)
    if form == "json.mcap":
        assert any("not read: /log ('json' with 'jsonschema' schema, type foxglove.Log)" in note for note in notes)


def test_one_topic_that_cannot_be_read_stops_no_other(tmp_path: Path, moving: Motion) -> None:
    """Of a schema of another form, of two texts that differ in comments, of a type that nobody knows."""
    with LogWriter(tmp_path / "ours.mcap", epoch_ns=EPOCH) as log:
        channel = log.add_channel("/imu", "sensor_msgs/msg/Imu", frame_id="imu")
        log.start()
        log.write(channel, ns(moving.t), ns(moving.t), angular_velocity=moving.gyro_b @ FLU,
                  linear_acceleration=moving.accel_b @ FLU)  # fmt: skip
    from ahrs_sim.log.mcap.reader import LogReader

    text = messages.schema_text("sensor_msgs/msg/Imu")
    with LogReader(tmp_path / "ours.mcap") as log:
        blocks = log.raw_blocks(log.carried(["/imu"]))
        bodies = [row for _, found in blocks for batches in found.values() for rows in batches for row in rows]
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        first, second = (
            writer.register_channel("/imu", "cdr", writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", t.encode()))
            for t in (text, f"# another comment\n{text}")
        )
        idl = writer.register_schema("sensor_msgs/msg/Imu", "ros2idl", b"module sensor_msgs { ... }")
        third = writer.register_channel("/idl/imu", "cdr", idl)
        broken = writer.register_schema("own_msgs/msg/State", "ros2msg", b"unknown_msgs/Thing thing")
        other = writer.register_channel("/state", "cdr", broken)
        for i, (row, t) in enumerate(zip(bodies, ns(moving.t).tolist(), strict=True)):
            payload = row[31:].tobytes()
            writer.add_message(first if i % 2 else second, t, payload, t)
            writer.add_message(third, t, payload, t)
            writer.add_message(other, t, b"\x00\x01\x00\x00", t)
        writer.finish()
    source = open_source(tmp_path / "a.mcap", Table({}, ""))
    assert {t.name for t in source.topics()} == {"/imu", "/idl/imu"}
    assert ["not read: /state" in note and "unknown_msgs/Thing is missing" in note for note in source.notes] == [True]
    for topic in ("/imu", "/idl/imu"):
        turns = np.concatenate([b[topic]["angular_velocity"]["y"] for b in source.blocks([topic])])
        np.testing.assert_allclose(turns, -moving.gyro_b[:, 1], atol=1e-12)
    source.close()


def test_what_is_found_and_what_is_read_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    with pytest.raises(InputError, match=r"a.mat: not a recording known here; can be read: MCAP, ROS bags"):
        open_bag(tmp_path / "a.mat", map_file=None)
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(200))
    with pytest.raises(InputError, match=r"a.bag: no ROS 1 bag"):
        open_bag(tmp_path / "a.bag", map_file=None)


# ----------------------------------------------------------------------------------------------- dates


def declination(bag_notes: list[str]) -> float:
    return next(float(n.split("declination ")[1].split()[0]) for n in bag_notes if "declination" in n)


def shifted(m: Motion, path: Path, epoch: int, first: int = 0) -> None:
    """A bag whose clock starts at `epoch`; the first messages are at 0."""
    with LogWriter(path, epoch_ns=0) as log:
        imu = log.add_channel("/imu", "sensor_msgs/msg/Imu", frame_id="imu")
        fix = log.add_channel("/gps/fix", "sensor_msgs/msg/NavSatFix", frame_id="gps")
        log.start()
        t = epoch + np.rint(m.t * 1e9).astype(np.int64)
        t[:first] = 0
        log.write(imu, t, t, angular_velocity=m.gyro_b @ FLU, linear_acceleration=m.accel_b @ FLU)
        every = slice(None, None, 20)
        log.write(fix, t[every], t[every], latitude=np.full(len(t[every]), LLA[0]),
                  longitude=np.full(len(t[every]), LLA[1]), altitude=np.full(len(t[every]), LLA[2]))  # fmt: skip


def test_a_time_near_zero_is_no_date(tmp_path: Path, moving: Motion) -> None:
    shifted(moving, tmp_path / "a.mcap", 12 * 10**9)
    _, notes = samples_of(tmp_path / "a.mcap")
    assert any("the time starts at 12 s, which is no date: field of 2027.5 (--date" in note for note in notes)
    lla = np.array([[np.radians(LLA[0]), np.radians(LLA[1]), LLA[2]]])
    middle = magnetic.wmm(lla, 2027.5)[0]
    assert declination(notes) == pytest.approx(np.degrees(np.arctan2(middle[1], middle[0])), abs=0.01)
    date = datetime.datetime(2026, 6, 1, tzinfo=datetime.UTC)
    _, notes = samples_of(tmp_path / "a.mcap", date=date)
    then = magnetic.wmm(lla, magnetic.decimal_year(date))[0]
    assert declination(notes) == pytest.approx(np.degrees(np.arctan2(then[1], then[0])), abs=0.01)
    assert not any("no date" in note for note in notes)
    (tmp_path / "m.toml").write_text("[time]\ndate = 2026-06-01T00:00:00Z\n")
    assert declination(samples_of(tmp_path / "a.mcap", map_file=tmp_path / "m.toml")[1]) == declination(notes)


def test_messages_from_before_the_clock_was_set(tmp_path: Path, moving: Motion) -> None:
    shifted(moving, tmp_path / "a.mcap", EPOCH, first=150)
    s, notes = samples_of(tmp_path / "a.mcap")
    assert any("from before the recorder's clock was set" in note for note in notes)
    np.testing.assert_allclose(s.t, moving.t[150:] - 1.5, atol=1e-9)
    assert not any("no date" in note for note in notes)


def test_a_date_before_the_model_is_that_of_another(tmp_path: Path, moving: Motion) -> None:
    write_bag(tmp_path / "a.mcap", moving)
    date = datetime.datetime(2015, 1, 1, tzinfo=datetime.UTC)
    _, notes = samples_of(tmp_path / "a.mcap", date=date)
    assert any("2015.0 is before WMM2025: field by IGRF-14" in note for note in notes)
    _, notes = samples_of(tmp_path / "a.mcap", date=date.replace(year=2033))
    assert any("years after WMM2025: field extrapolated" in note for note in notes)
