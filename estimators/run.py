"""The estimation loop: row by row through a block, the same for every filter, policy and model.

Time stamps decide: dt is their difference, never a nominal rate. A row whose stamp repeats or goes back is left out
(the estimate stays, status COASTING); a gap is bridged by prediction in steps of at most `MAX_STEP`.
"""

import math

import numpy as np

from estimators.adaptation.base import POLICY, PolicyHandle, admit
from estimators.filters.base import METHOD, FilterHandle, predict, reported, update
from estimators.filters.work import CARRY, WORK, Carry, Work
from estimators.jit import inner
from estimators.linalg import healthy
from estimators.models.base import HANDLE, Handle, constrain, load, measure, report
from estimators.native import Kernel, adapts, entry, record
from estimators.records import ESTIMATE, SAMPLE, Estimate, Sample
from estimators.types import MEASUREMENTS, Status

MAX_STEP = 0.5  # s, longest step of one prediction
MAX_STEPS = 120  # a longer gap than a minute is bridged with longer steps
BACKWARDS = 1.0  # s: a stamp that goes further back is another recording, not jitter

_RUNNING, _COASTING, _DIVERGED = int(Status.RUNNING), int(Status.COASTING), int(Status.DIVERGED)


@inner
def _blank_zero(v: np.ndarray) -> None:
    if v[0] == 0.0 and v[1] == 0.0 and v[2] == 0.0:
        v[0] = v[1] = v[2] = math.nan


@entry("pif", int)
def screen(rows: np.ndarray, count: int, last: float) -> int:  # type: ignore[empty-body]
    """Find the first row whose stamp is not finite or jumps back more than `BACKWARDS`; -1 when there is none.

    Zero on all axes of accelerometer or magnetometer is a dead sensor, not a measurement: it becomes NaN.
    """


@adapts(screen)
def _screen(owner: None, kernel: Kernel) -> Kernel:
    def body(rows, count, last):  # type: ignore[no-untyped-def]
        latest = last
        for k in range(count):
            row = record(rows, SAMPLE, k)
            _blank_zero(row.accel_b)
            _blank_zero(row.mag_b)
            t = row.t
            if not math.isfinite(t) or t < latest - BACKWARDS:
                return k
            if not latest >= t:
                latest = t
        return -1

    return body


@inner
def _correct(
    method: FilterHandle, policy: PolicyHandle, model: Handle, carry: Carry, work: Work, answer: Estimate
) -> bool:
    """Update by all measurement groups of a row; their innovations and variances go to the estimates."""
    ok = True  # no early return: it costs more than the equations
    for g in range(model.groups):
        start, rows = model.start[g], model.rows[g]
        any_used = False
        for i in range(rows):
            work.measured[i] = carry.z[start + i]
            work.used[i] = carry.used[start + i]
            any_used |= carry.used[start + i] != 0
        if any_used and ok:
            ok = update(method, policy, model, g, carry.x, carry.P, carry.u, carry.trust, work)
            for i in range(rows):
                if work.used[i] != 0 and start + i < MEASUREMENTS:
                    answer.innovation[start + i] = work.residual[i]
                    answer.innovation_var[start + i] = work.variance[i]
    constrain(model, carry.x)
    return ok


@inner
def _report(method: FilterHandle, model: Handle, carry: Carry, work: Work, answer: Estimate) -> None:
    """Write the estimate; most filters keep P as it is reported."""
    if method.plain != 0:
        report(model, carry.x, carry.P, answer)
    else:
        reported(method, model, carry.x, carry.P, work, answer)


@inner
def _restart(model: Handle, carry: Carry, work: Work, answer: Estimate) -> None:
    """Go back to the state before the row, with a large covariance."""
    for i in range(model.raw):
        carry.x[i] = work.before[i]
    for i in range(model.size):
        for j in range(model.size):
            carry.P[i, j] = carry.P_restart[i, j]
    for i in range(MEASUREMENTS):
        answer.innovation[i] = answer.innovation_var[i] = math.nan


@inner
def _step(
    method: FilterHandle, policy: PolicyHandle, model: Handle, carry: Carry, work: Work, row: Sample, answer: Estimate
) -> None:
    """Estimate one row."""
    t = row.t
    answer.t = t
    dt = t - carry.clock
    if dt <= 0.0:
        answer.status = _COASTING
        _report(method, model, carry, work, answer)
        return
    carry.clock = t
    for i in range(model.raw):
        work.before[i] = carry.x[i]
    load(model, row, carry.x, carry.u)
    steps = 1 if dt <= MAX_STEP else 0  # none at the first row of all, where dt is NaN
    if dt > MAX_STEP:
        steps = min(MAX_STEPS, math.ceil(dt / MAX_STEP))
    ok = True
    for _ in range(steps):
        ok = ok and predict(method, model, carry.x, carry.P, carry.u, dt / steps, work)
    state = measure(model, row, carry.x, carry.u, carry.z, carry.used)
    refused = policy.admits != 0 and admit(policy, model, row, carry.x, carry.trust, carry.used)
    if refused or dt > MAX_STEP:
        state = _COASTING
    ok = ok and _correct(method, policy, model, carry, work, answer)
    if not (ok and healthy(model.raw, carry.x, model.size, carry.P)):
        state = _DIVERGED
        _restart(model, carry, work, answer)
    answer.status = state
    for i in range(4):
        answer.adaptation[i] = carry.trust[i]
    _report(method, model, carry, work, answer)


@entry("pppppppii")
def run(
    method: FilterHandle, policy: PolicyHandle, model: Handle, carry: Carry, work: Work, rows: np.ndarray,
    out: np.ndarray, first: int, count: int,
) -> None:  # fmt: skip
    """Estimate rows `first` to `count` - 1 of samples (records) into estimates (records)."""


@adapts(run)
def _run(owner: None, kernel: Kernel) -> Kernel:
    def body(method, policy, model, carry, work, rows, out, first, count):  # type: ignore[no-untyped-def]
        a, b, c = record(method, METHOD), record(policy, POLICY), record(model, HANDLE)
        d, e = record(carry, CARRY), record(work, WORK)
        for k in range(first, count):
            _step(a, b, c, d, e, record(rows, SAMPLE, k), record(out, ESTIMATE, k))

    return body
