"""Heading from motion, once: where the magnetometer has been given up, or never was there, and the heading is wrong.

See `turned`. The covariance is opened in the step before: what the filter believed about everything that goes with the
heading was wrong, too.
"""

import math
from typing import Any

from estimators.jit import inner
from estimators.models.ins.aids.baseline import Readings
from estimators.models.ins.layout import Kept, Motion, Shared, State
from estimators.native import Flag, Number, Record
from estimators.records import Place, Sample, Sheet
from estimators.rotations import yaw
from estimators.turned import FIELD_OFF, SURE, is_lost, turned_by

NAME, READS_AS = "realign", "baseline"

SETTINGS = {"field_off": FIELD_OFF}


class Parameters(Record):
    """Parameters of the aid."""

    off: Number  # rad


class Memory(Record):
    """What is due."""

    due: Flag  # the covariance is open


@inner
def configure(settings: Any, site: Place, sensors: Sheet, own: Parameters) -> None:
    """Set the parameters."""
    own.off = settings.field_off


@inner
def measure(
    own: Parameters, model: Shared, row: Sample, x: State, kept: Memory, memory: Kept, u: Motion, z: Readings,
    variance: Readings, used: Any,
) -> None:  # fmt: skip
    """Set the heading to what the motion shows when the filter's has contradicted it for a while."""
    s = memory.turned
    if kept.due:
        kept.due = False
        turn, sigma = turned_by(s, row.t, model.velocity)
        if sigma < SURE:
            z.heading, variance.heading = yaw(x.q_nb) + turn, sigma * sigma
            used.heading = 1
    elif (row.gnss_new or row.mag_new) and is_lost(s, row.t, math.isnan(memory.mag_t), model.velocity, own.off):
        memory.reopened = kept.due = True
