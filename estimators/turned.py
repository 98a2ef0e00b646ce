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

from estimators.elementary import atan2, cos, exp, sin
from estimators.jit import inner, njit
from estimators.native import Number, Record
from estimators.rotations import wrap
from estimators.settings import Setting

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
FIELD_OFF = Setting(0.4, "rad, of the field's heading against motion's: the magnetometer is given up", above=0.0)
NOTES = {2: ("magnetometer given up: motion contradicts its heading", "magnetometer used again")}
"""What a column of `Estimates.adaptation` means when it becomes 1, and 0 again."""


class Turned(Record):
    """Holds what the fixes and the inertial sensors have shown; times are NaN before the first."""

    turn: Number  # rad, by which the filter has turned its heading
    cos: Number  # of it
    sin: Number
    v_north: Number  # m/s, integral of the acceleration, in axes that no measurement turns
    v_east: Number
    fix_t: Number  # s, the fix that the next is compared with
    fix_north: Number  # m/s, its velocity
    fix_east: Number
    fix_own_north: Number  # m/s, the integral of then
    fix_own_east: Number
    along: Number  # (m/s)^2, sum d_i . d_g
    across: Number  # (m/s)^2, sum d_i x d_g
    own2: Number  # (m/s)^2, sum |d_i|^2
    given2: Number  # (m/s)^2, sum |d_g|^2
    time2: Number  # s2, sum of the squared times between fixes
    seen_t: Number  # s, the last manoeuvre
    field_t: Number  # s, the last field
    wrong_s: Number  # s, for which the field has contradicted the motion
    right_s: Number  # s, for which a field given up has fitted
    refused: Number  # 1: the field is given up
    before: Number  # `refused` at the last look
    right_t: Number  # s, when the filter's heading last fitted


@njit
def begin(s: Turned) -> None:
    """Begin with nothing seen."""
    s.turn = s.sin = s.v_north = s.v_east = s.fix_north = s.fix_east = s.fix_own_north = s.fix_own_east = 0.0
    s.along = s.across = s.own2 = s.given2 = s.time2 = s.wrong_s = s.right_s = s.refused = s.before = 0.0
    s.cos = 1.0
    s.fix_t = s.seen_t = s.field_t = s.right_t = math.nan


@inner
def note_correction(s: Turned, angle: float) -> None:
    """Note that the filter has turned its heading by an angle (rad)."""
    if angle != 0.0:
        s.turn += angle
        s.cos, s.sin = cos(s.turn), sin(s.turn)


@inner
def note_force(s: Turned, north: float, east: float, dt: float) -> None:
    """Integrate an acceleration (m/s2) in the filter's axes over dt (s)."""
    s.v_north += (s.cos * north + s.sin * east) * dt
    s.v_east += (s.cos * east - s.sin * north) * dt


@inner
def carried(s: Turned, north: float, east: float) -> tuple[float, float]:
    """Return the integral (m/s), north and east by the gyro alone plus the antenna's swing, in the filter's axes."""
    return s.v_north + s.cos * north + s.sin * east, s.v_east + s.cos * east - s.sin * north


@inner
def note_fix(s: Turned, t: float, north: float, east: float, own_north: float, own_east: float) -> None:
    """Note a velocity (m/s) that was true at t (s), and the integral of then."""
    dt = t - s.fix_t
    if LEAST <= dt <= MOST:
        a, b, x, y = own_north - s.fix_own_north, own_east - s.fix_own_east, north - s.fix_north, east - s.fix_east
        left = exp(-dt / MEMORY)
        s.along, s.across, s.own2 = left * s.along, left * s.across, left * s.own2
        s.given2, s.time2 = left * s.given2, left * s.time2
        least = (MANOEUVRE * dt) ** 2  # both: vibration that the sampling folds down is in one alone
        if a * a + b * b > least and x * x + y * y > least:
            s.along += a * x + b * y
            s.across += a * y - b * x
            s.own2 += a * a + b * b
            s.given2 += x * x + y * y
            s.time2 += dt * dt
            s.seen_t = t
    if not 0.0 <= dt < LEAST:
        s.fix_t, s.fix_north, s.fix_east, s.fix_own_north, s.fix_own_east = t, north, east, own_north, own_east


@inner
def turned_by(s: Turned, t: float, velocity: float) -> tuple[float, float]:
    """Return how far the filter's heading is off at t (s), and the sigma of that (rad); infinite when nothing tells.

    Args:
        s: memory.
        t: s.
        velocity: m/s, sigma of the receiver's velocity.
    """
    explained = s.along * s.along + s.across * s.across
    if not (s.own2 > 0.0 and explained > FIT * s.own2 * s.given2):
        return 0.0, math.inf
    variance = 2.0 * velocity * velocity / s.own2 + FORCE * FORCE * s.time2 / s.own2
    age = DRIFT * (t - s.seen_t)
    return wrap(atan2(s.across, s.along) - s.turn), math.sqrt(variance + age * age)


@inner
def refuse_field(s: Turned, t: float, innovation: float, velocity: float, off: float) -> bool:
    """Tell whether the field is given up at t (s).

    Args:
        s: memory.
        t: s.
        innovation: rad, by which the field would turn the filter's heading.
        velocity: m/s, sigma of the receiver's velocity.
        off: rad, beyond which it contradicts the motion.
    """
    dt = min(t - s.field_t, MOST) if s.field_t <= t else 0.0
    s.field_t = t
    turn, sigma = turned_by(s, t, velocity)
    wrong = abs(wrap(innovation - turn)) if sigma < SURE else abs(innovation)
    if s.refused == 0.0:
        contradicts = sigma < SURE and wrong > max(off, 4.0 * sigma)
        s.wrong_s = max(s.wrong_s + dt * (min(wrong / off, GROSS) if contradicts else -0.25), 0.0)
        s.refused, s.right_s = 1.0 if s.wrong_s >= LONG else 0.0, 0.0
    else:
        s.right_s = s.right_s + dt if wrong < BACK * off else 0.0
        s.refused, s.wrong_s = 0.0 if s.right_s >= AGAIN else 1.0, 0.0
    return bool(s.refused == 1.0)


@inner
def is_lost(s: Turned, t: float, blind: bool, velocity: float, off: float) -> bool:
    """Tell whether the filter's heading is to be set to what motion shows, its covariance opened before.

    Always when the field has just been given up: what it has taught of hard iron is wrong, whatever the heading.

    Args:
        s: memory.
        t: s.
        blind: there has never been a field.
        velocity: m/s, sigma of the receiver's velocity.
        off: rad, beyond which the heading contradicts the motion.
    """
    just = s.refused > s.before
    s.before = s.refused
    if not (blind or s.refused == 1.0):
        return False
    turn, sigma = turned_by(s, t, velocity)
    if not (sigma < SURE and (just or abs(turn) > max(off, 3.0 * sigma))):
        s.right_t = t
        return False
    if not (just or t - s.right_t >= LONG):
        return False
    s.right_t = t
    return True
