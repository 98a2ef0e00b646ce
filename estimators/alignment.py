"""Initial attitude, gyro bias and sensor noise from a stationary stretch.

Each second of the stretch is classified: still when gyro and accelerometer scatter no more than their noise, the
gyro's mean could be its bias (a great one where the field does not turn with it) and the accelerometer's mean
gravity. `align_s` still seconds in a row give the alignment: attitude by TRIAD from mean specific force and mean
field (down exactly, heading from the field), bias from the mean rate, noise covariances from the scatter. Motion
before that ends it, too, when there was a still second: what was still is the alignment, with larger sigmas, and is
turned on by the gyro to where the motion has come. Without stillness the alignment is coarse, from the means of the
last second, with a large covariance, after `MOVING_S` (started in the air). Moving, specific force is not gravity:
with an airspeed what a coordinated flight adds, w x v + dv/dt, is taken off it, and with GNSS two velocities say it
in navigation axes, f_n = dv_n/dt - g. That brings a start in a turn from the angle of bank to a few degrees.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated

import numpy as np

from estimators.elementary import atan2, hypot
from estimators.jit import inner
from estimators.native import (
    Flag,
    Integer,
    Kernel,
    Matrix3,
    Number,
    Record,
    Vector3,
    Vector4,
    adapts,
    entry,
    loaded,
    local,
    passed,
    record,
    shaped,
)
from estimators.plausible import MAX_FIELD, MAX_FORCE, MAX_RATE, MAX_SPEED, on_earth, plausible
from estimators.records import PLACE, SHEET, Place, Sample, Sheet
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
MEAN_RATE = math.radians(1.5)  # rad/s: more than a turn-on bias is a turn, unless the field stays where it is
GREATEST_BIAS = math.radians(15.0)  # rad/s
COARSE_TILT, COARSE_HEADING, NO_HEADING = math.radians(20.0), math.radians(45.0), math.radians(104.0)  # sigmas
AIDED_TILT, AIDED_HEADING = math.radians(5.0), math.radians(12.0)  # of a start in motion with a velocity aid


class Alignment(Record):
    """Holds the averages of a stationary stretch (coarse: of the last second before the wait ended)."""

    still: Flag
    moving: Flag  # at its end: it never stood, or has set off since
    q_nb: Vector4
    sigma_n: Vector3  # rad, of a rotation about north, east, down
    gyro_bias: Vector3  # rad/s
    gyro_bias_sigma: Vector3
    gyro_cov: Matrix3  # of single samples
    accel_cov: Matrix3
    mag_cov: Matrix3  # NaN without magnetometer
    vel_n: Vector3  # m/s, GNSS at the end of a start in motion, else NaN
    lla: Vector3  # rad, rad, m, likewise
    air_n: Vector3  # m/s, velocity in the air mass, likewise from the airspeed


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
    """Holds the alignment's memory from row to row; times are NaN before the first."""

    began_t: Number  # s, first row of all
    stretch_t: Number  # s, begin of the stationary stretch
    second_t: Number  # s, begin of the present second
    last_t: Number  # s, last row
    was_still: Flag  # a second was still
    phase: Integer  # ALIGNING, STILL or COARSE
    stretch: Moments  # since the stretch began
    second: Moments  # of the present second
    before: Vector3  # T, mean field of the second before it
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
_AHEAD, _BELOW = math.cos(INCIDENCE), math.sin(INCIDENCE)
ALIGNING, STILL, COARSE = range(3)
NOTHING, FLIGHT, FIXES = range(3)  # known of the motion: an airspeed, or GNSS velocities
STRETCH, ALIGNMENT = Stretch.dtype, Alignment.dtype


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
def begin(s: Stretch) -> None:
    """Forget the stretch, as `Stretch.make` makes it."""
    s.began_t = s.stretch_t = s.second_t = s.last_t = math.nan
    s.was_still = s.cut_short = False
    s.phase = ALIGNING
    _clear(s.stretch)
    _clear(s.second)
    _clear(s.kept)
    _forget(s.aids)
    s.kept_s = 0.0
    s.before[0] = s.before[1] = s.before[2] = math.nan
    s.turned[0] = 1.0
    s.turned[1] = s.turned[2] = s.turned[3] = 0.0


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
    """Tell from GNSS speed, or else airspeed, that the vehicle moves: smooth flight scatters as little as standing."""
    v = aids.vel1_n
    moving: bool = aids.speed1 > FLYING
    if math.isfinite(aids.vel1_t):
        moving = v[0] ** 2 + v[1] ** 2 + v[2] ** 2 > MOVING**2
    return moving


@inner
def _turn_is_bias(s: Stretch) -> bool:
    """Tell that the gyro's rate is a bias: the field stays where it is while several degrees a second are reported."""
    m, b = s.second, s.before
    if m.fields < 1.0:
        return False
    w0, w1, w2 = m.mean[0], m.mean[1], m.mean[2]
    f0, f1, f2 = m.mean[6], m.mean[7], m.mean[8]
    across = math.sqrt((w1 * f2 - w2 * f1) ** 2 + (w2 * f0 - w0 * f2) ** 2 + (w0 * f1 - w1 * f0) ** 2)  # in a second
    change = math.sqrt((f0 - b[0]) ** 2 + (f1 - b[1]) ** 2 + (f2 - b[2]) ** 2)  # NaN: nothing before, and none is known
    seen = across > 0.01 * math.sqrt(f0**2 + f1**2 + f2**2)
    bias: bool = seen and change < 0.2 * across and w0**2 + w1**2 + w2**2 < GREATEST_BIAS**2
    return bias


@inner
def _second_is_still(s: Stretch, gyro_limit: float, accel_limit: float, gravity: float) -> bool:
    """Tell that a second is still: noise explains the scatter, a bias the rate, and gravity the force."""
    m = s.second
    n = m.samples
    if n < 2.0 or _is_moving(s.aids):
        return False
    norm2, fast = 0.0, False
    for i in range(3):
        norm2 += m.mean[3 + i] ** 2
        fast |= abs(m.mean[i]) > MEAN_RATE
        if m.spread[i, i] > (n - 1.0) * gyro_limit**2 or m.spread[3 + i, i] > (n - 1.0) * accel_limit**2:
            return False
    if fast and not _turn_is_bias(s):
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
    for i in range(3):
        s.before[i] = s.second.mean[6 + i] if s.second.fields > 0.0 else math.nan
    _clear(s.second)
    _forget(s.aids)
    s.second_t = t
    return False


@inner
def take(
    s: Stretch, row: Sample, align_s: float, wait_s: float, gyro_limit: float, accel_limit: float, gravity: float
) -> bool:  # fmt: skip
    """Take a sample; true, and the sample not taken, when the alignment is over before it: `phase` says how."""
    t = row.t
    if math.isnan(s.began_t):
        s.began_t = s.stretch_t = s.second_t = t
        s.was_still = s.cut_short = False
    elif t <= s.last_t:
        return False
    dt = t - s.last_t
    s.last_t = t
    if t - s.second_t >= 1.0 and _end_second(s, t, align_s, wait_s, gyro_limit, accel_limit, gravity):
        return True
    _watch(s.aids, row)
    imu, mag = True, row.mag_new
    for i in range(3):
        imu &= plausible(row.gyro_b[i], MAX_RATE) and plausible(row.accel_b[i], MAX_FORCE)
        mag &= plausible(row.mag_b[i], MAX_FIELD)
    if imu and s.kept_s > 0.0 and dt < 1.0:
        turn(s.turned, dt * row.gyro_b[0], dt * row.gyro_b[1], dt * row.gyro_b[2], s.turned)
    _gather(s.stretch, row, imu, mag)
    _gather(s.second, row, imu, mag)
    return False


def limits(sensors: SensorInfo | Sheet) -> tuple[float, float]:
    """Scatter (rad/s, m/s2) up to which a second counts as still, for sensors of this noise."""
    gyro = sensors.gyro_noise * math.sqrt(sensors.rate / 2)
    accel = sensors.accel_noise * math.sqrt(sensors.rate / 2)
    return max(GYRO_SCATTER, 2 * gyro), max(ACCEL_SCATTER, 2 * accel)


still_limits = inner(limits)


@inner
def _motion(s: Stretch, still: bool, rate: np.ndarray, force: np.ndarray, gravity: float, expected: np.ndarray) -> int:
    """Take what is known of the motion off the force of the last second, or add it to the `expected` one; which."""
    a = s.aids
    expected[0] = expected[1] = 0.0
    expected[2] = -gravity
    if still:
        return NOTHING
    if a.speed1 > FLYING:  # a coordinated flight: w x v + dv/dt
        ahead, down = a.speed1 * _AHEAD, a.speed1 * _BELOW
        span = a.speed1_t - a.speed0_t
        force[0] = force[0] - rate[1] * down - ((a.speed1 - a.speed0) / span if span > 0.3 else 0.0)
        force[1] = force[1] - (rate[2] * ahead - rate[0] * down)
        force[2] = force[2] + rate[1] * ahead
        return FLIGHT
    if a.vel1_t - a.vel0_t > 0.3:  # f_n = dv_n/dt - g
        for i in range(3):
            expected[i] += (a.vel1_n[i] - a.vel0_n[i]) / (a.vel1_t - a.vel0_t)
        return FIXES
    return NOTHING


@inner
def _covariance(m: Moments, sensor: int, n: float, out: np.ndarray) -> None:
    """Covariance of single samples of a sensor; NaN of less than two."""
    first = 3 * sensor
    for i in range(3):
        for j in range(3):
            both = m.spread[first + i, j] + m.spread[first + j, i]
            out[i, j] = both / (2.0 * (n - 1.0)) if n > 1.0 else math.nan


@inner
def _attitude(s: Stretch, m: Moments, still: bool, site: Place, out: Alignment) -> tuple[int, bool]:
    """Attitude from force and field, or level from the force alone; what motion was known, and whether a heading is."""
    force, expected, field = local(3), local(3), local(3)
    for i in range(3):
        force[i], field[i] = m.mean[3 + i], m.mean[6 + i]
    known = _motion(s, still, m.mean, force, site.gravity, expected)
    q = out.q_nb
    q[0] = 1.0
    q[1] = q[2] = q[3] = 0.0
    has_heading = m.fields > 0.0 and _two_vectors(force, field, expected, site.mag_n, q)
    x, y, z = force[0], force[1], force[2]
    if not has_heading and math.sqrt(x * x + y * y + z * z) > 0.0:
        from_euler(atan2(-y, -z), atan2(x, hypot(y, z)), 0.0, q)
    return known, has_heading


@inner
def conclude(s: Stretch, still: bool, site: Place, sensors: Sheet, out: Alignment) -> None:
    """Conclude the alignment from what was taken: the whole stretch when still, else the last second."""
    cut = still and s.cut_short
    m = s.kept if cut else s.stretch if still else s.second
    known, has_heading = _attitude(s, m, still, site, out)
    aided = known == FLIGHT or (known == FIXES and has_heading)
    q, rate = out.q_nb, m.mean
    if aided:  # the means are those of the middle of the second: on to its end
        half = 0.5 * (s.last_t - s.second_t)
        turn(q, half * rate[0], half * rate[1], half * rate[2], q)
    if cut:  # on to where the gyro has turned it since, less the bias for as long
        at_rest, since = local(4), s.last_t - s.stretch_t - s.kept_s
        for i in range(4):
            at_rest[i] = q[i]
        multiply(at_rest, s.turned, q)
        turn(q, -since * rate[0], -since * rate[1], -since * rate[2], q)
    # velocity and place, where an aid says them: a filter that starts in motion needs them
    a = s.aids
    out.still, out.moving = still, cut or not still
    timed = (cut or not still) and math.isfinite(a.vel1_t)
    placed = timed and on_earth(a.lla[0], a.lla[1], a.lla[2])
    for i in range(3):
        out.vel_n[i] = a.vel1_n[i] if timed else math.nan
        out.lla[i] = a.lla[i] if placed else math.nan
        out.air_n[i] = math.nan
    if (known == FLIGHT or (cut and a.speed1 > FLYING)) and has_heading:
        to_nav(q, a.speed1 * _AHEAD, 0.0, a.speed1 * _BELOW, out.air_n)
    _sigmas(still, aided, has_heading, m, site, sensors, out)
    if cut:  # a slow turn or a steady push may have passed for standing
        for i in range(3):
            slow = SHORT_TILT / s.kept_s * (_dip_factor(site) if i == 2 else 1.0)
            out.sigma_n[i] = hypot(out.sigma_n[i], slow)
            out.gyro_bias_sigma[i] = hypot(out.gyro_bias_sigma[i], SHORT_RATE / s.kept_s)
    _covariance(m, 0, m.samples, out.gyro_cov)
    _covariance(m, 1, m.samples, out.accel_cov)
    _covariance(m, 2, m.fields, out.mag_cov)


@inner
def _sigmas(
    still: bool, aided: bool, has_heading: bool, m: Moments, site: Place, sensors: Sheet, out: Alignment
) -> None:  # fmt: skip
    """Gyro bias, and sigmas of it and of the attitude: from the data sheet, or coarse."""
    tilt = AIDED_TILT if aided else COARSE_TILT
    heading = AIDED_HEADING if aided else COARSE_HEADING
    sigma = max(sensors.gyro_bias, 1e-4)
    if still:  # biases of the accelerometer tilt it, those of the field and the tilt turn it
        horizontal = hypot(site.mag_n[0], site.mag_n[1])
        tilt = hypot(hypot(sensors.accel_bias / site.gravity, sensors.accel_scale), 1e-3)
        heading = hypot(hypot(sensors.mag_bias / horizontal, tilt * site.mag_n[2] / horizontal), 5e-3)
        per_sample = sensors.gyro_noise * math.sqrt(sensors.rate / 2)
        # the mean rate has the Earth's in it
        sigma = hypot(hypot(per_sample / math.sqrt(m.samples), sensors.gyro_instability), 7.3e-5)
    out.sigma_n[0] = out.sigma_n[1] = tilt
    out.sigma_n[2] = heading if has_heading else NO_HEADING
    for i in range(3):
        out.gyro_bias[i] = m.mean[i] if still else 0.0
        out.gyro_bias_sigma[i] = sigma


@inner
def _dip_factor(site: Place) -> float:
    """Error of heading by that of the vertical it is levelled with."""
    slope: float = abs(site.mag_n[2]) / max(hypot(site.mag_n[0], site.mag_n[1]), 1e-7)
    return slope


@inner
def _two_vectors(
    force_b: np.ndarray, field_b: np.ndarray, force_n: np.ndarray, mag_n: np.ndarray, q_nb: np.ndarray
) -> bool:
    """`q_nb` (4,) from specific force, exactly, and field; False, and `q_nb` as it was, when they do not tell.

    TRIAD in axes whose down is -force_n, reached from NED by the shortest rotation.
    """
    norm = math.sqrt(force_n[0] ** 2 + force_n[1] ** 2 + force_n[2] ** 2)
    q, down_b, mag, q_of_these = local(4), local(3), local(3), local(4)
    q[0], q[1], q[2], q[3] = 1.0 - force_n[2] / norm, force_n[1] / norm, -force_n[0] / norm, 0.0  # (0, 0, 1) to down
    norm = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
    for i in range(3):
        q[i] /= norm
        down_b[i] = -force_b[i]
    to_body(q, mag_n[0], mag_n[1], mag_n[2], mag)
    if not triad(down_b, field_b, mag, q_of_these):
        return False
    multiply(q, q_of_these, q_nb)
    return True


@inner
def turned_sigmas(alignment: Alignment, scale: float, out: np.ndarray) -> None:
    """Set `out[:3, :3]` to the covariance `scale C_bn s^2 C_nb` in body axes that belongs to `sigma_n`."""
    C, s = local(3, 3), alignment.sigma_n
    attitude_matrix(alignment.q_nb, C)
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += C[i, k] * (s[k] * s[k]) * C[j, k]
            out[i, j] = scale * total


@inner
def attitude_block(alignment: Alignment, out: np.ndarray) -> None:
    """Set `out[:4, :4]` to the covariance of the elements of q_nb for `sigma_n`: `1/4 X C_bn s^2 C_nb X^T`."""
    a, b, c, d = alignment.q_nb[0], alignment.q_nb[1], alignment.q_nb[2], alignment.q_nb[3]
    C, T, s = local(3, 3), local(4, 3), alignment.sigma_n
    attitude_matrix(alignment.q_nb, C)
    for j in range(3):
        x, y, z = C[0, j], C[1, j], C[2, j]
        T[0, j] = -b * x + -c * y + -d * z
        T[1, j] = a * x + -d * y + c * z
        T[2, j] = d * x + a * y + -b * z
        T[3, j] = -c * x + b * y + a * z
    for i in range(4):
        for k in range(4):
            total = 0.0
            for j in range(3):
                total += T[i, j] * (s[j] * s[j]) * T[k, j]
            out[i, k] = 0.25 * total


# Outside of the loop


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


@entry("pippp")
def _concluded(stretch: Stretch, still: int, site: Place, sensors: Sheet, out: Alignment) -> None:
    """See `conclude`."""


@adapts(_concluded)
def _adapt_concluded(owner: None, kernel: Kernel) -> Kernel:
    def body(stretch, still, site, sensors, out):  # type: ignore[no-untyped-def]
        a, b, c = record(stretch, STRETCH), record(site, PLACE), record(sensors, SHEET)
        conclude(a, still != 0, b, c, record(out, ALIGNMENT))

    return body


def concluded(s: Stretch, still: bool, site: Site, sensors: SensorInfo) -> Alignment:
    """Conclude the alignment from what `align` has taken: the whole stretch when still, else the last second."""
    out, place, sheet = Alignment.zeros(), Place.from_site(site), Sheet.from_info(sensors)
    call = loaded(_concluded, "alignment")
    call(*passed(s), int(still), *passed(place, sheet, out))
    return out
