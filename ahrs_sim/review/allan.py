"""Allan deviation: what noise a channel really has.

Overlapping estimator, with theta the running integral of the series and m samples in tau:

    sigma^2(tau) = 1 / (2 tau^2 (n - 2m + 1)) sum_k (theta[k + 2m] - 2 theta[k + m] + theta[k])^2

and, fitted to it, the three processes of IEEE Std 952 that a datasheet speaks of:

    sigma^2(tau) = N^2 / tau + F^2 + K^2 tau / 3

N white noise (angle random walk): a single-sided density d = sqrt(2) N; F floor: bias instability B = F / 0.664; K rate
random walk. Confidence from the equivalent degrees of freedom of the estimator under flicker noise (NIST SP 1065, table
5), between those under the two others.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.reader import stamps
from ahrs_sim.recordings.clocks import coarse_stamps
from ahrs_sim.sensors.grade import parse
from ahrs_sim.sensors.suite import SECTIONS
from ahrs_sim.world import gravity

_OTHER_CLOCK_NS, _STEP_NS = 10 * 10**9, 10**9
"""As in a replay: stamps this far from the log's times are of another clock; one this far back is no late message."""

_MODEL_ERROR = 0.02
"""Relative error that no point of the fit is thought to be better than: real noise is not quite one of three kinds."""


@dataclass(frozen=True)
class Coefficient:
    """A fitted coefficient of each axis with its standard error, in the series' unit."""

    value: np.ndarray  # (axes,)
    sigma: np.ndarray  # (axes,)


@dataclass(frozen=True)
class AllanTable:
    """Allan deviation of a channel and what was fitted to it."""

    names: tuple[str, ...]  # of the axes
    unit: str  # of the series
    rate: float  # Hz
    duration: float  # s
    tau: np.ndarray  # (k,) s
    deviation: np.ndarray  # (k, axes)
    low: np.ndarray  # (k, axes) 68 % confidence
    high: np.ndarray  # (k, axes)
    density: Coefficient  # unit/sqrt(Hz), single-sided
    floor: Coefficient  # unit, minimum of the flicker part alone
    walk: Coefficient  # unit/sqrt(s)

    def rows(self, specified: Mapping[str, np.ndarray] | None = None) -> list[dict[str, Any]]:
        """Make one row per axis and coefficient: fitted, its standard error, and the grade's figure where given.

        Args:
            specified: by coefficient (`density`, `floor`, `walk`), (axes,), as from `specified`.
        """
        units = {"density": f"{self.unit}/sqrt(Hz)", "floor": self.unit, "walk": f"{self.unit}/sqrt(s)"}
        made = []
        for i, axis in enumerate(self.names):
            for name, unit in units.items():
                fitted: Coefficient = getattr(self, name)
                row = {
                    "axis": axis,
                    "coefficient": name,
                    "unit": unit,
                    "fitted": float(fitted.value[i]),
                    "sigma": float(fitted.sigma[i]),
                }
                if specified is not None:
                    row["specified"] = float(specified[name][i])
                made.append(row)
        return made

    def json(self, specified: Mapping[str, np.ndarray] | None = None) -> dict[str, Any]:
        """Return the whole table in types that JSON knows."""
        return {
            "unit": self.unit,
            "rate_hz": self.rate,
            "duration_s": self.duration,
            "coefficients": self.rows(specified),
            "tau_s": self.tau.tolist(),
            "deviation": {name: self.deviation[:, i].tolist() for i, name in enumerate(self.names)},
            "low": {name: self.low[:, i].tolist() for i, name in enumerate(self.names)},
            "high": {name: self.high[:, i].tolist() for i, name in enumerate(self.names)},
        }

    def model(self, tau: np.ndarray) -> np.ndarray:
        """Return the fitted deviation (k, axes) at `tau` (k,) s."""
        n2, f2, k2 = 0.5 * self.density.value**2, self.floor.value**2, self.walk.value**2
        variance = n2 / tau[:, None] + f2 + k2 * tau[:, None] / 3.0
        return np.asarray(np.sqrt(variance))


def allan_deviation(
    series: np.ndarray, rate: float, *, per_decade: int = 8, overlap: int | None = 64
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the overlapping Allan deviation.

    Args:
        series: (n,) or (n, axes), evenly sampled.
        rate: Hz.
        per_decade: points per decade of tau.
        overlap: clusters per tau: beyond some tens more of them say nothing new but cost time; None: all.

    Returns:
        tau (k,) s up to a fifth of the length, samples per tau (k,), deviation (k, axes).

    Raises:
        InputError: fewer than 20 samples, or any not finite.
    """
    x = series[:, None] if series.ndim == 1 else series
    n = len(x)
    if n < 20:
        raise InputError(f"Allan deviation: {n} samples are too few; give at least 20")
    if not np.isfinite(x).all():
        raise InputError("Allan deviation: the series has missing values; choose a stretch without")
    sizes = np.unique(np.round(10.0 ** np.arange(0.0, math.log10(n / 5), 1.0 / per_decade)).astype(int))
    strides = np.maximum(sizes // overlap, 1) if overlap else np.ones_like(sizes)
    sizes = sizes // strides * strides
    deviation = np.empty((len(sizes), x.shape[1]))
    for axis in range(x.shape[1]):
        theta = np.concatenate([[0.0], np.cumsum(x[:, axis] - np.mean(x[:, axis]))]) / rate
        for k, (m, stride) in enumerate(zip(sizes.tolist(), strides.tolist(), strict=True)):
            points = theta[::stride]
            deviation[k, axis] = math.sqrt(0.5 * _mean_square(points, m // stride)) * rate / m
    return sizes / rate, sizes, deviation


def _mean_square(theta: np.ndarray, lag: int, chunk: int = 1 << 13) -> float:
    """Compute mean square of second differences of `theta` (n,) over `lag`; in chunks that stay in the cache."""
    count = len(theta) - 2 * lag
    total = 0.0
    for i in range(0, count, chunk):
        j = min(i + chunk, count)
        d = theta[i + 2 * lag : j + 2 * lag] - 2.0 * theta[i + lag : j + lag] + theta[i:j]
        total += float(d @ d)
    return total / count


def allan_table(
    series: np.ndarray, rate: float, *, names: Sequence[str] | None = None, unit: str = "", per_decade: int = 8
) -> AllanTable:
    """Compute the Allan deviation of a channel with its confidence and fitted coefficients.

    Args:
        series: (n,) or (n, axes), evenly sampled, without gaps; a sensor at rest at constant temperature.
        rate: Hz.
        names: of the axes; default x, y, z or 0, 1, ...
        unit: of the series.
        per_decade: points per decade of tau.

    Raises:
        InputError: fewer than 20 samples, or any not finite.
    """
    tau, sizes, deviation = allan_deviation(series, rate, per_decade=per_decade)
    n, axes = len(series), deviation.shape[1]
    freedom = _freedom(n + 1, sizes)
    low, high = (deviation * np.sqrt(freedom / _chi2(freedom, z))[:, None] for z in (1.0, -1.0))
    relative = np.sqrt(2.0 / freedom + _MODEL_ERROR**2)
    # Neighbouring points share most of their data: errors are those of one point per octave.
    shared = math.sqrt(max(per_decade * math.log10(2.0), 1.0))
    fits = [_fit(tau, deviation[:, i] ** 2, relative, shared) for i in range(axes)]
    n2, f2, k2 = (np.array([fit[0][j] for fit in fits]) for j in range(3))
    errors = [np.array([fit[1][j] for fit in fits]) for j in range(3)]
    return AllanTable(
        names=tuple(names or (("x", "y", "z") if axes == 3 else [str(i) for i in range(axes)])),
        unit=unit,
        rate=rate,
        duration=n / rate,
        tau=tau,
        deviation=deviation,
        low=low,
        high=high,
        density=_root(2.0 * n2, 2.0 * errors[0]),
        floor=_root(f2, errors[1]),
        walk=_root(k2, errors[2]),
    )


def specified(specification: Mapping[str, str], sensor: str) -> dict[str, np.ndarray]:
    """Read the grade's figures of a sensor from the flat texts of `Suite.specification` that a log keeps.

    Args:
        specification: e.g. `gyro.noise_density_dps_rthz` -> `0.03 (quoted: ...)`.
        sensor: `gyro`, `accelerometer` or `magnetometer`.

    Returns:
        `density`, `floor`, `walk`, (3,) each, SI; zero where the grade says nothing.
    """
    stated = {}
    for key, text in specification.items():
        section, _, name = key.partition(".")
        if section == sensor:
            stated[name] = [float(x) for x in text.split(" (")[0].split()]
    layer = parse({sensor: stated}, SECTIONS, "log", "log").get(sensor, {})
    fields = {"density": "noise_density", "floor": "bias_floor", "walk": "rate_random_walk"}
    found = {}
    for name, field in fields.items():
        entry = layer.get(field)
        found[name] = np.broadcast_to(np.multiply(entry.value, entry.factor) if entry else 0.0, 3).astype(float)
    return found


@dataclass(frozen=True)
class Channel:
    """One sensor of a log with its Allan table."""

    topic: str
    sensor: str  # gyro, accelerometer or magnetometer
    table: AllanTable
    specified: dict[str, np.ndarray] | None  # what the grade says, for logs of ours
    left_out: str = ""  # what of the series is not in the table, and why
    moved: str = ""  # that it was not at rest


_SENSORS = {
    "sensor_msgs/msg/Imu": {"angular_velocity": "gyro", "linear_acceleration": "accelerometer"},
    "sensor_msgs/msg/MagneticField": {"magnetic_field": "magnetometer"},
}
"""Vector fields of the message types that can be analysed."""

_SHOWN = {
    "gyro": ("rad/s", 180.0 / math.pi, "deg/s"),
    "accelerometer": ("m/s2", 1e3 / gravity.STANDARD, "mg"),
    "magnetometer": ("T", 1e7, "mG"),
}
"""Unit in tables of numbers, factor and unit in what people read."""


def of_log(path: Path, topics: Sequence[str] = (), map_file: Path | None = None) -> list[Channel]:
    """Compute Allan tables of the sensors in a log of ours or in any recording.

    The sensors should have stood still: a flight's own motion is not noise. Of a series with gaps or steps of its
    clock, the longest stretch without is taken; what was left out is in the channel.

    Args:
        path: the log.
        topics: `Imu` or `MagneticField` topics; none: all `Imu` topics but the truth's and the estimators'.
        map_file: what the columns of a table of text are.

    Raises:
        InputError: no such log or topic, a topic of another type, or too few samples.
    """
    from ahrs_sim.recordings.as_log import open_log

    channels: list[Channel] = []
    with open_log(path, map_file) as log:
        named = bool(topics)
        if not named:
            imus = [name for name, info in log.topics.items() if info.type_name == "sensor_msgs/msg/Imu"]
            topics = [t for t in imus if not t.startswith(("/est/", "/truth/"))]
        if not topics:
            raise InputError(f"{path}: no Imu topic; name one with --topic")
        for topic in topics:
            kind = log.topics[topic].type_name if topic in log.topics else ""
            array = log.read(topic)
            fields = _SENSORS.get(kind)
            if fields is None:
                raise InputError(f"{path}: {topic}: is a {kind}; give an Imu or MagneticField topic")
            if why := messages.difference(kind, array.dtype):
                raise InputError(f"{path}: {topic} is not a {kind} as it is known: {why}")
            unit = log.metadata.get(f"suite {topic.split('/')[1]}") if "/" in topic else None
            for field, sensor in fields.items():
                values = np.column_stack([array[field][axis] for axis in "xyz"])
                values = values[array[f"{field}_covariance"][:, 0] != -1.0]
                if len(array) and not (values != values[:1]).any():  # not there, or a placeholder
                    continue
                found = evenly(stamps(array), array["log_time"], _known(array, field), f"{path}: {topic}")
                table = allan_table(found.values, found.rate, unit=_SHOWN[sensor][0])
                grade = specified(unit, sensor) if unit else None
                moved = _moved(found.values, found.rate, sensor)
                channels.append(Channel(topic, sensor, table, grade, found.left_out, moved))
    if not channels:
        raise InputError(f"{path}: {', '.join(topics)}: no values that change; there is no noise to analyse")
    return channels


def _known(array: np.ndarray, field: str) -> np.ndarray:
    """Compute values (n, 3) of a vector field, NaN where a message says that it has none."""
    values = np.column_stack([array[field][axis] for axis in "xyz"])
    values[array[f"{field}_covariance"][:, 0] == -1.0] = np.nan
    return values


@dataclass(frozen=True)
class Even:
    """The longest stretch of evenly sampled values."""

    values: np.ndarray  # (m, 3)
    rate: float  # Hz
    left_out: str  # what is not in it, and why; empty: nothing


def evenly(header_ns: np.ndarray, log_ns: np.ndarray, values: np.ndarray, where: str) -> Even:
    """Find the longest stretch without gaps, missing values and steps of the clock.

    Samples that came late are put in their place, and repeated ones counted once; stamps of another clock than the
    log's, and those that repeat, are replaced by its times, as in a replay. Coarse stamps and bursts are no gaps: those
    are found where the stamps go ahead of an even count by half a sample and stay there.

    Args:
        header_ns: (n,) int64, stamps.
        log_ns: (n,) int64, when the samples were recorded.
        values: (n, 3).
        where: of what, for messages.

    Raises:
        InputError: no stretch of 20 samples.
    """
    notes = []
    t = header_ns
    if len(t) and abs(float(np.median(header_ns - log_ns))) > _OTHER_CLOCK_NS:
        t = log_ns
        notes.append("stamps are of another clock, times of the log are used")
    elif coarse_stamps(header_ns, log_ns):
        t = log_ns
        notes.append("stamps repeat or stand still, times of the log are used")
    known = np.isfinite(values).all(axis=1)
    if not known.all():
        notes.append(f"{int((~known).sum())} samples without values")
    back = np.flatnonzero(np.diff(t) < -_STEP_NS) + 1
    if len(back):
        notes.append(f"the clock steps back {len(back)} times, first by {(t[back[0] - 1] - t[back[0]]) / 1e9:.6g} s")
    best, rate = np.empty(0, np.int64), math.nan
    counts = np.zeros(4, int)  # late, repeated, gaps, lost
    for part in np.split(np.arange(len(t)), back):
        stretches, found = _stretches(t, values, part, known)
        counts += found
        longest, its_rate = max(stretches, key=lambda s: len(s[0]), default=(best, rate))
        if len(longest) > len(best):
            best, rate = longest, its_rate
    for count, text in zip(counts, ("came late", "came twice", "gaps", "samples lost in them"), strict=True):
        if count:
            notes.append(f"{count} {text}")
    if len(best) < 20:
        why = f" ({', '.join(notes)})" if notes else ""
        raise InputError(
            f"{where}: of {len(t)} samples no stretch of 20 without gaps{why}; the Allan deviation needs even samples"
        )
    if len(best) < len(t):
        notes.append(f"the longest even stretch is {len(best)} of {len(t)} samples")
    return Even(values[best], rate, ", ".join(notes))


def _stretches(
    t: np.ndarray, values: np.ndarray, part: np.ndarray, known: np.ndarray
) -> tuple[list[tuple[np.ndarray, float]], np.ndarray]:
    """Find rows and rate of each even stretch of one part of a series; count late, repeated, gaps, lost."""
    if len(part) < 2:
        return [], np.zeros(4, int)
    late = int(np.sum(np.diff(t[part]) < 0))
    rows = part[np.argsort(t[part], kind="stable")]
    same = np.r_[False, (np.diff(t[rows]) == 0) & (np.diff(values[rows], axis=0) == 0).all(axis=1)]
    rows = rows[~same]
    if len(rows) < 2 or t[rows[-1]] == t[rows[0]]:
        return [], np.array([late, int(same.sum()), 0, 0])
    s = (t[rows] - t[rows[0]]).astype(float)
    k = min(50, len(s) - 1)
    period = float(np.median((s[k:] - s[:-k]) / k)) or (s[-1] / (len(s) - 1))
    breaks = _gaps(s / period)
    lost = int(np.sum(np.maximum(np.rint(np.diff(s)[breaks - 1] / period) - 1, 0)))
    edges = np.union1d(breaks, np.flatnonzero(known[rows][1:] != known[rows][:-1]) + 1)
    found = []
    for stretch in np.split(rows, edges):
        if len(stretch) > 1 and known[stretch[0]] and t[stretch[-1]] > t[stretch[0]]:
            found.append((stretch, (len(stretch) - 1) * 1e9 / float(t[stretch[-1]] - t[stretch[0]])))
    return found, np.array([late, int(same.sum()), len(breaks), lost])


def _gaps(s: np.ndarray) -> np.ndarray:
    """Find samples before which some are missing, from the stamps (n,) in periods."""
    steps = np.diff(s)
    burst = max(1, round(len(s) / (1 + int(np.sum(steps > 0.5)))))  # samples that come together
    jitter = 1.05 * float(np.median(np.abs(steps - 1.0))) if burst == 1 else 0.0
    half = min(max(4 if burst == 1 else 2 * burst, math.ceil(400.0 * jitter**2)), 200)  # medians good to a tenth
    if len(s) < 2 * half + 2:
        return np.flatnonzero(steps > 1.5 * burst) + 1
    ahead = s - np.arange(len(s))
    medians = np.median(np.lib.stride_tricks.sliding_window_view(ahead, half), axis=1)
    jump = medians[half:] - medians[:-half]  # between samples i + half - 1 and i + half
    candidates = np.flatnonzero(jump > max(0.5, 0.35 * burst)) + half
    found = []
    for group in np.split(candidates, np.flatnonzero(np.diff(candidates) > 1) + 1):
        if len(group):
            widest = group[np.argmax(steps[group - 1])]
            found.append(int(widest))
    # near the ends there is no median on one side
    ends = np.r_[np.arange(1, half), np.arange(len(s) - half + 1, len(s))]
    found += ends[steps[ends - 1] > 1.5 * burst + 6.0 * jitter].tolist()
    return np.unique(np.array(found, np.int64))


_MOVING = {"gyro": math.radians(1.0), "accelerometer": 0.3}  # rad/s, m/s2: no drift within a recording is as large


def _moved(values: np.ndarray, rate: float, sensor: str) -> str:
    """Say so if the means (m, 3) of every second differ by more than a sensor at rest drifts; "" else."""
    per_second = max(1, round(rate))
    whole = len(values) // per_second * per_second
    if sensor not in _MOVING or not whole:
        return ""
    means = values[:whole].reshape(-1, per_second, values.shape[1]).mean(axis=1)
    largest = float(np.abs(means - np.median(means, axis=0)).max())
    if largest < _MOVING[sensor]:
        return ""
    factor, unit = _SHOWN[sensor][1:]
    return f"not at rest: its means change by up to {largest * factor:.3g} {unit}, and the fits take that for noise"


def as_json(channels: Sequence[Channel]) -> list[dict[str, Any]]:
    """Convert the tables to types that JSON knows, SI."""
    named = ({"topic": c.topic, "sensor": c.sensor, "left_out": c.left_out, "moved": c.moved} for c in channels)
    return [{**name, **c.table.json(c.specified)} for name, c in zip(named, channels, strict=True)]


def text(channels: Sequence[Channel]) -> str:
    """Format the tables for a reader: fitted and, where known, specified side by side."""
    lines = []
    for c in channels:
        _, factor, unit = _SHOWN[c.sensor]
        hours = 3600.0 if c.sensor == "gyro" else 1.0
        shown = {
            "density": (factor, f"{unit}/sqrt(Hz)", "white noise, single-sided density"),
            "floor": (factor * hours, "deg/h" if c.sensor == "gyro" else unit, "floor (0.664 bias instability)"),
            "walk": (factor, f"{unit}/sqrt(s)", "rate random walk"),
        }
        lines.append(f"{c.topic} {c.sensor}: {c.table.rate:.6g} Hz, {c.table.duration:.6g} s")
        lines += [f"  {line}" for line in (c.left_out, c.moved) if line]
        for row in c.table.rows(c.specified):
            scale, name, meaning = shown[row["coefficient"]]
            nominal = f"   specified {row['specified'] * scale:8.4g}" if "specified" in row else ""
            fitted = f"{row['fitted'] * scale:10.4g} +- {row['sigma'] * scale:<8.2g}"
            lines.append(f"  {row['axis']}  {fitted} {name:14s}{nominal}   {meaning}")
    return "\n".join(lines)


def plot(channels: Sequence[Channel], path: Path) -> None:
    """Write a picture of the curves, their confidence and the fits; the format follows the file's name.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError("plot: matplotlib is not installed; pip install 'ahrs-sim[plot]'") from None
    figure = Figure(figsize=(8.0, 4.0 * len(channels)), layout="constrained")
    for number, c in enumerate(channels):
        axes = figure.add_subplot(len(channels), 1, number + 1)
        _, factor, unit = _SHOWN[c.sensor]
        model = c.table.model(c.table.tau)
        for i, name in enumerate(c.table.names):
            (line,) = axes.loglog(c.table.tau, factor * c.table.deviation[:, i], label=name)
            band = factor * c.table.low[:, i], factor * c.table.high[:, i]
            axes.fill_between(c.table.tau, *band, color=line.get_color(), alpha=0.2, lw=0)
            axes.loglog(c.table.tau, factor * model[:, i], "--", color=line.get_color(), lw=0.8)
        axes.set(xlabel="tau (s)", ylabel=f"Allan deviation ({unit})", title=f"{c.topic} {c.sensor}")
        axes.grid(True, which="both", alpha=0.3)
        axes.legend(title="dashed: fit")
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({error})") from None


def _freedom(points: int, m: np.ndarray) -> np.ndarray:
    """Equivalent degrees of freedom under flicker noise, NIST SP 1065 table 5, from `points` of theta."""
    n = float(points)
    one = 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9)
    return np.where(m == 1, one, np.maximum(5.0 * n**2 / (4.0 * m * (n + 3.0 * m)), 1.0))


def _chi2(freedom: np.ndarray, z: float) -> np.ndarray:
    """Quantile of chi-square that a standard normal has at `z` (Wilson and Hilferty)."""
    a = 2.0 / (9.0 * freedom)
    return np.asarray(freedom * (1.0 - a + z * np.sqrt(a)) ** 3)


def _fit(tau: np.ndarray, variance: np.ndarray, relative: np.ndarray, shared: float) -> tuple[np.ndarray, np.ndarray]:
    """Non-negative least squares of N^2, F^2, K^2 and their standard errors, (3,) each.

    `relative` (k,) is the relative error of a variance; the weights come from the model, not the noisy points, after
    the first pass.
    """
    size = float(variance.max())
    if not 1e-300 < size < 1e300:  # none, or numbers that are no measurements
        return np.zeros(3), np.zeros(3)
    variance = variance / size
    basis = np.column_stack([1.0 / tau, np.ones_like(tau), tau / 3.0])
    model = variance.copy()
    for _ in range(4):
        weight = 1.0 / (relative * np.maximum(model, 1e-12))
        a, b = basis * weight[:, None], variance * weight
        scale = np.sqrt(np.sum(a * a, axis=0))
        best, cost = np.zeros(3), float(b @ b)
        # Three unknowns: all subsets are tried, and the best whose coefficients are positive is the solution.
        for terms in (1, 2, 3):
            for used in map(list, itertools.combinations(range(3), terms)):
                x = np.linalg.lstsq(a[:, used] / scale[used], b, rcond=None)[0] / scale[used]
                r = b - a[:, used] @ x
                if (x > 0.0).all() and float(r @ r) < cost:
                    best, cost = np.zeros(3), float(r @ r)
                    best[used] = x
        if not best.any():
            break
        model = basis @ best
    scaled = a / scale
    covariance = np.linalg.pinv(scaled.T @ scaled) / np.outer(scale, scale)
    return size * best, size * shared * np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _root(square: np.ndarray, error: np.ndarray) -> Coefficient:
    """Square root of a fitted square with its standard error: an upper bound when the fit is zero."""
    value = np.sqrt(square)
    sigma = np.where(square > error, error / (2.0 * np.maximum(value, 1e-300)), np.sqrt(error))
    return Coefficient(value, sigma)
