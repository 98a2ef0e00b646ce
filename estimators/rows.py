"""Samples and estimates as one row of numbers each, as the kernels take them.

One array instead of some thirty keeps calls and compilation fast. The offsets follow the fields of `Samples` and
`Estimates` in order; a mask is 0 or 1 there, and the status of an estimate travels beside its row.
"""

import dataclasses

import numpy as np

from estimators.errors import SampleError
from estimators.types import Columns, Estimates, Samples

# Offsets in a row of samples.
T, GYRO, ACCEL, MAG, MAG_NEW, LLA, VEL, GNSS_T, SATELLITES, GNSS_NEW = 0, 1, 4, 7, 10, 11, 14, 17, 18, 19
HEADING, HEADING_SIGMA, HEADING_T, HEADING_NEW, AIRSPEED, ALPHA, BETA, AIR_NEW = 20, 21, 22, 23, 24, 25, 26, 27

# Offsets in a row of estimates.
E_Q, E_DOWN, E_COV, E_GYRO_BIAS, E_GYRO_SIGMA, E_ACCEL_BIAS, E_ACCEL_SIGMA = 1, 5, 8, 17, 20, 23, 26
E_LLA, E_VEL, E_INNOVATION, E_VARIANCE, E_ADAPTATION = 29, 32, 35, 47, 59


def _places(block: type[Columns], skip: str = "") -> list[tuple[str, int, int, tuple[int, ...]]]:
    """(name, first, end, shape of one row) of each field."""
    places, start = [], 0
    for f in dataclasses.fields(block):
        if f.name != skip:
            shape = f.metadata["shape"]
            width = int(np.prod(shape))
            places.append((f.name, start, start + width, shape))
            start += width
    return places


_SAMPLES = _places(Samples)
_ESTIMATES = _places(Estimates, skip="status")
SAMPLE_WIDTH, ESTIMATE_WIDTH = _SAMPLES[-1][2], _ESTIMATES[-1][2]


def pack(samples: Samples) -> np.ndarray:
    """Rows (n, SAMPLE_WIDTH) of a block.

    Raises:
        SampleError: a column whose shape does not fit the time stamps (n,).
    """
    n = len(samples.t)
    rows = np.empty((n, SAMPLE_WIDTH))
    for name, first, end, shape in _SAMPLES:
        column = getattr(samples, name)
        if column.shape != (n, *shape):
            raise SampleError(f"Samples: {name} has shape {column.shape}, expected {(n, *shape)}")
        if end - first == 1:
            rows[:, first] = column
        else:
            rows[:, first:end] = column
    return rows


def unpack(rows: np.ndarray, status: np.ndarray) -> Estimates:
    """`Estimates` with contiguous columns from rows (n, ESTIMATE_WIDTH) and status (n,)."""
    n = len(rows)
    columns = {"status": status}
    for name, first, end, shape in _ESTIMATES:
        columns[name] = np.ascontiguousarray(rows[:, first:end]).reshape(n, *shape)
    return Estimates(**columns)
