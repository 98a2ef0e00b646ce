"""`ahrs-sim check`: has anything become less accurate? A suite of flights against the baseline beside it.

check_suite       what is flown: TOML
check_baseline    what it gave when the baseline was made: JSON
check_report      the result as text, Markdown, JSON, JUnit

The baseline holds the RMSE of every flight, estimator, phase and axis for each seed. Flights are flown again with the
same seeds, so that differences are paired; a figure is worse when the mean difference is larger than the tolerance and
its bootstrap interval lies above zero.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.evaluation.bootstrap import interval
from ahrs_sim.evaluation.metrics import MEASURES
from ahrs_sim.evaluation.phases import PHASES
from ahrs_sim.runs import check_baseline
from ahrs_sim.runs import pool as flights
from ahrs_sim.runs.check_baseline import Figures, Found
from ahrs_sim.runs.check_suite import Suite
from ahrs_sim.runs.pool import Run

ALL = "all"
"""The whole flight, beside its phases."""

SAME, BETTER, WORSE, NEW, GONE = "same", "better", "worse", "new", "gone"


@dataclass(frozen=True)
class Row:
    """One figure against its baseline."""

    flight: str
    estimator: str
    figure: str
    before: float
    now: float
    low: float  # of the paired difference
    high: float
    tolerance: float
    result: str  # SAME, BETTER, WORSE, NEW, GONE

    @property
    def change(self) -> float:
        """Difference of the means."""
        return self.now - self.before


@dataclass(frozen=True)
class Result:
    """A suite against its baseline."""

    suite: str
    baseline: str
    rows: list[Row]
    errors: dict[str, str] = field(default_factory=dict)  # by flight and seed
    flown: dict[str, tuple[str, ...]] = field(default_factory=dict)  # estimators of each flight
    seconds: dict[str, float] = field(default_factory=dict)  # of each flight, its seeds one after the other

    @property
    def passed(self) -> bool:
        """Nothing worse, nothing gone, every flight flown."""
        return not self.errors and not any(row.result in (WORSE, GONE) for row in self.rows)

    def changed(self) -> list[Row]:
        """Select the rows that have changed, worst first."""
        order = {WORSE: 0, GONE: 1, BETTER: 2, NEW: 3}
        return sorted((r for r in self.rows if r.result in order), key=lambda r: order[r.result])


def fly(
    suite: Suite, *, workers: int | None = None, progress: Callable[[int, int], None] = lambda done, all_: None
) -> Found:
    """Fly every flight of a suite with every seed on processes of this machine.

    Raises:
        InputError: a scenario, or settings of an estimator, that cannot be flown.
    """
    figures: Figures = {f.name: {} for f in suite.flights}
    errors: dict[str, str] = {}
    seconds = dict.fromkeys(figures, 0.0)
    place = {f.name: f for f in suite.flights}

    def all_runs() -> Iterator[Run]:
        for flight in suite.flights:
            for seed in flight.seeds:
                run = flight.run
                yield replace(run, key=(flight.name, seed), data={**run.data, "seed": seed})

    total = sum(len(f.seeds) for f in suite.flights)
    with flights.local_pool(workers) as pool:
        flights.warm_up(pool, [f.run for f in suite.flights])
        for count, outcome in enumerate(flights.fly_all(pool, all_runs()), 1):
            name, seed = outcome.key
            if outcome.bad_input:
                raise InputError(str(outcome.error))
            seconds[name] += outcome.seconds
            if outcome.error is not None:
                errors[f"{name}, seed {seed}"] = outcome.error
            column = place[name].seeds.index(seed)
            for estimator, values in outcome.figures.items():
                mine = figures[name].setdefault(estimator, {})
                for figure, value in _kept(values, [span.name for span in place[name].run.spans]):
                    mine.setdefault(figure, [math.nan] * len(place[name].seeds))[column] = value
            progress(count, total)
    return Found(figures, errors, seconds)


def _kept(values: Mapping[str, Any], parts: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Select the figures that a baseline holds from a flat row: by phase, and by part of the flight."""
    yield "all.availability", float(values["availability"])
    for phase in (ALL, *PHASES, *parts):
        for axis in MEASURES:
            value = values.get(f"{axis}_rmse_deg" if phase == ALL else f"{phase}.{axis}_rmse_deg", math.nan)
            if math.isfinite(value):
                yield f"{phase}.{axis}", float(value)


def compare(suite: Suite, found: Found) -> Result:
    """Compare what was found with the baseline.

    Raises:
        InputError: there is no baseline, or it is damaged.
    """
    kept = check_baseline.read(suite)["flights"]
    rows: list[Row] = []
    for flight in suite.flights:
        old = kept.get(flight.name, {"seeds": [], "estimators": {}})
        columns = [(old["seeds"].index(s), i) for i, s in enumerate(flight.seeds) if s in old["seeds"]]
        before, now = old["estimators"] if columns else {}, found.figures[flight.name]
        failed = any(where.startswith(f"{flight.name}, seed") for where in found.errors)
        for estimator in dict.fromkeys([*before, *now]):
            names = dict.fromkeys([*before.get(estimator, {}), *now.get(estimator, {})])
            for figure in names:
                a = np.array(before.get(estimator, {}).get(figure, []), float)
                b = np.array(now.get(estimator, {}).get(figure, []), float)
                a = a[[i for i, _ in columns]] if len(a) else np.full(len(columns), np.nan)
                b = b[[j for _, j in columns]] if len(b) and columns else b
                b = b if len(b) else np.full(len(columns), np.nan)
                if not (failed and not np.isfinite(b).any()):
                    rows.append(_row(suite, flight.name, estimator, figure, a, b))
    flown = {flight.name: flight.estimators for flight in suite.flights}
    return Result(suite.name, str(suite.baseline), rows, found.errors, flown, found.seconds)


def _row(suite: Suite, flight: str, estimator: str, figure: str, before: np.ndarray, now: np.ndarray) -> Row:
    both = np.isfinite(before) & np.isfinite(now) if len(before) == len(now) else np.zeros(0, bool)
    if not both.any():
        kind = GONE if np.isfinite(before).any() else NEW
        return Row(flight, estimator, figure, _mean(before), _mean(now), math.nan, math.nan, math.nan, kind)
    a, b = before[both], now[both]
    tolerance = suite.tolerance.of(figure, float(a.mean()))
    low, high = interval(b - a)
    worse, better = low > 0 and (b - a).mean() > tolerance, high < 0 and (b - a).mean() < -tolerance
    if figure.endswith("availability"):
        worse, better = better, worse
    if (np.isfinite(before) & ~np.isfinite(now)).any():  # some seeds have no figure any more
        worse, better = True, False
    kind = WORSE if worse else BETTER if better else SAME
    return Row(flight, estimator, figure, float(a.mean()), float(b.mean()), low, high, tolerance, kind)


def _mean(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else math.nan
