"""Messages of the instruments: one block type per message, each row with its own stamp.

`stamp_ns` is the time of measurement by the instrument's clock, `arrival_ns` that of arrival; both count from
the scenario's epoch. Values are what the log stores, bit for bit, so that a replay sees the same numbers.
"""

from dataclasses import dataclass

import numpy as np

from estimators.types import Columns, Estimates, column


@dataclass(frozen=True, slots=True)
class Record(Columns):
    """Columns that all messages have."""

    stamp_ns: np.ndarray = column(dtype=np.int64)  # (n,) ns
    arrival_ns: np.ndarray = column(dtype=np.int64)  # (n,) ns


@dataclass(frozen=True, slots=True)
class ImuRecord(Record):
    """Gyro and accelerometer."""

    gyro_b: np.ndarray = column(3)  # (n, 3) rad/s
    accel_b: np.ndarray = column(3)  # (n, 3) m/s2, specific force
    saturated: np.ndarray = column(dtype=bool)  # any axis at its range
    temperature: np.ndarray = column()  # K, of the chip


@dataclass(frozen=True, slots=True)
class ImuErrorsRecord(Record):
    """True biases in each `ImuRecord`, for reports; no instrument sends them.

    The effective ones include what acts as a bias at constant specific force: of the accelerometer scale, misalignment
    and non-linearity times g, too; of the gyro g-sensitivity times g, but nothing that comes and goes with the rate.
    A navigator's bias states mean these.
    """

    gyro_bias: np.ndarray = column(3)  # (n, 3) rad/s, turn-on, in-run and temperature
    accel_bias: np.ndarray = column(3)  # (n, 3) m/s2
    gyro_effective_bias: np.ndarray = column(3)  # (n, 3) rad/s
    accel_effective_bias: np.ndarray = column(3)  # (n, 3) m/s2


@dataclass(frozen=True, slots=True)
class MagRecord(Record):
    """Magnetometer."""

    mag_b: np.ndarray = column(3)  # (n, 3) T
    saturated: np.ndarray = column(dtype=bool)


@dataclass(frozen=True, slots=True)
class FixRecord(Record):
    """GNSS position; NaN and `fix` -1 without a solution."""

    lla_deg: np.ndarray = column(3)  # (n, 3) deg, deg, m ellipsoidal (degrees: what NavSatFix stores)
    sigma: np.ndarray = column(3)  # (n, 3) m, NED, as the receiver reports it
    fix: np.ndarray = column(dtype=np.int8)  # NavSatStatus: -1 none, 0 fix, 2 RTK
    satellites: np.ndarray = column(dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class VelocityRecord(Record):
    """GNSS velocity; NaN without a solution."""

    vel_n: np.ndarray = column(3)  # (n, 3) m/s


@dataclass(frozen=True, slots=True)
class HeadingRecord(Record):
    """Dual-antenna heading; NaN without a solution."""

    heading: np.ndarray = column()  # rad, true heading of the baseline
    sigma: np.ndarray = column()  # rad, as reported
    satellites: np.ndarray = column(dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class PressureRecord(Record):
    """Static or differential pressure."""

    pressure: np.ndarray = column()  # Pa


@dataclass(frozen=True, slots=True)
class AirRecord(Record):
    """Air data derived by the air data computer from the two pressures, and the vanes where fitted."""

    indicated_airspeed: np.ndarray = column()  # m/s
    airspeed: np.ndarray = column()  # m/s, true
    alpha: np.ndarray = column()  # rad, NaN without vane
    beta: np.ndarray = column()  # rad, NaN without vane


@dataclass(frozen=True, slots=True)
class PhaseRecord(Record):
    """Two-antenna interferometer on a ground emitter."""

    phase: np.ndarray = column()  # rad, modulo 2 pi
    phase_rate: np.ndarray = column()  # rad/s
    bearing: np.ndarray = column()  # rad, coarse amplitude bearing


@dataclass(frozen=True, slots=True)
class AttitudeRecord(Record):
    """Reference attitude: the truth of a flight, or the reference of a recording."""

    q_nb: np.ndarray = column(4)  # (n, 4)


@dataclass(frozen=True, slots=True)
class Answers(Estimates):
    """Holds the answers of a unit under test, each row stamped at its arrival."""

    arrival: np.ndarray = column()  # (n,) s of flight


SuiteBlock = dict[str, Record]
"""One block of a suite, records by instrument: imu, imu_errors, mag, fix, velocity, heading, diff_pressure,
static_pressure, air, interferometer; on replay also reference.
"""


def within(block: SuiteBlock, first_ns: float, last_ns: float) -> SuiteBlock:
    """Select the rows of a block stamped from `first_ns` to `last_ns`."""
    cut = {}
    for name, records in block.items():
        rows = (records.stamp_ns >= first_ns) & (records.stamp_ns <= last_ns)
        cut[name] = (
            records if rows.all() else type(records)(*(getattr(records, f)[rows] for f in records.__match_args__))
        )
    return cut
