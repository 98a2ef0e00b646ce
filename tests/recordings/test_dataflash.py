"""ArduPilot logs: fields in their units, the right instance, whatever a damaged file still has."""

from pathlib import Path

import numpy as np
import pytest
from bag_helpers import EPOCH, LLA, Motion, motion
from dataflash_helpers import MESSAGES, assembled, rows, write_dataflash

from ahrs_sim import playback
from ahrs_sim.errors import InputError
from ahrs_sim.recordings.recording import open_bag
from ahrs_sim.recordings.sources.base import from_gps
from ahrs_sim.recordings.sources.dataflash import DataFlash, Messages
from ahrs_sim.sensors.assemble import Assembler
from estimators.types import Samples


@pytest.fixture(scope="module")
def moving() -> Motion:
    return motion(40.0, still=10.0)


def samples_of(path: Path) -> tuple[Samples, list[str]]:
    with open_bag(path, map_file=None) as bag:
        assembler = Assembler()
        return Samples.concatenate([assembler.assemble(block["bag"]) for block in bag.blocks()]), bag.notes


@pytest.mark.parametrize("units", [True, False])
def test_units_axes_and_the_receiver_that_has_fixes(tmp_path: Path, moving: Motion, units: bool) -> None:
    write_dataflash(tmp_path / "a.bin", moving, units=units)
    s, notes = samples_of(tmp_path / "a.bin")
    np.testing.assert_allclose(s.t, moving.t, atol=1e-9)
    np.testing.assert_allclose(s.gyro_b, moving.gyro_b, atol=1e-6)
    np.testing.assert_allclose(s.accel_b, moving.accel_b, atol=1e-5)
    np.testing.assert_allclose(s.mag_b[s.mag_new], moving.mag_b[::2], atol=0.51e-7)  # whole mGauss
    good = s.gnss_new
    assert good.sum() == len(moving.t) // 20
    np.testing.assert_allclose(np.degrees(s.lla[good, :2]), np.tile(LLA[:2], (good.sum(), 1)), atol=1e-7)
    np.testing.assert_allclose(s.vel_n[good], np.tile([1.0, 2.0, 3.0], (good.sum(), 1)), atol=1e-6)
    assert s.airspeed[-1] == pytest.approx(20.0 * np.sqrt(1.225 / (99000.0 / (287.05 * 286.9))), rel=2e-3)
    assert any(note.startswith("imu             IMU  100.0 Hz") and "also there: IMU[1]" in note for note in notes)
    assert any(note.startswith("fix             GPS[1]/fix") and "GPS/fix" in note for note in notes)
    assert not any(note.startswith("check") for note in notes)


def test_the_date_is_that_of_the_receiver(tmp_path: Path, moving: Motion) -> None:
    write_dataflash(tmp_path / "a.bin", moving)
    assert DataFlash(tmp_path / "a.bin").epoch_ns == pytest.approx(EPOCH, abs=2_000_000)
    # 2016-12-31 23:59:59 UTC, 17 leap seconds, then the first second of 2017 with 18
    before, after = from_gps(np.array([1930, 1930]), np.array([16.0, 18.0]))
    assert before == 1483228799 * 10**9
    assert after == 1483228800 * 10**9


def test_names_before_there_were_instances(tmp_path: Path, moving: Motion) -> None:
    old = {k: (n, f.replace("QB", "Q", 1), c.replace("TimeUS,I,", "TimeUS,"), "", "")
           for k, (n, f, c, *_) in MESSAGES.items() if k == "IMU"}  # fmt: skip
    old["IMU2"] = (20, *old["IMU"][1:])
    columns = dict(zip(("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
                       np.column_stack([moving.gyro_b, moving.accel_b]).T, strict=True))  # fmt: skip
    us = moving.t * 1e6
    groups = [rows(k, old, TimeUS=us, **columns) for k in ("IMU", "IMU2")]
    (tmp_path / "a.bin").write_bytes(assembled(old, groups, units=False))
    source = DataFlash(tmp_path / "a.bin")
    assert [t.name for t in source.topics()] == ["IMU", "IMU2"]
    block = next(source.blocks(["IMU2"]))["IMU2"]
    np.testing.assert_allclose(block["angular_velocity"]["x"], moving.gyro_b[: len(block), 0], atol=1e-6)


def test_logs_of_milliseconds_have_the_clock_of_the_receiver_beside_their_own(tmp_path: Path, moving: Motion) -> None:
    """Copter 3.2 and before: `TimeMS` of GPS is the receiver's time of the week, `T` that of the board."""
    old = {
        "IMU": (10, "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "", ""),
        "GPS": (12, "BIHBcLLeeEefI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T", "", ""),
    }
    board, slow = np.rint(moving.t * 1e3) + 5000, slice(None, None, 20)
    seconds = EPOCH // 10**9 + moving.t[slow] - 315964800 + 18.0
    columns = dict(zip(("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
                       np.column_stack([moving.gyro_b, moving.accel_b]).T, strict=True))  # fmt: skip
    groups = [
        rows("IMU", old, at=moving.t, TimeMS=board, **columns),
        rows("GPS", old, at=moving.t[slow], Status=3, TimeMS=np.mod(seconds, 604800) * 1e3, Week=seconds // 604800,
             Lat=LLA[0] * 1e7, Lng=LLA[1] * 1e7, Alt=LLA[2] * 100, Spd=500, GCrs=9000, VZ=-2.0, T=board[slow] + 150),
    ]  # fmt: skip
    (tmp_path / "a.bin").write_bytes(assembled(old, groups, units=False))
    source = DataFlash(tmp_path / "a.bin")
    assert source.epoch_ns == pytest.approx(EPOCH - 150_000_000, abs=2_000_000)
    assert source.duration == pytest.approx(moving.t[-1], abs=0.2)
    block = next(source.blocks(["IMU", "GPS/velocity"]))
    late = block["GPS/velocity"]["log_time"][0] - block["IMU"]["log_time"][0]
    assert late == 150_000_000
    velocity = block["GPS/velocity"]["twist"]["linear"][0]
    assert [velocity[a] for a in "xyz"] == pytest.approx([0.0, 5.0, -2.0], abs=1e-9)


def test_raw_samples_are_pointed_to_and_read(tmp_path: Path, moving: Motion) -> None:
    raw = {
        "IMU": MESSAGES["IMU"],
        "ACC": (20, "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ", "s#sooo", "F-F000"),
        "GYR": (21, "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ", "s#sEEE", "F-F000"),
    }
    us, slow = np.rint(moving.t * 1e6) + 5e6, slice(None, None, 4)
    gyro = dict(zip(("GyrX", "GyrY", "GyrZ"), moving.gyro_b.T, strict=True))
    accel = dict(zip(("AccX", "AccY", "AccZ"), moving.accel_b.T, strict=True))
    groups = [
        rows("IMU", raw, TimeUS=us[slow], **{k: v[slow] for k, v in (gyro | accel).items()}),
        rows("GYR", raw, TimeUS=us + 900, SampleUS=us, **gyro),
        rows("ACC", raw, TimeUS=us + 900, SampleUS=us, **accel),
    ]
    (tmp_path / "a.bin").write_bytes(assembled(raw, groups))
    s, notes = samples_of(tmp_path / "a.bin")
    assert len(s) == len(moving.t[slow])
    assert 'GYR and ACC have 4 times the rate of IMU: [topics] imu = "GYR", accel = "ACC"' in notes
    (tmp_path / "map.toml").write_text('[topics]\nimu = "GYR"\naccel = "ACC"\n')
    with open_bag(tmp_path / "a.bin", map_file=tmp_path / "map.toml") as bag:
        assembler = Assembler()
        s = Samples.concatenate([assembler.assemble(block["bag"]) for block in bag.blocks()])
    np.testing.assert_allclose(s.t, moving.t, atol=1e-9)
    np.testing.assert_allclose(s.gyro_b, moving.gyro_b, atol=1e-6)
    np.testing.assert_allclose(s.accel_b, moving.accel_b, atol=1e-5)


def test_what_two_starts_of_the_board_wrote_does_not_meet(tmp_path: Path, moving: Motion) -> None:
    """The longer one has no fixes: those of the other, whose clock runs through the same times, are not its own."""
    columns = dict(zip(("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
                       np.column_stack([moving.gyro_b, moving.accel_b]).T, strict=True))  # fmt: skip
    first = assembled(MESSAGES, [rows("IMU", MESSAGES, TimeUS=np.rint(moving.t * 1e6) + 5e6, **columns)])
    write_dataflash(tmp_path / "b.bin", motion(20.0, still=5.0), second=False)
    second = (tmp_path / "b.bin").read_bytes()
    for order in (first + second, second + first):
        (tmp_path / "a.bin").write_bytes(order)
        source = DataFlash(tmp_path / "a.bin")
        assert [t.name for t in source.topics()] == ["IMU"]
        assert source.topics()[0].count == len(moving.t)
        assert any("begins anew: of the 2 parts the longest is used, " in note for note in source.notes)
    assert not any("anew" in note for note in DataFlash(tmp_path / "b.bin").notes)


def test_a_cut_or_damaged_log_is_read_up_to_there_and_behind(tmp_path: Path, moving: Motion) -> None:
    write_dataflash(tmp_path / "a.bin", moving)
    data = (tmp_path / "a.bin").read_bytes()
    whole = Messages(tmp_path / "a.bin")
    (tmp_path / "cut.bin").write_bytes(data[: len(data) * 2 // 3 + 1])
    cut = Messages(tmp_path / "cut.bin")
    assert 0.6 * whole.count < cut.count < 0.7 * whole.count
    assert cut.lost < 64
    middle = len(data) // 2
    (tmp_path / "hole.bin").write_bytes(data[:middle] + bytes(range(256)) * 4 + data[middle + 1024 :])
    hole = Messages(tmp_path / "hole.bin")
    assert whole.count - 80 < hole.count < whole.count - 10
    assert 1024 <= hole.lost < 1024 + 3 * 64
    assert any("belong to no message" in note for note in DataFlash(tmp_path / "hole.bin").notes)
    s, _ = samples_of(tmp_path / "hole.bin")
    assert len(s) > 0.99 * len(moving.t)
    for name, content in {
        "none.bin": b"\xa3\x95\x80" + bytes(200),
        "short.bin": data[:5],
        "text.bin": b"abc" * 99,
    }.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            open_bag(tmp_path / name, map_file=None)


def test_every_value_is_the_one_that_pymavlink_reads(tmp_path: Path, moving: Motion) -> None:
    mavutil = pytest.importorskip("pymavlink.mavutil")
    write_dataflash(tmp_path / "a.bin", moving)
    ours = Messages(tmp_path / "a.bin")
    theirs = mavutil.mavlink_connection(str(tmp_path / "a.bin"))
    found: dict[str, list[dict]] = {}
    while (message := theirs.recv_match()) is not None:
        found.setdefault(message.get_type(), []).append(message.to_dict())
    assert len(found["IMU"]) == 2 * len(moving.t)
    for name in MESSAGES:
        mine = ours.raw(name)
        assert len(mine) == len(found[name])
        _, form, columns, *_ = MESSAGES[name]
        for letter, column in zip(form, columns.split(","), strict=True):
            scale = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}.get(letter, 1.0)
            np.testing.assert_allclose(mine[column] * scale, [m[column] for m in found[name]], rtol=1e-12)


def test_the_attitudes_of_the_autopilot_are_estimators(tmp_path: Path, moving: Motion) -> None:
    write_dataflash(tmp_path / "a.bin", moving)
    lines = playback.replay(tmp_path / "a.bin", tmp_path / "out.mcap", estimators=["hand-ins"], only_estimates=True)
    assert any(line.startswith("reference       ATT") for line in lines)
    result = playback.accuracy(tmp_path / "out.mcap")
    assert result is not None
    assert list(result["estimators"]) == ["hand-ins", "ekf3"]
    assert result["estimators"]["ekf3"]["total_rmse_deg"] < 1e-6
    playback.replay(tmp_path / "a.bin", tmp_path / "b.mcap", estimators=["hand-ins"], reference="XKF1")
    result = playback.accuracy(tmp_path / "b.mcap")
    assert result is not None
    assert list(result["estimators"]) == ["hand-ins", "ahrs"]
    with pytest.raises(InputError, match="no topic 'XKF2'"):
        playback.replay(tmp_path / "a.bin", tmp_path / "c.mcap", reference="XKF2")
