"""The manoeuvres a scenario can ask for: one small class each, all of one shape.

A `[[step]]` table names a manoeuvre (`do = "turn"`) and its parameters. `parse_steps` makes objects of them before any
aircraft exists, so that bad input is found first. In flight the pilot calls `begin` once and `step` 50 times a second
until it returns True; a manoeuvre only changes set-points of the autopilot. Heights are above the ground at the start,
angles to the right and upwards are positive.

Every manoeuvre takes `timeout_s`, after which it has failed; those that fly also `airspeed_mps`, a new speed to hold.
"""

# ruff: noqa: D102  (`Manoeuvre` documents the methods which every class below defines)

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.table import Table

if TYPE_CHECKING:
    from ahrs_sim.flight.fdm import Fdm
    from ahrs_sim.flight.pilot import Autopilot, State

G = 9.81  # m/s2
ROLL_RATE = 1.0  # rad/s, with which the autopilot rolls into and out of a turn


class Failure(Exception):
    """A manoeuvre cannot be completed: the reason."""


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def clamp(value: float, limit: float) -> float:
    """`value` within +-`limit`."""
    return max(-limit, min(limit, value))


def bank_for(state: "State", course: float, turn_rate: float = 0.0, limit: float = math.radians(30.0)) -> float:
    """Bank angle that brings the ground track to `course`, on top of a turn at `turn_rate` (rad/s) along a curve.

    Working on the ground track and not on the heading takes care of the wind.
    """
    rate = turn_rate + 0.6 * wrap(course - state.course)
    return clamp(math.atan(state.ground_speed * rate / G), limit)


def optional(table: Table, key: str, **limits: float) -> float | None:
    """A number that may be left out."""
    return table.number(key, None, **limits)


class Manoeuvre:
    """Base of all: `begin`, then `step` until it returns True, within `timeout` seconds."""

    name: ClassVar[str]
    needs_autopilot: ClassVar[bool] = True
    in_flight: ClassVar[bool] = True

    def __init__(self, table: Table) -> None:
        """Read the parameters.

        Raises:
            InputError: a key is missing, unknown or out of range.
        """
        self.where = table.where
        self.new_airspeed = optional(table, "airspeed_mps", above=0.0, maximum=60.0) if self.in_flight else None
        self.read(table)
        self.timeout = table.number("timeout_s", 3.0 * self.expected() + 30.0, above=0.0)
        table.close()

    def read(self, table: Table) -> None:
        """Take this manoeuvre's own keys from `table`."""

    def expected(self) -> float:
        """About how long it takes, s."""
        return 10.0

    def bind(self, fdm: "Fdm") -> None:
        """Look up what is needed of the aircraft."""

    def begin(self, ap: "Autopilot", state: "State") -> None:
        """Called once, before the first `step`."""

    def step(self, ap: "Autopilot", state: "State") -> bool:
        """Adjust the set-points; True when the manoeuvre is complete."""
        raise NotImplementedError

    def progress(self, state: "State") -> str:
        """How far it got, for the message of a time-out."""
        return f"at {state.height:.0f} m, {state.airspeed:.1f} m/s"

    def take_airspeed(self, ap: "Autopilot") -> None:
        """Make `airspeed_mps` the speed to hold, if it was given."""
        if self.new_airspeed is not None:
            ap.airspeed_goal = self.new_airspeed


class Wait(Manoeuvre):
    """Leave everything as it is for `for_s`; on the ground `motor` switches the motor on (idling) or off."""

    name = "wait"
    needs_autopilot = False
    in_flight = False

    def read(self, table: Table) -> None:
        self.duration = table.number("for_s", above=0.0)
        self.motor = table.flag("motor", None) if table.has("motor") else None
        self.needs_autopilot = self.motor is not None  # type: ignore[misc]

    def expected(self) -> float:
        return self.duration

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.end = state.t + self.duration
        if self.motor is not None:
            ap.set("motor-on", float(self.motor))

    def step(self, ap: "Autopilot", state: "State") -> bool:
        return state.t >= self.end - 1e-6


class Set(Manoeuvre):
    """Set any JSBSim `property` to `value`, at once."""

    name = "set"
    needs_autopilot = False
    in_flight = False

    def read(self, table: Table) -> None:
        self.property = table.text("property")
        self.value = table.number("value")

    def expected(self) -> float:
        return 0.0

    def bind(self, fdm: "Fdm") -> None:
        self.put = fdm.setter(self.property, f"{self.where}: property")

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.put(self.value)

    def step(self, ap: "Autopilot", state: "State") -> bool:
        return True


class Takeoff(Manoeuvre):
    """Take off along the heading at the start and climb straight ahead to `to_height_m`."""

    name = "takeoff"
    in_flight = False

    def read(self, table: Table) -> None:
        self.height = table.number("to_height_m", 30.0, minimum=10.0)
        self.new_airspeed = optional(table, "airspeed_mps", above=0.0, maximum=60.0)

    def expected(self) -> float:
        return 10.0 + self.height / 4.0

    def begin(self, ap: "Autopilot", state: "State") -> None:
        if not state.on_ground:
            raise Failure("the aircraft is in the air already; leave this step out")
        self.take_airspeed(ap)
        self.started = state.t
        ap.set("motor-on", 1)
        ap.heading_goal = state.home_heading
        ap.altitude_goal = state.altitude + self.height
        ap.heading(ap.heading_goal)
        ap.set("phase", 1)

    def step(self, ap: "Autopilot", state: "State") -> bool:
        if state.height < self.height:
            return False
        ap.cruise()
        return True

    def progress(self, state: "State") -> str:
        return f"at {state.height:.0f} of {self.height:.0f} m, {state.airspeed:.1f} m/s"


class Climb(Manoeuvre):
    """Climb straight ahead to `to_height_m` at `rate_mps`."""

    name = "climb"
    sign = 1.0

    def read(self, table: Table) -> None:
        self.height = table.number("to_height_m", above=0.0)
        self.rate = table.number("rate_mps", 2.5, above=0.0, maximum=20.0)

    def expected(self) -> float:
        return 40.0 / self.rate

    def begin(self, ap: "Autopilot", state: "State") -> None:
        way = self.sign * (self.height - state.height)
        if way < -5.0:
            other = "descend" if self.sign > 0.0 else "climb"
            raise Failure(f"to_height_m is {self.height:g}, but the aircraft is at {state.height:.0f} m; use {other}")
        self.timeout = max(self.timeout, 20.0 + 3.0 * way / self.rate)
        self.take_airspeed(ap)
        ap.altitude_goal = state.altitude - state.height + self.height
        ap.cruise()
        ap.altitude(ap.altitude_goal, self.rate)

    def step(self, ap: "Autopilot", state: "State") -> bool:
        return self.sign * (self.height - state.height) < 1.0

    def progress(self, state: "State") -> str:
        return f"at {state.height:.0f} of {self.height:.0f} m, climbing {state.climb:.1f} m/s"


class Descend(Climb):
    """Descend straight ahead to `to_height_m` at `rate_mps`."""

    name = "descend"
    sign = -1.0


class Straight(Manoeuvre):
    """Fly straight and level for `for_s`, on `heading_deg` if given (turning to it first)."""

    name = "straight"

    def read(self, table: Table) -> None:
        self.duration = table.number("for_s", 10.0, above=0.0)
        heading = optional(table, "heading_deg", minimum=-360.0, maximum=360.0)
        self.heading = None if heading is None else math.radians(heading)

    def expected(self) -> float:
        return self.duration + (0.0 if self.heading is None else 8.0)

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.take_airspeed(ap)
        if self.heading is not None:
            ap.heading_goal = self.heading
        ap.cruise()
        self.end: float | None = None

    def step(self, ap: "Autopilot", state: "State") -> bool:
        if self.end is None and abs(wrap(state.heading - ap.heading_goal)) < math.radians(10.0):
            self.end = state.t + self.duration
        return self.end is not None and state.t >= self.end - 1e-6

    def progress(self, state: "State") -> str:
        return f"heading {math.degrees(state.heading):.0f} deg"


class Turn(Manoeuvre):
    """Level turn at `bank_deg` (30) or `rate_dps`, through `through_deg` (360) or for `for_s`.

    Negative `through_deg` turns left; so does a negative bank or rate together with `for_s`.
    """

    name = "turn"

    def read(self, table: Table) -> None:
        bank = optional(table, "bank_deg", minimum=-75.0, maximum=75.0)
        rate = optional(table, "rate_dps", minimum=-60.0, maximum=60.0)
        through = optional(table, "through_deg", minimum=-36000.0, maximum=36000.0)
        duration = optional(table, "for_s", above=0.0)
        if bank is not None and rate is not None:
            raise table.error("rate_dps", "bank_deg and rate_dps exclude each other; keep one of them")
        if through is not None and duration is not None:
            raise table.error("for_s", "through_deg and for_s exclude each other; keep one of them")
        if 0.0 in (bank, rate, through):
            raise table.error("do", "a turn through nothing or with wings level is no turn; give it a value")
        if through is None and duration is None:
            through = 360.0 if (bank or rate or 1.0) > 0.0 else -360.0
        if through is not None and through > 0.0 and (bank or rate or 1.0) < 0.0:
            key = "rate_dps" if bank is None else "bank_deg"
            raise table.error(key, "turns left, but through_deg turns right; fix a sign")
        self.sign = math.copysign(1.0, through if through is not None else bank or rate or 1.0)
        self.bank = abs(math.radians(30.0 if bank is None else bank))
        self.rate: float | None = None if rate is None else abs(math.radians(rate))
        self.through: float | None = None if through is None else abs(math.radians(through))
        self.duration = duration

    def expected(self) -> float:
        if self.duration is not None:
            return self.duration
        rate = G * math.tan(self.bank) / 20.0 if self.rate is None else self.rate
        return (self.through or 0.0) / rate + 2.0

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.take_airspeed(ap)
        ap.level()
        self.started = state.t
        self.from_turned = state.turned
        self.from_heading = ap.heading_goal

    def step(self, ap: "Autopilot", state: "State") -> bool:
        bank = self.bank if self.rate is None else math.atan(max(state.airspeed, 10.0) * self.rate / G)
        if self.duration is not None:
            done = state.t - self.started >= self.duration - 1e-6
            if done:
                ap.heading_goal = state.heading
        else:
            assert self.through is not None
            # begin to roll out so early that half the roll-out's turn is left
            lead = G * math.tan(abs(state.roll)) / max(state.airspeed, 10.0) * 0.5 * abs(state.roll) / ROLL_RATE
            done = self.sign * self.turned(state) >= self.through - lead
            if done:
                ap.heading_goal = self.from_heading + self.sign * self.through
        if done:
            ap.heading(ap.heading_goal)
        else:
            ap.roll(self.sign * bank)
        return done

    def turned(self, state: "State") -> float:
        """How far round, rad, from the heading that was to be held before."""
        return state.turned - self.from_turned

    def progress(self, state: "State") -> str:
        if self.through is None:
            return f"turned {math.degrees(self.turned(state)):.0f} deg"
        return f"turned {math.degrees(self.turned(state)):.0f} of {math.degrees(self.sign * self.through):.0f} deg"


class FigureEight(Manoeuvre):
    """Two full turns at `bank_deg` (45), the first to the right, or to the left with a negative bank; `times` over."""

    name = "figure_eight"

    def read(self, table: Table) -> None:
        bank = table.number("bank_deg", 45.0, minimum=-75.0, maximum=75.0)
        if bank == 0.0:
            raise table.error("bank_deg", "wings level is no turn; give it a value")
        times = table.integer("times", 1, minimum=1, maximum=100)
        self.turns = []
        for i in range(2 * times):
            sign = math.copysign(1.0, bank) * (-1.0) ** i
            self.turns.append(Turn(Table({"bank_deg": abs(bank), "through_deg": 360.0 * sign}, table.where)))

    def expected(self) -> float:
        return sum(turn.expected() for turn in self.turns)

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.take_airspeed(ap)
        self.number = 0
        self.turns[0].begin(ap, state)

    def step(self, ap: "Autopilot", state: "State") -> bool:
        if not self.turns[self.number].step(ap, state):
            return False
        self.number += 1
        if self.number == len(self.turns):
            return True
        self.turns[self.number].begin(ap, state)
        return False

    def progress(self, state: "State") -> str:
        return f"circle {self.number + 1} of {len(self.turns)}: {self.turns[self.number].progress(state)}"


class Orbit(Manoeuvre):
    """Circle over a point at `radius_m` (80), `turns` (1) times or through `through_deg`; negative: to the left.

    The centre is `north_m`, `east_m` from the start of the flight, or where the aircraft is when the step begins. The
    circle is one over the ground: the bank changes with the wind.
    """

    name = "orbit"

    def read(self, table: Table) -> None:
        self.radius = table.number("radius_m", 80.0, minimum=20.0)
        turns = optional(table, "turns", minimum=-1000.0, maximum=1000.0)
        through = optional(table, "through_deg", minimum=-360000.0, maximum=360000.0)
        if turns is not None and through is not None:
            raise table.error("turns", "turns and through_deg exclude each other; keep one of them")
        sweep = math.radians(through) if through is not None else 2.0 * math.pi * (1.0 if turns is None else turns)
        if sweep == 0.0:
            raise table.error("through_deg" if through is not None else "turns", "no orbit at all; give it a value")
        self.sign, self.through = math.copysign(1.0, sweep), abs(sweep)
        north, east = optional(table, "north_m"), optional(table, "east_m")
        if (north is None) != (east is None):
            raise table.error("north_m", "north_m and east_m belong together; give both or none")
        self.centre = None if north is None or east is None else (north, east)

    def expected(self) -> float:
        return self.through * self.radius / 20.0 + 10.0

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.take_airspeed(ap)
        ap.level()
        north, east = self.centre or (state.north, state.east)
        self.north, self.east = north, east
        # the way there counts for the time-out
        self.timeout = max(self.timeout, 60.0 + math.hypot(state.north - north, state.east - east) / 5.0)
        self.swept = 0.0
        self.bearing: float | None = None  # from the centre, once on the circle

    def step(self, ap: "Autopilot", state: "State") -> bool:
        north, east = state.north - self.north, state.east - self.east
        distance, bearing = math.hypot(north, east), math.atan2(east, north)
        off = distance - self.radius
        tangent = bearing + self.sign * (0.5 * math.pi + math.atan(off / (0.35 * self.radius)))
        along = self.sign * state.ground_speed / self.radius if abs(off) < 0.5 * self.radius else 0.0
        ap.roll(bank_for(state, tangent, along, math.radians(45.0)))
        if self.bearing is not None:
            self.swept += self.sign * wrap(bearing - self.bearing)
        if self.bearing is not None or abs(off) < 0.1 * self.radius + 2.0:
            self.bearing = bearing
        if self.swept < self.through:
            return False
        ap.heading_goal = state.heading
        ap.heading(ap.heading_goal)
        return True

    def progress(self, state: "State") -> str:
        distance = math.hypot(state.north - self.north, state.east - self.east)
        return (
            f"{math.degrees(self.swept):.0f} of {math.degrees(self.through):.0f} deg round, {distance:.0f} m from the "
            f"centre, {self.radius:.0f} wanted"
        )


class WindupTurn(Manoeuvre):
    """Turn that tightens from level to `bank_deg` (60) at `rate_dps` (4) of bank, held for `hold_s` (3) at the end.

    A negative bank turns left.
    """

    name = "windup_turn"

    def read(self, table: Table) -> None:
        self.bank = math.radians(table.number("bank_deg", 60.0, minimum=-75.0, maximum=75.0))
        self.rate = math.radians(table.number("rate_dps", 4.0, above=0.0))
        self.hold = table.number("hold_s", 3.0, minimum=0.0)
        if self.bank == 0.0:
            raise table.error("bank_deg", "wings level is no turn; give it a value")

    def expected(self) -> float:
        return abs(self.bank) / self.rate + self.hold

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.take_airspeed(ap)
        ap.level()
        self.started = state.t

    def step(self, ap: "Autopilot", state: "State") -> bool:
        elapsed = state.t - self.started
        if elapsed >= self.expected():
            ap.heading_goal = state.heading
            ap.heading(ap.heading_goal)
            return True
        ap.roll(math.copysign(min(abs(self.bank), self.rate * elapsed), self.bank))
        return False


class Doublet(Manoeuvre):
    """`surface` (aileron, elevator, rudder) deflected by `size` (0.3) one way and the other for `for_s` (1) in all.

    It is added to what the holds command; `rest_s` (3) of flight follow it.
    """

    name = "doublet"

    def read(self, table: Table) -> None:
        self.surface = table.choice("surface", ["aileron", "elevator", "rudder"])
        self.size = table.number("size", 0.3, minimum=-1.0, maximum=1.0)
        self.duration = table.number("for_s", 1.0, above=0.0, maximum=20.0)
        self.rest = table.number("rest_s", 3.0, minimum=0.0)

    def expected(self) -> float:
        return self.duration + self.rest

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.take_airspeed(ap)
        ap.cruise()
        self.started = state.t

    def step(self, ap: "Autopilot", state: "State") -> bool:
        elapsed = state.t - self.started + 1e-6
        if elapsed < self.duration:
            ap.set(f"{self.surface}-add-norm", self.size if elapsed < 0.5 * self.duration else -self.size)
        else:
            ap.set(f"{self.surface}-add-norm", 0.0)
        return elapsed >= self.duration + self.rest


class PullUp(Manoeuvre):
    """Pull to `pitch_deg` (30) at `rate_dps` (30), hold it for `hold_s` (1), push back to level flight."""

    name = "pull_up"

    def read(self, table: Table) -> None:
        self.pitch = math.radians(table.number("pitch_deg", 30.0, above=0.0, maximum=70.0))
        self.rate = math.radians(table.number("rate_dps", 30.0, above=0.0, maximum=120.0))
        self.hold = table.number("hold_s", 1.0, minimum=0.0)

    def expected(self) -> float:
        return 2.0 * self.pitch / self.rate + self.hold + 2.0

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.take_airspeed(ap)
        ap.cruise()
        ap.throttle(1.0)
        self.top: float | None = None

    def step(self, ap: "Autopilot", state: "State") -> bool:
        if self.top is None:
            ap.pitch_rate(self.rate)
            if state.pitch >= self.pitch - 0.1 * self.rate:
                self.top = state.t
            return False
        if state.t < self.top + self.hold:
            ap.pitch(self.pitch)
            return False
        ap.pitch_rate(-self.rate)
        if state.pitch > math.radians(5.0):
            return False
        ap.cruise()
        return True

    def progress(self, state: "State") -> str:
        return f"pitch {math.degrees(state.pitch):.0f} deg, {state.airspeed:.1f} m/s"


class Loop(Manoeuvre):
    """Inside loop at a pitch rate of `rate_dps` (70), begun at `entry_mps` (27)."""

    name = "loop"

    def read(self, table: Table) -> None:
        self.rate = math.radians(table.number("rate_dps", 70.0, above=20.0, maximum=140.0))
        self.entry = table.number("entry_mps", 27.0, above=0.0, maximum=60.0)

    def expected(self) -> float:
        return 2.0 * math.pi / self.rate + 10.0

    def begin(self, ap: "Autopilot", state: "State") -> None:
        ap.cruise()
        ap.throttle(1.0)
        self.from_pitched: float | None = None

    def step(self, ap: "Autopilot", state: "State") -> bool:
        if self.from_pitched is None:
            if state.airspeed < self.entry:
                return False
            self.from_pitched = state.pitched - state.pitch
        # near the vertical roll and heading have no meaning: steer by the rate, levelling what is left of a bank
        tilt = math.sin(state.roll) * math.cos(state.pitch)
        ap.roll_rate(clamp(-2.0 * tilt * math.copysign(1.0, math.cos(state.roll)), 1.0))
        ap.pitch_rate(self.rate)
        if state.pitched - self.from_pitched < 2.0 * math.pi - 0.15:
            return False
        ap.cruise()
        return True

    def progress(self, state: "State") -> str:
        if self.from_pitched is None:
            return f"{state.airspeed:.1f} m/s, entry at {self.entry:.1f}"
        return f"{math.degrees(state.pitched - self.from_pitched):.0f} deg of the loop, {state.airspeed:.1f} m/s"


class Roll(Manoeuvre):
    """Aileron roll at `rate_dps` (120) through `through_deg` (360; negative: left), from `pitch_deg` (20) nose up."""

    name = "roll"

    def read(self, table: Table) -> None:
        self.rate = math.radians(table.number("rate_dps", 120.0, above=30.0, maximum=360.0))
        through = table.number("through_deg", 360.0, minimum=-3600.0, maximum=3600.0)
        if through == 0.0:
            raise table.error("through_deg", "a roll through nothing; give it a value")
        self.sign, self.through = math.copysign(1.0, through), abs(math.radians(through))
        self.pitch = math.radians(table.number("pitch_deg", 20.0, minimum=0.0, maximum=60.0))

    def expected(self) -> float:
        return self.through / self.rate + 3.0

    def begin(self, ap: "Autopilot", state: "State") -> None:
        self.take_airspeed(ap)
        ap.cruise()
        ap.throttle(0.8)
        ap.pitch(self.pitch)
        self.from_rolled: float | None = None

    def step(self, ap: "Autopilot", state: "State") -> bool:
        if self.from_rolled is None:
            if state.pitch < self.pitch - math.radians(3.0):
                return False
            self.from_rolled = state.rolled - state.roll
        ap.roll_rate(self.sign * self.rate)
        # keep the nose up: pull when upright, push when inverted
        ap.pitch_rate(clamp(2.0 * (self.pitch - state.pitch), 0.6) * math.cos(state.roll))
        if self.sign * (state.rolled - self.from_rolled) < self.through - 0.2 * self.rate:
            return False
        ap.cruise()
        return True

    def progress(self, state: "State") -> str:
        if self.from_rolled is None:
            return f"pitch {math.degrees(state.pitch):.0f} deg, entry at {math.degrees(self.pitch):.0f}"
        return f"rolled {math.degrees(state.rolled - self.from_rolled):.0f} deg"


class Approach(Manoeuvre):
    """Fly back to the runway of the start, line up, and come down the glide path until `to_height_m` (12).

    `distance_m` (450) before the start the aircraft joins the runway's line at the height of a glide path of
    `glide_deg` (5) that ends at the start; not lined up at the end, it goes round again.
    """

    name = "approach"

    def read(self, table: Table) -> None:
        self.distance = table.number("distance_m", 450.0, minimum=200.0, maximum=5000.0)
        self.glide = math.radians(table.number("glide_deg", 5.0, above=0.0, maximum=15.0))
        self.height = table.number("to_height_m", 12.0, minimum=5.0)
        self.bank = math.radians(table.number("bank_deg", 30.0, minimum=10.0, maximum=60.0))
        self.speed = 17.0 if self.new_airspeed is None else self.new_airspeed

    def expected(self) -> float:
        return 60.0 + self.distance / 14.0

    def begin(self, ap: "Autopilot", state: "State") -> None:
        # the way back counts for the time-out
        self.timeout = max(self.timeout, 120.0 + (math.hypot(state.north, state.east) + 2.0 * self.distance) / 4.0)
        self.rounds = 0
        self.join(ap, state)

    def join(self, ap: "Autopilot", state: "State") -> None:
        """Head for the point where the glide path begins."""
        ap.airspeed_goal = self.speed
        ap.altitude_goal = state.altitude - state.height + max(15.0, self.distance * math.tan(self.glide))
        ap.level()
        self.lined_up = False

    def step(self, ap: "Autopilot", state: "State") -> bool:
        along, cross = runway(state)
        if not self.lined_up:
            before = along + self.distance  # > 0: past the point of joining
            if before < 60.0 and abs(cross) < 60.0 and abs(wrap(state.course - state.home_heading)) < 0.5 * math.pi:
                self.lined_up = True
            ap.roll(bank_for(state, self.course_to_join(state, along, cross), limit=self.bank))
            return False
        ap.roll(bank_for(state, runway_course(state, cross), limit=self.bank))
        path = -along * math.tan(self.glide)
        if path > state.height and along < -0.8 * self.distance:
            return False  # level until the glide path comes down to meet the aircraft
        rate = -state.ground_speed * math.tan(self.glide) + 0.4 * (path - state.height)
        ap.climb_rate(clamp(rate, 3.5))
        if state.height > self.height and along < 0.0:
            return False
        off = wrap(state.course - state.home_heading)
        if abs(cross) < 4.0 and abs(off) < math.radians(10.0) and abs(path - state.height) < 6.0:
            return True
        self.rounds += 1
        if self.rounds > 2:
            raise Failure(f"not lined up after {self.rounds} tries: {cross:.0f} m beside the runway")
        self.join(ap, state)
        return False

    def course_to_join(self, state: "State", along: float, cross: float) -> float:
        """Course to a point ahead of the joining point, so far that the last turn ends on the runway's line."""
        radius = state.ground_speed**2 / (G * math.tan(self.bank))
        back = self.distance + 2.5 * radius
        side = math.copysign(2.0 * radius, cross)
        if along > -back and not (abs(cross) < 0.5 * radius and along < -self.distance):
            target_along, target_cross = -back, side  # downwind, beside the line
        else:
            return runway_course(state, cross)
        return state.home_heading + math.atan2(target_cross - cross, target_along - along)

    def progress(self, state: "State") -> str:
        along, cross = runway(state)
        return f"{-along:.0f} m before the runway, {cross:.0f} m beside its line, at {state.height:.0f} m"


class Land(Manoeuvre):
    """Continue on the glide path, flare, touch down, roll out and stop; brakes on and motor off at the end."""

    name = "land"

    def read(self, table: Table) -> None:
        self.glide = math.radians(table.number("glide_deg", 4.0, above=0.0, maximum=15.0))
        self.flare = optional(table, "flare_height_m", above=0.0, maximum=20.0)
        self.speed = 16.0 if self.new_airspeed is None else self.new_airspeed

    def expected(self) -> float:
        return 25.0

    def begin(self, ap: "Autopilot", state: "State") -> None:
        if self.flare is not None:
            ap.set("flare-height-m", self.flare)
        ap.set("glide-angle-rad", self.glide)
        ap.airspeed(self.speed)
        ap.set("phase", 2)
        self.down: float | None = None  # since when it has stood still

    def step(self, ap: "Autopilot", state: "State") -> bool:
        _, cross = runway(state)
        ap.roll(bank_for(state, runway_course(state, cross), limit=math.radians(15.0)))
        ap.set("heading-cmd-rad", state.home_heading)
        if not state.on_ground or state.ground_speed > 0.3:
            self.down = None
            return False
        if self.down is None:
            self.down = state.t
        if state.t < self.down + 1.0:
            return False
        ap.park()
        ap.set("motor-on", 0)
        return True

    def progress(self, state: "State") -> str:
        return f"at {state.height:.1f} m, {state.ground_speed:.1f} m/s over ground"


def runway(state: "State") -> tuple[float, float]:
    """Where the aircraft is: m along the runway from the start (negative: before it) and m to the right of its line."""
    cos, sin = math.cos(state.home_heading), math.sin(state.home_heading)
    return state.north * cos + state.east * sin, state.east * cos - state.north * sin


def runway_course(state: "State", cross: float) -> float:
    """Course that leads onto the runway's line and along it."""
    return state.home_heading - math.radians(50.0) * 2.0 / math.pi * math.atan(cross / 25.0)


MANOEUVRES: dict[str, type[Manoeuvre]] = {
    cls.name: cls
    for cls in (
        Wait, Takeoff, Climb, Descend, Straight, Turn, Orbit, FigureEight, WindupTurn, Doublet, PullUp, Loop, Roll,
        Approach, Land, Set,
    )
}  # fmt: skip
"""Every manoeuvre by the name a scenario uses."""


def parse_steps(tables: Sequence[Table]) -> tuple[Manoeuvre, ...]:
    """Manoeuvres from a scenario's `[[step]]` tables.

    Raises:
        InputError: an unknown manoeuvre or key, or a value out of range.
    """
    steps = []
    for table in tables:
        name = table.text("do")
        if name not in MANOEUVRES:
            raise InputError(f"{table.where}: do: '{name}' is unknown{nearest(name, MANOEUVRES)}")
        steps.append(MANOEUVRES[name](table))
    return tuple(steps)
