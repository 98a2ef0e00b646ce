"""Everything that an estimator does with a block, row by row: alignment, then the loop, the same for every combination.

Time stamps decide: dt is their difference, never a nominal rate. A row whose stamp repeats or goes back is left out
(the estimate stays, status COASTING); a gap is bridged by prediction in steps of at most `MAX_STEP`.
"""

import math

import numpy as np

from estimators import adaptation
from estimators.adaptation.base import POLICY, PolicyHandle, admit, configure
from estimators.adaptation.base import begin as begin_trust
from estimators.alignment import ALIGNMENT, LONGEST_GAP, STILL, STRETCH, conclude, still_limits, take
from estimators.alignment import begin as begin_stretch
from estimators.elementary import ceil
from estimators.filters.base import METHOD, FilterHandle, predict, reported, store, update
from estimators.filters.work import CARRY, WORK, Carry, Work
from estimators.jit import inner
from estimators.latency import is_late, to_gyro_time, to_stamp_time
from estimators.linalg import healthy
from estimators.models.base import HANDLE, Handle, build, constrain, load, measure, report
from estimators.native import CAPACITY, Address, Integer, Kernel, Number, Record, adapts, entry, flags, record
from estimators.records import ESTIMATE, PLACE, SAMPLE, SHEET, Estimate, Sample, Sheet, settings_type
from estimators.types import MEASUREMENTS, Status

MAX_STEP = 0.5  # s, longest step of one prediction
MAX_STEPS = 120  # a longer gap than a minute is bridged with longer steps
BACKWARDS = 1.0  # s: a stamp that goes further back is another recording, not jitter


class Instance(Record):
    """An estimator to the loop: addresses of its parts, and where it is."""

    method: Address
    policy: Address
    model: Address
    carry: Address
    work: Address
    stretch: Address
    alignment: Address
    settings: Address  # of the model
    rules: Address  # settings of the policies
    site: Address
    sensors: Address
    align_s: Number  # s
    wait_s: Number  # s
    from_paper: Integer  # 1: no alignment
    begun: Integer  # 0: aligning
    begin: Address


INSTANCE = Instance.dtype
RULES = settings_type(adaptation.settings())

_RUNNING, _COASTING, _DIVERGED = int(Status.RUNNING), int(Status.COASTING), int(Status.DIVERGED)


@inner
def _blank_zero(v: np.ndarray) -> None:
    if v[0] == 0.0 and v[1] == 0.0 and v[2] == 0.0:
        v[0] = v[1] = v[2] = math.nan


@inner
def screen(rows: np.ndarray, count: int, last: float, sensors: Sheet, late: bool) -> int:
    """Find the first row whose stamp is not finite or jumps back more than `BACKWARDS`; -1 when there is none.

    Rows become what the loop takes: zero on all axes of accelerometer or magnetometer is a dead sensor, not a
    measurement, and becomes NaN; sensors that are late are brought to the gyro's time.
    """
    latest = last
    for k in range(count):
        row = record(rows, SAMPLE, k)
        if late:
            to_gyro_time(row, sensors)
        _blank_zero(row.accel_b)
        _blank_zero(row.mag_b)
        t = row.t
        if not math.isfinite(t) or t < latest - BACKWARDS:
            return k
        if not latest >= t:
            latest = t
    return -1


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
        steps = min(MAX_STEPS, ceil(dt / MAX_STEP))
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


@entry("p")
def begin(own: Instance) -> None:
    """Begin to estimate with what the alignment says."""


@adapts(begin)
def _adapt_begin(owner: None, kernel: Kernel) -> Kernel:
    def body(pointer):  # type: ignore[no-untyped-def]
        own = record(pointer, INSTANCE)
        stretch, site, sensors = record(own.stretch, STRETCH), record(own.site, PLACE), record(own.sensors, SHEET)
        method, policy, model = record(own.method, METHOD), record(own.policy, POLICY), record(own.model, HANDLE)
        carry, alignment = record(own.carry, CARRY), record(own.alignment, ALIGNMENT)
        conclude(stretch, stretch.phase == STILL, site, sensors, alignment)
        for i in range(CAPACITY):
            carry.x[i] = carry.u[i] = carry.z[i] = 0.0
            carry.used[i] = 0
            for j in range(CAPACITY):
                carry.P[i, j] = carry.P_restart[i, j] = 0.0
        carry.clock = math.nan
        begin_trust(carry.trust)
        configure(policy, record(own.rules, RULES), site)
        build(model, flags(own.settings), site, sensors, alignment, carry.x, carry.P, carry.P_restart)
        if method.plain == 0:
            store(method, model, carry.P)
            store(method, model, carry.P_restart)
        own.begun = 1

    return body


@inner
def _forget(own: Instance) -> None:
    begin_stretch(record(own.stretch, STRETCH))
    own.begun = 0
    if own.from_paper != 0:
        begin(own)  # nothing to learn from the ground


@inner
def _estimate(own: Instance, row: Sample, answer: Estimate) -> None:
    """Estimate a row, or align with it."""
    stretch, carry = record(own.stretch, STRETCH), record(own.carry, CARRY)
    if row.t - (carry.clock if own.begun != 0 else stretch.last_t) > LONGEST_GAP:
        _forget(own)
    site, sensors = record(own.site, PLACE), record(own.sensors, SHEET)
    if own.begun == 0:
        gyro, accel = still_limits(sensors)
        if not take(stretch, row, own.align_s, own.wait_s, gyro, accel, site.gravity):
            answer.t = row.t
            return
        begin(own)
    method, policy, model = record(own.method, METHOD), record(own.policy, POLICY), record(own.model, HANDLE)
    _step(method, policy, model, carry, record(own.work, WORK), row, answer)
    if is_late(sensors):
        to_stamp_time(row, answer, sensors, site.gravity)


@entry("p")
def forget(own: Instance) -> None:
    """Forget everything seen: align anew."""


@adapts(forget)
def _adapt_forget(owner: None, kernel: Kernel) -> Kernel:
    def body(own):  # type: ignore[no-untyped-def]
        _forget(record(own, INSTANCE))

    return body


@entry("ppip", int)
def process(own: Instance, rows: np.ndarray, count: int, out: np.ndarray) -> int:  # type: ignore[empty-body]
    """Estimate `count` samples (records) into estimates (records), blank before.

    Returns -1, or the first row whose time stamp is impossible: nothing of the block has been used then.
    """


@adapts(process)
def _process(owner: None, kernel: Kernel) -> Kernel:
    def body(own, rows, count, out):  # type: ignore[no-untyped-def]
        a = record(own, INSTANCE)
        last = record(a.carry, CARRY).clock if a.begun != 0 else record(a.stretch, STRETCH).last_t
        sensors = record(a.sensors, SHEET)
        bad = screen(rows, count, last, sensors, is_late(sensors))
        if bad < 0:
            for k in range(count):
                _estimate(a, record(rows, SAMPLE, k), record(out, ESTIMATE, k))
        return bad

    return body
