"""The IMU integrated over some seconds, and what must follow from it: the velocity of GNSS, the turning of the field.

Each window starts from axes of its own. From them specific force gives a velocity s(t), f_w integrated; with the
attitude C_nw of these axes and gravity it is that of the receiver,

    v_n(t) = v_0 + C_nw (s(t) + C_wb(t) (w_b(t) x l_b)) + g_n (t - t_w),

whose antenna is at l_b and whose stamps are late by a delay. v_0 and C_nw belong to a window and are eliminated; delay,
lever arm and biases are common to all (Gauss-Newton with Huber weights). Sigmas are those of independent windows, not
of independent readings: what is wrong with a receiver is wrong for seconds (jackknife over clusters: Cameron and
Miller, "A Practitioner's Guide to Cluster-Robust Inference", J. Human Resources 50, 2015, section VI.B, CR3).
"""

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.attitude import cross_matrices, rotation_matrix
from ahrs_sim.recordings.survey import BIN_S, Survey

WINDOW_S = 12.0
SHORTEST_S = 8.0
LONGEST_DELAY = 1.2  # s: looked for from -0.4 to this
EARLIEST_DELAY = -0.4  # s
_GRID = 0.1  # s
_LEAST_WINDOWS = 3
_MOVING = 1.5  # m/s: spread of velocity from which on a window says something
_PER_SECOND = 5.0  # readings of GNSS a second that are used
_GYRO_BIAS, _ACCEL_BIAS, _LEVER, _DELAY = 0.05, 0.5, 5.0, 1.0  # priors: rad/s, m/s2, m, s
_DELAY_FLOOR, _LEVER_FLOOR = 3e-3, 0.04  # s, m: what means over a tenth of a second leave unsure
HEADING_KNOWN = math.radians(4.0)  # sigma up to which a window's attitude counts as known
_ATTITUDE = 1.0  # rad, prior of a window's attitude about the one from the velocities


@dataclass(frozen=True)
class Windows:
    """Bins of a survey in windows without a gap, and integrals from the start of each, in the axes of its start."""

    t: np.ndarray  # (n,) s
    first: np.ndarray  # (w,) first bin of each
    last: np.ndarray  # (w,) last bin
    number: np.ndarray  # (n,) window of each bin, -1: none
    C_wb: np.ndarray  # (n, 3, 3)
    rate_b: np.ndarray  # (n, 3) rad/s
    speed_w: np.ndarray  # (n, 3) m/s, integral of specific force
    turned_w: np.ndarray  # (n, 3, 3) s, integral of C_wb
    moved_w: np.ndarray  # (n, 3, 3) m/s per rad/s of gyro bias

    def at(self, t: np.ndarray, margin: tuple[float, float] = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
        """Mask the times (m,) that lie in a window with a margin (s) before and after; also return its number."""
        k = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        number = np.where(self.number[k] == self.number[k - 1], self.number[k], -1)
        first, last = self.t[self.first[number]], self.t[self.last[number]]
        inside = (number >= 0) & (t - margin[1] >= first) & (t + margin[0] <= last)
        return np.flatnonzero(inside), number[inside]

    def between(self, values: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Interpolate values of bins (n, ...) linearly to times (m,)."""
        k = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        weight = (t - self.t[k - 1]) / (self.t[k] - self.t[k - 1])
        weight = weight.reshape(-1, *(1,) * (values.ndim - 1))
        mixed: np.ndarray = (1.0 - weight) * values[k - 1] + weight * values[k]
        return mixed


def windows(s: Survey, seconds: float = WINDOW_S) -> Windows | None:
    """Integrate gyro and accelerometer over windows of a survey; None when there is not one."""
    n = len(s.t)
    if n < 2:
        return None
    cuts = np.r_[0, np.flatnonzero(np.diff(s.t) > 2.5 * BIN_S) + 1, n]
    starts: list[int] = []
    ends: list[int] = []
    for a, b in pairwise(cuts):
        span = s.t[b - 1] - s.t[a]
        parts = max(1, round(span / seconds))
        if span / parts < SHORTEST_S:
            continue
        edges = np.searchsorted(s.t[a:b], s.t[a] + span * np.arange(parts + 1) / parts) + a
        starts += edges[:-1].tolist()
        ends += [*(edges[1:-1] - 1).tolist(), b - 1]
    if not starts:
        return None
    first, last = np.array(starts), np.array(ends)
    number = np.full(n, -1)
    for w, (a, b) in enumerate(zip(first, last, strict=True)):
        number[a : b + 1] = w
    return _integrated(s, first, last, number)


def _integrated(s: Survey, first: np.ndarray, last: np.ndarray, number: np.ndarray) -> Windows:
    n = len(s.t)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    step = 0.5 * (s.gyro_b[:-1] + s.gyro_b[1:]) * np.diff(s.t)[:, None]
    turn = attitude.exponential(step)
    for k in range(1, int((last - first).max()) + 1):
        rows = (first + k)[first + k <= last]
        q[rows] = attitude.product(q[rows - 1], turn[rows - 1])
    C = np.stack([attitude.to_nav(q, np.tile(e, (n, 1))) for e in np.eye(3)], axis=-1)
    force_w = np.einsum("nij,nj->ni", C, s.accel_b)
    turned = cumulated(s.t, C, number)
    lever = np.einsum("nij,njk->nik", cross_matrices(force_w), turned)
    return Windows(
        t=s.t,
        first=first,
        last=last,
        number=number,
        C_wb=C,
        rate_b=s.gyro_b,
        speed_w=cumulated(s.t, force_w, number),
        turned_w=turned,
        moved_w=cumulated(s.t, lever, number),
    )


def cumulated(t: np.ndarray, values: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Integral (n, ...) over time from the start of each window, by trapezia."""
    dt = np.diff(t).reshape(-1, *(1,) * (values.ndim - 1))
    whole = np.concatenate([np.zeros_like(values[:1]), np.cumsum(0.5 * (values[:-1] + values[1:]) * dt, axis=0)])
    starts = np.flatnonzero(np.diff(number, prepend=-2))
    begun = np.repeat(starts, np.diff(np.r_[starts, len(t)]))
    since: np.ndarray = whole - whole[begun]
    return since


# ----------------------------------------------------------------------------------------------- least squares


@dataclass
class Groups:
    """A least-squares problem whose rows come in groups with parameters of their own, which are eliminated."""

    size: int  # common parameters
    normal: np.ndarray = field(init=False)  # (p, p)
    right: np.ndarray = field(init=False)  # (p,)
    parts: list[tuple[np.ndarray, np.ndarray]] = field(init=False, default_factory=list)  # both, of each group
    squares: float = 0.0
    count: int = 0

    def __post_init__(self) -> None:
        self.normal, self.right = np.zeros((self.size, self.size)), np.zeros(self.size)

    def add(self, residual: np.ndarray, common: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Add rows of one group; return pinv(own) (k, m): the group's step is pinv(own) (residual - common step).

        Args:
            residual: (m,), weighted.
            common: (m, p) derivatives of the model by the common parameters.
            own: (m, k) by those of the group.
        """
        inverse: np.ndarray = np.linalg.pinv(own, rcond=1e-8)
        left = residual - own @ (inverse @ residual)
        kept = common - own @ (inverse @ common)
        score = kept.T @ left
        self.normal += kept.T @ kept
        self.right += score
        self.parts.append((kept.T @ kept, score))
        self.squares += float(left @ left)
        self.count += len(residual) - own.shape[1]
        return inverse

    def step(self, x: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """Step (p,) from `x` with priors of sigma `prior` (p,) about zero."""
        step: np.ndarray = np.linalg.solve(self.normal + np.diag(prior**-2), self.right - x / prior**2)
        return step

    def sigma(self, x: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """Compute sigmas (p,): the greater of those of independent rows and of independent groups (jackknife).

        With few groups they are widened (about as Student's t is) so that three of them hold as they do for many.
        """
        whole = self.normal + np.diag(prior**-2)
        n = len(self.parts)
        shifts = np.array([np.linalg.solve(whole - normal, score) for normal, score in self.parts])
        grouped = np.sum(shifts**2, axis=0) * (n - 1.0) / n * (1.0 + 3.5 / max(n - 1.0, 1.0)) ** 2
        plain = np.diag(np.linalg.inv(whole)) * max(1.0, self.squares / max(self.count, 1))
        sigma: np.ndarray = np.sqrt(np.maximum(grouped, plain))
        return sigma


# ----------------------------------------------------------------------------------------------- GNSS


@dataclass(frozen=True)
class Track:
    """Holds the motion as IMU and GNSS velocity agree on it."""

    windows: Windows
    which: np.ndarray  # (k,) windows that have a solution
    C_nw: np.ndarray  # (w, 3, 3) attitude of each window's axes; NaN without
    vel_0: np.ndarray  # (w, 3) m/s
    heading_sigma: np.ndarray  # (w,) rad; inf without
    gravity: float
    delay: float  # s, by which stamps are late
    delay_sigma: float
    lever_b: np.ndarray  # (3,) m
    lever_sigma: np.ndarray
    gyro_bias: np.ndarray  # (3,) rad/s
    accel_bias: np.ndarray  # (3,) m/s2
    noise: float  # m/s, one axis of a velocity
    misfit: float  # m/s, median over the windows of the RMS of what is left

    def attitude(self, rows: np.ndarray) -> np.ndarray:
        """Compute C_nb (m, 3, 3) at bins `rows`."""
        w = self.windows
        wrong = np.einsum("nij,j->ni", w.turned_w[rows], self.gyro_bias)
        C_wb = w.C_wb[rows] - np.einsum("nij,njk->nik", cross_matrices(wrong), w.C_wb[rows])
        C_nb: np.ndarray = np.einsum("nij,njk->nik", self.C_nw[w.number[rows]], C_wb)
        return C_nb

    def velocity(self, rows: np.ndarray) -> np.ndarray:
        """Compute the velocity (m, 3) m/s of the IMU at bins `rows`."""
        w = self.windows
        gained = w.speed_w[rows] + w.moved_w[rows] @ self.gyro_bias - w.turned_w[rows] @ self.accel_bias
        number = w.number[rows]
        v = self.vel_0[number] + np.einsum("nij,nj->ni", self.C_nw[number], gained)
        v[:, 2] += self.gravity * (w.t[rows] - w.t[w.first[number]])
        return np.asarray(v)


def track(
    s: Survey, gravity: float, *, lever: bool = False, made: Windows | None = None, delay: float | None = None
) -> Track | None:
    """Fit windows of the IMU to the velocities of GNSS; None when there are too few in motion.

    Args:
        s: the survey.
        gravity: m/s2.
        lever: look for the lever arm, too.
        made: the windows, when they are there already.
        delay: s, where the delay is known.
    """
    w = made or windows(s)
    if w is None or len(s.t_velocity) < 2 * _LEAST_WINDOWS:
        return None
    t, vel_n = _thinned(s.t_velocity, s.vel_n)
    rows, number = w.at(t, (-EARLIEST_DELAY, LONGEST_DELAY))
    t, vel_n = t[rows], vel_n[rows]
    groups = {k: np.flatnonzero(number == k) for k in np.unique(number)}
    groups = {k: g for k, g in groups.items() if len(g) >= 6 and np.ptp(vel_n[g], axis=0).max() > _MOVING}
    if len(groups) < _LEAST_WINDOWS:
        return None
    fit = _Fit(w, t, vel_n, groups, gravity)
    if delay is None:
        grid = np.arange(EARLIEST_DELAY, LONGEST_DELAY + 1e-9, _GRID)
        delay, free = float(grid[int(np.argmin([fit.start(d) for d in grid]))]), True
    else:
        free = False
    fit.start(delay)
    return fit.solved(delay, lever, free)


def _thinned(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Choose at most `_PER_SECOND` readings a second."""
    keep = np.flatnonzero(np.diff(np.floor(t * _PER_SECOND), prepend=-1.0) != 0)
    return t[keep], values[keep]


class _Fit:
    """One fit of windows to velocities."""

    def __init__(
        self, w: Windows, t: np.ndarray, vel_n: np.ndarray, groups: dict[int, np.ndarray], gravity: float
    ) -> None:
        self.w, self.t, self.vel_n, self.groups = w, t, vel_n, groups
        self.down = np.array([0.0, 0.0, gravity])
        self.C = np.full((len(w.first), 3, 3), np.nan)
        self.v0 = np.full((len(w.first), 3), np.nan)
        self.noise = 0.1

    def start(self, delay: float) -> float:
        """Fit attitude and velocity of each window at a delay (Wahba, SVD); return the median misfit (m/s)."""
        gained = self.w.between(self.w.speed_w, self.t - delay)
        misfits = []
        for k, g in self.groups.items():
            y = self.vel_n[g] - self.down * (self.t[g] - delay - self.w.t[self.w.first[k]])[:, None]
            x = gained[g]
            my, mx = y.mean(axis=0), x.mean(axis=0)
            u, _, vt = np.linalg.svd((y - my).T @ (x - mx))
            C = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
            self.C[k], self.v0[k] = C, my - C @ mx
            left = y - my - (x - mx) @ C.T
            misfits.append(math.sqrt(float(np.mean(left**2))))
        self.noise = max(1e-3, float(np.median(misfits)))
        return self.noise

    def solved(self, delay: float, lever: bool, free: bool) -> Track | None:
        """Gauss-Newton from `start`; parameters are delay, lever arm, gyro bias, accelerometer bias."""
        x = np.zeros(10)
        x[0] = delay
        prior = np.r_[
            _DELAY if free else 1e-6, np.full(3, _LEVER if lever else 1e-6), [_GYRO_BIAS] * 3, [_ACCEL_BIAS] * 3
        ]
        centre = np.zeros(10) if free else x.copy()
        heading = np.full(len(self.C), np.inf)
        for last in (False,) * 7 + (True,):
            groups = Groups(10)
            inverses = {}
            misfits = []
            for k, g in self.groups.items():
                residual, common, own, raw = self._rows(k, g, x)
                inverses[k] = (groups.add(residual, common, own), residual, common, own)
                misfits.append(math.sqrt(float(np.mean(raw**2))))
            if last:
                break
            step = groups.step(x - centre, prior)
            x = x + step
            if not EARLIEST_DELAY - _GRID <= x[0] <= LONGEST_DELAY + _GRID:
                x[0] = min(max(x[0], EARLIEST_DELAY), LONGEST_DELAY)
            for k, (inverse, residual, common, _) in inverses.items():
                own_step = inverse @ (residual - common @ step)
                self.v0[k] += own_step[:3]
                self.C[k] = rotation_matrix(own_step[3:]) @ self.C[k]
            self.noise = max(1e-3, 0.5 * (self.noise + float(np.median(misfits))))
        for k, (_, _, _, own) in inverses.items():
            covariance = np.linalg.inv(own.T @ own + 1e-9 * np.eye(6))
            heading[k] = math.sqrt(covariance[5, 5])
        sigma = np.hypot(groups.sigma(x - centre, prior), [_DELAY_FLOOR, *[_LEVER_FLOOR] * 3, *[0.0] * 6])
        which = np.array(list(self.groups))
        return Track(
            windows=self.w, which=which, C_nw=self.C, vel_0=self.v0, heading_sigma=heading,
            gravity=float(self.down[2]), delay=float(x[0]), delay_sigma=float(sigma[0]), lever_b=x[1:4],
            lever_sigma=sigma[1:4], gyro_bias=x[4:7], accel_bias=x[7:10], noise=self.noise,
            misfit=float(np.median(misfits)),
        )  # fmt: skip

    def _rows(self, k: int, g: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Weighted residuals, derivatives by common and own parameters, and residuals (m/s) of window `k`."""
        w, at = self.w, self.t[g] - x[0]
        C_wb, rate = w.between(w.C_wb, at), w.between(w.rate_b, at) - x[4:7]
        turned, moved = w.between(w.turned_w, at), w.between(w.moved_w, at)
        antenna = np.einsum("nij,nj->ni", C_wb, np.cross(rate, x[1:4]))
        gained = w.between(w.speed_w, at) + moved @ x[4:7] - turned @ x[7:10] + antenna
        C, since = self.C[k], (at - w.t[w.first[k]])[:, None]
        swept = gained @ C.T
        residual = self.vel_n[g] - self.v0[k] - swept - self.down * since
        ahead = w.between(w.speed_w, at + 0.05) - w.between(w.speed_w, at - 0.05)
        accel_n = (ahead / 0.1) @ C.T + self.down
        common = np.concatenate(
            [-accel_n[:, :, None], C @ (C_wb @ cross_matrices(rate)), C @ moved, -(C @ turned)], axis=2
        )
        own = np.concatenate([np.broadcast_to(np.eye(3), (len(g), 3, 3)), -cross_matrices(swept)], axis=2)
        size = np.linalg.norm(residual, axis=1) / (math.sqrt(3.0) * self.noise)
        weight = np.sqrt(np.minimum(1.0, 2.0 / np.maximum(size, 1e-9))) / self.noise
        rows = (weight[:, None] * residual).ravel()
        common = (weight[:, None, None] * common).reshape(-1, 10)
        own = (weight[:, None, None] * own).reshape(-1, 6)
        prior = np.concatenate([np.zeros((3, 3)), np.eye(3) / _ATTITUDE], axis=1)
        return (
            np.r_[rows, np.zeros(3)],
            np.concatenate([common, np.zeros((3, 10))]),
            np.concatenate([own, prior]),
            residual,
        )


@dataclass(frozen=True)
class Course:
    """Compares the measured field with the model's, turned by the heading of GNSS and IMU."""

    offset: float  # rad, to the right
    sigma: float
    spread: float  # rad, RMS about it, from one stretch of flight to the next
    count: int


def course_of(mag_b: np.ndarray, track: Track, declination: float = 0.0) -> Course | None:
    """Direction of the field (n, 3) against a declination (rad); None when too few headings are known."""
    w = track.windows
    angles = []
    for k in track.which[track.heading_sigma[track.which] < HEADING_KNOWN]:
        rows = np.arange(w.first[k], w.last[k] + 1)
        rows = rows[np.isfinite(mag_b[rows]).all(axis=1)]
        if len(rows) < 20:
            continue
        field = np.einsum("nij,nj->ni", track.attitude(rows), mag_b[rows]).mean(axis=0)
        if math.hypot(field[0], field[1]) > 0.05 * np.linalg.norm(field):
            angles.append(math.atan2(field[1], field[0]) - declination)
    if len(angles) < 4:
        return None
    around = np.exp(1j * np.array(angles))
    middle = complex(np.mean(around))
    off = np.angle(around / middle)
    spread = float(np.std(off, ddof=1))
    return Course(float(np.angle(middle)), spread / math.sqrt(len(off)), spread, len(off))


def scaled(s: Survey, gyro: np.ndarray, accel: np.ndarray) -> Survey:
    """Multiply gyro and accelerometer of a survey by (3, 3) matrices."""
    return replace(s, gyro_b=s.gyro_b @ gyro.T, accel_b=s.accel_b @ accel.T)
