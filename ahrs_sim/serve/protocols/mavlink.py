"""MAVLink 2: the few messages that sensors, simulators and attitudes need.

Framing, checksum and messages after https://mavlink.io/en/guide/serialization.html and the message set `common.xml`
(https://mavlink.io/en/messages/common.html). Fields go over the wire by falling size of their type, extensions last.
Heights are sent above the ellipsoid.
"""

import math
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.serve.protocols import Answer
from ahrs_sim.serve.protocols.framing import crc16_reflected, gps_time
from ahrs_sim.serve.readings import Heading, Position, Reading, pressure_altitude

MESSAGES: dict[str, tuple[int, str, int]] = {
    "HEARTBEAT": (0, "<IBBBBB", 50),
    "ATTITUDE": (30, "<I6f", 39),
    "ATTITUDE_QUATERNION": (31, "<I7f4f", 246),
    "ATTITUDE_QUATERNION_COV": (61, "<Q4f3f9f", 167),
    "COMMAND_LONG": (76, "<7fHBBB", 152),
    "HIL_ACTUATOR_CONTROLS": (93, "<QQ16fB", 47),
    "HIGHRES_IMU": (105, "<Q13fHB", 93),
    "HIL_SENSOR": (107, "<Q13fIB", 108),
    "HIL_GPS": (113, "<Qiii3H3hH3BH", 124),
    "GPS_INPUT": (232, "<QIii9fHHBBBH", 151),
}
"""Number, fields as they lie on the wire, and the byte that seeds the checksum with the message's definition."""

_NAMES = {number: name for name, (number, _, _) in MESSAGES.items()}
_NONE = 65535  # a value of 16 bits that is not known


class Messages:
    """One side of a MAVLink wire: packs messages, and finds those of the other side (version 1 and 2) in a stream."""

    def __init__(self, system: int = 1, component: int = 1) -> None:
        self._from = system, component
        self._sequence = 0
        self._pending = b""

    def pack(self, name: str, *fields: Any) -> bytes:
        """Make the packet of a message from its fields in the order of the wire."""
        number, form, extra = MESSAGES[name]
        payload = struct.pack(form, *fields)
        payload = payload.rstrip(b"\0") or payload[:1]
        head = struct.pack("<BBBBBB", len(payload), 0, 0, self._sequence, *self._from) + number.to_bytes(3, "little")
        self._sequence = self._sequence + 1 & 0xFF
        crc = crc16_reflected(bytes([extra]), crc16_reflected(head + payload, 0xFFFF))
        return b"\xfd" + head + payload + struct.pack("<H", crc)

    def feed(self, data: bytes) -> Iterator[tuple[str, tuple[Any, ...]]]:
        """Yield the known messages that are whole: name, and fields in the order of the wire."""
        self._pending += data
        while True:
            starts = [i for i in (self._pending.find(b"\xfd"), self._pending.find(b"\xfe")) if i >= 0]
            self._pending = self._pending[min(starts) :] if starts else b""
            if len(self._pending) < 3:
                return
            newer = self._pending[0] == 0xFD
            head, length = (10 if newer else 6), self._pending[1]
            end = head + length + 2
            if len(self._pending) < end:
                return
            found = _unpack(self._pending[:end], head, newer)
            if found is None:  # no message after all, or one that is not in the table
                self._pending = self._pending[1:]
                continue
            signed = 13 if newer and self._pending[2] & 1 else 0
            self._pending = self._pending[end + signed :]
            yield found


def _unpack(packet: bytes, head: int, newer: bool) -> tuple[str, tuple[Any, ...]] | None:
    number = int.from_bytes(packet[7:10] if newer else packet[5:6], "little")
    name = _NAMES.get(number)
    if name is None:
        return None
    _, form, extra = MESSAGES[name]
    (crc,) = struct.unpack("<H", packet[-2:])
    if crc16_reflected(bytes([extra]), crc16_reflected(packet[1:-2], 0xFFFF)) != crc:
        return None
    size = struct.calcsize(form)
    payload = packet[head:-2][:size].ljust(size, b"\0")
    return name, struct.unpack(form, payload)


class Mavlink:
    """An IMU with GNSS on MAVLink: HIGHRES_IMU and GPS_INPUT out, ATTITUDE_QUATERNION, its _COV, or ATTITUDE back."""

    resolution_ns = 1_000_000

    def __init__(self, zero_ns: int) -> None:
        self._wire = Messages()
        self._zero_ns = zero_ns  # of the stamps, since 1970
        self._second = -1

    def encode(self, reading: Reading) -> bytes:
        """Make HIGHRES_IMU, GPS_INPUT when there is a fix or heading, and a HEARTBEAT a second."""
        packets = [self._wire.pack("HIGHRES_IMU", reading.t_ns // 1000, *sensors(reading), 0)]
        if reading.position or reading.heading:
            packets.insert(0, self._gps(reading.position, reading.heading))
        if reading.t_ns // 10**9 != self._second:
            self._second = reading.t_ns // 10**9
            packets.insert(0, self._wire.pack("HEARTBEAT", 0, 18, 8, 0, 4, 3))  # onboard controller, no autopilot
        return b"".join(packets)

    def _gps(self, position: Position | None, heading: Heading | None) -> bytes:
        t_ns, lla, vel, sigma, satellites = 0, np.full(3, np.nan), np.full(3, np.nan), np.full(3, np.nan), 0
        if position:
            t_ns, lla, vel = position.t_ns, position.lla, position.vel_n
            sigma, satellites = position.sigma, position.satellites
        elif heading:
            t_ns = heading.t_ns
        placed, moving = np.isfinite(lla[0]), np.isfinite(vel[0])
        ignored = 2 | 4 | 32 | (0 if placed else 1 | 64 | 128) | (0 if moving else 8 | 16)  # hdop, vdop, velocity sigma
        week, in_week_ns = gps_time(self._zero_ns + t_ns)
        lat, lon = (round(math.degrees(x) * 1e7) for x in np.nan_to_num(lla[:2]))
        yaw = round(math.degrees(heading.heading) * 100) % 36000 or 36000 if heading else 0  # 0: none, 36000: north
        horizontal = math.hypot(sigma[0], sigma[1])
        numbers = np.nan_to_num([lla[2], 0.0, 0.0, *vel, 0.0, horizontal, sigma[2]])
        return self._wire.pack(
            "GPS_INPUT", t_ns // 1000, in_week_ns // 10**6, lat, lon, *numbers, ignored, week, 0, 3 if placed else 0,
            satellites, yaw,
        )  # fmt: skip

    def feed(self, data: bytes) -> list[Answer]:
        """Take what has come from the unit; return the attitudes that are whole."""
        return [answer for name, fields in self._wire.feed(data) if (answer := attitude_of(name, fields))]


def attitude_of(name: str, fields: tuple[Any, ...]) -> Answer | None:
    """Read the attitude in a message; None: it has none."""
    if name == "ATTITUDE_QUATERNION":
        return Answer(fields[0] * 1_000_000, np.array(fields[1:5]))
    if name == "ATTITUDE":
        return Answer(fields[0] * 1_000_000, attitude.from_euler(np.array([fields[1:4]]))[0])
    if name == "ATTITUDE_QUATERNION_COV":
        variance = np.array(fields[8:17])[[0, 4, 8]]
        known = bool((variance > 0.0).all())
        return Answer(fields[0] * 1000, np.array(fields[1:5]), np.sqrt(variance) if known else None)
    return None


def sensors(reading: Reading) -> tuple[Any, ...]:
    """Lay out the fields that HIGHRES_IMU and HIL_SENSOR share, `fields_updated` last.

    m/s2, rad/s, gauss, hPa, hPa, m, deg C; the pressure altitude of the standard atmosphere.
    """
    updated = 0b000000111111 | 1 << 12
    field = np.zeros(3)
    if reading.mag_b is not None:
        field, updated = reading.mag_b * 1e4, updated | 0b000111000000
    static = diff = height = 0.0
    if reading.static_pressure is not None:
        static, updated = reading.static_pressure / 100.0, updated | 1 << 9 | 1 << 11
        height = pressure_altitude(reading.static_pressure)
    if reading.diff_pressure is not None:
        diff, updated = reading.diff_pressure / 100.0, updated | 1 << 10
    celsius = reading.temperature - 273.15
    return (*reading.accel_b, *reading.gyro_b, *field, static, diff, height, celsius, updated)


def hil_gps(position: Position, heading: Heading | None, zero_ns: int) -> tuple[Any, ...]:
    """Lay out the fields of HIL_GPS: 1e-7 deg, mm above the ellipsoid, cm, cm/s, 0.01 deg.

    Args:
        position: of the receiver.
        heading: of two antennas, when it has them.
        zero_ns: of the stamps, ns since 1970.
    """
    placed, moving = np.isfinite(position.lla[0]), np.isfinite(position.vel_n[0])
    latitude, longitude, height = np.nan_to_num(position.lla)
    north, east, down = np.nan_to_num(position.vel_n)
    accuracy = [round(100 * x) if placed else _NONE for x in (math.hypot(*position.sigma[:2]), position.sigma[2])]
    course = round(math.degrees(math.atan2(east, north)) * 100) % 36000
    return (
        (zero_ns + position.t_ns) // 1000,
        round(math.degrees(latitude) * 1e7),
        round(math.degrees(longitude) * 1e7),
        round(height * 1e3),
        *accuracy,
        round(100 * math.hypot(north, east)) if moving else _NONE,
        *(round(100 * v) for v in (north, east, down)),
        course if moving else _NONE,
        3 if placed else 0,
        position.satellites,
        0,
        round(math.degrees(heading.heading) * 100) % 36000 or 36000 if heading else 0,  # 0: none, 36000: north
    )
