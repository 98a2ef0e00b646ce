"""Axes of others and ours: FLU to FRD, ENU to NED, and which of them a frame's name says."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators import rotations

BODIES = ("FLU", "FRD")
WORLDS = ("ENU", "NED")

_HALF = float(np.sqrt(0.5))
_TO_FRD = {"FLU": np.diag([1.0, -1.0, -1.0]), "FRD": np.eye(3)}
_TO_NED = {"ENU": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), "NED": np.eye(3)}
_Q_TO_NED = {"ENU": np.array([0.0, _HALF, _HALF, 0.0]), "NED": np.array([1.0, 0.0, 0.0, 0.0])}
_Q_FROM_FRD = {"FLU": np.array([0.0, 1.0, 0.0, 0.0]), "FRD": np.array([1.0, 0.0, 0.0, 0.0])}

ORIENTATIONS: dict[str, tuple[str, ...]] = {
    "sensor_msgs/msg/Imu": ("orientation",),
    "nav_msgs/msg/Odometry": ("pose", "pose", "orientation"),
    "geometry_msgs/msg/PoseStamped": ("pose", "orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose", "pose", "orientation"),
    "geometry_msgs/msg/QuaternionStamped": ("quaternion",),
    "ahrs_sim_msgs/msg/EstimatorState": ("orientation",),
}
"""Where a message type keeps an orientation, body to world."""


def to_frd(body: str) -> np.ndarray:
    """(3, 3) that takes vectors of `body` axes to FRD."""
    return _TO_FRD[body]


def to_ned(world: str) -> np.ndarray:
    """(3, 3) that takes vectors of `world` axes to NED."""
    return _TO_NED[world]


def q_ned(q: np.ndarray, body: str, world: str) -> np.ndarray:
    """`q_nb` (n, 4) of orientations (n, 4), scalar first, from `body` to `world` axes; NaN where they are none."""
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where(np.abs(norm - 1.0) < 0.1, q / norm, np.nan)
    return product(product(_Q_TO_NED[world][None], unit), _Q_FROM_FRD[body][None])


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton products (n, 4) of quaternions (n, 4), scalar first; one row stands for all."""
    a, b = p[:, :1], p[:, 1:]
    c, d = q[:, :1], q[:, 1:]
    return np.concatenate([a * c - np.sum(b * d, axis=1, keepdims=True), a * d + c * b + np.cross(b, d)], axis=1)


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) turned by quaternions (n, 4)."""
    t = 2.0 * np.cross(q[:, 1:], v)
    return v + q[:, :1] * t + np.cross(q[:, 1:], t)


def from_euler(angles: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) of roll, pitch, yaw (n, 3) rad."""
    out = np.empty((len(angles), 4))
    for i, (roll, pitch, yaw) in enumerate(angles):
        rotations.from_euler(roll, pitch, yaw, out[i])
    return out


def euler_of(C: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (3,) rad of a rotation matrix (3, 3)."""
    level = math.hypot(C[0, 0], C[1, 0])
    if level < 1e-6:  # straight up or down: roll is what is left
        return np.array([math.atan2(-C[1, 2], C[1, 1]), math.atan2(-C[2, 0], level), 0.0])
    return np.array([math.atan2(C[2, 1], C[2, 2]), math.atan2(-C[2, 0], level), math.atan2(C[1, 0], C[0, 0])])


def named(array: np.ndarray, type_name: str) -> tuple[str, str]:
    """Body and world axes that the frame names of messages say; REP-103 (FLU, ENU) where they say nothing."""
    if type_name.startswith("ahrs_sim_msgs/"):
        return "FRD", "NED"
    frame = str(array["header"]["frame_id"][0]).lower()
    child = str(array["child_frame_id"][0]).lower() if "child_frame_id" in (array.dtype.names or ()) else frame
    body = "FRD" if child.endswith(("frd", "_ned")) else "FLU"
    world = "NED" if frame.endswith("ned") or (child == frame and body == "FRD") else "ENU"
    return body, world


def orientation(array: np.ndarray, type_name: str) -> np.ndarray:
    """Orientations (n, 4) as the messages have them, scalar first; NaN where an Imu says that it has none."""
    place: Sequence[str] = ORIENTATIONS[type_name]
    values: Any = array
    for name in place:
        values = values[name]
    q = np.stack([values["w"], values["x"], values["y"], values["z"]], axis=-1)
    if type_name == "sensor_msgs/msg/Imu":
        q[array["orientation_covariance"][:, 0] == -1.0] = np.nan
    return q
