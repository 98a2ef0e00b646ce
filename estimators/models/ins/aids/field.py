"""Magnetic heading: the azimuth of the field alone (tilt columns zero, for every filter).

A disturbed field must not tilt the horizon. Norm and dip away from the local field inflate the noise.
"""

from typing import Any

import numpy as np

from estimators.elementary import atan2, hypot
from estimators.jit import inner
from estimators.models.ins.layout import HI, PHI, WIND, Kept, Motion, Shared, State
from estimators.native import Number, Record, local
from estimators.plausible import MAX_FIELD, plausible
from estimators.records import Place, Sample, Sheet
from estimators.rotations import attitude_matrix, to_nav, wrap
from estimators.settings import Setting
from estimators.turned import refuse_field

NAME = READS_AS = "field"
ANGLE, REPORTED = True, True

SETTINGS = {
    "mag_share": Setting(2.0, "of the hard iron left over: noise of the field's direction", minimum=0.0),
    "mag_sigma": Setting(0.008, "rad, besides, of the direction of the field", above=0.0),
    "field_period": Setting(1.0, "s, from one use of the field to the next: errors between are the same", minimum=0.0),
    "norm_scale": Setting(0.05, "relative error of the field's norm that doubles the noise", above=0.0),
    "dip_scale": Setting(0.1, "rad, error of the dip that doubles the noise", above=0.0),
}


class Parameters(Record):
    """Parameters of the aid."""

    sigma: Number  # rad, of the direction
    period: Number  # s
    norm_scale: Number  # relative
    dip_scale: Number  # rad


class Memory(Record):
    """Holds how the last field reading was weighted."""

    inflation: Number  # factor on its variance


class Readings(Record):
    """Azimuth of the local field."""

    azimuth: Number  # rad


@inner
def configure(settings: Any, site: Place, sensors: Sheet, own: Parameters) -> None:
    """Set the parameters."""
    n = site.mag_n
    strength = hypot(hypot(n[0], n[1]), n[2])
    own.sigma = hypot(settings.mag_sigma, settings.mag_share * sensors.mag_bias / strength)
    own.period, own.norm_scale, own.dip_scale = settings.field_period, settings.norm_scale, settings.dip_scale


def reads(states: int) -> tuple[int, int]:
    """Everything but the wind."""
    return PHI, min(states, WIND)


@inner
def _field_n(model: Shared, x: State, u: Motion, out: np.ndarray) -> None:
    """Field as the magnetometer and the attitude have it, hard iron removed, in NED."""
    b = u.mag_b
    if model.states > HI:
        h = x.hard_iron
        to_nav(x.q_nb, b[0] - h[0], b[1] - h[1], b[2] - h[2], out)
    else:
        to_nav(x.q_nb, b[0], b[1], b[2], out)


@inner
def measure(
    own: Parameters, model: Shared, row: Sample, x: State, kept: Memory, memory: Kept, u: Motion, z: Readings,
    variance: Readings, used: Any,
) -> None:  # fmt: skip
    """Once in `period`, unless it is vertical."""
    if not row.mag_new or row.t - memory.mag_t < own.period - 1e-6:
        return
    for i in range(3):
        if not plausible(row.mag_b[i], MAX_FIELD):
            return
        u.mag_b[i] = row.mag_b[i]
    m, n = local(3), model.mag_n
    _field_n(model, x, u, m)
    horizontal, known = hypot(m[0], m[1]), hypot(n[0], n[1])
    norm, norm_n = hypot(horizontal, m[2]), hypot(known, n[2])
    if not horizontal > 0.01 * norm:
        return
    # how far from the local field, in units that each double the noise
    off = (norm / norm_n - 1.0) / own.norm_scale
    dip = (atan2(m[2], horizontal) - atan2(n[2], known)) / own.dip_scale
    wrong = off * off + dip * dip
    kept.inflation = 1.0 + wrong + 0.1 * wrong * wrong
    azimuth = atan2(n[1], n[0])
    innovation = wrap(azimuth - atan2(m[1], m[0]))
    if refuse_field(memory.turned, row.t, innovation, model.velocity, model.realign.off):
        return
    sigma = own.sigma * norm_n / known
    z.azimuth = azimuth
    variance.azimuth = sigma * sigma * kept.inflation
    used.azimuth = 1
    memory.mag_t = row.t


@inner
def observe(own: Parameters, model: Shared, x: State, u: Motion, y: np.ndarray) -> None:
    """Azimuth of the field as read."""
    m = local(3)
    _field_n(model, x, u, m)
    y[0] = atan2(m[1], m[0])


@inner
def slope(own: Parameters, model: Shared, x: State, u: Motion, H: np.ndarray) -> None:
    """One for the heading; the hard iron turns the field."""
    H[0, PHI + 2] = 1.0
    if model.states > HI:
        C, m = local(3, 3), local(3)
        attitude_matrix(x.q_nb, C)
        _field_n(model, x, u, m)
        horizontal2 = m[0] * m[0] + m[1] * m[1]
        for i in range(3):
            H[0, HI + i] = (m[1] * C[i, 0] - m[0] * C[i, 1]) / horizontal2
