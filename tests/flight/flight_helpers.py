"""Flying scenarios in tests, and dead reckoning to check a truth against itself."""

from typing import Any

import numpy as np

from ahrs_sim import scenario
from ahrs_sim.flight import Event, Setpoints, Truth, open_flight
from ahrs_sim.world import wgs84

AIR = {"on_ground": False, "height_m": 120.0, "airspeed_mps": 20.0, "heading_deg": 320.0}


def make(**data: Any) -> scenario.Scenario:
    return scenario.parse(data, "test.toml", "test")


def airborne(*steps: dict[str, Any], **data: Any) -> scenario.Scenario:
    return make(**{"start": AIR, "step": list(steps), **data})


class Flown:
    """A whole flight in memory."""

    def __init__(self, what: scenario.Scenario, block: int = 2000) -> None:
        self.flight = open_flight(what)
        blocks, setpoints, self.events = [], [], list[Event]()
        while True:
            rows = self.flight.fly(block)
            setpoints.append(self.flight.take_setpoints())
            self.events += self.flight.take_events()
            if len(rows) == 0:
                break
            blocks.append(rows)
        self.truth = Truth.concatenate(blocks)
        self.setpoints = Setpoints.concatenate(setpoints)
        self.error = self.flight.error
        self.roll, self.pitch, self.heading = euler_deg(self.truth.q_nb)

    def during(self, step: int) -> slice:
        """The rows of a step, numbered from 1."""
        times = {e.text: e.t for e in self.events if e.name == "pilot"}
        begin = next(t for text, t in times.items() if text.startswith(f"step {step} ") and text.endswith("begins"))
        end = next(t for text, t in times.items() if text.startswith(f"step {step} ") and text.endswith("ends"))
        return slice(int(np.searchsorted(self.truth.t, begin)), int(np.searchsorted(self.truth.t, end)) + 1)


def euler_deg(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    a, b, c, d = q.T
    roll = np.arctan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c))
    pitch = np.arcsin(np.clip(2 * (a * c - b * d), -1, 1))
    heading = np.arctan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d))
    return np.degrees(roll), np.degrees(pitch), np.degrees(heading)


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton products of rows."""
    v = p[:, :1] * q[:, 1:] + q[:, :1] * p[:, 1:] + np.cross(p[:, 1:], q[:, 1:])
    return np.column_stack([p[:, 0] * q[:, 0] - np.sum(p[:, 1:] * q[:, 1:], axis=1), v])


def running_product(q: np.ndarray, *, on_the_left: bool) -> np.ndarray:
    """q0, q0 q1, q0 q1 q2 ... (or the other way round) by doubling."""
    out, step = q.copy(), 1
    while step < len(out):
        a, b = out[:-step], out[step:]
        out = np.concatenate([out[:step], product(b, a) if on_the_left else product(a, b)])
        step *= 2
    return out


def small_rotations(angle: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    return np.column_stack([np.cos(0.5 * size), 0.5 * np.sinc(0.5 * size / np.pi) * angle])


def to_ned(q_nb: np.ndarray, vector_b: np.ndarray) -> np.ndarray:
    twice = 2.0 * np.cross(q_nb[:, 1:], vector_b)
    return vector_b + q_nb[:, :1] * twice + np.cross(q_nb[:, 1:], twice)


def attitude_residual_deg(truth: Truth) -> np.ndarray:
    """How far the integrated gyro is from the attitude, (n - 1,) deg.

    The gyro in body axes, the rotation of Earth and local level in navigation axes; trapezium with the coning term.
    """
    dt = np.diff(truth.t)[:, None]
    w = truth.rate_ib_b
    body = 0.5 * (w[1:] + w[:-1]) * dt + dt**2 / 12.0 * np.cross(w[:-1], w[1:])
    frame = wgs84.earth_rate_n(truth.lla[:, 0]) + wgs84.transport_rate_n(truth.lla, truth.vel_n)
    level = -0.5 * (frame[1:] + frame[:-1]) * dt
    left = running_product(small_rotations(level), on_the_left=True)
    right = running_product(small_rotations(body), on_the_left=False)
    start = np.broadcast_to(truth.q_nb[:1], left.shape)
    found = product(product(left, start), right)
    off = product(found * [1.0, -1.0, -1.0, -1.0], truth.q_nb[1:])
    return np.degrees(2.0 * np.linalg.norm(off[:, 1:], axis=1))


def velocity_residual(truth: Truth, gravity_n: np.ndarray) -> np.ndarray:
    """How far integrated specific force and `gravity_n` (n, 3) are from the velocity, (n, 3) m/s."""
    earth = wgs84.earth_rate_n(truth.lla[:, 0])
    frame = earth + wgs84.transport_rate_n(truth.lla, truth.vel_n)
    accel = to_ned(truth.q_nb, truth.accel_b) + gravity_n - np.cross(earth + frame, truth.vel_n)
    dt = np.diff(truth.t)[:, None]
    gained = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (accel[1:] + accel[:-1]) * dt, axis=0)])
    return truth.vel_n[0] + gained - truth.vel_n


def position_residual(truth: Truth) -> np.ndarray:
    """How far the integrated velocity is from the position, (n, 3) m."""
    rate = wgs84.lla_rate(truth.lla, truth.vel_n)
    dt = np.diff(truth.t)[:, None]
    moved = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * dt, axis=0)])
    off = truth.lla[0] + moved - truth.lla
    meridian, prime = wgs84.radii(truth.lla[:, 0])
    return off * np.column_stack([meridian, prime * np.cos(truth.lla[:, 0]), np.ones(len(off))])
