"""Installation of a sensor suite: grade, place in the aircraft, random streams and faults of its instruments."""

import datetime
from dataclasses import dataclass

import numpy as np

from ahrs_sim.scenario import seeds
from ahrs_sim.sensors.faults import Channel, Faults
from ahrs_sim.sensors.grade import FiguresT, Grade
from ahrs_sim.sensors.sampling import divider


@dataclass(frozen=True)
class Fitting:
    """A suite as installed in the aircraft: all that its instruments are made from."""

    suite: str
    grade: Grade
    faults: Faults
    seed: int  # of the flight
    unit_seed: int  # of what is built into the unit
    dt: float  # s between rows of the truth
    epoch: datetime.datetime
    start_lla: np.ndarray  # (3,) rad, rad, m
    position: np.ndarray  # m, FRD from where the centre of gravity is at first
    mount: np.ndarray  # C_sb (3, 3), body to sensor axes, known to the unit
    mounting_error: np.ndarray  # (3, 3) rotation from the assumed to the true sensor axes
    where: str  # for messages

    def figures(self, section: str, cls: type[FiguresT]) -> FiguresT:
        """Read the figures of a section of the grade."""
        return self.grade.figures(section, cls)

    def every(self, rate: float, section: str) -> int:
        """Count the rows of the truth per sample at `rate` (Hz)."""
        return divider(rate, self.dt, f"{self.where}: [{section}]")

    def stream(self, *name: str) -> np.random.Generator:
        """Make the random generator of a process of this suite, named `name`."""
        return seeds.generator(self.seed, "suite", self.suite, *name)

    def normal(self, instrument: str, term: str, *shape: int) -> np.ndarray:
        """Draw standard normal numbers of `shape` for an error term of this unit, from a stream of its own."""
        return seeds.generator(self.unit_seed, "suite", self.suite, instrument, term).standard_normal(shape)

    def anew(self, instrument: str, term: str, *shape: int) -> np.ndarray:
        """Draw standard normal numbers of `shape` for an error that is another at each switch-on."""
        return self.stream(instrument, term).standard_normal(shape)

    def world(self, name: str) -> np.random.Generator:
        """Make the random generator of a process outside the suites, such as the pressure of the day."""
        return seeds.generator(self.seed, "world", name)

    def channel(self, name: str) -> Channel:
        """Select the faults of a channel."""
        return self.faults.channel(name)
