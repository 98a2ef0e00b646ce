"""Switch: leave out what turning or accelerating falsifies (Yao 2012, eq. (23); Zhao 2015, section 3.1).

    |w_z| > turn_rate   or   | |f|/g - 1 | > accel   :   the gain is zero, the gyro carries the attitude

What is falsified is the model's business (`disturbed`): the accelerometer as a plumb line, a course as a heading.
"""

import math
from typing import Any

import numpy as np

from estimators.adaptation.base import Trust
from estimators.models.base import Handle
from estimators.native import Number, Record
from estimators.records import Place, Sample
from estimators.settings import Setting

SETTINGS = {
    "switch_turn_rate": Setting(math.radians(2.0), "rad/s, switched: turning above it", above=0.0),
    "switch_accel": Setting(0.02, "switched: accelerating when |f|/g is further than that from 1", above=0.0),
}


class Parameters(Record):
    """Thresholds."""

    turn_rate: Number  # rad/s, a of the papers
    accel: Number  # b of Yao 2012, in parts of gravity
    gravity: Number  # m/s2


def admit(policy: Parameters, model: Handle, row: Sample, x: np.ndarray, trust: Trust, used: np.ndarray) -> bool:
    """Refuse what the vehicle's turning or accelerating falsifies."""
    f = row.accel_b
    off = abs(math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) / policy.gravity - 1.0) > policy.accel
    off |= abs(row.gyro_b[2]) > policy.turn_rate
    first, end, sensor = model.disturbed[0], model.disturbed[1], model.disturbed[2]
    refused = False
    for i in range(first, end):
        if used[i]:
            trust.trusted[sensor] = 0.0 if off else 1.0
            refused |= off
            used[i] = not off
    return refused


def configure(settings: Any, site: Place, policy: Parameters) -> None:
    """Set the parameters from the settings `switch_*`."""
    policy.turn_rate, policy.accel, policy.gravity = settings.switch_turn_rate, settings.switch_accel, site.gravity
