"""Attitude errors and their statistics."""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np


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

GAP = 5.0
"""Periods of a reference; where its samples are further apart it is not interpolated."""


def euler(q_nb: np.ndarray) -> np.ndarray:
    """Roll, pitch, heading (n, 3) in rad of quaternions (n, 4); heading in (-pi, pi]."""
    a, b, c, d = q_nb.T
    roll = np.arctan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c))
    pitch = np.arcsin(np.clip(2 * (a * c - b * d), -1.0, 1.0))
    heading = np.arctan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d))
    return np.column_stack([roll, pitch, heading])


def wrap(angle: np.ndarray) -> np.ndarray:
    """The angle (rad) in (-pi, pi]."""
    wrapped: np.ndarray = np.pi - np.mod(np.pi - angle, 2 * np.pi)
    return wrapped


def down(q_nb: np.ndarray) -> np.ndarray:
    """The down direction in body axes (n, 3): the third row of C_nb, the tilt without the heading."""
    a, b, c, d = q_nb.T
    return np.column_stack([2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)])


def roll_pitch(down_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch (n,) rad from the down direction in body axes (n, 3)."""
    return np.arctan2(down_b[:, 1], down_b[:, 2]), np.arcsin(np.clip(-down_b[:, 0], -1.0, 1.0))


def interpolate(t: np.ndarray, q_nb: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Quaternions (m, 4) at times `at` (m,) from samples `q_nb` (n, 4) at rising times `t` (n,).

    Linear and normalised between neighbours: at 100 Hz and 2 rad/s off by less than 1e-4 deg. NaN outside of `t`, and
    between neighbours more than `GAP` periods apart; the period is what nine tenths of the samples keep to.
    """
    right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    left = right - 1
    span = t[right] - t[left]
    weight = np.where(span > 0, (at - t[left]) / np.where(span > 0, span, 1.0), 0.0)[:, None]
    sign = np.where(np.sum(q_nb[left] * q_nb[right], axis=1) < 0, -1.0, 1.0)[:, None]
    q: np.ndarray = (1 - weight) * q_nb[left] + weight * sign * q_nb[right]
    with np.errstate(invalid="ignore"):  # a reference of zeros is none
        q /= np.linalg.norm(q, axis=1, keepdims=True)
    longest = GAP * np.quantile(np.diff(t), 0.9, method="lower") if len(t) > 2 else np.inf
    gap = (span > longest) & (at > t[left] + 1e-9) & (at < t[right] - 1e-9)
    q[gap | (at < t[0] - 1e-9) | (at > t[-1] + 1e-9)] = np.nan
    return q


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


def attitude_errors(q_nb: np.ndarray, down_b: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Errors (n, 5) in rad, in the order of MEASURES: signed for the Euler angles, never negative for the last two.

    Args:
        q_nb: estimate (n, 4); rows of NaN where the method has no heading.
        down_b: estimated down direction in body axes (n, 3), used for the tilt and, without heading, roll and pitch.
        reference: reference attitude (n, 4).
    """
    reference_euler, reference_down = euler(reference), down(reference)
    with np.errstate(invalid="ignore"):
        estimated = euler(q_nb)
        roll, pitch = roll_pitch(down_b)
        difference = wrap(np.column_stack([roll, pitch, estimated[:, 2]]) - reference_euler)
        cross = np.linalg.norm(np.cross(down_b, reference_down), axis=1)
        tilt = np.arctan2(cross, np.sum(down_b * reference_down, axis=1))
        total = 2 * np.arccos(np.clip(np.abs(np.sum(q_nb * reference, axis=1)), 0.0, 1.0))
        small = total < 1e-3  # arccos loses half the digits near 1: the vector part of the difference keeps them
        if small.any():
            total[small] = 2 * np.arcsin(np.clip(_vector_part(q_nb[small], reference[small]), 0.0, 1.0))
    return np.column_stack([difference, tilt, total])


def _vector_part(q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Norm of the vector part of conj(q) (x) r, (n,)."""
    v = q[:, :1] * r[:, 1:] - r[:, :1] * q[:, 1:] - np.cross(q[:, 1:], r[:, 1:])
    norm: np.ndarray = np.linalg.norm(v, axis=1)
    return norm


def figures(measure: str, errors: np.ndarray) -> dict[str, float]:
    """RMSE, 95th percentile and maximum of |error| in deg of one measure, NaN when none is finite.

    Args:
        measure: its name.
        errors: (n,) rad.
    """
    values = np.degrees(np.abs(errors[np.isfinite(errors)].astype(float)))
    if not len(values):
        return dict.fromkeys((f"{measure}_{s}_deg" for s in ("rmse", "p95", "max")), math.nan)
    return {
        f"{measure}_rmse_deg": math.sqrt(float(values @ values) / len(values)),
        f"{measure}_p95_deg": float(np.percentile(values, 95, overwrite_input=True)),
        f"{measure}_max_deg": float(values.max()),
    }


def statistics(errors: np.ndarray) -> dict[str, float]:
    """`figures` of all measures.

    Args:
        errors: (n, 5) rad, in the order of MEASURES.
    """
    return {key: value for k, m in enumerate(MEASURES) for key, value in figures(m, errors[:, k]).items()}
