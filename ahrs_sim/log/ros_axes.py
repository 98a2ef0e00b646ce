"""Twins of the IMU and magnetometer topics in the axes of ROS (REP-103, REP-145): `fly --ros-axes`.

The log is north-east-down and forward-right-down, declared by frame ids and `/tf_static`. Consumers that do not look
at these, such as imu_tools or robot_localization, expect forward-left-up vectors and an attitude towards east-north-up:
each topic that they read is written a second time behind `/ros`.
"""

from collections.abc import Mapping

import numpy as np

from ahrs_sim.log.mcap.writer import LogChannel, LogWriter
from ahrs_sim.log.topics import ESTIMATED_IMU, INSTRUMENTS, TRUTH, Route

PREFIX = "/ros"
FLU = "base_link"
_FLIP = np.array([1.0, -1.0, -1.0])  # forward-right-down to forward-left-up and back
_HALF = np.sqrt(0.5)

TWINS: tuple[Route, ...] = (
    next(route for route in TRUTH if route.type_name == "sensor_msgs/msg/Imu"),
    INSTRUMENTS["imu"][1],
    INSTRUMENTS["mag"][1],
    ESTIMATED_IMU,
)
"""The topics that have twins."""


def attitude(q_nb: np.ndarray) -> np.ndarray:
    """Turn an attitude (n, 4) from body FRD to NED into one from body FLU to ENU.

    q = (0, 1/sqrt 2, 1/sqrt 2, 0) q_nb (0, 1, 0, 0), Hamilton, scalar first.
    """
    a, b, c, d = q_nb.T
    # right: times i; left: times (i + j) / sqrt 2
    w, x, y, z = -b, a, d, -c
    turned: np.ndarray = _HALF * np.column_stack([-x - y, w + z, w - z, y - x])
    return turned


def vectors(v_b: np.ndarray) -> np.ndarray:
    """Turn vectors (n, 3) from forward-right-down to forward-left-up."""
    turned: np.ndarray = v_b * _FLIP
    return turned


class RosTwins:
    """Writes the twins; make it before the log is started."""

    def __init__(self, writer: LogWriter) -> None:
        self._writer = writer
        self._channels: dict[str, LogChannel] = {}

    def add(self, route: Route, prefix: str = "") -> None:
        """Open the twin of a topic, if it is one of `TWINS`."""
        if route in TWINS:
            topic = f"{PREFIX}{prefix}{route.topic}"
            self._channels[f"{prefix}{route.topic}"] = self._writer.add_channel(
                topic, route.type_name, constant=route.constant, frame_id=FLU
            )

    def write(
        self, route: Route, prefix: str, logged: np.ndarray, stamps: np.ndarray, columns: Mapping[str, np.ndarray]
    ) -> None:
        """Write the twin of messages, where there is one.

        Args:
            route, prefix: as in `add`.
            logged, stamps: (n,) ns, times of the messages.
            columns: what the messages have, in our axes.
        """
        channel = self._channels.get(f"{prefix}{route.topic}")
        if channel is None:
            return
        turned = {}
        for name, values in columns.items():
            if name == "orientation":
                turned[name] = attitude(values)
            elif name == "orientation_covariance":
                turned[name] = values.reshape(-1, 9) * np.outer(_FLIP, _FLIP).ravel()
            else:
                turned[name] = vectors(values)
        self._writer.write(channel, logged, stamps, **turned)
