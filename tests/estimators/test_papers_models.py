"""Models of the papers: Jacobians against finite differences, filters against naive ones, their promises."""

import kernels
import numpy as np
import pytest
from synthetic import SITE, error_deg, flight, from_euler, matrix_bn

from estimators import SensorInfo, create
from estimators.adaptation import fuzzy, gating
from estimators.filters import ukf
from estimators.filters.base import Method

NAMES = ["fakf", "sekf", "ins9-ekf"]


def swaying(seconds=30.0, **options):
    t = np.arange(round(100 * seconds)) / 100.0
    grow = np.clip((t - 5.0) / 3.0, 0, 1)
    angles = (0.3 * np.sin(0.5 * t), 0.2 * np.sin(0.37 * t), 1.0 + 0.8 * np.sin(0.3 * t))
    return flight(*(grow * a + (1 - grow) * a[0] for a in angles), np.zeros((len(t), 3)), **options)


def begun(name, **settings):
    """The kernels of an estimator just aligned."""
    samples, _ = swaying(5.0)
    estimator = create(name, site=SITE, align_s=2.0, **settings)
    estimator.process(samples[:300])
    return kernels.of(estimator)


def state_of(name, rng):
    q = from_euler(0.3, -0.4, 2.0)
    if name == "sekf":
        return matrix_bn(q)[:, 2]
    if name == "fakf":
        return np.concatenate([q, 0.01 * rng.normal(size=3)])
    return np.concatenate([q, [0.76, 0.02, 200.0], [20.0, -30.0, 2.0]])


def by_differences(function, model, x, n):
    eps = 1e-3 if n == 9 else 1e-5  # a latitude is good to 1e-9 m
    columns = []
    for i in range(n):
        moved = []
        for sign in (1.0, -1.0):
            dx = np.zeros(n)
            dx[i] = sign * eps
            moved.append(function(model.retract(x, dx)))
        columns.append((moved[0] - moved[1]) / (2 * eps))
    return np.array(columns).T


@pytest.mark.parametrize("name", NAMES)
def test_jacobians_are_the_differences(name):
    rng = np.random.default_rng(2)
    model = begun(name)
    n, x = model.size, state_of(name, rng)
    u = np.array([0.4, -0.9, 0.7, 0.0, 0.0, 0.0])
    if name == "ins9-ekf":
        u[3:6] = 1.0, -2.0, -9.5
    centre = model.propagate(x, u, 0.05)

    def error(moved):
        return model.difference(model.propagate(moved, u, 0.05), centre)

    np.testing.assert_allclose(model.transition(x, u, 0.05), by_differences(error, model, x, n), atol=5e-6)
    for group, (_, rows, first, end, _) in enumerate(model.groups):
        y, H = model.observe(group, x, u), model.slope(group, x, u)

        def h(moved, group=group, y=y):
            return model.residual(group, model.observe(group, moved, u), y)

        found = by_differences(h, model, x, n)
        scale = np.abs(found).max()
        np.testing.assert_allclose(H[:rows, first:end], found[:, first:end], atol=2e-4 * scale if group == 0 else 3e-6)
        found[:, first:end] = 0.0
        assert np.abs(found).max() < 1e-6, "the group depends on states it does not declare"


@pytest.mark.parametrize("a", [0.0, 0.5, 1.0])
def test_rodrigues_parameters_come_back(a):
    model = begun("ins9-ekf", rodrigues_a=a)
    rng = np.random.default_rng(3)
    x = state_of("ins9-ekf", rng)
    for size in (1e-6, 0.1, 1.5):
        dx = np.concatenate([size * rng.normal(size=3), 10 * rng.normal(size=3), rng.normal(size=3)])
        out = model.retract(x, dx)
        assert abs(np.linalg.norm(out[:4]) - 1) < 1e-12
        np.testing.assert_allclose(model.difference(out, x), dx, atol=1e-8)
    out = model.retract(x, np.array([1e-4, 0, 0, 0, 0, 0, 0, 0, 0.0]))
    assert error_deg(out[:4], x[:4])[0] == pytest.approx(np.degrees(1e-4), rel=1e-4)


class Oracle:
    """Textbook unscented transform: every weight spelt out."""

    def __init__(self, alpha, beta, kappa):
        self.alpha, self.beta, self.kappa = alpha, beta, kappa

    def moments(self, function, n, P):
        scale = self.alpha**2 * (n + self.kappa)
        root = np.linalg.cholesky(scale * P)
        points = np.vstack([np.zeros(n), root.T, -root.T])
        mean_weight = np.full(2 * n + 1, 0.5 / scale)
        mean_weight[0] = 1 - n / scale
        weight = mean_weight.copy()
        weight[0] += 1 - self.alpha**2 + self.beta
        values = np.array([function(p) for p in points])
        mean = mean_weight @ values
        return mean, (values - mean).T @ (weight[:, None] * (values - mean))


@pytest.mark.parametrize("settings", [(1.0, 2.0, 0.0), (0.5, 2.0, 1.0), (1.0, 0.0, 0.0)])
def test_the_unscented_prediction_equals_its_oracle(settings):
    model = begun("ins9-ukf")
    rng = np.random.default_rng(4)
    x = state_of("ins9-ukf", rng)
    root = rng.normal(size=(9, 9)) * np.repeat([0.05, 1.0, 0.3], 3)[:, None]
    P = root @ root.T
    u = np.array([0.4, -0.9, 0.7, 1.0, -2.0, -9.5])
    centre = model.propagate(x, u, 0.05)

    def error(dx):
        return model.difference(model.propagate(model.retract(x, dx), u, 0.05), centre)

    mean, cov = Oracle(*settings).moments(error, 9, P)
    expected = model.retract(centre, mean)
    cov[range(3), range(3)] += model.parameters.gyro_psd * 0.05
    cov[range(3, 6), range(3, 6)] += 1e-6 * 0.05
    cov[range(6, 9), range(6, 9)] += model.parameters.accel_psd * 0.05
    method = Method(ukf, ukf.make(dict(zip(("alpha", "beta", "kappa"), settings, strict=True))))
    got, got_P = model.predict(method, x, P, u, 0.05)
    np.testing.assert_allclose(got, expected, atol=1e-9)
    np.testing.assert_allclose(got_P, cov, atol=1e-9)


def naive_adaptive(samples, x, P, last, last_gyro, model, policy):
    """The model of Tian 2011 with dense matrices and fuzzy weights, from the formulas."""
    q, e = x[:4].copy(), x[4:].copy()
    factor, smooth, count = np.ones(2), np.zeros(2), np.zeros(2)
    vectors, noises = (model.gravity_n, model.mag_n), (model.R_accel, model.R_mag)

    def skew(v):
        return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])

    def turned(q, r):
        angle = np.linalg.norm(r)
        p = np.concatenate([[np.cos(angle / 2)], np.sinc(angle / 2 / np.pi) / 2 * r])
        scalar, vector = q[0] * p[0] - q[1:] @ p[1:], q[0] * p[1:] + p[0] * q[1:] + np.cross(q[1:], p[1:])
        return np.concatenate([[scalar], vector])

    for k in range(len(samples)):
        dt, last = samples.t[k] - last, samples.t[k]
        r = (0.5 * (samples.gyro_b[k] + last_gyro) - e) * dt
        last_gyro = samples.gyro_b[k]
        a = np.linalg.norm(r)
        K = skew(r)
        F = np.eye(6)
        F[:3, :3] = np.eye(3) - np.sin(a) / a * K + (1 - np.cos(a)) / a**2 * K @ K
        J = np.eye(3) - (1 - np.cos(a)) / a**2 * K + (a - np.sin(a)) / a**3 * K @ K
        F[:3, 3:] = -0.5 * dt * J
        q = turned(q, r)
        P = F @ P @ F.T + dt * np.diag([0.25 * model.gyro_psd] * 3 + [model.bias_noise] * 3)
        for s, z in ((0, samples.accel_b[k]), (1, samples.mag_b[k])):
            if s == 1 and not samples.mag_new[k]:
                continue
            y = matrix_bn(q) @ vectors[s]
            H = np.hstack([2 * skew(y), np.zeros((3, 3))])
            HPH = H @ P @ H.T
            count[s] += 1
            d = (1 - policy.memory) / (1 - policy.memory ** count[s])
            smooth[s] = (1 - d) * smooth[s] + d * np.sum((z - y) ** 2)
            ratio = smooth[s] / np.trace(HPH + factor[s] * noises[s])
            W = np.interp(ratio, [0.5, 0.7, 1.0, 1.3, 1.5], [0.7, 0.8, 1.0, 1.2, 1.3])
            factor[s] = np.clip(W * factor[s], policy.lowest, policy.highest)
            S = HPH + factor[s] * noises[s]
            gain = P @ H.T @ np.linalg.inv(S)
            dx = gain @ (z - y)
            left = np.eye(6) - gain @ H
            P = left @ P @ left.T + gain @ (factor[s] * noises[s]) @ gain.T  # Joseph
            q, e = turned(q, 2 * dx[:3]), e + dx[3:]
        q /= np.linalg.norm(q)
    return q, e, factor


def test_the_fuzzy_filter_equals_its_naive_oracle():
    samples, _ = swaying(8.0, gyro_bias=(0.004, -0.003, 0.002))
    samples.accel_b[500:] += np.random.default_rng(1).normal(0, 0.2, (300, 3))
    estimator = create("fakf", site=SITE, align_s=2.0, noise="sensors")
    estimator.process(samples[:210])
    state = estimator.state()
    kept, model = state["filter"], estimator.parameters
    kept["trust"][:] = 0.0  # the policy from here on
    estimator.restore(state)
    policy = fuzzy.Parameters.of(memory=0.98, lowest=0.1, highest=1e6)
    last_gyro = samples.gyro_b[209]
    q, e, factor = naive_adaptive(samples[210:], kept["x"], kept["P"], float(kept["clock"]), last_gyro, model, policy)
    estimates = estimator.process(samples[210:])
    np.testing.assert_allclose(estimates.q_nb[-1] * np.sign(estimates.q_nb[-1] @ q), q, atol=1e-9)
    np.testing.assert_allclose(estimates.gyro_bias[-1], e, atol=1e-9)
    np.testing.assert_allclose(estimates.adaptation[-1, :2], 1 / factor, rtol=1e-6)


def test_fuzzy_weights_pass_through_the_printed_points():
    ratios = np.array([0.1, 0.5, 0.6, 0.7, 1.0, 1.15, 1.3, 1.5, 9.0])
    expected = np.interp(ratios, [0.5, 0.7, 1.0, 1.3, 1.5], [0.7, 0.8, 1.0, 1.2, 1.3])
    np.testing.assert_allclose([fuzzy.weight(r) for r in ratios], expected, atol=1e-15)


def test_tilt_has_no_heading_and_learns_the_bias_while_nothing_moves():
    samples, q = swaying(60.0, gyro_bias=(0.004, -0.003, 0.002), noise=0.1)
    estimates = create("tilt-ekf", site=SITE, align_s=4.0, bias_start="zero", bias_time=10.0).process(samples)
    assert np.isnan(estimates.q_nb).all() and np.isnan(estimates.gyro_bias[:, 2]).all()
    down = matrix_bn(q)[..., 2]
    assert np.abs(estimates.down_b[-1000:] - down[-1000:]).max() < 0.01
    np.testing.assert_allclose(estimates.gyro_bias[-1000:, :2].mean(0), [0.004, -0.003], atol=6e-4)


def test_the_switch_leaves_the_attitude_to_the_gyro():
    samples, _ = swaying(10.0, noise=0.1)
    samples.accel_b[600:700] *= 1.2
    estimates = create("sekf", site=SITE, align_s=3.0).process(samples)
    assert (estimates.adaptation[600:700, 0] == 0.0).all()
    assert (estimates.status[600:700] == 2).all()
    assert np.isnan(estimates.innovation[600:700]).all()


@pytest.mark.parametrize("name", ["marg-ckf", "akf-standard"])
def test_a_gate_refuses_and_believes_again(name):
    samples, q = swaying(30.0)
    samples.mag_b[1200:1500] = samples.mag_b[1200:1500, ::-1]
    settings = {"site": SITE, "align_s": 4.0, "noise": "from-ground"}
    found = [create(name, adaptation=a, **settings).process(samples) for a in ("none", "gate")]
    errors = [np.abs(error_deg(e.q_nb, q)[2][1200:1500]).max() for e in found]
    assert errors[1] < 0.5 * errors[0]
    refused = (found[1].adaptation[1200:1500] == 0.0).any(axis=1)
    assert refused.mean() > 0.8 and not (found[1].adaptation[2000:] == 0.0).any(axis=1).all()


def test_the_gate_counts_as_chi_square():
    for m, known in ((1, 9.0), (2, 11.83), (3, 14.16)):  # as likely as a normal variable within 3 sigma
        assert gating.limit(2.782, m) == pytest.approx(known, rel=0.02)
    rng = np.random.default_rng(7)
    root = rng.normal(size=(6, 6))
    S, error = root @ root.T, rng.normal(size=6)
    for counts in ([1, 1, 1], [0, 1, 1], [1, 0, 1], [0, 0, 1]):
        used = np.array([1, 1, 1, *counts], bool)
        rows = 3 + np.flatnonzero(counts)
        expected = error[rows] @ np.linalg.solve(S[np.ix_(rows, rows)], error[rows])
        assert gating.distance2(S - np.eye(6), np.eye(6), error, used, 3, 6, np.empty((6, 6))) == pytest.approx(
            expected, rel=1e-9
        )


@pytest.mark.parametrize("name", ["fakf", "sekf", "ins9-ukf"])
def test_blocks_give_the_same_bits(name):
    samples, _ = swaying(8.0)
    whole = create(name, site=SITE, align_s=3.0).process(samples)
    estimator = create(name, site=SITE, align_s=3.0)
    parts = [estimator.process(samples[a:b]) for a, b in ((0, 1), (1, 350), (350, 351), (351, 800))]
    joined = type(parts[0]).concatenate(parts)
    for column in ("q_nb", "down_b", "gyro_bias", "innovation", "adaptation", "att_cov"):
        np.testing.assert_array_equal(getattr(whole, column), getattr(joined, column))


def driving(satellites, n=6000):
    """A car that starts after 20 s and goes round: GNSS at 10 Hz, heading with it."""
    t = np.arange(n) / 100.0
    grow = np.clip((t - 20.0) / 10.0, 0, 1)
    speed = 15.0 * grow**2 * (3 - 2 * grow)
    yaw = 1.0 + 0.1 * np.cumsum(grow) / 100.0
    velocity = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), 0 * t], -1)
    place = np.cumsum(velocity, 0) / 100.0
    latitude, longitude = SITE.lla[:2]
    lla = np.stack([latitude + place[:, 0] / 6.36e6, longitude + place[:, 1] / 6.39e6 / np.cos(latitude),
                    np.full(n, SITE.lla[2])], -1)  # fmt: skip
    new = np.arange(n) % 10 == 0
    gravity = type(SITE)(SITE.lla, 9.8053, SITE.mag_n)
    return flight(
        0 * t, 0 * t, yaw, velocity, site=gravity, vel_n=velocity, lla=lla, gnss_t=t, gnss_new=new, heading=yaw,
        heading_sigma=np.full(n, 3e-3), heading_t=t, heading_new=new & (satellites >= 6), gnss_satellites=satellites,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["ins9-ekf", "ins9-ukf"])
def test_satellites_choose_the_heading(name):
    satellites = np.full(6000, 8.0)
    satellites[4000:5000], satellites[5000:5500] = 5.0, 3.0
    samples, q = driving(satellites)
    estimates = create(name, site=SITE, sensors=SensorInfo(gnss_vel=0.02), align_s=10.0).process(samples)
    _, tilt, heading = error_deg(estimates.q_nb, q)
    assert np.abs(heading[1100:]).max() < 2.0 and tilt[1100:].max() < 1.5
    used = np.isfinite(estimates.innovation)
    assert used[3000:4000, 6].any() and not used[3000:4000, 7].any()
    assert not used[4000:5500, 6].any()
    assert not used[4000:5000, 7].any(), "it turns: no course"
    assert not used[5000:5500].any() and (estimates.status[5300:5490] == 2).all()
    free = create(name, site=SITE, align_s=10.0, adaptation="none").process(samples)
    assert np.isfinite(free.innovation[4200:5000, 7]).any()
