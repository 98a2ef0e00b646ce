"""Past states, for measurements that are old when they arrive: what a ring (`estimators.past`) keeps of them.

A correction is of the past as well: what was taken in since a state was kept has to be in it when a fix of that moment
is compared with it, or the fix would correct it once more.
"""

import numpy as np

from estimators.earth import move
from estimators.jit import inner
from estimators.past import SLOTS, Ring
from estimators.rotations import wrap

CARRIED = 7
"""In the ring: velocity of the antenna (3, m/s), its place (rad, rad, m), yaw (rad), and from here `turned.carried`."""
ANGLES = (4, 6)


@inner
def correct(past: Ring, t: float, dx: np.ndarray) -> None:
    """Correct what was kept before t by the error dx of now: the same velocity and turn, the place less tau d v.

    The error of the acceleration is left out, here and in the slope of a fix: those of attitude and accelerometer
    all but cancel, and to take one of them alone would make their sum seem visible.
    """
    for back in range(SLOTS):
        slot = (int(past.newest) - back) % SLOTS
        tau = t - past.t[slot]
        if not tau < 1.0:
            return
        values = past.values[slot]
        for i in range(3):
            values[i] += dx[3 + i]
        place = values[3:6]
        north, east, down = dx[6] - tau * dx[3], dx[7] - tau * dx[4], dx[8] - tau * dx[5]
        move((place[0], place[1], place[2]), north, east, down, place)
        values[6] = wrap(values[6] + dx[2])
