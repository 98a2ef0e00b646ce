"""NEES, NIS and their bounds against scipy and against filters that are consistent by construction."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from ahrs_sim import attitude
from ahrs_sim.evaluation import consistency

RNG = np.random.default_rng(5)


def attitudes(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truth, estimates whose errors have exactly the covariance returned with them."""
    angles = RNG.uniform([-3, -1.2, -3], [3, 1.2, 3], (n, 3))
    truth = Rotation.from_euler("ZYX", angles[:, ::-1])
    root = RNG.normal(size=(n, 3, 3)) * 0.003
    cov = root @ root.transpose(0, 2, 1) + 1e-6 * np.eye(3)
    error = np.array([RNG.multivariate_normal(np.zeros(3), c) for c in cov])
    wrong = truth * Rotation.from_rotvec(error)
    return truth.as_quat(scalar_first=True), wrong.as_quat(scalar_first=True), cov


@pytest.mark.parametrize("freedom", [1, 3, 6, 500])
def test_bounds_are_those_of_scipy(freedom: int) -> None:
    low, high = consistency.chi_square_bounds(freedom, 0.99)
    assert low == pytest.approx(stats.chi2.ppf(0.005, freedom))
    assert high == pytest.approx(stats.chi2.ppf(0.995, freedom))


def test_bounds_of_nothing_are_missing() -> None:
    low, high = consistency.chi_square_bounds(np.array([0, 3]))
    assert np.isnan([low[0], high[0]]).all()
    assert low[1] < 3 < high[1]


def test_mean_bounds_close_in_on_one() -> None:
    low, high = consistency.mean_bounds(3, np.array([1, 100, 10_000]))
    assert (np.diff(low) > 0).all() and (np.diff(high) < 0).all()
    assert low[-1] == pytest.approx(1, abs=0.02) and high[-1] == pytest.approx(1, abs=0.02)


def test_rotation_error_is_scipys() -> None:
    p, q = Rotation.random(200, rng=1), Rotation.random(200, rng=2)
    wanted = (p.inv() * q).as_rotvec()
    found = consistency.rotation_error(q.as_quat(scalar_first=True), p.as_quat(scalar_first=True))
    assert found == pytest.approx(wanted, abs=1e-9)
    same = consistency.rotation_error(p.as_quat(scalar_first=True), -p.as_quat(scalar_first=True))
    assert same == pytest.approx(np.zeros((200, 3)), abs=1e-9)


def test_nees_of_a_consistent_estimator() -> None:
    truth, estimate, cov = attitudes(4000)
    values = consistency.attitude_nees(estimate, cov, truth)
    low, high = consistency.mean_bounds(3, len(values), 0.999)
    assert low < values.mean() / 3 < high
    error = attitude.wrap(attitude.euler(estimate) - attitude.euler(truth))
    inside = consistency.within(error, consistency.euler_sigma(estimate, cov))
    nothing = consistency.nis(np.full((4000, 2), np.nan), np.full((4000, 2), np.nan))
    result = consistency.summary(values / 3, *nothing, inside)
    assert result["nees_inside"] == pytest.approx(0.95, abs=0.015)
    assert result["inside"] > 0.985
    assert np.isnan(result["nis"])
    ones = consistency.nis(np.ones((4000, 2)), np.ones((4000, 2)))
    boast = consistency.summary(consistency.attitude_nees(estimate, cov / 9, truth) / 3, *ones)
    assert boast["nees"] == pytest.approx(9 * result["nees"])
    assert boast["nis"] == 1


def test_nees_needs_a_definite_covariance() -> None:
    error = np.ones((4, 2))
    cov = np.array([np.eye(2), np.zeros((2, 2)), [[1, 2], [2, 1]], [[np.nan, 0], [0, 1]]])
    assert consistency.nees(error, cov) == pytest.approx([2, np.nan, np.nan, np.nan], nan_ok=True)


def test_nis_counts_only_what_was_measured() -> None:
    innovation = np.array([[1.0, np.nan, 4.0], [np.nan] * 3])
    variance = np.array([[1.0, np.nan, 8.0], [np.nan] * 3])
    squares, freedom = consistency.nis(innovation, variance)
    assert squares == pytest.approx([3, 0])
    assert freedom.tolist() == [2, 0]


def test_euler_sigma_matches_sampled_errors() -> None:
    truth = Rotation.from_euler("ZYX", [1.0, 0.7, -0.5])
    cov = np.diag([1e-6, 4e-6, 9e-6])
    errors = RNG.multivariate_normal(np.zeros(3), cov, 20_000)
    sampled = attitude.euler((truth * Rotation.from_rotvec(errors)).as_quat(scalar_first=True))
    q = truth.as_quat(scalar_first=True)[None]
    assert consistency.euler_sigma(q, cov[None])[0] == pytest.approx(sampled.std(axis=0), rel=0.03)
