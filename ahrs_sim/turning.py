"""Turn rate and slip, as a turn-and-slip indicator shows them: of the truth, and of what any estimator reports.

turn rate = (w_y d_y + w_z d_z) / (d_y^2 + d_z^2),   slip = atan2(-f_y, -f_z)

w is the angular rate, f the specific force, d the unit down vector, all in body axes and averaged over the last
`AVERAGE_S`. The first is the rate of the Euler angle heading, (q sin roll + r cos roll) / cos pitch (Stevens, Lewis and
Johnson, Aircraft Control and Simulation, 2016, section 1.4). The second is the angle of the ball: zero in coordinated
flight, positive when the ball is to the right, as it is when the air comes from the right with the wings level.
Estimators report neither; rate and force are those of their IMU less the biases that they have learnt.
"""

from dataclasses import dataclass

import numpy as np

from ahrs_sim.evaluation.decimate import Decimator
from estimators.types import Columns, Estimates, Samples, column

RATE = 10.0
"""Hz."""

AVERAGE_S = 1.0
"""s: what is faster is vibration or gust, and no indicator follows it."""

STEEP2 = 0.1**2
"""Squared cosine of pitch below which the heading jumps while the attitude does not: no turn rate there."""

FLOATS = 1.0
"""m/s2 of specific force upwards below which the ball has no place."""


@dataclass(frozen=True, slots=True)
class Turning(Columns):
    """Turn rate and slip, `RATE` rows a second; NaN where they are not known."""

    t: np.ndarray = column()  # (n,) s
    turn_rate: np.ndarray = column()  # (n,) rad/s, positive to the right
    slip: np.ndarray = column()  # (n,) rad, positive: the ball is to the right


class TurnAndSlip:
    """Makes `Turning` of a stream in blocks; the bits do not depend on how the stream is cut."""

    def __init__(self) -> None:
        self._t = np.empty(0)
        self._values = np.empty((0, 3))  # of the last `AVERAGE_S`: rate of the heading, f_y, f_z
        self._rows = Decimator(RATE)

    def add(self, t: np.ndarray, rate_b: np.ndarray, force_b: np.ndarray, down_b: np.ndarray) -> Turning:
        """Take a block.

        Args:
            t: (n,) s, rising.
            rate_b: (n, 3) rad/s, body axes.
            force_b: (n, 3) m/s2, specific force.
            down_b: (n, 3) unit down vector; NaN where the attitude is not known.
        """
        across2 = down_b[:, 1] ** 2 + down_b[:, 2] ** 2
        with np.errstate(invalid="ignore", divide="ignore"):
            rate = (rate_b[:, 1] * down_b[:, 1] + rate_b[:, 2] * down_b[:, 2]) / across2
        rate[across2 < STEEP2] = np.nan
        times = np.concatenate([self._t, t])
        values = np.vstack([self._values, np.column_stack([rate, force_b[:, 1:]])])
        rows = len(self._t) + self._rows.rows(t)
        begins = np.searchsorted(times, times[rows] - AVERAGE_S + 1e-6)
        mean = np.array([_mean(values[a : b + 1]) for a, b in zip(begins, rows, strict=True)]).reshape(-1, 3)
        if len(t):
            kept = times > t[-1] - AVERAGE_S
            self._t, self._values = times[kept], values[kept]
        with np.errstate(invalid="ignore"):
            slip = np.where(-mean[:, 2] > FLOATS, np.arctan2(-mean[:, 1], -mean[:, 2]), np.nan)
        return Turning(t=times[rows], turn_rate=mean[:, 0], slip=slip)

    def of(self, samples: Samples, estimates: Estimates) -> Turning:
        """Take what an estimator reports for a block of samples, row by row."""
        rate = samples.gyro_b - np.nan_to_num(estimates.gyro_bias)
        force = samples.accel_b - np.nan_to_num(estimates.accel_bias)
        return self.add(samples.t, rate, force, estimates.down_b)


def _mean(values: np.ndarray) -> np.ndarray:
    """Average columns of `values` (n, 3); NaN unless the last row and more than half of all are known."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    enough = known[-1] & (2 * count > len(values))
    return np.where(enough, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
