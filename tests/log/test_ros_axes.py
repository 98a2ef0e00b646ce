"""The twins of IMU topics in the axes of ROS."""

from pathlib import Path

import numpy as np
import pandas as pd
from log_helpers import MadeUpFlight
from scipy.spatial.transform import Rotation

from ahrs_sim.log.mcap.reader import LogReader, quaternion, vector
from ahrs_sim.log.ros_axes import attitude, vectors

NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def test_attitude_is_from_flu_to_enu() -> None:
    q = Rotation.random(50, random_state=1).as_quat(scalar_first=True)
    forward_left_up = np.random.default_rng(0).standard_normal((50, 3))
    ned = Rotation.from_quat(q, scalar_first=True).apply(vectors(forward_left_up))
    enu = Rotation.from_quat(attitude(q), scalar_first=True).apply(forward_left_up)
    np.testing.assert_allclose(enu, ned @ NED_TO_ENU.T, atol=1e-12)
    heading_north = Rotation.from_quat(attitude(np.array([[1.0, 0, 0, 0]]))[0], scalar_first=True)
    np.testing.assert_allclose(heading_north.as_euler("ZYX", degrees=True), [90.0, 0.0, 0.0], atol=1e-9)


def test_the_log_has_twins_and_the_rest_is_the_same(tmp_path: Path) -> None:
    flight = MadeUpFlight()
    flight.write(tmp_path / "plain.mcap")
    flight.write(tmp_path / "twins.mcap", ros_axes=True)
    with LogReader(tmp_path / "plain.mcap") as plain, LogReader(tmp_path / "twins.mcap") as log:
        more = set(log.topics) - set(plain.topics)
        for topic in plain.topics:
            pd.testing.assert_frame_equal(plain.frame(topic), log.frame(topic))
        assert {"/ros/truth/imu", "/ros/chr/imu/data_raw", "/ros/chr/imu/mag"} <= more
        assert all(topic.startswith("/ros/") for topic in more)
        ours, theirs = log.read("/truth/imu"), log.read("/ros/truth/imu")
        np.testing.assert_allclose(vector(theirs["linear_acceleration"]), vectors(vector(ours["linear_acceleration"])))
        np.testing.assert_allclose(quaternion(theirs["orientation"]), attitude(quaternion(ours["orientation"])))
        assert set(theirs["header"]["frame_id"]) == {"base_link"}
        name = next(topic for topic in more if topic.startswith("/ros/est/"))
        ours, theirs = log.read(name.removeprefix("/ros")), log.read(name)
        turned = theirs["orientation_covariance"].reshape(-1, 3, 3)
        same = ours["orientation_covariance"].reshape(-1, 3, 3)
        np.testing.assert_allclose(turned[:, 0, 1], -same[:, 0, 1])
        np.testing.assert_allclose(turned[:, 1, 2], same[:, 1, 2])
