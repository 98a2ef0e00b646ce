"""The estimation loop: row by row through a block, the same for every filter and model.

Time stamps decide: dt is their difference, never a nominal rate. A row whose stamp repeats or goes back is left out
(the estimate stays, status COASTING); a gap is bridged by prediction in steps of at most `MAX_STEP`.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from estimators.adaptation.base import admit, weigh
from estimators.filters.base import Work, correct, covariance, predict, project
from estimators.jit import borrowed, inner, njit
from estimators.linalg import healthy
from estimators.models.base import (
    ROWS,
    START,
    constrain,
    load,
    measure,
    report,
    residual,
    retract,
)
from estimators.rows import E_ADAPTATION, E_INNOVATION, E_VARIANCE, T
from estimators.types import MEASUREMENTS, Status

MAX_STEP = 0.5  # s, longest step of one prediction
MAX_STEPS = 120  # a longer gap than a minute is bridged with longer steps
BACKWARDS = 1.0  # s: a stamp that goes further back is another recording, not jitter

_RUNNING, _COASTING, _DIVERGED = int(Status.RUNNING), int(Status.COASTING), int(Status.DIVERGED)


class Carry(NamedTuple):
    """What goes on from row to row: with the model it is the whole state of an estimator."""

    x: np.ndarray  # (raw,) state
    P: np.ndarray  # (n, n) its covariance, as the filter keeps it
    memory: np.ndarray  # (m,) of the model: latched inputs, derivatives
    clock: np.ndarray  # (1,) s, last time stamp; NaN before the first
    u: np.ndarray  # inputs of the last row
    z: np.ndarray  # measurements of the last row
    used: np.ndarray  # which of them counted
    P_restart: np.ndarray  # (n, n) covariance to restart with when the filter is lost
    trust: np.ndarray  # of the adaptation, see `adaptation.base`


@njit
def first_bad_stamp(rows: np.ndarray, last: float) -> int:
    """Index of the first row whose stamp is not finite or jumps back more than `BACKWARDS`; -1 when there is none."""
    latest = last
    for k in range(rows.shape[0]):
        t = rows[k, T]
        if not math.isfinite(t) or t < latest - BACKWARDS:
            return k
        if not latest >= t:
            latest = t
    return -1


@inner
def update(
    method: Any,
    policy: Any,
    model: Any,
    x: np.ndarray,
    P: np.ndarray,
    u: np.ndarray,
    z: np.ndarray,
    used: np.ndarray,
    trust: np.ndarray,
    work: Work,
    answer: np.ndarray,
) -> bool:
    """All measurement groups of a row; writes the independent innovations and their variances to the estimates."""
    S, y, measured, error, noise, scratch = work.S, work.y, work.measured, work.residual, work.noise, work.scratch
    counts, spread, dx, moved = work.used, work.variance, work.dx, work.x
    ok = True  # no early return: it costs more than the equations
    for g in range(model.groups.shape[0]):
        start, rows = model.groups[g, START], model.groups[g, ROWS]
        any_used = False
        for i in range(rows):
            measured[i] = z[start + i]
            counts[i] = used[start + i]
            any_used |= used[start + i]
        if any_used and ok:
            ok = project(method, model, g, x, P, u, work)
            residual(model, g, measured, y, error)
            weigh(policy, model, g, x, u, S, error, counts, trust, noise, scratch)
            ok &= correct(method, model, g, P, work)
            for i in range(rows):
                if counts[i] and start + i < MEASUREMENTS:
                    answer[E_INNOVATION + start + i] = error[i]
                    answer[E_VARIANCE + start + i] = spread[i]
            retract(model, x, dx, moved)
            for i in range(x.shape[0]):
                x[i] = moved[i]
    constrain(model, x)
    return ok


@njit
def run(
    method: Any,
    policy: Any,
    model: Any,
    carry: Carry,
    work: Work,
    rows: np.ndarray,
    out: np.ndarray,
    status: np.ndarray,
    first: int,
) -> None:
    """Rows `first` to the end of samples (n, SAMPLE_WIDTH) into estimates (n, ESTIMATE_WIDTH) and status (n,)."""
    model, carry, work = borrowed(model), borrowed(carry), borrowed(work)
    rows, out, status = borrowed(rows), borrowed(out), borrowed(status)
    x, P, memory, clock, u, z, used = carry.x, carry.P, carry.memory, carry.clock, carry.u, carry.z, carry.used
    trust = carry.trust
    before = np.empty_like(x)
    for k in range(first, rows.shape[0]):
        row, answer = rows[k], out[k]
        t = row[T]
        answer[0] = t
        dt = t - clock[0]
        if dt <= 0.0:
            status[k] = _COASTING
            report(model, x, covariance(method, P, work), memory, answer)
            continue
        clock[0] = t
        for i in range(x.shape[0]):
            before[i] = x[i]
        load(model, row, x, memory, u)
        steps = 1 if dt <= MAX_STEP else 0  # none at the first row of all, where dt is NaN
        if dt > MAX_STEP:
            steps = min(MAX_STEPS, math.ceil(dt / MAX_STEP))
        ok = True
        for _ in range(steps):
            ok = ok and predict(method, model, x, P, u, dt / steps, work)
        state = measure(model, row, x, memory, u, z, used)
        if admit(policy, model, row, x, trust, used) or dt > MAX_STEP:
            state = _COASTING
        ok = ok and update(method, policy, model, x, P, u, z, used, trust, work, answer)
        if not (ok and healthy(x, P)):
            state = _DIVERGED
            for i in range(x.shape[0]):
                x[i] = before[i]
            for i in range(P.shape[0]):
                for j in range(P.shape[0]):
                    P[i, j] = carry.P_restart[i, j]
            for i in range(2 * MEASUREMENTS):
                answer[E_INNOVATION + i] = math.nan
        status[k] = state
        for i in range(4):
            answer[E_ADAPTATION + i] = trust[i]
        report(model, x, covariance(method, P, work), memory, answer)
