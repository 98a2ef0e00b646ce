"""Readers of the streams that are not ours: pymavlink, pyubx2, and two written from the makers' documents alone.

Each takes bytes (`rows`) and gives rows of samples as they come, and packs the answer on one (`answer`).
"""

import binascii
import os
import struct
from typing import Any, ClassVar

import numpy as np


class Reader:
    """Latches what comes between two IMU messages."""

    def __init__(self) -> None:
        self.kept: dict[str, Any] = {}
        self.pending = b""

    def row(self, t: float, stamp: int, gyro: Any, accel: Any) -> dict[str, Any]:
        row = {"t": t, "stamp": stamp, "gyro_b": gyro, "accel_b": accel, **self.kept}
        self.kept = {}
        return row


class Mavlink(Reader):
    """pymavlink on both ways."""

    def __init__(self) -> None:
        super().__init__()
        os.environ["MAVLINK20"] = "1"
        from pymavlink.dialects.v20 import common

        self.mav = common.MAVLink(None, srcSystem=7)

    def rows(self, data: bytes) -> list[dict[str, Any]]:
        rows = []
        for m in self.mav.parse_buffer(data) or []:
            if m.get_type() == "GPS_INPUT" and m.fix_type >= 3:
                self.kept |= {
                    "lla": [np.radians(m.lat * 1e-7), np.radians(m.lon * 1e-7), m.alt],
                    "vel_n": [m.vn, m.ve, m.vd],
                    "gnss_t": m.time_usec * 1e-6,
                    "gnss_satellites": m.satellites_visible,
                    "gnss_new": True,
                }
            if m.get_type() != "HIGHRES_IMU":
                continue
            if m.fields_updated & 448:
                self.kept |= {"mag_b": np.array([m.xmag, m.ymag, m.zmag]) * 1e-4, "mag_new": True}
            gyro, accel = [m.xgyro, m.ygyro, m.zgyro], [m.xacc, m.yacc, m.zacc]
            rows.append(self.row(m.time_usec * 1e-6, m.time_usec // 1000, gyro, accel))
        return rows

    def answer(self, row: dict[str, Any], q: np.ndarray, rpy: np.ndarray) -> bytes:
        return bytes(self.mav.attitude_quaternion_encode(row["stamp"], *q, 0, 0, 0).pack(self.mav))


class VectorNav(Reader):
    """Written from the manual of the VN-300: the three messages by their headers."""

    IMU = b"\xfa\x01" + struct.pack("<H", 0x0203)  # TimeStartup, TimeGps, Imu: accelerometer, gyro
    MAG = b"\xfa\x01" + struct.pack("<H", 0x0401)  # TimeStartup, MagPres
    GNSS = b"\xfa\x09" + struct.pack(
        "<HH", 0x0001, 0x06BE
    )  # ... and Tow, Week, NumSats, Fix, PosLla, VelNed, PosU, VelU
    SIZES: ClassVar = {IMU: 4 + 40 + 2, MAG: 4 + 28 + 2, GNSS: 6 + 8 + 8 + 2 + 1 + 1 + 24 + 12 + 12 + 4 + 2}

    def rows(self, data: bytes) -> list[dict[str, Any]]:
        self.pending += data
        rows = []
        while len(self.pending) >= 6:
            head = next((h for h in self.SIZES if self.pending.startswith(h)), None)
            assert head is not None, self.pending[:8]
            if len(self.pending) < self.SIZES[head]:
                break
            frame, self.pending = self.pending[: self.SIZES[head]], self.pending[self.SIZES[head] :]
            crc = 0
            for byte in frame[1:]:  # as printed in the manual
                crc = (crc >> 8 | crc << 8) & 0xFFFF
                crc ^= byte
                crc ^= (crc & 0xFF) >> 4
                crc ^= (crc << 12) & 0xFFFF
                crc ^= ((crc & 0xFF) << 5) & 0xFFFF
            assert crc == 0
            body = frame[len(head) : -2]
            if head == self.MAG:
                self.kept |= {"mag_b": np.array(struct.unpack_from("<3f", body, 8)) * 1e-4, "mag_new": True}
            elif head == self.GNSS:
                self.gnss = struct.unpack("<QQHBB3d3f3ff", body)
            else:
                t_ns, gps_ns, *inertial = struct.unpack("<QQ6f", body)
                if hasattr(self, "gnss"):
                    _, tow, week, satellites, fix, lat, lon, height, *rest = self.gnss
                    then = week * 604800 * 10**9 + tow
                    del self.gnss
                    assert fix == 3
                    self.kept |= {
                        "lla": [np.radians(lat), np.radians(lon), height],
                        "vel_n": rest[:3],
                        "gnss_t": (t_ns - gps_ns + then) * 1e-9,
                        "gnss_satellites": satellites,
                        "gnss_new": True,
                    }
                rows.append(self.row(t_ns * 1e-9, t_ns, inertial[3:], inertial[:3]))
        return rows

    def answer(self, row: dict[str, Any], q: np.ndarray, rpy: np.ndarray) -> bytes:
        body = b"\x01" + struct.pack("<HQ4f", 0x0011, row["stamp"], *q[1:], q[0])
        return b"\xfa" + body + struct.pack(">H", binascii.crc_hqx(body, 0))


def sbg_crc(data: bytes) -> int:
    """CRC-16 of the sbgECom document: polynomial 0x8408, from 0."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


class Sbg(Reader):
    """Written from "sbgECom Binary Messages"."""

    FIELD = 50e-6

    def rows(self, data: bytes) -> list[dict[str, Any]]:
        self.pending += data
        rows = []
        while len(self.pending) >= 9:
            assert self.pending[:2] == b"\xff\x5a" and self.pending[3] == 1
            size = int.from_bytes(self.pending[4:6], "little")
            if len(self.pending) < size + 9:
                break
            frame, self.pending = self.pending[: size + 9], self.pending[size + 9 :]
            assert frame[-1] == 0x33 and sbg_crc(frame[2:-3]) == int.from_bytes(frame[-3:-1], "little")
            number, body = frame[2], frame[6:-3]
            (stamp,) = struct.unpack_from("<I", body)
            if number == 4:
                assert len(body) == 30
                self.kept |= {"mag_b": np.array(struct.unpack_from("<3f", body, 6)) * self.FIELD, "mag_new": True}
            elif number == 14:
                assert len(body) == 62
                lat, lon, height = struct.unpack_from("<3d", body, 12)
                self.kept |= {"lla": [np.radians(lat), np.radians(lon), height], "gnss_t": stamp * 1e-6}
                self.kept |= {"gnss_new": True, "gnss_satellites": body[52]}
            elif number == 13:
                assert len(body) == 44
                self.kept |= {"vel_n": struct.unpack_from("<3f", body, 12), "gnss_t": stamp * 1e-6, "gnss_new": True}
            elif number == 15:
                assert len(body) == 32
                heading, sigma = np.radians(struct.unpack_from("<2f", body, 10))
                self.kept |= {
                    "heading": heading,
                    "heading_sigma": sigma,
                    "heading_t": stamp * 1e-6,
                    "heading_new": True,
                }
            elif number == 36:
                assert len(body) == 26
                if struct.unpack_from("<H", body, 4)[0] & 16:
                    self.kept |= {"airspeed": struct.unpack_from("<f", body, 18)[0], "air_new": True}
            elif number == 44:
                counts = np.array(struct.unpack_from("<6i", body, 6), float)
                rows.append(self.row(stamp * 1e-6, stamp, counts[3:] / 67108864, counts[:3] / 1048576))
        return rows

    def answer(self, row: dict[str, Any], q: np.ndarray, rpy: np.ndarray) -> bytes:
        body = struct.pack("<BBHI7fIff", 7, 1, 44, row["stamp"], *q, 0.01, 0.02, 0.03, 0, 0.0, 0.0)
        return b"\xff\x5a" + body + struct.pack("<HB", sbg_crc(body), 0x33)


class Ublox(Reader):
    """pyubx2, which uses pynmeagps for the sentences between."""

    def __init__(self) -> None:
        super().__init__()
        self.first: int | None = None
        self.sentences = 0

    def rows(self, data: bytes) -> list[dict[str, Any]]:
        from io import BytesIO

        from pyubx2 import UBXReader

        self.pending += data
        rows = []
        while self.pending:
            size = self._whole()
            if not size:
                break
            packet, self.pending = self.pending[:size], self.pending[size:]
            _, m = UBXReader(BytesIO(packet), protfilter=3, quitonerror=2).read()
            if m.identity == "NAV-PVT":
                then = (m.iTOW - self.first) * 1e-3 if self.first is not None else 0.0
                if m.fixType == 3:
                    self.kept |= {"lla": [np.radians(m.lat), np.radians(m.lon), m.height * 1e-3], "gnss_t": then}
                    self.kept |= {"vel_n": [m.velN * 1e-3, m.velE * 1e-3, m.velD * 1e-3], "gnss_new": True}
                    self.kept |= {"gnss_satellites": m.numSV}
            elif m.identity == "ESF-MEAS":
                self.first = m.timeTag if self.first is None else self.first
                values = {}
                for k in range(1, m.numMeas + 1):
                    raw = getattr(m, f"dataField_{k:02d}")
                    values[getattr(m, f"dataType_{k:02d}")] = raw - 2**24 if raw >= 2**23 else raw
                gyro = np.radians([values[k] / 4096 for k in (14, 13, 5)])
                accel = [values[k] / 1024 for k in (16, 17, 18)]
                rows.append(self.row((m.timeTag - self.first) * 1e-3, m.timeTag, gyro, accel))
            else:
                self.sentences += 1
                if m.identity.endswith("HDT"):
                    self.kept |= {"heading": np.radians(float(m.headingT)), "heading_new": True}
        return rows

    def _whole(self) -> int:
        if self.pending[:1] == b"$":
            return self.pending.find(b"\n") + 1
        assert self.pending[:1] == b"\xb5", self.pending[:4]
        size = 8 + int.from_bytes(self.pending[4:6], "little") if len(self.pending) >= 6 else 10**9
        return size if len(self.pending) >= size else 0

    def answer(self, row: dict[str, Any], q: np.ndarray, rpy: np.ndarray) -> bytes:
        from pyubx2 import GET, UBXMessage

        angles = dict(zip(("roll", "pitch", "heading"), np.degrees(rpy).tolist(), strict=True))
        sigmas = {"accRoll": 0.1, "accPitch": 0.2, "accHeading": 0.3}
        made = UBXMessage("NAV", "NAV-ATT", GET, iTOW=row["stamp"], version=0, reserved0=0, **angles, **sigmas)
        return bytes(made.serialize())


READERS = {"mavlink": Mavlink, "vectornav": VectorNav, "sbg": Sbg, "ubx+nmea": Ublox}
