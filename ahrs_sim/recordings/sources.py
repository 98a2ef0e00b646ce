"""Any recording as topics of ROS messages: structured arrays as `LogReader` gives them, block by block.

MCAP is read by our own reader, db3 by rosbags, ULog by pyulog, CSV by pandas; the last two are laid out as the standard
messages, so that whatever follows knows one form only.
"""

import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.cdr import CdrError, decode, message_dtype, parse_definitions
from ahrs_sim.log.mcap.reader import LogReader
from ahrs_sim.scenario.table import Table

FRD, NED = "base_link_frd", "map_ned"
_BATCH = 20000  # messages of a db3 decoded together

UNITS = {
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9,
    "rad": 1.0, "deg": np.pi / 180, "rad/s": 1.0, "deg/s": np.pi / 180,
    "m/s2": 1.0, "m/s^2": 1.0, "g": 9.80665, "mg": 9.80665e-3,
    "T": 1.0, "uT": 1e-6, "nT": 1e-9, "G": 1e-4, "mG": 1e-7,
    "m": 1.0, "ft": 0.3048, "m/s": 1.0, "km/h": 1 / 3.6, "kt": 1852 / 3600,
    "Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "kPa": 1000.0,
}  # fmt: skip
"""SI value of the units that a map may name."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a recording."""

    name: str
    type_name: str  # package/msg/Type
    count: int


class Source(Protocol):
    """What is asked of a recording."""

    path: Path
    epoch_ns: int  # log time of the first message, ns since 1970
    duration: float  # s

    def topics(self) -> list[Topic]:
        """All topics that can be read."""
        ...

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Messages by topic, portion by portion, in the order of log time."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


def open_source(path: Path, mapping: Table) -> Source:
    """The recording at `path`, by its suffix.

    Args:
        path: .mcap, .db3 or a folder with one, .csv, .ulg.
        mapping: the user's map; a CSV needs its `[csv]`.

    Raises:
        InputError: not there, cannot be read, or of no kind known here.
    """
    if path.suffix == ".csv":
        return Csv(path, mapping.table("csv"))
    if path.suffix in (".ulg", ".ulog"):
        return Ulog(path)
    if path.suffix == ".db3" or path.is_dir():
        return Db3(path)
    return Mcap(path)


class Mcap:
    """A ROS 2 bag in MCAP."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.reader = LogReader(path)
        first, last = self.reader.time_range_ns
        self.epoch_ns, self.duration = first, (last - first) / 1e9
        refused = ""
        if self.reader.message_count == 0:
            refused = "no messages in it; nothing to replay"
        elif self.reader.profile not in ("ros2", ""):
            refused = f"profile {self.reader.profile!r}; only ROS 2 bags ('ros2') can be replayed"
        if refused:
            self.close()
            raise InputError(f"{path}: {refused}")

    def topics(self) -> list[Topic]:
        """All topics of messages in CDR."""
        found = self.reader.topics.values()
        return [Topic(t.topic, t.type_name, t.count) for t in found if t.encoding == "cdr" and t.count]

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """As `LogReader.blocks`."""
        return self.reader.blocks(list(topics))

    def close(self) -> None:
        """Close the file."""
        self.reader.close()


class Db3:
    """A ROS 2 bag in SQLite."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.exists():
            raise InputError(f"{path}: cannot be read: no such file")
        module = _extra("rosbags.rosbag2", "rosbags", "bags")
        self._error: Any = (module.ReaderError, OSError, ValueError, KeyError)
        try:
            self._reader = module.Reader(path)
            self._reader.open()
        except Exception as error:  # sqlite3 and rosbags raise many kinds for a file that is none
            raise InputError(f"{path}: no ROS 2 bag: {_line(error)}") from None
        try:
            self._connections = {c.topic: c for c in self._reader.connections}
            self.epoch_ns, self.duration = self._reader.start_time, self._reader.duration / 1e9
            empty = self._reader.message_count == 0
        except Exception as error:
            self.close()
            raise InputError(f"{path}: no ROS 2 bag: {_line(error)}") from None
        if empty:
            self.close()
            raise InputError(f"{path}: no messages in it; nothing to replay")

    def topics(self) -> list[Topic]:
        """All topics."""
        return [Topic(c.topic, c.msgtype, c.msgcount) for c in self._connections.values() if c.msgcount]

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Batches of messages."""
        chosen = [self._connections[t] for t in topics]
        kinds = {c.topic: self._definitions(c) for c in chosen}
        waiting: dict[str, list[tuple[int, bytes]]] = {t: [] for t in topics}
        try:
            for i, (connection, time, data) in enumerate(self._reader.messages(chosen), 1):
                waiting[connection.topic].append((time, data))
                if i % _BATCH == 0:
                    yield {t: _decoded(*kinds[t], rows) for t, rows in waiting.items()}
                    waiting = {t: [] for t in topics}
            yield {t: _decoded(*kinds[t], rows) for t, rows in waiting.items()}
        except (CdrError, *self._error) as error:
            raise InputError(f"{self.path}: damaged: {_line(error)}") from None

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def _definitions(self, connection: Any) -> tuple[Any, str]:
        name, text = connection.msgtype, connection.msgdef.data
        try:
            if not text or connection.msgdef.format.name != "MSG":
                return messages.definitions(name), name
            return parse_definitions(name, text), name
        except (KeyError, CdrError) as error:
            raise InputError(f"{self.path}: topic {connection.topic}: type {name} is not known: {error}") from None


def _decoded(definitions: Any, name: str, rows: list[tuple[int, bytes]]) -> np.ndarray:
    inner = message_dtype(definitions, name)
    out = np.empty(len(rows), [("log_time", "<i8"), *((f, inner[f]) for f in inner.names or ())])
    if not rows:
        return out
    out["log_time"] = [time for time, _ in rows]
    sizes = np.array([len(data) for _, data in rows])
    for size in np.unique(sizes):
        which = np.flatnonzero(sizes == size)
        payload = np.frombuffer(b"".join(rows[i][1] for i in which), np.uint8).reshape(len(which), size)
        part = np.empty(len(which), out.dtype)
        part["log_time"] = out["log_time"][which]
        decode(definitions, name, payload, part)
        out[which] = part
    return out


def laid_out(type_name: str, stamp_ns: np.ndarray, frame_id: str, **fields: Any) -> np.ndarray:
    """Messages (n,) of a type as `LogReader` would give them; fields by name, vectors (n, 3), quaternions (n, 4)."""
    inner = message_dtype(messages.definitions(type_name), type_name)
    out = np.zeros(len(stamp_ns), [("log_time", "<i8"), *((f, inner[f]) for f in inner.names or ())])
    out["log_time"] = stamp_ns
    out["header"]["stamp"]["sec"], out["header"]["stamp"]["nanosec"] = stamp_ns // 10**9, stamp_ns % 10**9
    out["header"]["frame_id"] = frame_id
    for path, value in fields.items():
        column = out
        for name in path.split("__"):
            column = column[name]
        if column.dtype.names:
            for axis, part in zip("wxyz" if value.shape[1] == 4 else "xyz", value.T, strict=True):
                column[axis] = part
        else:
            column[...] = value
    return out


class _Held:
    """A recording that fits into memory: messages by topic."""

    def __init__(self, path: Path, arrays: Mapping[str, tuple[str, np.ndarray]]) -> None:
        self.path = path
        self._arrays = {name: (kind, array) for name, (kind, array) in arrays.items() if len(array)}
        if not self._arrays:
            raise InputError(f"{path}: nothing in it that could be replayed")
        times = [array["log_time"] for _, array in self._arrays.values()]
        self.epoch_ns = int(min(t[0] for t in times))
        self.duration = (int(max(t.max() for t in times)) - self.epoch_ns) / 1e9

    def topics(self) -> list[Topic]:
        """All of it."""
        return [Topic(name, kind, len(array)) for name, (kind, array) in self._arrays.items()]

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """In portions of ten seconds."""
        step = 10 * 10**9
        arrays = {t: self._arrays[t][1] for t in topics}
        keys = {t: (a["log_time"] - self.epoch_ns) // step for t, a in arrays.items()}
        for k in sorted(set().union(*(np.unique(v).tolist() for v in keys.values()))):
            yield {t: a[keys[t] == k] for t, a in arrays.items()}

    def close(self) -> None:
        """Nothing is open."""


# ----------------------------------------------------------------------------------------------- CSV

_CSV_KINDS: dict[str, tuple[str, dict[str, tuple[str, int]]]] = {  # type, and its fields from keys of the map
    "imu": ("sensor_msgs/msg/Imu", {"gyro": ("angular_velocity", 3), "accel": ("linear_acceleration", 3)}),
    "mag": ("sensor_msgs/msg/MagneticField", {"field": ("magnetic_field", 3)}),
    "fix": (
        "sensor_msgs/msg/NavSatFix",
        {"latitude": ("latitude", 1), "longitude": ("longitude", 1), "altitude": ("altitude", 1)},
    ),
    "velocity": ("geometry_msgs/msg/TwistStamped", {"velocity": ("twist__linear", 3)}),
    "heading": ("ahrs_sim_msgs/msg/Heading", {"heading": ("heading", 1)}),
    "diff_pressure": ("sensor_msgs/msg/FluidPressure", {"pressure": ("fluid_pressure", 1)}),
    "static_pressure": ("sensor_msgs/msg/FluidPressure", {"pressure": ("fluid_pressure", 1)}),
    "air": ("ahrs_sim_msgs/msg/AirData", {"airspeed": ("airspeed", 1)}),
    "reference": ("sensor_msgs/msg/Imu", {"euler": ("orientation", 3), "quaternion": ("orientation", 4)}),
}
_CHANGES_ONLY = ("fix", "velocity", "heading")
_DEGREES = ("latitude", "longitude")


class Csv(_Held):
    """Columns by name; `[csv.KIND]` of the map says which and in what units."""

    def __init__(self, path: Path, table: Table) -> None:
        if not path.is_file():
            raise InputError(f"{path}: cannot be read: no such file")
        if not table.data:
            raise InputError(f"{path}: a CSV needs a --map with [csv] saying what its columns are; see docs/replay.md")
        import pandas

        clock = table.table("time")
        separator = table.text("separator", ",")
        try:
            frame = pandas.read_csv(path, sep=separator, skipinitialspace=True)
        except (OSError, ValueError, pandas.errors.ParserError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: no CSV: {_line(error)}") from None
        self._frame = frame
        ns = np.rint(self._column(clock, "column") * (UNITS[clock.choice("unit", ["s", "ms", "us", "ns"], "s")] * 1e9))
        clock.close()
        arrays = {}
        for kind, (type_name, fields) in _CSV_KINDS.items():
            if table.has(kind):
                arrays[kind] = (type_name, self._messages(table.table(kind), kind, type_name, fields, ns))
        table.close()
        super().__init__(path, arrays)

    def _messages(
        self, table: Table, kind: str, type_name: str, fields: Mapping[str, tuple[str, int]], ns: np.ndarray
    ) -> np.ndarray:
        frame_id = NED if kind in ("velocity", "heading") else FRD
        columns: dict[str, np.ndarray] = {}
        for key, (place, size) in fields.items():
            if not table.has(key):
                continue
            entry = table.table(key)
            names = entry.value("columns")
            if not isinstance(names, list) or len(names) != size:
                raise entry.error("columns", f"{names!r} is not a list of {size} column names")
            scale = 1.0 if key in _DEGREES else UNITS[entry.choice("unit", list(UNITS), *_default_unit(key))]
            entry.close()
            value = scale * np.column_stack([self._named(entry, name) for name in names])
            if key == "euler":
                from ahrs_sim.recordings.frames import from_euler

                value = from_euler(value)
            columns[place] = value
        table.close()
        if not columns:
            raise table.error(next(iter(fields)), "missing; name its columns")
        values = np.column_stack(list(columns.values()))
        good = np.isfinite(values).all(axis=1) & np.isfinite(ns)
        if kind in _CHANGES_ONLY:  # a table repeats what a slow sensor has said
            good &= np.r_[True, (np.diff(values, axis=0) != 0).any(axis=1)]
        chosen = {k: (v[good] if v.shape[1] > 1 else v[good, 0]) for k, v in columns.items()}
        return laid_out(type_name, ns[good].astype(np.int64), frame_id, **chosen)

    def _column(self, table: Table, key: str) -> np.ndarray:
        return self._named(table, table.text(key))

    def _named(self, table: Table, name: Any) -> np.ndarray:
        import pandas

        if name not in self._frame:
            known = [str(c) for c in self._frame.columns]
            raise table.error("columns", f"no column '{name}' in the file{nearest(str(name), known)}")
        numbers: np.ndarray = pandas.to_numeric(self._frame[name], errors="coerce").to_numpy(float)
        return numbers


def _default_unit(key: str) -> tuple[str, ...]:
    return ("m",) if key in ("altitude", "quaternion", *_DEGREES) else ()


# ----------------------------------------------------------------------------------------------- ULog


class Ulog(_Held):
    """A PX4 log: FRD and NED by definition."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise InputError(f"{path}: cannot be read: no such file")
        module = _extra("pyulog", "pyulog", "ulog")
        try:
            with path.open("rb") as stream:
                log = module.ULog(stream)
        except Exception as error:  # it raises whatever parsing a foreign file meets
            raise InputError(f"{path}: no ULog: {_line(error)}") from None
        self._data: dict[str, Mapping[str, np.ndarray]] = {}
        for item in log.data_list:
            self._data.setdefault(item.name, item.data)  # the first instance
        self._offset = self._utc_offset()
        super().__init__(path, {name: entry for name, entry in self._arrays_by_topic() if entry is not None})

    def _utc_offset(self) -> int:
        """From the board's clock to UTC by its GNSS, ns."""
        for name in ("vehicle_gps_position", "sensor_gps"):
            data = self._data.get(name, {})
            if "time_utc_usec" in data:
                valid = data["time_utc_usec"] > 0
                if valid.any():
                    shift = data["time_utc_usec"][valid].astype(np.int64) - data["timestamp"][valid].astype(np.int64)
                    return int(np.median(shift)) * 1000
        return 0

    def _ns(self, data: Mapping[str, np.ndarray]) -> np.ndarray:
        sampled = data.get("timestamp_sample")
        clock = data["timestamp"] if sampled is None or not sampled.any() else sampled
        return clock.astype(np.int64) * 1000 + self._offset

    def _arrays_by_topic(self) -> Iterator[tuple[str, tuple[str, np.ndarray] | None]]:
        def make(topic: str, type_name: str, frame_id: str = FRD, **fields: Any) -> Any:
            data = self._data.get(topic)
            try:
                values = {k: v(data) for k, v in fields.items()} if data is not None else None
            except KeyError:
                values = None  # a version of the message that has other fields
            if data is None or values is None:
                return topic, None
            return topic, (type_name, laid_out(type_name, self._ns(data), frame_id, **values))

        def vector(name: str, scale: float = 1.0) -> Any:
            return lambda d: scale * np.column_stack([d[f"{name}[{i}]"] for i in range(3)])

        imu = "sensor_msgs/msg/Imu"
        yield make("sensor_combined", imu, angular_velocity=vector("gyro_rad"),
                   linear_acceleration=vector("accelerometer_m_s2"))  # fmt: skip
        yield make("vehicle_magnetometer", "sensor_msgs/msg/MagneticField",
                   magnetic_field=vector("magnetometer_ga", 1e-4))  # fmt: skip
        gnss = "sensor_gps" if "sensor_gps" in self._data else "vehicle_gps_position"
        name, entry = make(gnss, "sensor_msgs/msg/NavSatFix", **_fix_fields(self._data.get(gnss, {})))
        yield f"{name}/fix", entry
        name, entry = make(gnss, "geometry_msgs/msg/TwistStamped", NED, twist__linear=lambda d: np.column_stack(
            [d["vel_n_m_s"], d["vel_e_m_s"], d["vel_d_m_s"]]))  # fmt: skip
        yield f"{name}/velocity", entry
        if np.isfinite(self._data.get(gnss, {}).get("heading", np.array([np.nan]))).any():
            name, entry = make(gnss, "ahrs_sim_msgs/msg/Heading", NED, heading=lambda d: d["heading"])
            yield f"{name}/heading", entry
        speed = "true_airspeed_m_s"
        yield make("airspeed", "ahrs_sim_msgs/msg/AirData", airspeed=lambda d: d[speed],
                   indicated_airspeed=lambda d: d["indicated_airspeed_m_s"])  # fmt: skip
        yield make("vehicle_attitude", imu, orientation=lambda d: np.column_stack([d[f"q[{i}]"] for i in range(4)]))


def _fix_fields(data: Mapping[str, np.ndarray]) -> dict[str, Any]:
    new = "latitude_deg" in data
    fields: dict[str, Any] = {
        "status__status": lambda d: np.where(d["fix_type"] >= 3, 0, -1),
        "latitude": (lambda d: d["latitude_deg"]) if new else (lambda d: d["lat"] * 1e-7),
        "longitude": (lambda d: d["longitude_deg"]) if new else (lambda d: d["lon"] * 1e-7),
        "altitude": (lambda d: d["altitude_ellipsoid_m"]) if new else (lambda d: d["alt_ellipsoid"] * 1e-3),
    }
    return fields


def _extra(module: str, package: str, extra: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"{package} is needed to read this file: pip install 'ahrs-sim[{extra}]'") from None


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
