"""Paper 000, cubature Kalman filter for aircraft attitude: EKF, CKF and CDKF on a low-cost unit in a model aircraft."""

import math
import time
from typing import Any

import numpy as np

from ahrs_sim import metrics
from ahrs_sim import scenario as scenarios
from ahrs_sim.papers import Claim, Reproduction, Verdict, holds
from ahrs_sim.papers.bench import Flown, Measured, fly, measure, rms, thinned, time_first, time_until, turned
from ahrs_sim.papers.fuzzy import words

RUNS = 4
SETTLED = 80.0
"""s: from here on errors count, in flight."""

_FILTERS = ("ekf", "ckf", "cdkf")
_AIDED = {"aiding": "airspeed"}

_STILL = {"motion": {"kind": "constant"}, "duration_s": 90.0, "rate_hz": 200.0}
_CHR, _SBG = {"grade": "chr_6dm"}, {"grade": "sbg_ig500"}

_EQUAL = (
    "While they track, the covariance is small and all three compute the same estimate to a few hundredths of a "
    "degree; the order on one flight is that of its noise. What makes the error is the model: an accelerometer in a "
    "turn is no plumb line, and each filter believes it with the R of the ground."
)
_REFERENCE = (
    "The reference of the paper is a filter of the same model on better sensors: it makes the same error in turns. "
    "What the filters differ by from it is therefore no measure of their error."
)
_SPEED = (
    "Compiled, with sigma points for those components only that the functions read, and analytic slopes: the ratio "
    "is that of the arithmetic, not of MATLAB's calls. CKF and CDKF cost the same: both evaluate the "
    "centre, from which differences are taken."
)
_ERRATIC = (
    "P0 = 1e4 I on a unit quaternion says nothing about the attitude, and the first update is far outside of what any "
    "of the approximations stands: where the state lands is decided by rounding and noise of the first samples. From "
    "there the rate and bias states, as uncertain, take part of the error. Seeds differ; no filter is safe."
)
_FAR = (
    "Standing, R and Q from the ground. What P says decides more than the filter: rate and bias states take part of "
    "the first large innovation, and give it back as slowly as the bias may walk. With P = I on the quaternion the "
    "sigma points feel the whole circle and come round sooner than the EKF's slope."
)


def flight(duration: float) -> Flown:
    """The turns, shortened: standing, take-off, climb, bank of 30 deg both ways."""
    return fly(scenarios.load("turns", duration=duration).data, "turns")


def tracked(unit: Measured, **settings: Any) -> dict[str, np.ndarray]:
    """Errors (n, 3) of roll, pitch, heading in deg from `SETTLED` on, by filter."""
    found = {}
    for name in _FILTERS:
        estimates = unit.estimate(f"marg-{name}", **settings)
        found[name] = unit.errors(estimates)[estimates.t >= SETTLED, :3]
    return found


def against(unit: Measured, reference: Measured, **settings: Any) -> dict[str, float]:
    """RMS difference (deg, of the whole rotation) from the EKF on the better unit, by filter."""
    best = reference.estimate("marg-ekf", **settings)
    there = np.isfinite(best.q_nb[:, 0])
    found = {}
    for name in _FILTERS:
        estimates = unit.estimate(f"marg-{name}", **settings)
        judged = estimates.t >= SETTLED
        q_ref = metrics.interpolate(best.t[there], best.q_nb[there], estimates.t[judged])
        difference = metrics.attitude_errors(estimates.q_nb[judged], estimates.down_b[judged], q_ref)
        found[name] = rms(np.degrees(difference[:, 4]))
    return found


def seconds(unit: Measured, repeats: int) -> dict[str, float]:
    """CPU time of each filter for the samples, the best of some."""
    best = {}
    for name in _FILTERS:
        estimator = unit.create(f"marg-{name}")
        estimator.process(unit.samples[:4000])  # compiled and aligned
        times = []
        for _ in range(repeats):
            begun = time.process_time()
            estimator.process(unit.samples[4000:])
            times.append(time.process_time() - begun)
            estimator.reset()
            estimator.process(unit.samples[:4000])
        best[name] = min(times)
    return best


def from_far(units: list[Measured], degrees: float, variance: float | None) -> dict[str, tuple[float, float]]:
    """Median time (s) until the heading is within 5 deg, first and for good, standing, from one wrong by so much."""
    found = {}
    for name in _FILTERS:
        times = []
        for unit in units:
            rest, estimator = turned(unit.create(f"marg-{name}"), unit.samples, degrees, variance)
            estimates = estimator.process(rest)
            error = unit.errors(estimates)[:, 2]
            times.append([time_first(estimates.t, error, 5.0), time_until(estimates.t, error, 5.0)])
        first, last = np.median(np.nan_to_num(times, nan=math.inf), axis=0)
        found[name] = (float(first), float(last))
    return found


def from_nothing(units: list[Measured]) -> dict[str, int]:
    """How many of the runs that start as the paper does (P0 = 1e4 I) end within 5 deg, standing."""
    found = {}
    for name in _FILTERS:
        good = 0
        for unit in units:
            estimates = unit.estimate(f"marg-{name}", initialisation="paper", noise="practical")
            last = unit.errors(estimates)[-200:, 4]
            good += bool(np.isfinite(last).all() and rms(last) < 5.0)
        found[name] = good
    return found


def reproduce(quick: bool = False) -> Reproduction:
    """Table 1, the order of the errors, then starts from far and low rates."""
    runs = 1 if quick else RUNS
    flown = flight(220.0 if quick else 420.0)
    seeds = range(1, runs + 1)
    chr_units = [measure(flown, _CHR, seed) for seed in seeds]
    sbg_units = [measure(flown, _SBG, seed) for seed in seeds]
    claims = [*_times(chr_units[0], 2 if quick else 5), *_order(chr_units, sbg_units, runs), *_aided(chr_units, runs)]
    claims += _starts(3 if quick else 2 * runs)
    return Reproduction(
        name="cubature",
        title="Cubature Kalman filter for aircraft attitude, beside EKF and CDKF",
        source="Paper 000: Han, Gan, He, Alazard, aircraft attitude estimation method based on CKF, 2013 (in Chinese)",
        conditions=(
            "A model aircraft at 23 m/s, wind 4 m/s, light turbulence: standing, take-off, climb, turns of 30 deg of "
            "bank; CHR-6dm grade, reference the EKF on SBG IG-500 grade (the paper's) and the truth. 100 Hz. R and Q "
            f"from the ground, aligned start. RMS of {SETTLED:g} s on, deg, over all runs (one flight, other sensors)."
        ),
        claims=claims,
    )


def _times(unit: Measured, repeats: int) -> list[Claim]:
    found = seconds(unit, repeats)
    claims = []
    steps = len(unit.samples) - 4000
    for over, under, paper in (("ckf", "cdkf", 35.85 / 43.20), ("ekf", "ckf", 17.94 / 35.85)):
        ratio = found[over] / found[under]
        verdict = holds(ratio < 0.9)  # nearer to one it is a draw
        text = f"Table 1, CPU time {over.upper()} over {under.upper()}"
        claims.append(Claim(text, paper, ratio, "", verdict, _SPEED, repeats))
    each = words([1e6 * found[name] / steps for name in _FILTERS])
    claims.append(Claim("  a step, EKF, CKF, CDKF", None, each, "us", runs=repeats))
    return claims


def _rows(found: list[dict[str, float]]) -> dict[str, float]:
    return {name: math.sqrt(float(np.mean([f[name] ** 2 for f in found]))) for name in _FILTERS}


def _order(chr_units: list[Measured], sbg_units: list[Measured], runs: int) -> list[Claim]:
    each = [against(c, s) for c, s in zip(chr_units, sbg_units, strict=True)]
    found, claims = _rows(each), []
    text = words([found[name] for name in _FILTERS])
    claims.append(Claim("Fig. 2 to 7, EKF, CKF, CDKF against EKF-SBG", "CKF least", text, "deg", _ordered(found),
                        f"{_EQUAL} {_REFERENCE}", runs))  # fmt: skip
    in_order = sum(f["ckf"] < f["cdkf"] < f["ekf"] for f in each)
    claims.append(Claim("  runs with CKF < CDKF < EKF", "1 of 1", f"{in_order} of {runs}", "", runs=runs))
    errors = [tracked(unit) for unit in chr_units]
    for column, axis in enumerate(("roll", "pitch", "heading")):
        found = _rows([{name: rms(e[name][:, column]) for name in _FILTERS} for e in errors])
        text = words([found[name] for name in _FILTERS])
        claims.append(Claim(f"EKF, CKF, CDKF against the truth: {axis}", "CKF least", text, "deg", _ordered(found),
                            _EQUAL, runs))  # fmt: skip
    reference = [unit.errors(unit.estimate("marg-ekf"))[:, 4] for unit in sbg_units]
    late = [e[-len(errors[0]["ekf"]) :] for e in reference]
    figure = math.sqrt(float(np.mean([rms(e) ** 2 for e in late])))
    claims.append(Claim("EKF-SBG, the paper's reference, against the truth", None, figure, "deg", reason=_REFERENCE,
                        runs=runs))  # fmt: skip
    return claims


def _ordered(found: dict[str, float]) -> Verdict:
    """CKF < CDKF < EKF by more than a hundredth, else it is no order."""
    return holds(found["ckf"] < 0.99 * found["cdkf"] and found["cdkf"] < 0.99 * found["ekf"])


def _aided(units: list[Measured], runs: int) -> list[Claim]:
    claims = []
    few = units[: max(1, runs // 2)]
    for every in (1, 5, 20):
        found = _rows([{n: rms(e[:, 2]) for n, e in tracked(thinned(u, every), **_AIDED).items()} for u in few])
        text = words([found[name] for name in _FILTERS])
        what = f"Airspeed aided, {100 // every} Hz: heading, EKF, CKF, CDKF"
        claims.append(Claim(what, None, text, "deg", reason=_EQUAL, runs=len(few)))
    return claims


def _time(t: float) -> str:
    return "never" if math.isinf(t) else f"{t:.2g}"


def _starts(runs: int) -> list[Claim]:
    flown = fly(_STILL, "still")
    units = [measure(flown, _CHR, seed) for seed in range(1, runs + 1)]
    claims = []
    for degrees in (90.0, 175.0):
        for variance, told in ((None, "heading sigma told"), (1.0, "P = I on q")):
            for every in (1, 5, 20):
                found = from_far([thinned(unit, every) for unit in units], degrees, variance)
                text = " ".join(f"{_time(first)}/{_time(last)}" for first, last in found.values())
                what = f"Off by {degrees:g} deg, {told}, {100 // every} Hz: first/for good within 5, EKF, CKF, CDKF"
                claims.append(Claim(what, None, text, "s", reason=_FAR, runs=runs))
    good = from_nothing(units)
    text = " ".join(f"{good[name]}/{runs}" for name in _FILTERS)
    claims.append(Claim("Start of the paper (P0 = 1e4 I): runs within 5 deg after 90 s, EKF, CKF, CDKF", "all", text,
                        "", holds(all(n == runs for n in good.values())), _ERRATIC, runs))  # fmt: skip
    return claims
