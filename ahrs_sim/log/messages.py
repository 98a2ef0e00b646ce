"""The messages of our logs: standard ROS 2 types where they exist, `ahrs_sim_msgs` with fixed arrays for the rest.

To add a type, write its definition into `_DEFINITIONS`, one field a line with unit and frame as comment: the comment
travels in every log's schema and into `logs/README.md`.
"""

import functools
from typing import Any

import numpy as np

from ahrs_sim.log.mcap.cdr import Definitions, message_dtype, parse_definitions, short_name

LONGEST_S = 7 * 86400.0
"""Longest flight or recording, s: a limit for whoever makes grids of time."""

_DEFINITIONS = """
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
MSG: geometry_msgs/PoseStamped
std_msgs/Header header
geometry_msgs/Pose pose
MSG: geometry_msgs/PoseWithCovarianceStamped
std_msgs/Header header
geometry_msgs/PoseWithCovariance pose
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance
MSG: geometry_msgs/TwistStamped
std_msgs/Header header
geometry_msgs/Twist twist
MSG: geometry_msgs/Vector3Stamped
std_msgs/Header header
geometry_msgs/Vector3 vector
MSG: geometry_msgs/QuaternionStamped
std_msgs/Header header
geometry_msgs/Quaternion quaternion
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
MSG: tf2_msgs/TFMessage
geometry_msgs/TransformStamped[] transforms
MSG: nav_msgs/Odometry
std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
MSG: sensor_msgs/Imu
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
MSG: sensor_msgs/MagneticField
std_msgs/Header header
geometry_msgs/Vector3 magnetic_field
float64[9] magnetic_field_covariance
MSG: sensor_msgs/NavSatStatus
int8 STATUS_NO_FIX=-1
int8 STATUS_FIX=0
int8 STATUS_SBAS_FIX=1
int8 STATUS_GBAS_FIX=2
int8 status
uint16 SERVICE_GPS=1
uint16 SERVICE_GLONASS=2
uint16 SERVICE_COMPASS=4
uint16 SERVICE_GALILEO=8
uint16 service
MSG: sensor_msgs/NavSatFix
std_msgs/Header header
sensor_msgs/NavSatStatus status
float64 latitude
float64 longitude
float64 altitude
float64[9] position_covariance
uint8 COVARIANCE_TYPE_UNKNOWN=0
uint8 COVARIANCE_TYPE_APPROXIMATED=1
uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2
uint8 COVARIANCE_TYPE_KNOWN=3
uint8 position_covariance_type
MSG: sensor_msgs/FluidPressure
std_msgs/Header header
float64 fluid_pressure
float64 variance
MSG: sensor_msgs/Temperature
std_msgs/Header header
float64 temperature
float64 variance
MSG: ahrs_sim_msgs/TruthState
std_msgs/Header header
float64[3] lla # rad, rad, m: geodetic latitude, longitude, ellipsoidal height (WGS84) of the centre of gravity
geometry_msgs/Vector3 velocity # m/s, NED, relative to the Earth
geometry_msgs/Vector3 angular_acceleration # rad/s2, FRD, derivative of the inertial body rate
geometry_msgs/Vector3 centre_of_gravity # m, FRD axes, in the aircraft's reference frame
MSG: ahrs_sim_msgs/TruthAir
std_msgs/Header header
float64 airspeed # m/s, true
float64 alpha # rad, angle of attack
float64 beta # rad, sideslip
geometry_msgs/Vector3 wind # m/s, NED, velocity of the air, gusts and turbulence included
float64 pressure # Pa, static
float64 temperature # K
float64 rpm # 1/min, propeller
float64 throttle # 0..1
float64 height_agl # m above ground
bool on_ground # weight on any wheel
MSG: ahrs_sim_msgs/Heading
std_msgs/Header header
float64 heading # rad, true heading of the antenna baseline
float64 sigma # rad, one sigma as the receiver reports it
uint8 satellites # in use
MSG: ahrs_sim_msgs/AirData
std_msgs/Header header
float64 indicated_airspeed # m/s
float64 airspeed # m/s, true
float64 alpha # rad, angle of attack; NaN without a vane
float64 beta # rad, sideslip; NaN without a vane
MSG: ahrs_sim_msgs/EmitterPhase
std_msgs/Header header
float64 phase # rad, modulo 2 pi, between the two antennas
float64 phase_rate # rad/s
float64 bearing # rad, coarse bearing from the amplitudes
MSG: ahrs_sim_msgs/SensorStatus
std_msgs/Header header
bool saturated # an axis is at the end of its range
uint8 satellites # in use; 0 for instruments that need none
MSG: ahrs_sim_msgs/ImuErrors
std_msgs/Header header
geometry_msgs/Vector3 gyro_bias # rad/s, FRD, true bias of the gyro: turn-on, in-run, temperature
geometry_msgs/Vector3 accel_bias # m/s2, FRD, true bias of the accelerometer
geometry_msgs/Vector3 gyro_effective_bias # rad/s, FRD, what acts as a bias: with g-sensitivity
geometry_msgs/Vector3 accel_effective_bias # m/s2, FRD, the same: with scale and misalignment times g
MSG: ahrs_sim_msgs/EstimatorState
std_msgs/Header header
uint8 ALIGNING=0
uint8 RUNNING=1
uint8 COASTING=2
uint8 DIVERGED=3
uint8 status # 0 aligning, 1 running, 2 coasting, 3 diverged
geometry_msgs/Quaternion orientation # body FRD to NED, Hamilton; NaN without a heading
geometry_msgs/Vector3 down # unit down vector in body axes: the tilt alone
geometry_msgs/Vector3 gyro_bias # rad/s, FRD
geometry_msgs/Vector3 accel_bias # m/s2, FRD
float64[3] lla # rad, rad, m
geometry_msgs/Vector3 velocity # m/s, NED
float32[9] attitude_covariance # rad2, row by row, of the small rotation in body axes
float32[9] position_covariance # m2, row by row, north, east, down, wander of the fixes included
float32[9] velocity_covariance # m2/s2, row by row, north, east, down
float32[3] gyro_bias_sigma # rad/s
float32[3] accel_bias_sigma # m/s2
float32[12] innovation # decorrelated, in the units of the method's measurements; NaN where unused
float32[12] innovation_variance # of the above; NIS is the sum of innovation^2 / innovation_variance
float32[4] adaptation # state of the adaptation policy, meaning by method
MSG: ahrs_sim_msgs/Attitude
std_msgs/Header header
float64 roll # rad
float64 pitch # rad
float64 heading # rad, true, 0 to 2 pi; NaN without one
MSG: ahrs_sim_msgs/AttitudeErrors
std_msgs/Header header
float64 roll # rad, estimate less truth, as pitch and heading; heading NaN without one
float64 pitch # rad
float64 heading # rad, -pi to pi
float64 tilt # rad, angle between the two verticals
float64 total # rad, angle of the whole rotation; NaN without a heading
float64 roll_sigma # rad, one sigma as the estimator claims it; NaN where it claims none
float64 pitch_sigma # rad
float64 heading_sigma # rad
MSG: ahrs_sim_msgs/Biases
std_msgs/Header header
geometry_msgs/Vector3 gyro_bias # rad/s, FRD; NaN where it is not estimated
geometry_msgs/Vector3 accel_bias # m/s2, FRD; NaN where it is not estimated
MSG: ahrs_sim_msgs/TurnSlip
std_msgs/Header header
float64 turn_rate # rad/s, of the heading, positive to the right; NaN while not known
float64 slip # rad, angle of the ball, positive to the right; NaN while not known
MSG: ahrs_sim_msgs/Setpoints
std_msgs/Header header
int32 step # of the scenario, from 0
float64 roll # rad; every set-point is NaN while not in use
float64 pitch # rad
float64 heading # rad, true
float64 altitude # m
float64 climb_rate # m/s
float64 airspeed # m/s
float64[4] surfaces # aileron, elevator, rudder (-1..1, positive right, up, right), throttle (0..1)
MSG: ahrs_sim_msgs/Event
std_msgs/Header header
string level # info, warning or error
string name # who: pilot, flight, fault, an estimator
string text # one line
"""


@functools.cache
def _texts() -> dict[str, str]:
    """Collect definition texts by `package/Type`."""
    parts = [part.partition("\n") for part in _DEFINITIONS.split("MSG: ")[1:]]
    return {name.strip(): body for name, _, body in parts}


def type_names() -> list[str]:
    """List every type that can be written, as `package/msg/Type`."""
    return [name.replace("/", "/msg/") for name in _texts()]


def definition(type_name: str) -> str:
    """Give the text of one type's own definition, without its dependencies.

    Raises:
        KeyError: not one of `type_names`.
    """
    return _texts()[short_name(type_name)]


@functools.cache
def definitions(type_name: str) -> Definitions:
    """Parse the definitions of a type and all it needs."""
    everything = f"\n{'=' * 80}\n".join(f"MSG: {name}\n{text}" for name, text in _texts().items())
    return parse_definitions(type_name, f"{definition(type_name)}\n{everything}")


LATER = ("gyro_effective_bias", "accel_effective_bias", "position_covariance", "velocity_covariance")
"""Fields of our own types that logs of version 0.1.0 have not; what they fill stays NaN."""


def difference(type_name: str, dtype: np.dtype[Any]) -> str:
    """Name the field of a type that is missing or of another kind in a foreign definition of it.

    Args:
        type_name: `package/msg/Type`.
        dtype: of its messages as read; more fields than expected do no harm.

    Returns:
        The field and what is wrong with it; empty when nothing is, or when the type is none of ours.
    """
    if short_name(type_name) not in _texts():
        return ""
    later = LATER if short_name(type_name).startswith("ahrs_sim_msgs/") else ()
    return _differs(message_dtype(definitions(type_name), type_name), dtype, "", later)


def _differs(expected: np.dtype[Any], found: np.dtype[Any], path: str, later: tuple[str, ...]) -> str:
    if expected.shape != found.shape:
        return f"field {path} has {found.shape or 'no'} elements instead of {expected.shape or 'none'}"
    expected, found = expected.base, found.base
    if expected.names is None or found.names is None:
        alike = expected.kind == found.kind or {expected.kind, found.kind} <= set("biuf")
        return "" if alike else f"field {path} is of another kind"
    for name in expected.names:
        inner = f"{path}.{name}" if path else name
        if name not in found.names:
            if inner in later:
                continue
            return f"field {inner} is missing"
        if wrong := _differs(expected[name], found[name], inner, later):
            return wrong
    return ""


def schema_text(type_name: str) -> str:
    """Make the `ros2msg` schema of a type: its definition and, behind 80 `=` each, those of its dependencies."""
    first, *rest = definitions(type_name)
    parts = [definition(first), *(f"MSG: {name}\n{definition(name)}" for name in rest)]
    return ("=" * 80 + "\n").join(parts)
