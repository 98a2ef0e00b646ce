"""Everything a report draws of one flight, gathered from its log in one pass and in little memory.

Errors are kept at the rate of the estimates; what changes slowly is kept ten times a second (`COARSE`), innovations are
summed up by the second.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.evaluation import metrics, phases
from ahrs_sim.evaluation.decimate import Decimator, take
from ahrs_sim.evaluation.evaluator import Comparison, Evaluator
from ahrs_sim.evaluation.metrics import EULER, Measure
from ahrs_sim.evaluation.phases import PHASES
from ahrs_sim.flight.truth import Event
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.reader import quaternion, stamps, vector
from ahrs_sim.log.topics import INSTRUMENTS, REFERENCE
from ahrs_sim.recordings.mapping import SUITE as BAG
from ahrs_sim.review import compare
from ahrs_sim.world import wgs84
from estimators.types import Status

COARSE = 10.0
"""Hz of everything but attitudes and their errors."""

WINDOW_S = 10.0
"""Length of an estimator's worst window."""

LOST_DEG = 5.0
"""Error that counts as wrong where it also exceeds three sigma ..."""

LOST_S = 2.0
"""... for so long without a break."""


_KEPT = ("gyro_bias", "gyro_bias_sigma", "accel_bias", "accel_bias_sigma", "adaptation", "status")
"""Columns of the estimates that are drawn as they are, at `COARSE`."""

_READ = {*_KEPT, "q_nb", "down_b", "att_cov", "lla", "innovation", "innovation_var"}


@dataclass(frozen=True)
class Worst:
    """The ten seconds in which an estimator erred most."""

    start: float  # s
    end: float
    rms: float  # rad, of the whole rotation (of the tilt where there is no heading)
    axis: str  # of roll, pitch, heading: the one that erred most
    axis_rms: float  # rad
    sigma: float  # rad, mean of what the estimator thought of that axis; NaN: it says nothing
    phase: str


@dataclass(frozen=True)
class EstimatorTrace:
    """Holds the reports of one estimator beside the reference."""

    name: str
    suite: str
    t: np.ndarray  # (n,) s
    error: np.ndarray  # (n, 5) rad, order of metrics.MEASURES
    coarse_t: np.ndarray  # (m,) s, at COARSE or slower
    sigma: np.ndarray  # (m, 3) rad, of roll, pitch, heading
    nees: np.ndarray  # (m,) of the attitude, per degree of freedom
    inside: np.ndarray  # (m,) 1 where every Euler error is inside of three sigma, 0 where not, NaN
    gyro_bias: np.ndarray  # (m, 3) rad/s
    gyro_bias_sigma: np.ndarray
    accel_bias: np.ndarray  # (m, 3) m/s2
    accel_bias_sigma: np.ndarray
    adaptation: np.ndarray  # (m, 4)
    status: np.ndarray  # (m,) `estimators.types.Status`
    position: np.ndarray  # (m, 3) m NED from the start; NaN where the method has none
    nis: np.ndarray  # (s,) sum over second k, from 0
    nis_freedom: np.ndarray  # (s,) degrees of freedom in that sum
    innovation_low: np.ndarray  # (s, 12) extremes over the second of innovation / sigma
    innovation_high: np.ndarray
    innovations: tuple[str, ...] = ()  # their names, as far as the log knows them
    adjusted: dict[str, Any] = field(default_factory=dict)  # what was taken out before, as `compare` tells it

    def worst(self, flight: "FlightTraces") -> Worst | None:
        """Find the ten seconds with the largest root mean square error; None in a shorter flight."""
        total = self.error[:, Measure.TOTAL]
        total = total if np.isfinite(total).any() else self.error[:, Measure.TILT]
        known = np.isfinite(total)
        t, squares = self.t[known], np.cumsum(np.r_[0.0, total[known].astype(float) ** 2])
        if len(t) < 10 or t[-1] - t[0] < WINDOW_S:
            return None
        last = np.searchsorted(t, t + WINDOW_S, "right")
        first = np.arange(len(t))
        full = t <= t[-1] - WINDOW_S + 1e-6
        mean = np.where(full, (squares[last] - squares[first]) / np.maximum(last - first, 1), -1.0)
        best = int(np.argmax(mean))
        start, end = float(t[best]), float(t[best]) + WINDOW_S
        rows = (self.t >= start) & (self.t <= end)
        angles = np.sqrt(np.nanmean(np.nan_to_num(self.error[rows, EULER].astype(float)) ** 2, axis=0))
        axis = int(np.argmax(angles))
        sigma = self.sigma[(self.coarse_t >= start) & (self.coarse_t <= end), axis]
        sigma = sigma[np.isfinite(sigma)]
        return Worst(
            start,
            end,
            math.sqrt(max(0.0, float(mean[best]))),
            metrics.MEASURES[axis],
            float(angles[axis]),
            float(sigma.mean()) if len(sigma) else math.nan,
            flight.phase_at(0.5 * (start + end)),
        )

    def lost(self) -> float | None:
        """Find when the error first exceeded `LOST_DEG` and three sigma for `LOST_S`, s; None: never."""
        error = np.abs(self.error[np.clip(np.searchsorted(self.t, self.coarse_t), 0, len(self.t) - 1), EULER])
        limit = np.fmax(math.radians(LOST_DEG), 3 * self.sigma)
        with np.errstate(invalid="ignore"):
            wrong = (error > limit).any(axis=1)
        right_at = np.maximum.accumulate(np.where(wrong, -np.inf, self.coarse_t))
        long = wrong & (self.coarse_t - right_at >= LOST_S) & np.isfinite(right_at)
        return float(right_at[np.argmax(long)]) if long.any() else None


@dataclass(frozen=True)
class SuiteTrace:
    """True biases and satellites of one sensor suite."""

    t: np.ndarray  # (m,) s, of the biases, at COARSE or slower
    gyro_bias: np.ndarray  # (m, 3) rad/s
    accel_bias: np.ndarray  # (m, 3) m/s2
    satellites_t: np.ndarray  # (k,)
    satellites: np.ndarray  # (k,)
    fix: np.ndarray  # (k, 2) m north and east from the start


@dataclass(frozen=True)
class FlightTraces:
    """One flight."""

    path: Path
    label: str
    reference: str  # truth, or the estimator taken for it
    t: np.ndarray  # (n,) s
    q_nb: np.ndarray  # (n, 4) reference attitude
    truth_t: np.ndarray  # (k,) s
    position: np.ndarray  # (k, 3) m NED from where the flight began
    speed: np.ndarray  # (k,) m/s, true airspeed
    phase: np.ndarray  # (k,) index into phases.PHASES
    estimators: dict[str, EstimatorTrace]
    suites: dict[str, SuiteTrace]
    events: list[Event]
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, str] = field(default_factory=dict)  # text by name

    def phase_at(self, t: float) -> str:
        """Name the phase at a time (s); empty: unknown."""
        found = int(phases.at(self.truth_t, self.phase, np.array([t]))[0])
        return "" if found < 0 else PHASES[found]

    def step_at(self, t: float) -> str:
        """Name the step that the pilot was flying at a time (s); empty when no event tells."""
        begun = [e.text for e in self.events if e.name == "pilot" and e.t <= t and e.text.endswith(" begins")]
        return begun[-1].removesuffix(" begins") if begun else ""


def gather(
    path: Path,
    *,
    reference: str | None = None,
    start: float | None = None,
    end: float | None = None,
    align: str | None = None,
    sync: bool = False,
) -> FlightTraces:
    """Read what a report needs.

    Args:
        path: a log with estimates.
        reference, start, end, align, sync: as `compare.compare` takes them.

    Raises:
        InputError: no log, nothing to compare in it, or an unknown reference.
    """
    with FlightReader(path) as log:
        if not log.estimators:
            raise InputError(
                f"{path}: no estimates in it (no topic /est/NAME/state); replay it with an estimator first"
            )
        columns, fixes = _columns(log)
        t, q_nb, phase = _truth(log, columns)
        if reference is None and not len(t) and REFERENCE.topic in log.topics:
            reference = REFERENCE.topic
        history = metrics.History(t, q_nb) if reference is None and len(t) else compare.attitudes(log, reference)
        first, last = (t[0], t[-1]) if len(t) else (history.t[0], history.t[-1])
        low = float(max(first, -math.inf if start is None else start))
        high = float(min(last, math.inf if end is None else end))
        if low >= high:
            raise InputError(f"{path}: --from/--to: the log spans {first:.1f} to {last:.1f} s")
        adjusted = {n: compare.aligned(log, n, history, low, high, align, sync) for n in log.estimators}
        kept, shown = (history.t >= low) & (history.t <= high), (t >= low) & (t <= high)
        lla = columns[compare.STATE_TOPIC]["lla"][: len(t)] if len(t) else np.empty((0, 3))
        origin = _origin(log, lla, columns, fixes)
        texts = {n: log.attachment(n).decode(errors="replace") for n in log.attachments if n.endswith(".toml")}
        return FlightTraces(
            path=path,
            label=path.stem,
            reference=reference or "truth",
            t=history.t[kept],
            q_nb=history.q_nb[kept],
            truth_t=t[shown],
            position=wgs84.offset_n(lla[shown], origin),
            speed=columns[compare.AIR_TOPIC]["airspeed"][: len(t)][shown] if len(t) else np.empty(0),
            phase=phase[shown],
            estimators=_estimators(log, adjusted, origin, low, high),
            suites={suite: _suite(columns, suite, fix, origin, low, high) for suite, fix in fixes.items()},
            events=[e for e in log.events() if low <= e.t <= high] if "/events" in log.topics else [],
            metadata=log.metadata,
            attachments=texts,
        )


def _columns(log: FlightReader) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, str]]:
    """List the columns of truth and suites by topic and name, and each suite's topic of position fixes.

    One pass, for uncompressing is what costs. What a replay has received of a bag counts as suite `bag`.
    """
    wanted: dict[str, Callable[[np.ndarray], dict[str, np.ndarray]]] = {
        compare.TRUTH_TOPIC: lambda m: {"q_nb": quaternion(m["orientation"])},
        compare.STATE_TOPIC: lambda m: {"lla": m["lla"], "vel_n": vector(m["velocity"])},
        compare.AIR_TOPIC: lambda m: {"airspeed": m["airspeed"], "on_ground": m["on_ground"]},
    }
    missing = [topic for topic in wanted if topic not in log.topics]
    if missing and compare.TRUTH_TOPIC in log.topics:
        raise InputError(f"{log.path}: no {missing[0]} in it: there is nothing to compare with")
    fixes = {suite: f"/{suite}{INSTRUMENTS['fix'][1].topic}" for suite in log.suites}
    if source := log.metadata.get("replay", {}).get("topic fix"):
        fixes[BAG] = source.split()[0]
    for suite, fix in fixes.items():
        wanted[f"/{suite}/imu/errors"] = _biases
        wanted[f"/{suite}/gps/status"] = lambda m: {"satellites": m["satellites"].astype(float)}
        if fix in log.topics and log.topics[fix].type_name == INSTRUMENTS["fix"][1].type_name:
            wanted[fix] = lambda m: {
                "lla": np.column_stack([np.radians(m["latitude"]), np.radians(m["longitude"]), m["altitude"]])
            }
    topics = [topic for topic in wanted if topic in log.topics]
    parts: dict[str, list[dict[str, np.ndarray]]] = {topic: [] for topic in topics}
    for block in log.blocks(topics) if topics else ():
        for topic, messages in block.items():
            parts[topic].append({"t": log.seconds(stamps(messages)), **wanted[topic](messages)})
    columns = {
        topic: {name: np.concatenate([b[name] for b in blocks]) for name in blocks[0]}
        for topic, blocks in parts.items()
        if blocks
    }
    return columns, fixes


def _truth(log: FlightReader, columns: dict[str, dict[str, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read times (n,), attitudes (n, 4) and phases (n,), empty where a log has no truth.

    A recovered log may end between two topics, the shortest counts.
    """
    needed = (compare.TRUTH_TOPIC, compare.STATE_TOPIC, compare.AIR_TOPIC)
    if compare.TRUTH_TOPIC not in log.topics:
        return np.empty(0), np.empty((0, 4)), np.empty(0, int)
    found = [columns.get(topic, {"t": np.empty(0)}) for topic in needed]
    n = min(len(c["t"]) for c in found)
    if n < 2:
        raise InputError(f"{log.path}: {compare.TRUTH_TOPIC} is empty: there is nothing to compare with")
    attitude, state, air = found
    t, q_nb = attitude["t"][:n], attitude["q_nb"][:n]
    return t, q_nb, phases.classify(t, q_nb, state["vel_n"][:n], air["on_ground"][:n])


def _origin(
    log: FlightReader, lla: np.ndarray, columns: dict[str, dict[str, np.ndarray]], fixes: dict[str, str]
) -> np.ndarray:
    """Find the origin of positions (3,): start of the flight, else the first fix; NaN: unknown."""
    for places in (lla, *(columns[fix]["lla"] for fix in fixes.values() if fix in columns)):
        if len(known := places[np.isfinite(places).all(axis=1)]):
            return np.asarray(known[0])
    return np.full(3, np.nan)


class _Gathering:
    """The columns of one estimator while they come in."""

    def __init__(self, origin: np.ndarray) -> None:
        self.origin = origin
        self.columns: dict[str, list[np.ndarray]] = {}
        self.coarse = Decimator(COARSE)

    def add(self, pair: Comparison) -> None:
        """Take estimates with their reference."""
        estimates = pair.estimates
        squares, freedom = pair.nis()
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = estimates.innovation / np.sqrt(estimates.innovation_var)
        rows = self.coarse.rows(estimates.t)
        some = Comparison(take(estimates, rows), pair.reference[rows])
        position = np.full(some.estimates.lla.shape, np.nan)
        located = np.isfinite(some.estimates.lla).all(axis=1) & np.isfinite(self.origin).all()
        position[located] = wgs84.offset_n(some.estimates.lla[located], self.origin)
        for name, values in {
            "t": estimates.t,
            "error": pair.errors().astype(np.float32),
            "nis": squares.astype(np.float32),
            "freedom": freedom.astype(np.float32),
            "ratio": ratio,
            "coarse_t": some.estimates.t,
            "sigma": some.sigma(),
            "nees": some.nees(),
            "inside": some.within(),
            "position": position,
            **{name: getattr(some.estimates, name) for name in _KEPT},
        }.items():
            self._put(name, values)

    def _put(self, name: str, values: np.ndarray) -> None:
        self.columns.setdefault(name, []).append(values)

    def trace(self, name: str, about: Mapping[str, str], adjusted: dict[str, Any]) -> EstimatorTrace:
        c = {key: np.concatenate(parts) for key, parts in self.columns.items()}
        second = np.maximum(np.floor(c["t"] + 1e-6), 0).astype(int)
        count = int(second.max()) + 1
        starts = np.flatnonzero(np.diff(second, prepend=-1))
        low, high = (np.full((count, c["ratio"].shape[1]), np.nan) for _ in range(2))
        ratio = c.pop("ratio").astype(float)
        low[second[starts]] = np.fmin.reduceat(ratio, starts)
        high[second[starts]] = np.fmax.reduceat(ratio, starts)
        return EstimatorTrace(
            name=name,
            suite=about.get("suite", ""),
            innovations=tuple(about.get("innovations", "").split()),
            adjusted=adjusted,
            nis=np.bincount(second, c.pop("nis"), count),
            nis_freedom=np.bincount(second, c.pop("freedom"), count),
            innovation_low=low,
            innovation_high=high,
            **c,
        )


def _estimators(
    log: FlightReader,
    against: Mapping[str, tuple[metrics.History, dict[str, Any]]],
    origin: np.ndarray,
    low: float,
    high: float,
) -> dict[str, EstimatorTrace]:
    topics = {f"/est/{name}/state": name for name in against}
    gathering = {name: _Gathering(origin) for name in against}
    evaluator = Evaluator(
        lambda name, pair: gathering[name].add(pair), against={name: history for name, (history, _) in against.items()}
    )
    for block in log.blocks(list(topics)):
        for topic, messages in block.items():
            at = log.seconds(stamps(messages))
            within = (at >= low - 1e-3) & (at <= high + 1e-3)
            evaluator.add(topics[topic], log.estimates_in(messages[within], _READ))
    about = {name: log.metadata.get(f"estimator {name}", {}) for name in gathering}
    return {name: g.trace(name, about[name], against[name][1]) for name, g in gathering.items() if g.columns}


def _biases(messages: np.ndarray) -> dict[str, np.ndarray]:
    """Take the biases that an estimator's mean: the effective ones, where a log has them."""
    effective = "gyro_effective_bias" in (messages.dtype.names or ())
    return {s: vector(messages[f"{s}_effective_bias" if effective else f"{s}_bias"]) for s in ("gyro", "accel")}


def _suite(
    columns: dict[str, dict[str, np.ndarray]], suite: str, fix: str, origin: np.ndarray, low: float, high: float
) -> SuiteTrace:
    none = {"t": np.empty(0)}
    errors, status, fixes = (columns.get(t, none) for t in (f"/{suite}/imu/errors", f"/{suite}/gps/status", fix))
    rows = Decimator(COARSE).rows(errors["t"])
    rows = rows[(errors["t"][rows] >= low) & (errors["t"][rows] <= high)]
    within = (status["t"] >= low) & (status["t"] <= high)
    lla = fixes.get("lla", np.empty((0, 3)))
    lla = lla[np.isfinite(lla).all(axis=1) & (fixes["t"] >= low) & (fixes["t"] <= high)]
    return SuiteTrace(
        t=errors["t"][rows],
        gyro_bias=errors.get("gyro", np.empty((0, 3)))[rows],
        accel_bias=errors.get("accel", np.empty((0, 3)))[rows],
        satellites_t=status["t"][within],
        satellites=status.get("satellites", np.empty(0))[within],
        fix=wgs84.offset_n(lla, origin)[:, :2] if len(lla) else np.empty((0, 2)),
    )


def finding(flight: FlightTraces, trace: EstimatorTrace) -> str:
    """Describe in one or two sentences how wrong an estimator was at its worst, when, and what may be behind it."""
    worst = trace.worst(flight)
    if worst is None:
        return "no attitude for ten seconds on end"
    phase = f" ({worst.phase})" if worst.phase else ""
    parts = [f"worst from {worst.start:.0f} to {worst.end:.0f} s{phase}: {worst.axis} {_degrees(worst.axis_rms)} wrong"]
    if math.isfinite(worst.sigma):
        parts.append(f", claimed uncertainty {_degrees(worst.sigma)} (1 sigma)")
    lost = trace.lost()
    if lost is not None:
        step = flight.step_at(lost)
        own = " and its own 3 sigma" if np.isfinite(trace.sigma).any() else ""
        parts.append(f"; first exceeded {LOST_DEG:g} deg{own} at {lost:.0f} s" + (f", in {step}" if step else ""))
    rows = (trace.coarse_t >= worst.start) & (trace.coarse_t <= worst.end)
    coasting = np.mean(np.isin(trace.status[rows], [Status.COASTING, Status.DIVERGED])) if rows.any() else 0.0
    if coasting > 0.1:
        parts.append(f"; {100 * coasting:.0f} % of that time without a usable measurement")
    others = [f"{suite}/" for suite in flight.suites if suite != trace.suite]
    before = [
        e
        for e in flight.events
        if worst.start - 20 <= e.t <= worst.end and e.name != "pilot" and not any(o in e.text for o in others)
    ]
    if before:
        parts.append(f"; shortly before: {before[-1].text} ({before[-1].t:.0f} s)")
    if "delay_s" in trace.adjusted:
        parts.append(f"; a delay of {trace.adjusted['delay_s']:+.3f} s was taken out")
    if "aligned_deg" in trace.adjusted:
        turned = " and ".join(f"{angle:.1f}" for angle in trace.adjusted["aligned_deg"] if angle > 0.05) or "0"
        parts.append(f"; a constant rotation of {turned} deg was taken out")
    return "".join(parts)


def _degrees(angle: float) -> str:
    value = math.degrees(angle)
    return f"{value:.0f} deg" if value >= 10 else f"{value:.2g} deg"
