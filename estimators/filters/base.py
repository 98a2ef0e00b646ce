"""What a filter supplies: how a mean and a covariance go through a nonlinear function.

A filter is a `NamedTuple` of its parameters with `predict` and `project` registered for its type. All else (measurement
noise, adaptation, recovery) is the same for every filter and lives in `estimators.run`. What a filter keeps of its
covariance is its own business: P itself unless it registers `stored`, `covariance` and `correct` (`square_root`).
"""

from typing import Any, NamedTuple

import numpy as np

from estimators.generic import default, generic
from estimators.linalg import condition
from estimators.models.base import READ, ROWS, changed, read, size


class Work(NamedTuple):
    """Memory of one filter step, so that no step allocates."""

    x: np.ndarray  # (raw,) a state
    point: np.ndarray  # (raw,) a sigma point
    moved: np.ndarray  # (raw,) a propagated sigma point
    dx: np.ndarray  # (n,) an error
    L: np.ndarray  # (read, n) leading columns of the Cholesky factor, one to a row
    odd: np.ndarray  # (read, rows) f(+) - f(-) per sigma point pair
    even: np.ndarray  # (read, rows) f(+) + f(-) - 2 f(0)
    shift: np.ndarray  # (rows,) mean minus f(0)
    plus: np.ndarray  # (rows,)
    minus: np.ndarray  # (rows,)
    J: np.ndarray  # (rows, n) a Jacobian
    T: np.ndarray  # (rows, n) its product with P
    S: np.ndarray  # (rows, rows) covariance of the measurements
    noise: np.ndarray  # (rows, rows) measurement noise as the adaptation weighs it, lower half
    scratch: np.ndarray  # (rows, rows) of the adaptation
    C: np.ndarray  # (rows, n) covariance of measurements and state
    y: np.ndarray  # (rows,) predicted measurements
    measured: np.ndarray  # (rows,)
    residual: np.ndarray  # (rows,)
    variance: np.ndarray  # (rows,)
    used: np.ndarray  # (rows,) bool
    Q: np.ndarray  # (n, n) process noise     }
    A: np.ndarray  # columns to be compressed } of square-root filters
    P: np.ndarray  # (n, n) covariance        }

    @classmethod
    def make(cls, model: Any, raw: int) -> "Work":
        """Memory for a model with `raw` numbers in its state."""
        n = size(model)
        columns = max(read(model), int(model.groups[:, READ].max()))
        rows = max(changed(model), int(model.groups[:, ROWS].max()))

        def zeros(*shape: int) -> np.ndarray:
            return np.zeros(shape)

        return cls(
            x=zeros(raw), point=zeros(raw), moved=zeros(raw), dx=zeros(n), L=zeros(columns, n),
            odd=zeros(columns, rows), even=zeros(columns, rows), shift=zeros(rows), plus=zeros(rows), minus=zeros(rows),
            J=zeros(rows, n), T=zeros(rows, n), S=zeros(rows, rows), noise=zeros(rows, rows), scratch=zeros(rows, rows),
            C=zeros(rows, n), y=zeros(rows), measured=zeros(rows), residual=zeros(rows), variance=zeros(rows),
            used=np.zeros(rows, bool), Q=zeros(n, n), A=zeros(rows + n, n + columns + 1 + max(n, rows)), P=zeros(n, n),
        )  # fmt: skip


@generic
def predict(  # type: ignore[empty-body]
    method: Any, model: Any, x: np.ndarray, P: np.ndarray, u: np.ndarray, dt: float, work: Work
) -> bool:
    """Move x and P by dt seconds, process noise included; False when P is not positive."""


@generic
def project(  # type: ignore[empty-body]
    method: Any, model: Any, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work
) -> bool:
    """Joint moments of a measurement group and the state, without measurement noise.

    `work.y[:rows]` mean, `work.S[:rows, :rows]` covariance (lower half), `work.C[:rows]` covariance with the state
    (of that only what the filter's own `correct` reads).
    """


@generic
def correct(method: Any, model: Any, group: int, P: np.ndarray, work: Work) -> bool:  # type: ignore[empty-body]
    """Condition P on the measurements of a group that count, after `project`; False when that is impossible.

    Takes `work.noise`, `work.residual` and `work.used`; leaves the correction in `work.dx`, independent innovations in
    `work.residual` and their variances in `work.variance`.
    """


@generic
def stored(method: Any, P: np.ndarray) -> np.ndarray:  # type: ignore[empty-body]
    """What the filter keeps of a covariance P (n, n), itself (n, n)."""


@generic
def covariance(method: Any, P: np.ndarray, work: Work) -> np.ndarray:  # type: ignore[empty-body]
    """The covariance (n, n) from what the filter keeps."""


@default
def _correct(method: Any, model: Any, group: int, P: np.ndarray, work: Work) -> bool:
    rows, S, noise = model.groups[group, ROWS], work.S, work.noise
    for i in range(rows):
        for j in range(i + 1):
            S[i, j] += noise[i, j]
    ok: bool = condition(size(model), rows, S, work.C, P, work.residual, work.used, work.variance, work.dx)
    return ok


@default
def _stored(method: Any, P: np.ndarray) -> np.ndarray:
    return P


@default
def _covariance(method: Any, P: np.ndarray, work: Work) -> np.ndarray:
    return P
