"""How the state moves: attitude, velocity and place at every row, their transition beside them.

w = (I + M_g)^-1 (gyro - b),   f = (I + M_a)^-1 (accel - b)
phi' = -C_nb (K_g d b + E_g w),   d v' = phi x C_nb f - C_nb (K_a d b + E_a f),   d p' = d v,   K = (I + M)^-1
"""

from typing import Any

import numpy as np

from estimators.earth import GRAVITY_GRADIENT, frame_rates, move
from estimators.jit import inner
from estimators.native import local
from estimators.navigator.layout import (
    ACCEL_BIAS,
    ACCEL_MATRIX,
    COUPLED,
    GYRO_BIAS,
    GYRO_FAST,
    GYRO_MATRIX,
    GYRO_SLOW,
    PHI,
    POS,
    VEL,
    Batch,
    Nominal,
    Parameters,
)
from estimators.rotations import attitude_matrix, nav_vector, turn_nav, turned

Triple = Any  # a tuple of three: it stays in registers


@inner
def calibrated(c: np.ndarray, matrix: int, x: float, y: float, z: float) -> Triple:
    """`(I + M)^-1 (x, y, z)` of the matrix at an offset, to third order in M."""
    u, v, w = x, y, z
    for _ in range(3):
        u, v, w = (
            x - (c[matrix] * u + c[matrix + 1] * v + c[matrix + 2] * w),
            y - (c[matrix + 3] * u + c[matrix + 4] * v + c[matrix + 5] * w),
            z - (c[matrix + 6] * u + c[matrix + 7] * v + c[matrix + 8] * w),
        )
    return u, v, w


@inner
def true_rate(c: np.ndarray, gyro: np.ndarray) -> Triple:
    """Angular rate (rad/s) of a gyro reading."""
    x = gyro[0] - c[GYRO_BIAS] - c[GYRO_FAST] - c[GYRO_SLOW]
    y = gyro[1] - c[GYRO_BIAS + 1] - c[GYRO_FAST + 1] - c[GYRO_SLOW + 1]
    z = gyro[2] - c[GYRO_BIAS + 2] - c[GYRO_FAST + 2] - c[GYRO_SLOW + 2]
    return calibrated(c, GYRO_MATRIX, x, y, z)


@inner
def true_force(c: np.ndarray, accel: np.ndarray) -> Triple:
    """Specific force (m/s2) of an accelerometer reading."""
    x, y, z = accel[0] - c[ACCEL_BIAS], accel[1] - c[ACCEL_BIAS + 1], accel[2] - c[ACCEL_BIAS + 2]
    return calibrated(c, ACCEL_MATRIX, x, y, z)


@inner
def advance(
    model: Parameters,
    nominal: Nominal,
    batch: Batch,
    C: np.ndarray,
    w: Triple,
    f: Triple,
    steady: np.ndarray,
    dt: float,
) -> Triple:
    """Move the state by dt with rate w and force f, the transition with `steady`; the force in navigation axes."""
    q, v, lla = nominal.q, nominal.v, nominal.lla
    north, east, down = v[0], v[1], v[2]
    ie_n, ie_d, en_n, en_e, en_d = frame_rates(lla, v)
    hx, hy, hz = 0.5 * dt * w[0], 0.5 * dt * w[1], 0.5 * dt * w[2]
    half = turned(q, hx, hy, hz)
    turn_nav(turned(half, hx, hy, hz), -(ie_n + en_n) * dt, -en_e * dt, -(ie_d + en_d) * dt, q)
    f_n = nav_vector(half, f[0], f[1], f[2])
    wn, we, wd = 2.0 * ie_n + en_n, en_e, 2.0 * ie_d + en_d
    gravity = model.gravity - GRAVITY_GRADIENT * (lla[2] - model.origin[2])
    v[0] = north + (f_n[0] - (we * down - wd * east)) * dt
    v[1] = east + (f_n[1] - (wd * north - wn * down)) * dt
    v[2] = down + (f_n[2] + gravity - (wn * east - we * north)) * dt
    here = (lla[0], lla[1], lla[2])
    move(here, 0.5 * (north + v[0]) * dt, 0.5 * (east + v[1]) * dt, 0.5 * (down + v[2]) * dt, lla)
    between = local(4)
    for i in range(4):
        between[i] = half[i]
    attitude_matrix(between, C)
    x, y, z = steady[1, 0], steady[1, 1], steady[1, 2]
    steady_b = (
        C[0, 0] * x + C[0, 1] * y + C[0, 2] * z,
        C[1, 0] * x + C[1, 1] * y + C[1, 2] * z,
        C[2, 0] * x + C[2, 1] * y + C[2, 2] * z,
    )
    transition(batch.F, C, nominal.c, (steady[0, 0], steady[0, 1], steady[0, 2]), steady_b, (x, y, z), dt)
    batch.seconds += dt
    return f_n


@inner
def transition(F: np.ndarray, C: np.ndarray, c: np.ndarray, w: Triple, f: Triple, f_n: Triple, dt: float) -> None:
    """`F` = transition of dt times F; C = C_bn(half-way)."""
    for k in range(COUPLED):
        F[POS, k] += dt * F[VEL, k]
        F[POS + 1, k] += dt * F[VEL + 1, k]
        F[POS + 2, k] += dt * F[VEL + 2, k]
        x, y, z = dt * F[PHI, k], dt * F[PHI + 1, k], dt * F[PHI + 2, k]
        F[VEL, k] += y * f_n[2] - z * f_n[1]
        F[VEL + 1, k] += z * f_n[0] - x * f_n[2]
        F[VEL + 2, k] += x * f_n[1] - y * f_n[0]
    for a in range(3):
        x, y, z = -C[0, a] * dt, -C[1, a] * dt, -C[2, a] * dt
        for i in range(3):
            share = -C[i, a] * dt
            m = GYRO_MATRIX + i  # C_nb (I + M)^-1 to first order
            of_bias = share - (x * c[m] + y * c[m + 3] + z * c[m + 6])
            F[PHI + a, GYRO_BIAS + i] += of_bias
            F[PHI + a, GYRO_FAST + i] += of_bias
            F[PHI + a, GYRO_SLOW + i] += of_bias
            m = ACCEL_MATRIX + i
            F[VEL + a, ACCEL_BIAS + i] += share - (x * c[m] + y * c[m + 3] + z * c[m + 6])
            for j in range(3):
                F[PHI + a, GYRO_MATRIX + 3 * i + j] += share * w[j]
                F[VEL + a, ACCEL_MATRIX + 3 * i + j] += share * f[j]
