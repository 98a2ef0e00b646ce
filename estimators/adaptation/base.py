"""What an adaptation policy supplies.

A policy is a `NamedTuple` of its parameters with `admit` and `factor`, or one of them, registered for its type. It sees
sensors, not physics: a sensor is three consecutive measurements of a group (or what is left of it), sensors are counted
through all groups. Its memory `trust` (MEMORY,) starts with how far each sensor was trusted last, and the first four of
these go into the estimates: 1 as far as the model says, 0.1 with ten times the variance, 0 not at all, NaN never seen.
"""

from typing import Any, NamedTuple

import numpy as np

from estimators.generic import default, generic, register
from estimators.jit import inner, njit
from estimators.models.base import ROWS, measurement_noise

SENSORS = 8
MEMORY = 4 * SENSORS


@generic
def admit(policy: Any, model: Any, row: np.ndarray, x: np.ndarray, trust: np.ndarray, used: np.ndarray) -> bool:  # type: ignore[empty-body]
    """Before anything is corrected: refuse measurements by clearing `used`; true when one was (status COASTING).

    `x` is the predicted state, whose first four elements are q_nb for every model that has a heading.
    """


@generic
def factor(  # type: ignore[empty-body]
    policy: Any,
    sensor: int,
    first: int,
    end: int,
    S: np.ndarray,
    noise: np.ndarray,
    error: np.ndarray,
    counts: np.ndarray,
    trust: np.ndarray,
    scratch: np.ndarray,
) -> float:
    """On the noise of one sensor, rows `first` to `end` of its group: 1 as the model says, 0 to refuse it.

    Args:
        policy: the policy.
        sensor: its number.
        first: its first row.
        end: the row after its last.
        S: (rows, rows) predicted covariance of the group without noise, lower half.
        noise: (rows, rows) the model's noise, lower half.
        error: (rows,) measured minus predicted.
        counts: (rows,) which of them are there.
        trust: memory.
        scratch: (rows, rows).
    """


@generic
def disturbed(model: Any) -> tuple[int, int, int]:  # type: ignore[empty-body]
    """Of a model: rows of z (from, end) that the vehicle's own acceleration or turning falsifies, their sensor."""


@generic
def magnetic(model: Any) -> tuple[int, int, int]:  # type: ignore[empty-body]
    """Of a model: rows of z (from, end) that come from the magnetometer, and their sensor; (0, 0, 0) without."""


@default
def _admit(policy: Any, model: Any, row: np.ndarray, x: np.ndarray, trust: np.ndarray, used: np.ndarray) -> bool:
    return False


@default
def _factor(
    policy: Any,
    sensor: int,
    first: int,
    end: int,
    S: np.ndarray,
    noise: np.ndarray,
    error: np.ndarray,
    counts: np.ndarray,
    trust: np.ndarray,
    scratch: np.ndarray,
) -> float:
    return 1.0


@default
def _disturbed(model: Any) -> tuple[int, int, int]:
    return 0, 3, 0  # the accelerometer comes first


@default
def _magnetic(model: Any) -> tuple[int, int, int]:
    return 0, 0, 0


@njit
def first_sensor(model: Any, group: int) -> int:
    """Number of the first sensor of a group."""
    count = 0
    for g in range(group):
        count += (model.groups[g, ROWS] + 2) // 3
    return count


@inner
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
    scratch: np.ndarray,
) -> None:
    """`noise` (lower half) = noise of a measurement group, as much of it as the policy thinks right, sensor by sensor.

    Elements of `counts` are cleared for a sensor that is refused. The other arguments are those of `factor`.
    """
    rows = model.groups[group, ROWS]
    for i in range(rows):
        for j in range(i + 1):
            noise[i, j] = 0.0
    measurement_noise(model, group, x, u, noise)
    first, sensor = 0, first_sensor(model, group)
    while first < rows:
        end = min(rows, first + 3)
        share = factor(policy, sensor, first, end, S, noise, error, counts, trust, scratch)
        for i in range(first, end):
            if share == 0.0:
                counts[i] = False
            else:
                for j in range(first, i + 1):
                    noise[i, j] *= share
        first, sensor = end, sensor + 1


class Plain(NamedTuple):
    """None: every measurement counts as the model says."""


register(Plain)
