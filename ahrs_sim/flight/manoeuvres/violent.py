"""What shakes filters: the bank of a windup turn, deflections, pulls, loops and rolls."""

# ruff: noqa: D102  (`Manoeuvre` documents the methods which every class below defines)

import math

from ahrs_sim.flight.autopilot import Autopilot, State
from ahrs_sim.flight.manoeuvres.base import FASTEST, G, Manoeuvre, clamp, optional
from ahrs_sim.scenario.table import Table


class WindupTurn(Manoeuvre):
    """Turn that tightens from level to `bank_deg` (60) at `rate_dps` (4) of bank, held for `hold_s` (3) at the end.

    A negative bank turns left. With `load_g` instead, the bank is that of a level turn with this load factor, and the
    elevator holds the load factor, not the height; `left` turns left.
    """

    name = "windup_turn"
    steady = False

    def read(self, table: Table) -> None:
        bank = optional(table, "bank_deg", minimum=-80.0, maximum=80.0)
        load = optional(table, "load_g", minimum=1.1, maximum=9.0)
        left = table.flag("left", False)
        self.rate = math.radians(table.number("rate_dps", 4.0, above=0.0))
        self.hold = table.number("hold_s", 3.0, minimum=0.0)
        if bank is not None and load is not None:
            raise table.error("load_g", "bank_deg and load_g exclude each other; keep one of them")
        if bank == 0.0:
            raise table.error("bank_deg", "wings level is no turn; give it a value")
        if left and load is None:
            raise table.error("left", "belongs to load_g; give bank_deg a sign instead")
        self.loaded = load is not None
        self.bank = math.radians(60.0 if bank is None else bank)
        if load is not None:
            self.bank = math.copysign(math.acos(1.0 / load), -1.0 if left else 1.0)

    def expected(self) -> float:
        return abs(self.bank) / self.rate + self.hold

    def steepest(self, airspeed: float) -> float:
        return abs(self.bank)

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        ap.level()
        self.started = state.t
        self.missing = 0.0  # g, integral of what the load factor lacks

    def step(self, ap: Autopilot, state: State) -> bool:
        elapsed = state.t - self.started
        if elapsed >= self.expected():
            ap.heading_goal = state.heading
            if self.loaded:
                ap.cruise()
            ap.heading(ap.heading_goal)
            return True
        bank = min(abs(self.bank), self.rate * elapsed)
        ap.roll(math.copysign(bank, self.bank))
        if self.loaded and bank > 0.5:
            load = 1.0 / math.cos(bank)
            self.missing = clamp(self.missing + 0.02 * (load - state.load), 1.0)
            pull = load + self.missing - math.cos(state.pitch) * math.cos(state.roll)
            ap.pitch_rate(G / max(state.airspeed, 10.0) * pull)
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

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        ap.cruise()
        self.started = state.t

    def step(self, ap: Autopilot, state: State) -> bool:
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

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        ap.cruise()
        ap.throttle(1.0)
        self.top: float | None = None

    def step(self, ap: Autopilot, state: State) -> bool:
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

    def progress(self, state: State) -> str:
        return f"pitch {math.degrees(state.pitch):.0f} deg, {state.airspeed:.1f} m/s"


class Loop(Manoeuvre):
    """Inside loop at a pitch rate of `rate_dps` (70), begun at `entry_mps` (27)."""

    name = "loop"

    def read(self, table: Table) -> None:
        self.rate = math.radians(table.number("rate_dps", 70.0, above=20.0, maximum=140.0))
        self.entry = table.number("entry_mps", 27.0, above=0.0, maximum=FASTEST)

    def expected(self) -> float:
        return 2.0 * math.pi / self.rate + 10.0

    def begin(self, ap: Autopilot, state: State) -> None:
        ap.cruise()
        ap.throttle(1.0)
        self.from_pitched: float | None = None

    def step(self, ap: Autopilot, state: State) -> bool:
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

    def progress(self, state: State) -> str:
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

    def begin(self, ap: Autopilot, state: State) -> None:
        self.take_airspeed(ap)
        ap.cruise()
        ap.throttle(0.8)
        ap.pitch(self.pitch)
        self.from_rolled: float | None = None

    def step(self, ap: Autopilot, state: State) -> bool:
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

    def progress(self, state: State) -> str:
        if self.from_rolled is None:
            return f"pitch {math.degrees(state.pitch):.0f} deg, entry at {math.degrees(self.pitch):.0f}"
        return f"rolled {math.degrees(state.rolled - self.from_rolled):.0f} deg"
