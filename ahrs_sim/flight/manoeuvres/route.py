"""Along a route: to waypoints, round a racetrack, over survey lines, at random, and what calibrates sensors."""

# ruff: noqa: D102  (`Manoeuvre` documents the methods which every class below defines)

import math
from typing import ClassVar, TypeVar

from ahrs_sim.flight.autopilot import Autopilot, State, wrap
from ahrs_sim.flight.manoeuvres.base import Failure, G, Manoeuvre, bank_for, optional
from ahrs_sim.flight.manoeuvres.ordinary import Climb, Straight, Turn
from ahrs_sim.flight.manoeuvres.violent import Doublet
from ahrs_sim.scenario.table import Table

Kind = TypeVar("Kind", bound=Manoeuvre)


class _Height:
    """The height and the climb rate that several steps take."""

    def __init__(self, table: Table) -> None:
        self.height = optional(table, "height_m", above=0.0)
        self.rate = optional(table, "rate_mps", above=0.0, maximum=150.0)

    def take(self, ap: Autopilot, state: State) -> None:
        """Make it what is to be held."""
        if self.height is not None:
            ap.altitude_goal = state.altitude - state.height + self.height
        ap.altitude(ap.altitude_goal, self.rate or ap.climb_speed)


class _Place:
    """A place: north and east of the start, or latitude and longitude; or where the aircraft is."""

    def __init__(self, table: Table) -> None:
        self.metres = self._pair(table, "north_m", "east_m", math.inf, math.inf)
        self.degrees = self._pair(table, "latitude_deg", "longitude_deg", 89.0, 180.0)
        if self.metres and self.degrees:
            raise table.error("latitude_deg", "north_m, east_m and latitude_deg, longitude_deg exclude each other")

    @staticmethod
    def _pair(table: Table, first: str, second: str, most: float, furthest: float) -> tuple[float, float] | None:
        x = optional(table, first, minimum=-most, maximum=most)
        y = optional(table, second, minimum=-furthest, maximum=furthest)
        if (x is None) != (y is None):
            raise table.error(first, f"{first} and {second} belong together; give both or none")
        return None if x is None or y is None else (x, y)

    def locate(self, state: State) -> tuple[float, float]:
        """North and east of the start, m."""
        if self.degrees:
            latitude, longitude, per_latitude, per_longitude = state.home
            north = (math.radians(self.degrees[0]) - latitude) * per_latitude
            return north, wrap(math.radians(self.degrees[1]) - longitude) * per_longitude
        return self.metres or (state.north, state.east)


def radius(state: State, bank: float) -> float:
    """Compute radius of a turn at the present ground speed, m."""
    return state.ground_speed**2 / (G * math.tan(bank))


def line(state: State, north: float, east: float, course: float) -> tuple[float, float]:
    """Find m along a line beyond a place on it, and m to the right of it."""
    cos, sin = math.cos(course), math.sin(course)
    north, east = state.north - north, state.east - east
    return north * cos + east * sin, east * cos - north * sin


def line_course(state: State, cross: float, course: float, bank: float) -> float:
    """Find the course that leads onto a line and along it, without overshooting it at this bank."""
    return course - math.radians(50.0) * 2.0 / math.pi * math.atan(cross / (0.35 * radius(state, bank) + 1.0))


class _ToPlace(Manoeuvre):
    """A step that begins by flying to a place, at a height and with a bank of its own."""

    banks: ClassVar[tuple[float, float]] = (30.0, 60.0)  # deg, `bank_deg` unless given, and its limit

    def read(self, table: Table) -> None:
        self.place = _Place(table)
        self.level = _Height(table)
        usual, most = self.banks
        self.bank = math.radians(table.number("bank_deg", usual, minimum=5.0, maximum=most))

    def steepest(self, airspeed: float) -> float:
        return self.bank

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        ap.level()
        self.level.take(ap, state)
        self.north, self.east = self.place.locate(state)

    def distance(self, state: State) -> float:
        """Horizontal distance to the place, m."""
        return math.hypot(self.north - state.north, self.east - state.east)

    def direct(self, state: State) -> float:
        """Compute course to the place, rad."""
        return math.atan2(self.east - state.east, self.north - state.north)


def leave(ap: Autopilot, heading: float) -> None:
    """Fly on with a heading, rad, which later steps come back to."""
    ap.heading_goal = heading
    ap.heading(heading)


class Goto(_ToPlace):
    """Fly to a waypoint: `north_m`, `east_m` from the start, or `latitude_deg`, `longitude_deg`.

    On the way to `height_m`, if given, at `rate_mps`. It is reached within `radius_m` (a third of the turn's radius at
    `bank_deg`, 30), or without `radius_m` when it has been passed as near as the turn allows.
    """

    name = "goto"

    def read(self, table: Table) -> None:
        super().read(table)
        self.within = optional(table, "radius_m", above=0.0)

    def check(self, table: Table) -> None:
        if not (self.place.metres or self.place.degrees):
            raise table.error("north_m", "missing; give north_m and east_m, or latitude_deg and longitude_deg")

    def expected(self) -> float:
        return 60.0

    def begin(self, ap: Autopilot, state: State) -> None:
        super().begin(ap, state)
        if self.patient:
            self.timeout = 120.0 + 3.0 * self.distance(state) / max(ap.airspeed_goal, 5.0)

    def step(self, ap: Autopilot, state: State) -> bool:
        course = self.direct(state)
        ap.roll(bank_for(ap, state, course, limit=self.bank))
        turn = radius(state, self.bank)
        distance = self.distance(state)
        passed = distance < 2.0 * turn and abs(wrap(course - state.course)) > 0.5 * math.pi
        if not (distance < (self.within or turn / 3.0) or passed):
            return False
        if self.within and distance > self.within and passed:
            return self.round_again(state)
        leave(ap, state.heading)
        return True

    def round_again(self, state: State) -> bool:
        """Passed outside of `radius_m`: it comes round by itself, unless the circle is too small to be met."""
        if self.within and self.within < 0.02 * radius(state, self.bank):
            raise Failure(
                f"radius_m is {self.within:g}, too near for a turn of {radius(state, self.bank):.0f} m radius"
            )
        return False

    def progress(self, state: State) -> str:
        return f"{self.distance(state):.0f} m before the waypoint, at {state.height:.0f} m"


class Hold(_ToPlace):
    """Racetrack over a fix, `times` (1) round: a place as in `goto`, or here; `course_deg` to it, or the present one.

    Legs of `leg_s` (60), turns at `bank_deg` (25) to the right, or to the `left`.
    """

    name = "hold"
    banks = (25.0, 45.0)

    def read(self, table: Table) -> None:
        super().read(table)
        course = optional(table, "course_deg", minimum=-360.0, maximum=360.0)
        self.given = None if course is None else math.radians(course)
        self.leg = table.number("leg_s", 60.0, above=0.0, maximum=3600.0)
        self.times = table.integer("times", 1, minimum=1, maximum=1000)
        self.sign = -1.0 if table.flag("left", False) else 1.0

    def expected(self) -> float:
        return self.times * 2.0 * (self.leg + math.pi * 20.0 / (G * math.tan(self.bank)))

    def begin(self, ap: Autopilot, state: State) -> None:
        super().begin(ap, state)
        self.course = state.course if self.given is None else self.given
        away = self.distance(state)
        turn = math.pi * ap.airspeed_goal / (G * math.tan(self.bank))
        if self.patient:
            self.timeout = 240.0 + 3.0 * away / max(ap.airspeed_goal, 5.0) + 3.0 * self.times * 2.0 * (self.leg + turn)
        self.until = math.inf  # s, the end of the leg outbound
        self.phase = "to the fix"
        self.round = 0

    def step(self, ap: Autopilot, state: State) -> bool:
        along, cross = line(state, self.north, self.east, self.course)
        turn = radius(state, self.bank)
        if self.phase in ("to the fix", "inbound"):
            far = self.phase == "to the fix" and math.hypot(along, cross) > 3.0 * turn
            course = self.direct(state) if far else line_course(state, cross, self.course, self.bank)
            ap.roll(bank_for(ap, state, course, limit=self.bank))
            if along >= 0.0 and abs(cross) < 2.0 * turn and abs(wrap(state.course - self.course)) < 0.5 * math.pi:
                return self.over_the_fix(ap, state)
        elif self.phase == "outbound":
            ap.roll(bank_for(ap, state, self.course + math.pi, limit=self.bank))
            if state.t > self.until:
                self.phase, self.target = "turn inbound", self.course
        else:
            ap.roll(self.sign * self.bank)
            left = self.sign * wrap(self.target - state.course)
            if 0.0 <= left < 0.35:
                outbound = self.phase == "turn outbound"
                self.phase, self.until = ("outbound", state.t + self.leg) if outbound else ("inbound", math.inf)
        return False

    def over_the_fix(self, ap: Autopilot, state: State) -> bool:
        """Count a round; True after the last."""
        if self.phase == "inbound":
            self.round += 1
        if self.round >= self.times:
            leave(ap, self.course)
            return True
        self.phase, self.target = "turn outbound", self.course + math.pi
        return False

    def progress(self, state: State) -> str:
        return f"{self.phase}, {self.round} of {self.times} rounds, at {state.height:.0f} m"


class Survey(_ToPlace):
    """Parallel lines to and fro: `lines` (4) of `length_m` on `course_deg` (0), `spacing_m` apart to the right.

    The first begins at the place, as in `goto`, or here; a negative spacing goes on to the left. Turns at `bank_deg`
    (30) are flown beyond the lines, so that each is followed over its whole length.
    """

    name = "survey"
    RUN_OUT = 7.0  # turn radii beyond the end of a line, which it takes to be on the next

    def read(self, table: Table) -> None:
        super().read(table)
        self.course = math.radians(table.number("course_deg", 0.0, minimum=-360.0, maximum=360.0))
        self.length = table.number("length_m", above=0.0, maximum=1e6)
        self.spacing = table.number("spacing_m", minimum=-1e5, maximum=1e5)
        self.lines = table.integer("lines", 4, minimum=1, maximum=1000)

    def expected(self) -> float:
        return self.lines * (self.length / 20.0 + 60.0)

    def begin(self, ap: Autopilot, state: State) -> None:
        super().begin(ap, state)
        self.line = 0
        self.joined = False
        speed = max(ap.airspeed_goal, 5.0)
        turn = speed**2 / (G * math.tan(self.bank))
        if self.patient:
            self.timeout = 120.0 + 3.0 * (self.distance(state) + self.lines * (self.length + 20.0 * turn)) / speed

    def ends(self) -> tuple[float, float, float]:
        """North and east of where the present line begins, and its course."""
        cos, sin = math.cos(self.course), math.sin(self.course)
        across = self.line * self.spacing
        along = self.length if self.line % 2 else 0.0
        course = self.course + (math.pi if self.line % 2 else 0.0)
        return self.north + along * cos - across * sin, self.east + along * sin + across * cos, course

    def step(self, ap: Autopilot, state: State) -> bool:
        north, east, course = self.ends()
        along, cross = line(state, north, east, course)
        turn = radius(state, self.bank)
        if not self.joined:  # first away from the line's beginning, as far as the turn onto it takes
            back = self.RUN_OUT * turn
            before_north, before_east = north - back * math.cos(course), east - back * math.sin(course)
            self.joined = along < -back or math.hypot(before_north - state.north, before_east - state.east) < turn
            direct = math.atan2(before_east - state.east, before_north - state.north)
            ap.roll(bank_for(ap, state, direct, limit=self.bank))
            return False
        ap.roll(bank_for(ap, state, line_course(state, cross, course, self.bank), limit=self.bank))
        if along < self.length:
            return False
        self.line += 1
        self.joined = False
        if self.line < self.lines:
            return False
        leave(ap, course)
        return True

    def progress(self, state: State) -> str:
        return f"line {self.line + 1} of {self.lines}, at {state.height:.0f} m"


class Random(Manoeuvre):
    """Manoeuvres at random for `for_s`: turns, climbs, descents, straights and changes of speed within the envelope.

    Banks up to `bank_deg` (45), heights from `low_m` to `high_m` (half and one and a half of the present one), not
    further from the start than `within_m` (four minutes of flight). What comes depends on the scenario's seed and on
    the step's number.
    """

    name = "random"

    def read(self, table: Table) -> None:
        self.duration = table.number("for_s", above=0.0, maximum=1e6)
        self.bank = math.radians(table.number("bank_deg", 45.0, minimum=5.0, maximum=75.0))
        self.low, self.high = optional(table, "low_m", above=0.0), optional(table, "high_m", above=0.0)
        self.within = optional(table, "within_m", above=0.0)
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise table.error("high_m", f"is not above low_m, {self.low:g}")

    def expected(self) -> float:
        return self.duration

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        self.timeout = max(self.timeout, self.duration + 60.0)
        self.end = state.t + self.duration
        self.bottom = self.low or 0.5 * state.height
        self.top = self.high or 1.5 * state.height
        self.reach = self.within or 240.0 * ap.airspeed_goal
        self.part: Manoeuvre | None = None
        self.until = state.t

    def step(self, ap: Autopilot, state: State) -> bool:
        if state.t >= self.end - 1e-6:
            ap.heading_goal = state.heading
            ap.altitude_goal = state.altitude
            ap.cruise()
            return True
        if self.part is None or self.part.step(ap, state) or state.t > self.until:
            self.part = self.draw(ap, state)
            self.part.begin(ap, state)
            self.until = state.t + self.part.timeout
        return False

    def draw(self, ap: Autopilot, state: State) -> Manoeuvre:
        """Draw the next manoeuvre."""
        uniform, speed = self.random.uniform, ap.airspeed_goal
        kind = self.random.choice(["turn", "turn", "straight", "height", "speed"])
        if math.hypot(state.north, state.east) > self.reach:
            home = math.degrees(math.atan2(-state.east, -state.north))
            return self.make(Straight, heading_deg=home + uniform(-30.0, 30.0), for_s=uniform(20.0, 40.0))
        if kind == "speed":
            low, high = ap.speeds
            return self.make(Straight, airspeed_mps=uniform(low, high), for_s=uniform(15.0, 40.0))
        if kind == "height":
            height = uniform(self.bottom, self.top)
            step = self.make(Climb, to_height_m=max(height, 1.0))
            step.sign = math.copysign(1.0, height - state.height)
            step.timeout = 120.0
            return step
        if kind == "turn":
            steepest = min(self.bank, 0.9 * ap.steepest(speed))
            bank = math.degrees(uniform(min(0.17, 0.5 * steepest), steepest)) * self.random.choice([-1.0, 1.0])
            return self.make(Turn, bank_deg=bank, for_s=uniform(10.0, 60.0))
        return self.make(Straight, for_s=uniform(5.0, 40.0))

    def make(self, kind: type[Kind], **settings: float) -> Kind:
        """Make a manoeuvre of this one's parts."""
        return kind(Table({key: float(value) for key, value in settings.items()}, self.where))

    def progress(self, state: State) -> str:
        return f"{self.part.name if self.part else 'nothing'}, at {state.height:.0f} m"


class Calibrate(Manoeuvre):
    """Two minutes in the air that show a navigator best what its sensors' errors are.

    Turns up to `bank_deg` (60), slow flight and doublets in the order that makes the Cramer-Rao bound of a flight
    afterwards least (`benchmarks/calibration_flight.py`), each ended in level flight. `ins-cal` learns from it.
    """

    name = "calibrate"

    PARTS: ClassVar[tuple[str | float, ...]] = (
        -60.0, 60.0, "slow", "slow", 60.0, "slow", -60.0, *7 * ("rudder",),
    )  # fmt: skip
    """Banks (deg) of turns of 10 s, "slow" and "fast" flight of 8 s, surfaces of doublets."""

    def read(self, table: Table) -> None:
        self.bank = math.radians(table.number("bank_deg", 60.0, minimum=10.0, maximum=75.0))
        where = f"{table.where}: part"  # keys of the parts are not keys of this step
        made = [self.made(part, where) for part in self.PARTS]
        level = Table({"for_s": 2.0}, where)
        self.parts: list[Manoeuvre] = [one for part in made for one in (part, Straight(level))]

    def made(self, part: str | float, where: str) -> Manoeuvre:
        """Make a part of the sequence."""
        if isinstance(part, float):
            bank = math.copysign(min(abs(part), math.degrees(self.bank)), part)
            return Turn(Table({"bank_deg": bank, "for_s": 10.0}, where))
        if part in ("slow", "fast"):
            return Straight(Table({"for_s": 8.0}, where))
        return Doublet(Table({"surface": part, "size": 0.5}, where))

    def expected(self) -> float:
        return sum(part.expected() for part in self.parts)

    def steepest(self, airspeed: float) -> float:
        return min(self.bank, math.radians(max(abs(part) for part in self.PARTS if isinstance(part, float))))

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        self.speed = ap.airspeed_goal
        self.number = -1
        self.next(ap, state)

    def next(self, ap: Autopilot, state: State) -> None:
        """Begin the next part, at its own speed."""
        self.number += 1
        name = self.PARTS[self.number // 2] if self.number % 2 == 0 else ""
        slow, fast = ap.speeds
        ap.airspeed_goal = slow if name == "slow" else fast if name == "fast" else self.speed
        self.parts[self.number].begin(ap, state)

    def step(self, ap: Autopilot, state: State) -> bool:
        if not self.parts[self.number].step(ap, state):
            return False
        if self.number == len(self.parts) - 1:
            return True
        self.next(ap, state)
        return False

    def progress(self, state: State) -> str:
        part = self.parts[self.number]
        return f"part {self.number // 2 + 1} of {len(self.PARTS)}, {part.name}: {part.progress(state)}"
