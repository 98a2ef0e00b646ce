"""Sensors whose values are old when they are stamped: all brought to the gyro's time, estimates then to the stamp's.

The value at stamp t was true at t - delay (`SensorInfo`). The attitude that the gyro carries is then that of t - delay
of the gyro; a vector v that another sensor saw tau earlier is, in the axes of that moment,

    v' = exp(-[w x] tau) v,   tau = delay of the sensor - delay of the gyro

and so serves every model unchanged. GNSS and dual antenna state when they were true; their stamps move with the
velocity (which the accelerometer carries) and the attitude. At the end the attitude is turned on by w times the gyro's
delay, velocity and place are moved on by the accelerometer's: v += a delay, a = C f + g. w is the gyro as it is: a
turn-on bias of 0.3 deg/s is 0.01 deg in 30 ms.
"""

import math

import numpy as np

from estimators.earth import move
from estimators.jit import inner
from estimators.native import local
from estimators.records import Estimate, Sample, Sheet
from estimators.rotations import to_nav, turn

_FASTEST = 30.0  # rad/s: beyond, it is no rate


@inner
def _turn_vector(v: np.ndarray, x: float, y: float, z: float) -> None:
    """Vector v (3,) turned by exp(-[r x]), r = (x, y, z) rad, to second order; in place."""
    a, b, c = v[0], v[1], v[2]
    d, e, f = y * c - z * b, z * a - x * c, x * b - y * a
    v[0] = a - d + 0.5 * (y * f - z * e)
    v[1] = b - e + 0.5 * (z * d - x * f)
    v[2] = c - f + 0.5 * (x * e - y * d)


@inner
def _move(row: Sample, answer: Estimate, delay: float, gravity: float) -> None:
    """Move velocity and place of an estimate on by `delay` (s), with the acceleration of its row; m/s2."""
    f, a, b = row.accel_b, local(3), local(3)
    if not math.isfinite(answer.vel_n[0] * answer.q_nb[0] * f[0] * f[1] * f[2]):
        return
    for i in range(3):
        b[i] = answer.accel_bias[i] if math.isfinite(answer.accel_bias[i]) else 0.0
    to_nav(answer.q_nb, f[0] - b[0], f[1] - b[1], f[2] - b[2], a)
    a[2] += gravity
    v = answer.vel_n
    north, east, down = (delay * (v[0] + 0.5 * delay * a[0]), delay * (v[1] + 0.5 * delay * a[1]), delay * v[2])
    if math.isfinite(answer.lla[0]):
        move(answer.lla, north, east, down, answer.lla)
    for i in range(3):
        v[i] += delay * a[i]


@inner
def is_late(sensors: Sheet) -> bool:
    """Tell whether any value is older than its stamp."""
    return sensors.gyro_delay != 0.0 or sensors.accel_delay != 0.0 or sensors.mag_delay != 0.0  # type: ignore[no-any-return]


@inner
def to_gyro_time(row: Sample, sensors: Sheet) -> None:
    """Turn accelerometer and magnetometer of a sample to where the body was when the gyro was read; in place."""
    x, y, z = row.gyro_b[0], row.gyro_b[1], row.gyro_b[2]
    row.gnss_t += sensors.accel_delay
    row.heading_t += sensors.gyro_delay
    if math.isfinite(x * y * z) and abs(x) + abs(y) + abs(z) < _FASTEST:
        tau = sensors.accel_delay - sensors.gyro_delay
        _turn_vector(row.accel_b, tau * x, tau * y, tau * z)
        tau = sensors.mag_delay - sensors.gyro_delay
        _turn_vector(row.mag_b, tau * x, tau * y, tau * z)


@inner
def to_stamp_time(row: Sample, answer: Estimate, sensors: Sheet, gravity: float) -> None:
    """Turn and move an estimate on to the time of the stamp of its sample; in place."""
    _move(row, answer, sensors.accel_delay, gravity)
    rate, bias, delay = row.gyro_b, answer.gyro_bias, sensors.gyro_delay
    x = rate[0] - bias[0] if math.isfinite(bias[0]) else rate[0]
    y = rate[1] - bias[1] if math.isfinite(bias[1]) else rate[1]
    z = rate[2] - bias[2] if math.isfinite(bias[2]) else rate[2]
    if not (math.isfinite(x * y * z) and abs(x) + abs(y) + abs(z) < _FASTEST):
        return
    x, y, z = delay * x, delay * y, delay * z
    _turn_vector(answer.down_b, x, y, z)
    if math.isfinite(answer.q_nb[0]):
        q = local(4)
        for i in range(4):
            q[i] = answer.q_nb[i]
        turn(q, x, y, z, answer.q_nb)
