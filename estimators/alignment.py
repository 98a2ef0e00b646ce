"""Initial attitude, gyro bias and sensor noise from a stationary stretch.

Second by second the stretch is judged: still when gyro and accelerometer scatter no more than their noise explains, the
gyro's mean could be its bias and the accelerometer's mean gravity. `align_s` still seconds in a row give the alignment:
attitude by TRIAD from mean specific force and mean field (down exactly, heading from the field), bias from the mean
rate, noise covariances from the scatter. Motion before that ends it, too, when there was a still second: what was still
is the alignment, with larger sigmas, and is turned on by the gyro to where the motion has come. Without stillness the
alignment is coarse, from the means of the last second, with a large covariance, after `MOVING_S` (started in the air).
Moving, specific force is not gravity: with an airspeed what
a coordinated flight adds, w x v + dv/dt, is taken off it, and with GNSS two velocities say it in navigation axes, f_n =
dv_n/dt - g. That brings a start in a turn from the angle of bank to a few degrees.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from estimators.jit import inner
from estimators.native import Flag, Integer, Kernel, Number, Record, Vector3, adapts, entry, local, record, shaped
from estimators.plausible import MAX_FIELD, MAX_FORCE, MAX_RATE, MAX_SPEED, on_earth, plausible
from estimators.records import SAMPLE, Sample
from estimators.rotations import attitude_matrix, from_euler, multiply, to_body, to_nav, triad, turn
from estimators.settings import Setting
from estimators.types import SensorInfo, Site

SETTINGS = {
    "initialisation": Setting(
        "aligned", "aligned: from a stationary stretch; paper: fixed state, large covariance", ("aligned", "paper")
    ),
    "align_s": Setting(20.0, "s, stationary stretch that is averaged", minimum=1.0, maximum=3600.0),
    "wait_s": Setting(60.0, "s, wait for it so long, then align coarsely", minimum=1.0, maximum=3600.0),
}
ALIGNED = {name: setting for name, setting in SETTINGS.items() if name != "initialisation"}
"""For models without the paper's start."""

LONGEST_GAP = 5.0
"""s: after a longer gap the attitude is aligned anew, since no prediction stands for the rates that are missing."""

MOVING_S = 5.0  # s
SHORT_TILT, SHORT_RATE = math.radians(2.0), math.radians(0.5)  # rad s, rad: over the length, of a stretch cut short
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


class Aids(Record):
    """Airspeed and GNSS velocity of a second: the first and the last of each, and the last place; NaN: none."""

    speed0: Number  # m/s
    speed0_t: Number  # s
    speed1: Number
    speed1_t: Number
    vel0_n: Vector3  # m/s
    vel0_t: Number  # s, when it was true
    vel1_n: Vector3
    vel1_t: Number
    lla: Vector3  # rad, rad, m


class Moments(Record):
    """Running means and scatter of the sensors (Welford)."""

    samples: Number  # of the IMU
    fields: Number  # of the magnetometer
    mean: Annotated[np.ndarray, shaped(9)]  # gyro, accelerometer, magnetometer
    spread: Annotated[np.ndarray, shaped(9, 3)]  # sums of products of deviations, a 3x3 block each


class Stretch(Record):
    """What the alignment keeps from row to row; times are NaN before the first."""

    began_t: Number  # s, first row of all
    stretch_t: Number  # s, begin of the stationary stretch
    second_t: Number  # s, begin of the present second
    last_t: Number  # s, last row
    was_still: Flag  # a second was still
    phase: Integer  # ALIGNING, STILL or COARSE
    stretch: Moments  # since the stretch began
    second: Moments  # of the present second
    aids: Aids  # of the present second
    kept: Moments  # of the stretch up to its last still second
    kept_s: Number  # s, its length; 0: none
    turned: Annotated[np.ndarray, shaped(4)]  # attitude now from that at its end, by the gyro
    cut_short: Flag  # the alignment is `kept`

    @classmethod
    def make(cls) -> "Stretch":
        """Nothing seen."""
        made = cls.nans()
        for name in Moments.dtype.names or ():
            made.data["stretch"][name] = made.data["second"][name] = made.data["kept"][name] = 0.0
        made.data["kept_s"], made.data["turned"] = 0.0, (1.0, 0.0, 0.0, 0.0)
        return made


FLYING, MOVING = 8.0, 5.0  # m/s: above, an airspeed is not wind on the ground, a speed not noise of the receiver
INCIDENCE = 0.05  # rad, of an aeroplane in cruise
ALIGNING, STILL, COARSE = range(3)
STRETCH = Stretch.dtype


@inner
def _add(m: Moments, sensor: int, n: float, reading: np.ndarray) -> None:
    """Add one reading (3,) of a sensor (0 gyro, 1 accelerometer, 2 magnetometer), the n-th."""
    first = 3 * sensor
    before = local(3)
    for i in range(3):
        before[i] = reading[i] - m.mean[first + i]
        m.mean[first + i] += before[i] / n
    for i in range(3):
        for j in range(3):
            m.spread[first + i, j] += before[i] * (reading[j] - m.mean[first + j])


@inner
def _clear(m: Moments) -> None:
    m.samples = m.fields = 0.0
    for i in range(9):
        m.mean[i] = 0.0
        for j in range(3):
            m.spread[i, j] = 0.0


@inner
def _forget(aids: Aids) -> None:
    aids.speed0 = aids.speed0_t = aids.speed1 = aids.speed1_t = aids.vel0_t = aids.vel1_t = math.nan
    for i in range(3):
        aids.vel0_n[i] = aids.vel1_n[i] = aids.lla[i] = math.nan


@inner
def _watch(aids: Aids, row: Sample) -> None:
    """Keep the first and the last airspeed and GNSS velocity of the present second, and the last place."""
    if row.air_new and plausible(row.airspeed, MAX_SPEED):
        if math.isnan(aids.speed0_t):
            aids.speed0, aids.speed0_t = row.airspeed, row.t
        aids.speed1, aids.speed1_t = row.airspeed, row.t
    if row.gnss_new and plausible(abs(row.vel_n[0]) + abs(row.vel_n[1]) + abs(row.vel_n[2]), MAX_SPEED):
        if math.isnan(aids.vel0_t):
            aids.vel0_t = row.gnss_t
            for i in range(3):
                aids.vel0_n[i] = row.vel_n[i]
        aids.vel1_t = row.gnss_t
        for i in range(3):
            aids.vel1_n[i], aids.lla[i] = row.vel_n[i], row.lla[i]


@inner
def _is_moving(aids: Aids) -> bool:
    """Whether GNSS, or without it the airspeed, says that nothing stands: smooth flight scatters as little."""
    v = aids.vel1_n
    moving: bool = aids.speed1 > FLYING
    if math.isfinite(aids.vel1_t):
        moving = v[0] ** 2 + v[1] ** 2 + v[2] ** 2 > MOVING**2
    return moving


@inner
def _second_is_still(s: Stretch, gyro_limit: float, accel_limit: float, gravity: float) -> bool:
    """Whether noise explains the scatter, a bias the rate, and gravity the force."""
    m = s.second
    n = m.samples
    if n < 2.0 or _is_moving(s.aids):
        return False
    norm2 = 0.0
    for i in range(3):
        norm2 += m.mean[3 + i] ** 2
        if m.spread[i, i] > (n - 1.0) * gyro_limit**2 or abs(m.mean[i]) > MEAN_RATE:
            return False
        if m.spread[3 + i, i] > (n - 1.0) * accel_limit**2:
            return False
    return abs(math.sqrt(norm2) / gravity - 1.0) < 0.1


@inner
def _gather(m: Moments, row: Sample, imu: bool, mag: bool) -> None:
    """Add the readings of a row."""
    if imu:
        m.samples += 1.0
        _add(m, 0, m.samples, row.gyro_b)
        _add(m, 1, m.samples, row.accel_b)
    if mag:
        m.fields += 1.0
        _add(m, 2, m.fields, row.mag_b)


@inner
def _keep(s: Stretch, t: float) -> None:
    """Keep what the stretch says up to a still second that ends at time t."""
    s.kept.samples, s.kept.fields = s.stretch.samples, s.stretch.fields
    for i in range(9):
        s.kept.mean[i] = s.stretch.mean[i]
        for j in range(3):
            s.kept.spread[i, j] = s.stretch.spread[i, j]
    s.kept_s = t - s.stretch_t
    s.turned[0] = 1.0
    s.turned[1] = s.turned[2] = s.turned[3] = 0.0


@inner
def _end_second(
    s: Stretch, t: float, align_s: float, wait_s: float, gyro_limit: float, accel_limit: float, gravity: float
) -> bool:
    """End a second at time t; true when the alignment is over, still or given up, as `phase` says."""
    if _second_is_still(s, gyro_limit, accel_limit, gravity):
        s.was_still = True
        if t - s.stretch_t >= align_s:
            s.phase = STILL
            return True
        _keep(s, t)
    elif s.kept_s > 0.0:
        s.cut_short = True
        s.phase = STILL
        return True
    else:  # the stretch starts again, unless there has been enough of that
        waited = t - s.began_t
        if s.second.samples > 0.0 and (waited >= wait_s or (waited >= MOVING_S and not s.was_still)):
            s.phase = COARSE
            return True
        _clear(s.stretch)
        s.stretch_t = t
    _clear(s.second)
    _forget(s.aids)
    s.second_t = t
    return False


@entry("ppifffff", int)
def align(  # type: ignore[empty-body]
    stretch: Stretch, rows: np.ndarray, count: int, align_s: float, wait_s: float, gyro_limit: float,
    accel_limit: float, gravity: float,
) -> int:  # fmt: skip
    """Take samples (records) until aligned; returns how many were taken, `stretch.phase` says what for."""


@adapts(align)
def _align(owner: None, kernel: Kernel) -> Kernel:
    def body(stretch, rows, count, align_s, wait_s, gyro_limit, accel_limit, gravity):  # type: ignore[no-untyped-def]
        s = record(stretch, STRETCH)
        for k in range(count):
            row = record(rows, SAMPLE, k)
            t = row.t
            if math.isnan(s.began_t):
                s.began_t = s.stretch_t = s.second_t = t
                s.was_still = s.cut_short = False
            elif t <= s.last_t:
                continue
            dt = t - s.last_t
            s.last_t = t
            if t - s.second_t >= 1.0 and _end_second(s, t, align_s, wait_s, gyro_limit, accel_limit, gravity):
                return k
            _watch(s.aids, row)
            imu, mag = True, row.mag_new
            for i in range(3):
                imu &= plausible(row.gyro_b[i], MAX_RATE) and plausible(row.accel_b[i], MAX_FORCE)
                mag &= plausible(row.mag_b[i], MAX_FIELD)
            if imu and s.kept_s > 0.0 and dt < 1.0:
                turn(s.turned, dt * row.gyro_b[0], dt * row.gyro_b[1], dt * row.gyro_b[2], s.turned)
            _gather(s.stretch, row, imu, mag)
            _gather(s.second, row, imu, mag)
        return count

    return body


def pieces(t: np.ndarray, last: float) -> Iterator[tuple[int, int, bool]]:
    """Cut times (n,) s at gaps longer than `LONGEST_GAP`: first and last + 1 of each piece, whether to align anew.

    Args:
        t: times of the rows.
        last: of the row before them; NaN: there is none.
    """
    cuts = np.flatnonzero(np.diff(t, prepend=last) > LONGEST_GAP)
    edges = [0, *(int(c) for c in cuts if c > 0), len(t)]
    for first, end in pairwise(edges):
        yield first, end, first in cuts


def limits(sensors: SensorInfo) -> tuple[float, float]:
    """Scatter (rad/s, m/s2) up to which a second counts as still, for sensors of this noise."""
    gyro = sensors.gyro_noise * math.sqrt(sensors.rate / 2)
    accel = sensors.accel_noise * math.sqrt(sensors.rate / 2)
    return max(GYRO_SCATTER, 2 * gyro), max(ACCEL_SCATTER, 2 * accel)


@dataclass(frozen=True)
class _Motion:
    """What is known of the motion in the last second of a start in motion; nothing when still."""

    force_b: np.ndarray  # (3,) m/s2, specific force less what the known motion adds to gravity's
    force_n: np.ndarray  # (3,) m/s2, what this is in navigation axes
    air_b: np.ndarray  # (3,) m/s, velocity in the air mass
    flying: bool  # with an airspeed
    fixes: bool  # with GNSS velocities


def _motion(s: Stretch, still: bool, rate: np.ndarray, force: np.ndarray, gravity: float) -> _Motion:
    a: Any = s.aids
    flying = not still and a.speed1 > FLYING
    fixes = not still and not flying and a.vel1_t - a.vel0_t > 0.3
    force_n = np.array([0.0, 0.0, -gravity])
    air_b = a.speed1 * np.array([math.cos(INCIDENCE), 0.0, math.sin(INCIDENCE)]) if flying else np.zeros(3)
    if flying:  # a coordinated flight: w x v + dv/dt
        span = a.speed1_t - a.speed0_t
        force = force - np.cross(rate, air_b) - [(a.speed1 - a.speed0) / span if span > 0.3 else 0.0, 0.0, 0.0]
    elif fixes:  # f_n = dv_n/dt - g
        force_n = force_n + (a.vel1_n - a.vel0_n) / (a.vel1_t - a.vel0_t)
    return _Motion(force, force_n, air_b, flying, fixes)


def conclude(s: Stretch, still: bool, site: Site, sensors: SensorInfo) -> Alignment:
    """Conclude the alignment from what `align` has gathered: the whole stretch when still, else the last second."""
    cut = still and bool(s.cut_short)
    seen: Any = s.kept if cut else s.stretch if still else s.second
    aids: Any = s.aids
    rate, force, field = seen.mean[0:3], seen.mean[3:6], seen.mean[6:9]
    mag_n = np.array(site.mag_n, float)
    q_nb, nothing = np.array([1.0, 0.0, 0.0, 0.0]), np.full(3, np.nan)
    # attitude from force and field, or level from the force alone
    motion = _motion(s, still, rate, force, site.gravity)
    force = motion.force_b
    has_heading = seen.fields > 0 and _two_vectors(force, field, motion.force_n, mag_n, q_nb)
    if not has_heading and np.linalg.norm(force) > 0.0:
        from_euler(math.atan2(-force[1], -force[2]), math.atan2(force[0], math.hypot(force[1], force[2])), 0.0, q_nb)
    aided = motion.flying or (motion.fixes and has_heading)
    if aided:  # the means are those of the middle of the second: on to its end
        middle = q_nb.copy()
        half = 0.5 * (s.last_t - s.second_t)
        turn(middle, half * rate[0], half * rate[1], half * rate[2], q_nb)
    if cut:  # on to where the gyro has turned it since, less the bias for as long
        at_rest, since = q_nb.copy(), s.last_t - s.stretch_t - s.kept_s
        multiply(at_rest, s.turned, q_nb)
        turn(q_nb.copy(), *(-since * rate), q_nb)
    # velocity and place, where an aid says them: a filter that starts in motion needs them
    air_n = nothing.copy()
    if motion.flying and has_heading:
        to_nav(q_nb, *motion.air_b, air_n)
    moving = not still and math.isfinite(aids.vel1_t)
    placed = moving and on_earth(*aids.lla)
    sigma_n, bias, bias_sigma = _sigmas(still, aided, has_heading, seen, site, sensors)
    if cut:  # a slow turn or a steady push may have passed for standing
        sigma_n = np.hypot(sigma_n, SHORT_TILT / s.kept_s * np.array([1.0, 1.0, _dip_factor(site)]))
        bias_sigma = np.hypot(bias_sigma, SHORT_RATE / s.kept_s)

    def covariance(sensor: int, n: float) -> np.ndarray:
        block = seen.spread[3 * sensor : 3 * sensor + 3]
        return (block + block.T) / (2 * (n - 1)) if n > 1 else np.full((3, 3), np.nan)

    return Alignment(
        still=still,
        q_nb=q_nb,
        sigma_n=sigma_n,
        gyro_bias=bias,
        gyro_bias_sigma=bias_sigma,
        gyro_cov=covariance(0, seen.samples),
        accel_cov=covariance(1, seen.samples),
        mag_cov=covariance(2, seen.fields),
        vel_n=aids.vel1_n.copy() if moving else nothing,
        lla=aids.lla.copy() if placed else nothing,
        air_n=air_n,
    )


def _sigmas(
    still: bool, aided: bool, has_heading: bool, seen: Any, site: Site, sensors: SensorInfo
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sigmas of the attitude (3,) rad; gyro bias (3,) rad/s and its sigmas: from the data sheet, or coarse."""
    if still:  # biases of the accelerometer tilt it, those of the field and the tilt turn it
        horizontal = math.hypot(site.mag_n[0], site.mag_n[1])
        tilt = math.hypot(sensors.accel_bias / site.gravity, sensors.accel_scale, 1e-3)
        heading = math.hypot(sensors.mag_bias / horizontal, tilt * site.mag_n[2] / horizontal, 5e-3)
        per_sample = sensors.gyro_noise * math.sqrt(sensors.rate / 2)
        bias = seen.mean[0:3].copy()
        # the mean rate has the Earth's in it
        sigma = math.hypot(per_sample / math.sqrt(seen.samples), sensors.gyro_instability, 7.3e-5)
    else:
        tilt, heading = (AIDED_TILT, AIDED_HEADING) if aided else (COARSE_TILT, COARSE_HEADING)
        bias, sigma = np.zeros(3), max(sensors.gyro_bias, 1e-4)
    return np.array([tilt, tilt, heading if has_heading else NO_HEADING]), bias, np.full(3, sigma)


def _dip_factor(site: Site) -> float:
    """Error of heading by that of the vertical it is levelled with."""
    return abs(site.mag_n[2]) / max(math.hypot(site.mag_n[0], site.mag_n[1]), 1e-7)


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
    turned = np.einsum("ij,jk->ik", X, C_bn)  # no BLAS, whose last digit depends on the processor
    block: np.ndarray = 0.25 * np.einsum("ij,j,kj->ik", turned, alignment.sigma_n**2, turned)
    return block
