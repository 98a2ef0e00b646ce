"""PX4's ULog: which fields a message has stands in the file (https://docs.px4.io/main/en/dev_log/ulog_file_format.html).

FRD and NED by definition. Every instance of a message is a topic, `sensor_gps`, `sensor_gps[1]`; of several of a kind
the one that the autopilot itself used comes first: `vehicle_gps_position` (selected or blended) before `sensor_gps`
(raw, in logs often thinned out), a receiver with fixes before one without.
"""

import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.recordings.sources import scan
from ahrs_sim.recordings.sources.base import (
    AIR,
    ATTITUDE,
    FIX,
    HEADING,
    IMU,
    MAG,
    NED,
    PRESSURE,
    VELOCITY,
    BinaryLog,
    Columns,
    gathered,
    numbered,
)

MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"
_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4",
    "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8", "bool": "?", "char": "S1",
}  # fmt: skip
_FIELD = re.compile(r"^([A-Za-z0-9_/]+)(?:\[(\d+)\])? ([A-Za-z0-9_]+)$")
_LARGEST = 65535  # bytes of a message
_NEVER = 0x7FFFFFFF  # `magnetometer_timestamp_relative` of a row without a new field

RECORDED = {"ekf2": "vehicle_attitude"}
"""Topic by name of the attitude estimator that wrote it."""


@dataclass
class _Subscription:
    name: str
    instance: int
    dtype: np.dtype[Any]
    shortest: int
    offsets: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))


class Messages:
    """The data messages of a ULog by name and instance.

    Raises:
        InputError: not there, or no ULog.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._data = np.fromfile(path, np.uint8)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
        if self._data.size < 16 or self._data[:7].tobytes() != MAGIC:
            raise InputError(f"{path}: no ULog: it does not start as one")
        free = np.full(65536, -1, np.int64)
        heads = self._scanned(free, np.zeros_like(free), self._parts(16), with_data=False)
        self._formats = self._described(heads)
        self._subscriptions = dict(self._announced(heads))
        if not self._subscriptions:
            raise InputError(f"{path}: no ULog: no message is announced in it")
        sizes, shortest = np.full(65536, -2, np.int64), np.zeros(65536, np.int64)
        for number, s in self._subscriptions.items():
            sizes[number], shortest[number] = s.dtype.itemsize, s.shortest
        offsets = self._scanned(sizes, shortest, self._parts(16), with_data=True)
        kinds = self._data[offsets + 2]
        at = offsets[kinds == ord("D")]
        numbers = self._data[at + 3].astype(np.int64) | self._data[at + 4].astype(np.int64) << 8
        order = np.argsort(numbers, kind="stable")
        at, numbers = at[order], numbers[order]
        for number, s in self._subscriptions.items():
            low, high = np.searchsorted(numbers, [number, number + 1])
            s.offsets = at[low:high]
        drops = offsets[kinds == ord("O")]
        drops = drops[drops + 5 <= self._data.size]
        lengths = self._data[drops + 3].astype(int) | self._data[drops + 4].astype(int) << 8
        self.dropouts, self.dropped_s = len(drops), float(lengths.sum()) / 1e3

    def _parts(self, start: int) -> list[tuple[int, int]]:
        """Find the parts with messages: data may have been appended behind a part that was cut off (flag bits)."""
        end = self._data.size
        appended: list[int] = []
        flagged = end >= start + 43 and self._data[start + 2] == ord("B") and self._data[start] == 40
        if flagged and self._data[start + 3 + 8] & 1:
            offsets = self._data[start + 19 : start + 43].view("<u8")
            appended = sorted(int(o) for o in offsets if start < o < end)
        edges = [start, *appended, end]
        return list(itertools.pairwise(edges))

    def _scanned(
        self, sizes: np.ndarray, shortest: np.ndarray, parts: list[tuple[int, int]], *, with_data: bool
    ) -> np.ndarray:
        found, self.lost = [], 0
        for start, end in parts:
            count, room = (end - start) // (16 if with_data else 1000) + 100, 0
            while count > room:  # messages are rarely so short that the first guess is too small
                room = count
                offsets = np.empty(room, np.int64)
                count, lost = scan.ulog(self._data, start, end, sizes, shortest, with_data, offsets)
            found.append(offsets[:count])
            self.lost += lost
        return np.concatenate(found)

    def _bodies(self, offsets: np.ndarray, kind: str) -> Iterator[bytes]:
        for at in offsets[self._data[offsets + 2] == ord(kind)].tolist():
            size = int(self._data[at]) | int(self._data[at + 1]) << 8
            yield self._data[at + 3 : at + 3 + size].tobytes()

    def _described(self, heads: np.ndarray) -> dict[str, list[tuple[str, int, str]]]:
        """Type, count and name of the fields of each format."""
        formats: dict[str, list[tuple[str, int, str]]] = {}
        for body in self._bodies(heads, "F"):
            name, _, fields = body.decode("ascii", errors="replace").partition(":")
            matches = [_FIELD.match(f.strip()) for f in fields.split(";") if f.strip()]
            if all(matches):
                formats.setdefault(name, [(m[1], int(m[2] or 1), m[3]) for m in matches if m])
        return formats

    def _announced(self, heads: np.ndarray) -> Iterator[tuple[int, _Subscription]]:
        seen: set[int] = set()
        for body in self._bodies(heads, "A"):
            name = body[3:].decode("ascii", errors="replace")
            number = int.from_bytes(body[1:3], "little")
            if len(body) > 3 and name in self._formats and number not in seen:
                dtype = self._dtype(name, ())
                if dtype is not None and dtype.names and "timestamp" in dtype.names:
                    seen.add(number)
                    yield number, _Subscription(name, body[0], dtype, dtype.itemsize - self._padding(name, dtype))

    def _dtype(self, name: str, outer: tuple[str, ...]) -> np.dtype[Any] | None:
        """Layout of a message or of one inside another; None where it cannot be."""
        if name in outer or len(outer) > 8 or name not in self._formats:
            return None
        columns: list[Any] = []
        total = 0
        for kind, count, field_name in self._formats[name]:
            inner = np.dtype(_TYPES[kind]) if kind in _TYPES else self._dtype(kind, (*outer, name))
            if inner is None or not 1 <= count <= _LARGEST:
                return None
            total += inner.itemsize * count
            if total > _LARGEST:
                return None
            columns.append((field_name, inner, (count,)) if count > 1 else (field_name, inner))
        names = [c[0] for c in columns]
        return np.dtype(columns) if columns and len(set(names)) == len(names) else None

    def _padding(self, name: str, dtype: np.dtype[Any]) -> int:
        """Count the bytes at the end which the logger leaves out."""
        last = self._formats[name][-1][2]
        return int(dtype[last].itemsize) if last.startswith("_padding") else 0

    def instances(self, name: str) -> Iterator[tuple[int, np.ndarray]]:
        """Yield number and messages (n,) of each instance of a message."""
        matching = sorted((s.instance, n) for n, s in self._subscriptions.items() if s.name == name)
        for instance, number in matching:
            rows = self.rows(number)
            if len(rows):
                yield instance, rows

    def rows(self, number: int) -> np.ndarray:
        """Read the messages of a subscription."""
        s = self._subscriptions[number]
        out = np.zeros((len(s.offsets), s.dtype.itemsize), np.uint8)
        if len(out):
            scan.gather(self._data, s.offsets + 5, out)
        return out.view(s.dtype)[:, 0] if len(out) else np.empty(0, s.dtype)


class Ulog(BinaryLog):
    """A PX4 log as topics named like its messages."""

    form = "PX4 ULog"

    def __init__(self, path: Path) -> None:
        self._log = Messages(path)
        self._offset = self._utc_offset()
        topics, refused = gathered(
            self._imu, self._raw_imu, self._mag, self._gnss, self._air, self._pressure, self._attitudes
        )
        if not topics:
            raise InputError(f"{path}: ULog without sensors or attitudes; nothing to replay")
        super().__init__(path, topics, RECORDED)
        if self._log.dropouts:
            self.notes.append(f"{self._log.dropouts} dropouts of the logger, {self._log.dropped_s:.3f} s in all")
        self._damage(refused, self._log.lost)

    def _utc_offset(self) -> int:
        """Compute the offset from the board's clock to UTC by its GNSS, ns; 0 without."""
        for name in ("vehicle_gps_position", "sensor_gps"):
            for _, rows in self._log.instances(name):
                if "time_utc_usec" in (rows.dtype.names or ()):
                    valid = rows[(rows["time_utc_usec"] > 0) & (rows["time_utc_usec"] < 2**62 // 1000)]
                    if len(valid):
                        shift = valid["time_utc_usec"].astype(np.int64) - valid["timestamp"].astype(np.int64)
                        return int(np.median(shift)) * 1000
        return 0

    def _made(self, name: str, type_name: str, make: Any, needed: tuple[str, ...], rank: int = 0,
              suffix: str = "", **more: Any) -> Iterator[tuple[str, Columns]]:  # fmt: skip
        """Make topics of each instance that has the fields needed; `make` gives rows and fields of some messages."""
        for i, rows in self._log.instances(name):
            if set(needed) <= set(rows.dtype.names or ()):
                rows, fields, worse = make(rows)
                yield (
                    f"{numbered(name, i)}{suffix}",
                    self._columns(type_name, rows, fields, rank=rank + i + 50 * worse, **more),
                )

    def _columns(self, type_name: str, rows: np.ndarray, fields: Mapping[str, np.ndarray], **more: Any) -> Columns:
        names = rows.dtype.names or ()
        sampled = "timestamp_sample" in names and rows["timestamp_sample"].any()
        clock = rows["timestamp_sample" if sampled else "timestamp"]
        sane = clock < 2**62 // 1000
        ns = np.where(sane, clock, 0).astype(np.int64) * 1000 + self._offset
        return self._in_time(Columns(type_name, ns, dict(fields), **more), sane)

    def _imu(self) -> Iterator[tuple[str, Columns]]:
        def combined(rows: np.ndarray) -> Any:
            return rows, {"angular_velocity": _vectors(rows["gyro_rad"]),
                          "linear_acceleration": _vectors(rows["accelerometer_m_s2"])}, 0  # fmt: skip

        def integrated(rows: np.ndarray) -> Any:
            rows = rows[(rows["delta_angle_dt"] > 0) & (rows["delta_velocity_dt"] > 0)]
            turn, push = (1e6 / rows[f"{k}_dt"].astype(float)[:, None] for k in ("delta_angle", "delta_velocity"))
            return rows, {"angular_velocity": turn * _vectors(rows["delta_angle"]),
                          "linear_acceleration": push * _vectors(rows["delta_velocity"])}, 0  # fmt: skip

        yield from self._made("sensor_combined", IMU, combined, ("gyro_rad", "accelerometer_m_s2"))
        needed = ("delta_angle", "delta_velocity", "delta_angle_dt", "delta_velocity_dt")
        yield from self._made("vehicle_imu", IMU, integrated, needed, rank=10)

    def _raw_imu(self) -> Iterator[tuple[str, Columns]]:
        """Read gyros and accelerometers apart, in the vehicle's axes as their drivers turn them."""
        for name, here, there in (
            ("sensor_gyro", "angular_velocity", "linear_acceleration"),
            ("sensor_accel", "linear_acceleration", "angular_velocity"),
        ):

            def single(rows: np.ndarray, here: str = here, there: str = there) -> Any:
                absent = np.tile(np.r_[-1.0, np.zeros(8)], (len(rows), 1))
                values = np.column_stack([rows[a].astype(float) for a in "xyz"])
                return rows, {here: values, f"{there}_covariance": absent}, 0

            yield from self._made(name, IMU, single, ("x", "y", "z"), rank=20)

    def _mag(self) -> Iterator[tuple[str, Columns]]:
        def calibrated(rows: np.ndarray) -> Any:
            return rows, {"magnetic_field": 1e-4 * _vectors(rows["magnetometer_ga"])}, 0

        def repeated(rows: np.ndarray) -> Any:
            """Make rows of the IMU, which repeat the field until there is a new one."""
            field_ga = _vectors(rows["magnetometer_ga"])
            fresh = np.r_[True, (np.diff(field_ga, axis=0) != 0).any(axis=1)]
            names = rows.dtype.names or ()
            if "magnetometer_timestamp_relative" in names:
                fresh &= rows["magnetometer_timestamp_relative"] != _NEVER
            fresh &= field_ga.any(axis=1)
            rows = rows[fresh]
            if "magnetometer_timestamp_relative" in names:
                rows = rows.copy()
                rows["timestamp"] += rows["magnetometer_timestamp_relative"].astype(np.int64).view(np.uint64)
            return rows, {"magnetic_field": 1e-4 * field_ga[fresh]}, 0

        def raw(rows: np.ndarray) -> Any:
            return rows, {"magnetic_field": 1e-4 * np.column_stack([rows[a].astype(float) for a in "xyz"])}, 0

        yield from self._made("vehicle_magnetometer", MAG, calibrated, ("magnetometer_ga",))
        yield from self._made("sensor_combined", MAG, repeated, ("magnetometer_ga",), rank=10, suffix="/mag")
        yield from self._made("sensor_mag", MAG, raw, ("x", "y", "z"), rank=20)

    def _gnss(self) -> Iterator[tuple[str, Columns]]:
        velocity_fields = ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s")

        def fixed(rows: np.ndarray) -> np.ndarray:
            names = rows.dtype.names or ()
            good: np.ndarray = rows["fix_type"] >= 3
            if "vel_ned_valid" in names:
                good = good & rows["vel_ned_valid"].astype(bool)
            return good

        def fixes(rows: np.ndarray) -> Any:
            good = rows["fix_type"] >= 3
            return rows, {"status__status": np.where(good, 0, -1), **_position(rows)}, 2 * good.sum() < len(rows)

        def velocities(rows: np.ndarray) -> Any:
            good = fixed(rows)
            worse = 2 * good.sum() < len(rows)
            velocity = np.column_stack([rows[good][f].astype(float) for f in velocity_fields])
            return rows[good], {"twist__linear": velocity}, worse

        def headings(rows: np.ndarray) -> Any:
            rows = rows[np.isfinite(rows["heading"])]
            return rows, {"heading": rows["heading"].astype(float)}, 0

        for rank, name in ((0, "vehicle_gps_position"), (10, "sensor_gps")):
            for new in (("latitude_deg", "longitude_deg", "altitude_ellipsoid_m"), ("lat", "lon", "alt_ellipsoid")):
                yield from self._made(name, FIX, fixes, ("fix_type", *new), rank, "/fix")
            needed = ("fix_type", *velocity_fields)
            yield from self._made(name, VELOCITY, velocities, needed, rank, "/velocity", frame_id=NED)
            yield from self._made(name, HEADING, headings, ("heading",), rank, "/heading", frame_id=NED)

    def _air(self) -> Iterator[tuple[str, Columns]]:
        def speeds(rows: np.ndarray) -> Any:
            rows = rows[np.isfinite(rows["true_airspeed_m_s"])]
            fields = (("airspeed", "true_airspeed_m_s"), ("indicated_airspeed", "indicated_airspeed_m_s"))
            return rows, {k: rows[v].astype(float) for k, v in fields}, not len(rows)

        for rank, name in ((0, "airspeed"), (10, "airspeed_validated")):
            yield from self._made(name, AIR, speeds, ("true_airspeed_m_s", "indicated_airspeed_m_s"), rank)

    def _pressure(self) -> Iterator[tuple[str, Columns]]:
        for name, column in (("vehicle_air_data", "baro_pressure_pa"), ("differential_pressure",
                             "differential_pressure_pa")):  # fmt: skip

            def pressures(rows: np.ndarray, column: str = column) -> Any:
                return rows, {"fluid_pressure": rows[column].astype(float)}, 0

            yield from self._made(name, PRESSURE, pressures, (column,))

    def _attitudes(self) -> Iterator[tuple[str, Columns]]:
        def attitudes(rows: np.ndarray) -> Any:
            return rows, {"quaternion": rows["q"].astype(float)}, 0

        for rank, name in ((0, "vehicle_attitude_groundtruth"), (10, "vehicle_attitude"), (20, "estimator_attitude")):
            yield from self._made(name, ATTITUDE, attitudes, ("q",), rank)


def _vectors(values: np.ndarray) -> np.ndarray:
    """Make (n, 3) float64 from an array field."""
    return values.astype(float).reshape(len(values), -1)[:, :3]


def _position(rows: np.ndarray) -> dict[str, np.ndarray]:
    if "latitude_deg" in (rows.dtype.names or ()):
        columns = (("latitude_deg", 1.0), ("longitude_deg", 1.0), ("altitude_ellipsoid_m", 1.0))
    else:
        columns = (("lat", 1e-7), ("lon", 1e-7), ("alt_ellipsoid", 1e-3))
    names = ("latitude", "longitude", "altitude")
    return {n: rows[c].astype(float) * scale for n, (c, scale) in zip(names, columns, strict=True)}
