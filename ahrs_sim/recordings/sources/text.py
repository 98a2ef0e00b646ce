"""Reads a text table: finds encoding, header, separator, decimal sign and units where the map does not give them."""

import csv
import io
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.recordings.sources.base import one_line
from ahrs_sim.scenario.table import Table

_SPELT = {
    "us": "us", "usec": "us", "µs": "us", "ms": "ms", "msec": "ms", "ns": "ns", "nsec": "ns", "s": "s", "sec": "s",
    "seconds": "s", "min": "min", "minutes": "min", "h": "h", "hours": "h",
    "rads1": "rad/s", "rads": "rad/s", "rad/s": "rad/s", "rads^-1": "rad/s", "radians/second": "rad/s",
    "deg/s": "deg/s", "°/s": "deg/s", "dps": "deg/s", "degs^-1": "deg/s", "degrees/second": "deg/s",
    "m/s^2": "m/s2", "m/s2": "m/s2", "m/s²": "m/s2", "ms^-2": "m/s2", "ms-2": "m/s2", "g": "g", "mg": "mg",
    "µt": "uT", "ut": "uT", "nt": "nT", "t": "T", "gauss": "G", "mgauss": "mG", "deg": "deg", "°": "deg",
    "degrees": "deg", "rad": "rad", "radians": "rad", "m": "m", "meters": "m", "m/s": "m/s", "ms-1": "m/s",
    "ms^-1": "m/s", "ft": "ft", "feet": "ft", "kt": "kt", "kts": "kt", "knots": "kt",
    "hpa": "hPa", "pa": "Pa", "pascal": "Pa", "mbar": "mbar", "kpa": "kPa", "km/h": "km/h",
}  # fmt: skip
"""Unit by its spelling in a header, in lower case without blanks, dots and asterisks."""

_BRACKETS = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")
_SEPARATORS = (",", ";", "\t", "|")
_DATES = re.compile(r"\d+\.\d+\.\d+")
TIME_OF_DAY = re.compile(r"^\s*\d{1,2}:\d\d:\d\d([.,]\d+)?\s*$")
ISO_DATE = re.compile(r"^\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d")


@dataclass
class TextTable:
    """Holds the contents of one file, and what the user should know about them."""

    path: Path
    frame: Any  # pandas
    units: list[str]  # by column; "" where the header has none
    first_row: int  # line number of the first data row, from 1
    unknown: list[str] = field(default_factory=list)  # by column, the header's unit where it is not one of ours
    notes: list[str] = field(default_factory=list)  # a line each for the user

    def place(self, name: str) -> int:
        """Find the index of a column by its name, by `*ENDING` or by alternatives `A|B`; -1 when there is none."""
        names = [str(c) for c in self.frame.columns]
        for one in name.split("|") if name not in names else [name]:
            if one in names:
                return names.index(one)
            if one.startswith("*"):
                found = [i for i, n in enumerate(names) if n.endswith(one[1:])]
            else:
                found = [i for i, n in enumerate(names) if _plain(n) == _plain(one)]
            if found:
                return found[0]
        return -1

    def unit(self, name: str, fallback: str) -> str:
        """Find the unit of a column in the header; without a known one take `fallback`, and note an unknown one."""
        i = self.place(name)
        if i >= 0 and self.units[i]:
            return self.units[i]
        if i >= 0 and i < len(self.unknown) and self.unknown[i]:
            self.notes.append(
                f"{self.path.name}: {name}: '{self.unknown[i]}' of the header is no unit known here, "
                f"taken as {fallback} (unit = ... in the map)"
            )
        return fallback

    def numbers(self, name: str, table: Table, key: str = "columns") -> np.ndarray:
        """Convert a column to numbers (n,), NaN for empty cells and for text, which is counted in a note.

        Raises:
            InputError: no such column, or no cell of it is a number.
        """
        import pandas

        i = self.place(name)
        if i < 0:
            known = [str(c) for c in self.frame.columns]
            raise table.error(key, f"no column '{name}' in the file{nearest(name, known)}")
        column = self.frame.iloc[:, i]
        numbers: np.ndarray = pandas.to_numeric(column, errors="coerce").to_numpy(float)
        if column.dtype.kind not in "fiu":
            lost = np.flatnonzero(np.isnan(numbers) & column.notna().to_numpy())
            if len(lost) and len(lost) == int(column.notna().sum()):
                raise table.error(key, f"{name}: {self.no_number(column, lost[0])}")
            if len(lost):
                many = "values are no numbers" if len(lost) > 1 else "value is no number"
                self.notes.append(
                    f"{self.path.name}: {name}: {len(lost)} {many}, the first in {self.cell(column, lost[0])}"
                )
        return numbers

    def cell(self, column: Any, i: int) -> str:
        """Name the row and the value of a cell, for messages."""
        return f"row {self.first_row + i}: '{str(column.iloc[i])[:40]}'"

    def no_number(self, column: Any, i: int) -> str:
        """Describe a cell that should hold a number, for messages."""
        return f"no number in {self.cell(column, i)}"


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", "", _BRACKETS.sub("", name)).lower()


def read_file(path: Path, keys: Mapping[str, Any], where: str) -> TextTable:
    """Read a text table with any separator and any lines above its header.

    Args:
        path: the file.
        keys: of the map's `[csv]`: separator, decimal, encoding, comment, skip_rows.
        where: name of the map, for messages.

    Raises:
        InputError: the file cannot be read, or holds no table.
    """
    import pandas

    notes: list[str] = []
    text = _text(path, keys.get("encoding"), notes)
    comment = keys.get("comment")
    skip = int(keys.get("skip_rows", 0))
    head, start, separator, second = _header(path, text, skip, keys.get("separator"), comment)
    body = text[start:]
    decimal = keys.get("decimal") or _decimal(body, separator)
    names, units, unknown = _named(head, second)
    sep = r"\s+" if separator == " " else separator
    bad: list[int] = []

    def left_out(cells: list[str]) -> None:
        bad.append(len(cells))

    options: dict[str, Any] = {"sep": sep, "decimal": decimal, "header": None, "names": names, "index_col": False,
                               "skipinitialspace": True, "skip_blank_lines": True}  # fmt: skip
    lines = [line for line in body.splitlines(keepends=True) if not line.startswith(comment)] if comment else None
    stream = io.StringIO(body if lines is None else "".join(lines))
    try:
        try:
            frame = pandas.read_csv(stream, low_memory=False, on_bad_lines="error", **options)
        except (pandas.errors.ParserError, ValueError):
            stream.seek(0)
            frame = pandas.read_csv(stream, engine="python", on_bad_lines=left_out, **options)
    except (OSError, ValueError, OverflowError, pandas.errors.ParserError, re.error) as error:
        raise InputError(f"{path}: no CSV: {one_line(error)} ({where}: [csv])") from None
    if bad:
        notes.append(f"{path.name}: {len(bad)} rows with too many cells left out")
    if not len(frame):
        raise InputError(f"{path}: no CSV: no rows under its header")
    return TextTable(path, frame, units, 1 + text[:start].count("\n"), unknown, notes)


def header_of(path: Path) -> TextTable | None:
    """Read the column names of a text table without its rows; None when the file is no such table."""
    import pandas

    try:
        with path.open("rb") as stream:
            beginning = stream.read(1 << 16)
        text = _decoded(path, beginning[: beginning.rfind(b"\n") + 1 or None], None, [])
        head, _, _, second = _header(path, text, 0, None, None)
    except (OSError, InputError):
        return None
    names, units, _ = _named(head, second)
    return TextTable(path, pandas.DataFrame(columns=names), units, 1)


def _text(path: Path, encoding: str | None, notes: list[str]) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    return _decoded(path, data, encoding, notes)


def _decoded(path: Path, data: bytes, encoding: str | None, notes: list[str]) -> str:
    tried = (
        [encoding] if encoding else ["utf-16"] if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ["utf-8-sig", "cp1252"]
    )
    for name in tried:
        try:
            text = data.decode(name)
        except LookupError:
            raise InputError(f"{path}: no CSV: encoding '{name}' is not known") from None
        except UnicodeDecodeError:
            continue
        if "\0" in text[:10000]:
            break
        if "\n" not in text[: 1 << 16]:  # lines may end as they did on old Macs
            text = text.replace("\r", "\n")
        if name == "cp1252" and not encoding:
            notes.append(f"{path.name}: not UTF-8, read as cp1252 ([csv] encoding)")
        return text
    raise InputError(f"{path}: no CSV: it is no text in {' or '.join(tried)} ([csv] encoding)")


def _header(
    path: Path, text: str, skip: int, separator: str | None, comment: str | None
) -> tuple[list[str], int, str, list[str] | None]:
    """Find the header: its cells, the offset of the data, the separator, and a second header line or None."""
    lines = list(itertools.islice(_lines(text), 400))[skip:]
    if comment:
        lines = [(at, line) for at, line in lines if not line.startswith(comment)]
    lines = [(at, line) for at, line in lines if line.strip()]
    if len(lines) < 2:
        raise InputError(f"{path}: no CSV: no rows under a header")
    last = [line for _, line in lines[-20:]]
    found = separator or _separator(last)
    width = int(np.median([len(_cells(line, found)) for line in last]))
    for i, (_, line) in enumerate(lines[:-1]):
        cells = _cells(line.lstrip("#%").strip() if not comment else line, found)
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if len(cells) == width and not all(_is_number(c) or not c for c in cells):
            following = _cells(lines[i + 1][1], found)
            commented = lines[i + 1][1].startswith(("//", "#"))
            if commented or (len(following) != width and i + 2 < len(lines) and not line.startswith("#")):
                continue
            second = None
            data = i + 1
            texts = [c for c in following if c]
            plain = not any(_is_number(c) or ISO_DATE.match(c) for c in texts)
            if texts and plain and i + 2 < len(lines) and _some_number(_cells(lines[i + 2][1], found)):
                second, data = following, i + 2
            return cells, lines[data][0], found, second
    raise InputError(f"{path}: no CSV: no header with the names of the columns above its rows of {width}")


def _lines(text: str) -> Iterator[tuple[int, str]]:
    at = 0
    while at < len(text):
        end = text.find("\n", at)
        end = len(text) if end < 0 else end
        yield at, text[at:end].rstrip("\r")
        at = end + 1


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        parts = line.split()
    elif '"' in line and len(separator) == 1:  # a separator within quotes is none
        parts = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    else:
        parts = line.split(separator)
    return [p.strip().strip('"').strip() for p in parts]


def _separator(lines: Sequence[str]) -> str:
    """Find the separator that occurs equally often in all lines; a comma between digits may be a decimal comma."""
    best, most = " ", 0
    for separator in _SEPARATORS:
        counts = {line.count(separator) for line in lines}
        if len(counts) == 1 and (n := counts.pop()) > 0:
            mixed = separator == "," and any(s in lines[0] for s in (";", "\t", "|"))
            if not mixed and n > most:
                best, most = separator, n
    if most == 0:
        totals = {s: sum(line.count(s) for line in lines) for s in _SEPARATORS}
        best = max(totals, key=lambda s: totals[s]) if max(totals.values()) else " "
    return best


def _decimal(body: str, separator: str) -> str:
    sample = _DATES.sub("", body[:20000])
    comma = separator != "," and re.search(r"(^|[;\t| \"])-?\d+,\d+", sample, re.M)
    return "," if comma and not re.search(r"\d\.\d", sample) else "."


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _some_number(cells: Sequence[str]) -> bool:
    return any(_is_number(c) or ISO_DATE.match(c) for c in cells)


def _named(head: Sequence[str], second: Sequence[str] | None) -> tuple[list[str], list[str], list[str]]:
    """List by column a unique name, the unit in the name or in the line below, and a unit that is not known."""
    names: list[str] = []
    units: list[str] = []
    unknown = []
    for i, cell in enumerate(head):
        name = cell or f"column {i + 1}"
        names.append(name if name not in names else f"{name}.{names.count(name)}.{i}")
        below = second[i].strip("[]() ") if second and i < len(second) else ""
        match = _BRACKETS.search(cell)
        units.append(_unit(below) or (_unit(match[1]) if match else ""))
        unknown.append("" if units[-1] else below or (match[1] if match else ""))
    return names, units, unknown


def _unit(text: str) -> str:
    spelt = re.sub(r"[\s.*·]", "", text).lower().replace("\N{GREEK SMALL LETTER MU}", "\N{MICRO SIGN}")
    return _SPELT.get(spelt, "")
