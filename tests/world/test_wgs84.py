"""The ellipsoid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_sim.world import wgs84
from ahrs_sim.world.gravity import normal_gravity
from estimators import earth

latitudes = st.floats(-1.57, 1.57)
longitudes = st.floats(-3.14, 3.14)
heights = st.floats(-5e3, 1e5)


@given(latitudes, longitudes, heights)
def test_position_survives_the_way_through_earth_fixed_coordinates(lat, lon, height):
    back = wgs84.lla(wgs84.ecef(np.array([lat, lon, height])))
    assert back[:2] == pytest.approx([lat, lon], abs=1e-12)
    assert back[2] == pytest.approx(height, abs=1e-7)


def test_known_points():
    assert wgs84.ecef(np.array([0.0, 0.0, 0.0])) == pytest.approx([6378137.0, 0.0, 0.0])
    assert wgs84.ecef(np.array([np.pi / 2, 0.0, 0.0])) == pytest.approx([0.0, 0.0, 6356752.314245], abs=1e-6)
    meridian, prime = wgs84.radii(np.array([0.0, np.pi / 2]))
    assert meridian == pytest.approx([6335439.327, 6399593.626], abs=1e-2)  # a(1-e2), a/sqrt(1-e2)
    assert prime == pytest.approx([6378137.0, 6399593.626], abs=1e-2)


@given(latitudes, longitudes)
def test_axes_are_a_rotation_and_down_is_inward(lat, lon):
    axes = wgs84.ned_axes(np.array(lat), np.array(lon))
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    up = wgs84.ecef(np.array([lat, lon, 1.0])) - wgs84.ecef(np.array([lat, lon, 0.0]))
    assert axes @ up == pytest.approx([0.0, 0.0, -1.0], abs=1e-8)


@given(st.floats(-1.5, 1.5), longitudes, st.floats(-300, 300), st.floats(-300, 300), st.floats(-50, 50))
def test_rates_of_position_and_frame_are_derivatives(lat, lon, north, east, down):
    lla, vel = np.array([lat, lon, 500.0]), np.array([north, east, down])
    rate = wgs84.lla_rate(lla, vel)
    h = 1e-2  # s
    moved = wgs84.ecef(lla + h * rate) - wgs84.ecef(lla - h * rate)
    axes = wgs84.ned_axes(np.array(lat), np.array(lon))
    assert axes @ moved / (2 * h) == pytest.approx(vel, abs=1e-5)
    # dC_ne/dt = -[w x] C_ne for a frame that turns with w (its own components)
    turn = [wgs84.ned_axes(np.array(lat + s * rate[0]), np.array(lon + s * rate[1])) for s in (h, -h)]
    cross = -(turn[0] - turn[1]) / (2 * h) @ axes.T
    wanted = wgs84.transport_rate_n(lla, vel)
    assert [cross[2, 1], cross[0, 2], cross[1, 0]] == pytest.approx(wanted, abs=1e-10)


def test_offset_is_where_one_has_gone():
    origin = np.array([0.76, 0.03, 150.0])
    there = origin + np.array([[1e-5, 0.0, 0.0], [0.0, 1e-5, 0.0], [0.0, 0.0, 10.0]])
    meridian, prime = wgs84.radii(np.array(origin[0]))
    offset = wgs84.offset_n(there, origin)
    assert offset[0, 0] == pytest.approx(1e-5 * (meridian + 150.0), rel=1e-6)
    assert offset[1, 1] == pytest.approx(1e-5 * (prime + 150.0) * np.cos(0.76), rel=1e-6)
    assert offset[2] == pytest.approx([0.0, 0.0, -10.0], abs=1e-8)


def test_earth_rate_points_to_the_pole():
    assert wgs84.earth_rate_n(np.array(np.pi / 2)) == pytest.approx([0.0, 0.0, -7.292115e-5])
    assert wgs84.earth_rate_n(np.array(0.0)) == pytest.approx([7.292115e-5, 0.0, 0.0])


def test_navigators_have_the_same_earth() -> None:
    """`estimators` stands alone and has kernels of its own: the same ellipsoid, rotation and gravity."""
    assert [earth.A, earth.EARTH_RATE] == [wgs84.A, wgs84.EARTH_RATE]
    assert pytest.approx(wgs84.E2, rel=1e-11) == earth.E2
    for latitude, height in ((0.0, 0.0), (0.8, 500.0), (-1.4, 9000.0)):
        place = np.array([latitude, 0.1, height])
        assert earth.radii(latitude) == pytest.approx(wgs84.radii(np.array(latitude)), rel=1e-11)
        assert earth.normal_gravity(latitude, height) == pytest.approx(float(normal_gravity(place)), rel=1e-11)
