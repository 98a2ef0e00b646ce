"""Dual-antenna heading: the azimuth of a baseline between two GNSS antennas.

    heading = atan2(east, north) of C_nb e + (wander + white) / L,    e: the baseline's direction

The error of the phase difference, some mm, over the baseline's length L is the error in rad; most of it is multipath
and wanders. The baseline is misaligned by an angle unknown to the unit (one draw a flight). Needs six satellites;
sometimes the ambiguities are fixed to wrong integers and the heading is off by about a wavelength over L until that is
noticed.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.flight.truth import Truth
from ahrs_sim.jit import njit
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.gnss import SatelliteLock, Sky
from ahrs_sim.sensors.grade import figure
from ahrs_sim.sensors.latency import LatencyBuffer
from ahrs_sim.sensors.noise import White, gauss_markov
from ahrs_sim.sensors.records import HeadingRecord, Record
from ahrs_sim.sensors.sampling import Clock, nanoseconds, pick
from estimators.rotations import nav_vector, wrap

WAVELENGTH = 0.1903  # m, GPS L1
LEAST_SATELLITES = 6


@dataclass(frozen=True)
class HeadingFigures:
    """Figures of a receiver with two antennas."""

    rate: float = figure("frequency", 5.0, minimum=0.01)
    latency: float = figure("time", minimum=0.0)
    baseline: float = figure("length", 1.0, minimum=0.05)
    baseline_yaw: float = figure("angle")  # of the second antenna from the first, against the nose; taken out again
    phase_noise: float = figure("length", minimum=0.0)  # 1 sigma, white
    phase_wander: float = figure("length", minimum=0.0)  # 1 sigma, Gauss-Markov
    wander_time: float = figure("time", 60.0, minimum=1e-3)
    misalignment: float = figure("angle", minimum=0.0)  # 1 sigma, in yaw and pitch
    wrong_fixes: float = figure("per_hour", minimum=0.0)
    wrong_fix_time: float = figure("time", 10.0, minimum=1e-3)  # how long one lasts
    reacquisition: float = figure("time", minimum=0.0)


class DualAntenna:
    """Heading receiver of a suite: sends records `heading`, NaN without a solution."""

    records = ("heading",)

    def __init__(self, fitting: Fitting, sky: Sky) -> None:
        f = self.figures = fitting.figures("heading", HeadingFigures)
        every = fitting.every(f.rate, "heading")
        self.period = every * fitting.dt
        self.sigma = math.hypot(f.phase_noise, f.phase_wander) / f.baseline
        self._clock = Clock(every)
        self._sky = sky
        self._lock = SatelliteLock(LEAST_SATELLITES, f.reacquisition, self.period)
        self._channel = fitting.channel("heading")
        self.misalignment = fitting.normal("heading", "turn-on", 2) * f.misalignment  # rad, yaw and pitch
        self._direction = attitude.matrix(0.0, self.misalignment[1], f.baseline_yaw + self.misalignment[0])[:, 0].copy()
        self._white = White(np.array([f.phase_noise / f.baseline]), fitting.stream("heading", "white"))
        wander = np.array([f.phase_wander / f.baseline])
        self._wander = gauss_markov(wander, f.wander_time, self.period, fitting.stream("heading", "wander"))
        self._wrong = fitting.stream("heading", "wrong fixes")
        self._wrong_offset = math.asin(min(WAVELENGTH / f.baseline, 1.0))
        self._wrong_state = np.zeros(2)  # samples left, offset in rad
        self._buffer = LatencyBuffer(HeadingRecord, self._channel, f.latency)

    def info(self) -> dict[str, Any]:
        """Return its fields of `SensorInfo`: data sheet figures, SI."""
        return {"heading": self.sigma, "heading_mount": self.figures.misalignment}

    def drawn(self) -> dict[str, Any]:
        """Return the errors that were drawn for this flight, SI."""
        return {"heading.misalignment": self.misalignment}

    def sense(self, truth: Truth) -> dict[str, Record]:
        """Sense a block of the truth; return the records that arrive within it."""
        rows, t, now = self._clock.sample(truth)
        m = len(t)
        if not m:
            return {"heading": self._buffer.pop(now)}
        f = self.figures
        q_nb = pick(truth.q_nb, rows)
        count = self._sky.count(t, pick(truth.lla, rows), q_nb)
        noise = self._white.draw(m)
        if self._channel.shaping:
            self._channel.shape(t, noise, np.full((m, 1), np.inf))
        noise += self._wander.draw(m)
        heading = np.empty((m, 1))
        _azimuth(q_nb, self._direction, f.baseline_yaw, noise, self._wrong.random((m, 2)), f.wrong_fixes * self.period,
                 f.wrong_fix_time / self.period, self._wrong_offset, self._wrong_state, heading)  # fmt: skip
        lost = ~self._lock.update(count)
        heading[lost] = np.nan
        self._channel.send(t, heading)
        ns = nanoseconds(t)
        sigma = np.where(lost, np.nan, self.sigma)
        sent = HeadingRecord(ns, ns, heading[:, 0], sigma, count.astype(np.uint8))
        return {"heading": self._buffer.push(sent, t, now)}


@njit
def _azimuth(
    q_nb: np.ndarray, e: np.ndarray, yaw: float, noise: np.ndarray, uniform: np.ndarray, chance: float,
    lasting: float, offset: float, state: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Measure the heading (m, 1) rad in (-pi, pi]; NaN when the baseline points within 10 deg of the vertical."""
    for i in range(out.shape[0]):
        north, east, _ = nav_vector(q_nb[i], e[0], e[1], e[2])
        if state[0] > 0.0:
            state[0] -= 1.0
        elif uniform[i, 0] < chance:
            state[0] = lasting
            state[1] = offset if uniform[i, 1] < 0.5 else -offset
        wrong = state[1] if state[0] > 0.0 else 0.0
        if north * north + east * east < 0.03:
            out[i, 0] = np.nan
            continue
        out[i, 0] = wrap(math.atan2(east, north) - yaw + noise[i, 0] + wrong)
