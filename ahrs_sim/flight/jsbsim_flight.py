"""A flight of JSBSim's: truth at every step, the pilot 50 times a second.

Which property says what is not obvious, and several obvious ones are wrong:

* `velocities/{p,q,r}-rad_sec` are relative to the rotating Earth; a gyro reads `{pi,qi,ri}`.
* `accelerations/N*`, `a-pilot-*` and `<accelerometer>` are one step stale; specific force is
  `forces/fb*-total-lbs / inertia/mass-slugs`, which leaves out weight and includes the wheels.
* `position/geod-alt-ft` is the height above the ellipsoid; `h-sl-ft` is measured along the radius.

After `run()` state, forces and accelerations belong to the same instant.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError
from ahrs_sim.flight.columns import (
    ANGULAR_ACCELERATION,
    CENTRE_OF_GRAVITY,
    EULER_ANGLES,
    FORCE,
    FT,
    INCH,
    OPTIONAL,
    PLACE,
    RATES,
    SCALE,
    VELOCITY,
    WIND,
    Column,
)
from ahrs_sim.flight.design import Design, design
from ahrs_sim.flight.fdm import Fdm, configure, script_path, trims
from ahrs_sim.flight.laws import RATE
from ahrs_sim.flight.manoeuvres import Manoeuvre, parse_steps
from ahrs_sim.flight.pilot import Pilot, own_autopilot
from ahrs_sim.flight.truth import Event, Setpoints, Truth
from ahrs_sim.flight.turbulence import RoughAir
from ahrs_sim.scenario import Gust, Scenario, Start, seeds
from ahrs_sim.world import gravity, wgs84

EULER, ADAMS_BASHFORTH_2, BUSS_2 = 1, 3, 7  # JSBSim's integrators

PILOT_RATE = 50.0  # Hz
SETTLE_GROUND = 4.0  # s until the springs of the wheels are at rest
SETTLE_AIR = 15.0  # s until motor, trim and holds are
TRIMMED_BY = 120.0  # s of a script that are looked at for a trim
JUMP = 0.5  # m within a step that no velocity explains
HARD = 6.0  # m/s, sink rate at touchdown that no wheel survives


class JsbsimFlight:
    """A flight as the pipeline sees it (see `ahrs_sim.flight.Flight`).

    Raises:
        InputError: unknown aircraft, script, manoeuvre or property, impossible start or gusts.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.error: str | None = None
        self.dt = 1.0 / scenario.rate
        if scenario.pilot_attitude != "truth" and scenario.script is not None:
            raise InputError(f"{scenario.where}: [pilot]: attitude: a script flies without our autopilot; leave it out")
        steps = parse_steps(scenario.steps, scenario.seed)  # before JSBSim starts: bad input is the cheapest error
        _check_gusts(scenario)
        self._events: list[Event] = []
        self._before: np.ndarray | None = None  # the row before, for a script that jumps
        self._skipped = 0.0  # s of a script before row 0
        self._fdm = fdm = Fdm(self.dt)
        end = math.inf if scenario.duration is None else scenario.duration
        self._scripted = scenario.script is not None
        if scenario.script is not None:
            script_end = fdm.load_script(scenario.script, scenario.where, _own_aircraft(scenario))
            model = fdm.exec.get_model_name()
            if Path(scenario.aircraft).stem not in ("", model):
                raise InputError(
                    f"{scenario.where}: aircraft: script '{scenario.script}' flies '{model}', not "
                    f"'{scenario.aircraft}'; leave aircraft out"
                )
            jumps = trims(script_path(scenario.script, scenario.where))
            self._skipped = _last_trim(scenario, self.dt, script_end) if jumps else 0.0
            if script_end is not None:
                end = min(end, script_end - self._skipped)
        else:
            fdm.load_aircraft(scenario.aircraft, scenario.where)
        self._design = self._known(scenario, steps)
        self._rows = math.inf if end == math.inf else math.floor(end * scenario.rate + 1e-6) + 1
        fdm["simulation/randomseed"] = seeds.integer(scenario.seed, "flight")
        self._every = max(1, round(scenario.rate / PILOT_RATE))
        self._airspeed = self._start_speed(scenario)
        if self._scripted:
            fdm.exec.run_ic()
        else:
            self._start(scenario)
        fdm["simulation/integrator/position/rotational"] = BUSS_2  # the default drifts 0.09 deg in 600 s
        self._integrators = [fdm.setter(f"simulation/integrator/rate/{x}") for x in ("rotational", "translational")]
        self._low = fdm["metrics/bw-ft"]  # ft, below which the ground is near: the wing span
        self._near_ground = False
        self._choose_integrators(True)
        self._wind(scenario)
        self._gusts = list(scenario.wind.gusts)
        self._get = [_reader(fdm, column) for column in Column]
        self._contacts = _contacts(fdm)
        self._pilot = Pilot(fdm, steps, scenario.start, self.dt * self._every, self._design, self._airspeed)
        self._control_every = max(1, round(scenario.rate / RATE)) if self._design else 0
        if scenario.pilot_attitude != "truth" and self._pilot.autopilot is None:
            model = fdm.exec.get_model_name()
            raise InputError(f"{scenario.where}: [pilot]: attitude: '{model}' has not our autopilot; leave it out")
        air = RoughAir.wanted(scenario.wind)
        self._air = RoughAir(fdm, scenario.wind, scenario.seed, self._every) if air else None
        self._settle(scenario)
        place = [fdm[column.source] * column.factor for column in list(Column)[PLACE]]
        self.start_lla = np.array(place)
        self._run = fdm.exec.run
        self._next = 0  # number of the next row
        self._last: list[float] = []  # raw values of the last row
        self._resting = [wow() > 0.0 for wow in self._contacts]  # skids: a contact that is there from the start
        self.done = False
        self.expected_duration: float | None = end if end < math.inf else None
        if steps and self._design is None:  # what other aircraft need for a step depends on their speeds
            expected = sum(step.expected() for step in steps)
            self.expected_duration = min(expected, end)

    # -- what the pipeline calls

    def fly(self, n: int) -> Truth:
        """Fly the next up to `n` rows; fewer when the flight ends, none when it is over."""
        raw = np.empty((n, len(Column)))
        k = 0
        get, every = self._get, self._every
        run, air = self._run, self._air
        if self._next == 0 and n > 0 and not self.done:
            self._last = [g() for g in get]
            raw[0] = self._last
            self._next = k = 1
        while k < n and not self.done:
            since = (self._next - 1) % every  # rows since the pilot last acted
            if since == 0 and not self._tick((self._next - 1) * self.dt):
                break
            stop = min(n, k + every - since)
            first = k
            row = self._last
            try:
                while k < stop:
                    if air is not None:
                        air.step()
                    if self._control_every and (self._next + k - first - 1) % self._control_every == 0:
                        self._control()
                    if not run():
                        self._finish(None)
                        break
                    raw[k] = row = [g() for g in get]
                    k += 1
            except RuntimeError as error:  # JSBSim gives up, e.g. on a position that is not a number
                self._finish(f"JSBSim stopped{self._pilot.during()}: {' '.join(str(error).split())}")
            self._last = row
            self._next += k - first
        return self._truth(raw[:k])

    def take_setpoints(self) -> Setpoints:
        """Collect the pilot's set-points since the last call."""
        return self._pilot.take_setpoints()

    def take_events(self) -> list[Event]:
        """Collect events since the last call."""
        events = sorted(self._events + self._pilot.take_events(), key=lambda event: event.t)
        self._events = []
        return events

    def feedback(self, q_nb: np.ndarray, rate_b: np.ndarray) -> None:
        """Set attitude (4,) and body rate (3,) rad/s that the autopilot flies on; NaN is ignored."""
        self._pilot.feedback(q_nb, rate_b)

    def attachments(self) -> dict[str, bytes]:
        """Collect the XML files of aircraft and script, and the design of an aircraft without its own autopilot."""
        found = {"design.json": self._design.text().encode()} if self._design else {}
        return {**self._fdm.attachments(), **found}

    # -- set-up

    def _known(self, scenario: Scenario, steps: Sequence[Manoeuvre]) -> Design | None:
        """Find the design of an aircraft that has no autopilot of its own, where one is needed."""
        needed = scenario.pilot_attitude != "truth" or any(step.needs_autopilot for step in steps)
        if self._scripted or not needed or own_autopilot(self._fdm):
            return None
        return design(scenario.aircraft, scenario.where)

    def _start_speed(self, scenario: Scenario) -> float:
        """Calibrated airspeed at the start, m/s: an aircraft that is not ours cruises where nobody says."""
        start = scenario.start
        if self._design is None or "airspeed_mps" in scenario.data.get("start", {}) or start.on_ground:
            return start.airspeed
        return self._design.cruise

    def _start(self, scenario: Scenario) -> None:
        fdm, start = self._fdm, scenario.start
        latitude, longitude = start.latitude, start.longitude
        if self._settles(scenario):  # fly in from behind, to be at the start when it begins
            speed_n = self._airspeed * math.cos(start.heading) - scenario.wind.speed * math.cos(scenario.wind.from_)
            speed_e = self._airspeed * math.sin(start.heading) - scenario.wind.speed * math.sin(scenario.wind.from_)
            meridian, prime = wgs84.radii(np.array(latitude))
            latitude -= speed_n * SETTLE_AIR / float(meridian)
            longitude -= speed_e * SETTLE_AIR / (float(prime) * math.cos(latitude))
        fdm["ic/terrain-elevation-ft"] = start.altitude / FT
        fdm["ic/lat-geod-rad"] = latitude
        fdm["ic/long-gc-rad"] = longitude
        fdm["ic/psi-true-rad"] = start.heading
        if self._design is not None:
            configure(fdm, 0.0, float(start.on_ground))
        if start.on_ground:
            fdm["ic/h-agl-ft"] = 10.0
            fdm.begin()  # now the centre of gravity is known
            wheels = [fdm[f"{unit}/z-position"] for unit in _units(fdm, "gear/unit") or _units(fdm, "contact/unit")]
            above = fdm["inertia/cg-z-in"] - min(wheels, default=0.0)
            fdm["ic/h-agl-ft"] = above * INCH / FT
            fdm["ic/vt-fps"] = 0.0
        else:
            fdm["ic/h-agl-ft"] = start.height / FT
            fdm["ic/vt-fps"] = self._airspeed / FT
            fdm["ic/phi-rad"] = start.roll
            fdm["ic/theta-rad"] = start.pitch
            if self._design is not None:
                self._fly_in(start)
        fdm.begin()
        if (
            not start.on_ground
            and not fdm.has("ap/motor-on")
            and self._design is None
            and fdm.has("propulsion/set-running")
        ):
            fdm["propulsion/set-running"] = -1  # piston and jet engines of the library

    def _fly_in(self, start: Start) -> None:
        """Begin in the trim of the airspeed."""
        assert self._design is not None
        self._fdm["ic/vc-kts"] = self._airspeed / 0.514444
        self._fdm["ic/theta-rad"] = start.pitch + self._design.at(self._airspeed, lambda row: row.theta)
        self._fdm["ic/alpha-rad"] = self._design.at(self._airspeed, lambda row: row.alpha)
        self._fdm["ic/phi-rad"] = start.roll

    def _control(self) -> None:
        """Let the autopilot of an aircraft that has none of its own move the controls."""
        assert self._pilot.designed is not None
        self._pilot.designed.run(self.dt * self._control_every)

    def _wind(self, scenario: Scenario) -> None:
        fdm, wind = self._fdm, scenario.wind
        if wind.speed > 0.0 or not self._scripted:
            fdm["atmosphere/wind-north-fps"] = -wind.speed * math.cos(wind.from_) / FT
            fdm["atmosphere/wind-east-fps"] = -wind.speed * math.sin(wind.from_) / FT
        if wind.turbulence != "none":
            fdm["atmosphere/turb-type"] = 0  # a script's own; ours comes from `RoughAir`

    def _settles(self, scenario: Scenario) -> bool:
        """Decide whether to fly a few seconds before the flight begins: in the air, level, under our autopilot."""
        start = scenario.start
        flown = self._fdm.has("ap/motor-on") or self._design is not None
        return not start.on_ground and flown and start.roll == start.pitch == 0.0

    def _settle(self, scenario: Scenario) -> None:
        """Let the transient of the start pass before row 0."""
        if self._scripted:
            for _ in range(round(self._skipped / self.dt)):
                self._fdm.exec.run()
            if self._skipped:
                text = f"the script trims at {self._skipped:.2f} s and moves the aircraft: the flight begins after it"
                self._events.append(Event(0.0, "info", "flight", text))
            return
        start = scenario.start
        if start.on_ground:
            self._pilot.park()
            seconds = SETTLE_GROUND
        else:
            self._pilot.hold(start.altitude + start.height, self._airspeed, start.heading)
            seconds = SETTLE_AIR if self._settles(scenario) else 0.0
        for k in range(round(seconds / self.dt)):
            if self._air is not None:
                if k % self._every == 0:
                    self._look_ahead([g() for g in self._get])
                self._air.step()
            if self._control_every and k % self._control_every == 0:
                self._control()
            self._fdm.exec.run()

    # -- in flight

    def _tick(self, t: float) -> bool:
        """50 times a second, before the step that follows row `t`: crash, gusts, pilot. False: the flight is over."""
        row = self._last
        if self._next >= self._rows:
            self._finish(None)
            return False
        if not math.isfinite(row[Column.HEIGHT_AGL]):
            self.done = True  # `_truth` finds the first bad row and says so
            return False
        self._choose_integrators(row[Column.HEIGHT_AGL] < self._low)
        if not self._scripted and (reason := self._crash(row)):
            self._events.append(Event(t, "error", "flight", f"crash: {reason}"))
            self._finish(f"crash at {t:.1f} s{self._pilot.during()}: {reason}")
            return False
        while self._gusts and self._gusts[0].at <= t:
            self._gust(t, self._gusts.pop(0))
        if not self._pilot.tick(t, row):
            self._finish(self._pilot.error)
            return False
        self._look_ahead(row)
        return True

    def _look_ahead(self, row: list[float]) -> None:
        """Compute the air until the pilot acts again."""
        if self._air is not None:
            velocity = [FT * x for x in row[VELOCITY]]
            self._air.ahead(FT * row[Column.HEIGHT_AGL], velocity, row[EULER_ANGLES])

    def _choose_integrators(self, near_ground: bool) -> None:
        """Choose how rates and velocities are integrated: Adams-Bashforth 2 in the air, Euler near the ground.

        JSBSim's friction is the force that stops the wheel within one Euler step. Under Adams-Bashforth 2 that has an
        eigenvalue of -1: a parked aircraft shakes from side to side at half the step's rate for ever, with whatever
        amplitude the touchdown left, and a 100 Hz sensor sees it as a constant false tilt. The change comes before the
        wheels touch, because in the shock it would leave a step between acceleration and velocity.
        """
        if near_ground != self._near_ground:
            self._near_ground = near_ground
            for put in self._integrators:
                put(EULER if near_ground else ADAMS_BASHFORTH_2)

    def _crash(self, row: list[float]) -> str | None:
        if row[Column.HEIGHT_AGL] < 0.0:
            return "the aircraft is below the ground"
        if row[Column.WHEELS] > 0.0 and row[Column.VEL_DOWN] * FT > HARD:
            return f"hit the ground at {row[Column.VEL_DOWN] * FT:.1f} m/s"
        for resting, wow in zip(self._resting, self._contacts, strict=True):
            if wow() > 0.0 and not resting:
                return f"the airframe touched the ground at {math.hypot(*row[VELOCITY]) * FT:.1f} m/s"
        return None

    def _gust(self, t: float, gust: Gust) -> None:
        fdm = self._fdm
        prefix = "atmosphere/cosine-gust"
        for phase in ("startup", "steady", "end"):
            fdm[f"{prefix}/{phase}-duration-sec"] = gust.rise
        fdm[f"{prefix}/magnitude-ft_sec"] = gust.speed / FT
        fdm[f"{prefix}/frame"] = 3  # NED
        fdm[f"{prefix}/X-velocity-ft_sec"] = -math.cos(gust.from_)
        fdm[f"{prefix}/Y-velocity-ft_sec"] = -math.sin(gust.from_)
        fdm[f"{prefix}/Z-velocity-ft_sec"] = 0.0
        fdm[f"{prefix}/start"] = 1
        bearing = math.degrees(gust.from_) % 360.0
        self._events.append(Event(t, "info", "flight", f"gust of {gust.speed:g} m/s from {bearing:.0f} deg"))

    def _finish(self, error: str | None) -> None:
        self.done = True
        self.error = error

    def _find_jump(self, column: np.ndarray) -> None:
        """End the flight where its script puts the aircraft elsewhere: no sensor and no estimator can follow."""
        ends = (
            [self._before, column[: EULER_ANGLES.stop]] if self._before is not None else [column[: EULER_ANGLES.stop]]
        )
        jumps, sizes = _jumps(np.concatenate(ends, axis=1), self.dt)
        self._before = column[: EULER_ANGLES.stop, -1:]
        if len(jumps) and self.error is None:
            at = (self._next - column.shape[1] + int(jumps[0])) * self.dt
            text = f"the script moves the aircraft by {sizes[0]:.0f} m within a step at {at:.1f} s (a trim?)"
            self._events.append(Event(at, "error", "flight", text))
            self._finish(f"{text}; end the flight before it with duration_s")

    def _truth(self, raw: np.ndarray) -> Truth:
        """Truth from raw rows, cut at the first that is not finite."""
        finite = np.isfinite(raw).all(axis=1)
        if not finite.all():
            raw = raw[: int(np.argmin(finite))]
            first = self._next - len(finite) + len(raw)
            self._next = first
            self._finish(f"the state is not a number any more at {first * self.dt:.2f} s{self._pilot.during()}")
            self._events.append(Event(first * self.dt, "error", "flight", "the state is not a number any more"))
        n = len(raw)
        column = np.multiply(raw.T, SCALE[:, None], order="C")  # (columns, n)
        q_nb = attitude.from_half_angles(*column[EULER_ANGLES])
        accel_b = (column[FORCE] / column[Column.MASS]).T
        if (held := column[Column.HELD] > 0.0).any():  # what holds it carries its weight
            weight = gravity.normal_gravity(column[PLACE].T[held])
            accel_b[held] = -weight[:, None] * attitude.down(q_nb[held])
        if self._scripted and n:
            self._find_jump(column)
        return Truth(
            t=np.arange(self._next - n, self._next) * self.dt,
            lla=np.ascontiguousarray(column[PLACE].T),
            vel_n=np.ascontiguousarray(column[VELOCITY].T),
            q_nb=q_nb,
            rate_ib_b=np.ascontiguousarray(column[RATES].T),
            rate_dot_b=np.ascontiguousarray(column[ANGULAR_ACCELERATION].T),
            accel_b=np.ascontiguousarray(accel_b),
            cg_b=np.ascontiguousarray(column[CENTRE_OF_GRAVITY].T),
            wind_n=np.ascontiguousarray(column[WIND].T),
            airspeed=column[Column.AIRSPEED],
            alpha=column[Column.ALPHA],
            beta=column[Column.BETA],
            pressure=column[Column.PRESSURE],
            temperature=column[Column.TEMPERATURE],
            height_agl=column[Column.HEIGHT_AGL],
            on_ground=(column[Column.WHEELS] > 0.0) | held,
            rpm=column[Column.RPM],
            throttle=column[Column.THROTTLE],
        )


def _own_aircraft(scenario: Scenario) -> str:
    """Find the path of a script's aircraft where it is not one of JSBSim's."""
    return scenario.aircraft if scenario.aircraft not in ("", Path(scenario.aircraft).stem) else ""


def model_files(scenario: Scenario) -> list[Path]:
    """List the files of the aircraft that a scenario flies, engines, systems and script included.

    Raises:
        InputError: it cannot be loaded.
    """
    fdm = Fdm(1.0 / scenario.rate)
    if scenario.script is not None:
        fdm.load_script(scenario.script, scenario.where, _own_aircraft(scenario))
    else:
        fdm.load_aircraft(scenario.aircraft, scenario.where)
    return sorted(set(fdm.sources))


def _last_trim(scenario: Scenario, dt: float, end: float | None) -> float:
    """Find the time (s) up to which a script moves the aircraft by trimming it; fly it once to see."""
    fdm = Fdm(dt)
    fdm.load_script(scenario.script or "", scenario.where, _own_aircraft(scenario))
    fdm.begin()
    get = [fdm.getter(column.source) for column in list(Column)[: EULER_ANGLES.stop]]
    rows = [[g() for g in get]]
    for _ in range(round(min(TRIMMED_BY, end or TRIMMED_BY) / dt)):
        if not fdm.exec.run():
            break
        rows.append([g() for g in get])
    column = np.array(rows).T * SCALE[: EULER_ANGLES.stop, None]
    jumps, _ = _jumps(column, dt)
    return float(jumps[-1] + 1) * dt if len(jumps) else 0.0


def _jumps(column: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Find rows (k,) after which the position moves by more than the velocity explains, and by how many m (k,)."""
    place, vel_n = column[PLACE], column[VELOCITY]
    step = np.diff(place, axis=1) * [[wgs84.A], [wgs84.A], [1.0]]
    step[1] *= np.cos(place[0, :-1])
    step[2] *= -1.0
    off = np.linalg.norm(step - 0.5 * dt * (vel_n[:, 1:] + vel_n[:, :-1]), axis=0)
    jumps = np.flatnonzero(off > JUMP + 0.02 * dt * np.linalg.norm(vel_n[:, :-1], axis=0))
    return jumps, off[jumps]


def _reader(fdm: Fdm, column: Column) -> Callable[[], float]:
    if column in OPTIONAL and not fdm.has(column.source):
        return lambda: 0.0
    return fdm.getter(column.source)


def _units(fdm: Fdm, prefix: str) -> list[str]:
    """List the wheels (`gear/unit`) or other points (`contact/unit`) that can touch the ground."""
    names = [f"{prefix}[{i}]" if i else prefix for i in range(64)]
    return [name for name in names if fdm.has(f"{name}/WOW")]


def _contacts(fdm: Fdm) -> list[Callable[[], float]]:
    """Make readers that are above 0 when something other than a wheel is on the ground (ours latches it)."""
    names = [f"{unit}/WOW" for unit in _units(fdm, "contact/unit")]
    return [fdm.getter(name) for name in (*names, *(["ap/crashed"] if fdm.has("ap/crashed") else []))]


def _check_gusts(scenario: Scenario) -> None:
    """JSBSim has one gust at a time."""
    gusts = scenario.wind.gusts
    for i, (gust, following) in enumerate(pairwise(gusts)):
        end = gust.at + 3.0 * gust.rise
        if following.at < end:
            raise InputError(
                f"{scenario.where}: [wind]: [[gust]] {i + 2}: at_s: {following.at:g} is before the gust before it ends "
                f"({end:g} s); move it"
            )
