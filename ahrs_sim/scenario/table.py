"""Checked access to a TOML table: every key is used or refused, every message names file and key.

table = read_toml(path)                         # Table
seed = table.integer("seed", 0, minimum=0)
with_default = table.number("for_s", 10.0, above=0.0)
needed = table.text("aircraft")                 # no default: missing is an error
table.close()                                   # keys that were not read are errors, with the nearest spelling
"""

import contextlib
import datetime
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError, nearest

MAX_TOML = 4 << 20
"""Characters of a TOML file."""

MAX_DEPTH = 32
"""Levels of tables and lists in a TOML file."""

_YEARS = 1970, 2038  # that a date may be in: seconds of a stamp in a message have 31 bits

_REQUIRED: Any = object()


@dataclass(frozen=True)
class Key:
    """One key as a reader declares it: form of its value, limits, default."""

    form: str  # number, integer, flag, text, choice, vector, date, table, named tables, list of tables, any
    required: bool
    default: Any = None
    minimum: float = -math.inf
    maximum: float = math.inf
    above: float = -math.inf
    choices: tuple[str, ...] = ()
    size: int = 0


class Declarations:
    """Keys that readers declare while `declaring`, by the place of their table."""

    def __init__(self, present: bool) -> None:
        self.tables: dict[str, dict[str, Key]] = {}
        self.present = present  # what `has` answers of a key that is not there
        self._optional: set[tuple[str, str]] = set()

    def asked(self, where: str, key: str) -> bool:
        """Note that a reader tests for a key: it is optional."""
        self._optional.add((where, key))
        self.tables.setdefault(where, {}).setdefault(key, Key("any", False))
        return self.present

    def add(self, where: str, key: str, found: Key) -> None:
        """Note a key; one that only some readers require is optional."""
        keys = self.tables.setdefault(where, {})
        known = keys.get(key, found)
        optional = (where, key) in self._optional or not (known.required and found.required)
        best = found if known.form == "any" else known
        keys[key] = replace(best, required=best.required and not optional)


_declarations: ContextVar[Declarations | None] = ContextVar("declarations", default=None)


@contextlib.contextmanager
def declaring(present: bool = True) -> Iterator[Declarations]:
    """Collect the keys that readers declare; in this context a valid value stands in for a missing key.

    Args:
        present: what `Table.has` answers of a missing key: both branches of a reader take two passes.
    """
    made = Declarations(present)
    token = _declarations.set(made)
    try:
        yield made
    finally:
        _declarations.reset(token)


class Table:
    """One TOML table with its place (`file: [step 3]`) for messages.

    Getters raise `InputError` for a missing key without default, a wrong type, NaN or a value out of bounds.
    """

    def __init__(self, data: dict[str, Any], where: str) -> None:
        self.data = data
        self.where = where
        self._asked: set[str] = set()

    def error(self, key: str, message: str) -> InputError:
        """Make an `InputError` about `key` of this table."""
        return InputError(f"{self.where}: {key}: {message}")

    def has(self, key: str) -> bool:
        """Test for a key and mark it as read."""
        self._asked.add(key)
        made = _declarations.get()
        return key in self.data or (made is not None and made.asked(self.where, key))

    def value(self, key: str, default: Any = _REQUIRED) -> Any:
        """Read a raw value."""
        return self._value(key, default, Key("any", default is _REQUIRED, default))

    def _value(self, key: str, default: Any, asked: Key) -> Any:
        self._asked.add(key)
        if (made := _declarations.get()) is not None:
            made.add(self.where, key, asked)
        if key in self.data:
            return self.data[key]
        if made is not None and (default is _REQUIRED or default == math.inf):
            return _fitting(asked)
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
        """Read a finite float with `minimum <= value <= maximum` and `value > above`."""
        value = self._value(key, default, _key("number", default, minimum=minimum, maximum=maximum, above=above))
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
        """Read an int with `minimum <= value <= maximum`."""
        value = self._value(key, default, _key("integer", default, minimum=minimum, maximum=maximum))
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"{value!r} is not a whole number")
        if not minimum <= value <= maximum:
            raise self.error(key, f"{value} is out of range; it must be {minimum} to {maximum}")
        return value

    def flag(self, key: str, default: Any = _REQUIRED) -> bool:
        """Read `true` or `false`."""
        value = self._value(key, default, _key("flag", default))
        if not isinstance(value, bool):
            raise self.error(key, f"{value!r} is not true or false")
        return value

    def text(self, key: str, default: Any = _REQUIRED) -> str:
        """Read a string."""
        return self._text(key, default, _key("text", default))

    def _text(self, key: str, default: Any, asked: Key) -> str:
        value = self._value(key, default, asked)
        if value is default:
            return value  # type: ignore[no-any-return]
        if not isinstance(value, str):
            raise self.error(key, f"{value!r} is not a text in quotes")
        return value

    def choice(self, key: str, choices: Sequence[str], default: Any = _REQUIRED) -> str:
        """Read one of `choices`."""
        value = self._text(key, default, _key("choice", default, choices=tuple(choices)))
        if value is not default and value not in choices:
            raise self.error(key, f"'{value}' is unknown{nearest(value, choices)}")
        return value

    def vector(self, key: str, default: Any = _REQUIRED, *, size: int = 3) -> np.ndarray:
        """Read a float array (size,) from a list of finite numbers."""
        value = self._value(key, default, _key("vector", default, size=size))
        if value is default and value is None:
            return value  # type: ignore[return-value]
        numbers = isinstance(value, (list, tuple, np.ndarray)) and all(
            isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) for x in value
        )
        if not numbers or len(value) != size:
            raise self.error(key, f"{value!r} is not a list of {size} finite numbers")
        return np.array(value, dtype=float)

    def texts(self, key: str, default: Any = _REQUIRED) -> list[str]:
        """Read a list of strings."""
        value = self._value(key, default, _key("texts", default))
        if not isinstance(value, list) or not all(isinstance(x, str) for x in value):
            raise self.error(key, f"{value!r} is not a list of texts")
        return value

    def date(self, key: str, default: Any = _REQUIRED) -> datetime.datetime:
        """Read a date with time; without offset it is UTC."""
        value = self._value(key, default, _key("date", default))
        if not isinstance(value, datetime.datetime):
            raise self.error(key, f"{value!r} is not a date and time like 2026-06-01T10:00:00Z")
        if not _YEARS[0] <= value.year < _YEARS[1]:
            raise self.error(key, f"{value} is out of range; it must be from {_YEARS[0]} to {_YEARS[1] - 1}")
        return value if value.tzinfo else value.replace(tzinfo=datetime.UTC)

    def table(self, key: str) -> "Table":
        """Read a sub-table (empty when absent)."""
        return self._table(key, "table")

    def _table(self, key: str, form: str) -> "Table":
        value = self._value(key, {}, Key(form, False))
        if not isinstance(value, dict):
            raise self.error(key, f"is not a table; write [{key}]")
        return Table(value, f"{self.where}: [{key}]")

    def named_tables(self, key: str) -> "dict[str, Table]":
        """Read `[key.NAME]` tables by name, in the file's order."""
        tables = self._table(key, "named tables")
        for name, value in tables.data.items():
            if not isinstance(value, dict):
                raise tables.error(name, f"is not a table; write [{key}.{name}]")
        return {name: Table(value, f"{self.where}: [{key}.{name}]") for name, value in tables.data.items()}

    def list_of_tables(self, key: str) -> "list[Table]":
        """Read `[[key]]` tables, numbered from 1 in messages."""
        value = self._value(key, [], Key("list of tables", False))
        if not isinstance(value, list) or not all(isinstance(x, dict) for x in value):
            raise self.error(key, f"is not a list of tables; write [[{key}]]")
        return [Table(x, f"{self.where}: [[{key}]] {i + 1}") for i, x in enumerate(value)]

    def rest(self) -> dict[str, Any]:
        """Return the remaining keys, marked as read, for a downstream validator."""
        left = {k: v for k, v in self.data.items() if k not in self._asked}
        self._asked.update(left)
        return left

    def close(self) -> None:
        """Raise `InputError` for the first key that was not read."""
        for key in self.data:
            if key not in self._asked:
                raise self.error(key, f"unknown key{nearest(key, self._asked)}")


def _key(form: str, default: Any, **bounds: Any) -> Key:
    required = default is _REQUIRED
    return Key(form, required, None if required else default, **bounds)


def _fitting(asked: Key) -> Any:
    """Make a value that a key of this form accepts."""
    if asked.form in ("number", "integer"):
        low = max(asked.minimum, asked.above)
        high = min(asked.maximum, max(low + 2.0, 2.0))
        middle = 0.5 * (max(low, high - 2.0) + high)
        return middle if asked.form == "number" else int(middle)
    if asked.form == "vector":
        return [1.0] * asked.size
    return {"flag": True, "text": "x", "texts": [], "date": datetime.datetime(2026, 6, 1, tzinfo=datetime.UTC)}.get(
        asked.form, asked.choices[0] if asked.choices else "x"
    )


def overlay(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """Lay a table over another: tables are merged key by key, everything else is replaced."""
    merged = dict(base)
    for key, value in top.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = overlay(base[key], value) if both else value
    return merged


def is_file(path: Path) -> bool:
    """Tell whether there is a file; a name that no file can have is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def named_file(name: str, folder: Path) -> Path | None:
    """Find a file that another one in `folder` names: beside that one, else in the current folder; None: in neither."""
    return next((base / name for base in (folder, Path()) if is_file(base / name)), None)


def _closest(word: str, known: Sequence[str]) -> str:
    hint = nearest(word, known)
    return hint.split("'")[1] if hint.startswith("; did") else ""


def read_toml(path: Path) -> Table:
    """Parse a TOML file.

    Raises:
        InputError: the file is absent, unreadable, not UTF-8, too large or not TOML (with the line).
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise InputError(f"{path}: cannot be read (it is not a file)")
        with path.open("rb") as stream:
            text = stream.read(MAX_TOML + 1).decode()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    return Table(parse_toml(text, str(path)), str(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Parse TOML from any author; the result has limited depth and numbers of 64 bits.

    Raises:
        InputError: it is not TOML, longer than `MAX_TOML`, nested deeper than `MAX_DEPTH`, or a number is too large.
    """
    if len(text) > MAX_TOML:
        raise InputError(f"{where}: longer than {MAX_TOML >> 20} MiB, which no such file is")
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{where}: not valid TOML: nested deeper than {MAX_DEPTH} levels") from None
    except ValueError as error:  # TOMLDecodeError, and numbers of thousands of digits
        reason = error if isinstance(error, tomllib.TOMLDecodeError) else "a number has too many digits"
        raise InputError(f"{where}: not valid TOML: {reason}") from None
    level: list[Any] = [data]
    for _ in range(MAX_DEPTH):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict | list):
                inner += value.values() if isinstance(value, dict) else value
            elif isinstance(value, int) and not -(2**63) <= value < 2**63:
                raise InputError(f"{where}: not valid TOML: a whole number does not fit into 64 bits")
        level = inner
    if level:
        raise InputError(f"{where}: not valid TOML: nested deeper than {MAX_DEPTH} levels")
    return data
