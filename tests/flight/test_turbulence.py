"""Turbulence has the spectra and scale lengths of the standard by height above the ground, not sea level."""

import math
from itertools import pairwise

import numpy as np
import pytest
from flight_helpers import Flown, airborne, make
from scipy.signal import csd, welch

from ahrs_sim.flight.turbulence import RoughAir, blow, dryden, first_state, gradient
from ahrs_sim.scenario import Wind

FT = 0.3048
LIGHT = Wind(4.0, 0.0, "light", 4.0, ())


def standard(height):
    """L_u, L_w (m) and sigma_u, sigma_w (m/s) of MIL-F-8785C for W20 = 4 m/s, as its text has them, in feet."""
    h = height / FT
    if h <= 1000:
        f = 0.177 + 0.000823 * h
        return h / f**1.2 * FT, h * FT, 0.4 / f**0.4, 0.4
    # from 1000 to 2000 ft linear to L = 1750 ft and figure 7; "light" there (10^-2: 6.95 ft/s at 2000 ft) means
    # W20 = 25 ft/s, so that a wind of 4 m/s has 4 / 7.62 of it
    part = (h - 1000) / 1000
    length, sigma = (1000 + 750 * part) * FT, 0.4 + part * (6.95 * FT * 4.0 / 7.62 - 0.4)
    return length, length, sigma, sigma


@pytest.mark.parametrize("height", [20.0, 100.0, 500.0])
def test_scale_lengths_and_intensities(height):
    assert dryden(height, LIGHT) == pytest.approx(standard(height), rel=0.003)


def test_the_models_meet_and_the_ground_stops_the_vertical():
    for edge in (1000 * FT, 2000 * FT):
        assert dryden(edge - 1e-6, LIGHT) == pytest.approx(dryden(edge + 1e-6, LIGHT), rel=1e-4)
    assert dryden(0.0, LIGHT).sigma_w == 0.0
    assert dryden(1.5, LIGHT).sigma_u == dryden(10 * FT, LIGHT).sigma_u
    assert dryden(1.5, LIGHT).sigma_w < 0.2 < dryden(10 * FT, LIGHT).sigma_w
    severe = dryden(800.0, Wind(4.0, 0.0, "severe", 22.86, ()))
    assert severe.sigma_w == pytest.approx((17.6 + (800 / FT - 1750) / 2000 * 5.4) * FT, rel=1e-6)


def series(height, *, speed=20.0, dt=0.02, n=400_000, seed=1, span=2.0):
    """Gusts along, across and down in m/s and rates in rad/s (n, 6) at one height, flying north with wings level."""
    model = dryden(height, LIGHT)
    random = np.random.default_rng(seed)
    settings = np.array([0.0, 0.0, model.sigma_u, model.sigma_w, 0.0])
    state = first_state(random.standard_normal(6))
    noise = random.standard_normal((n, 6))
    air = blow(state, noise, settings, settings, model.length_u, model.length_w, speed, span, dt, 0.0, 0.0, 0.0)
    return air * [FT, FT, FT, 1, 1, 1]


@pytest.mark.parametrize("height", [20.0, 100.0, 500.0])
def test_spectra_are_those_of_the_standard(height):
    """One-sided spectra in rad/s of 3.7.1.2 and 3.7.5, to 6 % of power and what the record leaves open, by band."""
    speed, dt, span = 20.0, 0.02, 2.0
    air = series(height, speed=speed, dt=dt, span=span)
    length_u, length_w, sigma_u, sigma_w = standard(height)
    f, found = welch(air, fs=1 / dt, nperseg=16384, axis=0)
    omega = 2 * math.pi * f
    x, y = length_u * omega / speed, length_w * omega / speed
    along = sigma_u**2 * 2 * length_u / (math.pi * speed) / (1 + x**2)
    across = sigma_u**2 * length_u / (math.pi * speed) * (1 + 3 * x**2) / (1 + x**2) ** 2
    down = sigma_w**2 * length_w / (math.pi * speed) * (1 + 3 * y**2) / (1 + y**2) ** 2
    roll = 0.8 * sigma_w**2 / (length_w * speed) * (math.pi * length_w / (4 * span)) ** (1 / 3)
    roll = roll / (1 + (4 * span * omega / (math.pi * speed)) ** 2)
    pitch = down * (omega / speed) ** 2 / (1 + (4 * span * omega / (math.pi * speed)) ** 2)
    yaw = across * (omega / speed) ** 2 / (1 + (3 * span * omega / (math.pi * speed)) ** 2)
    bands = np.geomspace(0.01, 4.0, 9)
    for column, expected in enumerate((along, across, down, roll, pitch, yaw)):
        for low, high in pairwise(bands):
            inside = (f >= low) & (f < high)
            ratio = found[inside, column].sum() / (2 * math.pi * expected[inside].sum())
            rough = 2.5 / math.sqrt(inside.sum() * len(air) / 16384)  # of an average of so many bins
            assert ratio == pytest.approx(1.0, abs=0.06 + rough), (column, low)


def test_the_gusts_are_independent_and_the_rates_follow_from_them():
    air = series(100.0, n=200_000)
    gusts = np.corrcoef(air[:, :4].T) - np.eye(4)
    assert np.abs(gusts).max() < 0.1
    f, cross = csd(air[:, 2], air[:, 4], fs=50.0, nperseg=4096)
    rate = cross / welch(air[:, 2], fs=50.0, nperseg=4096)[1]
    k = np.searchsorted(f, 0.5)  # frozen air: q = -dw/dx = -(dw/dt) / V, averaged over the span
    s = 2j * math.pi * f[k]
    assert rate[k] == pytest.approx(-s / 20.0 / (1 + 4 * 2.0 / (math.pi * 20.0) * s), rel=0.05)


def test_variance_does_not_depend_on_the_step():
    for dt in (1.0, 0.1):
        air = series(100.0, dt=dt, n=200_000)
        assert air[:, :3].std(axis=0) == pytest.approx([standard(100.0)[2]] * 2 + [0.4], rel=0.03)
    fine = series(100.0, speed=0.1, dt=1 / 400, n=1000)  # where the closed form of the noise cancels
    assert np.isfinite(fine).all() and np.abs(np.diff(fine, axis=0)).max() < 0.05


FLIGHT = {"do": "straight", "for_s": 60.0}
AIR = {"speed_mps": 4.0, "from_deg": 320.0, "turbulence": "light", "at_20ft_mps": 4.0}


@pytest.mark.parametrize("height", [20.0, 100.0, 500.0])
def test_the_elevation_of_the_field_does_not_matter(height):
    """The wind of a flight over fields at 0 and 1600 m: the same gusts, as strong as the standard says."""
    winds = []
    for altitude in (0.0, 1600.0):
        start = {"altitude_m": altitude, "on_ground": False, "height_m": height, "heading_deg": 320.0}
        winds.append(Flown(airborne(FLIGHT, wind=AIR, start=start, seed=5)).truth.wind_n)
    n = min(map(len, winds))
    _, _, sigma_u, sigma_w = standard(height)
    for wind in winds:
        rms = np.sqrt(
            np.mean((wind - [-4.0 * math.cos(math.radians(320)), -4 * math.sin(math.radians(320)), 0]) ** 2, 0)
        )
        assert rms == pytest.approx([sigma_u, sigma_u, sigma_w], rel=0.6)  # a minute is a few scale lengths
    assert winds[0][:n].std(axis=0) == pytest.approx(winds[1][:n].std(axis=0), rel=0.15)


@pytest.mark.parametrize("altitude", [0.0, 1600.0])
def test_a_parked_aircraft_feels_the_ground(altitude):
    scene = make(step=[{"do": "wait", "for_s": 20.0}], wind=AIR, start={"altitude_m": altitude}, seed=2)
    truth = Flown(scene).truth
    assert truth.wind_n[:, 2].std() < 0.06  # m/s; the centre of gravity is 0.3 m above the ground
    assert np.hypot(*truth.wind_n[:, :2].std(axis=0)) < 1.5
    assert np.abs(truth.vel_n).max() < 0.01


def test_the_wind_grows_with_height():
    """MIL-F-8785C 3.7.3.2: ln(h / z0) / ln(20 ft / z0), z0 = 0.15 ft."""
    assert gradient(20 * FT, 0.15 * FT) == 1.0
    assert gradient(100.0, 0.15 * FT) == pytest.approx(math.log(100 / FT / 0.15) / math.log(20 / 0.15))
    assert gradient(0.0, 0.15 * FT) == gradient(3 * FT, 0.15 * FT) == pytest.approx(0.612, abs=1e-3)
    assert gradient(5000.0, 0.15 * FT) == gradient(1000 * FT, 0.15 * FT)
    assert gradient(0.0, 0.0) == 1.0
    calm = {"speed_mps": 4.0, "from_deg": 320.0, "roughness_m": 0.0457}
    truth = Flown(
        airborne({"do": "descend", "to_height_m": 25.0}, {"do": "climb", "to_height_m": 60.0}, wind=calm)
    ).truth
    wind = np.hypot(truth.wind_n[:, 0], truth.wind_n[:, 1])
    expected = [4.0 * gradient(h, 0.0457) for h in truth.height_agl]
    assert wind == pytest.approx(expected, abs=0.01)
    assert np.ptp(wind) > 1.0 and np.abs(np.diff(wind)).max() < 0.005


def test_nothing_blows_that_nobody_asked_for():
    assert not RoughAir.wanted(Wind(4.0, 0.0, "none", 0.0, ()))
    truth = Flown(airborne({"do": "straight", "for_s": 2.0}, wind={"speed_mps": 4.0})).truth
    assert np.ptp(truth.wind_n, axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_the_axes_do_not_flip_in_a_loop():
    truth = Flown(airborne({"do": "loop"}, {"do": "straight", "for_s": 3.0}, wind=AIR, seed=3)).truth
    assert np.abs(np.diff(truth.wind_n, axis=0)).max() < 0.12  # 400 steps a second; a flip would be 1 m/s
