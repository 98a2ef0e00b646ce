"""What the papers claim and what comes out here: one module a paper, each with `reproduce(quick) -> Reproduction`.

    result = run("emitter")
    print(result.text())            # or json.dumps(result.as_json())

A module is imported when its paper is run, not before.
"""

import concurrent.futures as futures
import importlib
import math
import multiprocessing
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.flight.ahead import end_with_parent

_PAPERS = {
    "cubature": "Cubature Kalman filter for aircraft attitude, beside EKF and CDKF",
    "adaptive_ins": "Adaptive UKF of a loosely coupled INS/GNSS, heading by number of satellites",
    "fuzzy": "Fuzzy adaptive Kalman filter: measurement noise from the innovations",
    "emitter": "Gaussian-sum EKF, emitter location with one interferometer baseline",
    "switched": "Switched EKF without heading: gravity only while nothing else accelerates",
}
"""Modules of this package, with a title."""

Figure = float | str | None
"""A number (NaN: failed), words, or None: the paper has no such figure."""

_WIDTH = 118


class Outcome(StrEnum):
    """Names the result of testing a claim."""

    REPRODUCED = "reproduced"
    BETTER = "better"
    NOT = "not reproduced"
    OWN = "beyond the paper"


@dataclass(frozen=True)
class Claim:
    """One line of a table: what the paper says, what we find under the same conditions."""

    what: str
    paper: Figure
    ours: Figure
    unit: str = ""
    outcome: Outcome = Outcome.OWN
    reason: str = ""  # needed when the claim does not hold
    runs: int = 1  # of the Monte Carlo behind `ours`


@dataclass(frozen=True)
class Reproduction:
    """Holds all claims of one paper with their results."""

    name: str
    title: str
    source: str
    conditions: str
    claims: Sequence[Claim]

    def as_json(self) -> dict[str, Any]:
        """Convert everything for `json.dumps`: a figure that failed (NaN) is the word "failed"."""
        content = asdict(self)
        for claim in content["claims"]:
            for key in ("paper", "ours"):
                if isinstance(claim[key], float) and not math.isfinite(claim[key]):
                    claim[key] = "failed"
        return content

    def _rows(self) -> tuple[list[tuple[str, ...]], list[str]]:
        """Lay out the table, its head first, and the reasons that its last column numbers."""
        reasons = list(dict.fromkeys(claim.reason for claim in self.claims if claim.reason))
        rows: list[tuple[str, ...]] = [("", "paper", "ours", "unit", "runs", "outcome")]
        for claim in self.claims:
            mark = f" [{reasons.index(claim.reason) + 1}]" if claim.reason else ""
            figures = (_figure(claim.paper), _figure(claim.ours), claim.unit)
            rows.append((claim.what, *figures, str(claim.runs), f"{claim.outcome}{mark}"))
        return rows, reasons

    def markdown(self) -> str:
        """Format a section of a page: conditions, table, reasons."""
        (head, *rows), reasons = self._rows()
        lines = [f"## {self.name}", "", f"{self.title}. {self.source}.", "", self.conditions, ""]
        lines += [f"| {' | '.join(head)} |", "|---|--:|--:|---|--:|---|"]
        for what, *cells in rows:
            lines.append(f"| {' | '.join([what.replace('  ', '&emsp;', 1), *cells])} |")
        return "\n".join([*lines, "", *(f"{number}. {reason}" for number, reason in enumerate(reasons, 1))]).rstrip()

    def text(self) -> str:
        """Format a table with the conditions above and the reasons below it."""
        rows, reasons = self._rows()
        widths = [max(len(row[i]) for row in rows) for i in range(6)]
        lines = [f"{self.name}: {self.title}", *_wrapped(self.source), *_wrapped(self.conditions), ""]
        for what, paper, ours, unit, runs, outcome in rows:
            line = f"{what:{widths[0]}}  {paper:>{widths[1]}}  {ours:>{widths[2]}}  {unit:{widths[3]}}"
            lines.append(f"{line}  {runs:>{widths[4]}}  {outcome}".rstrip())
        for number, reason in enumerate(reasons, 1):
            lines += _wrapped(f"[{number}] {reason}", indent=4)
        return "\n".join(lines)


def outcome_of(paper: float, ours: float, tolerance: float = 0.25) -> Outcome:
    """Compare a figure of which less is better (an error, a time) with the paper's.

    Args:
        paper: the paper's figure, NaN when the paper says that it failed.
        ours: ours, NaN likewise.
        tolerance: how far, relative to the paper's, a figure may be off and still be the same: papers seldom say how
            many runs, which percentile, or what their plots were read from.
    """
    if math.isnan(paper):
        return Outcome.REPRODUCED if math.isnan(ours) else Outcome.BETTER
    if ours < (1.0 - tolerance) * paper:
        return Outcome.BETTER
    return Outcome.REPRODUCED if ours <= (1.0 + tolerance) * paper else Outcome.NOT


def holds(claim: bool) -> Outcome:
    """Outcome of a claim that is true or false."""
    return Outcome.REPRODUCED if claim else Outcome.NOT


def names() -> list[str]:
    """List the papers that can be run."""
    return list(_PAPERS)


def title(name: str) -> str:
    """Read what the paper is about, one line.

    Raises:
        InputError: no such paper.
    """
    if name not in _PAPERS:
        raise InputError(f"no paper '{name}'{nearest(name, _PAPERS)}")
    return _PAPERS[name]


def run(name: str, quick: bool = False) -> Reproduction:
    """Reproduce one paper.

    Args:
        name: see `names`.
        quick: with a tenth of the Monte Carlo runs or less, to see that it works; the outcomes are then not worth much.

    Raises:
        InputError: no such paper.
    """
    title(name)
    result = importlib.import_module(f"ahrs_sim.papers.{name}").reproduce(quick)
    assert isinstance(result, Reproduction)
    return result


def run_all(chosen: Sequence[str], quick: bool = False, workers: int = 2) -> Iterator[Reproduction]:
    """Run several papers, each in a process of its own; yield in the order asked for, as they are ready."""
    if len(chosen) < 2 or workers < 2:
        yield from (run(name, quick) for name in chosen)
        return
    context = multiprocessing.get_context("spawn")
    with futures.ProcessPoolExecutor(workers, mp_context=context, initializer=end_with_parent) as pool:
        yield from pool.map(run, chosen, [quick] * len(chosen))


def markdown(results: Sequence[Reproduction], page: str = "") -> str:
    """Write the page `docs/papers.md`: sections of the results, and of the other papers those of `page`, as it was."""
    sections = {head[1]: head[0].rstrip() for head in re.findall(r"(^## (\w+)\n.*?)(?=^## |\Z)", page, re.M | re.S)}
    sections |= {result.name: result.markdown() for result in results}
    head = (
        "# The papers, reproduced\n\n"
        "Made by `ahrs-sim papers --markdown docs/papers.md`; do not edit. What each paper claims, what comes out here "
        "under the same conditions, and why where it differs. No figure is tuned to match."
    )
    return "\n\n".join([head, *(sections[name] for name in names() if name in sections)]) + "\n"


def _figure(value: Figure) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    return "failed" if math.isnan(value) else f"{value:.3g}"


def _wrapped(text: str, indent: int = 0) -> list[str]:
    return textwrap.wrap(text, _WIDTH, subsequent_indent=" " * indent)
