"""Rotations: one equation per kernel.

Quaternions are scalar first, Hamilton; `q_nb` turns body into navigation vectors: `v_n = q_nb v_b q_nb*`, `C_bn(q_nb)`
is the matrix that maps a navigation vector to body axes. Rotation vectors are in rad. Kernels write to their last
argument, which must not be one of the others, or return a tuple: that costs no memory, which in a filter's innermost
loops takes longer than the equations.
"""

import math
from typing import Any

import numpy as np

from estimators.elementary import asin, atan2, cos, hypot, modulo, sin
from estimators.jit import njit
from estimators.native import local

Quaternion = Any  # an array or a tuple of four

_SMALL = 0.04  # rad2: below, series are exact to rounding and much faster than sin and cos


@njit
def exp_terms(angle2: float) -> tuple[float, float, float]:
    """`cos(a/2)`, `s = sin(a/2)/a` and `(cos(a/2)/2 - s)/a^2` (the slope of s over a) for `angle2 = a^2`."""
    if angle2 < _SMALL:
        y = 0.25 * angle2
        cosine = 1.0 + y * (-1.0 / 2 + y * (1.0 / 24 + y * (-1.0 / 720 + y / 40320)))
        sine = 0.5 * (1.0 + y * (-1.0 / 6 + y * (1.0 / 120 + y * (-1.0 / 5040 + y / 362880))))
        slope = -1.0 / 24 + angle2 * (1.0 / 960 + angle2 * (-1.0 / 107520 + angle2 / 23224320))
        return cosine, sine, slope
    angle = math.sqrt(angle2)
    cosine = cos(0.5 * angle)
    sine = sin(0.5 * angle) / angle
    return cosine, sine, (0.5 * cosine - sine) / angle2


@njit
def turned(q: Quaternion, rx: float, ry: float, rz: float) -> tuple[float, float, float, float]:
    """`q (x) exp_q(r)`: attitude after the body has turned by the rotation vector r (rad, body axes)."""
    cosine, sine, _ = exp_terms(rx * rx + ry * ry + rz * rz)
    b, c, d = sine * rx, sine * ry, sine * rz
    return (
        q[0] * cosine - q[1] * b - q[2] * c - q[3] * d,
        q[0] * b + q[1] * cosine + q[2] * d - q[3] * c,
        q[0] * c - q[1] * d + q[2] * cosine + q[3] * b,
        q[0] * d + q[1] * c - q[2] * b + q[3] * cosine,
    )


@njit
def turn(q: np.ndarray, rx: float, ry: float, rz: float, out: np.ndarray) -> None:
    """`out = turned(q, r)`."""
    out[0], out[1], out[2], out[3] = turned(q, rx, ry, rz)


@njit
def turn_nav(q: Quaternion, rx: float, ry: float, rz: float, out: np.ndarray) -> None:
    """`out = exp_q(r) (x) q`: attitude after a turn by r (rad, navigation axes); `turned` on conjugates."""
    a, b, c, d = turned((q[0], -q[1], -q[2], -q[3]), -rx, -ry, -rz)
    out[0], out[1], out[2], out[3] = a, -b, -c, -d


@njit
def multiply(p: np.ndarray, q: np.ndarray, out: np.ndarray) -> None:
    """`out = p (x) q`."""
    out[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    out[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    out[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    out[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]


@njit
def rotation_between(p: Quaternion, q: Quaternion, out: np.ndarray) -> None:
    """`out = r` (3,) rad with `q = p (x) exp_q(r)`, the short way round: the inverse of `turn`."""
    a = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    b = p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    c = p[0] * q[2] + p[1] * q[3] - p[2] * q[0] - p[3] * q[1]
    d = p[0] * q[3] - p[1] * q[2] + p[2] * q[1] - p[3] * q[0]
    square = b * b + c * c + d * d
    if a < 0.0:
        a, b, c, d = -a, -b, -c, -d
    if square < 0.01 * a * a:  # atan(t)/t as a series, exact to rounding
        y = -square / (a * a)
        tail = 1.0 / 9 + y * (1.0 / 11 + y * (1.0 / 13 + y * (1.0 / 15 + y / 17)))
        scale = 2.0 / a * (1.0 + y * (1.0 / 3 + y * (1.0 / 5 + y * (1.0 / 7 + y * tail))))
    else:
        sine = math.sqrt(square)
        scale = 2.0 * atan2(sine, a) / sine
    out[0] = scale * b
    out[1] = scale * c
    out[2] = scale * d


@njit
def normalise(q: np.ndarray) -> None:
    """`q / |q|` in place, of the first four elements; NaN when there is no direction left (0 or overflow)."""
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    scale = 1.0 / norm if 0.0 < norm < math.inf else math.nan
    for i in range(4):
        q[i] *= scale


@njit
def to_body(q: np.ndarray, x: float, y: float, z: float, out: np.ndarray) -> None:
    """`out = C_bn(q) (x, y, z)`: navigation vector to body axes; homogeneous of degree 2 in q, as W in Han 2013."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    aa, bb, cc, dd = a * a, b * b, c * c, d * d
    out[0] = (aa + bb - cc - dd) * x + 2.0 * ((b * c + a * d) * y + (b * d - a * c) * z)
    out[1] = (aa - bb + cc - dd) * y + 2.0 * ((b * c - a * d) * x + (c * d + a * b) * z)
    out[2] = (aa - bb - cc + dd) * z + 2.0 * ((b * d + a * c) * x + (c * d - a * b) * y)


@njit
def nav_vector(q: Quaternion, x: float, y: float, z: float) -> tuple[float, float, float]:
    """`C_nb(q) (x, y, z)`: body vector to navigation axes."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    aa, bb, cc, dd = a * a, b * b, c * c, d * d
    return (
        (aa + bb - cc - dd) * x + 2.0 * ((b * c - a * d) * y + (b * d + a * c) * z),
        (aa - bb + cc - dd) * y + 2.0 * ((b * c + a * d) * x + (c * d - a * b) * z),
        (aa - bb - cc + dd) * z + 2.0 * ((b * d - a * c) * x + (c * d + a * b) * y),
    )


@njit
def to_nav(q: np.ndarray, x: float, y: float, z: float, out: np.ndarray) -> None:
    """`out = nav_vector(q, x, y, z)`."""
    out[0], out[1], out[2] = nav_vector(q, x, y, z)


@njit
def to_body_by_q(q: np.ndarray, x: float, y: float, z: float, out: np.ndarray) -> None:
    """`out` (3, 4): derivative of `to_body` with respect to the four elements of q."""
    a, b, c, d = 2.0 * q[0], 2.0 * q[1], 2.0 * q[2], 2.0 * q[3]
    out[0, 0] = a * x + d * y - c * z
    out[0, 1] = b * x + c * y + d * z
    out[0, 2] = -c * x + b * y - a * z
    out[0, 3] = -d * x + a * y + b * z
    out[1, 0] = -d * x + a * y + b * z
    out[1, 1] = c * x - b * y + a * z
    out[1, 2] = b * x + c * y + d * z
    out[1, 3] = -a * x - d * y + c * z
    out[2, 0] = c * x - b * y + a * z
    out[2, 1] = d * x - a * y - b * z
    out[2, 2] = a * x + d * y - c * z
    out[2, 3] = b * x + c * y + d * z


@njit
def attitude_matrix(q: np.ndarray, out: np.ndarray) -> None:
    """`out = C_bn(q)` (3, 3), columns are the north, east and down axes seen from the body."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    out[0, 0] = a * a + b * b - c * c - d * d
    out[0, 1] = 2.0 * (b * c + a * d)
    out[0, 2] = 2.0 * (b * d - a * c)
    out[1, 0] = 2.0 * (b * c - a * d)
    out[1, 1] = a * a - b * b + c * c - d * d
    out[1, 2] = 2.0 * (c * d + a * b)
    out[2, 0] = 2.0 * (b * d + a * c)
    out[2, 1] = 2.0 * (c * d - a * b)
    out[2, 2] = a * a - b * b - c * c + d * d


@njit
def from_matrix(C_bn: np.ndarray, out: np.ndarray) -> None:
    """`out = q_nb` of a rotation matrix, by the largest element (Shepperd), scalar part not negative."""
    xx, yy, zz = C_bn[0, 0], C_bn[1, 1], C_bn[2, 2]
    trace = xx + yy + zz
    if trace >= max(xx, yy, zz):
        out[0], out[1] = 1.0 + trace, C_bn[1, 2] - C_bn[2, 1]
        out[2], out[3] = C_bn[2, 0] - C_bn[0, 2], C_bn[0, 1] - C_bn[1, 0]
    elif xx >= max(yy, zz):
        out[0], out[1] = C_bn[1, 2] - C_bn[2, 1], 1.0 + xx - yy - zz
        out[2], out[3] = C_bn[0, 1] + C_bn[1, 0], C_bn[0, 2] + C_bn[2, 0]
    elif yy >= zz:
        out[0], out[1] = C_bn[2, 0] - C_bn[0, 2], C_bn[0, 1] + C_bn[1, 0]
        out[2], out[3] = 1.0 - xx + yy - zz, C_bn[1, 2] + C_bn[2, 1]
    else:
        out[0], out[1] = C_bn[0, 1] - C_bn[1, 0], C_bn[0, 2] + C_bn[2, 0]
        out[2], out[3] = C_bn[1, 2] + C_bn[2, 1], 1.0 - xx - yy + zz
    normalise(out)
    if out[0] < 0.0:
        for i in range(4):
            out[i] = -out[i]


@njit
def yaw(q: np.ndarray) -> float:
    """Heading (rad, -pi..pi) of q_nb."""
    angle: float = atan2(2.0 * (q[0] * q[3] + q[1] * q[2]), 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]))
    return angle


@njit
def euler(q: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch, yaw (rad, yaw in -pi..pi) of q_nb: Han 2013, eq. (17) with its names set right."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    roll = atan2(2.0 * (a * b + c * d), 1.0 - 2.0 * (b * b + c * c))
    pitch = asin(min(1.0, max(-1.0, 2.0 * (a * c - b * d))))
    return roll, pitch, yaw(q)


@njit
def from_euler(roll: float, pitch: float, yaw: float, out: np.ndarray) -> None:
    """`out = q_nb` of roll, pitch, yaw (rad)."""
    cr, sr = cos(0.5 * roll), sin(0.5 * roll)
    cp, sp = cos(0.5 * pitch), sin(0.5 * pitch)
    cy, sy = cos(0.5 * yaw), sin(0.5 * yaw)
    out[0] = cr * cp * cy + sr * sp * sy
    out[1] = sr * cp * cy - cr * sp * sy
    out[2] = cr * sp * cy + sr * cp * sy
    out[3] = cr * cp * sy - sr * sp * cy


@njit
def wrap(angle: float) -> float:
    """`angle` in (-pi, pi]."""
    if -math.pi < angle <= math.pi:
        return angle
    wrapped: float = math.pi - modulo(math.pi - angle, 2.0 * math.pi)
    return wrapped


@njit
def triad(down_b: np.ndarray, mag_b: np.ndarray, mag_n: np.ndarray, out: np.ndarray) -> bool:
    """`out = q_nb` from two directions (TRIAD): down exactly, the magnetic field for the heading alone.

    `down_b`, `mag_b` and `mag_n` need not be unit vectors; `mag_n` carries the declination. False, and `out` untouched,
    when a vector vanishes or the field is vertical.
    """
    north = hypot(mag_n[0], mag_n[1])
    length = math.sqrt(down_b[0] ** 2 + down_b[1] ** 2 + down_b[2] ** 2)
    if not (north > 0.0 and length > 0.0):
        return False
    dx, dy, dz = down_b[0] / length, down_b[1] / length, down_b[2] / length
    ex = dy * mag_b[2] - dz * mag_b[1]
    ey = dz * mag_b[0] - dx * mag_b[2]
    ez = dx * mag_b[1] - dy * mag_b[0]
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    if not length > 0.0:
        return False
    ex, ey, ez = ex / length, ey / length, ez / length  # magnetic east
    cosine, sine = mag_n[0] / north, mag_n[1] / north  # of the declination
    nx, ny, nz = ey * dz - ez * dy, ez * dx - ex * dz, ex * dy - ey * dx  # magnetic north
    C_bn = local(3, 3)
    C_bn[0, 0], C_bn[0, 1], C_bn[0, 2] = cosine * nx - sine * ex, sine * nx + cosine * ex, dx
    C_bn[1, 0], C_bn[1, 1], C_bn[1, 2] = cosine * ny - sine * ey, sine * ny + cosine * ey, dy
    C_bn[2, 0], C_bn[2, 1], C_bn[2, 2] = cosine * nz - sine * ez, sine * nz + cosine * ez, dz
    from_matrix(C_bn, out)
    return True


@njit
def rotation_slopes(rx: float, ry: float, rz: float, E: np.ndarray, J: np.ndarray) -> None:
    """`E = exp(-[r x])` (3, 3) and the right Jacobian `J` (3, 3) of rotation r: exp(r + d) = exp(r) exp(J d)."""
    a2 = rx * rx + ry * ry + rz * rz
    if a2 < 1e-4:
        sine, cosine, cubic = 1.0 - a2 / 6.0 + a2 * a2 / 120.0, 0.5 - a2 / 24.0, 1.0 / 6.0 - a2 / 120.0
    else:
        a = math.sqrt(a2)
        sine, cosine, cubic = sin(a) / a, (1.0 - cos(a)) / a2, (a - sin(a)) / (a2 * a)
    # products of r with itself: [r x]^2 = r r^T - a2 I
    E[0, 0], E[1, 1], E[2, 2] = (
        1.0 + cosine * (rx * rx - a2),
        1.0 + cosine * (ry * ry - a2),
        1.0 + cosine * (rz * rz - a2),
    )
    E[0, 1], E[1, 0] = cosine * rx * ry + sine * rz, cosine * rx * ry - sine * rz
    E[0, 2], E[2, 0] = cosine * rx * rz - sine * ry, cosine * rx * rz + sine * ry
    E[1, 2], E[2, 1] = cosine * ry * rz + sine * rx, cosine * ry * rz - sine * rx
    J[0, 0], J[1, 1], J[2, 2] = 1.0 + cubic * (rx * rx - a2), 1.0 + cubic * (ry * ry - a2), 1.0 + cubic * (rz * rz - a2)
    J[0, 1], J[1, 0] = cubic * rx * ry + cosine * rz, cubic * rx * ry - cosine * rz
    J[0, 2], J[2, 0] = cubic * rx * rz - cosine * ry, cubic * rx * rz + cosine * ry
    J[1, 2], J[2, 1] = cubic * ry * rz + cosine * rx, cubic * ry * rz - cosine * rx
