"""The stochastic processes of sensor errors.

* White noise by single-sided density d: sigma = d sqrt(fs / 2). In the terms of IEEE Std 952, whose coefficients belong
  to two-sided spectra, the angle random walk is N = d / sqrt(2): an Allan variance N^2 / tau at any sampling rate.
* Gauss-Markov: x <- phi x + q n, phi = exp(-dt / T), q = sigma sqrt(1 - phi^2): exact for any dt, started from its
  stationary distribution.
* Flicker (bias instability B): Gauss-Markov terms one decade apart, T = 0.1 s ... 1e4 s, each with
  sigma = B sqrt(ln 10 / pi), whose Allan deviation is flat at 0.664 B within 4 % from 0.5 s to 2000 s.
* Random walk: x <- x + K sqrt(dt) n, Allan variance K^2 tau / 3; starts from zero, having no stationary distribution.

Every process draws row by row from a generator of its own, so that neither the length of blocks nor other processes
matter.
"""

import math

import numpy as np

from ahrs_sim.jit import njit

FLICKER_TIMES = 10.0 ** np.arange(-1, 5)
"""Correlation times (s) of the terms of flicker noise."""

FLICKER_SIGMA = math.sqrt(math.log(10.0) / math.pi)
"""Sigma of each term for B = 1: a spectrum B^2 / (2 pi f) needs sigma^2 = B^2 ln(10) / pi of each decade."""

ALLAN_FLOOR = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""The Allan deviation of flicker noise with B = 1: 0.664."""


def white_sigma(density: np.ndarray, rate: float) -> np.ndarray:
    """Compute sigma of samples at `rate` (Hz) of a noise with single-sided `density` (unit/sqrt(Hz))."""
    return density * math.sqrt(rate / 2.0)


def rms(x: np.ndarray) -> float:
    """Compute the root mean square over the axes: one sigma for all of them."""
    return float(np.sqrt(np.mean(np.square(x))))


class White:
    """White noise: independent normal samples (n, axes)."""

    def __init__(self, sigma: np.ndarray, rng: np.random.Generator) -> None:
        self.sigma = np.atleast_1d(np.asarray(sigma, float))
        self._rng = rng

    def draw(self, n: int) -> np.ndarray:
        """Draw the next `n` rows (n, axes)."""
        return self._rng.standard_normal((n, len(self.sigma))) * self.sigma  # type: ignore[no-any-return]


class Correlated:
    """A sum of Gauss-Markov terms and a random walk, for each axis.

    Args:
        sigma: (terms, axes) stationary sigma of each term.
        times: (terms,) correlation times, s.
        walk: (axes,) unit/sqrt(s).
        dt: s between samples.
        rng: its own generator.
    """

    def __init__(
        self, sigma: np.ndarray, times: np.ndarray, walk: np.ndarray, dt: float, rng: np.random.Generator
    ) -> None:
        # A term without size would cost a random number at every sample: it is left out for good.
        used = np.any(sigma > 0.0, axis=1)
        self._phi = np.exp(-dt / times[used])
        self._q = sigma[used] * np.sqrt(-np.expm1(-2.0 * dt / times[used]))[:, None]
        self._walk = np.asarray(walk, float) * math.sqrt(dt)
        self._rng = rng
        terms, axes = self._q.shape
        self._walks = bool(np.any(self._walk > 0.0))
        self._state = np.zeros((terms + 1, axes))
        self._state[:terms] = rng.standard_normal((terms, axes)) * sigma[used]
        self._shape = (terms + self._walks, axes)

    def draw(self, n: int) -> np.ndarray:
        """Draw the next `n` rows (n, axes)."""
        terms, axes = self._shape
        out = np.zeros((n, axes))
        if terms and n:
            draws = self._rng.standard_normal((n, terms * axes))
            correlated(draws, self._phi, self._q, self._walk, self._state, out)
        return out


def gauss_markov(sigma: np.ndarray, time: float, dt: float, rng: np.random.Generator) -> Correlated:
    """Make one first-order Gauss-Markov process per axis: stationary `sigma` (axes,), correlation `time` (s)."""
    sigma = np.atleast_1d(np.asarray(sigma, float))
    return Correlated(sigma[None], np.array([time]), np.zeros(len(sigma)), dt, rng)


def in_run_bias(floor: np.ndarray, walk: np.ndarray, dt: float, rng: np.random.Generator) -> Correlated:
    """Make flicker whose Allan deviation is flat at `floor` (axes,), plus a random walk (axes,) unit/sqrt(s)."""
    sigma = np.outer(np.full(len(FLICKER_TIMES), FLICKER_SIGMA / ALLAN_FLOOR), floor)
    return Correlated(sigma, FLICKER_TIMES, walk, dt, rng)


@njit
def correlated(
    draws: np.ndarray, phi: np.ndarray, q: np.ndarray, walk: np.ndarray, state: np.ndarray, out: np.ndarray
) -> None:
    """Advance Gauss-Markov terms and the walk by one step a row; `out` (n, axes) is their sum after each step.

    draws (n, (terms [+ 1]) axes) standard normal, phi (terms,), q (terms, axes), walk (axes,) per step,
    state (terms + 1, axes) with the walk last.
    """
    terms = phi.shape[0]
    axes = out.shape[1]
    walks = draws.shape[1] > terms * axes
    for i in range(out.shape[0]):
        for a in range(axes):
            total = 0.0
            for k in range(terms):
                state[k, a] = phi[k] * state[k, a] + q[k, a] * draws[i, k * axes + a]
                total += state[k, a]
            if walks:
                state[terms, a] += walk[a] * draws[i, terms * axes + a]
            out[i, a] = total + state[terms, a]
