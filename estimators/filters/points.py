"""Sigma points in symmetric pairs: the part that CKF, CDKF and UKF share.

All three evaluate f at the mean and at `x +- h S e_i` (S the lower Cholesky factor of P) and differ only in how they
weigh

    d_i = f(+) - f(-),   s_i = f(+) + f(-) - 2 f(0),   delta = sum_i s_i / (2 h^2) :

    mean             f(0) + delta
    covariance       sum_i [ d_i d_i^T / (4 h^2) + even s_i s_i^T ] + square delta delta^T
    cross covariance sum_i S e_i d_i^T / (2 h)

`h`, `even` and `square` come from four numbers of a filter (`Parameters`), derived from its paper in the filter's own
file: all three are these kernels. A component that f does not read leaves d_i = s_i = 0, one that f passes on unchanged
is reproduced exactly: so only the components that the model declares are evaluated. Differences are the model's own, so
that states on a manifold need nothing more.
"""

import math

import numpy as np

from estimators.filters import moments
from estimators.filters.work import Work
from estimators.jit import inner
from estimators.models.base import Handle, difference, observe, process_noise, propagate, residual, retract, slope
from estimators.native import Number, Record

USES = (
    propagate, difference, observe, slope, moments.factorise, moments.predicted, moments.measured,
    moments.project_slope, moments.condition,
)  # fmt: skip


class Parameters(Record):
    """Holds the parameters that distinguish these sigma-point filters."""

    growth: Number  # h^2 = growth n + interval2, n the components of the state
    interval2: Number
    less: Number  # even = (h^2 - less) / (4 h^4)
    square: Number


@inner
def rule(method: Parameters, n: int) -> tuple[float, float, float]:
    """`(h, even, square)` of a filter for a state of n components."""
    h2 = method.growth * n + method.interval2
    return math.sqrt(h2), (h2 - method.less) / (4.0 * h2 * h2), method.square


@inner
def place_points(model: Handle, columns: int, h: float, x: np.ndarray, work: Work) -> None:
    """Set `work.points` to the pairs of points about x that belong to `columns` columns of the factor in `work.L`."""
    L, steps = work.L, work.steps
    for i in range(columns):
        for j in range(model.size):
            step = h * L[i, j]
            steps[2 * i, j] = step
            steps[2 * i + 1, j] = -step
    retract(model, 2 * columns, x, steps, work.points)


@inner
def combine(columns: int, rows: int, h: float, work: Work) -> None:
    """Set `work.odd` to d, `work.even` to s and `work.shift` to delta from what the pairs have in `work.ends`."""
    d, s, shift, ends = work.odd, work.even, work.shift, work.ends
    for a in range(rows):
        shift[a] = 0.0
    for i in range(columns):
        for a in range(rows):
            plus, minus = ends[2 * i, a], ends[2 * i + 1, a]
            d[i, a] = plus - minus
            s[i, a] = plus + minus
            shift[a] += s[i, a]
    for a in range(rows):
        shift[a] *= 0.5 / (h * h)


@inner
def propagate_points(model: Handle, h: float, x: np.ndarray, u: np.ndarray, dt: float, work: Work) -> None:
    """Propagate the points of `work.L`: x becomes the mean, the rest as in `combine`."""
    columns, centre = model.read, work.x
    propagate(model, 1, x, u, dt, centre)
    place_points(model, columns, h, x, work)
    propagate(model, 2 * columns, work.points, u, dt, work.moved)
    difference(model, 2 * columns, work.moved, centre, work.ends)
    combine(columns, model.changed, h, work)
    for j in range(model.size):
        work.dx[j] = work.shift[j] if j < model.changed else 0.0
    retract(model, 1, centre, work.dx, x)


def predict(
    method: Parameters, model: Handle, x: np.ndarray, P: np.ndarray, u: np.ndarray, dt: float, work: Work
) -> bool:
    """Time update (Han 2013, eq. (2)-(6))."""
    ok = moments.factorise(model, model.read, P, work.L)  # when it is not positive, the results are void
    h, even, square = rule(method, model.size)
    propagate_points(model, h, x, u, dt, work)
    moments.predicted(model, P, work, h, even, square)
    process_noise(model, x, u, dt, P)
    return ok


@inner
def observe_points(model: Handle, group: int, h: float, x: np.ndarray, u: np.ndarray, work: Work) -> None:
    """Observe the points of `work.L`: `work.y` becomes the mean, the rest as in `combine`."""
    rows, columns, y = model.rows[group], model.end[group], work.y
    observe(model, group, 1, x, u, y)
    place_points(model, columns, h, x, work)
    observe(model, group, 2 * columns, work.points, u, work.ends)
    residual(model, group, 2 * columns, work.ends, y, work.ends)
    combine(columns, rows, h, work)
    for a in range(rows):
        y[a] += work.shift[a]


def project(
    method: Parameters, model: Handle, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work
) -> bool:
    """Measurement moments (Han 2013, eq. (7)-(12)); a linear group needs no points."""
    if model.linear[group] != 0:
        observe(model, group, 1, x, u, work.y)
        slope(model, group, x, u, work.J)
        moments.project_slope(model, group, P, work)
        return True
    ok = moments.factorise(model, model.end[group], P, work.L)
    h, even, square = rule(method, model.size)
    observe_points(model, group, h, x, u, work)
    moments.measured(model, group, P, work, h, even, square)
    return ok
