"""`ahrs-sim tune`: settings of an estimator that fit a recording.

Sensors are read once; a trial is one pass of the filter. The recording is cut into blocks of `BLOCK_S`: the search sees
every other one, the rest says what the settings found are worth. Either the innovations are made as likely as can be,
which needs no reference,

    log L = -1/2 sum (ln 2 pi s + r^2 / s),      r innovations, decorrelated, s their variances

(Schweppe 1965), or the mean square of tilt and heading errors against the truth or a reference is minimised. The search
goes along one setting at a time in its logarithm: three points, the parabola through them, steps that halve.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import plugins
from ahrs_sim.errors import CheckError, InputError, nearest
from ahrs_sim.evaluation import metrics
from ahrs_sim.evaluation.bootstrap import interval
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.recordings.sources import is_mcap
from ahrs_sim.scenario import Component, Gate
from ahrs_sim.scenario.code import from_outside
from ahrs_sim.sensors.assemble import Assembler
from estimators import create, describe
from estimators.settings import Setting
from estimators.types import Estimates, Samples, SensorInfo, Site

BLOCK_S = 20.0
NOISES = (
    "gyro_noise", "accel_noise", "velocity_share", "position_share", "mag_sigma", "mag_share", "gnss_time",
    "scale_share", "force_share", "turn_share", "accel_share", "heading_share", "speed_sigma", "accel_sigma",
)  # fmt: skip
"""Settings that are searched when none is named: those of them that the method has."""

WIDE = 30.0
"""A setting without limits is searched from its value over this to its value times this."""

FIRST_STEP, LAST_STEP, SWEEPS = math.log(3.0), 0.1, 6
LIKELIHOOD, ERROR = "likelihood", "error"


@dataclass(frozen=True)
class Recorded:
    """Holds the sensor stream that an estimator is tuned on."""

    samples: Samples
    site: Site
    sensors: SensorInfo
    method: str
    settings: Mapping[str, Any]  # those that it has in the log or the map
    reference: metrics.History = metrics.NOTHING
    folder: Path = Path()  # of the file that names code from outside


@dataclass(frozen=True)
class Knob:
    """A setting to search, from `low` to `high`."""

    name: str
    low: float
    high: float

    @classmethod
    def read(cls, text: str, known: Mapping[str, Setting] | None, values: Mapping[str, Any]) -> "Knob":
        """Read a knob from `gyro_noise` or `gyro_noise=1e-4..1e-2`; known: None when only the estimator knows.

        Raises:
            InputError: no such setting, not a number, or limits that are none.
        """
        name, _, limits = text.partition("=")
        if known is not None and name not in known:
            raise InputError(f"--setting {text}: no such setting{nearest(name, known)}")
        value = values.get(name, known[name].default if known is not None else 0.0)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"--setting {text}: '{name}' is not a number; only numbers can be tuned")
        if not limits:
            if not value > 0:
                raise InputError(f"--setting {text}: is {value:g} now; give limits: {name}=LOW..HIGH")
            return cls(name, float(value) / WIDE, float(value) * WIDE)
        low, _, high = limits.partition("..")
        try:
            knob = cls(name, float(low), float(high))
        except ValueError:
            raise InputError(f"--setting {text}: write {name}=LOW..HIGH") from None
        if not 0.0 < knob.low < knob.high < math.inf:
            raise InputError(f"--setting {text}: limits must rise and be above 0")
        return knob


@dataclass(frozen=True)
class Score:
    """Holds the score of one filter pass, by block; NaN where there is none."""

    cost: np.ndarray  # (blocks,) mean over the block: -2 log L a number, or squared error in deg2
    nis: np.ndarray  # (blocks,) mean NIS a number


@dataclass
class Tuned:
    """Holds the result of a search."""

    method: str
    objective: str
    settings: dict[str, float]
    before: float  # over the blocks that the search has not seen: log L a number, or RMS error in deg
    after: float
    gain: float  # positive is better
    low: float  # its 95 % bootstrap interval over blocks
    high: float
    nis_before: float
    nis_after: float
    blocks: int
    passes: int
    notes: list[str] = field(default_factory=list)

    def text(self) -> str:
        """Format the settings to paste and what they are worth."""
        outcome = "better" if self.low > 0 else "worse" if self.high < 0 else "no significant difference"
        what = "log-likelihood a number" if self.objective == LIKELIHOOD else "error, deg"
        nis = f"NIS {self.nis_before:.3g} -> {self.nis_after:.3g}; " if math.isfinite(self.nis_before) else ""
        return "\n".join(
            [
                f"[estimator.{Path(self.method.rpartition(':')[2]).stem}]",
                f'method = "{self.method}"',
                *(f"{name} = {value:.4g}" for name, value in self.settings.items()),
                "",
                f"{what}, {self.blocks} held-out blocks of {BLOCK_S:g} s: {self.before:.4g} -> {self.after:.4g}, "
                f"gain {self.gain:.3g} (95 %: {self.low:.3g} to {self.high:.3g}): {outcome}",
                f"{nis}{self.passes} passes of the filter",
                *self.notes,
            ]
        )


def read(
    path: Path,
    estimator: str,
    *,
    map_file: Path | None = None,
    reference: str | None = None,
    calibrate: Sequence[str] = ("auto",),
    gate: Gate,
) -> Recorded:
    """Read the sensors of a log or a recording once, as an estimator gets them.

    Args:
        path: a log of ours or any recording that `replay` reads.
        estimator: one of the log's, METHOD@SUITE, or METHOD.
        map_file: what topics and axes of a recording mean.
        reference: topic of a recording's reference attitude.
        calibrate: what to take out of a recording's sensors first, see `recordings.recording.open_bag`.
        gate: what code from outside may run.

    Raises:
        InputError: the recording cannot be read, or has no such estimator.
    """
    from ahrs_sim.playback import is_flight

    if is_mcap(path):
        with FlightReader(path) as log:
            if is_flight(log):
                return _of_flight(log, estimator, gate)
    from ahrs_sim.recordings.mapping import SUITE
    from ahrs_sim.recordings.recording import open_bag

    blocks, attitudes, assembler = [], [], Assembler()
    with open_bag(
        path, map_file=map_file, names=[estimator], calibrate=calibrate, sync=True, reference=reference, gate=gate
    ) as bag:
        for block in bag.blocks():
            records = block[SUITE]
            if "reference" in records:
                one: Any = records["reference"]
                known = np.isfinite(one.q_nb).all(axis=1)
                attitudes.append((one.stamp_ns[known] / 1e9, one.q_nb[known]))
            blocks.append(assembler.assemble(records))
        (component,) = bag.estimators
        return _recorded(blocks, attitudes, bag.site, bag.sensors, component)


def _of_flight(log: FlightReader, estimator: str, gate: Gate) -> Recorded:
    from ahrs_sim.log.mcap.reader import quaternion, stamps
    from ahrs_sim.playback import of_flight

    attitudes: list[tuple[np.ndarray, np.ndarray]] = []

    def truth(messages: Mapping[str, np.ndarray]) -> None:
        imu = messages["/truth/imu"]
        attitudes.append((log.seconds(stamps(imu)), quaternion(imu["orientation"])))

    beside, topics = (truth, ["/truth/imu"]) if "/truth/imu" in log.topics else (None, [])
    recording = of_flight(log, [estimator], beside, *topics, gate=gate)
    (component,) = recording.estimators
    suite = str(component.settings["suite"])
    assembler = Assembler()
    blocks = [assembler.assemble(block[suite]) for block in recording.blocks]
    return _recorded(blocks, attitudes, recording.site, recording.sensors[suite], component)


def _recorded(
    blocks: Sequence[Samples], attitudes: Sequence[tuple[np.ndarray, np.ndarray]], site: Site, sensors: SensorInfo,
    component: Component,
) -> Recorded:  # fmt: skip
    settings = {k: v for k, v in component.settings.items() if k not in ("method", "suite")}
    reference = metrics.NOTHING
    if attitudes:
        reference = metrics.History(*(np.concatenate(column) for column in zip(*attitudes, strict=True)))
    full = [block for block in blocks if len(block)]
    if not full:
        raise InputError("tune: the recording has no sample of the IMU")
    folder = Path(component.where.partition(":")[0]).parent
    method = str(component.settings["method"])
    return Recorded(Samples.concatenate(full), site, sensors, method, settings, reference, folder)


def tune(
    recorded: Recorded,
    settings: Sequence[str] = (),
    objective: str = LIKELIHOOD,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> Tuned:
    """Search for the settings that fit a recording.

    Args:
        recorded: see `read`.
        settings: `NAME` or `NAME=LOW..HIGH`; none: those of `NOISES` that the method has and that are not 0.
        objective: `LIKELIHOOD` or `ERROR`.
        progress: called with the passes done and the most there can be.

    Raises:
        InputError: a setting that is none, no reference for `ERROR`, an estimator without innovations.
        CheckError: the recording is too short to be cut in halves.
    """
    known = next((m.settings for m in describe() if m.name == recorded.method), None)
    values = {**{name: s.default for name, s in (known or {}).items()}, **recorded.settings}
    names = settings or [n for n in NOISES if isinstance(values.get(n), float) and values[n] > 0.0]
    if known is None and not from_outside(recorded.method):
        known = {}
    knobs = [Knob.read(text, known, values) for text in names]
    if not knobs:
        raise InputError(f"tune: {recorded.method} has no setting to tune by default; name one with --setting")
    if objective == ERROR and len(recorded.reference.t) < 2:
        raise InputError("tune --objective error: neither truth nor reference in it; leave it out")
    most = 1 + 3 * len(knobs) * SWEEPS
    trials: dict[tuple[float, ...], Score] = {}

    def score(x: np.ndarray) -> Score:
        if (key := tuple(x)) not in trials:
            trials[key] = _pass(recorded, {k.name: math.exp(v) for k, v in zip(knobs, x, strict=True)}, objective)
            progress(len(trials), most)
        return trials[key]

    start = np.log([np.clip(float(values.get(k.name, math.sqrt(k.low * k.high))), k.low, k.high) for k in knobs])
    first = _pass(recorded, {}, objective)
    usable = np.flatnonzero(np.isfinite(first.cost))
    if len(usable) < 4:
        raise CheckError(f"tune: only {len(usable)} blocks of {BLOCK_S:g} s with estimates; it takes four")
    seen, held_out = usable[::2], usable[1::2]
    best = _search(lambda x: float(np.mean(_or_worst(score(x).cost[seen]))), start, knobs)
    last = score(best)
    gain, low, high, before, after = _worth(first.cost[held_out], last.cost[held_out], objective)
    return Tuned(
        method=recorded.method,
        objective=objective,
        settings={k.name: math.exp(v) for k, v, was in zip(knobs, best, start, strict=True) if v != was},
        before=before,
        after=after,
        gain=gain,
        low=low,
        high=high,
        nis_before=_mean(first.nis[held_out]),
        nis_after=_mean(last.nis[held_out]),
        blocks=len(held_out),
        passes=len(trials) + 1,
        notes=[
            f"{k.name} ended at its limit: {math.exp(v):.4g}"
            for k, v in zip(knobs, best, strict=True)
            if min(v - math.log(k.low), math.log(k.high) - v) < 1e-6
        ],
    )


def _mean(nis: np.ndarray) -> float:
    """Mean of what is known; NaN where nothing is: an estimator without innovations."""
    return float(np.mean(nis[np.isfinite(nis)])) if np.isfinite(nis).any() else math.nan


def _or_worst(cost: np.ndarray) -> np.ndarray:
    """Count blocks without estimates as very bad: the search must not prefer settings that diverge."""
    return np.where(np.isfinite(cost), cost, 1e6)


def _worth(before: np.ndarray, after: np.ndarray, objective: str) -> tuple[float, float, float, float, float]:
    """Gain with its interval, and what it was and is, of costs by block."""
    both = np.isfinite(before) & np.isfinite(after)
    if not both.any():
        raise CheckError("tune: no held-out block has estimates both before and after")
    if objective == LIKELIHOOD:
        gains = 0.5 * (before[both] - after[both])
        was, now = -0.5 * float(before[both].mean()), -0.5 * float(after[both].mean())
        return now - was, *interval(gains), was, now
    was, now = math.sqrt(before[both].mean()), math.sqrt(after[both].mean())
    scale = 1.0 / (was + now) if was + now > 0.0 else 1.0  # of mean squares: a difference of roots
    low, high = interval((before[both] - after[both]) * scale)
    return was - now, low, high, was, now


def _search(cost: Callable[[np.ndarray], float], start: np.ndarray, knobs: Sequence[Knob]) -> np.ndarray:
    """Go along one setting at a time; logarithms."""
    low, high = np.log([k.low for k in knobs]), np.log([k.high for k in knobs])
    x, step = start.copy(), np.full(len(knobs), FIRST_STEP)
    here = cost(x)
    for _ in range(SWEEPS):
        for k in np.flatnonzero(step > LAST_STEP):

            def at(value: float, k: int = int(k), around: np.ndarray = x) -> tuple[float, np.ndarray]:
                trial = around.copy()
                trial[k] = np.clip(value, low[k], high[k])
                return cost(trial), trial

            below, above = at(x[k] - step[k]), at(x[k] + step[k])
            tried = [(here, x), below, above]
            if below[0] == here == above[0]:  # without effect on these sensors
                step[k] = 0.0
                continue
            bend = below[0] - 2.0 * here + above[0]
            if bend > 0.0:
                vertex = 0.5 * step[k] * (below[0] - above[0]) / bend
                tried.append(at(x[k] + float(np.clip(vertex, -step[k], step[k]))))
            before = x[k]
            here, x = min(tried, key=lambda pair: pair[0])
            if abs(x[k] - before) < 0.75 * step[k]:
                step[k] *= 0.5
    return x


def _pass(recorded: Recorded, changed: Mapping[str, float], objective: str) -> Score:
    """One pass of the filter."""
    estimates = _estimates(recorded, {**recorded.settings, **changed}, strict=not changed)
    block = ((estimates.t - estimates.t[0]) / BLOCK_S).astype(int)
    count = int(block[-1]) + 1
    with np.errstate(invalid="ignore", divide="ignore"):
        square = estimates.innovation**2 / estimates.innovation_var
        number = np.log(2.0 * math.pi * estimates.innovation_var) + square
    used = np.isfinite(number) & np.isfinite(estimates.q_nb[:, :1])
    numbers = np.bincount(block, used.sum(axis=1), count)
    with np.errstate(invalid="ignore", divide="ignore"):
        nis = np.bincount(block, np.where(used, square, 0.0).sum(axis=1), count) / numbers
        likely = np.bincount(block, np.where(used, number, 0.0).sum(axis=1), count) / numbers
    return Score(likely if objective == LIKELIHOOD else _errors(recorded, estimates, block, count), nis)


def _estimates(recorded: Recorded, settings: Mapping[str, Any], strict: bool) -> Estimates:
    """Estimate all samples, by code from outside in its process; when `strict`, its failure is an `InputError`."""
    site, sensors = recorded.site, recorded.sensors
    if not from_outside(recorded.method):
        return create(recorded.method, site=site, sensors=sensors, **settings).process(recorded.samples)
    made = plugins.create(
        recorded.method, recorded.method, recorded.folder, site=site, sensors=sensors, settings=settings
    )
    estimates = made.process(recorded.samples)
    if strict and made.failure is not None:
        raise InputError(f"tune: {recorded.method} {made.failure}")
    getattr(made.estimator, "close", lambda: None)()
    return estimates


def _errors(recorded: Recorded, estimates: Estimates, block: np.ndarray, count: int) -> np.ndarray:
    """Mean square (deg2) of tilt and heading errors by block, NaN where none is known."""
    rows = np.flatnonzero((estimates.t >= recorded.reference.t[0]) & (estimates.t <= recorded.reference.t[-1]))[::10]
    reference = recorded.reference.at(estimates.t[rows])
    errors = metrics.attitude_errors(estimates.q_nb[rows], estimates.down_b[rows], reference)
    square = np.degrees(errors[:, [metrics.Measure.TILT, metrics.Measure.HEADING]]) ** 2
    known = np.isfinite(square)
    total = np.bincount(block[rows], np.where(known, square, 0.0).sum(axis=1), count)
    of = np.bincount(block[rows], known.any(axis=1), count)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(total / of)
