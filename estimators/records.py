"""Samples and estimates as one record a row, as the kernels take them."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Self

import numpy as np

from estimators.errors import SampleError
from estimators.native import Flag, Matrix3, Number, Record, Vector3, Vector4, shaped
from estimators.settings import Setting, SettingValue
from estimators.types import MEASUREMENTS, Estimates, Samples, SensorInfo, Site, real

Innovations = Annotated[np.ndarray, shaped(MEASUREMENTS)]


class Sample(Record):
    """A row of `Samples`: the same names, in the order of `ahrs_sample`."""

    t: Number
    gyro_b: Vector3
    accel_b: Vector3
    mag_b: Vector3
    lla: Vector3
    vel_n: Vector3
    gnss_t: Number
    gnss_satellites: Number
    heading: Number
    heading_sigma: Number
    heading_t: Number
    airspeed: Number
    alpha: Number
    beta: Number
    mag_new: Flag
    gnss_new: Flag
    heading_new: Flag
    air_new: Flag
    reserved: Annotated[np.ndarray, shaped(4, dtype=np.uint8)]


class Estimate(Record):
    """A row of `Estimates`: the same names, in the order of `ahrs_estimate`."""

    t: Number
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
    status: Annotated[int, np.dtype(np.uint8)]
    reserved: Annotated[np.ndarray, shaped(7, dtype=np.uint8)]


class Place(Record):
    """A `Site`: the same names."""

    lla: Vector3
    gravity: Number
    mag_n: Vector3

    @classmethod
    def from_site(cls, site: Site) -> Self:
        """Make it of a site."""
        return cls.of(**{f.name: getattr(site, f.name) for f in fields(site)})


class Sheet(Record):
    """The data sheet figures of a `SensorInfo`: the same names."""

    @classmethod
    def from_info(cls, sensors: SensorInfo) -> Self:
        """Make it of data sheet figures."""
        return cls.of(**{f.name: getattr(sensors, f.name) for f in fields(sensors)})


Sheet.dtype = np.dtype(
    [(f.name, np.float64, (3,) if isinstance(f.default, tuple) else ()) for f in fields(SensorInfo)], align=True
)


def settings_type(known: Mapping[str, Setting]) -> np.dtype:
    """The type of a record of settings: numbers, switches, and choices by their place among them."""
    fields_ = []
    for name, setting in known.items():
        switch, choice = isinstance(setting.default, bool), isinstance(setting.default, str)
        fields_.append((name, np.bool_ if switch else np.int64 if choice else np.float64))
    return np.dtype(fields_, align=True)


def pack_settings(known: Mapping[str, Setting], values: Mapping[str, SettingValue]) -> Record:
    """A record of checked settings."""
    made = np.zeros((), settings_type(known))
    for name, setting in known.items():
        made[name] = setting.choices.index(str(values[name])) if setting.choices else values[name]
    return Record(made)


SAMPLE, ESTIMATE, PLACE, SHEET = Sample.dtype, Estimate.dtype, Place.dtype, Sheet.dtype
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
    rows["status"], rows["reserved"] = 0, 0
    return rows


def unpack(rows: np.ndarray) -> Estimates:
    """`Estimates` with contiguous columns from records (n,)."""
    return Estimates(**{name: np.ascontiguousarray(rows[name]) for name in Estimates.__match_args__})
