"""A filter on a model as an object: alignment, then the estimation loop, block by block."""

import copy
import dataclasses
from collections import namedtuple
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from estimators.alignment import ALIGNING, STILL, Start, Stretch, align, conclude, limits
from estimators.errors import EstimationError, SampleError
from estimators.filters.base import Work
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


_SAMPLES = [(f.name, np.dtype(f.metadata["dtype"]), f.metadata["shape"]) for f in dataclasses.fields(Samples)]
_ESTIMATES = [(f.name, np.dtype(f.metadata["dtype"]), f.metadata["shape"]) for f in dataclasses.fields(Estimates)]
_WIDTHS = [(name, int(np.prod(shape)), shape) for name, dtype, shape in _ESTIMATES if dtype == float]
_WIDTH = sum(width for _, width, _ in _WIDTHS)
SampleColumns = namedtuple("SampleColumns", [name for name, _, _ in _SAMPLES])
EstimateColumns = namedtuple("EstimateColumns", [name for name, _, _ in _ESTIMATES])


def sample_columns(samples: Samples) -> SampleColumns:  # type: ignore[valid-type]
    """The columns as kernels take them: contiguous arrays of exactly the declared types.

    Raises:
        SampleError: a column whose shape does not fit the time stamps (n,).
    """
    rows = samples.t.shape[0] if samples.t.ndim == 1 else -1
    columns = []
    for name, dtype, shape in _SAMPLES:
        column = getattr(samples, name)
        if not column.flags.carray or column.dtype != dtype:
            column = np.array(column, dtype, order="C")
        if column.shape[0] != rows or column.shape[1:] != shape:
            raise SampleError(f"Samples: {name} has shape {column.shape}, expected {('n', *shape)} with n = len(t)")
        columns.append(column)
    return SampleColumns(*columns)


def blank_estimates(rows: int) -> EstimateColumns:  # type: ignore[valid-type]
    """Columns of `Estimates`, NaN and ALIGNING, in one piece of memory (allocating is what costs with single rows)."""
    memory = np.full(rows * _WIDTH, np.nan)
    columns, start = {"status": np.zeros(rows, np.uint8)}, 0
    for name, width, shape in _WIDTHS:
        columns[name] = memory[start : start + rows * width].reshape(rows, *shape)
        start += rows * width
    return EstimateColumns(**columns)


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
        self._limits = limits(sensors)
        self.reset()

    def reset(self) -> None:
        """Forget everything seen: align anew."""
        self._stretch = Stretch.make()
        self._model: Any = None
        self._carry: Carry | None = None
        self._work: Work | None = None
        if self.settings["initialisation"] == "paper" and self.settings["noise"] == "practical":
            self._begin(still=False)  # nothing to learn from the ground

    def process(self, samples: Samples) -> Estimates:
        """One row of estimates for each row of samples.

        Raises:
            SampleError: a column of a wrong shape, a time stamp that is not finite or more than a second back.
                Nothing of the block has been used then.
        """
        rows = sample_columns(samples)
        t = rows.t  # type: ignore[attr-defined]
        last = self._stretch.clock[3] if self._carry is None else self._carry.clock[0]
        bad = first_bad_stamp(t, last)
        if bad >= 0:
            raise SampleError(f"{self.name}: time stamp {t[bad]} in row {bad} after {t[bad - 1] if bad else last}")
        out = blank_estimates(len(t))
        done = 0
        if self._carry is None:
            settings = self.settings
            done, phase = align(
                self._stretch, rows, settings["align_s"], settings["wait_s"], *self._limits, self.site.gravity
            )
            out.t[:done] = t[:done]  # type: ignore[attr-defined]
            if phase != ALIGNING:
                self._begin(still=phase == STILL)
        if done < len(t):
            run(self._method, self._model, self._carry, self._work, rows, out, done)
        return Estimates(*out)

    def _begin(self, still: bool) -> None:
        alignment = conclude(self._stretch, still, self.site, self.sensors)
        start = self._build(self.settings, self.site, self.sensors, alignment)
        self._model = start.model
        self._carry = Carry(
            x=start.x,
            P=start.P,
            memory=start.memory,
            clock=np.full(1, np.nan),
            u=np.zeros(start.inputs),
            z=np.zeros(start.measurements),
            used=np.zeros(start.measurements, bool),
            P_restart=start.P_restart,
        )
        self._work = Work.make(self._model.layout, len(start.x), len(start.P))

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
            self._work = Work.make(self._model.layout, len(self._carry.x), len(self._carry.P))
