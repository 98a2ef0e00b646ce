"""The bootstrap that regression checks and tuning share."""

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
