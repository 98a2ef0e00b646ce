"""Attitudes in bulk: every rotation of this package that is not inside a compiled kernel, on arrays (..., 4).

Inside kernels it is `estimators.rotations`. Quaternions are scalar first, Hamilton, body to navigation: `q_nb` turns
body vectors into north, east, down. Angles are in rad. Source: Titterton and Weston, *Strapdown Inertial Navigation
Technology*, 2nd edition, section 3.6.
"""

import math

import numpy as np

GAP = 5.0
"""Periods of a series; where its samples are further apart it is not interpolated."""


def wrap(angle: np.ndarray) -> np.ndarray:
    """Wrap angles into (-pi, pi]."""
    wrapped: np.ndarray = np.pi - np.mod(np.pi - angle, 2 * np.pi)
    return wrapped


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Multiply quaternions (..., 4), which broadcast: `p (x) q`, the turn q in the axes that p leads out of."""
    a, b = p[..., :1], p[..., 1:]
    c, d = q[..., :1], q[..., 1:]
    return np.concatenate([a * c - np.sum(b * d, axis=-1, keepdims=True), a * d + c * b + np.cross(b, d)], axis=-1)


def conjugate(q: np.ndarray) -> np.ndarray:
    """Conjugate quaternions (..., 4): of unit quaternions, the inverse."""
    return np.concatenate([q[..., :1], -q[..., 1:]], axis=-1)


def difference(p: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute `conj(p) (x) q`: scalar (n, 1) and vector (n, 3) of the turn from p to q in body axes."""
    scalar = np.sum(p * q, axis=1, keepdims=True)
    vector: np.ndarray = p[:, :1] * q[:, 1:] - q[:, :1] * p[:, 1:] - np.cross(p[:, 1:], q[:, 1:])
    return scalar, vector


def rotation_vector(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Compute rotation vectors r (n, 3), body axes, that turn p into q the short way: `q = p (x) exp(r)`."""
    scalar, vector = difference(p, q)
    vector = np.where(scalar < 0, -vector, vector)
    sine = np.linalg.norm(vector, axis=1, keepdims=True)
    small = sine < 1e-8
    scale = np.where(small, 2.0, 2.0 * np.arctan2(sine, np.abs(scalar)) / np.where(small, 1.0, sine))
    return np.asarray(scale * vector)


def exponential(r: np.ndarray) -> np.ndarray:
    """Make quaternions (n, 4) of rotation vectors (n, 3)."""
    norm = np.linalg.norm(r, axis=1, keepdims=True)
    return np.concatenate([np.cos(norm / 2), 0.5 * np.sinc(norm / (2 * math.pi)) * r], axis=1)


def by_rotation(q: np.ndarray) -> np.ndarray:
    """Slope (4, 3) of `q (x) exp(r)` by r at r = 0, for one quaternion (4,)."""
    a, b, c, d = q
    return 0.5 * np.array([[-b, -c, -d], [a, -d, c], [d, a, -b], [-c, b, a]])


def to_nav(q_nb: np.ndarray, vector_b: np.ndarray) -> np.ndarray:
    """Turn body vectors (n, 3) into navigation axes."""
    t = 2.0 * np.cross(q_nb[:, 1:], vector_b)
    turned: np.ndarray = vector_b + q_nb[:, :1] * t + np.cross(q_nb[:, 1:], t)
    return turned


def to_body(q_nb: np.ndarray, vector_n: np.ndarray) -> np.ndarray:
    """Turn navigation vectors (n, 3) into body axes."""
    return to_nav(conjugate(q_nb), vector_n)


def euler(q_nb: np.ndarray) -> np.ndarray:
    """Roll, pitch, heading (n, 3) of quaternions (n, 4); heading in (-pi, pi]."""
    a, b, c, d = q_nb.T
    roll = np.arctan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c))
    pitch = np.arcsin(np.clip(2 * (a * c - b * d), -1.0, 1.0))
    heading = np.arctan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d))
    return np.column_stack([roll, pitch, heading])


def from_euler(angles: np.ndarray) -> np.ndarray:
    """Make quaternions (n, 4) of roll, pitch, heading (n, 3)."""
    return from_half_angles(*(0.5 * angle for angle in angles.T))


def from_half_angles(roll: np.ndarray, pitch: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Make quaternions (n, 4) of halves of roll, pitch and heading, (n,) each."""
    (c0, c1, c2), (s0, s1, s2) = ([f(half) for half in (roll, pitch, heading)] for f in (np.cos, np.sin))
    return np.stack(
        [
            c0 * c1 * c2 + s0 * s1 * s2,
            s0 * c1 * c2 - c0 * s1 * s2,
            c0 * s1 * c2 + s0 * c1 * s2,
            c0 * c1 * s2 - s0 * s1 * c2,
        ],
        axis=-1,
    )


def matrix(roll: float, pitch: float, heading: float) -> np.ndarray:
    """Make the rotation (3, 3) from axes turned by heading, pitch, roll (in this order) to those before."""
    cr, sr, cp, sp, cy, sy = (f(x) for x in (roll, pitch, heading) for f in (math.cos, math.sin))
    return np.array(
        [
            [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp],
        ]
    )


def cross_matrices(v: np.ndarray) -> np.ndarray:
    """Make the matrices (n, 3, 3) of `v x` for vectors v (n, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return out


def rotation_matrix(turn: np.ndarray) -> np.ndarray:
    """Make the rotation (3, 3) of a rotation vector (3,), rad (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    K = cross_matrices(turn[None])[0]
    if angle < 1e-9:
        return np.asarray(np.eye(3) + K)
    return np.asarray(np.eye(3) + math.sin(angle) / angle * K + (1 - math.cos(angle)) / angle**2 * K @ K)


def euler_of(C: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (3,) rad of a rotation matrix (3, 3)."""
    level = math.hypot(C[0, 0], C[1, 0])
    if level < 1e-6:  # straight up or down: roll is what is left
        return np.array([math.atan2(-C[1, 2], C[1, 1]), math.atan2(-C[2, 0], level), 0.0])
    return np.array([math.atan2(C[2, 1], C[2, 2]), math.atan2(-C[2, 0], level), math.atan2(C[1, 0], C[0, 0])])


def down(q_nb: np.ndarray) -> np.ndarray:
    """Down in body axes (n, 3), the third row of C_nb: the tilt without the heading."""
    a, b, c, d = q_nb.T
    return np.column_stack([2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)])


def roll_pitch(down_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch (n,) of the down direction in body axes (n, 3)."""
    return np.arctan2(down_b[:, 1], down_b[:, 2]), np.arcsin(np.clip(-down_b[:, 0], -1.0, 1.0))


def interpolate(t: np.ndarray, q_nb: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate quaternions to times: (m, 4) at `at` (m,) from samples `q_nb` (n, 4) at rising times `t` (n,).

    Linear and normalised between neighbours: at 100 Hz and 2 rad/s off by less than 1e-4 deg. NaN outside of `t`, and
    between neighbours more than `GAP` periods apart; the period is what nine tenths of the samples keep to.
    """
    right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    left = right - 1
    span = t[right] - t[left]
    weight = np.where(span > 0, (at - t[left]) / np.where(span > 0, span, 1.0), 0.0)[:, None]
    sign = np.where(np.sum(q_nb[left] * q_nb[right], axis=1) < 0, -1.0, 1.0)[:, None]
    q: np.ndarray = (1 - weight) * q_nb[left] + weight * sign * q_nb[right]
    with np.errstate(invalid="ignore"):  # a reference of zeros is none
        q /= np.linalg.norm(q, axis=1, keepdims=True)
    longest = GAP * np.quantile(np.diff(t), 0.9, method="lower") if len(t) > 2 else np.inf
    gap = (span > longest) & (at > t[left] + 1e-9) & (at < t[right] - 1e-9)
    q[gap | (at < t[0] - 1e-9) | (at > t[-1] + 1e-9)] = np.nan
    return q
