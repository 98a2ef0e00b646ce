"""Two attitude histories of one motion: by how much is one later, and what constant rotation lies between them."""

import math

import numpy as np

from ahrs_sim import attitude

LONGEST = 1.0
"""s: no delay is looked for beyond this."""

_MOVING = math.radians(5.0)  # rad/s: only turning tells times apart
_LEAST = 5.0  # s of turning needed


def rates(t: np.ndarray, q_nb: np.ndarray, at: np.ndarray, width: float) -> np.ndarray:
    """Compute mean body rates (m, 3) rad/s over `width` (s) about `at` (m,) from attitudes (n, 4) at times (n,)."""
    if len(t) < 2:
        return np.full((len(at), 3), np.nan)
    a = attitude.interpolate(t, q_nb, at - width / 2)
    b = attitude.interpolate(t, q_nb, at + width / 2)
    w, v = attitude.difference(a, b)
    v = np.where(w < 0, -v, v)
    norm = np.linalg.norm(v, axis=1, keepdims=True)
    angle = 2 * np.arctan2(norm, np.abs(w))
    rate: np.ndarray = v * np.where(norm > 1e-12, angle / np.maximum(norm, 1e-12), 2.0) / width
    return rate


def time_shift(t: np.ndarray, rate_b: np.ndarray, width: float, t_ref: np.ndarray, q_ref: np.ndarray) -> float | None:
    """Estimate by how many s attitudes `q_ref` (m, 4) at `t_ref` are later than body rates (n, 3) rad/s at `t`.

    The delay that makes the rates differ least, by trying and a parabola; None without `_LEAST` s of turning.

    Args:
        t: (n,) s, middle of the spans that `rate_b` are means of.
        rate_b: (n, 3) rad/s.
        width: s, of these spans.
        t_ref: (m,) s, rising.
        q_ref: (m, 4).
    """
    moving = np.linalg.norm(rate_b, axis=1) > _MOVING
    if len(t_ref) < 2 or moving.sum() * width < _LEAST:
        return None
    t, rate_b = t[moving], rate_b[moving]
    every = max(1, len(t) // 3000)
    t, rate_b = t[::every], rate_b[::every]

    def cost(delay: float) -> float:
        difference = rates(t_ref, q_ref, t + delay, width) - rate_b
        good = np.isfinite(difference[:, 0])
        return float(np.median(np.sum(difference[good] ** 2, axis=1))) if good.sum() > 20 else math.inf

    delay, step = 0.0, LONGEST / 10
    grid: np.ndarray = np.linspace(-LONGEST, LONGEST, 21)
    while step > 5e-4:
        costs = [cost(d) for d in grid]
        if not np.isfinite(min(costs)):
            return None
        delay = float(grid[int(np.argmin(costs))])
        step /= 4
        grid = delay + step * np.arange(-4, 5)
    return delay if abs(delay) < LONGEST else None


def heading_offset(q: np.ndarray, reference: np.ndarray) -> float:
    """Find the rotation about down (rad) that takes the reference (n, 4) closest to the attitudes `q` (n, 4)."""
    w = np.sum(q * reference, axis=1)
    z = -q[:, 0] * reference[:, 3] + q[:, 3] * reference[:, 0] - q[:, 1] * reference[:, 2] + q[:, 2] * reference[:, 1]
    good = np.isfinite(w)
    angle = 2 * np.arctan2(z[good], w[good])
    return float(np.angle(np.sum(np.exp(1j * angle)))) if good.any() else 0.0


def constant_rotations(q: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find quaternions (4,) `left` and `right` with left (x) reference (x) right closest to `q` (n, 4)."""
    good = np.isfinite(q).all(axis=1) & np.isfinite(reference).all(axis=1)
    q, reference = q[good], reference[good]
    left = right = np.array([1.0, 0.0, 0.0, 0.0])
    for _ in range(30):
        left = _mean(attitude.product(q, attitude.conjugate(attitude.product(reference, right[None]))))
        right = _mean(attitude.product(attitude.conjugate(attitude.product(left[None], reference)), q))
    return left, right


def _mean(q: np.ndarray) -> np.ndarray:
    """Find the rotation (4,) closest to all of `q` (n, 4)."""
    mean: np.ndarray = np.linalg.eigh(q.T @ q)[1][:, -1]
    return mean
