"""Samples and estimates as one record a row, as the kernels take them."""

from typing import Annotated

import numpy as np

from estimators.errors import SampleError
from estimators.native import Flag, Matrix3, Number, Record, Vector3, Vector4, shaped
from estimators.types import MEASUREMENTS, Estimates, Samples, real

Innovations = Annotated[np.ndarray, shaped(MEASUREMENTS)]


class Sample(Record):
    """A row of `Samples`: the same names."""

    t: Number
    gyro_b: Vector3
    accel_b: Vector3
    mag_b: Vector3
    mag_new: Flag
    lla: Vector3
    vel_n: Vector3
    gnss_t: Number
    gnss_satellites: Number
    gnss_new: Flag
    heading: Number
    heading_sigma: Number
    heading_t: Number
    heading_new: Flag
    airspeed: Number
    alpha: Number
    beta: Number
    air_new: Flag


class Estimate(Record):
    """A row of `Estimates`: the same names."""

    t: Number
    status: Annotated[int, np.dtype(np.uint8)]
    q_nb: Vector4
    down_b: Vector3
    att_cov: Matrix3
    gyro_bias: Vector3
    gyro_bias_sigma: Vector3
    accel_bias: Vector3
    accel_bias_sigma: Vector3
    lla: Vector3
    vel_n: Vector3
    pos_cov: Matrix3
    vel_cov: Matrix3
    innovation: Innovations
    innovation_var: Innovations
    adaptation: Vector4


SAMPLE, ESTIMATE = Sample.dtype, Estimate.dtype
_WIDTH = ESTIMATE.itemsize // 8
_COLUMNS = Samples.__match_args__


def pack(samples: Samples) -> np.ndarray:
    """Records (n,) of a block.

    Raises:
        SampleError: a column whose shape does not fit the time stamps (n,), or whose type is not that of real numbers.
    """
    n = len(real("t", samples.t))
    rows = np.empty(n, SAMPLE)
    for name in _COLUMNS:
        column, field = getattr(samples, name), rows[name]
        if type(column) is not np.ndarray or column.dtype.kind not in "fb":
            column = real(name, column)
        if column.shape != field.shape:
            raise SampleError(f"Samples: {name} has shape {column.shape}, expected {field.shape}")
        field[...] = column
    return rows


def blank_estimates(n: int) -> np.ndarray:
    """Records (n,) of nothing: NaN, status ALIGNING."""
    rows = np.full((n, _WIDTH), np.nan).view(ESTIMATE).reshape(n)
    rows["status"] = 0
    return rows


def unpack(rows: np.ndarray) -> Estimates:
    """`Estimates` with contiguous columns from records (n,)."""
    return Estimates(**{name: np.ascontiguousarray(rows[name]) for name in Estimates.__match_args__})
