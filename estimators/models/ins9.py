"""M4: loosely coupled inertial navigation with satellites, nine states and no sensor biases (paper 001).

Raw state: `q_nb` (4), latitude, longitude (rad), height (m), velocity NED (3, m/s). Error (9): attitude as generalised
Rodrigues parameters in body axes, place (m NED), velocity (m/s). With the quaternion (dq4, dp) of an error rotation

    p = f dp/(a + dq4),   f = 2 (a + 1),   0 <= a <= 1                                          eq. (4)
    dq4 = (-a p^2 + f sqrt(f^2 + (1 - a^2) p^2))/(f^2 + p^2),   dp = (a + dq4) p/f               eq. (16)

and `q = q_estimated (x) dq`: p is the rotation vector for small errors. Filters see errors only, the quaternion itself
is propagated (USQUE, eq. (15)-(20)), with the strapdown equations on WGS84: Earth rate, transport rate, normal gravity,
eq. (5)-(9).

Measurements: place and velocity, and a heading, chosen by the number of satellites (section 3.1):

    6 or more    heading of the dual-antenna baseline; where it does not come (not fitted, no solution) the course
    4 or 5       course over ground atan2(v_E, v_N) of the velocity less the known wind; refused by the adaptation
                 `switched` while turning; its variance has `drift_sigma` in it, the angle of drift
    fewer        inertial only

All are compared with the state of their own time (latency), the antennas' places are taken into account.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.alignment import Alignment, Start
from estimators.earth import EARTH_RATE, GRAVITY_GRADIENT, apart, frame_rates, move, normal_gravity, radii
from estimators.generic import register
from estimators.jit import njit
from estimators.models.attitude_error import mean_rate, rotation_slopes
from estimators.models.base import MAX_FORCE, MAX_SPEED, on_earth, plausible, report_attitude
from estimators.past import LENGTH, WIDTH, keep, recall
from estimators.rotations import attitude_matrix, multiply, normalise, to_nav, turn, wrap, yaw
from estimators.rows import (
    ACCEL,
    E_COV,
    E_LLA,
    E_VEL,
    GNSS_NEW,
    GNSS_T,
    HEADING,
    HEADING_NEW,
    HEADING_SIGMA,
    HEADING_T,
    LLA,
    SATELLITES,
    VEL,
    T,
)
from estimators.types import SensorInfo, Site, Status

ATTITUDE, PLACE, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9)  # of the error; the raw state has one more in front
FIX, ANTENNA, COURSE = range(3)  # groups
_Z_HEADING, _Z_COURSE, MEASUREMENTS_ = 6, 7, 8
# inputs: mean rate and force of the step, variance of the heading, of the course
_W, _F, _VAR, INPUTS = 0, 3, 6, 8
# memory, after the last rate: last force, when satellites and a heading were last there, when the antennas'
_FORCE, _FIX_T, _HEADING_T, _ANTENNA_T, _RING = 3, 6, 7, 8, 9
MEMORY = _RING + LENGTH
_ANGLES = (6,)  # of the values of the ring
FIX_TIMEOUT, HEADING_TIMEOUT, ANTENNA_TIMEOUT = 2.0, 5.0, 1.0  # s
ENOUGH_FOR_HEADING, ENOUGH_FOR_FIX = 6.0, 4.0  # satellites
_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)


class Ins9(NamedTuple):
    """Parameters of the model."""

    groups: np.ndarray  # (3, 5) int64: place and velocity, antenna heading, course
    origin: np.ndarray  # (3,) rad, rad, m: places are measured from here
    a: float  # of the Rodrigues parameters
    gyro_bias: np.ndarray  # (3,) rad/s, from the alignment, for good: no state corrects it
    antenna_b: np.ndarray  # (3,) m
    gyro_psd: float  # rad2/s
    accel_psd: float  # m2/s3
    place_variance: float  # m2
    velocity_variance: float  # (m/s)^2
    heading_share: float  # of the reported sigma
    drift_variance: float  # rad2
    course_speed: float  # m/s
    wind_n: np.ndarray  # (2,) m/s
    use_heading: int


def _load(model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray) -> None:
    mean_rate(row, memory, u)
    there = True
    for i in range(3):
        u[i] -= model.gyro_bias[i]
        there &= plausible(row[ACCEL + i], MAX_FORCE)
    for i in range(3):
        last = memory[_FORCE + i]
        now = row[ACCEL + i] if there else last
        if math.isnan(last):
            last = now
        u[_F + i] = 0.5 * (last + now) if math.isfinite(now) else 0.0
        memory[_FORCE + i] = now


@njit
def _keep(model: Any, t: float, x: np.ndarray, memory: np.ndarray, u: np.ndarray, now: np.ndarray) -> None:
    """`now` (7,) = the antenna's place (m from the origin) and velocity, and yaw; kept."""
    a, lever = model.antenna_b, np.empty(3)
    to_nav(x, a[0], a[1], a[2], lever)
    apart(x[4:7], model.origin, now)
    swing = np.empty(3)
    to_nav(x, u[1] * a[2] - u[2] * a[1], u[2] * a[0] - u[0] * a[2], u[0] * a[1] - u[1] * a[0], swing)
    for i in range(3):
        now[i] += lever[i]
        now[3 + i] = x[7 + i] + swing[i]
    now[6] = yaw(x)
    keep(memory[_RING:], t, now)


def _measure(
    model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray
) -> int:
    t = row[T]
    now, then = np.empty(WIDTH), np.empty(WIDTH)
    _keep(model, t, x, memory, u, now)
    for i in range(MEASUREMENTS_):
        used[i] = False
    satellites = row[SATELLITES]
    if math.isnan(satellites):
        satellites = ENOUGH_FOR_HEADING  # a receiver that does not say
    if row[GNSS_NEW] != 0.0 and satellites >= ENOUGH_FOR_FIX and recall(memory[_RING:], row[GNSS_T], _ANGLES, then):
        _measure_fix(model, row, x, memory, now, then, z, used)
    if model.use_heading == 1:
        new = row[HEADING_NEW] != 0.0 and satellites >= ENOUGH_FOR_HEADING and plausible(row[HEADING], 100.0)
        if new and recall(memory[_RING:], row[HEADING_T], _ANGLES, then):
            z[_Z_HEADING] = row[HEADING] + (now[6] - then[6])
            u[_VAR] = (model.heading_share * row[HEADING_SIGMA]) ** 2
            used[_Z_HEADING] = u[_VAR] > 0.0
            if used[_Z_HEADING]:
                memory[_HEADING_T] = memory[_ANTENNA_T] = t
        antenna = satellites >= ENOUGH_FOR_HEADING and t - memory[_ANTENNA_T] <= ANTENNA_TIMEOUT
        if used[3] and not antenna and recall(memory[_RING:], row[GNSS_T], _ANGLES, then):
            north, east = row[VEL] - model.wind_n[0], row[VEL + 1] - model.wind_n[1]
            speed = math.hypot(north, east)
            if speed >= model.course_speed:
                z[_Z_COURSE] = math.atan2(east, north) + (now[6] - then[6])
                u[_VAR + 1] = model.velocity_variance / (speed * speed) + model.drift_variance
                used[_Z_COURSE] = True
                memory[_HEADING_T] = t
    aided = t - memory[_FIX_T] <= FIX_TIMEOUT
    if model.use_heading == 1:
        aided &= t - memory[_HEADING_T] <= HEADING_TIMEOUT
    return _RUNNING if aided else _COASTING


@njit
def _measure_fix(
    model: Any,
    row: np.ndarray,
    x: np.ndarray,
    memory: np.ndarray,
    now: np.ndarray,
    then: np.ndarray,
    z: np.ndarray,
    used: np.ndarray,
) -> None:
    """Place and velocity of the state itself: what the receiver says of the antenna then, less what was kept of it."""
    here, there = np.empty(3), np.empty(3)
    apart(x[4:7], model.origin, here)
    apart(row[LLA : LLA + 3], model.origin, there)
    place = on_earth(row[LLA], row[LLA + 1], row[LLA + 2])
    for i in range(3):
        z[i] = here[i] + (there[i] - then[i])
        z[3 + i] = x[7 + i] + (row[VEL + i] - then[3 + i])
        used[i], used[3 + i] = place and plausible(there[i], 1e7), plausible(row[VEL + i], MAX_SPEED)
    if used[3] and used[4] and used[5]:
        memory[_FIX_T] = row[T]


def _propagate(model: Any, x: np.ndarray, u: np.ndarray, dt: float, out: np.ndarray) -> None:
    north, east, down = x[7], x[8], x[9]
    ie_n, ie_d, en_n, en_e, en_d = frame_rates(x[4:7], x[7:10])
    half, body, frame = np.empty(4), np.empty(4), np.empty(4)
    turn(x, 0.5 * u[0] * dt, 0.5 * u[1] * dt, 0.5 * u[2] * dt, half)
    turn(x, u[0] * dt, u[1] * dt, u[2] * dt, body)
    frame[0], frame[1], frame[2], frame[3] = 1.0, 0.0, 0.0, 0.0
    still = np.empty(4)
    turn(frame, -(ie_n + en_n) * dt, -en_e * dt, -(ie_d + en_d) * dt, still)
    multiply(still, body, out)
    force = np.empty(3)
    to_nav(half, u[_F], u[_F + 1], u[_F + 2], force)
    wn, we, wd = 2.0 * ie_n + en_n, en_e, 2.0 * ie_d + en_d
    out[7] = north + (force[0] - (we * down - wd * east)) * dt
    out[8] = east + (force[1] - (wd * north - wn * down)) * dt
    out[9] = down + (force[2] + normal_gravity(x[4], x[6]) - (wn * east - we * north)) * dt
    step = 0.5 * dt
    move(x[4:7], step * (north + out[7]), step * (east + out[8]), step * (down + out[9]), out[4:7])


def _transition(model: Any, x: np.ndarray, u: np.ndarray, dt: float, F: np.ndarray) -> None:
    """Left out: how transport rate and gravity change with the place but for the height, 1e-9 of anything else."""
    for a in range(9):
        for k in range(9):
            F[a, k] = 0.0
    latitude, height = x[4], x[6]
    along, across = radii(latitude)
    r_n, r_e, tangent = 1.0 / (along + height), 1.0 / (across + height), math.tan(latitude)
    north, east, down = x[7], x[8], x[9]
    wn, we = 2.0 * EARTH_RATE * math.cos(latitude) + east * r_e, -north * r_n
    wd = -2.0 * EARTH_RATE * math.sin(latitude) - east * r_e * tangent
    half, E, J, C, M = np.empty(4), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    turn(x, u[0] * dt, u[1] * dt, u[2] * dt, half)
    attitude_matrix(half, C)  # C_bn at the end of the step
    rotation_slopes(u[0] * dt, u[1] * dt, u[2] * dt, E, J)
    for a in range(3):
        for k in range(3):
            F[a, k] = E[a, k]
        F[a, 6] = C[a, 1] * r_n * dt
        F[a, 7] = (-C[a, 0] + C[a, 2] * tangent) * r_e * dt
    turn(x, 0.5 * u[0] * dt, 0.5 * u[1] * dt, 0.5 * u[2] * dt, half)
    attitude_matrix(half, C)
    rotation_slopes(0.5 * u[0] * dt, 0.5 * u[1] * dt, 0.5 * u[2] * dt, E, J)
    fx, fy, fz = u[_F], u[_F + 1], u[_F + 2]
    for k in range(3):  # -[f x] E, then turned into NED
        M[0, k] = fz * E[1, k] - fy * E[2, k]
        M[1, k] = fx * E[2, k] - fz * E[0, k]
        M[2, k] = fy * E[0, k] - fx * E[1, k]
    for a in range(3):
        for k in range(3):
            F[6 + a, k] = (C[0, a] * M[0, k] + C[1, a] * M[1, k] + C[2, a] * M[2, k]) * dt
    F[6, 6], F[6, 7], F[6, 8] = 1.0 + down * r_n * dt, (wd - east * r_e * tangent) * dt, -we * dt
    F[7, 6], F[7, 7], F[7, 8] = -wd * dt, 1.0 + (north * tangent + down) * r_e * dt, wn * dt
    F[8, 6], F[8, 7], F[8, 8] = (we - north * r_n) * dt, -(wn + east * r_e) * dt, 1.0
    F[8, 5] = GRAVITY_GRADIENT * dt
    for a in range(3):
        F[3 + a, 3 + a] = 1.0
        for k in range(9):
            F[3 + a, k] += 0.5 * dt * (F[6 + a, k] + (1.0 if k == 6 + a else 0.0))


def _process_noise(model: Any, x: np.ndarray, u: np.ndarray, dt: float, P: np.ndarray) -> None:
    for i in range(3):
        P[i, i] += model.gyro_psd * dt
        P[3 + i, 3 + i] += 1e-6 * dt
        P[6 + i, 6 + i] += model.accel_psd * dt


def _observe(model: Any, group: int, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> None:
    if group == FIX:
        apart(x[4:7], model.origin, y)
        for i in range(3):
            y[3 + i] = x[7 + i]
    else:
        y[0] = yaw(x)


def _slope(model: Any, group: int, x: np.ndarray, u: np.ndarray, H: np.ndarray) -> None:
    if group == FIX:
        for i in range(6):
            for j in range(3, 9):
                H[i, j] = 1.0 if j == 3 + i else 0.0
        return
    C = np.empty((3, 3))
    attitude_matrix(x, C)
    level2 = C[0, 0] * C[0, 0] + C[0, 1] * C[0, 1]  # forward axis, north and east
    H[0, 0] = 0.0  # a turn about it leaves it
    H[0, 1] = (-C[0, 0] * C[2, 1] + C[0, 1] * C[2, 0]) / level2
    H[0, 2] = (C[0, 0] * C[1, 1] - C[0, 1] * C[1, 0]) / level2


def _measurement_noise(model: Any, group: int, x: np.ndarray, u: np.ndarray, S: np.ndarray) -> None:
    if group == FIX:
        for i in range(3):
            wide = 2.25 if i == 2 else 1.0  # satellites are worse at heights
            S[i, i] += wide * model.place_variance
            S[3 + i, 3 + i] += wide * model.velocity_variance
    else:
        S[0, 0] += u[_VAR + group - ANTENNA]


def _residual(model: Any, group: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    if group == FIX:
        for i in range(6):
            out[i] = z[i] - y[i]
    else:
        out[0] = wrap(z[0] - y[0])


def _retract(model: Any, x: np.ndarray, dx: np.ndarray, out: np.ndarray) -> None:
    """Error quaternion from the Rodrigues parameters, eq. (16), (17)."""
    a, f = model.a, 2.0 * (model.a + 1.0)
    p2 = dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2]
    d = np.empty(4)
    d[0] = (-a * p2 + f * math.sqrt(f * f + (1.0 - a * a) * p2)) / (f * f + p2)
    for i in range(3):
        d[1 + i] = (a + d[0]) / f * dx[i]
    multiply(x, d, out)
    move(x[4:7], dx[3], dx[4], dx[5], out[4:7])
    for i in range(3):
        out[7 + i] = x[7 + i] + dx[6 + i]


def _difference(model: Any, x: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
    """Rodrigues parameters of the error quaternion, eq. (19), (20)."""
    back, d = np.empty(4), np.empty(4)
    back[0] = origin[0]
    for i in range(1, 4):
        back[i] = -origin[i]
    multiply(back, x, d)
    sign = -1.0 if d[0] < 0.0 else 1.0
    scale = sign * 2.0 * (model.a + 1.0) / (model.a + abs(d[0]))
    apart(x[4:7], origin[4:7], out[3:6])
    for i in range(3):
        out[i] = scale * d[1 + i]
        out[6 + i] = x[7 + i] - origin[7 + i]


def _constrain(model: Any, x: np.ndarray) -> None:
    normalise(x)


def _report(model: Any, x: np.ndarray, P: np.ndarray, memory: np.ndarray, row: np.ndarray) -> None:
    report_attitude(x, row)
    for i in range(3):
        for j in range(3):
            row[E_COV + 3 * i + j] = P[i, j]
        row[E_LLA + i], row[E_VEL + i] = x[4 + i], x[7 + i]


def _nine(model: Any) -> int:
    return 9


def _disturbed(model: Any) -> tuple[int, int, int]:
    return _Z_COURSE, _Z_COURSE + 1, 3


register(
    Ins9,
    size=_nine,
    changed=_nine,
    read=_nine,
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
    disturbed=_disturbed,
)


def build(settings: Mapping[str, Any], site: Site, sensors: SensorInfo, alignment: Alignment) -> Start:
    """The model and its first state from settings (see the catalogue), place, sensors and alignment."""
    model = Ins9(
        groups=np.array([[0, 6, 3, 9, 1], [6, 1, 0, 3, 0], [7, 1, 0, 3, 0]], np.int64),
        origin=np.array(site.lla, float),
        a=settings["rodrigues_a"],
        gyro_bias=np.array(alignment.gyro_bias, float),
        antenna_b=np.array(sensors.antenna_b, float),
        gyro_psd=0.5 * max(settings["gyro_noise"], sensors.gyro_noise) ** 2,
        accel_psd=0.5 * max(settings["accel_noise"], sensors.accel_noise) ** 2,
        place_variance=(settings["position_share"] * max(sensors.gnss_pos, 1e-3)) ** 2,
        velocity_variance=(settings["velocity_share"] * max(sensors.gnss_vel, 1e-4)) ** 2,
        heading_share=settings["heading_share"],
        drift_variance=settings["drift_sigma"] ** 2,
        course_speed=settings["course_speed"],
        wind_n=np.array([settings["wind_north"], settings["wind_east"]], float),
        use_heading=1 if settings["heading_aid"] else 0,
    )
    x, P, P_restart = np.zeros(10), np.zeros((9, 9)), np.zeros((9, 9))
    x[:4], x[4:7] = alignment.q_nb, site.lla
    C_bn = np.empty((3, 3))
    attitude_matrix(alignment.q_nb, C_bn)
    P[ATTITUDE, ATTITUDE] = C_bn @ np.diag(alignment.sigma_n**2) @ C_bn.T + 1e-10 * np.eye(3)
    known = bool(np.isfinite(alignment.vel_n).all() and np.isfinite(alignment.lla).all())
    if known:
        x[4:7], x[7:10] = alignment.lla, alignment.vel_n
    speed = 0.1 if alignment.still else 3.0 if known else 30.0
    P[PLACE, PLACE], P[VELOCITY, VELOCITY] = (10.0 if alignment.still else 1e3) ** 2 * np.eye(3), speed**2 * np.eye(3)
    P_restart[ATTITUDE, ATTITUDE] = 0.4 * np.eye(3)
    P_restart[PLACE, PLACE], P_restart[VELOCITY, VELOCITY] = 1e6 * np.eye(3), 900.0 * np.eye(3)
    memory = np.full(MEMORY, np.nan)
    return Start(model, x, P, P_restart, memory=memory, inputs=INPUTS, measurements=MEASUREMENTS_)
