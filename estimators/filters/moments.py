"""Linear algebra of the filters for given sizes: compiled once for each, with the sizes as constants.

Loops over ten or twenty states are twice as fast when the compiler knows how many there are. So what filters do to
covariances is here, as entries that a model's handle supplies (see `models.base`) by its sizes. `work` is the filter's
(`filters.base`), P and L have rows of CAPACITY.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from estimators import linalg
from estimators.filters.work import WORK, Work
from estimators.native import Kernel, adapts, entry, local, matrix, record

if TYPE_CHECKING:
    from estimators.models.base import Handle


class Sizes(NamedTuple):
    """The constants, see `models.base`."""

    size: int
    changed: int
    read: int


@entry("pipp", bool)
def factorise(model: "Handle", columns: int, P: np.ndarray, L: np.ndarray) -> bool:  # type: ignore[empty-body]
    """The first `columns` columns of P's Cholesky factor, each a row of L; False when P is not positive."""


@entry("ppp")
def transform(model: "Handle", P: np.ndarray, work: Work) -> None:
    """`P <- F P F^T` with F in `work.J`, which differs from the identity in `changed` rows and `read` columns only."""


@entry("pipp")
def project_slope(model: "Handle", group: int, P: np.ndarray, work: Work) -> None:
    """`work.C = H P` and `work.S = H P H^T` (lower half) of a group, H in `work.J`."""


@entry("pppfff")
def predicted(model: "Handle", P: np.ndarray, work: Work, h: float, even: float, square: float) -> None:
    """Covariance P of propagated points: `work.odd`, `work.even`, `work.shift` and `work.L` as `points` has them."""


@entry("pippfff")
def measured(model: "Handle", group: int, P: np.ndarray, work: Work, h: float, even: float, square: float) -> None:
    """`work.S` (lower half) and `work.C` of the observed points of a group, likewise."""


@entry("pipp", bool)
def condition(model: "Handle", group: int, P: np.ndarray, work: Work) -> bool:  # type: ignore[empty-body]
    """Add `work.noise` to `work.S` and condition P on the group (`linalg.condition`); False when not positive."""


ENTRIES = (factorise, transform, project_slope, predicted, measured, condition)


@adapts(factorise)
def _factorise(sizes: Sizes, kernel: Kernel) -> Kernel:
    n = sizes.size

    def body(model, columns, P, L):  # type: ignore[no-untyped-def]
        return 1 if linalg.leading_cholesky(n, matrix(P), columns, matrix(L)) else 0

    return body


@adapts(transform)
def _transform(sizes: Sizes, kernel: Kernel) -> Kernel:
    n, moved, columns = sizes

    def body(model, P_, work_):  # type: ignore[no-untyped-def]
        work, P = record(work_, WORK), matrix(P_)
        F, FP, row = work.J, work.T, local(n)  # own memory: nothing else can point to it
        for a in range(moved):
            for j in range(n):
                row[j] = 0.0
            for k in range(columns):
                if F[a, k] != 0.0:
                    for j in range(n):
                        row[j] += F[a, k] * P[k, j]
            for j in range(n):
                FP[a, j] = row[j]
        for a in range(moved):
            for j in range(moved, n):
                P[a, j] = P[j, a] = FP[a, j]
        for a in range(moved):
            for b in range(a + 1):
                total = 0.0
                for k in range(columns):
                    if F[b, k] != 0.0:
                        total += FP[a, k] * F[b, k]
                P[a, b] = P[b, a] = total

    return body


@adapts(project_slope)
def _project_slope(sizes: Sizes, kernel: Kernel) -> Kernel:
    from estimators.models.base import HANDLE

    n = sizes.size

    def body(model_, group, P_, work_):  # type: ignore[no-untyped-def]
        model, work, P = record(model_, HANDLE), record(work_, WORK), matrix(P_)
        rows, first, end = model.rows[group], model.first[group], model.end[group]
        H, C, S, row = work.J, work.C, work.S, local(n)  # own memory: nothing else can point to it
        for a in range(rows):
            for j in range(n):
                row[j] = 0.0
            for k in range(first, end):
                if H[a, k] != 0.0:
                    for j in range(n):
                        row[j] += H[a, k] * P[k, j]
            for j in range(n):
                C[a, j] = row[j]
            for b in range(a + 1):
                total = 0.0
                for k in range(first, end):
                    total += C[a, k] * H[b, k]
                S[a, b] = total

    return body


@adapts(predicted)
def _predicted(sizes: Sizes, kernel: Kernel) -> Kernel:
    n, moved, columns = sizes

    def body(model, P_, work_, h, even, square):  # type: ignore[no-untyped-def]
        work, P = record(work_, WORK), matrix(P_)
        L, d = work.L, work.odd
        linalg.spread(d, work.even, work.shift, columns, moved, 0.25 / (h * h), even, square, P)
        for a in range(moved):
            for j in range(moved, n):
                P[a, j] = 0.0
            for i in range(columns):
                weighted = 0.5 / h * d[i, a]
                for j in range(moved, n):
                    P[a, j] += weighted * L[i, j]
            for j in range(moved, n):
                P[j, a] = P[a, j]
        for a in range(moved):
            for b in range(a):
                P[b, a] = P[a, b]

    return body


@adapts(measured)
def _measured(sizes: Sizes, kernel: Kernel) -> Kernel:
    from estimators.models.base import HANDLE

    n = sizes.size

    def body(model_, group, P, work_, h, even, square):  # type: ignore[no-untyped-def]
        model, work = record(model_, HANDLE), record(work_, WORK)
        rows, columns = model.rows[group], model.end[group]
        L, d, C = work.L, work.odd, work.C
        linalg.spread(d, work.even, work.shift, columns, rows, 0.25 / (h * h), even, square, work.S)
        for a in range(rows):
            for j in range(n):
                C[a, j] = 0.0
            for i in range(columns):
                weighted = 0.5 / h * d[i, a]
                for j in range(i, n):
                    C[a, j] += weighted * L[i, j]

    return body


@adapts(condition)
def _condition(sizes: Sizes, kernel: Kernel) -> Kernel:
    from estimators.models.base import HANDLE

    n = sizes.size

    def body(model_, group, P_, work_):  # type: ignore[no-untyped-def]
        model, work, P = record(model_, HANDLE), record(work_, WORK), matrix(P_)
        rows, S, noise = model.rows[group], work.S, work.noise
        for i in range(rows):
            for j in range(i + 1):
                S[i, j] += noise[i, j]
        row, dx = local(n), local(n)  # own memory: nothing else can point to it
        ok = linalg.condition(n, rows, S, work.C, P, work.residual, work.used, work.variance, row, dx)
        for i in range(n):
            work.dx[i] = dx[i]
        return 1 if ok else 0

    return body
