"""Extended Kalman filter: functions linearised at the mean, with the model's analytic Jacobians."""

from typing import Any, NamedTuple

import numpy as np

from estimators.filters.base import Work
from estimators.generic import register
from estimators.jit import inner
from estimators.models.base import (
    FROM,
    READ,
    ROWS,
    changed,
    observe,
    process_noise,
    propagate,
    read,
    size,
    slope,
    transition,
)


class Ekf(NamedTuple):
    """No parameters."""


def _predict(method: Any, model: Any, x: np.ndarray, P: np.ndarray, u: np.ndarray, dt: float, work: Work) -> bool:
    """`x <- f(x)`, `P <- F P F^T + Q`, where F differs from the identity in `changed` rows and `read` columns only."""
    n, moved, columns = size(model), changed(model), read(model)
    F, FP = work.J, work.T
    transition(model, x, u, dt, F)
    propagate(model, x, u, dt, work.x)
    for i in range(x.shape[0]):
        x[i] = work.x[i]
    for a in range(moved):
        for j in range(n):
            FP[a, j] = 0.0
        for k in range(columns):
            if F[a, k] != 0.0:
                for j in range(n):
                    FP[a, j] += F[a, k] * P[k, j]
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
    process_noise(model, x, u, dt, P)
    return True


@inner
def project_linear(
    method: Any, model: Any, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work
) -> bool:
    """`y = h(x)`, `C = H P`, `S = H P H^T`: exact for a linear group, so every filter uses it there."""
    n, rows = size(model), model.groups[group, ROWS]
    first, end = model.groups[group, FROM], model.groups[group, READ]
    H, C, S = work.J, work.C, work.S
    observe(model, group, x, u, work.y)
    slope(model, group, x, u, H)
    for a in range(rows):
        for j in range(n):
            C[a, j] = 0.0
        for k in range(first, end):
            if H[a, k] != 0.0:
                for j in range(n):
                    C[a, j] += H[a, k] * P[k, j]
        for b in range(a + 1):
            total = 0.0
            for k in range(first, end):
                total += C[a, k] * H[b, k]
            S[a, b] = total
    return True


register(Ekf, predict=_predict, project=project_linear)
