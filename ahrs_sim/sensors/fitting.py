"""What an instrument is made from: its grade, its place in the aircraft, its random streams, its faults."""

import datetime
from dataclasses import dataclass

import numpy as np

from ahrs_sim.scenario import seeds
from ahrs_sim.sensors.faults import Channel, Faults
from ahrs_sim.sensors.grade import FiguresT, Grade
from ahrs_sim.sensors.sampling import divider


@dataclass(frozen=True)
class Fitting:
    """One suite's unit, fitted into the aircraft."""

    suite: str
    grade: Grade
    faults: Faults
    seed: int
    dt: float  # s between rows of the truth
    epoch: datetime.datetime
    start_lla: np.ndarray  # (3,) rad, rad, m
    position: np.ndarray  # m, FRD from where the centre of gravity is at first
    mount: np.ndarray  # C_sb (3, 3), body to sensor axes, known to the unit
    turned: np.ndarray  # (3, 3) from the assumed sensor axes to the true ones (mounting error)
    where: str  # for messages

    def figures(self, section: str, cls: type[FiguresT]) -> FiguresT:
        """The figures of a section of the grade."""
        return self.grade.figures(section, cls)

    def every(self, rate: float, section: str) -> int:
        """Rows of the truth per sample at `rate` (Hz)."""
        return divider(rate, self.dt, f"{self.where}: [{section}]")

    def stream(self, *name: str) -> np.random.Generator:
        """The generator of a process of this suite."""
        return seeds.generator(self.seed, "suite", self.suite, *name)

    def normal(self, instrument: str, term: str, *shape: int) -> np.ndarray:
        """Draw what an error term is in this flight: standard normal numbers of `shape` from a stream of its own."""
        return self.stream(instrument, term).standard_normal(shape)

    def world(self, name: str) -> np.random.Generator:
        """The generator of something that all suites meet alike."""
        return seeds.generator(self.seed, "world", name)

    def channel(self, name: str) -> Channel:
        """The faults of a channel."""
        return self.faults.channel(name)
