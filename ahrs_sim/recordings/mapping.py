"""What the topics of a recording mean: the user's map (TOML), and the choice of topics by type, name and rate.

Everything in a map is optional:

    correction = "unit.toml"    # taken off the readings in the vehicle's axes (`ahrs_sim.sensors.correction`)
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
    gyro_unit = "deg/s"     # or "dps"
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
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.recordings import frames, presets
from ahrs_sim.recordings.frames import ORIENTATIONS
from ahrs_sim.recordings.sources import UNITS
from ahrs_sim.scenario import Component, Gate, estimator_component
from ahrs_sim.scenario.table import Table
from ahrs_sim.sensors import correction as corrections
from ahrs_sim.sensors.correction import Correction
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
    correction: Correction | None  # of the readings in the vehicle's axes
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
        """Make the matrix (3, 3) from a magnetometer's messages in `body` axes to the vehicle's FRD."""
        axes: np.ndarray = self.mount @ self.mag_mount @ frames.to_frd(body)
        return axes

    def corrected(self, mag_b: np.ndarray) -> np.ndarray:
        """Take the unit's correction off readings (n, 3) of the magnetometer, T, vehicle's axes."""
        return mag_b if self.correction is None else self.correction.magnetometer.applied(mag_b)


def load(path: Path | None, gate: Gate = _FOREIGN) -> Map:
    """Load the user's map; without a path an empty one. Its estimators run code from outside that `gate` allows.

    Raises:
        InputError: file, table and key of what is wrong.
    """
    table = presets.read(path) if path else Table({}, "no map")
    table.text("preset", "")  # the map that it builds on: already taken into it
    named = table.text("correction", None)
    correction = None if named is None else corrections.load(named, table.where)
    topics = table.table("topics")
    by_kind = {kind: topics.text(kind) for kind in KINDS if topics.has(kind)}
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
    has_iron = mag.has("hard_iron") or mag.has("soft_iron") or correction is not None
    unit = UNITS[mag.choice("unit", ["T", "uT", "nT", "G", "mG"], "T")]
    hard = mag.vector("hard_iron", [0.0, 0.0, 0.0]) * unit
    soft = mag.vector("soft_iron", np.eye(3).ravel().tolist(), size=9).reshape(3, 3)
    mag_mount = _rotation(mag)
    mag.close()
    imu = table.table("imu")
    gyro_unit = UNITS[imu.choice("gyro_unit", ["rad/s", "deg/s", "dps"], "rad/s")]
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
        topics=by_kind,
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
        correction=correction,
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
