"""What a model supplies to the filters, and how a filter calls it.

A model is a module with

    Parameters, State, Inputs, Memory, Readings   records: what the kernels read and keep, by name
    load, measure, propagate, ...                 its kernels, see `Model`
    SETTINGS                                      what a user can choose
    layout(settings)                              its `Layout`

A filter sees none of these names. To it the state x, the inputs u and the measurements z are vectors, and the model is
a *handle*: the sizes below, and the functions of this module, which call the model's kernels on records that lie over
the same memory. Where a filter has many states at a time (sigma points), one call takes all of them.

The state (`raw` numbers) may lie on a manifold, such as a quaternion with other states: the filter then works on an
error of `size` components that `retract` adds to x and `difference` finds between two states. For a plain vector both
are the defaults, addition and subtraction, and `raw == size`. States are ordered so that what the nonlinear functions
change and read comes first: `propagate` changes the first `changed` error components and reads the first `read`; the
rest stay as they are. Filters use this, exactly. `size`, `changed` and `read` are constants in the compiled linear
algebra.

Measurements come in groups (`Group`), processed one after the other.
"""

import math
from types import ModuleType
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np

from estimators.alignment import ALIGNMENT, Alignment
from estimators.jit import JIT, njit
from estimators.native import (
    CAPACITY,
    Address,
    Integer,
    Kernel,
    Plain,
    Record,
    adapts,
    entry,
    flags,
    matrix,
    pointer,
    record,
    shaped,
    source_key,
    supplied,
    vector,
)
from estimators.records import ESTIMATE, PLACE, SAMPLE, SHEET, Estimate, Place, Sample, Sheet, settings_type

STATE = 8 * CAPACITY
"""Bytes of a state, of inputs and of measurements: `class State(Record, size=STATE)`."""
FLAGS = CAPACITY
"""Bytes of the flags of measurements."""
GROUPS = 12
"""Most measurement groups of a model."""

_Groups = Annotated[np.ndarray, shaped(GROUPS, dtype=np.int64)]
_Rows = Annotated[np.ndarray, shaped(3, dtype=np.int64)]


class Group(NamedTuple):
    """Measurements that are processed together."""

    start: int  # its first row in z
    rows: int
    first: int  # it depends on the error components from `first`
    end: int  # to `end` - 1
    linear: bool  # the prediction is linear in them: no filter approximates it then


class Layout(NamedTuple):
    """Holds the sizes of a model, as its `layout` returns them."""

    raw: int  # numbers of the state
    size: int  # components of the error
    changed: int  # see above
    read: int
    groups: tuple[Group, ...]
    magnetic: tuple[int, int, int] = (0, 0, 0)  # rows of z (from, end) from the magnetometer, and their sensor
    disturbed: tuple[int, int, int] = (0, 3, 0)  # those that the vehicle's own acceleration or turning falsifies


class Model(Protocol):
    """The kernels of a model: plain functions that Numba compiles (no allocation, no Python objects).

    `model` is its record `Parameters`, x its `State`, u its `Inputs`, `memory` its `Memory`, z and used its `Readings`
    and `Used` (the same fields, of numbers and of booleans). Matrices have rows of `CAPACITY`; what is not named is not
    to be touched. SI and radians. `residual`, `retract`, `difference` and `constrain` may be missing: plain vectors.
    """

    Parameters: type[Record]
    State: type[Record]
    Inputs: type[Record]
    Memory: type[Record]
    Readings: type[Record]
    Used: type[Record]

    def build(
        self, settings: Record, site: Place, sensors: Sheet, alignment: Alignment, model: Record, memory: Record,
        x: Record, P: np.ndarray, P_restart: np.ndarray,
    ) -> None:  # fmt: skip
        """Set the parameters `model`, all of them, and the first state x with its covariance.

        `memory` is NaN, everything else zero before; `settings` are a record of SETTINGS (`pack_settings`); `P_restart`
        is for a filter that was numerically lost.
        """

    def load(self, model: Record, row: Sample, x: Record, memory: Record, u: Record) -> None:
        """Set the inputs u of the step that ends with a row, x before it; keep what the next row needs."""

    def measure(self, model: Record, row: Sample, x: Record, memory: Record, u: Record, z: Record, used: Record) -> int:
        """Set measurements z of a row and which are `used` (all of them), x predicted to it; return a `Status`."""

    def propagate(self, model: Record, x: Record, u: Record, dt: float, out: Record) -> None:
        """Set `out` to the whole state after dt seconds (s) without noise."""

    def transition(self, model: Record, x: Record, u: Record, dt: float, F: np.ndarray) -> None:
        """Set `F[:changed, :read]` to the derivative of `propagate`'s error by the error in x."""

    def process_noise(self, model: Record, x: Record, u: Record, dt: float, P: np.ndarray) -> None:
        """Add the noise of dt seconds to `P[:size, :size]`, both halves."""

    def observe(self, model: Record, group: int, x: Record, u: Record, y: np.ndarray) -> None:
        """Set `y[:rows]` to the predicted measurements of a group."""

    def slope(self, model: Record, group: int, x: Record, u: Record, H: np.ndarray) -> None:
        """Set `H[:rows, first:end]` to the derivative of `observe` by the error in x."""

    def measurement_noise(self, model: Record, group: int, x: Record, u: Record, S: np.ndarray) -> None:
        """Add the noise covariance of a group to the lower half of `S[:rows, :rows]`."""

    def residual(self, model: Record, group: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
        """Set `out[:rows]` to z - y, both of this group, angles wrapped; `out` may be z."""

    def retract(self, model: Record, x: Record, dx: np.ndarray, out: Record) -> None:
        """Set `out` to x moved by the error dx (size,)."""

    def difference(self, model: Record, x: Record, origin: Record, out: np.ndarray) -> None:
        """Set `out[:changed]` to the error that moves `origin` to x, of the components that `propagate` changes."""

    def constrain(self, model: Record, x: Record) -> None:
        """Put x back on its manifold after rounding or an additive correction (normalise a quaternion)."""

    def report(self, model: Record, x: Record, P: np.ndarray, memory: Record, answer: Estimate) -> None:
        """Write a row of estimates from the state and its covariance `P[:size, :size]`."""


class Handle(Record):
    """A model to a filter: sizes, groups, and addresses of memory and functions."""

    parameters: Address
    memory: Address
    raw: Integer
    size: Integer
    changed: Integer
    read: Integer
    groups: Integer  # how many
    start: _Groups
    rows: _Groups
    first: _Groups
    end: _Groups
    linear: _Groups
    magnetic: _Rows
    disturbed: _Rows
    subtracts: Integer  # 1: it has no `residual`
    adds: Integer  # 1: it has no `retract`
    blank: Address  # what `memory` is at first
    memory_size: Integer  # bytes
    build: Address
    load: Address
    measure: Address
    propagate: Address
    transition: Address
    process_noise: Address
    observe: Address
    slope: Address
    measurement_noise: Address
    residual: Address
    retract: Address
    difference: Address
    constrain: Address
    report: Address
    factorise: Address
    transform: Address
    project_slope: Address
    predicted: Address
    measured: Address
    condition: Address


HANDLE = Handle.dtype


# The same kernels as a filter calls them. `model` is a handle, vectors have CAPACITY elements.


@entry("pppppppp")
def build(
    model: Handle, settings: np.ndarray, site: Place, sensors: Sheet, alignment: Alignment, x: np.ndarray,
    P: np.ndarray, P_restart: np.ndarray,
) -> None:  # fmt: skip
    """See `Model.build`."""


@entry("pppp")
def load(model: Handle, row: Sample, x: np.ndarray, u: np.ndarray) -> None:
    """See `Model.load`."""


@entry("pppppp", int)
def measure(model: Handle, row: Sample, x: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray) -> int:  # type: ignore[empty-body]
    """See `Model.measure`."""


@entry("pippfp")
def propagate(model: Handle, count: int, x: np.ndarray, u: np.ndarray, dt: float, out: np.ndarray) -> None:
    """See `Model.propagate`; x and `out` are `count` states, a row each."""


@entry("pppfp")
def transition(model: Handle, x: np.ndarray, u: np.ndarray, dt: float, F: np.ndarray) -> None:
    """See `Model.transition`."""


@entry("pppfp")
def process_noise(model: Handle, x: np.ndarray, u: np.ndarray, dt: float, P: np.ndarray) -> None:
    """See `Model.process_noise`."""


@entry("piippp")
def observe(model: Handle, group: int, count: int, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> None:
    """See `Model.observe`; x and y are `count` states and predictions, a row each."""


@entry("pippp")
def slope(model: Handle, group: int, x: np.ndarray, u: np.ndarray, H: np.ndarray) -> None:
    """See `Model.slope`."""


@entry("pippp")
def measurement_noise(model: Handle, group: int, x: np.ndarray, u: np.ndarray, S: np.ndarray) -> None:
    """See `Model.measurement_noise`."""


@entry("piippp")
def residual(model: Handle, group: int, count: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """See `Model.residual`; z and `out` are `count` rows, y is one."""


@entry("pippp")
def retract(model: Handle, count: int, x: np.ndarray, dx: np.ndarray, out: np.ndarray) -> None:
    """See `Model.retract`; one state x, `count` errors and results, a row each."""


@entry("pippp")
def difference(model: Handle, count: int, x: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
    """See `Model.difference`; `count` states x and results, a row each, one origin."""


@entry("pp")
def constrain(model: Handle, x: np.ndarray) -> None:
    """See `Model.constrain`."""


@entry("pppp")
def report(model: Handle, x: np.ndarray, P: np.ndarray, answer: Estimate) -> None:
    """See `Model.report`."""


# How a kernel becomes the C function that these calls go to: pointers in, records out.


@adapts(build)
def _build(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X, M, S = m.Parameters.dtype, m.State.dtype, m.Memory.dtype, settings_type(m.SETTINGS)

    def body(model, settings, site, sensors, alignment, x, P_, P_restart):  # type: ignore[no-untyped-def]
        h = record(model, HANDLE)
        memory, blank = flags(h.memory), flags(h.blank)
        for i in range(h.memory_size):
            memory[i] = blank[i]
        kernel(
            record(settings, S), record(site, PLACE), record(sensors, SHEET), record(alignment, ALIGNMENT),
            record(h.parameters, P), record(h.memory, M), record(x, X), matrix(P_), matrix(P_restart),
        )  # fmt: skip

    return body


@adapts(load)
def _load(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X, M, U = m.Parameters.dtype, m.State.dtype, m.Memory.dtype, m.Inputs.dtype

    def body(model, row, x, u):  # type: ignore[no-untyped-def]
        h = record(model, HANDLE)
        kernel(record(h.parameters, P), record(row, SAMPLE), record(x, X), record(h.memory, M), record(u, U))

    return body


@adapts(measure)
def _measure(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X, M, U = m.Parameters.dtype, m.State.dtype, m.Memory.dtype, m.Inputs.dtype
    Z, D = m.Readings.dtype, m.Used.dtype

    def body(model, row, x, u, z, used):  # type: ignore[no-untyped-def]
        h = record(model, HANDLE)
        p, memory = record(h.parameters, P), record(h.memory, M)
        return kernel(p, record(row, SAMPLE), record(x, X), memory, record(u, U), record(z, Z), record(used, D))

    return body


@adapts(propagate)
def _propagate(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X, U = m.Parameters.dtype, m.State.dtype, m.Inputs.dtype

    def body(model, count, x, u, dt, out):  # type: ignore[no-untyped-def]
        p, inputs = record(record(model, HANDLE).parameters, P), record(u, U)
        for k in range(count):
            kernel(p, record(x, X, k), inputs, dt, record(out, X, k))

    return body


@adapts(transition)
@adapts(process_noise)
def _with_step(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X, U = m.Parameters.dtype, m.State.dtype, m.Inputs.dtype

    def body(model, x, u, dt, out):  # type: ignore[no-untyped-def]
        kernel(record(record(model, HANDLE).parameters, P), record(x, X), record(u, U), dt, matrix(out))

    return body


@adapts(observe)
def _observe(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X, U = m.Parameters.dtype, m.State.dtype, m.Inputs.dtype

    def body(model, group, count, x, u, y):  # type: ignore[no-untyped-def]
        p, inputs = record(record(model, HANDLE).parameters, P), record(u, U)
        for k in range(count):
            kernel(p, group, record(x, X, k), inputs, vector(y, k))

    return body


@adapts(slope)
@adapts(measurement_noise)
def _of_group(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X, U = m.Parameters.dtype, m.State.dtype, m.Inputs.dtype

    def body(model, group, x, u, out):  # type: ignore[no-untyped-def]
        kernel(record(record(model, HANDLE).parameters, P), group, record(x, X), record(u, U), matrix(out))

    return body


@adapts(residual)
def _residual(m: ModuleType, kernel: Kernel) -> Kernel:
    P = m.Parameters.dtype

    def body(model, group, count, z, y, out):  # type: ignore[no-untyped-def]
        p = record(record(model, HANDLE).parameters, P)
        for k in range(count):
            kernel(p, group, vector(z, k), vector(y), vector(out, k))

    def subtract(model, group, count, z, y, out):  # type: ignore[no-untyped-def]
        rows = record(model, HANDLE).rows[group]
        for k in range(count):
            a, b, c = vector(z, k), vector(y), vector(out, k)
            for i in range(rows):
                c[i] = a[i] - b[i]

    return subtract if kernel is None else body


@adapts(retract)
def _retract(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X = m.Parameters.dtype, m.State.dtype

    def body(model, count, x, dx, out):  # type: ignore[no-untyped-def]
        p, from_ = record(record(model, HANDLE).parameters, P), record(x, X)
        for k in range(count):
            kernel(p, from_, vector(dx, k), record(out, X, k))

    def add(model, count, x, dx, out):  # type: ignore[no-untyped-def]
        n = record(model, HANDLE).size
        for k in range(count):
            a, b, c = vector(x), vector(dx, k), vector(out, k)
            for i in range(n):
                c[i] = a[i] + b[i]

    return add if kernel is None else body


@adapts(difference)
def _difference(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X = m.Parameters.dtype, m.State.dtype

    def body(model, count, x, origin, out):  # type: ignore[no-untyped-def]
        p, from_ = record(record(model, HANDLE).parameters, P), record(origin, X)
        for k in range(count):
            kernel(p, record(x, X, k), from_, vector(out, k))

    def subtract(model, count, x, origin, out):  # type: ignore[no-untyped-def]
        changed = record(model, HANDLE).changed
        for k in range(count):
            a, b, c = vector(x, k), vector(origin), vector(out, k)
            for i in range(changed):
                c[i] = a[i] - b[i]

    return subtract if kernel is None else body


@adapts(constrain)
def _constrain(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X = m.Parameters.dtype, m.State.dtype

    def body(model, x):  # type: ignore[no-untyped-def]
        kernel(record(record(model, HANDLE).parameters, P), record(x, X))

    def nothing(model, x):  # type: ignore[no-untyped-def]
        pass

    return nothing if kernel is None else body


@adapts(report)
def _report(m: ModuleType, kernel: Kernel) -> Kernel:
    P, X, M = m.Parameters.dtype, m.State.dtype, m.Memory.dtype

    def body(model, x, P_, answer):  # type: ignore[no-untyped-def]
        h = record(model, HANDLE)
        kernel(record(h.parameters, P), record(x, X), matrix(P_), record(h.memory, M), record(answer, ESTIMATE))

    return body


ALWAYS = (build, load, measure, measurement_noise, process_noise, residual, retract, constrain, report)
"""What the loop calls for any filter."""
BANK = (measurement_noise, process_noise, residual, retract, constrain)
"""What a bank of filters calls."""
_DEFAULT = (residual, retract, difference, constrain)


class Bound:
    """A model with its memory, and the handle by which filters know it."""

    def __init__(
        self, model: Any, layout: Layout, entries: tuple[Any, ...], parameters: Any = None, memory: Any = None
    ) -> None:  # fmt: skip
        """Bind the kernels of `entries`, compiled or loaded; parameters and memory are NaN before `build`."""
        from estimators.filters import moments

        self.parameters = model.Parameters.nans() if parameters is None else parameters
        self.memory, self.blank = (model.Memory.nans() if memory is None else memory for _ in range(2))
        self.size, self.raw = n, raw = layout.size, layout.raw
        if raw > CAPACITY:
            raise ValueError(f"{model.__name__}: {raw} numbers in a state, at most {CAPACITY}")
        fields: dict[str, Any] = {
            "raw": raw, "size": n, "changed": layout.changed, "read": layout.read, "groups": len(layout.groups),
            "magnetic": np.array(layout.magnetic), "disturbed": np.array(layout.disturbed),
            "memory_size": self.memory.data.nbytes,
            "subtracts": int(not hasattr(model, "residual")), "adds": int(not hasattr(model, "retract")),
        }  # fmt: skip
        for name in Group._fields:
            fields[name] = np.zeros(GROUPS, np.int64)
            fields[name][: len(layout.groups)] = [getattr(group, name) for group in layout.groups]
        sizes = moments.Sizes(n, layout.changed, layout.read)
        for called in entries:
            owner: Any = model
            kernel = getattr(model, called.__name__, None)
            key = source_key(kernel, "models.plain")
            if called in moments.ENTRIES:
                owner, key = sizes, f"moments-{n}-{layout.changed}-{layout.read}"
            elif kernel is None and called not in _DEFAULT:
                raise TypeError(f"{model.__name__} has no kernel '{called.__name__}'")
            fields[called.__name__] = supplied(called, owner, kernel, key)
        if not JIT:
            self.handle: Any = Plain(parameters=self.parameters, memory=self.memory, blank=self.blank, **fields)
        else:
            handle = Handle.zeros()
            for name, value in {
                **fields,
                "parameters": pointer(self.parameters),
                "memory": pointer(self.memory),
                "blank": pointer(self.blank),
            }.items():
                setattr(handle, name, value)
            self.handle = handle


@njit(forceinline=True)
def report_attitude(q: np.ndarray, answer: Estimate) -> None:
    """Quaternion and down vector of a row of estimates from q_nb (first four elements), of any length."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    scale = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    a, b, c, d = a * scale, b * scale, c * scale, d * scale
    answer.q_nb[0], answer.q_nb[1], answer.q_nb[2], answer.q_nb[3] = a, b, c, d
    answer.down_b[0], answer.down_b[1] = 2.0 * (b * d - a * c), 2.0 * (c * d + a * b)
    answer.down_b[2] = a * a - b * b - c * c + d * d
