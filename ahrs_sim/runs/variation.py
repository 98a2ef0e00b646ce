"""What differs from run to run: distributions of `--vary`, and the place of a value in a scenario."""

import math
from dataclasses import dataclass
from typing import Any

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.scenario import seeds

DISTRIBUTIONS = {
    "uniform": "uniform:LOW..HIGH",
    "normal": "normal:MEAN,SIGMA",
    "choice": "choice:A,B,...",
    "grid": "grid:A,B,...",
    "lhs": "lhs:LOW..HIGH",
}
"""Kinds of variation and how they are written; grids combine all with all, `lhs` is one Latin hypercube of all such."""


@dataclass(frozen=True)
class Variation:
    """One `--vary KEY=KIND:NUMBERS`."""

    key: str
    kind: str
    values: tuple[Any, ...]

    @classmethod
    def read(cls, text: str) -> "Variation":
        """Read a variation from `wind.speed_mps=uniform:0..8`.

        Raises:
            InputError: it is not of one of the forms in `DISTRIBUTIONS`.
        """
        key, equals, distribution = text.partition("=")
        kind, colon, arguments = distribution.partition(":")
        if not (key and equals and colon):
            raise InputError(f"--vary {text}: write KEY=KIND:VALUES, e.g. wind.speed_mps={DISTRIBUTIONS['uniform']}")
        if kind not in DISTRIBUTIONS:
            raise InputError(f"--vary {text}: no distribution '{kind}'{nearest(kind, DISTRIBUTIONS)}")
        values: tuple[Any, ...]
        if kind in ("uniform", "lhs"):
            values = span(arguments, f"--vary {text}")
        else:
            values = tuple(_value(x) for x in arguments.split(","))
            if kind == "normal" and not (len(values) == 2 and all(map(_is_number, values)) and values[1] >= 0):
                raise InputError(f"--vary {text}: write {DISTRIBUTIONS['normal']}")
        return cls(key, kind, values)

    def draw(self, seed: int, run: int) -> Any:
        """Draw the value of a run, for kinds whose runs are independent."""
        rng = seeds.generator(seed, "campaign", self.key, str(run))
        if self.kind == "uniform":
            return float(rng.uniform(*self.values))
        if self.kind == "normal":
            return float(rng.normal(*self.values))
        return self.values[int(rng.integers(len(self.values)))]


def span(text: str, where: str) -> tuple[float, float]:
    """Read `LOW..HIGH`.

    Raises:
        InputError: it is not that, or empty.
    """
    low, dots, high = text.partition("..")
    try:
        numbers = float(low), float(high)
    except ValueError:
        numbers = math.nan, math.nan
    if not dots or not numbers[0] < numbers[1] or not all(map(math.isfinite, numbers)):
        raise InputError(f"{where}: '{text}' is not a range; write LOW..HIGH")
    return numbers


def _value(text: str) -> Any:
    """Read a number, true or false, else the text itself."""
    words = {"true": True, "false": False}
    if text in words:
        return words[text]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def put(data: dict[str, Any], key: str, value: Any) -> None:
    """Set `a.b.c` in nested tables; the number n in it is the n-th of a list: `step.3.bank_deg`.

    Raises:
        InputError: a part of the path is no table, or there is no such element.
    """
    *path, last = key.split(".")
    place: Any = data
    for part in path:
        if isinstance(place, list) and part.isdigit() and 1 <= int(part) <= len(place):
            place = place[int(part) - 1]
        elif isinstance(place, dict):
            place = place.setdefault(part, {})
        else:
            raise InputError(f"{key}: nothing called '{part}' there")
    if not isinstance(place, dict):
        raise InputError(f"{key}: '{last}' is not in a table")
    place[last] = value
