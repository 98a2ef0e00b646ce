"""Settings of the methods: name, default, bounds and meaning in one place, checked before anything is built."""

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from estimators.errors import SettingError

SettingValue = str | float | bool


@dataclass(frozen=True)
class Setting:
    """One setting: its type is that of the default (a number, a choice or a switch)."""

    default: SettingValue
    text: str  # what it does, unit first
    choices: tuple[str, ...] = ()
    minimum: float = -math.inf
    maximum: float = math.inf
    above: float = -math.inf

    def check(self, where: str, value: Any) -> SettingValue:
        """The value, a number as float.

        Raises:
            SettingError: wrong type, not finite, out of bounds, or not one of the choices.
        """
        if isinstance(self.default, bool):
            if not isinstance(value, bool):
                raise SettingError(f"{where}: expected true or false, got {value!r}")
            return value
        if isinstance(self.default, str):
            if not isinstance(value, str) or value not in self.choices:
                raise SettingError(f"{where}: {value!r} is not a choice{nearest(str(value), self.choices)}")
            return value
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise SettingError(f"{where}: expected a finite number, got {value!r}")
        if value < self.minimum or value > self.maximum or value <= self.above:
            raise SettingError(f"{where}: {value:g} is out of range, {self.bounds()}")
        return float(value)

    def bounds(self) -> str:
        """The allowed range or choices, for people."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        parts = []
        if self.above > -math.inf:
            parts.append(f"above {self.above:g}")
        if self.minimum > -math.inf:
            parts.append(f"at least {self.minimum:g}")
        if self.maximum < math.inf:
            parts.append(f"at most {self.maximum:g}")
        return ", ".join(parts)


def checked(where: str, known: Mapping[str, Setting], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return all settings: the given ones checked, the others at their defaults.

    Raises:
        SettingError: an unknown name (with the nearest known one) or an impossible value.
    """
    for name in given:
        if name not in known:
            raise SettingError(f"{where}: unknown setting '{name}'{nearest(name, known)}")
    return {
        name: setting.check(f"{where}: {name}", given[name]) if name in given else setting.default
        for name, setting in known.items()
    }


def nearest(word: str, known: Iterable[str]) -> str:
    """`"; did you mean 'x'?"` for a misspelt word, else the choices: the tail of an error message."""
    choices = sorted(known)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.6)
    return f"; did you mean '{close[0]}'?" if close else f"; known: {', '.join(choices)}"
