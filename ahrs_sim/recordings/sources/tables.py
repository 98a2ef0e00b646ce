"""Tables of text (`.csv` and the like), one file or several, whose columns the user's map names.

    [csv]
    separator = ";"         # else found: comma, semicolon, tab, bar, blanks
    decimal = ","           # else found
    encoding = "cp1252"     # else UTF-8, UTF-16 with its mark, cp1252
    comment = "//"          # lines that begin so are left out; else those before the header
    skip_rows = 3           # lines before the header; else found
    file = "log.csv"        # of a folder; a pattern will do
    time = {column = "t", unit = "ms"}      # or a number of seconds as unit; ISO 8601 needs none
    time = {column = "t", format = "%d.%m.%Y %H:%M:%S.%f"}
    time = {week = "gps_week", seconds = "gps_tow", unit = "s"}
    time = {year = "Y", month = "M", day = "D", hour = "h", minute = "m", second = "s"}
    [csv.imu]
    file = "imu0/data.csv"  # where each kind has a file of its own; likewise time, optional = true
    gyro = {columns = ["gx", "gy", "gz"], unit = "deg/s"}       # unit: else as the header says, `gx (deg/s)`

A column is found by its name, without regard to case and punctuation, "a|b" is either, "*:x" ends in `:x`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.recordings.sources.base import (
    AIR,
    ATTITUDE,
    FIX,
    FRD,
    HEADING,
    IMU,
    MAG,
    NED,
    PRESSURE,
    UNITS,
    VELOCITY,
    Columns,
    Held,
    from_gps,
    longest_part,
    one_line,
)
from ahrs_sim.recordings.sources.text import ISO_DATE, TIME_OF_DAY, TextTable, read_file
from ahrs_sim.scenario.table import Table

_KINDS: dict[str, tuple[str, dict[str, tuple[str, int, str]]]] = {  # type; by key of the map: field, size, dimension
    "imu": (IMU, {"gyro": ("angular_velocity", 3, "rad/s"), "accel": ("linear_acceleration", 3, "m/s2")}),
    "mag": (MAG, {"field": ("magnetic_field", 3, "T")}),
    "fix": (
        FIX,
        {
            "latitude": ("latitude", 1, "deg"),
            "longitude": ("longitude", 1, "deg"),
            "altitude": ("altitude", 1, "m"),
            "status": ("status__status", 1, ""),
        },
    ),
    "velocity": (VELOCITY, {"velocity": ("twist__linear", 3, "m/s"), "polar": ("twist__linear", 3, "m/s")}),
    "heading": (HEADING, {"heading": ("heading", 1, "rad")}),
    "diff_pressure": (PRESSURE, {"pressure": ("fluid_pressure", 1, "Pa")}),
    "static_pressure": (PRESSURE, {"pressure": ("fluid_pressure", 1, "Pa")}),
    "air": (AIR, {"airspeed": ("airspeed", 1, "m/s")}),
    "reference": (ATTITUDE, {"euler": ("quaternion", 3, "rad"), "quaternion": ("quaternion", 4, "")}),
}
_CHANGES_ONLY = ("fix", "velocity", "heading")
_DIMENSIONS = {
    "rad/s": ("rad/s", "deg/s", "dps"), "m/s2": ("m/s2", "m/s^2", "g", "mg"), "T": ("T", "uT", "nT", "G", "mG"),
    "deg": ("deg", "rad"), "rad": ("rad", "deg"), "m": ("m", "ft"), "m/s": ("m/s", "km/h", "kt"),
    "Pa": ("Pa", "hPa", "mbar", "kPa"),
}  # fmt: skip
_FEWEST_TIMES = 0.5
"""Share of the rows of an IMU that must have a time of their own."""

_TIMES = ("s", "ms", "us", "ns", "min", "h")

CSV_KEYS = ("separator", "decimal", "encoding", "comment", "skip_rows", "file", "time")


class Csv(Held):
    """Columns by name; `[csv.KIND]` of the map says which, in what units and in what file."""

    form = "table of text"

    def __init__(self, path: Path, table: Table) -> None:
        if not path.exists():
            raise InputError(f"{path}: cannot be read: no such file")
        if not table.data:
            raise InputError(
                f"{path}: a CSV needs a --map with [csv] saying what its columns are, or --map preset:NAME "
                "(ahrs-sim list maps); see docs/replay.md"
            )
        self._root = path
        self._files: dict[tuple[Path, str], TextTable] = {}
        self._said: list[str] = []
        self._parts: dict[Path, tuple[int, int]] = {}  # rows that are used of files whose clock steps back
        shared = {k: table.value(k) for k in CSV_KEYS if table.has(k)}
        topics: dict[str, Columns] = {}
        for kind in _KINDS:
            if table.has(kind):
                topics |= self._of_kind(table.table(kind), kind, shared, table)
        table.close()
        if self._parts and len({p for p, _ in self._files}) > 1:
            raise InputError(f"{next(iter(self._parts))}: {self._said[-1]}; of several files each has to be one part")
        super().__init__(path, topics)
        self.notes += list(dict.fromkeys([n for f in self._files.values() for n in f.notes] + self._said))

    def _of_kind(self, table: Table, kind: str, shared: Mapping[str, Any], whole: Table) -> dict[str, Columns]:
        own = {k: table.value(k) for k in CSV_KEYS if table.has(k)}
        optional = bool(table.value("optional", False))
        keys = {**shared, **own}
        _, fields = _KINDS[kind]
        given = {key: table.table(key) for key in fields if table.has(key)}
        separate = {key: t for key, t in given.items() if t.has("file")}
        table.close()
        if not given:
            raise table.error(next(iter(fields)), "missing; name its columns")
        made: dict[str, Columns] = {}
        for group in [*([k] for k in separate), [k for k in given if k not in separate]]:
            if not group:
                continue
            entry = given[group[0]]
            local = {**keys, **{k: entry.value(k) for k in CSV_KEYS if entry.has(k)}} if group[0] in separate else keys
            file = self._file(local, table, optional)
            if file is None:
                continue
            chosen = {k: given[k] for k in group}
            if optional and any(file.place(n) < 0 for t in chosen.values() for n in _names(t, 0)):
                continue
            part = self._messages(kind, chosen, file, local, table, whole, split=len(given) > 1)
            for name, columns in part.items():
                made[name] = columns
        return made

    def _file(self, keys: Mapping[str, Any], table: Table, optional: bool) -> TextTable | None:
        """The file that a kind stands in, read once."""
        path = self._root
        for name in ("separator", "decimal", "encoding", "comment", "file"):
            if not isinstance(keys.get(name, ""), str):
                raise table.error(name, f"{keys[name]!r} is not a text in quotes")
        if not isinstance(keys.get("skip_rows", 0), int):
            raise table.error("skip_rows", f"{keys['skip_rows']!r} is not a whole number")
        pattern = keys.get("file")
        if pattern is not None:
            if not pattern or any(Path(one).is_absolute() or ".." in Path(one).parts for one in pattern.split("|")):
                raise table.error("file", f"'{pattern}' is not the name of a file beside the recording")
            folder = path if path.is_dir() else path.parent
            found = [p for one in str(pattern).split("|") for p in sorted(folder.glob(one)) if p.is_file()]
            if not found and optional:
                return None
            if not found:
                raise table.error("file", f"no file '{pattern}' in {folder}")
            path = found[0]
        elif path.is_dir():
            there = ", ".join(sorted(p.name for p in path.glob("*.*"))[:8])
            raise table.error("file", f"missing; {path} is a folder, name the file ({there})")
        key = path, repr(sorted((k, v) for k, v in keys.items() if k not in ("file", "time")))
        if key not in self._files:
            self._files[key] = read_file(path, keys, table.where)
        return self._files[key]

    def _messages(
        self, kind: str, given: Mapping[str, Table], file: TextTable, keys: Mapping[str, Any], table: Table,
        whole: Table, split: bool,
    ) -> dict[str, Columns]:  # fmt: skip
        """The topics of one kind in one file."""
        _, fields = _KINDS[kind]
        columns: dict[str, np.ndarray] = {}
        for key, entry in given.items():
            place, size, dimension = fields[key]
            columns[place] = self._values(key, entry, file, size, dimension)
        owner = table if table.has("time") else whole
        ns, timed = self._times(keys, owner, file)
        good = timed & np.all([np.isfinite(v).all(axis=1) for v in columns.values()], axis=0)
        apart = kind == "imu" and len(columns) == 2 and 2 * good.sum() < max(
            int((timed & np.isfinite(v).all(axis=1)).sum()) for v in columns.values()
        )  # fmt: skip
        if apart or (kind == "imu" and len(columns) == 1 and split):
            return {
                f"imu/{'gyro' if place == 'angular_velocity' else 'accel'}": self._selected(
                    "imu", {place: v, f"{_OTHER[place]}_covariance": np.tile(_ABSENT, (len(v), 1))},
                    ns, timed & np.isfinite(v).all(axis=1), file)
                for place, v in columns.items()
            }  # fmt: skip
        return {kind: self._selected(kind, columns, ns, good, file)}

    def _values(self, key: str, entry: Table, file: TextTable, size: int, dimension: str) -> np.ndarray:
        """Values (n, size) in SI of an entry like `{columns = [...], unit = "deg/s"}`."""
        names = _names(entry, size)
        if key == "status":
            minimum = entry.number("minimum", 3.0)
            entry.close()
            fixed: np.ndarray = np.where(file.numbers(names[0], entry) >= minimum, 0.0, -1.0)[:, None]
            return fixed
        places = [file.place(n) for n in names]
        stated = {file.units[p] for p in places if p >= 0} & set(_DIMENSIONS.get(dimension, ()))
        header = stated.pop() if len(stated) == 1 else ""
        unit, scale = self._scale(entry, dimension, header)
        if not header and dimension in ("m", "deg") and not entry.has("unit"):
            for name in names:
                file.unit(name, dimension)
        if header and unit and UNITS[header] != UNITS[unit]:
            self._said.append(f"{file.path.name}: {names[0]}: unit is {unit} by the map, {header} by its header")
        signs = np.where([bool(s) for s in entry.value("negative", [False] * size)], -1.0, 1.0)
        values: np.ndarray = np.column_stack([file.numbers(n, entry) for n in names])
        for key_of_file in CSV_KEYS:
            entry.has(key_of_file)
        entry.close()
        if key == "polar":  # speed, course in deg, down
            speed, course, down = scale * values[:, 0], np.radians(values[:, 1]), scale * values[:, 2]
            return np.column_stack([speed * np.cos(course), speed * np.sin(course), down])
        values = scale * signs * values
        return attitude.from_euler(values) if key == "euler" else values

    @staticmethod
    def _scale(entry: Table, dimension: str, header: str) -> tuple[str, float]:
        """Unit and SI value (deg for latitudes) of a 1, by the map, else by the header."""
        given = entry.value("unit", None)
        if isinstance(given, (int, float)) and not isinstance(given, bool):
            return "", float(given)
        if dimension in ("", "deg"):
            unit = entry.choice("unit", list(UNITS), header)
            return unit, float(np.degrees(1.0)) if unit == "rad" else 1.0
        fallback = header or {"m": "m"}.get(dimension)
        unit = entry.choice("unit", list(UNITS), fallback) if fallback else entry.choice("unit", list(UNITS))
        return unit, UNITS[unit]

    def _times(self, keys: Mapping[str, Any], owner: Table, file: TextTable) -> tuple[np.ndarray, np.ndarray]:
        """Times (n,) ns and whether each row has one."""
        if not isinstance(keys.get("time"), dict):
            raise owner.error("time", 'missing; name its column: time = {column = "t", unit = "s"}')
        table = Table(keys["time"], f"{owner.where}: time")
        clock = _clock(table, file)
        table.close()
        finite = np.isfinite(clock)
        if not finite.any():
            raise InputError(f"{file.path}: time: no times in it")
        seconds_ns = np.zeros(len(clock), np.int64)
        seconds_ns[finite] = np.rint(np.clip(clock[finite], -9e18, 9e18)).astype(np.int64)
        return seconds_ns, finite

    def _selected(
        self, kind: str, columns: Mapping[str, np.ndarray], ns: np.ndarray, good: np.ndarray, file: TextTable
    ) -> Columns:
        """The rows that say something new, in the order of time."""
        rows = np.flatnonzero(good)
        if len(rows) == 0:
            raise InputError(f"{file.path}: {kind}: no row has all of its columns")
        rows = self._forward(kind, ns, rows, file)
        values = np.column_stack([v[rows] for k, v in columns.items() if not k.endswith("covariance")])
        fresh = np.r_[True, (np.diff(values, axis=0) != 0).any(axis=1)]
        runs = np.diff(np.r_[np.flatnonzero(fresh), len(rows)])
        if kind in _CHANGES_ONLY or np.median(runs) >= 2:  # a table repeats what a slow sensor has said
            rows = rows[fresh]
        times = len(np.unique(ns[rows]))
        if kind == "imu" and times < _FEWEST_TIMES * len(rows):
            raise InputError(
                f"{file.path}: time: {len(rows)} rows, {times} different times: the column has too few digits"
            )
        frame_id = NED if kind in ("velocity", "heading") else FRD
        chosen = {k: (v[rows] if v.shape[1] > 1 else v[rows, 0]) for k, v in columns.items()}
        return Columns(_KINDS[kind][0], ns[rows], chosen, frame_id)

    def _forward(self, kind: str, ns: np.ndarray, rows: np.ndarray, file: TextTable) -> np.ndarray:
        """Rows in the order of time: turned round where they descend, the longest part where the clock steps back.

        A part that is used for one kind is for all of the file: another one is of another time.
        """
        low, high = self._parts.get(file.path, (0, len(ns)))
        rows = rows[(rows >= low) & (rows < high)]
        if not len(rows):
            raise InputError(
                f"{file.path}: no row of {kind} is in rows {file.first_row + low} to {file.first_row + high - 1}, the "
                "longest part without a step back of the clock; cut the file"
            )
        steps = np.diff(ns[rows])
        if len(steps) > 2 and (steps <= 0).all() and (steps < 0).any():
            self._said.append(f"{file.path.name}: the rows go back in time: taken from the last to the first")
            return rows[::-1]
        part, back = longest_part(ns[rows])
        if not back:
            return rows
        at = int(np.flatnonzero(steps < -(10**9))[0])
        where = f"time goes back by {-steps[at] / 1e9:.6g} s in row {file.first_row + int(rows[at + 1])}"
        if back > 10:
            raise InputError(f"{file.path}: {where}, and {back - 1} times more; sort the rows")
        low, high = int(rows[part.start]), int(rows[part.stop - 1]) + 1
        self._parts[file.path] = low, high
        first, last = file.first_row + low, file.first_row + high - 1
        self._said.append(
            f"{file.path.name}: {where}: of the {back + 1} parts the longest is used, rows {first} to {last}"
        )
        return rows[part]


_ABSENT = np.r_[-1.0, np.zeros(8)]
_OTHER = {"angular_velocity": "linear_acceleration", "linear_acceleration": "angular_velocity"}


def _names(entry: Table, size: int) -> list[str]:
    names = entry.value("columns")
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names) or (size and len(names) != size):
        raise entry.error("columns", f"{names!r} is not a list of {size} column names")
    return names


def _clock(table: Table, file: TextTable) -> np.ndarray:
    """Time (n,) in ns as the table's `time` describes it; NaN where a row has none."""
    if table.has("week"):
        week, seconds = (file.numbers(table.text(k), table, k) for k in ("week", "seconds"))
        scale = UNITS[table.choice("unit", _TIMES, file.unit(table.text("seconds"), "s"))]
        good = np.isfinite(week) & np.isfinite(seconds) & (np.abs(week) < 1e6)
        out = np.full(len(week), np.nan)
        ns = from_gps(week[good], scale * seconds[good])
        out[good] = ns
        return out
    if table.has("year"):
        return _calendar(table, file)
    name = table.text("column")
    if table.has("format") or (file.place(name) >= 0 and _is_date(file, name)):
        return _dated(file, name, table)
    if file.place(name) >= 0 and _is_time_of_day(file, name):
        return _of_day(file, name, table)
    unit = table.value("unit", None) or file.unit(name, "s")
    if not isinstance(unit, (int, float)) and unit not in _TIMES:
        raise table.error("unit", f"{unit!r} is none of {', '.join(_TIMES)}, a number of seconds")
    header = file.units[file.place(name)] if file.place(name) >= 0 else ""
    if header in _TIMES and unit in _TIMES and unit != header:
        file.notes.append(f"{file.path.name}: {name}: unit is {unit} by the map, {header} by its header")
    values = file.numbers(name, table, "column")
    if table.has("wraps_at"):  # a counter that starts anew
        wrap = table.number("wraps_at", above=0.0)
        steps = np.diff(values, prepend=values[:1])
        values = values + wrap * np.cumsum(np.where(steps < -0.5 * wrap, 1.0, 0.0))
    ns_per = (float(unit) if isinstance(unit, (int, float)) else UNITS[unit]) * 1e9
    ticks: np.ndarray = values * ns_per
    return ticks


def _is_date(file: TextTable, name: str) -> bool:
    column = file.frame.iloc[:, file.place(name)].dropna()
    return bool(len(column) and ISO_DATE.match(str(column.iloc[0])))


def _is_time_of_day(file: TextTable, name: str) -> bool:
    column = file.frame.iloc[:, file.place(name)].dropna()
    return bool(len(column) and TIME_OF_DAY.match(str(column.iloc[0])))


def _of_day(file: TextTable, name: str, table: Table) -> np.ndarray:
    """Times (n,) ns of a day that is not known, counted on over midnight."""
    import pandas

    table.has("unit")
    column = file.frame.iloc[:, file.place(name)]
    times = pandas.to_timedelta(column, errors="coerce")
    lost = np.flatnonzero((times.isna() & column.notna()).to_numpy())
    if len(lost):
        file.notes.append(
            f"{file.path.name}: {name}: {len(lost)} rows without a time, the first {file.cell(column, lost[0])}"
        )
    out = np.full(len(column), np.nan)
    known = times.notna().to_numpy()
    seconds = times[known].dt.total_seconds().to_numpy(float)
    out[known] = 1e9 * (seconds + 86400.0 * np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -43200.0))
    return out


def _dated(file: TextTable, name: str, table: Table) -> np.ndarray:
    import pandas

    i = file.place(name)
    if i < 0:
        raise table.error("column", f"no column '{name}' in {file.path.name}{nearest(name, list(file.frame.columns))}")
    form = table.text("format", "ISO8601")
    table.has("unit")
    column = file.frame.iloc[:, i]
    try:
        dates = pandas.to_datetime(column, format=form, utc=True, errors="coerce")
    except ValueError as error:
        raise table.error("format", one_line(error)) from None
    known = dates.notna().to_numpy()
    lost = np.flatnonzero(~known & column.notna().to_numpy())
    if not known.any():
        raise table.error("column", f"{name}: no time in {file.cell(column, 0)}")
    if len(lost):
        file.notes.append(
            f"{file.path.name}: {name}: {len(lost)} rows without a time, the first {file.cell(column, lost[0])}"
        )
    out = np.full(len(column), np.nan)
    out[known] = dates[known].astype("datetime64[ns, UTC]").astype("int64").to_numpy()
    return out


def _calendar(table: Table, file: TextTable) -> np.ndarray:
    """Convert columns year, month, day, hour, minute, second and perhaps nanosecond to a time."""
    parts = {k: file.numbers(table.text(k), table, k) for k in ("year", "month", "day", "hour", "minute", "second")}
    more = file.numbers(table.text("nanosecond"), table, "nanosecond") if table.has("nanosecond") else 0.0
    good = np.all([np.isfinite(v) for v in parts.values()], axis=0) & (parts["year"] > 1900) & (parts["year"] < 2200)
    out = np.full(len(good), np.nan)
    months = ((parts["year"][good] - 1970) * 12 + parts["month"][good] - 1).astype("timedelta64[M]")
    days = (np.datetime64("1970-01") + months).astype("datetime64[D]").astype(np.int64) + parts["day"][good] - 1
    hours = days * 24 + parts["hour"][good]
    seconds = (hours * 60 + parts["minute"][good]) * 60 + parts["second"][good]
    out[good] = seconds * 1e9 + (more[good] if isinstance(more, np.ndarray) else 0.0)
    return out
