"""M6: one aided inertial navigator; only its velocity aid changes.

Raw state: `q_nb` (4), velocity NED (3, m/s), latitude, longitude (rad), height (m), gyro bias (3, rad/s), accelerometer
bias (3, m/s2), gyro scale (3), hard iron (3, T), wind NED (3, m/s). Error state in that order, the attitude error phi
in navigation axes, `q = exp_q(phi) (x) q_estimated`, and the position error in metres NED. Three sizes: `Ins15`
(to the accelerometer bias), `Ins21` (to the hard iron), `Ins24` (with the wind).

    q'   = gyro corrected, minus Earth and transport rate
    v'   = C_nb (accel - bias) + g - (2 w_ie + w_en) x v
    phi' = -C_nb (d bias + diag(w) d scale),   d v' = -[C_nb f] x phi - C_nb d bias,   d p' = d v

Aids (`models.base` groups):

    GNSS       velocity and position, differenced with the state kept from the time of the fix (latency)
    still      v = 0 and gyro = bias while a second without scatter says so
    pseudo     hand-held: v = 0 within 1 m/s and p = start within 1 m, ten times a second: replaces an inertial low-pass
    magnetic   heading only (tilt columns zero, for every filter: a disturbed field must not tilt the horizon); norm and
               dip away from the local field inflate the noise
    heading    dual-antenna baseline, also with latency
    airspeed   C_bn (v - wind) = V (cos i, 0, sin i), i the incidence of cruise, wide across; without GNSS v itself is
               the velocity in the air mass

Gyro noise grows with the rate, since what scale and misalignment leave behind is correlated over a manoeuvre, and with
what is too fast for the sampling: after a hard landing the heading is open again. Accelerometer noise grows with the
acceleration. Most of a fix's error wanders over a minute; so does the place that is estimated, which leaves the noise
from fix to fix to the measurement. Field and baseline count once in a while, whatever their rates: errors of theirs are
of the attitude and of the minute, not of the reading.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.alignment import ACCEL_SCATTER, GYRO_SCATTER, MEAN_RATE, Alignment, Start
from estimators.earth import GRAVITY_GRADIENT, apart, frame_rates, move
from estimators.generic import register
from estimators.jit import inner
from estimators.models.base import (
    MAX_FIELD,
    MAX_FORCE,
    MAX_RATE,
    MAX_SPEED,
    ROWS,
    START,
    on_earth,
    plausible,
    report_attitude,
    size,
)
from estimators.past import LENGTH, WIDTH, keep, recall
from estimators.rotations import (
    attitude_matrix,
    nav_vector,
    normalise,
    rotation_between,
    to_body,
    to_nav,
    turn_nav,
    turned,
    wrap,
    yaw,
)
from estimators.rows import (
    ACCEL,
    AIR_NEW,
    AIRSPEED,
    ALPHA,
    BETA,
    E_ACCEL_BIAS,
    E_ACCEL_SIGMA,
    E_ADAPTATION,
    E_COV,
    E_GYRO_BIAS,
    E_GYRO_SIGMA,
    E_LLA,
    E_VEL,
    GNSS_NEW,
    GNSS_T,
    GYRO,
    HEADING,
    HEADING_NEW,
    HEADING_SIGMA,
    HEADING_T,
    LLA,
    MAG,
    MAG_NEW,
    VEL,
    T,
)
from estimators.types import SensorInfo, Site, Status

PHI, V, P_, BG, BA, SG, HI, WIND = 0, 3, 6, 9, 12, 15, 18, 21  # offsets in the error; one more in the raw state
RAW = 25

GNSS, STILL, MAGNETIC, DUAL, AIR = range(5)
_Z_GNSS, _Z_MAG, _Z_DUAL, _Z_AIR, _Z_STILL, MEASUREMENTS_ = 0, 6, 7, 8, 11, 17

# inputs: mean rate and force of the step, field, noise of gyro and accelerometer (variance per second), variance of
# each measurement
_W, _F, _B, _PSD, _FORCE_PSD, _VAR = 0, 3, 6, 9, 10, 11
INPUTS = _VAR + MEASUREMENTS_

# memory: scalars, then the moments of the present second, then a ring of past states
(
    _LAST,
    _GOOD,
    _MAG_T,
    _AID_T,
    _GNSS_T,
    _DUAL_T,
    _AIR_T,
    _PSEUDO_T,
    _STILL_T,
    _IS_STILL,
    _SECOND,
    _COUNT,
    _INFLATION,
    _SPEED,
    _JERKY,
) = range(15)
_LAST_W, _LAST_F, _STEP, _MEAN, _SPREAD, _RING = 15, 18, 21, 24, 30, 36
MEMORY = _RING + LENGTH
_ANGLES = (4, 6)  # of the values of the ring: longitude, yaw

MAG_TIMEOUT, AID_TIMEOUT = 2.0, 2.0  # s
STILL_SPEED = 0.2  # m/s
JERKY_TIME = 0.3  # s, over which the gyro's scatter between samples is averaged
# s: errors of these are correlated, more often says nothing new
AIR_PERIOD, DUAL_PERIOD, PSEUDO_PERIOD, STILL_PERIOD = 0.1, 1.0, 0.1, 0.1
UP = 1.5  # satellites are all above: vertical errors are larger by about that
_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)


class _Parameters(NamedTuple):
    """Parameters of the model, the same for every size."""

    groups: np.ndarray  # (5, 5) int64
    gravity: float  # m/s2 at `origin`
    origin: np.ndarray  # (3,) rad, rad, m
    mag_n: np.ndarray  # (3,) T
    antenna_b: np.ndarray  # (3,) m
    gyro_psd: float  # rad2/s
    rate_noise: float  # 2 tau k^2, s: gyro_psd + rate_noise |w|^2
    accel_psd: float  # m2/s3
    accel_noise2: float  # s, accel_psd + accel_noise2 |a|^2
    jerk_share: float  # gyro_psd + jerk_share dt (variance between samples)
    walks: np.ndarray  # (size - 6,) variance per second of the constants; of the velocity for wind in it
    limits: np.ndarray  # (2,) rad/s, m/s2: scatter of a still second
    gyro_variance: float  # (rad/s)^2 of a sample
    gnss_velocity: float  # m/s
    gnss_position: float  # m, from fix to fix
    place_walk: np.ndarray  # (3,) m2/s: the rest of a fix's error wanders, and the place with it
    gnss_time2: float  # s2, of the time of a fix
    mag_sigma: float  # rad
    field_period: float  # s
    norm_scale: float  # relative
    dip_scale: float  # rad
    heading_factor: float  # on the reported sigma: its error is correlated
    speed_sigma: float  # m/s
    side: float  # of V
    vertical: float  # of V
    speed_min: float  # m/s
    incidence: float  # rad
    use_gnss: int
    use_air: int
    use_heading: int
    pseudo: int


class Ins15(_Parameters):
    """To the accelerometer bias."""


class Ins21(_Parameters):
    """With gyro scale and hard iron."""


class Ins24(_Parameters):
    """With the wind as well."""


def _propagate(model: Any, x: np.ndarray, u: np.ndarray, dt: float, out: np.ndarray) -> None:
    for i in range(10, x.shape[0]):
        out[i] = x[i]
    place, (north, east, down) = (x[7], x[8], x[9]), (x[4], x[5], x[6])
    ie_n, ie_d, en_n, en_e, en_d = frame_rates(place, (north, east, down))
    hx, hy, hz = 0.5 * dt * (u[_W] - x[10]), 0.5 * dt * (u[_W + 1] - x[11]), 0.5 * dt * (u[_W + 2] - x[12])
    if size(model) > SG:
        hx, hy, hz = hx * (1.0 - x[1 + SG]), hy * (1.0 - x[2 + SG]), hz * (1.0 - x[3 + SG])
    half = turned(x, hx, hy, hz)
    turn_nav(turned(half, hx, hy, hz), -(ie_n + en_n) * dt, -en_e * dt, -(ie_d + en_d) * dt, out)
    force_n, force_e, force_d = nav_vector(half, u[_F] - x[13], u[_F + 1] - x[14], u[_F + 2] - x[15])
    wn, we, wd = 2.0 * ie_n + en_n, en_e, 2.0 * ie_d + en_d
    gravity = model.gravity - GRAVITY_GRADIENT * (x[9] - model.origin[2])
    out[4] = north + (force_n - (we * down - wd * east)) * dt
    out[5] = east + (force_e - (wd * north - wn * down)) * dt
    out[6] = down + (force_d + gravity - (wn * east - we * north)) * dt
    move(place, 0.5 * (north + out[4]) * dt, 0.5 * (east + out[5]) * dt, 0.5 * (down + out[6]) * dt, out[7:10])


def _transition(model: Any, x: np.ndarray, u: np.ndarray, dt: float, F: np.ndarray) -> None:
    for a in range(9):
        for k in range(min(18, size(model))):
            F[a, k] = 0.0
        F[a, a] = 1.0
    C = np.empty((3, 3))
    attitude_matrix(x, C)  # C_bn: its rows are the body axes in NED
    north, east, down = nav_vector(x, (u[_F] - x[13]) * dt, (u[_F + 1] - x[14]) * dt, (u[_F + 2] - x[15]) * dt)
    for a in range(3):
        F[P_ + a, V + a] = dt
        for i in range(3):
            F[PHI + a, BG + i] = -C[i, a] * dt
            F[V + a, BA + i] = -C[i, a] * dt
            if size(model) > SG:
                F[PHI + a, SG + i] = -C[i, a] * (u[_W + i] - x[10 + i]) * dt
    F[V, PHI + 1], F[V, PHI + 2] = down, -east
    F[V + 1, PHI], F[V + 1, PHI + 2] = -down, north
    F[V + 2, PHI], F[V + 2, PHI + 1] = east, -north


def _process_noise(model: Any, x: np.ndarray, u: np.ndarray, dt: float, P: np.ndarray) -> None:
    for i in range(3):
        P[PHI + i, PHI + i] += u[_PSD] * dt
        P[V + i, V + i] += u[_FORCE_PSD] * dt
        P[P_ + i, P_ + i] += model.place_walk[i] * dt
    for i in range(9, size(model)):
        P[i, i] += model.walks[i - 9] * dt


def _retract(model: Any, x: np.ndarray, dx: np.ndarray, out: np.ndarray) -> None:
    turn_nav(x, dx[0], dx[1], dx[2], out)
    for i in range(3):
        out[4 + i] = x[4 + i] + dx[3 + i]
    move((x[7], x[8], x[9]), dx[6], dx[7], dx[8], out[7:10])
    for i in range(9, size(model)):
        out[1 + i] = x[1 + i] + dx[i]


def _difference(model: Any, x: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
    back, inverse = (origin[0], -origin[1], -origin[2], -origin[3]), (x[0], -x[1], -x[2], -x[3])
    rotation_between(back, inverse, out)  # x* = origin* (x) exp_q(-phi)
    for i in range(3):
        out[i] = -out[i]
        out[3 + i] = x[4 + i] - origin[4 + i]
    apart((x[7], x[8], x[9]), (origin[7], origin[8], origin[9]), out[6:9])


def _constrain(model: Any, x: np.ndarray) -> None:
    normalise(x)


@inner
def _field_n(model: Any, x: np.ndarray, u: np.ndarray, out: np.ndarray) -> None:
    """Field as the magnetometer and the attitude have it, hard iron removed, in NED."""
    bx, by, bz = u[_B], u[_B + 1], u[_B + 2]
    if size(model) > HI:
        bx, by, bz = bx - x[1 + HI], by - x[2 + HI], bz - x[3 + HI]
    to_nav(x, bx, by, bz, out)


@inner
def _air_velocity(model: Any, x: np.ndarray, out: np.ndarray) -> None:
    """Velocity in the air mass, body axes."""
    north, east, down = x[4], x[5], x[6]
    if size(model) > WIND:
        north, east, down = north - x[1 + WIND], east - x[2 + WIND], down - x[3 + WIND]
    to_body(x, north, east, down, out)


def _observe(model: Any, group: int, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> None:
    """GNSS and heading are differenced with kept states in `measure`, so what is left is the error itself."""
    if group == GNSS:
        for i in range(3):
            y[i] = x[4 + i]
        apart(x[7:10], model.origin, y[3:6])
    elif group == STILL:
        for i in range(3):
            y[i] = x[4 + i]
            y[3 + i] = x[10 + i]
    elif group == MAGNETIC:
        _field_n(model, x, u, y)
        y[0] = math.atan2(y[1], y[0])
    elif group == DUAL:
        y[0] = yaw(x)
    else:
        _air_velocity(model, x, y)


def _slope(model: Any, group: int, x: np.ndarray, u: np.ndarray, H: np.ndarray) -> None:
    for i in range(model.groups[group, ROWS]):
        for j in range(size(model)):
            H[i, j] = 0.0
    if group == GNSS:
        for i in range(3):
            H[i, V + i] = H[3 + i, P_ + i] = 1.0
    elif group == STILL:
        for i in range(3):
            H[i, V + i] = H[3 + i, BG + i] = 1.0
    elif group == MAGNETIC:
        H[0, PHI + 2] = 1.0
        if size(model) > HI:
            C, m = np.empty((3, 3)), np.empty(3)
            attitude_matrix(x, C)
            _field_n(model, x, u, m)
            horizontal2 = m[0] * m[0] + m[1] * m[1]
            for i in range(3):
                H[0, HI + i] = (m[1] * C[i, 0] - m[0] * C[i, 1]) / horizontal2
    elif group == DUAL:
        C = np.empty((3, 3))
        attitude_matrix(x, C)
        horizontal2 = C[0, 0] * C[0, 0] + C[0, 1] * C[0, 1]
        H[0, PHI] = -C[0, 2] * C[0, 0] / horizontal2
        H[0, PHI + 1] = -C[0, 2] * C[0, 1] / horizontal2
        H[0, PHI + 2] = 1.0
    else:
        C, v = np.empty((3, 3)), np.empty(3)
        attitude_matrix(x, C)
        for i in range(3):
            v[i] = x[4 + i]
            if size(model) > WIND:
                v[i] -= x[1 + WIND + i]
        for i in range(3):
            for j in range(3):
                H[i, V + j] = C[i, j]
                if size(model) > WIND:
                    H[i, WIND + j] = -C[i, j]
            # C_bn exp(-phi) v = C_bn (v + v x phi)
            H[i, PHI] = C[i, 1] * v[2] - C[i, 2] * v[1]
            H[i, PHI + 1] = C[i, 2] * v[0] - C[i, 0] * v[2]
            H[i, PHI + 2] = C[i, 0] * v[1] - C[i, 1] * v[0]


def _measurement_noise(model: Any, group: int, x: np.ndarray, u: np.ndarray, S: np.ndarray) -> None:
    start = model.groups[group, START]
    for i in range(model.groups[group, ROWS]):
        S[i, i] += u[_VAR + start + i]


def _residual(model: Any, group: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    for i in range(model.groups[group, ROWS]):
        out[i] = z[i] - y[i]
    if group in (MAGNETIC, DUAL):
        out[0] = wrap(out[0])


@inner
def _acceleration2(model: Any, x: np.ndarray, u: np.ndarray) -> float:
    """Square of the acceleration over the ground, m2/s4."""
    north, east, down = nav_vector(x, u[_F] - x[13], u[_F + 1] - x[14], u[_F + 2] - x[15])
    return float(north**2 + east**2 + (down + model.gravity) ** 2)


def _load(model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray) -> None:
    t = row[T]
    good = True
    for i in range(3):
        good &= plausible(row[GYRO + i], MAX_RATE) and plausible(row[ACCEL + i], MAX_FORCE)
    memory[_GOOD] = 1.0 if good else 0.0
    fresh = math.isfinite(memory[_LAST]) and t - memory[_LAST] < 0.1
    dt = t - memory[_LAST] if fresh else 0.0
    if good:
        _judge_jerks(row, memory, dt)
    for i in range(3):  # the samples at both ends of the step; the last good ones while there are none
        if good:
            u[_W + i] = 0.5 * (row[GYRO + i] + memory[_LAST_W + i]) if fresh else row[GYRO + i]
            u[_F + i] = 0.5 * (row[ACCEL + i] + memory[_LAST_F + i]) if fresh else row[ACCEL + i]
            memory[_LAST_W + i], memory[_LAST_F + i] = row[GYRO + i], row[ACCEL + i]
    if good:
        memory[_LAST] = t
    rate2 = 0.0
    for i in range(3):
        rate2 += (u[_W + i] - x[10 + i]) ** 2
    u[_PSD] = model.gyro_psd + model.rate_noise * rate2 + model.jerk_share * dt * memory[_JERKY]
    u[_FORCE_PSD] = model.accel_psd + model.accel_noise2 * _acceleration2(model, x, u)
    if not good:
        u[_PSD] += 0.01  # 0.1 rad/s/sqrt(Hz): whatever happens meanwhile
    if good:
        _judge_second(model, row, x, memory)


@inner
def _judge_jerks(row: np.ndarray, memory: np.ndarray, dt: float) -> None:
    """Variance of what turns too fast for the sampling (an impact, vibration): a sixth of the second differences'."""
    square = 0.0
    for i in range(3):
        step = row[GYRO + i] - memory[_LAST_W + i] if dt > 0.0 else 0.0
        square += (step - memory[_STEP + i]) ** 2
        memory[_STEP + i] = step
    memory[_JERKY] += min(dt / JERKY_TIME, 1.0) * (square / 18.0 - memory[_JERKY])


@inner
def _judge_second(model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray) -> None:
    """Standstill detector: scatter and mean rate of each second."""
    t = row[T]
    if not t - memory[_SECOND] < 1.0:
        n = memory[_COUNT]
        still = n >= 10.0
        for i in range(3):
            still = still and memory[_SPREAD + i] < n * model.limits[0] ** 2
            still = still and memory[_SPREAD + 3 + i] < n * model.limits[1] ** 2
            still = still and abs(memory[_MEAN + i] - x[10 + i]) < MEAN_RATE
        memory[_IS_STILL] = 1.0 if still else 0.0
        memory[_SECOND], memory[_COUNT] = t, 0.0
        for i in range(6):
            memory[_MEAN + i] = memory[_SPREAD + i] = 0.0
    memory[_COUNT] += 1.0
    for i in range(6):
        value = row[GYRO + i] if i < 3 else row[ACCEL + i - 3]
        off = value - memory[_MEAN + i]
        memory[_MEAN + i] += off / memory[_COUNT]
        memory[_SPREAD + i] += off * (value - memory[_MEAN + i])
    for i in range(3):  # moved off in mid-second
        if abs(row[GYRO + i] - x[10 + i]) > 5.0 * model.limits[0]:
            memory[_IS_STILL] = 0.0


@inner
def _keep(model: Any, t: float, x: np.ndarray, memory: np.ndarray, u: np.ndarray, now: np.ndarray) -> None:
    """`now` (7,) = the antenna's velocity and place, and yaw; kept."""
    a = model.antenna_b
    wx, wy, wz = u[_W] - x[10], u[_W + 1] - x[11], u[_W + 2] - x[12]
    lever, swing = np.empty(3), np.empty(3)
    to_nav(x, a[0], a[1], a[2], lever)
    to_nav(x, wy * a[2] - wz * a[1], wz * a[0] - wx * a[2], wx * a[1] - wy * a[0], swing)
    for i in range(3):
        now[i] = x[4 + i] + swing[i]
    move(x[7:10], lever[0], lever[1], lever[2], now[3:6])
    now[6] = yaw(x)
    keep(memory[_RING:], t, now)


def _measure(
    model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray
) -> int:
    t = row[T]
    for i in range(MEASUREMENTS_):
        used[i] = False
    now, then = np.empty(WIDTH), np.empty(WIDTH)
    _keep(model, t, x, memory, u, now)
    if model.use_gnss == 1 and row[GNSS_NEW] != 0.0:
        _measure_gnss(model, row, x, memory, then, u, z, used)
    if model.pseudo == 1 and not t - memory[_PSEUDO_T] < PSEUDO_PERIOD - 1e-6:
        memory[_PSEUDO_T] = memory[_AID_T] = t
        for i in range(3):
            z[i] = z[3 + i] = 0.0
            u[_VAR + i] = u[_VAR + 3 + i] = 1.0
            used[i] = used[3 + i] = True
    told = model.use_heading == 1 and row[HEADING_NEW] != 0.0 and plausible(row[HEADING], 100.0)
    told = told and not t - memory[_DUAL_T] < DUAL_PERIOD - 1e-6
    if told and recall(memory[_RING:], row[HEADING_T], _ANGLES, then):
        memory[_DUAL_T] = t
        z[_Z_DUAL] = row[HEADING] + (now[6] - then[6])
        sigma = model.heading_factor * row[HEADING_SIGMA]
        u[_VAR + _Z_DUAL] = sigma * sigma
        used[_Z_DUAL] = sigma > 0.0
    if row[MAG_NEW] != 0.0 and not t - memory[_MAG_T] < model.field_period - 1e-6:
        _measure_field(model, row, x, memory, u, z, used)
    flying = False
    if row[AIR_NEW] != 0.0 and plausible(row[AIRSPEED], MAX_SPEED):
        flying = row[AIRSPEED] >= model.speed_min
        if flying and model.use_air == 1 and not t - memory[_AIR_T] < AIR_PERIOD - 1e-6:
            _measure_air(model, row, memory, u, z, used)
    moving = t - memory[_GNSS_T] < 1.0 and memory[_SPEED] > STILL_SPEED + 3.0 * model.gnss_velocity
    if flying or moving:  # a smooth acceleration scatters as little as standing
        memory[_IS_STILL] = 0.0
    if memory[_IS_STILL] == 1.0 and not used[0] and not t - memory[_STILL_T] < STILL_PERIOD - 1e-6:
        memory[_STILL_T] = memory[_AID_T] = t
        for i in range(3):
            z[_Z_STILL + i], z[_Z_STILL + 3 + i] = 0.0, row[GYRO + i]
            u[_VAR + _Z_STILL + i], u[_VAR + _Z_STILL + 3 + i] = 0.05**2, model.gyro_variance
            used[_Z_STILL + i] = used[_Z_STILL + 3 + i] = True
    aided = t - memory[_AID_T] <= AID_TIMEOUT and t - memory[_MAG_T] <= MAG_TIMEOUT
    return _RUNNING if aided and memory[_GOOD] == 1.0 else _COASTING


@inner
def _measure_gnss(
    model: Any,
    row: np.ndarray,
    x: np.ndarray,
    memory: np.ndarray,
    then: np.ndarray,
    u: np.ndarray,
    z: np.ndarray,
    used: np.ndarray,
) -> None:
    if not recall(memory[_RING:], row[GNSS_T], _ANGLES, then):
        return
    there, here = np.empty(3), np.empty(3)
    acceleration2 = _acceleration2(model, x, u)
    apart(row[LLA : LLA + 3], then[3:6], there)
    apart(x[7:10], model.origin, here)
    place = on_earth(row[LLA], row[LLA + 1], row[LLA + 2])
    for i in range(3):
        speed = row[VEL + i]
        z[i] = x[4 + i] + (speed - then[i])
        z[3 + i] = here[i] + there[i]
        wide = UP if i == 2 else 1.0
        u[_VAR + i] = (wide * model.gnss_velocity) ** 2 + model.gnss_time2 * acceleration2
        u[_VAR + 3 + i] = (wide * model.gnss_position) ** 2
        used[i] = plausible(speed, MAX_SPEED)
        used[3 + i] = place and plausible(there[i], 1e6)
    if used[0] and used[1] and used[2]:
        memory[_SPEED] = math.sqrt(row[VEL] ** 2 + row[VEL + 1] ** 2 + row[VEL + 2] ** 2)
        memory[_AID_T] = memory[_GNSS_T] = row[T]


@inner
def _measure_field(
    model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray
) -> None:
    for i in range(3):
        if not plausible(row[MAG + i], MAX_FIELD):
            return
        u[_B + i] = row[MAG + i]
    m = np.empty(3)
    _field_n(model, x, u, m)
    n = model.mag_n
    horizontal, known = math.hypot(m[0], m[1]), math.hypot(n[0], n[1])
    norm, norm_n = math.hypot(horizontal, m[2]), math.hypot(known, n[2])
    if not horizontal > 0.01 * norm:
        return
    off = (norm / norm_n - 1.0) / model.norm_scale
    dip = (math.atan2(m[2], horizontal) - math.atan2(n[2], known)) / model.dip_scale
    wrong = off * off + dip * dip
    memory[_INFLATION] = 1.0 + wrong + 0.1 * wrong * wrong
    sigma = model.mag_sigma * norm_n / known
    z[_Z_MAG] = math.atan2(n[1], n[0])
    u[_VAR + _Z_MAG] = sigma * sigma * memory[_INFLATION]
    used[_Z_MAG] = True
    memory[_MAG_T] = row[T]


@inner
def _measure_air(
    model: Any, row: np.ndarray, memory: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray
) -> None:
    speed = row[AIRSPEED]
    alpha, beta = row[ALPHA], row[BETA]
    side, vertical = model.side, model.vertical
    if plausible(beta, 1.5):
        side = 0.03
    else:
        beta = 0.0
    if plausible(alpha, 1.5):
        vertical = 0.03
    else:
        alpha = model.incidence
    z[_Z_AIR] = speed * math.cos(alpha) * math.cos(beta)
    z[_Z_AIR + 1] = speed * math.sin(beta)
    z[_Z_AIR + 2] = speed * math.sin(alpha) * math.cos(beta)
    u[_VAR + _Z_AIR] = model.speed_sigma**2
    u[_VAR + _Z_AIR + 1] = (side * speed) ** 2
    u[_VAR + _Z_AIR + 2] = (vertical * speed) ** 2
    for i in range(3):
        used[_Z_AIR + i] = True
    memory[_AIR_T] = memory[_AID_T] = row[T]


def _report(model: Any, x: np.ndarray, P: np.ndarray, memory: np.ndarray, row: np.ndarray) -> None:
    report_attitude(x, row)
    C = np.empty((3, 3))
    attitude_matrix(x, C)
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += C[i, a] * P[a, b] * C[j, b]
            row[E_COV + 3 * i + j] = row[E_COV + 3 * j + i] = total
        row[E_GYRO_BIAS + i], row[E_GYRO_SIGMA + i] = x[10 + i], math.sqrt(P[BG + i, BG + i])
        row[E_ACCEL_BIAS + i], row[E_ACCEL_SIGMA + i] = x[13 + i], math.sqrt(P[BA + i, BA + i])
        if model.use_gnss == 1:
            row[E_VEL + i], row[E_LLA + i] = x[4 + i], x[7 + i]
    row[E_ADAPTATION] = memory[_IS_STILL]
    row[E_ADAPTATION + 1] = memory[_INFLATION]


def _fifteen(model: Any) -> int:
    return 15


def _twenty_one(model: Any) -> int:
    return 21


def _twenty_four(model: Any) -> int:
    return 24


def _nine(model: Any) -> int:
    return 9


def _eighteen(model: Any) -> int:
    return 18


def _magnetic(model: Any) -> tuple[int, int, int]:
    return _Z_MAG, _Z_MAG + 1, 2  # reported where nothing else is


for _type, _size, _read in (
    (Ins15, _fifteen, _fifteen),
    (Ins21, _twenty_one, _eighteen),
    (Ins24, _twenty_four, _eighteen),
):
    register(
        _type,
        size=_size,
        changed=_nine,
        read=_read,
        load=_load,
        measure=_measure,
        propagate=_propagate,
        transition=_transition,
        process_noise=_process_noise,
        observe=_observe,
        slope=_slope,
        measurement_noise=_measurement_noise,
        residual=_residual,
        retract=_retract,
        difference=_difference,
        constrain=_constrain,
        report=_report,
        magnetic=_magnetic,
    )


def build(settings: Mapping[str, Any], site: Site, sensors: SensorInfo, alignment: Alignment) -> Start:
    """The model and its first state from settings (see the catalogue), place, sensors and alignment."""
    aid = settings["aiding"]
    n = int(settings["states"])
    use_gnss, use_air = int("gnss" in aid), int("airspeed" in aid)
    if use_gnss and use_air:
        n = 24
    kind = {15: Ins15, 21: Ins21, 24: Ins24}[n]
    groups = np.array(
        [[_Z_GNSS, 6, V, BG, 1], [_Z_STILL, 6, V, BA, 1], [_Z_MAG, 1, 0, min(n, WIND), 1], [_Z_DUAL, 1, 0, 3, 1],
         [_Z_AIR, 3, 0, n if n > WIND else P_, 1]], np.int64
    )  # fmt: skip
    horizontal = math.hypot(site.mag_n[0], site.mag_n[1])
    gyro = sensors.gyro_noise**2 / 2.0  # single-sided density d: variance d^2/2 per second
    accel = sensors.accel_noise**2 / 2.0
    walk = settings["bias_time"]
    walks = np.zeros(n - 9)
    walks[0:3] = 2.0 * sensors.gyro_instability**2 / walk + 1e-14
    walks[3:6] = 2.0 * (0.1 * sensors.accel_bias) ** 2 / walk + 1e-12
    initial = np.zeros(n)
    still = alignment.still
    initial[PHI : PHI + 3] = alignment.sigma_n
    velocity, place = (alignment.vel_n, alignment.lla) if use_gnss else (alignment.air_n, np.full(3, np.nan))
    known = bool(np.isfinite(velocity).all())  # moving, and told how fast
    initial[V : V + 3] = 0.1 if still else 3.0 if known else 30.0
    initial[P_ : P_ + 3] = 100.0 if use_gnss else 1.0
    initial[BG : BG + 3] = alignment.gyro_bias_sigma
    initial[BA : BA + 3] = math.hypot(sensors.accel_bias, sensors.accel_scale * site.gravity, 1e-3)
    if n > SG:
        initial[SG : SG + 3] = max(sensors.gyro_scale, 1e-5)
        initial[HI : HI + 3] = max(sensors.mag_bias, 1e-4 * horizontal)
        walks[SG - 9 : SG - 6] = 1e-12
        walks[HI - 9 : HI - 6] = (1e-3 * horizontal) ** 2 / 100.0
    if n > WIND:
        initial[WIND : WIND + 2], initial[WIND + 2] = 8.0, 0.5
        walks[WIND - 9 : WIND - 7], walks[WIND - 7] = settings["wind_walk"] ** 2, (0.3 * settings["wind_walk"]) ** 2
    x = np.zeros(RAW)[: n + 1].copy()
    x[0:4] = alignment.q_nb
    x[4:7] = velocity if known else 0.0
    x[7:10] = place if np.isfinite(place).all() else site.lla
    x[10:13] = alignment.gyro_bias
    wind_in_velocity = settings["wind_walk"] ** 2 if use_air and not use_gnss else 0.0
    wander = use_gnss * 2.0 * sensors.gnss_pos**2 / settings["position_time"]
    model = kind(
        groups=groups,
        gravity=float(site.gravity),
        origin=np.array(site.lla, float),
        mag_n=np.array(site.mag_n, float),
        antenna_b=np.array(sensors.antenna_b, float),
        gyro_psd=gyro + settings["gyro_noise"] ** 2 / 2.0,
        rate_noise=2.0 * settings["scale_time"] * (settings["scale_share"] * sensors.gyro_scale) ** 2,
        accel_psd=accel + settings["accel_noise"] ** 2 / 2.0 + wind_in_velocity,
        accel_noise2=settings["accel_share"] ** 2 / 2.0,
        jerk_share=settings["jerk_share"],
        walks=walks,
        limits=np.array(
            [max(GYRO_SCATTER, 2 * sensors.gyro_noise * math.sqrt(sensors.rate / 2)),
             max(ACCEL_SCATTER, 2 * sensors.accel_noise * math.sqrt(sensors.rate / 2))]
        ),
        gyro_variance=max(gyro * sensors.rate, 1e-10),
        gnss_velocity=max(settings["velocity_share"] * sensors.gnss_vel, 1e-3),
        gnss_position=max(settings["position_share"] * sensors.gnss_pos, 1e-3),
        place_walk=1e-6 + wander * np.array([1.0, 1.0, UP**2]),
        gnss_time2=settings["gnss_time"] ** 2,
        mag_sigma=math.hypot(settings["mag_sigma"], settings["mag_share"] * sensors.mag_bias / math.hypot(*site.mag_n)),
        field_period=settings["field_period"],
        norm_scale=settings["norm_scale"],
        dip_scale=settings["dip_scale"],
        heading_factor=settings["heading_share"],
        speed_sigma=settings["speed_sigma"],
        side=settings["side"],
        vertical=settings["vertical"],
        speed_min=settings["speed_min"],
        incidence=settings["incidence"],
        use_gnss=use_gnss,
        use_air=use_air,
        use_heading=int(settings["heading_aid"]),
        pseudo=int(aid == "none"),
    )  # fmt: skip
    memory = np.full(MEMORY, np.nan)
    memory[[_IS_STILL, _COUNT, _JERKY]], memory[_GOOD] = 0.0, 1.0
    memory[_STEP : _STEP + 3] = 0.0
    restart = np.array(initial)
    restart[PHI : PHI + 3], restart[V : V + 3] = 0.5, 10.0
    P, P_restart = np.diag(initial**2), np.diag(restart**2)
    return Start(model, x, P, P_restart, memory=memory, inputs=INPUTS, measurements=MEASUREMENTS_)
