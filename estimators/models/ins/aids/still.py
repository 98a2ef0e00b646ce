"""Standstill: v = 0 and gyro = bias while a second without scatter says so."""

from typing import Any

import numpy as np

from estimators.jit import inner
from estimators.models.ins.layout import BA, BG, Kept, Motion, Shared, State, V
from estimators.native import Number, Record, Vector3
from estimators.plausible import MAX_SPEED, plausible
from estimators.records import Place, Sample, Sheet
from estimators.settings import Setting

NAME = READS_AS = "still"
ANGLE, REPORTED = False, False
PERIOD = 0.1  # s: errors are correlated, more often says nothing new
MOVING = 0.2  # m/s, and three sigma of the receiver

SETTINGS: dict[str, Setting] = {}


class Parameters(Record):
    """Parameters of the aid."""

    moving: Number  # m/s, a GNSS speed above is no noise of the receiver
    gyro_variance: Number  # (rad/s)^2 of a sample


class Memory(Record):
    """Holds the time of the last use."""

    t: Number  # s


class Readings(Record):
    """Holds the readings of a stationary vehicle."""

    vel_n: Vector3  # m/s
    rate_b: Vector3  # rad/s


@inner
def configure(settings: Any, site: Place, sensors: Sheet, own: Parameters) -> None:
    """Set the parameters."""
    own.moving = MOVING + 3.0 * max(settings.velocity_share * sensors.gnss_vel, 1e-3)
    own.gyro_variance = max(sensors.gyro_noise**2 / 2.0 * sensors.rate, 1e-10)


def reads(states: int) -> tuple[int, int]:
    """Velocity to gyro bias."""
    return V, BA


@inner
def measure(
    own: Parameters, model: Shared, row: Sample, x: State, kept: Memory, memory: Kept, u: Motion, z: Readings,
    variance: Readings, used: Any,
) -> None:  # fmt: skip
    """Take it where nothing contradicts the detector: a smooth acceleration scatters as little as standing."""
    flying = row.air_new and plausible(row.airspeed, MAX_SPEED) and row.airspeed >= model.speed_min
    moving = row.t - memory.fix_t < 1.0 and memory.speed > own.moving
    if flying or moving:
        memory.is_still = False
    if memory.is_still and not memory.fixed and not row.t - kept.t < PERIOD - 1e-6:
        kept.t = memory.aid_t = row.t
        for i in range(3):
            z.vel_n[i], z.rate_b[i] = 0.0, row.gyro_b[i]
            variance.vel_n[i], variance.rate_b[i] = 0.05**2, own.gyro_variance
            used.vel_n[i] = used.rate_b[i] = True


@inner
def observe(own: Parameters, model: Shared, x: State, u: Motion, y: np.ndarray) -> None:
    """Velocity and gyro bias."""
    for i in range(3):
        y[i] = x.vel_n[i]
        y[3 + i] = x.gyro_bias[i]


@inner
def slope(own: Parameters, model: Shared, x: State, u: Motion, H: np.ndarray) -> None:
    """Identity."""
    for i in range(3):
        H[i, V + i] = H[3 + i, BG + i] = 1.0
