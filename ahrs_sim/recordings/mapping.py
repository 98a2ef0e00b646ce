"""What the topics of a recording mean: the user's map (TOML), and the choice of topics by type, name and rate.

Everything in a map is optional:

    [topics]                # imu, accel (where apart), mag, fix, velocity, heading, diff_pressure, static_pressure,
                            # air, reference
    imu = "/imu/data_raw"
    heading = ""            # leave it out
    [frames]
    body = "FLU"            # or FRD; else by frame_id, else FLU (REP-103)
    world = "ENU"           # or NED
    reference_body = "FRD"  # where the reference differs
    reference_world = "NED"
    [mounting]              # the IMU against the vehicle
    yaw_deg = 90.0
    [magnetometer]
    unit = "uT"
    hard_iron = [39.2, 16.1, -39.6]                         # in that unit and in the axes of the messages
    soft_iron = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]    # row by row: m = soft (raw - hard)
    yaw_deg = 90.0          # how it sits on the IMU, where the two differ
    [imu]
    gyro_unit = "deg/s"
    accel_unit = "g"
    gyro_bias = [0.0, 0.0, 0.0]     # rad/s, in the axes of the messages
    [air]
    scale = 1.03            # true airspeed by what is read
    [place]                 # else from the first fix and the recording's date
    latitude_deg = 45.3
    longitude_deg = -93.2
    altitude_m = 250.0
    declination_deg = 0.6   # instead of the World Magnetic Model's
    [time]
    stamps = "header"       # or "log"
    date = 2026-06-01T10:00:00Z     # where the times start near 0
    fix_s = -0.2            # added to the stamps of a topic
    [sensors]               # data sheet figures, SI, as in estimators.SensorInfo
    gyro_noise = 5e-4
    [estimator.mine]
    method = "marg-ekf"
"""

import dataclasses
import datetime
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.reader import vector
from ahrs_sim.recordings import frames, presets
from ahrs_sim.recordings.frames import ORIENTATIONS
from ahrs_sim.recordings.sources import UNITS, Source, Topic
from ahrs_sim.scenario import Component, Gate, estimator_component
from ahrs_sim.scenario.table import Table
from estimators.types import SensorInfo

_FOREIGN = Gate()
SUITE = "bag"
"""Name of the suite that a recording becomes."""

IMU = "sensor_msgs/msg/Imu"
KINDS: dict[str, tuple[str, ...]] = {
    "imu": (IMU,),
    "accel": (IMU,),
    "mag": ("sensor_msgs/msg/MagneticField",),
    "fix": ("sensor_msgs/msg/NavSatFix",),
    "velocity": ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistWithCovarianceStamped"),
    "heading": ("ahrs_sim_msgs/msg/Heading", "geometry_msgs/msg/QuaternionStamped", IMU),
    "diff_pressure": ("sensor_msgs/msg/FluidPressure",),
    "static_pressure": ("sensor_msgs/msg/FluidPressure",),
    "air": ("ahrs_sim_msgs/msg/AirData",),
    "reference": tuple(ORIENTATIONS),
}
"""Message types that each kind of measurement can come as."""

_LIKED = {  # words of a topic's name that speak for a kind, the best first
    "imu": ("raw",),
    "accel": ("acc", "raw"),
    "mag": ("mag",),
    "fix": ("raw", "gnss", "gps"),
    "velocity": ("raw", "gnss", "gps"),
    "heading": ("heading",),
    "diff_pressure": ("diff", "pitot", "dynamic"),
    "static_pressure": ("static", "abs", "baro"),
    "air": ("air",),
    "reference": ("truth", "reference", "ground", "mocap", "optic", "odom"),
}
_DISLIKED = {"velocity": ("cmd", "setpoint", "target", "local"), "reference": ("setpoint", "target")}
_NEEDED = {"velocity": ("gps", "gnss", "raw", "fix", "velocity"), "heading": ("heading",)}
_STATIC = (2e4, 1.2e5)  # Pa: what static pressure can be


@dataclass(frozen=True)
class Map:
    """A checked map."""

    where: str
    table: Table
    topics: Mapping[str, str]
    body: str | None
    world: str | None
    reference_body: str | None
    reference_world: str | None
    mount: np.ndarray  # C_bs (3, 3), sensor to vehicle, both FRD
    mag_mount: np.ndarray  # (3, 3), magnetometer to IMU, both FRD
    mag_unit: float  # T
    hard_iron: np.ndarray  # (3,) T, in the axes of the messages
    soft_iron: np.ndarray  # (3, 3)
    has_iron: bool  # given, if only as none
    gyro_unit: float  # rad/s
    accel_unit: float  # m/s2
    gyro_bias: np.ndarray  # (3,) rad/s
    air_scale: float  # true airspeed by what is read
    place: Mapping[str, float]
    stamps: str | None
    shifts: Mapping[str, int]  # ns, by kind
    sensors: Mapping[str, Any]
    estimators: tuple[Component, ...]
    date: datetime.datetime | None = None  # of the recording, where its own times are none

    def mag_axes(self, body: str) -> np.ndarray:
        """(3, 3) from a magnetometer's messages in `body` axes to the vehicle's FRD."""
        axes: np.ndarray = self.mount @ self.mag_mount @ frames.to_frd(body)
        return axes


def load(path: Path | None, gate: Gate = _FOREIGN) -> Map:
    """Load the user's map; without a path an empty one. Its estimators run code from outside that `gate` allows.

    Raises:
        InputError: file, table and key of what is wrong.
    """
    table = presets.read(path) if path else Table({}, "no map")
    table.text("preset", "")  # the map that it builds on: already taken into it
    topics = table.table("topics")
    named = {kind: topics.text(kind) for kind in KINDS if topics.has(kind)}
    topics.close()
    axes = table.table("frames")
    body, world = axes.choice("body", frames.BODIES, None), axes.choice("world", frames.WORLDS, None)
    reference = (
        axes.choice("reference_body", frames.BODIES, body),
        axes.choice("reference_world", frames.WORLDS, world),
    )
    axes.close()
    mounting = table.table("mounting")
    mount = _rotation(mounting)
    mounting.close()
    mag = table.table("magnetometer")
    has_iron = mag.has("hard_iron") or mag.has("soft_iron")
    unit = UNITS[mag.choice("unit", ["T", "uT", "nT", "G", "mG"], "T")]
    hard = mag.vector("hard_iron", [0.0, 0.0, 0.0]) * unit
    soft = mag.vector("soft_iron", np.eye(3).ravel().tolist(), size=9).reshape(3, 3)
    mag_mount = _rotation(mag)
    mag.close()
    imu = table.table("imu")
    gyro_unit = UNITS[imu.choice("gyro_unit", ["rad/s", "deg/s"], "rad/s")]
    accel_unit = UNITS[imu.choice("accel_unit", ["m/s2", "g", "mg"], "m/s2")]
    gyro_bias = imu.vector("gyro_bias", [0.0, 0.0, 0.0])
    imu.close()
    air = table.table("air")
    air_scale = air.number("scale", 1.0, minimum=0.1, maximum=10.0)
    air.close()
    clock = table.table("time")
    date = clock.date("date") if clock.has("date") else None
    stamps = clock.choice("stamps", ["header", "log"], None)
    shifts = {kind: round(clock.number(f"{kind}_s", 0.0) * 1e9) for kind in KINDS}
    clock.close()
    table.table("csv")  # read with the file
    mapping = Map(
        where=table.where,
        table=table,
        topics=named,
        body=body,
        world=world,
        reference_body=reference[0],
        reference_world=reference[1],
        mount=mount,
        mag_mount=mag_mount,
        mag_unit=unit,
        hard_iron=hard,
        soft_iron=soft,
        has_iron=has_iron,
        gyro_unit=gyro_unit,
        accel_unit=accel_unit,
        gyro_bias=gyro_bias,
        air_scale=air_scale,
        place=_place(table.table("place")),
        stamps=stamps,
        date=date,
        shifts=shifts,
        sensors=_sensors(table.table("sensors")),
        estimators=tuple(
            estimator_component(name, {**t.data, "suite": SUITE}, t.where, gate)
            for name, t in table.named_tables("estimator").items()
        ),
    )
    table.close()
    return mapping


def _rotation(table: Table) -> np.ndarray:
    return attitude.matrix(*(math.radians(table.number(f"{a}_deg", 0.0)) for a in ("roll", "pitch", "yaw")))


def _place(table: Table) -> dict[str, float]:
    limits = {"latitude_deg": 90.0, "longitude_deg": 180.0, "altitude_m": 1e5, "declination_deg": 180.0}
    place = {k: table.number(k, minimum=-v, maximum=v) for k, v in limits.items() if table.has(k)}
    table.close()
    if ("latitude_deg" in place) != ("longitude_deg" in place):
        raise table.error("latitude_deg", "a place needs latitude_deg and longitude_deg; add the other")
    return place


def _sensors(table: Table) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for field in dataclasses.fields(SensorInfo):
        if table.has(field.name):
            triple = field.name in ("antenna_b", "field_error")
            values[field.name] = tuple(table.vector(field.name).tolist()) if triple else table.number(field.name)
    table.close()
    return values


# ----------------------------------------------------------------------------------------------- choosing


@dataclass(frozen=True)
class Choice:
    """A topic for a kind of measurement, and its axes."""

    topic: Topic
    body: str
    world: str
    others: tuple[str, ...] = ()  # topics of the same kind that the recording offers as well


def choose(source: Source, mapping: Map, notes: list[str] | None = None) -> dict[str, Choice]:
    """Choose topics by kind: those of the map, else by type, name and rate.

    Args:
        source: the recording.
        mapping: the user's map.
        notes: gets a line for each topic that has the right type and is passed over.

    Raises:
        InputError: no IMU, a topic of the map that is not there, or of a type that cannot be that.
    """
    topics = {t.name: t for t in source.topics()}
    chosen: dict[str, Choice] = {}
    passed: list[str] = []
    for kind in KINDS:
        wanted = mapping.topics.get(kind)
        if wanted == "" or (kind == "accel" and not wanted):  # found with the gyro
            continue
        taken = [c.topic.name for k, c in chosen.items() if k != "imu"]
        candidates = _candidates(kind, topics, taken) if wanted is None else [_named(kind, wanted, topics, mapping)]
        for topic in candidates:
            first = _first(source, topic.name)
            why = messages.difference(topic.type_name, first.dtype) if len(first) else ""
            if why and wanted:
                raise InputError(f"{source.path}: {topic.name} is not a {topic.type_name} as it is known: {why}")
            why = why or ("" if wanted and len(first) else _unfit(kind, topic, first, source))
            if why:
                if "never change" in why or kind == "imu":
                    passed.append(f"{topic.name} is no {kind}: {why}")
                continue
            body, world = frames.named(first, topic.type_name)
            if kind == "reference":
                body, world = mapping.reference_body or body, mapping.reference_world or world
            else:
                body, world = mapping.body or body, mapping.world or world
            others = [t for t in candidates if t is not topic and any(c.rank for c in candidates)]
            fit = (t.name for t in others if not _unfit(kind, t, _first(source, t.name), source))
            chosen[kind] = Choice(topic, body, world, tuple(fit))
            break
    if "imu" not in chosen and mapping.topics.get("imu") is None:
        chosen = _apart(source, topics, mapping) | chosen
    if "imu" not in chosen:
        why = f"; {passed[0]}" if passed else ""
        raise InputError(
            f"{source.path}: no IMU in it (no {IMU} with rates and forces{why}); name it with --map, [topics] imu"
        )
    if notes is not None:
        notes += passed
    return chosen


def _apart(source: Source, topics: Mapping[str, Topic], mapping: Map) -> dict[str, Choice]:
    """Find a gyro and an accelerometer with a topic each; nothing without both."""
    chosen: dict[str, Choice] = {}
    for kind, place, other in (
        ("imu", "angular_velocity", "linear_acceleration"),
        ("accel", "linear_acceleration", "angular_velocity"),
    ):
        for topic in _candidates(kind, topics, []):
            first = _first(source, topic.name)
            if not {f"{place}_covariance", f"{other}_covariance"} <= set(first.dtype.names or ()):
                continue  # something else than its name says
            if not len(first) or (first[f"{place}_covariance"][:, 0] == -1.0).all():
                continue
            if (first[f"{other}_covariance"][:, 0] == -1.0).all():
                body, world = frames.named(first, topic.type_name)
                chosen[kind] = Choice(topic, mapping.body or body, mapping.world or world)
                break
    return chosen if len(chosen) == 2 else {}


def _candidates(kind: str, topics: Mapping[str, Topic], taken: Sequence[str]) -> list[Topic]:
    """List topics that could be of a kind, the likeliest first."""
    found = [t for t in topics.values() if t.type_name in KINDS[kind] and t.name not in taken]
    found = [t for t in found if not any(w in t.name.lower() for w in _DISLIKED.get(kind, ()))]
    if kind in _NEEDED:
        found = [t for t in found if any(w in t.name.lower() for w in _NEEDED[kind])]
    return sorted(found, key=lambda t: (t.rank, _liking(kind, t.name), -t.count))


def _named(kind: str, wanted: str, topics: Mapping[str, Topic], mapping: Map) -> Topic:
    """Find the topic that the map names."""
    if wanted not in topics:
        raise InputError(f"{mapping.where}: [topics]: {kind}: no topic '{wanted}'{nearest(wanted, topics)}")
    if topics[wanted].type_name not in KINDS[kind]:
        raise InputError(
            f"{mapping.where}: [topics]: {kind}: {wanted} is a {topics[wanted].type_name}; "
            f"it must be {' or '.join(KINDS[kind])}"
        )
    return topics[wanted]


def _liking(kind: str, name: str) -> int:
    """Rank of a name, 0 the best."""
    words = _LIKED[kind]
    return next((i for i, word in enumerate(words) if word in name.lower()), len(words))


def _first(source: Source, topic: str) -> np.ndarray:
    for block in source.blocks([topic]):
        if len(block[topic]):
            return block[topic][:200]
    return np.empty(0)


def _unfit(kind: str, topic: Topic, first: np.ndarray, source: Source) -> str:
    """Why a topic cannot be of a kind; nothing when it can."""
    if not len(first):
        return "no message in it"
    if kind == "imu":
        for what, place in (("rates", "angular_velocity"), ("forces", "linear_acceleration")):
            if (first[f"{place}_covariance"][:, 0] == -1.0).all():
                return f"it has no {what} (covariance -1)"
            if not _changes(source, topic.name, functools.partial(_vector, place)):
                return f"its {what} never change"
    if kind == "reference" or (kind == "heading" and topic.type_name != "ahrs_sim_msgs/msg/Heading"):
        q = frames.orientation(first, topic.type_name)
        if not (np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.1).any():
            return "it has no orientation"
        if not _changes(source, topic.name, lambda block: frames.orientation(block, topic.type_name)):
            return "its orientation never changes"
    if kind in ("diff_pressure", "static_pressure"):
        static = _STATIC[0] < abs(float(np.nanmedian(first["fluid_pressure"]))) < _STATIC[1]
        if static != (kind == "static_pressure"):
            return "static pressure" if static else "differential pressure"
    return ""


def _vector(place: str, array: np.ndarray) -> np.ndarray:
    return vector(array[place])


def _changes(source: Source, topic: str, values: Callable[[np.ndarray], np.ndarray]) -> bool:
    """Test whether finite values (n, k) of a topic's messages differ anywhere; read on until they do."""
    known = None
    for block in source.blocks([topic]):
        if not len(block[topic]):
            continue
        found = values(block[topic])
        found = found[np.isfinite(found).all(axis=1)]
        if len(found):
            known = found[0] if known is None else known
            if (found != known).any():
                return True
    return False


def described(chosen: Mapping[str, Choice], duration: float) -> Sequence[str]:
    """Describe each choice in one line."""
    lines = []
    for kind, choice in chosen.items():
        rate = (choice.topic.count - 1) / duration if duration > 0 else math.nan
        axes = {"imu": choice.body, "mag": choice.body, "velocity": choice.world}.get(kind, "")
        axes = f"{choice.body}, {choice.world}" if kind == "reference" else axes
        also = f"  (also there: {', '.join(choice.others)}; [topics] {kind})" if choice.others else ""
        lines.append(f"{kind:16s}{choice.topic.name}  {rate:.1f} Hz  {axes}".rstrip() + also)
    return lines
