"""A ring of past values, for measurements that are old when they arrive.

A ring is a row of numbers (LENGTH,) in a model's memory, NaN at first: it keeps WIDTH values of each of the last SLOTS
rows.
"""

import math

import numpy as np

from estimators.jit import njit
from estimators.rotations import wrap

SLOTS, WIDTH = 256, 7  # rows: more than a second at 200 Hz
_STRIDE = WIDTH + 1
LENGTH = 1 + SLOTS * _STRIDE


@njit
def keep(ring: np.ndarray, t: float, values: np.ndarray) -> None:
    """Put `values` (WIDTH,) of time t in; times must rise."""
    slot = 0 if math.isnan(ring[0]) else (int(ring[0]) + 1) % SLOTS
    ring[0] = slot
    at = 1 + slot * _STRIDE
    ring[at] = t
    for i in range(WIDTH):
        ring[at + 1 + i] = values[i]


@njit
def recall(ring: np.ndarray, t: float, angles: tuple[int, ...], out: np.ndarray) -> bool:
    """`out` (WIDTH,) = values at time t, straight between rows, the newest if t is later; False when t is too old.

    Those at the places `angles` are angles.
    """
    if math.isnan(ring[0]) or not math.isfinite(t):
        return False
    slot = int(ring[0])
    late = 1 + slot * _STRIDE
    t = min(t, ring[late])
    if t == ring[late]:
        for i in range(WIDTH):
            out[i] = ring[late + 1 + i]
        return True
    for back in range(1, SLOTS):
        early = 1 + ((slot - back) % SLOTS) * _STRIDE
        if not ring[early] < ring[late]:  # NaN: not filled yet
            return False
        if ring[early] <= t:
            share = (t - ring[early]) / (ring[late] - ring[early])
            for i in range(WIDTH):
                step = ring[late + 1 + i] - ring[early + 1 + i]
                out[i] = ring[early + 1 + i] + share * (wrap(step) if i in angles else step)
            return True
        late = early
    return False
