"""`ahrs-sim compare`: how wrong was each estimator, over all and by phase of the flight.

The log is read in its own chunks and only errors are kept (float32), so memory hardly grows with the flight.
"""

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.bags import frames
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.log.reader import quaternion, stamps, vector
from ahrs_sim.log.record import REFERENCE, FlightReader
from ahrs_sim.review import metrics

TRUTH_TOPIC = "/truth/odometry"
STATE_TOPIC = "/truth/state"
AIR_TOPIC = "/truth/air"

TURN_RATE = math.radians(3.0)
"""rad/s of heading (mean over 2 s) from which on a flight is turning: the standard rate, 360 deg in two minutes."""

ACCELERATION = 1.0
"""m/s2 along the path (mean over 2 s) from which on flight is not steady: take-off, flare, roll-out."""

SETTLING = 20.0
"""s after a turn or an acceleration that count as transient: what an estimator learnt wrong in it dies away."""

STANDING = 0.5
"""m/s below which an aircraft on its wheels stands."""

PHASES = ("ground", "straight", "turning", "transient")
"""Standing on the ground; steady straight flight; turning in the air; everything else, settling included."""


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
    with FlightReader(path) as log:
        span = -math.inf if start is None else start, math.inf if end is None else end
        return _compare(log, reference, *span, band_s, align, sync)


def _compare(
    log: FlightReader,
    reference: str | None,
    low: float,
    high: float,
    band_s: float | None,
    align: str | None,
    sync: bool,
) -> dict[str, Any]:
    path, names = log.path, log.estimators
    if not names:
        raise InputError(f"{path}: no estimates in it (no topic /est/NAME/state); replay it with an estimator first")
    truth, against = _reference(log, reference)
    span = (against if truth is None else truth).t
    if max(low, span[0]) >= min(high, span[-1]):
        raise InputError(f"{path}: --from/--to: the log spans {span[0]:.1f} to {span[-1]:.1f} s")
    adjusted = {name: _adjusted(log, name, against, low, high, align, sync) for name in names}
    estimators = {}
    for name, (t, errors, honesty) in _errors(
        log, {n: a for n, (a, _) in adjusted.items()}, band_s is not None
    ).items():
        within = (t >= low) & (t <= high)
        phase = np.full(int(within.sum()), -1) if truth is None else truth.phase[_row(truth.t, t[within])]
        estimators[name] = _summary(errors[within], phase) | adjusted[name][1]
        if band_s is not None:
            estimators[name] |= _details(t[within], errors[within], honesty[within], band_s)
    return {
        "log": str(path),
        "reference": reference or ("truth" if against is truth else REFERENCE.topic),
        "from_s": float(max(low, span[0])),
        "to_s": float(min(high, span[-1])),
        "estimators": estimators,
    }


@dataclass(frozen=True)
class _History:
    t: np.ndarray  # (n,) s, rising
    q_nb: np.ndarray  # (n, 4)


def _reference(log: FlightReader, name: str | None) -> "tuple[_Truth | None, _History]":
    """The truth when there is one, and what to compare with."""
    if name is None and TRUTH_TOPIC not in log.topics and REFERENCE.topic in log.topics:
        name = REFERENCE.topic
    if name is None:
        truth = _truth(log)
        return truth, truth
    if name in log.estimators:
        topic = f"/est/{name}/state"
    elif name in log.topics:
        topic = name
    else:
        known = [*log.estimators, *(t.topic for t in log.topics.values() if t.type_name in frames.ORIENTATIONS)]
        raise InputError(
            f"{log.path}: --reference {name}: no such estimator or topic in this log{nearest(name, known)}"
        )
    return _truth(log) if TRUTH_TOPIC in log.topics else None, orientations(log, topic)


def orientations(log: FlightReader, topic: str) -> _History:
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
    return _History(t, q_nb[first])


def _adjusted(
    log: FlightReader, name: str, against: _History, low: float, high: float, align: str | None, sync: bool
) -> tuple[_History, dict[str, Any]]:
    """The reference without a constant delay and rotation against an estimator, and what these were."""
    if align is None and not sync:
        return against, {}
    from ahrs_sim.review import sync as syncing

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
    return _History(times, q_ref), told


@dataclass(frozen=True)
class _Truth(_History):
    phase: np.ndarray  # (n,) index into PHASES


def _seconds(log: FlightReader, messages: np.ndarray) -> np.ndarray:
    """Header stamps as seconds of flight, (n,)."""
    return log.seconds(stamps(messages))


def _row(t: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Row of `t` (rising) that is next to each of `at`, at or after it."""
    return np.clip(np.searchsorted(t, at - 1e-6), 0, len(t) - 1)


def _truth(log: FlightReader) -> _Truth:
    """Attitude and phase of the flight."""
    needed = [TRUTH_TOPIC, STATE_TOPIC, AIR_TOPIC]
    if missing := [topic for topic in needed if topic not in log.topics]:
        raise InputError(f"{log.path}: no {missing[0]} in it: there is nothing to compare with")
    parts = [
        (
            _seconds(log, block[TRUTH_TOPIC]),
            quaternion(block[TRUTH_TOPIC]["pose"]["pose"]["orientation"]),
            np.linalg.norm(vector(block[STATE_TOPIC]["velocity"]), axis=1),
            block[AIR_TOPIC]["on_ground"].copy(),  # a view would keep the whole block
        )
        for block in log.blocks(needed)
    ]
    t, q_nb, speed, on_ground = (np.concatenate(column) for column in zip(*parts, strict=True))
    rows = min(map(len, (t, q_nb, speed, on_ground)))  # a recovered log may end between two topics
    if rows < 2:
        raise InputError(f"{log.path}: {TRUTH_TOPIC} is empty: there is nothing to compare with")
    t, q_nb = t[:rows], q_nb[:rows]
    return _Truth(t, q_nb, phases(t, q_nb, speed[:rows], on_ground[:rows]))


def phases(t: np.ndarray, q_nb: np.ndarray, speed: np.ndarray, on_ground: np.ndarray) -> np.ndarray:
    """Index into PHASES (n,)."""
    half = max(1, round(1.0 / float(np.median(np.diff(t)))))
    later, earlier = np.minimum(np.arange(len(t)) + half, len(t) - 1), np.maximum(np.arange(len(t)) - half, 0)

    def slope(x: np.ndarray) -> np.ndarray:
        change: np.ndarray = np.abs(x[later] - x[earlier]) / np.maximum(t[later] - t[earlier], 1e-9)
        return change

    standing = on_ground & (speed < STANDING)
    turning = ~on_ground & (slope(np.unwrap(metrics.euler(q_nb)[:, 2])) > TURN_RATE)
    unsteady = turning | (~standing & (on_ground | (slope(speed) > ACCELERATION)))
    last = np.maximum.accumulate(np.where(unsteady, t, -np.inf))
    phase = np.where(standing, PHASES.index("ground"), PHASES.index("straight"))
    phase[t - last < SETTLING] = PHASES.index("transient")
    phase[turning] = PHASES.index("turning")
    return phase


def attitude(log: FlightReader, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and attitude (n, 4) of an estimator, where it has one."""
    blocks = [(_seconds(log, b), quaternion(b["orientation"])) for b in log.blocks(topic)]
    t, q_nb = (np.concatenate(column) for column in zip(*blocks, strict=True)) if blocks else (np.empty(0),) * 2
    known = np.isfinite(q_nb).all(axis=-1)
    if known.sum() < 2:
        raise InputError(f"{log.path}: {topic} has no attitude to compare with")
    return t[known], q_nb[known]


def _errors(
    log: FlightReader, against: dict[str, _History], with_honesty: bool
) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Times (n,), errors (n, 5) and honesty (n, 3) of each estimator against its reference."""
    topics = {f"/est/{name}/state": name for name in against}
    parts: dict[str, list[tuple[np.ndarray, ...]]] = {name: [] for name in against}
    for block in log.blocks(list(topics)):
        for topic, messages in block.items():
            at = _seconds(log, messages)
            history = against[topics[topic]]
            reference = metrics.interpolate(history.t, history.q_nb, at)
            estimate = quaternion(messages["orientation"])
            errors = metrics.attitude_errors(estimate, vector(messages["down"]), reference).astype(np.float32)
            honesty = _honesty(messages, estimate, reference) if with_honesty else np.empty((len(at), 0))
            parts[topics[topic]].append((at, errors, honesty))
    return {name: tuple(np.concatenate(c) for c in zip(*p, strict=True)) for name, p in parts.items()}  # type: ignore[misc]


def _honesty(messages: np.ndarray, q_nb: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(n, 3) float32: NEES of the attitude per degree of freedom; NIS and its degrees of freedom."""
    from ahrs_sim.review import consistency  # scipy: not for every comparison

    nees = consistency.attitude_nees(q_nb, messages["attitude_covariance"].reshape(-1, 3, 3).astype(float), reference)
    nis = consistency.nis(messages["innovation"].astype(float), messages["innovation_variance"].astype(float))
    return np.column_stack([nees / 3.0, *nis]).astype(np.float32)


def _details(t: np.ndarray, errors: np.ndarray, honesty: np.ndarray, band_s: float) -> dict[str, Any]:
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
        squares = np.degrees(errors[:, metrics.MEASURES.index(measure)].astype(float)) ** 2
        finite = np.isfinite(squares) & (number >= 0)
        count = np.bincount(number[finite])
        total = np.bincount(number[finite], squares[finite])
        bands[measure] = [math.sqrt(x / n) if n else None for x, n in zip(total, count, strict=True)]
    return {**_finite(values), "bands": bands}


def _summary(errors: np.ndarray, phase: np.ndarray) -> dict[str, Any]:
    summary: dict[str, Any] = dict(_finite(metrics.statistics(errors)))
    tilt = errors[:, metrics.MEASURES.index("tilt")]
    summary["availability"] = float(np.mean(np.isfinite(tilt))) if len(tilt) else 0.0
    summary["phases"] = {
        name: _finite(metrics.statistics(errors[phase == i])) | {"samples": int(np.sum(phase == i))}
        for i, name in enumerate(PHASES)
        if np.any(phase == i)
    }
    return summary


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
