"""Extended Kalman filter: functions linearised at the mean, with the model's analytic Jacobians."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from estimators.filters import moments
from estimators.filters.base import project_linear
from estimators.filters.work import Work
from estimators.models.base import Handle, observe, process_noise, propagate, slope, transition
from estimators.native import Number, Record

USES = (propagate, transition, observe, slope, moments.transform, moments.project_slope, moments.condition)


class Parameters(Record):
    """None."""

    nothing: Number


def make(settings: Mapping[str, Any]) -> Parameters:
    """Make the parameters; no settings."""
    return Parameters.zeros()


def predict(
    method: Parameters, model: Handle, x: np.ndarray, P: np.ndarray, u: np.ndarray, dt: float, work: Work
) -> bool:
    """`x <- f(x)`, `P <- F P F^T + Q`."""
    transition(model, x, u, dt, work.J)
    propagate(model, 1, x, u, dt, work.x)
    for i in range(model.raw):
        x[i] = work.x[i]
    moments.transform(model, P, work)
    process_noise(model, x, u, dt, P)
    return True


project = project_linear
