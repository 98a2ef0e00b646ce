"""Checked access to a TOML table: every key is used or refused, every message names file and key.

table = read_toml(path)                         # Table
seed = table.integer("seed", 0, minimum=0)
with_default = table.number("for_s", 10.0, above=0.0)
needed = table.text("aircraft")                 # no default: missing is an error
table.close()                                   # keys nobody asked for are errors, with the nearest spelling
"""

import datetime
import math
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError, nearest

_REQUIRED: Any = object()


class Table:
    """One TOML table with its place (`file: [step 3]`) for messages.

    Getters raise `InputError` for a missing key without default, a wrong type, NaN or a value out of bounds.
    """

    def __init__(self, data: dict[str, Any], where: str) -> None:
        self.data = data
        self.where = where
        self._asked: set[str] = set()

    def error(self, key: str, message: str) -> InputError:
        """An `InputError` about `key` of this table."""
        return InputError(f"{self.where}: {key}: {message}")

    def has(self, key: str) -> bool:
        """Is the key there? Asking makes it known."""
        self._asked.add(key)
        return key in self.data

    def value(self, key: str, default: Any = _REQUIRED) -> Any:
        """The raw value."""
        self._asked.add(key)
        if key in self.data:
            return self.data[key]
        if default is _REQUIRED:
            unknown = [k for k in self.data if k not in self._asked]
            hint = f" (found '{k}')" if (k := _closest(key, unknown)) else ""
            raise self.error(key, f"missing{hint}; add it")
        return default

    def number(
        self,
        key: str,
        default: Any = _REQUIRED,
        *,
        minimum: float = -math.inf,
        maximum: float = math.inf,
        above: float = -math.inf,
    ) -> float:
        """A finite float with `minimum <= value <= maximum` and `value > above`."""
        value = self.value(key, default)
        if value is default and not isinstance(value, (int, float)):
            return value  # type: ignore[no-any-return]  # a default of None passes through
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self.error(key, f"{value!r} is not a finite number")
        if not (minimum <= value <= maximum and value > above):
            low = f"> {above:g}" if above > -math.inf else f">= {minimum:g}" if minimum > -math.inf else ""
            high = f"<= {maximum:g}" if maximum < math.inf else ""
            raise self.error(key, f"{value:g} is out of range; it must be {' and '.join(x for x in (low, high) if x)}")
        return float(value)

    def integer(self, key: str, default: Any = _REQUIRED, *, minimum: int = -(2**62), maximum: int = 2**62) -> int:
        """An int with `minimum <= value <= maximum`."""
        value = self.value(key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"{value!r} is not a whole number")
        if not minimum <= value <= maximum:
            raise self.error(key, f"{value} is out of range; it must be {minimum} to {maximum}")
        return value

    def flag(self, key: str, default: Any = _REQUIRED) -> bool:
        """`true` or `false`."""
        value = self.value(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"{value!r} is not true or false")
        return value

    def text(self, key: str, default: Any = _REQUIRED) -> str:
        """A string."""
        value = self.value(key, default)
        if value is default:
            return value  # type: ignore[no-any-return]
        if not isinstance(value, str):
            raise self.error(key, f"{value!r} is not a text in quotes")
        return value

    def choice(self, key: str, choices: Sequence[str], default: Any = _REQUIRED) -> str:
        """One of `choices`."""
        value = self.text(key, default)
        if value is not default and value not in choices:
            raise self.error(key, f"'{value}' is unknown{nearest(value, choices)}")
        return value

    def vector(self, key: str, default: Any = _REQUIRED, *, size: int = 3) -> np.ndarray:
        """A float array (size,) from a list of finite numbers."""
        value = self.value(key, default)
        if value is default and value is None:
            return value  # type: ignore[return-value]
        numbers = isinstance(value, (list, tuple, np.ndarray)) and all(
            isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) for x in value
        )
        if not numbers or len(value) != size:
            raise self.error(key, f"{value!r} is not a list of {size} finite numbers")
        return np.array(value, dtype=float)

    def date(self, key: str, default: Any = _REQUIRED) -> datetime.datetime:
        """A date with time; without offset it is UTC."""
        value = self.value(key, default)
        if not isinstance(value, datetime.datetime):
            raise self.error(key, f"{value!r} is not a date and time like 2026-06-01T10:00:00Z")
        return value if value.tzinfo else value.replace(tzinfo=datetime.UTC)

    def table(self, key: str) -> "Table":
        """A sub-table (empty when absent)."""
        value = self.value(key, {})
        if not isinstance(value, dict):
            raise self.error(key, f"is not a table; write [{key}]")
        return Table(value, f"{self.where}: [{key}]")

    def named_tables(self, key: str) -> "dict[str, Table]":
        """`[key.NAME]` tables by name, in the file's order."""
        tables = self.table(key)
        for name, value in tables.data.items():
            if not isinstance(value, dict):
                raise tables.error(name, f"is not a table; write [{key}.{name}]")
        return {name: Table(value, f"{self.where}: [{key}.{name}]") for name, value in tables.data.items()}

    def list_of_tables(self, key: str) -> "list[Table]":
        """`[[key]]` tables, numbered from 1 in messages."""
        value = self.value(key, [])
        if not isinstance(value, list) or not all(isinstance(x, dict) for x in value):
            raise self.error(key, f"is not a list of tables; write [[{key}]]")
        return [Table(x, f"{self.where}: [[{key}]] {i + 1}") for i, x in enumerate(value)]

    def rest(self) -> dict[str, Any]:
        """The keys nobody has asked for yet (now known): settings passed on to somebody who checks them."""
        left = {k: v for k, v in self.data.items() if k not in self._asked}
        self._asked.update(left)
        return left

    def close(self) -> None:
        """Raise `InputError` for the first key nobody asked for."""
        for key in self.data:
            if key not in self._asked:
                raise self.error(key, f"unknown key{nearest(key, self._asked)}")


def _closest(word: str, known: Sequence[str]) -> str:
    hint = nearest(word, known)
    return hint.split("'")[1] if hint.startswith("; did") else ""


def read_toml(path: Path) -> Table:
    """Parse a TOML file.

    Raises:
        InputError: the file is absent, unreadable, not UTF-8 or not TOML (with the line).
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    return Table(data, str(path))
