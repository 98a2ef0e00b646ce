"""The Earth for a navigator: WGS84 ellipsoid, its rotation, normal gravity, metres and radians. Plain kernels."""

import math
from typing import Any

import numpy as np

from estimators.elementary import cos, sin
from estimators.jit import njit
from estimators.rotations import wrap

Triple = Any  # an array or a tuple of three: the same to a kernel, but a tuple may stay in registers

A, E2, EARTH_RATE = 6378137.0, 6.69437999014e-3, 7.292115e-5  # m, -, rad/s
GRAVITY_GRADIENT = 3.086e-6  # 1/s2, of gravity with height
_EQUATOR, _K, _F, _M = 9.7803253359, 0.00193185265241, 1.0 / 298.257223563, 0.00344978650684


@njit
def radii(latitude: float) -> tuple[float, float]:
    """Radii of curvature (m) along the meridian and across it."""
    sine = sin(latitude)
    w2 = 1.0 - E2 * sine * sine
    across = A / math.sqrt(w2)
    return across * (1.0 - E2) / w2, across


@njit
def normal_gravity(latitude: float, height: float) -> float:
    """Normal gravity, m/s2 (Somigliana, second order in height: NIMA TR8350.2 eq. 4-1 and 4-3)."""
    sin2 = sin(latitude) ** 2
    h = height / A
    surface = _EQUATOR * (1.0 + _K * sin2) / math.sqrt(1.0 - E2 * sin2)
    return float(surface * (1.0 - 2.0 * (1.0 + _F + _M - 2.0 * _F * sin2) * h + 3.0 * h * h))


@njit
def frame_rates(lla: Triple, vel_n: Triple) -> tuple[float, float, float, float, float]:
    """Earth rate (north, down), then transport rate (north, east, down) of the local frame, rad/s."""
    along, across = radii(lla[0])
    sine, cosine = sin(lla[0]), cos(lla[0])
    north, east = vel_n[1] / (across + lla[2]), -vel_n[0] / (along + lla[2])
    return EARTH_RATE * cosine, -EARTH_RATE * sine, north, east, -north * sine / cosine


@njit
def move(lla: Triple, north: float, east: float, down: float, out: np.ndarray) -> None:
    """`out` (3,) = place `lla` (rad, rad, m) moved by metres."""
    out[0], out[1], out[2] = lla[0], lla[1], lla[2] - down
    if north != 0.0 or east != 0.0:  # most sigma points do not leave the place
        along, across = radii(lla[0])
        out[0] += north / (along + lla[2])
        out[1] += east / ((across + lla[2]) * cos(lla[0]))


@njit
def apart(lla: Triple, origin: Triple, out: np.ndarray) -> None:
    """`out` (3,) = metres NED from `origin` to `lla`, the inverse of `move`."""
    along, across = radii(origin[0])
    out[0] = (lla[0] - origin[0]) * (along + origin[2])
    out[1] = wrap(lla[1] - origin[1]) * (across + origin[2]) * cos(origin[0])
    out[2] = origin[2] - lla[2]
