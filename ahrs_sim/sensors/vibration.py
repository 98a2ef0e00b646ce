"""Motor vibration as a sensor samples it: a line at the shaft's rate, its harmonics and a band of noise.

Amplitudes grow with the square of the speed (unbalance), but a running motor shakes by a share of them however slowly
it turns: at idle a piston engine rocks on its mount. The lines are evaluated at the sampling instants, weakened by the
analogue low-pass at their true frequency, so that what lies above half the sampling rate folds down as it really does.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ahrs_sim.jit import njit
from ahrs_sim.sensors.fitting import Fitting
from ahrs_sim.sensors.grade import figure
from ahrs_sim.sensors.triad import InertialFigures
from estimators.native import Number, Record, argument, shaped


@dataclass(frozen=True)
class MotorFigures:
    """Figures of the vibration that the motor causes in the airframe."""

    reference: float = figure("revolutions", 6000.0, minimum=1.0)  # speed at which amplitudes are stated
    harmonics: np.ndarray = figure("number", 0.0, size=3, minimum=0.0)  # relative amplitudes at 1, 2, 3 x shaft rate
    idle: float = figure("fraction", minimum=0.0)  # least share of the amplitudes while it turns


class Shaking(Record):
    """Holds the vibration at the reference speed; columns: gyro x, y, z, accelerometer x, y, z."""

    reference: Number  # rpm
    idle: Number
    power: Number  # (m/s2)^2, mean square of the acceleration, ahead of the low-pass
    dt: Number  # s between rows of the truth
    cutoff: Annotated[np.ndarray, shaped(2)]  # Hz, low-pass of gyro and accelerometer; 0: none
    in_phase: Annotated[np.ndarray, shaped(3, 6)]  # row h: harmonic h + 1
    in_quadrature: Annotated[np.ndarray, shaped(3, 6)]
    band: Annotated[np.ndarray, shaped(6)]  # rms of the noise


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
        band = np.concatenate([gyro.vibration_band, accel.vibration_band])
        self._shaking = Shaking.of(
            reference=motor.reference,
            idle=motor.idle,
            power=float(0.5 * np.sum(lines[:, 3:] ** 2) + np.sum(accel.vibration_band**2)),
            dt=fitting.dt,
            cutoff=cutoffs,
            in_phase=lines * np.cos(phases),
            in_quadrature=lines * np.sin(phases),
            band=band,
        )
        self._every = every
        self._angle = np.zeros(1)  # rad, of the shaft
        self._rng = rng
        self._silent = not (lines.any() or band.any())

    def shake(self, rpm: np.ndarray, rows: slice, m: int) -> tuple[np.ndarray, np.ndarray]:
        """Compute vibration (m, 6) at the sampled `rows` of `rpm` (n,), and mean square acceleration (m,), (m/s2)^2."""
        out, square = np.zeros((m, 6)), np.zeros(m)
        if not self._silent:
            draws = self._rng.standard_normal((m, 6))
            _vibrate(argument(self._shaking), rpm, rows.start, self._every, draws, self._angle, out, square)
        return out, square


@njit
def _vibrate(
    shaking: Shaking, rpm: np.ndarray, first: int, every: int, draws: np.ndarray, angle: np.ndarray, out: np.ndarray,
    square: np.ndarray,
) -> None:  # fmt: skip
    """Add band and lines at the sampled rows; `angle` (1,) carries the shaft's angle from block to block, rad."""
    turn = 2.0 * math.pi
    m = 0
    for i in range(rpm.shape[0]):
        speed = max(rpm[i], 0.0) if rpm[i] == rpm[i] else 0.0
        angle[0] += turn * speed / 60.0 * shaking.dt
        while angle[0] >= turn:
            angle[0] -= turn
        if i != first + m * every or m >= out.shape[0]:
            continue
        if speed > 0.0:
            level = max((speed / shaking.reference) ** 2, shaking.idle)
            square[m] = level * level * shaking.power
            for k in range(6):
                out[m, k] = level * shaking.band[k] * draws[m, k]
            for h in range(3):
                s, c = level * math.sin((h + 1) * angle[0]), level * math.cos((h + 1) * angle[0])
                frequency = (h + 1) * speed / 60.0
                for part in range(2):
                    cutoff = shaking.cutoff[part]
                    gain = 1.0 / math.sqrt(1.0 + (frequency / cutoff) ** 4) if cutoff > 0.0 else 1.0
                    for k in range(3 * part, 3 * part + 3):
                        out[m, k] += gain * (shaking.in_phase[h, k] * s + shaking.in_quadrature[h, k] * c)
        m += 1
