"""Satellites in view, from the nominal 24-slot GPS constellation, frozen.

Slots: GPS Standard Positioning Service Performance Standard, table of the 24 nominal slots (epoch 1993-07-01T00:00Z,
six planes of 55 degrees, circular orbits). Frozen: no perturbation, no satellite ever moved, and no almanac is needed.
Good for how many there are and how that changes with time, place and attitude; not for where one of them is today.
"""

import datetime
import math

import numpy as np

from ahrs_sim.jit import njit
from ahrs_sim.world.wgs84 import E2, EARTH_RATE, GM, A
from estimators.rotations import nav_vector

EPOCH = datetime.datetime(1993, 7, 1, tzinfo=datetime.UTC)
GREENWICH = math.radians((18.0 + 36.0 / 60.0 + 14.4 / 3600.0) * 15.0)  # hour angle of the equinox at EPOCH
SEMI_MAJOR = 26559.7e3  # m
INCLINATION = math.radians(55.0)
MEAN_MOTION = math.sqrt(GM / SEMI_MAJOR**3)  # rad/s

_NODES = (272.847, 332.847, 32.847, 92.847, 152.847, 212.847)  # deg, right ascension of planes A to F
_LATITUDES = (  # deg, argument of latitude of slots 1 to 4 at EPOCH
    (268.126, 161.786, 11.676, 41.806),
    (80.956, 173.336, 309.976, 204.376),
    (111.876, 11.796, 339.666, 241.556),
    (135.226, 265.446, 35.156, 167.356),
    (197.046, 302.596, 66.066, 333.686),
    (238.886, 345.226, 105.206, 135.346),
)

SLOTS = np.radians([(node, u) for node, plane in zip(_NODES, _LATITUDES, strict=True) for u in plane])
"""(24, 2) rad: right ascension of the node, argument of latitude at EPOCH."""


def seconds_since_epoch(date: datetime.datetime) -> float:
    """Compute the time from the constellation's epoch to `date` (UTC when it has no zone), s."""
    return ((date if date.tzinfo else date.replace(tzinfo=datetime.UTC)) - EPOCH).total_seconds()


def directions(since_epoch: np.ndarray, lla: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 24, 3), NED, to all satellites from `lla` (n, 3) at `since_epoch` (n,) s."""
    out = np.empty((len(since_epoch), len(SLOTS), 3))
    _directions(since_epoch, np.ascontiguousarray(lla), out)
    return out


def in_view(since_epoch: np.ndarray, lla: np.ndarray, q_nb: np.ndarray, elevation: float, shadow: float) -> np.ndarray:
    """Count the satellites (n,) that an antenna on the back of an aircraft receives.

    Args:
        since_epoch: (n,) s.
        lla: (n, 3) rad, rad, m.
        q_nb: (n, 4).
        elevation: mask angle above the horizon, rad.
        shadow: mask angle above the plane of the wings, rad: what lies lower is hidden by the airframe.
    """
    count = np.empty(len(since_epoch), np.int64)
    if len(count):
        _in_view(since_epoch, np.ascontiguousarray(lla), np.ascontiguousarray(q_nb), math.sin(elevation),
                 math.sin(shadow), np.empty((len(count), len(SLOTS), 3)), count)  # fmt: skip
    return count


@njit
def _directions(since_epoch: np.ndarray, lla: np.ndarray, out: np.ndarray) -> None:
    """Circular orbits to Earth-fixed axes to local NED."""
    ci, si = math.cos(INCLINATION), math.sin(INCLINATION)
    for i in range(out.shape[0]):
        sl, cl = math.sin(lla[i, 0]), math.cos(lla[i, 0])
        so, co = math.sin(lla[i, 1]), math.cos(lla[i, 1])
        prime = A / math.sqrt(1.0 - E2 * sl * sl)
        here_x = (prime + lla[i, 2]) * cl * co
        here_y = (prime + lla[i, 2]) * cl * so
        here_z = (prime * (1.0 - E2) + lla[i, 2]) * sl
        turned = GREENWICH + EARTH_RATE * since_epoch[i]
        for s in range(out.shape[1]):
            u = SLOTS[s, 1] + MEAN_MOTION * since_epoch[i]
            node = SLOTS[s, 0] - turned
            cu, su, cn, sn = math.cos(u), math.sin(u), math.cos(node), math.sin(node)
            x = SEMI_MAJOR * (cn * cu - sn * ci * su) - here_x
            y = SEMI_MAJOR * (sn * cu + cn * ci * su) - here_y
            z = SEMI_MAJOR * si * su - here_z
            scale = 1.0 / math.sqrt(x * x + y * y + z * z)
            out[i, s, 0] = scale * (-sl * co * x - sl * so * y + cl * z)
            out[i, s, 1] = scale * (-so * x + co * y)
            out[i, s, 2] = scale * (-cl * co * x - cl * so * y - sl * z)


@njit
def _in_view(
    since_epoch: np.ndarray, lla: np.ndarray, q_nb: np.ndarray, low: float, shade: float, work: np.ndarray,
    count: np.ndarray,
) -> None:  # fmt: skip
    _directions(since_epoch, lla, work)
    for i in range(count.shape[0]):
        n, e, down = nav_vector(q_nb[i], 0.0, 0.0, 1.0)  # the body's down axis
        total = 0
        for s in range(work.shape[1]):
            above_wings = -(n * work[i, s, 0] + e * work[i, s, 1] + down * work[i, s, 2])
            if -work[i, s, 2] >= low and above_wings >= shade:
                total += 1
        count[i] = total
