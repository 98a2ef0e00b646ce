"""Hand-held, no aid at all: v = 0 within 1 m/s and p = start within 1 m. This replaces an inertial low-pass."""

from typing import Any

from estimators.jit import inner
from estimators.models.ins.aids.gnss import Readings
from estimators.models.ins.layout import Kept, Motion, Shared, State
from estimators.native import Flag, Number, Record
from estimators.records import Place, Sample, Sheet
from estimators.settings import Setting

NAME, READS_AS = "pseudo", "gnss"
PERIOD = 0.1  # s

SETTINGS: dict[str, Setting] = {}


class Parameters(Record):
    """Parameters of the aid."""

    assumed: Flag


class Memory(Record):
    """Holds the time of the last use."""

    t: Number  # s


@inner
def configure(settings: Any, site: Place, sensors: Sheet, own: Parameters) -> None:
    """Set the parameters."""
    own.assumed = settings.aiding == 0  # "none"


@inner
def measure(
    own: Parameters, model: Shared, row: Sample, x: State, kept: Memory, memory: Kept, u: Motion, z: Readings,
    variance: Readings, used: Any,
) -> None:  # fmt: skip
    """Assume it ten times a second."""
    if own.assumed and not row.t - kept.t < PERIOD - 1e-6:
        kept.t = memory.aid_t = row.t
        memory.fixed = True
        for i in range(3):
            z.vel_n[i] = z.place_n[i] = 0.0
            variance.vel_n[i] = variance.place_n[i] = 1.0
            used.vel_n[i] = used.place_n[i] = True
