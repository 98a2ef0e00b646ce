"""The compiled filters against naive ones, and the models' Jacobians against the complex step."""

import kernels
import numpy as np
import oracle
import pytest
from synthetic import SITE, flight, from_euler, still

from estimators import SensorInfo, create
from estimators.alignment import Stretch, concluded

SETTINGS = {"align_s": 2.0, "noise": "practical", "scale_share": 0.0}


def swaying(n=2210, seed=3, **options):
    t = np.arange(n) / 100.0
    grow = np.clip(t - 2.5, 0, 1)
    return flight(
        0.4 * grow * np.sin(0.9 * t), 0.3 * grow * np.sin(0.7 * t), 1.0 + 0.8 * grow * np.sin(0.4 * t),
        np.zeros((n, 3)), seed=seed, gyro_bias=(0.004, -0.003, 0.002), **options,
    )  # fmt: skip


@pytest.mark.parametrize(("name", "naive"), [("ekf", oracle.Ekf), ("ckf", oracle.Ckf), ("cdkf", oracle.Cdkf)])
@pytest.mark.parametrize(("initialisation", "steps", "tolerance"), [("aligned", 2000, 1e-9), ("paper", 2, 1e-6)])
def test_a_filter_equals_its_naive_oracle(name, naive, initialisation, steps, tolerance):
    """The paper's P0 = 1e4 I is 1e12 times what the first update leaves: rounding then decides, so only two steps."""
    samples, _ = swaying()
    samples.accel_b[700:710] = np.nan  # and with sensors missing
    samples.gyro_b[900, 1] = np.nan
    estimator = create(f"marg-{name}", site=SITE, initialisation=initialisation, **SETTINGS)
    first = 201 if initialisation == "aligned" else 1
    estimator.process(samples[:first])  # ends after the first row of the filter
    model, kept = estimator.parameters, estimator.state()["filter"]
    last = float(kept["clock"])
    assert last == samples.t[first - 1]
    Q = np.zeros((10, 10))
    Q[range(4), range(4)] = model.q_noise
    Q[4:7, 4:7], Q[range(7, 10), range(7, 10)] = model.Q_rate, model.bias_noise
    R = np.zeros((9, 9))
    R[:3, :3], R[3:6, 3:6], R[6:, 6:] = model.R_accel, model.R_mag, model.R_gyro
    rest = samples[first : first + steps]
    states, P = oracle.run(naive(), oracle.Marg(SITE.gravity, SITE.mag_n), kept["x"], kept["P"], Q, R, rest, last)
    estimates = estimator.process(rest)
    got = np.hstack([estimates.q_nb, estimates.gyro_bias])
    assert len(got) == steps
    np.testing.assert_allclose(got, states[:, [0, 1, 2, 3, 7, 8, 9]], rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(estimator.state()["filter"]["P"], P, rtol=1e-5, atol=1e-12 if steps > 100 else 1e-3)


@pytest.mark.parametrize("steps", [1, 2, 4])
def test_the_iterated_filter_equals_its_naive_oracle_far_from_the_truth(steps):
    """One row of a filter whose heading is 40 deg off and known to be: there a second look changes much."""
    samples, _ = swaying()
    names = {"marg-iekf": {"iterations": float(steps)}, "marg-ekf": {}}
    after = {}
    for name, more in names.items():
        estimator = create(name, site=SITE, **SETTINGS, **more)
        estimator.process(samples[:300])
        state = estimator.state()
        q, kept = state["filter"]["x"][:4].copy(), state["filter"]
        half = np.radians(20.0)
        kept["x"][:4] = [
            np.cos(half) * q[0] - np.sin(half) * q[3], np.cos(half) * q[1] - np.sin(half) * q[2],
            np.cos(half) * q[2] + np.sin(half) * q[1], np.cos(half) * q[3] + np.sin(half) * q[0],
        ]  # fmt: skip
        kept["P"][:4, :4] += 0.05 * np.eye(4)
        estimator.restore(state)
        before = {key: np.array(value) for key, value in kept.items()}
        estimator.process(samples[300:301])
        after[name] = estimator.state()["filter"]["x"], before, estimator.parameters
    found, kept, model = after["marg-iekf"]
    naive, dt = oracle.Marg(SITE.gravity, SITE.mag_n), samples.t[300] - float(kept["clock"])
    x, P = oracle.Ekf().predict(lambda v: naive.f(v, dt), kept["x"], kept["P"])
    P[range(4), range(4)] += model.q_noise * dt
    P[4:7, 4:7] += model.Q_rate * dt
    P[range(7, 10), range(7, 10)] += model.bias_noise * dt
    R = np.zeros((9, 9))
    R[:3, :3], R[3:6, 3:6], R[6:, 6:] = model.R_accel, model.R_mag, model.R_gyro
    z = np.concatenate([samples.accel_b[300], samples.mag_b[300], samples.gyro_b[300]])
    used = np.arange(9) < (6 if samples.mag_new[300] else 3)
    x, P = oracle.iterate(naive.h, x, P, z, R, used, steps)
    x, P = oracle.iterate(naive.h, x, P, z, R, np.arange(9) >= 6, 1)  # the gyro is a group of its own, and linear
    x[:4] /= np.linalg.norm(x[:4])
    np.testing.assert_allclose(found, x, rtol=1e-7, atol=1e-7)
    assert (steps == 1) == np.allclose(found, after["marg-ekf"][0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("aiding", ["none", "airspeed"])
def test_jacobians_are_the_complex_step(aiding):
    estimator = create("marg-ekf", site=SITE, initialisation="paper", noise="practical", aiding=aiding)
    model = kernels.of(estimator)
    naive = oracle.Marg(SITE.gravity, SITE.mag_n)
    rng = np.random.default_rng(5)
    for scale in (1e-6, 0.3, 30.0):  # both branches of the exponential
        x = np.concatenate([from_euler(0.3, -0.4, 2.0), scale * rng.normal(size=3), rng.normal(size=3) * 0.01])
        u = np.concatenate([np.zeros(3), [20.0, 1.0, -2.0], [0.5, 0.1, 0.2], [1.0]]) * (aiding == "airspeed")
        np.testing.assert_allclose(model.propagate(x, u, 0.01), naive.f(x, 0.01), atol=1e-15)
        F = model.transition(x, u, 0.01)
        np.testing.assert_allclose(F[:, :7], oracle.slope(lambda v: naive.f(v, 0.01), x)[:4, :7], atol=1e-14)

        def h(v, u=u):
            y = naive.h(v)
            return y + np.concatenate([np.cross(v[4:7], u[3:6]) + u[6:9], np.zeros(6)])

        for group, rows in ((0, slice(0, 6)), (1, slice(6, 9))):
            first, end = model.groups[group].first, model.groups[group].end
            np.testing.assert_allclose(model.observe(group, x, u), h(x)[rows], atol=1e-13)
            H = model.slope(group, x, u)
            expected = oracle.slope(h, x)[rows]
            np.testing.assert_allclose(H[:, first:end], expected[:, first:end], atol=1e-13)
            expected[:, first:end] = 0.0
            assert not expected.any(), "the group depends on states it does not declare"


def test_an_alignment_of_nothing_is_coarse_and_finite():
    alignment = concluded(Stretch.make(), False, SITE, SensorInfo())
    for name in ("q_nb", "sigma_n", "gyro_bias", "gyro_bias_sigma"):
        assert np.isfinite(alignment[name]).all()


def test_the_covariance_is_symmetric_and_positive_for_hours_of_updates():
    samples, _ = still(60.0)
    for name in ("marg-ekf", "marg-ckf", "marg-cdkf"):
        estimator = create(name, site=SITE, align_s=2.0)
        for hour in range(12):
            moved = type(samples)(*(samples.t + 60.0 * hour, *(getattr(samples, f) for f in samples.__slots__[1:])))
            estimator.process(moved)
            P = estimator.state()["filter"]["P"]
            assert (P == P.T).all()
            assert np.linalg.eigvalsh(P).min() > 0.0
