"""Sigma-point filters that keep the Cholesky factor S of the covariance P = S S^T (van der Merwe and Wan 2001).

The points are x +- h S e_i as ever, but no covariance is formed to be factored again: what a filter needs is written as
the columns of a matrix A with A A^T = P, and A is compressed to a square by orthogonal transformations (QR),

    time update           A = [ d_i/(2h), S e_i | e_i | r delta | Q^(1/2) ]                     -> S
    measurement update    A = [ d_i/(2h)   e_i   r delta   R^(1/2) ]       [ S_y  0  ]
                              [ S e_i      0     0         0       ]   ->  [ K   S^+ ]

with the pairs d_i, s_i and delta of `points` and e_i = sqrt(even) (s_i - mean of s), r^2 = 4 h^4 even/columns + square:
the sums of `points` without a negative weight (r^2 is at least 0 for the CKF and the CDKF, and for the UKF whenever
kappa is), so nothing is ever subtracted and P cannot become indefinite. Rounding counts half the digits: variances may
span 1e24 where the plain form has 1e12. `Carry.P` holds S.
"""

import math

import numpy as np

from estimators.filters.points import Parameters, observe_points, propagate_points, rule
from estimators.filters.work import Work
from estimators.jit import inner, njit
from estimators.models.base import Handle, difference, observe, process_noise, propagate, report, slope
from estimators.records import Estimate

USES = (propagate, difference, observe, slope)


@njit
def triangularise(A: np.ndarray, rows: int, columns: int) -> None:
    """`A[:rows, :columns]` = lower triangle with the same A A^T, by Householder reflections from the right."""
    for k in range(rows):
        norm2 = 0.0
        for j in range(k, columns):
            norm2 += A[k, j] * A[k, j]
        tail2 = norm2 - A[k, k] * A[k, k]
        if not tail2 > 0.0:
            continue
        norm = math.sqrt(norm2)
        pivot = -norm if A[k, k] > 0.0 else norm
        head = A[k, k] - pivot
        scale = 1.0 / (-pivot * head)  # 2 over the square of the reflection's vector (head, A[k, k+1:])
        for i in range(k + 1, rows):
            total = A[i, k] * head
            for j in range(k + 1, columns):
                total += A[i, j] * A[k, j]
            total *= scale
            A[i, k] -= total * head
            for j in range(k + 1, columns):
                A[i, j] -= total * A[k, j]
        A[k, k] = pivot
        for j in range(k + 1, columns):
            A[k, j] = 0.0


@njit
def append_root(M: np.ndarray, n: int, A: np.ndarray, at: int) -> None:
    """Lower Cholesky factor of a covariance M (n, n; lower half, may be singular) into `A[:n, at:at + n]`."""
    for j in range(n):
        pivot = M[j, j]
        for k in range(j):
            pivot -= A[j, at + k] ** 2
        pivot = math.sqrt(pivot) if pivot > 0.0 else 0.0
        for i in range(n):
            if i < j or pivot == 0.0:
                A[i, at + j] = 0.0
            elif i == j:
                A[i, at + j] = pivot
            else:
                rest = M[i, j]
                for k in range(j):
                    rest -= A[i, at + k] * A[j, at + k]
                A[i, at + j] = rest / pivot


@inner
def _take_factor(A: np.ndarray, row: int, column: int, n: int, S: np.ndarray) -> None:
    """`S` (n, n) = the triangle of A that begins there, diagonal not negative."""
    for j in range(n):
        sign = -1.0 if A[row + j, column + j] < 0.0 else 1.0
        for i in range(n):
            S[i, j] = sign * A[row + i, column + j] if i >= j else 0.0


@inner
def _centre(s: np.ndarray, shift: np.ndarray, columns: int, rows: int, h: float, even: float, square: float) -> bool:
    """Turn s into e and `shift` into r delta, see above; False when the filter's parameters make r^2 negative."""
    r2 = 4.0 * h**4 * even / columns + square
    root, r = math.sqrt(even), math.sqrt(max(r2, 0.0))
    for a in range(rows):
        mean = 2.0 * h * h * shift[a] / columns
        for i in range(columns):
            s[i, a] = root * (s[i, a] - mean)
        shift[a] *= r
    return r2 > -1e-9


def predict(
    method: Parameters, model: Handle, x: np.ndarray, P: np.ndarray, u: np.ndarray, dt: float, work: Work
) -> bool:
    """Time update: propagate the points, then compress their columns and those of the process noise."""
    n, moved, columns = model.size, model.changed, model.read
    L, d, e, shift, A, Q = work.L, work.odd, work.even, work.shift, work.A, work.Q
    for i in range(n):
        for j in range(columns):
            L[j, i] = P[i, j]
    h, even, square = rule(method, n)
    propagate_points(model, h, x, u, dt, work)
    ok: bool = _centre(e, shift, columns, moved, h, even, square)
    for i in range(n):
        for j in range(n):
            A[i, j] = P[i, j]
            Q[i, j] = 0.0
        for j in range(columns):
            if i < moved:
                A[i, j] = d[j, i] * (0.5 / h)
            A[i, n + j] = e[j, i] if i < moved else 0.0
        A[i, n + columns] = shift[i] if i < moved else 0.0
    process_noise(model, x, u, dt, Q)
    append_root(Q, n, A, n + columns + 1)
    triangularise(A, n, 2 * n + columns + 1)
    _take_factor(A, 0, 0, n, P)
    return ok


@inner
def _linear_columns(model: Handle, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work) -> None:
    """Columns `H S e_i` of a linear group in `work.odd`, nothing in the others."""
    rows, columns, d = model.rows[group], model.end[group], work.odd
    observe(model, group, 1, x, u, work.y)
    slope(model, group, x, u, work.J)
    for a in range(rows):
        work.shift[a] = 0.0
        for i in range(columns):
            total = 0.0
            for k in range(max(i, model.first[group]), columns):
                total += work.J[a, k] * P[k, i]
            d[i, a], work.even[i, a] = total, 0.0


def project(
    method: Parameters, model: Handle, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work
) -> bool:
    """Columns of the measurement update without noise, in `work.odd`, `work.even` and `work.shift`, and their S."""
    n, rows, columns = model.size, model.rows[group], model.end[group]
    L, d, e, shift, S = work.L, work.odd, work.even, work.shift, work.S
    ok = True
    if model.linear[group] != 0:
        _linear_columns(model, group, x, P, u, work)
    else:
        for i in range(n):
            for j in range(columns):
                L[j, i] = P[i, j]
        h, even, square = rule(method, n)
        observe_points(model, group, h, x, u, work)
        ok = _centre(e, shift, columns, rows, h, even, square)
        for a in range(rows):
            for i in range(columns):
                d[i, a] *= 0.5 / h
    for a in range(rows):
        for b in range(a + 1):
            total = shift[a] * shift[b]
            for i in range(columns):
                total += d[i, a] * d[i, b] + e[i, a] * e[i, b]
            S[a, b] = total
    return ok


@inner
def _gather(model: Handle, group: int, P: np.ndarray, work: Work) -> int:
    """`work.A` = the matrix of the measurement update, for the measurements that count; returns their number."""
    n, rows, columns = model.size, model.rows[group], model.end[group]
    A, S = work.A, work.S
    q = 0
    for a in range(rows):
        if work.used[a]:
            for i in range(n):
                A[q, i] = work.odd[i, a] if i < columns else 0.0
            for i in range(columns):
                A[q, n + i] = work.even[i, a]
            A[q, n + columns] = work.shift[a]
            p = 0
            for b in range(a + 1):
                if work.used[b]:
                    S[q, p] = work.noise[a, b]
                    p += 1
            q += 1
    append_root(S, q, A, n + columns + 1)
    for i in range(n):
        for j in range(n):
            A[q + i, j] = P[i, j]
        for j in range(n, n + columns + 1 + q):
            A[q + i, j] = 0.0
    return q


def correct(method: Parameters, model: Handle, group: int, P: np.ndarray, work: Work) -> bool:
    """Compress the columns; K and S_y of the triangle give the correction."""
    n, rows, A, error = model.size, model.rows[group], work.A, work.residual
    q = _gather(model, group, P, work)
    triangularise(A, q + n, n + model.end[group] + 1 + q)
    for i in range(n):
        work.dx[i] = 0.0
    k, ok = 0, True
    for a in range(rows):
        if work.used[a]:
            left, p = error[a], 0
            for b in range(a):
                if work.used[b]:
                    left -= A[k, p] * error[b] / A[p, p]
                    p += 1
            ok &= abs(A[k, k]) > 0.0
            error[a], work.variance[a] = left, A[k, k] * A[k, k]
            for i in range(n):
                work.dx[i] += A[q + i, k] * left / A[k, k]
            k += 1
    _take_factor(A, q, q, n, P)
    return ok


def store(method: Parameters, model: Handle, P: np.ndarray) -> None:
    """Put the factor S of a covariance in its place."""
    for j in range(model.size):
        for i in range(j, model.size):
            total = P[i, j]
            for k in range(j):
                total -= P[i, k] * P[j, k]
            P[i, j] = math.sqrt(total) if i == j else total / P[j, j]
        for i in range(j):
            P[i, j] = 0.0


def reported(method: Parameters, model: Handle, x: np.ndarray, P: np.ndarray, work: Work, answer: Estimate) -> None:
    """Report with S S^T."""
    for i in range(model.size):
        for j in range(i + 1):
            total = 0.0
            for k in range(j + 1):
                total += P[i, k] * P[j, k]
            work.P[i, j] = work.P[j, i] = total
    report(model, x, work.P, answer)
