"""Waiting, and what any flight consists of: straight, up, down and round."""

# ruff: noqa: D102  (`Manoeuvre` documents the methods which every class below defines)

import math

from ahrs_sim.flight.autopilot import Autopilot, State, wrap
from ahrs_sim.flight.fdm import Fdm
from ahrs_sim.flight.manoeuvres.base import Failure, G, Manoeuvre, bank_for, optional
from ahrs_sim.scenario.table import Table


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

    def begin(self, ap: Autopilot, state: State) -> None:
        self.end = state.t + self.duration
        if self.motor is not None:
            ap.set("motor-on", float(self.motor))

    def step(self, ap: Autopilot, state: State) -> bool:
        return state.t >= self.end - 1e-6


class HandOver(Manoeuvre):
    """Up to here the autopilot flies on the truth, from here on on the estimator of `[pilot] attitude`.

    Without this step it flies on the estimator as soon as that has an estimate.
    """

    name = "hand_over"
    in_flight = False

    def expected(self) -> float:
        return 0.0

    def begin(self, ap: "Autopilot", state: "State") -> None:
        ap.handed_over = True

    def step(self, ap: "Autopilot", state: "State") -> bool:
        return True


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

    def bind(self, fdm: Fdm) -> None:
        self.put = fdm.setter(self.property, f"{self.where}: property")

    def begin(self, ap: Autopilot, state: State) -> None:
        self.put(self.value)

    def step(self, ap: Autopilot, state: State) -> bool:
        return True


class Climb(Manoeuvre):
    """Climb straight ahead to `to_height_m` at `rate_mps` (2.5; any other aircraft than ours: its own)."""

    name = "climb"
    sign = 1.0

    def read(self, table: Table) -> None:
        self.height = table.number("to_height_m", above=0.0)
        self.given = optional(table, "rate_mps", above=0.0, maximum=150.0)

    def expected(self) -> float:
        return 40.0 / (self.given or Autopilot.climb_speed)

    def begin(self, ap: Autopilot, state: State) -> None:
        way = self.sign * (self.height - state.height)
        if way < -5.0:
            other = "descend" if self.sign > 0.0 else "climb"
            raise Failure(f"to_height_m is {self.height:g}, but the aircraft is at {state.height:.0f} m; use {other}")
        rate = self.given or ap.climb_speed
        self.timeout = max(self.timeout, 20.0 + 3.0 * way / rate)
        self.take_airspeed(ap)
        ap.altitude_goal = state.altitude - state.height + self.height
        ap.cruise()
        ap.altitude(ap.altitude_goal, rate)

    def step(self, ap: Autopilot, state: State) -> bool:
        return self.sign * (self.height - state.height) < 1.0

    def progress(self, state: State) -> str:
        return f"at {state.height:.0f} of {self.height:.0f} m, climbing {state.climb:.1f} m/s"


class Descend(Climb):
    """Descend straight ahead to `to_height_m` at `rate_mps` (as `climb`)."""

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

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        if self.heading is not None:
            ap.heading_goal = self.heading
        ap.cruise()
        self.end: float | None = None

    def step(self, ap: Autopilot, state: State) -> bool:
        if self.end is None and abs(wrap(state.heading - ap.heading_goal)) < math.radians(10.0):
            self.end = state.t + self.duration
        return self.end is not None and state.t >= self.end - 1e-6

    def progress(self, state: State) -> str:
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

    def steepest(self, airspeed: float) -> float:
        return self.bank if self.rate is None else math.atan(airspeed * self.rate / G)

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        ap.level()
        self.started = state.t
        self.from_turned = state.turned
        self.from_heading = ap.heading_goal

    def step(self, ap: Autopilot, state: State) -> bool:
        bank = self.bank if self.rate is None else math.atan(max(state.airspeed, 10.0) * self.rate / G)
        if self.duration is not None:
            done = state.t - self.started >= self.duration - 1e-6
            if done:
                ap.heading_goal = state.heading
        else:
            assert self.through is not None
            # begin to roll out so early that half the roll-out's turn is left
            lead = (
                G * math.tan(abs(state.roll)) / max(state.airspeed, 10.0) * 0.5 * abs(state.roll) / ap.roll_rate_limit
            )
            done = self.sign * self.turned(state) >= self.through - lead
            if done:
                ap.heading_goal = self.from_heading + self.sign * self.through
        if done:
            ap.heading(ap.heading_goal)
        else:
            ap.roll(self.sign * bank)
        return done

    def turned(self, state: State) -> float:
        """Compute the angle turned, rad, from the heading that was to be held before."""
        return state.turned - self.from_turned

    def progress(self, state: State) -> str:
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

    def steepest(self, airspeed: float) -> float:
        return self.turns[0].bank

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        self.number = 0
        self.turns[0].begin(ap, state)

    def step(self, ap: Autopilot, state: State) -> bool:
        if not self.turns[self.number].step(ap, state):
            return False
        self.number += 1
        if self.number == len(self.turns):
            return True
        self.turns[self.number].begin(ap, state)
        return False

    def progress(self, state: State) -> str:
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

    def steepest(self, airspeed: float) -> float:
        return math.atan(airspeed**2 / (self.radius * G))

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        ap.level()
        north, east = self.centre or (state.north, state.east)
        self.north, self.east = north, east
        # the way there counts for the time-out
        self.timeout = max(self.timeout, 60.0 + math.hypot(state.north - north, state.east - east) / 5.0)
        self.swept = 0.0
        self.bearing: float | None = None  # from the centre, once on the circle

    def step(self, ap: Autopilot, state: State) -> bool:
        north, east = state.north - self.north, state.east - self.east
        distance, bearing = math.hypot(north, east), math.atan2(east, north)
        off = distance - self.radius
        tangent = bearing + self.sign * (0.5 * math.pi + math.atan(off / (0.35 * self.radius)))
        along = self.sign * state.ground_speed / self.radius if abs(off) < 0.5 * self.radius else 0.0
        ap.roll(bank_for(ap, state, tangent, along, math.radians(45.0)))
        if self.bearing is not None:
            self.swept += self.sign * wrap(bearing - self.bearing)
        if self.bearing is not None or abs(off) < 0.1 * self.radius + 2.0:
            self.bearing = bearing
        if self.swept < self.through:
            return False
        ap.heading_goal = state.heading
        ap.heading(ap.heading_goal)
        return True

    def progress(self, state: State) -> str:
        distance = math.hypot(state.north - self.north, state.east - self.east)
        return (
            f"{math.degrees(self.swept):.0f} of {math.degrees(self.through):.0f} deg round, {distance:.0f} m from the "
            f"centre, {self.radius:.0f} wanted"
        )
