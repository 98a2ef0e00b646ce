"""Two-antenna interferometer on a ground emitter: phase modulo 2 pi, its rate, and a coarse bearing from amplitudes.

On the plane tangent to the ellipsoid where the flight began, north and east in m:

    phase = k cos(theta - alpha),    phase rate = -k sin(theta - alpha) (theta' - alpha'),    k = 2 pi f d / c

theta bearing of the emitter, theta' = (v_n sin(theta) - v_e cos(theta)) / R, alpha heading of the baseline, which lies
along the fuselage.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim.flight.truth import Truth
from ahrs_sim.jit import njit
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.grade import figure
from ahrs_sim.sensors.latency import LatencyBuffer
from ahrs_sim.sensors.noise import White
from ahrs_sim.sensors.records import PhaseRecord, Record
from ahrs_sim.sensors.sampling import Clock, nanoseconds, pick
from ahrs_sim.world.wgs84 import radii
from estimators.rotations import nav_vector, wrap

LIGHT = 299792458.0  # m/s


@dataclass(frozen=True)
class PhaseFigures:
    """Figures of an interferometer and of the emitter that it receives."""

    rate: float = figure("frequency", 2.0, minimum=0.01)
    latency: float = figure("time", minimum=0.0)
    frequency: float = figure("frequency", 6e9, minimum=1.0)
    baseline: float = figure("length", 10.0, minimum=1e-3)
    phase_noise: float = figure("angle", minimum=0.0)
    rate_noise: float = figure("rate", minimum=0.0)
    bearing_noise: float = figure("angle", minimum=0.0)
    emitter_north: float = figure("length", 10e3)  # from where the flight begins
    emitter_east: float = figure("length", 10e3)


class Interferometer:
    """Interferometer of a suite: sends records `interferometer`."""

    records = ("interferometer",)

    def __init__(self, fitting: Fitting) -> None:
        f = self.figures = fitting.figures("interferometer", PhaseFigures)
        every = fitting.every(f.rate, "interferometer")
        self.period = every * fitting.dt
        self._clock = Clock(every)
        self._channel = fitting.channel("interferometer")
        self._k = 2.0 * math.pi * f.frequency * f.baseline / LIGHT
        lat, lon, height = fitting.start_lla
        meridian, prime = radii(np.asarray(lat))
        self._origin = np.array([lat, lon])
        self._scale = np.array([meridian + height, (prime + height) * math.cos(lat)])  # m per rad
        self._emitter = np.array([f.emitter_north, f.emitter_east])
        sigma = np.array([f.phase_noise, f.rate_noise, f.bearing_noise])
        self._white = White(sigma, fitting.stream("interferometer", "white"))
        self._buffer = LatencyBuffer(PhaseRecord, self._channel, f.latency)

    def info(self) -> dict[str, Any]:
        """Return nothing: `SensorInfo` has no field for it."""
        return {}

    def drawn(self) -> dict[str, Any]:
        """Return nothing: no error is drawn once a flight."""
        return {}

    def sense(self, truth: Truth) -> dict[str, Record]:
        """Sense a block of the truth; return the records that arrive within it."""
        rows, t, now = self._clock.sample(truth)
        m = len(t)
        if not m:
            return {"interferometer": self._buffer.pop(now)}
        noise = self._white.draw(m)
        if self._channel.shaping:
            self._channel.shape(t, noise[:, :1], np.full((m, 1), np.inf))
        out = np.empty((m, 3))
        motion = [pick(x, rows) for x in (truth.lla, truth.vel_n, truth.q_nb, truth.rate_ib_b)]
        _observe(*motion, self._origin, self._scale, self._emitter, self._k, noise, out)
        self._channel.send(t, out)
        ns = nanoseconds(t)
        return {"interferometer": self._buffer.push(PhaseRecord(ns, ns, out[:, 0], out[:, 1], out[:, 2]), t, now)}


@njit
def _observe(
    lla: np.ndarray, vel_n: np.ndarray, q_nb: np.ndarray, rate: np.ndarray, origin: np.ndarray, scale: np.ndarray,
    emitter: np.ndarray, k: float, noise: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Measure phase in (-pi, pi], phase rate and coarse bearing (m, 3), rad and rad/s."""
    for i in range(out.shape[0]):
        north = emitter[0] - (lla[i, 0] - origin[0]) * scale[0]
        east = emitter[1] - (lla[i, 1] - origin[1]) * scale[1]
        theta = math.atan2(east, north)
        turning = (vel_n[i, 0] * math.sin(theta) - vel_n[i, 1] * math.cos(theta)) / math.sqrt(north**2 + east**2)
        nose_n, nose_e, _ = nav_vector(q_nb[i], 1.0, 0.0, 0.0)
        alpha = math.atan2(nose_e, nose_n)
        # d(alpha)/dt from the velocity of the nose's tip, r y - q z in body axes.
        tip_n, tip_e, _ = nav_vector(q_nb[i], 0.0, rate[i, 2], -rate[i, 1])
        yawing = (nose_n * tip_e - nose_e * tip_n) / (nose_n * nose_n + nose_e * nose_e)
        phase = k * math.cos(theta - alpha) + noise[i, 0]
        out[i, 0] = wrap(phase)
        out[i, 1] = -k * math.sin(theta - alpha) * (turning - yawing) + noise[i, 1]
        out[i, 2] = wrap(theta + noise[i, 2])
