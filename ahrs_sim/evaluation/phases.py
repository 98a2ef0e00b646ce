"""Phases of a flight, from the truth: standing, steady, turning, and everything in between."""

import math

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.evaluation.decimate import Decimator

TURN_RATE = math.radians(3.0)
"""rad/s of heading (mean over 2 s) from which on a flight is turning: the standard rate, 360 deg in two minutes."""

ACCELERATION = 1.0
"""m/s2 along the path (mean over 2 s) from which on flight is not steady: take-off, flare, roll-out."""

CLIMB = 1.5
"""m/s of climb or sink (mean over 2 s) from which on flight is not level."""

SETTLING = 20.0
"""s after a turn, a climb or an acceleration that are transient: what an estimator learnt wrong in it dies away."""

PHASE_RATE = 10.0
"""Hz of the truth from which phases are found."""

STANDING = 0.5
"""m/s below which an aircraft on its wheels stands."""

PHASES = ("ground", "straight", "turning", "transient")
"""Standing on the ground; steady, straight and level; turning in the air; everything else, settling included."""


def classify(t: np.ndarray, q_nb: np.ndarray, vel_n: np.ndarray, on_ground: np.ndarray) -> np.ndarray:
    """Find the phase of every row: index into `PHASES` (n,), found at `PHASE_RATE`.

    Args:
        t: (n,) s, rising.
        q_nb: (n, 4).
        vel_n: (n, 3) m/s, NED.
        on_ground: (n,) weight on the wheels.
    """
    every, rows = t, Decimator(PHASE_RATE).rows(t)
    t, q_nb, vel_n, on_ground = t[rows], q_nb[rows], vel_n[rows], on_ground[rows]
    half = max(1, round(1.0 / float(np.median(np.diff(t)))))
    later, earlier = np.minimum(np.arange(len(t)) + half, len(t) - 1), np.maximum(np.arange(len(t)) - half, 0)

    def slope(x: np.ndarray) -> np.ndarray:
        change: np.ndarray = np.abs(x[later] - x[earlier]) / np.maximum(t[later] - t[earlier], 1e-9)
        return change

    speed, climbed = np.linalg.norm(vel_n, axis=1), np.cumsum(vel_n[:, 2] * np.gradient(t))
    standing = on_ground & (speed < STANDING)
    turning = ~on_ground & (slope(np.unwrap(attitude.euler(q_nb)[:, 2])) > TURN_RATE)
    unsteady = turning | (~standing & (on_ground | (slope(speed) > ACCELERATION) | (slope(climbed) > CLIMB)))
    last = np.maximum.accumulate(np.where(unsteady, t, -np.inf))
    phase = np.where(standing, PHASES.index("ground"), PHASES.index("straight"))
    phase[t - last < SETTLING] = PHASES.index("transient")
    phase[turning] = PHASES.index("turning")
    return at(t, phase, every)


def at(t: np.ndarray, phase: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Look up phases (m,) at `times` (m,) s: of the row at or next after each; -1 where nothing is known.

    Args:
        t: (n,) s, rising.
        phase: (n,) index into `PHASES`.
        times: (m,) s.
    """
    if not len(t):
        return np.full(len(times), -1, np.int8)
    found: np.ndarray = phase[np.clip(np.searchsorted(t, times - 1e-6), 0, len(t) - 1)]
    return found
