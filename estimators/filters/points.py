"""Sigma points in symmetric pairs: the part that CKF, CDKF and UKF share.

All three evaluate f at the mean and at `x +- h S e_i` (S the lower Cholesky factor of P) and differ only in how they
weigh

    d_i = f(+) - f(-),   s_i = f(+) + f(-) - 2 f(0),   delta = sum_i s_i / (2 h^2) :

    mean             f(0) + delta
    covariance       sum_i [ d_i d_i^T / (4 h^2) + even s_i s_i^T ] + square delta delta^T
    cross covariance sum_i S e_i d_i^T / (2 h)

`h`, `even` and `square` come from four numbers of a filter (`Points`), derived from its paper in the filter's own file:
all three are one type and compiled once. A component that f does not read leaves d_i = s_i = 0, one that f passes on
unchanged is reproduced exactly: so only the components that the model declares are evaluated. Differences are the
model's own, so that states on a manifold need nothing more.
"""

from typing import Any, NamedTuple

import numpy as np

from estimators.filters.base import Work
from estimators.filters.ekf import project_linear
from estimators.generic import register
from estimators.jit import inner, njit
from estimators.linalg import leading_cholesky
from estimators.models.base import (
    LINEAR,
    READ,
    ROWS,
    changed,
    difference,
    observe,
    process_noise,
    propagate,
    read,
    residual,
    retract,
    size,
)


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
    """`out` (lower half) = covariance of the points: the second line of the module's docstring."""
    for a in range(rows):
        for b in range(a + 1):
            out[a, b] = square * shift[a] * shift[b]
    for i in range(pairs):
        for a in range(rows):
            weighted_d, weighted_s = odd * d[i, a], even * s[i, a]
            for b in range(a + 1):
                out[a, b] += weighted_d * d[i, b] + weighted_s * s[i, b]


class Points(NamedTuple):
    """What tells one of these filters from another."""

    growth: float  # h^2 = growth n + interval2, n the components of the state
    interval2: float
    less: float  # even = (h^2 - less) / (4 h^4)
    square: float


@inner
def rule(method: Any, n: int) -> tuple[float, float, float]:
    """`(h, even, square)` of a filter for a state of n components."""
    h2 = method.growth * n + method.interval2
    return h2**0.5, (h2 - method.less) / (4.0 * h2 * h2), method.square


@inner
def propagate_points(
    method: Any, model: Any, x: np.ndarray, u: np.ndarray, dt: float, work: Work
) -> tuple[float, float, float]:
    """Points of `work.L` through `propagate`: x becomes the mean, `work.odd` d, `work.even` s, `work.shift` delta."""
    n, moved, columns = size(model), changed(model), read(model)
    h, even, square = rule(method, n)
    L, d, s, shift, plus, minus, dx = work.L, work.odd, work.even, work.shift, work.plus, work.minus, work.dx
    centre = work.x
    propagate(model, x, u, dt, centre)
    for a in range(moved):
        shift[a] = 0.0
    for i in range(columns):
        for j in range(n):
            dx[j] = h * L[i, j]
        retract(model, x, dx, work.point)
        propagate(model, work.point, u, dt, work.moved)
        difference(model, work.moved, centre, plus)
        for j in range(n):
            dx[j] = -dx[j]
        retract(model, x, dx, work.point)
        propagate(model, work.point, u, dt, work.moved)
        difference(model, work.moved, centre, minus)
        for a in range(moved):
            d[i, a] = plus[a] - minus[a]
            s[i, a] = plus[a] + minus[a]
            shift[a] += s[i, a]
    for j in range(n):
        dx[j] = 0.0
    for a in range(moved):
        shift[a] *= 0.5 / (h * h)
        dx[a] = shift[a]
    retract(model, centre, dx, x)
    return h, even, square


def predict_points(method: Any, model: Any, x: np.ndarray, P: np.ndarray, u: np.ndarray, dt: float, work: Work) -> bool:
    """Time update (paper 000 eq. (2)-(6))."""
    n, moved, columns = size(model), changed(model), read(model)
    L, d, s, shift = work.L, work.odd, work.even, work.shift
    ok: bool = leading_cholesky(n, P, columns, L)  # when it is not, the results are void; an early return costs time
    h, even, square = propagate_points(method, model, x, u, dt, work)
    spread(d, s, shift, columns, moved, 0.25 / (h * h), even, square, P)
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
    process_noise(model, x, u, dt, P)
    return ok


def project_points(
    method: Any, model: Any, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work
) -> bool:
    """Measurement moments (paper 000 eq. (7)-(12)); a linear group needs no points."""
    if model.groups[group, LINEAR] == 1:
        ok: bool = project_linear(method, model, group, x, P, u, work)
    else:
        ok = _project_nonlinear(method, model, group, x, P, u, work)
    return ok


@inner
def observe_points(
    method: Any, model: Any, group: int, x: np.ndarray, u: np.ndarray, work: Work
) -> tuple[float, float, float]:
    """Points of `work.L` through `observe`: `work.y` becomes the mean, the rest as in `propagate_points`."""
    n, rows, columns = size(model), model.groups[group, ROWS], model.groups[group, READ]
    h, even, square = rule(method, n)
    L, d, s, shift, plus, minus, dx, y = (
        work.L, work.odd, work.even, work.shift, work.plus, work.minus, work.dx, work.y,
    )  # fmt: skip
    observe(model, group, x, u, y)
    for a in range(rows):
        shift[a] = 0.0
    for i in range(columns):
        for j in range(n):
            dx[j] = h * L[i, j]
        retract(model, x, dx, work.point)
        observe(model, group, work.point, u, plus)
        for j in range(n):
            dx[j] = -dx[j]
        retract(model, x, dx, work.point)
        observe(model, group, work.point, u, minus)
        residual(model, group, plus, y, plus)
        residual(model, group, minus, y, minus)
        for a in range(rows):
            d[i, a] = plus[a] - minus[a]
            s[i, a] = plus[a] + minus[a]
            shift[a] += s[i, a]
    for a in range(rows):
        shift[a] *= 0.5 / (h * h)
        y[a] += shift[a]
    return h, even, square


@inner
def _project_nonlinear(
    method: Any, model: Any, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work
) -> bool:
    n, rows, columns = size(model), model.groups[group, ROWS], model.groups[group, READ]
    L, d, C = work.L, work.odd, work.C
    ok: bool = leading_cholesky(n, P, columns, L)
    h, even, square = observe_points(method, model, group, x, u, work)
    spread(d, work.even, work.shift, columns, rows, 0.25 / (h * h), even, square, work.S)
    for a in range(rows):
        for j in range(n):
            C[a, j] = 0.0
        for i in range(columns):
            weighted = 0.5 / h * d[i, a]
            for j in range(i, n):
                C[a, j] += weighted * L[i, j]
    return ok


register(Points, predict=predict_points, project=project_points)
