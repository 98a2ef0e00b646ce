"""Makers' protocols: readings to bytes, and the bytes of a unit to its answers.

| name | stream | answer | time stamps |
|---|---|---|---|
| mavlink | HIGHRES_IMU with magnetometer and pressures, GPS_INPUT | ATTITUDE_QUATERNION(_COV), ATTITUDE | us; ms |
| vectornav | binary output: IMU; magnetometer and pressure; GNSS | Quaternion or Ypr with TimeStartup, YprU | ns |
| sbg | IMU_SHORT, MAG, GPS1_POS, GPS1_VEL, GPS1_HDT, AIR_DATA | EKF_QUAT, EKF_EULER | us |
| ubx+nmea | ESF-MEAS, NAV-PVT; GGA, RMC, HDT | NAV-ATT | ms |

A protocol is a class with `encode` and `feed`; the table below names it.
"""

import importlib
from dataclasses import dataclass
from typing import Protocol as Interface

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.serve.readings import SWITCHED_ON_NS, Reading


@dataclass(frozen=True, slots=True)
class Answer:
    """Holds the attitude that the unit reports for a time of the stream's clock."""

    t_ns: int  # of the stamps that it was sent, in the protocol's resolution
    q_nb: np.ndarray  # (4,), NaN: none yet
    sigma: np.ndarray | None = None  # (3,) rad of roll, pitch, heading; None: not said


class Protocol(Interface):
    """One protocol, on one wire."""

    resolution_ns: int
    """Of the time in an answer."""

    def encode(self, reading: Reading) -> bytes:
        """Make the messages of a reading."""
        ...

    def feed(self, data: bytes) -> list[Answer]:
        """Take what has come from the unit, in pieces of any length; return the answers that are whole."""
        ...


_CLASSES = {
    "mavlink": "ahrs_sim.serve.protocols.mavlink:Mavlink",
    "vectornav": "ahrs_sim.serve.protocols.vectornav:VectorNav",
    "sbg": "ahrs_sim.serve.protocols.sbg:Sbg",
    "ubx+nmea": "ahrs_sim.serve.protocols.ublox:Ublox",
}
NAMES = tuple(_CLASSES)


def make(name: str, epoch_ns: int) -> Protocol:
    """Make a protocol.

    Args:
        name: one of `NAMES`.
        epoch_ns: zero of the flight's time, ns since 1970: messages of GNSS carry a date.

    Raises:
        InputError: an unknown protocol.
    """
    if name not in _CLASSES:
        raise InputError(f"--protocol {name}: unknown{nearest(name, NAMES)}")
    module, _, attribute = _CLASSES[name].partition(":")
    made: Protocol = getattr(importlib.import_module(module), attribute)(epoch_ns + SWITCHED_ON_NS)
    return made
