"""SBG Systems' sbgECom, the messages of an Ellipse: IMU, magnetometer, GNSS, dual-antenna heading, air data.

After "sbgECom Binary Protocol" and "sbgECom Binary Messages" (https://github.com/SBG-Systems/sbgECom, doc/): 0xFF 0x5A,
number, class, length, data, CRC-16, 0x33. Stamps are us since power-up in 32 bits and begin anew after 71 minutes. The
magnetic field is in units of its own: here of 50 uT, so that it is about one as after SBG's calibration. Heights are
above the ellipsoid, with an undulation of zero. (An IG-500 speaks the maker's older protocol, not this one.)
"""

import math
import struct

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.serve.protocols import Answer
from ahrs_sim.serve.protocols.framing import Frames, crc16_reflected, gps_time
from ahrs_sim.serve.readings import Heading, Position, Reading, pressure_altitude

FIELD_T = 50e-6
"""T of one unit of the magnetic field."""

_MAG, _EULER, _QUAT, _VEL, _POS, _HDT, _AIR, _IMU = 4, 6, 7, 13, 14, 15, 36, 44
_LOG = 1  # class of all of them
_ACCEL, _RATE, _FAST_RATE = (
    1048576,
    67108864,
    12304174,
)  # units of IMU_SHORT in 1 m/s2, 1 rad/s, 1 rad/s beyond 1833 deg/s
_WRAP_US = 2**32


def message(number: int, payload: bytes) -> bytes:
    """Make the frame of a log message."""
    body = struct.pack("<BBH", number, _LOG, len(payload)) + payload
    return b"\xff\x5a" + body + struct.pack("<HB", crc16_reflected(body), 0x33)


def _good(frame: bytes) -> bool:
    (crc,) = struct.unpack_from("<H", frame, len(frame) - 3)
    return frame[-1] == 0x33 and crc == crc16_reflected(frame[2:-3])


class Sbg:
    """An Ellipse: IMU_SHORT, MAG, GPS1_POS, GPS1_VEL, GPS1_HDT and AIR_DATA; EKF_QUAT or EKF_EULER back."""

    resolution_ns = 1_000

    def __init__(self, zero_ns: int) -> None:
        self._zero_ns = zero_ns  # of the stamps, since 1970
        self._sent_us = 0
        self._frames = Frames(b"\xff\x5a", 6, lambda f: 9 + struct.unpack_from("<H", f, 4)[0], _good)

    def encode(self, reading: Reading) -> bytes:
        """Make the messages of a reading, the IMU's last."""
        self._sent_us = reading.t_ns // 1000
        stamp = struct.pack("<I", self._sent_us % _WRAP_US)
        made = b""
        if reading.position:
            made += self._position(reading.position)
        if reading.heading:
            made += self._heading(reading.heading)
        if reading.static_pressure is not None or reading.diff_pressure is not None or reading.airspeed is not None:
            made += message(_AIR, stamp + _air(reading))
        if reading.mag_b is not None:
            made += message(_MAG, stamp + struct.pack("<H6f", 0x1FF, *(reading.mag_b / FIELD_T), *reading.accel_b))
        status, unit = 0x3FF, _RATE
        if np.abs(reading.gyro_b).max() > math.radians(1833.0):
            status, unit = status | 1 << 10, _FAST_RATE
        counts = np.rint([*(reading.accel_b * _ACCEL), *(reading.gyro_b * unit)]).astype(int)
        celsius = round((reading.temperature - 273.15) * 256)
        return made + message(_IMU, stamp + struct.pack("<H6ih", status, *counts, celsius))

    def _stamps(self, t_ns: int) -> tuple[int, int]:
        """Stamp, and ms of the GPS week, of an instant of GNSS."""
        return t_ns // 1000 % _WRAP_US, gps_time(self._zero_ns + t_ns)[1] // 10**6

    def _position(self, position: Position) -> bytes:
        stamp, tow = self._stamps(position.t_ns)
        lla, vel, sigma = position.lla, position.vel_n, position.sigma
        made = b""
        if np.isfinite(lla[0]):
            degrees = math.degrees(lla[0]), math.degrees(lla[1]), lla[2]
            end = (position.satellites, 0xFFFF, 0xFFFF, 0xFF, 0)
            made += message(_POS, struct.pack("<III3d4fBHHBI", stamp, 2 << 6, tow, *degrees, 0.0, *sigma, *end))
        if np.isfinite(vel[0]):
            course = math.degrees(math.atan2(vel[1], vel[0])) % 360.0
            made += message(
                _VEL, struct.pack("<III8f", stamp, 2 << 6, tow, *vel, *np.full(3, np.nan), course, math.nan)
            )
        return made

    def _heading(self, heading: Heading) -> bytes:
        stamp, tow = self._stamps(heading.t_ns)
        degrees = math.degrees(heading.heading) % 360.0, math.degrees(heading.sigma)
        return message(_HDT, struct.pack("<IHI5fBB", stamp, 0, tow, *degrees, 0.0, math.nan, 0.0, 0xFF, 0xFF))

    def feed(self, data: bytes) -> list[Answer]:
        """Take what has come from the unit; return the attitudes that are whole."""
        return [a for frame in self._frames.feed(data) if frame[3] == _LOG and (a := self._answer(frame[2], frame[6:]))]

    def _answer(self, number: int, data: bytes) -> Answer | None:
        if number not in (_QUAT, _EULER) or len(data) < 36:
            return None
        (stamp,) = struct.unpack_from("<I", data)
        turns = (self._sent_us - stamp + _WRAP_US // 2) // _WRAP_US  # the nearest to what was sent last
        t_ns = (stamp + turns * _WRAP_US) * 1000
        if number == _QUAT:
            return Answer(
                t_ns, np.array(struct.unpack_from("<4f", data, 4)), _sigma(struct.unpack_from("<3f", data, 20))
            )
        angles = np.array([struct.unpack_from("<3f", data, 4)])
        return Answer(t_ns, attitude.from_euler(angles)[0], _sigma(struct.unpack_from("<3f", data, 16)))


def _sigma(values: tuple[float, ...]) -> np.ndarray | None:
    return np.array(values) if all(x > 0.0 for x in values) else None


def _air(reading: Reading) -> bytes:
    """Lay out AIR_DATA behind its stamp; a bit says which of its fields are there."""
    static, diff, speed = reading.static_pressure, reading.diff_pressure, reading.airspeed
    status = (0b110 if static is not None else 0) | (0b1000 if diff is not None else 0)
    status |= 0b10000 if speed is not None else 0
    height = 0.0 if static is None else pressure_altitude(static)
    return struct.pack("<H5f", status, static or 0.0, height, diff or 0.0, speed or 0.0, 0.0)
