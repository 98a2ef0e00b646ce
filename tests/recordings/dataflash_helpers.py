"""ArduPilot DataFlash logs written by the format's definition (libraries/AP_Logger/LogStructure.h)."""

import struct
from pathlib import Path

import numpy as np
from bag_helpers import EPOCH, LLA, Motion

from ahrs_sim.attitude import euler

HEAD = b"\xa3\x95"
_DTYPES = {"Q": "<u8", "B": "u1", "H": "<u2", "h": "<i2", "I": "<u4", "f": "<f4", "c": "<i2", "C": "<u2", "e": "<i4",
           "E": "<u4", "L": "<i4", "n": "S4", "N": "S16", "Z": "S64", "b": "i1", "d": "<f8"}  # fmt: skip
UNITS = {"s": "s", "#": "instance", "E": "rad/s", "o": "m/s/s", "G": "Gauss", "D": "deglatitude", "U": "deglongitude",
         "m": "m", "n": "m/s", "h": "degheading", "d": "deg", "P": "Pa", "-": ""}  # fmt: skip
MULTIPLIERS = {"-": 0.0, "0": 1.0, "F": 1e-6, "C": 1e-3, "B": 1e-2, "G": 1e-7}

# type, name, format, columns, units, multipliers
MESSAGES = {
    "IMU": (10, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "s#EEEooo", "F-000000"),
    "MAG": (11, "QBhhhB", "TimeUS,I,MagX,MagY,MagZ,Health", "s#GGG-", "F-CCC-"),
    "GPS": (12, "QBBIHLLeffffB", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U", "s#---DUmnhnh-",
            "F----GGB0000-"),
    "BARO": (13, "QBff", "TimeUS,I,Alt,Press", "s#mP", "F-00"),
    "ARSP": (14, "QBffB", "TimeUS,I,Airspeed,DiffPress,H", "s#nP-", "F-00-"),
    "ATT": (15, "QccC", "TimeUS,Roll,Pitch,Yaw", "sddh", "FBBB"),
    "XKF1": (16, "QBccC", "TimeUS,C,Roll,Pitch,Yaw", "s#ddh", "F-BBB"),
}  # fmt: skip


def dtype(form: str, columns: str) -> np.dtype:
    pairs = zip(columns.split(","), form, strict=True)
    return np.dtype([("head", "u1", 3), *((name, _DTYPES[letter]) for name, letter in pairs)])


def fmt(kind: int, name: str, form: str, columns: str) -> bytes:
    size = dtype(form, columns).itemsize
    return HEAD + struct.pack("<BBB4s16s64s", 128, kind, size, name.encode(), form.encode(), columns.encode())


def rows(
    name: str, messages: dict, at: np.ndarray | None = None, **values: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Times and messages of one kind; `at` (n,) says their order, else `TimeUS` does."""
    kind, form, columns, *_ = messages[name]
    n = len(np.atleast_1d(values["TimeUS"] if at is None else at))
    out = np.zeros(n, dtype(form, columns))
    out["head"] = (0xA3, 0x95, kind)
    for column, value in values.items():
        out[column] = value
    return (out["TimeUS"].astype(np.int64) if at is None else at), out


def assembled(messages: dict, groups: list[tuple[np.ndarray, np.ndarray]], *, units: bool = True) -> bytes:
    """A log: formats, units, then all messages in the order of their times."""
    head = fmt(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    for name, (kind, form, columns, *_) in messages.items():
        head += fmt(kind, name, form, columns)
    if units:
        head += fmt(129, "UNIT", "QbZ", "TimeUS,Id,Label") + fmt(130, "MULT", "Qbd", "TimeUS,Id,Mult")
        head += fmt(131, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
        for letter, label in UNITS.items():
            head += HEAD + struct.pack("<BQb64s", 129, 1, ord(letter), label.encode())
        for letter, factor in MULTIPLIERS.items():
            head += HEAD + struct.pack("<BQbd", 130, 1, ord(letter), factor)
        for kind, _, _, unit, multiplier in messages.values():
            head += HEAD + struct.pack("<BQB16s16s", 131, 1, kind, unit.encode(), multiplier.encode())
    times = np.concatenate([t for t, _ in groups])
    texts = [row.tobytes() for _, array in groups for row in array]
    return head + b"".join(texts[i] for i in np.argsort(times, kind="stable"))


def write_dataflash(path: Path, m: Motion, *, second: bool = True, units: bool = True, fixes: bool = True) -> None:
    """A flight of the motion as an autopilot would log it; the second units read something else."""
    us = np.rint(m.t * 1e6) + 5e6  # since boot
    slow = slice(None, None, 20)
    n = len(us[slow])
    seconds = (EPOCH // 10**9 + m.t[slow]) - 315964800 + 18.0
    week, in_week = np.floor(seconds / 604800), np.mod(seconds, 604800)
    groups = []
    for i in range(1 + second):
        gyro, accel = (m.gyro_b, m.accel_b) if i == 0 else (m.gyro_b + 0.1, m.accel_b + 0.2)
        groups.append(rows("IMU", MESSAGES, TimeUS=us, I=i, GyrX=gyro[:, 0], GyrY=gyro[:, 1], GyrZ=gyro[:, 2],
                           AccX=accel[:, 0], AccY=accel[:, 1], AccZ=accel[:, 2]))  # fmt: skip
        mag = np.rint(m.mag_b[::2] * 1e7) * (1 + i)
        groups.append(rows("MAG", MESSAGES, TimeUS=us[::2], I=i, MagX=mag[:, 0], MagY=mag[:, 1], MagZ=mag[:, 2],
                           Health=1))  # fmt: skip
        status = 3 if i == second and fixes else 0  # the first receiver of two is dead
        groups.append(rows("GPS", MESSAGES, TimeUS=us[slow], I=i, Status=status, GMS=in_week * 1e3, GWk=week,
                           Lat=np.rint(LLA[0] * 1e7), Lng=np.rint(LLA[1] * 1e7), Alt=LLA[2] * 100,
                           Spd=np.hypot(1, 2), GCrs=np.degrees(np.arctan2(2, 1)), VZ=3.0, U=status > 0))  # fmt: skip
    groups.append(rows("BARO", MESSAGES, TimeUS=us[slow], I=0, Press=99000.0))
    groups.append(rows("ARSP", MESSAGES, TimeUS=us[slow], I=0, Airspeed=np.full(n, 20.0), H=1))
    angles = np.rint(np.degrees(euler(m.q_nb)) * 100)
    angles[:, 2] %= 36000
    for name, extra in (("ATT", {}), ("XKF1", {"C": 0})):
        groups.append(rows(name, MESSAGES, TimeUS=us, Roll=angles[:, 0], Pitch=angles[:, 1], Yaw=angles[:, 2],
                           **extra))  # fmt: skip
    path.write_bytes(assembled(MESSAGES, groups, units=units))
