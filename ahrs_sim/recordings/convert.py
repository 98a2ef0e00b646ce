"""Messages of others into the records of a suite: FRD, NED, SI, in order of their stamps.

Messages are merged by what their stamps say, not by when they came: a slow link costs a live system latency, an
analysis nothing. Each topic is held back for `HOLD_NS`, so whatever is late by less is put in order; what comes later
still, twice, or with a stamp of another clock is left out and counted.
"""

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim.log.mcap.reader import stamps, vector
from ahrs_sim.recordings import frames
from ahrs_sim.recordings.choosing import RECORDED, Choice
from ahrs_sim.recordings.clocks import OTHER_CLOCK_NS, Clocks
from ahrs_sim.recordings.mapping import Map
from ahrs_sim.sensors import air_data
from ahrs_sim.sensors.records import (
    AirRecord,
    AttitudeRecord,
    FixRecord,
    HeadingRecord,
    ImuRecord,
    MagRecord,
    PressureRecord,
    Record,
    SuiteBlock,
    VelocityRecord,
)
from estimators.alignment import LONGEST_GAP
from estimators.types import blank

HOLD_NS = 10**9
"""How much later than the newest a message may be and still be put in its place."""

APART_NS = 2 * 10**8
"""Accelerations further apart than this say nothing of the time between them."""

SAME_NS = 10**7
"""Position and velocity this close in time are of one solution."""

GAP = 5.0
"""Mean intervals of the IMU from which on a pause in which messages are missing is a gap."""

_AROUND_NS, _GROUP = 10**9, 100
"""Before and after a pause, ns: messages are counted there. Messages of which the mean interval is taken."""

BRIDGED_NS = 2 * 10**7
"""How far away a force may have been measured that stands in for one that is missing."""

_LAPSE, _EXPONENT = 0.0065, 5.255876  # K/m, standard atmosphere below 11 km


_RECORDS: dict[str, type[Record]] = {
    "imu": ImuRecord,
    "mag": MagRecord,
    "fix": FixRecord,
    "velocity": VelocityRecord,
    "heading": HeadingRecord,
    "diff_pressure": PressureRecord,
    "static_pressure": PressureRecord,
    "air": AirRecord,
    "reference": AttitudeRecord,
}


@dataclass
class Calibration:
    """Holds the sensor errors to remove, in the axes of the messages."""

    hard_iron: np.ndarray  # (3,) T
    soft_iron: np.ndarray  # (3, 3)
    gyro_bias: np.ndarray  # (3,) rad/s


class Converter:
    """One pass over a recording.

    Args:
        chosen: topics by kind.
        mapping: the user's map.
        calibration: see there.
        epoch_ns: zero of the records' times, ns since 1970.
        height: m, of fixes before the first one that has a height.
        clocks: what is to be taken off the stamps; none: nothing.
        held: spans (s) of the reference's own stamps in which it is left out.
    """

    def __init__(
        self,
        chosen: Mapping[str, Choice],
        mapping: Map,
        calibration: Calibration,
        epoch_ns: int,
        height: float = 0.0,
        clocks: Clocks | None = None,
        held: Sequence[tuple[float, float]] = (),
    ) -> None:
        self.chosen, self.mapping, self.calibration, self.epoch_ns = chosen, mapping, calibration, epoch_ns
        self.counts: Counter[str] = Counter()
        self._held = [(round(1e9 * start), round(1e9 * end)) for start, end in held]
        self._clocks = clocks or Clocks(by_log=mapping.stamps == "log")
        kinds = [k for k in chosen if k != "accel"]
        kinds += ["air"] if "diff_pressure" in chosen and "air" not in chosen else []
        in_order = not self._clocks.hold_ns
        self._queues = {k: _Queue(_RECORDS.get(k, AttitudeRecord), k, self.counts, in_order) for k in kinds}
        self._gyro: np.ndarray | None = None  # messages whose acceleration has not come yet
        self._force = (np.empty(0, np.int64), np.empty((0, 3)))  # ns, in the axes of the gyro's messages
        self._static = (np.empty(0, np.int64), np.empty(0))  # ns, Pa: static pressure so far
        self._height = float(mapping.place.get("altitude_m", height))
        self._newest = np.iinfo(np.int64).min  # ns, latest stamp of the IMU
        self._makers: dict[str, Callable[[np.ndarray, Choice], dict[str, np.ndarray]]] = {
            "imu": self._imu,
            "mag": self._mag,
            "fix": self._fix,
            "velocity": self._velocity,
            "heading": self._heading,
            "static_pressure": self._static_pressure,
            "diff_pressure": self._diff_pressure,
            "air": self._air,
            "reference": self._reference,
        }

    def records(self, blocks: Iterable[dict[str, np.ndarray]]) -> Iterator[SuiteBlock]:
        """Yield blocks of records by kind, in the order of their stamps, `arrival_ns` being the stamp."""
        for block in blocks:
            self._take(block)
            if block_records := self._release(self._newest - HOLD_NS - self._clocks.hold_ns):
                yield block_records
        if rest := self._release(np.iinfo(np.int64).max):
            yield rest

    def _release(self, until: int) -> SuiteBlock:
        gnss = [self._queues[kind] for kind in ("fix", "velocity") if kind in self._queues]
        cut = _before_pair(until, [queue.waiting for queue in gnss])
        out = {kind: q.release(cut if q in gnss else until, until) for kind, q in self._queues.items()}
        if len(gnss) == 2:
            out["fix"], velocity = _together(out["fix"], out["velocity"])
            lost = np.isin(velocity.stamp_ns, out["fix"].stamp_ns[out["fix"].fix < 0])
            self.counts["velocity: without a fix, left out"] += int(lost.sum())
            out["velocity"] = _picked(velocity, np.flatnonzero(~lost))
        return out if any(len(r) for r in out.values()) else {}

    def _take(self, block: dict[str, np.ndarray]) -> None:
        arrays = {kind: block[choice.topic.name] for kind, choice in self.chosen.items()}
        if "accel" in arrays:
            arrays["imu"] = self._joined(arrays["imu"], arrays.pop("accel"))
        for kind in sorted(arrays, key=lambda k: k == "diff_pressure"):  # after what it needs
            array = arrays[kind]
            if not len(array):
                continue
            ns, good = self._stamps(kind, array)
            make = self._reference if kind.startswith(RECORDED) else self._makers[kind]
            columns = make(array, self.chosen[kind])
            if kind == "imu":
                known = np.isfinite(columns["gyro_b"]).all(axis=1)
                self.counts["imu: without rates, left out"] += int(np.sum(~known & good))
                good &= known
            for start, end in self._held if kind == "reference" else ():
                own = ns - self.mapping.shifts.get("reference", 0)
                good &= (own < start) | (own > end)
            self._put(kind, ns, columns, good)
            if kind == "imu" and good.any():
                self._newest = max(self._newest, int(ns[good].max()))

    def _put(self, kind: str, ns: np.ndarray, columns: dict[str, np.ndarray], good: np.ndarray) -> None:
        record: Any = _RECORDS.get(kind, AttitudeRecord)
        made = blank(record, len(ns))
        made.update(columns)
        made["stamp_ns"] = made["arrival_ns"] = ns
        self._queues[kind].add(record(**{k: v[good] for k, v in made.items()}))

    def _stamps(self, kind: str, array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute times of messages (n,) ns from the epoch, shifted by the map, and mask those that are possible."""
        header, clock = stamps(array), self._clocks.of(kind)
        by_header, by_log = clock.times(header, array["log_time"])
        shift = self.mapping.shifts.get(kind, 0)
        good = np.ones(len(array), bool)
        if not (self._clocks.by_log or clock.unset):
            good = (header != 0) | (array["log_time"] == 0)
            self.counts[f"{kind}: without a stamp, left out"] += int(np.sum(~good))
        if not (self._clocks.by_log or self._clocks.apart):
            near = np.abs(by_header + shift - by_log) < OTHER_CLOCK_NS + abs(shift)
            self.counts[f"{kind}: stamps of another clock"] += int(np.sum(~near & good))
            good &= near
        return (by_log if self._clocks.by_log else by_header) - self.epoch_ns + shift, good

    def _joined(self, gyro: np.ndarray, accel: np.ndarray) -> np.ndarray:
        """Join messages of the gyro with the acceleration of their time, from an accelerometer with its own topic."""
        turn = frames.to_frd(self.chosen["imu"].body).T @ frames.to_frd(self.chosen["accel"].body)
        ns = np.r_[self._force[0], self._stamps("accel", accel)[0]]
        force = np.concatenate([self._force[1], vector(accel["linear_acceleration"]) @ turn.T])
        order = np.argsort(ns, kind="stable")
        ns, force = ns[order], force[order]
        gyro = gyro if self._gyro is None else np.concatenate([self._gyro, gyro])
        t = self._stamps("imu", gyro)[0]
        ready = t <= (ns[-1] if len(ns) else np.iinfo(np.int64).min)
        self._gyro, gyro, t = gyro[~ready], gyro[ready], t[ready]
        self._force = ns, force
        if not len(gyro):
            return gyro
        right = np.clip(np.searchsorted(ns, t), 1, max(len(ns) - 1, 1))
        near = (t >= ns[0]) & (len(ns) > 1)
        near[near] &= ns[right[near]] - ns[right[near] - 1] < APART_NS
        self.counts["imu: without an acceleration near"] += int(np.sum(~near))
        made: np.ndarray = gyro.copy()
        made["linear_acceleration_covariance"] = 0.0
        for i, axis in enumerate("xyz"):
            made["linear_acceleration"][axis] = np.interp(t - ns[0], ns - ns[0], force[:, i])
        keep = max(int(np.searchsorted(ns, t.max())) - 2, 0)
        self._force = ns[keep:], force[keep:]
        joined: np.ndarray = made[near]
        return joined

    # ------------------------------------------------------------------------------------------- by kind

    def _imu(self, array: np.ndarray, choice: Choice) -> dict[str, np.ndarray]:
        axes = self.mapping.mount @ frames.to_frd(choice.body)
        gyro = self.mapping.gyro_unit * vector(array["angular_velocity"]) - self.calibration.gyro_bias
        accel = self.mapping.accel_unit * vector(array["linear_acceleration"])
        gyro[array["angular_velocity_covariance"][:, 0] == -1.0] = np.nan
        accel[array["linear_acceleration_covariance"][:, 0] == -1.0] = np.nan
        if np.any(empty := (accel == 0.0).all(axis=1)):  # no accelerometer reads nothing on three axes
            gyro[~empty & (vector(array["angular_velocity"]) == 0.0).all(axis=1)] = np.nan
            accel[empty] = np.nan
        self.counts["imu: without forces, taken from the neighbours"] += int(np.sum(np.isnan(accel).any(axis=1)))
        gyro, accel = gyro @ axes.T, _filled(array["log_time"], accel) @ axes.T
        if (correction := self.mapping.correction) is not None:
            gyro, accel = correction.gyro.applied(gyro), correction.accelerometer.applied(accel)
        return {"gyro_b": gyro, "accel_b": accel}

    def _mag(self, array: np.ndarray, choice: Choice) -> dict[str, np.ndarray]:
        axes = self.mapping.mag_axes(choice.body)
        raw = self.mapping.mag_unit * field(array)
        raw[~raw.any(axis=1)] = np.nan  # no place on Earth is without a field
        self.counts["mag: without a field"] += int(np.sum(np.isnan(raw).any(axis=1)))
        mag_b = (raw - self.calibration.hard_iron) @ (axes @ self.calibration.soft_iron).T
        return {"mag_b": self.mapping.corrected(mag_b)}

    def _fix(self, array: np.ndarray, choice: Choice) -> dict[str, np.ndarray]:
        lla = np.column_stack([array["latitude"], array["longitude"], array["altitude"]])
        none = (array["status"]["status"] < 0) | ((lla[:, 0] == 0.0) & (lla[:, 1] == 0.0))
        lla[none | (np.abs(lla[:, 0]) > 90.0) | (np.abs(lla[:, 1]) > 360.0)] = np.nan
        self.counts["fix: messages without a fix"] += int(np.sum(np.isnan(lla[:, 0])))
        variance = array["position_covariance"][:, [4, 0, 8]]
        known = (array["position_covariance_type"] > 0)[:, None] & (variance > 0)
        flat = np.isfinite(lla[:, :2]).all(axis=1) & np.isnan(lla[:, 2])  # of two dimensions
        self.counts["fix: without a height, that of the fix before taken"] += int(flat.sum())
        known_at = np.maximum.accumulate(np.where(np.isfinite(lla[:, 2]), np.arange(len(lla)), -1))
        before = np.where(known_at >= 0, lla[np.maximum(known_at, 0), 2], self._height)
        lla[flat, 2] = before[flat]
        heights = lla[np.isfinite(lla).all(axis=1), 2]
        if len(heights):
            self._height = float(heights[-1])
        with np.errstate(invalid="ignore"):
            return {
                "lla_deg": lla,
                "sigma": np.where(known, np.sqrt(variance), np.nan),
                "fix": np.where(np.isfinite(lla[:, 0]), array["status"]["status"], -1).astype(np.int8),
            }

    def _velocity(self, array: np.ndarray, choice: Choice) -> dict[str, np.ndarray]:
        twist = array["twist"]
        if choice.topic.type_name.endswith("WithCovarianceStamped"):
            twist = twist["twist"]
        return {"vel_n": vector(twist["linear"]) @ frames.to_ned(choice.world).T}

    def _heading(self, array: np.ndarray, choice: Choice) -> dict[str, np.ndarray]:
        if choice.topic.type_name == "ahrs_sim_msgs/msg/Heading":
            sigma = np.where(array["sigma"] > 0, array["sigma"], np.nan)
            return {"heading": array["heading"], "sigma": sigma, "satellites": array["satellites"]}
        q = frames.q_ned(frames.orientation(array, choice.topic.type_name), choice.body, choice.world)
        w, x, y, z = q.T
        return {"heading": np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))}

    def _static_pressure(self, array: np.ndarray, choice: Choice) -> dict[str, np.ndarray]:
        order = np.argsort(ns := self._stamps("static_pressure", array)[0], kind="stable")
        self._static = ns[order], array["fluid_pressure"][order]
        return {"pressure": array["fluid_pressure"]}

    def _diff_pressure(self, array: np.ndarray, choice: Choice) -> dict[str, np.ndarray]:
        pressure = array["fluid_pressure"]
        if "air" not in self.chosen:
            ns, _ = self._stamps("diff_pressure", array)
            indicated, true = (self.mapping.air_scale * speed for speed in self._airspeed(ns, pressure))
            self._put("air", ns, {"indicated_airspeed": indicated, "airspeed": true}, np.isfinite(true))
        return {"pressure": pressure}

    def _air(self, array: np.ndarray, choice: Choice) -> dict[str, np.ndarray]:
        return {name: self.mapping.air_scale * array[name] for name in ("indicated_airspeed", "airspeed")}

    def _reference(self, array: np.ndarray, choice: Choice) -> dict[str, np.ndarray]:
        q = frames.orientation(array, choice.topic.type_name)
        return {"q_nb": frames.q_ned(q, choice.body, choice.world)}

    def _airspeed(self, ns: np.ndarray, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Indicated and true airspeed (n,) m/s from differential pressure (n,) Pa.

        Static pressure as measured, else that of the standard atmosphere at the height of the last fix; temperature by
        the standard atmosphere.
        """
        times, values = self._static
        if len(times):
            static = np.interp(ns, times, values)
        else:
            ratio = 1.0 - _LAPSE * self._height / air_data.SEA_LEVEL_TEMPERATURE
            static = np.full(len(ns), air_data.SEA_LEVEL_PRESSURE * ratio**_EXPONENT)
        temperature = air_data.SEA_LEVEL_TEMPERATURE * (static / air_data.SEA_LEVEL_PRESSURE) ** (1.0 / _EXPONENT)
        impact = np.maximum(pressure, 0.0)

        def speed(p: Any, t: Any) -> np.ndarray:
            mach2 = 5.0 * np.expm1(2.0 / 7.0 * np.log1p(impact / p))
            root: np.ndarray = np.sqrt(1.4 * air_data.GAS_CONSTANT * t * mach2)
            return root

        return speed(air_data.SEA_LEVEL_PRESSURE, air_data.SEA_LEVEL_TEMPERATURE), speed(static, temperature)


def _filled(ns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate rows of NaN in values (n, 3) where a neighbour is within `BRIDGED_NS`."""
    known = np.isfinite(values).all(axis=1)
    if known.all() or not known.any():
        return values
    order = np.argsort(ns[known], kind="stable")
    t, rows = ns[known][order], values[known][order]
    right = np.clip(np.searchsorted(t, ns), 0, len(t) - 1)
    near = np.minimum(np.abs(t[right] - ns), np.abs(t[np.maximum(right - 1, 0)] - ns)) < BRIDGED_NS
    between = np.column_stack([np.interp(ns - t[0], t - t[0], column) for column in rows.T])
    return np.where((~known & near)[:, None], between, values)


def field(array: np.ndarray) -> np.ndarray:
    """Magnetic field (n, 3) as reported."""
    return vector(array["magnetic_field"])


class _Queue:
    """Records of one kind until they are old enough to be put in order."""

    def __init__(self, cls: type[Record], kind: str, counts: Counter[str], in_order: bool) -> None:
        self._kind, self._counts, self._in_order = kind, counts, in_order
        self._held: Any = cls(**blank(cls, 0))
        self._last = np.iinfo(np.int64).min  # ns, stamp of the last released
        self._floor = np.iinfo(np.int64).min  # ns, up to where the IMU has been released
        self._newest = np.iinfo(np.int64).min
        self._interval = math.nan  # ns, mean of the first block

    def add(self, records: Any) -> None:
        ns = records.stamp_ns
        if not len(ns):
            return
        before = np.maximum.accumulate(np.r_[self._newest, ns])[:-1]
        if self._in_order:  # else the log's clock was set back
            self._counts[f"{self._kind}: out of order"] += int(np.sum(ns < before))
        self._newest = max(self._newest, int(ns.max()))
        self._held = type(records).concatenate([self._held, records]) if len(self._held) else records

    @property
    def waiting(self) -> np.ndarray:
        """Stamps (n,) ns of what has not been released."""
        stamps: np.ndarray = self._held.stamp_ns
        return stamps

    def release(self, until: int, imu: int) -> Any:
        """Release everything stamped up to `until`, in order; the IMU up to `imu`."""
        ns = self._held.stamp_ns
        early = ns <= until
        taken = _picked(self._held, np.flatnonzero(early)[np.argsort(ns[early], kind="stable")])
        self._held = _picked(self._held, np.flatnonzero(~early))
        ns = taken.stamp_ns
        late = ns < self._last
        twice = (ns == np.r_[self._last, ns[:-1]]) & ~late
        self._counts[f"{self._kind}: too late"] += int(late.sum())
        self._counts[f"{self._kind}: duplicate"] += int(twice.sum())
        taken = _picked(taken, np.flatnonzero(~late & ~twice))
        ns = taken.stamp_ns
        if len(ns):
            self._gaps(np.r_[self._last, ns] if self._last > np.iinfo(np.int64).min else ns)
            self._last = int(ns[-1])
        # What belongs to rows of the IMU that are gone arrives with the next.
        taken = dataclasses.replace(taken, arrival_ns=np.maximum(taken.arrival_ns, self._floor))
        self._floor = max(self._floor, imu) if imu < np.iinfo(np.int64).max else self._floor
        return taken

    def _gaps(self, ns: np.ndarray) -> None:
        """Count pauses in which messages are missing: where they come in bursts, as many as ever follow at once."""
        if self._kind != "imu" or len(ns) < 2:
            return
        if math.isnan(self._interval):
            n = min(_GROUP, len(ns) - 1)
            self._interval = max(float(np.median(ns[n:] - ns[:-n])) / n, 1.0)
        steps = np.diff(ns)
        for k in np.flatnonzero(steps > GAP * self._interval):
            low, high = np.searchsorted(ns, [ns[k] - _AROUND_NS, ns[k + 1] + _AROUND_NS])
            high = min(high, len(ns) - 1)
            lost = float(ns[high] - ns[low]) / self._interval - float(high - low)
            self._counts["imu: gaps"] += lost > 0.5 * steps[k] / self._interval
        self._counts["imu: gaps after which estimators align anew"] += int(np.sum(steps > 1e9 * LONGEST_GAP))


def _picked(block: Any, rows: np.ndarray) -> Any:
    return type(block)(*(getattr(block, f.name)[rows] for f in dataclasses.fields(block)))


def _before_pair(until: int, stamps_ns: Iterable[np.ndarray]) -> int:
    """Find the last time up to `until` that does not part a fix from its velocity."""
    if until == np.iinfo(np.int64).max:
        return until
    every = np.sort(np.concatenate([*stamps_ns, np.empty(0, np.int64)]))
    for ns in every[every <= until][::-1]:
        if until - ns > SAME_NS:
            break
        until = int(ns) - 1
    return until


def _together(fix: Any, velocity: Any) -> tuple[Any, Any]:
    """Give fixes and velocities of one solution one stamp and one arrival: estimators take both as of one instant."""
    if not len(velocity) or not len(fix):
        return fix, velocity
    last = len(fix) - 1
    right = np.searchsorted(fix.stamp_ns, velocity.stamp_ns)
    sides = np.stack([np.clip(right - 1, 0, last), np.clip(right, 0, last)])
    off = np.abs(fix.stamp_ns[sides] - velocity.stamp_ns)
    partner = np.where(off[0] <= off[1], sides[0], sides[1])
    mine = np.flatnonzero(off.min(axis=0) <= SAME_NS)
    partner = partner[mine]
    stamp, there, here = velocity.stamp_ns.copy(), velocity.arrival_ns.copy(), fix.arrival_ns.copy()
    stamp[mine] = fix.stamp_ns[partner]
    there[mine] = here[partner] = np.maximum(velocity.arrival_ns[mine], fix.arrival_ns[partner])
    fix = dataclasses.replace(fix, arrival_ns=np.maximum.accumulate(here))
    return fix, dataclasses.replace(velocity, stamp_ns=stamp, arrival_ns=np.maximum.accumulate(there))
