"""Air data and interferometer against their equations."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_helpers import DT, START, quaternion, run, suite, truth, wild

from ahrs_sim.world.wgs84 import radii

AIR = {"instruments": ["imu", "air_data"]}
GAS = 1.4 * 287.05287


@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 200.0), st.floats(20e3, 105e3), st.floats(230.0, 315.0))
def test_true_airspeed_comes_back(speed: float, pressure: float, temperature: float) -> None:
    out = run(suite("ideal", **AIR), truth(8, airspeed=speed, pressure=pressure, temperature=temperature))
    assert out["air"].airspeed[0] == pytest.approx(speed, rel=1e-9)
    mach = speed / math.sqrt(GAS * temperature)
    qc = pressure * ((1 + 0.2 * mach**2) ** 3.5 - 1)
    assert out["diff_pressure"].pressure[0] == pytest.approx(qc, rel=1e-6, abs=1e-6)
    assert out["static_pressure"].pressure[0] == pressure
    indicated = math.sqrt(GAS * 288.15 * 5 * ((qc / 101325 + 1) ** (2 / 7) - 1))
    assert out["air"].indicated_airspeed[0] == pytest.approx(indicated, rel=1e-6)


def test_indicated_equals_true_at_sea_level() -> None:
    out = run(suite("ideal", **AIR), truth(8, airspeed=60.0, pressure=101325.0, temperature=288.15))["air"]
    assert out.indicated_airspeed[0] == pytest.approx(60.0, rel=1e-9)


def test_pipes_lag() -> None:
    speed = np.where(np.arange(800) < 200, 20.0, 30.0)
    out = run(suite("ideal", air_data={"lag_ms": 100}, **AIR), truth(800, airspeed=speed))["diff_pressure"]
    t = out.stamp_ns * 1e-9
    settled = [run(suite("ideal", **AIR), truth(8, airspeed=v))["diff_pressure"].pressure[0] for v in (20.0, 30.0)]
    after = t >= 0.5
    expected = settled[1] + (settled[0] - settled[1]) * np.exp(-(t[after] - 0.5 + DT) / 0.1)
    np.testing.assert_allclose(out.pressure[after], expected, rtol=1e-9)


def test_errors_of_the_pressures() -> None:
    figures = {
        "air_data": {
            "position_error_percent": 3,
            "diff_scale_percent": 4,
            "diff_bias_pa": 3,
            "static_bias_pa": 50,
            "day_pressure_hpa": 8,
        }
    }
    flight = truth(8, airspeed=25.0)
    clean = run(suite("ideal", **AIR), flight)
    s = suite("ideal", **figures, **AIR)
    out, d = run(s, flight), {k.removeprefix("air_data."): float(v) for k, v in s.drawn().items() if v.ndim == 0}
    qc = clean["diff_pressure"].pressure[0]
    expected = (1 + d["diff_scale"]) * (1 - d["position_error"]) * qc + d["diff_bias"]
    assert out["diff_pressure"].pressure[0] == pytest.approx(expected)
    expected = 99000.0 + d["day_pressure"] + d["position_error"] * qc + d["static_bias"]
    assert out["static_pressure"].pressure[0] == pytest.approx(expected)
    other = suite("ideal", "other", **figures, **AIR).drawn()
    assert float(other["air_data.day_pressure"]) == d["day_pressure"]  # one weather for all
    assert float(other["air_data.diff_bias"]) != d["diff_bias"]
    assert s.info.airspeed_scale == pytest.approx(0.02)


def test_range_quantum_and_what_blows_from_behind() -> None:
    figures = {"air_data": {"diff_range_pa": 1000.0, "diff_quantum_pa": 0.84}}
    out = run(suite("ideal", **figures, **AIR), truth(8, airspeed=100.0))["diff_pressure"].pressure
    assert np.abs(out).max() <= 1000.0 + 0.42
    np.testing.assert_allclose(out / 0.84, np.round(out / 0.84), atol=1e-9)
    still = run(suite("ideal", air_data={"diff_noise_pa": 5.0}, **AIR), truth(800))
    assert (still["diff_pressure"].pressure < 0).any()
    assert (still["air"].airspeed >= 0).all()


def test_vanes() -> None:
    flight = truth(800, airspeed=np.repeat([2.0, 20.0], 400), alpha=0.1, beta=-0.05)
    out = run(suite("ideal", air_data={"vane_bias_deg": 0.5, "vane_noise_deg": 0.1}, **AIR), flight)["air"]
    assert np.isnan(out.alpha[:50]).all()
    assert np.degrees(out.alpha[50:].mean() - 0.1) != 0
    assert np.degrees(out.alpha[50:].std()) == pytest.approx(0.1, rel=0.5)
    assert np.isnan(run(suite("chr_6dm", **AIR), flight)["air"].alpha).all()


EMITTER = {"interferometer": {"rate_hz": 20, "emitter_north_m": 3000.0, "emitter_east_m": 4000.0, "baseline_m": 1.0,
                              "frequency_hz": 1e9}}  # fmt: skip


def test_interferometer_phase_is_what_geometry_says_and_its_rate_the_derivative() -> None:
    n = 4000
    t = np.arange(n) * DT
    yaw, roll = 0.4 + 0.2 * np.sin(t), 0.3
    q = np.array([quaternion(roll, 0.0, y) for y in yaw])
    meridian, prime = (float(r) + START[2] for r in radii(np.asarray(START[0])))
    lla = START + np.column_stack([50.0 * t / meridian, 30.0 * t / (prime * math.cos(START[0])), 0 * t])
    yaw_rate = 0.2 * np.cos(t)
    rate = np.column_stack([0 * t, yaw_rate * math.sin(roll), yaw_rate * math.cos(roll)])
    flight = truth(n, q_nb=q, lla=lla, vel_n=[50.0, 30.0, 0.0], rate_ib_b=rate)
    out = run(suite("ideal", **EMITTER), flight)["interferometer"]
    k = 2 * math.pi * 1e9 / 299792458.0
    at = out.stamp_ns * 1e-9
    theta = np.arctan2(4000.0 - 30.0 * at, 3000.0 - 50.0 * at)
    phase = k * np.cos(theta - 0.4 - 0.2 * np.sin(at))
    np.testing.assert_allclose(out.bearing, theta, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * out.phase), np.exp(1j * phase), atol=1e-6)
    assert (out.phase > -math.pi).all()
    assert (out.phase <= math.pi).all()
    unwrapped = np.unwrap(out.phase)
    slope = (unwrapped[2:] - unwrapped[:-2]) / (at[2:] - at[:-2])
    np.testing.assert_allclose(out.phase_rate[1:-1], slope, atol=2e-2)


def test_interferometer_is_there_only_when_asked_for_and_noisy_as_told() -> None:
    assert "interferometer" not in suite("chr_6dm").instruments
    noisy = {"interferometer": {**EMITTER["interferometer"], "phase_noise_deg": 10.0, "rate_noise_dps": 1.0,
                                "bearing_noise_deg": 5.0}}  # fmt: skip
    flight = truth(40_000)
    a, b = (run(suite("ideal", **e), flight)["interferometer"] for e in (EMITTER, noisy))
    assert np.degrees(np.angle(np.exp(1j * (b.phase - a.phase)))).std() == pytest.approx(10.0, rel=0.05)
    assert np.degrees(b.phase_rate - a.phase_rate).std() == pytest.approx(1.0, rel=0.05)
    assert np.degrees(b.bearing - a.bearing).std() == pytest.approx(5.0, rel=0.05)
    assert len(wild(4)) == 4
