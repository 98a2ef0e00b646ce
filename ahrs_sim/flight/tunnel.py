"""An aircraft held still in the air: its accelerations in any state and with any controls, its trims and derivatives.

JSBSim integrates nothing here (its four integrators are off), so that engines, actuators and whatever stabilises the
aircraft settle around a frozen state. SI units, radians, body axes; controls as JSBSim takes them, -1 to 1.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy import optimize

from ahrs_sim.flight.columns import FT
from ahrs_sim.flight.design import DT
from ahrs_sim.flight.fdm import Fdm, configure, engines, indexed, start_engines, write
from ahrs_sim.world.gravity import STANDARD as G

WINDOW = 0.1  # s
SETTLED = 1.2e-4  # m/s2 and rad/s2 in a window: nothing changes any more
PATIENCE = 15.0  # s, for a propeller or a turbine that is slow
ALTITUDE = 1000.0  # m above sea level
STEPS = np.array([0.01, 0.02, 0.02, 0.02, 0.01, 0.02])  # of what a trim varies
SCALE = np.array([0.1, 0.2, 0.2, 0.2, 0.1, 0.3])
CONVERGED = 1e-2  # m/s2
CONTROLS = ("elevator", "aileron", "rudder", "throttle")
_ACCELERATIONS = tuple(f"accelerations/{x}" for x in ("udot-ft_sec2", "vdot-ft_sec2", "wdot-ft_sec2")) + tuple(
    f"accelerations/{x}dot-rad_sec2" for x in "pqr"
)


@dataclass(frozen=True)
class Point:
    """A state and the controls in it."""

    speed: float  # m/s, true
    alpha: float = 0.0  # rad
    beta: float = 0.0
    p: float = 0.0  # rad/s
    q: float = 0.0
    r: float = 0.0
    phi: float = 0.0  # rad
    theta: float = 0.0
    elevator: float = 0.0
    aileron: float = 0.0
    rudder: float = 0.0
    throttle: float = 0.0


@dataclass(frozen=True)
class Trim:
    """A steady flight: level, gliding or turning."""

    point: Point
    qbar: float  # Pa
    calibrated: float  # m/s, calibrated airspeed
    slope: float  # rad, of the flight path
    residual: float  # of the accelerations: m/s2 and, times 10 m, rad/s2


class Tunnel:
    """The bench.

    Args:
        fdm: a model just loaded, with the time step `DT`.
        fuel: share of the tanks' contents that is left.
    """

    def __init__(self, fdm: Fdm, fuel: float = 1.0) -> None:
        self.fdm = fdm
        self.engines = engines(fdm)
        fdm["ic/terrain-elevation-ft"] = 0.0
        fdm["ic/lat-geod-rad"] = 0.7
        fdm["ic/h-sl-ft"] = ALTITUDE / FT
        fdm["ic/vt-fps"] = 100.0
        fdm.begin()
        configure(fdm, 0.5, 0.0)
        i = 0
        while fdm.has(tank := indexed("propulsion/tank", i) + "/contents-lbs"):
            fdm[tank] = fdm[tank] * fuel
            i += 1
        write(fdm, "propulsion/fuel_freeze", 1.0)
        if self.engines:
            start_engines(fdm)
        for kind in ("rate", "position"):
            for motion in ("rotational", "translational"):
                fdm[f"simulation/integrator/{kind}/{motion}"] = 0
        self._read = [fdm.getter(name) for name in _ACCELERATIONS]
        names = ("u-fps", "v-fps", "w-fps", "p-rad_sec", "q-rad_sec", "r-rad_sec", "phi-rad", "theta-rad")
        self._ic = {name: fdm.setter(f"ic/{name}") for name in names}
        self._set = {x: fdm.setter(f"fcs/{x}-cmd-norm") for x in CONTROLS[:3]}
        throttles = [indexed("fcs/throttle-cmd-norm", i) for i in range(self.engines)]
        self._throttles = [fdm.setter(name) for name in throttles if fdm.has(name)]
        fdm.exec.run()
        self.mass = fdm["inertia/mass-slugs"] * 14.593903
        self.density = fdm["atmosphere/rho-slugs_ft3"] * 515.3788
        self.area, self.span, self.chord = (fdm[f"metrics/{x}"] for x in ("Sw-sqft", "bw-ft", "cbarw-ft"))
        self.area, self.span, self.chord = self.area * FT**2, self.span * FT, self.chord * FT

    def put(self, point: Point) -> None:
        """Bring the aircraft into a state."""
        cos_b = math.cos(point.beta)
        ic = self._ic
        ic["phi-rad"](point.phi)
        ic["theta-rad"](point.theta)
        ic["u-fps"](point.speed * math.cos(point.alpha) * cos_b / FT)
        ic["v-fps"](point.speed * math.sin(point.beta) / FT)
        ic["w-fps"](point.speed * math.sin(point.alpha) * cos_b / FT)
        ic["p-rad_sec"](point.p)
        ic["q-rad_sec"](point.q)
        ic["r-rad_sec"](point.r)
        self.control(point)
        self.fdm.exec.run_ic()

    def control(self, point: Point) -> None:
        """Set the controls alone."""
        self._set["elevator"](point.elevator)
        self._set["aileron"](point.aileron)
        self._set["rudder"](point.rudder)
        for throttle in self._throttles:
            throttle(point.throttle)

    def run(self, seconds: float) -> np.ndarray:
        """Run on; return accelerations along the body axes (3,) m/s2, relative to them, and angular (3,) rad/s2."""
        for _ in range(round(seconds / DT)):
            self.fdm.exec.run()
        values = [get() for get in self._read]
        return np.array([values[0] * FT, values[1] * FT, values[2] * FT, *values[3:]])

    def accelerations(self, point: Point, patience: float = PATIENCE) -> np.ndarray:
        """Return accelerations (6,) as `run` does, once engines and actuators have settled."""
        self.put(point)
        before = self.run(WINDOW)
        for _ in range(round(patience / WINDOW)):
            now = self.run(WINDOW)
            if not np.isfinite(now).all():
                raise RuntimeError("its accelerations are not numbers any more")
            if np.abs(now - before).max() < SETTLED:
                return now
            before = now
        return before

    def side_force(self) -> float:
        """Specific force to the right, m/s2: what centres the ball."""
        return self.fdm["forces/fby-total-lbs"] / self.fdm["inertia/mass-slugs"] * FT

    def trim(
        self,
        speed: float,
        *,
        load: float = 1.0,
        guess: Point | None = None,
        throttle: float | None = None,
        thorough: bool = False,
    ) -> Trim:
        """Find the steady flight at a true airspeed; with a given throttle at any slope, else level.

        Unknowns: angle of attack, three controls, bank, and throttle or slope. A load factor above one is that of a
        level turn, looked at from the plane in which it pulls: wings level, lift and pitch rate as in the turn.
        A thorough search goes on with least squares within the limits where Newton's method has not converged.
        """
        found = guess or Point(speed, alpha=0.05, theta=0.05, throttle=0.5)
        start = [found.alpha, found.elevator, found.aileron, found.rudder, found.phi]
        start.append(found.throttle if throttle is None else found.theta - found.alpha)
        low = np.array([-0.3, -1.0, -1.0, -1.0, -0.3, 0.0 if throttle is None else -0.8])
        high = np.array([0.6, 1.0, 1.0, 1.0, 0.3, 1.0 if throttle is None else 0.8])
        rate = G / speed * (load - 1.0 / load)
        pull = (load - 1.0) * G

        def place(x: np.ndarray) -> Point:
            slope, engine = (0.0, x[5]) if throttle is None else (x[5], throttle)
            at = Point(speed, x[0], q=rate, phi=x[4], theta=x[0] + slope)
            return replace(at, elevator=x[1], aileron=x[2], rudder=x[3], throttle=engine)

        def residual(x: np.ndarray) -> np.ndarray:
            sin, cos = math.sin(x[0]), math.cos(x[0])
            wanted = np.array([pull * sin - rate * speed * sin, 0.0, -pull * cos + rate * speed * cos, 0.0, 0.0, 0.0])
            off: np.ndarray = (self.accelerations(place(x)) - wanted) * [1.0, 1.0, 1.0, 10.0, 10.0, 10.0]
            return off

        def jacobian(x: np.ndarray) -> np.ndarray:  # steps that no settling propeller drowns
            here = residual(x)
            step = np.where(x + STEPS < high, STEPS, -STEPS)
            return np.array([(residual(x + d) - here) / d.sum() for d in np.diag(step)]).T

        x = np.clip(start, low + 1e-3, high - 1e-3)
        now = residual(x)
        for _ in range(6):  # Newton's method
            if not np.abs(now).max() > CONVERGED:
                break
            x = np.clip(x - np.linalg.lstsq(jacobian(x), now)[0], low, high)
            now = residual(x)
        if thorough and np.abs(now).max() > CONVERGED:
            inside = np.clip(start, low + 1e-3, high - 1e-3)
            limits = optimize.Bounds(low, high)
            x = optimize.least_squares(residual, inside, jacobian, bounds=limits, x_scale=SCALE, max_nfev=12).x
            now = residual(x)
        point = Point(**{name: float(value) for name, value in asdict(place(x)).items()})
        worst = float(np.abs(now).max())
        slope = 0.0 if throttle is None else float(x[5])
        return Trim(point, self.fdm["aero/qbar-psf"] * 47.88026, self.fdm["velocities/vc-kts"] * 0.514444, slope, worst)

    def derivatives(self, at: Point, names: Sequence[str], steps: Sequence[float], patience: float = 1.5) -> np.ndarray:
        """Change of the accelerations and of the side force per unit of each variable of a `Point`, (7, n).

        Angles of the air move the attitude with them only where the caller asks for it: gravity stays as it is.
        """
        columns = []
        for name, step in zip(names, steps, strict=True):
            ends = []
            for sign in (1.0, -1.0):
                value = getattr(at, name) + sign * step
                moved = self.accelerations(replace(at, **{name: value}), patience)
                ends.append(np.append(moved, self.side_force()))
            columns.append((ends[0] - ends[1]) / (2.0 * step))
        return np.array(columns).T

    def lag(self, at: Point, control: str, size: float) -> float:
        """Find the time constant of a control, s: of the actuator and whatever filters its command."""
        steady = self.accelerations(at)
        moved = replace(at, **{control: getattr(at, control) + size})
        self.control(moved)
        history = np.array([self.run(DT) for _ in range(150 if control != "throttle" else 1200)]) - steady
        axis = {"elevator": 4, "aileron": 3, "rudder": 5, "throttle": 0}[control]
        final = history[-1, axis]
        if abs(final) < 1e-6:
            return math.inf
        return float(DT * np.clip(1.0 - history[:, axis] / final, -1.0, 1.0).sum())
