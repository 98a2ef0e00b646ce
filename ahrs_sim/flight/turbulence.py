"""Rough air by height above the ground: Dryden turbulence of MIL-F-8785C, and wind that grows with height.

JSBSim has the same turbulence model but takes its height above sea level, which makes gusts at 1500 m of elevation
five times too strong, and its wind is the same at every height. Here both depend on the height above the ground and
reach JSBSim through `atmosphere/gust-*`.

Along the path u, across it v, down w. With tau = L / V and unit white noise n (MIL-F-8785C, 3.7.1.2; MIL-HDBK-1797
writes 2 L for the L of v and w and means the same):

    u = sigma_u sqrt(2 tau) / (1 + tau s) n             v, w = sigma sqrt(tau) (1 + sqrt(3) tau s) / (1 + tau s)^2 n

The filters are discretised exactly, with states of variance one, so that height and speed may change on the way.
The rates at which the gusts turn the air about the aircraft (3.7.5) follow from frozen turbulence, by which the air
itself would turn with p = dw/dy, q = -dw/dx, r = dv/dx; only our own aircraft takes them (`gust/*-rad_sec`).
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ahrs_sim.flight.fdm import Fdm
from ahrs_sim.jit import njit
from ahrs_sim.scenario import Wind, seeds
from ahrs_sim.scenario.scenario import TURBULENCE

FT = 0.3048  # m
LOWEST = 10.0 * FT  # m, below which the standard says nothing
LOW, HIGH = 1000.0 * FT, 2000.0 * FT  # m, end of the low-altitude model, beginning of the high-altitude one
HIGH_SCALE = 1750.0 * FT  # m, L above HIGH (3.7.2.1)
REFERENCE = 20.0 * FT  # m, height of the wind that a scenario states, where it has a gradient
GRADIENT_FROM = 3.0 * FT  # m, lowest height of the wind's logarithm (3.7.3.2)
TURN = 1.0  # rad/s, at most, with which the axes of u and v follow the path, lest a loop reverses the wind at once
SLOWEST = 0.1  # m/s: a calm that drifts past an aircraft at rest

_ALTITUDES = 100.0 * FT * np.array([5.0, 17.5, 37.5, 75.0, 150.0, 250.0, 350.0, 450.0, 550.0, 650.0, 750.0, 800.0])
_INTENSITY = {  # RMS in ft/s that is exceeded with a probability of 1e-2, 1e-3, 1e-5 (figure 7)
    "light": (6.6, 6.9, 7.4, 6.7, 4.6, 2.7, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0),
    "moderate": (8.6, 9.6, 10.6, 10.1, 8.0, 6.6, 5.0, 4.2, 2.7, 0.0, 0.0, 0.0),
    "severe": (15.6, 17.6, 23.0, 23.6, 22.1, 20.0, 16.0, 15.1, 12.1, 7.9, 6.2, 5.1),
}
LOOKS = 2  # calls of `ahead` for which one of them does the work
_CHUNK = 500  # calls of `ahead` for which noise is drawn at once


class Dryden(NamedTuple):
    """Scale lengths (m) and intensities (m/s RMS) at one height; those of v are those of u."""

    length_u: float
    length_w: float
    sigma_u: float
    sigma_w: float


def dryden(height: float, wind: Wind) -> Dryden:
    """Scale lengths and intensities at `height` (m above the ground): MIL-F-8785C, figures 10, 11 and 7.

    Figure 7 has three severities; a wind that is not its severity's (`at_20ft_mps`) scales it, as it scales the gusts
    below. Below 10 ft lengths and horizontal gusts stay; vertical ones fade, as no wind blows out of the ground.
    """
    h = max(height, LOWEST)
    low = min(h, LOW) / FT
    stretch = 0.177 + 0.000823 * low
    sigma_w = 0.1 * wind.at_20ft
    sigma_u = sigma_w / stretch**0.4
    length_u, length_w = low * FT / stretch**1.2, low * FT
    if h > LOW:
        part = min(1.0, (h - LOW) / (HIGH - LOW))
        nominal = TURBULENCE[wind.turbulence]
        above = FT * float(np.interp(max(h, HIGH), _ALTITUDES, _INTENSITY[wind.turbulence])) * wind.at_20ft / nominal
        sigma_u, sigma_w = sigma_u + part * (above - sigma_u), sigma_w + part * (above - sigma_w)
        length_u, length_w = (length + part * (HIGH_SCALE - length) for length in (length_u, length_w))
    return Dryden(length_u, length_w, sigma_u, sigma_w * min(1.0, max(0.0, height) / LOWEST))


def gradient(height: float, roughness: float) -> float:
    """Wind at `height` (m above the ground) over that at 20 ft (MIL-F-8785C, 3.7.3.2); one without roughness (m).

    The logarithm holds from 3 to 1000 ft; the wind stays what it is at these ends.
    """
    if roughness == 0.0:
        return 1.0
    return math.log(min(max(height, GRADIENT_FROM), LOW) / roughness) / math.log(REFERENCE / roughness)


class RoughAir:
    """The air of one flight: set ahead for some steps, then blown step by step.

    Args:
        fdm: the aircraft, loaded.
        wind: what the scenario says.
        seed: of the flight.
        steps: steps of JSBSim's between two calls of `ahead`.
    """

    def __init__(self, fdm: Fdm, wind: Wind, seed: int, steps: int) -> None:
        self._wind, self._steps, self._dt = wind, LOOKS * steps, fdm.dt
        self._mean = -wind.speed * math.cos(wind.from_), -wind.speed * math.sin(wind.from_)
        self._random = seeds.generator(seed, "wind", "turbulence")
        self._noise = np.empty((0, 6))
        self._state = first_state(self._random.standard_normal(6))
        self._before: np.ndarray | None = None
        self._span = fdm["metrics/bw-ft"] * FT
        self._put_u, self._put_v, self._put_w = (
            fdm.setter(f"atmosphere/gust-{axis}-fps") for axis in ("north", "east", "down")
        )
        self._put_p, self._put_q, self._put_r = (
            fdm.setter(f"gust/{axis}-rad_sec") if fdm.has(f"gust/{axis}-rad_sec") else _nobody for axis in "pqr"
        )
        self._gusts: Iterator[Sequence[float]] = iter(())
        self._rates: Iterator[Sequence[float]] = iter(())
        self._turn = False  # whether the next step sets rates
        self._looks = 0

    @staticmethod
    def wanted(wind: Wind) -> bool:
        """Test whether this wind changes apart from its single gusts."""
        return wind.turbulence != "none" or (wind.roughness > 0.0 and wind.speed > 0.0)

    def ahead(self, height: float, velocity_n: Sequence[float], euler: Sequence[float]) -> None:
        """Work out the air of the next steps, at every other call.

        Args:
            height: m above the ground.
            velocity_n: (3,) m/s over the ground.
            euler: (3,) rad, roll, pitch, heading.
        """
        self._looks += 1
        if self._looks % LOOKS != 1:
            return
        wind = self._wind
        north, east, down = velocity_n[0] - self._mean[0], velocity_n[1] - self._mean[1], velocity_n[2]
        grown = gradient(height, wind.roughness) - 1.0
        model = dryden(height, wind)
        course = math.atan2(east, north)
        if self._before is not None:
            last = float(self._before[4])
            limit = TURN * self._steps * self._dt
            off = (course - last + math.pi) % (2.0 * math.pi) - math.pi
            course = last + max(-limit, min(limit, off))
        now = np.array([grown * self._mean[0], grown * self._mean[1], model.sigma_u, model.sigma_w, course])
        before = now if self._before is None else self._before
        speed = max(SLOWEST, math.sqrt(north * north + east * east + down * down))
        air = blow(
            self._state, self._drawn(), before, now, model.length_u, model.length_w, speed, self._span, self._dt,
            euler[0], euler[1], euler[2],
        )  # fmt: skip
        self._before = now
        self._gusts, self._rates = iter(air[::2, :3].tolist()), iter(air[1::2, 3:].tolist())
        self._turn = False

    def step(self) -> None:
        """Hand the air of the next step to JSBSim: gusts and rates in turn, as a setter costs a fiftieth of a step."""
        if self._turn:
            p, q, r = next(self._rates)
            self._put_p(p)
            self._put_q(q)
            self._put_r(r)
        else:
            u, v, w = next(self._gusts)
            self._put_u(u)
            self._put_v(v)
            self._put_w(w)
        self._turn = not self._turn

    def _drawn(self) -> np.ndarray:
        if len(self._noise) == 0:
            self._noise = self._random.standard_normal((_CHUNK * self._steps, 6))
        drawn, self._noise = self._noise[: self._steps], self._noise[self._steps :]
        return drawn


def _nobody(value: float) -> None:
    """Take the rates of an aircraft that does not: those of JSBSim's library."""


def first_state(noise: np.ndarray) -> np.ndarray:
    """Draw a stationary state of the filters (8,) from standard normal noise (6,).

    u; two of v; two of w; p; lags of w and v for q and r.
    """
    root = math.sqrt(0.5)
    state = np.array([noise[0], root * noise[1], 0.0, root * noise[3], 0.0, noise[5], 0.0, 0.0])
    for k, other in ((1, noise[2]), (3, noise[4])):  # covariance 1/2, 1/4; 1/4, 1/4
        state[k + 1] = 0.5 * state[k] + math.sqrt(0.125) * other
    state[6] = _second(state[3], state[4])
    state[7] = _second(state[1], state[2])
    return state


@njit
def _second(first: float, second: float) -> float:
    """Unit output of the second-order filter: (1 + sqrt(3) tau s) / (1 + tau s)^2 in partial fractions."""
    return 1.7320508075688772 * first - 0.7320508075688772 * second


@njit
def _noise_roots(k: float) -> tuple[float, float, float]:
    """Cholesky factor (11, 21, 22) of what noise adds to the two states in k = dt / tau."""
    if k < 1e-3:  # the closed form cancels
        q11, q12, q22 = k * (1.0 - k), 0.5 * k * k * (1.0 - 4.0 / 3.0 * k), k**3 / 3.0 * (1.0 - 1.5 * k)
    else:
        e = math.exp(-2.0 * k)
        q11 = 0.5 * (1.0 - e)
        q12 = 0.25 * (1.0 - e * (1.0 + 2.0 * k))
        q22 = 0.25 * (1.0 - e * (1.0 + 2.0 * k + 2.0 * k * k))
    a = math.sqrt(q11)
    b = q12 / a
    return a, b, math.sqrt(q22 - b * b)


@njit
def blow(
    state: np.ndarray,
    noise: np.ndarray,
    before: np.ndarray,
    now: np.ndarray,
    length_u: float,
    length_w: float,
    speed: float,
    span: float,
    dt: float,
    roll: float,
    pitch: float,
    heading: float,
) -> np.ndarray:
    """Move the filters on by the rows of `noise` (n, 6).

    Args:
        state: (8,), see `first_state`; changed.
        before, now: (5,) what the gusts are laid on and multiplied with, at the beginning and the end: wind north, east
            (m/s) to be added, sigma_u, sigma_w (m/s), course of the axis of u (rad).
        speed: m/s through the air.
        span: m, of the wing.

    Returns:
        (n, 6): gust north, east, down in ft/s, and the air's rates of turn about the body axes in rad/s.
    """
    k_u, k_w = speed * dt / length_u, speed * dt / length_w
    e_u, e_w = math.exp(-k_u), math.exp(-k_w)
    root_u = math.sqrt(-math.expm1(-2.0 * k_u))
    v11, v21, v22 = _noise_roots(k_u)
    w11, w21, w22 = _noise_roots(k_w)
    reach_q, reach_r = 4.0 * span / math.pi, 3.0 * span / math.pi  # m
    # integral of sigma_w^2 / L 0.8 (pi L / 4 b)^(1/3) / (1 + (reach omega / V)^2)
    sigma_p = math.sqrt(0.8 * (math.pi * length_w / (4.0 * span)) ** (1.0 / 3.0) / length_w * 0.5 * math.pi / reach_q)
    e_p = math.exp(-speed * dt / reach_q)
    e_r = math.exp(-speed * dt / reach_r)
    root_p = math.sqrt(1.0 - e_p * e_p)
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    out = np.empty((len(noise), 6))
    for i in range(len(noise)):
        n = noise[i]
        v_last, w_last = _second(state[1], state[2]), _second(state[3], state[4])
        state[0] = e_u * state[0] + root_u * n[0]
        state[2] = e_u * (state[2] + k_u * state[1]) + v21 * n[1] + v22 * n[2]
        state[1] = e_u * state[1] + v11 * n[1]
        state[4] = e_w * (state[4] + k_w * state[3]) + w21 * n[3] + w22 * n[4]
        state[3] = e_w * state[3] + w11 * n[3]
        state[5] = e_p * state[5] + root_p * n[5]
        v, w = _second(state[1], state[2]), _second(state[3], state[4])
        state[6] = e_p * state[6] + (1.0 - e_p) * 0.5 * (w + w_last)
        state[7] = e_r * state[7] + (1.0 - e_r) * 0.5 * (v + v_last)
        part = (i + 1.0) / len(noise)
        sigma_u = before[2] + part * (now[2] - before[2])
        sigma_w = before[3] + part * (now[3] - before[3])
        course = before[4] + part * (now[4] - before[4])
        c, s = math.cos(course), math.sin(course)
        u, v_u = sigma_u * state[0], sigma_u * v
        out[i, 0] = (before[0] + part * (now[0] - before[0]) + c * u - s * v_u) / FT
        out[i, 1] = (before[1] + part * (now[1] - before[1]) + s * u + c * v_u) / FT
        out[i, 2] = sigma_w * w / FT
        # along the course, across it, down; then into body axes
        p, q, r = sigma_w * sigma_p * state[5], -sigma_w * (w - state[6]) / reach_q, sigma_u * (v - state[7]) / reach_r
        c, s = math.cos(heading - course), math.sin(heading - course)
        ahead, right = c * p + s * q, c * q - s * p
        out[i, 3] = cp * ahead - sp * r
        out[i, 4] = sr * (sp * ahead + cp * r) + cr * right
        out[i, 5] = cr * (sp * ahead + cp * r) - sr * right
    return out
