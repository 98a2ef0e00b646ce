"""Truth from a formula: a motion table, a straight line, a road vehicle. For tests that need no aircraft.

A motion gives attitude and velocity as functions of time with their derivatives (`Jet`); angular rate, its derivative
and specific force follow exactly, on the rotating ellipsoid and with normal gravity. Only the position is integrated,
from the velocity.

    [motion]
    kind = "constant"     # still, or turning at constant rates; attitude from [start]
    kind = "sway"         # sinusoidal roll, pitch, heading on the spot
    kind = "line"         # straight ahead, speeding up and braking
    kind = "road"         # a car: laps of a running track, or a country road
    kind = "weave"        # an aircraft: level coordinated turns to and fro
    kind = "hover"        # a multirotor over one spot in gusts
"""

# ruff: noqa: D102  (`Motion` documents the methods which every class below defines)

import math
from dataclasses import dataclass

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError
from ahrs_sim.flight.truth import Event, Setpoints, Truth
from ahrs_sim.scenario import Scenario, Start, seeds
from ahrs_sim.scenario.table import Table
from ahrs_sim.world import wgs84
from ahrs_sim.world.gravity import gravity_n
from estimators.types import blank

TAU = 2.0 * math.pi
DEFAULT_DURATION = 240.0  # s


@dataclass(frozen=True, slots=True)
class Jet:
    """A function of time at n instants with its first and second derivative, each (n,) or a number.

    Sums, products and functions of jets are jets: derivatives without writing them out.
    """

    x: np.ndarray
    d: np.ndarray
    dd: np.ndarray

    def __add__(self, other: "Jet | float") -> "Jet":
        b = jet(other)
        return Jet(self.x + b.x, self.d + b.d, self.dd + b.dd)

    def __mul__(self, other: "Jet | float") -> "Jet":
        b = jet(other)
        return Jet(self.x * b.x, self.d * b.x + self.x * b.d, self.dd * b.x + 2.0 * self.d * b.d + self.x * b.dd)

    def __rsub__(self, other: float) -> "Jet":
        return -self + other

    __radd__ = __add__
    __rmul__ = __mul__

    def __neg__(self) -> "Jet":
        return self * -1.0

    def __sub__(self, other: "Jet | float") -> "Jet":
        return self + -jet(other)

    def of(self, f: np.ndarray, f1: np.ndarray, f2: np.ndarray) -> "Jet":
        """Apply a function to this jet, by its value and two derivatives at `x` (chain rule)."""
        return Jet(f, f1 * self.d, f2 * self.d**2 + f1 * self.dd)

    def rate(self) -> "Jet":
        """Take the derivative, whose own second derivative is unknown (0)."""
        return Jet(self.d, self.dd, np.zeros_like(self.d))


def jet(value: "Jet | float") -> Jet:
    """Make a jet of a constant."""
    if isinstance(value, Jet):
        return value
    zero = np.zeros(())
    return Jet(np.asarray(value, dtype=float), zero, zero)


def sin(a: Jet) -> Jet:
    """Sine."""
    s, c = np.sin(a.x), np.cos(a.x)
    return a.of(s, c, -s)


def cos(a: Jet) -> Jet:
    """Cosine."""
    s, c = np.sin(a.x), np.cos(a.x)
    return a.of(c, -s, -c)


def smooth_step(a: Jet, width: float) -> Jet:
    """Go from 0 to 1 while `a` goes from 0 to `width`, with four continuous derivatives (polynomial of degree 9)."""
    u = np.clip(a.x / width, 0.0, 1.0)
    f = u**5 * (126.0 - 420.0 * u + 540.0 * u**2 - 315.0 * u**3 + 70.0 * u**4)
    f1 = 630.0 * u**4 * (1.0 - u) ** 4 / width
    f2 = 2520.0 * u**3 * (1.0 - u) ** 3 * (1.0 - 2.0 * u) / width**2
    return a.of(f, f1, f2)


def smooth_ramp(a: Jet, width: float) -> Jet:
    """Integral of `smooth_step`: 0 before `a` = 0, `a - width/2` after `width`."""
    u = np.clip(a.x / width, 0.0, 1.0)
    f = width * u**6 * (21.0 - 60.0 * u + 67.5 * u**2 - 35.0 * u**3 + 7.0 * u**4) + np.maximum(a.x - width, 0.0)
    f1 = u**5 * (126.0 - 420.0 * u + 540.0 * u**2 - 315.0 * u**3 + 70.0 * u**4)
    return a.of(f, f1, 630.0 * u**4 * (1.0 - u) ** 4 / width)


class Motion:
    """Base of all: attitude and velocity at given times."""

    on_ground = True

    def attitude(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        """Roll, pitch, heading (rad)."""
        raise NotImplementedError

    def velocity(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        """North, east, down (m/s)."""
        return jet(0.0), jet(0.0), jet(0.0)

    def motor(self, t: Jet) -> tuple[np.ndarray, np.ndarray]:
        """Throttle (0 to 1) and speed (rpm), each (n,): no motor."""
        return np.zeros_like(t.x), np.zeros_like(t.x)


class Constant(Motion):
    """At one place with constant Euler angle rates: `roll_dps`, `pitch_dps`, `heading_dps` (all 0).

    The attitude at t = 0 is `roll_deg`, `pitch_deg` (0) and the start's heading.
    """

    def __init__(self, table: Table, start: Start) -> None:
        limits = {"minimum": -2000.0, "maximum": 2000.0}
        self.first = [math.radians(table.number(f"{axis}_deg", 0.0, minimum=-180.0, maximum=180.0)) for axis in _TILT]
        self.first.append(start.heading)
        self.rate = [math.radians(table.number(f"{axis}_dps", 0.0, **limits)) for axis in _AXES]

    def attitude(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        roll, pitch, heading = (t * rate + first for rate, first in zip(self.rate, self.first, strict=True))
        return roll, pitch, heading


class Sway(Motion):
    """Sinusoidal motion table at one place.

    Per axis (roll, pitch, heading) `AXIS_mean_deg`, `AXIS_amplitude_deg`, `AXIS_period_s`, `AXIS_phase_deg` (0); the
    defaults are the experiment of the fuzzy adaptive filter: 10 + 1 sin(pi/15 t), 10 + 1 sin(pi/10 t),
    30 + 5 sin(pi/20 t) degrees. With `still_s` it stands at the mean first and swings in within 2 s.
    """

    _DEFAULTS = ((10.0, 1.0, 30.0), (10.0, 1.0, 20.0), (30.0, 5.0, 40.0))

    def __init__(self, table: Table, start: Start) -> None:
        self.still = table.number("still_s", 0.0, minimum=0.0)
        self.axes = []
        for axis, (mean, amplitude, period) in zip(_AXES, self._DEFAULTS, strict=True):
            self.axes.append(
                (
                    math.radians(table.number(f"{axis}_mean_deg", mean, minimum=-360.0, maximum=360.0)),
                    math.radians(table.number(f"{axis}_amplitude_deg", amplitude, minimum=0.0, maximum=180.0)),
                    TAU / table.number(f"{axis}_period_s", period, above=0.0),
                    math.radians(table.number(f"{axis}_phase_deg", 0.0, minimum=-360.0, maximum=360.0)),
                )
            )

    def attitude(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        t = t - self.still
        window = smooth_step(t, 2.0) if self.still > 0.0 else jet(1.0)
        roll, pitch, heading = (
            window * sin(t * frequency + phase) * amplitude + mean for mean, amplitude, frequency, phase in self.axes
        )
        return roll, pitch, heading


class Line(Motion):
    """Straight along the start's heading at `speed_mps`, climbing `climb_mps` (0).

    `[[motion.leg]]` with `for_s` and `accel_mps2`, one after the other, change the speed; changes of acceleration take
    `ease_s` (0.5).
    """

    on_ground = False

    def __init__(self, table: Table, start: Start) -> None:
        self.speed = table.number("speed_mps", 20.0, minimum=0.0, maximum=300.0)
        self.climb = table.number("climb_mps", 0.0, minimum=-50.0, maximum=50.0)
        self.ease = table.number("ease_s", 0.5, above=0.0)
        self.heading = start.heading
        self.legs: list[tuple[float, float]] = []  # when the acceleration changes, by how much
        at, last = 0.0, 0.0
        for leg in table.list_of_tables("leg"):
            accel = leg.number("accel_mps2", minimum=-50.0, maximum=50.0)
            self.legs.append((at, accel - last))
            duration = leg.number("for_s", above=0.0)
            if duration < self.ease:
                raise leg.error("for_s", f"{duration:g} is shorter than ease_s ({self.ease:g}); make it longer")
            at, last = at + duration, accel
            leg.close()
        self.legs.append((at, -last))

    def attitude(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        return jet(0.0), jet(0.0), jet(self.heading)

    def velocity(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        speed = t * 0.0 + self.speed
        for at, change in self.legs:
            speed = speed + smooth_ramp(t - at, self.ease) * change
        return speed * math.cos(self.heading), speed * math.sin(self.heading), jet(-self.climb)


class Road(Motion):
    """A car: it points where it drives, leans out of bends, squats and dives, and shakes on a rough surface.

    `road = "track"` (laps of a 400 m running track, level) or `"country"` (bends and hills); `speed_mps` (track 8,
    country 15) swings by `swing_mps` (track 3, country 4) every `swing_s` (20), braking harder than it accelerates.
    `lean` is roll per lateral acceleration in deg/(m/s2) (0.5), `squat` pitch per longitudinal (0.4), `rough_deg` the
    rms of the shaking (track 0.05, country 0.3). `still_s` (20) of standing come first.
    """

    _RADIUS, _STRAIGHT = 36.5, 84.39  # m, of a standard running track

    def __init__(self, table: Table, start: Start, seed: int) -> None:
        self.track = table.choice("road", ["track", "country"], "track") == "track"
        self.speed = table.number("speed_mps", 8.0 if self.track else 15.0, above=0.0, maximum=60.0)
        default = min(3.0 if self.track else 4.0, 0.5 * self.speed)
        self.swing = table.number("swing_mps", default, minimum=0.0, maximum=0.7 * self.speed)
        self.frequency = TAU / table.number("swing_s", 20.0, above=1.0)
        self.lean = math.radians(table.number("lean", 0.5, minimum=0.0, maximum=5.0))
        self.squat = math.radians(table.number("squat", 0.4, minimum=0.0, maximum=5.0))
        rough = math.radians(table.number("rough_deg", 0.05 if self.track else 0.3, minimum=0.0, maximum=5.0))
        self.still = table.number("still_s", 20.0, minimum=0.0)
        self.heading = start.heading
        random = seeds.generator(seed, "road")
        # roughness: lines between 0.8 and 4 Hz of both axes; stands for suspension and surface, not for one car
        n = 12
        self.shake = [
            (TAU * random.uniform(0.8, 4.0), random.uniform(0.0, TAU), rough * math.sqrt(2.0 / n), i % 2)
            for i in range(2 * n)
        ]
        # the country road: amplitude, wavelength (m) and phase of curvature (1/m) and slope (rad)
        self.bends = [(0.006, 310.0), (0.004, 170.0), (0.002, 730.0)]
        self.hills = [(0.03, 900.0), (0.015, 350.0)]
        self.bend_phase = random.uniform(0.0, TAU, len(self.bends))
        self.hill_phase = random.uniform(0.0, TAU, len(self.hills))

    def distance(self, t: Jet) -> Jet:
        """Along the road, m."""
        t = t - self.still
        # the swing's second harmonic makes braking twice as hard as speeding up
        w, swing = self.frequency, self.swing
        swung = (1.0 - cos(t * w)) * (swing / w) - (1.0 - cos(t * (2.0 * w))) * (0.125 * swing / w)
        drive_off = self.speed / 0.8  # s; the peak is near 3 m/s2
        return smooth_ramp(t, drive_off) * self.speed + swung * smooth_step(t, drive_off)

    def heading_along(self, s: Jet) -> Jet:
        """Compute the heading at a distance, rad."""
        if not self.track:
            heading = jet(self.heading)
            for (curvature, length), phase in zip(self.bends, self.bend_phase, strict=True):
                k = TAU / length
                heading = heading + (math.cos(phase) - cos(s * k + phase)) * (curvature / k)
            return heading
        # every bend turns by half a circle; the curvature comes and goes over `ease` m
        bend, ease = math.pi * self._RADIUS, 20.0
        half = bend + self._STRAIGHT
        count = np.floor(s.x / half)
        within = s - Jet(count * half, np.zeros_like(s.x), np.zeros_like(s.x))
        turn = smooth_ramp(within - (self._STRAIGHT - 0.5 * ease), ease) - smooth_ramp(within - (half - ease), ease)
        turned = turn * (math.pi / (bend - 0.5 * ease))
        return turned + Jet(self.heading + count * math.pi, np.zeros_like(s.x), np.zeros_like(s.x))

    def slope_along(self, s: Jet) -> Jet:
        """Slope at a distance, rad."""
        slope = s * 0.0
        if not self.track:
            for (height, length), phase in zip(self.hills, self.hill_phase, strict=True):
                slope = slope + sin(s * (TAU / length) + phase) * height
        return slope

    def attitude(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        s = self.distance(t)
        heading = self.heading_along(s)
        slope = self.slope_along(s)
        moving = smooth_step(t - self.still, 5.0)
        # lean and squat follow the accelerations, whose own derivatives a jet does not have: from central differences
        eps = 1e-3
        lateral, forward = [], []
        for dt in (-eps, 0.0, eps):
            at = self.distance(t + dt)
            lateral.append(at.d * self.heading_along(at).d)
            forward.append(at.dd)
        roll = _differences(lateral, eps) * -self.lean
        pitch = slope + _differences(forward, eps) * self.squat
        for frequency, phase, amplitude, axis in self.shake:
            line = moving * sin(t * frequency + phase) * amplitude
            roll, pitch = (roll + line, pitch) if axis == 0 else (roll, pitch + line)
        return roll, pitch, heading

    def velocity(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        s = self.distance(t)
        speed, heading, slope = s.rate(), self.heading_along(s), self.slope_along(s)
        level = speed * cos(slope)
        return level * cos(heading), level * sin(heading), -(speed * sin(slope))


class Weave(Motion):
    """An aircraft that stands, speeds up and then banks to and fro in level coordinated flight, without wind.

    `still_s` (60) of standing, `speed_mps` (25) reached at `accel_mps2` (1.5) on average, two and a half times that in
    the middle, then a turn there and back again within `period_s` (60) at banks of about `bank_deg` (30), and
    `straight_s` (0) along the start's heading, `swings` times (0: for ever) and straight on. The body points along the
    velocity: the angle of attack is 0.
    """

    on_ground = False
    _EASE = 10.0  # s

    def __init__(self, table: Table, start: Start) -> None:
        self.still = table.number("still_s", 60.0, minimum=0.0)
        self.speed = table.number("speed_mps", 25.0, above=0.0, maximum=350.0)
        bank = math.radians(table.number("bank_deg", 30.0, minimum=0.0, maximum=70.0))
        self.period = table.number("period_s", 60.0, minimum=2.0 * self._EASE)
        self.cycle = self.period + table.number("straight_s", 0.0, minimum=0.0)
        self.swings = table.integer("swings", 0, minimum=0) or math.inf
        self.heading = start.heading
        self.gravity = float(gravity_n(np.array([[start.latitude, start.longitude, start.altitude]]))[0, 2])
        self.faster = self.speed / table.number("accel_mps2", 1.5, above=0.0, maximum=50.0)  # s
        self.swing = self.gravity * math.tan(bank) / self.speed * self.period / TAU  # rad

    def forward(self, t: Jet) -> Jet:
        """Speed, m/s."""
        return smooth_step(t - self.still, self.faster) * self.speed

    def course(self, t: Jet) -> Jet:
        """Compute the heading, rad."""
        t = t - (self.still + self.faster)
        count = np.minimum(np.floor(t.x / self.cycle), self.swings - 1.0)
        t = t - Jet(count * self.cycle, np.zeros_like(t.x), np.zeros_like(t.x))
        window = smooth_step(t, self._EASE) - smooth_step(t - (self.period - self._EASE), self._EASE)
        return window * (1.0 - cos(t * (TAU / self.period))) * self.swing + self.heading

    def attitude(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        # the bank's own derivatives need more of the heading's than a jet has: from central differences
        eps = 1e-3
        roll = [np.arctan(self.forward(t + dt).x * self.course(t + dt).d / self.gravity) for dt in (-eps, 0.0, eps)]
        return _differences(roll, eps), jet(0.0), self.course(t)

    def velocity(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        speed, heading = self.forward(t), self.course(t)
        return speed * cos(heading), speed * sin(heading), jet(0.0)


class Hover(Motion):
    """A multirotor over one spot: no course, no speed, only what gusts make of it.

    After `still_s` (20) of standing its rotors start, it climbs to `height_m` (20) within 10 s and stays. The place
    wanders by `wander_m` (0.3) rms along each axis, with periods of 4 to 20 s, the heading by `heading_wander_deg` (3).
    It leans into the wind by `lean_deg` (4, nose down) and by what its accelerations take. `throttle` (0.5) and `rpm`
    (5500) are those of the hover; both change with the lift and by a tenth with the work of the controller.
    """

    on_ground = False
    _SPIN_UP, _CLIMB = 3.0, 10.0  # s

    def __init__(self, table: Table, start: Start, seed: int) -> None:
        self.still = table.number("still_s", 20.0, minimum=0.0)
        self.height = table.number("height_m", 20.0, above=0.0, maximum=500.0)
        wander = table.number("wander_m", 0.3, minimum=0.0, maximum=5.0)
        turn = math.radians(table.number("heading_wander_deg", 3.0, minimum=0.0, maximum=30.0))
        self.lean = math.radians(table.number("lean_deg", 4.0, minimum=-30.0, maximum=30.0))
        self.throttle = table.number("throttle", 0.5, above=0.0, maximum=0.8)
        self.rpm = table.number("rpm", 5500.0, above=0.0, maximum=50000.0)
        self.heading = start.heading
        self.gravity = float(gravity_n(np.array([[start.latitude, start.longitude, start.altitude]]))[0, 2])
        random = seeds.generator(seed, "hover")

        def lines(rms: float, shortest: float, longest: float) -> list[tuple[float, float, float]]:
            """Frequency (rad/s), phase and amplitude of six sines that together have this rms."""
            amplitude = rms * math.sqrt(2.0 / 6.0)
            return [(TAU / random.uniform(shortest, longest), random.uniform(0.0, TAU), amplitude) for _ in range(6)]

        # velocities of sines of the place: amplitude times frequency
        self.gusts = [[(w, p, a * w) for w, p, a in lines(wander, 4.0, 20.0)] for _ in range(3)]
        self.yaw = lines(turn, 8.0, 40.0)
        self.work = lines(0.1, 0.5, 3.0)

    @staticmethod
    def _sum(lines: list[tuple[float, float, float]], t: Jet) -> Jet:
        total = t * 0.0
        for frequency, phase, amplitude in lines:
            total = total + sin(t * frequency + phase) * amplitude
        return total

    def velocity(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        up = t - (self.still + self._SPIN_UP)
        airborne = smooth_step(up, self._CLIMB)
        north, east, down = (airborne * self._sum(lines, t) for lines in self.gusts)
        return north, east, down - smooth_step(up, self._CLIMB).rate() * self.height

    def attitude(self, t: Jet) -> tuple[Jet, Jet, Jet]:
        airborne = smooth_step(t - (self.still + self._SPIN_UP), self._CLIMB)
        heading = airborne * self._sum(self.yaw, t) + self.heading
        # the lean follows the acceleration, whose own derivatives a jet does not have: from central differences
        eps = 1e-3
        roll, pitch = [], []
        for dt in (-eps, 0.0, eps):
            north, east, _ = self.velocity(t + dt)
            course = self._sum(self.yaw, t + dt).x * smooth_step(t + (dt - self.still - self._SPIN_UP), self._CLIMB).x
            c, s = np.cos(course + self.heading), np.sin(course + self.heading)
            roll.append(np.arctan((c * east.d - s * north.d) / self.gravity))
            pitch.append(-np.arctan((c * north.d + s * east.d) / self.gravity))
        return _differences(roll, eps), _differences(pitch, eps) - airborne * self.lean, heading

    def motor(self, t: Jet) -> tuple[np.ndarray, np.ndarray]:
        running = smooth_step(t - self.still, self._SPIN_UP).x
        lift = 1.0 - self.velocity(t)[2].d / self.gravity
        power = np.clip(running * lift**1.5 * (1.0 + self._sum(self.work, t).x), 0.0, 1.0 / self.throttle)
        return self.throttle * power, self.rpm * np.cbrt(power)


def _differences(values: list[np.ndarray], eps: float) -> Jet:
    before, now, after = values
    return Jet(now, (after - before) / (2.0 * eps), (after - 2.0 * now + before) / eps**2)


_AXES = ("roll", "pitch", "heading")
_TILT = _AXES[:2]
MOTIONS = ("constant", "sway", "line", "road", "weave", "hover")


class MotionFlight:
    """A motion as the pipeline sees it (see `ahrs_sim.flight.Flight`): `[motion]` at the scenario's start and wind.

    It lasts the scenario's duration, or 240 s.

    Raises:
        InputError: unknown kind or key, a value out of range, or a pilot, whom a motion has not.
    """

    def __init__(self, scenario: Scenario) -> None:
        assert scenario.motion is not None
        table = scenario.motion
        kind = table.choice("kind", list(MOTIONS))
        start = scenario.start
        self.motion: Motion
        if kind in ("road", "hover"):
            self.motion = {"road": Road, "hover": Hover}[kind](table, start, scenario.seed)
        else:
            self.motion = {"constant": Constant, "sway": Sway, "line": Line, "weave": Weave}[kind](table, start)
        table.close()
        if scenario.pilot_attitude != "truth":
            raise InputError(f"{scenario.where}: [pilot]: attitude: a motion is not flown by anybody; leave it out")
        self.kind = kind
        self.dt = 1.0 / scenario.rate
        self.done = False
        self.error: str | None = None
        duration = DEFAULT_DURATION if scenario.duration is None else scenario.duration
        self.expected_duration: float | None = duration
        self._rows = math.floor(duration * scenario.rate + 1e-6) + 1
        self._next = 0
        self._ground = start.altitude
        self._lla = (start.latitude, start.longitude, start.altitude + start.height)  # of the row before
        self.start_lla = np.array(self._lla)
        self._vel: tuple[float, float, float] | None = None
        wind = scenario.wind
        self._wind_n = np.array([-wind.speed * math.cos(wind.from_), -wind.speed * math.sin(wind.from_), 0.0])
        self._events = [Event(0.0, "info", "flight", f"motion '{kind}' begins")]

    def fly(self, n: int) -> Truth:
        """Fly the next up to `n` rows; fewer at the end, none when it is over."""
        n = max(0, min(n, self._rows - self._next))
        t = np.arange(self._next, self._next + n) * self.dt
        self._next += n
        self.done = self._next >= self._rows
        now = Jet(t, np.ones(n), np.zeros(n))
        roll, pitch, heading = self.motion.attitude(now)
        velocity = self.motion.velocity(now)
        vel_n = np.stack([np.broadcast_to(v.x, (n,)) for v in velocity], axis=-1)
        vel_dot = np.stack([np.broadcast_to(v.d, (n,)) for v in velocity], axis=-1)
        lla = self._integrate(vel_n)

        # p = roll' - heading' sin(pitch) and so on; the jets' first derivatives are the angular accelerations
        droll, dpitch, dheading = roll.rate(), pitch.rate(), heading.rate()
        rates = (
            droll - dheading * sin(pitch),
            dpitch * cos(roll) + dheading * (cos(pitch) * sin(roll)),
            dheading * (cos(pitch) * cos(roll)) - dpitch * sin(roll),
        )
        rate_nb_b = np.stack([np.broadcast_to(r.x, (n,)) for r in rates], axis=-1)
        rate_nb_dot_b = np.stack([np.broadcast_to(r.d, (n,)) for r in rates], axis=-1)
        q_nb = attitude.from_half_angles(*(0.5 * np.broadcast_to(angle.x, (n,)) for angle in (roll, pitch, heading)))

        earth_n = wgs84.earth_rate_n(lla[:, 0])
        frame_n = earth_n + wgs84.transport_rate_n(lla, vel_n)  # of NED against the stars
        frame_b = attitude.to_body(q_nb, frame_n)
        # what is left out is how the frame's rate changes with latitude, 1e-10 rad/s2
        frame_dot_b = attitude.to_body(q_nb, wgs84.transport_rate_n(lla, vel_dot)) - np.cross(rate_nb_b, frame_b)
        accel_n = vel_dot + np.cross(earth_n + frame_n, vel_n) - gravity_n(lla)
        air_b = attitude.to_body(q_nb, vel_n - self._wind_n)
        airspeed = np.sqrt(np.sum(air_b**2, axis=1))
        pressure, temperature = standard_atmosphere(lla[:, 2])
        throttle, rpm = self.motion.motor(now)
        columns = blank(Truth, n)
        columns.update(
            t=t,
            lla=lla,
            vel_n=vel_n,
            q_nb=q_nb,
            rate_ib_b=rate_nb_b + frame_b,
            rate_dot_b=rate_nb_dot_b + frame_dot_b,
            accel_b=attitude.to_body(q_nb, accel_n),
            cg_b=np.zeros((n, 3)),
            airspeed=airspeed,
            alpha=np.arctan2(air_b[:, 2], air_b[:, 0]),
            beta=np.arcsin(np.clip(air_b[:, 1] / np.maximum(airspeed, 1e-9), -1.0, 1.0)),
            wind_n=np.tile(self._wind_n, (n, 1)),
            pressure=pressure,
            temperature=temperature,
            rpm=rpm,
            throttle=throttle,
            height_agl=lla[:, 2] - self._ground,
            on_ground=np.full(n, self.motion.on_ground),
        )
        return Truth(**columns)

    def take_setpoints(self) -> Setpoints:
        """None: nobody flies."""
        return Setpoints(**blank(Setpoints, 0))

    def take_events(self) -> list[Event]:
        """Collect the event of the beginning."""
        events, self._events = self._events, []
        return events

    def feedback(self, q_nb: np.ndarray, rate_b: np.ndarray) -> None:
        """Ignore the attitude: a motion has no autopilot."""

    def attachments(self) -> dict[str, bytes]:
        """None: no aircraft."""
        return {}

    def _integrate(self, vel_n: np.ndarray) -> np.ndarray:
        """Integrate velocity (n, 3) to position (n, 3), trapezium rule, row after row."""
        lat, lon, height = self._lla
        last = self._vel
        half = 0.5 * self.dt
        out = []
        for velocity in vel_n.tolist():
            if last is not None:
                w2 = 1.0 - wgs84.E2 * math.sin(lat) ** 2
                prime = wgs84.A / math.sqrt(w2)
                height -= half * (last[2] + velocity[2])
                step = half * (last[0] + velocity[0]) / (prime * (1.0 - wgs84.E2) / w2 + height)
                lon += half * (last[1] + velocity[1]) / ((prime + height) * math.cos(lat + 0.5 * step))
                lat += step
            last = velocity
            out.append((lat, lon, height))
        self._lla, self._vel = (lat, lon, height), last
        return np.array(out).reshape(-1, 3)


def standard_atmosphere(height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pressure (Pa) and temperature (K) of the US Standard Atmosphere 1976 up to 11 km (geometric heights)."""
    temperature = 288.15 - 0.0065 * height
    return 101325.0 * (temperature / 288.15) ** 5.255876, temperature
