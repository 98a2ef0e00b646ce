"""The result of `ahrs-sim check` for people, pull requests, machines and CI systems."""

import io
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ahrs_sim.runs.check import BETTER, GONE, NEW, SAME, WORSE, Result, Row
from ahrs_sim.runs.junit import Case, document

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
    """Format the result for CI systems: a test case a flight and estimator, which fails with the flight.

    The time of a flight, of all its seeds, is shared equally by its cases.
    """
    groups: dict[tuple[str, str], list[Row]] = {(f, e): [] for f, names in result.flown.items() for e in names}
    for row in result.rows:
        groups.setdefault((row.flight, row.estimator), []).append(row)
    share = Counter(flight for flight, _ in groups)
    cases = []
    for (flight, estimator), rows in groups.items():
        failed = [
            f"{where.removeprefix(f'{flight}, ')}: {error}"
            for where, error in result.errors.items()
            if where.startswith(f"{flight}, seed ")
        ]
        bad = [row for row in rows if row.result in (WORSE, GONE)]
        message = "; ".join([*failed, *([f"{len(bad)} figures worse"] if bad else [])])
        details = "\n".join("  ".join(_cells(row)) for row in bad)
        seconds = result.seconds.get(flight, 0.0) / share[flight]
        cases.append(Case(flight, estimator, seconds, message or None, details or None))
    return document(f"ahrs-sim check {result.suite}", cases)
