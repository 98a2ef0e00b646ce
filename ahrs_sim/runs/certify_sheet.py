"""Sheets of `ahrs-sim certify`: text, Markdown, HTML with links to the worst moments, JSON, JUnit."""

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ahrs_sim.runs import campaign
from ahrs_sim.runs.certify import MET, NOT_MET, Finding, Sheet, Standard, measure_of
from ahrs_sim.runs.junit import Case, document
from ahrs_sim.runs.pool import Pool, fly_all

Links = Mapping[tuple[str, int], str]
"""Reports by name of the flight and number of the run."""

_HEADS = ("row", "figure", "limit", "found", "bound", "margin", "result")


def _number(value: float, sign: str = "") -> str:
    return f"{value:{sign}.2f}" if math.isfinite(value) else "-"


def _cells(finding: Finding) -> tuple[str, ...]:
    r = finding.requirement
    own = "*" if r.own else ""
    found = "none" if finding.found == math.inf else _number(finding.found)
    numbers = (f"{r.limit:g}{own}", found, _number(finding.bound), _number(finding.margin, "+"))
    return (r.row.title, r.figure.removesuffix("_deg").replace("_", " "), *numbers, finding.result)


def summary(standard: Standard, sheet: Sheet) -> str:
    """Count in one line what was met, what not, and what could not be shown."""
    results = [f.result for f in sheet.findings]
    texts = [f"{results.count(r)} {r}" for r in dict.fromkeys([MET, NOT_MET, *results])]
    few = f"; {standard.runs} flights are the least that show anything met" if sheet.runs < standard.runs else ""
    failed = f"; {len(sheet.errors)} flights failed" if sheet.errors else ""
    return f"{sheet.estimator}: {'passed' if sheet.passed else 'not passed'}: {', '.join(texts)}{failed}{few}"


def _notes(standard: Standard, sheet: Sheet) -> Iterator[str]:
    """Write the notes under the sheet: meaning of the columns, source of the limits."""
    yield (
        f"found: {100 * standard.quantile:g} % quantile over {sheet.runs} flights, deg (turn rate: deg/s); bound: its "
        f"upper bound with {100 * standard.confidence:g} % confidence; margin: limit less bound (without: less found)"
    )
    sources = dict.fromkeys((f.requirement.own, f.requirement.source) for f in sheet.findings)
    yield from (f"{'limit*, of the project alone' if own else 'limit'}: {source}" for own, source in sources)


def text(standard: Standard, sheet: Sheet) -> str:
    """Format a sheet for the terminal."""
    lines = [_HEADS, *(_cells(f) for f in sheet.findings)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(_HEADS))]
    out = [f"{sheet.estimator} ({sheet.method} on {sheet.grade})", ""]
    before = ""
    for line in lines:
        shown = ("" if line[0] == before else line[0], *line[1:])
        before = line[0]
        cells = [c.rjust(w) if 2 <= i <= 5 else c.ljust(w) for i, (c, w) in enumerate(zip(shown, widths, strict=True))]
        out.append("  ".join(cells).rstrip())
    failed = [f"{where}: {error}" for where, error in sheet.errors.items()]
    return "\n".join([*out, "", *_notes(standard, sheet), *failed, summary(standard, sheet)])


def markdown(standard: Standard, sheets: Sequence[Sheet], command: str) -> str:
    """Format sheets as a page: the results of all side by side, then each sheet.

    Args:
        standard: that was used.
        sheets: of one estimator each.
        command: that makes the page.
    """
    out = ["# Certification sheets", "", f"<!-- made by `{command}` -->", "", f"{standard.title}."]
    out += ["", *(f"* {note}" for note in _notes(standard, sheets[0]))]
    names = [s.estimator for s in sheets]
    out += ["", f"| row | {' | '.join(names)} |", f"|---|{'---|' * len(names)}"]
    for row in dict.fromkeys(f.requirement.row for f in sheets[0].findings):
        cells = [_worst([f for f in s.findings if f.requirement.row == row]) for s in sheets]
        out.append(f"| {row.title} | {' | '.join(cells)} |")
    out += ["", "In a cell: the result that is worst among the row's figures, and the figure with the least margin."]
    for sheet in sheets:
        out += [
            "",
            f"## {sheet.estimator}",
            "",
            f"`{sheet.method}` on `{sheet.grade}`. {summary(standard, sheet)}.",
            "",
        ]
        out += [f"| {' | '.join(_HEADS)} |", "|---|---|--:|--:|--:|--:|---|"]
        out += [f"| {' | '.join(_cells(f))} |" for f in sheet.findings]
    return "\n".join(out) + "\n"


def _worst(findings: Sequence[Finding]) -> str:
    order = (NOT_MET, "not shown", MET)
    result = min((f.result for f in findings), key=order.index)
    least = min(findings, key=lambda f: f.margin / f.requirement.limit)
    mark = f"**{result}**" if result == NOT_MET else result
    shown = _cells(least)[3]
    return f"{mark}: {measure_of(least.requirement.figure).replace('_', ' ')} {shown} of {least.requirement.limit:g}"


def as_json(standard: Standard, sheets: Sequence[Sheet]) -> dict[str, Any]:
    """Convert sheets for a machine; JSON has neither NaN nor infinity, so None."""

    def known(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        "title": standard.title,
        "quantile": standard.quantile,
        "confidence": standard.confidence,
        "passed": all(s.passed for s in sheets),
        "sheets": [
            {
                "estimator": s.estimator,
                "method": s.method,
                "grade": s.grade,
                "runs": s.runs,
                "passed": s.passed,
                "errors": dict(s.errors),
                "rows": [
                    {
                        "row": f.requirement.row.name,
                        "title": f.requirement.row.title,
                        "flight": f.requirement.row.flight,
                        "figure": f.requirement.figure,
                        "limit": f.requirement.limit,
                        "source": f.requirement.source,
                        "own": f.requirement.own,
                        "flights": len(f.values),
                        "found": known(f.found),
                        "bound": known(f.bound),
                        "margin": known(f.margin),
                        "result": f.result,
                        "worst_run": f.run,
                        "worst_s": known(f.worst_s),
                    }
                    for f in s.findings
                ],
            }
            for s in sheets
        ],
    }


def junit(sheets: Sequence[Sheet], seconds: float) -> str:
    """Format sheets for CI systems: a test case a row and figure; what is not shown to be met fails.

    A flight that failed is a failed case of every estimator aboard.

    Args:
        sheets: of one estimator each.
        seconds: that the flights took, shared equally by the cases: a flight serves many rows.
    """
    found: list[tuple[str, str, str | None]] = []
    for sheet in sheets:
        for finding in sheet.findings:
            r = finding.requirement
            failure = None if finding.result == MET else "  ".join(_cells(finding))
            found.append((sheet.estimator, f"{r.row.name}.{r.figure}", failure))
        found += [(sheet.estimator, where, error) for where, error in sheet.errors.items()]
    return document("ahrs-sim certify", [Case(e, name, seconds / len(found), failure) for e, name, failure in found])


# ----------------------------------------------------------------------------------------------- page with links


def reports(plans: Mapping[str, campaign.Plan], sheets: Sequence[Sheet], folder: Path, pool: Pool) -> Links:
    """Fly the worst run of each row once more, and make its report in `folder`; the same flight to the byte."""
    from ahrs_sim.review import report, traces

    folder.mkdir(parents=True, exist_ok=True)
    wanted = dict.fromkeys((f.requirement.row.flight, f.run) for s in sheets for f in s.findings if len(f.values))
    logs = {key: folder / f"{key[0]}-run{key[1]:03d}.mcap" for key in wanted}
    again = (replace(plans[key[0]].run(key[1]), key=key, band_s=None, log=str(log)) for key, log in logs.items())
    made = {}
    for outcome in fly_all(pool, again):
        log = logs[outcome.key]
        if outcome.error is None:
            page = log.with_suffix(".html")
            report.write([traces.gather(log)], page)
            made[outcome.key] = f"{folder.name}/{page.name}"
        log.unlink(missing_ok=True)
    return made


def page(standard: Standard, sheets: Sequence[Sheet], links: Links) -> str:
    """Format sheets as an HTML page; every row leads to the worst moment in a report."""
    out = [_HEAD, f"<h1>{html.escape(standard.title)}</h1>"]
    for sheet in sheets:
        out.append(f"<h2>{html.escape(sheet.estimator)}</h2><p>{html.escape(summary(standard, sheet))}</p><table><tr>")
        out += [f"<th>{head}</th>" for head in (*_HEADS, "worst moment")]
        for f in sheet.findings:
            cells = "".join(f"<td>{html.escape(cell)}</td>" for cell in _cells(f))
            out.append(f'</tr><tr class="{f.result.replace(" ", "-")}">{cells}<td>{_link(f, links)}</td>')
        out.append("</tr></table>")
        notes = [*_notes(standard, sheet), *(f"{where}: {error}" for where, error in sheet.errors.items())]
        out += [f"<p>{html.escape(note)}</p>" for note in notes]
    return "\n".join(out) + "\n"


def _link(finding: Finding, links: Links) -> str:
    flight = finding.requirement.row.flight
    target = links.get((flight, finding.run))
    known = math.isfinite(finding.worst_s)
    shown = f"run {finding.run}, {finding.worst_s:.0f} s" if known else f"run {finding.run}"
    if target is None:
        return shown
    return f'<a href="{html.escape(target)}{f"#t={finding.worst_s:.1f}" if known else ""}">{shown}</a>'


_HEAD = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Certification sheet - ahrs_sim</title>
<style>
body { font: 14px/1.45 system-ui, sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; width: 100% }
th, td { text-align: left; padding: 2px 10px; border-bottom: 1px solid #ddd }
td:nth-child(n+3):nth-child(-n+6) { text-align: right; font-variant-numeric: tabular-nums }
tr.met td:nth-child(7) { background: #cfe8cf }
tr.not-met td:nth-child(7) { background: #f3c3c3 }
tr.not-shown td:nth-child(7) { background: #f5e6b8 }
</style>"""
