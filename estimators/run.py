"""The estimation loop: row by row through a block, the same for every filter and model.

Time stamps decide: dt is their difference, never a nominal rate. A row whose stamp repeats or goes back is left out (the estimate
stays, status COASTING); a gap is bridged by prediction in steps of at most `MAX_STEP`.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from estimators.filters.base import Work, predict, project
from estimators.jit import njit
from estimators.linalg import condition, healthy
from estimators.models.base import (
    ROWS,
    START,
    constrain,
    load,
    measurement_noise,
    report,
    residual,
    retract,
)
from estimators.types import Status

MAX_STEP = 0.5  # s, longest step of one prediction
MAX_STEPS = 120  # a longer gap than a minute is bridged with longer steps
BACKWARDS = 1.0  # s: a stamp that goes further back is another recording, not jitter

_RUNNING, _COASTING, _DIVERGED = int(Status.RUNNING), int(Status.COASTING), int(Status.DIVERGED)


class Carry(NamedTuple):
    """What goes on from row to row: with the model it is the whole state of an estimator."""

    x: np.ndarray  # (raw,) state
    P: np.ndarray  # (n, n) its covariance
    memory: np.ndarray  # (m,) of the model: latched inputs, derivatives
    clock: np.ndarray  # (1,) s, last time stamp; NaN before the first
    u: np.ndarray  # inputs of the last row
    z: np.ndarray  # measurements of the last row
    used: np.ndarray  # which of them counted
    P_restart: np.ndarray  # (n, n) covariance to restart with when the filter is lost


@njit
def first_bad_stamp(t: np.ndarray, last: float) -> int:
    """Index of the first stamp that is not finite or jumps back by more than `BACKWARDS`, -1 when there is none."""
    latest = last
    for k in range(t.shape[0]):
        if not math.isfinite(t[k]) or t[k] < latest - BACKWARDS:
            return k
        if not latest >= t[k]:
            latest = t[k]
    return -1


@njit(forceinline=True)
def update(method: Any, model: Any, carry: Carry, work: Work, innovation: np.ndarray, variance: np.ndarray) -> bool:
    """All measurement groups of a row; writes the independent innovations and their variances (NaN when not used)."""
    x, P, u = carry.x, carry.P, carry.u
    for g in range(model.layout.groups.shape[0]):
        start, rows = model.layout.groups[g, START], model.layout.groups[g, ROWS]
        any_used = False
        for i in range(rows):
            work.used[i] = carry.used[start + i]
            any_used |= work.used[i]
        if not any_used:
            continue
        if not project(method, model, g, x, P, u, work):
            return False
        measurement_noise(model, g, x, u, work.S)
        for i in range(rows):
            work.measured[i] = carry.z[start + i]
        residual(model, g, work.measured, work.y, work.residual)
        if not condition(work.S, work.C, P, rows, work.residual, work.used, work.variance, work.dx):
            return False
        for i in range(rows):
            if work.used[i]:
                innovation[start + i] = work.residual[i]
                variance[start + i] = work.variance[i]
        retract(model, x, work.dx, work.x)
        for i in range(x.shape[0]):
            x[i] = work.x[i]
    constrain(model, x)
    return True


@njit(forceinline=True)
def advance(method: Any, model: Any, carry: Carry, work: Work, dt: float) -> bool:
    """Predict over dt seconds, in several steps when it is a gap."""
    steps = 1
    if dt > MAX_STEP:
        steps = min(MAX_STEPS, int(math.ceil(dt / MAX_STEP)))
    for _ in range(steps):
        if not predict(method, model, carry.x, carry.P, carry.u, dt / steps, work):
            return False
    return True


@njit
def run(method: Any, model: Any, carry: Carry, work: Work, samples: Any, out: Any, first: int) -> None:
    """Rows `first` to the end of `samples` (tuple of the columns of `Samples`) into `out` (those of `Estimates`)."""
    x, P = carry.x, carry.P
    before = np.empty_like(x)
    for k in range(first, samples.t.shape[0]):
        t = samples.t[k]
        out.t[k] = t
        dt = t - carry.clock[0]
        if dt <= 0.0:
            out.status[k] = _COASTING
            report(model, x, P, carry.memory, out, k)
            continue
        for i in range(x.shape[0]):
            before[i] = x[i]
        status = load(model, samples, k, x, carry.memory, carry.u, carry.z, carry.used)
        ok = True
        if dt > 0.0:  # not at the first row of all
            ok = advance(method, model, carry, work, dt)
            if dt > MAX_STEP:
                status = _COASTING
        carry.clock[0] = t
        if not (ok and update(method, model, carry, work, out.innovation[k], out.innovation_var[k]) and healthy(x, P)):
            status = _DIVERGED
            for i in range(x.shape[0]):
                x[i] = before[i]
            for i in range(P.shape[0]):
                for j in range(P.shape[0]):
                    P[i, j] = carry.P_restart[i, j]
            for i in range(out.innovation.shape[1]):
                out.innovation[k, i] = math.nan
                out.innovation_var[k, i] = math.nan
        out.status[k] = status
        report(model, x, P, carry.memory, out, k)
