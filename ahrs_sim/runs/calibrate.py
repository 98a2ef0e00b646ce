"""`ahrs-sim calibrate`: what a navigator has learnt of a unit in a flight, as a correction of its readings.

The navigator's states at the end of the recording: the matrices of gyro, accelerometer and magnetometer, the hard iron,
and their covariance. The biases of gyro and accelerometer are those of one switch-on and not of the unit: they are
written as comments. A rotation that all sensors have in common is one of the unit in the vehicle, which no flight
shows; it is in the sigmas.
"""

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.runs.log_tuning import Recorded
from ahrs_sim.sensors.correction import COMMON, Correction, TriadCorrection
from estimators import create
from estimators.navigator.layout import (
    ACCEL_BIAS,
    ACCEL_MATRIX,
    GYRO_BIAS,
    GYRO_FAST,
    GYRO_MATRIX,
    GYRO_SLOW,
    HARD_IRON,
    MAG_MATRIX,
)
from estimators.navigator.navigator import Navigator

UNITS = {"gyro": "rad/s", "accelerometer": "m/s2", "magnetometer": "T"}


@dataclass(frozen=True)
class Calibrated:
    """What a recording has shown of a unit."""

    correction: Correction
    before: dict[str, Any]  # figures of `SensorInfo`
    source: str
    end: float  # s

    def toml(self) -> str:
        """Format the correction as a file for a suite or a map."""
        lines = [
            f"# A unit as a navigator found it in {self.source} up to {self.end:.0f} s: reading = matrix true + bias,",
            "# in the vehicle's axes (FRD), SI. A suite or a map names this file as its `correction`.",
        ]
        for name, unit in UNITS.items():
            triad = getattr(self.correction, name)
            lines += ["", f"[{name}]"]
            lines += [f"matrix = {_list(triad.matrix, 7)}", f"matrix_sigma = {_list(triad.matrix_sigma, 7)}"]
            mark = ""
            if name != "magnetometer":
                mark = "# "
                lines.append("# Its bias of that switch-on; the next one has another.")
            lines.append(f"{mark}bias = {_list(triad.bias, 12)}  # {unit}")
            lines.append(f"{mark}bias_sigma = {_list(triad.bias_sigma, 12)}")
        return "\n".join(lines) + "\n"

    def text(self) -> str:
        """Format one sigma of each group of errors before and after, for the terminal."""
        after = self.correction.sheet(self.before)
        after |= {key: after[key] / COMMON for key, *_ in _ROWS if key.endswith("misalignment")}  # as they are
        iron = self.before.get("soft_iron", 0.0)
        was = self.before | {
            "mag_scale_factor": math.hypot(self.before["mag_scale_factor"], iron),
            "mag_misalignment": math.hypot(self.before["mag_misalignment"], iron / math.sqrt(2.0)),
        }
        lines = [f"{'one sigma':34s}{'data sheet':>12s}{'left':>12s}"]
        for key, title, factor, unit in _ROWS:
            lines.append(f"{title:34s}{factor * was[key]:8.3g} {unit:3s}{factor * after[key]:8.3g} {unit:3s}".rstrip())
        return "\n".join(lines)


_DEG = 180.0 / math.pi
_ROWS = (
    ("gyro_scale_factor", "gyro, scale factor", 100.0, "%"),
    ("gyro_misalignment", "gyro, misalignment", _DEG, "deg"),
    ("accel_scale_factor", "accelerometer, scale factor", 100.0, "%"),
    ("accel_misalignment", "accelerometer, misalignment", _DEG, "deg"),
    ("mag_scale_factor", "magnetometer, scale and soft iron", 100.0, "%"),
    ("mag_misalignment", "magnetometer, misalignment", _DEG, "deg"),
    ("mag_bias", "hard iron", 1e6, "uT"),
)


def calibrate(recorded: Recorded, source: str, until: float = math.inf) -> Calibrated:
    """Run a navigator with calibration states over a recording and read off what it has learnt.

    Args:
        recorded: see `log_tuning.read`.
        source: name of the recording, for the file.
        until: s into the recording, the rest is left out.

    Raises:
        InputError: another kind of estimator, or one that has not aligned.
    """
    navigator = create(recorded.method, site=recorded.site, sensors=recorded.sensors, **recorded.settings)
    if not isinstance(navigator, Navigator):
        raise InputError(f"calibrate: {recorded.method} has no states of calibration; take ins-cal")
    samples = recorded.samples
    samples = samples[: int(np.searchsorted(samples.t, samples.t[0] + until, side="right"))]
    navigator.process(samples)
    found = navigator.state()["filter"]
    if found is None:
        raise InputError(f"{source}: {recorded.method} has not aligned in it; take a longer part")
    c, P = np.asarray(found["nominal"]["c"]), found["P"]
    gyro_bias = [GYRO_BIAS, GYRO_FAST, GYRO_SLOW]
    correction = Correction(
        gyro=_triad(c, P, GYRO_MATRIX, gyro_bias),
        accelerometer=_triad(c, P, ACCEL_MATRIX, [ACCEL_BIAS]),
        magnetometer=_triad(c, P, MAG_MATRIX, [HARD_IRON]),
    )
    before = {name: getattr(recorded.sensors, name) for name, *_ in _ROWS} | {"soft_iron": recorded.sensors.soft_iron}
    return Calibrated(correction, before, source, float(samples.t[-1] - samples.t[0]))


def _triad(c: np.ndarray, P: np.ndarray, matrix: int, bias: list[int]) -> TriadCorrection:
    """Read a sensor's matrix and the sum of the terms of its bias from the states (N,) and their covariance (N, N)."""
    terms = np.array(bias)[:, None] + np.arange(3)
    variance = P[terms[:, None], terms[None]].sum(axis=(0, 1))
    return TriadCorrection(
        matrix=np.eye(3) + c[matrix : matrix + 9].reshape(3, 3),
        matrix_sigma=np.sqrt(np.diag(P)[matrix : matrix + 9]).reshape(3, 3),
        bias=c[terms].sum(axis=0),
        bias_sigma=np.sqrt(variance),
    )


def _list(values: np.ndarray, digits: int) -> str:
    return json.dumps([round(float(v), digits) for v in values.ravel()])
