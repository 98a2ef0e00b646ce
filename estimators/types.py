"""What goes into an estimator and what comes out: blocks of columns with one row per IMU sample.

Frames: navigation n = local NED, body b = FRD, quaternion `q_nb` scalar first, Hamilton, body to navigation. SI and
radians. Missing data are NaN, never zero.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar, Self

import numpy as np

from estimators.errors import SampleError

MEASUREMENTS = 12
"""Columns of the innovation: room for the largest measurement vector of a model, unused ones NaN."""


@dataclass(frozen=True, slots=True)
class Columns:
    """A block: a frozen dataclass of arrays with one row per sample.

    `block[a:b]` slices all columns, `len(block)` counts rows, `concatenate` joins blocks.
    """

    __match_args__: ClassVar[tuple[str, ...]]  # the names of the columns, made by `dataclass`

    def __len__(self) -> int:
        return len(getattr(self, self.__match_args__[0]))

    def __getitem__(self, rows: slice) -> Self:
        return type(self)(*[getattr(self, name)[rows] for name in self.__match_args__])

    @classmethod
    def concatenate(cls, blocks: Sequence[Self]) -> Self:
        """One block of all rows of `blocks` (at least one) in order."""
        if len(blocks) == 1:
            return blocks[0]
        return cls(*[np.concatenate([getattr(b, name) for b in blocks]) for name in cls.__match_args__])


def column(*shape: int, dtype: type = float) -> np.ndarray:
    """A field of a block: `shape` of one row and type, used by `blank`."""
    return field(metadata={"shape": shape, "dtype": dtype})  # type: ignore[no-any-return]


def real(name: str, value: object) -> np.ndarray:
    """The array of a column.

    Raises:
        SampleError: anything but real numbers or booleans: complex numbers, text, masked arrays.
    """
    array = np.asanyarray(value)
    if array.dtype.kind not in "biuf" or isinstance(array, np.ma.MaskedArray):
        kind = "a masked array (fill it with NaN)" if isinstance(array, np.ma.MaskedArray) else f"of type {array.dtype}"
        raise SampleError(f"Samples: {name} is {kind}, expected real numbers")
    return array


def blank(cls: type, n: int) -> dict[str, np.ndarray]:
    """Writable columns of `n` rows for a block type whose fields are made with `column`: NaN, 0 or False."""
    columns = {}
    for f in dataclasses.fields(cls):
        shape, dtype = f.metadata["shape"], f.metadata["dtype"]
        columns[f.name] = np.full((n, *shape), np.nan) if dtype is float else np.zeros((n, *shape), dtype)
    return columns


@dataclass(frozen=True, slots=True)
class Samples(Columns):
    """Holds an estimator's input: one row per IMU sample, slower sensors latched with a `*_new` mask.

    A latched value is what was last received at `t`; `*_new` is true on the row at which it arrived. `gnss_t` and
    `heading_t` say when the value was true (latency), the IMU's own delays are in `SensorInfo`.

    Attributes:
        t: (n,) s, time stamp of the IMU sample, rising; never missing.
        gyro_b: (n, 3) rad/s, angular rate.
        accel_b: (n, 3) m/s2, specific force: standing level it is (0, 0, -9.8).
        mag_b: (n, 3) T, magnetic field.
        mag_new: (n,) bool, `mag_b` has arrived with this row.
        lla: (n, 3) rad, rad, m, GNSS latitude, longitude and ellipsoidal height.
        vel_n: (n, 3) m/s, GNSS velocity.
        gnss_t: (n,) s, when `lla` and `vel_n` were true.
        gnss_satellites: (n,) in use; NaN before the first message.
        gnss_new: (n,) bool, `lla` and `vel_n` have arrived with this row.
        heading: (n,) rad, true heading of the dual-antenna baseline.
        heading_sigma: (n,) rad, one sigma, as the receiver reports it.
        heading_t: (n,) s, when `heading` was true.
        heading_new: (n,) bool, `heading` has arrived with this row.
        airspeed: (n,) m/s, true airspeed.
        alpha: (n,) rad, angle of attack (vane); NaN when not fitted.
        beta: (n,) rad, sideslip (vane); NaN when not fitted.
        air_new: (n,) bool, `airspeed`, `alpha` and `beta` have arrived with this row.
    """

    t: np.ndarray = column()
    gyro_b: np.ndarray = column(3)
    accel_b: np.ndarray = column(3)
    mag_b: np.ndarray = column(3)
    mag_new: np.ndarray = column(dtype=bool)
    lla: np.ndarray = column(3)
    vel_n: np.ndarray = column(3)
    gnss_t: np.ndarray = column()
    gnss_satellites: np.ndarray = column()
    gnss_new: np.ndarray = column(dtype=bool)
    heading: np.ndarray = column()
    heading_sigma: np.ndarray = column()
    heading_t: np.ndarray = column()
    heading_new: np.ndarray = column(dtype=bool)
    airspeed: np.ndarray = column()
    alpha: np.ndarray = column()
    beta: np.ndarray = column()
    air_new: np.ndarray = column(dtype=bool)

    @classmethod
    def make(cls, t: np.ndarray, gyro_b: np.ndarray, accel_b: np.ndarray, **columns: np.ndarray) -> "Samples":
        """Samples from arrays; what is not given is missing (NaN, mask false).

        Raises:
            SampleError: an unknown column, or one whose shape does not fit `t` (n,).
        """
        made = blank(cls, len(t))
        for name, value in {"t": t, "gyro_b": gyro_b, "accel_b": accel_b, **columns}.items():
            if name not in made:
                raise SampleError(f"Samples: no column '{name}'")
            array = np.ascontiguousarray(real(name, value), dtype=made[name].dtype)
            if array.shape != made[name].shape:
                raise SampleError(f"Samples: {name} has shape {array.shape}, expected {made[name].shape}")
            made[name] = array
        return cls(**made)


class Status(IntEnum):
    """Flags the quality of an estimate."""

    ALIGNING = 0  # no attitude yet: the columns are NaN
    RUNNING = 1
    COASTING = 2  # a needed measurement is missing or refused: carried by the gyro
    DIVERGED = 3  # numerically lost; restarted or NaN


@dataclass(frozen=True, slots=True)
class Estimates(Columns):
    """Holds an estimator's output: one row per row of `Samples`, the same however they are cut into blocks.

    What a method does not estimate is NaN, never zero; so is everything while it is aligning.

    Attributes:
        t: (n,) s, those of the samples.
        status: (n,) uint8, a `Status`.
        q_nb: (n, 4) attitude, of length 1; NaN before the alignment, or when the method has no heading.
        down_b: (n, 3) unit down vector in body axes: the tilt alone, known without a heading as well.
        att_cov: (n, 3, 3) rad2, covariance of the small rotation in body axes.
        gyro_bias: (n, 3) rad/s.
        gyro_bias_sigma: (n, 3) rad/s, one sigma.
        accel_bias: (n, 3) m/s2.
        accel_bias_sigma: (n, 3) m/s2, one sigma.
        lla: (n, 3) rad, rad, m, place.
        vel_n: (n, 3) m/s, velocity.
        pos_cov: (n, 3, 3) m2, NED, of the place, errors of the fixes that wander included.
        vel_cov: (n, 3, 3) m2/s2, NED.
        innovation: (n, MEASUREMENTS) decorrelated, so independent of each other (see `filters`); NaN where no
            measurement was used.
        innovation_var: (n, MEASUREMENTS) variances of the innovations: NIS is the sum of innovation^2 / variance.
        adaptation: (n, 4) state of the adaptation policy, of which the meaning depends on the method.
    """

    t: np.ndarray = column()
    status: np.ndarray = column(dtype=np.uint8)
    q_nb: np.ndarray = column(4)
    down_b: np.ndarray = column(3)
    att_cov: np.ndarray = column(3, 3)
    gyro_bias: np.ndarray = column(3)
    gyro_bias_sigma: np.ndarray = column(3)
    accel_bias: np.ndarray = column(3)
    accel_bias_sigma: np.ndarray = column(3)
    lla: np.ndarray = column(3)
    vel_n: np.ndarray = column(3)
    pos_cov: np.ndarray = column(3, 3)
    vel_cov: np.ndarray = column(3, 3)
    innovation: np.ndarray = column(MEASUREMENTS)
    innovation_var: np.ndarray = column(MEASUREMENTS)
    adaptation: np.ndarray = column(4)


@dataclass(frozen=True, slots=True)
class Site:
    """Holds place and date, known to any navigator: the gravity and field that a filter takes as given.

    Attributes:
        lla: rad, rad, m: latitude, longitude and ellipsoidal height where the flight starts.
        gravity: m/s2.
        mag_n: T, NED, the local field of the World Magnetic Model.
    """

    lla: tuple[float, float, float]
    gravity: float = 9.80665
    mag_n: tuple[float, float, float] = (2.2e-5, 0.0, 4.2e-5)


@dataclass(frozen=True, slots=True)
class SensorInfo:
    """Holds the data-sheet figures of the sensors behind a stream: one sigma, SI. A filter may use these and no more.

    Attributes:
        rate: Hz, nominal.
        gyro_noise: rad/s/sqrt(Hz), single-sided density: sigma = density sqrt(rate / 2).
        gyro_bias: rad/s, turn-on.
        gyro_instability: rad/s, in run.
        gyro_scale: of the rate: scale factor and misalignment together.
        gyro_scale_factor: of the rate: scale factor alone.
        gyro_misalignment: rad, of an axis about each other one.
        gyro_drift: rad/s, of the bias over minutes: warming up.
        accel_noise: m/s2/sqrt(Hz).
        accel_bias: m/s2.
        accel_instability: m/s2, in run.
        accel_drift: m/s2, over minutes.
        accel_scale: of the specific force: scale factor and misalignment together.
        accel_scale_factor: of the specific force: scale factor alone.
        accel_misalignment: rad, cross-axis sensitivity with it.
        mag_noise: T, one sample.
        mag_bias: T, hard iron left over after calibration.
        mag_wander: T, hard iron that comes and goes: currents.
        mag_scale_factor: of the field.
        mag_misalignment: rad.
        soft_iron: of the field, left over after calibration.
        field_error: T NED, of the World Magnetic Model.
        gyro_delay: s: the value at stamp t was true at t - delay.
        accel_delay: s, likewise.
        mag_delay: s, likewise.
        gnss_pos: m.
        gnss_vel: m/s.
        heading: rad, dual antenna.
        heading_mount: rad, of the baseline in yaw and in pitch.
        airspeed: m/s.
        airspeed_scale: of the airspeed.
        antenna_b: m, GNSS antenna from the IMU, body axes.
    """

    rate: float = 100.0
    gyro_noise: float = 5e-4
    gyro_bias: float = 5e-3
    gyro_instability: float = 5e-4
    gyro_scale: float = 1.5e-3
    gyro_scale_factor: float = 1e-3
    gyro_misalignment: float = 1e-3
    gyro_drift: float = 5e-4
    accel_noise: float = 2e-3
    accel_bias: float = 5e-2
    accel_instability: float = 1e-3
    accel_drift: float = 1e-2
    accel_scale: float = 5e-3
    accel_scale_factor: float = 3e-3
    accel_misalignment: float = 3e-3
    mag_noise: float = 5e-7
    mag_bias: float = 1e-6
    mag_wander: float = 1e-7
    mag_scale_factor: float = 5e-3
    mag_misalignment: float = 5e-3
    soft_iron: float = 5e-3
    field_error: tuple[float, float, float] = (1.37e-7, 8.9e-8, 1.41e-7)
    gyro_delay: float = 0.0
    accel_delay: float = 0.0
    mag_delay: float = 0.0
    gnss_pos: float = 2.5
    gnss_vel: float = 0.1
    heading: float = 3.5e-3
    heading_mount: float = 2.6e-3
    airspeed: float = 0.3
    airspeed_scale: float = 0.02
    antenna_b: tuple[float, float, float] = (0.0, 0.0, 0.0)
