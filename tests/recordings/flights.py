"""A flight whose truth is known in closed form, measured by sensors with known faults: as a survey, without a file."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.recordings import survey
from ahrs_sim.recordings.survey import Survey
from ahrs_sim.sensors.records import (
    AirRecord,
    FixRecord,
    ImuRecord,
    MagRecord,
    SuiteBlock,
    VelocityRecord,
)
from ahrs_sim.world import wgs84
from ahrs_sim.world.gravity import STANDARD as G
from estimators.types import blank

FIELD_N = np.array([2.35e-5, 0.12e-5, 4.0e-5])
LLA = np.array([np.radians(43.57), np.radians(1.47), 150.0])


@dataclass
class Planted:
    """What is wrong with the sensors."""

    gnss_delay: float = 0.0  # s
    mag_delay: float = 0.0
    air_delay: float = 0.0
    lever_b: np.ndarray = field(default_factory=lambda: np.zeros(3))  # m
    boresight: np.ndarray = field(default_factory=lambda: np.eye(3))  # IMU axes to those of the aircraft
    mag_axes: np.ndarray = field(default_factory=lambda: np.eye(3))  # takes readings to the IMU's axes
    hard_iron: np.ndarray = field(default_factory=lambda: np.zeros(3))  # T
    air_scale: float = 1.0  # true airspeed is this times the reading
    gyro_bias: np.ndarray = field(default_factory=lambda: np.radians([0.3, -0.2, 0.1]))
    gyro: np.ndarray = field(default_factory=lambda: np.eye(3))  # multiplies what is read
    accel: np.ndarray = field(default_factory=lambda: np.eye(3))
    accel_bias: np.ndarray = field(default_factory=lambda: np.array([0.05, -0.03, 0.08]))


def soft(t: np.ndarray, at: float, over: float) -> np.ndarray:
    """A step from 0 to 1."""
    x = np.clip((t - at) / over, 0.0, 1.0)
    step: np.ndarray = x * x * x * (10 - 15 * x + 6 * x * x)
    return step


@dataclass(frozen=True)
class Path:
    """Courses, speeds and climbs of a flight in still air or in wind, from one seed; `circles`: nothing but a turn."""

    seed: int = 0
    circles: bool = False
    wind_n: tuple[float, float] = (4.0, -3.0)

    def air(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Heading (rad), true airspeed (m/s) and climb (m/s)."""
        if self.circles:
            return np.radians(12.0) * t, np.full_like(t, 25.0), np.zeros_like(t)
        rng = np.random.default_rng(self.seed)
        heading, speed, climb = np.full_like(t, rng.uniform(0, 6.28)), np.full_like(t, 25.0), np.zeros_like(t)
        at = 3.0
        while at < t[-1]:
            over = rng.uniform(4.0, 12.0)
            kind = rng.integers(4)
            if kind < 2:
                heading = heading + rng.choice([-1, 1]) * rng.uniform(0.5, 2.5) * soft(t, at, over)
            elif kind == 2:
                change = rng.uniform(3.0, 8.0) * (1 if speed[-1] < 25.0 else -1)
                speed = speed + change * soft(t, at, over)
            else:
                climb = climb + (rng.uniform(-3.0, 3.0) - climb[-1]) * soft(t, at, over)
            at += over + rng.uniform(1.0, 10.0)
        return heading, speed, climb

    def vel_n(self, t: np.ndarray) -> np.ndarray:
        """Velocity (n, 3) m/s over ground."""
        heading, speed, climb = self.air(t)
        level = np.sqrt(np.maximum(speed**2 - climb**2, 1.0))
        wind = np.array([*self.wind_n, 0.0])
        velocity: np.ndarray = np.column_stack([level * np.cos(heading), level * np.sin(heading), -climb]) + wind
        return velocity

    def q_nb(self, t: np.ndarray) -> np.ndarray:
        """Attitude (n, 4) of coordinated flight at two degrees of incidence."""
        heading, speed, climb = self.air(t)
        h = 1e-3
        turn = (self.air(t + h)[0] - self.air(t - h)[0]) / (2 * h)
        bank = np.arctan(speed * turn / G)
        pitch = np.arcsin(climb / speed) + np.radians(2.0) * np.cos(bank)
        return attitude.from_euler(np.column_stack([bank, pitch, heading]))


def measured(
    path: Path,
    planted: Planted,
    *,
    duration: float = 240.0,
    seed: int = 1,
    rate: float = 100.0,
    gnss: float = 5.0,
    noise: float = 1.0,
) -> SuiteBlock:
    """Records of IMU, magnetometer, GNSS and airspeed."""  # fmt: skip
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * rate)) / rate
    q, h = path.q_nb(t), 1e-4
    back = q * [1, -1, -1, -1]
    after, before = path.q_nb(t + h), path.q_nb(t - h)
    step = attitude.product(before * [1, -1, -1, -1], after)
    gyro = 2 * step[:, 1:] * np.sign(step[:, :1]) / (2 * h)
    acceleration = (path.vel_n(t + 1e-2) - path.vel_n(t - 1e-2)) / 2e-2
    accel = attitude.to_nav(back, acceleration - [0.0, 0.0, G])
    to_imu = planted.boresight.T
    gyro = gyro @ to_imu.T + planted.gyro_bias + noise * rng.normal(0, 2e-3, gyro.shape)
    accel = accel @ to_imu.T + planted.accel_bias + noise * rng.normal(0, 5e-2, accel.shape)
    at = t - planted.mag_delay
    mag = attitude.to_nav(path.q_nb(at) * [1, -1, -1, -1], np.tile(FIELD_N, (len(t), 1))) @ to_imu.T
    mag = mag @ planted.mag_axes + planted.hard_iron + noise * rng.normal(0, 3e-7, mag.shape)  # axes.T @ m, as rows
    tg = np.arange(round(duration * gnss)) / gnss + 0.013
    at = tg - planted.gnss_delay
    rate_b = attitude.product(path.q_nb(at - h) * [1, -1, -1, -1], path.q_nb(at + h))
    rate_b = 2 * rate_b[:, 1:] * np.sign(rate_b[:, :1]) / (2 * h)
    arm = planted.boresight @ planted.lever_b
    velocity = path.vel_n(at) + attitude.to_nav(path.q_nb(at), np.cross(rate_b, arm))
    velocity += noise * (rng.normal(0, 0.05, velocity.shape) + _wander(rng, tg, 0.05, 10.0))
    fine = np.arange(-1.0, duration, 0.01)
    way = np.cumsum(path.vel_n(fine + 0.005), axis=0) * 0.01
    moved = np.column_stack([np.interp(at, fine + 0.01, column) for column in way.T])
    meridian, prime = (float(r) for r in wgs84.radii(np.array(LLA[0])))
    north, east = moved[:, 0] / meridian, moved[:, 1] / (prime * np.cos(LLA[0]))
    lla = np.column_stack([np.degrees(LLA[0] + north), np.degrees(LLA[1] + east), LLA[2] - moved[:, 2]])
    ta = np.arange(round(duration * 10)) / 10 + 0.007
    airspeed = path.air(ta - planted.air_delay)[1] / planted.air_scale + noise * rng.normal(0, 0.3, len(ta))
    return {
        "imu": records(ImuRecord, t, gyro_b=gyro @ planted.gyro.T, accel_b=accel @ planted.accel.T),
        "mag": records(MagRecord, t, mag_b=mag),
        "velocity": records(VelocityRecord, tg, vel_n=velocity),
        "fix": records(FixRecord, tg, lla_deg=lla),
        "air": records(AirRecord, ta, airspeed=airspeed),
    }


def _wander(rng: np.random.Generator, t: np.ndarray, sigma: float, seconds: float) -> np.ndarray:
    """First-order Gauss-Markov errors (n, 3)."""
    keep = np.exp(-np.diff(t, prepend=t[0]) / seconds)
    out = np.empty((len(t), 3))
    state = rng.normal(0, sigma, 3)
    for i, k in enumerate(keep):
        state = k * state + sigma * np.sqrt(1 - k * k) * rng.normal(0, 1, 3)
        out[i] = state
    return out


def records(cls: Any, t: np.ndarray, **columns: np.ndarray) -> Any:
    made = blank(cls, len(t))
    made.update(columns)
    made["stamp_ns"] = made["arrival_ns"] = np.rint(t * 1e9).astype(np.int64)
    return cls(**made)


def flown(path: Path | None = None, planted: Planted | None = None, **options: Any) -> Survey:
    """The survey of a flight."""
    return survey.look([measured(path or Path(), planted or Planted(), **options)])
