"""State of the navigator, and what its parts share: parameters, memory, inputs. Aids add their own (`aids`)."""

from typing import Annotated

import numpy as np

from estimators.models.base import GROUPS, STATE
from estimators.native import Flag, Integer, Number, Record, Vector3, Vector4, shaped
from estimators.past import Ring
from estimators.turned import Turned

PHI, V, P_, BG, BA, SG, HI, WIND = 0, 3, 6, 9, 12, 15, 18, 21  # offsets in the error
LARGEST = 24  # components of the error
RING_ANGLES = (4, 6)  # of the values of the ring: longitude, yaw


class State(Record, size=STATE):
    """The raw state; a smaller model ends earlier."""

    q_nb: Vector4
    vel_n: Vector3  # m/s
    lla: Vector3  # rad, rad, m
    gyro_bias: Vector3  # rad/s
    accel_bias: Vector3  # m/s2
    gyro_scale: Vector3
    hard_iron: Vector3  # T
    wind_n: Vector3  # m/s


class Shared(Record):
    """Parameters that are not of one aid."""

    states: Integer  # components of the error: 15, 21 or 24
    gravity: Number  # m/s2 at `origin`
    origin: Vector3  # rad, rad, m
    mag_n: Vector3  # T
    antenna_b: Vector3  # m
    gyro_psd: Number  # rad2/s
    rate_noise: Number  # 2 tau k^2, s: gyro_psd + rate_noise |w|^2
    accel_psd: Number  # m2/s3
    accel_noise2: Number  # s, accel_psd + accel_noise2 |a|^2
    jerk_share: Number  # gyro_psd + jerk_share dt (variance between samples)
    shake_share: Number  # accel_psd + shake_share dt (variance between samples), at most `shake_most`
    shake_most: Number  # m2/s3
    beside2: Annotated[np.ndarray, shaped(2)]  # squared misalignment of gyro and accelerometer
    along2: Annotated[np.ndarray, shaped(2)]  # squared scale error that no state has
    walks: Annotated[np.ndarray, shaped(LARGEST - 9)]  # variance per second of the constants, and of the wind
    still_rate: Number  # rad/s, scatter of a still second
    still_force: Number  # m/s2
    place_walk: Vector3  # m2/s: the rest of a fix's error wanders, and the place with it
    place_wander: Vector3  # m2, variance of that: what the place is off besides, and no fix shows
    speed_min: Number  # m/s, an airspeed above is not wind on the ground
    velocity: Number  # m/s, sigma of the receiver's
    opened: Annotated[np.ndarray, shaped(LARGEST)]  # variances after a wrong heading
    report_place: Flag  # place and velocity are over the ground
    start: Annotated[np.ndarray, shaped(GROUPS, dtype=np.int64)]  # first row in z of each group of measurements
    rows: Annotated[np.ndarray, shaped(GROUPS, dtype=np.int64)]  # its rows
    angle: Annotated[np.ndarray, shaped(GROUPS, dtype=np.int64)]  # 1: its residual is wrapped


class Kept(Record):
    """Memory that is not of one aid; NaN: not yet."""

    t: Number  # s, last good sample of the IMU
    good: Flag  # the last sample was
    rate_b: Vector3  # rad/s, last good gyro
    accel_b: Vector3  # m/s2, last good force
    step_b: Vector3  # rad/s, how much the gyro has changed at last
    jerky: Number  # (rad/s)^2, variance of the gyro between samples
    shock_b: Vector3  # m/s2, how much the accelerometer has changed at last
    shaky: Number  # (m/s2)^2, variance of the accelerometer between samples
    second_t: Number  # s, when the present second began
    count: Number  # samples in it
    mean: Annotated[np.ndarray, shaped(6)]  # of gyro and accelerometer in it
    spread: Annotated[np.ndarray, shaped(6)]  # sums of squared deviations
    before: Annotated[np.ndarray, shaped(6)]  # mean of the second before
    is_still: Flag
    aid_t: Number  # s, when the velocity was last aided
    mag_t: Number  # s, when the field was last used
    fix_t: Number  # s, when a complete velocity was last received
    speed: Number  # m/s, of it
    fixed: Flag  # velocity and place are measured in this row
    ring: Ring  # the antenna's velocity and place, yaw, and what `turned` integrates
    turned: Turned  # the heading that motion shows
    q_nb: Vector4  # the attitude before the last row's measurements
    acceleration_n: Vector3  # m/s2
    steady_n: Vector3  # m/s2, its mean over the last moment
    late2: Number  # s2, variance of a delay of the fixes that has been learnt
    reopened: Flag  # the next step opens the covariance


class Motion(Record):
    """Inputs of a step."""

    rate_b: Vector3  # rad/s, mean gyro
    accel_b: Vector3  # m/s2, mean specific force
    mag_b: Vector3  # T, field as read
    gyro_psd: Number  # rad2/s, noise of the step
    accel_psd: Number  # m2/s3
    reopened: Number  # 1: the covariance is opened
    changed: Annotated[np.ndarray, shaped(6)]  # variances by which the biases have changed
    opened2: Annotated[np.ndarray, shaped(6)]  # m2/s2, m2: variances by which velocity and place are opened
