"""One look at a whole recording before estimators run: are the axes right, when did it stand, where is the hard iron.

Everything is kept as means over a tenth of a second, so an hour takes a few megabytes.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim.evaluation.metrics import interpolate
from ahrs_sim.evaluation.sync import rates, time_shift
from ahrs_sim.recordings import frames
from ahrs_sim.sensors.records import SuiteBlock

BIN_S = 0.1
STILL_RATE, STILL_FORCE = math.radians(0.5), 0.15  # rad/s, m/s2: scatter within a second of standing
STILL_TURN = math.radians(3.0)  # rad/s: a mean that could be a bias
G = 9.80665
_SOFT_SIGMA = 0.1  # what soft iron may be without evidence
_HARD_SIGMA = 1e-4  # T
_POINTS = 3000
_WORTH = 100
_TURN_BINS = 10
_LOSS = 1e-6  # T: a field's error from which on a reading counts as disturbed


@dataclass
class Survey:
    """Means over bins of `BIN_S`, in FRD; the magnetometer as reported (T, axes of its messages)."""

    t: np.ndarray  # (n,) s, mean of the stamps
    gyro_b: np.ndarray  # (n, 3) rad/s
    accel_b: np.ndarray  # (n, 3) m/s2
    scatter: np.ndarray  # (n, 2) greatest deviation of gyro and accelerometer within the bin
    mag: np.ndarray  # (n, 3) T; NaN without
    rate: float  # Hz, of the IMU
    lla: np.ndarray | None  # (3,) rad, rad, m: first fix
    t_reference: np.ndarray  # (m,) s
    q_nb: np.ndarray  # (m, 4)

    @property
    def still(self) -> np.ndarray:
        """Bins (n,) in the middle of a second of standing."""
        n = len(self.t)
        if not n:
            return np.zeros(0, bool)
        half = max(1, round(0.5 / BIN_S))
        padded = np.pad(np.column_stack([self.gyro_b, self.accel_b]), ((half, half), (0, 0)), mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
        span = windows.max(axis=-1) - windows.min(axis=-1)
        quiet = (span[:, :3].max(axis=1) < 2 * STILL_RATE) & (span[:, 3:].max(axis=1) < 2 * STILL_FORCE)
        quiet &= np.linalg.norm(self.gyro_b, axis=1) < STILL_TURN
        still: np.ndarray = quiet & (self.scatter[:, 0] < 3 * STILL_RATE) & (self.scatter[:, 1] < 6 * STILL_FORCE)
        return still


def look(blocks: Iterable[SuiteBlock]) -> Survey:
    """Survey records made without calibration: their magnetometer is in the axes of its messages."""
    inertial: list[np.ndarray] = []
    magnetic: list[np.ndarray] = []
    times: list[np.ndarray] = []
    attitudes: list[np.ndarray] = []
    intervals: list[float] = []
    lla = None
    for block in blocks:
        imu: Any = block["imu"]
        t = imu.stamp_ns * 1e-9
        if len(t) > 1:
            intervals.append(float(np.median(np.diff(t))))
        inertial.append(_bins(t, np.column_stack([t, imu.gyro_b, imu.accel_b])))
        field: Any = block.get("mag")
        if field is not None:
            magnetic.append(_bins(field.stamp_ns * 1e-9, field.mag_b))
        fix: Any = block.get("fix")
        if lla is None and fix is not None:
            good = np.isfinite(fix.lla_deg).all(axis=1)
            if good.any():
                lla = fix.lla_deg[good][0] * np.array([math.pi / 180, math.pi / 180, 1.0])
        reference: Any = block.get("reference")
        if reference is not None:
            known = np.isfinite(reference.q_nb).all(axis=1)
            times.append(reference.stamp_ns[known] * 1e-9)
            attitudes.append(reference.q_nb[known])
    rows = np.concatenate([*inertial, np.empty((0, 16))])
    fields = np.concatenate([*magnetic, np.empty((0, 8))])
    mag = np.full((len(rows), 3), np.nan)
    _, here, there = np.intersect1d(rows[:, 0], fields[:, 0], return_indices=True)
    mag[here] = fields[there, 2:5]
    return Survey(
        t=rows[:, 2],
        gyro_b=rows[:, 3:6],
        accel_b=rows[:, 6:9],
        scatter=np.column_stack([rows[:, 10:13].max(axis=1, initial=0), rows[:, 13:16].max(axis=1, initial=0)]),
        mag=mag,
        rate=1.0 / float(np.median(intervals)) if intervals else math.nan,
        lla=lla,
        t_reference=np.concatenate([*times, np.empty(0)]),
        q_nb=np.concatenate([*attitudes, np.empty((0, 4))]),
    )


def _bins(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Number, count, mean (k) and greatest deviation (k) of each bin: (m, 2 + 2k); one cut by a block counts as two."""
    good = np.isfinite(values).all(axis=1)
    number, values = np.floor(t[good] / BIN_S), values[good]
    if not len(number):
        return np.empty((0, 2 + 2 * values.shape[1]))
    first = np.flatnonzero(np.r_[True, np.diff(number) != 0])
    count = np.diff(np.r_[first, len(number)])
    mean = np.add.reduceat(values, first) / count[:, None]
    deviation = np.maximum.reduceat(np.abs(values - np.repeat(mean, count, axis=0)), first)
    return np.column_stack([number[first], count, mean, deviation])


# ----------------------------------------------------------------------------------------------- checks


def suspicions(
    s: Survey, axes: tuple[str, str], reference_axes: tuple[str, str] | None, field: float | None
) -> list[str]:
    """What contradicts the conventions assumed, a line each.

    Args:
        s: the survey.
        axes: body axes of the IMU and world axes.
        reference_axes: those of the reference attitude, when there is one.
        field: T, norm of the field of the place; None: not known.
    """
    found = _at_rest(s, axes[0])
    norm = float(np.nanmedian(np.linalg.norm(s.mag, axis=1))) if np.isfinite(s.mag).any() else math.nan
    if field and math.isfinite(norm) and not 1 / 3 < norm / field < 3:
        unit = next(
            (u for u, f in (("G", 1e-4), ("mG", 1e-7), ("uT", 1e-6), ("nT", 1e-9)) if 0.3 < norm * f / field < 3), ""
        )
        found.append(f"magnetometer reads {norm:.3g} T, the field of the place is {field:.3g} T: "
                     + (f"unit is {unit}? ([magnetometer] unit)" if unit else "unit or calibration?"))  # fmt: skip
    if reference_axes:
        found += _against_reference(s, reference_axes)
    return found


def _at_rest(s: Survey, body: str) -> list[str]:
    still = s.still
    if still.sum() < 5:
        return []
    force = np.median(s.accel_b[still], axis=0)
    norm = float(np.linalg.norm(force))
    other = {"FLU": "FRD", "FRD": "FLU"}[body]
    if 0.8 < norm < 1.2:
        return [f"accelerometer reads {norm:.2f} at rest: unit is g? ([imu] accel_unit)"]
    if not 0.9 * G < norm < 1.1 * G:
        return [f"accelerometer reads {norm:.2f} m/s2 at rest: unit or gravity removed?"]
    if force[2] > 0.7 * norm:
        sign = "-g" if body == "FLU" else "+g"
        return [f"accelerometer reads {sign} on z at rest: frame is {other}? ([frames] body)"]
    if abs(force[2]) < 0.7 * norm:
        return ["accelerometer's z is not vertical at rest: mounting? ([mounting])"]
    return []


def _against_reference(s: Survey, axes: tuple[str, str]) -> list[str]:
    t, q = s.t_reference, s.q_nb
    if len(t) < 20 or len(s.t) < 20:
        return []
    found = []
    force_n = frames.rotate(interpolate(t, q, s.t), s.accel_b)
    up = np.nanmean(force_n, axis=0)
    if np.linalg.norm(up) > 0.5 * G and up[2] > 0:
        found.append(f"gravity points up by the reference attitude: its axes are not {axes[0]}, {axes[1]}? ([frames])")
    reference_rate = rates(t, q, s.t, BIN_S)
    good = np.isfinite(reference_rate).all(axis=1)
    moving = good & (np.linalg.norm(np.nan_to_num(reference_rate), axis=1) > math.radians(5.0))
    if moving.sum() < 20:
        return found
    mine, theirs = s.gyro_b[moving], reference_rate[moving]
    slope = np.sum(mine * theirs, axis=0) / np.maximum(np.sum(theirs**2, axis=0), 1e-12)
    strong = np.sqrt(np.mean(theirs**2, axis=0)) > 0.2 * np.sqrt(np.mean(theirs**2))
    if 20 < np.median(np.abs(slope[strong])) < 100:
        return [*found, "gyro reads 57 times the rate of the reference attitude: unit is deg/s? ([imu] gyro_unit)"]
    wrong = [a for a, k, use in zip("xyz", slope, strong, strict=True) if use and k < -0.3]
    if wrong:
        found.append(f"gyro {' and '.join(wrong)} turn against the reference attitude: frame or mounting? ([frames])")
    elif (slope[strong] < 0.5).any():
        found.append("gyro does not follow the reference attitude: mounting, or another body? ([mounting])")
    return found


def reference_delay(s: Survey) -> float | None:
    """By how many s the reference attitude is later than the gyro; None when there is too little motion to tell."""
    return time_shift(s.t, s.gyro_b, BIN_S, s.t_reference, s.q_nb)


# ----------------------------------------------------------------------------------------------- calibration


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


def turns(s: Survey, axes: np.ndarray) -> Turns:
    """Pairs `_TURN_BINS` bins apart with a turn of a few degrees or more.

    Args:
        s: the survey.
        axes: (3, 3) from the axes of the magnetometer's messages to FRD.
    """
    n = max(len(s.t) - _TURN_BINS, 0)
    found = gyro_bias(s)
    rate = (s.gyro_b - (found[0] if found else 0.0)) @ axes
    q = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    for k in range(_TURN_BINS):  # from the middle of a bin to that of the next
        angle = -0.5 * (rate[k : k + n] + rate[k + 1 : k + 1 + n]) * BIN_S
        norm = np.linalg.norm(angle, axis=1, keepdims=True)
        step = np.concatenate([np.cos(norm / 2), 0.5 * np.sinc(norm / (2 * math.pi)) * angle], axis=1)
        q = frames.product(step, q)
    whole = np.abs(s.t[_TURN_BINS:] - s.t[:n] - _TURN_BINS * BIN_S) < 0.5 * BIN_S
    turned = np.linalg.norm(q[:, 1:], axis=1) > math.sin(math.radians(2.5))
    good = np.flatnonzero(whole & turned & np.isfinite(s.mag[:n] + s.mag[_TURN_BINS:]).all(axis=1))
    good = good[:: max(1, len(good) // _POINTS)]
    eye = np.eye(3)
    C = np.stack([frames.rotate(q[good], np.tile(e, (len(good), 1))) for e in eye], axis=-1)
    return Turns(s.mag[good], s.mag[good + _TURN_BINS], C)


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


def field_at_rest(s: Survey, mag_b: np.ndarray) -> np.ndarray | None:
    """The field (3,) T along magnetic north, east, down, from readings `mag_b` (n, 3) in FRD without acceleration."""
    norm = np.linalg.norm(s.accel_b, axis=1)
    calm = s.still if s.still.sum() >= 10 else np.abs(norm - G) < 0.3
    calm = calm & np.isfinite(mag_b).all(axis=1)
    if calm.sum() < 10:
        return None
    strength = np.linalg.norm(mag_b[calm], axis=1)
    down = float(np.median(np.sum(mag_b[calm] * -s.accel_b[calm], axis=1) / (strength * norm[calm])))
    total = float(np.median(strength))
    return np.array([total * math.sqrt(max(1.0 - down**2, 0.0)), 0.0, total * down])
