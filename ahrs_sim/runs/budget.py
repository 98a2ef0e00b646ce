"""`ahrs-sim budget`: what each error of the sensors costs one estimator, on its own and among all others.

A flight is flown once a seed; what happened is then measured again and again, with every error of the grade, with none,
with one alone and with all but one. Each error draws from its own stream, so that the others stay as they are. The
estimator gets the same data sheet every time: its gains do not change, only what it is fed (an error budget in the
sense of Maybeck 1979, section 6.8). A filter tuned to a better sensor would gain somewhat more.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import scenario as scenarios
from ahrs_sim.chain import Chain, site
from ahrs_sim.errors import FlightError, InputError, nearest
from ahrs_sim.evaluation.evaluator import Comparison, Evaluator
from ahrs_sim.evaluation.metrics import Measure
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.runs import pool as runs
from ahrs_sim.scenario import Component, Gate, Scenario, create_estimator
from ahrs_sim.sensors import Suite, make_suite
from estimators.types import SensorInfo, Site

BLOCK_S = 5.0
"""s of flight that go through all variants at once."""

MOUNTING = "mounting_error_deg"
"""The one error that a suite states outside of its grade."""

_TRIAD = {
    "noise": ("noise_density",),
    "turn-on bias": ("turn_on_bias",),
    "in-run bias": ("bias_floor", "rate_random_walk"),
    "temperature": ("temperature_drift",),
    "scale": ("scale",),
    "misalignment": ("misalignment", "cross_axis"),
    "non-linearity": ("non_linearity",),
    "resolution": ("quantum",),
    "delay": ("delay",),
}
_SHAKEN = ("vibration_line", "vibration_band", "vibration_rectification")

TERMS: dict[str, Mapping[str, tuple[str, ...]]] = {
    **{f"gyro {term}": {"gyro": fields} for term, fields in _TRIAD.items()},
    "gyro g-sensitivity": {"gyro": ("g_sensitivity",)},
    **{f"accelerometer {term}": {"accelerometer": fields} for term, fields in _TRIAD.items()},
    "vibration": {"gyro": _SHAKEN, "accelerometer": _SHAKEN},
    "sampling jitter": {"imu": ("jitter", "stamp_jitter")},
    **{f"magnetometer {term}": {"magnetometer": f} for term, f in _TRIAD.items() if term != "turn-on bias"},
    "hard iron": {"magnetometer": ("turn_on_bias",)},
    "soft iron": {"magnetometer": ("soft_iron",)},
    "magnetometer turned": {"magnetometer": ("turned",)},
    "motor current's field": {"magnetometer": ("motor_field",)},
    "declination and dip": {"magnetometer": ("model_error",)},
    "GNSS position": {"gnss": ("position_noise", "position_wander", "start_up")},
    "GNSS velocity": {"gnss": ("velocity_noise", "velocity_wander")},
    "GNSS latency": {"gnss": ("latency", "undeclared", "velocity_lag")},
    "dual antenna noise": {"heading": ("phase_noise", "phase_wander")},
    "dual antenna misalignment": {"heading": ("misalignment",)},
    "dual antenna wrong fixes": {"heading": ("wrong_fixes",)},
    "dual antenna latency": {"heading": ("latency",)},
    "airspeed noise": {"air_data": ("diff_noise", "diff_wander", "diff_quantum")},
    "airspeed bias": {"air_data": ("diff_bias",)},
    "airspeed scale": {"air_data": ("diff_scale", "position_error")},
    "airspeed lag": {"air_data": ("lag", "latency")},
    "static pressure": {"air_data": ("static_noise", "static_wander", "static_quantum", "static_bias", "day_pressure")},
    "air temperature": {"air_data": ("temperature_bias",)},
    "vanes": {"air_data": ("vane_noise", "vane_bias", "vane_lag")},
    "mounting error": {},
}
"""Errors that are switched together, by the figures (section and field of a grade) they come from."""

ALL, NONE = "all errors", "no errors"


@dataclass(frozen=True)
class Line:
    """One row of the budget, RMS of tilt and heading in rad; `without` and `share` are NaN of all and no errors."""

    name: str
    figures: str  # as the grade states them
    alone: tuple[float, float]
    without: tuple[float, float] = (math.nan, math.nan)
    share: float = math.nan  # of the mean square of tilt and heading errors, gone without this one


@dataclass(frozen=True)
class Budget:
    """The error budget of an estimator."""

    scenario: str
    estimator: str
    method: str
    suite: str
    grade: str
    seeds: tuple[int, ...]
    span: tuple[float, float]  # s
    total: Line
    floor: Line  # what is left without any error: sampling and the method itself
    lines: tuple[Line, ...]  # what to buy or calibrate first comes first

    def as_json(self) -> dict[str, Any]:
        """Convert the budget to degrees and types that JSON knows."""

        def row(line: Line) -> dict[str, Any]:
            degrees = {"alone": line.alone, "without": line.without}
            values = {f"{k}_{m}_rmse_deg": _number(v) for k, p in degrees.items() for m, v in _named(p)}
            return {"name": line.name, "figures": line.figures, "share": _number(line.share, 1.0), **values}

        named = {"all": self.total, "none": self.floor}
        ends = {f"{k}_{m}_rmse_deg": _number(v) for k, line in named.items() for m, v in _named(line.alone)}
        known = {k: getattr(self, k) for k in ("scenario", "estimator", "method", "suite", "grade")}
        return {
            **known, "seeds": list(self.seeds), "from_s": self.span[0], "to_s": self.span[1], **ends,
            "terms": [row(line) for line in self.lines],
        }  # fmt: skip

    def text(self) -> str:
        """Format a table: what to buy or calibrate first on top, what has no effect in one line at the end."""
        count = f"{len(self.seeds)} seeds" if len(self.seeds) > 1 else f"seed {self.seeds[0]}"
        head = (
            f"error budget of {self.estimator} ({self.method} on {self.suite}, {self.grade}), {self.scenario}, "
            f"{count}, {self.span[0]:.0f} to {self.span[1]:.0f} s; RMS, deg"
        )
        rows = [line for line in self.lines if self._matters(line)]
        width = max(len(line.name) for line in (*rows, self.total)) + 2
        out = [head, "", f"{'':{width}s}{'on its own':>18s}{'all but this':>18s}{'share':>8s}"]
        out.append(f"{'':{width}s}" + "     tilt  heading" * 2)
        out.append(f"{ALL:{width}s}{'':18s}{_pair(self.total.alone)}")
        for line in rows:
            share = f"{100 * line.share:6.0f} %"
            figures = line.figures if len(line.figures) < 60 else f"{line.figures[:57]}..."
            out.append(f"{line.name:{width}s}{_pair(line.alone)}{_pair(line.without)}{share}   {figures}")
        out.append(f"{NONE:{width}s}{_pair(self.floor.alone)}")
        if silent := [line.name for line in self.lines if line not in rows]:
            out += ["", f"without effect: {', '.join(silent)}"]
        return "\n".join(out)

    def _matters(self, line: Line) -> bool:
        changes = np.array(
            [_pair(line.alone) != _pair(self.floor.alone), _pair(line.without) != _pair(self.total.alone)]
        )
        return bool(changes.any())

    def plot(self, path: Path) -> None:
        """Draw the table as bars.

        Raises:
            InputError: the file cannot be written.
        """
        from matplotlib.figure import Figure

        rows = [line for line in self.lines if self._matters(line)][::-1]
        figure = Figure((10, 1.5 + 0.32 * len(rows)), layout="constrained")
        place = np.arange(len(rows))
        for axes, m, measure in zip(figure.subplots(1, 2, sharey=True), (0, 1), ("tilt", "heading"), strict=True):
            for shift, key, label in ((0.2, "alone", "on its own"), (-0.2, "without", "all but this")):
                axes.barh(place + shift, [math.degrees(getattr(line, key)[m]) for line in rows], 0.38, label=label)
            for line, style in ((self.total, "-"), (self.floor, ":")):
                axes.axvline(math.degrees(line.alone[m]), color="black", linestyle=style, lw=0.8, label=line.name)
            axes.set(xlabel=f"{measure}, RMS, deg", yticks=place, yticklabels=[line.name for line in rows])
            axes.grid(True, axis="x", alpha=0.3)
        figure.axes[1].legend(fontsize="small")
        figure.suptitle(f"{self.estimator}, {self.grade}, {self.scenario}")
        try:
            figure.savefig(path, dpi=110)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be written ({error})") from None


def make(
    scenario: Scenario,
    estimator: str,
    *,
    suite: str | None = None,
    seeds: int = 1,
    start: float | None = None,
    end: float | None = None,
    workers: int | None = None,
    progress: Callable[[float, float | None], None] = lambda t, end: None,
) -> Budget:
    """Make the error budget of an estimator over a scenario.

    Args:
        scenario: what is flown, on the true attitude whatever its `[pilot]` says.
        estimator: one of the scenario's, METHOD@SUITE, or METHOD with `suite`.
        suite: the suite to take it on.
        seeds: flights, with the scenario's seed and those that follow.
        start, end: only errors in this span, s of flight.
        workers: processes when there are several seeds; default one per processor.
        progress: called with the time reached and the end (s), or with several seeds flights done and their number.

    Raises:
        InputError: no such estimator or suite, or something in the scenario is wrong.
        FlightError: a flight did not reach its end.
    """
    scenario = _alone(scenario, estimator, suite)
    span = -math.inf if start is None else start, math.inf if end is None else end
    numbers = tuple(range(scenario.seed, scenario.seed + seeds))
    if seeds == 1:
        found = [_of_seed(scenario, span, progress)]
    else:
        with runs.local_pool(workers) as pool:
            jobs = [pool.executor.submit(_of_seed, _seeded(scenario, n), span) for n in numbers]
            found = []
            for job in jobs:
                found.append(job.result())
                progress(len(found), seeds)
    return _budget(scenario, numbers, found)


def _alone(scenario: Scenario, name: str, suite: str | None) -> Scenario:
    """Make the scenario with one estimator and its suite, flown on the truth."""
    tables = {e.name: dict(e.settings) for e in scenario.estimators}
    if name not in tables and "@" not in name:
        if suite is None:
            raise InputError(
                f"budget: --estimator {name}: no such estimator in {scenario.name}{nearest(name, tables)}; "
                "or give METHOD@SUITE, or METHOD with --suite"
            )
        name = f"{name}@{suite}"
    data = {**scenario.data, "pilot": {}}
    scenario = scenarios.parse(data, scenario.where, scenario.name, estimators=[name], gate=Gate(scenario.code))
    (chosen,) = scenario.estimators
    if suite is not None and chosen.settings["suite"] != suite:
        known = [s.name for s in scenario.suites]
        if suite not in known:
            raise InputError(f"budget: --suite {suite}: no such suite in {scenario.name}{nearest(suite, known)}")
        chosen = dataclasses.replace(chosen, settings={**chosen.settings, "suite": suite})
    (carried,) = (s for s in scenario.suites if s.name == chosen.settings["suite"])
    return dataclasses.replace(scenario, estimators=(chosen,), suites=(carried,))


def _seeded(scenario: Scenario, seed: int) -> Scenario:
    return dataclasses.replace(scenario, seed=seed, data={**scenario.data, "seed": seed})


@dataclass
class _Squares:
    """Sums of squared tilt and heading errors and their numbers."""

    total: np.ndarray  # (2,) rad2
    count: np.ndarray  # (2,)
    span: tuple[float, float]  # s, first and last of them


class _Variant:
    """A suite with some of its errors, and the estimator on it."""

    def __init__(
        self, suite: Suite, component: Component, place: Site, sheet: SensorInfo, span: tuple[float, float]
    ) -> None:
        self._sheet, self._span = sheet, span
        delays = ("gyro_delay", "accel_delay", "mag_delay")  # declared, so compensated as they are
        info = dataclasses.replace(sheet, **{name: getattr(suite.info, name) for name in delays})
        self._chain = Chain(suite, {component.name: create_estimator(component, place, info)})
        self._evaluator = Evaluator(self._sum)
        self.squares = _Squares(np.zeros(2), np.zeros(2), (math.inf, -math.inf))

    def fly(self, truth: Truth) -> None:
        """Measure a block of the flight, estimate, and add the errors up."""
        self._evaluator.add_reference(truth.t, truth.q_nb)
        samples = self._chain.assemble(self._chain.sense(truth))
        if not len(samples):
            return
        sigma = np.where(np.isfinite(samples.heading_sigma), self._sheet.heading, np.nan)
        for name, estimates in self._chain.estimate(dataclasses.replace(samples, heading_sigma=sigma)):
            self._evaluator.add(name, estimates)

    def _sum(self, _: str, pair: Comparison) -> None:
        t = pair.estimates.t
        within = (t >= self._span[0]) & (t <= self._span[1])
        errors = pair.errors()[within][:, [Measure.TILT, Measure.HEADING]]
        known = np.isfinite(errors)
        s = self.squares
        s.total += np.sum(np.where(known, errors, 0.0) ** 2, axis=0)
        s.count += known.sum(axis=0)
        if known.any():
            t = t[within][known.any(axis=1)]
            s.span = min(s.span[0], float(t[0])), max(s.span[1], float(t[-1]))


def _of_seed(
    scenario: Scenario,
    span: tuple[float, float],
    progress: Callable[[float, float | None], None] = lambda t, end: None,
) -> dict[tuple[str, str], _Squares]:
    """Fly once, measure in all ways: squared errors by (`ALL` or `NONE`, the error that is added or missing)."""
    flight = open_flight(scenario)
    place = site(flight.start_lla, scenario.epoch)
    (component,), (carried,) = scenario.estimators, scenario.suites

    def fit(off: list[str]) -> Suite:
        return make_suite(
            _switched_off(carried, off, grade), seed=scenario.seed, dt=flight.dt, epoch=scenario.epoch,
            start_lla=np.array(place.lla), faults=scenario.faults,
        )  # fmt: skip

    grade: Any = None
    whole = fit([])
    grade, sheet = whole.grade, whole.info
    names = [name for name in TERMS if _stated(carried, whole, name)]
    variants = {
        (ALL, ""): _Variant(whole, component, place, sheet, span),
        (NONE, ""): _Variant(fit(names), component, place, sheet, span),
    }
    for name in names:
        variants[NONE, name] = _Variant(fit([n for n in names if n != name]), component, place, sheet, span)
        variants[ALL, name] = _Variant(fit([name]), component, place, sheet, span)
    rows = max(1, round(BLOCK_S * scenario.rate))
    while len(truth := flight.fly(rows)):
        for variant in variants.values():
            variant.fly(truth)
        progress(float(truth.t[-1]), scenario.duration or flight.expected_duration)
    if flight.error:
        raise FlightError(f"{scenario.where}: seed {scenario.seed}: {flight.error}")
    return {key: variant.squares for key, variant in variants.items()}


def _stated(carried: Component, suite: Suite, name: str) -> str:
    """List the figures of an error as the grade states them; empty when the suite has none, or all are zero."""
    if name == "mounting error":
        angles = carried.settings.get(MOUNTING, [0.0])
        return f"{MOUNTING} = {angles}" if any(angles) else ""
    found = []
    for section, fields in TERMS[name].items():
        instrument = "imu" if section in ("gyro", "accelerometer") else section
        for field, entry in suite.grade.layer.get(section, {}).items():
            if field in fields and np.any(entry.value) and instrument in suite.has:
                found.append(f"{entry.key} {entry.text}")
    return ", ".join(found)


def _switched_off(carried: Component, off: list[str], grade: Any) -> Component:
    """Make the suite's table with zeros for the figures of these errors."""
    settings = {k: dict(v) if isinstance(v, dict) else v for k, v in carried.settings.items()}
    for name in off:
        if name == "mounting error":
            settings[MOUNTING] = [0.0, 0.0, 0.0]
        for section, fields in TERMS[name].items():
            for field in fields:
                if (entry := grade.layer.get(section, {}).get(field)) is not None:
                    settings.setdefault(section, {})[entry.key] = 0.0  # the key it is stated under: takes its place
    return dataclasses.replace(carried, settings=settings)


def _budget(scenario: Scenario, seeds: tuple[int, ...], found: list[dict[tuple[str, str], _Squares]]) -> Budget:
    def rms(key: tuple[str, str]) -> tuple[float, float]:
        total, count = (np.sum([getattr(f[key], what) for f in found], axis=0) for what in ("total", "count"))
        with np.errstate(invalid="ignore"):
            tilt, heading = np.sqrt(total / count).tolist()
        return tilt, heading

    (component,), (carried,) = scenario.estimators, scenario.suites
    suite = make_suite(carried, seed=0, dt=1.0 / scenario.rate, epoch=scenario.epoch, start_lla=np.zeros(3))
    total, floor = Line(ALL, "", rms((ALL, ""))), Line(NONE, "", rms((NONE, "")))
    if not math.isfinite(total.alone[0]):
        raise InputError(f"budget: {component.name} has no attitude in this span; give another --from or --to")
    whole = float(np.nansum(np.square(total.alone)))
    lines = []
    for kind, name in found[0]:
        if kind == NONE and name:
            alone, without = rms((NONE, name)), rms((ALL, name))
            share = 1.0 - float(np.nansum(np.square(without))) / whole
            lines.append(Line(name, _stated(carried, suite, name), alone, without, share))
    spans = [f[ALL, ""].span for f in found]
    return Budget(
        scenario=scenario.name,
        estimator=component.name,
        method=str(component.settings["method"]),
        suite=carried.name,
        grade=suite.grade.name,
        seeds=seeds,
        span=(min(s[0] for s in spans), max(s[1] for s in spans)),
        total=total,
        floor=floor,
        lines=tuple(sorted(lines, key=lambda line: -line.share)),
    )


def _named(pair: tuple[float, float]) -> Iterator[tuple[str, float]]:
    return zip(("tilt", "heading"), pair, strict=True)


def _number(value: float, factor: float = math.degrees(1.0)) -> float | None:
    return value * factor if math.isfinite(value) else None


def _pair(pair: tuple[float, float]) -> str:
    """Two columns of degrees."""
    return "".join(f"{math.degrees(v):9.3f}" if math.isfinite(v) else f"{'-':>9s}" for v in pair)
