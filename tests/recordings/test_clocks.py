"""Clocks that are set on the way, or never were: the same samples come out, and a line says what was wrong."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_helpers import EPOCH, Motion, motion, ns

from ahrs_sim.errors import InputError
from ahrs_sim.log.mcap.writer import LogWriter
from ahrs_sim.recordings.recording import Bag, open_bag
from ahrs_sim.sensors.assemble import Assembler
from estimators.types import Samples

STEP_AT = 20.0


@pytest.fixture(scope="module")
def moving() -> Motion:
    return motion(40.0, still=10.0)


def write(
    path: Path,
    m: Motion,
    *,
    log: Any = lambda t: t,
    header: Any = lambda t: t,
    of: tuple[str, ...] = ("imu", "mag", "vel"),
) -> None:
    """A bag whose log times and stamps (of some topics) are functions of the time; messages in the order of the log."""
    with LogWriter(path, epoch_ns=EPOCH, force=True) as writer:
        imu = writer.add_channel("/imu/data_raw", "sensor_msgs/msg/Imu", frame_id="x_frd")
        mag = writer.add_channel("/imu/mag", "sensor_msgs/msg/MagneticField", frame_id="x_frd")
        vel = writer.add_channel("/gps/vel", "geometry_msgs/msg/TwistStamped", frame_id="map_ned")
        writer.start()
        for name, channel, every, columns in (
            ("imu", imu, 1, {"angular_velocity": m.gyro_b, "linear_acceleration": m.accel_b}),
            ("mag", mag, 2, {"magnetic_field": m.mag_b}),
            ("vel", vel, 20, {"twist.linear": np.column_stack([m.t, 0 * m.t, 0 * m.t])}),
        ):
            t = m.t[::every]
            arrival, stamp = np.asarray(log(t)), np.asarray(header(t) if name in of else t)
            stamps = np.where(np.isnan(stamp), 0, ns(np.nan_to_num(stamp)))
            order = np.argsort(ns(arrival), kind="stable")
            writer.write(
                channel, ns(arrival)[order], stamps[order], **{k: v[::every][order] for k, v in columns.items()}
            )


def read(path: Path, **options: Any) -> tuple[Samples, list[str], Bag]:
    with open_bag(path, map_file=None, **options) as bag:
        assembler = Assembler()
        samples = Samples.concatenate([assembler.assemble(block["bag"]) for block in bag.blocks()])
        return samples, [n for n in bag.notes if n.startswith("check:") and "reads" not in n] + bag.counted(), bag


def check(s: Samples, m: Motion, atol: float = 1e-6) -> None:
    """Every sample is the motion's; what the receiver says belongs to its time."""
    np.testing.assert_allclose(s.t - s.t[0], m.t - m.t[0], atol=atol)
    np.testing.assert_allclose(s.gyro_b, m.gyro_b, atol=1e-9)
    assert s.mag_new.sum() == len(m.t[::2])
    seen = s.gnss_new
    np.testing.assert_allclose(s.gnss_t[seen] - s.t[0], s.vel_n[seen][:, 0] - m.t[0], atol=max(atol, 1e-6))
    assert seen.sum() >= len(m.t[::20]) - 1


def late(t: np.ndarray) -> np.ndarray:
    """The link's latency and its jitter, for log times."""
    return t + 0.004 + 0.002 * np.sin(1e3 * t)


def set_by(size: float, at: float = STEP_AT) -> Any:
    return lambda t: t + np.where(t >= at, size, 0.0)


@pytest.mark.parametrize("size", [3600.2, -30.5, 2.0, 1e8])
def test_a_board_whose_clock_is_set_on_the_way(tmp_path: Path, moving: Motion, size: float) -> None:
    write(tmp_path / "a.mcap", moving, log=late, header=set_by(size))
    s, notes, _ = read(tmp_path / "a.mcap")
    check(s, moving)
    (line,) = notes
    assert f"header stamps of imu, mag, velocity step by {size:+.3f} s at 20.0 s: taken back" in line


def test_a_board_that_gets_the_time_on_the_way(tmp_path: Path, moving: Motion) -> None:
    """From the seconds since its boot to those of the calendar: the latter are right."""
    boot = -EPOCH / 1e9 + 100.0
    write(tmp_path / "a.mcap", moving, log=late, header=lambda t: t + np.where(t < STEP_AT, boot, 0.0))
    s, notes, bag = read(tmp_path / "a.mcap")
    check(s, moving, 1e-5)
    assert len(notes) == 1
    assert f"step by {-boot:+.3f} s at 20.0 s" in notes[0]
    assert not any("another clock" in note for note in bag.notes)


def test_a_receiver_that_learns_the_leap_seconds(tmp_path: Path, moving: Motion) -> None:
    write(tmp_path / "a.mcap", moving, log=late, header=lambda t: t + np.where(t < STEP_AT, 3.0, 0.0), of=("vel",))
    s, notes, _ = read(tmp_path / "a.mcap")
    check(s, moving)
    assert len(notes) == 1
    assert "header stamps of velocity step by -3.000 s at 20.0 s" in notes[0]


@pytest.mark.parametrize("size", [25.0, 7200.0, -2.0, -15.0])
def test_a_recorder_whose_clock_is_set_on_the_way(tmp_path: Path, moving: Motion, size: float) -> None:
    write(tmp_path / "a.mcap", moving, log=lambda t: set_by(size)(late(t)))
    s, notes, bag = read(tmp_path / "a.mcap")
    check(s, moving)
    assert re.match(r"imu +/imu/data_raw  (99\.9|100\.\d) Hz", bag.notes[0])
    (line,) = notes
    if size > 0:
        assert re.search(rf"log's times of imu, mag, velocity step by \+{size:.0f}\.00[01] s at 20\.0 s", line)
    else:
        assert f"the recorder's clock was set back by {-size:.1f} s: messages are put in the order" in line


def test_both_clocks_set_back_are_refused(tmp_path: Path, moving: Motion) -> None:
    """Headers come from the recorder's own clock: what was measured twice has the same stamps."""
    back = set_by(-8.3)
    write(tmp_path / "a.mcap", moving, log=lambda t: back(t) + 0.001, header=back)
    with pytest.raises(
        InputError, match=r"the clock goes back by \d+ s: from 1\d to 21 s .*--until 1\d or --skip 21"
    ) as e:
        read(tmp_path / "a.mcap")
    until = float(str(e.value).split("--until ")[1].split()[0])
    s, _, _ = read(tmp_path / "a.mcap", span=(0.0, until))
    np.testing.assert_allclose(s.gyro_b, moving.gyro_b[: len(s)], atol=1e-9)


@pytest.mark.parametrize("zeros_s", [0.5, 15.0])
def test_stamps_of_zero_before_the_clock_came(tmp_path: Path, moving: Motion, zeros_s: float) -> None:
    write(tmp_path / "a.mcap", moving, log=late, header=lambda t: np.where(t < zeros_s, np.nan, t))
    s, notes, _ = read(tmp_path / "a.mcap")
    check(s, moving._replace(**{f: getattr(moving, f)[moving.t >= zeros_s] for f in moving._fields}))
    assert "imu: without a stamp, left out: " + str(round(zeros_s * 100)) in notes
    assert not any(line.startswith("check:") for line in notes)


def test_simulation_time(tmp_path: Path, moving: Motion) -> None:
    """A simulator at 40 % of real time: its stamps are right, the log's times are not; zeros before it began."""
    started = 5.0 - EPOCH / 1e9

    def sim(t: np.ndarray) -> np.ndarray:
        return np.where(t < 1.0, np.nan, t + started)

    write(tmp_path / "a.mcap", moving, log=lambda t: 2.5 * t, header=sim)
    s, _, bag = read(tmp_path / "a.mcap")
    assert any("header stamps run at 0.40 of the log's clock" in note for note in bag.notes)
    rows = moving.t >= 1.0
    np.testing.assert_allclose(s.t - s.t[0], moving.t[rows] - moving.t[rows][0], atol=1e-5)
    np.testing.assert_allclose(s.gyro_b, moving.gyro_b[rows], atol=1e-9)
    seen = s.gnss_new & (s.vel_n[:, 0] > 1.5)
    np.testing.assert_allclose(s.gnss_t[seen] - s.t[0], s.vel_n[seen][:, 0] - 1.0, atol=1e-5)


def bursts(t: np.ndarray) -> np.ndarray:
    """Messages that come thirty at a time."""
    return np.ceil(t / 0.3) * 0.3


def stalls(t: np.ndarray) -> np.ndarray:
    """A recorder that twice writes nothing for some seconds, then all that has waited."""
    t = np.where((t > 12.0) & (t < 18.0), 17.9 + (t - 12.0) / 60.0, t)
    return np.where((t > 30.0) & (t < 32.5), 32.4 + (t - 30.0) / 25.0, t)


@pytest.mark.parametrize("link", [late, bursts, stalls, lambda t: t * (1 + 1e-4) + 0.5])
def test_silent_on_jitter_bursts_stalls_and_drift(tmp_path: Path, moving: Motion, link: Any) -> None:
    write(tmp_path / "a.mcap", moving, log=link)
    s, notes, _ = read(tmp_path / "a.mcap")
    check(s, moving)
    assert notes == []


def test_jitter_of_the_stamps_is_no_gap(tmp_path: Path, moving: Motion) -> None:
    """Stamped as they come, thirty at a time within a millisecond, or by a scheduler: nothing is missing."""
    rng = np.random.default_rng(2)
    jitter = np.sort(moving.t + rng.uniform(0.0, 0.018, len(moving.t)))
    k = np.arange(len(moving.t))
    together = np.ceil((k + 1) / 3) * 0.03 + 0.0004 * (k % 3)
    for stamp in (jitter, together):
        write(tmp_path / "a.mcap", moving, log=lambda t, s=stamp: np.interp(t, moving.t, s) + 0.001,
              header=lambda t, s=stamp: np.interp(t, moving.t, s))  # fmt: skip
        s, notes, _ = read(tmp_path / "a.mcap")
        assert notes == []
        assert len(s) == len(moving.t)


@pytest.mark.parametrize(
    "stamp",
    [
        np.floor,  # whole seconds
        lambda t: np.floor(t * 50.0 + 1e-6) / 50.0,  # two messages with one stamp
        lambda t: np.floor(t) + (t - np.floor(t)) * 1e-3,  # microseconds where nanoseconds belong
    ],
)
def test_stamps_that_repeat_or_stand_still_are_none(tmp_path: Path, moving: Motion, stamp: Any) -> None:
    write(tmp_path / "a.mcap", moving, header=stamp, of=("imu",))
    s, said, _ = read(tmp_path / "a.mcap")
    check(s, moving)
    assert said == ["check: header stamps of imu repeat or stand still: times of the log are used ([time] stamps)"]
    write(tmp_path / "a.mcap", moving, header=stamp)
    assert len(read(tmp_path / "a.mcap")[0]) == len(moving.t)
