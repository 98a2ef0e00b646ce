"""Magnetic disturbance rejection: a field that cannot be the Earth's is left out, the gyro carries the heading.

    | |m|/|M| - 1 | > norm,   | dip(m) - dip(M) | > dip,   | azimuth(m) - azimuth(M) | > turn   :   refused

with the field m as the predicted attitude turns it into navigation axes and M the local field. Norm and dip are the
classical signs of iron; a disturbance from the side leaves both nearly as they are (6 uT across a horizontal field of
23 uT: 1 % and 1 deg) and turns the needle by 15 deg, which only a heading that the gyro has carried can tell. A
disturbed sample refuses those of the next `hold` as well (alternating currents pass through zero). Refused for
`patience` without a break, the field is believed again until it fits: a heading may be wrong, too, and at the start it
is the field that says where north is.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.adaptation.base import SENSORS, magnetic
from estimators.generic import register
from estimators.rotations import to_nav, wrap
from estimators.rows import MAG, T
from estimators.types import Site

# in `trust`: s, refused since (0: not) and last seen disturbed (0: never), both a second later, so that 0 is free;
# 1 once the field has fitted
_SINCE, _BAD, _FITTED = SENSORS, SENSORS + 1, SENSORS + 2


class Magnetic(NamedTuple):
    """Limits, and the field they are about."""

    norm: float  # relative
    dip: float  # rad
    turn: float  # rad
    hold: float  # s
    patience: float  # s
    strength: float  # T
    down: float  # rad, dip of the local field
    azimuth: float  # rad, its declination


def _admit(policy: Any, model: Any, row: np.ndarray, x: np.ndarray, trust: np.ndarray, used: np.ndarray) -> bool:
    first, end, sensor = magnetic(model)
    there = end > first
    for i in range(first, end):
        there = there and used[i]
    if not there:
        return False
    m, now = np.empty(3), row[T] + 1.0
    to_nav(x, row[MAG], row[MAG + 1], row[MAG + 2], m)
    level = math.hypot(m[0], m[1])
    off = abs(math.hypot(level, m[2]) / policy.strength - 1.0) > policy.norm
    off |= abs(math.atan2(m[2], level) - policy.down) > policy.dip
    off |= abs(wrap(math.atan2(m[1], m[0]) - policy.azimuth)) > policy.turn
    if off:
        trust[_BAD] = now
    elif trust[_BAD] == 0.0 or now - trust[_BAD] >= policy.hold:
        trust[_FITTED], trust[_SINCE] = 1.0, 0.0
    disturbed = trust[_FITTED] == 1.0 and trust[_BAD] > 0.0 and now - trust[_BAD] < policy.hold
    if disturbed and trust[_SINCE] == 0.0:
        trust[_SINCE] = now
    refused = bool(disturbed and now - trust[_SINCE] < policy.patience)
    trust[sensor] = 0.0 if refused else 1.0
    for i in range(first, end):
        used[i] = not refused
    return refused


register(Magnetic, admit=_admit)


def make(settings: Mapping[str, Any], site: Site) -> Magnetic:
    """From the settings `magnetic_*` and the local field."""
    north, east, down = site.mag_n
    level = math.hypot(north, east)
    return Magnetic(
        norm=settings["magnetic_norm"],
        dip=settings["magnetic_dip"],
        turn=settings["magnetic_turn"],
        hold=settings["magnetic_hold"],
        patience=settings["magnetic_patience"],
        strength=math.hypot(level, down),
        down=math.atan2(down, level),
        azimuth=math.atan2(east, north),
    )
