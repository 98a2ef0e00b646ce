"""`ahrs-sim choose`: which unit, calibrated how well, with which estimator, is good enough for a scenario.

Every inertial unit among the grades flies in the same aircraft at the same time, completed by a magnetometer, a
receiver and air data where it has none of its own, as it comes and, where its grade names a calibration, calibrated;
each with every estimator. A need is an error that the median flight (or another quantile) must not exceed. Bounds
of that quantile are order statistics, as in `certify`: with five flights the largest figure is above the median with
a confidence of 1 - 0.5^5 = 97 %.
"""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.evaluation.metrics import MEASURES, STATISTICS
from ahrs_sim.evaluation.phases import PHASES
from ahrs_sim.runs import campaign
from ahrs_sim.runs.certify import MET, NOT_MET, NOT_SHOWN, bounds
from ahrs_sim.scenario import Scenario
from ahrs_sim.sensors import grade as grades
from ahrs_sim.sensors.suite import SECTIONS

PARTS = "rm3100 + zed_f9p + ms4525do"
"""What completes an inertial unit."""

ESTIMATORS: dict[str, dict[str, Any]] = {
    "marg-ckf-air": {"method": "marg-ckf", "aiding": "airspeed"},
    "air-ins": {"method": "air-ins"},
    "ins21": {"method": "ins21"},
}
"""What is flown unless others are asked for: aided by airspeed, by both, by GNSS."""

NOT_FROM_THE_SHOP = ("ideal", "chr_6dm", "sbg_ig500", "road_mems")
"""Grades with an inertial unit that are no candidates by themselves."""


@dataclass(frozen=True)
class Need:
    """An error that must not be exceeded."""

    name: str  # as given
    figure: str  # of `compare`
    limit: float  # deg

    @classmethod
    def read_all(cls, text: str) -> tuple["Need", ...]:
        """Read `tilt=0.5,heading=1`: [PHASE.]MEASURE[_STATISTIC]=DEG, the 95th percentile over the flight without one.

        Raises:
            InputError: it is not that.
        """
        needs = tuple(cls._read(part.strip()) for part in text.split(","))
        if twice := [n.name for n in needs if [m.figure for m in needs].count(n.figure) > 1]:
            raise InputError(f"--need {text}: {twice[0]}: given twice; keep one")
        return needs

    @classmethod
    def _read(cls, text: str) -> "Need":
        name, equals, number = text.partition("=")
        phase, dot, measure = name.rpartition(".")
        known = [*MEASURES, *(f"{m}_{s}" for m in MEASURES for s in STATISTICS)]
        if measure not in known:
            raise InputError(f"--need {text}: no error '{measure}'{nearest(measure, known)}")
        if dot and phase not in PHASES:
            raise InputError(f"--need {text}: no phase '{phase}'{nearest(phase, PHASES)}")
        try:
            limit = float(number)
        except ValueError:
            limit = math.nan
        if not equals or not 0.0 < limit < math.inf:
            raise InputError(f"--need {text}: write an error and degrees, e.g. tilt=0.5")
        return cls(name, f"{name}_deg" if "_" in measure else f"{name}_p95_deg", limit)


@dataclass(frozen=True)
class Found:
    """Holds the result of one need."""

    need: str
    limit: float  # deg
    found: float  # deg, the quantile among the flights; inf: no attitude, or none such
    low: float  # deg, bounds of it
    high: float
    result: str


@dataclass(frozen=True)
class Choice:
    """A unit with an estimator."""

    grade: str  # of the inertial unit, with its calibration
    suite: str  # all grades of it
    estimator: str
    needs: tuple[Found, ...]

    @property
    def result(self) -> str:
        """The worst result of all needs."""
        results = [f.result for f in self.needs]
        return next(r for r in (NOT_MET, NOT_SHOWN, MET) if r in results)

    @property
    def margin(self) -> float:
        """The least share of a limit that is left: from the upper bound, without one from what was found."""
        return min(1.0 - (f.high if math.isfinite(f.high) else f.found) / f.limit for f in self.needs)


# ----------------------------------------------------------------------------------------------- what is flown


def suites(units: Sequence[str] = (), parts: str = PARTS) -> dict[str, tuple[str, str]]:
    """Make the suites: by their name in the scenario the unit, calibrated or not, and all grades of it.

    Args:
        units: grades, or grades of parts; none: every inertial unit from the shop, as it comes and calibrated.
        parts: what completes each; a part that a unit has itself is left out.

    Raises:
        InputError: an unknown grade, or one without an inertial unit.
    """
    made: dict[str, tuple[str, str]] = {}
    for unit in list(units) or list(_all_units()):
        has = set(grades.load(unit, SECTIONS, where="choose").layer)
        if "imu" not in has:
            raise InputError(f"choose: --grade {unit}: has no inertial unit; it is a part (--with)")
        more = [p for p in parts.split(" + ") if not set(grades.load(p, SECTIONS, where="choose").layer) <= has]
        made[f"s{len(made) + 1}"] = (unit, " + ".join([unit, *more]))
    return made


def _all_units() -> Iterator[str]:
    for name in grades.names():
        grade = grades.load(name, SECTIONS)
        if "imu" in grade and name not in NOT_FROM_THE_SHOP:
            yield name
            if grade.calibration:
                yield f"{name} + {grade.calibration}"


def plan(
    scenario: Scenario, made: Mapping[str, tuple[str, str]], methods: Sequence[str], runs: int, gate: scenarios.Gate
) -> campaign.Plan:
    """Make the campaign: the scenario with all suites, each with every estimator.

    Place, mounting and figures that the scenario states for its first suite hold for each of them.
    """
    data = copy.deepcopy(scenario.data)
    data.pop("pilot", None)  # what is chosen does not fly
    for fault in data.get("fault", ()):
        fault.pop("suite", None)
    first: dict[str, Any] = next(iter(data["suite"].values()), {})
    own = ("grade", "instruments", "rate_hz", "unit_seed", "correction")
    mounted = {k: v for k, v in first.items() if k not in own}
    chosen = {scenarios.short_name(m): {"method": m} for m in methods} or ESTIMATORS
    data["suite"] = {name: {**mounted, "grade": grade} for name, (_, grade) in made.items()}
    data["estimator"] = {f"{e}-{s}": {**settings, "suite": s} for s in made for e, settings in chosen.items()}
    return campaign.Plan.make(scenarios.parse(data, scenario.where, scenario.name, gate=gate), runs)


# ----------------------------------------------------------------------------------------------- what is found


def rank(
    store: campaign.Store,
    made: Mapping[str, tuple[str, str]],
    needs: Sequence[Need],
    quantile: float,
    confidence: float,
) -> list[Choice]:
    """Rank what was flown: first what meets all needs, then by margin."""
    values: dict[str, list[dict[str, Any]]] = {}
    columns = ["estimator", "availability", *(n.figure for n in needs)]
    for row in store.table(columns).to_pylist():
        if row["estimator"] is not None:
            values.setdefault(row["estimator"], []).append(row)
    choices = []
    for name, rows in values.items():
        estimator, _, suite = name.rpartition("-")
        found = tuple(_found(need, rows, quantile, confidence) for need in needs)
        choices.append(Choice(*made[suite], estimator, found))
    order = (MET, NOT_SHOWN, NOT_MET)
    return sorted(choices, key=lambda c: (order.index(c.result), -c.margin, c.suite, c.estimator))


def _found(need: Need, rows: Sequence[Mapping[str, Any]], quantile: float, confidence: float) -> Found:
    known = [row.get(need.figure) for row in rows]
    figures = np.array([v if v is not None and math.isfinite(v) else math.inf for v in known], float)
    low, high = bounds(figures, quantile, confidence)
    result = NOT_MET if low > need.limit else MET if high <= need.limit else NOT_SHOWN
    found = float(np.quantile(figures, quantile, method="higher"))
    return Found(need.name, need.limit, found, low, high, result)


def text(choices: Sequence[Choice], quantile: float, confidence: float, runs: int) -> str:
    """Format a ranking for the terminal."""
    names = [f"{f.need} <= {f.limit:g}" for f in choices[0].needs] if choices else []
    lines = [("", "unit", "estimator", *names, "margin", "result")]
    for i, c in enumerate(choices, 1):
        margin = f"{100 * c.margin:+.0f} %" if math.isfinite(c.margin) else "-"
        lines.append((str(i), c.grade, c.estimator, *(_span(f) for f in c.needs), margin, c.result))
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    out = ["  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines]
    which = "median" if quantile == 0.5 else f"{100 * quantile:g} % quantile"
    note = f"deg, {which} of {runs} flights and its bounds, each with {100 * confidence:g} % confidence"
    out += ["", f"{note}; margin: least share of a limit that is left"]
    if runs < (least := math.ceil(math.log(1.0 - confidence) / math.log(quantile) - 1e-9)):
        out.append(f"{least} flights are the least that show a need met (--runs {least})")
    return "\n".join(out)


def _span(found: Found) -> str:
    def number(x: float) -> str:
        return f"{x:.2f}" if math.isfinite(x) else "-"

    return f"{number(found.found)} ({number(found.low)}..{number(found.high)})"


def as_json(choices: Sequence[Choice]) -> list[dict[str, Any]]:
    """Convert a ranking for a machine; JSON has no infinity, so None."""

    def plain(found: Found) -> dict[str, Any]:
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(found).items()}

    return [
        {
            "grade": c.grade,
            "suite": c.suite,
            "estimator": c.estimator,
            "result": c.result,
            "margin": c.margin if math.isfinite(c.margin) else None,
            "needs": [plain(f) for f in c.needs],
        }
        for c in choices
    ]
