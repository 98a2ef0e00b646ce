"""Suites of `ahrs-sim check`: which flights are flown with which seeds, and how large a change has to be.

A suite is a TOML file:

    title = "Mine"
    baseline = "mine.json"             # default: the suite's name with .json
    catalogue = "chr"                  # every method of the catalogue on this sensor suite (default: none)

    [tolerance]                        # a change must be larger than both parts
    relative = 0.05
    degrees = 0.05                     # for roll, pitch, tilt
    heading_degrees = 0.1              # for heading, total

    [estimator.mine]                   # in every flight, with the catalogue's; without either a flight has its own
    method = "package.module:Class"
    suite = "chr"

    [every]                            # also every shipped scenario flown on the truth that has no flight below
    at_most_s = 150.0
    seeds = [1, 2, 3]

    [[flight]]
    scenario = "circuit"               # a path from the suite's folder, or a shipped one
    seeds = [1, 2, 3]
    duration_s = 120.0                 # default: the scenario's
    estimators = ["mine"]              # only these

    [[flight]]
    certification = "restart"          # a flight of the shipped certification standard, its rows as further figures
    seeds = [1]
    estimators = ["ins21@sbg"]         # as `ahrs-sim certify` names them
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import InputError
from ahrs_sim.runs import certify
from ahrs_sim.runs.pool import Run
from ahrs_sim.scenario.shipped import scenario_dir
from ahrs_sim.scenario.table import Table, is_file, read_toml

STANDARD = Path(__file__).parents[2] / "tests" / "baselines" / "standard.toml"
"""The project's own suite; in a checkout only."""

_FOREIGN = scenarios.Gate()


@dataclass(frozen=True)
class Tolerance:
    """Sets how far a figure may move before it counts as changed."""

    relative: float
    degrees: float
    heading_degrees: float

    def of(self, figure: str, before: float) -> float:
        """Compute the largest difference from `before` that counts as no change."""
        axis = figure.rpartition(".")[2]
        if axis == "availability":
            return 0.01
        absolute = self.heading_degrees if axis in ("heading", "total") else self.degrees
        return max(absolute, self.relative * abs(before))


@dataclass(frozen=True)
class Flight:
    """One scenario of a suite."""

    name: str
    seeds: tuple[int, ...]
    run: Run  # with the first seed
    estimators: tuple[str, ...]


@dataclass(frozen=True)
class Suite:
    """A checked suite."""

    name: str
    baseline: Path
    tolerance: Tolerance
    flights: tuple[Flight, ...]


def load(path: str | None = None, gate: scenarios.Gate = _FOREIGN) -> Suite:
    """Read and check a suite with its scenarios, of whose code from outside only what `gate` lets pass may run.

    Raises:
        InputError: no such file, an unknown key, a scenario that is wrong.
    """
    if path is None and not STANDARD.is_file():
        raise InputError("check: no suite given, and the standard one is in a checkout only; write a suite of your own")
    file = Path(path) if path is not None else STANDARD
    table = read_toml(file)
    table.text("title", "")
    limits = table.table("tolerance")
    tolerance = Tolerance(
        relative=limits.number("relative", 0.05, minimum=0.0),
        degrees=limits.number("degrees", 0.05, minimum=0.0),
        heading_degrees=limits.number("heading_degrees", 0.1, minimum=0.0),
    )
    limits.close()
    estimators = {name: _placed(t.data, file.parent) for name, t in table.named_tables("estimator").items()}
    for settings in table.named_tables("estimator").values():
        settings.text("suite")
    on = table.text("catalogue", None)
    if on:
        estimators |= {f"{method}-{on}": {"method": method, "suite": on} for method in _methods()}
    listed = [_flight(t, file, estimators, gate) for t in table.list_of_tables("flight")]
    if table.has("every"):
        listed += _every(table.table("every"), file, estimators, gate, {f.run.name for f in listed})
    suite = Suite(file.stem, file.parent / table.text("baseline", f"{file.stem}.json"), tolerance, tuple(listed))
    table.close()
    names = [f.name for f in listed]
    if not names:
        raise table.error("flight", "missing; add [[flight]] tables")
    if twice := [n for n, count in Counter(names).items() if count > 1]:
        raise table.error("flight", f"'{twice[0]}' is there twice; give one of them another name")
    return suite


def _placed(settings: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Name a library or file beside the suite by its whole path in the settings of an estimator."""
    method = str(settings.get("method", ""))
    kind, colon, place = ("lib", ":", method[4:]) if method.startswith("lib:") else ("", "", method)
    path, rest = (place, "") if kind else (place.rpartition(":")[0], f":{place.rpartition(':')[2]}")
    if path and is_file(folder / path):
        return {**settings, "method": f"{kind}{colon}{(folder / path).resolve()}{rest}"}
    return dict(settings)


def _methods() -> list[str]:
    """List every method of our own catalogue that makes attitudes from a sensor suite."""
    import estimators

    return [method.name for method in estimators.describe() if method.own]


def _every(
    table: Table, file: Path, estimators: Mapping[str, Any], gate: scenarios.Gate, listed: set[str]
) -> list[Flight]:
    """Make a flight for each shipped scenario that has none, with the estimators that its suites can feed."""
    seeds, limit = table.value("seeds", [1, 2, 3]), table.number("at_most_s", math.inf, above=0.0)
    table.close()
    made = []
    for path in sorted(scenario_dir().glob("*.toml")):
        if path.stem in listed:
            continue
        scenario = scenarios.load(str(path))
        if not scenario.estimators:  # not meant for any
            continue
        if scenario.pilot_attitude != "truth":  # a change in one estimator would move the flight of all
            continue
        suites = {s.name for s in scenario.suites}
        fitting = {name: settings for name, settings in estimators.items() if settings.get("suite") in suites}
        if fitting or not estimators:
            flight: dict[str, Any] = {"scenario": str(path), "seeds": seeds}
            if limit < (scenario.duration or math.inf):
                flight["duration_s"] = limit
            made.append(_flight(Table(flight, f"{table.where}: {path.stem}"), file, fitting, gate))
    return made


def _seeds(table: Table) -> list[int]:
    seeds = table.value("seeds", [1, 2, 3])
    if not (isinstance(seeds, list) and seeds and all(isinstance(s, int) and s >= 0 for s in seeds)):
        raise table.error("seeds", f"{seeds!r} is not a list of whole numbers")
    if len(set(seeds)) < len(seeds):
        raise table.error("seeds", "one is there twice; each flight counts once")
    return list(seeds)


def _certification(table: Table, gate: scenarios.Gate) -> Flight:
    """Make one flight of the shipped certification standard, with the parts that its rows are of."""
    standard = certify.load()
    name, seeds = table.choice("certification", list(standard.flights)), _seeds(table)
    chosen = certify.candidates(standard, table.texts("estimators"))
    title = table.text("name", f"certify-{name}")
    table.close()
    run = certify.plans(standard, chosen, 1, gate)[name].run(0)
    return Flight(title, tuple(seeds), replace(run, key=None, band_s=None), tuple(chosen))


def _flight(table: Table, file: Path, estimators: Mapping[str, Any], gate: scenarios.Gate) -> Flight:
    if table.has("certification"):
        return _certification(table, gate)
    name, seeds = table.text("scenario"), _seeds(table)
    beside = file.parent / name
    chosen = table.value("estimators", [])
    if not (isinstance(chosen, list) and all(isinstance(e, str) for e in chosen)):
        raise table.error("estimators", f"{chosen!r} is not a list of names")
    path = str(beside) if is_file(beside) else name
    duration = table.number("duration_s", None, above=0.0)
    scenario = scenarios.load(path, seed=seeds[0], duration=duration, gate=gate)
    data = {**scenario.data, **({"estimator": dict(estimators)} if estimators else {})}
    scenario = scenarios.parse(data, scenario.where, scenario.name, estimators=chosen, gate=gate)
    title = table.text("name", scenario.name)
    table.close()
    run = Run(None, scenario.name, scenario.where, scenario.data, code=scenario.code)
    return Flight(title, tuple(seeds), run, tuple(e.name for e in scenario.estimators))
