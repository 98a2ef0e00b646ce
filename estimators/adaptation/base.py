"""What an adaptation policy supplies.

A policy is a `NamedTuple` of its parameters with `admit` and `weigh`, or one of them, registered for its type. It sees
sensors, not physics: a sensor is three consecutive measurements of a group (or what is left of it), sensors are counted
through all groups. Its memory `trust` (MEMORY,) starts with how far each sensor was trusted last, and the first four of
these go into the estimates: 1 as far as the model says, 0.1 with ten times the variance, 0 not at all, NaN never seen.
"""

from typing import Any, NamedTuple

import numpy as np

from estimators.generic import default, generic, register
from estimators.jit import njit
from estimators.models.base import ROWS, measurement_noise

SENSORS = 8
MEMORY = 4 * SENSORS


@generic
def admit(policy: Any, model: Any, row: np.ndarray, trust: np.ndarray, used: np.ndarray) -> bool:  # type: ignore[empty-body]
    """Before anything is predicted: refuse measurements by clearing `used`; true when one was (status COASTING)."""


@generic
def weigh(
    policy: Any,
    model: Any,
    group: int,
    x: np.ndarray,
    u: np.ndarray,
    S: np.ndarray,
    error: np.ndarray,
    counts: np.ndarray,
    trust: np.ndarray,
    noise: np.ndarray,
) -> None:
    """Add the noise of a measurement group to the lower half of its covariance S, as much of it as seems right.

    `error` (rows,) measured minus predicted; clearing an element of `counts` refuses a measurement; `noise` (rows,
    rows) is scratch.
    """


@generic
def disturbed(model: Any) -> tuple[int, int, int]:  # type: ignore[empty-body]
    """Of a model: rows of z (from, end) that the vehicle's own acceleration or turning falsifies, their sensor."""


@default
def _admit(policy: Any, model: Any, row: np.ndarray, trust: np.ndarray, used: np.ndarray) -> bool:
    return False


@default
def _weigh(
    policy: Any,
    model: Any,
    group: int,
    x: np.ndarray,
    u: np.ndarray,
    S: np.ndarray,
    error: np.ndarray,
    counts: np.ndarray,
    trust: np.ndarray,
    noise: np.ndarray,
) -> None:
    measurement_noise(model, group, x, u, S)


@default
def _disturbed(model: Any) -> tuple[int, int, int]:
    return 0, 3, 0  # the accelerometer comes first


@njit
def first_sensor(model: Any, group: int) -> int:
    """Number of the first sensor of a group."""
    count = 0
    for g in range(group):
        count += (model.groups[g, ROWS] + 2) // 3
    return count


class Plain(NamedTuple):
    """None: every measurement counts as the model says."""


register(Plain)
