"""Attitude errors and their statistics."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ahrs_sim.attitude import difference, down, euler, interpolate, roll_pitch, wrap


class Measure(IntEnum):
    """Errors of an attitude, as columns: Euler angles, angle between the verticals, angle of the whole rotation."""

    ROLL = 0
    PITCH = 1
    HEADING = 2
    TILT = 3
    TOTAL = 4


MEASURES = tuple(measure.name.lower() for measure in Measure)
"""Names of the columns of `attitude_errors`, in order."""

EULER = slice(Measure.ROLL, Measure.HEADING + 1)
"""Columns of the three Euler angles."""


@dataclass(frozen=True)
class History:
    """A reference attitude over time."""

    t: np.ndarray  # (n,) s, rising
    q_nb: np.ndarray  # (n, 4)

    def extended(self, t: np.ndarray, q_nb: np.ndarray, keep_s: float) -> "History":
        """Append newer samples and drop those more than `keep_s` older than the newest one so far."""
        kept = self.t > self.t[-1] - keep_s if len(self.t) else slice(0)
        return History(np.concatenate([self.t[kept], t]), np.concatenate([self.q_nb[kept], q_nb]))

    def covers(self, t: np.ndarray) -> np.ndarray:
        """Mask the times `t` (m,) up to which the reference has come; an attitude can be interpolated there."""
        covered: np.ndarray = t <= (self.t[-1] if len(self.t) > 1 else -np.inf)
        return covered

    def at(self, t: np.ndarray) -> np.ndarray:
        """Interpolate the attitude (m, 4) to times `t` (m,)."""
        return interpolate(self.t, self.q_nb, t)


NOTHING = History(np.empty(0), np.empty((0, 4)))


STEEP = 0.1
"""Cosine of pitch below which, the nose within 6 deg of the vertical, roll and heading are not compared: they jump
there while the attitude does not."""


def attitude_errors(q_nb: np.ndarray, down_b: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Compute errors (n, 5) in rad, in the order of MEASURES: signed for Euler angles, never negative for the last two.

    Roll and heading are NaN where the reference is `STEEP`.

    Args:
        q_nb: estimate (n, 4); rows of NaN where the method has no heading.
        down_b: estimated down direction in body axes (n, 3), used for the tilt and, without heading, roll and pitch.
        reference: reference attitude (n, 4).
    """
    reference_euler, reference_down = euler(reference), down(reference)
    with np.errstate(invalid="ignore"):
        estimated = euler(q_nb)
        roll, pitch = roll_pitch(down_b)
        angles = wrap(np.column_stack([roll, pitch, estimated[:, 2]]) - reference_euler)
        angles[np.abs(reference_down[:, 0]) > math.sqrt(1.0 - STEEP**2), :: Measure.HEADING] = np.nan
        cross = np.linalg.norm(np.cross(down_b, reference_down), axis=1)
        tilt = np.arctan2(cross, np.sum(down_b * reference_down, axis=1))
        total = 2 * np.arccos(np.clip(np.abs(np.sum(q_nb * reference, axis=1)), 0.0, 1.0))
        small = total < 1e-3  # arccos loses half the digits near 1: the vector part of the difference keeps them
        if small.any():
            _, vector = difference(q_nb[small], reference[small])
            total[small] = 2 * np.arcsin(np.clip(np.linalg.norm(vector, axis=1), 0.0, 1.0))
    return np.column_stack([angles, tilt, total])


STATISTICS: dict[str, Callable[[np.ndarray], float]] = {
    "rmse": lambda values: math.sqrt(float(values @ values) / len(values)),
    "p95": lambda values: float(np.percentile(values, 95, overwrite_input=True)),
    "max": lambda values: float(values.max()),
}
"""What is made of the absolute errors (n,) deg of a measure; called in this order, may reorder them."""


def figures(measure: str, errors: np.ndarray, unit: str = "deg") -> dict[str, float]:
    """Compute every statistic of |error| in deg of one measure, `MEASURE_STATISTIC_deg`; NaN when none is finite.

    Args:
        measure: its name.
        errors: (n,) rad, or rad/s.
        unit: at the end of the names.
    """
    values = np.degrees(np.abs(errors[np.isfinite(errors)].astype(float)))
    return {f"{measure}_{name}_{unit}": of(values) if len(values) else math.nan for name, of in STATISTICS.items()}


def statistics(errors: np.ndarray) -> dict[str, float]:
    """Compute `figures` of all measures.

    Args:
        errors: (n, 5) rad, in the order of MEASURES.
    """
    return {key: value for k, m in enumerate(MEASURES) for key, value in figures(m, errors[:, k]).items()}
