"""Gyro bias from standing, hard and soft iron from turning: fitted on one part of a recording, tried on the other."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim.recordings import frames
from ahrs_sim.recordings.survey import BIN_S, Survey

_SOFT_SIGMA = 0.1  # what soft iron may be without evidence
_HARD_SIGMA = 1e-4  # T
_POINTS = 3000
_WORTH = 100
_TURN_BINS = 10
_LOSS = 1e-6  # T: a field's error from which on a reading counts as disturbed


def gyro_bias(s: Survey) -> tuple[np.ndarray, float] | None:
    """Mean rate (3,) rad/s of the standing stretches in FRD, and their length in s; None without any."""
    still = s.still
    seconds = float(still.sum()) * BIN_S
    return (np.mean(s.gyro_b[still], axis=0), seconds) if seconds >= 1.0 else None


@dataclass(frozen=True)
class MagFit:
    """Result of `fit_mag`."""

    hard_iron: np.ndarray  # (3,) T
    soft_iron: np.ndarray  # (3, 3) symmetric
    hard_sigma: np.ndarray  # (3,) T
    before: float  # T, scatter of the norm
    after: float


@dataclass(frozen=True)
class Turns:
    """Pairs of readings of the magnetometer, and how the gyro says that it turned between them."""

    before: np.ndarray  # (m, 3) T
    after: np.ndarray  # (m, 3) T
    C: np.ndarray  # (m, 3, 3) takes the field in its axes before to that after


def turns(s: Survey, axes: np.ndarray, bins: int = _TURN_BINS) -> Turns:
    """Pairs `bins` bins apart with a turn of a few degrees or more.

    Args:
        s: the survey.
        axes: (3, 3) from the axes of the magnetometer's messages to FRD.
        bins: how far apart.
    """
    n = max(len(s.t) - bins, 0)
    found = gyro_bias(s)
    rate = (s.gyro_b - (found[0] if found else 0.0)) @ axes
    q = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    for k in range(bins):  # from the middle of a bin to that of the next
        angle = -0.5 * (rate[k : k + n] + rate[k + 1 : k + 1 + n]) * BIN_S
        norm = np.linalg.norm(angle, axis=1, keepdims=True)
        step = np.concatenate([np.cos(norm / 2), 0.5 * np.sinc(norm / (2 * math.pi)) * angle], axis=1)
        q = frames.product(step, q)
    whole = np.abs(s.t[bins:] - s.t[:n] - bins * BIN_S) < 0.5 * BIN_S
    turned = np.linalg.norm(q[:, 1:], axis=1) > math.sin(math.radians(2.5))
    good = np.flatnonzero(whole & turned & np.isfinite(s.mag[:n] + s.mag[bins:]).all(axis=1))
    good = good[:: max(1, len(good) // _POINTS)]
    eye = np.eye(3)
    C = np.stack([frames.rotate(q[good], np.tile(e, (len(good), 1))) for e in eye], axis=-1)
    return Turns(s.mag[good], s.mag[good + bins], C)


def fit_mag(mag: np.ndarray, turned: Turns, field: float | None) -> MagFit | None:
    """Hard and soft iron: soft (raw - hard) has the norm of the field and turns as the gyro says.

    The norm alone is an ellipsoid fit, which a vehicle that never banks far leaves open in one direction; the turns
    close it. Readings are thinned to equal numbers from all directions; together they count as `_WORTH` independent
    ones, since what is wrong with them is wrong for seconds; a prior of 10 % on soft iron keeps directions never seen
    from deforming it, and readings off by much more than `_LOSS` count little.

    Args:
        mag: (n, 3) T as reported; rows of NaN are left out.
        turned: see `turns`.
        field: T; None: the median norm about the centre of the best sphere.

    Returns:
        None when there are too few readings or too little turning for a centre.
    """
    from scipy.optimize import least_squares

    mag = mag[np.isfinite(mag).all(axis=1)]
    if len(mag) < 50:
        return None
    scale = float(np.median(np.linalg.norm(mag, axis=1)))
    if scale <= 0.0:
        return None
    centre = _centre(mag, turned, scale)
    points = _thinned(mag, centre)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / math.sqrt(len(points))
    if spread[1] < 0.05 * scale:
        return None
    target = field or float(np.median(np.linalg.norm(points - centre, axis=1)))
    weights = [math.sqrt(min(1.0, _WORTH / max(n, 1))) for n in (len(points), len(turned.C))]

    def unpack(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b, c, d, e, f = x[3:]
        return x[:3] * target, np.array([[1 + a, d, e], [d, 1 + b, f], [e, f, 1 + c]])

    def soft_l1(error: np.ndarray, weight: float) -> np.ndarray:
        r = error / _LOSS  # by hand: the priors below must not be softened
        softened: np.ndarray = weight * np.sign(r) * np.sqrt(2.0 * (np.sqrt(1.0 + r * r) - 1.0))
        return softened

    def cost(x: np.ndarray) -> np.ndarray:
        hard, soft = unpack(x)
        norm = np.linalg.norm((points - hard) @ soft, axis=1) - target
        turn = np.einsum("nij,nj->ni", turned.C, (turned.before - hard) @ soft) - (turned.after - hard) @ soft
        return np.concatenate(
            [
                soft_l1(norm, weights[0]),
                soft_l1(turn.ravel(), weights[1]),
                x[3:] / _SOFT_SIGMA,
                x[:3] * target / _HARD_SIGMA,
            ]
        )

    best: Any = None
    for start in (centre, np.zeros(3)):
        result = least_squares(cost, np.r_[start / target, np.zeros(6)], method="lm")
        if best is None or result.cost < best.cost:
            best = result
    hard, soft = unpack(best.x)
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    norms = np.linalg.norm((mag - hard) @ soft, axis=1)
    return MagFit(
        hard_iron=hard,
        soft_iron=soft,
        hard_sigma=np.sqrt(np.diag(covariance)[:3]) * target,
        before=float(np.std(np.linalg.norm(mag, axis=1))),
        after=float(np.std(norms)),
    )


def _centre(mag: np.ndarray, turned: Turns, scale: float) -> np.ndarray:
    """Hard iron (3,) without soft iron, linear least squares on the turns, or on a sphere without them."""
    if len(turned.C) >= 20:
        A = (turned.C - np.eye(3)).reshape(-1, 3)
        b = (np.einsum("nij,nj->ni", turned.C, turned.before) - turned.after).ravel()
        centre: np.ndarray = np.linalg.lstsq(A, b, rcond=1e-3)[0]
        return centre
    return _sphere(mag, scale)


def _sphere(mag: np.ndarray, scale: float) -> np.ndarray:
    """Centre (3,) of the best sphere, linear least squares."""
    A = np.column_stack([2 * mag / scale, np.ones(len(mag))])
    x = np.linalg.lstsq(A, np.sum((mag / scale) ** 2, axis=1), rcond=1e-6)[0]
    centre: np.ndarray = x[:3] * scale
    return centre


def _thinned(mag: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """At most `_POINTS` readings, as evenly over the directions as they come."""
    u = (mag - centre) / np.maximum(np.linalg.norm(mag - centre, axis=1, keepdims=True), 1e-12)
    cell = np.floor((u[:, 2] + 1.0) * 5.99).astype(int) * 24 + np.floor(
        (np.arctan2(u[:, 1], u[:, 0]) + math.pi) / (2 * math.pi) * 23.99
    ).astype(int)
    order = np.argsort(cell, kind="stable")
    first = np.r_[0, np.flatnonzero(np.diff(cell[order])) + 1]
    rank = np.arange(len(order)) - np.repeat(first, np.diff(np.r_[first, len(order)]))
    size = np.repeat(np.diff(np.r_[first, len(order)]), np.diff(np.r_[first, len(order)]))
    share = max(1, _POINTS // len(first))
    step = np.maximum(1.0, size / share)
    keep = np.floor(rank / step) != np.floor((rank - 1) / step)
    thinned: np.ndarray = mag[np.sort(order[keep])]
    return thinned
