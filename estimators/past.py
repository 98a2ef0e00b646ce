"""A ring of past values, for measurements that are old when they arrive: a record in a model's memory, NaN at first."""

import math
from typing import Annotated

import numpy as np

from estimators.jit import njit
from estimators.native import Number, Record, shaped
from estimators.rotations import wrap

SLOTS, WIDTH = 256, 9  # rows: more than a second at 200 Hz


class Ring(Record):
    """WIDTH values of each of the last SLOTS rows."""

    newest: Number  # slot; NaN: nothing kept yet
    t: Annotated[np.ndarray, shaped(SLOTS)]  # s
    values: Annotated[np.ndarray, shaped(SLOTS, WIDTH)]


@njit
def keep(ring: Ring, t: float, values: np.ndarray) -> None:
    """Store `values` (WIDTH,) of time t (s); times must rise."""
    slot = 0 if math.isnan(ring.newest) else (int(ring.newest) + 1) % SLOTS
    ring.newest = float(slot)
    ring.t[slot] = t
    for i in range(WIDTH):
        ring.values[slot, i] = values[i]


@njit
def recall(ring: Ring, t: float, angles: tuple[int, ...], out: np.ndarray) -> bool:
    """`out` (WIDTH,) = values at time t, straight between rows, the newest if t is later; False when t is too old.

    Those at the places `angles` are angles.
    """
    if math.isnan(ring.newest) or not math.isfinite(t):
        return False
    slot = int(ring.newest) % SLOTS
    late = slot
    t = min(t, ring.t[late])
    if t == ring.t[late]:
        for i in range(WIDTH):
            out[i] = ring.values[late, i]
        return True
    for back in range(1, SLOTS):
        early = (slot - back) % SLOTS
        if not ring.t[early] < ring.t[late]:  # NaN: not filled yet
            return False
        if ring.t[early] <= t:
            share = (t - ring.t[early]) / (ring.t[late] - ring.t[early])
            for i in range(WIDTH):
                step = ring.values[late, i] - ring.values[early, i]
                out[i] = ring.values[early, i] + share * (wrap(step) if i in angles else step)
            return True
        late = early
    return False
