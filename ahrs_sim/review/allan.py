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
from ahrs_sim.sensors.errors import ALLAN_FLOOR

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
        """One row per axis and coefficient: fitted, its standard error, and what the grade says where given.

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
        """The whole table in types that JSON knows."""
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
        """The fitted deviation (k, axes) at `tau` (k,) s."""
        n2, f2, k2 = 0.5 * self.density.value**2, self.floor.value**2, self.walk.value**2
        variance = n2 / tau[:, None] + f2 + k2 * tau[:, None] / 3.0
        return np.asarray(np.sqrt(variance))


def allan_deviation(
    series: np.ndarray, rate: float, *, per_decade: int = 8, overlap: int | None = 64
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Overlapping Allan deviation.

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
    """Mean square of second differences of `theta` (n,) over `lag`; in chunks that stay in the cache."""
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
    """Allan deviation of a channel with confidence and fitted coefficients.

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
    """What a suite's grade says of a sensor, from the flat texts of `Suite.specification` that a log keeps.

    Args:
        specification: e.g. `gyro.noise_density_dps_rthz` -> `0.03 (quoted: ...)`.
        sensor: `gyro`, `accelerometer` or `magnetometer`.

    Returns:
        `density`, `floor`, `walk`, (3,) each, SI; zero where the grade says nothing.
    """
    from ahrs_sim.sensors.grade import parse
    from ahrs_sim.sensors.suite import SECTIONS

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


def plot(table: AllanTable, path: Path, *, title: str = "") -> None:
    """Write a picture of the curve, its confidence and the fit; the format follows the file's name.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError("plot: matplotlib is not installed; pip install 'ahrs-sim[plot]'") from None
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.add_subplot()
    model = table.model(table.tau)
    for i, name in enumerate(table.names):
        (line,) = axes.loglog(table.tau, table.deviation[:, i], label=name)
        axes.fill_between(table.tau, table.low[:, i], table.high[:, i], color=line.get_color(), alpha=0.2, lw=0)
        axes.loglog(table.tau, model[:, i], "--", color=line.get_color(), lw=0.8)
    axes.set(xlabel="tau (s)", ylabel=f"Allan deviation ({table.unit})", title=title)
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

    `relative` (k,) is the relative error of a deviation; the variance's is twice that of the deviation, and the weights
    come from the model, not from the noisy points, in a second and third pass.
    """
    basis = np.column_stack([1.0 / tau, np.ones_like(tau), tau / 3.0])
    model = variance.copy()
    for _ in range(4):
        weight = 1.0 / (relative * np.maximum(model, 1e-300))
        a, b = basis * weight[:, None], variance * weight
        scale = np.sqrt(np.sum(a * a, axis=0))
        best, cost = np.zeros(3), float(b @ b)
        # Three unknowns: all subsets are tried, and the best whose coefficients are positive is the solution.
        for size in (1, 2, 3):
            for used in map(list, itertools.combinations(range(3), size)):
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
    return best, shared * np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _root(square: np.ndarray, error: np.ndarray) -> Coefficient:
    """Square root of a fitted square with its standard error: an upper bound when the fit is zero."""
    value = np.sqrt(square)
    sigma = np.where(square > error, error / (2.0 * np.maximum(value, 1e-300)), np.sqrt(error))
    return Coefficient(value, sigma)


FLOOR_PER_INSTABILITY = ALLAN_FLOOR
"""Floor over bias instability B, 0.664: `table.floor.value / FLOOR_PER_INSTABILITY` is B."""
