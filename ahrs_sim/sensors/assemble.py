"""Assembly of records into the input of estimators: one row per IMU message, slower sensors latched as they arrive.

Used in flight and on replay alike: all values come from the records.
"""

from typing import Any

import numpy as np

from ahrs_sim.sensors.records import (
    AirRecord,
    FixRecord,
    HeadingRecord,
    ImuRecord,
    MagRecord,
    Record,
    SuiteBlock,
    VelocityRecord,
)
from estimators.types import Samples, blank

_TYPES: dict[str, type[Record]] = {
    "mag": MagRecord,
    "fix": FixRecord,
    "velocity": VelocityRecord,
    "heading": HeadingRecord,
    "air": AirRecord,
}


class Assembler:
    """Merges the records of one suite by arrival.

    A row of `Samples` holds what had arrived when its IMU message did. A message without a value (no fix, a heading
    of NaN) makes the latched value NaN and sets no `*_new`.
    """

    def __init__(self) -> None:
        self._latches = {name: Latch(cls) for name, cls in _TYPES.items()}
        self._imu: Any = ImuRecord(**blank(ImuRecord, 0))

    def assemble(self, block: SuiteBlock) -> Samples:
        """Make samples of the IMU messages in `block`; other messages wait for the next IMU message."""
        imu: Any = block.get("imu", self._imu)
        arrival = imu.arrival_ns
        seen = {name: latch.update(block.get(name), arrival) for name, latch in self._latches.items()}
        mag, mag_new = seen["mag"]
        heading, heading_new = seen["heading"]
        air, air_new = seen["air"]
        fix, fix_new = seen["fix"]
        velocity, velocity_new = seen["velocity"]
        lla = np.deg2rad(fix.lla_deg)
        lla[:, 2] = fix.lla_deg[:, 2]
        vel_n, fix_ns = velocity.vel_n.copy(), fix.stamp_ns
        # Position and velocity of one row belong to one instant, the younger of the two; a message that did not come
        # leaves its part missing, not old.
        lla[fix_ns < velocity.stamp_ns] = np.nan
        vel_n[velocity.stamp_ns < fix_ns] = np.nan
        good = np.isfinite(lla[:, 0]) | np.isfinite(vel_n[:, 0])
        gnss_ns = np.maximum(fix_ns, velocity.stamp_ns)
        return Samples(
            t=imu.stamp_ns * 1e-9,
            gyro_b=imu.gyro_b,
            accel_b=imu.accel_b,
            mag_b=mag.mag_b,
            mag_new=mag_new & np.isfinite(mag.mag_b).all(axis=1),
            lla=lla,
            vel_n=vel_n,
            gnss_t=_seconds(gnss_ns),
            gnss_satellites=np.where(fix_ns == _NEVER, np.nan, fix.satellites),
            gnss_new=(fix_new | velocity_new) & good,
            heading=heading.heading,
            heading_sigma=heading.sigma,
            heading_t=_seconds(heading.stamp_ns),
            heading_new=heading_new & np.isfinite(heading.heading),
            airspeed=air.airspeed,
            alpha=air.alpha,
            beta=air.beta,
            air_new=air_new & np.isfinite(air.airspeed),
        )


_NEVER = np.iinfo(np.int64).min


def _seconds(ns: np.ndarray) -> np.ndarray:
    return np.where(ns == _NEVER, np.nan, ns * 1e-9)


class Latch:
    """Holds the last record of one kind that has arrived at each IMU message."""

    def __init__(self, cls: type[Record]) -> None:
        columns = blank(cls, 1)
        columns["stamp_ns"][:] = columns["arrival_ns"][:] = _NEVER
        self._held: Any = cls(**columns)  # the latched record, then those that have not arrived yet
        self._count = 1

    def update(self, records: Any, arrival: np.ndarray) -> tuple[Any, np.ndarray]:
        """Return the record latched at each IMU `arrival` (n,) ns, a block of n rows, and the mask (n,) of new ones."""
        fresh = len(records.stamp_ns) if records is not None else 0
        if fresh:
            self._held = type(records).concatenate([self._held, records])
        elif len(arrival) == 1 and self._count == 1:  # nothing waits, one row: the rule when an estimator flies
            return self._held, np.zeros(1, bool)
        last = np.searchsorted(self._held.arrival_ns, arrival, side="right") - 1
        new = np.empty(len(last), bool)
        if len(last):
            new[0] = last[0] > 0
            new[1:] = last[1:] > last[:-1]
        latched = self._held[last]
        if len(last) and last[-1] > 0:
            self._held = self._held[int(last[-1]) :]
        self._count = len(self._held.stamp_ns)
        return latched, new
