"""M1: attitude quaternion, body rate and gyro bias from magnetic, angular rate and gravity sensors (paper 000).

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

With practical noise the covariance is honest in two more ways. What scale and misalignment of the gyro leave behind in
a turn is noise that grows with the rate, of variance 2 tau (k |w|)^2 per second. And what no average removes is
reported on top (a Schmidt filter's "considered" errors, without their correlation): bias, scale and misalignment of the
accelerometer in the tilt, and in a turn the airspeed's scale times w V; hard iron, and that tilt times the dip, in the
heading. Ten states cannot learn any of them.

When the aid falls silent for `AID_TIMEOUT` the accelerometer's noise is raised by `unaided_factor` (status COASTING).
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.alignment import Alignment, Start, attitude_block
from estimators.generic import register
from estimators.jit import inner
from estimators.models.base import MAX_FIELD, MAX_FORCE, MAX_RATE, MAX_SPEED, plausible, report_attitude
from estimators.rotations import exp_terms, normalise, to_body, to_body_by_q, to_nav, turn
from estimators.rows import (
    ACCEL,
    AIR_NEW,
    AIRSPEED,
    ALPHA,
    BETA,
    E_COV,
    E_DOWN,
    E_GYRO_BIAS,
    E_GYRO_SIGMA,
    E_Q,
    GNSS_NEW,
    GNSS_T,
    GYRO,
    MAG,
    MAG_NEW,
    VEL,
    T,
)
from estimators.types import SensorInfo, Site, Status

ATTITUDE, RATE, BIAS = slice(0, 4), slice(4, 7), slice(7, 10)

# inputs u:
# acceleration a_n 0-2, velocity v_b 3-5, its derivative 6-8, factor on the accelerometer's variance 9
INPUTS = 10

# memory
_MAG_T, _AID_T, _V, _V_SLOW, _V_DOT, _ALPHA, _BETA, _LAST_VELOCITY, _LAST_T, _A, _A_T, MEMORY = (
    0, 1, 2, 3, 4, 5, 6, 7, 10, 11, 14, 15,
)  # fmt: skip

NONE, AIR, GNSS = 0, 1, 2
MAG_TIMEOUT = 1.0  # s without magnetometer: the heading is carried by the gyro
AID_TIMEOUT = 1.0  # s
_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)


class Marg(NamedTuple):
    """Parameters of the model."""

    groups: np.ndarray  # (2, 5) int64: accelerometer and magnetometer, gyro
    gravity_n: np.ndarray  # (3,) m/s2, G = (0, 0, -g)
    mag_n: np.ndarray  # (3,) T, M
    R_accel: np.ndarray  # (3, 3) (m/s2)^2
    R_mag: np.ndarray  # (3, 3) T2
    R_gyro: np.ndarray  # (3, 3) (rad/s)^2
    Q_rate: np.ndarray  # (3, 3) (rad/s)^2 per second
    q_noise: float  # 1/s, variance of the quaternion's elements: keeps P positive
    bias_noise: float  # (rad/s)^2 per second
    aiding: int  # NONE, AIR, GNSS
    speed_filter: float  # s, time constant of dV/dt
    speed_min: float  # m/s
    unaided_factor: float  # on R_accel while the aid is silent
    incidence: float  # rad, angle of attack without vane
    rate_noise: float  # s, 2 tau k^2: attitude noise that grows with the rate
    fixed_tilt: float  # rad2, of errors that no average removes
    fixed_heading: float  # rad2, likewise, without what comes from the tilt
    dip_slope: float  # tangent of the field's dip: heading error per tilt error
    speed_scale: float  # relative error of the airspeed


def _propagate(model: Any, x: np.ndarray, u: np.ndarray, dt: float, out: np.ndarray) -> None:
    turn(x, x[4] * dt, x[5] * dt, x[6] * dt, out)
    for i in range(4, 10):
        out[i] = x[i]


def _transition(model: Any, x: np.ndarray, u: np.ndarray, dt: float, F: np.ndarray) -> None:
    a, b, c, d = x[0], x[1], x[2], x[3]
    vx, vy, vz = x[4] * dt, x[5] * dt, x[6] * dt
    cosine, sine, slope = exp_terms(vx * vx + vy * vy + vz * vz)
    ex, ey, ez = sine * vx, sine * vy, sine * vz
    # dq'/dq: multiplication by exp_q(v) from the right
    F[0, 0], F[0, 1], F[0, 2], F[0, 3] = cosine, -ex, -ey, -ez
    F[1, 0], F[1, 1], F[1, 2], F[1, 3] = ex, cosine, ez, -ey
    F[2, 0], F[2, 1], F[2, 2], F[2, 3] = ey, -ez, cosine, ex
    F[3, 0], F[3, 1], F[3, 2], F[3, 3] = ez, ey, -ex, cosine
    # dq'/dw = q (x) d exp_q / dv dt, column by column
    for j in range(3):
        v_j = x[4 + j] * dt
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


def _process_noise(model: Any, x: np.ndarray, u: np.ndarray, dt: float, P: np.ndarray) -> None:
    turning = 0.25 * model.rate_noise * (x[4] * x[4] + x[5] * x[5] + x[6] * x[6])
    for i in range(4):
        P[i, i] += (model.q_noise + turning) * dt
    for i in range(3):
        for j in range(3):
            P[4 + i, 4 + j] += model.Q_rate[i, j] * dt
        P[7 + i, 7 + i] += model.bias_noise * dt


def _observe(model: Any, group: int, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> None:
    if group == 1:
        for i in range(3):
            y[i] = x[4 + i] + x[7 + i]
        return
    g, m = model.gravity_n, model.mag_n
    to_body(x, m[0], m[1], m[2], y)
    y[3], y[4], y[5] = y[0], y[1], y[2]
    to_body(x, g[0] + u[0], g[1] + u[1], g[2] + u[2], y)
    if model.aiding == AIR:
        vx, vy, vz = u[3], u[4], u[5]
        y[0] += x[5] * vz - x[6] * vy + u[6]
        y[1] += x[6] * vx - x[4] * vz + u[7]
        y[2] += x[4] * vy - x[5] * vx + u[8]


def _slope(model: Any, group: int, x: np.ndarray, u: np.ndarray, H: np.ndarray) -> None:
    if group == 1:
        for i in range(3):
            for j in range(4, 10):
                H[i, j] = 0.0
            H[i, 4 + i] = 1.0
            H[i, 7 + i] = 1.0
        return
    g, m = model.gravity_n, model.mag_n
    to_body_by_q(x, m[0], m[1], m[2], H)
    for i in range(3):
        for j in range(4):
            H[3 + i, j] = H[i, j]
    to_body_by_q(x, g[0] + u[0], g[1] + u[1], g[2] + u[2], H)
    if model.aiding == AIR:
        vx, vy, vz = u[3], u[4], u[5]
        H[0, 4], H[0, 5], H[0, 6] = 0.0, vz, -vy
        H[1, 4], H[1, 5], H[1, 6] = -vz, 0.0, vx
        H[2, 4], H[2, 5], H[2, 6] = vy, -vx, 0.0
        for i in range(3, 6):
            for j in range(4, 7):
                H[i, j] = 0.0


def _measurement_noise(model: Any, group: int, x: np.ndarray, u: np.ndarray, S: np.ndarray) -> None:
    for i in range(3):
        for j in range(i + 1):
            if group == 1:
                S[i, j] += model.R_gyro[i, j]
            else:
                S[i, j] += model.R_accel[i, j] * u[9]
                S[3 + i, 3 + j] += model.R_mag[i, j]


def _constrain(model: Any, x: np.ndarray) -> None:
    normalise(x)


def _load(model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray) -> None:
    u[9] = 1.0
    if model.aiding == AIR:
        _load_air(model, row, memory, u)
    elif model.aiding == GNSS:
        _load_gnss(model, row, x, memory, u)
    if model.aiding != NONE and not row[T] - memory[_AID_T] <= AID_TIMEOUT:
        u[9] = model.unaided_factor
        for i in range(9):
            u[i] = 0.0


def _measure(
    model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray
) -> int:
    t, new = row[T], row[MAG_NEW] != 0.0
    carried, mag = True, new  # by gyro and accelerometer; is the magnetometer there?
    for i in range(3):
        z[i], z[3 + i], z[6 + i] = row[ACCEL + i], row[MAG + i], row[GYRO + i]
        used[i] = plausible(z[i], MAX_FORCE)
        used[3 + i] = new and plausible(z[3 + i], MAX_FIELD)
        used[6 + i] = plausible(z[6 + i], MAX_RATE)
        carried &= used[i] and used[6 + i]
        mag &= used[3 + i]
    if mag or not math.isfinite(memory[_MAG_T]):
        memory[_MAG_T] = t
    aided = model.aiding == NONE or t - memory[_AID_T] <= AID_TIMEOUT
    return _RUNNING if carried and aided and t - memory[_MAG_T] <= MAG_TIMEOUT else _COASTING


@inner
def _load_air(model: Any, row: np.ndarray, memory: np.ndarray, u: np.ndarray) -> None:
    t = row[T]
    if row[AIR_NEW] != 0.0 and plausible(row[AIRSPEED], MAX_SPEED):
        speed, age = row[AIRSPEED], t - memory[_AID_T]
        if not age <= AID_TIMEOUT:
            memory[_V_SLOW] = speed
        elif age > 0.0:
            memory[_V_SLOW] += (1.0 - math.exp(-age / model.speed_filter)) * (speed - memory[_V_SLOW])
        memory[_V_DOT] = (speed - memory[_V_SLOW]) / model.speed_filter
        memory[_V] = speed
        memory[_ALPHA] = row[ALPHA] if math.isfinite(row[ALPHA]) else model.incidence
        memory[_BETA] = row[BETA] if math.isfinite(row[BETA]) else 0.0
        memory[_AID_T] = t
    speed, speed_up = memory[_V], memory[_V_DOT]
    if not speed >= model.speed_min:
        speed, speed_up = 0.0, 0.0
    alpha, beta = memory[_ALPHA], memory[_BETA]
    ahead, right, down = math.cos(alpha) * math.cos(beta), math.sin(beta), math.sin(alpha) * math.cos(beta)
    u[3], u[4], u[5] = speed * ahead, speed * right, speed * down
    u[6], u[7], u[8] = speed_up * ahead, speed_up * right, speed_up * down


@inner
def _load_gnss(model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray) -> None:
    if row[GNSS_NEW] != 0.0 and plausible(abs(row[VEL]) + abs(row[VEL + 1]) + abs(row[VEL + 2]), MAX_SPEED):
        valid = row[GNSS_T]
        age = valid - memory[_LAST_T]
        if 0.0 < age <= AID_TIMEOUT:  # False when a stamp is NaN
            for i in range(3):
                memory[_A + i] = (row[VEL + i] - memory[_LAST_VELOCITY + i]) / age
            memory[_A_T] = valid - 0.5 * age
            memory[_AID_T] = row[T]
        for i in range(3):
            memory[_LAST_VELOCITY + i] = row[VEL + i]
        memory[_LAST_T] = valid
    rate_n = np.empty(3)
    to_nav(x, x[4], x[5], x[6], rate_n)
    angle = min(1.0, max(-1.0, rate_n[2] * (row[T] - memory[_A_T])))  # the acceleration turns with the vehicle
    cosine, sine = math.cos(angle), math.sin(angle)
    u[0] = cosine * memory[_A] - sine * memory[_A + 1]
    u[1] = sine * memory[_A] + cosine * memory[_A + 1]
    u[2] = memory[_A + 2]


def _report(model: Any, x: np.ndarray, P: np.ndarray, memory: np.ndarray, row: np.ndarray) -> None:
    report_attitude(x, row)
    # small body rotation r = 2 vec(q* (x) dq): cov = 4 X P X^T with the rows of X below
    a, b, c, d = row[E_Q], row[E_Q + 1], row[E_Q + 2], row[E_Q + 3]
    for i in range(3):
        xa, xb, xc, xd = (-b, a, d, -c) if i == 0 else (-c, -d, a, b) if i == 1 else (-d, c, -b, a)
        pa = xa * P[0, 0] + xb * P[1, 0] + xc * P[2, 0] + xd * P[3, 0]
        pb = xa * P[0, 1] + xb * P[1, 1] + xc * P[2, 1] + xd * P[3, 1]
        pc = xa * P[0, 2] + xb * P[1, 2] + xc * P[2, 2] + xd * P[3, 2]
        pd = xa * P[0, 3] + xb * P[1, 3] + xc * P[2, 3] + xd * P[3, 3]
        row[E_COV + i] = row[E_COV + 3 * i] = 4.0 * (-b * pa + a * pb + d * pc - c * pd)
        if i >= 1:
            row[E_COV + 3 + i] = row[E_COV + 3 * i + 1] = 4.0 * (-c * pa - d * pb + a * pc + b * pd)
        if i == 2:
            row[E_COV + 8] = 4.0 * (-d * pa + c * pb - b * pc + a * pd)
        row[E_GYRO_BIAS + i] = x[7 + i]
        row[E_GYRO_SIGMA + i] = math.sqrt(P[7 + i, 7 + i])
    if model.fixed_tilt > 0.0:
        _report_fixed(model, x, memory, row)


@inner
def _report_fixed(model: Any, x: np.ndarray, memory: np.ndarray, row: np.ndarray) -> None:
    """Add C_bn diag(t, t, h) C_nb of the fixed errors to the covariance of a row."""
    tilt = model.fixed_tilt
    if model.aiding == AIR and memory[_V] >= model.speed_min:
        rate2 = x[4] * x[4] + x[5] * x[5] + x[6] * x[6]
        tilt += rate2 * (model.speed_scale * memory[_V] / model.gravity_n[2]) ** 2
    heading = model.fixed_heading + tilt * model.dip_slope**2
    down = np.empty(3)
    for i in range(3):
        down[i] = row[E_DOWN + i]
    for i in range(3):
        row[E_COV + 4 * i] += tilt
        for j in range(3):
            row[E_COV + 3 * i + j] += (heading - tilt) * down[i] * down[j]


def _size(model: Any) -> int:
    return 10


def _changed(model: Any) -> int:
    return 4  # the quaternion


def _read(model: Any) -> int:
    return 7  # quaternion and rate


def _magnetic(model: Any) -> tuple[int, int, int]:
    return 3, 6, 1


register(
    Marg,
    size=_size,
    changed=_changed,
    read=_read,
    load=_load,
    measure=_measure,
    propagate=_propagate,
    transition=_transition,
    process_noise=_process_noise,
    observe=_observe,
    slope=_slope,
    measurement_noise=_measurement_noise,
    constrain=_constrain,
    report=_report,
    magnetic=_magnetic,
)

_GROUPS = {  # start, rows, from, read, linear
    NONE: [[0, 6, 0, 4, 0], [6, 3, 4, 10, 1]],
    AIR: [[0, 6, 0, 7, 0], [6, 3, 4, 10, 1]],
    GNSS: [[0, 6, 0, 4, 0], [6, 3, 4, 10, 1]],
}
_FLOOR = (1e-5, 1e-11, 1e-7)  # m/s2, T, rad/s: no sensor of a ground phase is taken for better than this


def build(settings: Mapping[str, Any], site: Site, sensors: SensorInfo, alignment: Alignment) -> Start:
    """The model and its first state from settings (see the catalogue), place, sensors and alignment."""
    aiding = {"none": NONE, "airspeed": AIR, "gnss": GNSS}[settings["aiding"]]
    noise, practical = settings["noise"], 0.0
    if noise == "auto":
        noise = "from-ground" if aiding == NONE else "practical"
    if noise == "from-ground" and alignment.still:
        R_accel, R_mag, R_gyro = (
            cov + floor**2 * np.eye(3)
            for cov, floor in zip((alignment.accel_cov, alignment.mag_cov, alignment.gyro_cov), _FLOOR, strict=True)
        )
        Q_rate = R_gyro * sensors.rate  # the paper is silent on how: the gyro's own scatter per sample
        if not np.all(np.isfinite(R_mag)):  # no magnetometer seen yet
            R_mag = settings["mag_sigma"] ** 2 * np.eye(3)
    else:
        R_accel, R_mag = settings["accel_sigma"] ** 2 * np.eye(3), settings["mag_sigma"] ** 2 * np.eye(3)
        R_gyro = max(_FLOOR[2] ** 2, sensors.gyro_noise**2 * sensors.rate / 2) * np.eye(3)
        Q_rate = settings["rate_noise"] ** 2 * np.eye(3)
        practical = 1.0
    horizontal = math.hypot(site.mag_n[0], site.mag_n[1])
    model = Marg(
        groups=np.array(_GROUPS[aiding], np.int64),
        gravity_n=np.array([0.0, 0.0, -site.gravity]),
        mag_n=np.array(site.mag_n, float),
        R_accel=np.ascontiguousarray(R_accel),
        R_mag=np.ascontiguousarray(R_mag),
        R_gyro=np.ascontiguousarray(R_gyro),
        Q_rate=np.ascontiguousarray(Q_rate),
        q_noise=1e-10,
        bias_noise=settings["bias_walk"] ** 2,
        aiding=aiding,
        speed_filter=settings["speed_filter"],
        speed_min=settings["speed_min"],
        unaided_factor=settings["unaided_factor"],
        incidence=settings["incidence"],
        rate_noise=practical * 2.0 * settings["scale_time"] * (settings["scale_share"] * sensors.gyro_scale) ** 2,
        fixed_tilt=practical * ((sensors.accel_bias / site.gravity) ** 2 + sensors.accel_scale**2),
        fixed_heading=practical * (sensors.mag_bias / horizontal) ** 2,
        dip_slope=abs(site.mag_n[2]) / horizontal,
        speed_scale=sensors.airspeed_scale,
    )
    x, P, P_restart = np.zeros(10), np.zeros((10, 10)), np.zeros((10, 10))
    P_restart[ATTITUDE, ATTITUDE] = 0.1 * np.eye(4)
    P_restart[RATE, RATE] = 0.1 * np.eye(3)
    P_restart[BIAS, BIAS] = sensors.gyro_bias**2 * np.eye(3) + 1e-8 * np.eye(3)
    if settings["initialisation"] == "paper":
        x[ATTITUDE] = 0.0, 0.0, 0.0, 1.0
        P[:] = 1e4 * np.eye(10)
    else:
        x[ATTITUDE] = alignment.q_nb
        x[BIAS] = alignment.gyro_bias
        P[ATTITUDE, ATTITUDE] = attitude_block(alignment) + 1e-8 * np.eye(4)
        P[RATE, RATE] = 0.01**2 * np.eye(3) if alignment.still else 0.3**2 * np.eye(3)
        P[BIAS, BIAS] = np.diag(alignment.gyro_bias_sigma**2)
    return Start(model, x, P, P_restart, memory=np.full(MEMORY, np.nan), inputs=INPUTS, measurements=9)
