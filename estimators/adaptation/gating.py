"""Innovation gate: a sensor whose innovation is too unlikely is left out (chi-square test).

    a^T S^-1 a > limit(m) :  refused

for the m measurements of a sensor that are there. `limit` is the quantile of chi-square that a normal variable passes
at `sigma` (Wilson and Hilferty 1931). A sensor refused for `patience` without a break is accepted again, until it fits:
the filter may be the one that is wrong.
"""

import math
from typing import Any

import numpy as np

from estimators.adaptation.base import KEPT, Sensors
from estimators.filters.work import Work
from estimators.jit import njit
from estimators.models.base import Handle
from estimators.native import Number, Record
from estimators.records import Place, Sample
from estimators.settings import Setting

SETTINGS = {
    "gate_sigma": Setting(4.0, "gate: innovations beyond are refused", above=0.0),
    "gate_patience": Setting(5.0, "s, gate: re-accept a sensor refused continuously for this long", minimum=0.0),
}


class Parameters(Record):
    """Parameters of the policy."""

    sigma: Number
    patience: Number  # s


class Trust(Record, size=KEPT):
    """Holds the memory of the policy for each sensor."""

    trusted: Sensors
    since: Sensors  # s, refused since (0: not)
    now: Number  # s, time of the row; a second later, so that 0 is "not"


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


def admit(policy: Parameters, model: Handle, row: Sample, x: np.ndarray, trust: Trust, used: np.ndarray) -> bool:
    """Keep the time; refuse nothing yet."""
    trust.now = row.t + 1.0
    return False


def factor(policy: Parameters, sensor: int, first: int, end: int, trust: Trust, work: Work) -> float:
    """Refuse a sensor whose innovation is too unlikely, for `patience` at most."""
    m = 0
    for i in range(first, end):
        m += 1 if work.used[i] else 0
    if m == 0:
        return 1.0
    off = distance2(work.S, work.noise, work.residual, work.used, first, end, work.scratch)
    fits = off <= limit(policy.sigma, m)
    since = trust.since[sensor]
    if fits:
        trust.since[sensor] = 0.0
    elif since == 0.0:
        trust.since[sensor] = since = trust.now
    refused = not fits and trust.now - since < policy.patience
    trust.trusted[sensor] = 0.0 if refused else 1.0
    return 0.0 if refused else 1.0


def configure(settings: Any, site: Place, policy: Parameters) -> None:
    """Set the parameters from the settings `gate_*`."""
    policy.sigma, policy.patience = settings.gate_sigma, settings.gate_patience
