"""From the runway into the air and back onto it."""

# ruff: noqa: D102  (`Manoeuvre` documents the methods which every class below defines)

import math

from ahrs_sim.flight.autopilot import Autopilot, State, wrap
from ahrs_sim.flight.manoeuvres.base import FASTEST, Failure, G, Manoeuvre, bank_for, clamp, optional
from ahrs_sim.scenario.table import Table


class Takeoff(Manoeuvre):
    """Take off along the heading at the start, climb straight ahead to `to_height_m` (30; others: by their speed)."""

    name = "takeoff"
    in_flight = False

    def read(self, table: Table) -> None:
        self.given = optional(table, "to_height_m", minimum=10.0)
        self.height = self.given or 30.0
        self.new_airspeed = optional(table, "airspeed_mps", above=0.0, maximum=FASTEST)

    def expected(self) -> float:
        return 10.0 + self.height / 4.0

    def begin(self, ap: Autopilot, state: State) -> None:
        if not state.on_ground and state.height > 3.0 * ap.scale:  # a light one hops on its wheels
            raise Failure("the aircraft is in the air already; leave this step out")
        self.take_airspeed(ap)
        self.height = self.given or 30.0 * ap.scale
        self.started = state.t
        ap.set("motor-on", 1)
        ap.heading_goal = state.home_heading
        ap.altitude_goal = state.altitude + self.height
        ap.heading(ap.heading_goal)
        ap.set("phase", 1)

    def step(self, ap: Autopilot, state: State) -> bool:
        if state.height < self.height:
            return False
        ap.cruise()
        return True

    def progress(self, state: State) -> str:
        return f"at {state.height:.0f} of {self.height:.0f} m, {state.airspeed:.1f} m/s"


class RunUp(Manoeuvre):
    """Run the motor up on the brakes: at `throttle` (0.5) for `for_s` (10), then back to idle."""

    name = "run_up"
    in_flight = False

    def read(self, table: Table) -> None:
        self.throttle = table.number("throttle", 0.5, above=0.0, maximum=1.0)
        self.duration = table.number("for_s", 10.0, above=0.0)

    def expected(self) -> float:
        return self.duration

    def begin(self, ap: Autopilot, state: State) -> None:
        if not state.on_ground:
            raise Failure("the aircraft is in the air; leave this step out")
        self.end = state.t + self.duration
        ap.park()
        ap.set("motor-on", 1)
        ap.throttle(self.throttle)

    def step(self, ap: Autopilot, state: State) -> bool:
        if state.ground_speed > 0.5:
            raise Failure(f"the brakes do not hold throttle {self.throttle:g}; take less")
        if state.t < self.end - 1e-6:
            return False
        ap.throttle(0.0)
        return True


class Approach(Manoeuvre):
    """Fly back to the runway of the start, line up, and come down the glide path until `to_height_m` (12).

    `distance_m` (450) before the start the aircraft joins the runway's line at the height of a glide path of
    `glide_deg` (5) that ends at the start; not lined up at the end, it goes round again. The figures in brackets are
    our trainer's; any other aircraft has its own, from its stall.
    """

    name = "approach"

    def read(self, table: Table) -> None:
        self.given_distance = optional(table, "distance_m", minimum=200.0, maximum=50000.0)
        glide = optional(table, "glide_deg", above=0.0, maximum=15.0)
        self.given_glide = None if glide is None else math.radians(glide)
        self.given_height = optional(table, "to_height_m", minimum=5.0)
        self.bank = math.radians(table.number("bank_deg", 30.0, minimum=10.0, maximum=60.0))

    def expected(self) -> float:
        return 60.0 + (self.given_distance or Autopilot.approach_distance) / 14.0

    def begin(self, ap: Autopilot, state: State) -> None:
        self.distance = self.given_distance or ap.approach_distance
        self.glide = self.given_glide or ap.approach_glide
        self.height = self.given_height or ap.height_before
        self.speed = self.new_airspeed or ap.approach_speed
        # the way back counts for the time-out
        away = math.hypot(state.north, state.east) + 2.0 * self.distance
        self.timeout = max(self.timeout, 120.0 + away / (4.0 * ap.scale))
        self.rounds = 0
        self.join(ap, state)

    def join(self, ap: Autopilot, state: State) -> None:
        """Head for the point where the glide path begins."""
        ap.airspeed_goal = self.speed
        ap.altitude_goal = state.altitude - state.height + max(15.0, self.distance * math.tan(self.glide))
        ap.level()
        self.lined_up = False

    def step(self, ap: Autopilot, state: State) -> bool:
        along, cross = runway(state)
        if not self.lined_up:
            before = along + self.distance  # > 0: past the point of joining
            if (
                before < 60.0 * ap.scale
                and abs(cross) < 60.0 * ap.scale
                and abs(wrap(state.course - state.home_heading)) < 0.5 * math.pi
            ):
                self.lined_up = True
            ap.roll(bank_for(ap, state, self.course_to_join(ap, state, along, cross), limit=self.bank))
            return False
        ap.roll(bank_for(ap, state, runway_course(ap, state, cross), limit=self.bank))
        path = -along * math.tan(self.glide)
        if path > state.height and along < -0.8 * self.distance:
            return False  # level until the glide path comes down to meet the aircraft
        rate = -state.ground_speed * math.tan(self.glide) + 0.4 * (path - state.height)
        ap.climb_rate(clamp(rate, 3.5 * ap.scale))
        if state.height > self.height and along < 0.0:
            return False
        off = wrap(state.course - state.home_heading)
        if abs(cross) < 4.0 * ap.scale and abs(off) < math.radians(10.0) and abs(path - state.height) < 6.0 * ap.scale:
            return True
        self.rounds += 1
        if self.rounds > 2:
            raise Failure(f"not lined up after {self.rounds} tries: {cross:.0f} m beside the runway")
        self.join(ap, state)
        return False

    def course_to_join(self, ap: Autopilot, state: State, along: float, cross: float) -> float:
        """Compute the course to a point so far before the joining point that the last turn ends on the line."""
        radius = state.ground_speed**2 / (G * math.tan(self.bank))
        back = self.distance + 2.5 * radius
        side = math.copysign(2.0 * radius, cross)
        if along > -back and not (abs(cross) < 0.5 * radius and along < -self.distance):
            target_along, target_cross = -back, side  # downwind, beside the line
        else:
            return runway_course(ap, state, cross)
        return state.home_heading + math.atan2(target_cross - cross, target_along - along)

    def progress(self, state: State) -> str:
        along, cross = runway(state)
        return f"{-along:.0f} m before the runway, {cross:.0f} m beside its line, at {state.height:.0f} m"


class Land(Manoeuvre):
    """Continue on the glide path, flare, touch down, roll out and stop; brakes on and motor off at the end."""

    name = "land"

    def read(self, table: Table) -> None:
        glide = optional(table, "glide_deg", above=0.0, maximum=15.0)
        self.given_glide = None if glide is None else math.radians(glide)
        self.flare = optional(table, "flare_height_m", above=0.0, maximum=50.0)

    def expected(self) -> float:
        return 25.0

    def begin(self, ap: Autopilot, state: State) -> None:
        if self.flare is not None:
            ap.set("flare-height-m", self.flare)
        ap.set("glide-angle-rad", self.given_glide or ap.landing_glide)
        ap.airspeed(self.new_airspeed or ap.landing_speed)
        ap.set("phase", 2)
        self.down: float | None = None  # since when it has stood still

    def step(self, ap: Autopilot, state: State) -> bool:
        _, cross = runway(state)
        ap.roll(bank_for(ap, state, runway_course(ap, state, cross), limit=math.radians(15.0)))
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

    def progress(self, state: State) -> str:
        return f"at {state.height:.1f} m, {state.ground_speed:.1f} m/s over ground"


def runway(state: State) -> tuple[float, float]:
    """Locate the aircraft: m along the runway from the start (negative: before it) and m to the right of its line."""
    cos, sin = math.cos(state.home_heading), math.sin(state.home_heading)
    return state.north * cos + state.east * sin, state.east * cos - state.north * sin


def runway_course(ap: Autopilot, state: State, cross: float) -> float:
    """Compute the course that leads onto the runway's line and along it."""
    return state.home_heading - math.radians(50.0) * 2.0 / math.pi * math.atan(cross / ap.line_distance)
