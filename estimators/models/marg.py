"""Attitude quaternion, body rate and gyro bias from magnetic, angular rate and gravity sensors (Han 2013).

State (10): `q_nb` (a, b, c, d), true body rate w (rad/s), gyro bias e (rad/s); additive noise; vector state.

    propagate   q <- q (x) exp_q(w dt),   w <- w + n_w,   e <- e + n_e            eq. (16), (20)
    observe     f_b = C_bn(q) G,   m_b = C_bn(q) M,   gyro = w + e                eq. (22)

with G = (0, 0, -g), M the local field. The paper takes the accelerometer for a gravity sensor, which it is not in a
turn; with `aiding` the known motion is added, f_b = C_bn(q) (G + a_n) + w x v_b + dv_b/dt:

    none       a_n = v_b = 0: the paper
    airspeed   v_b = V (cos alpha cos beta, sin beta, sin alpha cos beta), V the true airspeed, beta 0 and alpha
               `incidence` where no vane is fitted; dV/dt from a first-order filter; below `speed_min` it may be wind on
               the ground: v_b = 0
    gnss       a_n = difference of successive GNSS velocities, turned by the body rate from its own time to now

With practical noise the covariance has two terms more. What scale and misalignment of the gyro leave behind in
a turn is noise that grows with the rate, of variance 2 tau (k |w|)^2 per second. And what no average removes is
reported on top (a Schmidt filter's "considered" errors, without their correlation): bias, scale and misalignment of the
accelerometer in the tilt, and in a turn the airspeed's scale times w V; hard iron, and that tilt times the dip, in the
heading. Ten states cannot learn any of them.

When the aid falls silent for `AID_TIMEOUT` the accelerometer's noise is raised by `unaided_factor` (status COASTING).
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from estimators import adaptation
from estimators.alignment import SETTINGS as ALIGNMENT
from estimators.alignment import Alignment, attitude_block
from estimators.elementary import cos, exp, hypot, sin
from estimators.jit import inner
from estimators.models.base import FLAGS, STATE, Group, Layout, report_attitude
from estimators.native import Flags3, Integer, Matrix3, Number, Record, Vector3, Vector4, local
from estimators.plausible import MAX_FIELD, MAX_FORCE, MAX_RATE, MAX_SPEED, plausible
from estimators.records import Estimate, Place, Sample, Sheet
from estimators.rotations import exp_terms, normalise, to_body, to_body_by_q, to_nav, turn
from estimators.settings import Setting
from estimators.types import Status

DIRECTIONS, TURNING = range(2)  # groups: accelerometer and magnetometer, gyro
NONE, AIR, GNSS = range(3)  # aiding
MAG_TIMEOUT = 1.0  # s without magnetometer: the heading is carried by the gyro
AID_TIMEOUT = 1.0  # s
_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)

SETTINGS = {
    **ALIGNMENT,
    "aiding": Setting("none", "what is added to gravity in the accelerometer's model", ("none", "airspeed", "gnss")),
    "noise": Setting(
        "auto",
        "from-ground: R and Q from the stationary stretch (the paper); practical: the settings below; "
        "auto: from-ground without aiding, practical with it",
        ("auto", "from-ground", "practical"),
    ),
    "accel_sigma": Setting(3.0, "m/s2, practical: vibration, turbulence and model errors, not sensor noise", above=0.0),
    "mag_sigma": Setting(4e-6, "T, practical", above=0.0),
    "rate_noise": Setting(0.035, "rad/s per sqrt(s), practical: how fast the body rate may change", above=0.0),
    "bias_walk": Setting(3e-5, "rad/s per sqrt(s), random walk of the gyro bias", minimum=0.0),
    "speed_filter": Setting(0.5, "s, time constant of the derivative of the airspeed", above=0.0),
    "speed_min": Setting(8.0, "m/s, below it the airspeed may be wind on the ground: not used", minimum=0.0),
    "incidence": Setting(
        0.05, "rad, angle of attack without vane; aeroplanes cruise at 2 to 4 deg", minimum=-0.3, maximum=0.3
    ),
    "scale_share": Setting(0.4, "practical: of the gyro's scale error, noise that grows with the rate", minimum=0.0),
    "scale_time": Setting(5.0, "s, practical: how long a rate lasts: correlation of that noise", above=0.0),
    "unaided_factor": Setting(11.0, "on the accelerometer's variance while the aid is silent", minimum=1.0),
    **adaptation.settings(),
}


class Parameters(Record):
    """Parameters of the model."""

    gravity_n: Vector3  # m/s2, G = (0, 0, -g)
    mag_n: Vector3  # T, M
    R_accel: Matrix3  # (m/s2)^2
    R_mag: Matrix3  # T2
    R_gyro: Matrix3  # (rad/s)^2
    Q_rate: Matrix3  # (rad/s)^2 per second
    q_noise: Number  # 1/s, variance of the quaternion's elements: keeps P positive
    bias_noise: Number  # (rad/s)^2 per second
    aiding: Integer  # NONE, AIR, GNSS
    speed_filter: Number  # s, time constant of dV/dt
    speed_min: Number  # m/s
    unaided_factor: Number  # on R_accel while the aid is silent
    incidence: Number  # rad, angle of attack without vane
    rate_noise: Number  # s, 2 tau k^2: attitude noise that grows with the rate
    fixed_tilt: Number  # rad2, of errors that no average removes
    fixed_heading: Number  # rad2, likewise, without what comes from the tilt
    dip_slope: Number  # tangent of the field's dip: heading error per tilt error
    speed_scale: Number  # relative error of the airspeed


class State(Record, size=STATE):
    """State, error and errors' order alike."""

    q_nb: Vector4
    rate_b: Vector3  # rad/s
    gyro_bias: Vector3  # rad/s


class Inputs(Record, size=STATE):
    """Holds the aiding data of one row."""

    accel_n: Vector3  # m/s2, a_n
    vel_b: Vector3  # m/s, v_b
    vel_dot_b: Vector3  # m/s2, its derivative
    accel_factor: Number  # on the accelerometer's variance


class Memory(Record):
    """Holds the model's memory from row to row; NaN: not yet seen."""

    mag_t: Number  # s, last magnetometer
    aid_t: Number  # s, last airspeed or velocity
    speed: Number  # m/s, last airspeed
    slow: Number  # m/s, the same behind the low-pass
    speed_dot: Number  # m/s2
    alpha: Number  # rad
    beta: Number  # rad
    vel_n: Vector3  # m/s, last GNSS velocity
    vel_t: Number  # s, when it was true
    accel_n: Vector3  # m/s2, of the last two of them
    accel_t: Number  # s, the middle between them


class Readings(Record, size=STATE):
    """Measurements."""

    accel_b: Vector3
    mag_b: Vector3
    gyro_b: Vector3


class Used(Record, size=FLAGS):
    """Flags the measurements used in this row."""

    accel_b: Flags3
    mag_b: Flags3
    gyro_b: Flags3


def propagate(model: Parameters, x: State, u: Inputs, dt: float, out: State) -> None:
    """Turn the attitude by the body rate, which stays."""
    w = x.rate_b
    turn(x.q_nb, w[0] * dt, w[1] * dt, w[2] * dt, out.q_nb)
    for i in range(3):
        out.rate_b[i], out.gyro_bias[i] = w[i], x.gyro_bias[i]


def transition(model: Parameters, x: State, u: Inputs, dt: float, F: np.ndarray) -> None:
    """Derivatives of the quaternion by quaternion and rate."""
    (a, b, c, d), w = (x.q_nb[0], x.q_nb[1], x.q_nb[2], x.q_nb[3]), x.rate_b
    vx, vy, vz = w[0] * dt, w[1] * dt, w[2] * dt
    cosine, sine, slope = exp_terms(vx * vx + vy * vy + vz * vz)
    ex, ey, ez = sine * vx, sine * vy, sine * vz
    # dq'/dq: multiplication by exp_q(v) from the right
    F[0, 0], F[0, 1], F[0, 2], F[0, 3] = cosine, -ex, -ey, -ez
    F[1, 0], F[1, 1], F[1, 2], F[1, 3] = ex, cosine, ez, -ey
    F[2, 0], F[2, 1], F[2, 2], F[2, 3] = ey, -ez, cosine, ex
    F[3, 0], F[3, 1], F[3, 2], F[3, 3] = ez, ey, -ex, cosine
    # dq'/dw = q (x) d exp_q / dv dt, column by column
    for j in range(3):
        v_j = w[j] * dt
        da = -0.5 * sine * v_j * dt
        db, dc, dd = slope * vx * v_j * dt, slope * vy * v_j * dt, slope * vz * v_j * dt
        if j == 0:
            db += sine * dt
        elif j == 1:
            dc += sine * dt
        else:
            dd += sine * dt
        F[0, 4 + j] = a * da - b * db - c * dc - d * dd
        F[1, 4 + j] = a * db + b * da + c * dd - d * dc
        F[2, 4 + j] = a * dc - b * dd + c * da + d * db
        F[3, 4 + j] = a * dd + b * dc - c * db + d * da


def process_noise(model: Parameters, x: State, u: Inputs, dt: float, P: np.ndarray) -> None:
    """Random walks of rate and bias; scale and misalignment of the gyro grow with the rate."""
    w = x.rate_b
    turning = 0.25 * model.rate_noise * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    for i in range(4):
        P[i, i] += (model.q_noise + turning) * dt
    for i in range(3):
        for j in range(3):
            P[4 + i, 4 + j] += model.Q_rate[i, j] * dt
        P[7 + i, 7 + i] += model.bias_noise * dt


def observe(model: Parameters, group: int, x: State, u: Inputs, y: np.ndarray) -> None:
    """Specific force with the known motion, field; or rate and bias."""
    w = x.rate_b
    if group == TURNING:
        for i in range(3):
            y[i] = w[i] + x.gyro_bias[i]
        return
    g, m, a = model.gravity_n, model.mag_n, u.accel_n
    to_body(x.q_nb, m[0], m[1], m[2], y)
    y[3], y[4], y[5] = y[0], y[1], y[2]
    to_body(x.q_nb, g[0] + a[0], g[1] + a[1], g[2] + a[2], y)
    if model.aiding == AIR:  # w x v + dv/dt
        v, v_dot = u.vel_b, u.vel_dot_b
        y[0] += w[1] * v[2] - w[2] * v[1] + v_dot[0]
        y[1] += w[2] * v[0] - w[0] * v[2] + v_dot[1]
        y[2] += w[0] * v[1] - w[1] * v[0] + v_dot[2]


def slope(model: Parameters, group: int, x: State, u: Inputs, H: np.ndarray) -> None:
    """Derivatives of the above."""
    if group == TURNING:
        for i in range(3):
            for j in range(4, 10):
                H[i, j] = 0.0
            H[i, 4 + i] = 1.0
            H[i, 7 + i] = 1.0
        return
    g, m, a = model.gravity_n, model.mag_n, u.accel_n
    to_body_by_q(x.q_nb, m[0], m[1], m[2], H)
    for i in range(3):
        for j in range(4):
            H[3 + i, j] = H[i, j]
    to_body_by_q(x.q_nb, g[0] + a[0], g[1] + a[1], g[2] + a[2], H)
    if model.aiding == AIR:
        v = u.vel_b
        H[0, 4], H[0, 5], H[0, 6] = 0.0, v[2], -v[1]
        H[1, 4], H[1, 5], H[1, 6] = -v[2], 0.0, v[0]
        H[2, 4], H[2, 5], H[2, 6] = v[1], -v[0], 0.0
        for i in range(3, 6):
            for j in range(4, 7):
                H[i, j] = 0.0


def measurement_noise(model: Parameters, group: int, x: State, u: Inputs, S: np.ndarray) -> None:
    """Noise of the sensors; the accelerometer's is larger while its aid is silent."""
    for i in range(3):
        for j in range(i + 1):
            if group == TURNING:
                S[i, j] += model.R_gyro[i, j]
            else:
                S[i, j] += model.R_accel[i, j] * u.accel_factor
                S[3 + i, 3 + j] += model.R_mag[i, j]


def constrain(model: Parameters, x: State) -> None:
    """Normalise the quaternion."""
    normalise(x.q_nb)


def load(model: Parameters, row: Sample, x: State, memory: Memory, u: Inputs) -> None:
    """Known motion of the row; none, and a larger noise, while the aid is silent."""
    u.accel_factor = 1.0
    if model.aiding == AIR:
        _load_air(model, row, memory, u)
    elif model.aiding == GNSS:
        _load_gnss(row, x, memory, u)
    if model.aiding != NONE and not row.t - memory.aid_t <= AID_TIMEOUT:
        u.accel_factor = model.unaided_factor
        for i in range(3):
            u.accel_n[i] = u.vel_b[i] = u.vel_dot_b[i] = 0.0


def measure(model: Parameters, row: Sample, x: State, memory: Memory, u: Inputs, z: Readings, used: Used) -> int:
    """Take all sensors; COASTING without the gyro, the accelerometer or its aid, and a while without the field."""
    carried, mag = True, row.mag_new  # by gyro and accelerometer; is the magnetometer there?
    for i in range(3):
        z.accel_b[i], z.mag_b[i], z.gyro_b[i] = row.accel_b[i], row.mag_b[i], row.gyro_b[i]
        force, rate = plausible(row.accel_b[i], MAX_FORCE), plausible(row.gyro_b[i], MAX_RATE)
        field = row.mag_new and plausible(row.mag_b[i], MAX_FIELD)
        used.accel_b[i], used.mag_b[i], used.gyro_b[i] = force, field, rate
        carried &= force and rate
        mag &= field
    if mag or not math.isfinite(memory.mag_t):
        memory.mag_t = row.t
    aided = model.aiding == NONE or row.t - memory.aid_t <= AID_TIMEOUT
    return _RUNNING if carried and aided and row.t - memory.mag_t <= MAG_TIMEOUT else _COASTING


@inner
def _load_air(model: Parameters, row: Sample, memory: Memory, u: Inputs) -> None:
    """Velocity in the air and its derivative, from airspeed and vanes."""
    if row.air_new and plausible(row.airspeed, MAX_SPEED):
        speed, age = row.airspeed, row.t - memory.aid_t
        if not age <= AID_TIMEOUT:  # the first, or the first after a pause: no derivative yet
            memory.slow = speed
        elif age > 0.0:
            memory.slow += (1.0 - exp(-age / model.speed_filter)) * (speed - memory.slow)
        memory.speed_dot = (speed - memory.slow) / model.speed_filter
        memory.speed = speed
        memory.alpha = row.alpha if math.isfinite(row.alpha) else model.incidence
        memory.beta = row.beta if math.isfinite(row.beta) else 0.0
        memory.aid_t = row.t
    speed, speed_up = memory.speed, memory.speed_dot
    if not speed >= model.speed_min:
        speed, speed_up = 0.0, 0.0
    alpha, beta = memory.alpha, memory.beta
    ahead, right, down = cos(alpha) * cos(beta), sin(beta), sin(alpha) * cos(beta)
    u.vel_b[0], u.vel_b[1], u.vel_b[2] = speed * ahead, speed * right, speed * down
    u.vel_dot_b[0], u.vel_dot_b[1], u.vel_dot_b[2] = speed_up * ahead, speed_up * right, speed_up * down


@inner
def _load_gnss(row: Sample, x: State, memory: Memory, u: Inputs) -> None:
    """Acceleration from two GNSS velocities."""
    v = row.vel_n
    if row.gnss_new and plausible(abs(v[0]) + abs(v[1]) + abs(v[2]), MAX_SPEED):
        age = row.gnss_t - memory.vel_t
        if 0.0 < age <= AID_TIMEOUT:  # False when a stamp is NaN
            for i in range(3):
                memory.accel_n[i] = (v[i] - memory.vel_n[i]) / age
            memory.accel_t = row.gnss_t - 0.5 * age
            memory.aid_t = row.t
        for i in range(3):
            memory.vel_n[i] = v[i]
        memory.vel_t = row.gnss_t
    rate_n, a = local(3), memory.accel_n
    to_nav(x.q_nb, x.rate_b[0], x.rate_b[1], x.rate_b[2], rate_n)
    angle = min(1.0, max(-1.0, rate_n[2] * (row.t - memory.accel_t)))  # the acceleration turns with the vehicle
    cosine, sine = cos(angle), sin(angle)
    u.accel_n[0] = cosine * a[0] - sine * a[1]
    u.accel_n[1] = sine * a[0] + cosine * a[1]
    u.accel_n[2] = a[2]


def report(model: Parameters, x: State, P: np.ndarray, memory: Memory, answer: Estimate) -> None:
    """Attitude and gyro bias."""
    report_attitude(x.q_nb, answer)
    # small body rotation r = 2 vec(q* (x) dq): cov = 4 X P X^T with the rows of X below
    a, b, c, d = answer.q_nb[0], answer.q_nb[1], answer.q_nb[2], answer.q_nb[3]
    cov = answer.att_cov
    for i in range(3):
        xa, xb, xc, xd = (-b, a, d, -c) if i == 0 else (-c, -d, a, b) if i == 1 else (-d, c, -b, a)
        pa = xa * P[0, 0] + xb * P[1, 0] + xc * P[2, 0] + xd * P[3, 0]
        pb = xa * P[0, 1] + xb * P[1, 1] + xc * P[2, 1] + xd * P[3, 1]
        pc = xa * P[0, 2] + xb * P[1, 2] + xc * P[2, 2] + xd * P[3, 2]
        pd = xa * P[0, 3] + xb * P[1, 3] + xc * P[2, 3] + xd * P[3, 3]
        cov[0, i] = cov[i, 0] = 4.0 * (-b * pa + a * pb + d * pc - c * pd)
        if i >= 1:
            cov[1, i] = cov[i, 1] = 4.0 * (-c * pa - d * pb + a * pc + b * pd)
        if i == 2:
            cov[2, 2] = 4.0 * (-d * pa + c * pb - b * pc + a * pd)
        answer.gyro_bias[i] = x.gyro_bias[i]
        answer.gyro_bias_sigma[i] = math.sqrt(P[7 + i, 7 + i])
    if model.fixed_tilt > 0.0:
        _report_fixed(model, x, memory, answer)


@inner
def _report_fixed(model: Parameters, x: State, memory: Memory, answer: Estimate) -> None:
    """Add C_bn diag(t, t, h) C_nb of the fixed errors to the covariance of a row."""
    tilt, w = model.fixed_tilt, x.rate_b
    if model.aiding == AIR and memory.speed >= model.speed_min:
        rate2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
        tilt += rate2 * (model.speed_scale * memory.speed / model.gravity_n[2]) ** 2
    heading = model.fixed_heading + tilt * model.dip_slope**2
    for i in range(3):
        answer.att_cov[i, i] += tilt
        for j in range(3):
            answer.att_cov[i, j] += (heading - tilt) * answer.down_b[i] * answer.down_b[j]


_FLOOR = (1e-5, 1e-11, 1e-7)  # m/s2, T, rad/s: no sensor of a ground phase is taken for better than this


def layout(settings: Mapping[str, Any]) -> Layout:
    """Sizes of the model; w x v reads the rate as well."""
    motion = 7 if settings["aiding"] == "airspeed" else 4
    return Layout(
        raw=10,
        size=10,
        changed=4,  # the quaternion
        read=7,  # quaternion and rate
        groups=(Group(0, 6, 0, motion, False), Group(6, 3, 4, 10, True)),
        magnetic=(3, 6, 1),
    )


_AUTO, _FROM_GROUND, _ = (SETTINGS["noise"].choices.index(name) for name in ("auto", "from-ground", "practical"))
_PAPER = SETTINGS["initialisation"].choices.index("paper")


@inner
def _noise(settings: Any, sensors: Sheet, alignment: Alignment, model: Parameters) -> bool:
    """Covariances of the sensors and of the body rate; whether they are practical ones."""
    noise = settings.noise
    if noise == _AUTO:
        noise = _FROM_GROUND if settings.aiding == NONE else noise
    accel, mag, seen = settings.accel_sigma**2, settings.mag_sigma**2, True
    gyro = max(_FLOOR[2] ** 2, sensors.gyro_noise**2 * sensors.rate / 2)
    ground = noise == _FROM_GROUND and alignment.still
    for i in range(3):
        for j in range(3):
            one = 1.0 if i == j else 0.0
            model.R_accel[i, j], model.R_mag[i, j] = accel * one, mag * one
            model.R_gyro[i, j], model.Q_rate[i, j] = gyro * one, settings.rate_noise**2 * one
            if ground:
                model.R_accel[i, j] = alignment.accel_cov[i, j] + _FLOOR[0] ** 2 * one
                model.R_gyro[i, j] = alignment.gyro_cov[i, j] + _FLOOR[2] ** 2 * one
                model.Q_rate[i, j] = model.R_gyro[i, j] * sensors.rate  # silent on how: the scatter per sample
                seen &= math.isfinite(alignment.mag_cov[i, j])
    if ground and seen:  # else no magnetometer was seen yet
        for i in range(3):
            for j in range(3):
                model.R_mag[i, j] = alignment.mag_cov[i, j] + (_FLOOR[1] ** 2 if i == j else 0.0)
    return not ground


def build(
    settings: Any, site: Place, sensors: Sheet, alignment: Alignment, model: Parameters, memory: Memory, x: State,
    P: np.ndarray, P_restart: np.ndarray,
) -> None:  # fmt: skip
    """Set parameters and first state from settings, place, sensors and alignment."""
    practical = 1.0 if _noise(settings, sensors, alignment, model) else 0.0
    horizontal = hypot(site.mag_n[0], site.mag_n[1])
    for i in range(3):
        model.gravity_n[i], model.mag_n[i] = 0.0, site.mag_n[i]
    model.gravity_n[2] = -site.gravity
    model.q_noise, model.bias_noise = 1e-10, settings.bias_walk**2
    model.aiding, model.speed_filter, model.speed_min = settings.aiding, settings.speed_filter, settings.speed_min
    model.unaided_factor, model.incidence = settings.unaided_factor, settings.incidence
    model.rate_noise = practical * 2.0 * settings.scale_time * (settings.scale_share * sensors.gyro_scale) ** 2
    model.fixed_tilt = practical * ((sensors.accel_bias / site.gravity) ** 2 + sensors.accel_scale**2)
    model.fixed_heading = practical * (sensors.mag_bias / horizontal) ** 2
    model.dip_slope, model.speed_scale = abs(site.mag_n[2]) / horizontal, sensors.airspeed_scale
    for i in range(10):
        P_restart[i, i] = 0.1 if i < 7 else sensors.gyro_bias**2 + 1e-8
    if settings.initialisation == _PAPER:
        x.q_nb[3] = 1.0
        for i in range(10):
            P[i, i] = 1e4
        return
    attitude_block(alignment, P)
    for i in range(4):
        x.q_nb[i] = alignment.q_nb[i]
        P[i, i] += 1e-8
    for i in range(3):
        x.gyro_bias[i] = alignment.gyro_bias[i]
        P[4 + i, 4 + i] = 0.3**2 if alignment.moving else 0.01**2
        P[7 + i, 7 + i] = alignment.gyro_bias_sigma[i] ** 2
