"""Gravity."""

import numpy as np
import pytest

from ahrs_sim.world import wgs84
from ahrs_sim.world.gravity import gravity_n, j2_gravity_n, normal_gravity


def at(latitude_deg, height=0.0):
    return np.array([np.radians(latitude_deg), 0.3, height])


def test_values_of_the_standard():
    # NIMA TR8350.2, table 3.4: normal gravity at the equator, at the poles, and its mean over the ellipsoid
    assert normal_gravity(at(0.0)) == pytest.approx(9.7803253359, abs=1e-10)
    assert normal_gravity(at(90.0)) == pytest.approx(9.8321849379, abs=1e-9)
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 20001)
    meridian, prime = wgs84.radii(latitude)
    area = meridian * prime * np.cos(latitude)
    gravity = normal_gravity(np.column_stack([latitude, 0 * latitude, 0 * latitude]))
    assert np.sum(gravity * area) / np.sum(area) == pytest.approx(9.7976432222, abs=1e-8)


def test_it_weakens_with_height():
    gradient = (normal_gravity(at(45.0, 100.0)) - normal_gravity(at(45.0))) / 100.0
    assert gradient == pytest.approx(-3.0855e-6, rel=1e-3)  # free-air gradient


def test_the_field_of_jsbsim_is_close_to_the_normal_field():
    lla = np.array([at(latitude, height) for latitude in range(-90, 91, 5) for height in (0.0, 3000.0)])
    assert np.abs(j2_gravity_n(lla) - gravity_n(lla)).max() < 1.2e-4


def test_gravity_is_steady_along_the_rotation_axis():
    lla = at(60.0, 1000.0)
    turned = lla + np.array([0.0, 1.0, 0.0])
    assert j2_gravity_n(turned) == pytest.approx(j2_gravity_n(lla), abs=1e-12)
    assert wgs84.EARTH_RATE == 7.292115e-5
