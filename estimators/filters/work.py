"""Memory of an estimator: what goes on from row to row, and what one step needs. Rows of matrices are CAPACITY long."""

from typing import Annotated

import numpy as np

from estimators.native import CAPACITY, Number, Record, shaped

TRUST = 32
"""Numbers that a policy may keep."""
_POINTS = 2 * CAPACITY

Vector = Annotated[np.ndarray, shaped(CAPACITY)]
Flags = Annotated[np.ndarray, shaped(CAPACITY, dtype=np.uint8)]  # 0 or 1
Matrix = Annotated[np.ndarray, shaped(CAPACITY, CAPACITY)]
Many = Annotated[np.ndarray, shaped(_POINTS, CAPACITY)]


class Carry(Record):
    """Carries the filter's state from row to row; with the model's memory it is the whole state of an estimator."""

    clock: Number  # s, last time stamp; NaN before the first
    x: Vector  # state, `raw` of it used
    u: Vector  # inputs of the last row
    z: Vector  # measurements of the last row
    used: Flags  # which of them counted
    trust: Annotated[np.ndarray, shaped(TRUST)]  # of the policy, see `adaptation.base`
    P: Matrix  # covariance (size, size) of it, as the filter keeps it
    P_restart: Matrix  # covariance to restart with when the filter is lost


class Work(Record):
    """Memory of one filter step, so that no step allocates; what simpler filters do not need lies behind."""

    before: Vector  # the state before the step
    x: Vector  # a state
    dx: Vector  # an error
    y: Vector  # predicted measurements of a group
    measured: Vector  # measurements of the group
    residual: Vector  # measured minus predicted, then independent innovations
    variance: Vector  # of these
    shift: Vector  # mean of points minus their centre
    used: Flags  # which of the group count
    J: Matrix  # a Jacobian (rows, size)
    T: Matrix  # its product with P
    L: Matrix  # leading columns of the Cholesky factor, one to a row
    S: Matrix  # (rows, rows) covariance of the measurements, lower half
    C: Matrix  # (rows, size) covariance of measurements and state
    noise: Matrix  # (rows, rows) measurement noise as the policy weighs it, lower half
    scratch: Matrix  # of the policy
    P: Matrix  # a covariance
    odd: Matrix  # (points, rows) f(+) - f(-) of each pair of points
    even: Matrix  # (points, rows) f(+) + f(-) - 2 f(0)
    steps: Many  # errors to the points, + and - in turns
    points: Many  # the points
    moved: Many  # the points propagated
    ends: Many  # errors or predictions of the points
    Q: Matrix  # process noise of square-root filters
    A: Annotated[np.ndarray, shaped(_POINTS, 4 * CAPACITY + 1)]  # columns to be compressed by square-root filters


CARRY, WORK = Carry.dtype, Work.dtype
POINTS_FROM, SQUARE_ROOT_FROM = "odd", "Q"
"""Where the memory begins that only filters with points need, and only square-root filters."""
