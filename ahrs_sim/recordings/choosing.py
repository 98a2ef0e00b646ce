"""Which topic of a recording is what: as the map says, else by type, name, rate and what is in it."""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.reader import vector
from ahrs_sim.recordings import frames
from ahrs_sim.recordings.mapping import IMU, KINDS, Map
from ahrs_sim.recordings.sources import Source, Topic

RECORDED = "recorded "
"""What the kind of an attitude begins with that the vehicle itself estimated; the estimator's name follows."""

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
                if "never" in why or kind == "imu":
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
        there = ", ".join(f"{t.name} ({t.type_name.rpartition('/')[2]})" for t in list(topics.values())[:5])
        why = f"; {passed[0]}" if passed else f"; it has {there}" if there else ""
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
        if not _changes(source, topic.name, functools.partial(_attitude, topic.type_name)):
            return "its orientation never changes"
    if kind in _PLACEHOLDERS and (kind != "heading" or topic.type_name == "ahrs_sim_msgs/msg/Heading"):
        what, values, only_zero = _PLACEHOLDERS[kind]
        if not (only_zero and values(first).any()) and not _changes(source, topic.name, values):
            return f"its {what} never changes{' from 0' if only_zero else ''}"
    if kind in ("diff_pressure", "static_pressure"):
        static = _STATIC[0] < abs(float(np.nanmedian(first["fluid_pressure"]))) < _STATIC[1]
        if static != (kind == "static_pressure"):
            return "static pressure" if static else "differential pressure"
    return ""


def _vector(place: str, array: np.ndarray) -> np.ndarray:
    return vector(array[place])


def _attitude(type_name: str, array: np.ndarray) -> np.ndarray:
    """Orientation (n, 4) to a millionth, q and -q being one."""
    q = frames.orientation(array, type_name)
    largest = np.argmax(np.abs(np.nan_to_num(q)).round(6), axis=1)[:, None]
    turned: np.ndarray = np.round(q * np.sign(np.take_along_axis(q, largest, axis=1)), 6)
    return turned


def _linear(array: np.ndarray) -> np.ndarray:
    twist = array["twist"]
    return vector((twist["twist"] if "twist" in (twist.dtype.names or ()) else twist)["linear"])


def _column(name: str, array: np.ndarray) -> np.ndarray:
    column: np.ndarray = array[name][:, None]
    return column


_PLACEHOLDERS: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray], bool]] = {
    "mag": ("field", functools.partial(_vector, "magnetic_field"), False),
    "velocity": ("velocity", _linear, True),
    "heading": ("heading", functools.partial(_column, "heading"), False),
    "diff_pressure": ("pressure", functools.partial(_column, "fluid_pressure"), True),
    "air": ("airspeed", functools.partial(_column, "airspeed"), True),
}
"""By kind: what it is, its values (n, k), and whether only one that stays 0 measures nothing."""


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


def recorded(source: Source, reference: Choice | None) -> dict[str, Choice]:
    """Choose the attitudes that the vehicle itself estimated, but for the reference; names begin with `RECORDED`."""
    topics = {t.name: t for t in source.topics()}
    named = {n: topics[t] for n, t in source.recorded.items() if reference is None or t != reference.topic.name}
    return {f"{RECORDED}{name}": Choice(topic, "FRD", "NED") for name, topic in named.items()}


def first_height(source: Source, chosen: Mapping[str, Choice]) -> float:
    """Find the height (m) of the first fix in three dimensions; 0 without any."""
    if "fix" not in chosen:
        return 0.0
    name = chosen["fix"].topic.name
    for block in source.blocks([name]):
        height = block[name]["altitude"][block[name]["status"]["status"] >= 0]
        if np.isfinite(height).any():
            return float(height[np.isfinite(height)][0])
    return 0.0
