"""The direction of gravity in body axes, no heading (Yao 2012).

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
from typing import Any

import numpy as np

from estimators import adaptation
from estimators.alignment import ALIGNED, COARSE_TILT, Alignment
from estimators.jit import inner
from estimators.models.attitude_error import GYRO_TIMEOUT, mean_rate
from estimators.models.base import FLAGS, STATE, Group, Layout
from estimators.native import Flags3, Number, Record, Vector3, local
from estimators.plausible import MAX_FORCE, plausible
from estimators.records import Estimate, Place, Sample, Sheet
from estimators.rotations import rotation_slopes, to_body
from estimators.settings import Setting
from estimators.types import Status

_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)

SETTINGS = {
    **ALIGNED,
    "accel_sigma": Setting(0.05, "of the measured direction of gravity, in parts of gravity", above=0.0),
    "gyro_noise": Setting(3e-4, "rad/s/sqrt(Hz), at least that, beside the data sheet's", minimum=0.0),
    "bias_time": Setting(100.0, "s, low-pass of the gyro bias; shorter swings with the tilt", above=0.0),
    "bias_start": Setting("aligned", "gyro bias before it is learned", ("aligned", "zero")),
    **adaptation.settings(switch_accel=0.01),
}


class Parameters(Record):
    """Parameters of the model."""

    accel_variance: Number  # of an element of z
    gyro_psd: Number  # rad2/s
    bias_time: Number  # s
    bias_start: Vector3  # rad/s


class State(Record, size=STATE):
    """The state."""

    down_b: Vector3  # s


class Inputs(Record, size=STATE):
    """The gyro."""

    rate_b: Vector3  # rad/s, mean of the step less the bias


class Memory(Record):
    """Holds the model's memory from row to row; NaN: not yet seen."""

    rate_b: Vector3  # rad/s, last gyro
    gyro_t: Number  # s, when it was there
    t: Number  # s, last row
    predicted_b: Vector3  # s before the last correction
    gyro_bias: Vector3  # rad/s, e


class Readings(Record, size=STATE):
    """Measurements."""

    down_b: Vector3


class Used(Record, size=FLAGS):
    """Flags the measurements used in this row."""

    down_b: Flags3


def load(model: Parameters, row: Sample, x: State, memory: Memory, u: Inputs) -> None:
    """Rate of the step, less the bias that the last correction has taught."""
    if math.isnan(memory.t):
        for i in range(3):
            memory.gyro_bias[i] = model.bias_start[i]
    elif math.isfinite(memory.predicted_b[0]):
        _learn(model, row.t - memory.t, x.down_b, memory)
    memory.t = row.t
    if mean_rate(row, memory.rate_b, u.rate_b) or math.isnan(memory.gyro_t):
        memory.gyro_t = row.t
    for i in range(3):
        u.rate_b[i] -= memory.gyro_bias[i]


@inner
def _learn(model: Parameters, dt: float, s: np.ndarray, memory: Memory) -> None:
    """Update the bias from the last correction (corrected - predicted); uses the following dt."""
    p, bias = memory.predicted_b, memory.gyro_bias
    dx, dy, dz = s[0] - p[0], s[1] - p[1], s[2] - p[2]
    share = min(1.0, dt / model.bias_time) / dt if 0.0 < dt < 1.0 else 0.0
    bias[0] += share * (s[1] * dz - s[2] * dy)
    bias[1] += share * (s[2] * dx - s[0] * dz)
    bias[2] += share * (s[0] * dy - s[1] * dx)


def measure(model: Parameters, row: Sample, x: State, memory: Memory, u: Inputs, z: Readings, used: Used) -> int:
    """Direction of the specific force; COASTING without it, and a while without gyro."""
    f = row.accel_b
    norm = math.sqrt(f[0] ** 2 + f[1] ** 2 + f[2] ** 2)
    there = plausible(norm, MAX_FORCE) and norm > 0.0
    for i in range(3):
        memory.predicted_b[i] = x.down_b[i]
        z.down_b[i] = -f[i] / norm if there else math.nan
        used.down_b[i] = there
    return _RUNNING if there and row.t - memory.gyro_t <= GYRO_TIMEOUT else _COASTING


def propagate(model: Parameters, x: State, u: Inputs, dt: float, out: State) -> None:
    """Turn the body under the direction."""
    F, J, w, s = local(3, 3), local(3, 3), u.rate_b, x.down_b
    rotation_slopes(w[0] * dt, w[1] * dt, w[2] * dt, F, J)
    for i in range(3):
        out.down_b[i] = F[i, 0] * s[0] + F[i, 1] * s[1] + F[i, 2] * s[2]


def transition(model: Parameters, x: State, u: Inputs, dt: float, F: np.ndarray) -> None:
    """The rotation itself."""
    J, w = local(3, 3), u.rate_b
    rotation_slopes(w[0] * dt, w[1] * dt, w[2] * dt, F, J)


def process_noise(model: Parameters, x: State, u: Inputs, dt: float, P: np.ndarray) -> None:
    """Noise n of the rate moves s by -n x s."""
    s = x.down_b
    for i in range(3):
        for j in range(3):
            P[i, j] -= model.gyro_psd * dt * s[i] * s[j]
        P[i, i] += model.gyro_psd * dt * (s[0] * s[0] + s[1] * s[1] + s[2] * s[2]) + 1e-12 * dt


def observe(model: Parameters, group: int, x: State, u: Inputs, y: np.ndarray) -> None:
    """The direction itself."""
    for i in range(3):
        y[i] = x.down_b[i]


def slope(model: Parameters, group: int, x: State, u: Inputs, H: np.ndarray) -> None:
    """Identity."""
    for i in range(3):
        for j in range(3):
            H[i, j] = 1.0 if i == j else 0.0


def measurement_noise(model: Parameters, group: int, x: State, u: Inputs, S: np.ndarray) -> None:
    """The same for each element."""
    for i in range(3):
        S[i, i] += model.accel_variance


def constrain(model: Parameters, x: State) -> None:
    """Normalise the direction."""
    s = x.down_b
    norm = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
    scale = 1.0 / norm if 0.0 < norm < math.inf else math.nan
    for i in range(3):
        s[i] *= scale


def report(model: Parameters, x: State, P: np.ndarray, memory: Memory, answer: Estimate) -> None:
    """Down vector; of the covariance the rotations about x and y: about s, level flight's z, nothing is known (NaN)."""
    s = x.down_b
    for i in range(3):
        answer.down_b[i] = s[i]
    # a small rotation r moves s by s x r, so r across s is -s x ds: rows of [s x] for x and y
    a, b = (0.0, -s[2], s[1]), (s[2], 0.0, -s[0])
    aa = ab = bb = 0.0
    for i in range(3):
        for j in range(3):
            aa += a[i] * P[i, j] * a[j]
            ab += a[i] * P[i, j] * b[j]
            bb += b[i] * P[i, j] * b[j]
    cov = answer.att_cov
    cov[0, 0], cov[0, 1], cov[1, 0], cov[1, 1] = aa, ab, ab, bb
    answer.gyro_bias[0], answer.gyro_bias[1] = memory.gyro_bias[0], memory.gyro_bias[1]


def layout(settings: Mapping[str, Any]) -> Layout:
    """Sizes of the model."""
    return Layout(raw=3, size=3, changed=3, read=3, groups=(Group(0, 3, 0, 3, True),))


_ALIGNED = SETTINGS["bias_start"].choices.index("aligned")


def build(
    settings: Any, site: Place, sensors: Sheet, alignment: Alignment, model: Parameters, memory: Memory, x: State,
    P: np.ndarray, P_restart: np.ndarray,
) -> None:  # fmt: skip
    """Set parameters and first state from settings, place, sensors and alignment."""
    model.accel_variance = settings.accel_sigma**2
    model.gyro_psd = 0.5 * max(settings.gyro_noise, sensors.gyro_noise) ** 2
    model.bias_time = settings.bias_time
    to_body(alignment.q_nb, 0.0, 0.0, 1.0, x.down_b)
    for i in range(3):
        model.bias_start[i] = alignment.gyro_bias[i] if settings.bias_start == _ALIGNED else 0.0
        P[i, i], P_restart[i, i] = alignment.sigma_n[0] ** 2, COARSE_TILT**2
