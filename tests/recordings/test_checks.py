"""Each check names its cause, and keeps silent where there is none: in flight, in the hand, at rest."""

import dataclasses
import math
import re
from typing import Any

import numpy as np
import pytest
from bag_helpers import motion
from flights import FIELD_N, Path, Planted, flown, measured, records

from ahrs_sim import attitude
from ahrs_sim.recordings import checks, inertial, survey
from ahrs_sim.recordings.survey import Survey
from ahrs_sim.sensors.records import ImuRecord, MagRecord
from ahrs_sim.world.gravity import STANDARD as G
from estimators.types import blank


def lines(s: Survey, field_n: np.ndarray | None = FIELD_N, **assumed: Any) -> list[str]:
    """What the checks say of a survey whose magnetometer is in FRD."""
    values = {"body": "FLU", "reference": None, "mag_axes": np.eye(3), "mag_b": s.mag, "field_n": field_n, "delay": 0.0}
    return checks.suspicions(s, checks.Assumed(**{**values, **assumed}), inertial.track(s, G))


def hand(
    *, gyro: np.ndarray | float = 1.0, accel: np.ndarray | float = 1.0, mag: np.ndarray | float = 1.0,
    without_gravity: bool = False, yaw_only: bool = False, start: float = 12.0,
) -> Survey:  # fmt: skip
    """Turned in the hand about all axes, without a standing stretch: a survey of what sensors read."""
    m = motion(60.0, still=0.0 if start else 10.0)
    rng = np.random.default_rng(3)
    rows = m.t >= start
    t = m.t[rows]
    gyro_b, accel_b, mag_b = m.gyro_b[rows].copy(), m.accel_b[rows].copy(), m.mag_b[rows].copy()
    if yaw_only:
        turn = 0.5 * (t - t[0])
        gyro_b, accel_b = np.tile([0.0, 0.0, 0.5], (len(t), 1)), np.tile([0.0, 0.0, -G], (len(t), 1))
        mag_b = np.column_stack([FIELD_N[0] * np.cos(turn), -FIELD_N[0] * np.sin(turn), np.full(len(t), FIELD_N[2])])
    if without_gravity:
        accel_b = 0.3 * np.sin(np.outer(t, [3.0, 4.0, 5.0]))

    def put(cls: Any, **columns: np.ndarray) -> Any:
        made = blank(cls, len(t))
        made.update(columns)
        made["stamp_ns"] = made["arrival_ns"] = np.rint(t * 1e9).astype(np.int64)
        return cls(**made)

    def scaled(values: np.ndarray, sigma: float, by: np.ndarray | float) -> np.ndarray:
        return (values + rng.normal(0, sigma, values.shape)) @ (np.eye(3) * by if np.isscalar(by) else np.asarray(by)).T

    return survey.look([{
        "imu": put(ImuRecord, gyro_b=scaled(gyro_b, 2e-3, gyro), accel_b=scaled(accel_b, 0.05, accel)),
        "mag": put(MagRecord, mag_b=scaled(mag_b, 3e-7, mag)),
    }])  # fmt: skip


FLIPPED = np.diag([1.0, -1.0, -1.0])
LEFT = np.diag([1.0, -1.0, 1.0])


def about_down(angle_deg: float) -> np.ndarray:
    """A rotation (3, 3) about the third axis."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"accel": 1 / G}, "in the median: unit is g?"),
        ({"accel": 1000 / G}, "in the median: unit is mg?"),
        ({"without_gravity": True}, "gravity removed"),
        ({"accel": -1.0}, "almost always: frame is FRD, or its sign?"),
        ({"gyro": FLIPPED}, "gyro axes read as (x -y -z) not as"),
        ({"gyro": LEFT}, "gyro axes read as (x -y z), a left-handed frame,"),
        ({"gyro": 180 / math.pi}, "unit is deg/s?"),
        ({"mag": FLIPPED}, "axes read as (x -y -z) not as they are: [magnetometer] roll_deg = 180"),
        ({"mag": LEFT}, "axes read as (x -y z), a left-handed frame, not as they are: [magnetometer] soft_iron = ["),
        ({"mag": 1e4}, "unit is G?"),
        ({"mag": 1e6}, "unit is uT?"),
        ({"mag": 3e8}, "counts? soft_iron = [k"),
    ],
)
def test_in_the_hand(changes: dict[str, Any], words: str) -> None:
    found = lines(hand(**changes))
    assert len(found) == 1
    assert words in found[0]


@pytest.mark.long
def test_all_orientations_of_a_magnetometer() -> None:
    """Every one of the 24 is found from turning about all axes, and put right by the line that is printed."""
    plain = hand()
    assert lines(plain) == []
    for name, matrix in checks.signed_axes():
        if np.linalg.det(matrix) < 0 or name == "x y z":
            continue
        turned = dataclasses.replace(plain, mag=plain.mag @ matrix)
        found = checks.orientation(turned, turned.mag, math.atan2(FIELD_N[2], FIELD_N[0]))
        assert found is not None
        assert found.unique
        np.testing.assert_array_equal(found.matrix, matrix)
        (line,) = lines(turned)
        values = {}
        for part in line.split("[magnetometer] ")[1].split(", "):
            key, value = part.split(" = ")
            values[key.removesuffix("_deg")] = math.radians(float(value))
        again = attitude.matrix(*(values.get(a, 0.0) for a in ("roll", "pitch", "yaw")))
        np.testing.assert_allclose(again, matrix, atol=1e-9)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"yaw_only": True},
        {"yaw_only": True, "mag": FLIPPED @ np.diag([-1.0, -1.0, 1.0])},  # about one axis, several would fit
    ],
)
def test_silent_in_the_hand(changes: dict[str, Any]) -> None:
    assert [line for line in lines(hand(**changes)) if "read as" in line or "unit" in line or "gravity" in line] == []


def test_silent_in_the_hand_without_a_place() -> None:
    assert lines(hand(), field_n=None) == []


@pytest.mark.parametrize("seed", range(4))
def test_silent_in_flight(seed: int) -> None:
    assert lines(flown(Path(seed), seed=seed)) == []


@pytest.mark.parametrize(("gnss", "delay"), [(1.0, 0.3), (5.0, 0.2), (10.0, -0.15), (5.0, 0.0), (1.0, 0.02)])
def test_latency_of_gnss_in_flight(gnss: float, delay: float) -> None:
    found = lines(flown(Path(3), Planted(gnss_delay=delay), gnss=gnss))
    if abs(delay) < 0.1:
        assert found == []
        return
    (line,) = found
    word = "late" if delay > 0 else "early"
    reported, sigma = (float(x) for x in line.split(f"is {word} by ")[1].split(" s:")[0].split(" +- "))
    assert abs(reported - abs(delay)) < 3 * sigma + 0.005
    assert sigma < 0.04
    assert f"velocity_s = {-math.copysign(reported, delay):g}" in line


def test_latency_of_circles_alone_is_not_claimed() -> None:
    assert lines(flown(Path(circles=True), Planted(gnss_delay=0.25))) == []


@pytest.mark.parametrize(
    ("planted", "words"),
    [
        (Planted(gyro=np.eye(3) * 180 / math.pi), "unit is deg/s?"),
        (Planted(gyro=LEFT), "gyro axes read as (x -y z), a left-handed frame,"),
        (Planted(accel=np.eye(3) / G), "unit is g?"),
        (Planted(mag_axes=FLIPPED), "axes read as (x -y -z)"),
        (Planted(hard_iron=np.array([1e-5, 1e-5, 0.0])), "hard iron? (--calibrate mag)"),
        (Planted(mag_axes=about_down(-30.0)), "deg to the right"),
    ],
)
def test_in_flight(planted: Planted, words: str) -> None:
    found = lines(flown(Path(3), planted))
    assert len(found) == 1
    assert words in found[0]


def test_an_imu_that_is_stuck_is_the_one_that_is_named() -> None:
    block = measured(Path(3), Planted(), duration=120.0)
    imu = block["imu"]
    held = (imu.stamp_ns > 60 * 10**9) & (imu.stamp_ns <= 75 * 10**9)
    row = int(np.flatnonzero(held)[0])
    columns = {k: np.where(held[:, None], getattr(imu, k)[row], getattr(imu, k)) for k in ("gyro_b", "accel_b")}
    (line,) = lines(survey.look([{**block, "imu": dataclasses.replace(imu, **columns)}]))
    assert re.match(r"the IMU repeats one reading for 1[45]\.\d s \(from 60\.\d s on\) while the field turns", line)
    still = motion(30.0, still=30.0)  # without noise: it stands
    quiet = {
        "imu": records(ImuRecord, still.t, gyro_b=still.gyro_b, accel_b=still.accel_b),
        "mag": records(MagRecord, still.t, mag_b=still.mag_b),
    }
    assert not any("repeats" in line for line in lines(survey.look([quiet])))


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (lambda v: v[:, [1, 0, 2]] * [1, 1, -1], "has north and east exchanged"),
        (lambda v: 3.6 * v, "is 3.6 times the way between the fixes: its unit is km/h"),
        (lambda v: v * 3600 / 1852, "its unit is kt"),
        (lambda v: np.column_stack([np.hypot(v[:, 0], v[:, 1]), np.zeros(len(v)), v[:, 2]]), "in the vehicle's axes?"),
    ],
)
def test_velocity_by_the_way_between_fixes(changed: Any, words: str) -> None:
    s = flown(Path(3))
    (line,) = lines(dataclasses.replace(s, vel_n=changed(s.vel_n)))
    assert words in line


def test_velocity_is_not_blamed_in_a_hover_nor_for_a_delay_or_single_fixes() -> None:
    rng = np.random.default_rng(2)
    s = flown(Path(3), Planted(gnss_delay=0.4))
    assert checks._velocity(s) == []
    wild = np.where(rng.random((len(s.fixes), 1)) < 0.02, [1e-2, 1e-2, 0.0], 0.0)
    assert checks._velocity(dataclasses.replace(s, fixes=s.fixes + wild)) == []
    hover = s.fixes[0] + rng.normal(0, 1.5e-7, s.fixes.shape) * [1.0, 1.0, 0.0]
    still = dataclasses.replace(s, fixes=hover, vel_n=rng.normal(0, 0.1, s.vel_n.shape))
    assert checks._velocity(still) == []


def referred(s: Survey, off_deg: Any) -> list[str]:
    """What the checks say of a reference whose heading is off by a function of time."""
    t = np.arange(0.0, s.t[-1], 0.05)
    half = np.radians(off_deg(t)) / 2
    turn = np.column_stack([np.cos(half), 0.0 * t, 0.0 * t, np.sin(half)])
    q_nb = attitude.product(turn, Path(3).q_nb(t))
    return lines(dataclasses.replace(s, t_reference=t, q_nb=q_nb), reference=("FRD", "NED"))


def test_a_reference_that_was_not_aligned_at_first() -> None:
    s = flown(Path(3))
    (line,) = referred(s, lambda t: np.interp(t, [60.0, 85.0], [100.0, 0.0]))
    found = re.fullmatch(
        r"heading of the reference turns by (\d+) deg against the gyro up to (\d+) s and not after: it was not aligned "
        r"before; --from (\d+) leaves that out of the errors",
        line,
    )
    assert found is not None
    assert int(found[1]) == pytest.approx(100, abs=8)
    assert 80 <= int(found[2]) <= int(found[3]) <= 105
    for sound in (
        lambda t: 0.0 * t,
        lambda t: 0.0 * t + 70.0,  # never aligned, or a heading without declination: another thing
        lambda t: 0.3 * t,  # a bias of either
        lambda t: np.interp(t, [60.0, 85.0, 190.0, 210.0], [100.0, 0.0, 0.0, 100.0]),  # lost again
        lambda t: np.interp(t, [200.0, 220.0], [0.0, 100.0]),  # lost at the end
    ):
        assert referred(s, sound) == []


def test_sensors_that_are_not_there() -> None:
    blocks = measured(Path(1), Planted(), duration=40.0)
    seen = survey.look([blocks])
    assert checks.missing({"imu", "fix", "velocity"}, seen) == []
    assert [line.split(":")[0] for line in checks.missing({"imu", "fix"}, seen)] == [
        "positions without a velocity", "nothing in it measures heading",
    ]  # fmt: skip
    standing = survey.look([{"imu": blocks["imu"]}])
    assert checks.missing({"imu", "mag"}, standing) == []


@pytest.mark.parametrize(
    "bias", [(0.0, 0.0, 0.0), (2.0, 0.0, 1.0), (0.0, 12.0, 0.0), (14.8, 0.0, 0.0), (-8.0, 8.0, 9.0)]
)
def test_a_great_gyro_bias_is_known_standing(bias: tuple[float, float, float]) -> None:
    """Field and gravity stay where they are: what the gyro reads is its bias."""
    from ahrs_sim.recordings import calibration

    s = hand(start=0.0)
    s = dataclasses.replace(s, gyro_b=s.gyro_b + np.radians(bias))
    still = s.t < 9.0
    assert s.still[still][10:-10].mean() > 0.9
    assert s.still[s.t > 13.0].mean() < 0.02
    found = calibration.gyro_bias(s)
    assert found is not None
    assert np.degrees(found[0]) == pytest.approx(bias, abs=0.2)
    great = np.linalg.norm(bias) > 3.0
    assert any("deg/s at rest: a bias" in line for line in lines(s)) == great
