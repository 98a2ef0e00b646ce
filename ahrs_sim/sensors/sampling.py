"""The deterministic path from the truth to an instrument's sample: clock, anti-alias filter, delay, quantisation."""

import math

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.flight.truth import Truth
from ahrs_sim.jit import njit


class Clock:
    """Chooses the rows of the truth that an instrument samples: every `every`-th since the first."""

    def __init__(self, every: int) -> None:
        self.every = every
        self._next = 0  # rows of the coming block before the next sample

    def rows(self, n: int) -> slice:
        """Choose the sampled rows of the next block of `n` rows."""
        first = self._next
        self._next = first + -(-(n - first) // self.every) * self.every - n if n > first else first - n
        return slice(first, n, self.every)

    def sample(self, truth: Truth) -> tuple[slice, np.ndarray, float]:
        """Return the sampled rows of the next block, their times (m,) s, and the time at which the block ends, s."""
        rows = self.rows(len(truth))
        return rows, truth.t[rows], float(truth.t[-1]) if len(truth) else 0.0


def divider(rate: float, dt: float, what: str) -> int:
    """Count the rows of the truth (every `dt` s) per sample at `rate` (Hz).

    Raises:
        InputError: the rate does not divide that of the truth.
    """
    if rate <= 0.0:
        raise InputError(f"{what}: rate_hz must be > 0; state it")
    every = round(1.0 / (rate * dt))
    if every < 1 or abs(every * rate * dt - 1.0) > 1e-6:
        near = 1.0 / (max(every, 1) * dt)
        raise InputError(f"{what}: rate_hz = {rate:g} does not divide the truth's {1 / dt:g} Hz; take {near:g}")
    return every


class BandLimit:
    """Second-order Butterworth low-pass at the truth's rate and a pure delay, sampled at an instrument's rows.

    Args:
        cutoff: -3 dB frequency, Hz; 0 or anything the truth's rate cannot carry: no filter.
        delay: total group delay, s; never less than the filter's own at low frequency.
        dt: s between rows of the truth.
        every: rows per sample.
        longest: largest additional delay of single samples (jitter), s.
    """

    def __init__(self, cutoff: float, delay: float, dt: float, every: int, longest: float = 0.0) -> None:
        self._b, self._a = np.array([1.0, 0.0, 0.0]), np.zeros(2)
        own = 0.0
        if 0.0 < cutoff < 0.45 / dt:
            # Bilinear transform with the corner frequency prewarped; its delay at low frequency is that of the
            # analogue prototype, sqrt(2) / corner.
            w = math.tan(math.pi * cutoff * dt)
            norm = 1.0 + math.sqrt(2.0) * w + w * w
            self._b = np.array([w * w, 2.0 * w * w, w * w]) / norm
            self._a = np.array([2.0 * (w * w - 1.0), 1.0 - math.sqrt(2.0) * w + w * w]) / norm
            own = math.sqrt(2.0) * dt / (2.0 * w)
        self.cutoff = cutoff
        self.delay = max(delay, own)
        self._dt = dt
        self._every = every
        self._lag = (self.delay - own) / dt
        self._state: np.ndarray | None = None
        self._past = np.zeros((int(self._lag + longest / dt) + 3, 3))
        self._count = np.zeros(1, np.int64)

    def apply(self, x: np.ndarray, rows: slice, extra: np.ndarray) -> np.ndarray:
        """Filter and delay `x` (n, 3); return samples (m, 3) at `rows`, each `extra` (m,) s later still."""
        if self._state is None:  # as if the first value had always been there: no transient
            if not len(x):
                return np.empty((0, 3))
            self._state = np.stack([(1.0 - self._b[0]) * x[0], (self._b[2] - self._a[1]) * x[0]])
            self._past[:] = x[0]
        out = np.empty((len(extra), 3))
        _band_limit(x, self._b, self._a, self._state, self._past, self._count, rows.start, self._every, self._lag,
                    extra / self._dt, out)  # fmt: skip
        return out


@njit
def _band_limit(
    x: np.ndarray, b: np.ndarray, a: np.ndarray, state: np.ndarray, past: np.ndarray, count: np.ndarray,
    first: int, every: int, lag: float, extra: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Filter each axis (transposed direct form II) into a ring of past values; interpolate samples `lag` rows back."""
    size = past.shape[0]
    now = count[0]
    m = 0
    for i in range(x.shape[0]):
        now = (now + 1) % size
        for k in range(3):
            y = b[0] * x[i, k] + state[0, k]
            state[0, k] = b[1] * x[i, k] - a[0] * y + state[1, k]
            state[1, k] = b[2] * x[i, k] - a[1] * y
            past[now, k] = y
        if i == first + m * every and m < out.shape[0]:
            back = lag + extra[m]
            whole = int(back)
            part = back - whole
            for k in range(3):
                late = past[(now - whole) % size, k]
                out[m, k] = late if part == 0.0 else late + part * (past[(now - whole - 1) % size, k] - late)
            m += 1
    count[0] = now


def pick(x: np.ndarray, rows: slice) -> np.ndarray:
    """Copy the sampled `rows` of `x` contiguously, because a kernel compiles once for each memory layout."""
    return np.ascontiguousarray(x[rows])


def nanoseconds(t: np.ndarray) -> np.ndarray:
    """Round times (s) to whole nanoseconds, int64."""
    return np.rint(t * 1e9).astype(np.int64)


class Lag:
    """First-order lag with time constant `time` (s) on a signal every `dt` s; starts settled on its first value."""

    def __init__(self, time: float, dt: float) -> None:
        self._share = -math.expm1(-dt / time) if time > 0.0 else 1.0
        self._state = np.full(1, np.nan)

    def apply(self, x: np.ndarray) -> np.ndarray:
        """Apply the lag to `x` (n,); return (n,)."""
        out = np.empty(len(x))
        if len(x):
            if np.isnan(self._state[0]):
                self._state[0] = x[0]
            _lag(np.ascontiguousarray(x), self._share, self._state, out)
        return out


@njit
def _lag(x: np.ndarray, share: float, state: np.ndarray, out: np.ndarray) -> None:
    for i in range(x.shape[0]):
        if share == 1.0:
            state[0] = x[i]
        else:
            state[0] += share * (x[i] - state[0])
        out[i] = state[0]
