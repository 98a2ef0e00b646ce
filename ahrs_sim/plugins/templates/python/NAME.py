"""NAME: a complementary filter, to be replaced by your own.

The gyro carries the attitude; the accelerometer pulls the tilt and the magnetometer the heading back with the rates
`tilt_gain` and `heading_gain` (1/s). The first second of samples is averaged for the first attitude.
"""

import math

import numpy as np

from estimators import Estimates, Samples, SensorInfo, Site, Status
from estimators.rotations import from_euler, normalise
from estimators.types import blank


class NAME:
    """The estimator; `method = "NAME:NAME"` in a scenario. Settings are keyword arguments."""

    def __init__(self, site: Site, sensors: SensorInfo, tilt_gain: float = 0.1, heading_gain: float = 0.1) -> None:
        self.declination = math.atan2(site.mag_n[1], site.mag_n[0])
        self.tilt_gain, self.heading_gain = tilt_gain, heading_gain
        self.reset()

    def reset(self) -> None:
        """Forget everything seen."""
        self.q = np.array([1.0, 0.0, 0.0, 0.0])
        self.t = self.begun = math.nan
        self.running = False
        self.accel, self.field = np.zeros(3), np.zeros(3)

    def process(self, samples: Samples) -> Estimates:
        """Return one row of estimates for each row of samples; blocks of any length give the same numbers."""
        columns = blank(Estimates, len(samples))
        columns["t"][:] = samples.t
        for k in range(len(samples)):
            t, gyro, accel, mag = samples.t[k], samples.gyro_b[k], samples.accel_b[k], samples.mag_b[k]
            if not (np.isfinite(gyro).all() and np.isfinite(accel).all()):
                continue  # the row stays NaN and ALIGNING
            if math.isnan(self.t):
                self.begun = self.t = t
            dt, self.t = t - self.t, t
            if self.running:
                self._turn((gyro + self._correction(accel, mag)) * dt)
            else:
                self.accel += accel
                self.field += mag if samples.mag_new[k] else 0.0
                if t - self.begun < 1.0:
                    continue
                self._level()
            columns["q_nb"][k], columns["status"][k] = self.q, Status.RUNNING
        return Estimates(**columns)

    def _level(self) -> None:
        f = self.accel
        roll, pitch = math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2]))
        from_euler(roll, pitch, 0.0, self.q)
        north, east, _ = _matrix(self.q) @ self.field
        from_euler(roll, pitch, self.declination - math.atan2(east, north), self.q)
        self.running = True

    def _turn(self, rotation: np.ndarray) -> None:
        a, (b, c, d), (x, y, z) = self.q[0], self.q[1:], 0.5 * rotation
        turn = (-b * x - c * y - d * z, a * x + c * z - d * y, a * y + d * x - b * z, a * z + b * y - c * x)
        self.q = self.q + np.array(turn)
        normalise(self.q)

    def _correction(self, accel: np.ndarray, mag: np.ndarray) -> np.ndarray:
        c_nb = _matrix(self.q)
        rate = self.tilt_gain * np.cross(accel, -c_nb[2]) / np.linalg.norm(accel)
        if np.isfinite(mag).all():
            north, east, _ = c_nb @ mag
            miss = math.remainder(self.declination - math.atan2(east, north), math.tau)
            rate += c_nb[2] * self.heading_gain * miss
        return rate


def _matrix(q: np.ndarray) -> np.ndarray:
    """C_nb (3, 3), body to navigation."""
    a, b, c, d = q
    return np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
        ]
    )
