"""M3: the direction of gravity in body axes, no heading (paper 004).

State (3): `s = C_bn e_down`, the paper's C31, C32, C33 in forward-right-down axes.

    s <- exp(-[w x] dt) s,   w = gyro - e                                   eq. (7)-(11), closed form
    z = -f_b / |f_b|                                                         eq. (12)-(14)

A unit vector: it is normalised after each correction. Roll and pitch of s are what the paper computes; the heading is
not estimated. The gyro's bias e is what rotates s away between corrections: the rate of the corrections,

    e <- e + dt/bias_time * (s x ds/dt)                                      eq. (24)-(26)

low-passed and fed back. The paper's form holds for small angles; the vector form is the same there and holds anywhere.
Only the part across s shows; about level axes that is x and y, and z stays as it was. With the adaptation `switched`
(the paper's) there are no corrections while the vehicle turns or accelerates, and e waits.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.alignment import COARSE_TILT, Alignment, Start
from estimators.generic import register
from estimators.jit import inner
from estimators.models.attitude_error import GYRO_TIMEOUT, mean_rate, rotation_slopes
from estimators.models.base import MAX_FORCE, plausible
from estimators.rotations import to_body
from estimators.rows import ACCEL, E_COV, E_DOWN, E_GYRO_BIAS, T
from estimators.types import SensorInfo, Site, Status

INPUTS = 3  # rad/s, mean rate of the step less the bias
_GYRO_T, _T, _PREDICTED, _BIAS, MEMORY = 3, 4, 5, 8, 11  # after the last rate
_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)


class Tilt(NamedTuple):
    """Parameters of the model."""

    groups: np.ndarray  # (1, 5) int64
    accel_variance: float  # of an element of z
    gyro_psd: float  # rad2/s
    bias_time: float  # s
    bias_start: np.ndarray  # (3,) rad/s


def _load(model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray) -> None:
    t = row[T]
    if math.isnan(memory[_T]):
        for i in range(3):
            memory[_BIAS + i] = model.bias_start[i]
    elif math.isfinite(memory[_PREDICTED]):
        _learn(model, t - memory[_T], x, memory)
    memory[_T] = t
    if mean_rate(row, memory, u) or math.isnan(memory[_GYRO_T]):
        memory[_GYRO_T] = t
    for i in range(3):
        u[i] -= memory[_BIAS + i]


@inner
def _learn(model: Any, dt: float, x: np.ndarray, memory: np.ndarray) -> None:
    """Bias from the last correction, x less what had been predicted; `dt` to the next row stands for the step's own."""
    dx, dy, dz = x[0] - memory[_PREDICTED], x[1] - memory[_PREDICTED + 1], x[2] - memory[_PREDICTED + 2]
    share = min(1.0, dt / model.bias_time) / dt if 0.0 < dt < 1.0 else 0.0
    memory[_BIAS] += share * (x[1] * dz - x[2] * dy)
    memory[_BIAS + 1] += share * (x[2] * dx - x[0] * dz)
    memory[_BIAS + 2] += share * (x[0] * dy - x[1] * dx)


def _measure(
    model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray
) -> int:
    norm = math.sqrt(row[ACCEL] ** 2 + row[ACCEL + 1] ** 2 + row[ACCEL + 2] ** 2)
    there = plausible(norm, MAX_FORCE) and norm > 0.0
    for i in range(3):
        memory[_PREDICTED + i] = x[i]
        z[i] = -row[ACCEL + i] / norm if there else math.nan
        used[i] = there
    return _RUNNING if there and row[T] - memory[_GYRO_T] <= GYRO_TIMEOUT else _COASTING


def _propagate(model: Any, x: np.ndarray, u: np.ndarray, dt: float, out: np.ndarray) -> None:
    F, J = np.empty((3, 3)), np.empty((3, 3))
    rotation_slopes(u[0] * dt, u[1] * dt, u[2] * dt, F, J)
    for i in range(3):
        out[i] = F[i, 0] * x[0] + F[i, 1] * x[1] + F[i, 2] * x[2]


def _transition(model: Any, x: np.ndarray, u: np.ndarray, dt: float, F: np.ndarray) -> None:
    J = np.empty((3, 3))
    rotation_slopes(u[0] * dt, u[1] * dt, u[2] * dt, F, J)


def _process_noise(model: Any, x: np.ndarray, u: np.ndarray, dt: float, P: np.ndarray) -> None:
    for i in range(3):  # noise n of the rate moves s by -n x s
        for j in range(3):
            P[i, j] -= model.gyro_psd * dt * x[i] * x[j]
        P[i, i] += model.gyro_psd * dt * (x[0] * x[0] + x[1] * x[1] + x[2] * x[2]) + 1e-12 * dt


def _observe(model: Any, group: int, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> None:
    for i in range(3):
        y[i] = x[i]


def _slope(model: Any, group: int, x: np.ndarray, u: np.ndarray, H: np.ndarray) -> None:
    for i in range(3):
        for j in range(3):
            H[i, j] = 1.0 if i == j else 0.0


def _measurement_noise(model: Any, group: int, x: np.ndarray, u: np.ndarray, S: np.ndarray) -> None:
    for i in range(3):
        S[i, i] += model.accel_variance


def _constrain(model: Any, x: np.ndarray) -> None:
    norm = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    scale = 1.0 / norm if 0.0 < norm < math.inf else math.nan
    for i in range(3):
        x[i] *= scale


def _report(model: Any, x: np.ndarray, P: np.ndarray, memory: np.ndarray, row: np.ndarray) -> None:
    """Of the covariance the rotations about x and y; about s, level flight's z, nothing is known: NaN."""
    for i in range(3):
        row[E_DOWN + i] = x[i]
    # a small rotation r moves s by s x r, so r across s is -s x ds: rows of [s x] for x and y
    a, b = (0.0, -x[2], x[1]), (x[2], 0.0, -x[0])
    aa = ab = bb = 0.0
    for i in range(3):
        for j in range(3):
            aa += a[i] * P[i, j] * a[j]
            ab += a[i] * P[i, j] * b[j]
            bb += b[i] * P[i, j] * b[j]
    row[E_COV], row[E_COV + 1], row[E_COV + 3], row[E_COV + 4] = aa, ab, ab, bb
    row[E_GYRO_BIAS], row[E_GYRO_BIAS + 1] = memory[_BIAS], memory[_BIAS + 1]


def _three(model: Any) -> int:
    return 3


register(
    Tilt,
    size=_three,
    changed=_three,
    read=_three,
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
)


def build(settings: Mapping[str, Any], site: Site, sensors: SensorInfo, alignment: Alignment) -> Start:
    """The model and its first state from settings (see the catalogue), place, sensors and alignment."""
    rate_noise = max(settings["gyro_noise"], sensors.gyro_noise)
    model = Tilt(
        groups=np.array([[0, 3, 0, 3, 1]], np.int64),
        accel_variance=settings["accel_sigma"] ** 2,
        gyro_psd=0.5 * rate_noise**2,
        bias_time=settings["bias_time"],
        bias_start=np.array(alignment.gyro_bias if settings["bias_start"] == "aligned" else np.zeros(3), float),
    )
    x = np.empty(3)
    to_body(alignment.q_nb, 0.0, 0.0, 1.0, x)
    P = float(alignment.sigma_n[0]) ** 2 * np.eye(3)
    memory = np.full(MEMORY, np.nan)
    return Start(model, x, P, COARSE_TILT**2 * np.eye(3), memory=memory, inputs=INPUTS, measurements=3)
