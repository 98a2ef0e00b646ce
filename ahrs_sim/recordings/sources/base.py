"""What all sources share: the interface, the layout of standard messages, recordings that are held in memory."""

import functools
import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.cdr import Definitions, message_dtype
from ahrs_sim.log.messages import LONGEST_S
from ahrs_sim.world import gravity

FRD, NED = "base_link_frd", "map_ned"

IMU = "sensor_msgs/msg/Imu"
MAG = "sensor_msgs/msg/MagneticField"
FIX = "sensor_msgs/msg/NavSatFix"
VELOCITY = "geometry_msgs/msg/TwistStamped"
PRESSURE = "sensor_msgs/msg/FluidPressure"
AIR = "ahrs_sim_msgs/msg/AirData"
HEADING = "ahrs_sim_msgs/msg/Heading"
ATTITUDE = "geometry_msgs/msg/QuaternionStamped"

UNITS = {
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0,
    "rad": 1.0, "deg": np.pi / 180, "rad/s": 1.0, "deg/s": np.pi / 180, "dps": np.pi / 180,
    "m/s2": 1.0, "m/s^2": 1.0, "g": gravity.STANDARD, "mg": gravity.STANDARD * 1e-3,
    "T": 1.0, "uT": 1e-6, "nT": 1e-9, "G": 1e-4, "mG": 1e-7,
    "m": 1.0, "ft": 0.3048, "m/s": 1.0, "km/h": 1 / 3.6, "kt": 1852 / 3600,
    "Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "kPa": 1000.0,
}  # fmt: skip
"""SI value of the units that a map may name."""

DATES_FROM_NS = 631_152_000 * 10**9
"""1990-01-01: a time before is none of a calendar, but that of a clock which started near 0."""

LATEST_S = 2**31 - 1
"""The last second that a ROS time can be."""

_STEP_NS = 10**9
"""A stamp this much before the one before it is a step of the clock, not a late message."""

_PORTION_NS = 10 * 10**9


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a recording."""

    name: str
    type_name: str  # package/msg/Type
    count: int
    rank: int = 0  # what the recording itself prefers among topics of one type, 0 the best


class Source(Protocol):
    """Describes what every kind of recording provides."""

    path: Path
    epoch_ns: int  # log time of the first message, ns since 1970, or since the clock's own zero
    duration: float  # s
    form: str  # what it is, for the user
    notes: list[str]  # what was left out, and why
    recorded: Mapping[str, str]  # topic by name, of the attitudes that the vehicle itself estimated
    one_clock: bool  # the times of headers are those of the log

    def topics(self) -> list[Topic]:
        """List all topics that can be read."""
        ...

    def dtype(self, topic: str) -> np.dtype[Any]:
        """Type of the messages of a topic, `log_time` (ns) first."""
        ...

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Yield messages by topic, portion by portion, in the order of log time."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


@dataclass
class Columns:
    """A topic in memory: vectors (n, 3) and quaternions (n, 4) by the field they are for, `twist__linear`."""

    type_name: str
    ns: np.ndarray  # (n,) int64
    fields: Mapping[str, np.ndarray]
    frame_id: str = FRD
    rank: int = 0

    def picked(self, rows: np.ndarray) -> "Columns":
        """Some of the rows."""
        fields = {k: v[rows] for k, v in self.fields.items()}
        return Columns(self.type_name, self.ns[rows], fields, self.frame_id, self.rank)


def laid_out(columns: Columns) -> np.ndarray:
    """Make messages (n,) of a type as `LogReader` would give them."""
    out = np.zeros(len(columns.ns), dtype_of(columns.type_name))
    ns = out["log_time"] = columns.ns
    out["header"]["stamp"]["sec"], out["header"]["stamp"]["nanosec"] = ns // 10**9, ns % 10**9
    out["header"]["frame_id"] = columns.frame_id
    for path, value in columns.fields.items():
        column = out
        for name in path.split("__"):
            column = column[name]
        if column.dtype.names:
            for axis, part in zip("wxyz" if value.shape[1] == 4 else "xyz", value.T, strict=True):
                column[axis] = part
        else:
            column[...] = value
    return out


@functools.cache
def _own_dtype(type_name: str) -> np.dtype[Any]:
    return _dtype(type_name, messages.definitions(type_name))


def _dtype(type_name: str, definitions: Definitions) -> np.dtype[Any]:
    inner = message_dtype(definitions, type_name)
    return np.dtype([("log_time", "<i8"), *((f, inner[f]) for f in inner.names or ())])


def dtype_of(type_name: str, definitions: Definitions | None = None) -> np.dtype[Any]:
    """Type of arrays of messages: `log_time` (ns), then their fields; our own definitions unless others are given."""
    return _dtype(type_name, definitions) if definitions else _own_dtype(type_name)


class Held:
    """A recording that fits into memory: columns by topic, laid out as messages portion by portion."""

    form = ""
    one_clock = True

    def __init__(self, path: Path, topics: Mapping[str, Columns], recorded: Mapping[str, str] | None = None) -> None:
        self.path = path
        self.notes: list[str] = []
        self.recorded: Mapping[str, str] = {
            n: t for n, t in (recorded or {}).items() if t in topics and len(topics[t].ns)
        }
        self._topics = {name: columns for name, columns in topics.items() if len(columns.ns)}
        if not self._topics:
            raise InputError(f"{path}: nothing in it that could be replayed")
        self.epoch_ns = min(int(c.ns.min()) for c in self._topics.values())
        if -LONGEST_S < self.epoch_ns / 1e9 < 0:  # counted from a trigger
            self.notes.append(f"{path.name}: its times start at {self.epoch_ns / 1e9:g} s: counted from there")
            for columns in self._topics.values():
                columns.ns = columns.ns - self.epoch_ns
            self.epoch_ns = 0
        self.duration = (max(int(c.ns.max()) for c in self._topics.values()) - self.epoch_ns) / 1e9
        if self.epoch_ns < 0 or self.duration > LONGEST_S or self.epoch_ns / 1e9 + self.duration > LATEST_S:
            raise InputError(
                f"{path}: its times go from {self.epoch_ns / 1e9:g} s on for {self.duration:g} s; they must not be "
                f"negative, nor last longer than {LONGEST_S:g} s, nor end after {LATEST_S:g} s (2038): is their unit "
                "right?"
            )

    def topics(self) -> list[Topic]:
        """Return all topics."""
        return [Topic(name, c.type_name, len(c.ns), c.rank) for name, c in self._topics.items()]

    def dtype(self, topic: str) -> np.dtype[Any]:
        """Type of the messages of a topic."""
        return dtype_of(self._topics[topic].type_name)

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Yield portions of ten seconds."""
        chosen = {t: self._topics[t] for t in topics}
        keys = {t: (c.ns - self.epoch_ns) // _PORTION_NS for t, c in chosen.items()}
        order = {t: np.argsort(k, kind="stable") for t, k in keys.items()}
        sorted_keys = {t: k[order[t]] for t, k in keys.items()}
        for k in sorted(set().union(*(np.unique(v).tolist() for v in keys.values()))):
            block = {}
            for t, c in chosen.items():
                low, high = np.searchsorted(sorted_keys[t], [k, k + 1])
                block[t] = laid_out(c.picked(order[t][low:high]))
            yield block

    def close(self) -> None:
        """Do nothing: nothing is open."""


class BinaryLog(Held):
    """A log of an autopilot, in which damage leaves random stamps and bytes that belong to no message."""

    left_out = 0  # messages so far whose time is not that of those around them

    def _in_time(self, made: Columns, sane: np.ndarray | None = None) -> Columns:
        """Pick the rows with a plausible time, of the longest stretch without a step back of the clock."""
        good = near_in_time(made.ns) if sane is None else near_in_time(made.ns) & sane
        made = made if good.all() else made.picked(np.flatnonzero(good))
        part, steps = longest_part(made.ns)
        self.left_out += len(good) - (part.stop - part.start)
        return made.picked(np.arange(part.start, part.stop)) if steps else made

    def _damage(self, refused: Sequence[str], lost: int) -> None:
        """Note what could not be read: descriptions, and bytes."""
        self.notes += refused
        if lost:
            self.notes.append(f"{lost} bytes of the file belong to no message: damaged or cut off there")
        if self.left_out:
            self.notes.append(f"{self.left_out} messages left out: their time is not that of those around them")


def numbered(name: str, number: int) -> str:
    """Name the topic of an instance of a message."""
    return f"{name}[{number}]" if number else name


def gathered(*makers: Callable[[], Iterable[tuple[str, Columns]]]) -> tuple[dict[str, Columns], list[str]]:
    """Collect topics of all makers, and a line for each that fails: a damaged description spoils its own only."""
    topics: dict[str, Columns] = {}
    notes = []
    for make in makers:
        try:
            for name, columns in make():
                laid_out(columns.picked(np.arange(min(1, len(columns.ns)))))
                topics[name] = columns
        except (ValueError, TypeError, KeyError, IndexError, OverflowError) as error:
            notes.append(f"{make.__name__.strip('_')}: cannot be read: {one_line(error)}")
    return topics, notes


def longest_part(ns: np.ndarray) -> tuple[slice, int]:
    """Find the longest stretch of rows (n,) without a step back of the clock; count the steps."""
    edges = np.flatnonzero(np.diff(ns) < -_STEP_NS) + 1
    bounds = np.r_[0, edges, len(ns)]
    k = int(np.argmax(np.diff(bounds)))
    return slice(int(bounds[k]), int(bounds[k + 1])), len(edges)


def near_in_time(ns: np.ndarray) -> np.ndarray:
    """Mask rows (n,) whose time agrees with that of their neighbours: in a damaged file stamps are random."""
    if len(ns) < 5 or (np.abs(np.diff(ns.astype(float))) < 60e9).all():
        return np.ones(len(ns), bool)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(ns, 2, mode="edge"), 5)
    near: np.ndarray = np.abs(ns.astype(float) - np.median(windows.astype(float), axis=1)) < 60e9
    return near


_GPS_EPOCH_S = 315_964_800  # 1980-01-06
_LEAPS = np.array(
    [46828800, 78364801, 109900802, 173059203, 252028804, 315187205, 346723206, 393984007, 425520008, 457056009,
     504489610, 551750411, 599184012, 820108813, 914803214, 1025136015, 1119744016, 1167264017]
)  # fmt: skip
"""GPS seconds at which a leap second came (IERS Bulletin C)."""


def from_gps(week: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Convert a GPS week and the seconds in it to time (n,) ns since 1970 (UTC)."""
    whole = np.floor(seconds)
    gps = week.astype(np.int64) * 604800 + whole.astype(np.int64)
    utc = gps + _GPS_EPOCH_S - np.searchsorted(_LEAPS, gps, "right")
    ns: np.ndarray = utc * 10**9 + np.rint((seconds - whole) * 1e9).astype(np.int64)
    return ns


def extra(module: str, package: str, name: str) -> ModuleType:
    """Import a module of an optional package.

    Raises:
        InputError: it is not installed; which extra has it.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"{package} is needed to read this file: pip install 'ahrs-sim[{name}]'") from None


def one_line(error: BaseException) -> str:
    """Make the text of a foreign error short enough for a line."""
    return " ".join(str(error).split())[:120] or type(error).__name__
