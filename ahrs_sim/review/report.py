"""`ahrs-sim compare LOG... --report OUT.html`: one page that shows who was wrong, when and why.

The page is complete in itself: data, styles, program and the plotting library (uPlot) are inside, nothing is fetched.
Series are quantised, coded as differences, split into byte planes, deflated and written in base64: attitudes and errors
stay at the rate of the estimates as long as the page keeps within its budget, else peaks are kept. The page's program
reduces them to what a screen can show at every zoom.
"""

import base64
import json
import math
import warnings
import zlib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError
from ahrs_sim.evaluation import accuracy, consistency, phases
from ahrs_sim.evaluation.metrics import Measure
from ahrs_sim.evaluation.phases import PHASES
from ahrs_sim.review import colors, one_file
from ahrs_sim.review.traces import COARSE, EstimatorTrace, FlightTraces, finding
from estimators.types import Status

BUDGET = 2_600_000
"""Bytes that the packed series may take in the page; what is beyond halves the rate of the errors."""

_POINTS = 5_000_000
"""Points of a grid over a flight: what the rate of the estimates may not exceed, whatever their times say."""

CAMPAIGN = 4
"""Flights of one scenario from which on a page shows bands over the flights instead of each."""


def write(flights: Sequence[FlightTraces], output: Path) -> int:
    """Make the page of some flights; returns its size in bytes.

    Args:
        flights: `CAMPAIGN` or more of the same scenario with the same estimators are shown as bands.
        output: the HTML file, replaced when there.

    Raises:
        InputError: the output cannot be written.
    """
    text = page(flights).encode()
    try:
        output.write_bytes(text)
    except OSError as error:
        raise InputError(f"{output}: cannot be written: {error.strerror or error}") from None
    return len(text)


def page(flights: Sequence[FlightTraces]) -> str:
    """Make the page of flights already gathered."""
    rate = max((_rate(e.t) for f in flights for e in f.estimators.values()), default=COARSE)
    rate = max(COARSE, min([rate, *(_POINTS / (float(f.t[-1] - f.t[0]) + 1.0) for f in flights)]))
    labels = _labels(flights)
    while True:
        packer = _Packer()
        if _is_campaign(flights):
            runs = [_campaign(flights, packer)]
        else:
            runs = [_run(flight, label, packer, rate) for flight, label in zip(flights, labels, strict=True)]
        packed = packer.packed()
        if len(packed) <= BUDGET or rate <= COARSE:
            break
        rate = max(COARSE, 0.5 * rate)
    data = {
        "title": ", ".join(dict.fromkeys(f.metadata.get("flight", {}).get("scenario", f.label) for f in flights)),
        "phases": PHASES,
        "status": [s.name.lower() for s in Status],
        "colors": [colors.pair(i) for i in range(max(10, sum(len(run["estimators"]) for run in runs)))],
        "runs": runs,
    }
    return _assemble(json.dumps(data, separators=(",", ":"), allow_nan=False), packed)


def _assemble(data: str, packed: str) -> str:
    """Fill the template."""
    folder = resources.files("ahrs_sim.review") / "page"
    parts = {mark: (folder / name).read_text(encoding="utf-8") for mark, name in _PARTS.items()}
    template = (folder / "template.html").read_text(encoding="utf-8")
    return one_file.filled(template, {**parts, "DATA": one_file.json_in_script(data), "SERIES": packed})


_PARTS = {
    "STYLE": "report.css",
    "UPLOT_STYLE": "uplot.css",
    "UPLOT_LICENSE": "uplot-LICENSE.txt",
    "UPLOT": "uplot.js",
    "PROGRAM": "report.js",
}


def _labels(flights: Sequence[FlightTraces]) -> list[str]:
    """Name the logs, numbered where two names are the same."""
    names = [f.label for f in flights]
    return [f"{n} ({names[:i].count(n) + 1})" if names.count(n) > 1 else n for i, n in enumerate(names)]


def _is_campaign(flights: Sequence[FlightTraces]) -> bool:
    kinds = {(f.metadata.get("flight", {}).get("scenario"), tuple(f.estimators)) for f in flights}
    return len(flights) >= CAMPAIGN and len(kinds) == 1


def _rate(t: np.ndarray) -> float:
    return 1.0 / float(np.median(np.diff(t))) if len(t) > 2 else COARSE


# ----------------------------------------------------------------------------------------------- packing


_DRAWN = (Measure.ROLL, Measure.PITCH, Measure.HEADING, Measure.TILT)
"""Errors that the page draws, in the order of its program."""


class _Packer:
    """Collects series on even grids and packs them; a series is referred to by where it begins."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.at = 0

    def add(self, values: np.ndarray, t0: float, dt: float, step: float) -> dict[str, Any] | None:
        """Pack `values` (n,) at t0, t0 + dt ...; None when there is not one finite number.

        Args:
            step: of the quantisation, in the unit of the values.
        """
        known = np.isfinite(values)
        if not known.any():
            return None
        edges = np.flatnonzero(np.diff(np.r_[False, ~known, False]))
        last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
        whole = np.rint(values[np.where(last < 0, int(np.argmax(known)), last)] / step).astype(np.int64)
        whole = np.clip(whole, -(2**29), 2**29)
        first = np.diff(whole, prepend=0)
        second = np.diff(first, prepend=0)
        order = 2 if np.abs(second).sum() < np.abs(first).sum() else 1
        coded = first if order == 1 else second
        zigzag = ((coded << 1) ^ (coded >> 63)).astype("<u4")
        planes = max(1, (int(zigzag.max()).bit_length() + 7) // 8)
        self.parts.append(zigzag.view(np.uint8).reshape(-1, 4)[:, :planes].T.tobytes())
        series = {
            "at": self.at,
            "n": len(values),
            "t0": round(t0, 6),
            "dt": round(dt, 9),
            "step": step,
            "order": order,
            "planes": planes,
            "gaps": edges.tolist(),
        }
        self.at += planes * len(values)
        return series

    def packed(self) -> str:
        """Pack all series: deflated, in base64."""
        squeeze = zlib.compressobj(6, zlib.DEFLATED, 15, 9, zlib.Z_FILTERED)
        data = squeeze.compress(b"".join(self.parts)) + squeeze.flush()
        return base64.b64encode(data).decode("ascii")


def _gridded(t: np.ndarray, values: np.ndarray, t0: float, dt: float, n: int) -> np.ndarray:
    """Put values (n,) on an even grid: of several in a cell the one furthest from zero, NaN in empty cells.

    A single empty cell, which jitter makes, takes its predecessor.
    """
    cell = np.rint((t - t0) / dt).astype(np.int64)
    inside = (cell >= 0) & (cell < n)
    cell, values = cell[inside], values[inside].astype(float)
    out = np.full(n, np.nan)
    if not len(cell):
        return out
    starts = np.flatnonzero(np.diff(cell, prepend=-1))
    if len(starts) == len(cell):
        out[cell] = values
    else:
        low, high = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
        out[cell[starts]] = np.where(np.abs(low) > np.abs(high), low, high)
    filled = np.zeros(n, bool)
    filled[cell] = True
    lone = np.flatnonzero(~filled[1:] & filled[:-1]) + 1
    out[lone] = out[lone - 1]
    return out


def _fine_step(values: np.ndarray) -> float:
    """Quantisation (deg) of a series: a thousandth of its size, but not finer than a sensible 0.1 mdeg."""
    known = values[np.isfinite(values)]
    size = math.sqrt(float(np.mean(known**2))) if len(known) else 1.0
    return float(f"{min(0.01, max(1e-4, size / 1000)):.1g}")


def _relative_step(values: np.ndarray, parts: float = 4000.0) -> float:
    """Quantisation of a series of any unit: its range in `parts`."""
    known = values[np.isfinite(values)]
    span = float(np.percentile(np.abs(known), 99.5)) if len(known) else 0.0
    return float(f"{max(span, 1e-12) / parts:.1g}")


class _Clock:
    """The grids of one flight."""

    def __init__(self, t0: float, end: float, packer: _Packer) -> None:
        self.t0, self.end, self.packer = t0, end, packer

    def put(self, t: np.ndarray, values: np.ndarray, dt: float, step: float | None = None) -> dict[str, Any] | None:
        """Pack a series on the grid of `dt`."""
        n = int((self.end - self.t0) / dt) + 1
        step = _relative_step(values) if step is None else step
        return self.packer.add(_gridded(t, values, self.t0, dt, n), self.t0, dt, step)

    def columns(self, t: np.ndarray, values: np.ndarray, dt: float, step: float | None = None) -> list[Any] | None:
        """Pack the columns (n, k) of a series; None when all are empty."""
        series = [self.put(t, column, dt, step) for column in values.T]
        return series if any(series) else None


# ----------------------------------------------------------------------------------------------- one flight


def _run(flight: FlightTraces, label: str, packer: _Packer, rate: float) -> dict[str, Any]:
    """Collect the page's data of a flight."""
    clock = _Clock(float(flight.t[0]), float(flight.t[-1]), packer)
    return {
        "kind": "flight",
        "label": label,
        "reference": flight.reference,
        "from": clock.t0,
        "to": clock.end,
        "truth": _truth(flight, clock, 1 / rate),
        "phase": _stretches(flight.truth_t, flight.phase),
        "events": [{"t": e.t, "level": e.level, "name": e.name, "text": e.text} for e in flight.events],
        "suites": {name: _suite(flight, name, clock) for name in flight.suites},
        "estimators": [_estimator(flight, e, clock, 1 / rate) for e in flight.estimators.values()],
        "provenance": flight.metadata,
        "attachments": flight.attachments,
    }


def _truth(flight: FlightTraces, clock: _Clock, dt: float) -> dict[str, Any]:
    n = int((clock.end - clock.t0) / dt) + 1
    at = np.minimum(clock.t0 + dt * np.arange(n), clock.end)
    angles = np.degrees(attitude.euler(attitude.interpolate(flight.t, flight.q_nb, at)))
    known = np.isfinite(angles[:, 0])
    for k in (0, 2):
        angles[known, k] = np.unwrap(angles[known, k], period=360.0)
    north, east, down = flight.position.T
    return {
        "attitude": [clock.packer.add(column, clock.t0, dt, 0.01) for column in angles.T],
        "north": clock.put(flight.truth_t, north, 0.2, 0.1),
        "east": clock.put(flight.truth_t, east, 0.2, 0.1),
        "height": clock.put(flight.truth_t, -down, 0.2, 0.1),
        "speed": clock.put(flight.truth_t, flight.speed, 0.2, 0.01),
    }


def _stretches(t: np.ndarray, values: np.ndarray) -> list[list[float]]:
    """Find runs of equal values: [start, end, value]."""
    if not len(t):
        return []
    starts = np.flatnonzero(np.r_[True, np.diff(values) != 0])
    ends = np.r_[starts[1:], len(t) - 1]
    return [[round(float(t[a]), 3), round(float(t[b]), 3), int(values[a])] for a, b in zip(starts, ends, strict=True)]


def _suite(flight: FlightTraces, name: str, clock: _Clock) -> dict[str, Any]:
    suite = flight.suites[name]
    every = max(1, len(suite.fix) // 1500)
    return {
        "gyro_bias": clock.columns(suite.t, np.degrees(suite.gyro_bias), 1.0),
        "accel_bias": clock.columns(suite.t, suite.accel_bias, 1.0),
        "satellites": _stretches(suite.satellites_t, suite.satellites),
        "fix": np.round(suite.fix[::every], 1).tolist(),
    }


def _estimator(flight: FlightTraces, e: EstimatorTrace, clock: _Clock, dt: float) -> dict[str, Any]:
    """Collect the page's data of an estimator: angles in deg, rates in deg/s."""
    error = np.degrees(e.error[:, _DRAWN].astype(float))
    slow, ct = 1.0, e.coarse_t
    rate = min(COARSE, _rate(ct))
    with np.errstate(divide="ignore", invalid="ignore"):
        nees = np.log10(np.maximum(e.nees, 1e-6))
        nis = np.log10(np.maximum(e.nis / e.nis_freedom, 1e-6))
        low, high = (np.log10(b / e.nis_freedom) for b in consistency.chi_square_bounds(e.nis_freedom))
    seconds = np.arange(len(e.nis)) + 0.0
    worst = e.worst(flight)
    return {
        "name": e.name,
        "suite": e.suite,
        "error": [clock.put(e.t, column, dt, _fine_step(column)) for column in error.T],
        "sigma": clock.columns(ct, np.degrees(e.sigma), 2 / rate),
        "gyro_bias": clock.columns(ct, np.degrees(e.gyro_bias), slow),
        "gyro_bias_sigma": clock.columns(ct, np.degrees(e.gyro_bias_sigma), slow),
        "accel_bias": clock.columns(ct, e.accel_bias, slow),
        "accel_bias_sigma": clock.columns(ct, e.accel_bias_sigma, slow),
        "adaptation": clock.columns(ct, e.adaptation.astype(float), 0.5),
        "status": _stretches(ct, e.status),
        "nees": clock.put(ct, nees, slow / 2, 0.01),
        "nis": clock.put(seconds, nis, slow, 0.01),
        "nis_low": clock.put(seconds, low, slow, 0.01),
        "nis_high": clock.put(seconds, high, slow, 0.01),
        "innovation_names": list(e.innovations),
        "innovation_low": clock.columns(seconds, e.innovation_low, slow, 0.02),
        "innovation_high": clock.columns(seconds, e.innovation_high, slow, 0.02),
        "north": clock.put(ct, e.position[:, 0], slow / 2, 0.1),
        "east": clock.put(ct, e.position[:, 1], slow / 2, 0.1),
        "summary": _summary(flight, e),
        "worst": None if worst is None else {"from": worst.start, "to": worst.end, "axis": worst.axis},
        "finding": finding(flight, e),
    }


def _summary(flight: FlightTraces, e: EstimatorTrace) -> dict[str, Any]:
    """Return the row of an estimator in the table: errors over all and by phase, and its consistency."""
    errors = accuracy.summary([e.error], phases.at(flight.truth_t, flight.phase, e.t))
    consistent = consistency.summary(e.nees, e.nis, e.nis_freedom, e.inside)
    return _rounded({**errors, **{key: consistent[key] for key in ("nees", "nis", "inside")}})


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Round numbers to the digits that a plot can show."""
    return {k: _rounded(v) if isinstance(v, dict) else v if v is None else _number(v) for k, v in values.items()}


def _number(value: float) -> float | None:
    """JSON has no NaN, and nobody needs sixteen digits."""
    return float(f"{value:.5g}") if math.isfinite(value) else None


# ----------------------------------------------------------------------------------------------- a campaign


def _campaign(flights: Sequence[FlightTraces], packer: _Packer) -> dict[str, Any]:
    """Many flights of a scenario as one: of every error the median and the middle 95 % over the flights."""
    first = flights[0]
    end = min(float(f.t[-1]) for f in flights)
    clock = _Clock(max(float(f.t[0]) for f in flights), end, packer)
    dt = 1 / COARSE
    run = _run(first, f"{len(flights)} flights", _Packer(), COARSE)
    return run | {
        "kind": "campaign",
        "from": clock.t0,
        "to": clock.end,
        "truth": _truth(first, clock, dt),
        "suites": {},
        "estimators": [_spread(flights, name, clock, dt) for name in first.estimators],
        "flights": [
            {
                "label": f.label,
                "seed": f.metadata.get("flight", {}).get("seed", ""),
                "estimators": {name: _summary(f, e) for name, e in f.estimators.items()},
            }
            for f in flights
        ],
    }


def _spread(flights: Sequence[FlightTraces], name: str, clock: _Clock, dt: float) -> dict[str, Any]:
    n = int((clock.end - clock.t0) / dt) + 1
    traces = [f.estimators[name] for f in flights]
    error: list[Any] = []
    low: list[Any] = []
    high: list[Any] = []
    sigma: list[Any] = []
    for axis in _DRAWN:
        grid = np.array([_gridded(e.t, np.degrees(e.error[:, axis]), clock.t0, dt, n) for e in traces])
        # Angles have no order: each is taken as its distance from the mean direction of all at that time.
        with np.errstate(invalid="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # times without any
            middle = np.degrees(np.angle(np.nanmean(np.exp(1j * np.radians(grid)), axis=0)))
        known = np.isfinite(middle)
        middle[known] = np.unwrap(middle[known], period=360.0)
        spread = middle + _percentiles(np.degrees(attitude.wrap(np.radians(grid - middle))))
        for kept, values in zip((low, error, high), spread, strict=True):
            kept.append(clock.packer.add(values, clock.t0, dt, _fine_step(values)))
        if axis == Measure.TILT:
            continue  # no estimator claims one
        sigmas = np.array([_gridded(e.coarse_t, np.degrees(e.sigma[:, axis]), clock.t0, dt, n) for e in traces])
        median = _percentiles(sigmas)[1]
        sigma.append(clock.packer.add(median, clock.t0, dt, _relative_step(median)))
    nees = np.array([_gridded(e.coarse_t, e.nees, clock.t0, 0.5, int(2 * (clock.end - clock.t0)) + 1) for e in traces])
    known = np.isfinite(nees)
    count = known.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.log10(np.where(known, nees, 0.0).sum(axis=0) / count)
        bounds = [np.log10(b) for b in consistency.mean_bounds(3, count)]
    summaries = [_summary(f, e) for f, e in zip(flights, traces, strict=True)]
    worst = max(range(len(flights)), key=lambda i: summaries[i]["tilt_rmse_deg"] or 0.0)
    window = traces[worst].worst(flights[worst])
    return {
        "name": name,
        "suite": traces[0].suite,
        "error": error,
        "low": low,
        "high": high,
        "sigma": sigma if any(sigma) else None,
        "nees": clock.packer.add(mean, clock.t0, 0.5, 0.01),
        "nees_low": clock.packer.add(bounds[0], clock.t0, 0.5, 0.01),
        "nees_high": clock.packer.add(bounds[1], clock.t0, 0.5, 0.01),
        "summary": _median_summary(summaries),
        "worst": None if window is None else {"from": window.start, "to": window.end, "axis": window.axis},
        "finding": f"worst flight {flights[worst].label}: {finding(flights[worst], traces[worst])}",
    }


def _percentiles(values: np.ndarray) -> np.ndarray:
    """2.5, 50 and 97.5 % (3, n) over the rows of (k, n); NaN where fewer than half of the rows are known."""
    ordered = np.sort(values, axis=0)  # NaN last
    count = np.isfinite(values).sum(axis=0)
    rows = np.rint(np.outer([0.025, 0.5, 0.975], np.maximum(count - 1, 0))).astype(int)
    result = np.take_along_axis(ordered, rows, axis=0)
    result[:, count < 0.5 * len(values)] = np.nan
    return np.asarray(result)


def _median_summary(summaries: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the median over the flights of every number."""
    result: dict[str, Any] = {}
    for key, value in summaries[0].items():
        if isinstance(value, dict):
            shared = [name for name in value if all(name in s[key] for s in summaries)]
            result[key] = {name: _median_summary([s[key][name] for s in summaries]) for name in shared}
        else:
            numbers = [s[key] for s in summaries if s[key] is not None]
            result[key] = _number(float(np.median(numbers))) if numbers else None
    return result
