"""Three axes of one kind: the errors that gyro, accelerometer and magnetometer share, in this order.

    u  = band limit and delay (true quantity), in the sensor's axes
    y  = (I + S + M) u + k u^2 / range + G f + v a^2 + bias + white noise + vibration + fault
    bias = turn-on + in-run (flicker, random walk) + temperature
    sent = quantise(clip(y)), turned back into body axes by the mounting that the unit knows

S scale factors, M misalignment and cross-axis sensitivity, k non-linearity, G g-sensitivity, v vibration rectification
with a the vibration's rms acceleration. S, M, k, G, v and the turn-on bias are drawn once a flight; all but the
turn-on bias of gyro and accelerometer once a unit, where the suite says which (`unit_seed`).
"""

import math
from dataclasses import dataclass

import numpy as np

from ahrs_sim.jit import njit
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.grade import figure
from ahrs_sim.sensors.noise import White, in_run_bias, rms, white_sigma
from ahrs_sim.sensors.sampling import BandLimit
from estimators.native import Flag, Matrix3, Number, Record, Vector3, argument


@dataclass(frozen=True)
class TriadFigures:
    """Figures of any triad; 1 sigma where a value is drawn. `*` is the quantity that the sensor measures."""

    range: np.ndarray = figure("*", math.inf, size=3, minimum=0.0)
    quantum: float = figure("*", minimum=0.0)
    noise_density: np.ndarray = figure("*_rthz", size=3, minimum=0.0)  # single-sided
    turn_on_bias: np.ndarray = figure("*", size=3, minimum=0.0)
    bias_floor: np.ndarray = figure("*", size=3, minimum=0.0)  # minimum of the Allan deviation: 0.664 B
    rate_random_walk: np.ndarray = figure("*_rts", size=3, minimum=0.0)
    temperature_drift: np.ndarray = figure("*_per_k", size=3, minimum=0.0)
    scale: np.ndarray = figure("fraction", size=3, minimum=0.0)
    misalignment: float = figure("angle", minimum=0.0)  # of an axis, about each of the two others
    cross_axis: float = figure("fraction", minimum=0.0)
    non_linearity: float = figure("fraction", minimum=0.0)  # of the range, at the range
    bandwidth: float = figure("frequency", minimum=0.0)  # -3 dB; 0: none
    antialias: float = figure("fraction", minimum=0.0)  # low-pass ahead of decimation, in parts of the output rate
    delay: float = figure("time", minimum=0.0)  # value at stamp t was true at t - delay, filters included


@dataclass(frozen=True)
class InertialFigures(TriadFigures):
    """Further figures of gyro and accelerometer."""

    vibration_rectification: np.ndarray = figure("*_per_g2", size=3, minimum=0.0)
    vibration_line: np.ndarray = figure("*", size=3, minimum=0.0)  # amplitude at the shaft's rate and reference speed
    vibration_band: np.ndarray = figure("*", size=3, minimum=0.0)  # rms of a sample at the reference speed


@dataclass(frozen=True)
class GyroFigures(InertialFigures):
    """Further figures of a gyro."""

    g_sensitivity: float = figure("rate_per_g", minimum=0.0)


class TriadErrors(Record):
    """Holds the terms of the equation at the head of this file that are drawn once a flight, in the sensor's axes."""

    true_mount: Matrix3  # from body to sensor axes
    mount: Matrix3  # the same, as the unit knows it
    matrix: Matrix3  # I + S + M
    square: Vector3  # k / range
    g_matrix: Matrix3  # G
    rectification: Vector3  # v
    temperature: Vector3  # bias per K
    turn_on: Vector3
    quantum: Number
    own_input: Flag  # the effective bias includes what the sensor's own input causes


class Triad:
    """One three-axis sensor of a suite.

    Args:
        name: its section of the grade, its channel of faults and the first part of its streams' names.
        figures: of its grade.
        fitting: of its suite.
        every: rows of the truth per sample.
        longest: s of additional delay that a sample may have (jitter).
    """

    def __init__(self, name: str, figures: TriadFigures, fitting: Fitting, every: int, longest: float = 0.0) -> None:
        f = self.figures = figures
        self.name = name
        self.channel = fitting.channel(name)
        self.period = fitting.dt * every
        rate = 1.0 / self.period
        corners = [c for c in (f.bandwidth, f.antialias * rate) if c > 0.0]
        self.band = BandLimit(min(corners, default=0.0), f.delay, fitting.dt, every, longest)
        # A stream for each term: another term, or another size of one, leaves the draws of all others as they are.
        matrix = math.tan(f.misalignment) * fitting.normal(name, "misalignment", 3, 3)
        matrix += f.cross_axis * fitting.normal(name, "cross-axis", 3, 3)
        np.fill_diagonal(matrix, 1.0 + f.scale * fitting.normal(name, "scale", 3))
        finite = np.isfinite(f.range)
        draw_bias = fitting.anew if isinstance(f, InertialFigures) else fitting.normal  # iron stays where it is
        square = fitting.normal(name, "non-linearity", 3) * f.non_linearity
        self.errors = TriadErrors.of(
            true_mount=np.einsum("ij,jk->ik", fitting.mounting_error, fitting.mount),
            mount=fitting.mount,
            matrix=matrix,
            square=square * (finite / np.where(finite, f.range, 1.0)),
            g_matrix=fitting.normal(name, "g-sensitivity", 3, 3) * getattr(f, "g_sensitivity", 0.0),
            rectification=fitting.normal(name, "rectification", 3) * getattr(f, "vibration_rectification", np.zeros(3)),
            temperature=fitting.normal(name, "temperature", 3) * f.temperature_drift,
            turn_on=draw_bias(name, "turn-on", 3) * f.turn_on_bias,
            quantum=f.quantum,
            own_input=not isinstance(f, GyroFigures),
        )
        # Parts of the record: whoever changes them (a magnetometer's iron) changes what is measured.
        self.matrix, self.turn_on = self.errors.matrix, self.errors.turn_on
        self._white = White(white_sigma(f.noise_density, rate), fitting.stream(name, "white"))
        self._in_run = in_run_bias(f.bias_floor, f.rate_random_walk, self.period, fitting.stream(name, "in-run"))
        # Whole quanta within the range, so that quantising what was clipped changes nothing more.
        self._limit = np.floor(f.range / f.quantum) * f.quantum if f.quantum > 0.0 else f.range

    @property
    def scale_sigma(self) -> float:
        """Compute one sigma for scale factor, misalignment and cross-axis sensitivity together, rad."""
        return math.hypot(rms(self.figures.scale), self.misalignment_sigma)

    @property
    def misalignment_sigma(self) -> float:
        """Compute one sigma for misalignment and cross-axis sensitivity together, rad."""
        return math.hypot(math.tan(self.figures.misalignment), self.figures.cross_axis)

    def drawn(self) -> dict[str, np.ndarray]:
        """Return the errors that were drawn for this flight, SI, in the sensor's axes."""
        return {f"{self.name}.turn_on_bias": self.turn_on, f"{self.name}.matrix": self.matrix}

    def measure(
        self, u_b: np.ndarray, rows: slice, t: np.ndarray, extra: np.ndarray, added: np.ndarray | None = None,
        force_b: np.ndarray | None = None, rms2: np.ndarray | None = None, warmth: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Measure one block.

        Args:
            u_b: true quantity (n, 3) at every row of the truth, body axes.
            rows: the sampled ones.
            t: (m,) s, stamps.
            extra: (m,) s, additional delay of each sample.
            added: (m, 3) vibration.
            force_b: (m, 3) m/s2, specific force, for the g-sensitivity.
            rms2: (m,) (m/s2)^2 of vibration, for its rectification.
            warmth: (m,) K above the temperature at switch-on.

        Returns:
            values (m, 3), saturated (m,), true bias (m, 3) of turn-on, in-run and temperature, effective bias (m, 3)
            and the noiseless input (m, 3), all in body axes. The effective bias is all that the values are off the
            input but noise, vibration and range; of a sensor with g-sensitivity without what its own input causes.
        """
        m = len(t)
        u = self.band.apply(u_b, rows, extra)
        noise = self._white.draw(m)
        limit = np.empty((m, 3))
        limit[:] = self._limit
        if self.channel.shaping:
            self.channel.shape(t, noise, limit)
        if added is not None:
            noise += added
        bias = self._in_run.draw(m)
        out, effective, saturated = np.empty((m, 3)), np.empty((m, 3)), np.zeros(m, bool)
        none = np.zeros(m)
        _triad(argument(self.errors), u, u if force_b is None else force_b, none if rms2 is None else rms2,
               none if warmth is None else warmth, noise, limit, bias, effective, out, saturated)  # fmt: skip
        if self.channel.sending:
            self.channel.send(t, out)
        return out, saturated, bias, effective, u


@njit
def _triad(
    errors: TriadErrors, u_b: np.ndarray, force_b: np.ndarray, rms2: np.ndarray, warmth: np.ndarray, noise: np.ndarray,
    limit: np.ndarray, bias: np.ndarray, effective: np.ndarray, out: np.ndarray, saturated: np.ndarray,
) -> None:  # fmt: skip
    """Evaluate the equation at the head of this file, row by row.

    `bias` (m, 3) comes as the in-run part in sensor axes and leaves as the whole in body axes.
    """
    true_mount, mount, matrix, g_matrix = errors.true_mount, errors.mount, errors.matrix, errors.g_matrix
    square, rectification, quantum = errors.square, errors.rectification, errors.quantum
    u, f, y, b, e = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(out.shape[0]):
        for k in range(3):
            c0, c1, c2 = true_mount[k, 0], true_mount[k, 1], true_mount[k, 2]
            u[k] = c0 * u_b[i, 0] + c1 * u_b[i, 1] + c2 * u_b[i, 2]
            f[k] = c0 * force_b[i, 0] + c1 * force_b[i, 1] + c2 * force_b[i, 2]
        for k in range(3):
            b[k] = errors.turn_on[k] + bias[i, k] + errors.temperature[k] * warmth[i]
            v = matrix[k, 0] * u[0] + matrix[k, 1] * u[1] + matrix[k, 2] * u[2] + square[k] * u[k] * u[k]
            e[k] = b[k] + rectification[k] * rms2[i]
            e[k] += g_matrix[k, 0] * f[0] + g_matrix[k, 1] * f[1] + g_matrix[k, 2] * f[2]
            own = v - u[k]
            v += e[k] + noise[i, k]
            if errors.own_input:  # not v less the noise: its last digit would depend on that
                e[k] += own
            top = limit[i, k]
            if v > top or v < -top:
                v = min(max(v, -top), top)
                saturated[i] = True
            if quantum > 0.0:
                v = np.rint(v / quantum) * quantum
            y[k] = v
        for k in range(3):
            out[i, k] = mount[0, k] * y[0] + mount[1, k] * y[1] + mount[2, k] * y[2]
            bias[i, k] = mount[0, k] * b[0] + mount[1, k] * b[1] + mount[2, k] * b[2]
            effective[i, k] = mount[0, k] * e[0] + mount[1, k] * e[1] + mount[2, k] * e[2]
            if errors.own_input:  # the mounting that the unit does not know of
                effective[i, k] += mount[0, k] * u[0] + mount[1, k] * u[1] + mount[2, k] * u[2] - u_b[i, k]
