"""A filter on a model as an object: alignment, then the estimation loop, block by block."""

import copy
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from estimators import adaptation
from estimators.alignment import ALIGNING, LAST, STILL, Start, Stretch, align, conclude, limits
from estimators.errors import EstimationError, SampleError
from estimators.filters.base import Work, stored
from estimators.latency import to_gyro_time, to_stamp_time
from estimators.rows import ESTIMATE_WIDTH, pack, unpack
from estimators.run import Carry, first_bad_stamp, run
from estimators.types import Estimates, Samples, SensorInfo, Site


class Estimator(Protocol):
    """What the catalogue makes. A user's own class needs `process` only."""

    def process(self, samples: Samples) -> Estimates:
        """One row of estimates for each row of samples; any block length gives the same numbers."""
        ...

    def reset(self) -> None:
        """Forget everything seen."""
        ...

    def state(self) -> dict[str, Any]:
        """A copy of everything that goes on from block to block."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a copy made by `state`."""
        ...


class FilterEstimator:
    """An estimator of the catalogue.

    Args:
        name: for messages.
        method: the filter, a NamedTuple of `estimators.filters`.
        build: the model's `build(settings, site, sensors, alignment)`.
        settings: checked settings of method and model.
        site: place and field.
        sensors: data sheet figures.
    """

    def __init__(
        self,
        name: str,
        method: Any,
        build: Callable[..., Start],
        settings: Mapping[str, Any],
        site: Site,
        sensors: SensorInfo,
    ) -> None:
        self.name, self.settings, self.site, self.sensors = name, dict(settings), site, sensors
        self._method, self._build = method, build
        self._policy = adaptation.make(settings, site)
        self._limits = limits(sensors)
        self.reset()

    def reset(self) -> None:
        """Forget everything seen: align anew."""
        self._stretch = Stretch.make()
        self._model: Any = None
        self._carry: Carry | None = None
        self._work: Work | None = None
        if self.settings.get("initialisation") == "paper" and self.settings["noise"] == "practical":
            self._begin(still=False)  # nothing to learn from the ground

    def process(self, samples: Samples) -> Estimates:
        """One row of estimates for each row of samples.

        Raises:
            SampleError: a column of a wrong shape, a time stamp that is not finite or more than a second back.
                Nothing of the block has been used then.
        """
        rows = pack(samples)
        delays = self.sensors.gyro_delay, self.sensors.accel_delay, self.sensors.mag_delay
        late = any(delays)
        if late:
            to_gyro_time(rows, *delays)
        last = self._stretch.clock[LAST] if self._carry is None else self._carry.clock[0]
        bad = first_bad_stamp(rows, last)
        if bad >= 0:
            before = rows[bad - 1, 0] if bad else last
            raise SampleError(f"{self.name}: time stamp {rows[bad, 0]} s in row {bad} after {before} s")
        n = len(rows)
        out, status = np.full((n, ESTIMATE_WIDTH), np.nan), np.zeros(n, np.uint8)
        done = 0
        if self._carry is None:
            settings = self.settings
            done, phase = align(
                self._stretch, rows, settings["align_s"], settings["wait_s"], *self._limits, self.site.gravity
            )
            out[:done, 0] = rows[:done, 0]
            if phase != ALIGNING:
                self._begin(still=phase == STILL)
        if done < n:
            run(self._method, self._policy, self._model, self._carry, self._work, rows, out, status, done)
            if late:
                to_stamp_time(rows, out, done, self.sensors.gyro_delay)
        return unpack(out, status)

    def _begin(self, still: bool) -> None:
        alignment = conclude(self._stretch, still, self.site, self.sensors)
        start = self._build(self.settings, self.site, self.sensors, alignment)
        self._model = start.model
        self._carry = Carry(
            x=start.x,
            P=stored(self._method, start.P),
            memory=start.memory,
            clock=np.full(1, np.nan),
            u=np.zeros(start.inputs),
            z=np.zeros(start.measurements),
            used=np.zeros(start.measurements, bool),
            P_restart=stored(self._method, start.P_restart),
            trust=adaptation.fresh(),
        )
        self._work = Work.make(self._model, len(start.x))

    def state(self) -> dict[str, Any]:
        """A copy of everything that goes on from block to block."""
        return copy.deepcopy({"name": self.name, "stretch": self._stretch, "model": self._model, "carry": self._carry})

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a copy made by `state` of an estimator of the same name and settings.

        Raises:
            EstimationError: a state of another estimator.
        """
        if state.get("name") != self.name:
            raise EstimationError(f"{self.name}: cannot go on from the state of '{state.get('name')}'")
        copied = copy.deepcopy(dict(state))
        self._stretch, self._model, self._carry = copied["stretch"], copied["model"], copied["carry"]
        self._work = None
        if self._carry is not None:
            self._work = Work.make(self._model, len(self._carry.x))
