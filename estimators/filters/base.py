"""What a filter supplies: how a mean and a covariance go through a nonlinear function.

A filter is a `NamedTuple` of its parameters with `predict` and `project` registered for its type. All else (measurement
noise, adaptation, conditioning, recovery) is the same for every filter and lives in `estimators.run`.
"""

from typing import Any, NamedTuple

import numpy as np

from estimators.generic import generic
from estimators.models.base import READ, ROWS, changed, read, size


class Work(NamedTuple):
    """Memory of one filter step, so that no step allocates."""

    x: np.ndarray  # (raw,) a state
    point: np.ndarray  # (raw,) a sigma point
    moved: np.ndarray  # (raw,) a propagated sigma point
    dx: np.ndarray  # (n,) an error
    L: np.ndarray  # (n, read) leading columns of the Cholesky factor
    odd: np.ndarray  # (read, rows) f(+) - f(-) per sigma point pair
    even: np.ndarray  # (read, rows) f(+) + f(-) - 2 f(0)
    shift: np.ndarray  # (rows,) mean minus f(0)
    plus: np.ndarray  # (rows,)
    minus: np.ndarray  # (rows,)
    J: np.ndarray  # (rows, n) a Jacobian
    T: np.ndarray  # (rows, n) its product with P
    S: np.ndarray  # (rows, rows) covariance of the measurements
    noise: np.ndarray  # (rows, rows) measurement noise, for an adaptation that weighs it
    C: np.ndarray  # (rows, n) covariance of measurements and state
    y: np.ndarray  # (rows,) predicted measurements
    measured: np.ndarray  # (rows,)
    residual: np.ndarray  # (rows,)
    variance: np.ndarray  # (rows,)
    used: np.ndarray  # (rows,) bool

    @classmethod
    def make(cls, model: Any, raw: int) -> "Work":
        """Memory for a model with `raw` numbers in its state."""
        n = size(model)
        columns = max(read(model), int(model.groups[:, READ].max()))
        rows = max(changed(model), int(model.groups[:, ROWS].max()))

        def zeros(*shape: int) -> np.ndarray:
            return np.zeros(shape)

        return cls(
            x=zeros(raw), point=zeros(raw), moved=zeros(raw), dx=zeros(n), L=zeros(n, columns),
            odd=zeros(columns, rows), even=zeros(columns, rows), shift=zeros(rows), plus=zeros(rows), minus=zeros(rows),
            J=zeros(rows, n), T=zeros(rows, n), S=zeros(rows, rows), noise=zeros(rows, rows), C=zeros(rows, n),
            y=zeros(rows), measured=zeros(rows), residual=zeros(rows), variance=zeros(rows), used=np.zeros(rows, bool),
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

    `work.y[:rows]` mean, `work.S[:rows, :rows]` covariance (lower half), `work.C[:rows]` covariance with the state.
    """
