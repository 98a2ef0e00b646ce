"""Motor vibration as a sensor samples it: a line at the shaft's rate, its harmonics and a band of noise.

Amplitudes grow with the square of the speed (unbalance). The lines are evaluated at the sampling instants, weakened by
the analogue low-pass at their true frequency, so that what lies above half the sampling rate folds down as it really
does.
"""

import math
from dataclasses import dataclass

import numpy as np

from ahrs_sim.jit import njit
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.grade import figure
from ahrs_sim.sensors.triad import InertialFigures


@dataclass(frozen=True)
class MotorFigures:
    """How the motor shakes what is mounted to the airframe."""

    reference: float = figure("revolutions", 6000.0, minimum=1.0)  # speed at which amplitudes are stated
    harmonics: np.ndarray = figure("number", 0.0, size=3, minimum=0.0)  # relative amplitudes at 1, 2, 3 x shaft rate


class Vibration:
    """Vibration of one triad.

    Args:
        motor: the motor's figures.
        figures: of the triad: `vibration_line`, `vibration_band`.
        cutoff: Hz of the sensor's low-pass, 0: none.
        fitting: of its suite.
        every: rows of the truth per sample.
        name: of the triad: its generator gives the phases of the lines, then the band.
    """

    def __init__(
        self, motor: MotorFigures, figures: InertialFigures, cutoff: float, fitting: Fitting, every: int, name: str
    ) -> None:
        rng = fitting.stream(name, "vibration")
        self._amplitudes = np.outer(motor.harmonics, figures.vibration_line)
        self._band = figures.vibration_band
        self._phases = rng.uniform(0.0, 2.0 * math.pi, (3, 3))
        self._state = np.zeros(1)
        self._numbers = (motor.reference, cutoff, fitting.dt, every)
        self._rng = rng
        self.silent = not (self._amplitudes.any() or self._band.any())

    def process(self, rpm: np.ndarray, rows: slice, m: int) -> tuple[np.ndarray, np.ndarray]:
        """Vibration (m, 3) at the sampled `rows` of `rpm` (n,), and the mean square (m,) ahead of the low-pass."""
        out, square = np.zeros((m, 3)), np.zeros(m)
        if not self.silent:
            draws = self._rng.standard_normal((m, 3))
            _vibrate(rpm, rows.start, *self._numbers, self._amplitudes, self._band, self._phases, draws, self._state,
                     out, square)  # fmt: skip
        return out, square


@njit
def _vibrate(
    rpm: np.ndarray, first: int, reference: float, cutoff: float, dt: float, every: int, amplitudes: np.ndarray,
    band: np.ndarray, phases: np.ndarray, draws: np.ndarray, state: np.ndarray, out: np.ndarray, square: np.ndarray,
) -> None:  # fmt: skip
    """Row h of `amplitudes` (3, 3) and `phases` belongs to harmonic h + 1; `state` is the shaft's angle, rad."""
    m = 0
    for i in range(rpm.shape[0]):
        speed = max(rpm[i], 0.0) if rpm[i] == rpm[i] else 0.0
        state[0] = (state[0] + 2.0 * math.pi * speed / 60.0 * dt) % (2.0 * math.pi)
        if i != first + m * every or m >= out.shape[0]:
            continue
        if speed > 0.0:
            level = (speed / reference) ** 2
            for k in range(3):
                out[m, k] = level * band[k] * draws[m, k]
                square[m] += (level * band[k]) ** 2
            for h in range(3):
                gain = level
                if cutoff > 0.0:
                    gain /= math.sqrt(1.0 + ((h + 1) * speed / 60.0 / cutoff) ** 4)
                for k in range(3):
                    a = amplitudes[h, k]
                    out[m, k] += gain * a * math.sin((h + 1) * state[0] + phases[h, k])
                    square[m] += 0.5 * (level * a) ** 2
        m += 1
