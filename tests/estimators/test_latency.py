"""Delays of gyro, accelerometer and magnetometer that the data sheet states are taken out."""

import dataclasses

import numpy as np
import pytest
from synthetic import SITE, error_deg, flight

from estimators import SensorInfo, create
from estimators.earth import radii
from estimators.models.ins.start import UP_SHARE

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


def test_velocity_and_place_are_those_of_the_stamp():
    """An accelerometer 40 ms late carries the velocity of then: moved on, at 3 m/s2 by 0.12 m/s."""
    t = np.arange(4000) / 100.0
    zero, fresh = np.zeros_like(t), np.arange(4000) % 20 == 0
    fix = np.maximum(np.maximum.accumulate(np.where(fresh, np.arange(4000), 0)) - 10, 0)  # 0.1 s late

    def forward(delay):
        grow = np.clip(t - delay - 15.0, 0.0, None)
        speed, way = 6.0 * (1.0 - np.cos(0.5 * grow)), 6.0 * grow - 12.0 * np.sin(0.5 * grow)  # m/s, m north
        vel = np.column_stack([speed, zero, zero])
        lla = np.tile(SITE.lla, (len(t), 1))
        lla[:, 0] += way / (radii(SITE.lla[0])[0] + SITE.lla[2])
        gnss = {"vel_n": vel[fix], "lla": lla[fix], "gnss_t": t[fix], "gnss_new": fresh}
        return flight(zero, zero, zero, vel, noise=0.1, **gnss)[0], lla

    now, lla = forward(0.0)
    late = dataclasses.replace(now, accel_b=forward(ACCEL)[0].accel_b)
    found = []
    for samples, delay in ((now, 0.0), (late, 0.0), (late, ACCEL)):
        sensors = SensorInfo(accel_delay=delay)
        estimates = create("ins21", site=SITE, sensors=sensors, align_s=4.0).process(samples)
        found.append(estimates.vel_n[2000:])
        assert np.abs(estimates.lla[2000:, 0] - lla[2000:, 0]).max() * 6.37e6 < 1.0
        for covariance in (estimates.vel_cov[2000:], estimates.pos_cov[2000:]):
            assert np.linalg.eigvalsh(covariance).min() > 0.0
    wander = SensorInfo().gnss_pos * np.sqrt(UP_SHARE)  # of the fixes, by axis: it is in what is known of the place
    assert (np.sqrt(np.diagonal(estimates.pos_cov[-1])) > wander).all()
    as_declared, moved = (np.sqrt(np.mean((v - found[0]) ** 2)) for v in found[1:])
    assert moved < 0.4 * as_declared, (moved, as_declared)
