import math

import numpy as np
import pytest

from estimators.filters import ckf, ekf
from estimators.filters.base import Method
from estimators.filters.gaussian_sum import (
    Bank,
    distance2,
    mean_and_covariance,
    merge_pair,
    normalise_weights,
    reduce_bank,
)
from estimators.filters.gaussian_sum import step as step_by_handles
from estimators.filters.work import Work
from estimators.models.emitter import PHASE, Emitter, bound, look, look_noise
from estimators.native import argument

MODEL = Emitter.make()
TARGET = np.array([60e3, 80e3])
USED = np.ones(2, bool)
EKF = Method(ekf, ekf.make({}))


def step(method, bank, k, dt=0.5):
    model = bound(MODEL, method)
    handles = argument(method.handle), argument(model.handle)
    return step_by_handles(*handles, bank, argument(Work.zeros()), inputs(k), measured(k), USED, dt)


def bank_of(terms=4, seed=0, spread=3e3):
    random = np.random.default_rng(seed)
    A = random.standard_normal((terms, 2, 2)) * 2e3
    return Bank.make(
        TARGET + spread * random.standard_normal((terms, 2)),
        A @ A.transpose(0, 2, 1) + 1e6 * np.eye(2),
        random.uniform(0.1, 1, terms),
    )


def inputs(k):
    return np.array([135.0 * k, 0.0, 270.0, 0.0, 0.0, 0.0])


def measured(k):
    y = np.empty(2)
    look(MODEL, TARGET, inputs(k), y, np.empty((2, 2)))
    y[PHASE] = math.remainder(y[PHASE], 2 * math.pi)
    return y


def textbook(x, P, u, z):
    """An EKF step as in the paper, eq. (20)-(27), with inverse and all."""
    y, H, S = np.empty(2), np.empty((2, 2)), np.zeros((2, 2))
    look(MODEL, x, u, y, H)
    look_noise(MODEL, x, u, S)
    S[0, 1] = S[1, 0]
    S += H @ P @ H.T
    v = z - y
    v[0] = (v[0] + math.pi) % (2 * math.pi) - math.pi
    K = P @ H.T @ np.linalg.inv(S)
    log_likelihood = -0.5 * (v @ np.linalg.solve(S, v) + np.log(np.linalg.det(2 * math.pi * S)))
    return x + K @ v, P - K @ S @ K.T, log_likelihood


def test_one_term_is_a_single_ekf():
    bank = bank_of(1)
    x, P = bank.x[0].copy(), bank.P[0].copy()
    for k in range(1, 30):
        assert step(EKF, bank, k)
        x, P, _ = textbook(x, P, inputs(k), measured(k))
        np.testing.assert_allclose(bank.x[0], x, rtol=1e-9)
        np.testing.assert_allclose(bank.P[0], P, rtol=1e-6, atol=1e-6 * np.trace(P))
        assert bank.log_weight[0] == 0.0


def test_weights_follow_the_likelihood_and_sum_to_one():
    bank = bank_of(5)
    expected = bank.log_weight.copy()
    terms = [(x.copy(), P.copy()) for x, P in zip(bank.x, bank.P, strict=True)]
    for i, (x, P) in enumerate(terms):
        expected[i] += textbook(x, P, inputs(1), measured(1))[2]
    assert step(EKF, bank, 1)
    expected -= expected.max()
    weights = np.exp(expected) / np.exp(expected).sum()
    np.testing.assert_allclose(np.exp(bank.log_weight), weights, rtol=1e-6)
    for k in range(2, 60):
        step(EKF, bank, k)
        assert np.exp(bank.log_weight).sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.long  # compiles the bank for another filter
def test_any_filter_serves():
    bank = bank_of(3)
    for k in range(1, 10):
        assert step(Method(ckf, ckf.make({})), bank, k)
    assert np.linalg.eigvalsh(bank.P).min() > 0


def test_tiny_likelihoods_do_not_underflow():
    bank = bank_of(3)
    bank.log_weight[:] = [-5000.0, -5001.0, -9000.0]
    assert normalise_weights(bank)
    np.testing.assert_allclose(np.exp(bank.log_weight[:2]), [1 / (1 + math.exp(-1)), 1 / (1 + math.e)])


def test_a_lost_bank_says_so():
    bank = bank_of(3)
    bank.log_weight[:] = -math.inf
    assert not normalise_weights(bank)
    bank = bank_of(3)
    bank.P[1] = -np.eye(2) * 1e9
    assert step(EKF, bank, 1)  # one term is lost, not the bank
    assert bank.log_weight[1] == -math.inf and np.exp(bank.log_weight).sum() == pytest.approx(1.0)


def moments(bank):
    x, P = np.empty(2), np.empty((2, 2))
    mean_and_covariance(bank, x, P)
    return x, P


def test_moments_of_the_sum():
    bank = bank_of(4)
    x, P = moments(bank)
    w = np.exp(bank.log_weight)
    np.testing.assert_allclose(x, w @ bank.x)
    d = bank.x - w @ bank.x
    np.testing.assert_allclose(P, np.einsum("i,iab->ab", w, bank.P + d[:, :, None] * d[:, None, :]))


def test_merging_conserves_weight_mean_and_covariance():
    bank = bank_of(4)
    before = moments(bank)
    merge_pair(bank, 0, 2)
    assert bank.log_weight[2] == -math.inf
    assert np.exp(bank.log_weight).sum() == pytest.approx(1.0)
    for a, b in zip(moments(bank), before, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10)
    reduce_bank(bank, 1e9, 1e-5)
    assert bank.alive[0] == 1
    np.testing.assert_allclose(bank.x[0], before[0], rtol=1e-10)
    np.testing.assert_allclose(bank.P[0], before[1], rtol=1e-10)


def test_distance_is_mahalanobis():
    bank = bank_of(2)
    d = bank.x[0] - bank.x[1]
    expected = d @ np.linalg.solve(bank.P[0] + bank.P[1], d)
    assert distance2(bank, 0, 1, np.empty((2, 2)), np.empty((2, 2)), np.empty(2)) == pytest.approx(expected)


def test_only_near_terms_merge_and_light_ones_go():
    P = np.broadcast_to(1e4 * np.eye(2), (4, 2, 2))
    means = np.array([[0.0, 0.0], [1e4, 0.0], [50.0, 0.0], [2e4, 0.0]])
    bank = Bank.make(means, P, np.array([0.4, 0.3, 0.3 - 1e-6, 1e-6]))
    reduce_bank(bank, 1.0, 1e-5)
    assert bank.alive[0] == 2
    np.testing.assert_allclose(bank.x[:2, 0], [50.0 * 3 / 7, 1e4], rtol=1e-4)
    assert np.exp(bank.log_weight[:2]).sum() == pytest.approx(1.0)
    bank = Bank.make(means, P)
    reduce_bank(bank, 0.0, 1e-5)  # no merging
    assert bank.alive[0] == 4
