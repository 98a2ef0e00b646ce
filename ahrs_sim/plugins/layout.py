"""The structures of `ahrs_estimator.h` as NumPy records: the columns of `Samples` and `Estimates` without loss."""

import dataclasses
from pathlib import Path

import numpy as np

from estimators.records import ESTIMATE as ESTIMATE
from estimators.records import SAMPLE as SAMPLE
from estimators.types import Estimates, Samples, SensorInfo, Site

HEADER = Path(__file__).parent / "interface" / "ahrs_estimator.h"
VERSION = 1  # AHRS_INTERFACE_VERSION


SENSORS = (
    "rate", "gyro_noise", "gyro_bias", "gyro_instability", "gyro_scale", "accel_noise", "accel_bias", "accel_scale",
    "mag_noise", "mag_bias", "gyro_delay", "accel_delay", "mag_delay", "gnss_pos", "gnss_vel", "heading", "airspeed",
    "airspeed_scale", "antenna_b",
)  # fmt: skip
"""The members of `ahrs_sensors`; `SensorInfo` has more, which this version of the interface leaves out."""


def write_samples(samples: Samples, rows: np.ndarray) -> None:
    """Write a block of n samples to `rows` (n,) of type `SAMPLE`."""
    for name in samples.__match_args__:
        rows[name] = getattr(samples, name)


def blank_estimates(t: np.ndarray, rows: np.ndarray) -> None:
    """Prepare `rows` (n,) of type `ESTIMATE`: time stamps `t` (n,), everything else NaN, ALIGNING."""
    rows.view(np.uint8).reshape(len(rows), -1)[:, -8:] = 0
    rows.view(np.float64).reshape(len(rows), -1)[:, :-1] = np.nan
    rows["t"] = t


def read_estimates(rows: np.ndarray) -> Estimates:
    """Copy `rows` (n,) of type `ESTIMATE` to a block with contiguous columns."""
    return Estimates(*[np.ascontiguousarray(rows[name]).copy() for name in Estimates.__match_args__])


def constants(known: Site | SensorInfo) -> bytes:
    """Make the bytes of `ahrs_site` or `ahrs_sensors`."""
    names = SENSORS if isinstance(known, SensorInfo) else [f.name for f in dataclasses.fields(known)]
    values = [getattr(known, name) for name in names]
    return np.concatenate([np.atleast_1d(np.asarray(v, float)) for v in values]).tobytes()
