"""Sensors whose values are old when they are stamped: all brought to the gyro's time, the attitude then to the stamp's.

The value at stamp t was true at t - delay (`SensorInfo`). The attitude that the gyro carries is then that of t - delay
of the gyro; a vector v that another sensor saw tau earlier is, in the axes of that moment,

    v' = exp(-[w x] tau) v,   tau = delay of the sensor - delay of the gyro

and so serves every model unchanged. GNSS and dual antenna state when they were true; their stamps move with the
velocity (which the accelerometer carries) and the attitude. At the end the attitude is turned on by w times the gyro's
delay. w is the gyro as it is: a turn-on bias of 0.3 deg/s is 0.01 deg in 30 ms.
"""

import math

import numpy as np

from estimators.jit import njit
from estimators.rotations import turn
from estimators.rows import ACCEL, E_DOWN, E_GYRO_BIAS, E_Q, GNSS_T, GYRO, HEADING_T, MAG


@njit
def _turned(row: np.ndarray, at: int, x: float, y: float, z: float) -> None:
    """`row[at:at + 3]` turned by exp(-[r x]), r = (x, y, z) rad, to second order."""
    a, b, c = row[at], row[at + 1], row[at + 2]
    u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
    row[at] = a - u + 0.5 * (y * w - z * v)
    row[at + 1] = b - v + 0.5 * (z * u - x * w)
    row[at + 2] = c - w + 0.5 * (x * v - y * u)


@njit
def to_gyro_time(rows: np.ndarray, gyro_delay: float, accel_delay: float, mag_delay: float) -> None:
    """Accelerometer and magnetometer of samples (n, SAMPLE_WIDTH) as if they had been read with the gyro; in place."""
    for k in range(rows.shape[0]):
        row = rows[k]
        x, y, z = row[GYRO], row[GYRO + 1], row[GYRO + 2]
        row[GNSS_T] += accel_delay
        row[HEADING_T] += gyro_delay
        if math.isfinite(x * y * z) and abs(x) + abs(y) + abs(z) < 30.0:  # rad/s: beyond, it is no rate
            tau = accel_delay - gyro_delay
            _turned(row, ACCEL, tau * x, tau * y, tau * z)
            tau = mag_delay - gyro_delay
            _turned(row, MAG, tau * x, tau * y, tau * z)


@njit
def to_stamp_time(rows: np.ndarray, out: np.ndarray, first: int, gyro_delay: float) -> None:
    """Attitude and down vector of estimates (n, ESTIMATE_WIDTH) from row `first` on, turned on to the stamp."""
    q, turned = np.empty(4), np.empty(4)
    for k in range(first, rows.shape[0]):
        row, answer = rows[k], out[k]
        x, y, z = row[GYRO], row[GYRO + 1], row[GYRO + 2]
        for i in range(3):
            bias = answer[E_GYRO_BIAS + i]
            if math.isfinite(bias):
                if i == 0:
                    x -= bias
                elif i == 1:
                    y -= bias
                else:
                    z -= bias
        if not (math.isfinite(x * y * z) and abs(x) + abs(y) + abs(z) < 30.0):
            continue
        x, y, z = gyro_delay * x, gyro_delay * y, gyro_delay * z
        _turned(answer, E_DOWN, x, y, z)
        if math.isfinite(answer[E_Q]):
            for i in range(4):
                q[i] = answer[E_Q + i]
            turn(q, x, y, z, turned)
            for i in range(4):
                answer[E_Q + i] = turned[i]
