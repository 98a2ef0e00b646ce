import math

import numpy as np
import pytest

from estimators.errors import SampleError, SettingError
from estimators.locate import EmitterLocator, Looks
from estimators.models.emitter import (
    PHASE,
    RATE,
    Emitter,
    bearings,
    hypotheses,
    look,
    look_noise,
    range_from_rate,
    range_sigma,
)
from estimators.types import Status

MODEL = Emitter.make(heading_sigma=1e-3, heading_rate_sigma=1e-4, frequency_sigma=1e5)
TARGET = np.array([60e3, 80e3])
INPUTS = [
    np.array([0.0, 0.0, 270.0, 0.0, 0.0, 0.0]),
    np.array([3e3, -2e3, 200.0, 90.0, 0.5, 0.01]),
    np.array([5e3, 9e3, -120.0, 180.0, -2.9, -0.02]),
]


def predict(model, x, u):
    y, H = np.empty(2), np.empty((2, 2))
    theta = look(model, np.asarray(x, float), np.asarray(u, float), y, H)
    return y, H, theta


def slope(function, x, step):
    columns = []
    for i in range(len(x)):
        d = np.zeros(len(x))
        d[i] = step[i]
        columns.append((function(x + d) - function(x - d)) / (2 * step[i]))
    return np.array(columns).T


@pytest.mark.parametrize("u", INPUTS)
def test_jacobian(u):
    numeric = slope(lambda x: predict(MODEL, x, u)[0], TARGET, [1.0, 1.0])
    np.testing.assert_allclose(predict(MODEL, TARGET, u)[1], numeric, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("u", INPUTS)
def test_phase_rate_is_the_derivative_of_the_phase(u):
    def phase(t):
        moved = u + t * np.array([u[2], u[3], 0, 0, u[5], 0])
        return predict(MODEL, TARGET, moved)[0][PHASE]

    assert predict(MODEL, TARGET, u)[0][RATE] == pytest.approx((phase(0.01) - phase(-0.01)) / 0.02, rel=1e-5)


@pytest.mark.parametrize("u", INPUTS)
def test_range_formula_inverts_the_model(u):
    y, _, theta = predict(MODEL, TARGET, u)
    assert range_from_rate(MODEL.k, theta, y[RATE], u) == pytest.approx(np.hypot(*(TARGET - u[:2])), rel=1e-9)


@pytest.mark.parametrize("u", INPUTS)
def test_range_sigma_is_first_order_propagation(u):
    y, _, theta = predict(MODEL, TARGET, u)

    def away(p):  # theta, vx, vy, phase rate, alpha, alpha rate, relative frequency
        inputs = np.array([u[0], u[1], p[1], p[2], p[4], p[5]])
        return np.array([range_from_rate(MODEL.k * p[6], p[0], p[3], inputs)])

    at = np.array([theta, u[2], u[3], y[RATE], u[4], u[5], 1.0])
    sigma = np.array([0.01, 2.0, 2.0, MODEL.phase_rate, 1e-3, 1e-4, MODEL.frequency])
    gradient = slope(away, at, [1e-6, 1e-3, 1e-3, 1e-6, 1e-6, 1e-8, 1e-6])[0]
    expected = math.sqrt(np.sum((gradient * sigma) ** 2))
    assert range_sigma(MODEL, theta, 0.01, y[RATE], u) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("u", INPUTS)
def test_noise_is_first_order_propagation(u):
    sigma = np.array([10.0, 10.0, 2.0, 2.0, 1e-3, 1e-4])
    G = slope(lambda v: predict(MODEL, TARGET, v)[0], u, [1.0, 1.0, 1e-3, 1e-3, 1e-6, 1e-6])
    expected = np.diag([MODEL.phase**2, MODEL.phase_rate**2]) + G @ np.diag(sigma**2) @ G.T
    S = np.zeros((2, 2))
    look_noise(MODEL, TARGET, u, S)
    np.testing.assert_allclose(S[np.tril_indices(2)], expected[np.tril_indices(2)], rtol=1e-6)


def test_constant_of_the_paper():
    assert Emitter.make().k == pytest.approx(1257.0, abs=1.0)


def test_bearings_explain_the_phase_and_the_paper_has_six_terms():
    u = INPUTS[0]
    y, _, theta = predict(MODEL, TARGET, u)
    wrapped = math.remainder(y[PHASE], 2 * math.pi)
    sigma = math.radians(5)
    found = bearings(MODEL.k, wrapped, 0.0, theta, sigma)
    phases = MODEL.k * np.cos(found) - wrapped
    np.testing.assert_allclose(phases, 2 * math.pi * np.round(phases / (2 * math.pi)), atol=1e-9)
    assert np.abs(found - theta).max() <= 2 * sigma
    assert np.abs(found - theta).min() < 1e-9  # the truth is one of them
    assert np.all(np.diff(found) > 0)
    means, covariances = hypotheses(
        MODEL, wrapped, y[RATE], u, coarse=theta, coarse_sigma=sigma, every=9, bearing_sigma=math.radians(1)
    )
    assert len(means) == 6
    assert np.all(np.linalg.eigvalsh(covariances) > 0)


def test_bearings_of_both_sides_and_across_the_cut():
    ahead = bearings(100.0, 0.3, 0.0, 0.0, 0.2)  # ahead: left and right of the baseline both explain the phase
    assert (ahead > 0).any() and (ahead < 0).any()
    left = bearings(1257.0, 0.3, math.pi / 2, math.pi - 0.01, 0.05)
    assert (left > 0).any() and (left < 0).any() and np.all(np.abs(left) <= math.pi)
    assert len(bearings(10.0, 0.3, 0.0, 0.2, 1e-6)) == 0


def test_covariance_of_a_hypothesis_has_the_axes_of_range_and_cross_range():
    u = INPUTS[0]
    y, _, theta = predict(MODEL, TARGET, u)
    means, covariances = hypotheses(
        MODEL, math.nan, y[RATE], u, coarse=theta, coarse_sigma=0.05, every=5, bearing_sigma=0.01
    )
    for mean, P in zip(means, covariances, strict=True):
        away, angle = np.hypot(*mean), math.atan2(mean[1], mean[0])
        along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
        assert math.sqrt(along @ P @ along) == pytest.approx(range_sigma(MODEL, angle, 0.01, y[RATE], u), rel=1e-9)
        assert math.sqrt(across @ P @ across) == pytest.approx(away * 0.01, rel=1e-9)
        assert along @ P @ across == pytest.approx(0.0, abs=1e-3)


def looks(n=80, **noise):
    random = np.random.default_rng(0)
    t = 0.5 * np.arange(n)
    u = np.zeros((n, 6))
    u[:, 0], u[:, 2] = 270 * t, 270
    y = np.array([predict(MODEL, TARGET, row)[0] for row in u])
    y += np.radians([10.0, 1.0]) * random.standard_normal((n, 2))
    columns = {"t": t, "position": u[:, :2], "velocity": u[:, 2:4], "heading": u[:, 4], "heading_rate": u[:, 5]}
    columns |= {"phase": np.remainder(y[:, 0], 2 * math.pi), "phase_rate": y[:, 1]}
    return Looks(**(columns | noise))


COARSE = math.atan2(80, 60) + 0.06


@pytest.mark.long
def test_locates():
    fixes = EmitterLocator(coarse_bearing=COARSE, every=1).process(looks())
    assert np.hypot(*(fixes.position[-1] - TARGET)) < 2e3
    assert fixes.terms[0] > 50 and fixes.terms[-1] < fixes.terms[0]
    assert (fixes.status == Status.RUNNING).all()
    assert np.linalg.eigvalsh(fixes.covariance).min() > 0


def test_blocks_of_any_size_give_the_same():
    every = looks()
    whole = EmitterLocator(coarse_bearing=COARSE).process(every)
    locator = EmitterLocator(coarse_bearing=COARSE)
    parts = type(whole).concatenate([locator.process(every[a : a + 7]) for a in range(0, len(every), 7)])
    for name in ("status", "position", "covariance", "terms", "weight", "output"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    locator.reset()
    np.testing.assert_array_equal(locator.process(every).position, whole.position)


def test_phase_is_taken_modulo_two_pi():
    one, other = looks(), looks()
    other.phase[:] += 2 * math.pi * np.arange(-40, 40)
    a, b = (EmitterLocator(coarse_bearing=COARSE).process(x).position for x in (one, other))
    np.testing.assert_allclose(a, b, rtol=1e-9)


def test_missing_looks_coast():
    data = looks()
    data.phase[:5] = data.phase_rate[:5] = math.nan
    data.heading[30:40] = math.nan
    data.t[50] = data.t[49]
    fixes = EmitterLocator(coarse_bearing=COARSE).process(data)
    assert (fixes.status[:5] == Status.ALIGNING).all() and np.isnan(fixes.position[:5]).all()
    assert (fixes.status[30:40] == Status.COASTING).all() and fixes.status[50] == Status.COASTING
    np.testing.assert_array_equal(fixes.position[30:40], np.broadcast_to(fixes.position[29], (10, 2)))
    assert np.isfinite(fixes.position[5:]).all()


def test_a_useless_phase_is_left_out():
    data = looks()
    blind = looks()
    blind.phase[1:] = math.nan
    settings = {"coarse_bearing": COARSE, "heading_sigma": math.radians(0.2)}
    a, b = (EmitterLocator(**settings).process(x).position for x in (data, blind))
    np.testing.assert_array_equal(a, b)


def test_contradiction_diverges_and_says_so():
    data = looks()
    data.phase_rate[10] = 1e200
    locator = EmitterLocator(coarse_bearing=COARSE)
    with np.errstate(over="ignore"):  # warned of only where nothing is compiled
        fixes = locator.process(data)
    assert (fixes.status[10:] == Status.DIVERGED).all() and np.isnan(fixes.position[10:]).all()
    assert (locator.process(data).status == Status.DIVERGED).all()
    locator.reset()
    assert locator.process(looks()).status[-1] == Status.RUNNING


@pytest.mark.parametrize(
    "settings",
    [{"every": 0}, {"coarse_sigma": 0.0}, {"merge_below": -1.0}, {"phase_sigma": 0.0}, {"heading_sigma": -1.0},
     {"coarse_bearing": math.nan}, {"basline": 3.0}],
)  # fmt: skip
def test_impossible_settings(settings):
    with pytest.raises(SettingError, match=next(iter(settings))):
        EmitterLocator(**{"coarse_bearing": 0.9, **settings})


def test_wrong_looks():
    data = looks()
    data.t[3] = math.nan
    with pytest.raises(SampleError, match="time stamp"):
        EmitterLocator(coarse_bearing=0.9).process(data)
    with pytest.raises(SampleError, match="phase has shape"):
        EmitterLocator(coarse_bearing=0.9).process(looks(phase=np.zeros(3)))
