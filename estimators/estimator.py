"""A filter on a model as an object: alignment, then the estimation loop, block by block."""

import hashlib
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from estimators import adaptation
from estimators.adaptation.base import fresh
from estimators.alignment import ALIGNING, STILL, Stretch, align, conclude, limits, pieces
from estimators.errors import EstimationError, SampleError
from estimators.filters.base import Method
from estimators.filters.work import Carry, Work
from estimators.latency import to_gyro_time, to_stamp_time
from estimators.models.base import Bound, Start
from estimators.native import Record, loaded, passed, same_integers
from estimators.records import blank_estimates, pack, unpack
from estimators.run import run, screen
from estimators.types import MEASUREMENTS, Estimates, Samples, SensorInfo, Site

STATE_VERSION = 2


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


def _named(layout: np.dtype[Any], first: int = 0, path: str = "") -> Iterator[tuple[str, slice]]:
    """Names and places of the numbers of a record, in numbers."""
    for name, (inner, offset, *_) in (layout.fields or {}).items():
        start = first + offset // 8
        if inner.fields:
            yield from _named(inner, start, f"{path}{name}.")
        else:
            yield f"{path}{name}", slice(start, start + inner.itemsize // 8)


def _kind(array: np.ndarray) -> str:
    return f"a record of {array.dtype.itemsize} bytes" if array.dtype.names else f"{array.dtype}{array.shape}"


class FilterEstimator:
    """An estimator of the catalogue.

    Args:
        name: for messages.
        method: the filter.
        model: module of the model, see `models.base`.
        settings: checked settings of method and model.
        site: place and field.
        sensors: data sheet figures.
    """

    def __init__(
        self,
        name: str,
        method: Method,
        model: ModuleType,
        settings: Mapping[str, Any],
        site: Site,
        sensors: SensorInfo,
    ) -> None:
        self.name, self.settings, self.site, self.sensors = name, dict(settings), site, sensors
        self._method, self._module = method, model
        self._policy = adaptation.make(settings, site)
        self._limits = limits(sensors)
        self._run, self._align, self._bad = (
            loaded(run, "run"),
            loaded(align, "alignment"),
            loaded(screen, "run"),
        )
        self._delays = sensors.gyro_delay, sensors.accel_delay, sensors.mag_delay
        self._late = any(self._delays)
        if self._late:
            self._to_gyro_time, self._to_stamp_time = loaded(to_gyro_time, "latency"), loaded(to_stamp_time, "latency")
        self._work = Work.zeros()
        self.reset()

    def reset(self) -> None:
        """Forget everything seen: align anew."""
        self._stretch = Stretch.make()
        self._model: Bound | None = None
        self._carry: Any = None
        if self.settings.get("initialisation") == "paper" and self.settings["noise"] == "practical":
            self._begin(still=False)  # nothing to learn from the ground

    def prepare(self) -> None:
        """Compile, or load from the disk, everything that `process` will need; forgets everything seen."""
        self._begin(still=False)
        self.reset()

    @property
    def parameters(self) -> Any:
        """The model's record `Parameters`; None before the alignment is over."""
        return None if self._model is None else self._model.parameters

    @property
    def measurements(self) -> dict[str, slice]:
        """The columns of its innovations by the names of what is measured, `gnss.vel_n`, `mag_b`."""
        return {name: columns for name, columns in _named(self._module.Readings.dtype) if columns.stop <= MEASUREMENTS}

    def process(self, samples: Samples) -> Estimates:
        """One row of estimates for each row of samples.

        Raises:
            SampleError: a column of a wrong shape or type, a time stamp that is not finite or more than a second back.
                Nothing of the block has been used then.
        """
        rows = pack(samples)
        n = len(rows)
        if self._late:
            self._to_gyro_time(*passed(rows), n, *self._delays)
        self._check_stamps(rows)
        out = blank_estimates(n)
        last = float(self._stretch.last_t if self._carry is None else self._carry.clock)
        for first, end, anew in pieces(rows["t"], last):
            if anew:
                self.reset()
            self._process(rows[first:end], out[first:end])
        return unpack(out)

    def _process(self, rows: np.ndarray, out: np.ndarray) -> None:
        """Estimate rows without a long gap into estimates."""
        n, done = len(rows), 0
        if self._carry is None:
            settings = self.settings
            limits_ = settings["align_s"], settings["wait_s"], *self._limits, self.site.gravity
            done = self._align(*passed(self._stretch, rows), n, *limits_)
            out["t"][:done] = rows["t"][:done]
            if self._stretch.phase != ALIGNING:
                self._begin(still=self._stretch.phase == STILL)
        if done < n:
            self._estimate(rows, out, done)
            if self._late:
                self._to_stamp_time(*passed(rows, out), done, n, *self._delays[:2], self.site.gravity)

    def _check_stamps(self, rows: np.ndarray) -> None:
        last = float(self._stretch.last_t if self._carry is None else self._carry.clock)
        bad = self._bad(*passed(rows), len(rows), last)
        if bad >= 0:
            t = rows["t"]
            before = t[bad - 1] if bad else last
            raise SampleError(f"{self.name}: time stamp {t[bad]} s in row {bad} after {before} s")

    def _estimate(self, rows: np.ndarray, out: np.ndarray, first: int) -> None:
        self._run(*self._fixed, *passed(rows, out), first, len(rows))

    def _begin(self, still: bool) -> None:
        alignment = conclude(self._stretch, still, self.site, self.sensors)
        start = self._module.build(self.settings, self.site, self.sensors, alignment)
        self._model = self._bind(start)
        self._carry = Carry.zeros()
        self._carry.clock, self._carry.trust[:] = np.nan, fresh()
        self._fill(start.x, self._method.stored(start.P), self._method.stored(start.P_restart))

    def _bind(self, start: Start) -> Bound:
        return Bound(self._module, start, self._method.entries)

    def state(self) -> dict[str, Any]:
        """Copy everything that goes on from block to block.

        `name`, `version` and `settings` (a hash, of place and sensors too) say whose it is; `stretch` is the
        alignment's; `filter` None or the filter's arrays: `x` (raw,), `P` and `P_restart` (n, n) as the filter keeps
        them, the records `parameters` and `memory` of the model, ...
        """
        kept: dict[str, Any] | None = None
        if self._model is not None:
            n, raw = self._model.size, self._model.raw
            kept = {name: np.array(self._carry.data[name]) for name in ("clock", "u", "z", "used", "trust")}
            kept |= {"x": self._carry.x[:raw].copy()}
            kept |= {name: self._carry.data[name][:n, :n].copy() for name in ("P", "P_restart")}
            kept |= {"parameters": self._model.parameters.data.copy(), "memory": self._model.memory.data.copy()}
        return {
            "name": self.name, "version": STATE_VERSION, "settings": self._fingerprint(),
            "stretch": self._stretch.data.copy(), "filter": kept,
        }  # fmt: skip

    def _fingerprint(self) -> str:
        known = f"{sorted(self.settings.items())} {self.site} {self.sensors}"
        return hashlib.sha256(known.encode()).hexdigest()[:16]

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a copy made by `state` of an estimator of the same name, settings, place and sensors.

        Raises:
            EstimationError: a state of another estimator, or one that is damaged. The estimator is as it was then.
        """
        for key, own in (("name", self.name), ("version", STATE_VERSION), ("settings", self._fingerprint())):
            if state.get(key) != own:
                raise EstimationError(
                    f"{self.name}: cannot go on from a state whose {key} is '{state.get(key)}', not '{own}'"
                )
        blank, kept = Stretch.make(), state.get("filter")
        stretch = Stretch(self._taken(state, "stretch", blank.data))
        if kept is None:
            self._stretch, self._model, self._carry = stretch, None, None
            return
        alignment = conclude(blank, False, self.site, self.sensors)  # any: the shapes are what counts
        start = self._module.build(self.settings, self.site, self.sensors, alignment)
        parameters = self._taken(kept, "parameters", start.parameters.data)
        if not same_integers(parameters, start.parameters.data):
            raise EstimationError(f"{self.name}: the state's parameters are not those of its settings")
        made = {name: self._taken(kept, name, getattr(start, name)) for name in ("x", "P", "P_restart")}
        carry = Carry.zeros()
        for name in ("clock", "u", "z", "used", "trust"):
            carry.data[name] = self._taken(kept, name, carry.data[name])
        memory = self._taken(kept, "memory", start.memory.data)
        start = start._replace(parameters=Record(parameters), memory=Record(memory), **made)
        self._stretch, self._model, self._carry = stretch, self._bind(start), carry
        self._fill(start.x, start.P, start.P_restart)

    def _taken(self, state: Any, name: str, like: np.ndarray) -> np.ndarray:
        """A copy of an array of a state, of the shape and type of `like`."""
        value = state.get(name) if isinstance(state, Mapping) else None
        if not isinstance(value, np.ndarray) or value.shape != like.shape or value.dtype != like.dtype:
            found = _kind(value) if isinstance(value, np.ndarray) else type(value).__name__
            raise EstimationError(f"{self.name}: the state's {name} is {found}, expected {_kind(like)}")
        return np.array(value, order="C")

    def _fill(self, x: np.ndarray, P: np.ndarray, P_restart: np.ndarray) -> None:
        assert self._model is not None
        n = len(P)
        self._fixed = passed(
            self._method.handle, self._policy.handle, self._model.handle, self._carry, self._work
        )  # they stay where they are
        self._carry.x[: len(x)] = x
        self._carry.P[:n, :n], self._carry.P_restart[:n, :n] = P, P_restart
