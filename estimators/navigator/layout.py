"""What the navigator estimates, and what it is given.

Nominal state: attitude `q_nb` (4), velocity NED (3, m/s), latitude, longitude (rad), height (m), and constants, which
have the same offsets as in the error state. Error state of N components in the order below; the attitude error phi is a
small rotation in navigation axes, `q = exp_q(phi) (x) q_estimated`, that of the place is in metres NED.

    gyro    y = (I + M_g) w + b + b_10 + b_100 + noise          accelerometer   y = (I + M_a) f + b + noise
    field   y = (I + M_m) C_bn (B + dB) + h + noise             fix             p = place + wander + noise
    baseline heading = azimuth of C_nb (1, yaw error, -pitch error) + wander + noise
    a fix that says it was true at t was true at t - late

M are full matrices: scale factors on the diagonal, misalignment, cross-axis sensitivity and soft iron beside it. Their
error E is a factor, `I + M = (I + M_estimated) (I + E)`: a rotation of all three sensors and the attitude together,
which no reading shows, is then the same direction of the error state whatever has been estimated, and the filter does
not become certain of it.

How errors grow with rate and force is taken from their mean over a moment where the unit is shaken
(`loop.keep_steady`): vibration that the sampling folds down is in no aid, and the matrices would be fitted to it. For
the same reason a delay is seen in accelerations that last, and a reading of the field counts less there (`mag_shake`).
"""

from typing import Annotated, Any

import numpy as np

from estimators.native import Address, Flag, Integer, Matrix3, Number, Record, Vector3, Vector4, joined, shaped
from estimators.past import Ring
from estimators.turned import Turned

PHI, VEL, POS = 0, 3, 6
GYRO_BIAS, GYRO_FAST, GYRO_SLOW, ACCEL_BIAS = 9, 12, 15, 18
GYRO_MATRIX, ACCEL_MATRIX, HARD_IRON, MAG_MATRIX, FIELD = 21, 30, 39, 42, 51
WANDER, BASELINE, LATE = 54, 57, 60  # BASELINE: wander, yaw and pitch of its mounting
N = 61
MOVING = 9  # components that move by themselves
SMOOTHED = 21  # components that a smoother gives: to the bias of the accelerometer
COUPLED = HARD_IRON  # those before it act on them
FAST_TIME, SLOW_TIME = 10.0, 100.0  # s, of the terms of the gyro's bias in run

Errors = Annotated[np.ndarray, shaped(N)]
Covariance = Annotated[np.ndarray, shaped(N, N)]
Pairs3 = Annotated[np.ndarray, shaped(2, 3)]
Transition = Annotated[np.ndarray, shaped(MOVING, COUPLED)]


class Parameters(Record):
    """Holds the parameters that are constant during a flight."""

    gravity: Number  # m/s2 at `origin`
    origin: Vector3  # rad, rad, m
    mag_n: Vector3  # T
    antenna_b: Vector3  # m
    gyro_psd: Number  # rad2/s
    rate_noise: Number  # s: gyro_psd + rate_noise |w|^2
    jerk_share: Number  # gyro_psd + jerk_share dt (variance between samples)
    accel_psd: Number  # m2/s3
    shake_share: Number  # accel_psd + shake_share dt (variance between samples), at most `shake_most`
    shake_most: Number  # m2/s3
    accel_noise2: Number  # s, accel_psd + accel_noise2 |a|^2
    decay: Errors  # 1/s: zero for a constant
    walk: Errors  # variance per second of what walks
    settled: Errors  # variance of what decays
    iron_step: Number  # T2, of the hard iron when the aircraft sets off: the motor's current
    still_rate: Number  # rad/s, scatter of a still second
    still_force: Number  # m/s2, likewise
    gnss_velocity: Number  # m/s
    gnss_position: Number  # m, from fix to fix
    gnss_time: Number  # s, of the time of a fix, from fix to fix
    mag_noise: Number  # T, of one sample
    mag_floor: Number  # T, of one use of the field, whatever the number of samples
    mag_shake: Number  # T s2, besides, of the gyro's variance between samples
    gyro_delay: Number  # s: estimates are turned on by so much, to the stamp
    accel_delay: Number  # s: and moved on by so much
    baseline_share: Number  # of the reported sigma that is white
    surprise: Number  # of a measurement, per degree of freedom: beyond, its noise is taken as larger
    field_off: Number  # rad, of the field's heading against motion's: it is given up
    use_heading: Flag


class Nominal(Record):
    """The state, updated in place."""

    q: Vector4  # q_nb
    v: Vector3  # m/s NED
    lla: Vector3  # rad, rad, m
    c: Errors  # the constants, at their offsets; the first nine unused


class Memory(Record):
    """Carries what is kept from row to row beside the state."""

    last_t: Number  # s, of the last row; every time is NaN before the first
    good_t: Number  # s, of the last row whose rate and force are good
    batch_t: Number  # s, when the covariance was last propagated
    aid_t: Number  # s, of the last aid
    fix_t: Number  # s, of the last fix
    mag_t: Number  # s, of the last use of the field
    wrong_baseline_t: Number  # s, of the last baseline that was left out
    second_t: Number  # s, when the present second began
    last: Pairs3  # last good rate and force
    mean: Pairs3  # mean rate and force of the step
    step: Pairs3  # rad/s, m/s2: last changes of rate and force
    steady: Pairs3  # rad/s, m/s2 NED: rate and force without what vibrates
    second: Annotated[np.ndarray, shaped(2, 6)]  # mean and spread of the present second
    count: Number  # rows in the present second
    good: Number  # 1: rate and force of the last row are good
    jerk: Number  # rad2/s2, variance of the gyro between samples
    shake: Number  # m2/s4, of the accelerometer
    still: Number  # 1: the last second was
    was_still: Number  # before the last batch
    speed: Number  # m/s, of the last fix
    surprise: Number  # square of the last innovation by its variance, per degree of freedom
    field_noise: Number  # factor of the field's variance that its innovations ask for
    speed_noise: Number  # of the receiver's
    turned: Turned  # the heading that motion shows
    past: Ring  # the antenna's velocity and place, the yaw, and the velocity that the gyro alone carries (`turned`)


class Batch(Record):
    """Accumulates the motion since the covariance was last propagated."""

    F: Transition  # of the moving components; the others keep
    seconds: Number
    gyro_variance: Number  # rad2
    force_variance: Number  # m2/s2
    fields: Number  # readings of the field in it
    field: Vector3  # T, sum of measured minus predicted field
    read: Annotated[np.ndarray, shaped(2)]  # T, sum of the readings as they are, north and east
    field_slope: Annotated[np.ndarray, shaped(3, N)]  # sum of its slopes
    rate: Vector3  # rad, turned in it, the Earth's turning taken off


class Carry(Record):
    """Everything that goes on from row to row."""

    nominal: Nominal
    P: Covariance
    P_restart: Covariance  # when the filter is lost
    batch: Batch
    memory: Memory
    safe: Nominal  # when the covariance was last sound


class Work(Record):
    """Scratch, nothing to keep."""

    tape: Address  # a `Tape`
    G: Annotated[np.ndarray, shaped(MOVING, N)]
    gain: Errors
    dx: Errors
    at: Annotated[np.ndarray, shaped(3, N, dtype=np.int64)]  # columns of a slope that are not zero
    by: Annotated[np.ndarray, shaped(3, N)]  # their values
    terms: Annotated[np.ndarray, shaped(3, dtype=np.int64)]
    residual: Vector3
    variance: Vector3
    S: Matrix3
    C: Matrix3  # C_bn
    keep: Errors  # what is left of the constants after a batch

    @classmethod
    def make(cls, tape: Any) -> Any:
        """Make the memory, with a tape (`tape`)."""
        kinds = {name: cls.dtype[name] for name in cls.dtype.names or () if name != "tape"}
        return joined(cls, {"tape": tape}, {name: np.zeros(kind.shape, kind.base) for name, kind in kinds.items()})


class Tape(Record):
    """What the smoother needs of each batch and each measurement; see `smoother`."""

    batches: Address  # of `NotedBatch`, `room` of them
    numbers: Address  # of `NotedNumber`, sixteen times as many
    room: Integer  # 0: nothing is noted
    batch: Integer  # how many batches there are
    number: Integer  # how many numbers


class NotedBatch(Record):
    """A batch on the tape."""

    row: Integer  # with which it ended
    first: Integer  # its first number
    lost: Integer  # 1: begun anew
    F: Transition
    keep: Errors
    dx: Annotated[np.ndarray, shaped(SMOOTHED)]  # the correction
    P: Annotated[np.ndarray, shaped(SMOOTHED, N)]  # afterwards


class NotedNumber(Record):
    """A measured number on the tape."""

    slope: Errors
    gain: Errors  # covariance with the number
    innovation: Number
    variance: Number  # of it


NUMBERS = 16  # for each batch


def tape(room: int = 0) -> Any:
    """Make a `Tape` for a number of batches, and their memory (kept by the caller): tape, batches, numbers."""
    batches, numbers = np.zeros(room, NotedBatch.dtype), np.zeros(NUMBERS * room, NotedNumber.dtype)
    parts, counts = {"batches": batches, "numbers": numbers}, {"room": room, "batch": 0, "number": 0}
    return joined(Tape, parts, counts), batches, numbers


PARAMETERS, CARRY, WORK = Parameters.dtype, Carry.dtype, Work.dtype
TAPE, NOTED_BATCH, NOTED_NUMBER = Tape.dtype, NotedBatch.dtype, NotedNumber.dtype
