"""Gains of the autopilot from a linear model of the aircraft, and the margins they leave.

The inner loops hold roll rate and pitch rate and centre the ball, by a linear-quadratic regulator with integrators;
the outer ones turn an error of bank or pitch into a rate. Both are made gentler until the loops, broken at each
control, keep `GAIN_MARGIN` and `PHASE_MARGIN` with the delays of actuators and sampling, and every mode is damped.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from ahrs_sim.world.gravity import STANDARD as G

GAIN_MARGIN = 8.0  # dB
PHASE_MARGIN = 45.0  # deg
DAMPING = 0.5  # of every closed-loop mode faster than SLOW
LEAST = 0.5  # share of all three that is flown with where no gains keep them, e.g. just above the stall
SLOW = 0.05  # rad/s
ROLL_INTEGRAL, PITCH_INTEGRAL = 5, 3  # places in the states of the two models
DELAY = 0.03  # s: samples at 100 Hz, and an estimate that comes late
FREQUENCIES = np.geomspace(0.02, 150.0, 400)  # rad/s
EAGERNESS = tuple(10.0**x for x in (1.0, 0.5, 0.0, -0.5, -1.0, -1.5, -2.0, -2.5, -3.0))
OUTER = (1.6, 1.3, 1.0, 0.8, 0.6, 0.45, 0.3, 0.2)  # 1/s


Model = tuple[np.ndarray, np.ndarray]
"""A and B of a linear model."""


@dataclass(frozen=True)
class Margins:
    """Holds the stability margins of one loop, opened at its control."""

    gain_db: float
    phase_deg: float
    crossover: float  # rad/s, the highest frequency at which the loop's gain is one


@dataclass(frozen=True)
class Loop:
    """A regulator u = -K x on x = (states, lagged controls, integrals), and the outer gain."""

    inner: np.ndarray  # (m, n)
    outer: float  # 1/s
    damping: float  # the least of the closed-loop modes
    margins: tuple[Margins, ...]  # of each control


class NoGains(Exception):
    """No regulator keeps the margins: the reason."""


def lateral_model(d: np.ndarray, speed: float, theta: float, lags: tuple[float, float]) -> Model:
    """Give A (8, 8), B (8, 2): beta, p, r, aileron, rudder, integral of roll rate, of side force, bank.

    Args:
        d: (7, 5) derivatives of the accelerations and the side force by beta, p, r, aileron, rudder.
    """
    a = np.zeros((8, 8))
    a[0, :5] = d[1] / speed
    a[1, :5], a[2, :5] = d[3], d[5]
    a[0, 7] = G * np.cos(theta) / speed
    a[3, 3], a[4, 4] = -1.0 / lags[0], -1.0 / lags[1]
    a[5, 1] = 1.0
    a[6, :5] = d[6]
    a[7, 1], a[7, 2] = 1.0, np.tan(theta)
    b = np.zeros((8, 2))
    b[3, 0], b[4, 1] = 1.0 / lags[0], 1.0 / lags[1]
    return a, b


def longitudinal_model(d: np.ndarray, speed: float, lag: float) -> Model:
    """Give A (5, 5), B (5, 1): alpha, q, elevator, integral of pitch rate, pitch.

    Args:
        d: (7, 3) derivatives of the accelerations by alpha, q, elevator.
    """
    a = np.zeros((5, 5))
    a[0, :3] = d[2] / speed
    a[1, :3] = d[4]
    a[2, 2] = -1.0 / lag
    a[3, 1] = a[4, 1] = 1.0
    b = np.zeros((5, 1))
    b[2, 0] = 1.0 / lag
    return a, b


def lateral(model: Model, light: Model) -> tuple[Loop, Loop]:
    """Find the regulator of roll rate and side force, as it is on the model and on that of the lightly loaded aircraft.

    Raises:
        NoGains: none keeps the margins.
    """
    weights = [1 / 0.1, 1 / 0.3, 1 / 0.15, 0.0, 0.0, 1 / 0.2, 1 / 3.0]
    return _search((model, light), np.array(weights) ** 2, ROLL_INTEGRAL)


def longitudinal(model: Model, light: Model) -> tuple[Loop, Loop]:
    """Find the regulator of pitch rate, as `lateral` does.

    Raises:
        NoGains: none keeps the margins.
    """
    return _search((model, light), np.array([0.0, 1 / 0.15, 0.0, 1 / 0.1]) ** 2, PITCH_INTEGRAL)


def closed(
    a: np.ndarray, b: np.ndarray, inner: np.ndarray, outer: float, integral: int
) -> tuple[np.ndarray, np.ndarray]:
    """Give A and K with the outer loop closed: the rate that is commanded is -`outer` times the last state."""
    rate = a[integral].nonzero()[0][0]
    gain = np.zeros((b.shape[1], len(a)))
    gain[:, :-1] = inner
    gain[:, -1] += inner[:, rate] * outer  # K acts on the rate less its command
    whole = a.copy()
    whole[integral, -1] += outer
    return whole, gain


def assess(model: Model, inner: np.ndarray, outer: float, integral: int) -> Loop:
    """Find the damping and the margins that gains have on a model."""
    a, b = model
    whole, gain = closed(a, b, inner, outer, integral)
    margins = tuple(_margins(whole, b, gain, i) for i in range(b.shape[1]))
    return Loop(inner, outer, _damping(whole - b @ gain), margins)


def _search(models: tuple[Model, Model], weights: np.ndarray, integral: int) -> tuple[Loop, Loop]:
    best, best_share, reason = None, 0.0, "the Riccati equation has no solution"
    a, b = models[0]
    for inner in _regulators(a[:-1, :-1], b[:-1], weights):
        for outer in OUTER:
            loops = (assess(models[0], inner, outer, integral), assess(models[1], inner, outer, integral))
            gain, phase = (min(getattr(m, x) for loop in loops for m in loop.margins) for x in ("gain_db", "phase_deg"))
            damping = min(loop.damping for loop in loops)
            share = min(gain / GAIN_MARGIN, phase / PHASE_MARGIN, damping / DAMPING)
            if share >= 1.0:
                return loops
            if share > best_share:
                best, best_share = loops, share
                reason = f"gain margin {gain:.1f} dB, phase margin {phase:.0f} deg, damping {damping:.2f}"
    if best is None or best_share < LEAST:
        raise NoGains(reason)
    return best


def _regulators(a: np.ndarray, b: np.ndarray, weights: np.ndarray) -> Iterator[np.ndarray]:
    for eagerness in EAGERNESS:
        try:
            riccati = linalg.solve_continuous_are(a, b, np.diag(weights * eagerness + 1e-9), 4.0 * np.eye(b.shape[1]))
        except (linalg.LinAlgError, ValueError):
            continue
        gain = 0.25 * b.T @ riccati
        lagged = np.flatnonzero(np.abs(b).any(axis=1))  # the controls themselves are not measured: they follow at once
        gain = np.linalg.solve(np.eye(len(gain)) + (gain @ b) / b[lagged].sum(axis=0), gain)
        gain[:, lagged] = 0.0
        yield gain


def _damping(a: np.ndarray) -> float:
    modes = np.linalg.eigvals(a)
    fast = modes[np.abs(modes) > SLOW]
    return float((-fast.real / np.abs(fast)).min(initial=1.0))


def _margins(a: np.ndarray, b: np.ndarray, gain: np.ndarray, i: int) -> Margins:
    """Break the loop at control i, the others closed."""
    others = np.arange(b.shape[1]) != i
    rest = a - b[:, others] @ gain[others]
    s = 1j * FREQUENCIES
    inverse = np.linalg.solve(
        s[:, None, None] * np.eye(len(a)) - rest, np.broadcast_to(b[:, i : i + 1], (len(s), len(a), 1))
    )
    loop = (inverse[..., 0] @ gain[i]) * np.exp(-s * DELAY)
    size, angle = np.abs(loop), np.unwrap(np.angle(loop))
    ones = np.flatnonzero(np.diff(np.sign(size - 1.0)))
    phase = min((abs((np.degrees(angle[k]) + 180.0 + 180.0) % 360.0 - 180.0) for k in ones), default=180.0)
    turns = np.floor((angle + np.pi) / (2.0 * np.pi))
    crossings = np.flatnonzero(np.diff(turns))
    decibels = [abs(20.0 * np.log10(size[k])) for k in crossings if size[k] > 1e-3]
    return Margins(float(min(decibels, default=60.0)), float(phase), float(FREQUENCIES[ones[-1]]) if len(ones) else 0.0)
