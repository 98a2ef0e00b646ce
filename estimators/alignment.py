"""Initial attitude, gyro bias and sensor noise from a stationary stretch.

Second by second the stretch is judged: still when gyro and accelerometer scatter no more than their noise explains, the
gyro's mean could be its bias and the accelerometer's mean gravity. `align_s` still seconds in a row give the alignment:
attitude by TRIAD from mean specific force and mean field (down exactly, heading from the field), bias from the mean
rate, noise covariances from the scatter. A second that is not still starts the stretch again. Without stillness the
alignment is coarse, from the means of the last second, with a large covariance: after `MOVING_S` when no second was
still (started in the air), after `wait_s` in any case. Moving, specific force is not gravity: with an airspeed what
a coordinated flight adds, w x v + dv/dt, is taken off it, and with GNSS two velocities say it in navigation axes, f_n =
dv_n/dt - g. That brings a start in a turn from the angle of bank to a few degrees.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from estimators.jit import njit
from estimators.models.base import MAX_FIELD, MAX_FORCE, MAX_RATE, MAX_SPEED, on_earth, plausible
from estimators.rotations import attitude_matrix, from_euler, multiply, to_body, to_nav, triad, turn
from estimators.rows import (
    ACCEL,
    AIR_NEW,
    AIRSPEED,
    GNSS_NEW,
    GNSS_T,
    GYRO,
    LLA,
    MAG,
    MAG_NEW,
    VEL,
    T,
)
from estimators.types import SensorInfo, Site

MOVING_S = 5.0  # s
GYRO_SCATTER, ACCEL_SCATTER = (
    math.radians(0.5),
    0.15,
)  # rad/s, m/s2: least limits, vibration of an idling motor included
MEAN_RATE = math.radians(1.5)  # rad/s: more than a turn-on bias is a turn
COARSE_TILT, COARSE_HEADING, NO_HEADING = math.radians(20.0), math.radians(45.0), math.radians(104.0)  # sigmas
AIDED_TILT, AIDED_HEADING = math.radians(5.0), math.radians(12.0)  # of a start in motion with a velocity aid


@dataclass(frozen=True)
class Alignment:
    """What a stationary stretch says (or, coarse, the last second before it was given up)."""

    still: bool
    q_nb: np.ndarray  # (4,)
    sigma_n: np.ndarray  # (3,) rad, of a rotation about north, east, down
    gyro_bias: np.ndarray  # (3,) rad/s
    gyro_bias_sigma: np.ndarray  # (3,)
    gyro_cov: np.ndarray  # (3, 3), of single samples
    accel_cov: np.ndarray  # (3, 3)
    mag_cov: np.ndarray  # (3, 3) NaN without magnetometer
    vel_n: np.ndarray  # (3,) m/s, GNSS at the end of a start in motion, else NaN
    lla: np.ndarray  # (3,) rad, rad, m, likewise
    air_n: np.ndarray  # (3,) m/s, velocity in the air mass, likewise from the airspeed


class Start(NamedTuple):
    """What a model's `build` returns: the model and the first contents of the estimator's memory."""

    model: Any
    x: np.ndarray
    P: np.ndarray
    P_restart: np.ndarray
    memory: np.ndarray
    inputs: int  # length of u
    measurements: int  # length of z


class Stretch(NamedTuple):
    """Running moments since the stretch began and of the present second (Welford)."""

    clock: (
        np.ndarray
    )  # s: first stamp of all, start of stretch, start of second, last stamp; 1.0 once a second was still
    counts: np.ndarray  # samples in stretch: IMU, magnetometer; in second: IMU, magnetometer
    mean: np.ndarray  # (2, 9) gyro, accelerometer, magnetometer; of stretch, of second
    spread: np.ndarray  # (2, 9, 3) sums of products of deviations, a 3x3 block each
    aid: np.ndarray  # (AID,) airspeed and GNSS of the second: first and last with their times, place; NaN: none

    @classmethod
    def make(cls) -> "Stretch":
        """Nothing seen."""
        return cls(np.full(5, np.nan), np.zeros(4), np.zeros((2, 9)), np.zeros((2, 9, 3)), np.full(AID, np.nan))


BEGAN, STRETCH, SECOND, LAST, EVER_STILL = range(5)
_V0, _V0_T, _V1, _V1_T, _G0, _G0_T, _G1, _G1_T, _PLACE, AID = 0, 1, 2, 3, 4, 7, 8, 11, 12, 15
FLYING, MOVING = (
    8.0,
    3.0,
)  # m/s: an airspeed above is not wind on the ground, a speed above is not noise of the receiver
INCIDENCE = 0.05  # rad, of an aeroplane in cruise
ALIGNING, STILL, COARSE = range(3)


@njit
def _add(s: Stretch, which: int, sensor: int, n: float, row: np.ndarray, at: int) -> None:
    """Add one reading of a sensor (0 gyro, 1 accelerometer, 2 magnetometer), the n-th, from `row[at:at + 3]`."""
    first = 3 * sensor
    before = np.empty(3)
    for i in range(3):
        before[i] = row[at + i] - s.mean[which, first + i]
        s.mean[which, first + i] += before[i] / n
    for i in range(3):
        for j in range(3):
            s.spread[which, first + i, j] += before[i] * (row[at + j] - s.mean[which, first + j])


@njit
def _clear(s: Stretch, which: int) -> None:
    s.counts[2 * which] = s.counts[2 * which + 1] = 0.0
    for i in range(9):
        s.mean[which, i] = 0.0
        for j in range(3):
            s.spread[which, i, j] = 0.0


@njit
def _watch(s: Stretch, row: np.ndarray) -> None:
    """Keep the first and the last airspeed and GNSS velocity of the present second, and the last place."""
    aid = s.aid
    if row[AIR_NEW] != 0.0 and plausible(row[AIRSPEED], MAX_SPEED):
        if math.isnan(aid[_V0_T]):
            aid[_V0], aid[_V0_T] = row[AIRSPEED], row[T]
        aid[_V1], aid[_V1_T] = row[AIRSPEED], row[T]
    if row[GNSS_NEW] != 0.0 and plausible(abs(row[VEL]) + abs(row[VEL + 1]) + abs(row[VEL + 2]), MAX_SPEED):
        if math.isnan(aid[_G0_T]):
            aid[_G0_T] = row[GNSS_T]
            for i in range(3):
                aid[_G0 + i] = row[VEL + i]
        aid[_G1_T] = row[GNSS_T]
        for i in range(3):
            aid[_G1 + i], aid[_PLACE + i] = row[VEL + i], row[LLA + i]


@njit
def _is_moving(s: Stretch) -> bool:
    """Whether GNSS, or without it the airspeed, says that nothing stands: smooth flight scatters as little."""
    aid = s.aid
    if math.isfinite(aid[_G1_T]):
        return bool(aid[_G1] ** 2 + aid[_G1 + 1] ** 2 + aid[_G1 + 2] ** 2 > MOVING**2)
    return bool(aid[_V1] > FLYING)


@njit
def _second_is_still(s: Stretch, gyro_limit: float, accel_limit: float, gravity: float) -> bool:
    n = s.counts[2]
    if n < 2.0 or _is_moving(s):
        return False
    norm2 = 0.0
    for i in range(3):
        norm2 += s.mean[1, 3 + i] ** 2
        if s.spread[1, i, i] > (n - 1.0) * gyro_limit**2 or abs(s.mean[1, i]) > MEAN_RATE:
            return False
        if s.spread[1, 3 + i, i] > (n - 1.0) * accel_limit**2:
            return False
    return abs(math.sqrt(norm2) / gravity - 1.0) < 0.1


@njit
def align(
    s: Stretch, rows: np.ndarray, align_s: float, wait_s: float, gyro_limit: float, accel_limit: float, gravity: float
) -> tuple[int, int]:
    """Take rows until aligned: the number of rows taken and ALIGNING, STILL or COARSE."""
    clock, count = s.clock, s.counts
    for k in range(rows.shape[0]):
        row = rows[k]
        t = row[T]
        if math.isnan(clock[BEGAN]):
            clock[BEGAN] = clock[STRETCH] = clock[SECOND] = t
            clock[EVER_STILL] = 0.0
        elif t <= clock[LAST]:
            continue
        clock[LAST] = t
        if t - clock[SECOND] >= 1.0:
            if _second_is_still(s, gyro_limit, accel_limit, gravity):
                clock[EVER_STILL] = 1.0
                if t - clock[STRETCH] >= align_s:
                    return k, STILL
            else:
                waited = t - clock[BEGAN]
                if count[2] > 0.0 and (waited >= wait_s or (waited >= MOVING_S and clock[EVER_STILL] == 0.0)):
                    return k, COARSE
                _clear(s, 0)
                clock[STRETCH] = t
            _clear(s, 1)
            s.aid[:] = math.nan
            clock[SECOND] = t
        _watch(s, row)
        finite = True
        for i in range(3):
            finite &= plausible(row[GYRO + i], MAX_RATE) and plausible(row[ACCEL + i], MAX_FORCE)
        mag = row[MAG_NEW] != 0.0
        for i in range(3):
            mag &= plausible(row[MAG + i], MAX_FIELD)
        for which in range(2):
            if finite:
                count[2 * which] += 1.0
                _add(s, which, 0, count[2 * which], row, GYRO)
                _add(s, which, 1, count[2 * which], row, ACCEL)
            if mag:
                count[2 * which + 1] += 1.0
                _add(s, which, 2, count[2 * which + 1], row, MAG)
    return rows.shape[0], ALIGNING


def limits(sensors: SensorInfo) -> tuple[float, float]:
    """Scatter (rad/s, m/s2) up to which a second counts as still, for sensors of this noise."""
    gyro = sensors.gyro_noise * math.sqrt(sensors.rate / 2)
    accel = sensors.accel_noise * math.sqrt(sensors.rate / 2)
    return max(GYRO_SCATTER, 2 * gyro), max(ACCEL_SCATTER, 2 * accel)


def conclude(s: Stretch, still: bool, site: Site, sensors: SensorInfo) -> Alignment:
    """The alignment from what `align` has gathered: the whole stretch when still, else the last second."""
    which = 0 if still else 1
    samples, fields = s.counts[2 * which], s.counts[2 * which + 1]
    rate, force, field = s.mean[which, 0:3], s.mean[which, 3:6], s.mean[which, 6:9]
    mag_n = np.array(site.mag_n, float)
    q_nb = np.array([1.0, 0.0, 0.0, 0.0])
    aid, nothing = s.aid, np.full(3, np.nan)
    flying = not still and bool(aid[_V1] > FLYING)
    fixes = not still and not flying and bool(aid[_G1_T] - aid[_G0_T] > 0.3)
    force_n = np.array([0.0, 0.0, -site.gravity])
    v_b = aid[_V1] * np.array([math.cos(INCIDENCE), 0.0, math.sin(INCIDENCE)]) if flying else np.zeros(3)
    if flying:
        span = aid[_V1_T] - aid[_V0_T]
        force = force - np.cross(rate, v_b) - [(aid[_V1] - aid[_V0]) / span if span > 0.3 else 0.0, 0.0, 0.0]
    elif fixes:
        force_n = force_n + (aid[_G1 : _G1 + 3] - aid[_G0 : _G0 + 3]) / (aid[_G1_T] - aid[_G0_T])
    has_heading = fields > 0 and _two_vectors(force, field, force_n, mag_n, q_nb)
    if not has_heading and np.linalg.norm(force) > 0.0:  # level from gravity, heading unknown
        from_euler(math.atan2(-force[1], -force[2]), math.atan2(force[0], math.hypot(force[1], force[2])), 0.0, q_nb)
    aided = flying or (fixes and has_heading)
    if aided:  # the means are those of the middle of the second: on to its end
        middle = q_nb.copy()
        half = 0.5 * (s.clock[LAST] - s.clock[SECOND])
        turn(middle, half * rate[0], half * rate[1], half * rate[2], q_nb)
    air_n = nothing.copy()
    if flying and has_heading:
        to_nav(q_nb, v_b[0], v_b[1], v_b[2], air_n)
    moving = not still and math.isfinite(aid[_G1_T])
    placed = moving and on_earth(aid[_PLACE], aid[_PLACE + 1], aid[_PLACE + 2])
    horizontal = math.hypot(mag_n[0], mag_n[1])
    if still:
        tilt = math.hypot(sensors.accel_bias / site.gravity, sensors.accel_scale, 1e-3)
        heading = (
            math.hypot(sensors.mag_bias / horizontal, tilt * mag_n[2] / horizontal, 5e-3) if has_heading else NO_HEADING
        )
        per_sample = sensors.gyro_noise * math.sqrt(sensors.rate / 2)
        bias = rate.copy()
        bias_sigma = np.full(3, math.hypot(per_sample / math.sqrt(samples), sensors.gyro_instability, 7.3e-5))
    else:
        tilt, heading = (AIDED_TILT, AIDED_HEADING) if aided else (COARSE_TILT, COARSE_HEADING)
        heading = heading if has_heading else NO_HEADING
        bias, bias_sigma = np.zeros(3), np.full(3, max(sensors.gyro_bias, 1e-4))

    def covariance(sensor: int, n: float) -> np.ndarray:
        block = s.spread[which, 3 * sensor : 3 * sensor + 3]
        return (block + block.T) / (2 * (n - 1)) if n > 1 else np.full((3, 3), np.nan)

    return Alignment(
        still=still,
        q_nb=q_nb,
        sigma_n=np.array([tilt, tilt, heading]),
        gyro_bias=bias,
        gyro_bias_sigma=bias_sigma,
        gyro_cov=covariance(0, samples),
        accel_cov=covariance(1, samples),
        mag_cov=covariance(2, fields),
        vel_n=aid[_G1 : _G1 + 3].copy() if moving else nothing,
        lla=aid[_PLACE : _PLACE + 3].copy() if placed else nothing,
        air_n=air_n,
    )


def _two_vectors(
    force_b: np.ndarray, field_b: np.ndarray, force_n: np.ndarray, mag_n: np.ndarray, q_nb: np.ndarray
) -> bool:
    """`q_nb` (4,) from specific force, exactly, and field; False, and `q_nb` as it was, when they do not tell.

    TRIAD in axes whose down is -force_n, reached from NED by the shortest rotation.
    """
    down = -force_n / np.linalg.norm(force_n)
    q = np.array([1.0 + down[2], -down[1], down[0], 0.0])  # turns (0, 0, 1) into `down`
    q /= np.linalg.norm(q)
    mag, q_of_these = np.empty(3), np.empty(4)
    to_body(q, mag_n[0], mag_n[1], mag_n[2], mag)
    if not triad(-force_b, field_b, mag, q_of_these):
        return False
    multiply(q, q_of_these, q_nb)
    return True


def attitude_block(alignment: Alignment) -> np.ndarray:
    """(4, 4) covariance of the elements of q_nb that belongs to `sigma_n`, rank three: `1/4 X C_bn s^2 C_nb X^T`."""
    a, b, c, d = alignment.q_nb
    C_bn = np.empty((3, 3))
    attitude_matrix(alignment.q_nb, C_bn)
    X = np.array([[-b, -c, -d], [a, -d, c], [d, a, -b], [-c, b, a]])
    block: np.ndarray = 0.25 * X @ C_bn @ np.diag(alignment.sigma_n**2) @ C_bn.T @ X.T
    return block
