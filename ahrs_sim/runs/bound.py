"""`ahrs-sim bound`: how good an attitude the sensors of a suite allow on a flight, whatever the filter.

Posterior Cramer-Rao bound (Tichavsky, Muravchik and Nehorai 1998, eq. 21): the information of the error state along the
true trajectory, with the true figures of the grade. Errors are small and their equations linear, so that the recursion
is that of a Kalman filter linearised at the truth,

    P <- F P F^T + Q,      P <- P - P H^T (H P H^T + R)^-1 H P,

and no estimator's mean square error is below P. States are the attitude (3, navigation axes), velocity, place, and of
the grade everything that is drawn once a flight or wanders: biases, in run and with temperature; full matrices of gyro,
accelerometer and magnetometer; g-sensitivity; field model and motor current's field; wander of fixes and of the dual
antenna, and its mounting. That a standing aircraft stands is known.

Left out, which makes the bound lower than what can be reached, never higher: lines of the motor's vibration, aliasing,
quantisation, non-linearity, jitter, ranges, wrong fixes, latency, mounting error. Air data are left out too, since what
they say of an attitude depends on the aircraft: an estimator that uses them may be below.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim.chain import site
from ahrs_sim.errors import FlightError, InputError, nearest
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.scenario import Scenario
from ahrs_sim.sensors import Suite, make_suite
from ahrs_sim.sensors.gnss import GnssFigures
from ahrs_sim.sensors.heading import HeadingFigures
from ahrs_sim.sensors.imu import ImuFigures
from ahrs_sim.sensors.magnetometer import MagFigures
from ahrs_sim.sensors.noise import ALLAN_FLOOR, FLICKER_SIGMA, FLICKER_TIMES
from ahrs_sim.sensors.triad import GyroFigures, InertialFigures
from ahrs_sim.sensors.vibration import MotorFigures
from ahrs_sim.world.gravity import STANDARD
from estimators.types import Site

STEP_S = 0.1
"""s of a step of the recursion; field readings are averaged over it."""

AIDS: dict[str, tuple[str, ...]] = {
    "magnetometer": ("magnetometer",),
    "magnetometer, GNSS": ("magnetometer", "gnss"),
    "magnetometer, GNSS, two antennas": ("magnetometer", "gnss", "heading"),
}
"""Sensors beside the IMU of each bound."""

PHI, VEL, POS = 0, 3, 6
MOVING = 9
STILL_SPEED = 1e-3  # m/s: slower stands


@dataclass(frozen=True)
class Bound:
    """Lower bound of the errors of any estimator, one sigma in rad over time."""

    t: np.ndarray  # (n,) s
    tilt: np.ndarray  # (n,)
    heading: np.ndarray  # (n,)

    def rms(self, low: float = -math.inf, high: float = math.inf) -> tuple[float, float]:
        """Root mean square of tilt and heading from `low` to `high` (s), rad; NaN when there is nothing between."""
        rows = (self.t >= low) & (self.t <= high)
        if not rows.any():
            return math.nan, math.nan
        return math.sqrt(np.mean(self.tilt[rows] ** 2)), math.sqrt(np.mean(self.heading[rows] ** 2))

    def as_json(self, low: float, high: float) -> dict[str, Any]:
        """Convert RMS over a span, and sigmas every second, to degrees and types that JSON knows."""
        tilt, heading = (math.degrees(x) if math.isfinite(x) else None for x in self.rms(low, high))
        thin = slice(None, None, round(1.0 / STEP_S))
        return {
            "tilt_rms_deg": tilt,
            "heading_rms_deg": heading,
            "t": self.t[thin].tolist(),
            "tilt_deg": np.degrees(self.tilt[thin]).tolist(),
            "heading_deg": np.degrees(self.heading[thin]).tolist(),
        }


@dataclass(frozen=True)
class Wanders:
    """A part of the state: prior sigma, correlation time (s; infinite: constant), walk (unit/sqrt(s))."""

    name: str
    sigma: np.ndarray
    time: float = math.inf
    walk: float | np.ndarray = 0.0


class Model:
    """Error state of a suite: where its parts are, their priors and how they decay.

    Args:
        suite: its figures.
        aids: names of `INSTRUMENTS` beside the IMU.
    """

    def __init__(self, suite: Suite, aids: Sequence[str]) -> None:
        g = suite.grade
        self.aids = [a for a in aids if a in suite.has]
        self.imu, self.motor = g.figures("imu", ImuFigures), g.figures("motor", MotorFigures)
        self.gyro, self.accel = g.figures("gyro", GyroFigures), g.figures("accelerometer", InertialFigures)
        self.mag, self.gnss = g.figures("magnetometer", MagFigures), g.figures("gnss", GnssFigures)
        self.heading = g.figures("heading", HeadingFigures)
        parts = [
            Wanders("phi", np.array([0.5, 0.5, math.pi / math.sqrt(3.0)])),
            Wanders("v", np.full(3, 30.0)),
            Wanders("p", np.full(3, 1e3)),
            *_triad("gyro", self.gyro),
            Wanders("gyro g", np.full(9, self.gyro.g_sensitivity)),
            *_triad("accel", self.accel),
        ]
        if "magnetometer" in self.aids:
            parts += [*_triad("mag", self.mag, self.mag.soft_iron)]
            parts += [Wanders("motor field", self.mag.motor_field), Wanders("field", self.mag.model_error)]
        if "gnss" in self.aids:
            time = self.gnss.wander_time
            parts += [Wanders("p wander", self.gnss.position_wander, time)]
            parts += [Wanders("v wander", self.gnss.velocity_wander, time)]
        if "heading" in self.aids:
            wander = self.heading.phase_wander / self.heading.baseline
            parts += [Wanders("azimuth", np.array([wander]), self.heading.wander_time)]
            parts += [Wanders("baseline", np.full(2, self.heading.misalignment))]
        parts = [p for p in parts if np.any(p.sigma > 0.0) or np.any(np.asarray(p.walk) > 0.0)]
        sizes = np.cumsum([0, *(len(p.sigma) for p in parts)])
        self.at = {p.name: slice(int(a), int(b)) for p, a, b in zip(parts, sizes, sizes[1:], strict=False)}
        self.n = int(sizes[-1])
        self.sigma = np.concatenate([p.sigma for p in parts])
        self.keep = np.concatenate([np.full(len(p.sigma), math.exp(-STEP_S / p.time)) for p in parts])
        walk = np.concatenate([np.broadcast_to(np.asarray(p.walk, float), p.sigma.shape) for p in parts])
        self.added = (1.0 - self.keep**2) * self.sigma**2 + walk**2 * STEP_S

    def biases(self, sensor: str) -> list[slice]:
        """Return the indices of the terms whose sum is the bias of "gyro", "accel" or "mag"."""
        return [self.at[k] for k in self.at if k.startswith(f"{sensor} bias")]


def _triad(name: str, f: Any, soft_iron: float = 0.0) -> list[Wanders]:
    """Bias terms and matrix of a triad; the fastest term of the flicker is white and the slowest a constant."""
    flicker = f.bias_floor * FLICKER_SIGMA / ALLAN_FLOOR
    beside = math.hypot(math.tan(f.misalignment), f.cross_axis, soft_iron / math.sqrt(2.0))
    matrix = np.full((3, 3), beside)
    np.fill_diagonal(matrix, np.hypot(f.scale, soft_iron))
    parts = [Wanders(f"{name} bias", np.hypot(f.turn_on_bias, flicker), walk=f.rate_random_walk)]
    parts += [Wanders(f"{name} bias {time:g} s", flicker, float(time)) for time in FLICKER_TIMES[1:-1]]
    return [*parts, Wanders(f"{name} warmth", f.temperature_drift), Wanders(f"{name} matrix", matrix.ravel())]


def _white(f: Any) -> np.ndarray:
    """Variance per second (3,) of white noise: density, and the flicker's fastest term."""
    fast = (f.bias_floor * FLICKER_SIGMA / ALLAN_FLOOR) ** 2 * 2.0 * FLICKER_TIMES[0]
    return np.asarray(f.noise_density**2 / 2.0 + fast)


class Recursion:
    """The covariance along a trajectory.

    Args:
        model: of the error state.
        place: gravity and field where the flight is.
    """

    def __init__(self, model: Model, place: Site) -> None:
        self.model, self.place = model, place
        self.P = np.diag(model.sigma**2)
        self._due = {"gnss": 0.0, "heading": 0.0}
        self._cold: float | None = None

    def step(self, truth: Truth) -> tuple[float, float]:
        """Go on by a block of `STEP_S`; return the sigmas of tilt and heading (rad) at its end."""
        C, w, f = _matrices(truth.q_nb), truth.rate_ib_b, truth.accel_b
        still = bool(np.max(np.abs(truth.vel_n)) < STILL_SPEED)
        warmth = self._warmth(truth)
        self._move(C, w, f, truth, warmth, still)
        rows, values = [], []
        for H, variance in self._measured(C[-1], w, truth, warmth, still):
            rows.append(np.atleast_2d(H))
            values.append(np.broadcast_to(variance, (len(rows[-1]),)))
        if rows:
            condition(self.P, np.vstack(rows), np.concatenate(values))
        h = _heading_slope(C[-1])
        attitude = self.P[PHI : PHI + 3, PHI : PHI + 3]
        return math.sqrt(attitude[0, 0] + attitude[1, 1]), math.sqrt(float(np.einsum("i,ij,j", h, attitude, h)))

    def _warmth(self, truth: Truth) -> float:
        m = self.model.imu
        air = float(truth.temperature[-1])
        self._cold = air if self._cold is None else self._cold
        share = -math.expm1(-float(truth.t[-1]) / m.warm_up_time) if m.warm_up_time > 0.0 else 1.0
        return share * m.warm_up + air - self._cold

    def _move(self, C: np.ndarray, w: np.ndarray, f: np.ndarray, truth: Truth, warmth: float, still: bool) -> None:
        m, dt = self.model, STEP_S
        A = np.zeros((MOVING, m.n))
        noise = np.zeros(MOVING)
        if not still:  # else attitude and velocity are known to stay
            mean = C.mean(axis=0)
            self._inertial(A[PHI : PHI + 3], "gyro", mean, np.einsum("nai,nj->aij", C, w) / len(C), warmth)
            if "gyro g" in m.at:
                A[PHI : PHI + 3, m.at["gyro g"]] = -_flat(np.einsum("nai,nj->aij", C, f) / len(C)) / STANDARD
            self._inertial(A[VEL : VEL + 3], "accel", mean, np.einsum("nai,nj->aij", C, f) / len(C), warmth)
            A[VEL : VEL + 3, PHI : PHI + 3] = -cross(np.einsum("nai,ni->a", C, f) / len(C))
            shake = self._shake(truth)
            noise[PHI : PHI + 3] = mean**2 @ (_white(m.gyro) + shake[0])
            noise[VEL : VEL + 3] = mean**2 @ (_white(m.accel) + shake[1])
        A[POS : POS + 3, VEL : VEL + 3] = np.eye(3)
        F = A * dt
        F[:, :MOVING] += A[:, :MOVING] @ A[:, :MOVING] * (0.5 * dt * dt) + np.eye(MOVING)
        F[:, MOVING:] += A[:, :MOVING] @ A[:, MOVING:] * (0.5 * dt * dt)
        P = self.P
        top = F @ P
        P[:MOVING, :MOVING] = top @ F.T
        P[:MOVING, MOVING:] = top[:, MOVING:]
        P *= m.keep[None, :] * m.keep[:, None]
        P[MOVING:, :MOVING] = P[:MOVING, MOVING:].T
        P[np.diag_indices(m.n)] += m.added
        P[np.diag_indices(MOVING)] += noise * dt

    def _inertial(self, out: np.ndarray, sensor: str, C: np.ndarray, outer: np.ndarray, warmth: float) -> None:
        """Slopes (3, n) of rate or force error in navigation axes: -C_nb (b + E u)."""
        for at in self.model.biases(sensor):
            out[:, at] = -C
        if f"{sensor} warmth" in self.model.at:
            out[:, self.model.at[f"{sensor} warmth"]] = -C * warmth
        if f"{sensor} matrix" in self.model.at:
            out[:, self.model.at[f"{sensor} matrix"]] = -_flat(outer)

    def _shake(self, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
        """Variance per second of gyro and accelerometer by the motor's band of noise."""
        m = self.model
        speed = float(np.mean(truth.rpm)) / m.motor.reference
        level = max(speed * speed, m.motor.idle) if speed > 0.0 else 0.0
        share = level * level / m.imu.rate
        return m.gyro.vibration_band**2 * share, m.accel.vibration_band**2 * share

    def _measured(
        self, C: np.ndarray, w: np.ndarray, truth: Truth, warmth: float, still: bool
    ) -> Iterator[tuple[np.ndarray, Any]]:
        """Collect slopes and variances of what is measured in a step."""
        m = self.model
        if still:
            yield from self._standing(C, truth, warmth)
        if "magnetometer" in m.aids:
            yield self._field(C, float(np.mean(np.nan_to_num(truth.throttle)))), self._field_variance()
        if "gnss" in m.aids and self._is_due("gnss", m.gnss.rate, truth):
            yield from self._fix(C, w[-1])
        if "heading" in m.aids and self._is_due("heading", m.heading.rate, truth):
            north, east = C[0, 0], C[1, 0]
            level2 = north * north + east * east
            if level2 > 0.03:
                H = np.zeros(m.n)
                H[PHI : PHI + 3] = _heading_slope(C)
                if "azimuth" in m.at:
                    H[m.at["azimuth"]] = 1.0
                if "baseline" in m.at:  # yaw and pitch of its mounting
                    H[m.at["baseline"]] = (north * C[1, 1:] - east * C[0, 1:]) / level2 * (1.0, -1.0)
                yield H, (m.heading.phase_noise / m.heading.baseline) ** 2

    def _is_due(self, name: str, rate: float, truth: Truth) -> bool:
        due = bool(truth.t[-1] >= self._due[name] - 1e-9)
        if due:
            self._due[name] += 1.0 / rate
        return due

    def _standing(self, C: np.ndarray, truth: Truth, warmth: float) -> Iterator[tuple[np.ndarray, Any]]:
        """No velocity; gyro and accelerometer read their errors, and the attitude against gravity."""
        m = self.model
        H = np.zeros((3, m.n))
        H[:, VEL : VEL + 3] = np.eye(3)
        yield H, 1e-4**2
        shake = self._shake(truth)
        for k, (name, figures) in enumerate((("gyro", m.gyro), ("accel", m.accel))):
            H = np.zeros((3, m.n))
            force = C.T @ np.array([0.0, 0.0, -self.place.gravity])
            rate = np.zeros(3)
            self._inertial(H, name, -np.eye(3), -_outer(np.eye(3), rate if k == 0 else force), warmth)
            if k == 0 and "gyro g" in m.at:
                H[:, m.at["gyro g"]] = _flat(_outer(np.eye(3), force)) / STANDARD
            if k == 1:  # f = C_bn exp(-phi) (-g)
                H[:, PHI : PHI + 3] = C.T @ cross(np.array([0.0, 0.0, -self.place.gravity]))
            variance = (_white(figures) + shake[k]) / STEP_S
            yield H, np.maximum(variance, 1e-20)

    def _field(self, C: np.ndarray, throttle: float) -> np.ndarray:
        """Slopes (3, n) of the field in body axes: (I + M) C_bn exp(-phi) (B + dB) + h + throttle m."""
        m, B = self.model, np.array(self.place.mag_n)
        H = np.zeros((3, m.n))
        H[:, PHI : PHI + 3] = C.T @ cross(B)
        for at in m.biases("mag"):
            H[:, at] = np.eye(3)
        if "mag matrix" in m.at:
            H[:, m.at["mag matrix"]] = _flat(_outer(np.eye(3), C.T @ B))
        if "motor field" in m.at:
            H[:, m.at["motor field"]] = throttle * np.eye(3)
        if "field" in m.at:
            H[:, m.at["field"]] = C.T
        return H

    def _field_variance(self) -> np.ndarray:
        """Compute the variance (3,) of the mean of a step's readings."""
        return np.maximum(_white(self.model.mag) / STEP_S, 1e-22)

    def _fix(self, C: np.ndarray, w: np.ndarray) -> Iterator[tuple[np.ndarray, Any]]:
        """Velocity and place of the antenna, r from the IMU: v + C (w x r)."""
        m, f = self.model, self.model.gnss
        for at, arm, name, noise in (
            (VEL, C @ np.cross(w, f.antenna), "v wander", f.velocity_noise),
            (POS, C @ f.antenna, "p wander", f.position_noise),
        ):
            H = np.zeros((3, m.n))
            H[:, at : at + 3] = np.eye(3)
            H[:, PHI : PHI + 3] = -cross(arm)
            if name in m.at:
                H[:, m.at[name]] = np.eye(3)
            yield H, np.maximum(noise**2, 1e-12)


def condition(P: np.ndarray, H: np.ndarray, variance: np.ndarray) -> None:
    """Condition a covariance P (n, n) on measurements of slopes H (m, n) and `variance` (m,), in place; symmetric."""
    gain = P @ H.T
    S = H @ gain
    S[np.diag_indices(len(S))] += variance
    P -= gain @ np.linalg.solve(S, gain.T)
    P[:] = 0.5 * (P + P.T)


def cross(v: np.ndarray) -> np.ndarray:
    """Make the matrix (3, 3) of the cross product: `cross(v) @ x = v x x`."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _outer(C: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.asarray(C[:, :, None] * u)


def _flat(outer: np.ndarray) -> np.ndarray:
    """(3, 3, 3) of navigation axis, row and column of a matrix to (3, 9)."""
    return outer.reshape(3, 9)


def _heading_slope(C: np.ndarray) -> np.ndarray:
    """Return the slope of heading by a rotation about navigation axes, for the forward axis of C_nb."""
    level2 = max(C[0, 0] ** 2 + C[1, 0] ** 2, 1e-6)
    return np.array([-C[2, 0] * C[0, 0] / level2, -C[2, 0] * C[1, 0] / level2, 1.0])


def _matrices(q: np.ndarray) -> np.ndarray:
    """C_nb (n, 3, 3)."""
    a, b, c, d = q.T
    rows = [
        [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def along(blocks: Iterator[Truth], suite: Suite, aids: Mapping[str, Sequence[str]], place: Site) -> dict[str, Bound]:
    """Compute the bounds by name of `aids` along a trajectory that comes in blocks of `STEP_S`."""
    recursions = {name: Recursion(Model(suite, sensors), place) for name, sensors in aids.items()}
    times: list[float] = []
    sigmas: dict[str, list[tuple[float, float]]] = {name: [] for name in aids}
    for truth in blocks:
        times.append(float(truth.t[-1]))
        for name, recursion in recursions.items():
            sigmas[name].append(recursion.step(truth))
    t = np.array(times)
    return {name: Bound(t, *np.array(s).reshape(-1, 2).T) for name, s in sigmas.items()}


def make(
    scenario: Scenario,
    suite: str,
    *,
    aids: Mapping[str, Sequence[str]] | None = None,
    progress: Callable[[float, float | None], None] = lambda t, end: None,
) -> dict[str, Bound]:
    """Compute the bounds of a suite on a flight of a scenario.

    Args:
        scenario: what to fly.
        suite: one of its suites.
        aids: sensors beside the IMU, by the name of a bound; default: those of `AIDS` that the suite has.
        progress: called with the time reached and the expected end (None: unknown), s.

    Raises:
        InputError: no such suite.
        FlightError: the flight did not reach its end.
    """
    known = {s.name: s for s in scenario.suites}
    if suite not in known:
        raise InputError(f"bound: --suite {suite}: no such suite in {scenario.name}{nearest(suite, known)}")
    flight = open_flight(scenario)
    place = site(flight.start_lla, scenario.epoch)
    made = make_suite(known[suite], seed=scenario.seed, dt=flight.dt, epoch=scenario.epoch,
                      start_lla=np.array(place.lla))  # fmt: skip
    chosen = aids or {name: s for name, s in AIDS.items() if all(i in made.has for i in s)} or {"IMU alone": ()}
    rows = max(1, round(STEP_S / flight.dt))

    def blocks() -> Iterator[Truth]:
        while len(truth := flight.fly(100 * rows)):
            for k in range(0, len(truth) - rows + 1, rows):
                yield truth[k : k + rows]
            progress(float(truth.t[-1]), scenario.duration or flight.expected_duration)

    found = along(blocks(), made, chosen, place)
    if flight.error:
        raise FlightError(f"{scenario.where}: {flight.error}")
    return found


def table(bounds: Mapping[str, Bound], low: float, high: float) -> str:
    """Format RMS and end of every bound for a reader, deg."""
    width = max(*map(len, bounds), 20) + 2
    lines = [f"{'deg, beside the IMU':{width}s}{'RMS tilt  heading':>20s}{'at the end':>20s}"]
    for name, bound in bounds.items():
        tilt, heading = np.degrees(bound.rms(low, high))
        last = np.degrees([bound.tilt[-1], bound.heading[-1]]) if len(bound.t) else [math.nan, math.nan]
        lines.append(f"{name:{width}s}{tilt:11.3f}{heading:9.3f}{last[0]:11.3f}{last[1]:9.3f}")
    return "\n".join(lines)
