"""PX4 logs written by the format's specification, topics as (name, instance, fields, columns)."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bag_helpers import EPOCH, LLA, Motion

_TYPES = {"uint64_t": "<u8", "int32_t": "<i4", "float": "<f4", "double": "<f8", "uint8_t": "u1", "uint32_t": "<u4"}
HEADER = b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", 0)
Table = tuple[str, int, str, Mapping[str, Any]]
FIX = "timestamp time_utc_usec latitude_deg:double longitude_deg:double altitude_ellipsoid_m:double " \
      "vel_n_m_s:float vel_e_m_s:float vel_d_m_s:float heading:float fix_type:uint8_t"  # fmt: skip


def message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + kind + body


def _fields(text: str) -> list[tuple[str, str, int]]:
    """Name, type and count of `gyro_rad:float[3]`; plain names are uint64."""
    found = []
    for word in text.split():
        name, _, kind = word.partition(":")
        base, _, count = kind.partition("[")
        found.append((name, base or "uint64_t", int(count.rstrip("]") or 1) if count else 1))
    return found


def ulog(tables: Sequence[Table], dropouts: Sequence[int] = (), head: bytes = b"") -> bytes:
    """A log; `dropouts` in ms stand at its end."""
    out = bytearray(HEADER + head)
    for name, text in {t[0]: t[2] for t in tables}.items():
        parts = (f"{k}{f'[{n}]' if n > 1 else ''} {f};" for f, k, n in _fields(text))
        out += message(b"F", f"{name}:{''.join(parts)}".encode())
    rows: list[tuple[int, bytes]] = []
    for number, (name, instance, text, columns) in enumerate(tables):
        out += message(b"A", struct.pack("<BH", instance, number) + name.encode())
        kinds: list[Any] = [(f, _TYPES[k], (n,)) if n > 1 else (f, _TYPES[k]) for f, k, n in _fields(text)]
        array = np.zeros(len(columns["timestamp"]), kinds)
        for column, values in columns.items():
            array[column] = values
        prefix = struct.pack("<H", number)
        rows += [(int(row["timestamp"]), message(b"D", prefix + row.tobytes())) for row in array]
    rows.sort(key=lambda row: row[0])
    out += b"".join(row for _, row in rows)
    for length in dropouts:
        out += message(b"O", struct.pack("<H", length))
    return bytes(out)


def inertial(m: Motion, extra: str = "", **columns: Any) -> Table:
    text = f"timestamp gyro_rad:float[3] accelerometer_m_s2:float[3] {extra}"
    return "sensor_combined", 0, text, {"timestamp": m.t * 1e6, "gyro_rad": m.gyro_b,
                                        "accelerometer_m_s2": m.accel_b, **columns}  # fmt: skip


def magnetometer(m: Motion, instance: int = 0, scale: float = 1.0) -> Table:
    return "vehicle_magnetometer", instance, "timestamp magnetometer_ga:float[3]", {
        "timestamp": m.t[::2] * 1e6, "magnetometer_ga": scale * m.mag_b[::2] * 1e4}  # fmt: skip


def attitude(m: Motion, name: str = "vehicle_attitude") -> Table:
    return name, 0, "timestamp q:float[4]", {"timestamp": m.t * 1e6, "q": m.q_nb}


def receiver(m: Motion, name: str = "sensor_gps", instance: int = 0, every: int = 20, **columns: Any) -> Table:
    us = m.t[::every] * 1e6
    return name, instance, FIX, {
        "timestamp": us, "time_utc_usec": us + EPOCH // 1000, "latitude_deg": LLA[0], "longitude_deg": LLA[1],
        "altitude_ellipsoid_m": LLA[2], "vel_n_m_s": 1.0, "vel_e_m_s": 2.0, "vel_d_m_s": 3.0, "heading": np.nan,
        "fix_type": 3, **columns}  # fmt: skip


def write(path: Path, *tables: Table, **options: Any) -> Path:
    path.write_bytes(ulog(tables, **options))
    return path
