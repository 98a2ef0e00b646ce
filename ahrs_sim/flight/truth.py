"""The truth: one row per step of the flight (400 Hz by default)."""

from dataclasses import dataclass

import numpy as np

from estimators.types import Columns, column


@dataclass(frozen=True, slots=True)
class Truth(Columns):
    """Holds the true motion of the centre of gravity; all columns of a row are valid at the same instant `t`."""

    t: np.ndarray = column()  # (n,) s since the scenario's epoch
    lla: np.ndarray = column(3)  # (n, 3) geodetic latitude rad, longitude rad, ellipsoidal height m (WGS84)
    vel_n: np.ndarray = column(3)  # (n, 3) m/s relative to the Earth, NED
    q_nb: np.ndarray = column(4)  # (n, 4) body to NED, scalar first
    rate_ib_b: np.ndarray = column(3)  # (n, 3) rad/s, inertial: what a perfect gyro reads
    rate_dot_b: np.ndarray = column(3)  # (n, 3) rad/s2, its derivative
    accel_b: np.ndarray = column(3)  # (n, 3) m/s2, specific force at the centre of gravity
    cg_b: np.ndarray = column(3)  # (n, 3) m, centre of gravity in the aircraft's reference frame, FRD axes
    airspeed: np.ndarray = column()  # (n,) m/s, true
    alpha: np.ndarray = column()  # (n,) rad
    beta: np.ndarray = column()  # (n,) rad
    wind_n: np.ndarray = column(3)  # (n, 3) m/s, velocity of the air, NED, gusts and turbulence included
    pressure: np.ndarray = column()  # (n,) Pa, static
    temperature: np.ndarray = column()  # (n,) K
    rpm: np.ndarray = column()  # (n,) 1/min, of the propeller
    throttle: np.ndarray = column()  # (n,) 0..1
    height_agl: np.ndarray = column()  # (n,) m above ground
    on_ground: np.ndarray = column(dtype=bool)  # weight on any wheel


@dataclass(frozen=True, slots=True)
class Setpoints(Columns):
    """Holds commands and positions of the control surfaces: one row per pilot step (NaN: not in use)."""

    t: np.ndarray = column()  # (n,) s
    step: np.ndarray = column(dtype=np.int32)  # (n,) number of the scenario's step, from 0
    roll: np.ndarray = column()  # rad
    pitch: np.ndarray = column()  # rad
    heading: np.ndarray = column()  # rad
    altitude: np.ndarray = column()  # m
    climb_rate: np.ndarray = column()  # m/s
    airspeed: np.ndarray = column()  # m/s
    surfaces: np.ndarray = column(4)  # (n, 4) aileron, elevator, rudder (-1..1, positive: right, up, right), throttle


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth knowing that happened at `t` (s): a step begins, a fault sets in, a crash."""

    t: float
    level: str  # "info", "warning", "error"
    name: str  # who: "pilot", "fault", "flight", the estimator's name
    text: str
