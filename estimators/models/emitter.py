"""Emitter location from the phase between two antennas (Baseline 2021): where a fixed emitter on the ground is.

The aircraft carries two antennas, d metres apart along the fuselage. An emitter of frequency f at the bearing theta and
the range R gives, with `k = 2 pi f d / c` and the direction alpha of the baseline (the heading, from the AHRS),

    phase        phi  = k cos(theta - alpha), measured modulo 2 pi                                        eq. (1)
    phase rate   phi' = -k sin(theta - alpha) (theta' - alpha')                                           eq. (2)
    bearing rate theta' = (v_x sin(theta) - v_y cos(theta)) / R                                           eq. (6)
    range        R = (v_x sin(theta) - v_y cos(theta)) / (alpha' - phi' / (k sin(theta - alpha)))         eq. (7)

State: the emitter's position (x, y), m. All angles are counted from x towards y: with (x, y) = (north, east) alpha is
the heading and theta the bearing of navigation, with (x, y) = (east, north) they are those of the paper. Inputs u of a
look: own position (2), own velocity (2), alpha, alpha'. SI and radians.

The own position, velocity and heading are measured too. The paper names their errors but not where they enter the
filter; here they add to the measurement noise, to first order (`look_noise`), as if independent from look to look.
"""

import math
import sys
from typing import Annotated, NamedTuple

import numpy as np

from estimators.errors import SettingError
from estimators.filters.base import Method
from estimators.jit import njit
from estimators.models.base import BANK, STATE, Bound, Group, Layout
from estimators.native import Number, Record, local, shaped, vector

LIGHT = 299_792_458.0
"""Speed of light, m/s."""

PHASE, RATE = 0, 1
"""Rows of the measurement."""


class Emitter(NamedTuple):
    """Parameters: geometry and errors, one sigma each."""

    k: float  # rad of phase per unit of cos(theta - alpha)
    phase: float  # rad
    phase_rate: float  # rad/s
    position: float  # m, of the aircraft, each axis
    velocity: float  # m/s, each axis
    heading: float  # rad
    heading_rate: float  # rad/s
    frequency: float  # of f, relative to f

    @classmethod
    def make(
        cls,
        *,
        frequency: float = 6e9,
        baseline: float = 10.0,
        phase_sigma: float = math.radians(10.0),
        phase_rate_sigma: float = math.radians(1.0),
        position_sigma: float = 10.0,
        velocity_sigma: float = 2.0,
        heading_sigma: float = 0.0,
        heading_rate_sigma: float = 0.0,
        frequency_sigma: float = 0.0,
    ) -> "Emitter":
        """The paper's experiment (section 4.1.1) by default: Hz, m, rad, rad/s, m, m/s, rad, rad/s, Hz.

        Raises:
            SettingError: frequency, baseline, or the sigma of the phase or its rate not positive, another negative.
        """
        positive = {
            "frequency": frequency,
            "baseline": baseline,
            "phase_sigma": phase_sigma,
            "phase_rate_sigma": phase_rate_sigma,
        }
        others = {
            "position_sigma": position_sigma,
            "velocity_sigma": velocity_sigma,
            "heading_sigma": heading_sigma,
            "heading_rate_sigma": heading_rate_sigma,
            "frequency_sigma": frequency_sigma,
        }
        for name, value in positive.items():
            if not (value > 0.0 and math.isfinite(value)):
                raise SettingError(f"emitter: {name} = {value} must be positive")
        for name, value in others.items():
            if not (value >= 0.0 and math.isfinite(value)):
                raise SettingError(f"emitter: {name} = {value} must not be negative")
        return cls(
            k=2.0 * math.pi * frequency * baseline / LIGHT,
            phase=float(phase_sigma),
            phase_rate=float(phase_rate_sigma),
            position=float(position_sigma),
            velocity=float(velocity_sigma),
            heading=float(heading_sigma),
            heading_rate=float(heading_rate_sigma),
            frequency=float(frequency_sigma / frequency),
        )


@njit
def range_from_rate(k: float, theta: float, phase_rate: float, u: np.ndarray) -> float:
    """Range (m) of an emitter at bearing theta from the phase rate, eq. (7); not positive when they contradict."""
    across = u[2] * math.sin(theta) - u[3] * math.cos(theta)
    return float(across / (u[5] - phase_rate / (k * math.sin(theta - u[4]))))


@njit
def range_sigma(
    model: "Emitter | Parameters", theta: float, theta_sigma: float, phase_rate: float, u: np.ndarray
) -> float:
    """Standard deviation (m) of `range_from_rate`, all errors independent and to first order, eq. (16)."""
    sine, cosine = math.sin(theta), math.cos(theta)
    s, c = math.sin(theta - u[4]), math.cos(theta - u[4])
    across, along = u[2] * sine - u[3] * cosine, u[2] * cosine + u[3] * sine
    rate = u[5] - phase_rate / (model.k * s)  # theta'
    by_rate = -across / (rate * rate)  # derivative of R with respect to theta'
    rate_by_theta = phase_rate * c / (model.k * s * s)
    variance = ((along / rate + by_rate * rate_by_theta) * theta_sigma) ** 2
    variance += (model.velocity / rate) ** 2  # sine and cosine of the two axes add up to one
    variance += (by_rate / (model.k * s) * model.phase_rate) ** 2
    variance += (by_rate * rate_by_theta * model.heading) ** 2
    variance += (by_rate * model.heading_rate) ** 2
    variance += (by_rate * phase_rate / (model.k * s) * model.frequency) ** 2
    return math.sqrt(variance)


def bearings(k: float, phase: float, alpha: float, coarse: float, coarse_sigma: float) -> np.ndarray:
    """List the bearings that explain a phase, eq. (5), within two sigma of the coarse bearing, eq. (12).

    Args:
        k: rad per unit of cosine.
        phase: rad, modulo 2 pi.
        alpha: direction of the baseline, rad.
        coarse: bearing from the amplitudes, rad.
        coarse_sigma: its standard deviation, rad.

    Returns:
        (m,) rad, in (-pi, pi], ordered from one end of the interval to the other; empty when none fits.
    """
    most = math.floor(k / (2.0 * math.pi)) + 1
    cosine = (phase + 2.0 * math.pi * np.arange(-most, most + 1)) / k
    angle = np.arccos(cosine[np.abs(cosine) <= 1.0])
    # An emitter left and one right of the baseline give the same phase: the coarse bearing tells them apart.
    theta = np.concatenate([alpha + angle, alpha - angle])
    off = np.remainder(theta - coarse + math.pi, 2.0 * math.pi) - math.pi
    off = np.sort(off[np.abs(off) <= 2.0 * coarse_sigma])
    return math.pi - np.remainder(math.pi - (coarse + off), 2.0 * math.pi)


def hypotheses(
    model: Emitter,
    phase: float,
    phase_rate: float,
    u: np.ndarray,
    *,
    coarse: float,
    coarse_sigma: float,
    every: int,
    bearing_sigma: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The first terms of the Gaussian sum, eq. (12)-(16): one for every `every`-th possible bearing.

    The middle one of each run of `every` bearings stands for the run. A term lies at the range that its bearing
    and the phase rate give, and its covariance has the axes of range and cross range.

    Args:
        model: geometry and errors.
        phase: rad modulo 2 pi; NaN when not measured (then any phase does: the bearings only need to be as dense).
        phase_rate: rad/s.
        u: (6,) inputs.
        coarse: coarse bearing, rad.
        coarse_sigma: rad.
        every: the paper's q.
        bearing_sigma: rad, of one term.

    Returns:
        means (terms, 2) m and covariances (terms, 2, 2) m2; no terms when the phase rate contradicts every bearing.
    """
    theta = bearings(model.k, 0.0 if math.isnan(phase) else phase, float(u[4]), coarse, coarse_sigma)
    theta = theta[min(every // 2, len(theta) // 2) :: every]
    means, covariances = [], []
    for angle in theta:
        away = range_from_rate(model.k, angle, phase_rate, u)
        if not (away > 0.0 and math.isfinite(away)):
            continue
        direction = np.array([math.cos(angle), math.sin(angle)])
        rotation = np.array([direction, [-direction[1], direction[0]]])  # range and cross range in rows
        sigma = np.array([range_sigma(model, angle, bearing_sigma, phase_rate, u), away * bearing_sigma])
        means.append(u[:2] + away * direction)
        covariances.append(rotation.T @ np.diag(sigma**2) @ rotation)
    return np.array(means).reshape(-1, 2), np.array(covariances).reshape(-1, 2, 2)


@njit
def look(model: "Emitter | Parameters", x: np.ndarray, u: np.ndarray, y: np.ndarray, H: np.ndarray) -> float:
    """Phase (not wrapped) and phase rate into y, their derivatives by (x, y) into H (2, 2); returns theta."""
    dx, dy = x[0] - u[0], x[1] - u[1]
    R = math.sqrt(dx * dx + dy * dy)
    sine, cosine = dy / R, dx / R
    theta = math.atan2(dy, dx)
    s, c = math.sin(theta - u[4]), math.cos(theta - u[4])
    across, along = u[2] * sine - u[3] * cosine, u[2] * cosine + u[3] * sine
    turning = across / R - u[5]  # theta' - alpha'
    y[PHASE] = model.k * c
    y[RATE] = -model.k * s * turning
    by_theta = -model.k * (c * turning + s * along / R)
    by_range = model.k * s * across / (R * R)
    H[PHASE, 0] = model.k * s * sine / R
    H[PHASE, 1] = -model.k * s * cosine / R
    H[RATE, 0] = -by_theta * sine / R + by_range * cosine
    H[RATE, 1] = by_theta * cosine / R + by_range * sine
    return theta


@njit
def look_noise(model: "Emitter | Parameters", x: np.ndarray, u: np.ndarray, S: np.ndarray) -> None:
    """Add the noise of a look to the lower half of S (2, 2): phase, its rate, the aircraft's own state."""
    y, H = local(2), local(2, 2)
    theta = look(model, x, u, y, H)
    away = math.hypot(x[0] - u[0], x[1] - u[1])
    s, c = model.k * math.sin(theta - u[4]), model.k * math.cos(theta - u[4])
    turning = (u[2] * math.sin(theta) - u[3] * math.cos(theta)) / away - u[5]
    place, heading = model.position**2, model.heading**2
    # An error of the own position acts as one of the emitter's with the opposite sign.
    S[0, 0] += model.phase**2 + place * (H[0, 0] ** 2 + H[0, 1] ** 2) + heading * s * s
    S[1, 0] += place * (H[0, 0] * H[1, 0] + H[0, 1] * H[1, 1]) + heading * s * c * turning
    S[1, 1] += (
        model.phase_rate**2
        + place * (H[1, 0] ** 2 + H[1, 1] ** 2)
        + (s / away * model.velocity) ** 2
        + heading * (c * turning) ** 2
        + (s * model.heading_rate) ** 2
    )


class Parameters(Record):
    """An `Emitter` as a record."""

    k: Number
    phase: Number
    phase_rate: Number
    position: Number
    velocity: Number
    heading: Number
    heading_rate: Number
    frequency: Number


class State(Record, size=STATE):
    """The state."""

    position: Annotated[np.ndarray, shaped(2)]  # m


class Inputs(Record):
    """Holds the inputs of one look, see above."""

    position: Annotated[np.ndarray, shaped(2)]  # m
    velocity: Annotated[np.ndarray, shaped(2)]  # m/s
    heading: Number  # rad
    heading_rate: Number  # rad/s


def propagate(model: Parameters, x: State, u: Inputs, dt: float, out: State) -> None:
    """The emitter stands still."""
    out.position[0], out.position[1] = x.position[0], x.position[1]


def transition(model: Parameters, x: State, u: Inputs, dt: float, F: np.ndarray) -> None:
    """Identity: nothing changes."""


def process_noise(model: Parameters, x: State, u: Inputs, dt: float, P: np.ndarray) -> None:
    """None."""


def observe(model: Parameters, group: int, x: State, u: Inputs, y: np.ndarray) -> None:
    """Phase and its rate."""
    look(model, x.position, vector(u), y, local(2, 2))


def slope(model: Parameters, group: int, x: State, u: Inputs, H: np.ndarray) -> None:
    """Derivatives by the position."""
    look(model, x.position, vector(u), local(2), H)


def measurement_noise(model: Parameters, group: int, x: State, u: Inputs, S: np.ndarray) -> None:
    """Noise of a look."""
    look_noise(model, x.position, vector(u), S)


def residual(model: Parameters, group: int, z: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """Z - y; the phase is known modulo 2 pi."""
    apart = z[PHASE] - y[PHASE]
    out[PHASE] = math.atan2(math.sin(apart), math.cos(apart))
    out[RATE] = z[RATE] - y[RATE]


def bound(emitter: Emitter, method: Method) -> Bound:
    """Bind the model for a filter; it has no alignment, and its states are a bank's (`gaussian_sum`)."""
    layout = Layout(raw=2, size=2, changed=0, read=0, groups=(Group(0, 2, 0, 2, False),))
    entries = (*method.module.USES, *BANK)
    return Bound(sys.modules[__name__], layout, entries, Parameters.of(**emitter._asdict()), Inputs.zeros())
