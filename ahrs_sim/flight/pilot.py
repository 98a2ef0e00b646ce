"""The pilot: 50 times a second it looks at the aircraft and changes the set-points of the autopilot.

Position and speed come from the truth; attitude and rates come from the autopilot's own inputs (`ap/in/...`), which are
an estimate when the aircraft flies on one.
"""

import math
from collections.abc import Sequence

import numpy as np

from ahrs_sim.flight.autopilot import Autopilot, State, wrap
from ahrs_sim.flight.columns import FT, Column
from ahrs_sim.flight.design import Design
from ahrs_sim.flight.envelope import check
from ahrs_sim.flight.fdm import Fdm
from ahrs_sim.flight.laws import Body, DesignedAutopilot
from ahrs_sim.flight.manoeuvres import Failure, HandOver, Manoeuvre
from ahrs_sim.flight.truth import Event, Setpoints
from ahrs_sim.scenario import Start
from ahrs_sim.world import wgs84
from ahrs_sim.world.gravity import STANDARD as G
from estimators import rotations


def own_autopilot(fdm: Fdm) -> bool:
    """Test whether the aircraft's XML holds an autopilot with our set-points."""
    return fdm.has("ap/lateral-mode") and fdm.has("ap/in/phi-rad")


class Pilot:
    """Flies the steps one after the other.

    Args:
        fdm: the aircraft, ready to fly.
        steps: manoeuvres in order; none: nobody touches the controls (a script does).
        start: where the flight begins: ground and heading are the runway's.
        dt: s between ticks.
        design: of an aircraft that has no autopilot of its own; None: it has, or nobody flies it.
        airspeed: m/s, calibrated, at the start in the air.

    Raises:
        InputError: a step asks for what the aircraft cannot do, or names an unknown property.
    """

    def __init__(
        self,
        fdm: Fdm,
        steps: Sequence[Manoeuvre],
        start: Start,
        dt: float,
        design: Design | None = None,
        airspeed: float = 0.0,
    ) -> None:
        self._steps = list(steps)
        self._dt = dt
        self._ground = start.altitude
        self._external = False
        self.error: str | None = None
        self.designed: DesignedAutopilot | None = None
        self.autopilot: Autopilot | None = None
        if design is not None:
            self.autopilot = self.designed = DesignedAutopilot(fdm, design, start.altitude)
        elif own_autopilot(fdm):
            self.autopilot = Autopilot(fdm)
        for step in self._steps:
            step.bind(fdm)
        if self.autopilot is not None:
            self.autopilot.handed_over = not any(isinstance(step, HandOver) for step in self._steps)
            check(self._steps, design, airspeed)
        euler = ("phi-rad", "theta-rad", "psi-rad")
        rates = ("p-rad_sec", "q-rad_sec", "r-rad_sec")
        surfaces = ("aileron", "elevator", "rudder", "throttle")
        if self.autopilot is not None and self.designed is None:
            self._get = [fdm.getter(f"ap/in/{x}") for x in euler + rates]
            names = [f"ap/out/{x}-norm" for x in surfaces]
            self._ext = [fdm.setter(f"ap/ext/{x}") for x in euler + rates]
            self._signs = (1.0, 1.0, 1.0, 1.0)
        else:
            self._get = [fdm.getter(f"attitude/{x}") for x in euler] + [fdm.getter(f"velocities/{x}") for x in rates]
            names = [f"fcs/{x}-cmd-norm" for x in surfaces]
            up, right, yaw = self.designed.signs if self.designed else (-1.0, 1.0, -1.0)  # JSBSim's: down, right, left
            self._signs = (right, up, yaw, 1.0)
        self._surfaces = [fdm.getter(name) if fdm.has(name) else lambda: math.nan for name in names]
        self.state = State()
        self.state.turned = self.state.rolled = self.state.pitched = 0.0
        self.state.home_heading = start.heading
        self._origin: tuple[float, float, float, float] | None = None  # latitude, longitude, m per rad of each
        self._number = -1  # of the current step
        self._began = 0.0
        self._setpoints: list[list[float]] = []
        self._events: list[Event] = []

    def park(self) -> None:
        """Before the flight, on the ground: brakes on, motor off."""
        if self.autopilot is not None:
            self.autopilot.heading_goal = self.state.home_heading
            self.autopilot.altitude_goal = self._ground
            self.autopilot.park()

    def hold(self, altitude: float, airspeed: float, heading: float) -> None:
        """Before the flight, in the air: hold altitude (m above sea level), airspeed (m/s) and heading (rad)."""
        if self.autopilot is not None:
            self.autopilot.altitude_goal = altitude
            self.autopilot.airspeed_goal = airspeed
            self.autopilot.heading_goal = heading
            self.autopilot.cruise()

    def feedback(self, q_nb: np.ndarray, rate_b: np.ndarray) -> None:
        """Set attitude (4,) and rates (3,) rad/s of an estimator for the autopilot.

        Ignored: what is not finite, and what comes before the step `hand_over`, where there is one.
        """
        if self.autopilot is None or not self.autopilot.handed_over or not math.isfinite(q_nb.sum() + rate_b.sum()):
            return
        angles = rotations.euler(q_nb)
        if self.designed is not None:
            self.designed.estimate = Body(*angles, *rate_b.tolist())
            return
        if not self._external:
            self.autopilot.set("external", 1)
            self._external = True
        for put, value in zip(self._ext, (*angles, *rate_b.tolist()), strict=True):
            put(value)

    def tick(self, t: float, row: Sequence[float]) -> bool:
        """Act on the state at `t` (raw row of the flight); False when the last step is done or one has failed."""
        self._look(t, row)
        going = self._fly(t)
        asked = self.autopilot.asked if self.autopilot is not None else [math.nan] * 6
        surfaces = [sign * get() for sign, get in zip(self._signs, self._surfaces, strict=True)]
        self._setpoints.append([t, self._number, *asked, *surfaces])
        return going

    def during(self) -> str:
        """Name the step for messages: ` in step 3 (turn)`."""
        return f" in {self._label()}" if 0 <= self._number < len(self._steps) else ""

    def take_setpoints(self) -> Setpoints:
        """Collect set-points since the last call."""
        raw = np.array(self._setpoints).reshape(-1, 12)
        self._setpoints = []
        columns = np.ascontiguousarray(raw[:, [0, 2, 3, 4, 5, 6, 7]].T)
        return Setpoints(
            t=columns[0],
            step=raw[:, 1].astype(np.int32),
            roll=columns[1],
            pitch=columns[2],
            heading=columns[3],
            altitude=columns[4],
            climb_rate=columns[5],
            airspeed=columns[6],
            surfaces=np.ascontiguousarray(raw[:, 8:12]),
        )

    def take_events(self) -> list[Event]:
        """Collect events since the last call."""
        events, self._events = self._events, []
        return events

    def _fly(self, t: float) -> bool:
        if not self._steps:
            return True
        ap, state = self.autopilot, self.state
        try:
            if self._number < 0:
                self._begin(0, t)
            step = self._steps[self._number]
            while step.step(ap, state):  # type: ignore[arg-type]  # checked: a step without autopilot asks for none
                self._events.append(Event(t, "info", "pilot", f"{self._label()} ends"))
                if self._number + 1 == len(self._steps):
                    return False
                self._begin(self._number + 1, t)
                step = self._steps[self._number]
            if t - self._began > step.timeout:
                raise Failure(f"not finished after {step.timeout:.0f} s: {step.progress(state)}")
        except Failure as failure:
            self.error = f"{self._label()}: {failure}"
            self._events.append(Event(t, "error", "pilot", self.error))
            return False
        return True

    def _begin(self, number: int, t: float) -> None:
        self._number = number
        self._began = t
        step = self._steps[number]
        self._events.append(Event(t, "info", "pilot", f"{self._label()} begins"))
        if step.in_flight and self.state.on_ground:
            raise Failure("the aircraft is on the ground; take off first")
        step.begin(self.autopilot, self.state)  # type: ignore[arg-type]

    def _body(self) -> Sequence[float]:
        """Choose attitude and rates that the aircraft is flown on."""
        return self.designed.inputs() if self.designed else [get() for get in self._get]

    def _label(self) -> str:
        return f"step {self._number + 1} ({self._steps[self._number].name})"

    def _look(self, t: float, row: Sequence[float]) -> None:
        """Fill `state` from a raw row of the flight and the autopilot's inputs."""
        state, latitude, longitude = self.state, row[Column.LATITUDE], row[Column.LONGITUDE]
        if self._origin is None:
            meridian, prime = wgs84.radii(np.array(latitude))
            self._origin = (latitude, longitude, float(meridian), float(prime) * math.cos(latitude))
            state.home = self._origin
            state.heading = self._body()[2]
        lat, lon, per_lat, per_lon = self._origin
        state.t = t
        state.north = (latitude - lat) * per_lat
        state.east = (longitude - lon) * per_lon
        state.altitude = row[Column.HEIGHT] * FT
        state.height = state.altitude - self._ground
        state.ground_speed = math.hypot(row[Column.VEL_NORTH], row[Column.VEL_EAST]) * FT
        state.course = math.atan2(row[Column.VEL_EAST], row[Column.VEL_NORTH])
        state.climb = -row[Column.VEL_DOWN] * FT
        state.airspeed = row[Column.AIRSPEED] * FT
        state.load = -row[Column.FORCE_Z] / row[Column.MASS] * FT / G
        state.on_ground = row[Column.WHEELS] > 0.0
        before = state.heading
        state.roll, state.pitch, state.heading, p, state.q, _ = self._body()
        state.turned += wrap(state.heading - before)
        state.rolled += p * self._dt
        state.pitched += state.q * self._dt
