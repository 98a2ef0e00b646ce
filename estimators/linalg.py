"""Small dense linear algebra as plain loops: faster than LAPACK at these sizes, and compiled in a fraction of the time.

A covariance `P` (n, n) is kept symmetric, both halves filled.
"""

import math

import numpy as np

from estimators.jit import njit


@njit(forceinline=True)
def leading_cholesky(n: int, P: np.ndarray, columns: int, L: np.ndarray) -> bool:
    """The first `columns` columns of P's lower Cholesky factor, each a row of L (columns, n); False if not positive.

    The later columns do not move the first `columns` states, so a function that reads only these needs no more. Columns
    lie in rows so that the innermost loop runs along memory.
    """
    for j in range(columns):
        for i in range(n):
            L[j, i] = P[j, i] if i >= j else 0.0
        for k in range(j):
            factor = L[k, j]
            for i in range(j, n):
                L[j, i] -= factor * L[k, i]
        pivot = L[j, j]
        if not pivot > 0.0:
            return False
        inverse = 1.0 / math.sqrt(pivot)
        for i in range(j, n):
            L[j, i] *= inverse
    return True


@njit(forceinline=True)
def condition(
    n: int,
    rows: int,
    S: np.ndarray,
    C: np.ndarray,
    P: np.ndarray,
    residual: np.ndarray,
    used: np.ndarray,
    variance: np.ndarray,
    row: np.ndarray,
    dx: np.ndarray,
) -> bool:
    """Condition the state on measurements, given their joint covariance: eliminate one measurement after the other.

    The Kalman update of any filter (Han 2013, eq. (13)-(15)) without forming a gain or an inverse: each pass conditions
    states and later measurements on measurement k, so what is left of `residual` are independent innovations and
    the pivots are their variances. A measurement that is not used is left out, which is exact. P stays exactly
    symmetric.

    Args:
        n: number of states.
        rows: number of measurements.
        S: (rows, rows) covariance of the measurements, noise included, lower half; overwritten.
        C: (rows, n) covariance of measurements and state; overwritten.
        P: (n, n) covariance of the state; becomes the posterior.
        residual: (rows,) measured minus predicted; becomes the independent innovations.
        used: (rows,) which measurements count.
        variance: (rows,) out, variances of the innovations.
        row: (n,) memory, of its own.
        dx: (n,) out, correction of the state.

    Returns:
        False when the joint covariance is not positive: the results are then void.
    """
    for i in range(n):
        dx[i] = 0.0
    for k in range(rows):
        if not used[k]:
            continue
        pivot = S[k, k]
        if not pivot > 0.0:
            return False
        variance[k] = pivot
        inverse = 1.0 / pivot
        r = residual[k]
        for i in range(n):
            row[i] = C[k, i]
        for i in range(n):
            gain = row[i] * inverse
            dx[i] += gain * r
            for j in range(i + 1):
                P[i, j] -= gain * row[j]
        for m in range(k + 1, rows):
            if used[m]:
                gain = S[m, k] * inverse
                residual[m] -= gain * r
                for i in range(n):
                    C[m, i] -= gain * row[i]
                for j in range(k + 1, m + 1):
                    S[m, j] -= gain * S[j, k]
    for i in range(n):
        for j in range(i):
            P[j, i] = P[i, j]
    return True


@njit
def healthy(raw: int, x: np.ndarray, n: int, P: np.ndarray) -> bool:
    """Tell whether all `raw` states are finite and all n variances finite and positive."""
    total = 0.0
    for i in range(raw):
        total += x[i] * 0.0  # NaN when any is infinite or NaN
    positive = True
    for i in range(n):
        total += P[i, i] * 0.0
        positive &= P[i, i] > 0.0
    return positive and total == 0.0


@njit(forceinline=True)
def spread(
    d: np.ndarray,
    s: np.ndarray,
    shift: np.ndarray,
    pairs: int,
    rows: int,
    odd: float,
    even: float,
    square: float,
    out: np.ndarray,
) -> None:
    """`out` (lower half) = sum_i [odd d_i d_i^T + even s_i s_i^T] + square shift shift^T, covariance of points."""
    for a in range(rows):
        for b in range(a + 1):
            out[a, b] = square * shift[a] * shift[b]
    for i in range(pairs):
        for a in range(rows):
            weighted_d, weighted_s = odd * d[i, a], even * s[i, a]
            for b in range(a + 1):
                out[a, b] += weighted_d * d[i, b] + weighted_s * s[i, b]
