"""What a filter supplies: how a mean and a covariance go through a nonlinear function.

A filter is a module with a record `Parameters` and kernels, see `Filter`; `USES` names the entries of a model that it
calls beside those of the loop. Measurement noise, adaptation and recovery are the same for every filter (here and in
`estimators.run`). What a filter keeps of its covariance is its own business: P itself unless it has `store`,
`reported` and `correct` of its own (`square_root`); how a group changes x and P as well: once, unless it has `update`
(`iekf`, which looks again).
"""

from types import ModuleType
from typing import Any, Protocol

import numpy as np

from estimators.adaptation.base import POLICY, PolicyHandle, weigh
from estimators.filters import moments
from estimators.filters.work import WORK, Work
from estimators.jit import JIT
from estimators.models.base import (
    ALWAYS,
    HANDLE,
    Handle,
    observe,
    report,
    residual,
    retract,
    slope,
)
from estimators.native import (
    Address,
    Integer,
    Kernel,
    Plain,
    Record,
    adapts,
    entry,
    matrix,
    pointer,
    record,
    source_key,
    supplied,
    vector,
)
from estimators.records import ESTIMATE, Estimate


class Filter(Protocol):
    """The kernels of a filter.

    `method` is its record `Parameters`, `model` a handle (`models.base`), x a state, P what the filter keeps of its
    covariance, u the inputs, `work` memory whose contents last for a row.
    """

    Parameters: type[Record]
    USES: tuple[Any, ...]

    def predict(
        self, method: Record, model: Handle, x: np.ndarray, P: np.ndarray, u: np.ndarray, dt: float, work: Work
    ) -> bool:
        """Move x and P by dt seconds (s), process noise included; False when P is not positive."""

    def project(
        self, method: Record, model: Handle, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work
    ) -> bool:
        """Joint moments of a measurement group and the state, without measurement noise.

        `work.y[:rows]` mean, `work.S[:rows, :rows]` covariance (lower half), `work.C[:rows]` covariance with the state
        (of that only what the filter's own `correct` reads).
        """

    def correct(self, method: Record, model: Handle, group: int, P: np.ndarray, work: Work) -> bool:
        """Condition P on the measurements of a group that count, after `project`; False when that is impossible.

        Takes `work.noise`, `work.residual` and `work.used`; leaves the correction in `work.dx`, independent innovations
        in `work.residual` and their variances in `work.variance`.
        """

    def update(
        self, own: "FilterHandle", policy: PolicyHandle, model: Handle, group: int, x: np.ndarray, P: np.ndarray,
        u: np.ndarray, trust: np.ndarray, work: Work,
    ) -> bool:  # fmt: skip
        """Correct x and P by a measurement group, z in `work.measured`, where `work.used`; R by `weigh`.

        `own` is the filter as entries know it. Leaves independent innovations in `work.residual`, their variances in
        `work.variance`.
        """

    def reported(
        self, method: Record, model: Handle, x: np.ndarray, P: np.ndarray, work: Work, answer: Estimate
    ) -> None:
        """Call the model's `report` with the covariance of x."""

    def store(self, method: Record, model: Handle, P: np.ndarray) -> None:
        """Make of a covariance P what the filter keeps of it, in its place."""


class FilterHandle(Record):
    """A filter to the loop: addresses of its parameters and functions."""

    parameters: Address
    plain: Integer  # 1: it keeps P itself, and has neither `correct` nor `reported`
    predict: Address
    project: Address
    correct: Address
    update: Address
    reported: Address
    store: Address


METHOD = FilterHandle.dtype


@entry("pppppfp", bool)
def predict(  # type: ignore[empty-body]
    method: FilterHandle, model: Handle, x: np.ndarray, P: np.ndarray, u: np.ndarray, dt: float, work: Work
) -> bool:
    """See `Filter.predict`."""


@entry("ppipppp", bool)
def project(  # type: ignore[empty-body]
    method: FilterHandle, model: Handle, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work
) -> bool:
    """See `Filter.project`."""


@entry("ppipp", bool)
def correct(method: FilterHandle, model: Handle, group: int, P: np.ndarray, work: Work) -> bool:  # type: ignore[empty-body]
    """See `Filter.correct`."""


@entry("pppippppp", bool)
def update(  # type: ignore[empty-body]
    method: FilterHandle, policy: PolicyHandle, model: Handle, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray,
    trust: np.ndarray, work: Work,
) -> bool:  # fmt: skip
    """See `Filter.update`."""


@entry("pppppp")
def reported(method: FilterHandle, model: Handle, x: np.ndarray, P: np.ndarray, work: Work, answer: Estimate) -> None:
    """See `Filter.reported`."""


@entry("ppp")
def store(method: FilterHandle, model: Handle, P: np.ndarray) -> None:
    """See `Filter.store`."""


@adapts(predict)
def _predict(m: ModuleType, kernel: Kernel) -> Kernel:
    M = m.Parameters.dtype

    def body(method, model, x, P, u, dt, work):  # type: ignore[no-untyped-def]
        p = record(record(method, METHOD).parameters, M)
        ok = kernel(p, record(model, HANDLE), vector(x), matrix(P), vector(u), dt, record(work, WORK))
        return 1 if ok else 0

    return body


@adapts(project)
def _project(m: ModuleType, kernel: Kernel) -> Kernel:
    M = m.Parameters.dtype

    def body(method, model, group, x, P, u, work):  # type: ignore[no-untyped-def]
        p = record(record(method, METHOD).parameters, M)
        ok = kernel(p, record(model, HANDLE), group, vector(x), matrix(P), vector(u), record(work, WORK))
        return 1 if ok else 0

    return body


@adapts(correct)
def _correct(m: ModuleType, kernel: Kernel) -> Kernel:
    M = m.Parameters.dtype

    def body(method, model, group, P, work):  # type: ignore[no-untyped-def]
        p = record(record(method, METHOD).parameters, M)
        return 1 if kernel(p, record(model, HANDLE), group, matrix(P), record(work, WORK)) else 0

    def plain(method, model, group, P, work):  # type: ignore[no-untyped-def]
        return 1 if moments.condition(record(model, HANDLE), group, matrix(P), record(work, WORK)) else 0

    return plain if kernel is None else body


@adapts(update)
def _update(m: ModuleType, kernel: Kernel) -> Kernel:
    def body(method, policy, model, group, x, P, u, trust, work):  # type: ignore[no-untyped-def]
        ok = kernel(
            record(method, METHOD), record(policy, POLICY), record(model, HANDLE), group, vector(x), matrix(P),
            vector(u), vector(trust), record(work, WORK),
        )  # fmt: skip
        return 1 if ok else 0

    return body


def _once(
    own: FilterHandle, policy: PolicyHandle, model: Handle, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray,
    trust: np.ndarray, work: Work,
) -> bool:  # fmt: skip
    """Update by a measurement group as any Kalman filter does, whatever the moments come from."""
    ok = project(own, model, group, x, P, u, work)
    if model.subtracts != 0:  # a call costs as much as so short a loop
        for i in range(model.rows[group]):
            work.residual[i] = work.measured[i] - work.y[i]
    else:
        residual(model, group, 1, work.measured, work.y, work.residual)
    weigh(policy, model, group, x, u, trust, work)
    if own.plain != 0:
        ok &= moments.condition(model, group, P, work)
    else:
        ok &= correct(own, model, group, P, work)
    if model.adds != 0:
        for i in range(model.size):
            x[i] += work.dx[i]
    else:
        retract(model, 1, x, work.dx, work.x)
        for i in range(model.raw):
            x[i] = work.x[i]
    return ok


@adapts(reported)
def _reported(m: ModuleType, kernel: Kernel) -> Kernel:
    M = m.Parameters.dtype

    def body(method, model, x, P, work, answer):  # type: ignore[no-untyped-def]
        p = record(record(method, METHOD).parameters, M)
        kernel(p, record(model, HANDLE), vector(x), matrix(P), record(work, WORK), record(answer, ESTIMATE))

    def plain(method, model, x, P, work, answer):  # type: ignore[no-untyped-def]
        report(record(model, HANDLE), vector(x), matrix(P), record(answer, ESTIMATE))

    return plain if kernel is None else body


@adapts(store)
def _store(m: ModuleType, kernel: Kernel) -> Kernel:
    M = m.Parameters.dtype

    def body(method, model, P):  # type: ignore[no-untyped-def]
        kernel(record(record(method, METHOD).parameters, M), record(model, HANDLE), matrix(P))

    def nothing(method, model, P):  # type: ignore[no-untyped-def]
        pass

    return nothing if kernel is None else body


def project_linear(
    method: Record, model: Handle, group: int, x: np.ndarray, P: np.ndarray, u: np.ndarray, work: Work
) -> bool:
    """`y = h(x)`, `C = H P`, `S = H P H^T`: exact for a linear group, so every filter uses it there."""
    observe(model, group, 1, x, u, work.y)
    slope(model, group, x, u, work.J)
    moments.project_slope(model, group, P, work)
    return True


_DEFAULT: dict[Any, Any] = {update: _once}
_ENTRIES = (predict, project, correct, update, reported, store)


class Method:
    """A filter with its parameters: the handle by which the loop knows it."""

    def __init__(self, module: ModuleType, parameters: Any) -> None:
        """Bind the kernels of a filter, compiled or loaded."""
        self.module, self.parameters = module, parameters
        fields: dict[str, Any] = {"plain": int(not (hasattr(module, "correct") or hasattr(module, "reported")))}
        for called in _ENTRIES:
            kernel = getattr(module, called.__name__, None)
            key = source_key(kernel, "filters.plain")
            fields[called.__name__] = supplied(called, module, kernel or _DEFAULT.get(called), key)
        if not JIT:
            self.handle: Any = Plain(parameters=parameters, **fields)
        else:
            self.handle = FilterHandle.of(parameters=pointer(parameters), **fields)

    @property
    def entries(self) -> tuple[Any, ...]:
        """The entries of a model that it needs."""
        return tuple(dict.fromkeys((*ALWAYS, *self.module.USES)))
