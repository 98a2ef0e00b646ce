"""Iterated extended Kalman filter: linearise again where the correction leads (Bell and Cathey 1993).

The update of an extended Kalman filter is the first Gauss-Newton step towards the most probable state,

    x_(i+1) = x_0 + K_i [ z - h(x_i) + H_i (x_i - x_0) ],   H_i, K_i at x_i

and this filter takes up to `iterations` of them, all from the same prior x_0, P. It helps where a measurement is much
more precise than the prediction and its slope changes on the way, such as a field or a force with a heading that is far
off; where the filter tracks, the second step changes nothing. Linear groups need one step. R is that of the first step.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from estimators.adaptation.base import PolicyHandle, weigh
from estimators.filters import base
from estimators.filters.base import FilterHandle, project_linear
from estimators.filters.ekf import USES as USES
from estimators.filters.ekf import predict as predict
from estimators.filters.work import Work
from estimators.models.base import Handle, residual, retract
from estimators.native import Integer, Record, record
from estimators.settings import Setting

SETTINGS = {"iterations": Setting(3.0, "most linearisations of a measurement", minimum=1.0, maximum=20.0)}
_ENOUGH = 1e-3  # sigma: a step that small ends it


class Parameters(Record):
    """Parameters of the filter."""

    iterations: Integer


_PARAMETERS = Parameters.dtype


def make(settings: Mapping[str, Any]) -> Parameters:
    """Make the parameters from the setting `iterations`."""
    return Parameters.of(iterations=int(settings.get("iterations", 3)))


project = project_linear


def update(
    own: FilterHandle, policy: PolicyHandle, model: Handle, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray,
    trust: np.ndarray, work: Work,
) -> bool:  # fmt: skip
    """Correct x and P by a group, linearised up to `iterations` times; innovations are those of the first."""
    rows, n, prior, x0, dx = model.rows[group], model.size, work.P, work.points[0], work.steps[0]
    innovation, variance = work.ends[0], work.ends[1]
    most = 1 if model.linear[group] != 0 else record(own.parameters, _PARAMETERS).iterations
    for i in range(model.raw):
        x0[i] = x[i]
    ok, step, k = True, math.inf, 0
    while ok and k < most and step > _ENOUGH:
        for i in range(n):  # each step starts from the prior
            for j in range(n):
                if k == 0:
                    prior[i, j] = P[i, j]
                else:
                    P[i, j] = prior[i, j]
        ok = base.project(own, model, group, x, P, u, work)
        residual(model, group, 1, work.measured, work.y, work.residual)
        if k == 0:
            weigh(policy, model, group, x, u, trust, work)
        else:
            for a in range(rows):
                for j in range(model.first[group], model.end[group]):
                    work.residual[a] += work.J[a, j] * dx[j]
        ok &= base.correct(own, model, group, P, work)
        if k == 0:
            for a in range(rows):
                innovation[a], variance[a] = work.residual[a], work.variance[a]
        step = 0.0
        for i in range(n):
            moved = work.dx[i] - dx[i] if k > 0 else work.dx[i]
            step = max(step, abs(moved) / math.sqrt(prior[i, i]))
            dx[i] = work.dx[i]
        retract(model, 1, x0, dx, work.x)
        for i in range(model.raw):
            x[i] = work.x[i]
        k += 1
    for a in range(rows):
        work.residual[a], work.variance[a] = innovation[a], variance[a]
    return ok
