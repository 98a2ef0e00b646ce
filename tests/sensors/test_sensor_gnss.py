"""Satellites, GNSS and dual-antenna heading."""

import datetime
import math

import numpy as np
import pytest
from scipy import signal
from sensor_helpers import DT, EPOCH, START, fault, quaternion, run, same, suite, truth, wild

from ahrs_sim.errors import InputError
from ahrs_sim.world import satellites
from ahrs_sim.world.wgs84 import offset_n

GNSS = {"instruments": ["imu", "gnss"]}
HEADING = {"instruments": ["imu", "gnss", "heading"]}


def day(minutes: int = 2) -> np.ndarray:
    return satellites.seconds_since_epoch(EPOCH) + np.arange(0, 86400, 60.0 * minutes)


@pytest.mark.parametrize(("mask", "least", "mean", "most"), [(10, 5, 6.8, 8), (15, 4, 5.9, 8)])
def test_satellites_at_forty_north(mask: int, least: int, mean: float, most: int) -> None:
    t = day()
    lla, q = np.tile([math.radians(40), 0.0, 0.0], (len(t), 1)), np.tile([1.0, 0, 0, 0], (len(t), 1))
    count = satellites.in_view(t, lla, q, math.radians(mask), -math.pi / 2)
    assert (count.min(), count.max()) == (least, most)
    assert count.mean() == pytest.approx(mean, abs=0.15)


def test_satellite_geometry() -> None:
    t = day(20)
    lla = np.tile([0.7, 0.3, 0.0], (len(t), 1))
    e = satellites.directions(t, lla)
    np.testing.assert_allclose(np.linalg.norm(e, axis=2), 1.0, rtol=1e-12)
    # Seen from the northern hemisphere there is a hole to the north (no orbit above 55 degrees).
    high_north = (-e[..., 2] > math.sin(math.radians(20))) & (e[..., 2] < -0.2) & (e[..., 0] > 0.85)
    assert not high_north.any()
    # The ground track repeats after one sidereal day.
    again = satellites.directions(t + 86164.09, lla)
    assert np.abs(again - e).max() < 5e-3
    utc = datetime.datetime(2026, 6, 1, 10)
    assert satellites.seconds_since_epoch(utc) == satellites.seconds_since_epoch(EPOCH)


def test_the_airframe_hides_satellites_in_a_bank() -> None:
    t = day()
    lla = np.tile([math.radians(40), 0.0, 0.0], (len(t), 1))
    mean = []
    for bank in (0, 30, 60):
        q = np.tile(quaternion(math.radians(bank)), (len(t), 1))
        mean.append(satellites.in_view(t, lla, q, math.radians(5), 0.0).mean())
    assert mean[0] > mean[1] + 0.5 > mean[2] + 1.0
    assert satellites.in_view(t[:0], lla[:0], lla[:0], 0.1, 0.0).shape == (0,)


def test_what_real_receivers_do_and_do_not_say() -> None:
    """A latency that the stamps do not know, a velocity that lags, a place that settles after switch-on."""
    flight = wild(4000)
    clean = {"antenna_m": [0.0, 0.0, 0.0], "latency_ms": 300.0, "rate_hz": 20.0}
    known = run(suite("ideal", gnss=clean, **GNSS), flight)
    late = run(suite("ideal", gnss={**clean, "undeclared_ms": 200.0}, **GNSS), flight)
    np.testing.assert_array_equal(late["velocity"].vel_n, known["velocity"].vel_n)
    np.testing.assert_array_equal(late["fix"].stamp_ns - known["fix"].stamp_ns, 200_000_000)
    np.testing.assert_array_equal(late["fix"].arrival_ns, known["fix"].arrival_ns)
    lagging = run(suite("ideal", gnss={**clean, "velocity_lag_ms": 100.0}, **GNSS), flight)["velocity"].vel_n
    t, true = 0.05 * np.arange(len(lagging)), known["velocity"].vel_n
    for k in range(3):  # 1 / (0.1 s + 1) on a velocity that is linear between fixes
        _, behind, _ = signal.lsim(([10.0], [1.0, 10.0]), true[:, k], t, X0=true[:1, k] / 10.0)
        np.testing.assert_allclose(lagging[:, k], behind, atol=1e-9)
    settling = suite("ideal", gnss={**clean, "start_up_m": 20.0, "start_up_time_s": 3.0}, **GNSS)
    off = run(settling, flight)
    metres = (off["fix"].lla_deg[:, 2] - known["fix"].lla_deg[:, 2]) * -1.0
    t = off["fix"].stamp_ns * 1e-9
    np.testing.assert_allclose(metres, settling.drawn()["gnss.start_up"][2] * np.exp(-t / 3.0), atol=1e-5)
    rate = off["velocity"].vel_n[:, 2] - known["velocity"].vel_n[:, 2]
    np.testing.assert_allclose(rate, -metres / 3.0, atol=1e-5)
    with pytest.raises(InputError, match="more than the latency"):
        suite("ideal", gnss={"latency_ms": 50.0, "undeclared_ms": 100.0}, **GNSS)


def test_antenna_lever_arm_and_velocity() -> None:
    flight = wild(800)
    arm = np.array([-0.8, 0.2, -0.5])
    out = run(
        suite("ideal", position_m=[0.5, 0.0, 0.0], gnss={"antenna_m": arm.tolist(), "latency_ms": 0}, **GNSS), flight
    )
    rows = slice(0, 800, 80)
    a, b, c, d = flight.q_nb[rows].T
    c_nb = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
        ]
    ).transpose(2, 0, 1)
    r = arm + np.array([0.5, 0, 0]) + flight.cg_b[0] - flight.cg_b[rows]
    velocity = flight.vel_n[rows] + np.einsum("nij,nj->ni", c_nb, np.cross(flight.rate_ib_b[rows], r))
    np.testing.assert_allclose(out["velocity"].vel_n, velocity, atol=1e-12)
    lla = out["fix"].lla_deg * [math.pi / 180, math.pi / 180, 1.0]
    for i in range(len(lla)):
        shift = offset_n(lla[i : i + 1], flight.lla[rows][i])[0]
        np.testing.assert_allclose(shift, c_nb[i] @ r[i], atol=1e-6)


def test_messages_come_late_and_in_order() -> None:
    s = suite("ideal", gnss={"latency_ms": 110, "rate_hz": 10}, **GNSS)
    flight = truth(800)
    got = []
    for i in range(0, 800, 4):
        block = s.sense(flight[i : i + 4])
        got += [(flight.t[i + 3], x) for x in block["fix"].arrival_ns.tolist()]
        assert same(block["fix"][:0], block["fix"][:0])
    assert len(got) == 19  # 2 s at 10 Hz, the last still on its way
    assert all(arrival * 1e-9 <= now + 1e-9 < arrival * 1e-9 + 4 * DT for now, arrival in got)
    out = run(suite("ideal", gnss={"latency_ms": 110, "rate_hz": 10}, **GNSS), flight)
    assert np.array_equal(out["fix"].arrival_ns - out["fix"].stamp_ns, np.full(19, 110_000_000))
    assert np.array_equal(out["fix"].stamp_ns, np.arange(19) * 100_000_000)
    assert np.array_equal(out["velocity"].stamp_ns, out["fix"].stamp_ns)


def test_position_error_wanders_and_velocity_error_is_white() -> None:
    s = suite(
        "ideal",
        gnss={
            "position_wander_m": [2.0, 2.0, 4.0],
            "position_noise_m": 0.5,
            "wander_time_s": 10,
            "velocity_noise_mps": 0.1,
            "rate_hz": 10,
            "latency_ms": 0,
        },
        dt=0.1,
        rate_hz=10.0,
        **GNSS,
    )
    flight = truth(40_000, dt=0.1)
    out = run(s, flight)
    lla = out["fix"].lla_deg * [math.pi / 180, math.pi / 180, 1.0]
    error = offset_n(lla, START)
    np.testing.assert_allclose(error.std(axis=0), np.hypot([2, 2, 4], 0.5), rtol=0.15)
    np.testing.assert_allclose(out["fix"].sigma[0], np.hypot([2, 2, 4], 0.5))
    centred = error - error.mean(axis=0)
    lagged = (centred[100:] * centred[:-100]).mean(axis=0) / [4, 4, 16]
    np.testing.assert_allclose(lagged, math.exp(-1), atol=0.15)
    v = out["velocity"].vel_n
    np.testing.assert_allclose(v.std(axis=0), 0.1, rtol=0.03)
    assert abs(np.corrcoef(v[1:, 0], v[:-1, 0])[0, 1]) < 0.02


def test_no_fix_below_four_satellites_and_reacquisition() -> None:
    cap = [fault(sensor="gnss", kind="satellites", count=3, at_s=1.0, for_s=1.0)]
    out = run(suite("ideal", gnss={"reacquisition_s": 0.6, "latency_ms": 0}, faults=cap, **GNSS), truth(1600))["fix"]
    t = out.stamp_ns * 1e-9
    lost = out.fix < 0
    assert np.array_equal(lost, (t >= 1.0) & (t < 2.6 - 1e-9))
    assert np.array_equal(np.isnan(out.lla_deg).all(axis=1), lost)
    assert np.array_equal(np.isnan(out.sigma).all(axis=1), lost)
    assert out.satellites[(t >= 1.0) & (t < 2.0)].tolist() == [3] * 5


def test_heading_needs_six_satellites() -> None:
    cap = [fault(sensor="gnss", kind="satellites", count=5, at_s=1.0, for_s=1.0)]
    out = run(suite("ideal", faults=cap, **HEADING), truth(1600, q_nb=quaternion(yaw=2.0)))
    t = out["heading"].stamp_ns * 1e-9
    lost = (t >= 1.0) & (t < 2.0)
    assert np.array_equal(np.isnan(out["heading"].heading), lost)
    np.testing.assert_allclose(out["heading"].heading[~lost], 2.0)
    assert (out["fix"].fix >= 0).all()  # five are enough for a position


@pytest.mark.parametrize("baseline", [1.0, 2.0, 3.0])
def test_heading_sigma_follows_the_baseline(baseline: float) -> None:
    figures = {"heading": {"baseline_m": baseline, "phase_noise_mm": 1.4, "phase_wander_mm": 3.2, "wander_time_s": 2}}
    s = suite("ideal", dt=0.2, rate_hz=5.0, **figures, **HEADING)
    error = np.degrees(run(s, truth(20_000, dt=0.2))["heading"].heading)
    assert error.std() == pytest.approx(
        57.3 * 3.5e-3 / baseline, rel=0.05
    )  # Ekinox-D: 0.2 / 0.1 / 0.05 deg at 1 / 2 / 3 m
    assert np.corrcoef(error[1:], error[:-1])[0, 1] > 0.6
    assert s.info.heading == pytest.approx(3.5e-3 / baseline, rel=0.01)


def test_heading_of_a_tilted_baseline() -> None:
    across = {"heading": {"baseline_yaw_deg": 90.0}}
    q = quaternion(roll=0.5, yaw=1.0)
    along = run(suite("ideal", **HEADING), truth(80, q_nb=q))["heading"].heading[0]
    assert along == pytest.approx(1.0)
    # A baseline along the wings has the heading of its own projection.
    assert run(suite("ideal", **across, **HEADING), truth(80, q_nb=q))["heading"].heading[0] == pytest.approx(1.0)
    q = quaternion(roll=0.5, pitch=0.4, yaw=1.0)
    c = np.array([math.sin(0.5) * math.sin(0.4), math.cos(0.5)])
    expected = 1.0 + math.atan2(c[1], c[0]) - math.pi / 2
    assert run(suite("ideal", **across, **HEADING), truth(80, q_nb=q))["heading"].heading[0] == pytest.approx(expected)
    steep = run(suite("ideal", **HEADING), truth(80, q_nb=quaternion(pitch=math.radians(85))))
    assert np.isnan(steep["heading"].heading).all()
    out = [
        run(suite("ideal", seed=s, heading={"misalignment_deg": 0.2}, **HEADING), truth(4))["heading"].heading[0]
        for s in range(200)
    ]
    assert np.degrees(np.std(out)) == pytest.approx(0.2, rel=0.15)


def test_wrong_fixes_come_by_chance_and_last() -> None:
    figures = {"heading": {"wrong_fixes_per_h": 60.0, "wrong_fix_time_s": 8.0}}
    error = run(suite("ideal", dt=0.2, rate_hz=5.0, **figures, **HEADING), truth(180_000, dt=0.2))["heading"].heading
    wrong = np.abs(error) > 0.1
    np.testing.assert_allclose(np.abs(error[wrong]), math.asin(0.1903), rtol=1e-9)
    begins = np.flatnonzero(wrong[1:] & ~wrong[:-1])
    assert len(begins) == pytest.approx(600 / (1 + 8 / 60), rel=0.15)
    assert wrong.mean() == pytest.approx(len(begins) * 8.0 / 36_000, rel=0.05)
    assert {1.0, -1.0} == set(np.sign(error[wrong]))
