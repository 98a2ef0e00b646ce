"""From what sensors send to what estimators report: the one loop behind a flight, a replay, an error budget, a paper.

chain = Chain(suite, {"ekf": create_estimator(component, site(lla, date), suite.info)})
records = chain.sense(truth)                  # or from a recording
samples = chain.assemble(records)
for name, estimates in chain.estimate(samples):
    ...
"""

import datetime
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from ahrs_sim.flight.truth import Event, Truth
from ahrs_sim.plugins import Guarded, Processes
from ahrs_sim.scenario import Component, create_estimator
from ahrs_sim.sensors.assemble import Assembler
from ahrs_sim.sensors.records import SuiteBlock
from ahrs_sim.sensors.suite import Suite
from ahrs_sim.turning import TurnAndSlip, Turning
from ahrs_sim.world import gravity, magnetic
from estimators.types import MEASUREMENTS, Estimates, Samples, SensorInfo, Site


def site(lla: np.ndarray, date: datetime.datetime) -> Site:
    """Describe a place (3,) rad, rad, m as a navigator knows it: normal gravity, and the field of that date."""
    latitude, longitude, height = map(float, lla)
    return Site(
        lla=(latitude, longitude, height),
        gravity=float(gravity.normal_gravity(lla)),
        mag_n=tuple(magnetic.field_n(lla[None], date)[0]),
    )


class Chain:
    """A sensor suite, what makes samples of its records, and the estimators that see them.

    Args:
        suite: None: records come from a recording.
        estimators: by name.
    """

    def __init__(self, suite: Suite | None, estimators: Mapping[str, Processes]) -> None:
        self._suite = suite
        self.estimators = dict(estimators)
        self.pending: list[Truth] = []  # flown, not sensed yet: short blocks are put together where nothing is urgent
        self._assembler = Assembler()
        self._turns = {name: TurnAndSlip() for name in self.estimators}
        self._noted: dict[tuple[str, int], bool] = {}
        self._events: list[Event] = []

    @property
    def suite(self) -> Suite:
        """The suite; only where records are not from a recording."""
        assert self._suite is not None
        return self._suite

    def sense(self, truth: Truth) -> SuiteBlock:
        """Measure a block of the truth: records by instrument, in the order of arrival."""
        return self.suite.sense(truth)

    def assemble(self, records: SuiteBlock) -> Samples:
        """Merge records by arrival: one row for each message of the IMU."""
        return self._assembler.assemble(records)

    def estimate(self, samples: Samples) -> Iterator[tuple[str, Estimates]]:
        """Run every estimator on a block of samples; yield its name and its estimates, row by row of the samples."""
        for name, estimator in self.estimators.items():
            estimates = estimator.process(samples)
            for column, texts in getattr(estimator, "notes", {}).items():
                self._note(name, column, texts, estimates)
            yield name, estimates

    def _note(self, name: str, column: int, texts: tuple[str, str], estimates: Estimates) -> None:
        """Make events of a column of `adaptation` that becomes 1, or 0 again."""
        on = estimates.adaptation[:, column] == 1.0
        before = np.concatenate([[self._noted.get((name, column), False)], on])
        for k in np.flatnonzero(on != before[:-1]):
            level, text = ("warning", texts[0]) if on[k] else ("info", texts[1])
            self._events.append(Event(float(estimates.t[k]), level, name, text))
        self._noted[name, column] = bool(before[-1])

    def turning(self, name: str, samples: Samples, estimates: Estimates) -> Turning:
        """Make turn rate and slip of what an estimator has reported for a block of samples."""
        return self._turns[name].of(samples, estimates)

    def take_events(self) -> list[Event]:
        """Collect events of the estimators and of the suite since the last call."""
        events, self._events = self._events, []
        events += [e for made in self.estimators.values() if isinstance(made, Guarded) for e in made.take_events()]
        return events + (self._suite.take_events() if self._suite is not None else [])


def described(component: Component, estimator: Processes) -> dict[str, str]:
    """Write what a log keeps of an estimator: its settings, and the names of its innovations, `-` without one."""
    kept = {k: str(v) for k, v in component.settings.items()}
    names = ["-"] * MEASUREMENTS
    for name, columns in getattr(estimator, "measurements", {}).items():
        axes = ("north", "east", "down") if name.endswith("_n") else "xyz"
        one = columns.stop - columns.start == 1
        for k, place in enumerate(range(columns.start, columns.stop)):
            names[place] = name if one else f"{name}.{axes[k]}"
    return {**kept, "innovations": " ".join(names)} if set(names) != {"-"} else kept


def recorded_chains(components: Iterable[Component], site: Site, sensors: Mapping[str, SensorInfo]) -> dict[str, Chain]:
    """Make a chain for each suite of a recording.

    Args:
        components: `[estimator.NAME]` tables.
        site: where it was recorded.
        sensors: data sheets by suite.
    """
    made: dict[str, dict[str, Processes]] = {suite: {} for suite in sensors}
    for component in components:
        suite = component.settings["suite"]
        made[suite][component.name] = create_estimator(component, site, sensors[suite])
    return {suite: Chain(None, listed) for suite, listed in made.items()}
