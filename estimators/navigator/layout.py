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
"""

from typing import NamedTuple

import numpy as np

from estimators.navigator.history import History
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


class Rows(NamedTuple):
    """The columns of `Samples` that are used, contiguous."""

    t: np.ndarray
    gyro_b: np.ndarray
    accel_b: np.ndarray
    mag_b: np.ndarray
    mag_new: np.ndarray
    lla: np.ndarray
    vel_n: np.ndarray
    gnss_t: np.ndarray
    gnss_new: np.ndarray
    heading: np.ndarray
    heading_sigma: np.ndarray
    heading_t: np.ndarray
    heading_new: np.ndarray


class Answers(NamedTuple):
    """The columns of `Estimates`, to be filled."""

    t: np.ndarray
    status: np.ndarray
    q_nb: np.ndarray
    down_b: np.ndarray
    att_cov: np.ndarray
    gyro_bias: np.ndarray
    gyro_bias_sigma: np.ndarray
    accel_bias: np.ndarray
    accel_bias_sigma: np.ndarray
    lla: np.ndarray
    vel_n: np.ndarray
    pos_cov: np.ndarray
    vel_cov: np.ndarray
    innovation: np.ndarray
    innovation_var: np.ndarray
    adaptation: np.ndarray


class Parameters(NamedTuple):
    """Holds the parameters that are constant during a flight."""

    gravity: float  # m/s2 at `origin`
    origin: np.ndarray  # (3,) rad, rad, m
    mag_n: np.ndarray  # (3,) T
    antenna_b: np.ndarray  # (3,) m
    gyro_psd: float  # rad2/s
    rate_noise: float  # s: gyro_psd + rate_noise |w|^2
    jerk_share: float  # gyro_psd + jerk_share dt (variance between samples)
    accel_psd: float  # m2/s3
    shake_share: float  # accel_psd + shake_share dt (variance between samples), at most `shake_most`
    shake_most: float  # m2/s3
    accel_noise2: float  # s, accel_psd + accel_noise2 |a|^2
    decay: np.ndarray  # (N,) 1/s: zero for a constant
    walk: np.ndarray  # (N,) variance per second of what walks
    settled: np.ndarray  # (N,) variance of what decays
    iron_step: float  # T2, of the hard iron when the aircraft sets off: the motor's current
    still: np.ndarray  # (2,) rad/s, m/s2: scatter of a still second
    gnss_velocity: float  # m/s
    gnss_position: float  # m, from fix to fix
    gnss_time: float  # s, of the time of a fix, from fix to fix
    mag_noise: float  # T, of one sample
    mag_floor: float  # T, of one use of the field, whatever the number of samples
    gyro_delay: float  # s: estimates are turned on by so much, to the stamp
    accel_delay: float  # s: and moved on by so much
    baseline_share: float  # of the reported sigma that is white
    surprise: float  # of a measurement, per degree of freedom: beyond, its noise is taken as larger
    field_off: float  # rad, of the field's heading against motion's: it is given up
    use_heading: bool


class Nominal(NamedTuple):
    """The state, updated in place."""

    q: np.ndarray  # (4,) q_nb
    v: np.ndarray  # (3,) m/s NED
    lla: np.ndarray  # (3,) rad, rad, m
    c: np.ndarray  # (N,) the constants, at their offsets; the first nine unused


class Memory(NamedTuple):
    """Carries what is kept from row to row beside the state."""

    clock: np.ndarray  # (CLOCKS,) s
    last: np.ndarray  # (2, 3) last good rate and force
    mean: np.ndarray  # (2, 3) mean rate and force of the step
    step: np.ndarray  # (2, 3) rad/s, m/s2: last changes of rate and force
    second: np.ndarray  # (2, 6) mean and spread of the present second
    seen: np.ndarray  # (SEEN,)
    turned: Turned  # the heading that motion shows
    history: History


T_LAST, T_GOOD, T_BATCH, T_AID, T_GNSS, T_MAG, T_SECOND, CLOCKS = range(8)
GOOD, JERK, SHAKE, COUNT, IS_STILL, WAS_STILL, SPEED, SURPRISE, SEEN = range(9)


class Batch(NamedTuple):
    """Accumulates the motion since the covariance was last propagated."""

    F: np.ndarray  # (MOVING, COUPLED) transition of the moving components; the others keep
    total: np.ndarray  # (TOTALS,)
    field: np.ndarray  # (3,) T, sum of measured minus predicted field
    read: np.ndarray  # (2,) T, sum of the readings as they are, north and east
    field_slope: np.ndarray  # (3, N) sum of its slopes
    rate: np.ndarray  # (3,) rad, turned in it, the Earth's turning taken off


GYRO_VARIANCE, FORCE_VARIANCE, SECONDS, FIELDS, TOTALS = range(5)


class Tape(NamedTuple):
    """Records what the smoother needs of each batch and each measurement; see `smoother`."""

    used: np.ndarray  # (2,) int64: batches, numbers
    row: np.ndarray  # (batches,) int64, with which it ended
    first: np.ndarray  # (batches,) int64, its first number
    lost: np.ndarray  # (batches,) bool: begun anew
    F: np.ndarray  # (batches, MOVING, COUPLED)
    keep: np.ndarray  # (batches, N) what is left of the constants
    dx: np.ndarray  # (batches, SMOOTHED) the correction
    P: np.ndarray  # (batches, SMOOTHED, N) afterwards
    slope: np.ndarray  # (numbers, N)
    gain: np.ndarray  # (numbers, N), covariance with the number
    innovation: np.ndarray  # (numbers, 2) and its variance

    @classmethod
    def make(cls, batches: int) -> "Tape":
        """Make a tape for a number of batches; 0 keeps nothing."""
        numbers = 16 * batches
        return cls(
            np.zeros(2, np.int64),
            np.zeros(batches, np.int64),
            np.zeros(batches, np.int64),
            np.zeros(batches, bool),
            np.zeros((batches, MOVING, COUPLED)),
            np.ones((batches, N)),
            np.zeros((batches, SMOOTHED)),
            np.zeros((batches, SMOOTHED, N)),
            np.zeros((numbers, N)),
            np.zeros((numbers, N)),
            np.zeros((numbers, 2)),
        )


class Work(NamedTuple):
    """Scratch, nothing to keep; and the tape, empty for a filter."""

    G: np.ndarray  # (MOVING, N)
    gain: np.ndarray  # (N,)
    dx: np.ndarray  # (N,)
    at: np.ndarray  # (3, N) int64, columns of a slope that are not zero
    by: np.ndarray  # (3, N) their values
    terms: np.ndarray  # (3,) int64
    residual: np.ndarray  # (3,)
    variance: np.ndarray  # (3,)
    S: np.ndarray  # (3, 3)
    C: np.ndarray  # (3, 3) C_bn
    keep: np.ndarray  # (N,)
    tape: Tape

    @classmethod
    def make(cls, batches: int = 0) -> "Work":
        """Make the memory, with room on the tape for a number of batches."""
        return cls(
            np.zeros((MOVING, N)),
            np.zeros(N),
            np.zeros(N),
            np.zeros((3, N), np.int64),
            np.zeros((3, N)),
            np.zeros(3, np.int64),
            np.zeros(3),
            np.zeros(3),
            np.zeros((3, 3)),
            np.zeros((3, 3)),
            np.ones(N),
            Tape.make(batches),
        )
