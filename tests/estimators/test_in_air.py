"""A start in the air, turning: no standing stretch, and gravity is not what the accelerometer shows."""

import dataclasses

import numpy as np
import pytest
from synthetic import SITE, error_deg, flight

from estimators import SensorInfo, create

SPEED, BANK, ALPHA = 23.0, 0.6, 0.05
SENSORS = SensorInfo(gyro_noise=3.7e-3 / 50**0.5, accel_noise=0.02 / 50**0.5)


def circling(seconds=30.0, wind=(3.0, -4.0, 0.0)):
    """A steady coordinated turn from the first sample on: samples and truth."""
    n = round(100 * seconds)
    t = np.arange(n) / 100.0
    course = 0.7 + 9.805 * np.tan(BANK) / SPEED * t
    air = SPEED * np.stack([np.cos(course), np.sin(course), 0 * t], -1)
    velocity = air + np.array(wind)
    new = np.arange(n) % 20 == 0
    fix = np.maximum.accumulate(np.where(new, np.arange(n), 0))
    place = np.cumsum(velocity, axis=0) / 100.0
    lla = np.array(SITE.lla) + place * [1 / 6.36e6, 1 / (6.38e6 * np.cos(SITE.lla[0])), -1.0]
    return flight(
        np.full(n, BANK), np.full(n, ALPHA * np.cos(BANK)), course + ALPHA * np.sin(BANK), velocity,
        airspeed=np.full(n, SPEED), air_new=np.arange(n) % 2 == 0, vel_n=velocity[fix], lla=lla[fix], gnss_t=t[fix],
        gnss_new=new,
    )  # fmt: skip


def first_error(name, samples, truth, **settings):
    """Tilt and heading error (deg) of the first attitude, when it was, and RMS of both after 20 s."""
    estimates = create(name, site=SITE, sensors=SENSORS, **settings).process(samples)
    k = int(np.flatnonzero(np.isfinite(estimates.q_nb[:, 0]))[0])
    _, tilt, heading = (np.abs(error_deg(estimates.q_nb[k:], truth[k:])[i]) for i in range(3))
    late = slice(2000 - k, None)
    return tilt[0], heading[0], samples.t[k], np.sqrt(np.mean(tilt[late] ** 2)), np.sqrt(np.mean(heading[late] ** 2))


@pytest.mark.parametrize("aid", ["airspeed", "gnss", "nothing"])
def test_a_velocity_aid_finds_the_bank(aid):
    samples, truth = circling()
    nothing = np.zeros(len(samples), bool)
    if aid != "gnss":
        samples = dataclasses.replace(samples, gnss_new=nothing)
    if aid != "airspeed":
        samples = dataclasses.replace(samples, air_new=nothing)
    tilt, heading, t, _, _ = first_error("marg-ekf", samples, truth)
    assert t < 6.5
    if aid == "nothing":
        assert tilt > 25.0
    else:
        assert tilt < 3.0
        assert heading < 5.0


@pytest.mark.parametrize(("name", "settings"), [("ins21", {}), ("air-ins", {}), ("marg-ckf", {"aiding": "airspeed"})])
def test_it_flies_on_from_there(name, settings):
    samples, truth = circling(60.0)
    _, _, _, tilt, heading = first_error(name, samples, truth, **settings)
    assert tilt < 1.5
    assert heading < 3.0


def test_smooth_straight_flight_is_no_standing_start():
    n = 3000
    t, level = np.arange(n) / 100.0, np.zeros(n)
    velocity = np.tile([SPEED, 0.0, 0.0], (n, 1))
    samples, _ = flight(
        level,
        level,
        level,
        velocity,
        airspeed=np.full(n, SPEED),
        air_new=np.arange(n) % 2 == 0,
        gyro_bias=(0.0, 0.01, 0.0),
    )
    estimates = create("marg-ekf", site=SITE, aiding="airspeed").process(samples)
    began = int(np.flatnonzero(np.isfinite(estimates.q_nb[:, 0]))[0])
    assert t[began] < 6.5
    assert np.abs(estimates.gyro_bias[began]).max() < 1e-3  # what turns there may be a turn
