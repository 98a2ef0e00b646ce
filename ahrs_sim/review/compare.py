"""`ahrs-sim compare`: how wrong was each estimator, over all and by phase of the flight."""

import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.evaluation import consistency, metrics
from ahrs_sim.evaluation.metrics import History
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.reader import quaternion, stamps, vector
from ahrs_sim.log.topics import REFERENCE, STATE
from ahrs_sim.recordings import frames
from estimators.types import Estimates

TRUTH_TOPIC = "/truth/imu"
STATE_TOPIC = "/truth/state"
AIR_TOPIC = "/truth/air"
TRUTH_TOPICS = TRUTH_TOPIC, STATE_TOPIC, AIR_TOPIC

TURN_RATE = math.radians(3.0)
"""rad/s of heading (mean over 2 s) from which on a flight is turning: the standard rate, 360 deg in two minutes."""

ACCELERATION = 1.0
"""m/s2 along the path (mean over 2 s) from which on flight is not steady: take-off, flare, roll-out."""

CLIMB = 1.5
"""m/s of climb or sink (mean over 2 s) from which on flight is not level."""

SETTLING = 20.0
"""s after a turn, a climb or an acceleration that are transient: what an estimator learnt wrong in it dies away."""

PHASE_RATE = 10.0
"""Hz at which the truth is looked at to tell the phase."""

LATE_S = 2.0
"""s that an estimate may come after the truth of its instant has: sensors deliver late."""

STANDING = 0.5
"""m/s below which an aircraft on its wheels stands."""

PHASES = ("ground", "straight", "turning", "transient")
"""Standing on the ground; steady, straight and level; turning in the air; everything else, settling included."""


class Judge:
    """Errors of estimators against the truth, as both come in: during a flight, or out of its log.

    Blocks may have any length, but the truth of an instant has to come before, and at most `LATE_S` after, what the
    estimators say of it. Only errors are kept (float32), so memory hardly grows with the flight.

    Args:
        names: of the estimators, in the order of the result.
        against: compare them with these attitudes instead; the truth then only tells the phase.
        honesty: keep NEES and NIS too.
    """

    def __init__(
        self, names: Iterable[str], *, against: Mapping[str, History] | None = None, honesty: bool = False
    ) -> None:
        self._against = against
        self._honesty = honesty
        self._parts: dict[str, list[tuple[np.ndarray, ...]]] = {name: [] for name in names}
        self._waiting: list[tuple[str, Estimates]] = []
        self._recent = metrics.NOTHING  # truth that estimates may still ask for
        self._coarse: list[tuple[np.ndarray, ...]] = []  # truth for the phases
        self._cell = -math.inf
        self._times = np.empty(0)

    def truth(self, t: np.ndarray, q_nb: np.ndarray, vel_n: np.ndarray, on_ground: np.ndarray) -> None:
        """More of the truth: s, (n, 4), (n, 3) m/s NED, weight on the wheels; t rising."""
        if not len(t):
            return
        t = _whole_ns(t)
        self._recent = self._recent.then(t, q_nb, LATE_S)
        rows, self._cell = _coarse(t, self._cell)
        self._coarse.append((t[rows], q_nb[rows].astype(np.float32), vel_n[rows].astype(np.float32), on_ground[rows]))
        waiting, self._waiting = self._waiting, []
        for name, estimates in waiting:
            self.estimates(name, estimates)

    def estimates(self, name: str, block: Estimates) -> None:
        """More of what an estimator says."""
        block = replace(block, t=_whole_ns(block.t))
        if self._against is None:
            known = int(np.sum(self._recent.reached(block.t)))
            if known < len(block):
                self._waiting.append((name, block[known:]))
                block = block[:known]
            history = self._recent
        else:
            history = self._against[name]
        if not len(block):
            return
        reference = history.at(block.t)
        errors = metrics.attitude_errors(block.q_nb, block.down_b, reference).astype(np.float32)
        honesty = _honesty(block, reference) if self._honesty else np.empty((len(block), 0), np.float32)
        if np.array_equal(block.t, self._times):  # of the estimator before: one array for both
            block = replace(block, t=self._times)
        self._times = block.t
        self._parts[name].append((block.t, errors, honesty))

    def span(self) -> tuple[float, float]:
        """First and last time (s) there is something to compare with; (inf, -inf) when nowhere."""
        if self._against is not None:
            ends = [(h.t[0], h.t[-1]) for h in self._against.values()]
        else:
            ends = [(p[0][0], self._recent.t[-1]) for p in self._coarse[:1]]
        return min((float(a) for a, _ in ends), default=math.inf), max((float(b) for _, b in ends), default=-math.inf)

    def result(
        self, reference: str = "truth", *, low: float = -math.inf, high: float = math.inf, band_s: float | None = None
    ) -> dict[str, Any]:
        """What `compare` returns but for the log's name, over the span from `low` to `high` (s)."""
        first, last = self.span()
        t_phase, phase = np.empty(0), np.empty(0, np.int8)
        if sum(len(part[0]) for part in self._coarse) >= 2:
            t_phase, q_nb, vel_n, on_ground = (np.concatenate(c) for c in zip(*self._coarse, strict=True))
            phase = phases(t_phase, q_nb, vel_n, on_ground).astype(np.int8)
        found = {}
        for name, parts in self._parts.items():
            t, errors, honesty = _within(parts, low, high)
            found[name] = _summary(errors, phase[_row(t_phase, t)] if len(phase) else np.full(len(t), -1, np.int8))
            if band_s is not None:
                found[name] |= _details(t, errors, np.concatenate([np.empty((0, 3)), *honesty]), band_s)
        return {
            "reference": reference,
            "from_s": max(low, first),
            "to_s": min(high, last),
            "estimators": found,
        }


Parts = list[np.ndarray]
"""Pieces of an array, to be joined column by column: a long flight's errors should not be in memory twice."""


def _within(parts: list[tuple[np.ndarray, ...]], low: float, high: float) -> tuple[np.ndarray, Parts, Parts]:
    """Times (n,), and the parts of errors and honesty, of a span."""
    times, errors, honesty = [np.empty(0)], [], []
    for t, e, h in parts:
        rows = slice(int(np.searchsorted(t, low, "left")), int(np.searchsorted(t, high, "right")))
        times.append(t[rows])
        errors.append(e[rows])
        honesty.append(h[rows])
    return np.concatenate(times), errors, honesty


def _column(errors: Parts, measure: str) -> np.ndarray:
    """One measure of all parts, (n,) rad."""
    k = metrics.MEASURES.index(measure)
    return np.concatenate([np.empty(0, np.float32), *(e[:, k] for e in errors)])


def compare(
    path: Path,
    *,
    reference: str | None = None,
    start: float | None = None,
    end: float | None = None,
    band_s: float | None = None,
    align: str | None = None,
    sync: bool = False,
) -> dict[str, Any]:
    """Errors of every estimator in a log.

    Args:
        path: the log.
        reference: an estimator of the log, or any topic with orientations (its axes as its frame names say, else FLU
            and ENU), to compare with; None: the truth, else the reference that a replay has left.
        start, end: only samples in this span, s of flight.
        align: take out a constant rotation of each estimator first: "heading" (about down), or "frames" (one in each
            frame).
        sync: take out a constant delay of each estimator first.
        band_s: for campaigns: also the RMSE of every so many seconds, and mean NEES and NIS per degree of freedom.

    Returns:
        {"log", "reference", "from_s", "to_s", "estimators": {NAME: {"tilt_rmse_deg"..., "availability",
        "phases": {PHASE: {...}}}}}; with `align` "aligned_deg" and with `sync` "delay_s"; with `band_s` also "nees",
        "nis" and "bands": {MEASURE: [...]}. A value that cannot be told (a heading that the method does not estimate)
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
        has_truth = TRUTH_TOPIC in log.topics
        if reference is None and not has_truth and REFERENCE.topic in log.topics:
            reference = REFERENCE.topic
        against: dict[str, History] | None = None
        told: dict[str, dict[str, Any]] = {name: {} for name in names}
        if reference is not None or align is not None or sync:
            history = attitudes(log, reference)
            adjusted = {name: aligned(log, name, history, low, high, align, sync) for name in names}
            against = {name: a for name, (a, _) in adjusted.items()}
            told = {name: t for name, (_, t) in adjusted.items()}
        elif not has_truth:
            raise InputError(f"{path}: no {TRUTH_TOPIC} in it: there is nothing to compare with")
        judge = Judge(names, against=against, honesty=band_s is not None)
        listen(log, judge, names, honesty=band_s is not None)
    result = verdict(path, judge, reference or "truth", low, high, band_s=band_s)
    for name, values in told.items():
        result["estimators"][name] |= values
    return result


def listen(log: FlightReader, judge: Judge, names: Iterable[str], *, honesty: bool = False) -> None:
    """Give a judge what a log holds, in one pass."""
    topics = {f"/est/{name}{STATE.topic}": name for name in names}
    needed = TRUTH_TOPICS if TRUTH_TOPIC in log.topics else ()
    if missing := [topic for topic in needed if topic not in log.topics]:
        raise InputError(f"{log.path}: no {missing[0]} in it: there is nothing to compare with")
    for block in log.blocks([*needed, *topics]):
        if needed:
            tell_truth(log, judge, block)
        for topic, name in topics.items():
            judge.estimates(name, _said(log, block[topic], honesty))


def tell_truth(log: FlightReader, judge: Judge, messages: Mapping[str, np.ndarray]) -> None:
    """Give a judge the truth in the messages of `TRUTH_TOPICS`."""
    imu, state, air = (messages[topic] for topic in TRUTH_TOPICS)
    rows = min(map(len, (imu, state, air)))  # a recovered log may end between two topics
    judge.truth(
        _seconds(log, imu[:rows]),
        quaternion(imu["orientation"][:rows]),
        vector(state["velocity"][:rows]),
        air["on_ground"][:rows],
    )


def verdict(path: Path, judge: Judge, reference: str, low: float, high: float, **options: Any) -> dict[str, Any]:
    """A judge's result with the log's name; `options` as for `Judge.result`.

    Raises:
        InputError: there is nothing to compare between `low` and `high` (s).
    """
    first, last = judge.span()
    if first >= last:
        raise InputError(f"{path}: {TRUTH_TOPIC} is empty: there is nothing to compare with")
    if max(low, first) >= min(high, last):
        raise InputError(f"{path}: --from/--to: the log spans {first:.1f} to {last:.1f} s")
    return {"log": str(path), **judge.result(reference, low=low, high=high, **options)}


def _said(log: FlightReader, messages: np.ndarray, honesty: bool) -> Estimates:
    """What a judge asks of an estimator; the rest is NaN."""
    n = len(messages)
    columns = {
        f.name: np.broadcast_to(np.array(0 if f.metadata["dtype"] is not float else np.nan), (n, *f.metadata["shape"]))
        for f in fields(Estimates)
    }
    columns |= {
        "t": _seconds(log, messages),
        "q_nb": quaternion(messages["orientation"]),
        "down_b": vector(messages["down"]),
    }
    if honesty:
        columns["att_cov"] = messages["attitude_covariance"].reshape(-1, 3, 3)
        columns |= {"innovation": messages["innovation"], "innovation_var": messages["innovation_variance"]}
    return Estimates(**columns)


def attitudes(log: FlightReader, name: str | None) -> History:
    """The attitude of the truth (None), of an estimator, or of any topic with orientations.

    Raises:
        InputError: no such thing in the log.
    """
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


def orientations(log: FlightReader, topic: str) -> History:
    """`q_nb` over time of any topic with orientations, in the order of its stamps.

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
            parts.append((_seconds(log, block)[known], q[known]))
    t, q_nb = (np.concatenate(column) for column in zip(*parts, strict=True)) if parts else (np.empty(0),) * 2
    if len(t) < 2:
        raise InputError(f"{log.path}: {topic} has no attitude to compare with")
    t, first = np.unique(t, return_index=True)
    return History(t, q_nb[first])


def aligned(
    log: FlightReader, name: str, against: History, low: float, high: float, align: str | None, sync: bool
) -> tuple[History, dict[str, Any]]:
    """The reference without a constant delay and rotation against an estimator, and what these were."""
    if align is None and not sync:
        return against, {}
    from ahrs_sim.evaluation import sync as syncing

    t, q_nb = attitude(log, f"/est/{name}/state")
    within = (t >= low) & (t <= high)
    t, q_nb = t[within], q_nb[within]
    told: dict[str, Any] = {}
    times, q_ref = against.t, against.q_nb
    if sync and len(t):
        at = np.arange(t[0] + 0.1, t[-1] - 0.1, 0.1)
        rate_b = syncing.rates(t, q_nb, at, 0.1)
        known = np.isfinite(rate_b[:, 0])
        delay = syncing.time_shift(at[known], rate_b[known], 0.1, times, q_ref) or 0.0
        times, told["delay_s"] = times - delay, -delay
    if align is not None and len(t):
        every = max(1, len(t) // 20000)
        q_nb, q_here = q_nb[::every], metrics.interpolate(times, q_ref, t[::every])
        left, right = np.array([1.0, 0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
        if align == "heading":
            half = 0.5 * syncing.heading_offset(q_nb, q_here)
            left = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
        else:
            left, right = syncing.constant_rotations(q_nb, q_here)
        q_ref = frames.product(frames.product(left[None], q_ref), right[None])
        told["aligned_deg"] = [math.degrees(2 * math.acos(min(1.0, abs(float(q[0]))))) for q in (left, right)]
    return History(times, q_ref), told


def _seconds(log: FlightReader, messages: np.ndarray) -> np.ndarray:
    """Header stamps as seconds of flight, (n,)."""
    return log.seconds(stamps(messages))


def _whole_ns(t: np.ndarray) -> np.ndarray:
    """Times (s) as a log keeps them, so that a flight and its log give the same figures."""
    whole: np.ndarray = np.rint(t * 1e9) / 1e9
    return whole


def _row(t: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Row of `t` (rising) that is next to each of `at`, at or after it."""
    return np.clip(np.searchsorted(t, at - 1e-6), 0, len(t) - 1)


def _coarse(t: np.ndarray, cell: float = -math.inf) -> tuple[np.ndarray, float]:
    """Rows of `t`, the first of each 1 / PHASE_RATE after `cell`, and the last such cell."""
    cells = np.floor(t * PHASE_RATE + 1e-6)
    return np.flatnonzero(np.diff(cells, prepend=cell)), float(cells[-1])


def phases(t: np.ndarray, q_nb: np.ndarray, vel_n: np.ndarray, on_ground: np.ndarray) -> np.ndarray:
    """Index into PHASES (n,), told at `PHASE_RATE`."""
    every, (rows, _) = t, _coarse(t)
    t, q_nb, vel_n, on_ground = t[rows], q_nb[rows], vel_n[rows], on_ground[rows]
    half = max(1, round(1.0 / float(np.median(np.diff(t)))))
    later, earlier = np.minimum(np.arange(len(t)) + half, len(t) - 1), np.maximum(np.arange(len(t)) - half, 0)

    def slope(x: np.ndarray) -> np.ndarray:
        change: np.ndarray = np.abs(x[later] - x[earlier]) / np.maximum(t[later] - t[earlier], 1e-9)
        return change

    speed, climbed = np.linalg.norm(vel_n, axis=1), np.cumsum(vel_n[:, 2] * np.gradient(t))
    standing = on_ground & (speed < STANDING)
    turning = ~on_ground & (slope(np.unwrap(metrics.euler(q_nb)[:, 2])) > TURN_RATE)
    unsteady = turning | (~standing & (on_ground | (slope(speed) > ACCELERATION) | (slope(climbed) > CLIMB)))
    last = np.maximum.accumulate(np.where(unsteady, t, -np.inf))
    phase = np.where(standing, PHASES.index("ground"), PHASES.index("straight"))
    phase[t - last < SETTLING] = PHASES.index("transient")
    phase[turning] = PHASES.index("turning")
    shown: np.ndarray = phase[_row(t, every)]
    return shown


def attitude(log: FlightReader, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and attitude (n, 4) of an estimator, where it has one."""
    blocks = [(_seconds(log, b), quaternion(b["orientation"])) for b in log.blocks(topic)]
    t, q_nb = (np.concatenate(column) for column in zip(*blocks, strict=True)) if blocks else (np.empty(0),) * 2
    known = np.isfinite(q_nb).all(axis=-1)
    if known.sum() < 2:
        raise InputError(f"{log.path}: {topic} has no attitude to compare with")
    return t[known], q_nb[known]


def _honesty(block: Estimates, reference: np.ndarray) -> np.ndarray:
    """(n, 3) float32: NEES of the attitude per degree of freedom; NIS and its degrees of freedom."""
    nees = consistency.attitude_nees(block.q_nb, block.att_cov.astype(float), reference)
    nis = consistency.nis(block.innovation.astype(float), block.innovation_var.astype(float))
    return np.column_stack([nees / 3.0, *nis]).astype(np.float32)


def _details(t: np.ndarray, errors: Parts, honesty: np.ndarray, band_s: float) -> dict[str, Any]:
    """Mean NEES and NIS per degree of freedom, and tilt and heading RMSE (deg) of each `band_s` since t = 0."""
    freedom = float(np.nansum(honesty[:, 2]))
    known = honesty[np.isfinite(honesty[:, 0]), 0]
    values = {
        "nees": float(np.mean(known, dtype=float)) if len(known) else math.nan,
        "nis": float(np.nansum(honesty[:, 1], dtype=float)) / freedom if freedom else math.nan,
    }
    number = np.floor(t / band_s + 1e-6).astype(int)
    bands: dict[str, list[float | None]] = {}
    for measure in ("tilt", "heading"):
        squares = np.degrees(_column(errors, measure).astype(float)) ** 2
        finite = np.isfinite(squares) & (number >= 0)
        count = np.bincount(number[finite])
        total = np.bincount(number[finite], squares[finite])
        bands[measure] = [math.sqrt(x / n) if n else None for x, n in zip(total, count, strict=True)]
    return {**_finite(values), "bands": bands}


def _summary(errors: Parts, phase: np.ndarray) -> dict[str, Any]:
    present = [i for i in range(len(PHASES)) if np.any(phase == i)]
    summary: dict[str, Any] = {}
    by_phase: dict[str, dict[str, Any]] = {PHASES[i]: {} for i in present}
    for measure in metrics.MEASURES:
        values = _column(errors, measure)
        summary |= _finite(metrics.figures(measure, values))
        for i in present:
            by_phase[PHASES[i]] |= _finite(metrics.figures(measure, values[phase == i]))
        if measure == "tilt":
            summary["availability"] = float(np.mean(np.isfinite(values))) if len(values) else 0.0
    for i in present:
        by_phase[PHASES[i]]["samples"] = int(np.sum(phase == i))
    return {**summary, "phases": by_phase}


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    """JSON has no NaN."""
    return {k: v if math.isfinite(v) else None for k, v in values.items()}


def table(result: dict[str, Any]) -> str:
    """The result for a reader: one line an estimator, then tilt and heading by phase."""
    out = io.StringIO()
    against = "the truth" if result["reference"] == "truth" else result["reference"]
    print(f"errors against {against}, {result['from_s']:.0f} to {result['to_s']:.0f} s, deg", file=out)
    width = max(12, *(len(n) + 2 for n in result["estimators"]))
    heads = "".join(f"{m:>19s}" for m in metrics.MEASURES)
    print(f"{'':{width}s}{heads}\n{'':{width}s}{'rmse   p95   max'.rjust(19) * len(metrics.MEASURES)}", file=out)
    for name, values in result["estimators"].items():
        cells = [[values[f"{m}_{s}_deg"] for s in ("rmse", "p95", "max")] for m in metrics.MEASURES]
        print(f"{name:{width}s}" + "".join(" " + "".join(_cell(v) for v in c) for c in cells), file=out)
    for name, values in result["estimators"].items():
        if told := _told(values):
            print(f"{name:{width}s} {told}", file=out)
    phases = [p for p in PHASES if any(p in v["phases"] for v in result["estimators"].values())]
    if not phases:
        return out.getvalue().rstrip()
    print(f"\n{'by phase, rmse':{width}s}" + "".join(f"{p:>16s}" for p in phases), file=out)
    print(f"{'':{width}s}" + "    tilt heading" * len(phases), file=out)
    for name, values in result["estimators"].items():
        row = [values["phases"].get(p, {}) for p in phases]
        cells2 = "".join(f"{_cell(r.get('tilt_rmse_deg'), 8)}{_cell(r.get('heading_rmse_deg'), 8)}" for r in row)
        print(f"{name:{width}s}{cells2}", file=out)
    return out.getvalue().rstrip()


def _told(values: dict[str, Any]) -> str:
    """What was taken out first, for a reader."""
    parts = [f"delay of {values['delay_s']:+.3f} s"] if "delay_s" in values else []
    parts += [f"{a:.2f} deg" for a in values.get("aligned_deg", ()) if a > 5e-3]
    return f"without {' and '.join(parts)}" if parts else ""


def _cell(value: float | None, width: int = 6) -> str:
    if value is None:
        return "-".rjust(width)
    return f"{value:{width}.2f}" if value < 9.995 else f"{value:{width}.1f}"


def csv(result: dict[str, Any]) -> str:
    """The result as comma-separated values: a line per estimator and phase ("all": the whole flight)."""
    keys = [f"{m}_{s}_deg" for m in metrics.MEASURES for s in ("rmse", "p95", "max")]
    lines = [",".join(["estimator", "reference", "phase", *keys])]
    for name, values in result["estimators"].items():
        for phase, cells in {"all": values, **values["phases"]}.items():
            numbers = ["" if cells[k] is None else repr(cells[k]) for k in keys]
            lines.append(",".join([name, result["reference"], phase, *numbers]))
    return "\n".join(lines)
