"""Airspeed as body velocity: C_bn (v - wind) = V (cos i, 0, sin i), i the incidence of cruise, wide across.

Without GNSS v itself is the velocity in the air mass.
"""

from typing import Any

import numpy as np

from estimators.elementary import cos, sin
from estimators.jit import inner
from estimators.models.ins.layout import P_, PHI, WIND, Kept, Motion, Shared, State, V
from estimators.native import Flag, Number, Record, Vector3, local
from estimators.plausible import MAX_SPEED, plausible
from estimators.records import Place, Sample, Sheet
from estimators.rotations import attitude_matrix, to_body
from estimators.settings import Setting

NAME = READS_AS = "airspeed"
ANGLE, REPORTED = False, True
PERIOD = 0.1  # s: errors are correlated, more often says nothing new
VANE = 0.03  # of the airspeed, across, with a vane

SETTINGS = {
    "speed_sigma": Setting(1.0, "m/s, of the airspeed along the body", above=0.0),
    "incidence": Setting(
        0.05, "rad, angle of attack without vane; aeroplanes cruise at 2 to 4 deg", minimum=-0.3, maximum=0.3
    ),
    "side": Setting(0.1, "of the airspeed, sideways, without vane", above=0.0),
    "vertical": Setting(0.15, "of the airspeed, downwards, without vane", above=0.0),
}


class Parameters(Record):
    """Parameters of the aid."""

    wanted: Flag
    sigma: Number  # m/s
    side: Number  # of V
    vertical: Number  # of V
    incidence: Number  # rad


class Memory(Record):
    """Holds the time of the last use."""

    t: Number  # s


class Readings(Record):
    """Velocity in the air mass, body axes."""

    vel_b: Vector3  # m/s


@inner
def configure(settings: Any, site: Place, sensors: Sheet, own: Parameters) -> None:
    """Set the parameters."""
    own.wanted = settings.aiding >= 2  # "airspeed", "gnss+airspeed"
    own.sigma, own.side, own.vertical = settings.speed_sigma, settings.side, settings.vertical
    own.incidence = settings.incidence


def reads(states: int) -> tuple[int, int]:
    """Attitude and velocity, and everything to the wind where there is one."""
    return PHI, states if states > WIND else P_


@inner
def measure(
    own: Parameters, model: Shared, row: Sample, x: State, kept: Memory, memory: Kept, u: Motion, z: Readings,
    variance: Readings, used: Any,
) -> None:  # fmt: skip
    """Ten times a second, above the speed that may be wind on the ground."""
    flying = row.air_new and plausible(row.airspeed, MAX_SPEED) and row.airspeed >= model.speed_min
    if not (own.wanted and flying) or row.t - kept.t < PERIOD - 1e-6:
        return
    speed, alpha, beta = row.airspeed, own.incidence, 0.0
    side, vertical = own.side, own.vertical
    if plausible(row.beta, 1.5):
        side, beta = VANE, row.beta
    if plausible(row.alpha, 1.5):
        vertical, alpha = VANE, row.alpha
    z.vel_b[0] = speed * cos(alpha) * cos(beta)
    z.vel_b[1] = speed * sin(beta)
    z.vel_b[2] = speed * sin(alpha) * cos(beta)
    variance.vel_b[0] = own.sigma**2
    variance.vel_b[1] = (side * speed) ** 2
    variance.vel_b[2] = (vertical * speed) ** 2
    for i in range(3):
        used.vel_b[i] = True
    kept.t = memory.aid_t = row.t


@inner
def observe(own: Parameters, model: Shared, x: State, u: Motion, y: np.ndarray) -> None:
    """Velocity less the wind, in body axes."""
    north, east, down = x.vel_n[0], x.vel_n[1], x.vel_n[2]
    if model.states > WIND:
        north, east, down = north - x.wind_n[0], east - x.wind_n[1], down - x.wind_n[2]
    to_body(x.q_nb, north, east, down, y)


@inner
def slope(own: Parameters, model: Shared, x: State, u: Motion, H: np.ndarray) -> None:
    """Write the slope: by velocity and wind C_bn, by attitude from C_bn exp(-phi) v = C_bn (v + v x phi)."""
    C, v = local(3, 3), local(3)
    attitude_matrix(x.q_nb, C)
    for i in range(3):
        v[i] = x.vel_n[i]
        if model.states > WIND:
            v[i] -= x.wind_n[i]
    for i in range(3):
        for j in range(3):
            H[i, V + j] = C[i, j]
            if model.states > WIND:
                H[i, WIND + j] = -C[i, j]
        H[i, PHI] = C[i, 1] * v[2] - C[i, 2] * v[1]
        H[i, PHI + 1] = C[i, 2] * v[0] - C[i, 0] * v[2]
        H[i, PHI + 2] = C[i, 0] * v[1] - C[i, 1] * v[0]
