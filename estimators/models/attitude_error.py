"""Attitude error and gyro bias error about an attitude that the gyro integrates (Tian 2011).

Raw state: `q_nb` (4), gyro bias e (3, rad/s). Error (6): quaternion error vector q_e, half the small rotation in body
axes, `q = q_estimated (x) (sqrt(1 - q_e^2), q_e)`, and the bias error. After each correction the raw state takes it all
(feedback, the error is zero again).

    q_e' = -[w x] q_e - 1/2 d_e,   d_e' = noise,   w = gyro - e                                  eq. (2)
    f_b = C_bn G,  m_b = C_bn M,   slopes 2 [f_b x], 2 [m_b x]                                    eq. (3), (4)

with G = (0, 0, -g) and M the local field. The gyro of a step is the mean of its two ends. Accelerometer and
magnetometer are two groups, so that an adaptation (the paper's is `fuzzy`) treats them apart.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from estimators import adaptation
from estimators.alignment import ALIGNED, Alignment, turned_sigmas
from estimators.jit import inner
from estimators.models.base import FLAGS, STATE, Group, Layout, report_attitude
from estimators.native import Flags3, Matrix3, Number, Record, Vector3, Vector4, local
from estimators.plausible import MAX_FIELD, MAX_FORCE, MAX_RATE, plausible
from estimators.records import Estimate, Place, Sample, Sheet
from estimators.rotations import normalise, rotation_between, rotation_slopes, to_body, turn
from estimators.settings import Setting
from estimators.types import Status

ERROR, BIAS = slice(0, 3), slice(3, 6)  # of the error
FORCE, FIELD = range(2)  # groups
GYRO_TIMEOUT, MAG_TIMEOUT = 0.5, 1.0  # s
_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)

SETTINGS = {
    **ALIGNED,
    "noise": Setting(
        "practical",
        "sensors: R from the data sheet; from-ground: from the stationary stretch; practical: the settings below",
        ("practical", "from-ground", "sensors"),
    ),
    "accel_sigma": Setting(3.0, "m/s2, practical: manoeuvres and vibration, not sensor noise", above=0.0),
    "mag_sigma": Setting(4e-6, "T, practical", above=0.0),
    "bias_walk": Setting(3e-5, "rad/s per sqrt(s), random walk of the gyro bias", minimum=0.0),
    **adaptation.settings(),
}


class Parameters(Record):
    """Parameters of the model."""

    gravity_n: Vector3  # m/s2, G
    mag_n: Vector3  # T, M
    R_accel: Matrix3  # (m/s2)^2
    R_mag: Matrix3  # T2
    gyro_psd: Number  # rad2/s, white noise of the rate
    bias_noise: Number  # (rad/s)^2 per second


class State(Record, size=STATE):
    """The raw state."""

    q_nb: Vector4
    gyro_bias: Vector3  # rad/s


class Inputs(Record, size=STATE):
    """The gyro."""

    rate_b: Vector3  # rad/s, mean of the step


class Memory(Record):
    """Holds the model's memory from row to row; NaN: not yet seen."""

    rate_b: Vector3  # rad/s, last gyro
    gyro_t: Number  # s, when it was there
    mag_t: Number  # s, when the magnetometer was there


class Readings(Record, size=STATE):
    """Measurements."""

    accel_b: Vector3
    mag_b: Vector3


class Used(Record, size=FLAGS):
    """Flags the measurements used in this row."""

    accel_b: Flags3
    mag_b: Flags3


@inner
def mean_rate(row: Sample, kept: np.ndarray, out: np.ndarray) -> bool:
    """`out` (3,) = mean gyro of this row and the last, `kept` (3,); the last alone when it is missing (False)."""
    there = True
    for i in range(3):
        there &= plausible(row.gyro_b[i], MAX_RATE)
    for i in range(3):
        last = kept[i]
        now = row.gyro_b[i] if there else last
        if math.isnan(last):
            last = now
        out[i] = 0.5 * (last + now) if math.isfinite(now) else 0.0
        kept[i] = now
    return there


def load(model: Parameters, row: Sample, x: State, memory: Memory, u: Inputs) -> None:
    """Rate of the step."""
    if mean_rate(row, memory.rate_b, u.rate_b) or math.isnan(memory.gyro_t):
        memory.gyro_t = row.t


def measure(model: Parameters, row: Sample, x: State, memory: Memory, u: Inputs, z: Readings, used: Used) -> int:
    """Both vectors; COASTING without the accelerometer, and a while without gyro or field."""
    carried, mag = True, row.mag_new
    for i in range(3):
        z.accel_b[i], z.mag_b[i] = row.accel_b[i], row.mag_b[i]
        force, field = plausible(row.accel_b[i], MAX_FORCE), row.mag_new and plausible(row.mag_b[i], MAX_FIELD)
        used.accel_b[i], used.mag_b[i] = force, field
        carried &= force
        mag &= field
    if mag or math.isnan(memory.mag_t):
        memory.mag_t = row.t
    carried = carried and row.t - memory.gyro_t <= GYRO_TIMEOUT
    return _RUNNING if carried and row.t - memory.mag_t <= MAG_TIMEOUT else _COASTING


def propagate(model: Parameters, x: State, u: Inputs, dt: float, out: State) -> None:
    """Turn the attitude by the corrected gyro."""
    w, e = u.rate_b, x.gyro_bias
    turn(x.q_nb, (w[0] - e[0]) * dt, (w[1] - e[1]) * dt, (w[2] - e[2]) * dt, out.q_nb)
    for i in range(3):
        out.gyro_bias[i] = e[i]


def transition(model: Parameters, x: State, u: Inputs, dt: float, F: np.ndarray) -> None:
    """Derivatives of the attitude error by itself and the bias error."""
    w, e = u.rate_b, x.gyro_bias
    E, J = local(3, 3), local(3, 3)
    rotation_slopes((w[0] - e[0]) * dt, (w[1] - e[1]) * dt, (w[2] - e[2]) * dt, E, J)
    for i in range(3):
        for j in range(3):
            F[i, j] = E[i, j]
            F[i, 3 + j] = -0.5 * dt * J[i, j]


def process_noise(model: Parameters, x: State, u: Inputs, dt: float, P: np.ndarray) -> None:
    """White noise of the rate, random walk of the bias."""
    for i in range(3):
        P[i, i] += 0.25 * model.gyro_psd * dt
        P[3 + i, 3 + i] += model.bias_noise * dt


def observe(model: Parameters, group: int, x: State, u: Inputs, y: np.ndarray) -> None:
    """Gravity or field in body axes."""
    v = model.gravity_n if group == FORCE else model.mag_n
    to_body(x.q_nb, v[0], v[1], v[2], y)


def slope(model: Parameters, group: int, x: State, u: Inputs, H: np.ndarray) -> None:
    """Twice the cross-product matrix of it."""
    v, y = model.gravity_n if group == FORCE else model.mag_n, local(3)
    to_body(x.q_nb, v[0], v[1], v[2], y)
    H[0, 0] = H[1, 1] = H[2, 2] = 0.0
    H[0, 1], H[1, 0] = -2.0 * y[2], 2.0 * y[2]
    H[0, 2], H[2, 0] = 2.0 * y[1], -2.0 * y[1]
    H[1, 2], H[2, 1] = -2.0 * y[0], 2.0 * y[0]


def measurement_noise(model: Parameters, group: int, x: State, u: Inputs, S: np.ndarray) -> None:
    """R of the sensor."""
    R = model.R_accel if group == FORCE else model.R_mag
    for i in range(3):
        for j in range(i + 1):
            S[i, j] += R[i, j]


def retract(model: Parameters, x: State, dx: np.ndarray, out: State) -> None:
    """Turn by twice the error vector; add the bias error."""
    turn(x.q_nb, 2.0 * dx[0], 2.0 * dx[1], 2.0 * dx[2], out.q_nb)
    for i in range(3):
        out.gyro_bias[i] = x.gyro_bias[i] + dx[3 + i]


def difference(model: Parameters, x: State, origin: State, out: np.ndarray) -> None:
    """Half the rotation from `origin` to x."""
    rotation_between(origin.q_nb, x.q_nb, out)
    for i in range(3):
        out[i] *= 0.5


def constrain(model: Parameters, x: State) -> None:
    """Normalise the quaternion."""
    normalise(x.q_nb)


def report(model: Parameters, x: State, P: np.ndarray, memory: Memory, answer: Estimate) -> None:
    """Attitude and gyro bias."""
    report_attitude(x.q_nb, answer)
    for i in range(3):
        for j in range(3):
            answer.att_cov[i, j] = 4.0 * P[i, j]
        answer.gyro_bias[i], answer.gyro_bias_sigma[i] = x.gyro_bias[i], math.sqrt(P[3 + i, 3 + i])


_FLOOR = (1e-5, 1e-14, 1e-7)  # m/s2, T, rad/s/sqrt(Hz): no sensor is taken for better than this


def layout(settings: Mapping[str, Any]) -> Layout:
    """Sizes of the model."""
    groups = Group(0, 3, 0, 3, False), Group(3, 3, 0, 3, False)
    return Layout(raw=7, size=6, changed=3, read=6, groups=groups, magnetic=(3, 6, 1))


_SENSORS, _FROM_GROUND = (SETTINGS["noise"].choices.index(name) for name in ("sensors", "from-ground"))


def build(
    settings: Any, site: Place, sensors: Sheet, alignment: Alignment, model: Parameters, memory: Memory, x: State,
    P: np.ndarray, P_restart: np.ndarray,
) -> None:  # fmt: skip
    """Set parameters and first state from settings, place, sensors and alignment."""
    accel, mag, seen = settings.accel_sigma, settings.mag_sigma, True
    if settings.noise == _SENSORS:
        accel, mag = sensors.accel_noise * math.sqrt(sensors.rate / 2), sensors.mag_noise
    accel, mag = max(accel, _FLOOR[0]) ** 2, max(mag, _FLOOR[1]) ** 2
    ground = settings.noise == _FROM_GROUND and alignment.still
    for i in range(3):
        for j in range(3):
            seen &= math.isfinite(alignment.mag_cov[i, j])
    for i in range(3):
        for j in range(3):
            one = 1.0 if i == j else 0.0
            model.R_accel[i, j] = alignment.accel_cov[i, j] + _FLOOR[0] ** 2 * one if ground else accel * one
            model.R_mag[i, j] = alignment.mag_cov[i, j] + _FLOOR[1] ** 2 * one if ground and seen else mag * one
    for i in range(3):
        model.gravity_n[i], model.mag_n[i] = 0.0, site.mag_n[i]
    model.gravity_n[2] = -site.gravity
    model.gyro_psd = 0.5 * max(sensors.gyro_noise, _FLOOR[2]) ** 2
    model.bias_noise = settings.bias_walk**2
    turned_sigmas(alignment, 0.25, P)
    for i in range(4):
        x.q_nb[i] = alignment.q_nb[i]
    for i in range(3):
        x.gyro_bias[i] = alignment.gyro_bias[i]
        P[i, i] += 1e-12
        P[3 + i, 3 + i] = alignment.gyro_bias_sigma[i] ** 2
        P_restart[i, i], P_restart[3 + i, 3 + i] = 0.1, sensors.gyro_bias**2 + 1e-8
