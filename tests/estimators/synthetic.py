"""Trajectories from formulas and the samples perfect or noisy sensors would give: no simulator needed."""

import numpy as np

from estimators import Samples, Site

SITE = Site((0.76, 0.02, 150.0), gravity=9.805, mag_n=(2.3e-5, 4e-7, 4.0e-5))


def from_euler(roll, pitch, yaw):
    """q_nb (n, 4)."""
    r, p, y = (np.asarray(a, float) / 2 for a in (roll, pitch, yaw))
    cr, sr, cp, sp, cy, sy = np.cos(r), np.sin(r), np.cos(p), np.sin(p), np.cos(y), np.sin(y)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        -1,
    )


def matrix_bn(q):
    """C_bn (..., 3, 3) from v' = v + 2 q x (q x v + a v), independent of the package's polynomials."""
    q = np.asarray(q, float)
    a, v = q[..., :1, None], -q[..., 1:]
    zero = np.zeros(q.shape[:-1])
    cross = np.stack(
        [
            np.stack([zero, -v[..., 2], v[..., 1]], -1),
            np.stack([v[..., 2], zero, -v[..., 0]], -1),
            np.stack([-v[..., 1], v[..., 0], zero], -1),
        ],
        -2,
    )
    return np.eye(3) + 2 * a * cross + 2 * cross @ cross


def error_deg(q, truth):
    """Total, tilt and heading error (deg) of q against truth, each (n, 4)."""
    dot = np.abs(np.sum(q * truth, -1)).clip(0, 1)
    C, T = matrix_bn(q), matrix_bn(truth)
    tilt = np.arccos(np.sum(C[..., 2] * T[..., 2], -1).clip(-1, 1))
    yaw = [np.arctan2(M[..., 0, 1], M[..., 0, 0]) for M in (C, T)]
    heading = (yaw[0] - yaw[1] + np.pi) % (2 * np.pi) - np.pi
    return np.degrees(2 * np.arccos(dot)), np.degrees(tilt), np.degrees(heading)


def body_rate(q, dt):
    """Mean rate (n, 3) that turns each q into the next one; the last is repeated."""
    p, r = q[:-1], q[1:]
    vector = p[:, :1] * r[:, 1:] - r[:, :1] * p[:, 1:] - np.cross(p[:, 1:], r[:, 1:])
    scalar = np.sum(p * r, -1, keepdims=True)
    vector, scalar = vector * np.sign(scalar), np.abs(scalar)
    sine = np.linalg.norm(vector, axis=1, keepdims=True)
    rate = 2 * np.arctan2(sine, scalar) * vector / np.maximum(sine, 1e-300) / dt
    return np.vstack([rate[:1], rate])  # the gyro of a row turned the row before it into this one


def flight(
    roll,
    pitch,
    yaw,
    velocity,
    *,
    rate=100.0,
    seed=0,
    noise=1.0,
    gyro_bias=(0.0, 0.0, 0.0),
    mag_every=2,
    site=SITE,
    **columns,
):
    """Samples and true q_nb of a motion given by angles (n,) rad and velocity (n, 3) m/s NED."""
    n, dt = len(roll), 1.0 / rate
    rng = np.random.default_rng(seed)
    q = from_euler(roll, pitch, yaw)
    C = matrix_bn(q)
    acceleration = np.gradient(velocity, dt, axis=0)
    force = np.einsum("kij,kj->ki", C, acceleration - [0.0, 0.0, site.gravity])
    field = np.einsum("kij,j->ki", C, np.array(site.mag_n))
    t = np.arange(n) * dt
    samples = Samples.make(
        t,
        body_rate(q, dt) + gyro_bias + noise * rng.normal(0, 3.7e-3, (n, 3)),
        force + noise * rng.normal(0, 0.02, (n, 3)),
        mag_b=field + noise * rng.normal(0, 5e-7, (n, 3)),
        mag_new=np.arange(n) % mag_every == 0,
        **columns,
    )
    return samples, q


def still(seconds, *, roll=0.05, pitch=0.1, yaw=1.0, rate=100.0, **options):
    """Standing on the ground."""
    n = round(seconds * rate)
    return flight(*(np.full(n, a) for a in (roll, pitch, yaw)), np.zeros((n, 3)), rate=rate, **options)


def coordinated_turn(speed=23.0, bank=0.5236, turn_s=60.0, rate=100.0, ground_s=25.0, **options):
    """Still, a straight run to flying speed, a coordinated turn: samples, truth, in-turn mask."""
    n = round((ground_s + 20 + 4 + turn_s) * rate)
    t = np.arange(n) / rate
    along = speed * np.clip((t - ground_s) / 15.0, 0, 1) ** 2 * (3 - 2 * np.clip((t - ground_s) / 15.0, 0, 1))
    ramp = np.clip((t - ground_s - 20.0) / 4.0, 0, 1)
    roll = bank * ramp**2 * (3 - 2 * ramp)
    yaw_rate = np.where(along > 1.0, 9.805 * np.tan(roll) / np.maximum(along, 1.0), 0.0)
    yaw = 0.5 + np.cumsum(yaw_rate) / rate
    vel = np.stack([along * np.cos(yaw), along * np.sin(yaw), 0 * t], -1)
    gnss_new = np.arange(n) % 20 == 0
    fix = np.maximum.accumulate(np.where(gnss_new, np.arange(n), 0))
    samples, q = flight(
        roll, 0 * t, yaw, vel, rate=rate,
        airspeed=along, air_new=np.arange(n) % 4 == 0,
        vel_n=vel[fix], gnss_t=t[fix], gnss_new=gnss_new, **options,
    )  # fmt: skip
    return samples, q, t > ground_s + 20 + 4 + 5
