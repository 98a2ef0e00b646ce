"""Heading of a dual-antenna baseline, with its latency."""

from typing import Any

import numpy as np

from estimators.jit import inner
from estimators.models.ins.layout import PHI, RING_ANGLES, Kept, Motion, Shared, State, V
from estimators.native import Flag, Number, Record, local
from estimators.past import WIDTH, recall
from estimators.plausible import plausible
from estimators.records import Place, Sample, Sheet
from estimators.rotations import attitude_matrix, yaw
from estimators.settings import Setting

NAME = READS_AS = "baseline"
ANGLE, REPORTED = True, True
PERIOD = 1.0  # s: errors are correlated, more often says nothing new

SETTINGS = {
    "heading_aid": Setting(True, "use the dual-antenna heading where there is one"),
    "heading_share": Setting(4.5, "of the dual-antenna sigma, whose error is correlated", above=0.0),
}


class Parameters(Record):
    """Parameters of the aid."""

    wanted: Flag
    factor: Number  # on the reported sigma: its error is correlated


class Memory(Record):
    """Holds the time of the last use."""

    t: Number  # s


class Readings(Record):
    """Heading now: the measured one, turned on since."""

    heading: Number  # rad


@inner
def configure(settings: Any, site: Place, sensors: Sheet, own: Parameters) -> None:
    """Set the parameters."""
    own.wanted, own.factor = settings.heading_aid, settings.heading_share


def reads(states: int) -> tuple[int, int]:
    """Attitude."""
    return PHI, V


@inner
def measure(
    own: Parameters, model: Shared, row: Sample, x: State, kept: Memory, memory: Kept, u: Motion, z: Readings,
    variance: Readings, used: Any,
) -> None:  # fmt: skip
    """Once in `PERIOD`, when the ring still knows its time."""
    due = own.wanted and row.heading_new and plausible(row.heading, 100.0) and not row.t - kept.t < PERIOD - 1e-6
    then = local(WIDTH)
    if due and recall(memory.ring, row.heading_t, RING_ANGLES, then):
        kept.t = row.t
        sigma = own.factor * row.heading_sigma
        z.heading = row.heading + (yaw(x.q_nb) - then[6])
        variance.heading = sigma * sigma
        used.heading = 1 if sigma > 0.0 else 0


@inner
def observe(own: Parameters, model: Shared, x: State, u: Motion, y: np.ndarray) -> None:
    """Heading."""
    y[0] = yaw(x.q_nb)


@inner
def slope(own: Parameters, model: Shared, x: State, u: Motion, H: np.ndarray) -> None:
    """Write the slope of the baseline's heading by rotations about navigation axes."""
    C = local(3, 3)
    attitude_matrix(x.q_nb, C)
    horizontal2 = C[0, 0] * C[0, 0] + C[0, 1] * C[0, 1]
    H[0, PHI] = -C[0, 2] * C[0, 0] / horizontal2
    H[0, PHI + 1] = -C[0, 2] * C[0, 1] / horizontal2
    H[0, PHI + 2] = 1.0
