"""Air data: two measured pressures, and the airspeeds that an air data computer derives from them.

    impact pressure  qc = p ((1 + 0.2 M^2)^3.5 - 1),  M = V / sqrt(1.4 R T)
    static port      ps = p + day + k qc              k: position error
    diff pressure    = (1 + s) (qc - k qc) + bias + wander + noise
    static pressure  = ps + bias + wander + noise
    indicated        = sqrt(1.4 R T0) sqrt(5 ((qc / p0 + 1)^(2/7) - 1)), sea level of the standard atmosphere
    true             = the same with p and T of the place

The pipes make both pressures lag. The pressure of the day differs from the standard atmosphere's: one draw a flight for
all suites. Vanes, where fitted, read angle of attack and sideslip of the undisturbed flow, and nothing when it is slow.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from ahrs_sim.flight.truth import Truth
from ahrs_sim.jit import njit
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.grade import figure
from ahrs_sim.sensors.latency import LatencyBuffer
from ahrs_sim.sensors.noise import White, gauss_markov
from ahrs_sim.sensors.records import AirRecord, PressureRecord, Record
from ahrs_sim.sensors.sampling import Clock, Lag, nanoseconds, pick
from estimators import native

GAS_CONSTANT = 287.05287  # J/(kg K), dry air
SEA_LEVEL_PRESSURE = 101325.0  # Pa
SEA_LEVEL_TEMPERATURE = 288.15  # K
VANE_SPEED = 5.0  # m/s: below, a vane does not align itself


@dataclass(frozen=True)
class AirFigures:
    """Figures of an air data unit; sigmas of one sample, or of one draw a flight."""

    rate: float = figure("frequency", 50.0, minimum=0.1)
    latency: float = figure("time", minimum=0.0)
    lag: float = figure("time", minimum=0.0)  # time constant of the pipes
    diff_range: float = figure("pressure", math.inf, minimum=0.0)
    diff_quantum: float = figure("pressure", minimum=0.0)
    diff_noise: float = figure("pressure", minimum=0.0)
    diff_bias: float = figure("pressure", minimum=0.0)
    diff_wander: float = figure("pressure", minimum=0.0)
    diff_scale: float = figure("fraction", minimum=0.0)
    static_quantum: float = figure("pressure", minimum=0.0)
    static_noise: float = figure("pressure", minimum=0.0)
    static_bias: float = figure("pressure", minimum=0.0)
    static_wander: float = figure("pressure", minimum=0.0)
    wander_time: float = figure("time", 100.0, minimum=1e-3)
    position_error: float = figure("fraction", minimum=0.0)  # of the impact pressure, at the static port
    day_pressure: float = figure("pressure", minimum=0.0)  # of the day against the standard atmosphere
    temperature_bias: float = figure("temperature", minimum=0.0)  # of the outside air thermometer
    vanes: float = figure("number", 0.0, minimum=0.0)  # 1: fitted
    vane_noise: float = figure("angle", minimum=0.0)
    vane_bias: float = figure("angle", minimum=0.0)
    vane_lag: float = figure("time", minimum=0.0)


class PressureErrors(native.Record):
    """Holds the errors of the two pressures that are drawn once a flight; columns: differential, static."""

    day: native.Number  # Pa, the day's pressure less the standard one
    position_error: native.Number  # part of the impact pressure that the static port sees
    share: native.Number  # of a step that the pipes' lag covers
    scale: Annotated[np.ndarray, native.shaped(2)]
    bias: Annotated[np.ndarray, native.shaped(2)]  # Pa
    quantum: Annotated[np.ndarray, native.shaped(2)]  # Pa


class AirData:
    """Air data unit of a suite: sends records `diff_pressure`, `static_pressure` and `air`."""

    records = ("diff_pressure", "static_pressure", "air")

    def __init__(self, fitting: Fitting) -> None:
        f = self.figures = fitting.figures("air_data", AirFigures)
        every = fitting.every(f.rate, "air_data")
        self.period = every * fitting.dt
        self._clock = Clock(every)
        self._channels = [fitting.channel(name) for name in ("diff_pressure", "static_pressure", "vanes")]

        def drawn(term: str) -> float:
            return float(fitting.normal("air_data", term))

        self.diff_bias, self.static_bias = drawn("diff bias") * f.diff_bias, drawn("static bias") * f.static_bias  # Pa
        self.diff_scale = drawn("diff scale") * f.diff_scale
        self.position_error = drawn("position error") * f.position_error
        self.temperature_bias = drawn("temperature bias") * f.temperature_bias  # K
        self.vane_bias = fitting.normal("air_data", "vane bias", 2) * f.vane_bias  # rad
        self.day_pressure = fitting.world("pressure of the day").standard_normal() * f.day_pressure  # Pa
        self._errors = PressureErrors.of(
            day=self.day_pressure,
            position_error=self.position_error,
            share=_share(f.lag, fitting.dt),
            scale=(self.diff_scale, 0.0),
            bias=(self.diff_bias, self.static_bias),
            quantum=(f.diff_quantum, f.static_quantum),
        )
        self._pipes = np.full(2, np.nan)  # Pa, state of the lag: impact, static
        self._white = White(np.array([f.diff_noise, f.static_noise]), fitting.stream("air_data", "white"))
        wander = np.array([f.diff_wander, f.static_wander])
        self._wander = gauss_markov(wander, f.wander_time, self.period, fitting.stream("air_data", "wander"))
        self._vane_white = White(np.full(2, f.vane_noise), fitting.stream("air_data", "vanes"))
        self._vane_lags = [Lag(f.vane_lag, fitting.dt), Lag(f.vane_lag, fitting.dt)]
        self._limit = np.array([f.diff_range, np.inf])
        kinds = zip((PressureRecord, PressureRecord, AirRecord), self.records, strict=True)
        self._buffers = [LatencyBuffer(cls, fitting.channel(name), f.latency) for cls, name in kinds]

    def info(self) -> dict[str, Any]:
        """Return its fields of `SensorInfo`: data sheet figures, SI."""
        # Near the ground, where a sigma of pressure is one of airspeed by dq = rho V dV, V = 20 m/s.
        return {"airspeed": self.figures.diff_noise / (1.225 * 20.0), "airspeed_scale": 0.5 * self.figures.diff_scale}

    def drawn(self) -> dict[str, Any]:
        """Return the errors that were drawn for this flight, SI."""
        return {
            "air_data.diff_bias": self.diff_bias,
            "air_data.static_bias": self.static_bias,
            "air_data.diff_scale": self.diff_scale,
            "air_data.position_error": self.position_error,
            "air_data.temperature_bias": self.temperature_bias,
            "air_data.vane_bias": self.vane_bias,
            "air_data.day_pressure": self.day_pressure,
        }

    def sense(self, truth: Truth) -> dict[str, Record]:
        """Sense a block of the truth; return the records that arrive within it."""
        rows, t, now = self._clock.sample(truth)
        m = len(t)
        pressures, air = np.empty((m, 2)), np.empty((m, 4))
        noise = self._white.draw(m)
        limit = np.empty((m, 2))
        limit[:] = self._limit
        for k in (0, 1):
            if self._channels[k].shaping:
                self._channels[k].shape(t, noise[:, k : k + 1], limit[:, k : k + 1])
        noise += self._wander.draw(m)
        _sense(native.argument(self._errors), truth.pressure, truth.temperature, truth.airspeed, rows.start,
               self._clock.every, noise, limit, self._pipes, pressures)  # fmt: skip
        for k in (0, 1):
            if self._channels[k].sending:
                self._channels[k].send(t, pressures[:, k : k + 1])
        _compute(pressures, pick(truth.temperature, rows), self.temperature_bias, air)
        air[:, 2:] = self._vanes(truth, rows, t, air[:, 1])
        ns = nanoseconds(t)
        diff, static, computed = self._buffers
        return {
            "diff_pressure": diff.push(PressureRecord(ns, ns, pressures[:, 0]), t, now),
            "static_pressure": static.push(PressureRecord(ns, ns, pressures[:, 1]), t, now),
            "air": computed.push(AirRecord(ns, ns, air[:, 0], air[:, 1], air[:, 2], air[:, 3]), t, now),
        }

    def _vanes(self, truth: Truth, rows: slice, t: np.ndarray, airspeed: np.ndarray) -> np.ndarray:
        """Measure angle of attack and sideslip (m, 2), rad; NaN without vanes or below `VANE_SPEED`."""
        m = len(t)
        if not self.figures.vanes:
            return np.full((m, 2), np.nan)
        noise = self._vane_white.draw(m)
        channel = self._channels[2]
        if channel.shaping:
            channel.shape(t, noise, np.full((m, 2), np.inf))
        angles = zip(self._vane_lags, (truth.alpha, truth.beta), strict=True)
        values = np.column_stack([lag.apply(angle)[rows] for lag, angle in angles]) + self.vane_bias + noise
        # Not "airspeed < ..." alone: an airspeed lost to a fault says nothing about the vane.
        values[airspeed < VANE_SPEED] = np.nan
        channel.send(t, values)
        return np.asarray(values)


def _share(time: float, dt: float) -> float:
    """Compute the share of a step that a first-order lag covers in `dt` s."""
    return -math.expm1(-dt / time) if time > 0.0 else 1.0


@njit
def _sense(
    errors: PressureErrors, p: np.ndarray, temperature: np.ndarray, airspeed: np.ndarray, first: int, every: int,
    noise: np.ndarray, limit: np.ndarray, pipes: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Measure differential and static pressure (m, 2), Pa, from truth rows (n,)."""
    m = 0
    for i in range(p.shape[0]):
        mach2 = airspeed[i] * airspeed[i] / (1.4 * GAS_CONSTANT * temperature[i])
        qc = p[i] * math.expm1(3.5 * math.log1p(0.2 * mach2))
        static = p[i] + errors.day + errors.position_error * qc
        impact = (1.0 - errors.position_error) * qc
        if np.isnan(pipes[0]) or errors.share == 1.0:
            pipes[0] = impact
            pipes[1] = static
        else:
            pipes[0] += errors.share * (impact - pipes[0])
            pipes[1] += errors.share * (static - pipes[1])
        if i != first + m * every or m >= out.shape[0]:
            continue
        for k in range(2):
            v = (1.0 + errors.scale[k]) * pipes[k] + errors.bias[k]
            v = min(max(v + noise[m, k], -limit[m, k]), limit[m, k])
            quantum = errors.quantum[k]
            out[m, k] = np.rint(v / quantum) * quantum if quantum > 0.0 else v
        m += 1


@njit
def _compute(pressures: np.ndarray, temperature: np.ndarray, temperature_bias: float, out: np.ndarray) -> None:
    """Compute indicated and true airspeed, m/s, into the first two columns of `out` (m, 4)."""
    for i in range(out.shape[0]):
        q = pressures[i, 0]
        p = pressures[i, 1]
        t = temperature[i] + temperature_bias
        if q != q or p != p:
            out[i, 0] = out[i, 1] = np.nan
            continue
        q = max(q, 0.0)  # a pitot tube blown at from behind reads nothing
        p = max(p, 1.0)
        out[i, 0] = math.sqrt(1.4 * GAS_CONSTANT * SEA_LEVEL_TEMPERATURE) * math.sqrt(
            5.0 * math.expm1(2.0 / 7.0 * math.log1p(q / SEA_LEVEL_PRESSURE))
        )
        out[i, 1] = math.sqrt(1.4 * GAS_CONSTANT * t) * math.sqrt(5.0 * math.expm1(2.0 / 7.0 * math.log1p(q / p)))
