"""Inertial measurement unit: gyro and accelerometer, sent in one message.

The accelerometer senses f = f_cg + w' x r + w x (w x r), r from the centre of gravity, which moves, to the unit. The
chip warms up from switch-on towards the air's temperature plus its own heat.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim.flight.truth import Truth
from ahrs_sim.jit import njit
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.grade import figure
from ahrs_sim.sensors.latency import LatencyBuffer
from ahrs_sim.sensors.noise import rms
from ahrs_sim.sensors.records import ImuErrorsRecord, ImuRecord, Record
from ahrs_sim.sensors.sampling import Clock, Lag, nanoseconds
from ahrs_sim.sensors.triad import GyroFigures, InertialFigures, Triad
from ahrs_sim.sensors.vibration import MotorFigures, Vibration


@dataclass(frozen=True)
class ImuFigures:
    """Figures of the unit around gyro and accelerometer."""

    rate: float = figure("frequency", 100.0, minimum=0.1)
    jitter: float = figure("time", minimum=0.0)  # samples taken |N(0, jitter)| ahead of their slot, stamped truly
    stamp_jitter: float = figure("time", minimum=0.0)  # 1 sigma error of the stamps
    lost: float = figure("fraction", minimum=0.0)  # share of the messages that never arrive, one at a time
    warm_up: float = figure("temperature")  # own heat above the air's temperature, once settled
    warm_up_time: float = figure("time", minimum=0.0)  # time constant


class Imu:
    """Inertial unit of a suite: sends records `imu` and `imu_errors` (the true biases, for reports)."""

    records = ("imu", "imu_errors")

    def __init__(self, fitting: Fitting) -> None:
        f = self.figures = fitting.figures("imu", ImuFigures)
        every = fitting.every(f.rate, "imu")
        self.period = every * fitting.dt
        self._from_cg = fitting.position  # m, FRD from where the centre of gravity is at first
        self.position: np.ndarray | None = None  # m, FRD from the aircraft's reference, once the flight has begun
        self._clock = Clock(every)
        # Jitter is clipped at 5 sigma so that the delay line has a fixed length.
        self._earliest = min(5.0 * f.jitter, 0.9 * self.period)
        gyro, accel = fitting.figures("gyro", GyroFigures), fitting.figures("accelerometer", InertialFigures)
        self.gyro = Triad("gyro", gyro, fitting, every, self._earliest)
        self.accel = Triad("accelerometer", accel, fitting, every, self._earliest)
        motor = fitting.figures("motor", MotorFigures)
        cutoffs = self.gyro.band.cutoff, self.accel.band.cutoff
        self._vibration = Vibration(motor, gyro, accel, cutoffs, fitting, every)
        self._clock_noise = fitting.stream("imu", "clock")
        self._losses = fitting.stream("imu", "lost")
        self._heat = Lag(f.warm_up_time, self.period)
        self._cold: float | None = None  # K, at switch-on
        self._buffer = LatencyBuffer(ImuRecord, fitting.channel("gyro"), 0.0)
        self._errors = LatencyBuffer(ImuErrorsRecord, fitting.channel("gyro"), 0.0)

    def info(self) -> dict[str, Any]:
        """Return its fields of `SensorInfo`: data sheet figures, SI."""
        g, a = self.gyro.figures, self.accel.figures
        return {
            "rate": 1.0 / self.period,
            "gyro_noise": rms(g.noise_density),
            "gyro_bias": rms(g.turn_on_bias),
            "gyro_instability": rms(g.bias_floor),
            "gyro_scale": self.gyro.scale_sigma,
            "gyro_scale_factor": rms(g.scale),
            "gyro_misalignment": self.gyro.misalignment_sigma,
            "gyro_drift": rms(g.temperature_drift) * self.figures.warm_up,
            "gyro_delay": self.gyro.band.delay,
            "accel_noise": rms(a.noise_density),
            "accel_bias": rms(a.turn_on_bias),
            "accel_instability": rms(a.bias_floor),
            "accel_drift": rms(a.temperature_drift) * self.figures.warm_up,
            "accel_scale": self.accel.scale_sigma,
            "accel_scale_factor": rms(a.scale),
            "accel_misalignment": self.accel.misalignment_sigma,
            "accel_delay": self.accel.band.delay,
        }

    def drawn(self) -> dict[str, Any]:
        """Return the errors that were drawn for this flight, SI."""
        return self.gyro.drawn() | self.accel.drawn()

    def sense(self, truth: Truth) -> dict[str, Record]:
        """Sense a block of the truth; return the records that arrive within it."""
        n = len(truth)
        if self.position is None and n:
            self.position = truth.cg_b[0] + self._from_cg
        rows, slot, now = self._clock.sample(truth)
        m = len(slot)
        extra = np.zeros(m)
        stamp = slot
        if self._earliest > 0.0 or self.figures.stamp_jitter > 0.0:
            draws = self._clock_noise.standard_normal((m, 2))
            extra = np.minimum(np.abs(draws[:, 0]) * self.figures.jitter, self._earliest)
            stamp = slot - extra + draws[:, 1] * self.figures.stamp_jitter
        force_b = np.empty((n, 3))
        if n:
            _force_at(truth.accel_b, truth.rate_ib_b, truth.rate_dot_b, truth.cg_b, self.position, force_b)
        temperature, warmth = self._temperature(truth.temperature[rows])
        shake, rms2 = self._vibration.shake(truth.rpm, rows, m)
        accel, clipped, accel_bias, accel_effective, force = self.accel.measure(
            force_b, rows, slot, extra, shake[:, 3:], None, rms2, warmth
        )
        gyro, over, gyro_bias, gyro_effective, _ = self.gyro.measure(
            truth.rate_ib_b, rows, slot, extra, shake[:, :3], force, rms2, warmth
        )
        stamp_ns, arrival_ns = nanoseconds(stamp), nanoseconds(slot)
        values: Any = ImuRecord(stamp_ns, arrival_ns, gyro, accel, clipped | over, temperature)
        errors: Any = ImuErrorsRecord(stamp_ns, arrival_ns, gyro_bias, accel_bias, gyro_effective, accel_effective)
        if self.figures.lost > 0.0:
            sent = self._losses.random(m) >= self.figures.lost
            values, errors, slot = values[sent], errors[sent], slot[sent]
        return {"imu": self._buffer.push(values, slot, now), "imu_errors": self._errors.push(errors, slot, now)}

    def _temperature(self, air: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the chip's temperature (m,), K, and its rise since switch-on, when it was as cold as the air."""
        if self._cold is None and len(air):
            self._cold = float(air[0])
            self._heat.apply(air[:1])
        warm = self._heat.apply(air + self.figures.warm_up)
        return warm, warm - (self._cold or 0.0)


@njit
def _force_at(
    force: np.ndarray, rate: np.ndarray, rate_dot: np.ndarray, cg: np.ndarray, place: np.ndarray, out: np.ndarray
) -> None:
    """Compute f + w' x r + w x (w x r) with r = place - cg; all (n, 3), body axes."""
    for i in range(out.shape[0]):
        x, y, z = place[0] - cg[i, 0], place[1] - cg[i, 1], place[2] - cg[i, 2]
        p, q, r = rate[i, 0], rate[i, 1], rate[i, 2]
        dp, dq, dr = rate_dot[i, 0], rate_dot[i, 1], rate_dot[i, 2]
        u, v, w = q * z - r * y, r * x - p * z, p * y - q * x
        out[i, 0] = force[i, 0] + (dq * z - dr * y) + (q * w - r * v)
        out[i, 1] = force[i, 1] + (dr * x - dp * z) + (r * u - p * w)
        out[i, 2] = force[i, 2] + (dp * y - dq * x) + (p * v - q * u)
