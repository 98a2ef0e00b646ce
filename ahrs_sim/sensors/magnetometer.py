"""Magnetometer: the Earth's field as it really is, what the aircraft adds to it, and the errors of a triad.

The real field differs from the World Magnetic Model by its stated uncertainty, one draw a flight for all suites;
filters know the model. Soft iron is the triad's matrix, hard iron its turn-on bias (what calibration left of both). The
current of the motor adds a field that grows with the throttle.
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
from ahrs_sim.sensors.noise import rms, white_sigma
from ahrs_sim.sensors.records import MagRecord, Record
from ahrs_sim.sensors.sampling import Clock, nanoseconds, pick
from ahrs_sim.sensors.triad import Triad, TriadFigures
from ahrs_sim.world import magnetic
from estimators.rotations import to_body


@dataclass(frozen=True)
class MagFigures(TriadFigures):
    """Figures of a magnetometer; `turn_on_bias` is the hard iron left over by calibration."""

    rate: float = figure("frequency", 100.0, minimum=0.1)
    soft_iron: float = figure("fraction", minimum=0.0)  # 1 sigma of each term of the symmetric matrix
    motor_field: np.ndarray = figure("field", size=3, minimum=0.0)  # 1 sigma at full throttle
    turned: float = figure("angle")  # about the down axis: put in the wrong way round, and nobody noticed
    model_error: np.ndarray = figure("field", size=3, minimum=0.0)  # 1 sigma of the real field from the model, NED


class Magnetometer:
    """Magnetometer of a suite: sends records `mag`."""

    records = ("mag",)

    def __init__(self, fitting: Fitting) -> None:
        f = self.figures = fitting.figures("magnetometer", MagFigures)
        every = fitting.every(f.rate, "magnetometer")
        self.period = every * fitting.dt
        self._clock = Clock(every)
        self._held = np.zeros(3)  # T, NED, at the last sample
        self._faults = fitting.faults
        self._epoch = fitting.epoch
        self.triad = Triad("magnetometer", f, fitting, every)
        self.motor_field = fitting.normal("magnetometer", "motor field", 3) * f.motor_field
        iron = fitting.normal("magnetometer", "soft iron", 3, 3) * f.soft_iron
        self.triad.matrix[:] = np.einsum("ij,jk->ik", np.eye(3) + 0.5 * (iron + iron.T), self.triad.matrix)
        c, s = math.cos(f.turned), math.sin(f.turned)
        self.triad.matrix[:] = np.einsum("ij,jk->ik", self.triad.matrix, [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        self.model_error = fitting.world("magnetic field").standard_normal(3) * f.model_error
        self._buffer = LatencyBuffer(MagRecord, fitting.channel("magnetometer"), 0.0)

    def info(self) -> dict[str, Any]:
        """Return its fields of `SensorInfo`: data sheet figures, SI."""
        f = self.figures
        return {
            "mag_noise": rms(white_sigma(f.noise_density, 1.0 / self.period)),
            "mag_bias": rms(f.turn_on_bias),
            "mag_wander": rms(f.motor_field),
            "mag_scale_factor": rms(f.scale),
            "mag_misalignment": self.triad.misalignment_sigma,
            "soft_iron": f.soft_iron,
            "field_error": tuple(f.model_error.tolist()),
            "mag_delay": self.triad.band.delay,
        }

    def drawn(self) -> dict[str, Any]:
        """Return the errors that were drawn for this flight, SI."""
        return self.triad.drawn() | {
            "magnetometer.motor_field": self.motor_field,
            "magnetometer.model_error": self.model_error,
        }

    def sense(self, truth: Truth) -> dict[str, Record]:
        """Sense a block of the truth; return the records that arrive within it."""
        n = len(truth)
        rows, t, now = self._clock.sample(truth)
        field_b = np.empty((n, 3))
        # Between two samples the aircraft moves by metres and the field by picotesla: held.
        field_n = magnetic.field_n(pick(truth.lla, rows), self._epoch) if len(t) else np.empty((0, 3))
        here = field_n + self.model_error
        external = self._faults.field_n(truth.t) if self._faults.fields else np.zeros((n, 3))
        _field_in_body(here, rows.start, self._clock.every, self._held, external, truth.q_nb, truth.throttle,
                       self.motor_field, field_b)  # fmt: skip
        values, saturated, *_ = self.triad.measure(field_b, rows, t, np.zeros(len(t)))
        ns = nanoseconds(t)
        return {"mag": self._buffer.push(MagRecord(ns, ns, values, saturated), t, now)}


@njit
def _field_in_body(
    field_n: np.ndarray, first: int, every: int, held: np.ndarray, external: np.ndarray, q_nb: np.ndarray,
    throttle: np.ndarray, motor: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Compute C_bn(q) (B + external) + throttle x motor field, (n, 3) T; B (m, 3) at samples, `held` (3,) between."""
    m = 0
    for i in range(out.shape[0]):
        if i == first + m * every and m < field_n.shape[0]:
            for j in range(3):
                held[j] = field_n[m, j]
            m += 1
        to_body(q_nb[i], held[0] + external[i, 0], held[1] + external[i, 1], held[2] + external[i, 2], out[i])
        k = throttle[i] if throttle[i] == throttle[i] else 0.0
        for j in range(3):
            out[i, j] += k * motor[j]
