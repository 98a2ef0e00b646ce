"""Recordings of others: whatever their axes, units and stamps, the same samples come out; what is wrong is named."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_helpers import EPOCH, LLA, MAG_N, Motion, motion, ns, write_bag, write_ulog
from mcap.writer import Writer

from ahrs_sim import attitude
from ahrs_sim.errors import InputError
from ahrs_sim.evaluation.sync import constant_rotations, heading_offset, rates, time_shift
from ahrs_sim.log.mcap.writer import LogWriter
from ahrs_sim.recordings import calibration
from ahrs_sim.recordings.recording import Bag, open_bag
from ahrs_sim.sensors.assemble import Assembler
from estimators.types import Samples


@pytest.fixture(scope="module")
def moving() -> Motion:
    return motion(40.0, still=10.0)


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Close what `opened` has opened."""
    yield
    while _OPEN:
        _OPEN.pop().source.close()


_OPEN: list[Bag] = []


def opened(path: Path, text: str | None = "", **options: Any) -> Bag:
    map_file = path.with_suffix(".map.toml")
    if text is not None:
        map_file.write_text(text)
    _OPEN.append(open_bag(path, map_file=map_file if text is not None else None, **options))
    return _OPEN[-1]


def samples_of(bag: Bag) -> Samples:
    assembler = Assembler()
    return Samples.concatenate([assembler.assemble(block["bag"]) for block in bag.blocks()])


def check_samples(s: Samples, m: Motion, atol: float = 1e-12) -> None:
    """Every sample is the motion's, in our axes."""
    np.testing.assert_allclose(s.t, m.t, atol=1e-9)
    np.testing.assert_allclose(s.gyro_b, m.gyro_b, atol=atol)
    np.testing.assert_allclose(s.accel_b, m.accel_b, atol=10 * atol)
    seen = np.flatnonzero(s.mag_new)
    assert len(seen) == len(m.t) // 2
    np.testing.assert_allclose(s.mag_b[seen], m.mag_b[::2], atol=1e-4 * atol + 1e-17)


@pytest.mark.parametrize(("body", "world"), [("FLU", "ENU"), ("FRD", "NED")])
def test_axes_of_either_kind_give_the_same_samples(tmp_path: Path, moving: Motion, body: str, world: str) -> None:
    write_bag(tmp_path / "a.mcap", moving, body=body, world=world)
    bag = opened(tmp_path / "a.mcap", f'[frames]\nbody = "{body}"\nworld = "{world}"')
    assert not any(note.startswith("check") for note in bag.notes)
    s = samples_of(bag)
    check_samples(s, moving)
    good = s.gnss_new  # position and velocity arrive together, with the row after the velocity
    assert good.sum() == len(moving.t) // 20
    np.testing.assert_allclose(s.vel_n[good], np.tile([1.0, 2.0, 3.0], (good.sum(), 1)), atol=1e-12)
    np.testing.assert_allclose(np.degrees(s.lla[good][:, :2]), np.tile(LLA[:2], (good.sum(), 1)), atol=1e-12)
    assert s.gnss_t[good] == pytest.approx(
        moving.t[::20][: good.sum()]
    )  # the velocity, 0.3 ms later, is of the same instant
    # 0.5 rho0 V^2 at sea level, corrected for the density at 990 hPa
    assert s.airspeed[-1] == pytest.approx(20.0 * np.sqrt(1.225 / (99000.0 / (287.05 * 286.9))), rel=2e-3)
    again = opened(tmp_path / "a.mcap", f'[frames]\nbody = "{body}"\nworld = "{world}"')
    reference = np.concatenate([b["bag"]["reference"].q_nb for b in again.blocks()])  # type: ignore[attr-defined]
    assert np.abs(np.abs(np.sum(reference * moving.q_nb, axis=1)) - 1).max() < 1e-12


def test_what_was_chosen_is_said(tmp_path: Path, moving: Motion) -> None:
    write_bag(tmp_path / "a.mcap", moving)
    bag = opened(tmp_path / "a.mcap")
    chosen = {kind: choice.topic.name for kind, choice in bag.converter.chosen.items()}
    assert chosen == {
        "imu": "/imu/data_raw", "mag": "/imu/mag", "fix": "/gps/fix", "velocity": "/gps/vel",
        "diff_pressure": "/air/a", "static_pressure": "/air/b", "reference": "/truth/odom",
    }  # fmt: skip
    assert any("/imu/data_raw  100.0 Hz  FLU" in note for note in bag.notes)
    assert bag.site.lla == pytest.approx((np.radians(LLA[0]), np.radians(LLA[1]), LLA[2]))
    assert np.linalg.norm(bag.site.mag_n) == pytest.approx(4.63e-5, rel=0.03)  # Toulouse, 2026
    assert bag.sensors.rate == pytest.approx(100.0, rel=1e-3)


def write_imus(path: Path, m: Motion, **topics: dict[str, Any]) -> None:
    """A bag with Imu topics of any contents: constants of the channel, and columns, by topic; and a pose at 50 Hz."""
    with LogWriter(path, epoch_ns=EPOCH, force=True) as log:
        channels = {
            name: log.add_channel(
                f"/{name}/imu", "sensor_msgs/msg/Imu", frame_id="x_frd", constant=c.pop("constant", {})
            )
            for name, c in topics.items()
        }
        pose = log.add_channel("/pose", "nav_msgs/msg/Odometry",
                               constant={"header": {"frame_id": "map_ned"}, "child_frame_id": "x_frd"})  # fmt: skip
        log.start()
        for name, columns in topics.items():
            log.write(channels[name], ns(m.t), ns(m.t), **columns)
        log.write(pose, ns(m.t[::2]), ns(m.t[::2]), **{"pose.pose.orientation": m.q_nb[::2]})


ABSENT = np.r_[-1.0, np.zeros(8)]


def test_a_placeholder_is_neither_imu_nor_reference(tmp_path: Path, moving: Motion) -> None:
    """More messages, a better name, unit quaternions: what never changes or says that it is absent is not taken."""
    rates, forces = {"angular_velocity": moving.gyro_b}, {"linear_acceleration": moving.accel_b}
    unit = {"orientation": np.tile([1.0, 0.0, 0.0, 0.0], (len(moving.t), 1))}
    signs = np.where(np.arange(len(moving.t)) % 3, 1.0, -1.0)[:, None] * (1.0 + 1e-9 * moving.t[:, None])
    write_imus(
        tmp_path / "a.mcap", moving,
        a_raw_zeros=unit | {"angular_velocity": np.zeros((len(moving.t), 3))},
        b_raw_rates={**rates, **forces, "constant": {"linear_acceleration_covariance": ABSENT}},
        c_truth={**rates, **forces, "orientation": signs * unit["orientation"]},
    )  # fmt: skip
    bag = opened(tmp_path / "a.mcap")
    assert bag.converter.chosen["imu"].topic.name == "/c_truth/imu"
    assert bag.converter.chosen["reference"].topic.name == "/pose"
    for line in (
        "/a_raw_zeros/imu is no imu: its rates never change",
        "/b_raw_rates/imu is no imu: it has no forces (covariance -1)",
        "/c_truth/imu is no reference: its orientation never changes",
    ):
        assert line in bag.notes
    np.testing.assert_allclose(samples_of(bag).accel_b, moving.accel_b, atol=1e-11)
    write_imus(tmp_path / "b.mcap", moving, a=unit)
    with pytest.raises(InputError, match=r"no IMU in it .*its rates never change"):
        opened(tmp_path / "b.mcap")


@pytest.mark.parametrize(
    ("kind", "changes", "why"),
    [
        ("mag", {"mag_b": 0.0}, "/imu/mag is no mag: its field never changes"),
        ("mag", {"mag_b": 2e-5}, "/imu/mag is no mag: its field never changes"),
        ("velocity", {}, "/gps/vel is no velocity: its velocity never changes from 0"),
    ],
)
def test_a_placeholder_is_no_aid(tmp_path: Path, moving: Motion, kind: str, changes: dict[str, Any], why: str) -> None:
    m = moving._replace(**{name: np.full((len(moving.t), 3), value) for name, value in changes.items()})
    write_bag(tmp_path / "a.mcap", m, velocity=(1.0, 2.0, 3.0) if changes else (0.0, 0.0, 0.0))
    bag = opened(tmp_path / "a.mcap", None)
    assert kind not in bag.converter.chosen
    assert why in bag.notes
    assert not any("nan" in note for note in bag.notes)
    write_bag(tmp_path / "a.mcap", moving, velocity=(0.0, 3.0, 0.0))
    assert {"mag", "velocity"} <= set(opened(tmp_path / "a.mcap", None).converter.chosen)


def test_fields_of_zeros_before_the_first_are_none(tmp_path: Path, moving: Motion) -> None:
    late = moving._replace(mag_b=np.where(moving.t[:, None] < 5.0, 0.0, moving.mag_b))
    write_bag(tmp_path / "a.mcap", late)
    bag = opened(tmp_path / "a.mcap", None)
    s = samples_of(bag)
    assert np.isnan(s.mag_b[s.mag_new & (s.t < 5.0)]).all()
    np.testing.assert_allclose(s.mag_b[s.mag_new & (s.t >= 5.0)], moving.mag_b[500::2], atol=1e-15)
    assert "mag: without a field: 250" in bag.counted()


@pytest.mark.parametrize("shift", [0.0, 0.25])
def test_a_reference_that_stays_while_the_gyro_turns_is_left_out(tmp_path: Path, moving: Motion, shift: float) -> None:
    """Tracking lost: the last pose is sent on. A vehicle that stands has a reference that stays, too."""
    lost = (moving.t > 20.0) & (moving.t <= 26.0)
    held = moving._replace(q_nb=np.where(lost[:, None], moving.q_nb[2000], moving.q_nb))
    text = f"[time]\nreference_s = {shift}\n"
    write_bag(tmp_path / "a.mcap", held, reference_delay=-shift)
    bag = opened(tmp_path / "a.mcap", text)
    assert any("the very same for 6.0 s while the gyro turns" in note and "20.0 s on" in note for note in bag.notes)
    assert not any(note.startswith("check") for note in bag.notes)
    t = np.concatenate([block["bag"]["reference"].stamp_ns for block in bag.blocks()]) / 1e9
    assert not ((t > 19.999) & (t < 26.001)).any()
    assert len(t) == len(moving.t) - 601
    write_bag(tmp_path / "b.mcap", moving)
    assert not any("the very same" in note for note in opened(tmp_path / "b.mcap", None).notes)


def test_rates_and_forces_in_turn(tmp_path: Path, moving: Motion) -> None:
    gyro, accel = moving.gyro_b.copy(), moving.accel_b.copy()
    gyro[::2], accel[1::2] = 0.0, 0.0
    write_imus(tmp_path / "a.mcap", moving, a={"angular_velocity": gyro, "linear_acceleration": accel})
    bag = opened(tmp_path / "a.mcap")
    s = samples_of(bag)
    turning = s.t > 12.0
    np.testing.assert_allclose(s.t[turning], moving.t[1::2][moving.t[1::2] > 12.0], atol=1e-9)
    np.testing.assert_allclose(s.gyro_b[turning], moving.gyro_b[1::2][moving.t[1::2] > 12.0], atol=1e-12)
    expected = 0.5 * (moving.accel_b[:-2:2] + moving.accel_b[2::2])
    np.testing.assert_allclose(s.accel_b[turning][:-1], expected[moving.t[1:-1:2] > 12.0], atol=1e-9)
    assert any(line.startswith("imu: without rates, left out") for line in bag.counted())


def test_estimators_see_the_span_that_was_asked_for(tmp_path: Path, moving: Motion) -> None:
    write_bag(tmp_path / "a.mcap", moving)
    bag = opened(tmp_path / "a.mcap", None, span=(12.0, 30.0))
    s = samples_of(bag)
    assert (s.t[0], s.t[-1]) == (pytest.approx(12.0), pytest.approx(30.0))
    with pytest.raises(InputError, match="--skip/--until: no message"):
        opened(tmp_path / "a.mcap", None, span=(100.0, np.inf))


def test_frame_names_decide(tmp_path: Path, moving: Motion) -> None:
    write_bag(tmp_path / "a.mcap", moving, body="FRD", imu_frame="base_link_frd")
    assert opened(tmp_path / "a.mcap", '[topics]\nreference = ""').converter.chosen["imu"].body == "FRD"


def test_mounting_units_and_iron_are_taken_out(tmp_path: Path, moving: Motion) -> None:
    soft = np.array([[1.05, 0.02, 0.0], [0.02, 0.97, 0.01], [0.0, 0.01, 1.01]])
    hard = np.array([2.0e-5, -1.0e-5, 3.0e-5])
    turned = moving._replace(  # a unit that looks to the right sees the vehicle's right as its front
        gyro_b=moving.gyro_b[:, [1, 0, 2]] * [1, -1, 1],
        accel_b=moving.accel_b[:, [1, 0, 2]] * [1, -1, 1],
        mag_b=moving.mag_b[:, [1, 0, 2]] * [1, -1, 1],
    )
    write_bag(tmp_path / "a.mcap", turned, mag_scale=1e6, hard_iron=hard, soft_iron=soft)
    text = f"""
        [mounting]
        yaw_deg = 90.0
        [magnetometer]
        unit = "uT"
        hard_iron = {(hard * 1e6).tolist()}
        soft_iron = {soft.ravel().tolist()}
        [topics]
        reference = ""
        """
    check_samples(samples_of(opened(tmp_path / "a.mcap", text)), moving)


def test_out_of_order_twice_and_gaps(tmp_path: Path, moving: Motion) -> None:
    rng = np.random.default_rng(1)
    rows = np.delete(np.arange(len(moving.t)), slice(2000, 2100))  # a second is missing
    order = np.argsort(rows + rng.uniform(0, 5, len(rows)), kind="stable")  # up to 50 ms late
    order = np.r_[rows[order], rows[-300:-297]]  # the last three come again, 3 s late
    order = np.insert(order, 700, order[690:700])  # ten come twice at once
    write_bag(tmp_path / "a.mcap", moving, order=order)
    bag = opened(tmp_path / "a.mcap")
    s = samples_of(bag)
    np.testing.assert_allclose(s.t, moving.t[rows], atol=1e-9)
    np.testing.assert_allclose(s.gyro_b, moving.gyro_b[rows], atol=1e-12)
    counts = bag.converter.counts
    assert counts["imu: duplicate"] + counts["imu: too late"] == 13
    assert counts["imu: gaps"] == 1
    assert counts["imu: out of order"] > 500
    assert any(line.startswith("imu: duplicate") for line in bag.counted())


def test_stamps_of_another_clock(tmp_path: Path, moving: Motion) -> None:
    write_bag(tmp_path / "a.mcap", moving, header=False)
    bag = opened(tmp_path / "a.mcap")
    assert any("another clock" in note for note in bag.notes)
    check_samples(samples_of(bag), moving)


def test_a_clock_that_is_off_by_whole_seconds_is_taken_back(tmp_path: Path, moving: Motion) -> None:
    """A receiver that stamps GPS time, 18 s ahead of UTC."""
    t = moving.t[::20]
    with LogWriter(tmp_path / "a.mcap", epoch_ns=EPOCH, force=True) as log:
        imu = log.add_channel("/imu/data_raw", "sensor_msgs/msg/Imu", frame_id="x_frd")
        vel = log.add_channel("/gps/vel", "geometry_msgs/msg/TwistStamped", frame_id="map_ned")
        log.start()
        log.write(imu, ns(moving.t), ns(moving.t), angular_velocity=moving.gyro_b, linear_acceleration=moving.accel_b)
        log.write(vel, ns(t), ns(t - 0.05 + 18.0), **{"twist.linear": np.tile([1.0, 2.0, 3.0], (len(t), 1))})
    bag = opened(tmp_path / "a.mcap", None)
    assert any("check: velocity: its stamps are +18 s off the log's clock" in note for note in bag.notes)
    s = samples_of(bag)
    assert set(np.round(s.gnss_t[s.gnss_new] + 0.05, 6)) <= set(np.round(t, 6))
    assert s.gnss_new.sum() >= len(t) - 1
    shifted = opened(tmp_path / "a.mcap", "[time]\nvelocity_s = -18.0")
    assert not any("off the log's clock" in note for note in shifted.notes)
    assert samples_of(shifted).gnss_new.sum() >= len(t) - 1


@pytest.mark.parametrize(
    ("changes", "map_text", "words"),
    [
        ({"body": "FRD"}, "", "accelerometer reads -g on z at rest: frame is FRD?"),
        ({}, '[frames]\nbody = "FRD"', "accelerometer reads +g on z at rest: frame is FLU?"),
        ({"mag_scale": 1e4}, "", "unit is G?"),
        ({}, '[imu]\naccel_unit = "g"', "m/s2 in the median: unit"),
        ({}, '[frames]\nreference_body = "FRD"', "turn against the reference attitude"),
    ],
)
def test_wrong_conventions_are_named(
    tmp_path: Path, moving: Motion, changes: dict[str, Any], map_text: str, words: str
) -> None:
    write_bag(tmp_path / "a.mcap", moving, **changes)
    assert any(words in note for note in opened(tmp_path / "a.mcap", map_text).notes if note.startswith("check"))


def test_a_receiver_without_a_fix_has_no_velocity(tmp_path: Path, moving: Motion) -> None:
    status = np.where((moving.t[::20] > 20) & (moving.t[::20] < 30), -1, 0)
    with LogWriter(tmp_path / "a.mcap", epoch_ns=EPOCH) as log:
        imu = log.add_channel("/imu", "sensor_msgs/msg/Imu", frame_id="base_link_frd")
        fix = log.add_channel("/gps/fix", "sensor_msgs/msg/NavSatFix", frame_id="gps")
        vel = log.add_channel("/gps/vel", "geometry_msgs/msg/TwistStamped", frame_id="map")
        log.start()
        t, slow = ns(moving.t), ns(moving.t[::20])
        log.write(imu, t, t, angular_velocity=moving.gyro_b, linear_acceleration=moving.accel_b)
        place = {k: np.full(len(slow), v) for k, v in zip(("latitude", "longitude", "altitude"), LLA, strict=True)}
        log.write(fix, slow, slow, **{"status.status": status, **place})
        log.write(vel, slow, slow, **{"twist.linear": np.tile([1.0, 2.0, 3.0], (len(slow), 1))})
    bag = opened(tmp_path / "a.mcap")
    s = samples_of(bag)
    assert (np.isfinite(s.vel_n).all(axis=1) & s.gnss_new).sum() == (status == 0).sum()
    assert bag.converter.counts["velocity: without a fix, left out"] == (status < 0).sum()


def test_a_fix_without_a_height_is_of_two_dimensions(tmp_path: Path, moving: Motion) -> None:
    with LogWriter(tmp_path / "a.mcap", epoch_ns=EPOCH) as log:
        imu = log.add_channel("/imu", "sensor_msgs/msg/Imu", frame_id="base_link_frd")
        fix = log.add_channel("/gps/fix", "sensor_msgs/msg/NavSatFix", frame_id="gps")
        log.start()
        t, slow = ns(moving.t), ns(moving.t[::20])
        log.write(imu, t, t, angular_velocity=moving.gyro_b, linear_acceleration=moving.accel_b)
        k = np.arange(len(slow))
        height = np.where((k < 10) | (k > 100), np.nan, 500.0 + k)
        log.write(fix, slow, slow, latitude=np.full(len(k), LLA[0]), longitude=np.full(len(k), LLA[1]), altitude=height)
    bag = opened(tmp_path / "a.mcap")
    s = samples_of(bag)
    seen = s.lla[s.gnss_new]
    assert len(seen) == len(k)
    np.testing.assert_allclose(seen[:, 2], np.clip(500.0 + k, 510.0, 600.0))
    assert bag.site.lla[2] == 510.0
    assert bag.converter.counts["fix: without a height, that of the fix before taken"] == len(k) - 91


def test_gyro_and_accelerometer_with_a_topic_each_are_joined(tmp_path: Path, moving: Motion) -> None:
    absent = np.r_[-1.0, np.zeros(8)]
    with LogWriter(tmp_path / "a.mcap", epoch_ns=EPOCH) as log:
        gyro = log.add_channel("/camera/gyro/sample", "sensor_msgs/msg/Imu", frame_id="base_link_frd",
                               constant={"linear_acceleration_covariance": absent})  # fmt: skip
        accel = log.add_channel("/camera/accel/sample", "sensor_msgs/msg/Imu", frame_id="base_link_frd",
                                constant={"angular_velocity_covariance": absent})  # fmt: skip
        log.start()
        log.write(gyro, ns(moving.t), ns(moving.t), angular_velocity=moving.gyro_b)
        slow = ns(moving.t[::2] + 0.003)
        log.write(accel, slow, slow, linear_acceleration=moving.accel_b[::2])
    bag = opened(tmp_path / "a.mcap")
    s = samples_of(bag)
    there = np.column_stack([np.interp(s.t, moving.t[::2] + 0.003, column) for column in moving.accel_b[::2].T])
    np.testing.assert_allclose(s.accel_b, there, atol=1e-9)
    np.testing.assert_allclose(s.gyro_b, moving.gyro_b[1:][: len(s.t)], atol=1e-12)
    assert len(s.t) >= len(moving.t) - 3


def test_degrees_and_g_are_named(tmp_path: Path, moving: Motion) -> None:
    write_bag(tmp_path / "a.mcap", moving._replace(gyro_b=np.degrees(moving.gyro_b), accel_b=moving.accel_b / 9.80665))
    notes = opened(tmp_path / "a.mcap").notes
    assert any("unit is deg/s?" in note for note in notes)
    assert any("unit is g?" in note for note in notes)


def test_calibration_finds_what_was_put_in(tmp_path: Path, moving: Motion) -> None:
    hard, bias = np.array([39e-6, 16e-6, -39e-6]), np.array([0.01, -0.02, 0.005])
    write_bag(tmp_path / "a.mcap", moving._replace(gyro_b=moving.gyro_b + bias * [1, -1, -1]), hard_iron=hard)
    bag = opened(tmp_path / "a.mcap", "", calibrate=["mag", "gyro"])
    assert bag.converter.calibration.hard_iron == pytest.approx(hard, abs=0.5e-6)
    assert bag.converter.calibration.gyro_bias == pytest.approx(bias, abs=1e-6)
    assert float(bag.metadata["hard_iron_t"].split()[0]) == bag.converter.calibration.hard_iron[0]
    still = opened(tmp_path / "a.mcap", '[topics]\nmag = ""')
    with pytest.raises(InputError, match="--calibrate mag: no magnetometer"):
        open_bag(still.source.path, map_file=Path(still.converter.mapping.where), calibrate=["mag"])


def test_ellipsoid_fit_of_a_plain_cloud() -> None:
    rng = np.random.default_rng(2)
    u = rng.standard_normal((2000, 3))
    soft = np.array([[1.08, 0.03, -0.02], [0.03, 0.95, 0.04], [-0.02, 0.04, 1.02]])
    hard = np.array([1e-5, -2e-5, 3e-5])
    mag = 5e-5 * (u / np.linalg.norm(u, axis=1, keepdims=True)) @ np.linalg.inv(soft) + hard
    none = calibration.Turns(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3)))
    fit = calibration.fit_mag(mag, none, 5e-5)
    assert fit is not None
    assert fit.hard_iron == pytest.approx(hard, abs=3e-7)
    assert fit.soft_iron == pytest.approx(soft, abs=0.01)
    assert fit.after < 0.1 * fit.before
    assert calibration.fit_mag(mag[:10], none, 5e-5) is None
    assert calibration.fit_mag(np.tile([1e-5, 0, 4e-5], (500, 1)), none, 5e-5) is None


def test_without_a_position_the_field_comes_from_the_data(tmp_path: Path, moving: Motion) -> None:
    write_bag(tmp_path / "a.mcap", moving, with_place=False)
    bag = opened(tmp_path / "a.mcap")
    level = float(np.hypot(MAG_N[0], MAG_N[1]))
    assert bag.site.mag_n == pytest.approx((level, 0.0, MAG_N[2]), abs=1e-8)
    east = opened(tmp_path / "a.mcap", "[place]\ndeclination_deg = 90.0").site.mag_n
    assert east == pytest.approx((0.0, level, MAG_N[2]), abs=1e-8)


def test_delay_of_the_reference_is_found_and_taken_out(tmp_path: Path, moving: Motion) -> None:
    write_bag(tmp_path / "a.mcap", moving, reference_delay=0.04)
    assert any("reference is +0.04" in note for note in opened(tmp_path / "a.mcap").notes)
    bag = opened(tmp_path / "a.mcap", "", sync=True)
    assert bag.converter.mapping.shifts["reference"] == pytest.approx(-40_000_000, abs=1_500_000)


def test_sync_and_alignment() -> None:
    m = motion(30.0, still=2.0)
    at = m.t[50:-50:10]
    rate_b = rates(m.t, m.q_nb, at, 0.1)
    assert np.abs(rate_b - m.gyro_b[50:-50:10]).max() < 0.03
    assert time_shift(at, rate_b, 0.1, m.t + 0.123, m.q_nb) == pytest.approx(0.123, abs=5e-4)
    assert time_shift(at, 0 * rate_b, 0.1, m.t, m.q_nb) is None
    left, right = attitude.from_euler(np.array([[0.1, -0.2, 0.5], [0.02, 0.03, -0.04]]))
    turned = attitude.product(attitude.product(left[None], m.q_nb), right[None])
    found = constant_rotations(turned, m.q_nb)
    assert abs(found[0] @ left) == pytest.approx(1.0, abs=1e-6)
    assert abs(found[1] @ right) == pytest.approx(1.0, abs=1e-6)
    about_down = attitude.from_euler(np.array([[0.0, 0.0, 0.3]]))
    assert heading_offset(attitude.product(about_down, m.q_nb), m.q_nb) == pytest.approx(0.3, abs=1e-9)


# ----------------------------------------------------------------------------------------------- other files


def test_db3_reads_as_mcap(tmp_path: Path, moving: Motion) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    write_bag(tmp_path / "a.mcap", moving)
    store = get_typestore(Stores.ROS2_HUMBLE)
    with (
        rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3) as writer,
        rosbag2.Reader(tmp_path / "a.mcap") as reader,
    ):
        by_topic = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        for connection, time, data in reader.messages():
            writer.write(by_topic[connection.topic], time, data)
    a = samples_of(opened(tmp_path / "a.mcap"))
    for path in (tmp_path / "bag", next((tmp_path / "bag").glob("*.db3"))):
        b = samples_of(opened(path, None))
        np.testing.assert_array_equal(a.gyro_b, b.gyro_b)
        np.testing.assert_array_equal(a.mag_b, b.mag_b)
        np.testing.assert_array_equal(a.lla, b.lla)


CSV_MAP = """
[csv]
time = {column = "time_ms", unit = "ms"}
[csv.imu]
gyro = {columns = ["gx", "gy", "gz"], unit = "deg/s"}
accel = {columns = ["ax", "ay", "az"], unit = "g"}
[csv.mag]
field = {columns = ["mx", "my", "mz"], unit = "mG"}
[csv.fix]
latitude = {columns = ["lat"]}
longitude = {columns = ["lon"]}
[csv.reference]
euler = {columns = ["roll", "pitch", "yaw"], unit = "deg"}
"""


def write_csv(path: Path, m: Motion) -> None:
    from ahrs_sim.attitude import euler

    columns = [(ns(m.t) - EPOCH) / 1e6, *np.degrees(m.gyro_b).T, *(m.accel_b / 9.80665).T, *(m.mag_b * 1e7).T,
               np.full(len(m.t), LLA[0]), np.full(len(m.t), LLA[1]), *np.degrees(euler(m.q_nb)).T]  # fmt: skip
    names = "time_ms,gx,gy,gz,ax,ay,az,mx,my,mz,lat,lon,roll,pitch,yaw"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=names, comments="", fmt="%.15g")


def test_csv_by_its_map(tmp_path: Path, moving: Motion) -> None:
    write_csv(tmp_path / "a.csv", moving)
    bag = opened(tmp_path / "a.csv", CSV_MAP)
    s = samples_of(bag)
    np.testing.assert_allclose(s.gyro_b, moving.gyro_b, atol=1e-12)
    np.testing.assert_allclose(s.accel_b, moving.accel_b, atol=1e-11)
    np.testing.assert_allclose(s.mag_b, moving.mag_b, atol=1e-17)
    assert s.gnss_new.sum() == 1  # a repeated position is no new one
    assert not any(note.startswith("check") for note in bag.notes)
    with pytest.raises(InputError, match=r"no column 'rol' in the file; did you mean 'roll'\?"):
        opened(tmp_path / "a.csv", CSV_MAP.replace('"roll"', '"rol"'))
    with pytest.raises(InputError, match="needs a --map with"):
        opened(tmp_path / "a.csv")


def test_ulog(tmp_path: Path, moving: Motion) -> None:
    write_ulog(tmp_path / "a.ulg", moving)
    bag = opened(tmp_path / "a.ulg")
    s = samples_of(bag)
    np.testing.assert_allclose(s.gyro_b, moving.gyro_b, atol=1e-6)
    np.testing.assert_allclose(s.mag_b, moving.mag_b, atol=1e-11)
    assert bag.converter.chosen["reference"].topic.name == "vehicle_attitude"
    assert not any(note.startswith("check") for note in bag.notes)


# ----------------------------------------------------------------------------------------------- what cannot be read


def test_each_unusable_file_gives_one_line(tmp_path: Path, moving: Motion) -> None:
    write_bag(tmp_path / "good.mcap", motion(2.0))
    data = (tmp_path / "good.mcap").read_bytes()
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    (tmp_path / "noise.mcap").write_bytes(b"\x00" * 1000)
    (tmp_path / "packed.mcap").write_bytes(data.replace(b"\x04\x00\x00\x00zstd", b"\x04\x00\x00\x00xxxx", 1))
    with (tmp_path / "schema.mcap").open("wb") as stream:
        foreign = Writer(stream)
        foreign.start(profile="ros2")
        schema = foreign.register_schema("sensor_msgs/msg/Imu", "flatbuf", b"")
        foreign.add_message(foreign.register_channel("/imu/data_raw", "cdr", schema), EPOCH, b"", EPOCH)
        foreign.finish()
    with LogWriter(tmp_path / "silent.mcap", epoch_ns=EPOCH) as log:
        log.add_channel("/imu/data_raw", "sensor_msgs/msg/Imu")
    with LogWriter(tmp_path / "other.mcap", epoch_ns=EPOCH) as log:
        channel = log.add_channel("/t", "sensor_msgs/msg/Temperature")
        log.start()
        log.write(channel, np.array([EPOCH]), np.array([EPOCH]))
    sqlite3.connect(tmp_path / "empty.db3").close()
    (tmp_path / "noise.db3").write_bytes(b"no database" * 100)
    (tmp_path / "noise.ulg").write_bytes(b"no ulog" * 100)
    for folder, file in (("hollow", ""), ("tables", "a.csv"), ("lost", "good.mcap")):
        (tmp_path / folder).mkdir()
        if file:
            (tmp_path / folder / file).write_bytes(data)
    (tmp_path / "noise.csv").write_bytes(b"\xff\xfe\x00\x01" * 100)
    words = {
        "empty.mcap": "empty file", "cut.mcap": "unfinished or cut off", "noise.mcap": "not an MCAP log",
        "packed.mcap": "compression 'xxxx'", "schema.mcap": "'flatbuf' schema",
        "silent.mcap": "no messages", "other.mcap": "it has /t (Temperature)", "gone.mcap": "cannot be read",
        "hollow": "no recording in it", "tables": "needs a --map", "lost": "name the file in it, good.mcap",
        "empty.db3": "no ROS 2 bag", "noise.db3": "no ROS 2 bag", "gone.db3": "cannot be read",
        "noise.ulg": "no ULog", "gone.ulg": "cannot be read", "noise.csv": "CSV", "gone.csv": "cannot be read",
    }  # fmt: skip
    for name, word in words.items():
        with pytest.raises(InputError) as caught:
            open_bag(tmp_path / name, map_file=None)
        assert name in str(caught.value), name
        assert word in str(caught.value), (name, str(caught.value))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[topics]\nimu = "/imu/dat_raw"', "no topic '/imu/dat_raw'; did you mean '/imu/data_raw'?"),
        ('[topics]\nimu = "/imu/mag"', "it must be sensor_msgs/msg/Imu"),
        ('[frames]\nbody = "FLV"', "[frames]: body: 'FLV' is unknown"),
        ("[magnetometr]\nunit = 1", "magnetometr: unknown key"),
        ("[place]\nlatitude_deg = 45.0", "add the other"),
        ("[sensors]\ngyro_nose = 1", "gyro_nose: unknown key"),
        ('[estimator.a]\nsuite = "bag"', "method: missing"),
    ],
)
def test_a_wrong_map_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    write_bag(tmp_path / "a.mcap", motion(2.0))
    with pytest.raises(InputError) as caught:
        opened(tmp_path / "a.mcap", text)
    assert words in str(caught.value)


def test_map_and_reader_of_the_example_in_the_module(tmp_path: Path) -> None:
    from ahrs_sim.recordings import mapping

    text = mapping.__doc__.split("\n\n", 2)[2]  # type: ignore[union-attr]
    (tmp_path / "m.toml").write_text("\n".join(line[4:] for line in text.splitlines()))
    (tmp_path / "unit.toml").touch()  # the correction that it names: nothing is taken off
    map_ = mapping.load(tmp_path / "m.toml")
    assert map_.shifts["fix"] == -200_000_000
    assert map_.hard_iron == pytest.approx([39.2e-6, 16.1e-6, -39.6e-6])
    assert map_.estimators[0].settings == {"method": "marg-ekf", "suite": "bag"}
    with pytest.raises(InputError, match="no such file"):
        mapping.load(tmp_path / "none.toml")
