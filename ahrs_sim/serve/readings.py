"""What a unit sends at each message of its IMU: that, and what has arrived since the one before."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim.sensors.assemble import Latch
from ahrs_sim.sensors.records import FixRecord, ImuRecord, PressureRecord, SuiteBlock
from estimators.types import Samples

SWITCHED_ON_NS = -(10**9)
"""ns of flight at which the unit's clock was zero: before the first stamp, which may be a little before the flight."""


@dataclass(frozen=True, slots=True)
class Position:
    """Holds a GNSS receiver's report of one instant; missing parts are NaN."""

    t_ns: int  # of the instant, on the unit's clock
    lla: np.ndarray  # (3,) rad, rad, m
    vel_n: np.ndarray  # (3,) m/s
    sigma: np.ndarray  # (3,) m, NED
    satellites: int


@dataclass(frozen=True, slots=True)
class Heading:
    """The heading of two GNSS antennas."""

    t_ns: int  # of the instant, on the unit's clock
    heading: float  # rad, true
    sigma: float  # rad


@dataclass(frozen=True, slots=True)
class Reading:
    """One IMU message; None: nothing new of this kind."""

    t_ns: int  # stamp on the unit's clock
    arrival_ns: int  # of flight: when it is sent
    gyro_b: np.ndarray  # (3,) rad/s
    accel_b: np.ndarray  # (3,) m/s2, specific force
    temperature: float  # K
    mag_b: np.ndarray | None = None  # (3,) T
    position: Position | None = None
    heading: Heading | None = None
    static_pressure: float | None = None  # Pa
    diff_pressure: float | None = None  # Pa
    airspeed: float | None = None  # m/s, true


class Readings:
    """Makes readings of a suite's blocks; what comes between two IMU messages goes with the second."""

    def __init__(self) -> None:
        self._latches = {"fix": Latch(FixRecord)} | {
            name: Latch(PressureRecord) for name in ("static_pressure", "diff_pressure")
        }

    def make(self, samples: Samples, records: SuiteBlock) -> Iterator[Reading]:
        """Yield a reading for each row.

        Args:
            samples: what `Assembler` has made of the records.
            records: of the same block, for what samples have not.
        """
        imu: Any = records.get("imu")
        if imu is None or not isinstance(imu, ImuRecord):
            return
        arrival = imu.arrival_ns
        seen = {name: latch.update(records.get(name), arrival) for name, latch in self._latches.items()}
        fix: Any = seen["fix"][0]
        for i in range(len(samples)):
            pressures = {
                name: float(seen[name][0].pressure[i]) if seen[name][1][i] else None
                for name in ("static_pressure", "diff_pressure")
            }
            yield Reading(
                t_ns=int(imu.stamp_ns[i]) - SWITCHED_ON_NS,
                arrival_ns=int(arrival[i]),
                gyro_b=imu.gyro_b[i],
                accel_b=imu.accel_b[i],
                temperature=float(imu.temperature[i]),
                mag_b=samples.mag_b[i] if samples.mag_new[i] else None,
                position=_position(samples, fix, i) if samples.gnss_new[i] else None,
                heading=_heading(samples, i) if samples.heading_new[i] else None,
                airspeed=float(samples.airspeed[i]) if samples.air_new[i] else None,
                **pressures,
            )


def _position(samples: Samples, fix: Any, i: int) -> Position:
    t_ns = round(float(samples.gnss_t[i]) * 1e9) - SWITCHED_ON_NS
    return Position(t_ns, samples.lla[i], samples.vel_n[i], fix.sigma[i], int(np.nan_to_num(fix.satellites[i])))


def _heading(samples: Samples, i: int) -> Heading:
    return Heading(round(float(samples.heading_t[i]) * 1e9), float(samples.heading[i]), float(samples.heading_sigma[i]))


def pressure_altitude(pressure: float) -> float:
    """Compute the height (m) of a static pressure (Pa) in the ICAO standard atmosphere, below 11 km (Doc 7488)."""
    return float(44330.77 * (1.0 - (pressure / 101325.0) ** 0.1902632))
