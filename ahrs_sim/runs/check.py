"""`ahrs-sim check`: has anything become less accurate? A suite of flights against the baseline beside it.

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

The baseline holds the RMSE of every flight, estimator, phase and axis for each seed. Flights are flown again with the
same seeds, so that differences are paired; a figure is worse when the mean difference is larger than the tolerance and
its bootstrap interval lies above zero. It is changed by `renew` only, which keeps the reason.
"""

import datetime
import io
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import CheckError, InputError
from ahrs_sim.evaluation.bootstrap import interval
from ahrs_sim.evaluation.metrics import MEASURES
from ahrs_sim.evaluation.phases import PHASES
from ahrs_sim.runs import pool as flights
from ahrs_sim.runs.pool import Run
from ahrs_sim.scenario.shipped import scenario_dir
from ahrs_sim.scenario.table import Table, is_file, read_toml

STANDARD = Path(__file__).parents[2] / "tests" / "baselines" / "standard.toml"
"""The project's own suite; in a checkout only."""

_FOREIGN = scenarios.Gate()

ALL = "all"
"""The whole flight, beside its phases."""

SAME, BETTER, WORSE, NEW, GONE = "same", "better", "worse", "new", "gone"

Figures = dict[str, dict[str, dict[str, list[float]]]]
"""By flight, estimator and figure: a value a seed, NaN where there is none."""


@dataclass(frozen=True)
class Tolerance:
    """What is no change."""

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


@dataclass(frozen=True)
class Suite:
    """A checked suite."""

    name: str
    baseline: Path
    tolerance: Tolerance
    flights: tuple[Flight, ...]


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

    @property
    def passed(self) -> bool:
        """Nothing worse, nothing gone, every flight flown."""
        return not self.errors and not any(row.result in (WORSE, GONE) for row in self.rows)

    def changed(self) -> list[Row]:
        """Select the rows that have changed, worst first."""
        order = {WORSE: 0, GONE: 1, BETTER: 2, NEW: 3}
        return sorted((r for r in self.rows if r.result in order), key=lambda r: order[r.result])


@dataclass(frozen=True)
class Found:
    """What the flights of a suite have given."""

    figures: Figures
    errors: dict[str, str]


# ----------------------------------------------------------------------------------------------- reading


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
    """The settings of an estimator, with a library or file beside the suite named by its whole path."""
    method = str(settings.get("method", ""))
    kind, colon, place = ("lib", ":", method[4:]) if method.startswith("lib:") else ("", "", method)
    path, rest = (place, "") if kind else (place.rpartition(":")[0], f":{place.rpartition(':')[2]}")
    if path and is_file(folder / path):
        return {**settings, "method": f"{kind}{colon}{(folder / path).resolve()}{rest}"}
    return dict(settings)


def _methods() -> list[str]:
    """Every method of our own catalogue that makes attitudes from a sensor suite."""
    import estimators

    return [method.name for method in estimators.describe() if method.own]


def _every(
    table: Table, file: Path, estimators: Mapping[str, Any], gate: scenarios.Gate, listed: set[str]
) -> list[Flight]:
    """A flight for each shipped scenario that has none, with those of the estimators that its suites can feed."""
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


def _flight(table: Table, file: Path, estimators: Mapping[str, Any], gate: scenarios.Gate) -> Flight:
    name = table.text("scenario")
    beside = file.parent / name
    seeds = table.value("seeds", [1, 2, 3])
    if not (isinstance(seeds, list) and seeds and all(isinstance(s, int) and s >= 0 for s in seeds)):
        raise table.error("seeds", f"{seeds!r} is not a list of whole numbers")
    if len(set(seeds)) < len(seeds):
        raise table.error("seeds", "one is there twice; each flight counts once")
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
    return Flight(title, tuple(seeds), Run(None, scenario.name, scenario.where, scenario.data, code=scenario.code))


# ----------------------------------------------------------------------------------------------- flying


def fly(
    suite: Suite, *, workers: int | None = None, progress: Callable[[int, int], None] = lambda done, all_: None
) -> Found:
    """Fly every flight of a suite with every seed on processes of this machine.

    Raises:
        InputError: a scenario, or settings of an estimator, that cannot be flown.
    """
    figures: Figures = {f.name: {} for f in suite.flights}
    errors: dict[str, str] = {}
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
            if outcome.error is not None:
                errors[f"{name}, seed {seed}"] = outcome.error
            column = place[name].seeds.index(seed)
            for estimator, values in outcome.figures.items():
                mine = figures[name].setdefault(estimator, {})
                for figure, value in _judged(values):
                    mine.setdefault(figure, [math.nan] * len(place[name].seeds))[column] = value
            progress(count, total)
    return Found(figures, errors)


def _judged(values: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """The figures that a baseline holds, of a flat row."""
    yield "all.availability", float(values["availability"])
    for phase in (ALL, *PHASES):
        for axis in MEASURES:
            value = values.get(f"{axis}_rmse_deg" if phase == ALL else f"{phase}.{axis}_rmse_deg", math.nan)
            if math.isfinite(value):
                yield f"{phase}.{axis}", float(value)


# ----------------------------------------------------------------------------------------------- baseline


def read_baseline(suite: Suite) -> dict[str, Any]:
    """Read the baseline of a suite.

    Raises:
        InputError: there is none yet, or it is damaged.
    """
    try:
        baseline = json.loads(suite.baseline.read_text(encoding="utf-8"))
        _check_baseline(baseline)
    except FileNotFoundError:
        raise InputError(f"{suite.baseline}: no baseline yet; make it with --renew --why 'first baseline'") from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{suite.baseline}: not a baseline ({error}); restore it, or move it away and renew") from None
    return dict(baseline)


def _check_baseline(baseline: Any) -> None:
    """Check that a baseline has the form that `renew` writes.

    Raises:
        KeyError, TypeError, ValueError: it has not.
    """
    if not isinstance(baseline, dict) or not all(isinstance(entry, dict) for entry in _list(baseline["history"])):
        raise TypeError("no tables in it")
    for name, flight in _table(baseline["flights"]).items():
        seeds = _list(flight["seeds"])
        if not all(isinstance(seed, int) for seed in seeds):
            raise TypeError(f"seeds of {name}")
        for figures in _table(flight["estimators"]).values():
            for figure, values in _table(figures).items():
                if len(_list(values)) != len(seeds) or not all(x is None or isinstance(x, int | float) for x in values):
                    raise ValueError(f"{figure} of {name}")
                np.array(values, float)  # or it does not fit into a float


def _table(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError("something is no table")
    return value


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise TypeError("something is no list")
    return value


def renew(suite: Suite, found: Found, why: str) -> None:
    """Make what was found the baseline, with the reason in its history.

    Raises:
        CheckError: a flight has failed.
        InputError: the file cannot be written.
    """
    if found.errors:
        where, error = next(iter(found.errors.items()))
        raise CheckError(f"{suite.baseline}: not renewed: {where}: {error}")
    history = read_baseline(suite)["history"] if suite.baseline.exists() else []
    now = datetime.datetime.now(datetime.UTC).date().isoformat()
    history.append({"date": now, "version": version("ahrs-sim"), "why": why})
    data = {
        "history": history,
        "flights": {
            f.name: {
                "seeds": list(f.seeds),
                "estimators": {
                    estimator: {name: [_rounded(v) for v in values] for name, values in figures.items()}
                    for estimator, figures in found.figures[f.name].items()
                },
            }
            for f in suite.flights
        },
    }
    part = suite.baseline.with_suffix(".part")
    try:
        part.write_text(_dumps(data), encoding="utf-8")
        part.replace(suite.baseline)
    except OSError as error:
        raise InputError(f"{suite.baseline}: cannot be written: {error.strerror or error}") from None


def _rounded(value: float) -> float | None:
    return float(f"{value:.5g}") if math.isfinite(value) else None


def _dumps(data: dict[str, Any]) -> str:
    """JSON with a line per figure: what a renewal has changed can be read in a diff."""
    lists: dict[str, str] = {}

    def mark(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: mark(v) for k, v in value.items()}
        if isinstance(value, list) and not any(isinstance(x, dict) for x in value):
            lists[f"list {len(lists)}"] = json.dumps(value)
            return f"list {len(lists) - 1}"
        return value

    lines = json.dumps({k: v if k == "history" else mark(v) for k, v in data.items()}, indent=1).splitlines()
    for i, line in enumerate(lines):
        head, _, tail = line.rpartition(': "list ')
        if head:
            number, _, comma = tail.partition('"')
            lines[i] = f"{head}: {lists[f'list {number}']}{comma}"
    return "\n".join(lines) + "\n"


# ----------------------------------------------------------------------------------------------- judging


def compare(suite: Suite, found: Found) -> Result:
    """Compare what was found with the baseline.

    Raises:
        InputError: there is no baseline, or it is damaged.
    """
    kept = read_baseline(suite)["flights"]
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
    return Result(suite.name, str(suite.baseline), rows, found.errors)


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


# ----------------------------------------------------------------------------------------------- showing


_HEADS = ("flight", "estimator", "phase.axis", "baseline", "now", "change", "95 %", "tolerance", "result")


def _cells(row: Row) -> tuple[str, ...]:
    def number(x: float) -> str:
        return "-" if math.isnan(x) else f"{x:.3f}"

    span = "-" if math.isnan(row.low) else f"{row.low:+.3f}..{row.high:+.3f}"
    change = "-" if math.isnan(row.change) else f"{row.change:+.3f}"
    return (
        row.flight, row.estimator, row.figure, number(row.before), number(row.now), change, span,
        number(row.tolerance), row.result,
    )  # fmt: skip


def _collapsed(rows: Sequence[Row]) -> list[Row]:
    """New and gone estimators in one line each instead of one a figure."""
    seen: set[tuple[str, str, str]] = set()
    kept = []
    for row in rows:
        key = row.flight, row.estimator, row.result
        if row.result in (NEW, GONE) and key in seen:
            continue
        seen.add(key)
        kept.append(row)
    return kept


def summary(result: Result) -> str:
    """Count in one line how many figures are the same, better, worse."""
    count = Counter(row.result for row in result.rows)
    text = ", ".join(f"{count[v]} {v}" for v in (SAME, BETTER, WORSE, NEW, GONE) if count[v] or v in (SAME, WORSE))
    failed = f"; {len(result.errors)} flights failed" if result.errors else ""
    hint = (
        " (renew the baseline to keep what is better or new)" if result.passed and (count[BETTER] + count[NEW]) else ""
    )
    return f"{result.suite}: {'passed' if result.passed else 'FAILED'}: {text}{failed}{hint}"


def table(result: Result, *, everything: bool = False) -> str:
    """Format the result for a reader: a line a flight and estimator, then the figures that have changed (or all)."""
    out = io.StringIO()
    print(f"{'flight':18s}{'estimator':22s}{'tilt, deg':>20s}{'heading, deg':>22s}   result", file=out)
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in result.rows:
        groups.setdefault((row.flight, row.estimator), []).append(row)
    for (flight, estimator), rows in groups.items():
        figures = {row.figure: row for row in rows}
        tilt, heading = (_pair(figures.get(f"all.{axis}")) for axis in ("tilt", "heading"))
        kinds = {row.result for row in rows}
        kind = next(v for v in (WORSE, GONE, BETTER, NEW, SAME) if v in kinds)
        print(f"{flight:18s}{estimator:22s}{tilt:>20s}{heading:>22s}   {kind}", file=out)
    shown = result.rows if everything else _collapsed(result.changed())
    if shown:
        lines = [_HEADS, *(_cells(row) for row in shown)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(_HEADS))]
        print(file=out)
        for line in lines:
            cells = [c.ljust(w) if i < 3 else c.rjust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True))]
            print("  ".join(cells), file=out)
    for where, error in result.errors.items():
        print(f"{where}: {error}", file=out)
    print(summary(result), file=out)
    return out.getvalue().rstrip()


def _pair(row: Row | None) -> str:
    if row is None:
        return "-"
    before = "-" if math.isnan(row.before) else f"{row.before:.2f}"
    return f"{before} -> {row.now:.2f}" if math.isfinite(row.now) else f"{before} -> -"


def markdown(result: Result) -> str:
    """Format the result for a comment on a pull request."""
    lines = [f"### Accuracy: {'passed' if result.passed else 'failed'}", "", summary(result)]
    shown = _collapsed(result.changed())
    if shown:
        lines += ["", f"| {' | '.join(_HEADS)} |", "|---|---|---|--:|--:|--:|--:|--:|---|"]
        for row in shown:
            *cells, kind = _cells(row)
            lines.append(f"| {' | '.join(cells)} | {f'**{kind}**' if kind in (WORSE, GONE) else kind} |")
    lines += [f"- {where}: {error}" for where, error in result.errors.items()]
    return "\n".join(lines)


def as_json(result: Result) -> dict[str, Any]:
    """Convert the result for a machine: JSON has no NaN, so None."""
    rows = [
        {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in {**asdict(r), "change": r.change}.items()}
        for r in result.rows
    ]
    return {
        "suite": result.suite,
        "baseline": result.baseline,
        "passed": result.passed,
        "errors": result.errors,
        "rows": rows,
    }


def junit(result: Result) -> str:
    """Format the result for CI systems: a test case a flight and estimator, and one a failed flight."""
    from xml.etree import ElementTree as Xml

    suite = Xml.Element("testsuite", name=f"ahrs-sim check {result.suite}")
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in result.rows:
        groups.setdefault((row.flight, row.estimator), []).append(row)
    failures = 0
    for (flight, estimator), rows in groups.items():
        case = Xml.SubElement(suite, "testcase", classname=flight, name=estimator)
        bad = [row for row in rows if row.result in (WORSE, GONE)]
        if bad:
            failures += 1
            failure = Xml.SubElement(case, "failure", message=f"{len(bad)} figures worse")
            failure.text = "\n".join("  ".join(_cells(row)) for row in bad)
    for where, error in result.errors.items():
        failures += 1
        Xml.SubElement(Xml.SubElement(suite, "testcase", classname="flight", name=where), "failure", message=error)
    suite.set("tests", str(len(groups) + len(result.errors)))
    suite.set("failures", str(failures))
    return Xml.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"
