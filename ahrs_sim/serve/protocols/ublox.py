"""u-blox's UBX with NMEA 0183 beside it, as a receiver with an IMU: no magnetometer, no air data.

After the interface descriptions of u-blox M8 and F9 (UBX-13003221, UBX-22010984): 0xB5 0x62, class, number, length,
data, two sums (RFC 1145). ESF-MEAS carries gyro in 2^-12 deg/s and accelerometer in 2^-10 m/s2, with the ms of the GPS
week as its time tag; NAV-PVT the fix in 1e-7 deg and mm; NMEA GGA and RMC repeat it, HDT is the heading of two
antennas. Heights are above the ellipsoid.
"""

import datetime
import math
import struct

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.serve.protocols import Answer
from ahrs_sim.serve.protocols.framing import WEEK_MS, Frames, gps_time
from ahrs_sim.serve.readings import Position, Reading

_MEAS, _PVT, _ATT = (0x10, 0x02), (0x01, 0x07), (0x01, 0x05)
_TYPES = (14, 13, 5, 16, 17, 18, 12)  # gyro x, y, z, accelerometer x, y, z, temperature of the gyro
_UNITS = (4096.0, 4096.0, 4096.0, 1024.0, 1024.0, 1024.0, 100.0)  # in 1 deg/s, 1 m/s2, 1 deg C
_NONE = 2**32 - 1


def _sums(data: bytes) -> bytes:
    a = b = 0
    for byte in data:
        a = a + byte & 0xFF
        b = b + a & 0xFF
    return bytes([a, b])


def message(kind: tuple[int, int], payload: bytes) -> bytes:
    """Make the frame of a UBX message of a class and number."""
    body = struct.pack("<BBH", *kind, len(payload)) + payload
    return b"\xb5\x62" + body + _sums(body)


def sentence(*fields: str) -> bytes:
    """Make an NMEA sentence."""
    text = ",".join(fields).encode()
    check = 0
    for byte in text:
        check ^= byte
    return b"$%s*%02X\r\n" % (text, check)


class Ublox:
    """A receiver with an IMU: ESF-MEAS, NAV-PVT, GGA, RMC and HDT; NAV-ATT back."""

    resolution_ns = 1_000_000

    def __init__(self, zero_ns: int) -> None:
        self._zero_ns = zero_ns  # of the stamps, since 1970
        self._start_ms = gps_time(zero_ns)[1] / 1e6
        self._frames = Frames(
            b"\xb5\x62", 6, lambda f: 8 + struct.unpack_from("<H", f, 4)[0], lambda f: _sums(f[2:-2]) == f[-2:]
        )

    def encode(self, reading: Reading) -> bytes:
        """Make the messages of a reading, the IMU's last."""
        made = self._fix(reading.position) if reading.position else b""
        if reading.heading:
            made += sentence("GNHDT", f"{math.degrees(reading.heading.heading) % 360.0:.3f}", "T")
        celsius = reading.temperature - 273.15
        values = np.rint(np.multiply([*np.degrees(reading.gyro_b), *reading.accel_b, celsius], _UNITS)).astype(int)
        data = [kind << 24 | int(value) & 0xFFFFFF for kind, value in zip(_TYPES, values, strict=True)]
        head = struct.pack("<IHH", self._week_ms(reading.t_ns), len(data) << 11, 0)
        return made + message(_MEAS, head + struct.pack(f"<{len(data)}I", *data))

    def _week_ms(self, t_ns: int) -> int:
        return round(gps_time(self._zero_ns + t_ns)[1] / 1e6) % WEEK_MS

    def _fix(self, position: Position) -> bytes:
        date = datetime.datetime.fromtimestamp((self._zero_ns + position.t_ns) / 1e9, datetime.UTC)
        lla, vel, sigma = (np.nan_to_num(x) for x in (position.lla, position.vel_n, position.sigma))
        placed = bool(np.isfinite(position.lla[0]))
        lat, lon = (math.degrees(x) for x in lla[:2])
        height, north, east, down = (round(1e3 * x) for x in (lla[2], *vel))
        ground, course = math.hypot(vel[0], vel[1]), math.degrees(math.atan2(vel[1], vel[0])) % 360.0
        accuracy = round(1e3 * math.hypot(sigma[0], sigma[1])), round(1e3 * sigma[2])
        payload = struct.pack(
            "<IH5BBIiBBBB4i2I4i i2IH6x i h H".replace(" ", ""),
            self._week_ms(position.t_ns), date.year, date.month, date.day, date.hour, date.minute, date.second,
            0b111, 20, date.microsecond * 1000, 3 if placed else 0, int(placed), 0, position.satellites,
            round(lon * 1e7), round(lat * 1e7), height, height, *accuracy, north, east, down, round(1e3 * ground),
            round(course * 1e5), _NONE, _NONE, 9999, 0, 0, 0,
        )  # fmt: skip
        return message(_PVT, payload) + (
            _nmea(date, lat, lon, lla[2], ground, course, position.satellites) if placed else b""
        )

    def feed(self, data: bytes) -> list[Answer]:
        """Take what has come from the unit; return the attitudes that are whole."""
        return [self._answer(f[6:]) for f in self._frames.feed(data) if (f[2], f[3]) == _ATT and len(f) >= 40]

    def _answer(self, data: bytes) -> Answer:
        week_ms, _, *angles = struct.unpack_from("<IB3x6i", data)
        roll, pitch, heading, *sigma = np.radians(np.array(angles) * 1e-5)
        t_ns = round((week_ms - self._start_ms) % WEEK_MS * 1e6)
        known = min(sigma) > 0.0
        return Answer(
            t_ns, attitude.from_euler(np.array([[roll, pitch, heading]]))[0], np.array(sigma) if known else None
        )


def _nmea(
    date: datetime.datetime, lat: float, lon: float, height: float, ground: float, course: float, satellites: int
) -> bytes:
    time = f"{date:%H%M%S}.{date.microsecond // 10000:02d}"
    place = [_minutes(lat, 2), "N" if lat >= 0.0 else "S", _minutes(lon, 3), "E" if lon >= 0.0 else "W"]
    gga = sentence("GNGGA", time, *place, "1", f"{satellites:02d}", "1.0", f"{height:.3f}", "M", "0.0", "M", "", "")
    knots = f"{ground / 0.514444:.3f}"
    return gga + sentence("GNRMC", time, "A", *place, knots, f"{course:.2f}", f"{date:%d%m%y}", "", "", "A", "V")


def _minutes(degrees: float, digits: int) -> str:
    """Write an angle as NMEA does: whole degrees, then minutes."""
    units = round(abs(degrees) * 60e5)
    return f"{units // 6_000_000:0{digits}d}{units % 6_000_000 / 1e5:08.5f}"
