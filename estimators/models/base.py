"""What a model supplies to the filters.

A model is a `NamedTuple` of parameters (every field an array or a float, and `groups`) with the functions below
registered for its type. Its state `x` (raw) may be a manifold, such as a quaternion with other states: the filter then
works on an error of `size` components that `retract` adds to x and `difference` finds between two states. For a plain
vector both are the defaults, addition and subtraction, and `len(x) == size`.

States are ordered so that what the nonlinear functions change and read comes first: `propagate` changes the first
`changed` error components and reads the first `read`; the rest stay as they are. Filters use this, exactly. The three
sizes are constants in compiled code, so loops over them are unrolled.

Measurements come in groups, processed one after the other. Row g of `groups` (int64) says of group g: `START` (its
first row in z), `ROWS`, `FROM` and `READ` (it depends on the error components FROM to READ - 1), `LINEAR` (1 when the
prediction is linear in them: no filter approximates it then).
"""

import math
from typing import Any

import numpy as np

from estimators.generic import default, generic
from estimators.jit import njit
from estimators.rows import E_DOWN, E_Q

START, ROWS, FROM, READ, LINEAR = range(5)


@generic
def size(model: Any) -> int:  # type: ignore[empty-body]
    """Components of the error, a constant."""


@generic
def changed(model: Any) -> int:  # type: ignore[empty-body]
    """How many of the first of them `propagate` changes, a constant."""


@generic
def read(model: Any) -> int:  # type: ignore[empty-body]
    """How many of the first of them it reads, a constant."""


@generic
def load(model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray) -> None:
    """Inputs u of the step that ends with a row of samples (see `estimators.rows`), from the state x before it.

    What must be kept from row to row lives in `memory`.
    """


@generic
def measure(  # type: ignore[empty-body]
    model: Any, row: np.ndarray, x: np.ndarray, memory: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray
) -> int:
    """Measurements z of a row and which are used, with the predicted state x at hand; returns a `Status`."""


@generic
def propagate(model: Any, x: np.ndarray, u: np.ndarray, dt: float, out: np.ndarray) -> None:
    """`out` = the whole state after dt seconds without noise."""


@generic
def transition(model: Any, x: np.ndarray, u: np.ndarray, dt: float, F: np.ndarray) -> None:
    """`F[:changed, :read]` = derivative of `propagate`'s error with respect to the error in x."""


@generic
def process_noise(model: Any, x: np.ndarray, u: np.ndarray, dt: float, P: np.ndarray) -> None:
    """Add the noise of dt seconds to P, both halves."""


@generic
def observe(model: Any, group: int, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> None:
    """`y[:rows]` = predicted measurements of the group."""


@generic
def slope(model: Any, group: int, x: np.ndarray, u: np.ndarray, H: np.ndarray) -> None:
    """`H[:rows, from:read]` = derivative of `observe` with respect to the error in x."""


@generic
def measurement_noise(model: Any, group: int, x: np.ndarray, u: np.ndarray, S: np.ndarray) -> None:
    """Add the noise covariance of the group to the lower half of `S[:rows, :rows]`."""


@generic
def residual(model: Any, group: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """`out[:rows]` = z - y, both of this group; an angle must be wrapped. `out` may be z."""


@generic
def retract(model: Any, x: np.ndarray, dx: np.ndarray, out: np.ndarray) -> None:
    """`out` = x moved by the error dx (n,)."""


@generic
def difference(model: Any, x: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
    """`out[:changed]` = the error that moves `origin` to x, for the components that `propagate` changes."""


@generic
def constrain(model: Any, x: np.ndarray) -> None:
    """Put x back on its manifold after rounding or an additive correction (normalise a quaternion)."""


@generic
def report(model: Any, x: np.ndarray, P: np.ndarray, memory: np.ndarray, row: np.ndarray) -> None:
    """A row of estimates (offsets: `estimators.rows`) from the state."""


@default
def _residual(model: Any, group: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    for i in range(model.groups[group, ROWS]):
        out[i] = z[i] - y[i]


@default
def _retract(model: Any, x: np.ndarray, dx: np.ndarray, out: np.ndarray) -> None:
    for i in range(size(model)):
        out[i] = x[i] + dx[i]


@default
def _difference(model: Any, x: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
    for i in range(changed(model)):
        out[i] = x[i] - origin[i]


@default
def _constrain(model: Any, x: np.ndarray) -> None:
    pass


MAX_RATE, MAX_FORCE, MAX_FIELD, MAX_SPEED = 100.0, 2000.0, 0.01, 2000.0  # rad/s, m/s2, T, m/s: beyond is no measurement


@njit(forceinline=True)
def plausible(value: float, limit: float) -> bool:
    """Whether it is a number within the limit."""
    return abs(value) < limit  # False for NaN


@njit(forceinline=True)
def on_earth(latitude: float, longitude: float, height: float) -> bool:
    """Whether it is a place near the Earth (rad, rad, m): an angle of any size would be one after wrapping."""
    return abs(latitude) < 1.58 and abs(longitude) < 6.3 and abs(height) < 1e6  # False for NaN


@njit(forceinline=True)
def report_attitude(q: np.ndarray, row: np.ndarray) -> None:
    """Quaternion and down vector of a row of estimates from q_nb (first four elements), of any length."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    scale = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    a, b, c, d = a * scale, b * scale, c * scale, d * scale
    row[E_Q], row[E_Q + 1], row[E_Q + 2], row[E_Q + 3] = a, b, c, d
    row[E_DOWN], row[E_DOWN + 1] = 2.0 * (b * d - a * c), 2.0 * (c * d + a * b)
    row[E_DOWN + 2] = a * a - b * b - c * c + d * d
