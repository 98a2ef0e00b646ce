"""PX4 logs: the instance that the autopilot flew by, flags of validity, old messages, damage."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_helpers import EPOCH, LLA, Motion, motion
from ulog_helpers import HEADER, attitude, inertial, magnetometer, message, receiver, ulog, write

from ahrs_sim import playback
from ahrs_sim.errors import InputError
from ahrs_sim.recordings.recording import open_bag
from ahrs_sim.recordings.sources.ulog import Messages, Ulog
from ahrs_sim.sensors.assemble import Assembler
from estimators.types import Samples


@pytest.fixture(scope="module")
def moving() -> Motion:
    return motion(40.0, still=10.0)


def samples_of(path: Path) -> tuple[Samples, dict[str, str], list[str]]:
    with open_bag(path, map_file=None) as bag:
        chosen = {kind: choice.topic.name for kind, choice in bag.converter.chosen.items()}
        assembler = Assembler()
        return Samples.concatenate([assembler.assemble(block["bag"]) for block in bag.blocks()]), chosen, bag.notes


def test_the_receiver_that_the_autopilot_used(tmp_path: Path, moving: Motion) -> None:
    dead = receiver(moving, fix_type=0, latitude_deg=0.0, longitude_deg=0.0, vel_n_m_s=0.0, time_utc_usec=0)
    path = write(tmp_path / "a.ulg", inertial(moving), magnetometer(moving), magnetometer(moving, 1, 2.0), dead,
                 receiver(moving, instance=1, every=100), receiver(moving, "vehicle_gps_position"),
                 attitude(moving))  # fmt: skip
    s, chosen, notes = samples_of(path)
    assert chosen["fix"] == "vehicle_gps_position/fix"
    assert s.gnss_new.sum() == len(moving.t) // 20
    np.testing.assert_allclose(s.mag_b[s.mag_new], moving.mag_b[::2], atol=1e-11)
    assert any("also there: vehicle_magnetometer[1]" in note for note in notes)
    assert any("also there: sensor_gps[1]/fix, sensor_gps/fix" in note for note in notes)
    assert Ulog(path).epoch_ns == EPOCH
    path = write(tmp_path / "b.ulg", inertial(moving), dead, receiver(moving, instance=1), attitude(moving))
    assert samples_of(path)[1]["velocity"] == "sensor_gps[1]/velocity"


def test_messages_without_a_fix_are_counted(tmp_path: Path, moving: Motion) -> None:
    n = len(moving.t[::20])
    made = receiver(moving, fix_type=np.where(np.arange(n) < 30, 2, 3))
    with open_bag(write(tmp_path / "a.ulg", inertial(moving), made), map_file=None) as bag:
        assert list(bag.blocks())
        assert "fix: messages without a fix: 30" in bag.counted()


def test_a_heading_that_never_changes_is_none(tmp_path: Path, moving: Motion) -> None:
    """Receivers without a second antenna fill the field with 0."""
    for heading, chosen in ((0.0, False), (0.01 * np.arange(len(moving.t[::20])), True)):
        with open_bag(
            write(tmp_path / "a.ulg", inertial(moving), receiver(moving, heading=heading)), map_file=None
        ) as bag:
            assert ("heading" in bag.converter.chosen) == chosen
            assert ("sensor_gps/heading is no heading: its heading never changes" in bag.notes) != chosen


def test_without_a_fix_there_is_no_velocity(tmp_path: Path, moving: Motion) -> None:
    lost = (moving.t[::20] > 20) & (moving.t[::20] < 30)
    columns: dict[str, Any] = {k: np.where(lost, 0.0, v) for k, v in
                               {"latitude_deg": LLA[0], "vel_n_m_s": 1.0, "vel_d_m_s": 3.0}.items()}  # fmt: skip
    path = write(tmp_path / "a.ulg", inertial(moving), receiver(moving, fix_type=np.where(lost, 2, 3), **columns))
    s, _, _ = samples_of(path)
    seen = s.gnss_new & np.isfinite(s.vel_n).all(axis=1)
    assert seen.sum() == (~lost).sum()
    np.testing.assert_allclose(s.vel_n[seen], np.tile([1.0, 2.0, 3.0], (seen.sum(), 1)))


@pytest.mark.parametrize("relative", [True, False])
def test_the_field_of_old_logs_counts_once(tmp_path: Path, moving: Motion, relative: bool) -> None:
    held = np.repeat(moving.mag_b[::2], 2, axis=0)
    extra, columns = "magnetometer_ga:float[3]", {"magnetometer_ga": held * 1e4}
    shift = 0.0
    if relative:
        shift = 3000.0
        extra += " magnetometer_timestamp_relative:int32_t"
        columns["magnetometer_timestamp_relative"] = np.where(np.arange(len(moving.t)) % 2, 0x7FFFFFFF, -3000)
    moved = moving._replace(t=moving.t + 1.0)
    path = write(tmp_path / "a.ulg", inertial(moved, extra, **columns))
    source = Ulog(path)
    fields = np.concatenate([b["sensor_combined/mag"] for b in source.blocks(["sensor_combined/mag"])])
    changed = np.flatnonzero(np.r_[True, (np.diff(held[::2].astype("f4"), axis=0) != 0).any(axis=1)])
    assert len(fields) == len(changed)  # it stands at first
    np.testing.assert_allclose(fields["magnetic_field"]["x"], moving.mag_b[::2, 0][changed], atol=1e-11)
    np.testing.assert_allclose(fields["log_time"], np.rint(moved.t[::2][changed] * 1e9) - shift * 1e3, atol=1)


def test_dropouts_are_counted(tmp_path: Path, moving: Motion) -> None:
    path = write(tmp_path / "a.ulg", inertial(moving), dropouts=(25, 1000))
    assert "2 dropouts of the logger, 1.025 s in all" in Ulog(path).notes


def test_groundtruth_is_the_reference_and_ekf2_an_estimator(tmp_path: Path, moving: Motion) -> None:
    path = write(tmp_path / "a.ulg", inertial(moving), magnetometer(moving), attitude(moving),
                 attitude(moving, "vehicle_attitude_groundtruth"))  # fmt: skip
    playback.replay(path, tmp_path / "out.mcap", estimators=["hand-ins"], only_estimates=True)
    result = playback.accuracy(tmp_path / "out.mcap")
    assert result is not None
    assert list(result["estimators"]) == ["hand-ins", "ekf2"]
    assert result["estimators"]["ekf2"]["total_rmse_deg"] < 1e-3


def test_every_value_is_the_one_that_pyulog_reads(tmp_path: Path, moving: Motion) -> None:
    pyulog = pytest.importorskip("pyulog")
    # A message inside another, padding at the end that the logger leaves out, and one that nobody announced.
    formats = [b"inner:float x;uint8_t[2] n;", b"outer:uint64_t timestamp;inner[2] a;uint8_t k;uint8_t[3] _padding0;"]
    announced = message(b"A", struct.pack("<BH", 0, 99) + b"outer")
    nested = b"".join(message(b"F", text) for text in formats) + announced
    body = struct.pack("<HQfBBfBBB", 99, 5, 1.5, 1, 2, 2.5, 3, 4, 9)
    path = write(tmp_path / "a.ulg", inertial(moving), receiver(moving, instance=1), head=nested + message(b"D", body))
    theirs = pyulog.ULog(str(path))
    ours = Messages(path)
    for item in theirs.data_list:
        rows = dict(ours.instances(item.name))[item.multi_id]
        for name, values in item.data.items():
            place, _, index = name.partition("[")
            if place == "a":
                continue
            mine = rows[place] if not index else rows[place][:, int(index.rstrip("]"))]
            np.testing.assert_array_equal(mine, values)
    ((_, rows),) = ours.instances("outer")
    assert rows["a"]["x"].tolist() == [[1.5, 2.5]]
    assert rows["k"][0] == 9


def test_damage_costs_what_is_damaged(tmp_path: Path, moving: Motion) -> None:
    data = ulog([inertial(moving), magnetometer(moving)])
    middle = len(data) // 2
    (tmp_path / "hole.ulg").write_bytes(data[:middle] + bytes(range(256)) * 4 + data[middle + 1024 :])
    source = Ulog(tmp_path / "hole.ulg")
    assert any("belong to no message" in note for note in source.notes)
    counts = {t.name: t.count for t in source.topics()}
    assert len(moving.t) - 40 < counts["sensor_combined"] < len(moving.t)
    (tmp_path / "cut.ulg").write_bytes(data[: middle + 1])
    assert {t.name for t in Ulog(tmp_path / "cut.ulg").topics()} == {"sensor_combined", "vehicle_magnetometer"}
    for name, content in {"empty.ulg": b"", "head.ulg": HEADER, "text.ulg": b"abc" * 99}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            open_bag(tmp_path / name, map_file=None)


def test_data_appended_after_a_crash(tmp_path: Path, moving: Motion) -> None:
    flags = bytearray(40)
    flags[8] = 1
    first = ulog([inertial(moving)], head=message(b"B", bytes(flags)))
    struct.pack_into("<Q", flags, 16, len(first) - 10)  # the last message is cut off
    whole = ulog([inertial(moving)], head=message(b"B", bytes(flags)))[:-10]
    path = tmp_path / "a.ulg"
    path.write_bytes(whole + message(b"O", struct.pack("<H", 7)))
    log = Messages(path)
    assert log.dropouts == 1
    ((_, rows),) = log.instances("sensor_combined")
    assert len(rows) == len(moving.t) - 1
