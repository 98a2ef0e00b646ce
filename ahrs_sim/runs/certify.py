"""`ahrs-sim certify`: which requirements an estimator meets, manoeuvre by manoeuvre, and whether that is shown.

A standard is a TOML file (`certification.toml` beside this one is the shipped one):

    quantile = 0.95                    # of all flights must be within a limit ...
    confidence = 0.95                  # ... shown with this confidence

    [scenario]                         # keys of a scenario that all flights share
    [flight.NAME]                      # a scenario; `figures` are laid over the grade of every suite
    [suite.NAME]                       # as in a scenario
    [estimator.NAME]                   # as in a scenario, but for its suite

    [row.NAME]                         # a line of the sheet: a part of a flight
    title = "level flight"
    flight = "ordinary"
    steps = [5, 5]                     # first and last step, or times_s = [100.0, 160.0]
    skip_s = 0.0                       # left out at its beginning

    [[requirement]]
    rows = ["level"]
    limit = {roll_p95_deg = 2.0}       # figures of `compare`, of the row's part of the flight
    source = "where it comes from"
    own = false                        # true: nobody requires it but we

A file of the user's own is laid over the shipped one; its requirements replace all of those.

A flight is one draw of its figure. With n flights the k-th smallest figure is an upper bound of the quantile q with
confidence P(fewer than k of n lie below the quantile) = B(k - 1; n, q), B the binomial distribution function, whatever
the figures' distribution (order statistics: Wilks 1941; David and Nagaraja, Order Statistics, 2003, section 7.1). For
q = 0.95 and a confidence of 0.95 the largest of 59 is the first that is one. With fewer flights nothing can be shown to
be met; that a limit is exceeded can.
"""

import copy
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.evaluation.metrics import MEASURES, STATISTICS
from ahrs_sim.runs import campaign
from ahrs_sim.runs.pool import Pool, Span
from ahrs_sim.scenario.table import Table, overlay, read_toml

SHIPPED = "certification.toml"
FIGURES = (
    *(f"{m}_{s}_deg" for m in (*MEASURES, "slip") for s in STATISTICS),
    *(f"turn_rate_{s}_dps" for s in STATISTICS),
)
"""What a limit can be of."""


def measure_of(figure: str) -> str:
    """Cut statistic and unit off a figure: `turn_rate` of `turn_rate_p95_dps`."""
    return figure.rsplit("_", 2)[0]


AVAILABLE = 0.99
"""Share of a row's time with an attitude; a flight with less exceeds every limit of the row."""

MET, NOT_MET, NOT_SHOWN = "met", "not met", "not shown"


@dataclass(frozen=True)
class Row:
    """A line of the sheet."""

    name: str
    title: str
    flight: str
    span: Span


@dataclass(frozen=True)
class Requirement:
    """A limit of one figure in one row."""

    row: Row
    figure: str
    limit: float  # deg, or deg/s of the turn rate
    source: str
    own: bool  # the project's, of no authority


@dataclass(frozen=True)
class Standard:
    """A checked standard."""

    title: str
    where: str
    quantile: float
    confidence: float
    common: Mapping[str, Any]
    flights: Mapping[str, Mapping[str, Any]]
    suites: Mapping[str, Mapping[str, Any]]
    estimators: Mapping[str, Mapping[str, Any]]
    requirements: tuple[Requirement, ...]

    @property
    def runs(self) -> int:
        """Find the least number of flights with which a limit can be shown to be met."""
        return math.ceil(math.log(1.0 - self.confidence) / math.log(self.quantile) - 1e-9)


@dataclass(frozen=True)
class Finding:
    """Holds the result of one requirement."""

    requirement: Requirement
    values: np.ndarray  # (n,) deg, a flight each; inf: no attitude for long, or no such angle
    found: float  # deg, the sample's quantile
    bound: float  # deg, upper confidence bound of the quantile; inf: too few flights
    result: str  # MET, NOT_MET, NOT_SHOWN
    run: int  # with the largest figure
    worst_s: float  # when its error was largest; NaN: not known

    @property
    def margin(self) -> float:
        """Return the margin to the limit, deg: from the bound, or with too few flights from the measured figure."""
        return self.requirement.limit - (self.bound if math.isfinite(self.bound) else self.found)


@dataclass(frozen=True)
class Sheet:
    """Holds the results of one estimator for all requirements."""

    estimator: str
    method: str
    grade: str
    runs: int
    findings: tuple[Finding, ...]
    errors: Mapping[str, str] = field(default_factory=dict)  # flights that failed, by flight, run and seed

    @property
    def passed(self) -> bool:
        """Tell whether every requirement is shown to be met."""
        return not self.errors and all(f.result == MET for f in self.findings)


# ----------------------------------------------------------------------------------------------- reading


def load(path: str | None = None) -> Standard:
    """Read and check a standard: the shipped one, or a file laid over it.

    Raises:
        InputError: no such file, an unknown key, row, flight or figure.
    """
    shipped = Path(str(resources.files("ahrs_sim.runs") / SHIPPED))
    data = read_toml(shipped).data
    if path is not None:
        data = overlay(data, read_toml(Path(path)).data)
    table = Table(data, path or str(shipped))
    flights = {name: t.data for name, t in table.named_tables("flight").items()}
    rows = {name: _row(name, t, flights) for name, t in table.named_tables("row").items()}
    requirements = [r for t in table.list_of_tables("requirement") for r in _requirements(t, rows)]
    standard = Standard(
        title=table.text("title", ""),
        where=table.where,
        quantile=table.number("quantile", 0.95, above=0.0, maximum=0.999),
        confidence=table.number("confidence", 0.95, above=0.0, maximum=0.999),
        common=table.table("scenario").data,
        flights=flights,
        suites={name: t.data for name, t in table.named_tables("suite").items()},
        estimators={name: t.data for name, t in table.named_tables("estimator").items()},
        requirements=tuple(requirements),
    )
    table.close()
    if not requirements:
        raise table.error("requirement", "missing; add [[requirement]] tables")
    return standard


def _row(name: str, table: Table, flights: Mapping[str, Any]) -> Row:
    title, flight = table.text("title"), table.choice("flight", list(flights))
    if table.has("steps") == table.has("times_s"):
        raise table.error("steps", "give either steps = [FIRST, LAST] or times_s = [FROM, TO]")
    kind = "steps" if table.has("steps") else "times_s"
    first, last = table.vector(kind, size=2)
    if not 0.0 <= first <= last:
        raise table.error(kind, f"[{first:g}, {last:g}] does not go forwards")
    skip = table.number("skip_s", 0.0, minimum=0.0)
    table.close()
    if kind == "times_s":
        return Row(name, title, flight, Span(name, times=(float(first), float(last)), skip=skip))
    count = len(flights[flight].get("step", ()))
    if not 1 <= first <= last <= count or first % 1 or last % 1:
        raise table.error(kind, f"[{first:g}, {last:g}]: the steps of flight '{flight}' are 1 to {count}")
    return Row(name, title, flight, Span(name, steps=(int(first), int(last)), skip=skip))


def _requirements(table: Table, rows: Mapping[str, Row]) -> Iterator[Requirement]:
    names, source, own = table.texts("rows"), table.text("source"), table.flag("own", False)
    limits = table.table("limit")
    values = {}
    for figure in limits.data:
        if figure not in FIGURES:
            raise limits.error(figure, f"no such figure{nearest(figure, FIGURES)}")
        values[figure] = limits.number(figure, above=0.0)
    if not values:
        raise table.error("limit", "missing; write limit = {roll_p95_deg = 2.0}")
    table.close()
    for name in names:
        if name not in rows:
            raise table.error("rows", f"'{name}' is unknown{nearest(name, rows)}")
        for figure, limit in values.items():
            yield Requirement(rows[name], figure, limit, source, own)


# ----------------------------------------------------------------------------------------------- flying


def candidates(standard: Standard, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Resolve `METHOD[@SUITE]` or `NAME[@SUITE]` of the standard's own estimators into `[estimator.NAME]` tables.

    SUITE is one of the standard's, or a grade, or grades of parts: `ins21@bmi088 + rm3100 + zed_f9p`; default `chr`. It
    is left in the table as it was given.

    Raises:
        InputError: the same twice.
    """
    made: dict[str, dict[str, Any]] = {}
    for text in names:
        method, _, suite = text.partition("@")
        suite = suite or "chr"
        name = f"{scenarios.short_name(method)}-{_slug(suite)}"
        if name in made:
            raise InputError(f"certify: {text}: given twice; keep one")
        made[name] = {**standard.estimators.get(method, {"method": method}), "suite": suite}
    return made


def _slug(text: str) -> str:
    slug = re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")
    return slug if slug[:1].isalpha() else f"suite-{slug}"


def plans(
    standard: Standard, chosen: Mapping[str, Mapping[str, Any]], runs: int, gate: scenarios.Gate
) -> dict[str, campaign.Plan]:
    """Make a campaign of each flight that a requirement asks for, all estimators aboard.

    Raises:
        InputError: a flight that is no scenario, an unknown method or grade.
    """
    made = {}
    for name in dict.fromkeys(r.row.flight for r in standard.requirements):
        data = _scenario(standard, name, chosen)
        where = f"{standard.where}: [flight.{name}]"
        scenario = scenarios.parse(data, where, name, gate=gate)
        spans = {r.row.name: r.row.span for r in standard.requirements if r.row.flight == name}
        made[name] = replace(campaign.Plan.make(scenario, runs), spans=tuple(spans.values()))
    return made


def _scenario(standard: Standard, name: str, chosen: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    data = overlay(standard.common, copy.deepcopy(dict(standard.flights[name])))
    figures = data.pop("figures", {})
    if not isinstance(figures, dict):
        raise InputError(f"{standard.where}: [flight.{name}]: figures: is not a table; write [flight.{name}.figures]")
    suites, tables = {}, {}
    for estimator, settings in chosen.items():
        grade = str(settings["suite"])
        suite = _slug(grade)
        suites[suite] = overlay(standard.suites.get(grade, {"grade": grade}), figures)
        tables[estimator] = {**settings, "suite": suite}
    return data | {"suite": suites, "estimator": tables}


def fly(
    made: Mapping[str, campaign.Plan],
    folder: str,
    pool: Pool,
    progress: Callable[[str], Callable[[int, int], None]] = lambda name: lambda done, all_: None,
) -> dict[str, campaign.Store]:
    """Fly what is missing of each flight into `folder/FLIGHT`.

    Raises:
        InputError: a folder holds flights of something else, or a flight cannot be flown as it is.
    """
    stores = {}
    for name, plan in made.items():
        stores[name] = campaign.Store(f"{folder.rstrip('/')}/{name}")
        campaign.fly(plan, stores[name], pool, progress(name))
    return stores


# ----------------------------------------------------------------------------------------------- evaluating


def bounds(values: np.ndarray, quantile: float, confidence: float) -> tuple[float, float]:
    """Bound the quantile of the distribution that `values` (n,) are drawn from, from below and from above.

    Each bound holds with `confidence` by itself; -inf or inf where there are too few values for it.
    """
    from scipy.stats import binom

    ordered = np.sort(values)
    below = binom.cdf(np.arange(len(ordered)), len(ordered), quantile)  # P(at most k - 1 values lie below the quantile)
    upper = ordered[below >= confidence - 1e-9]
    lower = ordered[1.0 - below >= confidence - 1e-9]
    return float(lower[-1]) if len(lower) else -math.inf, float(upper[0]) if len(upper) else math.inf


def evaluate(
    standard: Standard,
    chosen: Mapping[str, Mapping[str, Any]],
    stores: Mapping[str, campaign.Store],
    runs: int,
) -> list[Sheet]:
    """Evaluate every requirement for every estimator on the first `runs` flights."""
    flown = {name: [r for r in store.table().to_pylist() if r["run"] < runs] for name, store in stores.items()}
    errors = {
        f"{name}, run {row['run']} (seed {row['seed']})": str(row["error"])
        for name, rows in flown.items()
        for row in rows
        if row["error"] is not None
    }
    sheets = []
    for estimator, settings in chosen.items():
        own = {name: [r for r in rows if r["estimator"] == estimator] for name, rows in flown.items()}
        findings = tuple(_finding(standard, r, own[r.row.flight]) for r in standard.requirements)
        grade = str(standard.suites.get(str(settings["suite"]), {}).get("grade", settings["suite"]))
        sheets.append(Sheet(estimator, str(settings["method"]), grade, runs, findings, errors))
    return sheets


def _finding(standard: Standard, requirement: Requirement, rows: Sequence[Mapping[str, Any]]) -> Finding:
    name, figure = requirement.row.name, requirement.figure
    values = np.array([_value(row, name, figure) for row in rows], float)
    if not len(values):
        return Finding(requirement, values, math.nan, math.inf, NOT_SHOWN, 0, math.nan)
    lower, bound = bounds(values, standard.quantile, standard.confidence)
    result = NOT_MET if lower > requirement.limit else MET if bound <= requirement.limit else NOT_SHOWN
    found = float(np.quantile(values, standard.quantile, method="higher"))
    worst = rows[int(values.argmax())]
    moment = worst.get(f"{name}.{measure_of(figure)}_worst_s")
    return Finding(requirement, values, found, bound, result, worst["run"], math.nan if moment is None else moment)


def _value(row: Mapping[str, Any], span: str, figure: str) -> float:
    """Look up the figure of a flight; infinite where the estimator had no attitude for long, or has no such angle."""
    value = row.get(f"{span}.{figure}")
    available = row.get(f"{span}.availability") or 0.0
    return float(value) if value is not None and math.isfinite(value) and available >= AVAILABLE else math.inf
