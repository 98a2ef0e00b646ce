"""What a model supplies to the filters.

A model is a `NamedTuple` of parameters (every field an array or a float, and `layout`) with the functions below
registered for its type. Its state `x` (raw) may be a manifold, such as a quaternion with other states: the filter then works on
an error of `n` components that `retract` adds to x and `difference` finds between two states. For a plain vector both
are the defaults, addition and subtraction, and `len(x) == n`.

States are ordered so that the components which the nonlinear functions change and read come first: `propagate` changes the first
`layout.changed` error components and reads the first `layout.read`; the rest stay as they are. Filters use this, exactly.

Measurements come in groups, processed one after the other. Row g of `layout.groups` says of group g: `START` (its
first row in z), `ROWS`, `FROM` and `READ` (it depends on the error components FROM to READ - 1), `LINEAR` (1 when the prediction
is linear in them: no filter approximates it then).
"""

from typing import Any, NamedTuple

import numpy as np

from estimators.generic import default, generic

START, ROWS, FROM, READ, LINEAR = range(5)


class Layout(NamedTuple):
    """Sizes and structure of a model."""

    changed: int
    read: int
    groups: np.ndarray  # (groups, 5) int64


@generic
def load(model: Any, samples: Any, k: int, x: np.ndarray, memory: np.ndarray, u: np.ndarray, z: np.ndarray, used: np.ndarray) -> int:  # type: ignore[empty-body]  # fmt: skip
    """Row k of the samples into inputs u, measurements z and `used`; what must be kept lives in `memory`. A `Status`."""


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
def report(model: Any, x: np.ndarray, P: np.ndarray, memory: np.ndarray, out: Any, k: int) -> None:
    """Row k of the estimates (a tuple of the columns of `Estimates`) from the state."""


@default
def _residual(model: Any, group: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    for i in range(model.layout.groups[group, ROWS]):
        out[i] = z[i] - y[i]


@default
def _retract(model: Any, x: np.ndarray, dx: np.ndarray, out: np.ndarray) -> None:
    for i in range(dx.shape[0]):
        out[i] = x[i] + dx[i]


@default
def _difference(model: Any, x: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
    for i in range(model.layout.changed):
        out[i] = x[i] - origin[i]


@default
def _constrain(model: Any, x: np.ndarray) -> None:
    pass
