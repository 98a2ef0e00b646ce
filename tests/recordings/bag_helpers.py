"""Recordings made from a motion that is known exactly, in anybody's axes and units."""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.log.mcap.writer import LogWriter
from ahrs_sim.recordings import frames
from estimators.rotations import triad
from estimators.types import Estimates, Samples, SensorInfo, Site, blank

EPOCH = 1_780_308_000_000_000_000  # 2026-06-01 10:00 UTC
G = 9.80665
LLA = (43.57, 1.47, 150.0)  # deg, deg, m
MAG_N = np.array([2.4e-5, 0.05e-5, 3.9e-5])
NED_TO = {"NED": np.eye(3), "ENU": frames.to_ned("ENU").T}


class Motion(NamedTuple):
    t: np.ndarray
    q_nb: np.ndarray
    gyro_b: np.ndarray
    accel_b: np.ndarray
    mag_b: np.ndarray


def motion(duration: float = 60.0, rate: float = 100.0, still: float = 25.0) -> Motion:
    """Stands, then turns about all axes in place."""
    t = np.arange(round(duration * rate)) / rate
    s = np.maximum(t - still, 0.0)
    soft = 1 - np.exp(-s)  # no jerk at the beginning
    d = np.exp(-s) * (s > 0)
    roll, droll = 0.9 * soft * np.sin(1.1 * s), 0.9 * (d * np.sin(1.1 * s) + soft * 1.1 * np.cos(1.1 * s))
    pitch, dpitch = 0.6 * soft * np.sin(0.7 * s), 0.6 * (d * np.sin(0.7 * s) + soft * 0.7 * np.cos(0.7 * s))
    yaw, dyaw = 0.4 + 0.5 * s * soft, 0.5 * soft + 0.5 * s * d
    q_nb = attitude.from_euler(np.column_stack([roll, pitch, yaw]))
    gyro_b = np.column_stack(
        [
            droll - dyaw * np.sin(pitch),
            dpitch * np.cos(roll) + dyaw * np.cos(pitch) * np.sin(roll),
            -dpitch * np.sin(roll) + dyaw * np.cos(pitch) * np.cos(roll),
        ]
    )
    back = q_nb * [1, -1, -1, -1]
    down = np.tile([0.0, 0.0, -G], (len(t), 1))
    return Motion(t, q_nb, gyro_b, attitude.to_nav(back, down), attitude.to_nav(back, np.tile(MAG_N, (len(t), 1))))


class Triad:
    """Attitude from gravity and field alone, exact where nothing accelerates; rows with a fresh field only."""

    def __init__(self, *, site: Site, sensors: SensorInfo) -> None:
        self.mag_n = np.array(site.mag_n)

    def process(self, samples: Samples) -> Estimates:
        columns = blank(Estimates, len(samples))
        columns["t"] = samples.t
        q = np.empty(4)
        for i in np.flatnonzero(samples.mag_new):
            if triad(-samples.accel_b[i], samples.mag_b[i], self.mag_n, q):
                columns["q_nb"][i] = q
                columns["down_b"][i] = -samples.accel_b[i] / np.linalg.norm(samples.accel_b[i])
        return Estimates(**columns)


def ns(t: np.ndarray) -> np.ndarray:
    return EPOCH + np.rint(np.asarray(t) * 1e9).astype(np.int64)


def write_bag(
    path: Path,
    m: Motion,
    *,
    body: str = "FLU",
    world: str = "ENU",
    imu_frame: str = "imu_link",
    mag_scale: float = 1.0,
    hard_iron: np.ndarray | tuple[float, ...] = (0.0, 0.0, 0.0),
    soft_iron: np.ndarray | None = None,
    order: np.ndarray | None = None,
    reference_delay: float = 0.0,
    with_place: bool = True,
    header: bool = True,
    velocity: tuple[float, float, float] = (1.0, 2.0, 3.0),
) -> None:
    """A bag as mavros would lay it out; `order` says in which order the IMU sends the rows of the motion."""
    turn = frames.to_frd(body).T
    rows = np.arange(len(m.t)) if order is None else order
    with LogWriter(path, epoch_ns=EPOCH, force=True) as log:
        imu = log.add_channel("/imu/data_raw", "sensor_msgs/msg/Imu", frame_id=imu_frame,
                              constant={"orientation_covariance": np.r_[-1.0, np.zeros(8)]})  # fmt: skip
        mag = log.add_channel("/imu/mag", "sensor_msgs/msg/MagneticField", frame_id=imu_frame)
        reference = log.add_channel(
            "/truth/odom", "nav_msgs/msg/Odometry",
            constant={"header": {"frame_id": "odom"}, "child_frame_id": "base_link"})  # fmt: skip
        fix = log.add_channel("/gps/fix", "sensor_msgs/msg/NavSatFix", frame_id="gps")
        vel = log.add_channel("/gps/vel", "geometry_msgs/msg/TwistStamped", frame_id="map")
        diff = log.add_channel("/air/a", "sensor_msgs/msg/FluidPressure", frame_id="pitot")
        static = log.add_channel("/air/b", "sensor_msgs/msg/FluidPressure", frame_id="static")
        log.add_channel("/unused", "sensor_msgs/msg/Temperature")
        log.start()
        arrival = ns(m.t[np.sort(rows)]) + np.arange(len(rows))
        stamp = ns(m.t) if header else ns(m.t) - EPOCH
        log.write(imu, arrival, stamp[rows], angular_velocity=(m.gyro_b @ turn.T)[rows],
                  linear_acceleration=(m.accel_b @ turn.T)[rows])  # fmt: skip
        soft = np.eye(3) if soft_iron is None else np.linalg.inv(soft_iron)
        raw = mag_scale * (m.mag_b @ turn.T @ soft.T + hard_iron)
        every = slice(None, None, 2)
        log.write(mag, ns(m.t[every]), stamp[every], magnetic_field=raw[every])
        q = frames.q_ned(m.q_nb, "FRD", "NED")
        w = {"ENU": np.array([[0.0, 0.5**0.5, 0.5**0.5, 0.0]]), "NED": np.array([[1.0, 0.0, 0.0, 0.0]])}[world]
        b = {"FLU": np.array([[0.0, 1.0, 0.0, 0.0]]), "FRD": np.array([[1.0, 0.0, 0.0, 0.0]])}[body]
        q = attitude.product(attitude.product(w * [1, -1, -1, -1], q), b * [1, -1, -1, -1])
        log.write(reference, ns(m.t), ns(m.t + reference_delay) - (0 if header else EPOCH),
                  **{"pose.pose.orientation": q})  # fmt: skip
        slow = slice(None, None, 20)
        n = len(m.t[slow])
        if with_place:
            log.write(fix, ns(m.t[slow]), stamp[slow], latitude=np.full(n, LLA[0]), longitude=np.full(n, LLA[1]),
                      altitude=np.full(n, LLA[2]))  # fmt: skip
        v = np.tile(velocity, (n, 1))
        log.write(vel, ns(m.t[slow]) + 300_000, stamp[slow] + 300_000, **{"twist.linear": v @ NED_TO[world].T})
        log.write(static, ns(m.t[slow]), stamp[slow], fluid_pressure=np.full(n, 99000.0))
        log.write(diff, ns(m.t[slow]), stamp[slow], fluid_pressure=np.full(n, 0.5 * 1.225 * 20.0**2))


def write_ulog(path: Path, m: Motion) -> None:
    """A PX4 log with what an estimator needs, by the format's specification."""
    topics: dict[str, tuple[str, np.ndarray]] = {
        "sensor_combined": (
            "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;",
            np.rec.fromarrays([m.t * 1e6, m.gyro_b, m.accel_b], dtype=[("t", "<u8"), ("g", "<f4", 3), ("a", "<f4", 3)]),
        ),
        "vehicle_magnetometer": (
            "uint64_t timestamp;float[3] magnetometer_ga;",
            np.rec.fromarrays([m.t * 1e6, m.mag_b * 1e4], dtype=[("t", "<u8"), ("m", "<f4", 3)]),
        ),
        "vehicle_attitude": (
            "uint64_t timestamp;float[4] q;",
            np.rec.fromarrays([m.t * 1e6, m.q_nb], dtype=[("t", "<u8"), ("q", "<f4", 4)]),
        ),
    }
    out = bytearray(b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", 0))

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<H", len(body)) + kind + body

    for name, (fields, _) in topics.items():
        out += message(b"F", f"{name}:{fields}".encode())
    for i, name in enumerate(topics):
        out += message(b"A", struct.pack("<BH", 0, i) + name.encode())
    for i, (_, rows) in enumerate(topics.values()):
        for row in rows:
            out += message(b"D", struct.pack("<H", i) + row.tobytes())
    path.write_bytes(out)
