"""A scenario: one TOML file that says all about a flight.

`load(name_or_path)` finds the file (a path, or the name of a shipped scenario), follows `extends`, checks every key and
returns a `Scenario`. Angles are degrees in the file and radians from here on.
"""

import copy
import datetime
import math
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.table import Table, read_toml

TURBULENCE = {"none": 0.0, "light": 7.62, "moderate": 15.24, "severe": 22.86}
"""MIL-F-8785C: wind speed at 20 ft (m/s: 15, 30, 45 knots rounded to 25, 50, 75 ft/s) by severity."""


@dataclass(frozen=True)
class Start:
    """Where the flight begins."""

    latitude: float  # rad, geodetic
    longitude: float  # rad
    altitude: float  # m above sea level (= ellipsoid) of the ground
    heading: float  # rad, true
    on_ground: bool
    height: float = 0.0  # m above ground, in the air
    airspeed: float = 0.0  # m/s, in the air
    roll: float = 0.0  # rad
    pitch: float = 0.0  # rad


@dataclass(frozen=True)
class Wind:
    """Steady wind, and what is on top of it."""

    speed: float = 0.0  # m/s
    from_: float = 0.0  # rad, true bearing it comes from
    turbulence: str = "none"
    gusts: tuple["Gust", ...] = ()


@dataclass(frozen=True)
class Gust:
    """A one-minus-cosine gust."""

    at: float  # s
    speed: float  # m/s, peak
    rise: float  # s, each of rise, hold and fall
    from_: float  # rad


@dataclass(frozen=True)
class Component:
    """A named table (suite, estimator, fault) whose further settings are checked by whoever is made from it."""

    name: str
    settings: dict[str, Any]
    where: str  # for messages


@dataclass(frozen=True)
class Scenario:
    """A checked scenario."""

    name: str
    text: str  # effective TOML source, kept in the log
    path: Path
    aircraft: str
    script: str | None
    motion: Table | None
    seed: int
    epoch: datetime.datetime
    rate: float  # Hz, truth
    duration: float | None  # s; None: to the end of the steps
    start: Start
    wind: Wind
    steps: tuple[Table, ...]
    pilot_attitude: str  # "truth" or the name of an estimator
    suites: tuple[Component, ...] = ()
    estimators: tuple[Component, ...] = ()
    faults: tuple[Component, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def epoch_ns(self) -> int:
        """The epoch in ns since 1970."""
        return round(self.epoch.timestamp()) * 10**9
