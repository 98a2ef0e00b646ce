"""Correction of a unit: what a calibration has found of its three triads, taken off its readings.

A file that `ahrs-sim calibrate` writes, or anybody; every table and key may be left out:

    [gyro]
    matrix = [1.002, 0.001, 0.0, 0.0, 1.0, 0.003, 0.0, 0.0, 0.999]    # row by row: reading = matrix true + bias
    matrix_sigma = [1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]
    bias = [0.0, 0.0, 0.0]                                            # rad/s
    bias_sigma = [1e-4, 1e-4, 1e-4]
    [accelerometer]                                                   # m/s2
    [magnetometer]                                                    # T: the bias is the hard iron

All in the vehicle's axes (FRD). A sigma replaces that of the data sheet, which estimators begin with; where none is
given the data sheet's stays.
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.scenario.table import Table, named_file, read_toml
from ahrs_sim.sensors.noise import rms
from ahrs_sim.sensors.records import SuiteBlock

TRIADS = ("gyro", "accelerometer", "magnetometer")
LARGEST = 0.5  # that an element of a matrix may be off the identity
COMMON = 1.5
"""Times the sigma of a misalignment that estimators are given: most of what a flight leaves is one rotation of all
three triads, and an estimator that takes them as independent believes to know it better. Chosen on four units:
`ins-cal` on the next flight had NEES 2.0 without, 1.5 with it, at 3 % more tilt."""
_NO_MATRIX = np.eye(3).ravel().tolist()
_OFF = ~np.eye(3, dtype=bool)


@dataclass(frozen=True)
class TriadCorrection:
    """Errors of a sensor: reading = matrix true + bias. A sigma of NaN is not known."""

    matrix: np.ndarray  # (3, 3)
    matrix_sigma: np.ndarray  # (3, 3)
    bias: np.ndarray  # (3,) rad/s, m/s2 or T
    bias_sigma: np.ndarray  # (3,)

    def applied(self, readings: np.ndarray) -> np.ndarray:
        """Correct readings (n, 3)."""
        return _product(self.inverse, readings - self.bias)

    @property
    def inverse(self) -> np.ndarray:
        """The inverse (3, 3) of the matrix, by its adjugate: the same bits on every machine."""
        a, b, c = self.matrix
        rows = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        inverse: np.ndarray = rows / (a[0] * rows[0, 0] + a[1] * rows[1, 0] + a[2] * rows[2, 0])
        return inverse


@dataclass(frozen=True)
class Correction:
    """What is taken off the readings of a unit."""

    gyro: TriadCorrection
    accelerometer: TriadCorrection
    magnetometer: TriadCorrection

    def records(self, block: SuiteBlock) -> SuiteBlock:
        """Correct a block of records; the true biases in `imu_errors` become those that are left."""
        block = dict(block)
        if "imu" in block:
            imu: Any = block["imu"]
            gyro, accel = self.gyro.applied(imu.gyro_b), self.accelerometer.applied(imu.accel_b)
            block["imu"] = imu = dataclasses.replace(imu, gyro_b=gyro, accel_b=accel)
            if "imu_errors" in block:
                block["imu_errors"] = self._left(block["imu_errors"], imu)
        if "mag" in block:
            mag: Any = block["mag"]
            block["mag"] = dataclasses.replace(mag, mag_b=self.magnetometer.applied(mag.mag_b))
        return block

    def _left(self, errors: Any, imu: Any) -> Any:
        """True biases of the corrected readings; with A the matrix and b the bias taken off, u' = A^-1 (u + e - b)."""
        gyro, accel = self.gyro, self.accelerometer
        at = np.minimum(np.searchsorted(imu.stamp_ns, errors.stamp_ns), max(len(imu) - 1, 0))
        force = np.full((len(errors), 3), np.nan)
        if len(imu):
            force = np.where((imu.stamp_ns[at] == errors.stamp_ns)[:, None], imu.accel_b[at], np.nan)
        own = _product(accel.matrix - np.eye(3), force)  # the effective one includes what the force itself causes
        return dataclasses.replace(
            errors,
            gyro_bias=gyro.applied(errors.gyro_bias),
            accel_bias=accel.applied(errors.accel_bias),
            gyro_effective_bias=gyro.applied(errors.gyro_effective_bias),
            accel_effective_bias=errors.accel_effective_bias - accel.bias - own,
        )

    def sheet(self, own: Mapping[str, Any]) -> dict[str, Any]:
        """Make the figures of `SensorInfo` that hold of the corrected unit, from its own."""
        made = dict(own)
        for name, triad in (("gyro", self.gyro), ("accel", self.accelerometer), ("mag", self.magnetometer)):
            if np.isfinite(triad.bias_sigma).all():
                made[f"{name}_bias"] = rms(triad.bias_sigma)
            if not np.isfinite(triad.matrix_sigma).all():
                continue
            scale, beside = rms(np.diag(triad.matrix_sigma)), COMMON * rms(triad.matrix_sigma[_OFF])
            made[f"{name}_scale_factor"], made[f"{name}_misalignment"] = scale, beside
            if name == "mag":
                made["soft_iron"] = 0.0  # its part is in the two
            else:
                made[f"{name}_scale"] = math.hypot(scale, beside)
        return made

    def specification(self) -> dict[str, str]:
        """Describe what is taken off, as flat texts for the log."""
        return {
            f"correction.{name}.{part}": " ".join(repr(float(x)) for x in getattr(getattr(self, name), part).ravel())
            for name in TRIADS
            for part in ("matrix", "bias")
        }


def _product(matrix: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Matrix (3, 3) times each row (n, 3), in one order of additions whatever n."""
    x, y, z = rows[:, :1], rows[:, 1:2], rows[:, 2:]
    product: np.ndarray = x * matrix[:, 0] + y * matrix[:, 1] + z * matrix[:, 2]
    return product


def load(name: str, where: str) -> Correction:
    """Load a correction.

    Args:
        name: of its file, beside the one that names it or in the current folder.
        where: which file, and where in it, names it.

    Raises:
        InputError: no such file, or anything wrong in it.
    """
    path = named_file(name, Path(where.partition(":")[0]).parent)
    if path is None:
        raise InputError(f"{where}: correction: {name}: no such file beside it or in the current folder")
    table = read_toml(path)
    made = Correction(*(_triad(table.table(part)) for part in TRIADS))
    table.close()
    return made


def _triad(table: Table) -> TriadCorrection:
    matrix = table.vector("matrix", _NO_MATRIX, size=9).reshape(3, 3)
    if np.abs(matrix - np.eye(3)).max() > LARGEST:
        raise table.error("matrix", f"is further than {LARGEST:g} from the identity; axes and units belong in a map")
    bias = table.vector("bias", [0.0] * 3)
    sigmas = _sigma(table, "matrix_sigma", 9).reshape(3, 3), _sigma(table, "bias_sigma", 3)
    table.close()
    return TriadCorrection(matrix, sigmas[0], bias, sigmas[1])


def _sigma(table: Table, key: str, size: int) -> np.ndarray:
    """Read sigmas (size,); NaN where none are given."""
    if not table.has(key):
        return np.full(size, np.nan)
    sigma = table.vector(key, size=size)
    if (sigma < 0.0).any():
        raise table.error(key, "is negative; a sigma is 0 or more")
    return sigma
