"""The bootstrap that regression checks, campaigns, comparisons and tuning share."""

import math
from collections.abc import Callable

import numpy as np

RESAMPLES = 2000


def interval(differences: np.ndarray, probability: float = 0.95) -> tuple[float, float]:
    """Compute the percentile bootstrap interval of the mean of paired differences (n,).

    Always the same for the same differences. With n = 3 it spans nearly from the smallest to the largest: three
    differences are significant when they agree in sign.
    """
    n = len(differences)
    rng = np.random.Generator(np.random.PCG64(0))
    means = np.asarray(differences, float)[rng.integers(n, size=(RESAMPLES, n))].mean(axis=1)
    tail = 50.0 * (1.0 - probability)
    low, high = np.percentile(means, (tail, 100.0 - tail))
    return float(low), float(high)


def block_length(series: np.ndarray) -> int:
    """Choose the length (rows) of the blocks that a circular block bootstrap of a series (n,) needs.

    Three times that of Politis and White 2004, "Automatic block-length selection for the dependent bootstrap",
    section 3, as corrected by Patton, Politis and White 2009, and at most a quarter of the series. Theirs has the least
    error for long series; of errors whose correlation time is a twentieth of the flight, `block_interval` with it
    covers the truth 86 times in a hundred and with three times as long blocks 93 times.
    """
    n = len(series)
    deviation = series - series.mean()
    run = max(5, math.ceil(math.log10(n)))
    lags = min(math.ceil(math.sqrt(n)) + run, n - 1)
    covariance = np.array([deviation[: n - k] @ deviation[k:] for k in range(lags + 1)]) / n
    if not covariance[0] > 0:
        return 1
    small = np.abs(covariance[1:] / covariance[0]) < 2.0 * math.sqrt(math.log10(n) / n)
    quiet = [m for m in range(len(small) - run + 1) if small[m : m + run].all()]
    window = min(2 * max(quiet[0], 1) if quiet else lags, lags)
    k = np.arange(1, window + 1)
    taper = np.minimum(1.0, 2.0 * (1.0 - k / window))
    slope = 2.0 * float(np.sum(taper * k * covariance[1 : window + 1]))
    spectrum = float(covariance[0] + 2.0 * np.sum(taper * covariance[1 : window + 1]))
    optimal = math.ceil((1.5 * slope**2 / spectrum**2 * n) ** (1.0 / 3.0)) if spectrum else n
    return max(1, min(3 * optimal, n // 4))


def block_interval(
    rows: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray], length: int, probability: float = 0.95
) -> tuple[float, float]:
    """Compute the circular block bootstrap interval of a statistic of sums over a time series.

    Widened as Student's t is against the normal distribution with as many blocks (Hesterberg 2015, "What teachers
    should know about the bootstrap", section 5.3): a flight has few that are independent.

    Args:
        rows: (n, k), in order of time.
        statistic: of sums (m, k) over the rows of m resamples; returns (m,).
        length: rows of a block.
        probability: of the interval.
    """
    from scipy.special import ndtr, stdtrit

    n = len(rows)
    blocks = math.ceil(n / length)
    tail = 0.5 * (1.0 - probability)
    if (independent := n / length) > 1.0:
        tail = float(ndtr(math.sqrt(independent / (independent - 1.0)) * stdtrit(independent - 1.0, tail)))
    # Sums of all circular blocks at once: a resample then adds up as many as cover the series.
    total = np.concatenate([np.zeros((1, rows.shape[1])), np.cumsum(np.concatenate([rows, rows]), axis=0)])
    sums = total[length : length + n] - total[:n]
    rng = np.random.Generator(np.random.PCG64(0))
    found = statistic(sums[rng.integers(n, size=(RESAMPLES, blocks))].sum(axis=1))
    low, high = np.percentile(found, (100.0 * tail, 100.0 * (1.0 - tail)))
    return float(low), float(high)
