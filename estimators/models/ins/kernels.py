"""The measurements of the navigator, put together from its aids, and what it reports."""

import math
from typing import Any

import numpy as np

from estimators.earth import move
from estimators.jit import inner
from estimators.models.base import FLAGS, STATE, report_attitude
from estimators.models.ins.aids import AIDS, GROUPED, by_group, in_turn
from estimators.models.ins.layout import BA, BG, P_, Kept, Motion, Shared, State, V
from estimators.native import Record, flags, local, vector
from estimators.past import WIDTH, keep
from estimators.records import Estimate, Sample
from estimators.rotations import attitude_matrix, to_nav, wrap, yaw
from estimators.turned import carried
from estimators.types import Status

AID_TIMEOUT, MAG_TIMEOUT = 2.0, 2.0  # s
_RUNNING, _COASTING = int(Status.RUNNING), int(Status.COASTING)


class _Readings(Record):
    """Measurements, a record of each group."""


Parameters = Shared.joined({aid.NAME: aid.Parameters for aid in AIDS})
Memory = Kept.joined({aid.NAME: aid.Memory for aid in AIDS})
_ORDER = sorted(GROUPED, key=lambda aid: not aid.REPORTED)  # the columns of the estimates have no room for all
Readings = _Readings.joined({aid.NAME: aid.Readings for aid in _ORDER}, size=STATE)
Used = Readings.flags(size=FLAGS)
Inputs = Motion.joined({"variance": _Readings.joined({aid.NAME: aid.Readings for aid in _ORDER})}, size=STATE)

_COUNT = sum(aid.Readings.dtype.itemsize // 8 for aid in GROUPED)
_measure_all = in_turn(AIDS)
_slope = by_group(lambda aid: aid.slope)
observe = by_group(lambda aid: aid.observe)


def measure(model: Shared, row: Sample, x: State, memory: Kept, u: Motion, z: Any, used: Any) -> int:
    """Let each aid measure; COASTING a while after the last velocity or field, and without the IMU."""
    chosen = flags(used)
    for i in range(_COUNT):
        chosen[i] = 0
    _keep(model, row.t, x, memory, u)
    memory.fixed = False
    _measure_all(model, row, x, memory, u, z, used)
    aided = row.t - memory.aid_t <= AID_TIMEOUT and row.t - memory.mag_t <= MAG_TIMEOUT
    return _RUNNING if aided and memory.good else _COASTING


@inner
def _keep(model: Shared, t: float, x: State, memory: Kept, u: Motion) -> None:
    """Store what later measurements compare with in the ring; and the attitude before this row's."""
    a, e, r = model.antenna_b, x.gyro_bias, u.rate_b
    wx, wy, wz = r[0] - e[0], r[1] - e[1], r[2] - e[2]
    lever, swing, now = local(3), local(3), local(WIDTH)
    to_nav(x.q_nb, a[0], a[1], a[2], lever)
    to_nav(x.q_nb, wy * a[2] - wz * a[1], wz * a[0] - wx * a[2], wx * a[1] - wy * a[0], swing)
    for i in range(3):
        now[i] = x.vel_n[i] + swing[i]
    move(x.lla, lever[0], lever[1], lever[2], now[3:6])
    now[6] = yaw(x.q_nb)
    now[7], now[8] = carried(memory.turned, swing[0], swing[1])
    for i in range(4):
        memory.q_nb[i] = x.q_nb[i]
    keep(memory.ring, t, now)


def slope(model: Shared, group: int, x: State, u: Motion, H: np.ndarray) -> None:
    """Derivative of a group's prediction."""
    for i in range(model.rows[group]):
        for j in range(model.states):
            H[i, j] = 0.0
    _slope(model, group, x, u, H)


def measurement_noise(model: Shared, group: int, x: State, u: Any, S: np.ndarray) -> None:
    """Variances that `measure` has set."""
    variance, start = vector(u.variance), model.start[group]
    for i in range(model.rows[group]):
        S[i, i] += variance[start + i]


def residual(model: Shared, group: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """Z - y, angles wrapped."""
    for i in range(model.rows[group]):
        out[i] = z[i] - y[i]
    if model.angle[group] != 0:
        out[0] = wrap(out[0])


def report(model: Shared, x: State, P: np.ndarray, memory: Any, answer: Estimate) -> None:
    """Attitude, biases, place and velocity; whether it stands, and what the field is worth."""
    report_attitude(x.q_nb, answer)
    C = local(3, 3)
    attitude_matrix(x.q_nb, C)
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += C[i, a] * P[a, b] * C[j, b]
            answer.att_cov[i, j] = answer.att_cov[j, i] = total
        answer.gyro_bias[i], answer.gyro_bias_sigma[i] = x.gyro_bias[i], math.sqrt(P[BG + i, BG + i])
        answer.accel_bias[i], answer.accel_bias_sigma[i] = x.accel_bias[i], math.sqrt(P[BA + i, BA + i])
        if model.report_place:
            answer.vel_n[i], answer.lla[i] = x.vel_n[i], x.lla[i]
            for j in range(3):
                answer.vel_cov[i, j], answer.pos_cov[i, j] = P[V + i, V + j], P[P_ + i, P_ + j]
            answer.vel_cov[i, i] += memory.late2 * memory.acceleration_n[i] ** 2
            answer.pos_cov[i, i] += model.place_wander[i]
    for i in range(3):
        memory.gnss.vel2[i], memory.gnss.place2[i] = P[V + i, V + i], P[P_ + i, P_ + i]
    answer.adaptation[0] = 1.0 if memory.is_still else 0.0
    answer.adaptation[1] = memory.field.inflation
    answer.adaptation[2] = memory.turned.refused
