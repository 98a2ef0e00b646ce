"""Gyro bias from standing, hard and soft iron from turning: fitted on one part of a recording, tried on the other."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.recordings.inertial import Track, course_of
from ahrs_sim.recordings.survey import BIN_S, Survey
from ahrs_sim.world.gravity import STANDARD as G

_SOFT_SIGMA = 0.1  # what soft iron may be without evidence
_HARD_SIGMA = 1e-4  # T
_NORM_SIGMA = 0.3  # share by which the field may differ from what the readings suggest, where no place gives it
_POINTS = 3000
_WORTH = 100  # independent readings of 1 uT, in the fit
_DIRECTIONS = 12  # independent readings, in the sigmas: what is wrong with a field is wrong for a place and a direction
_SIGNIFICANT = 2.5  # sigmas
_FAR = 1e6  # of the median, T: what is larger is no reading
_QUIET = 2e-7  # T: no sigma is smaller
_TURN_BINS = 10
_LOSS = 1e-6  # T: a field's error from which on a reading counts as disturbed


def gyro_bias(s: Survey) -> tuple[np.ndarray, float] | None:
    """Compute the mean rate (3,) rad/s of the standing stretches in FRD, and their length in s; None without any."""
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
    """Find pairs `bins` bins apart with a turn of a few degrees or more.

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
        q = attitude.product(attitude.exponential(angle), q)
    whole = np.abs(s.t[bins:] - s.t[:n] - bins * BIN_S) < 0.5 * BIN_S
    turned = np.linalg.norm(q[:, 1:], axis=1) > math.sin(math.radians(2.5))
    good = np.flatnonzero(whole & turned & np.isfinite(s.mag[:n] + s.mag[bins:]).all(axis=1))
    good = good[:: max(1, len(good) // _POINTS)]
    eye = np.eye(3)
    C = np.stack([attitude.to_nav(q[good], np.tile(e, (len(good), 1))) for e in eye], axis=-1)
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
    near = np.abs(mag).max(axis=1) < _FAR * scale  # single readings of a damaged file are anything
    if not 0.0 < scale < _FAR or near.sum() < 50:
        return None
    mag = mag[near]
    sound = np.abs(np.concatenate([turned.before, turned.after], axis=1)).max(axis=1) < _FAR * scale
    turned = Turns(turned.before[sound], turned.after[sound], turned.C[sound])
    centre = _centre(mag, turned, scale)
    points = _thinned(mag, centre)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / math.sqrt(len(points))
    if spread[1] < 0.05 * scale:
        return None
    target = field or float(np.median(np.linalg.norm(points - centre, axis=1)))
    weights = [math.sqrt(min(1.0, _WORTH / max(n, 1))) for n in (len(points), len(turned.C))]

    def unpack(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b, c, d, e, f = x[3:9]
        return x[:3] * target, np.array([[1 + a, d, e], [d, 1 + b, f], [e, f, 1 + c]])

    def soft_l1(error: np.ndarray, weight: float) -> np.ndarray:
        r = error / _LOSS  # by hand: the priors below must not be softened
        softened: np.ndarray = weight * np.sign(r) * np.sqrt(2.0 * (np.sqrt(1.0 + r * r) - 1.0))
        return softened

    def cost(x: np.ndarray, out: np.ndarray) -> np.ndarray:
        hard, soft = unpack(x)
        norm = np.linalg.norm((points - hard) @ soft, axis=1) - target * (1.0 + x[9])
        turn = np.einsum("nij,nj->ni", turned.C, (turned.before - hard) @ soft) - (turned.after - hard) @ soft
        return np.concatenate(
            [soft_l1(norm, weights[0]), soft_l1(turn.ravel(), weights[1]), x / prior, 1e6 * (out @ x)]
        )

    def best(out: np.ndarray) -> Any:
        found: Any = None
        for start in (centre, np.zeros(3)):
            result = least_squares(cost, np.r_[start / target, np.zeros(7)], method="lm", args=(out,))
            if found is None or result.cost < found.cost:
                found = result
        return found

    prior = np.r_[np.full(3, _HARD_SIGMA / target), np.full(6, _SOFT_SIGMA), 1e-6 if field else _NORM_SIGMA]
    first = best(np.empty((0, 10)))
    hard, soft = unpack(first.x)
    scatter = max(_QUIET, _mad(np.linalg.norm((points - hard) @ soft, axis=1)))
    data = first.jac[: len(points) + 3 * len(turned.C)]
    worth = _DIRECTIONS / _WORTH * (_LOSS / scatter) ** 2
    covariance = np.linalg.inv(worth * data.T @ data + np.diag(prior**-2))
    found = best(_unseen(first.x, covariance))
    hard, soft = unpack(found.x)
    norms = np.linalg.norm((mag - hard) @ soft, axis=1)
    return MagFit(
        hard_iron=hard,
        soft_iron=soft,
        hard_sigma=np.sqrt(np.diag(covariance)[:3]) * target,
        before=float(np.std(np.linalg.norm(mag, axis=1))),
        after=float(np.std(norms)),
    )


def _unseen(x: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Find directions (k, 10) of hard and soft iron in which the estimate (10,) is within its sigma."""
    out = []
    for block in (slice(0, 3), slice(3, 9)):
        values, vectors = np.linalg.eigh(covariance[block, block])
        for value, vector in zip(values, vectors.T, strict=True):
            if abs(float(vector @ x[block])) < _SIGNIFICANT * math.sqrt(max(float(value), 0.0)):
                whole = np.zeros(10)
                whole[block] = vector
                out.append(whole)
    return np.array(out).reshape(-1, 10)


def _mad(values: np.ndarray) -> float:
    """Standard deviation by the median of deviations, which a few disturbed readings leave alone."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


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
    """Choose at most `_POINTS` readings, spread over the directions as evenly as possible."""
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


# ----------------------------------------------------------------------------------------------- is it worth it


_PART_S = 10.0
_LEAST = 50  # readings
_TURNED = 0.3  # least eigenvalue of a soft iron: iron weakens a field, it does not turn it round
_BETTER = 0.85  # share of the disagreement that may be left where a calibration is kept
_NOT_WORSE = 1.15
_WORDS = {"norm": "norm", "turn": "turning", "dip": "dip", "course": "course"}


@dataclass(frozen=True)
class Trial:
    """A calibration and what became of it on the parts of the recording that it was not fitted to."""

    fit: MagFit | None  # None: nothing to be taken out
    line: str  # "kept" or "refused, because", for the user
    left: float  # T, sigma of the hard iron that stays; NaN: not known


def try_mag(s: Survey, axes: np.ndarray, field: float | None, track: Track | None) -> Trial:
    """Fit hard and soft iron on alternate parts of a recording, compare on the others, keep what agrees better there.

    Compared are the norm of the field, how it turns against the gyro, its angle to gravity, and its direction against
    the course of GNSS and IMU, where there is one.

    Args:
        s: the survey.
        axes: (3, 3) from the axes of the magnetometer's messages to FRD.
        field: T, norm of the field of the place; None: not known.
        track: IMU and GNSS velocity together.
    """
    whole = fit_mag(s.mag, turns(s, axes), field)
    if whole is None:
        return Trial(None, "refused, because there is too little turning to tell iron from field", math.nan)
    hard, soft, left = whole.hard_iron, whole.soft_iron, float(np.max(whole.hard_sigma))
    if np.linalg.norm(hard) < 1e-8 and np.abs(soft - np.eye(3)).max() < 1e-4:
        return Trial(None, f"refused, because no iron stands out of what it can tell ({1e6 * left:.1f} uT)", left)
    if np.linalg.eigvalsh(soft)[0] < _TURNED:
        return Trial(None, "refused, because its axes are not those of the IMU", left)
    part = (track.windows.number if track else np.floor(s.t / _PART_S).astype(int)) % 2
    known = np.isfinite(s.mag).all(axis=1)
    if min(int(np.sum(known & (part == k))) for k in (0, 1)) < _LEAST:
        return Trial(None, "refused, because the recording is too short to try it on a part of it", left)
    before: dict[str, list[float]] = {}
    after: dict[str, list[float]] = {}
    for k in (0, 1):
        fit = fit_mag(s.mag[part == k], turns(_only(s, part == k), axes), field)
        if fit is None:
            return Trial(None, "refused, because half of the recording has too little turning to try it on", left)
        rest = _only(s, part != k)
        for found, iron in ((before, (np.zeros(3), np.eye(3))), (after, (fit.hard_iron, fit.soft_iron))):
            for name, value in _disagreement(rest, iron, axes, field, track).items():
                found.setdefault(name, []).append(value)
    ratio = {name: float(np.mean(after[name]) / np.mean(values)) for name, values in before.items()}
    total = [math.sqrt(sum(float(np.mean(v)) ** 2 for v in found.values())) for found in (before, after)]
    changes = ", ".join(f"{_WORDS[name]} {_shown(name, before[name])} -> {_shown(name, after[name])}" for name in ratio)
    worse = [
        name for name, r in ratio.items() if r > _NOT_WORSE and np.mean(after[name]) - np.mean(before[name]) > 2e-3
    ]
    if worse:
        return Trial(
            None, f"refused, because on what it was not fitted to the {_WORDS[worse[0]]} gets worse ({changes})", left
        )
    if total[1] > _BETTER * total[0]:
        return Trial(None, f"refused, because what it was not fitted to agrees no better ({changes})", left)
    return Trial(whole, f"kept: on what it was not fitted to, {changes}", left)


def _shown(name: str, values: list[float]) -> str:
    value = float(np.mean(values))
    return f"{math.degrees(value):.1f} deg" if name in ("dip", "course") else f"{100 * value:.1f} %"


def _only(s: Survey, bins: np.ndarray) -> Survey:
    """Keep the magnetometer of some bins (n,) of a survey only; time goes on."""
    return replace(s, mag=np.where(bins[:, None], s.mag, np.nan))


def _disagreement(
    s: Survey, iron: tuple[np.ndarray, np.ndarray], axes: np.ndarray, field: float | None, track: Track | None
) -> dict[str, float]:
    """Measure how far a field without hard and soft iron is off: shares of the field, and rad."""
    hard, soft = iron
    mag_b = (s.mag - hard) @ (axes @ soft).T
    norm = np.linalg.norm(mag_b, axis=1)
    target = field or float(np.nanmedian(norm))
    off = np.abs(norm[np.isfinite(norm)] / target - 1.0)
    found = {"norm": math.sqrt(float(np.mean(np.minimum(off, 3.0 * np.median(off)) ** 2)))}
    pairs = turns(s, axes)
    if len(pairs.C) > 50:
        left = np.einsum("nij,nj->ni", pairs.C, (pairs.before - hard) @ soft) - (pairs.after - hard) @ soft
        found["turn"] = float(np.median(np.linalg.norm(left, axis=1))) / target
    force = np.linalg.norm(s.accel_b, axis=1)
    calm = np.isfinite(norm) & (np.abs(force - G) < 0.3)
    if calm.sum() > 50:
        sine = -np.sum(mag_b[calm] * s.accel_b[calm], axis=1) / (norm[calm] * force[calm])
        found["dip"] = _mad(np.arcsin(np.clip(sine, -1.0, 1.0)))
    if track is not None and (course := course_of(mag_b, track)) is not None:
        found["course"] = course.spread
    return found
