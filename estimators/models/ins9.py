"""Loosely coupled inertial navigation with satellites, nine states and no sensor biases (Zhao 2015).

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
from typing import Annotated, Any

import numpy as np

from estimators import adaptation
from estimators.alignment import ALIGNED, Alignment, turned_sigmas
from estimators.earth import EARTH_RATE, GRAVITY_GRADIENT, apart, frame_rates, move, normal_gravity, radii
from estimators.elementary import atan2, cos, hypot, sin, tan
from estimators.jit import inner
from estimators.models.attitude_error import mean_rate
from estimators.models.base import FLAGS, STATE, Group, Layout, report_attitude
from estimators.native import Flag, Flags3, Number, Record, Vector3, Vector4, local, shaped
from estimators.past import WIDTH, Ring, keep, recall
from estimators.plausible import MAX_FORCE, MAX_SPEED, on_earth, plausible
from estimators.records import Estimate, Place, Sample, Sheet
from estimators.rotations import attitude_matrix, multiply, normalise, rotation_slopes, to_nav, turn, wrap, yaw
from estimators.settings import Setting
from estimators.types import Status

ATTITUDE, PLACE, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9)  # of the error; the raw state has one more in front
FIX, ANTENNA, COURSE = range(3)  # groups
FIX_TIMEOUT, HEADING_TIMEOUT, ANTENNA_TIMEOUT = 2.0, 5.0, 1.0  # s
ENOUGH_FOR_HEADING, ENOUGH_FOR_FIX = 6.0, 4.0  # satellites
_YAW = 6  # of the values of the ring: an angle
_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)

SETTINGS = {
    **ALIGNED,
    "heading_aid": Setting(True, "use dual antenna and course; false: place and velocity alone"),
    "rodrigues_a": Setting(1.0, "a of the generalised Rodrigues parameters", minimum=0.0, maximum=1.0),
    "gyro_noise": Setting(1e-3, "rad/s/sqrt(Hz), at least that: biases and scale, which are no states", minimum=0.0),
    "accel_noise": Setting(0.05, "m/s2/sqrt(Hz), at least that, likewise", minimum=0.0),
    "position_share": Setting(3.0, "of the receiver's position sigma, whose error is correlated", above=0.0),
    "velocity_share": Setting(1.5, "of the receiver's velocity sigma", above=0.0),
    "heading_share": Setting(3.0, "of the dual-antenna sigma, whose error is correlated", above=0.0),
    "drift_sigma": Setting(0.02, "rad, between course and heading; an aircraft in wind: wind over airspeed", above=0.0),
    "course_speed": Setting(3.0, "m/s, no course below it", above=0.0),
    "wind_north": Setting(
        0.0, "m/s, known wind (towards north), taken off before the course", minimum=-100, maximum=100
    ),
    "wind_east": Setting(0.0, "m/s, towards east", minimum=-100, maximum=100),
    **adaptation.settings("switched", switch_accel=1000.0),
}


class Parameters(Record):
    """Parameters of the model."""

    origin: Vector3  # rad, rad, m: places are measured from here
    a: Number  # of the Rodrigues parameters
    gyro_bias: Vector3  # rad/s, from the alignment, for good: no state corrects it
    antenna_b: Vector3  # m
    gyro_psd: Number  # rad2/s
    accel_psd: Number  # m2/s3
    place_variance: Number  # m2
    velocity_variance: Number  # (m/s)^2
    heading_share: Number  # of the reported sigma
    drift_variance: Number  # rad2
    course_speed: Number  # m/s
    wind_n: Annotated[np.ndarray, shaped(2)]  # m/s
    use_heading: Flag


class State(Record, size=STATE):
    """The raw state."""

    q_nb: Vector4
    lla: Vector3  # rad, rad, m
    vel_n: Vector3  # m/s


class Inputs(Record, size=STATE):
    """Motion of the step, noise of the headings."""

    rate_b: Vector3  # rad/s, mean
    accel_b: Vector3  # m/s2, mean specific force
    heading_variance: Number  # rad2, of the antennas'
    course_variance: Number  # rad2


class Memory(Record):
    """Holds the model's memory from row to row; NaN: not yet seen."""

    rate_b: Vector3  # rad/s, last gyro
    accel_b: Vector3  # m/s2, last force
    fix_t: Number  # s, when satellites were last there
    heading_t: Number  # s, when a heading was
    antenna_t: Number  # s, when the antennas' was
    ring: Ring  # the antenna's place (m from the origin) and velocity, and yaw


class Readings(Record, size=STATE):
    """Measurements."""

    place_n: Vector3  # m from the origin
    vel_n: Vector3
    heading: Number
    course: Number


class Used(Record, size=FLAGS):
    """Flags the measurements used in this row."""

    place_n: Flags3
    vel_n: Flags3
    heading: Flag
    course: Flag


def load(model: Parameters, row: Sample, x: State, memory: Memory, u: Inputs) -> None:
    """Mean rate and force of the step."""
    mean_rate(row, memory.rate_b, u.rate_b)
    there = True
    for i in range(3):
        u.rate_b[i] -= model.gyro_bias[i]
        there &= plausible(row.accel_b[i], MAX_FORCE)
    for i in range(3):
        last = memory.accel_b[i]
        now = row.accel_b[i] if there else last
        if math.isnan(last):
            last = now
        u.accel_b[i] = 0.5 * (last + now) if math.isfinite(now) else 0.0
        memory.accel_b[i] = now


@inner
def _keep(model: Parameters, t: float, x: State, memory: Memory, u: Inputs, now: np.ndarray) -> None:
    """Store the antenna's place (m from the origin) and velocity, and yaw; also returned in `now` (7,)."""
    a, w, lever, swing = model.antenna_b, u.rate_b, local(3), local(3)
    to_nav(x.q_nb, a[0], a[1], a[2], lever)
    apart(x.lla, model.origin, now)
    to_nav(x.q_nb, w[1] * a[2] - w[2] * a[1], w[2] * a[0] - w[0] * a[2], w[0] * a[1] - w[1] * a[0], swing)
    for i in range(3):
        now[i] += lever[i]
        now[3 + i] = x.vel_n[i] + swing[i]
    now[6] = yaw(x.q_nb)
    keep(memory.ring, t, now)


def measure(model: Parameters, row: Sample, x: State, memory: Memory, u: Inputs, z: Readings, used: Used) -> int:
    """Select what the number of satellites allows; COASTING a while after the last fix or heading."""
    now, then = local(WIDTH), local(WIDTH)
    _keep(model, row.t, x, memory, u, now)
    used.heading = used.course = False
    for i in range(3):
        used.place_n[i] = used.vel_n[i] = 0
    satellites = row.gnss_satellites
    if math.isnan(satellites):
        satellites = ENOUGH_FOR_HEADING  # a receiver that does not say
    if row.gnss_new and satellites >= ENOUGH_FOR_FIX and recall(memory.ring, row.gnss_t, (_YAW,), then):
        _measure_fix(model, row, x, memory, then, z, used)
    if model.use_heading:
        # the antennas, with enough satellites
        new = row.heading_new and satellites >= ENOUGH_FOR_HEADING and plausible(row.heading, 100.0)
        if new and recall(memory.ring, row.heading_t, (_YAW,), then):
            z.heading = row.heading + (now[6] - then[6])
            u.heading_variance = (model.heading_share * row.heading_sigma) ** 2
            used.heading = u.heading_variance > 0.0
            if used.heading:
                memory.heading_t = memory.antenna_t = row.t
        # the course, where they are silent
        antenna = satellites >= ENOUGH_FOR_HEADING and row.t - memory.antenna_t <= ANTENNA_TIMEOUT
        if used.vel_n[0] != 0 and not antenna and recall(memory.ring, row.gnss_t, (_YAW,), then):
            _measure_course(model, row, memory, now[6] - then[6], u, z, used)
    aided = row.t - memory.fix_t <= FIX_TIMEOUT
    if model.use_heading:
        aided &= row.t - memory.heading_t <= HEADING_TIMEOUT
    return _RUNNING if aided else _COASTING


@inner
def _measure_fix(
    model: Parameters, row: Sample, x: State, memory: Memory, then: np.ndarray, z: Readings, used: Used
) -> None:
    """Innovation of a delayed fix: measured minus the stored state at fix time, on top of the present state."""
    here, there = local(3), local(3)
    apart(x.lla, model.origin, here)
    apart(row.lla, model.origin, there)
    place, complete = on_earth(row.lla[0], row.lla[1], row.lla[2]), True
    for i in range(3):
        z.place_n[i] = here[i] + (there[i] - then[i])
        z.vel_n[i] = x.vel_n[i] + (row.vel_n[i] - then[3 + i])
        fast = plausible(row.vel_n[i], MAX_SPEED)
        used.place_n[i], used.vel_n[i] = place and plausible(there[i], 1e7), fast
        complete &= fast
    if complete:
        memory.fix_t = row.t


@inner
def _measure_course(
    model: Parameters, row: Sample, memory: Memory, turned: float, u: Inputs, z: Readings, used: Used
) -> None:
    """Course over ground less the wind, turned on by what the heading has turned since."""
    north, east = row.vel_n[0] - model.wind_n[0], row.vel_n[1] - model.wind_n[1]
    speed = hypot(north, east)
    if speed >= model.course_speed:
        z.course = atan2(east, north) + turned
        u.course_variance = model.velocity_variance / (speed * speed) + model.drift_variance
        used.course = True
        memory.heading_t = row.t


def propagate(model: Parameters, x: State, u: Inputs, dt: float, out: State) -> None:
    """Strapdown equations, Zhao 2015, eq. (5)-(9)."""
    w, f = u.rate_b, u.accel_b
    north, east, down = x.vel_n[0], x.vel_n[1], x.vel_n[2]
    ie_n, ie_d, en_n, en_e, en_d = frame_rates(x.lla, x.vel_n)
    half, body, frame, still = local(4), local(4), local(4), local(4)
    turn(x.q_nb, 0.5 * w[0] * dt, 0.5 * w[1] * dt, 0.5 * w[2] * dt, half)
    turn(x.q_nb, w[0] * dt, w[1] * dt, w[2] * dt, body)
    frame[0], frame[1], frame[2], frame[3] = 1.0, 0.0, 0.0, 0.0
    turn(frame, -(ie_n + en_n) * dt, -en_e * dt, -(ie_d + en_d) * dt, still)
    multiply(still, body, out.q_nb)
    force = local(3)
    to_nav(half, f[0], f[1], f[2], force)
    wn, we, wd = 2.0 * ie_n + en_n, en_e, 2.0 * ie_d + en_d
    v = out.vel_n
    v[0] = north + (force[0] - (we * down - wd * east)) * dt
    v[1] = east + (force[1] - (wd * north - wn * down)) * dt
    v[2] = down + (force[2] + normal_gravity(x.lla[0], x.lla[2]) - (wn * east - we * north)) * dt
    step = 0.5 * dt
    move(x.lla, step * (north + v[0]), step * (east + v[1]), step * (down + v[2]), out.lla)


def transition(model: Parameters, x: State, u: Inputs, dt: float, F: np.ndarray) -> None:
    """Left out: how transport rate and gravity change with the place but for the height, 1e-9 of anything else."""
    for a in range(9):
        for k in range(9):
            F[a, k] = 0.0
    latitude, height = x.lla[0], x.lla[2]
    along, across = radii(latitude)
    r_n, r_e, tangent = 1.0 / (along + height), 1.0 / (across + height), tan(latitude)
    north, east, down = x.vel_n[0], x.vel_n[1], x.vel_n[2]
    wn, we = 2.0 * EARTH_RATE * cos(latitude) + east * r_e, -north * r_n
    wd = -2.0 * EARTH_RATE * sin(latitude) - east * r_e * tangent
    half, E, J, C, M, w = local(4), local(3, 3), local(3, 3), local(3, 3), local(3, 3), u.rate_b
    turn(x.q_nb, w[0] * dt, w[1] * dt, w[2] * dt, half)
    attitude_matrix(half, C)  # C_bn at the end of the step
    rotation_slopes(w[0] * dt, w[1] * dt, w[2] * dt, E, J)
    for a in range(3):
        for k in range(3):
            F[a, k] = E[a, k]
        F[a, 6] = C[a, 1] * r_n * dt
        F[a, 7] = (-C[a, 0] + C[a, 2] * tangent) * r_e * dt
    turn(x.q_nb, 0.5 * w[0] * dt, 0.5 * w[1] * dt, 0.5 * w[2] * dt, half)
    attitude_matrix(half, C)
    rotation_slopes(0.5 * w[0] * dt, 0.5 * w[1] * dt, 0.5 * w[2] * dt, E, J)
    fx, fy, fz = u.accel_b[0], u.accel_b[1], u.accel_b[2]
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


def process_noise(model: Parameters, x: State, u: Inputs, dt: float, P: np.ndarray) -> None:
    """White noise of rate and force; a little of the place, to keep P positive."""
    for i in range(3):
        P[i, i] += model.gyro_psd * dt
        P[3 + i, 3 + i] += 1e-6 * dt
        P[6 + i, 6 + i] += model.accel_psd * dt


def observe(model: Parameters, group: int, x: State, u: Inputs, y: np.ndarray) -> None:
    """Place (m from the origin) and velocity, or heading."""
    if group == FIX:
        apart(x.lla, model.origin, y)
        for i in range(3):
            y[3 + i] = x.vel_n[i]
    else:
        y[0] = yaw(x.q_nb)


def slope(model: Parameters, group: int, x: State, u: Inputs, H: np.ndarray) -> None:
    """Identity, or how a rotation of the body turns its forward axis about the vertical."""
    if group == FIX:
        for i in range(6):
            for j in range(3, 9):
                H[i, j] = 1.0 if j == 3 + i else 0.0
        return
    C = local(3, 3)
    attitude_matrix(x.q_nb, C)
    level2 = C[0, 0] * C[0, 0] + C[0, 1] * C[0, 1]  # forward axis, north and east
    H[0, 0] = 0.0  # a turn about it leaves it
    H[0, 1] = (-C[0, 0] * C[2, 1] + C[0, 1] * C[2, 0]) / level2
    H[0, 2] = (C[0, 0] * C[1, 1] - C[0, 1] * C[1, 0]) / level2


def measurement_noise(model: Parameters, group: int, x: State, u: Inputs, S: np.ndarray) -> None:
    """Write the noise of the receiver, larger in height, or of the headings."""
    if group == FIX:
        for i in range(3):
            wide = 2.25 if i == 2 else 1.0
            S[i, i] += wide * model.place_variance
            S[3 + i, 3 + i] += wide * model.velocity_variance
    else:
        S[0, 0] += u.heading_variance if group == ANTENNA else u.course_variance


def residual(model: Parameters, group: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """Z - y, headings wrapped."""
    if group == FIX:
        for i in range(6):
            out[i] = z[i] - y[i]
    else:
        out[0] = wrap(z[0] - y[0])


def retract(model: Parameters, x: State, dx: np.ndarray, out: State) -> None:
    """Error quaternion from the Rodrigues parameters, Zhao 2015, eq. (16), (17)."""
    a, f = model.a, 2.0 * (model.a + 1.0)
    p2 = dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2]
    d = local(4)
    d[0] = (-a * p2 + f * math.sqrt(f * f + (1.0 - a * a) * p2)) / (f * f + p2)
    for i in range(3):
        d[1 + i] = (a + d[0]) / f * dx[i]
    multiply(x.q_nb, d, out.q_nb)
    move(x.lla, dx[3], dx[4], dx[5], out.lla)
    for i in range(3):
        out.vel_n[i] = x.vel_n[i] + dx[6 + i]


def difference(model: Parameters, x: State, origin: State, out: np.ndarray) -> None:
    """Rodrigues parameters of the error quaternion, Zhao 2015, eq. (19), (20)."""
    back, d, metres = local(4), local(4), local(3)
    back[0] = origin.q_nb[0]
    for i in range(1, 4):
        back[i] = -origin.q_nb[i]
    multiply(back, x.q_nb, d)
    sign = -1.0 if d[0] < 0.0 else 1.0
    scale = sign * 2.0 * (model.a + 1.0) / (model.a + abs(d[0]))
    apart(x.lla, origin.lla, metres)
    for i in range(3):
        out[i] = scale * d[1 + i]
        out[3 + i] = metres[i]
        out[6 + i] = x.vel_n[i] - origin.vel_n[i]


def constrain(model: Parameters, x: State) -> None:
    """Normalise the quaternion."""
    normalise(x.q_nb)


def report(model: Parameters, x: State, P: np.ndarray, memory: Memory, answer: Estimate) -> None:
    """Attitude, place and velocity."""
    report_attitude(x.q_nb, answer)
    for i in range(3):
        for j in range(3):
            answer.att_cov[i, j] = P[i, j]
        answer.lla[i], answer.vel_n[i] = x.lla[i], x.vel_n[i]


def layout(settings: Mapping[str, Any]) -> Layout:
    """Sizes of the model."""
    groups = Group(0, 6, 3, 9, True), Group(6, 1, 0, 3, False), Group(7, 1, 0, 3, False)
    return Layout(raw=10, size=9, changed=9, read=9, groups=groups, disturbed=(7, 8, 3))


@inner
def _set(settings: Any, site: Place, sensors: Sheet, alignment: Alignment, model: Parameters) -> None:
    """Set the parameters."""
    for i in range(3):
        model.origin[i], model.antenna_b[i] = site.lla[i], sensors.antenna_b[i]
        model.gyro_bias[i] = alignment.gyro_bias[i]
    model.a, model.use_heading = settings.rodrigues_a, settings.heading_aid
    model.gyro_psd = 0.5 * max(settings.gyro_noise, sensors.gyro_noise) ** 2
    model.accel_psd = 0.5 * max(settings.accel_noise, sensors.accel_noise) ** 2
    model.place_variance = (settings.position_share * max(sensors.gnss_pos, 1e-3)) ** 2
    model.velocity_variance = (settings.velocity_share * max(sensors.gnss_vel, 1e-4)) ** 2
    model.heading_share, model.course_speed = settings.heading_share, settings.course_speed
    model.drift_variance = settings.drift_sigma**2
    model.wind_n[0], model.wind_n[1] = settings.wind_north, settings.wind_east


def build(
    settings: Any, site: Place, sensors: Sheet, alignment: Alignment, model: Parameters, memory: Memory, x: State,
    P: np.ndarray, P_restart: np.ndarray,
) -> None:  # fmt: skip
    """Set parameters and first state from settings, place, sensors and alignment."""
    _set(settings, site, sensors, alignment, model)
    known = True
    for i in range(3):
        known &= math.isfinite(alignment.vel_n[i]) and math.isfinite(alignment.lla[i])
    for i in range(4):
        x.q_nb[i] = alignment.q_nb[i]
    turned_sigmas(alignment, 1.0, P)
    speed = 3.0 if known else 30.0 if alignment.moving else 0.1
    for i in range(3):
        x.lla[i] = alignment.lla[i] if known else site.lla[i]
        x.vel_n[i] = alignment.vel_n[i] if known else 0.0
        P[i, i] += 1e-10
        P[3 + i, 3 + i], P[6 + i, 6 + i] = (10.0 if alignment.still else 1e3) ** 2, speed**2
        P_restart[i, i], P_restart[3 + i, 3 + i], P_restart[6 + i, 6 + i] = 0.4, 1e6, 900.0
