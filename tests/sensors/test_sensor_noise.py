"""The stochastic processes against theory."""

import allantools
import numpy as np
import pytest
from scipy import signal

from ahrs_sim.review.allan import allan_deviation, allan_table
from ahrs_sim.sensors import noise as errors


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0])
def test_white_density_is_single_sided(rate: float) -> None:
    x = errors.White(errors.white_sigma(np.array([0.05]), rate), rng()).draw(400_000)[:, 0]
    _, power = signal.welch(x, rate, nperseg=1024)  # one-sided
    assert np.sqrt(power[1:-1].mean()) == pytest.approx(0.05, rel=0.01)
    # 0.05 deg/s/sqrt(Hz) at 100 Hz is 0.354 deg/s.
    assert errors.white_sigma(np.array(0.05), 100.0) == pytest.approx(0.354, abs=5e-4)


def test_stationary_from_the_first_sample() -> None:
    many = 4000  # axes stand for independent runs
    process = errors.gauss_markov(np.full(many, 2.0), 10.0, 0.01, rng())
    first = process.draw(1)[0]
    process.draw(5000)
    later = process.draw(1)[0]
    for x in (first, later):
        assert x.std() == pytest.approx(2.0, rel=0.04)
        assert abs(x.mean()) < 0.12
    flicker = errors.in_run_bias(np.full(many, 1.0), np.zeros(many), 0.01, rng(1))
    spread = flicker.draw(1)[0].std()
    assert spread == pytest.approx(np.sqrt(6) * errors.FLICKER_SIGMA / errors.ALLAN_FLOOR, rel=0.04)


def test_gauss_markov_autocorrelation_and_spectrum() -> None:
    rate, time = 100.0, 0.5
    x = errors.gauss_markov(np.array([1.5]), time, 1.0 / rate, rng(2)).draw(600_000)[:, 0]
    assert x.std() == pytest.approx(1.5, rel=0.02)
    assert np.mean(x[50:] * x[:-50]) / 1.5**2 == pytest.approx(np.exp(-1.0), abs=0.03)
    f, power = signal.welch(x, rate, nperseg=4096)
    theory = 4.0 * 1.5**2 * time / (1.0 + (2.0 * np.pi * f * time) ** 2)
    low = (f > 0.05) & (f < 8.0)  # above, the sampled process folds
    assert np.log(power[low] / theory[low]).mean() == pytest.approx(0.0, abs=0.03)


def test_flicker_spectrum_and_flat_allan_deviation() -> None:
    rate, floor = 20.0, 1.0
    x = errors.in_run_bias(np.full(3, floor), np.zeros(3), 1 / rate, rng(3)).draw(1_000_000)
    tau, _, deviation = allan_deviation(x, rate)
    flat = (tau > 0.7) & (tau < 500.0)
    mean = np.sqrt((deviation[flat] ** 2).mean(axis=1))
    assert np.all(np.abs(mean / floor - 1.0) < 0.1)
    f, power = signal.welch(x[:, 0], rate, nperseg=1 << 15)
    b = floor / errors.ALLAN_FLOOR
    band = (f > 0.003) & (f < 0.3)
    assert np.exp(np.log(power[band] * np.pi * f[band] / b**2).mean()) == pytest.approx(1.0, rel=0.08)


def test_random_walk_grows_and_axes_are_independent() -> None:
    walk = errors.in_run_bias(np.zeros(2000), np.full(2000, 0.3), 0.1, rng(4)).draw(400)
    assert walk[-1].std() == pytest.approx(0.3 * np.sqrt(40.0), rel=0.05)
    x = errors.in_run_bias(np.ones(3), np.zeros(3), 0.01, rng(5))
    y = np.vstack([x.draw(1) for _ in range(2)] + [errors.White(np.ones(3), rng(6)).draw(20_000)])
    assert np.abs(np.corrcoef(y.T) - np.eye(3)).max() < 0.03


def test_infinite_correlation_time_is_a_constant_not_white_noise() -> None:
    x = errors.gauss_markov(np.array([1.0]), 1e12, 0.01, rng(7)).draw(1000)[:, 0]
    assert np.ptp(x) < 1e-4
    assert abs(x[0]) > 1e-3


@pytest.mark.parametrize("length", [1, 7, 400])
def test_blocks_give_the_same_bytes(length: int) -> None:
    def made(size: int) -> bytes:
        p = errors.in_run_bias(np.array([1.0, 2.0, 3.0]), np.full(3, 0.1), 0.01, rng(8))
        return np.vstack([p.draw(min(size, 800 - i)) for i in range(0, 800, size)]).tobytes()

    assert made(length) == made(800)


def test_allan_deviation_equals_allantools() -> None:
    x = rng(9).standard_normal((20_000, 2)).cumsum(axis=0) * 0.01 + rng(10).standard_normal((20_000, 2))
    tau, _, ours = allan_deviation(x, 50.0, overlap=None)
    for axis in (0, 1):
        _, theirs, _, _ = allantools.oadev(x[:, axis], rate=50.0, data_type="freq", taus=tau)
        np.testing.assert_allclose(ours[:, axis], theirs, rtol=1e-9)
    sparse = allan_deviation(x, 50.0)[2]
    np.testing.assert_allclose(sparse, ours, rtol=0.02)


def test_allan_fit_recovers_all_three_and_its_confidence_covers() -> None:
    rate, n = 20.0, 600_000
    x = errors.White(errors.white_sigma(np.full(3, 0.5), rate), rng(11)).draw(n)
    x += errors.in_run_bias(np.full(3, 0.05), np.full(3, 0.01), 1 / rate, rng(12)).draw(n)
    table = allan_table(x, rate, unit="deg/s")
    np.testing.assert_allclose(table.density.value, 0.5, rtol=0.05)
    np.testing.assert_allclose(table.walk.value, 0.01, rtol=0.3)
    assert (np.abs(table.walk.value - 0.01) < 4.0 * table.walk.sigma).all()
    inside = (table.low <= table.model(table.tau)) & (table.model(table.tau) <= table.high)
    assert 0.5 < inside.mean() <= 1.0
    rows = table.rows({"density": np.full(3, 0.5), "floor": np.full(3, 0.05), "walk": np.full(3, 0.01)})
    assert len(rows) == 9
    assert rows[0]["specified"] == 0.5
