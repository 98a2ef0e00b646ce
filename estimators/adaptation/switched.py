"""Switch: a measurement that turning or accelerating falsifies is left out (paper 004 eq. (23), paper 001 section 3.1).

    |w_z| > turn_rate   or   | |f|/g - 1 | > accel   :   the gain is zero, the gyro carries the attitude

What is falsified is the model's business (`disturbed`): the accelerometer as a plumb line, a course as a heading.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.adaptation.base import disturbed
from estimators.generic import register
from estimators.rows import ACCEL, GYRO
from estimators.types import Site


class Switched(NamedTuple):
    """Thresholds."""

    turn_rate: float  # rad/s, a of the papers
    accel: float  # b of paper 004, in parts of gravity
    gravity: float  # m/s2


def _admit(policy: Any, model: Any, row: np.ndarray, x: np.ndarray, trust: np.ndarray, used: np.ndarray) -> bool:
    x, y, z = row[ACCEL], row[ACCEL + 1], row[ACCEL + 2]
    off = abs(math.sqrt(x * x + y * y + z * z) / policy.gravity - 1.0) > policy.accel
    off |= abs(row[GYRO + 2]) > policy.turn_rate
    first, end, sensor = disturbed(model)
    refused = False
    for i in range(first, end):
        if used[i]:
            trust[sensor] = 0.0 if off else 1.0
            refused |= off
            used[i] = not off
    return refused


register(Switched, admit=_admit)


def make(settings: Mapping[str, Any], site: Site) -> Switched:
    """From the settings `switch_*`."""
    return Switched(settings["switch_turn_rate"], settings["switch_accel"], site.gravity)
