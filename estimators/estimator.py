"""Estimators as objects: alignment, then the estimation loop, block by block; the filter on a model among them."""

import hashlib
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any, Protocol, cast

import numpy as np

from estimators import adaptation
from estimators.alignment import Alignment, Stretch
from estimators.errors import EstimationError, SampleError
from estimators.filters import points
from estimators.filters.base import Method
from estimators.filters.work import POINTS_FROM, SQUARE_ROOT_FROM, WORK, Carry, Work
from estimators.models.base import Bound
from estimators.native import joined, loaded, passed, same_integers, supplied
from estimators.records import Place, Sheet, blank_estimates, pack, pack_settings, unpack
from estimators.run import Instance, begin, forget, process
from estimators.types import MEASUREMENTS, Estimates, Samples, SensorInfo, Site

STATE_VERSION = 4
_KEPT = ("clock", "u", "z", "used", "trust")


class Estimator(Protocol):
    """Describes the estimators that the catalogue makes; a user's own class needs `process` only."""

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


class Compiled:
    """An estimator whose loop, alignment included, is compiled as a whole (`run`, `navigator.loop`).

    Args:
        name: for messages.
        settings: checked settings.
        site: place and field.
        sensors: data sheet figures.
        entries: `process`, `forget` and `begin` of its loop.
        key: of the loop in the disk cache.
    """

    def __init__(
        self, name: str, settings: Mapping[str, Any], site: Site, sensors: SensorInfo,
        entries: tuple[Any, Any, Any], key: str,
    ) -> None:  # fmt: skip
        self.name, self.settings, self.site, self.sensors = name, dict(settings), site, sensors
        self._process, self._forget, self._start = (loaded(entry, key) for entry in entries)
        self._stretch = Stretch.make()
        self._parts: dict[str, Any] = {}
        self._instance: Any = None

    def assemble(self) -> tuple[dict[str, Any], Any]:
        """Make all parts by name, and the record of the addresses of those that the loop takes."""
        raise NotImplementedError

    def kept(self) -> dict[str, np.ndarray]:
        """The memory that goes on from row to row after the alignment, by name."""
        raise NotImplementedError

    def last_t(self) -> float:
        """Time (s) of the last row after the alignment."""
        raise NotImplementedError

    def check(self, made: Mapping[str, np.ndarray]) -> None:
        """Raise an `EstimationError` when a state's arrays do not belong to the settings."""

    def work_size(self) -> int:
        """Bytes of the part `work` that are needed, from its beginning."""
        raise NotImplementedError

    def row_length(self) -> int:
        """The least length of rows (`native.CAPACITY`) that is needed."""
        raise NotImplementedError

    def reset(self) -> None:
        """Forget everything seen: align anew."""
        if self._instance is not None:
            self._forget(*self._own)

    def prepare(self) -> None:
        """Compile, or load from the disk, everything that `process` will need; forgets everything seen."""
        self._bind()
        self.reset()

    def _bind(self) -> None:
        """Put the parts together, at the first need: a model's kernels may have to be compiled."""
        if self._instance is None:
            self._parts, self._instance = self.assemble()
            self._own = passed(self._instance)
            self._forget(*self._own)

    def process(self, samples: Samples) -> Estimates:
        """One row of estimates for each row of samples.

        Raises:
            SampleError: a column of a wrong shape or type, a time stamp that is not finite or more than a second back.
                Nothing of the block has been used then.
        """
        self._bind()
        rows = pack(samples)
        out = blank_estimates(len(rows))
        last = float(self.last_t() if self._instance.begun else self._stretch.last_t)
        bad = self._process(*self._own, *passed(rows), len(rows), *passed(out))
        if bad >= 0:
            t = rows["t"]
            raise SampleError(f"{self.name}: time stamp {t[bad]} s in row {bad} after {t[bad - 1] if bad else last} s")
        return unpack(out)

    def state(self) -> dict[str, Any]:
        """Copy everything that goes on from block to block.

        `name`, `version` and `settings` (a hash, of place and sensors too) say whose it is; `stretch` is the
        alignment's; `filter` None or the arrays and records of `kept`.
        """
        self._bind()
        kept = {name: np.array(array) for name, array in self.kept().items()} if self._instance.begun else None
        return {**self._owner(), "stretch": self._stretch.data.copy(), "filter": kept}

    def _owner(self) -> dict[str, Any]:
        known = f"{sorted(self.settings.items())} {self.site} {self.sensors}"
        settings = hashlib.sha256(known.encode()).hexdigest()[:16]
        return {"name": self.name, "version": STATE_VERSION, "settings": settings}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a copy made by `state` of an estimator of the same name, settings, place and sensors.

        Raises:
            EstimationError: a state of another estimator, or one that is damaged. The estimator is as it was then.
        """
        for key, own in self._owner().items():
            if state.get(key) != own:
                raise EstimationError(
                    f"{self.name}: cannot go on from a state whose {key} is '{state.get(key)}', not '{own}'"
                )
        self._bind()
        kept = state.get("filter")
        stretch = self._taken(state, "stretch", self._stretch.data)
        if kept is not None:
            like = self.kept()
            made = {name: self._taken(kept, name, array) for name, array in like.items()}
            self.check(made)
            self._start(*self._own)
            for name, array in made.items():
                like[name][...] = array
        self._stretch.data[...] = stretch
        self._instance.begun = int(kept is not None)

    def _taken(self, state: Any, name: str, like: np.ndarray) -> np.ndarray:
        """A copy of an array of a state, of the shape and type of `like`."""
        value = state.get(name) if isinstance(state, Mapping) else None
        if not isinstance(value, np.ndarray) or value.shape != like.shape or value.dtype != like.dtype:
            found = _kind(value) if isinstance(value, np.ndarray) else type(value).__name__
            raise EstimationError(f"{self.name}: the state's {name} is {found}, expected {_kind(like)}")
        return np.array(value, order="C")


class FilterEstimator(Compiled):
    """A filter on a model.

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
        super().__init__(name, settings, site, sensors, (process, forget, begin), "run")
        self._method, self._module, self._policy = method, model, adaptation.make(settings)
        self._carry, self._work = Carry.zeros(), Work.zeros()
        self._model: Bound | None = None

    @property
    def notes(self) -> Mapping[int, tuple[str, str]]:
        """Return what is worth an event: by column of `adaptation`, the texts for becoming 1 and 0 again."""
        return getattr(self._module, "NOTES", {})

    def assemble(self) -> tuple[dict[str, Any], Any]:
        """Make all parts by name, and the record of the addresses of those that the loop takes."""
        values = self.settings
        model = self._model = Bound(self._module, self._module.layout(values), self._method.entries)
        paper = values.get("initialisation") == "paper" and values["noise"] == "practical"
        parts = {
            "method": self._method.handle, "policy": self._policy.handle, "model": model.handle,
            "carry": self._carry, "work": self._work, "stretch": self._stretch, "alignment": Alignment.zeros(),
            "settings": pack_settings(self._module.SETTINGS, values),
            "rules": pack_settings(adaptation.settings(), values),
            "site": Place.from_site(self.site), "sensors": Sheet.from_info(self.sensors),
        }  # fmt: skip
        numbers = {"align_s": values["align_s"], "wait_s": values["wait_s"], "from_paper": int(paper), "begun": 0}
        numbers["begin"] = supplied(begin, None, None, "run")
        of_handles = {
            "method_parameters": self._method.parameters, "policy_parameters": self._policy.parameters,
            "parameters": model.parameters, "memory": model.memory, "blank": model.blank,
        }  # fmt: skip
        return {**parts, **of_handles}, joined(Instance, parts, numbers)

    def work_size(self) -> int:
        """Bytes of `Work` that the filter needs, from its beginning."""
        module = self._method.module
        if hasattr(module, "store"):
            return WORK.itemsize
        pointed = module.Parameters is points.Parameters or hasattr(module, "update")
        return int(WORK.fields[SQUARE_ROOT_FROM if pointed else POINTS_FROM][1])  # type: ignore[index]

    def row_length(self) -> int:
        """The least length of rows (`native.CAPACITY`) that this method needs."""
        module, layout = self._module, self._module.layout(self.settings)
        records = (module.State, module.Inputs, module.Readings, module.Used)
        numbers = [max(k.fields[n][1] + k.fields[n][0].itemsize for n in k.names) for k in (r.dtype for r in records)]
        longest = max(numbers[:3]) // 8
        return int(max(8, longest, numbers[3], layout.raw, layout.size))

    @property
    def parameters(self) -> Any:
        """The model's record `Parameters`; None before the alignment is over."""
        return self._model.parameters if self._model is not None and self._instance.begun else None

    @property
    def measurements(self) -> dict[str, slice]:
        """The columns of its innovations by the names of what is measured, `gnss.vel_n`, `mag_b`."""
        return {name: columns for name, columns in _named(self._module.Readings.dtype) if columns.stop <= MEASUREMENTS}

    def last_t(self) -> float:
        """Time (s) of the last row after the alignment."""
        return float(self._carry.clock)

    def kept(self) -> dict[str, np.ndarray]:
        """The filter's arrays `x` (raw,), `P` and `P_restart` (n, n) as it keeps them, the model's records, ..."""
        model, carry = cast("Bound", self._model), self._carry
        n = model.size
        kept = {"parameters": model.parameters.data, "memory": model.memory.data, "x": carry.x[: model.raw]}
        kept |= {name: carry.data[name][:n, :n] for name in ("P", "P_restart")}
        return kept | {name: carry.data[name] for name in _KEPT}

    def check(self, made: Mapping[str, np.ndarray]) -> None:
        """Compare the integers of a state's parameters, sizes of arrays among them, with those of the settings."""
        other = FilterEstimator(self.name, self._method, self._module, self.settings, self.site, self.sensors)
        other._bind()
        other._start(*other._own)
        if not same_integers(made["parameters"], other.parameters.data):
            raise EstimationError(f"{self.name}: the state's parameters are not those of its settings")
