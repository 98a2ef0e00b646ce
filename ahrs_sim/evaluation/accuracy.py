"""Accuracy of estimators over a flight: errors by measure and phase, gathered while truth and estimates come in."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ahrs_sim.evaluation import consistency, metrics, paired, phases
from ahrs_sim.evaluation.decimate import Decimator, take
from ahrs_sim.evaluation.evaluator import Comparison, Evaluator
from ahrs_sim.evaluation.metrics import History, Measure
from ahrs_sim.evaluation.phases import PHASE_RATE, PHASES
from estimators.types import Estimates

NEES_RATE = 10.0
"""Hz at which the consistency of every estimator is watched: neighbouring errors are nearly the same."""

LATE_S = 2.0
"""s that an estimate may come after the truth of its instant: sensors deliver late."""


class Accuracy:
    """Gathers errors of estimators against the truth, during a flight or out of its log.

    Blocks may have any length, but the truth of an instant has to come at most `LATE_S` before the estimates of it.
    Only errors are kept (float32), so memory hardly grows with the flight.

    Args:
        names: of the estimators, in the order of the result.
        against: references by estimator instead of the truth, which then only gives the phases.
        with_consistency: keep NEES and NIS, too.
    """

    def __init__(
        self, names: Iterable[str], *, against: Mapping[str, History] | None = None, with_consistency: bool = False
    ) -> None:
        self._against = against
        self._with_consistency = with_consistency
        self._parts: dict[str, list[tuple[np.ndarray, ...]]] = {name: [] for name in names}
        self._evaluator = Evaluator(self._keep, against=against, keep_s=LATE_S)
        self._coarse: list[tuple[np.ndarray, ...]] = []  # truth for the phases
        self._decimator = Decimator(PHASE_RATE)
        self._thinned = {name: Decimator(NEES_RATE) for name in self._parts}
        self._nees: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {name: [] for name in self._parts}
        self._times = np.empty(0)
        self._turns: dict[str | None, list[tuple[np.ndarray, ...]]] = {}  # t, turn rate, slip; None: the truth's
        self.begins: dict[int, float] = {}  # s, of every step of the flight, numbered from 1

    def add_steps(self, t: np.ndarray, step: np.ndarray) -> None:
        """Note when steps of the pilot begin: at times (n,) s, rising, the number (n,) of the step from 0."""
        for number, row in zip(*np.unique(step, return_index=True), strict=True):
            self.begins.setdefault(int(number) + 1, float(t[row]))

    def add_truth(self, t: np.ndarray, q_nb: np.ndarray, vel_n: np.ndarray, on_ground: np.ndarray) -> None:
        """Extend the truth: s, rising; (n, 4); (n, 3) m/s NED; weight on the wheels."""
        if not len(t):
            return
        t = _whole_ns(t)
        rows = self._decimator.rows(t)
        self._coarse.append((t[rows], q_nb[rows].astype(np.float32), vel_n[rows].astype(np.float32), on_ground[rows]))
        self._evaluator.add_reference(t, q_nb)

    def add_estimates(self, name: str, block: Estimates) -> None:
        """Take a block of an estimator."""
        if len(block):
            as_logged = {"t": _whole_ns(block.t), "att_cov": block.att_cov.astype(np.float32)}
            self._evaluator.add(name, replace(block, **as_logged))

    def add_turning(self, name: str | None, t: np.ndarray, turn_rate: np.ndarray, slip: np.ndarray) -> None:
        """Take turn rate (n,) rad/s and slip (n,) rad at `t` (n,) s, rising, of an estimator or the truth (None)."""
        self._turns.setdefault(name, []).append((t, turn_rate, slip))

    def _keep(self, name: str, pair: Comparison) -> None:
        t = pair.estimates.t
        errors = pair.errors().astype(np.float32)
        rows = self._thinned[name].rows(t)
        thin = Comparison(take(pair.estimates, rows), pair.reference[rows])
        self._nees[name].append((t[rows], thin.nees().astype(np.float32)))
        columns = np.empty((len(t), 0), np.float32)
        if self._with_consistency:
            columns = np.column_stack([pair.nees(), *pair.nis()]).astype(np.float32)
        if np.array_equal(t, self._times):  # of the estimator before: one array for both
            t = self._times
        self._times = t
        self._parts[name].append((t, errors, columns))

    def span(self) -> tuple[float, float]:
        """Find the first and last time (s) with a reference; (inf, -inf) when there is none."""
        if self._against is not None:
            ends = [(h.t[0], h.t[-1]) for h in self._against.values()]
        else:
            ends = [(p[0][0], self._evaluator.reached) for p in self._coarse[:1]]
        return min((float(a) for a, _ in ends), default=math.inf), max((float(b) for _, b in ends), default=-math.inf)

    def part(self, low: float, high: float) -> dict[str, dict[str, Any]]:
        """Summarise a part of the flight, from `low` to `high` (s), by estimator.

        Returns:
            What `result` has of the whole span, `turn_rate_STATISTIC_dps` and `slip_STATISTIC_deg` where they were
            taken, and `MEASURE_worst_s`, when the error was largest, where it is known.
        """
        found: dict[str, dict[str, Any]] = self.result(low=low, high=high)["estimators"]
        for name, parts in self._parts.items():
            t, errors, _ = _within(parts, low, high)
            columns = {m: np.abs(_column(errors, Measure[m.upper()])) for m in metrics.MEASURES}
            del found[name]["phases"]
            found[name] |= {
                f"{m}_worst_s": float(t[np.nanargmax(x)]) for m, x in columns.items() if np.isfinite(x).any()
            }
            found[name] |= self._turning(name, low, high)
        return found

    def _turning(self, name: str, low: float, high: float) -> dict[str, Any]:
        """Summarise the errors of turn rate and slip from `low` to `high` (s), against the truth at the same times."""
        if not (name in self._turns and None in self._turns):
            return {}
        t, *values = (np.concatenate(column) for column in zip(*self._turns[name], strict=True))
        true_t, *true = (np.concatenate(column) for column in zip(*self._turns[None], strict=True))
        rows = (t >= max(low, true_t[0])) & (t <= min(high, true_t[-1]))
        found: dict[str, Any] = {}
        for measure, unit, value, truth in zip(("turn_rate", "slip"), ("dps", "deg"), values, true, strict=True):
            error = value[rows] - np.interp(t[rows], true_t, truth)
            found |= _finite(metrics.figures(measure, error, unit=unit))
            if np.isfinite(error).any():
                found[f"{measure}_worst_s"] = float(t[rows][np.nanargmax(np.abs(error))])
        return found

    def result(
        self, reference: str = "truth", *, low: float = -math.inf, high: float = math.inf, band_s: float | None = None
    ) -> dict[str, Any]:
        """Summarise the span from `low` to `high` (s).

        Args:
            reference: what the errors are taken against, for the result.
            low, high: s of flight.
            band_s: also the RMSE of every so many seconds, and mean NIS.

        Returns:
            What `review.compare.compare` returns, but for the name of the log.
        """
        first, last = self.span()
        t_phase, phase = self.phases()
        found = {}
        for name, parts in self._parts.items():
            t, errors, columns = _within(parts, low, high)
            found[name] = summary(errors, phases.at(t_phase, phase, t))
            found[name] |= _finite({"nees": _mean_nees(self._nees[name], low, high)})
            if band_s is not None:
                found[name] |= _details(t, errors, np.concatenate([np.empty((0, 3)), *columns]), band_s)
        return {
            "reference": reference,
            "from_s": max(low, first),
            "to_s": min(high, last),
            "estimators": found,
        }

    def phases(self) -> tuple[np.ndarray, np.ndarray]:
        """Find the phases of the flight: times (n,) s, rising, and indices into `PHASES` (n,); none without a truth."""
        if sum(len(part[0]) for part in self._coarse) < 2:
            return np.empty(0), np.empty(0, np.int8)
        t, q_nb, vel_n, on_ground = (np.concatenate(c) for c in zip(*self._coarse, strict=True))
        return t, phases.classify(t, q_nb, vel_n, on_ground).astype(np.int8)

    def paired(self, against: str, *, low: float = -math.inf, high: float = math.inf) -> dict[str, dict[str, Any]]:
        """Compare every other estimator with `against` on the same seconds between `low` and `high` (s).

        Returns:
            By estimator: `MEASURE_rmse_deg`, each a `paired.Difference.plain` or None, and the same by phase.
        """
        spans = {name: _within(parts, low, high) for name, parts in self._parts.items()}
        last = max((t[-1] for t, _, _ in spans.values() if len(t)), default=0.0)
        bins = int(last / paired.BIN_S) + 2
        binned = {
            name: paired.Binned.of(t, np.concatenate([np.empty((0, len(Measure)), np.float32), *errors]), bins)
            for name, (t, errors, _) in spans.items()
        }
        phase = phases.at(*self.phases(), (np.arange(bins) + 0.5) * paired.BIN_S)
        rows = {"": np.ones(bins, bool), **{PHASES[i]: phase == i for i in range(len(PHASES)) if np.any(phase == i)}}

        def of(name: str, chosen: np.ndarray) -> dict[str, Any]:
            pairs = {m: paired.over_time(binned[name], binned[against], m, chosen) for m in Measure}
            return {f"{metrics.MEASURES[m]}_rmse_deg": d and d.plain() for m, d in pairs.items()}

        return {
            name: {**of(name, rows[""]), "phases": {p: of(name, r) for p, r in rows.items() if p}}
            for name in binned
            if name != against
        }


def _mean_nees(parts: list[tuple[np.ndarray, np.ndarray]], low: float, high: float) -> float:
    """Average the NEES per degree of freedom over a span; NaN when none is known."""
    t, nees = (np.concatenate(column) for column in zip((np.empty(0), np.empty(0)), *parts, strict=True))
    known = nees[(t >= low) & (t <= high) & np.isfinite(nees)]
    return float(np.mean(known, dtype=float)) if len(known) else math.nan


Parts = Sequence[np.ndarray]
"""Pieces of an array (n, 5), joined column by column: a long flight's errors should not be in memory twice."""


def summary(errors: Parts, phase: np.ndarray) -> dict[str, Any]:
    """Summarise errors: `metrics.figures` of every measure, "availability", and the same by phase.

    "steep", where there is one, is the share of the time that roll and heading leave out (see `metrics.STEEP`).

    Args:
        errors: pieces of (n, 5) rad, columns by `metrics.Measure`.
        phase: (n,) index into `PHASES`; -1: not known.

    Returns:
        None stands for a figure that is not known.
    """
    present = [i for i in range(len(PHASES)) if np.any(phase == i)]
    found: dict[str, Any] = {}
    by_phase: dict[str, dict[str, Any]] = {PHASES[i]: {} for i in present}
    for measure, name in zip(Measure, metrics.MEASURES, strict=True):
        values = _column(errors, measure)
        found |= _finite(metrics.figures(name, values))
        for i in present:
            by_phase[PHASES[i]] |= _finite(metrics.figures(name, values[phase == i]))
        if measure is Measure.TILT:
            found["availability"] = float(np.mean(np.isfinite(values))) if len(values) else 0.0
            steep = np.isfinite(values) & ~np.isfinite(_column(errors, Measure.ROLL))
            if steep.any():
                found["steep"] = float(np.mean(steep[np.isfinite(values)]))
    for i in present:
        by_phase[PHASES[i]]["samples"] = int(np.sum(phase == i))
    return {**found, "phases": by_phase}


def _whole_ns(t: np.ndarray) -> np.ndarray:
    """Round times (s) as a log keeps them, so that a flight and its log give the same figures."""
    whole: np.ndarray = np.rint(t * 1e9) / 1e9
    return whole


def _within(parts: list[tuple[np.ndarray, ...]], low: float, high: float) -> tuple[np.ndarray, Parts, Parts]:
    """Cut a span out: times (n,), and the pieces of errors and consistency."""
    times, errors, columns = [np.empty(0)], [], []
    for t, e, c in parts:
        rows = slice(int(np.searchsorted(t, low, "left")), int(np.searchsorted(t, high, "right")))
        times.append(t[rows])
        errors.append(e[rows])
        columns.append(c[rows])
    return np.concatenate(times), errors, columns


def _column(errors: Parts, measure: Measure) -> np.ndarray:
    """Join one measure of all pieces, (n,) rad."""
    return np.concatenate([np.empty(0, np.float32), *(e[:, measure] for e in errors)])


def _details(t: np.ndarray, errors: Parts, columns: np.ndarray, band_s: float) -> dict[str, Any]:
    """Compute mean NEES and NIS, and tilt and heading RMSE (deg) of each `band_s` since t = 0."""
    consistent = consistency.summary(*columns.T)
    number = np.floor(t / band_s + 1e-6).astype(int)
    bands: dict[str, list[float | None]] = {}
    for measure in (Measure.TILT, Measure.HEADING):
        squares = np.degrees(_column(errors, measure).astype(float)) ** 2
        finite = np.isfinite(squares) & (number >= 0)
        count = np.bincount(number[finite])
        total = np.bincount(number[finite], squares[finite])
        bands[metrics.MEASURES[measure]] = [math.sqrt(x / n) if n else None for x, n in zip(total, count, strict=True)]
    return {**_finite({key: consistent[key] for key in ("nis",)}), "bands": bands}


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    """Replace NaN, which JSON has not, by None."""
    return {k: v if math.isfinite(v) else None for k, v in values.items()}
