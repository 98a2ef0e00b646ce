"""GNSS receiver: position and velocity of its antenna, delayed, at its own rate, while it has enough satellites.

    position = antenna + start-up exp(-t/T) + wander (Gauss-Markov) + white
    velocity = antenna's velocity, lagging (first order), + d/dt of the start-up error + wander + white
    antenna  = CG + C_nb r,    its velocity = v + C_nb (w x r)

Below four satellites a message has no fix and holds NaN; then the receiver takes a while to acquire them again.
"""

import datetime
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.flight.truth import Truth
from ahrs_sim.jit import njit
from ahrs_sim.sensors.faults import Faults
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.grade import figure
from ahrs_sim.sensors.imu import Imu
from ahrs_sim.sensors.latency import LatencyBuffer
from ahrs_sim.sensors.noise import White, gauss_markov, rms
from ahrs_sim.sensors.records import FixRecord, Record, VelocityRecord
from ahrs_sim.sensors.sampling import Clock, nanoseconds, pick
from ahrs_sim.world import satellites
from estimators.earth import move
from estimators.rotations import nav_vector


@dataclass(frozen=True)
class GnssFigures:
    """Figures of a receiver; sigmas are north, east, down."""

    rate: float = figure("frequency", 5.0, minimum=0.01)
    latency: float = figure("time", minimum=0.0)
    undeclared: float = figure("time", minimum=0.0)  # part of the latency that the stamps do not know of
    velocity_lag: float = figure("time", minimum=0.0)  # time constant of the receiver's own filter of the velocity
    fix_type: float = figure("number", 0.0)  # NavSatStatus of a good fix: 0 single point, 1 SBAS, 2 RTK
    position_noise: np.ndarray = figure("length", size=3, minimum=0.0)  # 1 sigma, white
    position_wander: np.ndarray = figure("length", size=3, minimum=0.0)  # 1 sigma, Gauss-Markov
    velocity_noise: np.ndarray = figure("speed", size=3, minimum=0.0)
    velocity_wander: np.ndarray = figure("speed", size=3, minimum=0.0)
    start_up: np.ndarray = figure("length", size=3, minimum=0.0)  # 1 sigma off at switch-on, until it has settled
    start_up_time: float = figure("time", 60.0, minimum=1e-3)  # time constant of that
    wander_time: float = figure("time", 60.0, minimum=1e-3)  # correlation time
    antenna: np.ndarray = figure("length", size=3)  # from the inertial unit, FRD
    mask: float = figure("angle", math.radians(10.0))  # elevation above the horizon
    shadow: float = figure("angle", 0.0)  # elevation above the wings that the airframe hides
    reacquisition: float = figure("time", minimum=0.0)  # from satellites enough to a fix, after a loss


class Sky:
    """Satellites received by the antennas of one suite."""

    def __init__(self, figures: GnssFigures, epoch: datetime.datetime, faults: Faults) -> None:
        self._figures = figures
        self._offset = satellites.seconds_since_epoch(epoch)
        self._faults = faults
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    def count(self, t: np.ndarray, lla: np.ndarray, q_nb: np.ndarray) -> np.ndarray:
        """Count the satellites (m,) received at `t` (m,) s, `lla` (m, 3) rad, rad, m, `q_nb` (m, 4)."""
        # Position and heading receivers mostly ask for the same instants.
        if self._last is not None and np.array_equal(self._last[0], t):
            return self._last[1]
        f = self._figures
        seen = satellites.in_view(self._offset + t, lla, q_nb, f.mask, f.shadow)
        count = np.asarray(np.minimum(seen, self._faults.most_satellites(t)))
        self._last = (t, count)
        return count


class SatelliteLock:
    """Satellite lock with immediate loss and delayed re-acquisition."""

    def __init__(self, least: int, wait: float, period: float) -> None:
        self._least = least
        self._wait = round(wait / period)
        self._left = 0  # samples still to wait

    def update(self, count: np.ndarray) -> np.ndarray:
        """Mask the samples with a solution, from the number of satellites (m,)."""
        good = np.empty(len(count), bool)
        for i, n in enumerate(count.tolist()):
            if n < self._least:
                self._left = self._wait
                good[i] = False
            else:
                good[i] = self._left == 0
                self._left = max(self._left - 1, 0)
        return good


class Gnss:
    """GNSS receiver of a suite: sends records `fix` and `velocity`, both of one instant."""

    records = ("fix", "velocity")

    def __init__(self, fitting: Fitting, sky: Sky, imu: Imu) -> None:
        f = self.figures = fitting.figures("gnss", GnssFigures)
        every = fitting.every(f.rate, "gnss")
        self.period = every * fitting.dt
        self._clock = Clock(every)
        self._imu = imu
        self._sky = sky
        self._lock = SatelliteLock(4, f.reacquisition, self.period)
        self._position = fitting.channel("position")
        self._velocity = fitting.channel("velocity")
        self._noise = [
            (White(f.position_noise, fitting.stream("gnss", "position white")),
             gauss_markov(f.position_wander, f.wander_time, self.period, fitting.stream("gnss", "position wander"))),
            (White(f.velocity_noise, fitting.stream("gnss", "velocity white")),
             gauss_markov(f.velocity_wander, f.wander_time, self.period, fitting.stream("gnss", "velocity wander"))),
        ]  # fmt: skip
        self.sigma = np.sqrt(f.position_noise**2 + f.position_wander**2)
        self.start_up = fitting.anew("gnss", "start-up", 3) * f.start_up
        self._lagging: tuple[np.ndarray, np.ndarray] | None = None  # m/s, filtered and true velocity at the last fix
        if f.undeclared > f.latency:
            raise InputError(
                f"{fitting.where}: [gnss] undeclared: {f.undeclared:g} s is more than the latency of {f.latency:g} s"
            )
        self._fixes = LatencyBuffer(FixRecord, self._position, f.latency)
        self._velocities = LatencyBuffer(VelocityRecord, self._velocity, f.latency)

    def info(self) -> dict[str, Any]:
        """Return its fields of `SensorInfo`: data sheet figures, SI."""
        f = self.figures
        return {
            "gnss_pos": rms(self.sigma),
            "gnss_vel": float(np.hypot(rms(f.velocity_noise), rms(f.velocity_wander))),
            "antenna_b": tuple(f.antenna.tolist()),
        }

    def drawn(self) -> dict[str, Any]:
        """Return the truth of what was drawn, SI."""
        return {"gnss.start_up": self.start_up} if self.start_up.any() else {}

    def sense(self, truth: Truth) -> dict[str, Record]:
        """Sense a block of the truth; return the records that arrive within it."""
        rows, t, now = self._clock.sample(truth)
        m = len(t)
        if not m:
            return {"fix": self._fixes.pop(now), "velocity": self._velocities.pop(now)}
        lla, q_nb = pick(truth.lla, rows), pick(truth.q_nb, rows)
        count = self._sky.count(t, lla, q_nb)
        errors = []
        for (white, wander), channel in zip(self._noise, (self._position, self._velocity), strict=True):
            noise = white.draw(m)
            if channel.shaping:
                channel.shape(t, noise, np.full((m, 3), np.inf))
            errors.append(noise + wander.draw(m))
        antenna = self._imu.position + self.figures.antenna - truth.cg_b[rows]
        lla_deg, vel_n = np.empty((m, 3)), np.empty((m, 3))
        vel, rate = pick(truth.vel_n, rows), pick(truth.rate_ib_b, rows)
        if self.start_up.any():
            left = np.exp(-t[:, None] / self.figures.start_up_time) * self.start_up
            errors[0] = errors[0] + left
            errors[1] = errors[1] - left / self.figures.start_up_time
        _antenna(lla, vel, q_nb, rate, antenna, errors[0], np.zeros((m, 3)), lla_deg, vel_n)
        vel_n = self._lag(vel_n) + errors[1]
        lost = ~self._lock.update(count)
        lla_deg[lost] = vel_n[lost] = np.nan
        sigma = np.where(lost[:, None], np.nan, self.sigma)
        fix = np.where(lost, -1, int(self.figures.fix_type)).astype(np.int8)
        self._position.send(t, lla_deg)
        self._velocity.send(t, vel_n)
        stamp, ns = nanoseconds(t + self.figures.undeclared), nanoseconds(t)
        fixes = FixRecord(stamp, ns, lla_deg, sigma, fix, count.astype(np.uint8))
        return {
            "fix": self._fixes.push(fixes, t, now),
            "velocity": self._velocities.push(VelocityRecord(stamp, ns, vel_n), t, now),
        }

    def _lag(self, vel_n: np.ndarray) -> np.ndarray:
        """Velocities (m, 3) behind the receiver's own first-order filter, exact for a velocity linear between fixes."""
        lag = self.figures.velocity_lag
        if not lag > 0.0:
            return vel_n
        keep = math.exp(-self.period / lag)
        before = lag * (1.0 - keep) / self.period - keep  # weight of the velocity at the last fix
        state, last = (vel_n[0], vel_n[0]) if self._lagging is None else self._lagging
        out = np.empty_like(vel_n)
        for k, now in enumerate(vel_n):
            state = keep * state + before * last + (1.0 - keep - before) * now
            out[k], last = state, now
        self._lagging = state, last
        return out


@njit
def _antenna(
    lla: np.ndarray, vel_n: np.ndarray, q_nb: np.ndarray, rate: np.ndarray, arm: np.ndarray, position_error: np.ndarray,
    velocity_error: np.ndarray, lla_deg: np.ndarray, out_vel: np.ndarray,
) -> None:  # fmt: skip
    """Compute the antenna's place (deg, deg, m) and velocity, `arm` (m, 3) from the CG in body axes, errors in NED.

    The rate is inertial: the Earth's turning of the arm, 1e-4 m/s for a metre, is left in.
    """
    deg = 180.0 / math.pi
    for i in range(lla.shape[0]):
        x, y, z = arm[i, 0], arm[i, 1], arm[i, 2]
        p, q, r = rate[i, 0], rate[i, 1], rate[i, 2]
        turning = nav_vector(q_nb[i], q * z - r * y, r * x - p * z, p * y - q * x)
        for k in range(3):
            out_vel[i, k] = vel_n[i, k] + turning[k] + velocity_error[i, k]
        north, east, below = nav_vector(q_nb[i], x, y, z)
        move(
            lla[i],
            north + position_error[i, 0],
            east + position_error[i, 1],
            below + position_error[i, 2],
            lla_deg[i],
        )
        lla_deg[i, 0] *= deg
        lla_deg[i, 1] *= deg
