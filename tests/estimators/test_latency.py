"""Delays of gyro, accelerometer and magnetometer that the data sheet states are taken out."""

import dataclasses

import numpy as np
import pytest
from synthetic import SITE, error_deg, flight

from estimators import SensorInfo, create

GYRO, ACCEL, MAG = 0.01, 0.04, 0.06  # s, whole samples


def swung(delay=0.0):
    """Still for five seconds, then swings about all axes, as it was `delay` ago."""
    t = np.arange(3000) / 100.0 - delay
    grow = np.clip((t - 5.0) / 3.0, 0, 1)
    angles = (0.6 * np.sin(1.5 * t), 0.5 * np.sin(1.1 * t), 1.0 + 1.2 * np.sin(0.9 * t))
    return flight(*(grow * a for a in angles), np.zeros((len(t), 3)), noise=0.1)


@pytest.mark.parametrize("name", ["marg-ekf", "akf-standard", "tilt-ekf"])
def test_delays_are_taken_out(name):
    now, truth = swung()
    late = [swung(delay)[0] for delay in (GYRO, ACCEL, MAG)]
    samples = dataclasses.replace(now, gyro_b=late[0].gyro_b, accel_b=late[1].accel_b, mag_b=late[2].mag_b)
    settings = {"adaptation": "none"} if name == "tilt-ekf" else {"noise": "from-ground"}
    off = []
    for sensors in (SensorInfo(), SensorInfo(gyro_delay=GYRO, accel_delay=ACCEL, mag_delay=MAG)):
        estimates = create(name, site=SITE, sensors=sensors, align_s=4.0, **settings).process(samples)
        total = error_deg(np.nan_to_num(estimates.q_nb[1000:]), truth[1000:])[0]
        down = np.stack([_down(q) for q in truth[1000:]])
        tilt = np.degrees(np.arccos(np.clip(np.sum(estimates.down_b[1000:] * down, axis=1), -1, 1)))
        off.append((np.sqrt(np.mean(tilt**2)), np.sqrt(np.mean(total**2))))
    assert off[1][0] < 0.4 * off[0][0]
    if name != "tilt-ekf":
        assert off[1][1] < 0.3 * off[0][1]


def _down(q):
    a, b, c, d = q
    return np.array([2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d])
