"""What every manoeuvre is, and the steering that several share."""

import math
from typing import ClassVar

import numpy as np

from ahrs_sim.flight.autopilot import Autopilot, State, wrap
from ahrs_sim.flight.fdm import Fdm
from ahrs_sim.scenario.table import Table

G = 9.81  # m/s2, of steering; what the baseline's flights are flown with, so not the standard's digits


class Failure(Exception):
    """A manoeuvre cannot be completed: the reason."""


def clamp(value: float, limit: float) -> float:
    """Clamp `value` to +-`limit`."""
    return max(-limit, min(limit, value))


FASTEST = 400.0  # m/s, that a step may ask for; the aircraft's own limits are known when it is there


def bank_for(
    ap: Autopilot, state: State, course: float, turn_rate: float = 0.0, limit: float = math.radians(30.0)
) -> float:
    """Compute the bank that brings the ground track to `course`, on top of a turn at `turn_rate` (rad/s).

    Working on the ground track and not on the heading takes care of the wind.
    """
    rate = turn_rate + ap.steering * wrap(course - state.course)
    return clamp(math.atan(state.ground_speed * rate / G), limit)


def optional(table: Table, key: str, **limits: float) -> float | None:
    """Read a number that may be left out."""
    return table.number(key, None, **limits)


class Manoeuvre:
    """Base of all: `begin`, then `step` until it returns True, within `timeout` seconds."""

    name: ClassVar[str]
    needs_autopilot: ClassVar[bool] = True
    in_flight: ClassVar[bool] = True
    steady: ClassVar[bool] = True  # what bank it needs it needs for long: the thrust has to hold it

    random: np.random.Generator  # of its own, from the scenario's seed

    def __init__(self, table: Table) -> None:
        """Read the parameters.

        Raises:
            InputError: a key is missing, unknown or out of range.
        """
        self.where = table.where
        self.new_airspeed = optional(table, "airspeed_mps", above=0.0, maximum=FASTEST) if self.in_flight else None
        self.read(table)
        self.patient = not table.has("timeout_s")  # a bigger aircraft may take longer
        self.timeout = table.number("timeout_s", 3.0 * self.expected() + 30.0, above=0.0)
        self.check(table)
        table.close()

    def read(self, table: Table) -> None:
        """Take this manoeuvre's own keys from `table`."""

    def check(self, table: Table) -> None:
        """Refuse keys that do not go together, when all have been read."""

    def expected(self) -> float:
        """About how long it takes, s."""
        return 10.0

    def bind(self, fdm: Fdm) -> None:
        """Look up what is needed of the aircraft."""

    def steepest(self, airspeed: float) -> float:
        """Compute the bank that it needs at an airspeed, rad."""
        return 0.0

    def begin(self, ap: Autopilot, state: State) -> None:
        """Begin; called once, before the first `step`."""

    def step(self, ap: Autopilot, state: State) -> bool:
        """Adjust the set-points; True when the manoeuvre is complete."""
        raise NotImplementedError

    def progress(self, state: State) -> str:
        """Describe how far it got, for the message of a time-out."""
        return f"at {state.height:.0f} m, {state.airspeed:.1f} m/s"

    def take_airspeed(self, ap: Autopilot) -> None:
        """Make `airspeed_mps` the speed to hold, if it was given."""
        if self.new_airspeed is not None:
            ap.airspeed_goal = self.new_airspeed
