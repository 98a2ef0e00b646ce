"""`ahrs-sim compare`: how wrong was each estimator, over all and by phase of the flight."""

import csv as csv_form
import io
import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.evaluation import metrics, paired
from ahrs_sim.evaluation.accuracy import Accuracy
from ahrs_sim.evaluation.metrics import History
from ahrs_sim.evaluation.phases import PHASES
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.reader import quaternion, stamps, vector
from ahrs_sim.log.topics import REFERENCE, STATE
from ahrs_sim.recordings import frames
from ahrs_sim.review.export import plain_cell

TRUTH_TOPIC = "/truth/imu"
STATE_TOPIC = "/truth/state"
AIR_TOPIC = "/truth/air"
TRUTH_TOPICS = TRUTH_TOPIC, STATE_TOPIC, AIR_TOPIC
SMOOTHED = "smoothed"
"""As a reference: the smoothed estimates of a log (`fly --smooth`, `replay --smooth`)."""

FULL = 0.995
"""Share of the time with an estimate from which on the table does not mention it."""


def compare(
    path: Path,
    *,
    reference: str | None = None,
    start: float | None = None,
    end: float | None = None,
    band_s: float | None = None,
    align: str | None = None,
    sync: bool = False,
    against: str | None = None,
) -> dict[str, Any]:
    """Compute errors of every estimator in a log.

    Args:
        path: the log.
        reference: an estimator of the log, "smoothed" for the one that is smoothed, or any topic with orientations (its
            axes as its frame names say, else FLU and ENU), to compare with; None: the truth, else the reference that a
            replay has left.
        start, end: only samples in this span, s of flight.
        align: remove a constant rotation of each estimator before comparing: "heading" (about
            down), or "frames" (one in each frame).
        sync: remove a constant delay of each estimator before comparing.
        against: an estimator of the log: also differences of all others from it, on the same seconds.
        band_s: for campaigns: also the RMSE of every so many seconds, and mean NEES and NIS per degree of freedom.

    Returns:
        {"log", "reference", "from_s", "to_s", "estimators": {NAME: {"tilt_rmse_deg"..., "availability",
        "phases": {PHASE: {...}}}}}; with `align` "aligned_deg" and with `sync` "delay_s"; with `against`
        "paired": {"against", "estimators": `Accuracy.paired`}; with `band_s` also "nees",
        "nis" and "bands": {MEASURE: [...]}. A value that is not known (a heading that the method does not estimate)
        is None.

    Raises:
        InputError: no log, no truth or estimator in it, or an unknown reference.
    """
    low, high = -math.inf if start is None else start, math.inf if end is None else end
    with FlightReader(path) as log:
        names = log.estimators
        if not names:
            raise InputError(
                f"{path}: no estimates in it (no topic /est/NAME/state); replay it with an estimator first"
            )
        if against is not None and against not in names:
            raise InputError(f"{path}: --against {against}: no such estimator in this log{nearest(against, names)}")
        has_truth = TRUTH_TOPIC in log.topics
        if reference is None and not has_truth and REFERENCE.topic in log.topics:
            reference = REFERENCE.topic
        references: dict[str, History] | None = None
        removed: dict[str, dict[str, Any]] = {name: {} for name in names}
        if reference is not None or align is not None or sync:
            history = attitudes(log, reference)
            adjusted = {name: aligned(log, name, history, low, high, align, sync) for name in names}
            references = {name: a for name, (a, _) in adjusted.items()}
            removed = {name: r for name, (_, r) in adjusted.items()}
        elif not has_truth:
            raise InputError(f"{path}: no {TRUTH_TOPIC} in it: there is nothing to compare with")
        accuracy = Accuracy(names, against=references, with_consistency=band_s is not None)
        read_into(accuracy, log, names, with_consistency=band_s is not None)
    result = result_of(accuracy, path, reference or "truth", low, high, band_s=band_s)
    for name, values in removed.items():
        result["estimators"][name] |= values
    if against is not None:
        result["paired"] = {"against": against, "estimators": accuracy.paired(against, low=low, high=high)}
    return result


def read_into(accuracy: Accuracy, log: FlightReader, names: Iterable[str], *, with_consistency: bool = False) -> None:
    """Feed the truth and the estimates of a log to an accuracy in one pass.

    Raises:
        InputError: a part of the truth is missing.
    """
    topics = {f"/est/{name}{STATE.topic}": name for name in names}
    needed = TRUTH_TOPICS if TRUTH_TOPIC in log.topics else ()
    if missing := [topic for topic in needed if topic not in log.topics]:
        raise InputError(f"{log.path}: no {missing[0]} in it: there is nothing to compare with")
    columns = {"q_nb", "down_b", "att_cov", *(("innovation", "innovation_var") if with_consistency else ())}
    for block in log.blocks([*needed, *topics]):
        if needed:
            read_truth_into(accuracy, log, block)
        for topic, name in topics.items():
            accuracy.add_estimates(name, log.estimates_in(block[topic], columns))


def read_truth_into(accuracy: Accuracy, log: FlightReader, messages: Mapping[str, np.ndarray]) -> None:
    """Feed the truth in messages of `TRUTH_TOPICS` to an accuracy."""
    imu, state, air = (messages[topic] for topic in TRUTH_TOPICS)
    rows = min(map(len, (imu, state, air)))  # a recovered log may end between two topics
    accuracy.add_truth(
        log.seconds(stamps(imu[:rows])),
        quaternion(imu["orientation"][:rows]),
        vector(state["velocity"][:rows]),
        air["on_ground"][:rows],
    )


def result_of(
    accuracy: Accuracy, path: Path, reference: str, low: float, high: float, **options: Any
) -> dict[str, Any]:
    """Summarise a log's accuracy, with the log's name; `options` as for `Accuracy.result`.

    Raises:
        InputError: there is nothing to compare between `low` and `high` (s).
    """
    first, last = accuracy.span()
    if first >= last:
        raise InputError(f"{path}: {TRUTH_TOPIC} is empty: there is nothing to compare with")
    if max(low, first) >= min(high, last):
        raise InputError(f"{path}: --from/--to: the log spans {first:.1f} to {last:.1f} s")
    return {"log": str(path), **accuracy.result(reference, low=low, high=high, **options)}


def attitudes(log: FlightReader, name: str | None) -> History:
    """Read the attitude of the truth (None), of an estimator, or of any topic with orientations.

    Raises:
        InputError: no such thing in the log.
    """
    if name == SMOOTHED:
        name = _only_smoothed(log)
    if name is None:
        topic = TRUTH_TOPIC
        if topic not in log.topics:
            raise InputError(f"{log.path}: no {topic} in it: there is nothing to compare with")
    elif name in log.estimators:
        topic = f"/est/{name}{STATE.topic}"
    elif name in log.topics:
        topic = name
    else:
        known = [*log.estimators, *(t.topic for t in log.topics.values() if t.type_name in frames.ORIENTATIONS)]
        raise InputError(
            f"{log.path}: --reference {name}: no such estimator or topic in this log{nearest(name, known)}"
        )
    return orientations(log, topic)


def _only_smoothed(log: FlightReader) -> str:
    """Name the smoothed estimates of a log, where there are those of one estimator."""
    found = [name for name in log.estimators if name.endswith(f"_{SMOOTHED}")]
    if len(found) == 1:
        return found[0]
    which = (
        f"several smoothed estimates; name one: {', '.join(found)}" if found else "no smoothed estimates in this log"
    )
    raise InputError(f"{log.path}: --reference {SMOOTHED}: {which}")


def orientations(log: FlightReader, topic: str) -> History:
    """Read `q_nb` over time of any topic with orientations, in the order of its stamps.

    Raises:
        InputError: its type has none, or it says nothing.
    """
    kind = log.topics[topic].type_name
    if kind not in frames.ORIENTATIONS:
        raise InputError(f"{log.path}: --reference {topic}: a {kind} has no orientation")
    parts = []
    for block in log.blocks(topic):
        if len(block):
            q = frames.q_ned(frames.orientation(block, kind), *frames.named(block, kind))
            known = np.isfinite(q).all(axis=1)
            parts.append((log.seconds(stamps(block))[known], q[known]))
    t, q_nb = (np.concatenate(column) for column in zip(*parts, strict=True)) if parts else (np.empty(0),) * 2
    if len(t) < 2:
        raise InputError(f"{log.path}: {topic} has no attitude to compare with")
    t, first = np.unique(t, return_index=True)
    return History(t, q_nb[first])


def aligned(
    log: FlightReader, name: str, against: History, low: float, high: float, align: str | None, sync: bool
) -> tuple[History, dict[str, Any]]:
    """Align the reference to an estimator by a constant delay and rotation; also return what was removed."""
    if align is None and not sync:
        return against, {}
    from ahrs_sim.evaluation import sync as syncing

    t, q_nb = _known_attitudes(log, f"/est/{name}/state")
    within = (t >= low) & (t <= high)
    t, q_nb = t[within], q_nb[within]
    removed: dict[str, Any] = {}
    times, q_ref = against.t, against.q_nb
    if sync and len(t):
        at = np.arange(t[0] + 0.1, t[-1] - 0.1, 0.1)
        rate_b = syncing.rates(t, q_nb, at, 0.1)
        known = np.isfinite(rate_b[:, 0])
        delay = syncing.time_shift(at[known], rate_b[known], 0.1, times, q_ref) or 0.0
        times, removed["delay_s"] = times - delay, -delay
    if align is not None and len(t):
        every = max(1, len(t) // 20000)
        q_nb, q_here = q_nb[::every], attitude.interpolate(times, q_ref, t[::every])
        left, right = np.array([1.0, 0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
        if align == "heading":
            half = 0.5 * syncing.heading_offset(q_nb, q_here)
            left = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
        else:
            left, right = syncing.constant_rotations(q_nb, q_here)
        q_ref = attitude.product(attitude.product(left[None], q_ref), right[None])
        removed["aligned_deg"] = [math.degrees(2 * math.acos(min(1.0, abs(float(q[0]))))) for q in (left, right)]
    return History(times, q_ref), removed


def _known_attitudes(log: FlightReader, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Read times (n,) and attitudes (n, 4) of an estimator, where it has one."""
    blocks = [(log.seconds(stamps(b)), quaternion(b["orientation"])) for b in log.blocks(topic)]
    t, q_nb = (np.concatenate(column) for column in zip(*blocks, strict=True)) if blocks else (np.empty(0),) * 2
    known = np.isfinite(q_nb).all(axis=-1)
    if known.sum() < 2:
        raise InputError(f"{log.path}: {topic} has no attitude to compare with")
    return t[known], q_nb[known]


def table(result: dict[str, Any], *, details: bool = False, reasons: Sequence[str] | None = None) -> str:
    """Format the result for a reader: tilt and heading by phase, best tilt first.

    Args:
        result: of `compare`.
        details: add every measure.
        reasons: for figures that are missing, a line each; None: what the result itself tells.
    """
    out = io.StringIO()
    against = "the truth" if result["reference"] == "truth" else result["reference"]
    rows = dict(sorted(result["estimators"].items(), key=lambda item: item[1]["tilt_rmse_deg"] or math.inf))
    width = max(10, *(len(n) for n in rows))
    phases = [p for p in PHASES[:3] if any(p in v["phases"] for v in rows.values())]
    partial = any(values["availability"] < FULL for values in rows.values())
    print(
        f"RMS error against {against}, {result['from_s']:.0f} to {result['to_s']:.0f} s, deg: tilt / heading", file=out
    )
    heads = "".join(f"{p:>13s}" for p in [*phases, "whole flight"])
    print(f"{'':{width}s}{heads}   NEES" + "    avail" * partial, file=out)
    for name, values in rows.items():
        cells = "".join(_pair(values["phases"].get(p, {})) for p in phases) + _pair(values)
        share = f"{100.0 * values['availability']:8.1f}%" if partial else ""
        print(f"{name:{width}s}{cells}{_cell(values.get('nees'), 7)}{share}", file=out)
    for name, values in rows.items():
        if removed := _removed(values):
            print(f"{name:{width}s} {removed}", file=out)
    if steep := max((values.get("steep", 0.0) for values in rows.values()), default=0.0):
        print(f"roll and heading leave out {100 * steep:.1f} %: nose within 6 deg of the vertical", file=out)
    for line in _reasons(result) if reasons is None else reasons:
        print(textwrap.fill(line, 80, subsequent_indent="  ", break_on_hyphens=False), file=out)
    if "paired" in result:
        print(file=out)
        _paired(result["paired"], [name for name in rows if name != result["paired"]["against"]], width, details, out)
        if result["reference"] == "truth":
            print("of this flight; with other errors of the sensors: ahrs-sim campaign ... --against", file=out)
    if details:
        print(file=out)
        _details(rows, width, out)
    return out.getvalue().rstrip()


def _reasons(result: Mapping[str, Any]) -> Iterator[str]:
    """Say why figures over the whole flight are missing, a line each."""
    rows = result["estimators"]
    silent = [name for name, values in rows.items() if values["tilt_rmse_deg"] is None]
    no_heading = [n for n, values in rows.items() if values["heading_rmse_deg"] is None and n not in silent]
    no_nees = [n for n, v in rows.items() if v.get("nees") is None and n not in (*silent, *no_heading)]
    span = result["to_s"] - result["from_s"]
    if silent:
        how = "aligning takes align_s of standing, or motion for 5 s"
        yield f"no attitude in these {span:.0f} s: {', '.join(silent)}; {how}"
    if no_heading:
        yield f"no heading in the estimates, or none in what they are compared with: {', '.join(no_heading)}"
    if no_nees:
        yield f"no NEES, because no covariance is reported (att_cov): {', '.join(no_nees)}"


def _paired(found: Mapping[str, Any], names: Iterable[str], width: int, details: bool, out: io.StringIO) -> None:
    """Print the differences from one estimator, best tilt first; `details` adds the phases."""
    print(f"less that of {found['against']} on the same seconds, RMS error, deg (95 %; negative: better)", file=out)
    print(f"{'':{width}s}{'tilt':>30s}{'heading':>32s}", file=out)
    for name in names:
        values = found["estimators"][name]
        for phase, cells in {"": values, **(values["phases"] if details else {})}.items():
            title = f"  {phase}" if phase else name
            tilt, heading = (paired.cells(cells[f"{m}_rmse_deg"]) for m in ("tilt", "heading"))
            print(f"{title:{width}s}{tilt}  {heading}", file=out)


def over_logs(results: Sequence[Mapping[str, Any]], against: str) -> str:
    """Format differences from one estimator over several logs, a pair each: tilt and heading over the whole flight."""
    names = [n for n in results[0]["estimators"] if n != against and all(n in r["estimators"] for r in results)]
    width = max(10, *(len(n) for n in [*names, ""]))
    lines = [f"less that of {against} over {len(results)} logs, RMS error, deg (95 %; negative: better)"]
    for name in names:
        cells = []
        for key in ("tilt_rmse_deg", "heading_rmse_deg"):
            one, other = (np.array([r["estimators"][n][key] for r in results], float) for n in (name, against))
            difference = paired.over_runs(one, other)
            cells.append(paired.cells(difference.plain() if difference else None))
        lines.append(f"{name:{width}s}{'  '.join(cells)}")
    return "\n".join(lines)


def _details(rows: Mapping[str, Any], width: int, out: io.StringIO) -> None:
    """Print every statistic of every measure over the whole flight."""
    group = " " + "".join(f"{name:>6s}" for name in metrics.STATISTICS)
    print(f"{'':{width}s}" + "".join(f"{m:>{len(group)}s}" for m in metrics.MEASURES), file=out)
    print(f"{'':{width}s}" + group * len(metrics.MEASURES), file=out)
    for name, values in rows.items():
        cells = [[values[f"{m}_{s}_deg"] for s in metrics.STATISTICS] for m in metrics.MEASURES]
        print(f"{name:{width}s}" + "".join(" " + "".join(_cell(v) for v in c) for c in cells), file=out)


def _pair(values: Mapping[str, Any]) -> str:
    """Tilt and heading of a phase, in thirteen places."""
    tilt, heading = (_cell(values.get(f"{m}_rmse_deg"), 1) for m in ("tilt", "heading"))
    return f"{tilt:>5s} / {heading:<5s}"


def _removed(values: dict[str, Any]) -> str:
    """Name the delay and rotation removed before comparing."""
    parts = [f"delay of {values['delay_s']:+.3f} s"] if "delay_s" in values else []
    parts += [f"{a:.2f} deg" for a in values.get("aligned_deg", ()) if a > 5e-3]
    return f"{' and '.join(parts)} removed before comparing" if parts else ""


def _cell(value: float | None, width: int = 6) -> str:
    if value is None:
        return "-".rjust(width)
    form = ".2f" if value < 9.995 else ".1f" if value < 99.95 else ".0f" if value < 9999.5 else ".0e"
    return f"{value:{width}{form}}"


def csv(result: dict[str, Any]) -> str:
    """Write the result as comma-separated values: a line per estimator and phase ("all": the whole flight)."""
    keys = [f"{m}_{s}_deg" for m in metrics.MEASURES for s in metrics.STATISTICS]
    out = io.StringIO()
    rows = csv_form.writer(out, lineterminator="\n")
    rows.writerow(["estimator", "reference", "phase", *keys])
    for name, values in result["estimators"].items():
        for phase, cells in {"all": values, **values["phases"]}.items():
            numbers = ["" if cells[k] is None else repr(cells[k]) for k in keys]
            rows.writerow([plain_cell(name), plain_cell(result["reference"]), phase, *numbers])
    return out.getvalue().rstrip("\n")
