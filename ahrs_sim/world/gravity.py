"""Gravity: the normal field of WGS84 (what navigators use) and the J2 field (what JSBSim flies in).

The two differ by 1.2e-4 m/s2 at most (4e-5 at 45 degrees): J2 alone leaves out the smaller even zonal terms.
"""

import numpy as np

from ahrs_sim.world import wgs84

STANDARD = 9.80665  # m/s2, one g of a data sheet (ISO 80000-3)

_EQUATOR = 9.7803253359  # m/s2, normal gravity at the equator
_K = 0.00193185265241  # Somigliana's constant
_M = wgs84.EARTH_RATE**2 * wgs84.A**2 * wgs84.B / wgs84.GM


def normal_gravity(lla: np.ndarray) -> np.ndarray:
    """Compute magnitude of normal gravity (...,) m/s2 at `lla` (..., 3).

    Somigliana's closed formula on the ellipsoid and its second-order expansion in height (NIMA TR8350.2, eq. 4-1 and
    4-3): 1e-6 m/s2 up to 10 km.
    """
    sin2 = np.sin(lla[..., 0]) ** 2
    h = lla[..., 2] / wgs84.A
    surface = _EQUATOR * (1.0 + _K * sin2) / np.sqrt(1.0 - wgs84.E2 * sin2)
    above: np.ndarray = surface * (1.0 - 2.0 * (1.0 + wgs84.F + _M - 2.0 * wgs84.F * sin2) * h + 3.0 * h**2)
    return above


def gravity_n(lla: np.ndarray) -> np.ndarray:
    """Normal gravity as a vector (..., 3) m/s2 in NED.

    North: the plumb line bends, -8.08e-9 h sin(2 latitude) (Groves eq. 2.140), 1e-6 m/s2 in 100 m.
    """
    north = -8.08e-9 * lla[..., 2] * np.sin(2.0 * lla[..., 0])
    return np.stack([north, np.zeros_like(north), normal_gravity(lla)], axis=-1)


def j2_gravity_n(lla: np.ndarray) -> np.ndarray:
    """Compute gravity (..., 3) m/s2 in NED of the J2 field and the Earth's rotation: the field JSBSim flies in."""
    position = wgs84.ecef(lla)
    r2 = np.sum(position**2, axis=-1)
    z2 = position[..., 2] ** 2 / r2
    j = 1.5 * wgs84.J2 * wgs84.A**2 / r2
    factor = np.stack([1.0 + j * (1.0 - 5.0 * z2), 1.0 + j * (1.0 - 5.0 * z2), 1.0 + j * (3.0 - 5.0 * z2)], axis=-1)
    field = -wgs84.GM * position * factor / (r2 * np.sqrt(r2))[..., None]
    field[..., :2] += wgs84.EARTH_RATE**2 * position[..., :2]
    axes = wgs84.ned_axes(lla[..., 0], lla[..., 1])
    in_ned: np.ndarray = np.einsum("...ij,...j->...i", axes, field)
    return in_ned
