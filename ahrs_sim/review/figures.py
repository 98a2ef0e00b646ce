"""`ahrs-sim compare LOG --png DIR`: the main figures of a flight for papers and the logs of a build."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError
from ahrs_sim.evaluation import consistency, metrics
from ahrs_sim.evaluation.metrics import Measure
from ahrs_sim.evaluation.phases import PHASES
from ahrs_sim.review import colors
from ahrs_sim.review.traces import EstimatorTrace, FlightTraces

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_AXES = metrics.MEASURES[:3]
_EULER = (Measure.ROLL, Measure.PITCH, Measure.HEADING)
_SHADES = ("#e9edf2", "", "#fdebcf", "#e3edfd")
"""Behind the curves, by phase: ground, straight, turning, transient."""

_POINTS = 2000  # pairs of minimum and maximum a curve: finer than any print


def draw(flight: FlightTraces, folder: Path) -> list[Path]:
    """Write attitude, errors, consistency, worst windows, ground track and biases as PNG files; returns them.

    Raises:
        InputError: matplotlib is missing, or the folder cannot be used.
    """
    require()
    import matplotlib
    from matplotlib.figure import Figure

    written = []
    with matplotlib.rc_context({"axes.prop_cycle": _cycle(len(flight.estimators))}):  # colours are looked up when saved
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name, figure in _figures(Figure, flight).items():
                written.append(folder / f"{flight.label}-{name}.png")
                figure.savefig(written[-1], dpi=110)
        except OSError as error:
            raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return written


def require() -> None:
    """Check that figures can be drawn.

    Raises:
        InputError: matplotlib is missing.
    """
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        raise InputError("--png needs matplotlib; pip install 'ahrs-sim[plot]'")


def _cycle(estimators: int) -> Any:
    from cycler import cycler

    return cycler(color=[colors.pair(i)[0] for i in range(max(10, estimators))])


def _figures(new: Any, flight: FlightTraces) -> "dict[str, Figure]":
    return {
        "attitude": _attitude(new((11, 8), layout="constrained"), flight),
        "errors": _errors(new((11, 10), layout="constrained"), flight),
        "consistency": _consistency(
            new((15, 2.2 * max(1, len(flight.estimators)) + 0.6), layout="constrained"), flight
        ),
        "worst": _worst(new((11, 2.2 * max(1, len(flight.estimators)) + 0.6), layout="constrained"), flight),
        "track": _track(new((7, 7), layout="constrained"), flight),
        "biases": _biases(new((11, 8), layout="constrained"), flight),
    }


def _thin(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimum and maximum of every bucket, so that no peak is lost."""
    size = len(t) // _POINTS
    if size < 2:
        return t, values
    n = len(t) // size * size
    boxes = values[:n].reshape(-1, size)
    pairs = np.stack([np.fmin.reduce(boxes, axis=1), np.fmax.reduce(boxes, axis=1)], axis=1)
    return np.repeat(t[:n:size], 2), pairs.ravel()


def _thin_angle(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same of an angle, deg, with a gap where it wraps."""
    t, values = _thin(t, values)
    values = values.copy()
    values[1:][np.abs(np.diff(values)) > 180.0] = np.nan
    return t, values


def _continuous(t: np.ndarray, q_nb: np.ndarray) -> np.ndarray:
    """Roll, pitch, heading (n, 3) in deg without jumps."""
    angles: np.ndarray = np.degrees(attitude.euler(q_nb))
    angles[:, [0, 2]] = np.unwrap(angles[:, [0, 2]], period=360.0, axis=0)
    return angles


def _modulo(ax: "Axes") -> None:
    """Label the ticks with headings of 0 to 360 deg, however many turns were made."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    ax.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 1.5, 3, 4.5, 9, 10]))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y % 360:g}"))


def _estimated(flight: FlightTraces, e: EstimatorTrace, rows: slice | np.ndarray) -> np.ndarray:
    """Compute angles (n, 3) in deg of an estimator in the same turn as the reference."""
    truth = _continuous(flight.t, flight.q_nb)
    reference = np.column_stack([np.interp(e.t[rows], flight.t, truth[:, k]) for k in range(3)])
    angles = np.asarray(reference + np.degrees(e.error[rows, :3]))
    jump = np.abs(np.diff(angles, axis=0)) > 180.0  # the error wraps: not to be drawn
    angles[1:][jump] = np.nan
    return angles


def _attitude(figure: "Figure", flight: FlightTraces) -> "Figure":
    axes = figure.subplots(3, 1, sharex=True)
    truth = _continuous(flight.t, flight.q_nb)
    for k, ax in enumerate(axes):
        for e in flight.estimators.values():
            ax.plot(*_thin_angle(e.t, _estimated(flight, e, slice(None))[:, k]), linewidth=0.9, label=e.name)
        ax.plot(*_thin(flight.t, truth[:, k]), "k--", linewidth=0.9, label=flight.reference)
        _label(ax, f"{_AXES[k]}, deg")
    _modulo(axes[2])
    return _finish(figure, flight, axes, f"{flight.label}: attitude")


def _errors(figure: "Figure", flight: FlightTraces) -> "Figure":
    axes = figure.subplots(4, 1, sharex=True)
    for ax, k in zip(axes, (Measure.TILT, *_EULER), strict=True):
        for i, e in enumerate(flight.estimators.values()):
            error = np.degrees(e.error[:, k].astype(float))
            ax.plot(*_thin_angle(e.t, error), color=f"C{i}", linewidth=0.9, label=e.name)
            if k in _EULER:
                sigma = 3 * np.degrees(e.sigma[:, k])
                ax.fill_between(e.coarse_t, -sigma, sigma, color=f"C{i}", alpha=0.15, linewidth=0)
        _label(ax, f"{metrics.MEASURES[k]} error, deg")
    return _finish(figure, flight, axes, f"{flight.label}: errors, shaded ±3 sigma of the estimators")


def _consistency(figure: "Figure", flight: FlightTraces) -> "Figure":
    """Draw a row an estimator: its errors in its own ±3 sigma, and NEES per degree of freedom in its 95 % bounds."""
    axes = figure.subplots(max(1, len(flight.estimators)), 4, squeeze=False, sharex=True)
    low, high = (float(bound) / 3 for bound in consistency.chi_square_bounds(3))
    for row, e in zip(axes, flight.estimators.values(), strict=True):
        for k, ax in enumerate(row[:3]):
            error = np.degrees(e.error[:, k].astype(float))
            ax.plot(*_thin_angle(e.t, error), color="C3", linewidth=0.8, label="error")
            sigma = 3 * np.degrees(e.sigma[:, k])
            ax.fill_between(
                e.coarse_t, -sigma, sigma, color="C0", alpha=0.4, linewidth=0, label="±3 sigma of the estimator"
            )
            _label(ax, f"{_AXES[k]} error, deg")
        known = np.where(e.nees > 0.0, e.nees, np.nan)
        if not np.isfinite(known).any():
            row[3].text(0.5, 0.5, "claims no covariance", ha="center", va="center", transform=row[3].transAxes)
        row[3].plot(*_thin(e.coarse_t, known), color="C3", linewidth=0.8)
        row[3].axhspan(low, high, color="C0", alpha=0.4, linewidth=0)
        row[3].set_yscale("log")
        _label(row[3], "NEES / 3")
        row[0].set_title(e.name, fontsize=9, loc="left")
    return _finish(figure, flight, axes.ravel(), f"{flight.label}: errors in ±3 sigma, NEES in its 95 % bounds")


def _worst(figure: "Figure", flight: FlightTraces) -> "Figure":
    """Draw heading, pitch and roll of all estimators in the worst ten seconds of each."""
    axes = figure.subplots(max(1, len(flight.estimators)), 3, squeeze=False)
    truth = _continuous(flight.t, flight.q_nb)
    for row, chosen in zip(axes, flight.estimators.values(), strict=True):
        window = chosen.worst(flight)
        for ax, k in zip(row, (2, 1, 0), strict=True):
            if window is None:
                ax.set_axis_off()
                continue
            for e in flight.estimators.values():
                rows = (e.t >= window.start) & (e.t <= window.end)
                width = 1.6 if e is chosen else 0.8
                ax.plot(e.t[rows], _estimated(flight, e, rows)[:, k], linewidth=width, label=e.name)
            rows = (flight.t >= window.start) & (flight.t <= window.end)
            ax.plot(flight.t[rows], truth[rows, k], "k--", linewidth=1.2, label=flight.reference)
            _label(ax, f"{_AXES[k]}, deg")
        _modulo(row[0])
        row[0].set_title(
            f"worst of {chosen.name}" + (f": {window.phase}" if window and window.phase else ""), fontsize=9, loc="left"
        )
    return _finish(figure, flight, axes.ravel(), f"{flight.label}: the worst ten seconds of each estimator")


def _track(figure: "Figure", flight: FlightTraces) -> "Figure":
    ax = figure.subplots()
    for i, (name, suite) in enumerate(flight.suites.items()):
        if len(suite.fix):
            ax.plot(suite.fix[:, 1], suite.fix[:, 0], ".", color=f"C{7 - i}", markersize=1, label=f"{name} fixes")
    every = slice(None, None, max(1, len(flight.position) // 5000))
    if len(flight.position):
        ax.plot(flight.position[every, 1], flight.position[every, 0], "k", linewidth=1, label="truth")
    for e in flight.estimators.values():
        if np.isfinite(e.position).any():
            ax.plot(e.position[:, 1], e.position[:, 0], linewidth=0.9, label=e.name)
    ax.set_aspect("equal", "datalim")
    ax.set_xlabel("east, m")
    ax.set_ylabel("north, m")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    ax.set_title(f"{flight.label}: ground track")
    return figure


def _biases(figure: "Figure", flight: FlightTraces) -> "Figure":
    axes = figure.subplots(3, 1, sharex=True)
    for k, ax in enumerate(axes):
        for i, e in enumerate(flight.estimators.values()):
            bias, sigma = np.degrees(e.gyro_bias[:, k]), 3 * np.degrees(e.gyro_bias_sigma[:, k])
            ax.plot(e.coarse_t, bias, color=f"C{i}", linewidth=0.9, label=e.name)
            ax.fill_between(e.coarse_t, bias - sigma, bias + sigma, color=f"C{i}", alpha=0.15, linewidth=0)
        for i, (name, suite) in enumerate(flight.suites.items()):
            if len(suite.t):
                style = ("k--", "k:", "k-.")[i % 3]
                ax.plot(suite.t, np.degrees(suite.gyro_bias[:, k]), style, linewidth=1, label=f"{name} truth")
        _label(ax, f"gyro bias {'xyz'[k]}, deg/s")
    return _finish(figure, flight, axes, f"{flight.label}: gyro biases")


def shade(ax: "Axes", t: np.ndarray, phase: np.ndarray) -> None:
    """Draw the phases of flight behind the curves; straight flight stays white.

    Args:
        ax: with time on its x axis.
        t: (n,) s, rising.
        phase: (n,) index into `PHASES`.
    """
    if not len(phase) or not ax.axison:
        return
    low, high = ax.get_xlim()
    starts = np.flatnonzero(np.r_[True, np.diff(phase) != 0])
    ends = np.r_[starts[1:], len(phase) - 1]
    for a, b in zip(starts, ends, strict=True):
        color = _SHADES[phase[a]]
        if color and t[b] > low and t[a] < high:
            ax.axvspan(max(t[a], low), min(t[b], high), color=color, linewidth=0, zorder=0)
    ax.set_xlim(low, high)


def shades(phase: np.ndarray) -> "tuple[list[Any], list[str]]":
    """Make handles and labels for a legend of the phases that are shaded."""
    from matplotlib.patches import Patch

    used = [int(k) for k in np.unique(phase) if _SHADES[k]]
    return [Patch(color=_SHADES[k]) for k in used], [PHASES[k] for k in used]


def _label(ax: "Axes", text: str) -> None:
    ax.set_ylabel(text)
    ax.grid(alpha=0.3)
    ax.margins(x=0)


def _finish(figure: "Figure", flight: FlightTraces, axes: np.ndarray, title: str) -> "Figure":
    axes[-1].set_xlabel("time, s")
    for ax in axes:
        shade(ax, flight.truth_t, flight.phase)
    figure.suptitle(title)
    handles, labels = axes[0].get_legend_handles_labels()
    if handles:
        patches, names = shades(flight.phase)
        handles, labels = [*handles, *patches], [*labels, *names]
        columns = math.ceil(len(handles) / math.ceil(len(handles) / 8))
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=8)
    return figure
