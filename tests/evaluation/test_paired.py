"""Paired differences: their intervals cover the truth, of correlated errors too, and few pairs claim nothing."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from ahrs_sim.evaluation import paired
from ahrs_sim.evaluation.accuracy import Accuracy
from ahrs_sim.evaluation.bootstrap import block_interval, block_length
from ahrs_sim.evaluation.paired import Binned
from estimators.types import Estimates, blank


def _correlated(rng: np.random.Generator, count: int, correlation_s: float) -> np.ndarray:
    """A first-order Gauss-Markov sequence of unit variance, one value a second."""
    a = math.exp(-1.0 / correlation_s)
    found: np.ndarray = lfilter([math.sqrt(1 - a * a)], [1, -a], rng.standard_normal(count + 1000))[1000:]
    return found


def test_block_length_follows_the_correlation() -> None:
    rng = np.random.default_rng(1)
    lengths = [np.mean([block_length(_correlated(rng, 600, s)) for _ in range(20)]) for s in (0.1, 3.0, 20.0)]
    assert lengths[0] < 15
    assert lengths[0] < 0.7 * lengths[1] < 0.49 * lengths[2]
    assert block_length(np.full(50, 2.0)) == 1
    assert block_length(np.arange(50.0)) <= 12


def test_interval_of_blocks_covers_the_truth() -> None:
    """Mean of a sequence whose correlation time is a thirtieth of its length: plain resampling would cover 40 %."""
    rng = np.random.default_rng(2)
    covered = 0
    for _ in range(200):
        rows = np.column_stack([_correlated(rng, 600, 20.0), np.ones(600)])
        low, high = block_interval(rows, lambda s: s[:, 0] / s[:, 1], block_length(rows[:, 0]))
        covered += low <= 0.0 <= high
    assert 0.88 * 200 <= covered <= 0.99 * 200


def test_runs_are_compared_in_pairs() -> None:
    rng = np.random.default_rng(3)
    hardness = rng.uniform(1.0, 9.0, 20)  # of each run, the same for both: hides the difference in two distributions
    one, other = hardness + 0.9 + 0.1 * rng.standard_normal(20), hardness + 1.0 + 0.1 * rng.standard_normal(20)
    one[3], other[7] = math.nan, math.nan
    found = paired.over_runs(one, other)
    assert found is not None
    assert (found.pairs, found.result) == (18, paired.BETTER)
    assert found.low < -0.1 < found.high
    reverse = paired.over_runs(other, one)
    assert reverse is not None
    assert reverse.result == paired.WORSE
    assert reverse.smaller == found.pairs - found.smaller


def test_few_runs_are_unclear_and_none_is_unknown() -> None:
    found = paired.over_runs(np.arange(5.0), np.arange(5.0) + 1.0)
    assert found is not None
    assert (found.change, found.smaller, found.result) == (-1.0, 5, paired.UNCLEAR)
    assert found.plain()["low"] is None
    assert paired.over_runs(np.array([1.0, math.nan]), np.array([math.nan, 1.0])) is None


def _estimates(t: np.ndarray, roll: np.ndarray) -> Estimates:
    columns = blank(Estimates, len(t))
    columns["t"] = t
    columns["q_nb"] = np.column_stack([np.cos(roll / 2), np.sin(roll / 2), 0 * roll, 0 * roll])
    columns["down_b"] = np.column_stack([0 * roll, np.sin(roll), np.cos(roll)])
    return Estimates(**columns)


def test_estimators_of_one_flight() -> None:
    """A constant and a twice as large error differ by what the table says, in the span asked for and in each phase."""
    t = np.arange(0.0, 100.0, 0.1)
    still = np.zeros((len(t), 3))
    accuracy = Accuracy(["small", "large", "silent"])
    accuracy.add_truth(t, np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)), still, np.ones(len(t), bool))
    error = np.radians(1.0 + 0.1 * np.sin(t))
    accuracy.add_estimates("small", _estimates(t, error))
    accuracy.add_estimates("large", _estimates(t, np.where(t < 50.0, 2.0, 3.0) * error))
    accuracy.add_estimates("silent", _estimates(t, np.full(len(t), math.nan)))
    found = accuracy.paired("large")
    result = accuracy.result()["estimators"]
    difference = found["small"]["tilt_rmse_deg"]
    assert difference["change"] == pytest.approx(
        result["small"]["tilt_rmse_deg"] - result["large"]["tilt_rmse_deg"], rel=1e-5
    )
    assert difference["result"] == paired.BETTER
    assert difference["smaller"] == difference["pairs"] == 50
    assert found["small"]["phases"]["ground"]["tilt_rmse_deg"] == difference
    assert found["silent"]["tilt_rmse_deg"] is None
    early = accuracy.paired("large", high=49.9)["small"]["tilt_rmse_deg"]
    assert early["change"] == pytest.approx(-1.0, abs=0.01)


def test_bins_hold_every_sample_once() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    errors = np.full((len(t), 2), math.radians(3.0), np.float32)
    errors[:100, 1] = math.nan
    found = Binned.of(t, errors, 5)
    assert found.counts[:, 0].tolist() == [200.0] * 5
    assert found.counts[0, 1] == 100
    assert found.squares.sum(axis=0) == pytest.approx([9.0 * 1000, 9.0 * 900], rel=1e-5)
