"""The autopilot as manoeuvres see it: what is known of the aircraft, and the set-points they change.

The loops are closed in the aircraft's XML, inside JSBSim's step.
"""

import math
from collections.abc import Callable

from ahrs_sim.flight.fdm import Fdm


def wrap(angle: float) -> float:
    """Wrap an angle into [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


class State:
    """Holds the state of the aircraft at one moment; SI, radians, position relative to the start of the flight."""

    __slots__ = (
        "airspeed", "altitude", "climb", "course", "east", "ground_speed", "heading", "height", "home", "home_heading",
        "load", "north", "on_ground", "pitch", "pitched", "q", "roll", "rolled", "t", "turned",
    )  # fmt: skip

    t: float  # s
    north: float  # m from the start
    east: float  # m
    altitude: float  # m above sea level
    height: float  # m above the ground at the start
    climb: float  # m/s
    ground_speed: float  # m/s
    course: float  # of the ground track
    airspeed: float  # m/s, true
    load: float  # specific force upwards along the body, in g
    roll: float
    pitch: float
    heading: float
    q: float  # rad/s, pitch rate
    on_ground: bool
    turned: float  # heading without jumps: change since the flight began
    rolled: float  # integral of the roll rate
    pitched: float  # integral of the pitch rate: a loop is 2 pi
    home: tuple[float, float, float, float]  # latitude and longitude of the start, m per radian of each there
    home_heading: float  # of the runway: the heading at the start


class Autopilot:
    """The set-points of `aircraft/*/autopilot.xml` (documented there), and what they are for the log.

    `altitude_goal`, `heading_goal` and `airspeed_goal` are what the aircraft is cleared for: manoeuvres come back to
    them, so that a chain of steps does not drift.
    """

    # what manoeuvres do where the scenario does not say
    roll_rate_limit = 1.0  # rad/s
    climb_limit = 3.0  # m/s
    climb_speed = 2.5  # m/s, of the steps climb and descend
    approach_speed = 17.0  # m/s
    landing_speed = 16.0  # m/s
    approach_distance = 450.0  # m before the runway
    approach_glide = math.radians(5.0)
    landing_glide = math.radians(4.0)
    scale = 1.0  # of distances and heights near the runway
    steering = 0.6  # 1/s, turn rate per error of the ground track
    line_distance = 25.0  # m beside the runway's line, where it is steered to at half of the steepest angle
    height_before = 12.0  # m, at which an approach ends
    speeds = (16.0, 26.0)  # m/s, between which it flies any manoeuvre

    def __init__(self, fdm: Fdm) -> None:
        self._fdm = fdm
        self._set: dict[str, Callable[[float], object]] = {}
        self.altitude_goal = 0.0
        self.heading_goal = 0.0
        self.airspeed_goal = 20.0
        self.handed_over = True  # fly on the estimate, if there is one
        self.asked = [math.nan] * 6  # roll, pitch, heading, altitude, climb rate, airspeed

    def set(self, name: str, value: float) -> None:
        """Write `ap/name`."""
        try:
            self._set[name](value)
        except KeyError:
            self._set[name] = self._fdm.setter(f"ap/{name}")
            self._set[name](value)

    def get(self, name: str) -> float:
        """Read `ap/name`; for rare use."""
        return self._fdm[f"ap/{name}"]

    def steepest(self, airspeed: float) -> float:
        """Steepest bank that is held at an airspeed, rad."""
        return math.acos(min(1.0, (13.0 / airspeed) ** 2))

    def roll(self, angle: float) -> None:
        """Hold a bank angle."""
        self.set("lateral-mode", 1)
        self.set("roll-cmd-rad", angle)
        self.asked[0], self.asked[2] = angle, math.nan

    def heading(self, angle: float, bank_limit: float = math.radians(30.0)) -> None:
        """Turn to a heading, the shortest way, and hold it."""
        self.set("lateral-mode", 2)
        self.set("bank-limit-rad", bank_limit)
        self.set("heading-cmd-rad", angle)
        self.asked[0], self.asked[2] = math.nan, angle % (2.0 * math.pi)

    def roll_rate(self, rate: float) -> None:
        """Hold a roll rate."""
        self.set("lateral-mode", 3)
        self.set("roll-rate-cmd-rad_sec", rate)
        self.asked[0] = self.asked[2] = math.nan

    def pitch(self, angle: float) -> None:
        """Hold a pitch angle."""
        self.set("vertical-mode", 1)
        self.set("pitch-cmd-rad", angle)
        self.asked[1], self.asked[3], self.asked[4] = angle, math.nan, math.nan

    def altitude(self, altitude: float, rate: float | None = None) -> None:
        """Go to an altitude (m above sea level) at `rate` (m/s) and hold it."""
        self.set("vertical-mode", 2)
        self.set("climb-limit-mps", self.climb_limit if rate is None else rate)
        self.set("altitude-cmd-m", altitude)
        self.asked[1], self.asked[3], self.asked[4] = math.nan, altitude, math.nan

    def climb_rate(self, rate: float) -> None:
        """Hold a climb rate."""
        self.set("vertical-mode", 3)
        self.set("climb-rate-cmd-mps", rate)
        self.asked[1], self.asked[3], self.asked[4] = math.nan, math.nan, rate

    def pitch_rate(self, rate: float) -> None:
        """Hold a pitch rate."""
        self.set("vertical-mode", 4)
        self.set("pitch-rate-cmd-rad_sec", rate)
        self.asked[1] = self.asked[3] = self.asked[4] = math.nan

    def airspeed(self, speed: float) -> None:
        """Hold an airspeed with the throttle."""
        self.set("throttle-mode", 1)
        self.set("airspeed-cmd-mps", speed)
        self.asked[5] = speed

    def throttle(self, setting: float) -> None:
        """Fix the throttle, 0 to 1."""
        self.set("throttle-mode", 0)
        self.set("throttle-cmd-norm", setting)
        self.asked[5] = math.nan

    def level(self) -> None:
        """Altitude, airspeed and coordination as cleared; the roll axis is left alone."""
        self.set("phase", 0)
        self.set("motor-on", 1)
        self.set("brake-cmd-norm", 0)
        self.set("yaw-mode", 1)
        self.altitude(self.altitude_goal)
        self.airspeed(self.airspeed_goal)

    def cruise(self) -> None:
        """Hold height, speed and heading as cleared."""
        self.level()
        self.heading(self.heading_goal)

    def park(self) -> None:
        """Stand: controls neutral, throttle closed, brakes on."""
        self.set("phase", 0)
        for axis, surface in (("lateral", "aileron"), ("vertical", "elevator"), ("yaw", "rudder")):
            self.set(f"{axis}-mode", 0)
            self.set(f"{surface}-cmd-norm", 0)
        self.throttle(0.0)
        self.set("brake-cmd-norm", 1)
        self.asked = [math.nan] * 6
