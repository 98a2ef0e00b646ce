"""The inertial navigators: Jacobians, manifold, aids, latency, standstill."""

import dataclasses

import numpy as np
import pytest
from kernels import Kernels
from synthetic import SITE, coordinated_turn, error_deg, flight, still

from estimators import SensorInfo, Status, create, earth
from estimators.catalogue import _CATALOGUE
from estimators.models import ins
from estimators.models.ins.aids import GROUPED, field
from estimators.settings import checked

SENSORS = SensorInfo(gyro_noise=3.7e-3 / 50**0.5, accel_noise=0.02 / 50**0.5, gyro_scale=1e-3, mag_bias=5e-7)


def model_of(name, **settings):
    values = checked(name, _CATALOGUE[name].settings, settings)
    return Kernels(ins, values, SITE, SENSORS)


def random_state(model, rng):
    x = model.x.copy()
    x[:4] = rng.normal(size=4)
    x[:4] /= np.linalg.norm(x[:4])
    x[4:7] = rng.normal(size=3) * 15
    x[7:10] = SITE.lla + rng.normal(size=3) * [1e-4, 1e-4, 50]
    x[10:] = 0.01 * rng.normal(size=len(x) - 10)
    if len(x) > 19:
        x[19:22] = 1e-6 * rng.normal(size=3)
    u = np.zeros(9)
    u[0:3], u[3:6], u[6:9] = rng.normal(size=3), rng.normal(size=3) * 5 - [0, 0, 9.8], rng.normal(size=3) * 3e-5
    return x, u


DT = 1e-4  # s: F is of first order
VARIANTS = [("ins15", {}), ("ins21", {}), ("ins21", {"aiding": "gnss+airspeed"}), ("air-ins", {})]


@pytest.mark.parametrize(("name", "settings"), VARIANTS)
def test_retract_and_difference_are_inverse(name, settings):
    model, rng = model_of(name, **settings), np.random.default_rng(1)
    n = model.size
    x, _ = random_state(model, rng)
    dx = np.concatenate([rng.normal(size=3) * 0.3, rng.normal(size=3), rng.normal(size=3) * 10, np.zeros(n - 9)])
    np.testing.assert_allclose(model.difference(model.retract(x, dx), x), dx[:9], rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize(("name", "settings"), VARIANTS)
def test_jacobians_are_differences(name, settings):
    """Central differences on the manifold; Earth rate, Coriolis and curvature terms are left out of F on purpose."""
    model, rng = model_of(name, **settings), np.random.default_rng(2)
    n = model.size
    step = np.concatenate([np.full(3, 1e-5), np.full(3, 1e-3), np.full(3, 1.0), np.full(n - 9, 1e-5)])
    step[18:21] = 1e-9
    for _ in range(3):
        x, u = random_state(model, rng)
        F, numeric = model.transition(x, u, DT), np.zeros((9, n))
        for j in range(n):
            ends = []
            for sign in (1, -1):
                dx = np.zeros(n)
                dx[j] = sign * step[j]
                ends.append(model.propagate(model.retract(x, dx), u, DT))
            numeric[:, j] = model.difference(*ends) / (2 * step[j])
        np.testing.assert_allclose((F - np.eye(9, n)) / DT, (numeric - np.eye(9, n)) / DT, atol=0.02)
        for group, aid in enumerate(GROUPED):
            H = model.slope(group, x, u)
            for j in range(n):
                y = []
                for sign in (1, -1):
                    dx = np.zeros(n)
                    dx[j] = sign * step[j]
                    y.append(model.observe(group, model.retract(x, dx), u))
                off = model.residual(group, *y)
                if aid is field and j < 2:
                    assert H[0, j] == 0.0  # the horizon is none of its business
                else:
                    scale = max(1.0, 1e-9 / step[j])
                    expected = off / (2 * step[j])
                    np.testing.assert_allclose(H[:, j] / scale, expected / scale, rtol=2e-4, atol=1e-3)


def flown(turn_s=60.0, latency=0.0, **options):
    """The coordinated turn with GNSS place and velocity that are `latency` old when they arrive."""
    samples, truth, turning = coordinated_turn(turn_s=turn_s, **options)
    n, new = len(samples), samples.gnss_new
    along = np.interp(samples.t, samples.t, samples.airspeed)
    yaw = np.unwrap(2 * np.arctan2(truth[:, 3], truth[:, 0]))
    C_nb0 = np.stack([np.cos(_yaw(truth)), np.sin(_yaw(truth)), 0 * yaw], -1)
    velocity = along[:, None] * C_nb0
    place = np.cumsum(velocity, 0) / 100.0
    along_m, across_m = earth.radii(SITE.lla[0])
    lla = np.array(SITE.lla) + place * [
        1 / (along_m + SITE.lla[2]), 1 / ((across_m + SITE.lla[2]) * np.cos(SITE.lla[0])), -1.0
    ]  # fmt: skip
    fix = np.maximum.accumulate(np.where(new, np.arange(n), 0))
    then = (fix - round(latency * 100)).clip(0)
    return (
        dataclasses.replace(samples, lla=lla[then], vel_n=velocity[then], gnss_t=samples.t[then]), truth, turning,
    )  # fmt: skip


def _yaw(q):
    return np.arctan2(2 * (q[:, 0] * q[:, 3] + q[:, 1] * q[:, 2]), 1 - 2 * (q[:, 2] ** 2 + q[:, 3] ** 2))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("name", ["ins15", "ins21", "air-ins"])
def test_it_is_right_in_a_sustained_turn(name):
    samples, truth, turning = flown()
    estimates = create(name, site=SITE, sensors=SENSORS, align_s=10.0).process(samples)
    _, tilt, heading = error_deg(estimates.q_nb[turning], truth[turning])
    assert rms(tilt) < 0.3
    assert rms(heading) < 0.6
    if name != "air-ins":
        assert np.abs(estimates.vel_n[turning][:, 2]).max() < 0.5
        assert np.ptp(estimates.lla[turning][:, 2]) < 5.0


def test_latency_is_compensated():
    samples, truth, turning = flown(latency=0.15)
    yaw = _yaw(truth[turning])
    velocity = 23.0 * np.stack([np.cos(yaw), np.sin(yaw)], -1)
    off = []
    for stamps in (samples.gnss_t, samples.t.copy()):  # as it was, and taken for true on arrival
        stamped = dataclasses.replace(samples, gnss_t=stamps)
        estimates = create("ins21", site=SITE, sensors=SENSORS, align_s=10.0).process(stamped)
        off.append(rms(estimates.vel_n[turning][:, :2] - velocity))
    assert off[0] < 0.15
    assert off[1] > 0.4


def test_blocks_give_the_same_bits_and_a_checkpoint_goes_on():
    samples, _, _ = flown(turn_s=5.0, ground_s=5.0)
    settings = {"site": SITE, "sensors": SENSORS, "align_s": 2.0}
    whole = create("ins21", **settings).process(samples)
    stepped, parts, start = create("ins21", **settings), [], 0
    for length in [1] * 250 + [300, 7, 1000, len(samples)]:
        if length == 1000:
            state, stepped = stepped.state(), create("ins21", **settings)
            stepped.restore(state)
        parts.append(stepped.process(samples[start : start + length]))
        start += length
    joined = type(whole).concatenate(parts)
    for name in whole.__match_args__:
        np.testing.assert_array_equal(getattr(whole, name), getattr(joined, name), err_msg=name)


def test_hand_held_it_keeps_the_horizon():
    t = np.arange(6000) / 100.0
    grow = np.clip((t - 5.0) / 3.0, 0, 1)
    angles = (0.6 * grow * np.sin(1.5 * t), 0.5 * grow * np.sin(1.1 * t), 0.8 * grow * np.sin(0.7 * t))
    sway = 0.4 * grow[:, None] * np.cos(np.outer(t, [2.0, 1.7, 2.3]))
    samples, truth = flight(*angles, sway, gyro_bias=(0.004, -0.003, 0.002))
    estimates = create("hand-ins", site=SITE, sensors=SENSORS, align_s=3.0).process(samples)
    _, tilt, heading = error_deg(estimates.q_nb[1000:], truth[1000:])
    assert rms(tilt) < 0.5
    assert rms(heading) < 1.5
    assert (estimates.status[400:] == Status.RUNNING).all()


def test_standing_still_it_finds_the_bias_and_does_not_drift():
    samples, truth = still(120.0, gyro_bias=(0.004, -0.003, 0.002))
    estimates = create("ins21", site=SITE, sensors=SENSORS, align_s=5.0).process(samples)
    assert (estimates.adaptation[-500:, 0] == 1.0).all()
    np.testing.assert_allclose(estimates.gyro_bias[-1], [0.004, -0.003, 0.002], atol=2e-4)
    assert np.abs(estimates.vel_n[-1]).max() < 0.1
    assert error_deg(estimates.q_nb[-1:], truth[-1:])[0] < 0.5


def test_a_magnetic_disturbance_is_not_believed_and_never_tilts():
    samples, truth = still(120.0)
    samples.mag_b[6000:9000] += [3e-5, 2e-5, -2e-5]
    estimates = create("ins21", site=SITE, sensors=SENSORS, align_s=5.0).process(samples)
    _, tilt, heading = error_deg(estimates.q_nb[1000:], truth[1000:])
    assert tilt.max() < 0.3
    assert np.abs(heading).max() < 3.0
    assert np.nanmax(estimates.adaptation[6500:8500, 1]) > 5.0


def test_an_outage_coasts_and_airspeed_carries_through():
    samples, truth, _ = flown(turn_s=90.0)
    lost = samples.t > 70.0
    samples.gnss_new[lost] = False
    tilt = {}
    for aiding in ("gnss", "gnss+airspeed"):
        estimates = create("ins21", site=SITE, sensors=SENSORS, align_s=10.0, aiding=aiding).process(samples)
        tilt[aiding] = rms(error_deg(estimates.q_nb[lost], truth[lost])[1])
        expected = Status.COASTING if aiding == "gnss" else Status.RUNNING
        assert (estimates.status[samples.t > 73.0] == expected).all()
        P = estimates.att_cov[-1]
        assert np.linalg.eigvalsh(P).min() > 0.0
    assert tilt["gnss+airspeed"] < 0.5
    assert tilt["gnss"] < 3.0


@pytest.mark.parametrize("size", [4.0, 40.0])
def test_fixes_that_jump_take_the_velocity_along_but_not_the_attitude(size):
    """A receiver is off by `size` m/s for 15 s in a turn, and right again."""
    samples, q, _ = coordinated_turn()
    wrong = (samples.t >= 60.0) & (samples.t < 75.0)
    vel_n = samples.vel_n + np.where(wrong, size, 0.0)[:, None] * [1.0, -1.0, 0.0]
    found = create("ins21", site=SITE, sensors=SENSORS).process(dataclasses.replace(samples, vel_n=vel_n))
    _, tilt, heading = error_deg(found.q_nb, q)
    after = samples.t > 59.0
    assert tilt[after].max() < 0.5
    assert np.abs(heading[after]).max() < 1.0
    there = (samples.t > 61.0) & wrong
    assert found.vel_n[there, 0] == pytest.approx(vel_n[there, 0], abs=1.5)


def test_a_gap_of_the_imu_opens_what_it_has_missed():
    """The bank changes by 12 deg while nothing is measured; the navigator knows, and GNSS brings it back."""
    n = 7000
    t = np.arange(n) / 100.0
    bank = np.where(t > 45.4, 0.5236, 0.3142) * np.clip((t - 41.0) / 2.0, 0.0, 1.0)
    along = 23.0 * np.clip((t - 22.0) / 15.0, 0.0, 1.0)
    yaw = 0.5 + np.cumsum(np.where(along > 1.0, 9.805 * np.tan(bank) / np.maximum(along, 1.0), 0.0)) / 100.0
    vel = np.stack([along * np.cos(yaw), along * np.sin(yaw), 0.0 * t], -1)
    new = np.arange(n) % 20 == 0
    samples, q = flight(bank, 0.0 * t, yaw, vel, vel_n=vel, gnss_t=t, gnss_new=new)
    kept = (t < 45.0) | (t >= 45.8)
    found = create("ins21", site=SITE, sensors=SENSORS).process(samples[kept])
    _, tilt, _ = error_deg(found.q_nb, q[kept])
    first = int(np.searchsorted(t[kept], 45.8))
    assert tilt[first] > 8.0  # nobody could have measured it
    assert np.degrees(np.sqrt(np.diag(found.att_cov[first]))).min() > 3.0
    assert tilt[t[kept] > 53.0].max() < 1.0


def test_dual_antenna_heading_is_used():
    samples, truth = still(60.0)
    heading = np.full(len(samples), 1.0)
    new = np.arange(len(samples)) % 20 == 0
    with_heading = dataclasses.replace(
        samples, heading=heading, heading_sigma=np.full(len(samples), 2e-3), heading_t=samples.t, heading_new=new,
        mag_b=samples.mag_b * np.nan,
    )  # fmt: skip
    estimates = create("ins21", site=SITE, sensors=SENSORS, align_s=5.0).process(with_heading)
    assert np.abs(error_deg(estimates.q_nb[-1:], truth[-1:])[2]) < 0.3


@pytest.mark.parametrize("filter_", ["ckf", "cdkf"])
def test_sigma_point_filters_run_on_the_manifold_too(filter_):
    samples, truth, turning = flown(turn_s=20.0)
    estimates = create("ins15", filter=filter_, site=SITE, sensors=SENSORS, align_s=10.0).process(samples)
    assert rms(error_deg(estimates.q_nb[turning], truth[turning])[1]) < 0.3


def test_missing_samples_coast_and_recover():
    samples, truth, _ = flown()
    samples.gyro_b[5000:5020] = np.nan
    samples.accel_b[6000] = np.inf
    samples.vel_n[7000:7100] = np.nan
    estimates = create("ins21", site=SITE, sensors=SENSORS, align_s=10.0).process(samples)
    assert (estimates.status[5000:5020] == Status.COASTING).all()
    assert np.isfinite(estimates.q_nb[1100:]).all()
    assert rms(error_deg(estimates.q_nb[-500:], truth[-500:])[1]) < 1.0


def test_an_impact_too_fast_for_the_sampling_opens_the_heading():
    samples, _ = still(40.0)
    gyro_b = samples.gyro_b.copy()
    hit = np.searchsorted(samples.t, 30.0)
    gyro_b[hit : hit + 10, 0] += 5.0 * (-1.0) ** np.arange(10)
    estimator = create("ins21", site=SITE, sensors=SENSORS, align_s=5.0)
    variance = estimator.process(dataclasses.replace(samples, gyro_b=gyro_b)).att_cov[:, 2, 2]
    assert variance[hit + 10] > 10 * variance[hit - 1]


def test_a_faster_magnetometer_does_not_count_for_more():
    samples, _ = still(40.0)
    slow = samples.mag_new & (np.arange(len(samples.t)) % 10 == 0)
    sigmas = []
    for mag_new in (slow, np.ones(len(slow), bool)):
        estimator = create("ins21", site=SITE, sensors=SENSORS, align_s=5.0)
        sigmas.append(estimator.process(dataclasses.replace(samples, mag_new=mag_new)).att_cov[-1, 2, 2] ** 0.5)
    assert sigmas[1] == pytest.approx(sigmas[0], rel=0.05)


def _turned_field(samples, wrong):
    """The samples with the field 60 degrees off about the vertical of the aircraft where `wrong`."""
    c, s = np.cos(np.radians(60.0)), np.sin(np.radians(60.0))
    turned = samples.mag_b @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return dataclasses.replace(samples, mag_b=np.where(wrong[:, None], turned, samples.mag_b))


@pytest.mark.parametrize("name", ["ins21", "ins-cal"])
def test_a_field_that_motion_contradicts_is_given_up_and_taken_back(name):
    samples, truth, _ = flown(turn_s=150.0)
    wrong = samples.t < 120.0
    estimates = create(name, site=SITE, sensors=SENSORS).process(_turned_field(samples, wrong))
    given_up = estimates.adaptation[:, 2] == 1.0
    turning = (samples.t > 60.0) & wrong
    assert given_up[turning].all()
    assert (estimates.status[turning] == Status.COASTING).all()
    _, tilt, heading = error_deg(estimates.q_nb, truth)
    assert rms(heading[turning]) < 4.0  # opened, and learnt anew in the turn
    assert rms(tilt[turning]) < 1.2
    later = samples.t > 140.0
    assert not given_up[later].any()
    assert (estimates.status[later] == Status.RUNNING).all()
    assert rms(heading[later]) < 2.0


@pytest.mark.parametrize("name", ["ins21", "ins-cal"])
def test_a_field_without_motion_is_not_contradicted(name):
    samples, _ = still(60.0)
    estimates = create(name, site=SITE, sensors=SENSORS).process(_turned_field(samples, samples.t > 30.0))
    assert not (estimates.adaptation[:, 2] == 1.0).any()
