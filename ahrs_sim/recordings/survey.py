"""One look at a whole recording before estimators run: from which checks, calibration and installation are made.

Everything is kept as means over a tenth of a second, so an hour takes a few megabytes.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ahrs_sim.evaluation.sync import time_shift
from ahrs_sim.sensors.records import SuiteBlock
from ahrs_sim.world.gravity import STANDARD as G

BIN_S = 0.1
STILL_RATE, STILL_FORCE = math.radians(0.5), 0.15  # rad/s, m/s2: scatter within a second of standing
STILL_TURN = math.radians(3.0)  # rad/s: a mean that could be a bias
HELD_S = 2.0  # s: a reference that is slower is none
GREATEST_BIAS = math.radians(15.0)  # rad/s: one that is when nothing turns


@dataclass
class Survey:
    """Means over bins of `BIN_S`, in FRD; the magnetometer as reported (T, axes of its messages)."""

    t: np.ndarray  # (n,) s, mean of the stamps
    gyro_b: np.ndarray  # (n, 3) rad/s
    accel_b: np.ndarray  # (n, 3) m/s2
    scatter: np.ndarray  # (n, 2) greatest deviation of gyro and accelerometer within the bin
    mag: np.ndarray  # (n, 3) T; NaN without
    rate: float  # Hz, of the IMU
    lla: np.ndarray | None  # (3,) rad, rad, m: first fix
    t_velocity: np.ndarray  # (k,) s, GNSS
    vel_n: np.ndarray  # (k, 3) m/s
    t_fix: np.ndarray  # (k,) s
    fixes: np.ndarray  # (k, 3) rad, rad, m
    t_air: np.ndarray  # (k,) s
    airspeed: np.ndarray  # (k,) m/s, true
    t_mag: np.ndarray  # (n,) s, mean stamp of the magnetometer in each bin
    t_reference: np.ndarray  # (m,) s
    q_nb: np.ndarray  # (m, 4)

    def _turn_is_bias(self) -> np.ndarray:
        """Tell bins (n,) whose rate is small, or a bias up to `GREATEST_BIAS` with which the field does not turn."""
        rate = np.linalg.norm(self.gyro_b, axis=1)
        small: np.ndarray = rate < STILL_TURN
        half = max(1, round(0.5 / BIN_S))
        if len(rate) <= 2 * half:
            return small
        change, across = np.full(len(rate), np.nan), np.full(len(rate), np.nan)
        size = np.linalg.norm(self.mag, axis=1)
        size[size == 0.0] = np.nan
        change[half:-half] = np.linalg.norm(self.mag[2 * half :] - self.mag[: -2 * half], axis=1)
        across[half:-half] = 2 * half * BIN_S * np.linalg.norm(np.cross(self.gyro_b, self.mag), axis=1)[half:-half]
        with np.errstate(invalid="ignore"):  # a force that stays says nothing: it does in a coordinated turn
            stays = (across > 0.08 * size) & (change < 0.2 * across)
        return np.asarray(small | (stays & (rate < GREATEST_BIAS)))

    @property
    def still(self) -> np.ndarray:
        """Bins (n,) in the middle of a second of standing."""
        n = len(self.t)
        if not n:
            return np.zeros(0, bool)
        half = max(1, round(0.5 / BIN_S))
        padded = np.pad(np.column_stack([self.gyro_b, self.accel_b]), ((half, half), (0, 0)), mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
        span = windows.max(axis=-1) - windows.min(axis=-1)
        quiet = (span[:, :3].max(axis=1) < 2 * STILL_RATE) & (span[:, 3:].max(axis=1) < 2 * STILL_FORCE)
        quiet &= self._turn_is_bias()
        still: np.ndarray = quiet & (self.scatter[:, 0] < 3 * STILL_RATE) & (self.scatter[:, 1] < 6 * STILL_FORCE)
        return still


def look(blocks: Iterable[SuiteBlock]) -> Survey:
    """Survey records made without calibration: their magnetometer is in the axes of its messages."""
    inertial: list[np.ndarray] = []
    magnetic: list[np.ndarray] = []
    times: list[np.ndarray] = []
    attitudes: list[np.ndarray] = []
    intervals: list[float] = []
    slow: dict[str, list[np.ndarray]] = {"velocity": [], "fix": [], "air": []}
    for block in blocks:
        imu: Any = block["imu"]
        t = imu.stamp_ns * 1e-9
        if len(t) > 1:
            intervals.append(float(np.median(np.diff(t))))
        inertial.append(_bins(t, np.column_stack([t, imu.gyro_b, imu.accel_b])))
        field: Any = block.get("mag")
        if field is not None:
            t = field.stamp_ns * 1e-9
            magnetic.append(_bins(t, np.column_stack([t, field.mag_b])))
        for kind, found in slow.items():
            records: Any = block.get(kind)
            if records is not None:
                column = getattr(records, {"velocity": "vel_n", "fix": "lla_deg", "air": "airspeed"}[kind])
                rows = np.column_stack([records.stamp_ns * 1e-9, column])
                found.append(rows[np.isfinite(rows).all(axis=1)])
        reference: Any = block.get("reference")
        if reference is not None:
            known = np.isfinite(reference.q_nb).all(axis=1)
            times.append(reference.stamp_ns[known] * 1e-9)
            attitudes.append(reference.q_nb[known])
    rows = np.concatenate([*inertial, np.empty((0, 16))])
    fields = np.concatenate([*magnetic, np.empty((0, 10))])
    mag = np.full((len(rows), 4), np.nan)
    _, here, there = np.intersect1d(rows[:, 0], fields[:, 0], return_indices=True)
    mag[here] = fields[there, 2:6]
    velocity, fix, air = (
        np.concatenate([*slow[kind], np.empty((0, n))]) for kind, n in (("velocity", 4), ("fix", 4), ("air", 2))
    )
    fix = fix * [1.0, math.pi / 180, math.pi / 180, 1.0]
    return Survey(
        t=rows[:, 2],
        gyro_b=rows[:, 3:6],
        accel_b=rows[:, 6:9],
        scatter=np.column_stack([rows[:, 10:13].max(axis=1, initial=0), rows[:, 13:16].max(axis=1, initial=0)]),
        mag=mag[:, 1:],
        rate=1.0 / float(np.median(intervals)) if intervals else math.nan,
        lla=fix[0, 1:] if len(fix) else None,
        t_velocity=velocity[:, 0],
        vel_n=velocity[:, 1:],
        t_fix=fix[:, 0],
        fixes=fix[:, 1:],
        t_air=air[:, 0],
        airspeed=air[:, 1],
        t_mag=mag[:, 0],
        t_reference=np.concatenate([*times, np.empty(0)]),
        q_nb=np.concatenate([*attitudes, np.empty((0, 4))]),
    )


def _bins(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Compute number, count, mean (k) and greatest deviation (k) of each bin, (m, 2 + 2k); one cut in two is two."""
    good = np.isfinite(values).all(axis=1)
    number, values = np.floor(t[good] / BIN_S), values[good]
    if not len(number):
        return np.empty((0, 2 + 2 * values.shape[1]))
    first = np.flatnonzero(np.r_[True, np.diff(number) != 0])
    count = np.diff(np.r_[first, len(number)])
    mean = np.add.reduceat(values, first) / count[:, None]
    deviation = np.maximum.reduceat(np.abs(values - np.repeat(mean, count, axis=0)), first)
    return np.column_stack([number[first], count, mean, deviation])


def reference_delay(s: Survey) -> float | None:
    """Estimate by how many s the reference attitude is later than the gyro; None: too little motion."""
    return time_shift(s.t, s.gyro_b, BIN_S, s.t_reference, s.q_nb)


def held(s: Survey) -> list[tuple[float, float]]:
    """Find spans (s) in which the reference attitude stays the very same while the gyro turns: tracking lost."""
    if len(s.t_reference) < 2 or not len(s.t):
        return []
    turning = ~s._turn_is_bias()
    same = np.r_[False, (np.diff(s.q_nb, axis=0) == 0.0).all(axis=1), False]
    edges = np.flatnonzero(np.diff(same.astype(int)))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        start, end = float(s.t_reference[first]), float(s.t_reference[last])
        inside = turning[(s.t >= start) & (s.t <= end)]
        if end - start >= HELD_S and len(inside) and inside.mean() > 0.3:
            found.append((start, end))
    return found


def without_held(s: Survey, spans: Iterable[tuple[float, float]]) -> Survey:
    """Drop the reference attitude within spans (s)."""
    good = np.ones(len(s.t_reference), bool)
    for start, end in spans:
        good &= (s.t_reference < start) | (s.t_reference > end)
    return replace(s, t_reference=s.t_reference[good], q_nb=s.q_nb[good])


def field_at_rest(s: Survey, mag_b: np.ndarray) -> np.ndarray | None:
    """Compute the field (3,) T, magnetic north, east, down, from readings `mag_b` (n, 3), FRD, at rest."""
    norm = np.linalg.norm(s.accel_b, axis=1)
    calm = s.still if s.still.sum() >= 10 else np.abs(norm - G) < 0.3
    calm = calm & np.isfinite(mag_b).all(axis=1)
    if calm.sum() < 10:
        return None
    strength = np.linalg.norm(mag_b[calm], axis=1)
    down = float(np.median(np.sum(mag_b[calm] * -s.accel_b[calm], axis=1) / (strength * norm[calm])))
    total = float(np.median(strength))
    return np.array([total * math.sqrt(max(1.0 - down**2, 0.0)), 0.0, total * down])
