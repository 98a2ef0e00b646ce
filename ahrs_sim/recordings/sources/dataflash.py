"""ArduPilot's DataFlash logs (`.bin`), which describe themselves: FMT names the fields of each message.

Format: libraries/AP_Logger/LogStructure.h of ArduPilot (types of fields, units, multipliers) and
https://ardupilot.org/plane/docs/logmessages.html (messages). Rates and forces are in the axes of the vehicle (FRD),
positions WGS84 with heights above mean sea level.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError
from ahrs_sim.recordings.sources import scan
from ahrs_sim.recordings.sources.base import (
    AIR,
    ATTITUDE,
    FIX,
    HEADING,
    IMU,
    MAG,
    NED,
    PRESSURE,
    VELOCITY,
    BinaryLog,
    Columns,
    from_gps,
    gathered,
    longest_part,
    near_in_time,
    numbered,
)

_TYPES = {
    "a": ("<i2", 32), "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4", "d": "<f8",
    "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4", "M": "u1",
    "q": "<i8", "Q": "<u8", "g": "<f2",
}  # fmt: skip
_SCALES = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
"""What the type of a field implies; a multiplier of FMTU says the same again, or stands alone."""

_FMT = np.dtype([("head", "u1", 3), ("type", "u1"), ("length", "u1"), ("name", "S4"), ("format", "S16"),
                 ("columns", "S64")])  # fmt: skip
_UNITS = {
    "rad/s": 1.0, "deg/s": np.pi / 180, "m/s/s": 1.0, "m/s": 1.0, "m": 1.0, "Pa": 1.0, "Gauss": 1e-4,
    "deg": 1.0, "degheading": 1.0, "deglatitude": 1.0, "deglongitude": 1.0,
}  # fmt: skip
"""SI value of the labels of UNIT, angles in deg."""

_LONGEST_US = 10**9 * 10**3  # eleven days: no board runs for longer in one log

_NUMBERED = {"IMU": "IMU", "MAG": "MAG", "GPS": "GPS", "BAR": "BARO", "ASP": "ARSP"}  # IMU2, BAR2: before instances
_CORE_1 = {"NKF6": "NKF1", "XKF6": "XKF1"}

ATTITUDES = {"ahrs": "ATT", "ekf3": "XKF1", "ekf2": "NKF1", "dcm": "AHR2"}
"""Message by name of the attitude estimator that wrote it."""


class Messages:
    """The messages of a DataFlash log by name, as they are.

    Raises:
        InputError: not there, or no DataFlash log.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._data = np.fromfile(path, np.uint8)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
        lengths = np.zeros(256, np.int64)
        lengths[scan.FMT] = scan.FMT_LENGTH
        self.count, room = self._data.size // 16 + 1, 0
        while self.count > room:  # messages are rarely so short that the first guess is too small
            room = self.count
            offsets, kinds = np.empty(room, np.int64), np.empty(room, np.uint8)
            self.count, self.lost = scan.dataflash(self._data, lengths, offsets, kinds)
        offsets, kinds = offsets[: self.count], kinds[: self.count]
        order = np.argsort(kinds, kind="stable")
        self._offsets, bounds = offsets[order], np.searchsorted(kinds[order], np.arange(257))
        self._rows = {k: slice(int(bounds[k]), int(bounds[k + 1])) for k in range(256) if bounds[k] < bounds[k + 1]}
        self._formats = {name: (kind, dtype, form) for name, kind, dtype, form in self._described(lengths)}
        if not self._formats:
            raise InputError(f"{path}: no DataFlash log: no FMT message in it")
        self.factors = self._factors()

    def _gathered(self, kind: int, dtype: np.dtype[Any]) -> np.ndarray:
        offsets = self._offsets[self._rows.get(kind, slice(0))]
        out = np.zeros((len(offsets), dtype.itemsize), np.uint8)
        scan.gather(self._data, offsets, out)
        return out.view(dtype)[:, 0] if len(out) else np.empty(0, dtype)

    def _described(self, lengths: np.ndarray) -> Iterator[tuple[str, int, np.dtype[Any], str]]:
        for row in self._gathered(scan.FMT, _FMT):
            name, form, columns = (_text(row[k]) for k in ("name", "format", "columns"))
            names = columns.split(",")
            kind = int(row["type"])
            if not name.isalnum() or len(names) != len(form) or len(set(names)) != len(names) or "" in names:
                continue
            if any(c not in _TYPES for c in form):
                continue
            dtype = np.dtype([("head", "u1", 3), *((n, _TYPES[c]) for n, c in zip(names, form, strict=True))])
            if dtype.itemsize == lengths[kind] == row["length"]:
                yield name, kind, dtype, form

    def _factors(self) -> dict[str, dict[str, float]]:
        """SI value of a stored 1 by message and column, where FMTU says it; instance columns are 0."""
        units = {int(r["Id"]): _text(r["Label"]) for r in self._with("UNIT", "Id", "Label")}
        multipliers = {int(r["Id"]): float(r["Mult"]) for r in self._with("MULT", "Id", "Mult")}
        kinds = {kind: name for name, (kind, _, _) in self._formats.items()}
        found: dict[str, dict[str, float]] = {}
        for row in self._with("FMTU", "FmtType", "UnitIds", "MultIds"):
            name = kinds.get(int(row["FmtType"]), "")
            if not name:
                continue
            _, dtype, form = self._formats[name]
            described = zip((dtype.names or ())[1:], form, row["UnitIds"], row["MultIds"], strict=False)
            factors = found.setdefault(name, {})
            for column, letter, unit, multiplier in described:
                scale = _SCALES.get(letter) or multipliers.get(multiplier, 0.0)
                if unit == ord("#"):
                    factors[column] = 0.0
                elif scale > 0.0 and units.get(unit) in _UNITS:
                    factors[column] = scale * _UNITS[units[unit]]
        return found

    def keep_longest_start(self) -> tuple[int, int]:
        """Keep what was written after one start of the board, the longest; return how many there are, messages lost.

        Each start begins anew at 0, so what two sensors wrote after different ones must not meet.
        """
        timed = {n: k for n, (k, dtype, _) in self._formats.items() if (dtype.names or ())[1:2] == ("TimeUS",)}
        name = max(timed, key=lambda n: len(self._offsets[self._rows.get(timed[n], slice(0))]), default="")
        if not name or timed[name] not in self._rows:
            return 1, 0
        clock = self._gathered(timed[name], np.dtype([("head", "u1", 3), ("TimeUS", "<u8")]))["TimeUS"]
        good = np.flatnonzero(clock < _LONGEST_US)
        ns = clock[good].astype(np.int64) * 1000
        near = near_in_time(ns)
        offsets = self._offsets[self._rows[timed[name]]][good[near]]
        part, steps = longest_part(ns[near])
        if not steps:
            return 1, 0
        first, last = offsets[part.start], offsets[part.stop - 1]
        lost = 0
        for kind, rows in self._rows.items():
            low, high = np.searchsorted(self._offsets[rows], [first, last + 1]).tolist()
            lost += rows.stop - rows.start - (high - low)
            self._rows[kind] = slice(rows.start + low, rows.start + high)
        return steps + 1, lost

    def _with(self, name: str, *columns: str) -> np.ndarray:
        """Read as `raw`; empty when a column is missing."""
        rows = self.raw(name)
        return rows if set(columns) <= set(rows.dtype.names or ()) else rows[:0]

    @property
    def names(self) -> list[str]:
        """Messages of which there are any."""
        return [name for name, (kind, _, _) in self._formats.items() if kind in self._rows]

    def raw(self, name: str) -> np.ndarray:
        """Read the messages (n,) of a name as they are stored; empty without any."""
        if name not in self._formats:
            return np.empty(0, np.uint8)
        kind, dtype, _ = self._formats[name]
        return self._gathered(kind, dtype)

    def column(self, name: str, column: str, rows: np.ndarray, default: float = 1.0) -> np.ndarray:
        """Read a column of `rows` in SI (angles in deg); `default` is the value of a 1 where the log has no units."""
        letter = self._formats[name][2][(rows.dtype.names or ()).index(column) - 1]
        factor = self.factors.get(name, {}).get(column) or default * _SCALES.get(letter, 1.0)
        values: np.ndarray = rows[column].astype(float)
        return values if factor == 1.0 else factor * values

    def instances(self, name: str) -> Iterator[tuple[int, str, np.ndarray]]:
        """Instance, message name and rows of each unit that writes a message, in rising order."""
        for written in (name, *(k for k, v in _CORE_1.items() if v == name)):
            rows = self.raw(written)
            column = next((c for c, f in self.factors.get(written, {}).items() if f == 0.0), "")
            column = column or next((c for c in ("I", "C") if c in (rows.dtype.names or ())), "")
            if column and np.issubdtype(rows.dtype[column], np.integer) and written == name:
                for i in np.unique(rows[column])[:8].tolist():
                    yield int(i), written, rows[rows[column] == i]
            elif len(rows):
                yield int(written != name), written, rows
        for other in self.names:
            short, number = other[:-1], other[-1:]
            if _NUMBERED.get(short) == name and number in "23":
                yield int(number) - 1, other, self.raw(other)


def _text(value: bytes) -> str:
    return value.split(b"\0")[0].decode("ascii", errors="replace")


class DataFlash(BinaryLog):
    """An ArduPilot log as topics named like its messages, `IMU`, `IMU[1]`, `GPS/fix`, `GPS/velocity`."""

    form = "ArduPilot DataFlash"

    def __init__(self, path: Path) -> None:
        self._log = Messages(path)
        starts, lost = self._log.keep_longest_start()
        self._offset = self._utc_offset()
        topics, refused = gathered(
            self._imu, self._raw_imu, self._mag, self._gps, self._pressure, self._air, self._attitudes
        )
        if not topics:
            raise InputError(
                f"{path}: DataFlash without IMU, ATT or GPS messages (it has {', '.join(self._log.names)})"
            )
        super().__init__(path, topics, ATTITUDES)
        if {"IMU", "GYR", "ACC"} <= topics.keys() and len(topics["GYR"].ns) > 2 * len(topics["IMU"].ns):
            ratio = len(topics["GYR"].ns) / max(len(topics["IMU"].ns), 1)
            self.notes.append(
                f'GYR and ACC have {ratio:.0f} times the rate of IMU: [topics] imu = "GYR", accel = "ACC"'
            )
        if starts > 1:
            self.notes.append(
                f"the board's clock begins anew: of the {starts} parts the longest is used, {lost} messages of the "
                "others left out"
            )
        self._damage(refused, self._log.lost)

    def _utc_offset(self) -> int:
        """Compute the offset from the board's clock to UTC by its GNSS, ns; 0 without."""
        for _, _, rows in self._log.instances("GPS"):
            names = rows.dtype.names or ()
            week, ms = ("GWk", "GMS") if "GWk" in names else ("Week", "TimeMS")
            if {week, ms, "Status"} <= set(names) and {"TimeUS", "T"} & set(names):
                good = rows[(rows["Status"] >= 3) & (rows[week] > 1000)]
                if len(good):
                    utc = from_gps(good[week], good[ms].astype(float) / 1e3)
                    return int(np.median(utc - _board_ns(good)))
        return 0

    def _columns(self, type_name: str, rows: np.ndarray, fields: Mapping[str, np.ndarray], **more: Any) -> Columns:
        return self._in_time(Columns(type_name, _board_ns(rows) + self._offset, dict(fields), **more))

    def _units(self, name: str, needed: tuple[str, ...]) -> Iterator[tuple[str, str, int, np.ndarray]]:
        """Topic, message name, rank and rows of each unit of which all fields are there."""
        for k, written, rows in self._log.instances(name):
            columns = set(rows.dtype.names or ())
            if set(needed) <= columns and {"TimeUS", "TimeMS"} & columns:
                topic = written if k and written != name else numbered(name, k)
                yield topic, written, k, rows

    def _vector(self, written: str, rows: np.ndarray, columns: tuple[str, ...], default: float = 1.0) -> np.ndarray:
        return np.column_stack([self._log.column(written, c, rows, default) for c in columns])

    def _imu(self) -> Iterator[tuple[str, Columns]]:
        gyro, accel = ("GyrX", "GyrY", "GyrZ"), ("AccX", "AccY", "AccZ")
        for topic, written, rank, rows in self._units("IMU", gyro + accel):
            fields = {"angular_velocity": self._vector(written, rows, gyro),
                      "linear_acceleration": self._vector(written, rows, accel)}  # fmt: skip
            dead = not rows[gyro[0]].any() and not rows[accel[2]].any()
            yield topic, self._columns(IMU, rows, fields, rank=rank + 10 * dead)

    def _raw_imu(self) -> Iterator[tuple[str, Columns]]:
        """Read samples at the sensors' own rate (LOG_BITMASK raw IMU), gyro and accelerometer apart."""
        absent = np.r_[-1.0, np.zeros(8)]
        for name, letter, field, other in (
            ("GYR", "Gyr", "angular_velocity", "linear_acceleration"),
            ("ACC", "Acc", "linear_acceleration", "angular_velocity"),
        ):
            columns = tuple(f"{letter}{axis}" for axis in "XYZ")
            for topic, written, rank, rows in self._units(name, columns):
                sampled = rows.copy()
                if "SampleUS" in (rows.dtype.names or ()):
                    sampled["TimeUS"] = rows["SampleUS"]
                none = np.tile(absent, (len(rows), 1))
                fields = {field: self._vector(written, rows, columns), f"{other}_covariance": none}
                yield topic, self._columns(IMU, sampled, fields, rank=rank + 20)

    def _mag(self) -> Iterator[tuple[str, Columns]]:
        columns = ("MagX", "MagY", "MagZ")
        for topic, written, rank, rows in self._units("MAG", columns):
            field = self._vector(written, rows, columns, 1e-7)
            healthy = rows["Health"] > 0 if "Health" in (rows.dtype.names or ()) else np.ones(len(rows), bool)
            healthy &= field.any(axis=1)
            used = np.flatnonzero(healthy)
            fields = {"magnetic_field": field[used]}
            yield topic, self._columns(MAG, rows[used], fields, rank=rank + 10 * (2 * len(used) < len(rows)))

    def _gps(self) -> Iterator[tuple[str, Columns]]:
        for topic, written, rank, rows in self._units("GPS", ("Status", "Lat", "Lng", "Alt")):
            names = rows.dtype.names or ()
            fixed = rows["Status"] >= 3
            rank += 10 * (2 * int(fixed.sum()) < len(rows))
            fields: dict[str, np.ndarray] = {"status__status": np.where(fixed, 0, -1)}
            for field, column, default in (
                ("latitude", "Lat", 1.0),
                ("longitude", "Lng", 1.0),
                ("altitude", "Alt", 1.0),
            ):
                fields[field] = self._log.column(written, column, rows, default)
            yield f"{topic}/fix", self._columns(FIX, rows, fields, rank=rank)
            if {"Spd", "GCrs", "VZ"} <= set(names):
                good = rows[fixed]
                speed, course, down = (self._log.column(written, c, good) for c in ("Spd", "GCrs", "VZ"))
                course = np.radians(course)
                velocity = np.column_stack([speed * np.cos(course), speed * np.sin(course), down])
                yield f"{topic}/velocity", self._columns(VELOCITY, good, {"twist__linear": velocity}, frame_id=NED,
                                                         rank=rank)  # fmt: skip
            if "Yaw" in names and (rows["Yaw"][fixed] != 0).any():
                good = rows[fixed & (rows["Yaw"] != 0)]  # 0: the receiver has none
                heading = np.radians(self._log.column(written, "Yaw", good))
                yield f"{topic}/heading", self._columns(HEADING, good, {"heading": heading}, frame_id=NED, rank=rank)

    def _pressure(self) -> Iterator[tuple[str, Columns]]:
        for topic, written, rank, rows in self._units("BARO", ("Press",)):
            fields = {"fluid_pressure": self._log.column(written, "Press", rows)}
            yield topic, self._columns(PRESSURE, rows, fields, rank=rank)

    def _air(self) -> Iterator[tuple[str, Columns]]:
        static = next(iter(self._pressure()), None)
        for topic, written, rank, rows in self._units("ARSP", ("Airspeed",)):
            indicated = self._log.column(written, "Airspeed", rows)
            healthy = rows["H"] > 0 if "H" in (rows.dtype.names or ()) else np.ones(len(rows), bool)
            made = self._columns(AIR, rows[healthy], {"indicated_airspeed": indicated[healthy]}, rank=rank)
            pressure = np.full(len(made.ns), 101325.0)
            if static:
                pressure = np.interp(made.ns, static[1].ns, static[1].fields["fluid_pressure"])
            made.fields = {**made.fields, "airspeed": made.fields["indicated_airspeed"] * _density_factor(pressure)}
            yield topic, made

    def _attitudes(self) -> Iterator[tuple[str, Columns]]:
        """Read the simulator's truth, the attitude flown by, and those of the filters."""
        for place, name in enumerate(("SIM", "ATT", "XKF1", "NKF1", "AHR2")):
            for topic, written, k, rows in self._units(name, ("Roll", "Pitch", "Yaw")):
                quaternion = ("Q1", "Q2", "Q3", "Q4")
                if set(quaternion) <= set(rows.dtype.names or ()) and rows["Q1"].any():
                    q = self._vector(written, rows, quaternion)
                else:
                    q = attitude.from_euler(np.radians(self._vector(written, rows, ("Roll", "Pitch", "Yaw"))))
                yield topic, self._columns(ATTITUDE, rows, {"quaternion": q}, rank=10 * place + k)


def _board_ns(rows: np.ndarray) -> np.ndarray:
    """Read the board's clock (n,) ns of messages; in logs of milliseconds GPS has it as `T` beside the receiver's."""
    names = rows.dtype.names or ()
    if "TimeUS" in names:
        column, factor = "TimeUS", 1000
    else:
        column, factor = "T" if {"T", "Week"} <= set(names) else "TimeMS", 10**6
    ns: np.ndarray = rows[column].astype(np.int64) * factor
    return ns


def _density_factor(pressure: np.ndarray) -> np.ndarray:
    """True over equivalent airspeed (n,) at a static pressure (n,) Pa of the standard atmosphere below 11 km."""
    ratio = np.clip(pressure / 101325.0, 0.2, 1.2)
    factor: np.ndarray = np.sqrt(ratio ** (1.0 / 5.255876) / ratio)
    return factor
