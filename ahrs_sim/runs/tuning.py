"""`ahrs-sim campaign --tune`: settings of an estimator that minimise an error over a small campaign.

The search sees the runs 0 to N-1. N others that it has never seen are flown with the settings as they were and as they
are now; the result is the mean paired difference with its interval. Each is flown and measured once a worker (`kept`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ahrs_sim.errors import CheckError, InputError, nearest
from ahrs_sim.evaluation import paired
from ahrs_sim.runs import kept
from ahrs_sim.runs import pool as flights
from ahrs_sim.runs.campaign_plan import Plan
from ahrs_sim.runs.pool import Pool, Run
from ahrs_sim.runs.variation import put, span
from ahrs_sim.scenario import Scenario

DECADE = 10.0
"""A span over more than this factor is searched in its logarithm."""


@dataclass(frozen=True)
class Knob:
    """One `--tune ESTIMATOR.SETTING=LOW..HIGH`."""

    estimator: str
    setting: str
    low: float
    high: float

    @classmethod
    def read(cls, text: str, scenario: Scenario) -> "Knob":
        """Read a knob from `ckf-chr.accel_sigma=0.5..5`.

        Raises:
            InputError: it is not of that form, or the scenario has no such estimator.
        """
        key, _, limits = text.partition("=")
        estimator, _, setting = key.rpartition(".")
        known = [e.name for e in scenario.estimators]
        if not (estimator and setting):
            raise InputError(f"--tune {text}: write ESTIMATOR.SETTING=LOW..HIGH")
        if estimator not in known:
            raise InputError(f"--tune {text}: no estimator '{estimator}' in {scenario.name}{nearest(estimator, known)}")
        return cls(estimator, setting, *span(limits, f"--tune {text}"))

    def value(self, x: float) -> float:
        """Compute the setting at `x` in [0, 1]."""
        x = min(1.0, max(0.0, x))
        if self.low > 0 and self.high / self.low > DECADE:
            return self.low * math.exp(x * math.log(self.high / self.low))
        return self.low + x * (self.high - self.low)


@dataclass(frozen=True)
class Tuned:
    """Holds the result of a search."""

    settings: dict[str, float]  # by ESTIMATOR.SETTING
    metric: str
    before: float  # mean over the held-out runs
    after: float
    gain: float  # mean of the paired differences, positive is better
    low: float | None  # its 95 % interval; None: too few runs
    high: float | None
    flights: int  # runs of the estimator; a worker flies each flight once, its settings do not change it
    runs: int
    trials: list[dict[str, float]]  # in the order flown: the settings and "score", the mean over the search's runs

    def text(self) -> str:
        """Format the result for a reader."""
        names = list(self.settings)
        widths = [max(12, len(name) + 2) for name in names]
        lines = ["".join(f"{name:>{w}s}" for name, w in zip(names, widths, strict=True)) + f"  {self.metric}"]
        best = min(range(len(self.trials)), key=lambda k: self.trials[k]["score"])
        for k, trial in enumerate(self.trials):
            cells = "".join(f"{trial[name]:{w}.6g}" for name, w in zip(names, widths, strict=True))
            lines.append(f"{cells}  {trial['score']:.4g}{'  best of the search' if k == best else ''}")
        lines += ["", *(f"{key} = {value:.6g}" for key, value in self.settings.items())]
        span = "" if self.low is None else f" (95 %: {self.low:.4g} to {self.high:.4g})"
        lines.append(
            f"{self.metric}, {self.runs} held-out runs: {self.before:.4g} -> {self.after:.4g}, gain {self.gain:.4g}"
            f"{span}: {self._outcome()}; {self.flights} runs of the estimator"
        )
        return "\n".join(lines)

    def _outcome(self) -> str:
        if self.low is None or self.high is None:
            return f"unclear, {self.runs} runs are too few to tell; give --runs {paired.FEWEST} or more"
        if self.low > 0:
            return "better"
        return "worse" if self.high < 0 else "no significant difference; more --runs see smaller ones"


def tune(
    plan: Plan,
    knobs: Sequence[Knob],
    metric: str,
    pool: Pool,
    *,
    evaluations: int = 30,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> Tuned:
    """Search for the best settings.

    Args:
        plan: its runs are what is flown for each trial, and as many after them for the comparison.
        knobs: what to turn, all of one estimator.
        metric: mean over the runs of this figure is minimised.
        pool: the workers.
        evaluations: trials at most.
        progress: called with the trials done and the most there can be.

    Raises:
        InputError: knobs of different estimators, an unknown figure, settings that cannot be flown.
        CheckError: the estimator has no finite figure at the settings it has.
    """
    estimator = knobs[0].estimator
    if any(k.estimator != estimator for k in knobs):
        raise InputError("--tune: the settings belong to different estimators; tune one at a time")
    if any(v.split("=")[1].startswith("lhs") for v in plan.vary):
        raise InputError("--tune: a Latin hypercube has no held-out runs; use uniform")
    trials = _Trials(plan, knobs, metric, pool, lambda done: progress(done, evaluations))
    _minimise(trials.cost, len(knobs), evaluations)
    best = np.array(min(trials.costs, key=lambda key: trials.costs[key]))
    held_out = range(plan.runs, 2 * plan.runs)
    before, after = trials.fly(held_out, None), trials.fly(held_out, best)
    both = np.isfinite(before) & np.isfinite(after)
    if not both.any():
        raise CheckError(f"--tune: {estimator} has no {metric} in any held-out run")
    change = paired.over_runs(after, before)
    assert change is not None  # there are both
    low, high = (None if math.isnan(x) else x for x in (-change.high, -change.low))
    return Tuned(
        settings=trials.named(best),
        metric=metric,
        before=float(before[both].mean()),
        after=float(after[both].mean()),
        gain=-change.change,
        low=low,
        high=high,
        flights=trials.flown,
        runs=change.pairs,
        trials=[{**trials.named(np.array(x)), "score": cost} for x, cost in trials.costs.items()],
    )


class _Trials:
    """Flies an estimator at points of the unit cube of its knobs, and keeps the cost of each."""

    def __init__(
        self, plan: Plan, knobs: Sequence[Knob], metric: str, pool: Pool, progress: Callable[[int], None]
    ) -> None:
        self.plan, self.knobs, self.metric, self.pool, self.progress = plan, knobs, metric, pool, progress
        self.estimator = knobs[0].estimator
        self.costs: dict[tuple[float, ...], float] = {}
        self.flown = 0

    def fly(self, numbers: range, x: np.ndarray | None) -> np.ndarray:
        """Fly runs by number at the point `x`, or unchanged (None); return their metric, NaN for a failed run."""
        todo = [self._run(number, numbers.start, x) for number in numbers]
        if not self.flown:
            flights.warm_up(self.pool, todo[:1])
        values = np.full(len(numbers), np.nan)
        for outcome in flights.fly_all(self.pool, todo, task=kept.fly):
            if outcome.bad_input:
                raise InputError(str(outcome.error))
            figures = outcome.figures.get(self.estimator, {})
            if figures and self.metric not in figures:
                raise InputError(f"--metric {self.metric}: no such figure{nearest(self.metric, figures)}")
            values[outcome.key] = figures.get(self.metric, math.nan)
        self.flown += len(numbers)
        return values

    def _run(self, number: int, first: int, x: np.ndarray | None) -> Run:
        run = self.plan.run(number)
        data: dict[str, Any] = {
            **run.data,
            "estimator": {self.estimator: dict(run.data["estimator"][self.estimator])},
        }
        for name, value in {} if x is None else self.named(x).items():
            put(data, f"estimator.{name}", value)
        return replace(run, key=number - first, data=data, band_s=None)

    def cost(self, x: np.ndarray) -> float:
        """Mean of the metric over the runs at a point, which is flown once."""
        x = np.clip(np.atleast_1d(np.asarray(x, float)), 0.0, 1.0)
        if (key := tuple(x)) not in self.costs:
            values = self.fly(range(self.plan.runs), x)
            # A run that fails is as bad as an attitude can be: the search must not prefer settings that crash.
            self.costs[key] = float(np.where(np.isfinite(values), values, 180.0).mean())
            self.progress(len(self.costs))
        return self.costs[key]

    def named(self, x: np.ndarray) -> dict[str, float]:
        """The settings at a point, by `estimator.setting`."""
        return {f"{self.estimator}.{k.setting}": k.value(float(v)) for k, v in zip(self.knobs, x, strict=True)}


def _minimise(cost: Callable[[np.ndarray], float], n: int, evaluations: int) -> None:
    """Search the unit cube of n dimensions for the least cost."""
    from scipy import optimize

    if n == 1:
        optimize.minimize_scalar(
            lambda x: cost(np.array([x])), bounds=(0.0, 1.0), method="bounded",
            options={"maxiter": evaluations, "xatol": 0.01},
        )  # fmt: skip
        return
    simplex = np.full((n + 1, n), 0.35)
    simplex[np.arange(n) + 1, np.arange(n)] = 0.75
    optimize.minimize(
        cost, simplex[0], method="Nelder-Mead", bounds=[(0.0, 1.0)] * n,
        options={"maxfev": evaluations, "initial_simplex": simplex, "xatol": 0.01, "fatol": 1e-4},
    )  # fmt: skip
