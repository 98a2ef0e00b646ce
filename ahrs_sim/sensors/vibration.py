"""Motor vibration as a sensor samples it: a line at the shaft's rate, its harmonics and a band of noise.

Amplitudes grow with the square of the speed (unbalance), but a running motor shakes by a share of them however slowly
it turns: at idle a piston engine rocks on its mount. The lines are evaluated at the sampling instants, weakened by the
analogue low-pass at their true frequency, so that what lies above half the sampling rate folds down as it really does.
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
    """Figures of the vibration that the motor causes in the airframe."""

    reference: float = figure("revolutions", 6000.0, minimum=1.0)  # speed at which amplitudes are stated
    harmonics: np.ndarray = figure("number", 0.0, size=3, minimum=0.0)  # relative amplitudes at 1, 2, 3 x shaft rate
    idle: float = figure("fraction", minimum=0.0)  # least share of the amplitudes while it turns


class Vibration:
    """Vibration of gyro and accelerometer: six columns, gyro first.

    Args:
        motor: the motor's figures.
        gyro: the figures of each: `vibration_line`, `vibration_band`.
        accel: the same.
        cutoffs: Hz of their low-passes, 0: none.
        fitting: of the suite.
        every: rows of the truth per sample.
    """

    def __init__(
        self,
        motor: MotorFigures,
        gyro: InertialFigures,
        accel: InertialFigures,
        cutoffs: tuple[float, float],
        fitting: Fitting,
        every: int,
    ) -> None:
        rng = fitting.stream("imu", "vibration")
        phases = rng.uniform(0.0, 2.0 * math.pi, (3, 6))
        lines = np.outer(motor.harmonics, np.concatenate([gyro.vibration_line, accel.vibration_line]))
        self._sin, self._cos = lines * np.cos(phases), lines * np.sin(phases)
        self._band = np.concatenate([gyro.vibration_band, accel.vibration_band])
        # Mean square at the reference speed of what shakes the accelerometer, ahead of its low-pass.
        self._power = float(0.5 * np.sum(lines[:, 3:] ** 2) + np.sum(accel.vibration_band**2))
        self._state = np.zeros(1)
        self._numbers = (motor.reference, motor.idle, float(cutoffs[0]), float(cutoffs[1]), fitting.dt, every)
        self._rng = rng
        self._silent = not (lines.any() or self._band.any())

    def shake(self, rpm: np.ndarray, rows: slice, m: int) -> tuple[np.ndarray, np.ndarray]:
        """Compute vibration (m, 6) at the sampled `rows` of `rpm` (n,), and mean square acceleration (m,), (m/s2)^2."""
        out, square = np.zeros((m, 6)), np.zeros(m)
        if not self._silent:
            draws = self._rng.standard_normal((m, 6))
            _vibrate(rpm, rows.start, *self._numbers, self._sin, self._cos, self._band, self._power, draws,
                     self._state, out, square)  # fmt: skip
        return out, square


@njit
def _vibrate(
    rpm: np.ndarray, first: int, reference: float, idle: float, gyro_cutoff: float, accel_cutoff: float, dt: float,
    every: int, in_phase: np.ndarray, in_quadrature: np.ndarray, band: np.ndarray, power: float, draws: np.ndarray,
    state: np.ndarray, out: np.ndarray, square: np.ndarray,
) -> None:  # fmt: skip
    """Add the lines: row h of the amplitudes (3, 6) is harmonic h + 1; `state` holds the shaft's angle, rad."""
    turn = 2.0 * math.pi
    m = 0
    for i in range(rpm.shape[0]):
        speed = max(rpm[i], 0.0) if rpm[i] == rpm[i] else 0.0
        state[0] += turn * speed / 60.0 * dt
        while state[0] >= turn:
            state[0] -= turn
        if i != first + m * every or m >= out.shape[0]:
            continue
        if speed > 0.0:
            level = max((speed / reference) ** 2, idle)
            square[m] = level * level * power
            for k in range(6):
                out[m, k] = level * band[k] * draws[m, k]
            for h in range(3):
                s, c = level * math.sin((h + 1) * state[0]), level * math.cos((h + 1) * state[0])
                frequency = (h + 1) * speed / 60.0
                for part in range(2):
                    cutoff = gyro_cutoff if part == 0 else accel_cutoff
                    gain = 1.0 / math.sqrt(1.0 + (frequency / cutoff) ** 4) if cutoff > 0.0 else 1.0
                    for k in range(3 * part, 3 * part + 3):
                        out[m, k] += gain * (in_phase[h, k] * s + in_quadrature[h, k] * c)
        m += 1
