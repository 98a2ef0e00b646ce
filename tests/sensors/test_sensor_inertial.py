"""Gyro, accelerometer and magnetometer: every deterministic term against its equation, every draw against its sigma."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from sensor_helpers import DT, EPOCH, quaternion, run, same, suite, truth, wild

from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.world import magnetic

G0 = 9.80665
IMU = {"instruments": ["imu"]}
MAG = {"instruments": ["imu", "magnetometer"]}


def test_ideal_is_the_truth() -> None:
    flight = wild(400)
    out = run(suite("ideal", **MAG), flight)
    assert np.array_equal(out["imu"].gyro_b, flight.rate_ib_b[::4])
    np.testing.assert_allclose(out["imu"].stamp_ns, flight.t[::4] * 1e9, atol=0.5)
    still = wild(4)
    flight = truth(400, q_nb=quaternion(0.3, 0.2, 1.0), lla=still.lla[0])
    out = run(suite("ideal", **MAG), flight)
    assert np.array_equal(out["imu"].accel_b, flight.accel_b[::4])
    cr, sr, cp, sp, cy, sy = (f(x) for x in (0.3, 0.2, 1.0) for f in (np.cos, np.sin))
    c_nb = np.array(
        [
            [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp],
        ]
    )
    field = magnetic.field_n(flight.lla[:1], EPOCH)[0]
    np.testing.assert_allclose(out["mag"].mag_b, np.tile(c_nb.T @ field, (100, 1)), atol=1e-18, rtol=1e-12)


def test_lever_arm_from_the_moving_centre_of_gravity() -> None:
    flight = wild(400)
    place = np.array([1.2, -0.3, 0.4])
    out = run(suite("ideal", position_m=place.tolist(), **IMU), flight)
    r = flight.cg_b[0] + place - flight.cg_b
    w, dw = flight.rate_ib_b, flight.rate_dot_b
    expected = flight.accel_b + np.cross(dw, r) + np.cross(w, np.cross(w, r))
    np.testing.assert_allclose(out["imu"].accel_b, expected[::4], atol=1e-13)
    # Without a place the unit sits where the centre of gravity was at first, and stays there.
    r = flight.cg_b[0] - flight.cg_b
    expected = flight.accel_b + np.cross(dw, r) + np.cross(w, np.cross(w, r))
    np.testing.assert_allclose(run(suite("ideal", **IMU), flight)["imu"].accel_b, expected[::4], atol=1e-13)


@pytest.mark.parametrize("axes", [(90.0, 0.0, 0.0), (0.0, 0.0, 180.0), (10.0, 20.0, 30.0)])
def test_known_mounting_is_undone_unknown_is_not(axes: tuple[float, float, float]) -> None:
    flight = wild(400)
    turned = dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), axes, strict=True))
    out = run(suite("ideal", **turned, **IMU), flight)
    np.testing.assert_allclose(out["imu"].gyro_b, flight.rate_ib_b[::4], atol=1e-14)
    out = run(suite("ideal", **turned, mounting_error_deg=[0.0, 0.0, 1.0], **IMU), flight)
    error = out["imu"].gyro_b - flight.rate_ib_b[::4]
    assert 0.005 < np.abs(error).max() < 0.05


def test_delay_of_each_channel() -> None:
    """The IG-500's accelerometer lags its gyro by 25.5 ms."""
    n, hz = 4000, 0.5
    wave = np.sin(2 * np.pi * hz * np.arange(n) * DT)[:, None]
    flight = truth(n, rate_ib_b=0.1 * wave, accel_b=wave)
    quiet = {
        "accelerometer": {"delay_ms": 31.9, "bandwidth_hz": 250, "antialias_percent": 50},
        "gyro": {"delay_ms": 6.4, "bandwidth_hz": 240, "antialias_percent": 50},
    }
    s = suite("ideal", **quiet, **IMU)
    out = run(s, flight)["imu"]
    t = flight.t[::4]
    basis = np.column_stack([np.sin(2 * np.pi * hz * t), np.cos(2 * np.pi * hz * t)])[200:]
    for values, delay in ((out.gyro_b, 0.0064), (out.accel_b, 0.0319)):
        a, b = np.linalg.lstsq(basis, values[200:, 0], rcond=None)[0]
        assert -np.arctan2(b, a) / (2 * np.pi * hz) == pytest.approx(delay, abs=2e-5)
    assert (s.info.gyro_delay, s.info.accel_delay) == pytest.approx((0.0064, 0.0319))


def test_scale_misalignment_non_linearity_and_g_sensitivity() -> None:
    figures = {"gyro": {"range_dps": 100, "non_linearity_percent": 1.0, "scale_percent": 2.0, "misalignment_deg": 1.0,
                        "g_sensitivity_dps_per_g": 0.5}}  # fmt: skip
    s = suite("ideal", **figures, **IMU)
    matrix = s.drawn()["gyro.matrix"]
    rates = np.radians([[0, 0, 0], [50, 0, 0], [-50, 0, 0], [0, 50, 0], [0, -50, 0]])
    flight = truth(len(rates) * 4, rate_ib_b=np.repeat(rates, 4, axis=0))
    out = run(s, flight)["imu"].gyro_b
    np.testing.assert_allclose((out[1] - out[2]) / 2, matrix[:, 0] * rates[1, 0], atol=1e-12)
    np.testing.assert_allclose((out[3] - out[4]) / 2, matrix[:, 1] * rates[3, 1], atol=1e-12)
    square = (out[1] + out[2]) / 2 - out[0]
    assert 0 < abs(square[0]) < 4 * 0.01 * 0.25 * np.radians(100)
    np.testing.assert_allclose(square[1:], 0, atol=1e-12)
    assert 0 < np.abs(out[0]).max() < 4 * np.radians(0.5)  # 1 g on the down axis
    assert s.info.gyro_scale == pytest.approx(np.hypot(0.02, np.tan(np.radians(1))))


def test_range_clips_flags_and_keeps_whole_quanta() -> None:
    rates = np.radians([0.0, 399.0, 401.0, -1000.0])
    flight = truth(16, rate_ib_b=np.repeat(rates, 4)[:, None] * [1.0, 0.0, 0.0])
    figures = {"gyro": {"range_dps": 400, "quantum_dps": 0.7}}
    out = run(suite("ideal", **figures, **IMU), flight)["imu"]
    assert out.saturated.tolist() == [False, False, True, True]
    steps = np.degrees(out.gyro_b[:, 0]) / 0.7
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.degrees(out.gyro_b[2, 0]) == pytest.approx(571 * 0.7)
    assert np.degrees(out.gyro_b[3, 0]) == pytest.approx(-571 * 0.7)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.01, 5.0), st.floats(1.0, 300.0), st.lists(st.floats(-500, 500), min_size=3, max_size=3))
def test_clip_and_quantise_are_idempotent(quantum: float, limit: float, rate: list[float]) -> None:
    figures = {"gyro": {"range_dps": limit, "quantum_dps": quantum}}
    once = run(suite("ideal", **figures, **IMU), truth(4, rate_ib_b=np.radians(rate)))["imu"].gyro_b
    twice = run(suite("ideal", **figures, **IMU), truth(4, rate_ib_b=once[0]))["imu"].gyro_b
    np.testing.assert_allclose(twice, once, rtol=1e-12, atol=1e-12)
    assert np.abs(np.degrees(once)).max() <= limit * (1 + 1e-12)


def test_turn_on_biases_of_200_flights_have_the_specified_spread() -> None:
    flight = truth(4)
    drawn = {key: [] for key in ("gyro", "accel", "mag")}
    for seed in range(200):
        s = suite("chr_6dm", seed=seed, **MAG)
        d = s.drawn()
        drawn["gyro"].append(d["gyro.turn_on_bias"])
        drawn["accel"].append(d["accelerometer.turn_on_bias"])
        drawn["mag"].append(d["magnetometer.turn_on_bias"])
    for key, sigma in (("gyro", np.radians(0.3)), ("accel", 5e-3 * G0), ("mag", 5e-7)):
        x = np.array(drawn[key])
        assert x.std() == pytest.approx(sigma, rel=0.1)  # 600 draws: 3 % one sigma
        assert abs(x.mean()) < 0.15 * sigma
        assert np.abs(np.corrcoef(x.T) - np.eye(3)).max() < 0.25
    # The first sample really carries it.
    s = suite("ideal", gyro={"turn_on_bias_dps": 0.3}, **IMU)
    block = s.sense(flight)
    np.testing.assert_allclose(block["imu"].gyro_b[0], s.drawn()["gyro.turn_on_bias"])
    assert np.array_equal(block["imu_errors"].gyro_bias[0], s.drawn()["gyro.turn_on_bias"])


def test_logged_biases_are_those_in_the_samples() -> None:
    figures = {"gyro": {"turn_on_bias_dps": 0.3, "bias_floor_dph": 500}, "imu": {"warm_up_k": 10, "warm_up_time_s": 1}}
    figures["gyro"]["temperature_drift_dps_per_k"] = 0.05
    out = run(suite("ideal", yaw_deg=70.0, **figures, **IMU), truth(2000))
    np.testing.assert_allclose(out["imu"].gyro_b, out["imu_errors"].gyro_bias, atol=1e-15)
    assert np.ptp(out["imu_errors"].gyro_bias) > 1e-4


def test_one_sensor_is_unchanged_when_another_is_added() -> None:
    flight = wild(800)
    alone = run(suite("chr_6dm", **IMU), flight)
    full = run(suite("chr_6dm"), flight)
    assert same(alone["imu"], full["imu"])
    assert same(run(suite("chr_6dm", **MAG), flight)["mag"], full["mag"])
    changed = run(suite("chr_6dm", accelerometer={"noise_density_mg_rthz": 9.0}), flight)
    assert np.array_equal(changed["imu"].gyro_b, full["imu"].gyro_b)
    assert not np.array_equal(changed["imu"].accel_b, full["imu"].accel_b)
    other = run(suite("chr_6dm", "second"), flight)
    x = (other["imu"].gyro_b - alone["imu"].gyro_b)[:, 0]
    assert x.std() > 0


def test_suites_and_axes_are_independent() -> None:
    flight = truth(40_000)
    figures = {"gyro": {"noise_density_dps_rthz": 1.0}, "accelerometer": {"noise_density_mg_rthz": 1.0}}
    a, b = (run(suite("ideal", name, **figures, **IMU), flight)["imu"] for name in ("a", "b"))
    x = np.column_stack([a.gyro_b, a.accel_b, b.gyro_b, b.accel_b])
    assert np.abs(np.corrcoef(x.T) - np.eye(12)).max() < 0.05


@pytest.mark.parametrize("grade", ["chr_6dm", "sbg_ig500", "road_mems", "ideal"])
@pytest.mark.parametrize("block", [1, 4, 37])
def test_blocks_of_any_length_give_the_same_bytes(grade: str, block: int) -> None:
    flight = wild(1200)
    whole, pieces = run(suite(grade), flight), run(suite(grade), flight, block)
    for name, records in whole.items():
        assert same(records, pieces[name]), name


def test_warm_up_follows_its_curve() -> None:
    figures = {"imu": {"warm_up_k": 8.0, "warm_up_time_s": 2.0}}
    out = run(suite("ideal", **figures, **IMU), truth(4000, temperature=280.0))["imu"]
    t = (np.arange(len(out)) + 1) * 0.01
    np.testing.assert_allclose(out.temperature, 280.0 + 8.0 * (1 - np.exp(-t / 2.0)), atol=1e-9)


def test_jitter_moves_samples_and_stamps_alike() -> None:
    ramp = np.arange(4000) * DT
    flight = truth(4000, rate_ib_b=ramp[:, None])
    out = run(suite("ideal", imu={"jitter_ms": 0.4}, **IMU), flight)["imu"]
    early = out.arrival_ns - out.stamp_ns
    assert early.std() > 1e5
    assert early.min() >= 0
    np.testing.assert_allclose(out.gyro_b[1:, 0], out.stamp_ns[1:] * 1e-9, atol=2e-9)
    stamped = run(suite("ideal", imu={"stamp_jitter_ms": 0.4}, **IMU), flight)["imu"]
    assert (stamped.stamp_ns - stamped.arrival_ns).std() == pytest.approx(4e5, rel=0.1)
    np.testing.assert_allclose(stamped.gyro_b[:, 0], ramp[::4], atol=1e-12)


def test_vibration_is_a_line_at_the_shaft_rate_and_folds_down() -> None:
    figures = {"motor": {"reference_rpm": 6000, "harmonics": [1.0, 0.0, 0.0]},
               "accelerometer": {"vibration_line_mps2": 2.0}}  # fmt: skip
    for rpm, seen in ((1800, 30.0), (4200, 30.0), (6000, 0.0)):  # at 100 Hz, 70 Hz folds to 30, 100 to 0
        out = run(suite("ideal", **figures, **IMU), truth(16_000, rpm=rpm, accel_b=0.0))["imu"].accel_b[:, 0]
        f, power = signal.periodogram(out, 100.0, detrend=False)
        assert f[np.argmax(power)] == pytest.approx(seen, abs=0.05)
        if seen:
            assert out.std() * np.sqrt(2) == pytest.approx(2.0 * (rpm / 6000) ** 2, rel=0.01)
    # The low-pass weakens it at its true frequency: 70 Hz through 50 Hz.
    figures["accelerometer"]["bandwidth_hz"] = 50
    out = run(suite("ideal", **figures, **IMU), truth(16_000, rpm=4200, accel_b=0.0))["imu"].accel_b[:, 0]
    assert out.std() * np.sqrt(2) == pytest.approx(2.0 * 0.49 / np.sqrt(1 + 1.4**4), rel=0.01)
    assert not run(suite("ideal", **figures, **IMU), truth(400, rpm=0.0, accel_b=0.0))["imu"].accel_b.any()


def test_vibration_rectification() -> None:
    figures = {"motor": {"reference_rpm": 6000, "harmonics": [1.0, 0.0, 0.0]},
               "accelerometer": {"vibration_line_mps2": [G0, 0.0, 0.0]},
               "gyro": {"vibration_rectification_dps_per_g2": 1.0}}  # fmt: skip
    out = [run(suite("ideal", seed=s, **figures, **IMU), truth(4, rpm=6000))["imu"].gyro_b[0] for s in range(100)]
    # A line of 1 g amplitude has 0.5 g^2.
    assert np.std(out) == pytest.approx(np.radians(0.5), rel=0.15)


def test_band_noise_grows_with_the_square_of_the_speed() -> None:
    figures = {"accelerometer": {"vibration_band_mps2": 0.5}, "motor": {"reference_rpm": 6000}}
    for rpm in (3000, 6000):
        out = run(suite("ideal", **figures, **IMU), truth(40_000, rpm=rpm, accel_b=0.0))["imu"].accel_b
        assert out.std() == pytest.approx(0.5 * (rpm / 6000) ** 2, rel=0.02)


def test_magnetic_field_errors() -> None:
    flight = truth(40, throttle=np.repeat([0.0, 1.0], 20))
    field = magnetic.field_n(flight.lla[:1], EPOCH)[0]
    # The world's field is one draw for all suites.
    figures = {"magnetometer": {"model_error_nt": [137, 89, 141]}}
    a, b = (suite("ideal", name, magnetometer=figures["magnetometer"], **MAG) for name in ("a", "b"))
    x, y = run(a, flight)["mag"].mag_b, run(b, flight)["mag"].mag_b
    assert np.array_equal(x, y)
    np.testing.assert_allclose(x[0] - field, a.drawn()["magnetometer.model_error"], atol=1e-15)
    errors = [suite("ideal", seed=s, **figures, **MAG).drawn()["magnetometer.model_error"] for s in range(150)]
    np.testing.assert_allclose(np.std(errors, axis=0), [137e-9, 89e-9, 141e-9], rtol=0.2)
    # Motor current.
    s = suite("ideal", magnetometer={"motor_field_ut": 0.3}, **MAG)
    x = run(s, flight)["mag"].mag_b
    np.testing.assert_allclose(x[-1] - x[0], s.drawn()["magnetometer.motor_field"], atol=1e-15)
    # Soft iron: a symmetric matrix.
    s = suite("ideal", magnetometer={"soft_iron_percent": 2.0}, **MAG)
    matrix = s.drawn()["magnetometer.matrix"]
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-15)
    np.testing.assert_allclose(run(s, flight)["mag"].mag_b[0], matrix @ field, rtol=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from(["chr_6dm", "sbg_ig500", "road_mems", "ideal"]))
def test_finite_in_finite_out(seed: int, grade: str) -> None:
    draws = np.random.default_rng(seed)
    q = draws.standard_normal((200, 4))
    flight = truth(
        200, q_nb=q / np.linalg.norm(q, axis=1)[:, None], rate_ib_b=5 * draws.standard_normal((200, 3)),
        rate_dot_b=50 * draws.standard_normal((200, 3)), accel_b=40 * draws.standard_normal((200, 3)),
        airspeed=abs(50 * draws.standard_normal(200)), rpm=abs(8000 * draws.standard_normal(200)), throttle=1.0,
        vel_n=50 * draws.standard_normal((200, 3)),
    )  # fmt: skip
    out = run(suite(grade, seed=seed), flight)
    for name, columns in (
        ("imu", ("gyro_b", "accel_b", "temperature")), ("mag", ("mag_b",)), ("diff_pressure", ("pressure",)),
        ("static_pressure", ("pressure",)), ("air", ("indicated_airspeed", "airspeed")),
        ("imu_errors", ("gyro_bias", "accel_bias")),
    ):  # fmt: skip
        for column in columns:
            assert name not in out or np.isfinite(getattr(out[name], column)).all()
    fixed = out["fix"].fix >= 0
    assert np.isfinite(out["fix"].lla_deg[fixed]).all()


def test_the_effective_bias_is_all_but_noise() -> None:
    """At rest with wings level: bias and (scale, misalignment) x g, which no bias state can tell apart."""
    exact = {"bandwidth_hz": 0, "antialias_percent": 0, "delay_ms": 0}
    accel = {"noise_density_mg_rthz": 0, "vibration_line_mps2": 0, "vibration_band_mps2": 0, "quantum_mg": 0, **exact}
    gyro = {"noise_density_dps_rthz": 0, "vibration_line_dps": 0, "vibration_band_dps": 0, "quantum_dps": 0, **exact}
    figures = {"accelerometer": accel, "gyro": gyro, "imu": {"jitter_ms": 0}, **IMU}
    flight = dataclasses.replace(wild(4000), cg_b=np.zeros((4000, 3)))
    out = run(suite("chr_6dm", **figures, mounting_error_deg=[0.5, 0.0, 0.0]), flight)
    imu, errors = out["imu"], out["imu_errors"]
    np.testing.assert_allclose(imu.accel_b - errors.accel_effective_bias, flight.accel_b[::4], atol=1e-12)
    alike = run(
        suite("chr_6dm", **figures, mounting_error_deg=[0.5, 0.0, 0.0]),
        dataclasses.replace(flight, rate_ib_b=0.0 * flight.rate_ib_b),
    )
    np.testing.assert_allclose(errors.gyro_effective_bias, alike["imu"].gyro_b, atol=1e-12)  # what it sends at no rate
    assert np.abs(errors.gyro_effective_bias - errors.gyro_bias).max() > 1e-4  # g-sensitivity
    s = suite("chr_6dm", **figures)
    level = run(s, truth(4000))["imu_errors"]
    beyond = level.accel_effective_bias - level.accel_bias
    scale = s.drawn()["accelerometer.matrix"] - np.eye(3)
    np.testing.assert_allclose(beyond, np.tile(-9.81 * scale[:, 2], (len(beyond), 1)), atol=0.02)  # the rest: k u^2
    assert np.abs(beyond).max() > 0.02


def test_a_place_counts_from_the_centre_of_gravity() -> None:
    """The example of docs/sensors.md lies inside the aircraft: 0.1 m ahead of the centre of gravity."""
    flight = truth(400, rate_ib_b=[0.0, 0.0, 2.0], cg_b=[-0.5, 0.0, 0.0])
    out = run(suite("ideal", position_m=[0.1, 0.0, -0.05], **IMU), flight)
    np.testing.assert_allclose(out["imu"].accel_b[0], [-0.4, 0.0, -9.81], atol=1e-12)  # -w^2 r


TERMS = {
    "turn-on": "turn_on", "misalignment": "matrix", "cross-axis": "matrix", "scale": "matrix",
    "non-linearity": "square", "temperature": "temperature", "g-sensitivity": "g_matrix",
    "rectification": "rectification",
}  # fmt: skip


@pytest.mark.parametrize("term", TERMS)
def test_a_term_that_draws_more_changes_no_other(term: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every error term has a stream of its own, so that a new one leaves all flights as they are."""

    def drawn() -> dict[str, np.ndarray]:
        imu: Any = suite("chr_6dm", **IMU, **sizes)._instruments[0]
        return {name: np.array(imu.gyro.errors[name]) for name in set(TERMS.values())}

    sizes: dict[str, Any] = {
        "gyro": {"cross_axis_percent": 1.0, "non_linearity_percent": 0.1, "vibration_rectification_dps_per_g2": 0.1}
    }
    before = drawn()

    def greedy(plain: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
        def draw(self: Fitting, instrument: str, name: str, *shape: int) -> np.ndarray:
            if name != term:
                return plain(self, instrument, name, *shape)
            return plain(self, instrument, name, math.prod(shape) + 1)[1:].reshape(shape)

        return draw

    monkeypatch.setattr(Fitting, "normal", greedy(Fitting.normal))  # once a unit
    monkeypatch.setattr(Fitting, "anew", greedy(Fitting.anew))  # at each switch-on
    changed = {name for name, values in drawn().items() if not np.array_equal(values, before[name])}
    assert changed == {TERMS[term]}
