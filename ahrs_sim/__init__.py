"""Test bench for aircraft attitude and heading reference systems."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ahrs_sim.review.export import LogFrames


def read_log(path: str | Path) -> "LogFrames":
    """A log as pandas frames: `read_log(path)["/chr/imu/mag"]`, `.truth()`, `.errors("ekf-chr")`.

    Args:
        path: a log of ours, or any ROS 2 bag in MCAP.

    Raises:
        InputError: not a log.
    """
    from ahrs_sim.review.export import LogFrames  # pandas only when it is needed

    return LogFrames(path)
