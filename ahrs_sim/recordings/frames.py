"""Axes of others and ours: FLU to FRD, ENU to NED, and which of them a frame's name says."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ahrs_sim.attitude import product

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
    """Make the rotation (3, 3) of vectors from `body` axes to FRD."""
    return _TO_FRD[body]


def to_ned(world: str) -> np.ndarray:
    """Make the rotation (3, 3) of vectors from `world` axes to NED."""
    return _TO_NED[world]


def q_ned(q: np.ndarray, body: str, world: str) -> np.ndarray:
    """Convert orientations (n, 4), scalar first, from `body` to `world` axes, to `q_nb` (n, 4); NaN stays."""
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where(np.abs(norm - 1.0) < 0.1, q / norm, np.nan)
    return product(product(_Q_TO_NED[world][None], unit), _Q_FROM_FRD[body][None])


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
    """Read orientations (n, 4) of messages, scalar first; NaN where an Imu is marked to have none."""
    place: Sequence[str] = ORIENTATIONS[type_name]
    values: Any = array
    for name in place:
        values = values[name]
    q = np.stack([values["w"], values["x"], values["y"], values["z"]], axis=-1)
    if type_name == "sensor_msgs/msg/Imu":
        q[array["orientation_covariance"][:, 0] == -1.0] = np.nan
    return q
