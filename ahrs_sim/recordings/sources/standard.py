"""Messages of the standard types that come as names and values, from JSON or protobuf, as arrays."""

import datetime
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ahrs_sim.log import messages
from ahrs_sim.recordings.sources.base import FIX, dtype_of

_FOXGLOVE = {"LocationFix": FIX, "PoseInFrame": "geometry_msgs/msg/PoseStamped"}
"""Types of https://docs.foxglove.dev/docs/sdk/schemas, by the ROS type that says the same."""

_ABSENT = {"angular_velocity": "angular_velocity_covariance", "linear_acceleration": "linear_acceleration_covariance",
           "orientation": "orientation_covariance"}  # fmt: skip


def standard_name(type_name: str) -> str | None:
    """Find the ROS 2 name of a standard type, `sensor_msgs/Imu` or `ros.sensor_msgs.Imu` as well; None: it is none."""
    words = [w for w in type_name.replace("/", ".").split(".") if w != "msg"]
    if len(words) < 2:
        return None
    package, name = words[-2:]
    if package in ("foxglove", "foxglove_msgs"):
        return _FOXGLOVE.get(name)
    full = f"{package}/msg/{name}"
    return full if full in messages.type_names() or f"{package}/{name}" in messages.type_names() else None


def array_of(kind: str, log_ns: Sequence[int], values: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Make messages (n,) of a standard type; missing numbers are NaN, what an Imu does not have is marked so.

    Raises:
        ValueError, TypeError: a value that its field cannot hold.
    """
    out = np.zeros(len(values), dtype_of(kind))
    out["log_time"] = log_ns
    names = [n for n in out.dtype.names or () if n not in ("log_time", "header")]
    for i, message in enumerate(values):
        row = out[i]
        if not isinstance(message, Mapping):
            raise TypeError(f"a message is no object but {str(message)[:40]!r}")
        _header(row, message, int(log_ns[i]))
        for name in names:
            value = _get(message, name)
            if value is None:
                covariance = _ABSENT.get(name)
                if covariance in names:
                    row[covariance][0] = -1.0
                continue
            _fill(row, name, value)
    return out


def _get(message: Mapping[str, Any], name: str) -> Any:
    if name in message:
        return message[name]
    head, *rest = name.split("_")
    return message.get(head + "".join(w.capitalize() for w in rest))


def _header(row: Any, message: Mapping[str, Any], log_ns: int) -> None:
    header = message.get("header")
    if isinstance(header, Mapping):
        stamp, frame = header.get("stamp"), _get(header, "frame_id")
    else:
        stamp, frame = message.get("timestamp"), _get(message, "frame_id")
    seconds, nanoseconds = _stamp(stamp, log_ns)
    if "header" in (row.dtype.names or ()):
        row["header"]["stamp"]["sec"], row["header"]["stamp"]["nanosec"] = seconds, nanoseconds
        row["header"]["frame_id"] = str(frame or "")


def _stamp(stamp: Any, log_ns: int) -> tuple[int, int]:
    """Read seconds and nanoseconds; the log's own time where there is none."""
    if isinstance(stamp, str):
        text, _, fraction = stamp.rstrip("Z").partition(".")
        date = datetime.datetime.fromisoformat(text).replace(tzinfo=datetime.UTC)
        return int(date.timestamp()), int(f"{fraction:0<9.9}") if fraction else 0
    if isinstance(stamp, Mapping):
        seconds = next((stamp[k] for k in ("sec", "secs", "seconds") if k in stamp), 0)
        nanoseconds = next((stamp[k] for k in ("nsec", "nanosec", "nsecs", "nanos") if k in stamp), 0)
        return int(seconds), int(nanoseconds)
    return log_ns // 10**9, log_ns % 10**9


def _fill(row: Any, name: str, value: Any) -> None:
    inner = row[name]
    if inner is not None and getattr(inner, "dtype", None) is not None and inner.dtype.names:
        for part in inner.dtype.names:
            given = _get(value, part) if isinstance(value, Mapping) else None
            if given is not None:
                _fill(inner, part, given)
    elif isinstance(inner, np.ndarray) and inner.ndim:
        if len(value) == len(inner):
            inner[:] = value
    else:
        row[name] = np.nan if value is None else value
