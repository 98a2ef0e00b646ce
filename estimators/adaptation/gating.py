"""Innovation gate: a sensor whose innovation is too unlikely is left out (chi-square test).

    a^T S^-1 a > limit(m) :  refused

for the m measurements of a sensor that are there. `limit` is the quantile of chi-square that a normal variable passes
at `sigma` (Wilson and Hilferty 1931). A sensor refused for `patience` without a break is believed again, until it fits:
the filter may be the one that is wrong.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from estimators.adaptation.base import SENSORS
from estimators.generic import register
from estimators.jit import njit
from estimators.rows import T
from estimators.types import Site

_SINCE, _NOW = SENSORS, 2 * SENSORS  # in `trust`: s, refused since (0: not); s, time of the row (1 s later: 0 is "not")


class Gate(NamedTuple):
    """Parameters."""

    sigma: float
    patience: float  # s


@njit
def limit(sigma: float, m: int) -> float:
    """Quantile of chi-square with m degrees of freedom at the probability of a normal variable below `sigma`."""
    part = 2.0 / (9.0 * m)
    return float(m * (1.0 - part + sigma * math.sqrt(part)) ** 3)


@njit
def distance2(
    S: np.ndarray,
    noise: np.ndarray,
    error: np.ndarray,
    counts: np.ndarray,
    first: int,
    end: int,
    L: np.ndarray,
) -> float:
    """`a^T (S + noise)^-1 a` of the rows from `first` to `end` that count, by elimination; S and noise lower halves."""
    total = 0.0
    for i in range(first, end):
        for j in range(first, i + 1):
            L[i, j] = S[i, j] + noise[i, j]
        if i > first:
            L[first, i] = error[i]  # the first row above the diagonal keeps the residuals
    for k in range(first, end):
        if not counts[k]:
            continue
        residual = error[k] if k == first else L[first, k]
        total += residual * residual / L[k, k]
        for i in range(k + 1, end):
            gain = L[i, k] / L[k, k]
            L[first, i] -= gain * residual
            for j in range(k + 1, i + 1):
                L[i, j] -= gain * L[j, k]
    return total


def _admit(policy: Any, model: Any, row: np.ndarray, x: np.ndarray, trust: np.ndarray, used: np.ndarray) -> bool:
    trust[_NOW] = row[T] + 1.0
    return False


def _factor(
    policy: Any,
    sensor: int,
    first: int,
    end: int,
    S: np.ndarray,
    noise: np.ndarray,
    error: np.ndarray,
    counts: np.ndarray,
    trust: np.ndarray,
    scratch: np.ndarray,
) -> float:
    m = 0
    for i in range(first, end):
        m += 1 if counts[i] else 0
    if m == 0:
        return 1.0
    fits = distance2(S, noise, error, counts, first, end, scratch) <= limit(policy.sigma, m)
    since = trust[_SINCE + sensor]
    if fits:
        trust[_SINCE + sensor] = 0.0
    elif since == 0.0:
        trust[_SINCE + sensor] = since = trust[_NOW]
    refused = not fits and trust[_NOW] - since < policy.patience
    trust[sensor] = 0.0 if refused else 1.0
    return 0.0 if refused else 1.0


register(Gate, admit=_admit, factor=_factor)


def make(settings: Mapping[str, Any], site: Site) -> Gate:
    """From the settings `gate_*`."""
    return Gate(settings["gate_sigma"], settings["gate_patience"])
