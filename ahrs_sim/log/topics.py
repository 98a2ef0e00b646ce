"""Layout of a flight's log: every topic with its type, its frame and the columns that go there.

Numbers are stored as float64, unchanged to the last bit; of the estimates covariances, sigmas, innovations and
adaptation are float32. Frames are `map_ned` and `base_link_frd`, tied to the `map` and `base_link` of
ROS by `/tf_static`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ahrs_sim.log.mcap.reader import quaternion, vector
from ahrs_sim.log.mcap.writer import LogChannel, LogWriter
from ahrs_sim.log.messages import LATER
from ahrs_sim.sensors.records import (
    AirRecord,
    FixRecord,
    HeadingRecord,
    ImuErrorsRecord,
    ImuRecord,
    MagRecord,
    PhaseRecord,
    PressureRecord,
    Record,
    VelocityRecord,
)
from ahrs_sim.turning import AVERAGE_S
from ahrs_sim.turning import RATE as TURN_RATE
from estimators.types import Columns

NED = "map_ned"
FRD = "base_link_frd"

TRUTH_RATE = 100.0  # Hz, of the truth in the log
TF_RATE = 50.0  # Hz, of the moving frame
PLOT_RATE = 10.0  # Hz, of attitudes and errors for plots
FIX_RATE = 5.0  # Hz, of the true position for maps
TEMPERATURE_EVERY = 50  # IMU messages

_UNKNOWN = np.r_[-1.0, np.zeros(8)]  # ROS for a field that is not reported
_HALF = float(np.sqrt(0.5))


@dataclass(frozen=True, slots=True)
class Route:
    """One topic and the columns of a block that go there.

    `fields` names a column for each field of the message, or column and index for one of its components.
    """

    topic: str
    type_name: str
    frame: str
    about: str
    fields: Mapping[str, str | tuple[str, int]] = field(default_factory=dict)
    constant: Mapping[str, Any] = field(default_factory=dict)

    def channel(self, writer: LogWriter, prefix: str = "") -> LogChannel:
        """Add the channel to a new log, its topic behind `prefix`."""
        return writer.add_channel(prefix + self.topic, self.type_name, constant=self.constant, frame_id=self.frame)

    def columns(self, block: Columns) -> dict[str, np.ndarray]:
        """Take the fields of messages from the columns of a block."""
        return {
            path: getattr(block, place) if isinstance(place, str) else getattr(block, place[0])[:, place[1]]
            for path, place in self.fields.items()
        }

    def put(self, columns: dict[str, np.ndarray], array: np.ndarray) -> None:
        """Put an array from `LogReader.read` into the columns of a block, in place."""
        for path, place in self.fields.items():
            if path in LATER and path not in (array.dtype.names or ()):
                continue
            values = array
            for name in path.split("."):
                values = values[name]
            if values.dtype.names:
                values = quaternion(values) if "w" in values.dtype.names else vector(values)
            if isinstance(place, str):
                columns[place][...] = values.reshape(columns[place].shape)
            else:
                columns[place[0]][:, place[1]] = values


ODOMETRY = Route(
    "/truth/odometry",
    "nav_msgs/msg/Odometry",
    NED,
    "Of the centre of gravity: position from where the flight began (m), attitude, velocity (m/s) and inertial "
    "rate (rad/s), both in body axes.",
    {"pose.pose.orientation": "q_nb"},
    {"child_frame_id": FRD},
)
TRUTH: tuple[Route, ...] = (
    ODOMETRY,
    Route(
        "/truth/imu",
        "sensor_msgs/msg/Imu",
        FRD,
        "What a perfect IMU at the centre of gravity reads: inertial rate (rad/s), specific force (m/s2, -9.81 on z at "
        "rest); and the attitude. Integrated at 100 Hz the rate gives the attitude back to 0.11 deg over the circuit; "
        "`truth_rate_hz = 400` in the scenario keeps every row (0.002 deg).",
        {"orientation": "q_nb", "angular_velocity": "rate_ib_b", "linear_acceleration": "accel_b"},
    ),
    Route(
        "/truth/state",
        "ahrs_sim_msgs/msg/TruthState",
        NED,
        "The rest of the state of motion.",
        {
            "lla": "lla",
            "velocity": "vel_n",
            "angular_acceleration": "rate_dot_b",
            "centre_of_gravity": "cg_b",
        },
    ),
    Route(
        "/truth/air",
        "ahrs_sim_msgs/msg/TruthAir",
        FRD,
        "Air, engine and wheels.",
        {
            "wind": "wind_n",
            **{
                name: name
                for name in (
                    [
                        "airspeed",
                        "alpha",
                        "beta",
                        "pressure",
                        "temperature",
                        "rpm",
                        "throttle",
                        "height_agl",
                        "on_ground",
                    ]
                )
            },
        },
    ),
)
TRUTH_FIX = Route(
    "/truth/fix",
    "sensor_msgs/msg/NavSatFix",
    FRD,
    f"The position for maps, deg and m above the ellipsoid, {FIX_RATE:g} Hz.",
    constant={"status": {"service": 1}},
)
TRUTH_ATTITUDE = Route(
    "/truth/attitude",
    "ahrs_sim_msgs/msg/Attitude",
    NED,
    f"Roll, pitch and heading for plots, {PLOT_RATE:g} Hz.",
)
TRUTH_TURN = Route(
    "/truth/turn",
    "ahrs_sim_msgs/msg/TurnSlip",
    FRD,
    f"Turn rate and slip over the last {AVERAGE_S:g} s, as a turn-and-slip indicator shows them, {TURN_RATE:g} Hz.",
    {"turn_rate": "turn_rate", "slip": "slip"},
)
TF = Route(
    "/tf",
    "tf2_msgs/msg/TFMessage",
    "",
    f"Where the aircraft is, `{NED}` to `{FRD}`, {TF_RATE:g} Hz.",
    constant={"transforms": [{"header": {"frame_id": NED}, "child_frame_id": FRD}]},
)
TF_STATIC = Route(
    "/tf_static",
    "tf2_msgs/msg/TFMessage",
    "",
    f"`map` (ENU) to `{NED}` and `{FRD}` to `base_link` (FLU), once at the beginning.",
    constant={
        "transforms": [
            {
                "header": {"frame_id": "map"},
                "child_frame_id": NED,
                "transform": {"rotation": (0.0, _HALF, _HALF, 0.0)},  # rpy(pi, 0, pi/2)
            },
            {
                # base_link hangs below base_link_frd: a frame has one parent, and that of base_link_frd is map_ned.
                "header": {"frame_id": FRD},
                "child_frame_id": "base_link",
                "transform": {"rotation": (0.0, 1.0, 0.0, 0.0)},  # rpy(pi, 0, 0), its own inverse
            },
        ]
    },
)

INSTRUMENTS: dict[str, tuple[type[Record], Route]] = {
    "imu": (
        ImuRecord,
        Route(
            "/imu/data_raw",
            "sensor_msgs/msg/Imu",
            FRD,
            "Angular rate (rad/s) and specific force (m/s2, -9.81 on z at rest) as measured.",
            {"angular_velocity": "gyro_b", "linear_acceleration": "accel_b"},
            {"orientation_covariance": _UNKNOWN},
        ),
    ),
    "imu_errors": (
        ImuErrorsRecord,
        Route(
            "/imu/errors",
            "ahrs_sim_msgs/msg/ImuErrors",
            FRD,
            "The true biases behind every message of the IMU, alone and with all that acts as one: for reports, not "
            "for estimators.",
            {name: name for name in ("gyro_bias", "accel_bias", "gyro_effective_bias", "accel_effective_bias")},
        ),
    ),
    "mag": (
        MagRecord,
        Route("/imu/mag", "sensor_msgs/msg/MagneticField", FRD, "Magnetic field, T.", {"magnetic_field": "mag_b"}),
    ),
    "fix": (
        FixRecord,
        Route(
            "/gps/fix",
            "sensor_msgs/msg/NavSatFix",
            FRD,
            "Latitude and longitude in deg, height above the ellipsoid in m, covariance in m2 (east, north, up) as the "
            "receiver reports it.",
            {
                "status.status": "fix",
                "latitude": ("lla_deg", 0),
                "longitude": ("lla_deg", 1),
                "altitude": ("lla_deg", 2),
            },
            {"status": {"service": 1}, "position_covariance_type": 2},
        ),
    ),
    "velocity": (
        VelocityRecord,
        Route(
            "/gps/vel",
            "geometry_msgs/msg/TwistStamped",
            NED,
            "Velocity relative to the Earth, m/s, north, east, down.",
            {"twist.linear": "vel_n"},
        ),
    ),
    "heading": (
        HeadingRecord,
        Route(
            "/gps/heading",
            "ahrs_sim_msgs/msg/Heading",
            NED,
            "Heading of a two-antenna receiver.",
            {"heading": "heading", "sigma": "sigma", "satellites": "satellites"},
        ),
    ),
    "diff_pressure": (
        PressureRecord,
        Route(
            "/air/diff_pressure",
            "sensor_msgs/msg/FluidPressure",
            FRD,
            "Pitot minus static pressure, Pa.",
            {"fluid_pressure": "pressure"},
        ),
    ),
    "static_pressure": (
        PressureRecord,
        Route(
            "/air/static_pressure",
            "sensor_msgs/msg/FluidPressure",
            FRD,
            "Static pressure, Pa.",
            {"fluid_pressure": "pressure"},
        ),
    ),
    "air": (
        AirRecord,
        Route(
            "/air/data",
            "ahrs_sim_msgs/msg/AirData",
            FRD,
            "What the air data computer makes of the pressures.",
            {name: name for name in ("indicated_airspeed", "airspeed", "alpha", "beta")},
        ),
    ),
    "interferometer": (
        PhaseRecord,
        Route(
            "/interferometer/phase",
            "ahrs_sim_msgs/msg/EmitterPhase",
            FRD,
            "Two-antenna interferometer on a ground emitter.",
            {name: name for name in ("phase", "phase_rate", "bearing")},
        ),
    ),
}
"""Block type and topic of each instrument of a suite; the topic goes behind `/<suite>`."""

RECEIVED = ("imu", "mag", "fix", "velocity", "heading", "air")
"""Instruments whose records estimators use."""

STATUS: dict[str, Route] = {
    instrument: Route(topic, "ahrs_sim_msgs/msg/SensorStatus", FRD, about, fields)
    for instrument, topic, about, fields in (
        (
            "imu",
            "/imu/status",
            "First message of the IMU, then each at which `saturated` changes.",
            {"saturated": "saturated"},
        ),
        ("mag", "/imu/mag_status", "The same for the magnetometer.", {"saturated": "saturated"}),
        ("fix", "/gps/status", "Satellites behind every fix.", {"satellites": "satellites"}),
    )
}
TEMPERATURE = Route(
    "/imu/temperature",
    "sensor_msgs/msg/Temperature",
    FRD,
    f"Of the IMU's chip, deg C, every {TEMPERATURE_EVERY}th message.",
)

STATE = Route(
    "/state",
    "ahrs_sim_msgs/msg/EstimatorState",
    NED,
    "All estimates with their uncertainties, one message per IMU sample.",
    {
        "status": "status",
        "orientation": "q_nb",
        "down": "down_b",
        "gyro_bias": "gyro_bias",
        "accel_bias": "accel_bias",
        "lla": "lla",
        "velocity": "vel_n",
        "attitude_covariance": "att_cov",
        "position_covariance": "pos_cov",
        "velocity_covariance": "vel_cov",
        "gyro_bias_sigma": "gyro_bias_sigma",
        "accel_bias_sigma": "accel_bias_sigma",
        "innovation": "innovation",
        "innovation_variance": "innovation_var",
        "adaptation": "adaptation",
    },
)
ESTIMATED_IMU = Route(
    "/imu",
    "sensor_msgs/msg/Imu",
    FRD,
    f"The same attitude for viewers, `{FRD}` to `{NED}`, with its covariance (rad2; 0: not known); absent while there "
    "is none.",
    {"orientation": "q_nb"},
    {"angular_velocity_covariance": _UNKNOWN, "linear_acceleration_covariance": _UNKNOWN},
)
ATTITUDE = Route(
    "/attitude",
    "ahrs_sim_msgs/msg/Attitude",
    NED,
    f"Roll, pitch and heading for plots, {PLOT_RATE:g} Hz.",
)
TURN = Route(
    "/turn",
    "ahrs_sim_msgs/msg/TurnSlip",
    FRD,
    f"Turn rate and slip as of the truth: of its vertical, and of its IMU less its biases, {TURN_RATE:g} Hz.",
    {"turn_rate": "turn_rate", "slip": "slip"},
)
BIASES = Route(
    "/biases",
    "ahrs_sim_msgs/msg/Biases",
    FRD,
    f"Biases for plots, {PLOT_RATE:g} Hz.",
    {"gyro_bias": "gyro_bias", "accel_bias": "accel_bias"},
)
ERRORS = Route(
    "/errors",
    "ahrs_sim_msgs/msg/AttitudeErrors",
    NED,
    f"How wrong it is, for plots, {PLOT_RATE:g} Hz: against the truth, in the replay of a bag against its reference.",
)
ESTIMATES = (STATE, ESTIMATED_IMU, ATTITUDE, BIASES, TURN, ERRORS)
"""What goes behind `/est/<name>`."""

REFERENCE = Route(
    "/reference/imu",
    "sensor_msgs/msg/Imu",
    FRD,
    f"The reference attitude of a bag that was replayed, `{FRD}` to `{NED}`.",
    {"orientation": "q_nb"},
    {"angular_velocity_covariance": _UNKNOWN, "linear_acceleration_covariance": _UNKNOWN},
)
SETPOINTS = Route(
    "/pilot/setpoints",
    "ahrs_sim_msgs/msg/Setpoints",
    NED,
    "What the pilot asks of the autopilot, and where the surfaces are.",
    {name: name for name in ("step", "roll", "pitch", "heading", "altitude", "climb_rate", "airspeed", "surfaces")},
)
EVENTS = Route("/events", "ahrs_sim_msgs/msg/Event", "", "Worth knowing: a step begins, a fault sets in, a crash.")
