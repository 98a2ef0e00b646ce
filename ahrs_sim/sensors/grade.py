"""Grades: the figures of a kind of instrument, each with unit, source and a mark of how far it can be trusted.

A grade is a TOML file in `grades/`:

    title = "CH Robotics CHR-6dm"
    extends = "other"                                # optional: what is not stated here is as there
    calibration = "bench_calibration"                # optional: a grade for on top, what calibrating this one leaves

    [gyro]
    noise_density_dps_rthz = {value = 0.03, source = "GP9 data sheet", mark = "quoted"}

The unit is the end of the key, one of those of the figure's kind (`dps_rthz` or `dph_rthz`: the same figure). A vector
has one number per axis; one number stands for all axes. A scenario overrides figures in dotted tables of the suite,
where a bare number will do: `gyro.noise_density_dps_rthz = 0.05`. A figure that is not stated is zero, that is, absent.

Grades of parts make one of a suite: `grade = "bmi088 + rm3100 + zed_f9p"`; what a later one states replaces what an
earlier one does.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import reduce
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.scenario.table import named_file, read_toml
from ahrs_sim.world import gravity

_LARGEST = 1e9  # that a figure may be
MARKS = ("quoted", "firmware", "computed", "remembered", "inferred", "chosen")
"""How far a figure can be trusted: read in a document, or in code that runs on the instrument; computed from such; the
maker's, but from memory and not checked; of the class, by judgement; the user's choice."""
"""From the maker's paper, from its code, by calculation, by reasoning; `chosen`: how it is set up or installed here."""

_DEG = math.pi / 180.0
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3},
    "frequency": {"hz": 1.0},
    "angle": {"deg": _DEG},
    "fraction": {"percent": 1e-2},
    "length": {"m": 1.0, "mm": 1e-3},
    "speed": {"mps": 1.0},
    "pressure": {"pa": 1.0, "hpa": 100.0},
    "temperature": {"k": 1.0},
    "revolutions": {"rpm": 1.0},
    "rate": {"dps": _DEG, "mdps": 1e-3 * _DEG, "dph": _DEG / 3600.0, "radps": 1.0},
    "acceleration": {"mg": gravity.STANDARD * 1e-3, "ug": gravity.STANDARD * 1e-6, "g": gravity.STANDARD, "mps2": 1.0},
    "field": {"mgauss": 1e-7, "gauss": 1e-4, "ut": 1e-6, "nt": 1e-9},
    "number": {"": 1.0},
    "per_hour": {"per_h": 1.0 / 3600.0},
}
_PER = {"rthz": 1.0, "rts": 1.0, "per_k": 1.0, "per_g": 1.0 / gravity.STANDARD, "per_g2": 1.0 / gravity.STANDARD**2}

_WALKS = {
    ("rate", "rthz"): {"deg_rth": math.sqrt(2.0) * _DEG / 60.0},
    ("acceleration", "rthz"): {"mps_rth": math.sqrt(2.0) / 60.0},
}
"""Random walks N of IEEE Std 952 as units of a density d: d = sqrt(2) N, as sigma^2 = N^2/tau = (d^2/2)/tau."""

Layer = dict[str, dict[str, "Entry"]]
FiguresT = TypeVar("FiguresT")


@dataclass(frozen=True, slots=True)
class Entry:
    """A figure as stated in a grade or a scenario."""

    key: str  # as written, with its unit
    value: float | tuple[float, ...]  # as written
    factor: float  # to SI
    source: str
    mark: str

    @property
    def text(self) -> str:
        """Format the value as written, components separated by spaces."""
        return " ".join(f"{x:.6g}" for x in np.atleast_1d(self.value))


@dataclass(frozen=True, slots=True)
class Section:
    """Table of a grade: the dataclass of its figures and the quantity that `*` in their kinds stands for."""

    figures: type
    quantity: str = "number"


def figure(kind: str, default: float | tuple[float, ...] = 0.0, *, size: int = 0, minimum: float = -math.inf) -> Any:
    """Make a field of a dataclass of figures: its kind (`"rate"`, `"*_rthz"`), default in SI, size (0: one number)."""
    return dataclasses.field(metadata={"kind": kind, "default": default, "size": size, "minimum": minimum})


def _units(kind: str, quantity: str) -> dict[str, float]:
    """List the unit suffixes of a kind and their factors to SI: `*_rthz` for a rate gives dps_rthz and dph_rthz."""
    if kind in UNITS:
        return UNITS[kind]
    base, _, per = kind.partition("_")
    base = quantity if base == "*" else base
    return {f"{u}_{per}": f * _PER[per] for u, f in UNITS[base].items()} | _WALKS.get((base, per), {})


def _keys(section: Section) -> dict[str, tuple[str, float]]:
    """List every key that a table may hold, with the field it sets and its factor to SI."""
    keys = {}
    for f in dataclasses.fields(section.figures):
        kind = f.metadata["kind"]
        for unit, factor in _units(section.quantity if kind == "*" else kind, section.quantity).items():
            keys[f"{f.name}_{unit}" if unit else f.name] = (f.name, factor)
    return keys


def _entry(key: str, stated: Any, factor: float, where: str, default_source: str | None) -> Entry:
    source, mark = default_source, "chosen"
    value = stated
    if isinstance(stated, dict):
        for name in stated:
            if name not in ("value", "source", "mark"):
                raise InputError(f"{where}: {key}: unknown key '{name}'{nearest(name, ('value', 'source', 'mark'))}")
        if "value" not in stated:
            raise InputError(f"{where}: {key}: value is missing; write {key} = {{value = ...}}")
        value, source, mark = stated["value"], stated.get("source", default_source), stated.get("mark", mark)
    if source is None or not isinstance(source, str) or mark not in MARKS:
        raise InputError(f"{where}: {key}: a figure of a grade needs a source and a mark ({', '.join(MARKS)})")
    numbers = list(value) if isinstance(value, (list, tuple)) else [value]
    if not numbers or not all(isinstance(x, (int, float)) and math.isfinite(x) for x in numbers):
        raise InputError(f"{where}: {key}: {value!r} is neither a finite number nor a list of such; correct it")
    if max(abs(x) for x in numbers) > _LARGEST:
        raise InputError(f"{where}: {key}: {value!r} is out of range; no figure is beyond {_LARGEST:g}")
    written = tuple(float(x) for x in value) if isinstance(value, (list, tuple)) else float(value)
    return Entry(key, written, factor, source, mark)


def parse(tables: Mapping[str, Any], sections: Mapping[str, Section], where: str, source: str | None = None) -> Layer:
    """Check the tables of a grade or of overrides.

    Args:
        tables: by section, as TOML gives them.
        sections: those there are.
        where: for messages.
        source: stands for a missing source; None when a source must be given.

    Raises:
        InputError: an unknown section, key or unit, a value that is no number, a figure without source.
    """
    layer: Layer = {}
    for name, table in tables.items():
        if name not in sections:
            raise InputError(f"{where}: {name}: unknown key{nearest(name, sections)}")
        if not isinstance(table, dict):
            raise InputError(f"{where}: {name}: is not a table; write [{name}]")
        keys = _keys(sections[name])
        found: dict[str, Entry] = {}
        for key, stated in table.items():
            if key not in keys:
                raise InputError(f"{where}: [{name}] {key}: unknown key{nearest(key, keys)}")
            field, factor = keys[key]
            if field in found:
                raise InputError(f"{where}: [{name}] {key}: stated already as {found[field].key}; keep one")
            found[field] = _entry(key, stated, factor, f"{where}: [{name}]", source)
        layer[name] = found
    return layer


@dataclass(frozen=True)
class Grade:
    """Effective figures of a suite: its grade, the grades it extends, and the scenario's overrides."""

    name: str
    title: str
    layer: Layer
    sections: Mapping[str, Section]
    where: str
    calibration: str | None = None  # the grade for on top that says what calibrating this one leaves

    def __contains__(self, section: str) -> bool:
        return section in self.layer

    def figures(self, section: str, cls: type[FiguresT]) -> FiguresT:
        """Read the figures of a section in SI: floats, and arrays (size,) for fields with a size.

        Raises:
            InputError: a list of the wrong length, a number below its minimum.
        """
        stated = self.layer.get(section, {})
        values: dict[str, Any] = {}
        for f in dataclasses.fields(cls):  # type: ignore[arg-type]
            size, entry = f.metadata["size"], stated.get(f.name)
            value: Any = f.metadata["default"] if entry is None else np.multiply(entry.value, entry.factor)
            if entry is not None:
                if np.shape(value) not in ((), (size,)) or (np.ndim(value) and not size):
                    need = f"one number or {size}" if size else "one number"
                    raise InputError(f"{self.where}: [{section}] {entry.key}: {entry.value!r}: give {need}")
                if np.min(value) < f.metadata["minimum"]:
                    low = f.metadata["minimum"] / entry.factor
                    raise InputError(f"{self.where}: [{section}] {entry.key}: {entry.value!r}: must be >= {low:g}")
            values[f.name] = np.broadcast_to(np.asarray(value, float), (size,)).copy() if size else float(value)
        return cls(**values)

    def rows(self) -> Iterator[tuple[str, Entry]]:
        """List every stated figure with its section, in the order of the sections."""
        for section in self.sections:
            for entry in self.layer.get(section, {}).values():
                yield section, entry


def names() -> list[str]:
    """List the grades that come with the package."""
    folder = resources.files("ahrs_sim.sensors") / "grades"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))


def _find(name: str, where: str) -> Path:
    """Find the file of a grade: a shipped one by its name, else a TOML file beside the one that names it, or here."""
    if name in names():
        return Path(str(resources.files("ahrs_sim.sensors") / "grades" / f"{name}.toml"))
    if not name.endswith(".toml"):
        raise InputError(f"{where}: grade: '{name}' is unknown{nearest(name, names())}; or a file: \"mine.toml\"")
    if found := named_file(name, Path(where.partition(":")[0]).parent):
        return found
    raise InputError(f"{where}: grade: {name}: no such file beside it or in the current folder")


def _read(name: str, sections: Mapping[str, Section], where: str, chain: tuple[str, ...] = ()) -> Grade:
    """Read a grade file, laid over the figures of the grade that it extends."""
    path = _find(name, where)
    if str(path) in chain:
        raise InputError(f"{where}: extends: {' -> '.join((*chain, str(path)))} goes in a circle; remove one")
    table = read_toml(path)
    title, base, calibration = table.text("title"), table.text("extends", None), table.text("calibration", None)
    shown = path.name if name in names() else str(path)
    own = parse(table.rest(), sections, shown)
    below = _read(base, sections, shown, (*chain, str(path))).layer if base else {}
    return Grade(name, title, _over(below, own), sections, shown, calibration)


def _over(below: Layer, above: Layer) -> Layer:
    return {s: {**below.get(s, {}), **above.get(s, {})} for s in (*below, *(s for s in above if s not in below))}


def load(
    name: str, sections: Mapping[str, Section], overrides: Mapping[str, Any] | None = None, where: str = "grade"
) -> Grade:
    """Load a grade by name, or parts by names with " + " between, with the scenario's overrides on top.

    Raises:
        InputError: an unknown grade, or anything wrong in it or in the overrides.
    """
    parts = [_read(part.strip(), sections, where) for part in name.split(" + ")]
    layers = [*(part.layer for part in parts), parse(overrides or {}, sections, where, "scenario")]
    calibration = next((part.calibration for part in reversed(parts) if part.calibration), None)
    return Grade(name, "; ".join(p.title for p in parts), reduce(_over, layers), sections, where, calibration)
