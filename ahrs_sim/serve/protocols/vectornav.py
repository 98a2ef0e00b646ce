"""VectorNav's binary output, three messages as a VN-300 sends them when asked to.

After the user manuals of VN-100 and VN-300 (UM001, UM005), chapter "Binary output messages": 0xFA, a byte of groups,
for each group a word of fields, the fields, and a CRC-16 (CCITT, from 0) that makes the whole zero. Body axes are FRD;
the accelerometer gives specific force; quaternions have their scalar last. GNSS heights are above the ellipsoid. The
field Imu is sent: no bias of the unit's own filter has been taken out of it.
"""

import binascii
import math
import struct

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.serve.protocols import Answer
from ahrs_sim.serve.protocols.framing import Frames, gps_time
from ahrs_sim.serve.readings import Position, Reading

_SIZES = (
    (8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8),  # common
    (8, 8, 8, 2, 8, 8, 8, 4),  # time
    (2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2),  # IMU
    (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4),  # GNSS
    (2, 12, 16, 36, 12, 12, 12, 12, 12),  # attitude
    (2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4),  # INS
)
"""Bytes of the fields of each group, from the lowest bit on."""

_STARTUP, _GPS_NS, _YPR, _QUATERNION, _IMU, _MAG_PRES = 0, 1, 3, 4, 9, 10  # of the common group
_TOW, _WEEK, _SATELLITES, _FIX, _LLA, _VEL, _POS_U, _VEL_U = 1, 2, 3, 4, 5, 7, 9, 10  # of the GNSS group
_ATTITUDE, _ATTITUDE_YPR, _ATTITUDE_QUATERNION, _ATTITUDE_SIGMA = 4, 1, 2, 8


def message(*groups: tuple[int, tuple[int, ...]], payload: bytes) -> bytes:
    """Make a message of groups (number, bits of its fields) and their fields one behind the other."""
    head = bytes([sum(1 << number for number, _ in groups)])
    head += b"".join(struct.pack("<H", sum(1 << bit for bit in bits)) for _, bits in groups)
    body = head + payload
    return b"\xfa" + body + struct.pack(">H", binascii.crc_hqx(body, 0))


def _layout(frame: bytes) -> dict[tuple[int, int], int] | None:
    """Find where each field lies, by group and bit; the end as (-1, 0). None: more is needed, or unknown fields."""
    numbers = [n for n in range(8) if frame[1] >> n & 1]
    at = 2 + 2 * len(numbers)
    if len(frame) < at or not numbers or numbers[-1] >= len(_SIZES):
        return None
    places = {}
    for k, number in enumerate(numbers):
        (fields,) = struct.unpack_from("<H", frame, 2 + 2 * k)
        for bit in range(16):
            if fields >> bit & 1:
                if bit >= len(_SIZES[number]):
                    return None
                places[number, bit] = at
                at += _SIZES[number][bit]
    return {**places, (-1, 0): at}


def _size(frame: bytes) -> int:
    places = _layout(frame)
    return places[-1, 0] + 2 if places else 0


class VectorNav:
    """An IMU with magnetometer, barometer and GNSS: one message each; quaternion or yaw, pitch, roll back."""

    resolution_ns = 1

    def __init__(self, zero_ns: int) -> None:
        self._zero_ns = zero_ns  # of the stamps, since 1970
        self._frames = Frames(b"\xfa", 14, _size, lambda frame: binascii.crc_hqx(frame[1:], 0) == 0)

    def encode(self, reading: Reading) -> bytes:
        """Make the messages of a reading: GNSS, magnetometer with pressure, then the IMU."""
        week, in_week = gps_time(self._zero_ns + reading.t_ns)
        made = self._gnss(reading.t_ns, reading.position) if reading.position else b""
        startup = struct.pack("<Q", reading.t_ns)
        if reading.mag_b is not None or reading.static_pressure is not None:
            field = np.full(3, np.nan) if reading.mag_b is None else reading.mag_b * 1e4  # gauss
            pressure = math.nan if reading.static_pressure is None else reading.static_pressure / 1e3
            fields = struct.pack("<5f", *field, reading.temperature - 273.15, pressure)
            made += message((0, (_STARTUP, _MAG_PRES)), payload=startup + fields)
        gps_ns = week * 604_800 * 10**9 + in_week
        fields = struct.pack("<Q6f", gps_ns, *reading.accel_b, *reading.gyro_b)
        return made + message((0, (_STARTUP, _GPS_NS, _IMU)), payload=startup + fields)

    def _gnss(self, t_ns: int, position: Position) -> bytes:
        week, in_week = gps_time(self._zero_ns + position.t_ns)
        placed = bool(np.isfinite(position.lla[0]))
        lla = (math.degrees(position.lla[0]), math.degrees(position.lla[1]), position.lla[2])
        fields = struct.pack(
            "<QQHBB3d3f3ff", t_ns, in_week, week, position.satellites, 3 if placed else 0, *lla, *position.vel_n,
            *position.sigma, math.nan,
        )  # fmt: skip
        bits = (_TOW, _WEEK, _SATELLITES, _FIX, _LLA, _VEL, _POS_U, _VEL_U)
        return message((0, (_STARTUP,)), (3, bits), payload=fields)

    def feed(self, data: bytes) -> list[Answer]:
        """Take what has come from the unit; return the attitudes that are whole."""
        return [answer for frame in self._frames.feed(data) if (answer := _answer(frame))]


def _answer(frame: bytes) -> Answer | None:
    places = _layout(frame) or {}
    t_at = places.get((0, _STARTUP), places.get((1, 0)))
    if t_at is None:
        return None
    (t_ns,) = struct.unpack_from("<Q", frame, t_at)
    sigma = None
    if (at := places.get((_ATTITUDE, _ATTITUDE_SIGMA))) is not None:
        sigma = np.radians(struct.unpack_from("<3f", frame, at)[::-1])
    for key in ((0, _QUATERNION), (_ATTITUDE, _ATTITUDE_QUATERNION)):
        if key in places:
            x, y, z, w = struct.unpack_from("<4f", frame, places[key])
            return Answer(t_ns, np.array([w, x, y, z]), sigma)
    for key in ((0, _YPR), (_ATTITUDE, _ATTITUDE_YPR)):
        if key in places:
            rpy = np.radians(struct.unpack_from("<3f", frame, places[key])[::-1])
            return Answer(t_ns, attitude.from_euler(rpy[None])[0], sigma)
    return None
