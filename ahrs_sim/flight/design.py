"""What is known of an aircraft before it flies: its speeds, trims, modes, the gains of its autopilot and their margins.

All of it is found from the model itself (`analysis`), in some seconds, and kept in the user's cache under a hash of the
aircraft's files. SI units and radians; speeds are calibrated airspeeds unless they say otherwise.
"""

import contextlib
import hashlib
import json
import math
import os
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.flight.fdm import Fdm

STALL_MARGIN = 0.85  # share of the load factor at the stall that a manoeuvre may take
DT = 0.01  # s, time step of the analysis
_SOURCES = ("analysis.py", "design.py", "gains.py", "tunnel.py")


@dataclass(frozen=True)
class Row:
    """One speed of the schedule."""

    qbar: float  # Pa
    speed: float  # m/s, true, at 1000 m
    airspeed: float  # m/s, calibrated
    alpha: float
    theta: float
    elevator: float
    aileron: float
    rudder: float
    throttle: float
    slope: float  # rad, of the flight path: 0, or the glide without an engine
    lateral: list[list[float]]  # (2, 7) see `gains.lateral_model`
    bank_gain: float  # 1/s
    turn_forward: list[list[float]]  # (2, 2) aileron and rudder per roll rate and yaw rate
    longitudinal: list[float]  # (4,)
    pitch_gain: float  # 1/s
    pull_forward: list[float]  # (2,) elevator and angle of attack per pitch rate
    thrust: float  # m/s2 per unit of throttle
    climb: float  # m/s, steady at full throttle
    bank: float  # rad, the steepest level turn that it holds with the thrust it has
    modes: dict[str, list[float]]  # real and imaginary part, 1/s
    margins: dict[str, list[float]]  # of elevator, aileron, rudder: dB, deg, crossover rad/s; loaded
    margins_light: dict[str, list[float]]  # the same with little fuel
    damping: float  # the least of the closed loops


@dataclass(frozen=True)
class Design:
    """Holds an aircraft's trim points, gains and limits, as the autopilot and the pilot use them."""

    name: str
    digest: str  # of the aircraft's files and of how they were analysed
    mass: float  # kg, as loaded
    area: float  # m2
    span: float  # m
    engines: int
    powered: bool
    wheels: list[list[float]]  # (n, 3) m from the centre of gravity: forward, right, down
    ground_pitch: float  # rad, standing
    standing: float  # m, the centre of gravity above the ground
    wheelbase: float  # m
    steer: float  # rad, the most that a wheel is steered
    stall: float  # m/s
    cruise: float  # m/s
    fastest: float  # m/s
    throttle_lag: float  # s
    rows: list[Row] = field(default_factory=list)
    refusals: dict[str, str] = field(default_factory=dict)  # what it cannot do, and why

    @property
    def approach(self) -> float:
        """Speed on the glide path, m/s."""
        return 1.35 * self.stall

    @property
    def rotate(self) -> float:
        """Speed at which the nose is raised, m/s."""
        return 1.15 * self.stall

    def at(self, airspeed: float, what: Callable[[Row], float]) -> float:
        """Interpolate a figure of the schedule at a calibrated airspeed."""
        return float(np.interp(airspeed, [row.airspeed for row in self.rows], [what(row) for row in self.rows]))

    def bank_limit(self, airspeed: float, *, steady: bool = True) -> float:
        """Steepest bank (rad) at an airspeed: by the stall and, where it is to be held, by the thrust."""
        load = STALL_MARGIN * (airspeed / self.stall) ** 2
        if load <= 1.0:
            return 0.0
        stalled = math.acos(1.0 / load)
        return min(stalled, self.at(airspeed, lambda row: row.bank)) if steady and self.powered else stalled

    def text(self) -> str:
        """Format the design as JSON."""
        return json.dumps(asdict(self), indent=1)


def from_text(text: str) -> Design:
    """Read what `Design.text` wrote."""
    data: dict[str, Any] = json.loads(text)
    rows = [Row(**row) for row in data.pop("rows")]
    return Design(rows=rows, **data)


def design(name: str, where: str) -> Design:
    """Find all about an aircraft, or take it from the cache.

    Args:
        name: of JSBSim's or ours, or a path to somebody's own.
        where: for messages and relative paths: the scenario's file.

    Raises:
        InputError: there is no such aircraft, or it does not fly as an aeroplane does: the reason.
    """
    fdm = load(name, where)
    digest = _digest(fdm)
    file = _cache() / f"aircraft-{digest}.json"
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        return from_text(file.read_text(encoding="utf-8"))
    from ahrs_sim.flight.analysis import analyse

    made = analyse(name, where, digest, fdm)
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{os.getpid()}.part")
        part.write_text(made.text(), encoding="utf-8")
        part.replace(file)
    return made


def _cache() -> Path:
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return (root if os.access(root, os.W_OK) else Path(tempfile.gettempdir())) / "ahrs_sim"


def load(name: str, where: str) -> Fdm:
    """Load an aircraft with the time step of the analysis."""
    fdm = Fdm(DT)
    fdm.load_aircraft(name, where)
    return fdm


def _digest(fdm: Fdm) -> str:
    digest = hashlib.sha256(version("jsbsim").encode())
    for path in [*sorted(fdm.sources), *(Path(__file__).with_name(x) for x in _SOURCES)]:
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:20]
