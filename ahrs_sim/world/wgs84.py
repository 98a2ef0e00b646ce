"""The WGS84 ellipsoid: positions, radii of curvature and the rates of a local-level frame.

Positions `lla` are geodetic latitude (rad), longitude (rad) and height above the ellipsoid (m); frame n is NED.
Constants from NIMA TR8350.2, 3rd edition; formulas from Groves, *Principles of GNSS, Inertial and Multisensor
Integrated Navigation Systems*, 2nd edition, sections 2.4 and 5.3.
"""

import numpy as np

A = 6378137.0  # m, semi-major axis
F = 1.0 / 298.257223563  # flattening
B = A * (1.0 - F)  # m, semi-minor axis
E2 = F * (2.0 - F)  # first eccentricity squared
EARTH_RATE = 7.292115e-5  # rad/s
GM = 3.986004418e14  # m3/s2
J2 = 1.08262982e-3  # dynamic form factor


def radii(latitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radii of curvature in the meridian and in the prime vertical (m), same shape as `latitude` (rad)."""
    w2 = 1.0 - E2 * np.sin(latitude) ** 2
    prime = A / np.sqrt(w2)
    return prime * (1.0 - E2) / w2, prime


def ecef(lla: np.ndarray) -> np.ndarray:
    """Earth-fixed coordinates (..., 3) m of `lla` (..., 3)."""
    lat, lon, height = lla[..., 0], lla[..., 1], lla[..., 2]
    prime = radii(lat)[1]
    across = (prime + height) * np.cos(lat)
    up = (prime * (1.0 - E2) + height) * np.sin(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), up], axis=-1)


def lla(position: np.ndarray) -> np.ndarray:
    """Geodetic coordinates (..., 3) of Earth-fixed `position` (..., 3) m.

    Bowring's start and two Newton steps on the reduced latitude: exact to rounding from the surface to 1000 km.
    """
    x, y, z = position[..., 0], position[..., 1], position[..., 2]
    across = np.hypot(x, y)
    reduced = np.arctan2(z, across * (1.0 - F))
    ep2 = E2 / (1.0 - E2)
    for _ in range(3):
        lat = np.arctan2(z + ep2 * B * np.sin(reduced) ** 3, across - E2 * A * np.cos(reduced) ** 3)
        reduced = np.arctan2((1.0 - F) * np.sin(lat), np.cos(lat))
    sin, cos = np.sin(lat), np.cos(lat)
    height = across * cos + z * sin - A * np.sqrt(1.0 - E2 * sin**2)
    return np.stack([lat, np.arctan2(y, x), height], axis=-1)


def ned_axes(latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """Compute rotation (..., 3, 3) that takes Earth-fixed vectors to local NED."""
    sl, cl, so, co = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(sl)
    rows = [
        np.stack([-sl * co, -sl * so, cl], axis=-1),
        np.stack([-so, co, zero], axis=-1),
        np.stack([-cl * co, -cl * so, -sl], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def offset_n(lla: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Locate `lla` (n, 3) in the NED frame at `origin` (3,): (n, 3) m, straight line, exact."""
    axes = ned_axes(np.asarray(origin[0]), np.asarray(origin[1]))
    offset: np.ndarray = (ecef(lla) - ecef(np.asarray(origin))) @ axes.T
    return offset


def earth_rate_n(latitude: np.ndarray) -> np.ndarray:
    """Compute rotation of the Earth in NED, (..., 3) rad/s."""
    zero = np.zeros_like(latitude)
    return EARTH_RATE * np.stack([np.cos(latitude), zero, -np.sin(latitude)], axis=-1)


def transport_rate_n(lla: np.ndarray, vel_n: np.ndarray) -> np.ndarray:
    """Compute rotation of NED against the Earth as it moves along, (..., 3) rad/s, from `lla` and `vel_n` (..., 3).

    Groves eq. (5.44).
    """
    meridian, prime = radii(lla[..., 0])
    east = vel_n[..., 1] / (prime + lla[..., 2])
    north = vel_n[..., 0] / (meridian + lla[..., 2])
    return np.stack([east, -north, -east * np.tan(lla[..., 0])], axis=-1)


def lla_rate(lla: np.ndarray, vel_n: np.ndarray) -> np.ndarray:
    """Compute time derivative of `lla` (..., 3) for a velocity `vel_n` (..., 3) m/s: rad/s, rad/s, m/s."""
    meridian, prime = radii(lla[..., 0])
    return np.stack(
        [
            vel_n[..., 0] / (meridian + lla[..., 2]),
            vel_n[..., 1] / ((prime + lla[..., 2]) * np.cos(lla[..., 0])),
            -vel_n[..., 2],
        ],
        axis=-1,
    )
