"""Past states, for measurements that are old when they arrive.

They are the antenna's velocity and place, the yaw, and the velocity that the gyro alone carries (`turned`).
A correction is of the past as well: what was taken in since a state was kept has to be in it when a fix of that moment
is compared with it, or the fix would correct it once more.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from estimators.earth import move
from estimators.jit import njit
from estimators.rotations import wrap

SLOTS = 256  # rows: more than a second at 200 Hz
VELOCITY, PLACE, YAW, CARRIED, WIDTH = 0, 3, 6, 7, 9
_LONGITUDE = 4


class History(NamedTuple):
    """A ring."""

    newest: np.ndarray  # (1,) int64, its slot; -1: nothing yet
    t: np.ndarray  # (SLOTS,) s, NaN where there is nothing
    values: np.ndarray  # (SLOTS, WIDTH) m/s, then rad, rad, m, then rad, then m/s

    @classmethod
    def make(cls) -> "History":
        """Nothing kept."""
        return cls(np.full(1, -1, np.int64), np.full(SLOTS, np.nan), np.full((SLOTS, WIDTH), np.nan))


@njit
def keep(history: Any, t: float, values: np.ndarray) -> None:
    """Put the values (WIDTH,) of time t in; times must rise."""
    slot = (history.newest[0] + 1) % SLOTS
    history.newest[0], history.t[slot] = slot, t
    for i in range(WIDTH):
        history.values[slot, i] = values[i]


@njit
def recall(history: Any, t: float, out: np.ndarray) -> bool:
    """`out` (WIDTH,) = values at time t, straight between rows, the newest if t is later; False when t is too old."""
    late = history.newest[0]
    if late < 0 or not math.isfinite(t):
        return False
    t = min(t, history.t[late])
    for back in range(1, SLOTS + 1):
        if t == history.t[late]:
            for i in range(WIDTH):
                out[i] = history.values[late, i]
            return True
        early = (history.newest[0] - back) % SLOTS
        if back == SLOTS or not history.t[early] < history.t[late]:  # NaN: not filled yet
            return False
        if history.t[early] <= t:
            share = (t - history.t[early]) / (history.t[late] - history.t[early])
            for i in range(WIDTH):
                step = history.values[late, i] - history.values[early, i]
                step = wrap(step) if i in (_LONGITUDE, YAW) else step
                out[i] = history.values[early, i] + share * step
            return True
        late = early
    return False


@njit
def correct(history: Any, t: float, dx: np.ndarray) -> None:
    """Correct what was kept before t by the error dx of now: the same velocity and turn, the place less tau d v.

    The error of the acceleration is left out, here and in the slope of a fix: those of attitude and accelerometer
    all but cancel, and to take one of them alone would make their sum seem visible.
    """
    for back in range(SLOTS):
        slot = (history.newest[0] - back) % SLOTS
        tau = t - history.t[slot]
        if not tau < 1.0:
            return
        values = history.values[slot]
        for i in range(3):
            values[i] += dx[3 + i]
        place = values[3:6]
        north, east, down = dx[6] - tau * dx[3], dx[7] - tau * dx[4], dx[8] - tau * dx[5]
        move((place[0], place[1], place[2]), north, east, down, place)
        values[6] = wrap(values[6] + dx[2])
