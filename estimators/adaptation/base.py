"""What an adaptation policy supplies: how far a measurement is trusted, for any filter on any model.

A policy is a module with records `Parameters` and `Trust`, SETTINGS, and the kernels of `Policy`: `configure`, and one
or both of the others. It sees sensors, not physics: a sensor is three consecutive measurements of a group (or what is
left of it), sensors are counted through all groups.
"""

import math
from types import ModuleType
from typing import Annotated, Any, Protocol

import numpy as np

from estimators.filters.work import TRUST, WORK, Work
from estimators.jit import JIT, inner
from estimators.models.base import HANDLE, Handle, measurement_noise
from estimators.native import (
    Address,
    Integer,
    Kernel,
    Plain,
    Record,
    adapts,
    entry,
    flags,
    pointer,
    record,
    shaped,
    source_key,
    supplied,
    vector,
)
from estimators.records import PLACE, SAMPLE, Place, Sample, settings_type

SENSORS = 8
Sensors = Annotated[np.ndarray, shaped(SENSORS)]
KEPT = 8 * TRUST
"""Bytes of what a policy keeps: `class Trust(Record, size=KEPT)`."""


class Trust(Record, size=KEPT):
    """Holds what every policy keeps first: the last weight of each sensor.

    1 as far as the model says, 0.1 with ten times the variance, 0 not at all, NaN never seen. The first four go into
    the estimates (`adaptation`).
    """

    trusted: Sensors


class Policy(Protocol):
    """The kernels of a policy. `policy` is its record `Parameters`, `trust` its `Trust`. Both may be missing."""

    Parameters: type[Record]
    Trust: type[Record]

    def configure(self, settings: Record, site: Place, policy: Record) -> None:
        """Set the parameters `policy`, all of them, from the settings of all policies and the place."""

    def admit(self, policy: Record, model: Handle, row: Sample, x: np.ndarray, trust: Record, used: np.ndarray) -> bool:
        """Refuse measurements of a row before anything is corrected, by clearing `used`; true when one was (COASTING).

        `x` is the predicted state, whose first four elements are q_nb for every model that has a heading.
        """

    def factor(self, policy: Record, sensor: int, first: int, end: int, trust: Record, work: Work) -> float:
        """Return the factor on the noise of one sensor, rows `first` to `end` - 1 of its group; 0 refuses it.

        `work.S` predicted covariance of the group without noise, `work.noise` the model's noise (lower halves),
        `work.residual` measured minus predicted, `work.used` which are there; `work.scratch` is free.
        """


class PolicyHandle(Record):
    """A policy to the loop: addresses of its parameters and functions."""

    parameters: Address
    admits: Integer  # 0: it has no `admit`, and the loop need not call it
    weighs: Integer  # 0: no `factor`
    configure: Address
    admit: Address
    factor: Address


POLICY = PolicyHandle.dtype


@entry("ppp")
def configure(policy: PolicyHandle, settings: Record, site: Place) -> None:
    """See `Policy.configure`."""


@entry("pppppp", bool)
def admit(  # type: ignore[empty-body]
    policy: PolicyHandle, model: Handle, row: Sample, x: np.ndarray, trust: np.ndarray, used: np.ndarray
) -> bool:
    """See `Policy.admit`."""


@entry("piiipp", float)
def factor(policy: PolicyHandle, sensor: int, first: int, end: int, trust: np.ndarray, work: Work) -> float:  # type: ignore[empty-body]
    """See `Policy.factor`."""


@adapts(configure)
def _configure(m: ModuleType, kernel: Kernel) -> Kernel:
    from estimators import adaptation

    P, S = m.Parameters.dtype, settings_type(adaptation.settings())

    def body(policy, settings, site):  # type: ignore[no-untyped-def]
        kernel(record(settings, S), record(site, PLACE), record(record(policy, POLICY).parameters, P))

    return body


@adapts(admit)
def _admit(m: ModuleType, kernel: Kernel) -> Kernel:
    P, T = m.Parameters.dtype, m.Trust.dtype

    def body(policy, model, row, x, trust, used):  # type: ignore[no-untyped-def]
        p = record(record(policy, POLICY).parameters, P)
        refused = kernel(p, record(model, HANDLE), record(row, SAMPLE), vector(x), record(trust, T), flags(used))
        return 1 if refused else 0

    def nothing(policy, model, row, x, trust, used):  # type: ignore[no-untyped-def]
        return 0

    return nothing if kernel is None else body


@adapts(factor)
def _factor(m: ModuleType, kernel: Kernel) -> Kernel:
    P, T = m.Parameters.dtype, m.Trust.dtype

    def body(policy, sensor, first, end, trust, work):  # type: ignore[no-untyped-def]
        p = record(record(policy, POLICY).parameters, P)
        return kernel(p, sensor, first, end, record(trust, T), record(work, WORK))

    def one(policy, sensor, first, end, trust, work):  # type: ignore[no-untyped-def]
        return 1.0

    return one if kernel is None else body


@inner
def weigh(
    policy: PolicyHandle, model: Handle, group: int, x: np.ndarray, u: np.ndarray, trust: np.ndarray, work: Work
) -> None:
    """Set `work.noise` (lower half) to a group's noise, as much of it as the policy thinks right, sensor by sensor.

    Elements of `work.used` are cleared for a sensor that is refused.
    """
    rows, noise = model.rows[group], work.noise
    for i in range(rows):
        for j in range(i + 1):
            noise[i, j] = 0.0
    measurement_noise(model, group, x, u, noise)
    if policy.weighs == 0:
        return
    sensor = 0
    for g in range(group):
        sensor += (model.rows[g] + 2) // 3
    first = 0
    while first < rows:
        end = min(rows, first + 3)
        share = factor(policy, sensor, first, end, trust, work)
        for i in range(first, end):
            if share == 0.0:
                work.used[i] = False
            else:
                for j in range(first, i + 1):
                    noise[i, j] *= share
        first, sensor = end, sensor + 1


class BoundPolicy:
    """A policy with its parameters: the handle by which the loop knows it."""

    def __init__(self, module: Any) -> None:
        """Bind the kernels of a policy, compiled or loaded; its parameters are NaN before `configure`."""
        self.parameters = parameters = module.Parameters.nans()
        fields = {"admits": int(hasattr(module, "admit")), "weighs": int(hasattr(module, "factor"))}
        for called in (configure, admit, factor):
            kernel = getattr(module, called.__name__, None)
            fields[called.__name__] = supplied(called, module, kernel, source_key(kernel, "adaptation.plain"))
        if not JIT:
            self.handle: Any = Plain(parameters=parameters, **fields)
        else:
            self.handle = PolicyHandle.of(parameters=pointer(parameters), **fields)


@inner
def begin(trust: np.ndarray) -> None:
    """Set what a policy that has seen nothing keeps."""
    for i in range(TRUST):
        trust[i] = math.nan if i < SENSORS else 0.0
