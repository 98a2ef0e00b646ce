"""Gaussian sum filter (Alspach and Sorenson 1972; Baseline 2021, section 3): a bank of filters, weighted by likelihood.

A density with several peaks is a sum of Gaussian terms. Each goes through a filter of its own (any of this package, on
any model whose state is a plain vector), its weight times the likelihood of the innovation, eq. (17)-(27). Terms that
have become one are merged, those that have become impossible are pruned, section 3.2.3. Weights are kept as logarithms:
after a few good measurements those of wrong terms are smaller than the smallest number.
"""

import math
from typing import NamedTuple

import numpy as np

from estimators.filters.base import FilterHandle, correct, predict, project
from estimators.filters.work import Work
from estimators.jit import njit
from estimators.linalg import healthy, leading_cholesky
from estimators.models.base import Handle, constrain, measurement_noise, residual, retract


class Bank(NamedTuple):
    """The terms; the first `alive[0]` rows are alive."""

    x: np.ndarray  # (terms, n) means
    P: np.ndarray  # (terms, n, n) covariances
    log_weight: np.ndarray  # (terms,) logarithms of weights that sum to one
    alive: np.ndarray  # (1,) int64

    @classmethod
    def make(cls, means: np.ndarray, covariances: np.ndarray, weights: np.ndarray | None = None) -> "Bank":
        """A bank of means (terms, n), covariances (terms, n, n) and weights (terms,), by default equal ones."""
        terms = len(means)
        weights = np.ones(terms) if weights is None else np.asarray(weights, float)
        return cls(
            x=np.array(means, float, order="C"),
            P=np.array(covariances, float, order="C"),
            log_weight=np.log(weights / weights.sum()),
            alive=np.array([terms]),
        )


@njit
def _update(
    method: FilterHandle, model: Handle, x: np.ndarray, P: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray,
    work: Work,
) -> float:  # fmt: skip
    """Condition one term on a row of measurements; returns its log likelihood, eq. (27), -inf when the term is lost."""
    likelihood = 0.0
    for g in range(model.groups):
        start, rows = model.start[g], model.rows[g]
        any_used = False
        for i in range(rows):
            work.used[i] = used[start + i]
            any_used |= used[start + i]
            work.measured[i] = z[start + i]
        if not any_used:
            continue
        if not project(method, model, g, x, P, u, work):
            return -math.inf
        for i in range(rows):
            for j in range(i + 1):
                work.noise[i, j] = 0.0
        measurement_noise(model, g, x, u, work.noise)
        residual(model, g, 1, work.measured, work.y, work.residual)
        if not correct(method, model, g, P, work):
            return -math.inf
        for i in range(rows):
            if work.used[i] != 0:  # independent innovations: their densities multiply
                likelihood -= 0.5 * (
                    work.residual[i] ** 2 / work.variance[i] + math.log(2 * math.pi * work.variance[i])
                )
        retract(model, 1, x, work.dx, work.x)
        for i in range(model.raw):
            x[i] = work.x[i]
    constrain(model, x)
    return likelihood if healthy(model.raw, x, model.size, P) else -math.inf


@njit
def normalise_weights(bank: Bank) -> bool:
    """Let the weights sum to one, eq. (26); False when no term is possible any more."""
    count = bank.alive[0]
    largest = -math.inf
    for i in range(count):
        largest = max(largest, bank.log_weight[i])
    if not largest > -math.inf:
        return False
    total = 0.0
    for i in range(count):
        total += math.exp(bank.log_weight[i] - largest)
    for i in range(count):
        bank.log_weight[i] -= largest + math.log(total)
    return True


@njit
def step(
    method: FilterHandle, model: Handle, bank: Bank, work: Work, u: np.ndarray, z: np.ndarray, used: np.ndarray,
    dt: float,
) -> bool:  # fmt: skip
    """Predict every term by dt seconds (not when dt is zero), condition it on z (rows,) where `used`, weigh it.

    A term that is numerically lost gets no weight. Returns False when all are: the bank is then void.
    """
    x, P, n = work.before, work.P, bank.x.shape[1]  # a term, as filters take it
    for term in range(bank.alive[0]):
        for i in range(n):
            x[i] = bank.x[term, i]
            for j in range(n):
                P[i, j] = bank.P[term, i, j]
        if dt > 0.0 and not predict(method, model, x, P, u, dt, work):
            bank.log_weight[term] = -math.inf
            continue
        bank.log_weight[term] += _update(method, model, x, P, u, z, used, work)
        for i in range(n):
            bank.x[term, i] = x[i]
            for j in range(n):
                bank.P[term, i, j] = P[i, j]
    return bool(normalise_weights(bank))


@njit
def mean_and_covariance(bank: Bank, x: np.ndarray, P: np.ndarray) -> None:
    """Mean x (n,) and covariance P (n, n) of the whole sum, eq. (28) and (29)."""
    n = x.shape[0]
    for a in range(n):
        x[a] = 0.0
        for b in range(n):
            P[a, b] = 0.0
    for i in range(bank.alive[0]):
        weight = math.exp(bank.log_weight[i])
        for a in range(n):
            x[a] += weight * bank.x[i, a]
    for i in range(bank.alive[0]):
        weight = math.exp(bank.log_weight[i])
        for a in range(n):
            for b in range(n):
                P[a, b] += weight * (bank.P[i, a, b] + (bank.x[i, a] - x[a]) * (bank.x[i, b] - x[b]))


@njit
def distance2(bank: Bank, i: int, j: int, both: np.ndarray, L: np.ndarray, apart: np.ndarray) -> float:
    """Squared Mahalanobis distance of two terms, `(xi-xj)^T (Pi+Pj)^-1 (xi-xj)`, eq. (30).

    both (n, n), L (n, n) and apart (n,) are memory.
    """
    n = apart.shape[0]
    total = 0.0
    for a in range(n):
        for b in range(n):
            both[a, b] = bank.P[i, a, b] + bank.P[j, a, b]
    if not leading_cholesky(n, both, n, L):
        return math.inf
    for a in range(n):
        apart[a] = bank.x[i, a] - bank.x[j, a]
        for b in range(a):
            apart[a] -= L[b, a] * apart[b]
        apart[a] /= L[a, a]
        total += apart[a] * apart[a]
    return total


@njit
def merge_pair(bank: Bank, i: int, j: int) -> None:
    """Term i takes in term j, keeping weight, mean and covariance of the two, eq. (31)-(33); j loses its weight."""
    n = bank.x.shape[1]
    larger = max(bank.log_weight[i], bank.log_weight[j])
    wi, wj = math.exp(bank.log_weight[i] - larger), math.exp(bank.log_weight[j] - larger)
    share_i, share_j = wi / (wi + wj), wj / (wi + wj)
    for a in range(n):
        for b in range(n):
            apart = (bank.x[i, a] - bank.x[j, a]) * (bank.x[i, b] - bank.x[j, b])
            bank.P[i, a, b] = share_i * bank.P[i, a, b] + share_j * bank.P[j, a, b] + share_i * share_j * apart
    for a in range(n):
        bank.x[i, a] = share_i * bank.x[i, a] + share_j * bank.x[j, a]
    bank.log_weight[i] = larger + math.log(wi + wj)
    bank.log_weight[j] = -math.inf


@njit
def reduce_bank(bank: Bank, merge_below: float, prune_below: float) -> None:
    """Merge the closest two until none are closer than `merge_below` sigmas; drop weights below `prune_below`."""
    n = bank.x.shape[1]
    both, L, apart = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    while True:
        closest, first, second = merge_below * merge_below, -1, -1
        for i in range(bank.alive[0]):
            for j in range(i):
                if bank.log_weight[i] > -math.inf and bank.log_weight[j] > -math.inf:
                    square = distance2(bank, i, j, both, L, apart)
                    if square < closest:
                        closest, first, second = square, j, i
        if first < 0:
            break
        merge_pair(bank, first, second)
    kept = 0
    for i in range(bank.alive[0]):
        if bank.log_weight[i] > math.log(prune_below):
            if kept < i:
                for a in range(n):
                    bank.x[kept, a] = bank.x[i, a]
                    for b in range(n):
                        bank.P[kept, a, b] = bank.P[i, a, b]
                bank.log_weight[kept] = bank.log_weight[i]
            kept += 1
    bank.alive[0] = kept
    normalise_weights(bank)
