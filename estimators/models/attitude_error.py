"""M2: attitude error and gyro bias error about an attitude that the gyro integrates (paper 002).

Raw state: `q_nb` (4), gyro bias e (3, rad/s). Error (6): quaternion error vector q_e, half the small rotation in body
axes, `q = q_estimated (x) (sqrt(1 - q_e^2), q_e)`, and the bias error. After each correction the raw state takes it all
(feedback, the error is zero again).

    q_e' = -[w x] q_e - 1/2 d_e,   d_e' = noise,   w = gyro - e                                  eq. (2)
    f_b = C_bn G,  m_b = C_bn M,   slopes 2 [f_b x], 2 [m_b x]                                    eq. (3), (4)

with G = (0, 0, -g) and M the local field. The gyro of a step is the mean of its two ends. Accelerometer and
magnetometer are two groups, so that an adaptation (the paper's is `fuzzy`) judges them apart.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.alignment import Alignment, Start
from estimators.generic import register
from estimators.jit import njit
from estimators.models.base import MAX_FIELD, MAX_FORCE, MAX_RATE, plausible, report_attitude
from estimators.rotations import attitude_matrix, normalise, rotation_between, to_body, turn
from estimators.rows import ACCEL, E_COV, E_GYRO_BIAS, E_GYRO_SIGMA, GYRO, MAG, MAG_NEW, T
from estimators.types import SensorInfo, Site, Status

ERROR, BIAS = slice(0, 3), slice(3, 6)  # of the error; the raw state has one more in front
INPUTS = 3  # rad/s, mean rate of the step
_LAST, _GYRO_T, _MAG_T, MEMORY = 0, 3, 4, 5  # last rate, when gyro and magnetometer were last there
GYRO_TIMEOUT, MAG_TIMEOUT = 0.5, 1.0  # s
_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)


class AttitudeError(NamedTuple):
    """Parameters of the model."""

    groups: np.ndarray  # (2, 5) int64: accelerometer, magnetometer
    gravity_n: np.ndarray  # (3,) m/s2, G
    mag_n: np.ndarray  # (3,) T, M
    R_accel: np.ndarray  # (3, 3) (m/s2)^2
    R_mag: np.ndarray  # (3, 3) T2
    gyro_psd: float  # rad2/s, white noise of the rate
    bias_noise: float  # (rad/s)^2 per second


@njit
def mean_rate(row: np.ndarray, memory: np.ndarray, u: np.ndarray) -> bool:
    """`u[:3]` = mean gyro of this row and the last, kept in `memory[:3]`; the last one when it is missing (False)."""
    there = True
    for i in range(3):
        there &= plausible(row[GYRO + i], MAX_RATE)
    for i in range(3):
        last = memory[i]
        now = row[GYRO + i] if there else last
        if math.isnan(last):
            last = now
        u[i] = 0.5 * (last + now) if math.isfinite(now) else 0.0
        memory[i] = now
    return there


def _load(model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray) -> None:
    if mean_rate(row, memory, u) or math.isnan(memory[_GYRO_T]):
        memory[_GYRO_T] = row[T]


def _measure(
    model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray
) -> int:
    t, new = row[T], row[MAG_NEW] != 0.0
    force, field = True, new
    for i in range(3):
        z[i], z[3 + i] = row[ACCEL + i], row[MAG + i]
        used[i] = plausible(z[i], MAX_FORCE)
        used[3 + i] = new and plausible(z[3 + i], MAX_FIELD)
        force &= used[i]
        field &= used[3 + i]
    if field or math.isnan(memory[_MAG_T]):
        memory[_MAG_T] = t
    carried = force and t - memory[_GYRO_T] <= GYRO_TIMEOUT
    return _RUNNING if carried and t - memory[_MAG_T] <= MAG_TIMEOUT else _COASTING


def _propagate(model: Any, x: np.ndarray, u: np.ndarray, dt: float, out: np.ndarray) -> None:
    turn(x, (u[0] - x[4]) * dt, (u[1] - x[5]) * dt, (u[2] - x[6]) * dt, out)
    for i in range(4, 7):
        out[i] = x[i]


@njit
def rotation_slopes(rx: float, ry: float, rz: float, E: np.ndarray, J: np.ndarray) -> None:
    """`E = exp(-[r x])` (3, 3) and the right Jacobian `J` (3, 3) of rotation r: exp(r + d) = exp(r) exp(J d)."""
    a2 = rx * rx + ry * ry + rz * rz
    if a2 < 1e-4:
        sine, cosine, cubic = 1.0 - a2 / 6.0 + a2 * a2 / 120.0, 0.5 - a2 / 24.0, 1.0 / 6.0 - a2 / 120.0
    else:
        a = math.sqrt(a2)
        sine, cosine, cubic = math.sin(a) / a, (1.0 - math.cos(a)) / a2, (a - math.sin(a)) / (a2 * a)
    # products of r with itself: [r x]^2 = r r^T - a2 I
    E[0, 0], E[1, 1], E[2, 2] = (
        1.0 + cosine * (rx * rx - a2),
        1.0 + cosine * (ry * ry - a2),
        1.0 + cosine * (rz * rz - a2),
    )
    E[0, 1], E[1, 0] = cosine * rx * ry + sine * rz, cosine * rx * ry - sine * rz
    E[0, 2], E[2, 0] = cosine * rx * rz - sine * ry, cosine * rx * rz + sine * ry
    E[1, 2], E[2, 1] = cosine * ry * rz + sine * rx, cosine * ry * rz - sine * rx
    J[0, 0], J[1, 1], J[2, 2] = 1.0 + cubic * (rx * rx - a2), 1.0 + cubic * (ry * ry - a2), 1.0 + cubic * (rz * rz - a2)
    J[0, 1], J[1, 0] = cubic * rx * ry + cosine * rz, cubic * rx * ry - cosine * rz
    J[0, 2], J[2, 0] = cubic * rx * rz - cosine * ry, cubic * rx * rz + cosine * ry
    J[1, 2], J[2, 1] = cubic * ry * rz + cosine * rx, cubic * ry * rz - cosine * rx


def _transition(model: Any, x: np.ndarray, u: np.ndarray, dt: float, F: np.ndarray) -> None:
    E, J = np.empty((3, 3)), np.empty((3, 3))
    rotation_slopes((u[0] - x[4]) * dt, (u[1] - x[5]) * dt, (u[2] - x[6]) * dt, E, J)
    for i in range(3):
        for j in range(3):
            F[i, j] = E[i, j]
            F[i, 3 + j] = -0.5 * dt * J[i, j]


def _process_noise(model: Any, x: np.ndarray, u: np.ndarray, dt: float, P: np.ndarray) -> None:
    for i in range(3):
        P[i, i] += 0.25 * model.gyro_psd * dt
        P[3 + i, 3 + i] += model.bias_noise * dt


def _observe(model: Any, group: int, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> None:
    v = model.gravity_n if group == 0 else model.mag_n
    to_body(x, v[0], v[1], v[2], y)


def _slope(model: Any, group: int, x: np.ndarray, u: np.ndarray, H: np.ndarray) -> None:
    v, y = model.gravity_n if group == 0 else model.mag_n, np.empty(3)
    to_body(x, v[0], v[1], v[2], y)
    H[0, 0] = H[1, 1] = H[2, 2] = 0.0
    H[0, 1], H[1, 0] = -2.0 * y[2], 2.0 * y[2]
    H[0, 2], H[2, 0] = 2.0 * y[1], -2.0 * y[1]
    H[1, 2], H[2, 1] = -2.0 * y[0], 2.0 * y[0]


def _measurement_noise(model: Any, group: int, x: np.ndarray, u: np.ndarray, S: np.ndarray) -> None:
    R = model.R_accel if group == 0 else model.R_mag
    for i in range(3):
        for j in range(i + 1):
            S[i, j] += R[i, j]


def _retract(model: Any, x: np.ndarray, dx: np.ndarray, out: np.ndarray) -> None:
    turn(x, 2.0 * dx[0], 2.0 * dx[1], 2.0 * dx[2], out)
    for i in range(3):
        out[4 + i] = x[4 + i] + dx[3 + i]


def _difference(model: Any, x: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
    rotation_between(origin, x, out)
    for i in range(3):
        out[i] *= 0.5


def _constrain(model: Any, x: np.ndarray) -> None:
    normalise(x)


def _report(model: Any, x: np.ndarray, P: np.ndarray, memory: np.ndarray, row: np.ndarray) -> None:
    report_attitude(x, row)
    for i in range(3):
        for j in range(3):
            row[E_COV + 3 * i + j] = 4.0 * P[i, j]
        row[E_GYRO_BIAS + i], row[E_GYRO_SIGMA + i] = x[4 + i], math.sqrt(P[3 + i, 3 + i])


def _three(model: Any) -> int:
    return 3


def _six(model: Any) -> int:
    return 6


def _magnetic(model: Any) -> tuple[int, int, int]:
    return 3, 6, 1


register(
    AttitudeError,
    size=_six,
    changed=_three,
    read=_six,
    load=_load,
    measure=_measure,
    propagate=_propagate,
    transition=_transition,
    process_noise=_process_noise,
    observe=_observe,
    slope=_slope,
    measurement_noise=_measurement_noise,
    retract=_retract,
    difference=_difference,
    constrain=_constrain,
    report=_report,
    magnetic=_magnetic,
)

_FLOOR = (1e-5, 1e-14, 1e-7)  # m/s2, T, rad/s/sqrt(Hz): no sensor is taken for better than this


def build(settings: Mapping[str, Any], site: Site, sensors: SensorInfo, alignment: Alignment) -> Start:
    """The model and its first state from settings (see the catalogue), place, sensors and alignment."""
    accel, mag = settings["accel_sigma"], settings["mag_sigma"]
    if settings["noise"] == "sensors":
        accel, mag = sensors.accel_noise * math.sqrt(sensors.rate / 2), sensors.mag_noise
    R_accel, R_mag = max(accel, _FLOOR[0]) ** 2 * np.eye(3), max(mag, _FLOOR[1]) ** 2 * np.eye(3)
    if settings["noise"] == "from-ground" and alignment.still:
        R_accel = np.ascontiguousarray(alignment.accel_cov + _FLOOR[0] ** 2 * np.eye(3))
        if np.all(np.isfinite(alignment.mag_cov)):
            R_mag = np.ascontiguousarray(alignment.mag_cov + _FLOOR[1] ** 2 * np.eye(3))
    model = AttitudeError(
        groups=np.array([[0, 3, 0, 3, 0], [3, 3, 0, 3, 0]], np.int64),
        gravity_n=np.array([0.0, 0.0, -site.gravity]),
        mag_n=np.array(site.mag_n, float),
        R_accel=R_accel,
        R_mag=R_mag,
        gyro_psd=0.5 * max(sensors.gyro_noise, _FLOOR[2]) ** 2,
        bias_noise=settings["bias_walk"] ** 2,
    )
    x, P, P_restart = np.zeros(7), np.zeros((6, 6)), np.zeros((6, 6))
    x[:4], x[4:] = alignment.q_nb, alignment.gyro_bias
    C_bn = np.empty((3, 3))
    attitude_matrix(alignment.q_nb, C_bn)
    P[ERROR, ERROR] = 0.25 * C_bn @ np.diag(alignment.sigma_n**2) @ C_bn.T + 1e-12 * np.eye(3)
    P[BIAS, BIAS] = np.diag(alignment.gyro_bias_sigma**2)
    P_restart[ERROR, ERROR] = 0.1 * np.eye(3)
    P_restart[BIAS, BIAS] = (sensors.gyro_bias**2 + 1e-8) * np.eye(3)
    return Start(model, x, P, P_restart, memory=np.full(MEMORY, np.nan), inputs=INPUTS, measurements=6)
