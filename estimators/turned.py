"""The heading that motion shows: how GNSS velocity and the inertial sensors turn against each other.

A heading carried by the gyro alone is off by an angle that hardly changes. The same force, turned with that heading and
integrated from fix to fix, is a change of velocity d_i; the receiver has d_g. The rotation that fits best is the angle:

    theta = atan2(sum d_i x d_g, sum d_i . d_g),   sigma^2 = s^2 / sum |d_i|^2 + (FORCE / a)^2 + (DRIFT age)^2

s of the receiver's difference, a the mean acceleration, FORCE what a tilt and the accelerometer's bias make. No field
is in it: what a filter that believes a wrong field corrects is taken out. Against theta are held what the field says,
and the heading of the filter:

    field off by more than `off` and four sigma for LONG seconds     it is given up, until it fits for AGAIN seconds
    the field just given up, or the filter off as much for as long    its heading is set to theta, its covariance opened

Only accelerations above MANOEUVRE count; what is older is forgotten, and without any nothing is concluded.
"""

import math
from typing import Annotated

import numpy as np

from estimators.elementary import atan2, cos, exp, sin
from estimators.jit import inner, njit
from estimators.native import Record, shaped
from estimators.rotations import wrap

MANOEUVRE = 1.0  # m/s2
LEAST, MOST = 0.45, 3.0  # s, between the fixes that are compared
MEMORY = 60.0  # s, after which a manoeuvre counts half as much, about
FORCE = 0.15  # m/s2, what a tilt of a degree makes
DRIFT = 1e-3  # rad/s, of the gyro
SURE = 0.14  # rad, sigma above which nothing is concluded
FIT = 0.7  # share of the velocity's changes that the rotation explains
LONG, AGAIN = 2.5, 10.0  # s
GROSS = 3.0  # a contradiction so many times larger takes so much less time
BACK = 0.4  # of `off`: the field fits
NOTES = {2: ("magnetometer given up: motion contradicts its heading", "magnetometer used again")}
"""What a column of `Estimates.adaptation` means when it becomes 1, and 0 again."""

TURN, COS, SIN, V_NORTH, V_EAST, FIX_T, FIX_NORTH, FIX_EAST, FIX_I_NORTH, FIX_I_EAST = range(10)
ALONG, ACROSS, OWN2, GIVEN2, TIME2, SEEN_T, FIELD_T, WRONG_S, RIGHT_S, REFUSED, BEFORE, RIGHT_T, SIZE = range(10, 23)


class Turned(Record):
    """Its memory; see the indices above."""

    s: Annotated[np.ndarray, shaped(SIZE)]


@njit
def begin(s: np.ndarray) -> None:
    """Nothing seen yet."""
    for i in range(SIZE):
        s[i] = 0.0
    s[COS] = 1.0
    s[FIX_T] = s[SEEN_T] = s[FIELD_T] = s[RIGHT_T] = math.nan


@inner
def note_correction(s: np.ndarray, angle: float) -> None:
    """A filter has turned its heading by an angle (rad)."""
    if angle != 0.0:
        s[TURN] += angle
        s[COS], s[SIN] = cos(s[TURN]), sin(s[TURN])


@inner
def note_force(s: np.ndarray, north: float, east: float, dt: float) -> None:
    """Integrate an acceleration (m/s2) in the filter's axes over dt (s)."""
    s[V_NORTH] += (s[COS] * north + s[SIN] * east) * dt
    s[V_EAST] += (s[COS] * east - s[SIN] * north) * dt


@inner
def carried(s: np.ndarray, north: float, east: float) -> tuple[float, float]:
    """The integral (m/s), north and east by the gyro alone, with the swing of the antenna, in the filter's axes."""
    return s[V_NORTH] + s[COS] * north + s[SIN] * east, s[V_EAST] + s[COS] * east - s[SIN] * north


@inner
def note_fix(s: np.ndarray, t: float, north: float, east: float, own_north: float, own_east: float) -> None:
    """A velocity (m/s) that was true at t (s), and the integral of then."""
    dt = t - s[FIX_T]
    if LEAST <= dt <= MOST:
        a, b, x, y = own_north - s[FIX_I_NORTH], own_east - s[FIX_I_EAST], north - s[FIX_NORTH], east - s[FIX_EAST]
        left = exp(-dt / MEMORY)
        for i in range(ALONG, TIME2 + 1):
            s[i] *= left
        if a * a + b * b > (MANOEUVRE * dt) ** 2:
            s[ALONG] += a * x + b * y
            s[ACROSS] += a * y - b * x
            s[OWN2] += a * a + b * b
            s[GIVEN2] += x * x + y * y
            s[TIME2] += dt * dt
            s[SEEN_T] = t
    if not 0.0 <= dt < LEAST:
        s[FIX_T], s[FIX_NORTH], s[FIX_EAST], s[FIX_I_NORTH], s[FIX_I_EAST] = t, north, east, own_north, own_east


@inner
def turned_by(s: np.ndarray, t: float, velocity: float) -> tuple[float, float]:
    """How far the filter's heading is off at t (s), and the sigma of that (rad); infinite when nothing tells.

    Args:
        s: memory.
        t: s.
        velocity: m/s, sigma of the receiver's velocity.
    """
    explained = s[ALONG] * s[ALONG] + s[ACROSS] * s[ACROSS]
    if not (s[OWN2] > 0.0 and explained > FIT * s[OWN2] * s[GIVEN2]):
        return 0.0, math.inf
    variance = 2.0 * velocity * velocity / s[OWN2] + FORCE * FORCE * s[TIME2] / s[OWN2]
    age = DRIFT * (t - s[SEEN_T])
    return wrap(atan2(s[ACROSS], s[ALONG]) - s[TURN]), math.sqrt(variance + age * age)


@inner
def refuse_field(s: np.ndarray, t: float, innovation: float, velocity: float, off: float) -> bool:
    """Whether the field is given up at t (s).

    Args:
        s: memory.
        t: s.
        innovation: rad, by which the field would turn the filter's heading.
        velocity: m/s, sigma of the receiver's velocity.
        off: rad, beyond which it contradicts the motion.
    """
    dt = min(t - s[FIELD_T], MOST) if s[FIELD_T] <= t else 0.0
    s[FIELD_T] = t
    turn, sigma = turned_by(s, t, velocity)
    wrong = abs(wrap(innovation - turn)) if sigma < SURE else abs(innovation)
    if s[REFUSED] == 0.0:
        contradicts = sigma < SURE and wrong > max(off, 4.0 * sigma)
        s[WRONG_S] = max(s[WRONG_S] + dt * (min(wrong / off, GROSS) if contradicts else -0.25), 0.0)
        s[REFUSED], s[RIGHT_S] = 1.0 if s[WRONG_S] >= LONG else 0.0, 0.0
    else:
        s[RIGHT_S] = s[RIGHT_S] + dt if wrong < BACK * off else 0.0
        s[REFUSED], s[WRONG_S] = 0.0 if s[RIGHT_S] >= AGAIN else 1.0, 0.0
    return bool(s[REFUSED] == 1.0)


@inner
def is_lost(s: np.ndarray, t: float, blind: bool, velocity: float, off: float) -> bool:
    """Whether the filter's heading is to be set to what motion shows, its covariance opened before.

    Always when the field has just been given up: what it has taught of hard iron is wrong, whatever the heading.

    Args:
        s: memory.
        t: s.
        blind: there has never been a field.
        velocity: m/s, sigma of the receiver's velocity.
        off: rad, beyond which the heading contradicts the motion.
    """
    just = s[REFUSED] > s[BEFORE]
    s[BEFORE] = s[REFUSED]
    if not (blind or s[REFUSED] == 1.0):
        return False
    turn, sigma = turned_by(s, t, velocity)
    if not (sigma < SURE and (just or abs(turn) > max(off, 3.0 * sigma))):
        s[RIGHT_T] = t
        return False
    if not (just or t - s[RIGHT_T] >= LONG):
        return False
    s[RIGHT_T] = t
    return True
