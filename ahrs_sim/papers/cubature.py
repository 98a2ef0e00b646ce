"""Paper 000, cubature Kalman filter for aircraft attitude: EKF, CKF and CDKF on a low-cost unit in a model aircraft."""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from ahrs_sim import attitude
from ahrs_sim import scenario as scenarios
from ahrs_sim.evaluation import metrics
from ahrs_sim.papers import Claim, Outcome, Reproduction, holds
from ahrs_sim.papers.bench import Flown, Measured, fly, measure, rms, thinned, time_first, time_until, turned
from ahrs_sim.papers.fuzzy import words
from estimators.errors import SettingError

RUNS = 4
SETTLED = 80.0
"""s: from here on errors count, in flight."""

_FILTERS = ("ekf", "ckf", "cdkf")
_AIDED = {"aiding": "airspeed"}

_STILL = {"motion": {"kind": "constant"}, "duration_s": 90.0, "rate_hz": 200.0}
_CHR, _SBG = {"grade": "chr_6dm"}, {"grade": "sbg_ig500"}

_EQUAL = (
    "While they track, the covariance is small and all three compute the same estimate, with airspeed within a "
    "hundredth of a degree (rows below); an order there may be, but of that size. What makes the error is the model: "
    "an accelerometer in a turn is no plumb line, and each filter trusts it with the R of the ground."
)
_REFERENCE = (
    "The reference of the paper is a filter of the same model on better sensors: it makes the same error in turns. "
    "What the filters differ by from it is therefore no measure of their error."
)
_ENGINE = (
    'The paper takes R "in the ground start-up state" (地面启动状态), by its words with the engine running. Then R has '
    "the engine's vibration in it, of which it prints nothing: here so much in the accelerometer's R, all else from "
    "the ground. The size of the error hangs on it; that the three filters err alike does not."
)
_PEER = (
    "Yamagishi and Jing, lightweight cubature filter for AHRS, IEEE Access 14, 2026: a quaternion without gyro bias, "
    "directions of gravity and field; package turbo-ckf with the variances of its example. Raw it trusts the "
    "accelerometer in turns, too."
)
_SPEED = (
    "Compiled, with sigma points for those components only that the functions read, and analytic slopes: the ratio "
    "is that of the arithmetic, not of MATLAB's calls. CKF and CDKF cost the same: both evaluate the "
    "centre, from which differences are taken."
)
_ERRATIC = (
    "What decides is the noise of the first samples: a start one sample later fails in other runs, one with P0 larger "
    "by 1e-12 in the same ones. A run that fails has given bias and body rate, of which the gyro shows the "
    "sum alone, hundreds of deg/s of opposite sign. Given how well the bias is known (row below), the filters with "
    "points find the attitude; the EKF's slope at a quaternion of no meaning does not lead there."
)
_FAR = (
    "Standing, R and Q from the ground. From the opposite heading the innovation lies along the field, and a turn "
    "moves the predicted field across it: the first gains turn by the sine of what is missing, while P, which does not "
    "know the innovation, shrinks to R at once (to a sigma of 1 deg). The rest goes into rate and bias, which swing "
    "through (rows below: how far the bias moves; with it held the heading comes round without overshoot, somewhat "
    "sooner)."
)
_LUCK = (
    "With so large a P the points lie all round, and their second-order terms keep S large: after the first field the "
    "sigma is 2 to 1000 deg, with the EKF 1 deg. The noise of the first samples decides: a run either arrives at once "
    "or goes the way of the EKF. A single run, or a median, shows one or the other."
)


def flight(duration: float) -> Flown:
    """Fly the turns, shortened: standing, take-off, climb, bank of 30 deg both ways."""
    return fly(scenarios.load("turns", duration=duration).data, "turns")


def tracked(unit: Measured, **settings: Any) -> dict[str, np.ndarray]:
    """Compute errors (n, 3) of roll, pitch, heading in deg from `SETTLED` on, by filter."""
    found = {}
    for name in _FILTERS:
        estimates = unit.estimate(f"marg-{name}", **settings)
        found[name] = unit.errors(estimates)[estimates.t >= SETTLED, :3]
    return found


def against(unit: Measured, reference: Measured, **settings: Any) -> dict[str, float]:
    """Compute RMS difference (deg, of the whole rotation) from the EKF on the better unit, by filter."""
    best = reference.estimate("marg-ekf", **settings)
    there = np.isfinite(best.q_nb[:, 0])
    found = {}
    for name in _FILTERS:
        estimates = unit.estimate(f"marg-{name}", **settings)
        counted = estimates.t >= SETTLED
        q_ref = attitude.interpolate(best.t[there], best.q_nb[there], estimates.t[counted])
        difference = metrics.attitude_errors(estimates.q_nb[counted], estimates.down_b[counted], q_ref)
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


@dataclass(frozen=True)
class FromFar:
    """Holds how one filter recovered from a wrong initial heading at standstill; one value per run."""

    first: np.ndarray  # s, until it is within 5 deg for the first time; inf: never
    last: np.ndarray  # s, for good
    bias: np.ndarray  # deg/s, how far the estimate of the gyro bias moved


def from_far(
    units: list[Measured], degrees: float, variance: float | None, *, hold_bias: bool = False
) -> dict[str, FromFar]:
    """Back from a heading wrong by so much, by filter; `variance` of the quaternion's elements (see `bench.turned`)."""
    found = {}
    held = {"bias_walk": 0.0} if hold_bias else {}
    for name in _FILTERS:
        rows = []
        for unit in units:
            rest, estimator = turned(unit.create(f"marg-{name}", **held), unit.samples, degrees, variance)
            if hold_bias:
                _bias_variance(estimator, 1e-16)
            estimates = estimator.process(rest)
            error = unit.errors(estimates)[:, 2]
            moved = np.degrees(np.abs(estimates.gyro_bias - estimates.gyro_bias[0]).max())
            rows.append([time_first(estimates.t, error, 5.0), time_until(estimates.t, error, 5.0), moved])
        found[name] = FromFar(*np.nan_to_num(rows, nan=math.inf).T)
    return found


def _bias_variance(estimator: Any, variance: float) -> None:
    """Make the gyro bias known so well, (rad/s)^2, and uncorrelated."""
    state = estimator.state()
    P = state["filter"]["P"]
    P[7:], P[:, 7:] = 0.0, 0.0
    P[7:, 7:] = variance * np.eye(3)
    estimator.restore(state)


def from_nothing(
    units: list[Measured], skip: int = 0, bias_variance: float | None = None, noise: str = "from-ground"
) -> dict[str, int]:
    """Count the runs that start as the paper does (P0 = 1e4 I) and end within 5 deg, standing.

    Args:
        units: what was measured.
        noise: where R and Q are from.
        skip: samples before the start.
        bias_variance: (rad/s)^2, of the gyro bias instead of the paper's.
    """
    found = {}
    for name in _FILTERS:
        good = 0
        for unit in units:
            estimator = unit.create(f"marg-{name}", initialisation="paper", noise=noise)
            rest = unit.samples[skip:]
            if bias_variance is not None:
                while estimator.state()["filter"] is None:  # R and Q are being measured
                    estimator.process(rest[:1])
                    rest = rest[1:]
                _bias_variance(estimator, bias_variance)
            last = unit.errors(estimator.process(rest))[-200:, 4]
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
    claims += [*_engine(chr_units[: max(1, runs // 2)]), *_peer(chr_units[: max(1, runs // 2)])]
    claims += _starts(3 if quick else 2 * runs)
    return Reproduction(
        name="cubature",
        title="Cubature Kalman filter for aircraft attitude, beside EKF and CDKF",
        source="Paper 000: Han, Gan, He, Alazard, aircraft attitude estimation method based on CKF, 2013 (in Chinese)",
        conditions=(
            "A model aircraft at 20 m/s, wind 4 m/s, light turbulence: standing, take-off, climb, turns of 30 deg of "
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
        outcome = holds(ratio < 0.9)  # nearer to one it is a draw
        text = f"Table 1, CPU time {over.upper()} over {under.upper()}"
        claims.append(Claim(text, paper, ratio, "", outcome, _SPEED, repeats))
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
    claims.append(Claim("  EKF's less CKF's", None, found["ekf"] - found["ckf"], "deg", reason=_EQUAL, runs=runs))
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


def _ordered(found: dict[str, float]) -> Outcome:
    """CKF < CDKF < EKF by more than a hundredth, else it is no order."""
    return holds(found["ckf"] < 0.99 * found["cdkf"] and found["cdkf"] < 0.99 * found["ekf"])


def _aided(units: list[Measured], runs: int) -> list[Claim]:
    claims = []
    few = units[: max(1, runs // 2)]
    for every in (1, 5, 20):
        errors = [tracked(thinned(u, every), **_AIDED) for u in few]
        found = _rows([{name: rms(e[:, 2]) for name, e in by_filter.items()} for by_filter in errors])
        text = words([found[name] for name in _FILTERS])
        what = f"Airspeed aided, {100 // every} Hz: heading, EKF, CKF, CDKF"
        claims.append(Claim(what, None, text, "deg", reason=_EQUAL, runs=len(few)))
        apart = _rows([{name: rms((e[name] - e["ekf"])[:, 2]) for name in _FILTERS} for e in errors])
        text = words([apart["ckf"], apart["cdkf"]])
        claims.append(Claim("  from the EKF's: CKF, CDKF", None, text, "deg", reason=_EQUAL, runs=len(few)))
    return claims


def shaken(unit: Measured, name: str, sigma: float) -> np.ndarray:
    """Compute errors (n, 2) of tilt and heading in deg of a filter whose R has `sigma` m/s2 for the accelerometer.

    The rest of R and Q is from the ground; no `sigma`: the accelerometer's too.
    """
    estimator = unit.create(f"marg-{name}")
    taken = 0
    while estimator.state()["filter"] is None:
        estimator.process(unit.samples[taken : taken + 1])
        taken += 1
    if sigma:
        state = estimator.state()
        state["filter"]["parameters"]["R_accel"][...] = sigma**2 * np.eye(3)
        estimator.restore(state)
    estimates = estimator.process(unit.samples[taken:])
    found: np.ndarray = unit.errors(estimates)[estimates.t >= SETTLED][:, [3, 2]]
    return found


def _engine(units: list[Measured]) -> list[Claim]:
    """Compute errors against the truth with R from a ground start that shakes, tilt and heading."""
    claims = []
    for sigma in (0.0, 1.0, 3.0):
        found = []
        for name in _FILTERS:
            each = np.concatenate([shaken(unit, name, sigma) for unit in units])
            found.append("/".join(f"{rms(column):.3g}" for column in each.T))
        how = f"engine shaking with {sigma:g} m/s2" if sigma else "motor off"
        what = f"R from the ground, {how}: tilt/heading, EKF, CKF, CDKF"
        claims.append(Claim(what, None, " ".join(found), "deg", reason=_ENGINE, runs=len(units)))
    return claims


def _peer(units: list[Measured]) -> list[Claim]:
    """Run the cubature filter published since, where its package is installed."""
    claims = []
    for aiding in ("none", "airspeed"):
        try:
            estimates = [unit.estimate("turbo-ckf", aiding=aiding) for unit in units]
        except SettingError:  # not installed
            return []
        each = [u.errors(e)[e.t >= SETTLED][:, [3, 2]] for u, e in zip(units, estimates, strict=True)]
        text = "/".join(f"{rms(column):.3g}" for column in np.concatenate(each).T)
        what = f"turbo-ckf (2026), {'raw' if aiding == 'none' else 'corrected by airspeed'}: tilt/heading"
        claims.append(Claim(what, None, text, "deg", reason=_PEER, runs=len(units)))
    return claims


def _time(times: np.ndarray) -> str:
    """Format the median, s."""
    t = float(np.median(times))
    return "never" if math.isinf(t) else f"{t:.2g}"


def _starts(runs: int) -> list[Claim]:
    flown = fly(_STILL, "still")
    units = [measure(flown, _CHR, seed) for seed in range(1, runs + 1)]
    claims = []
    for degrees in (90.0, 175.0):
        for variance, known in ((None, "heading sigma given"), (1.0, "P = I on q")):
            for every in (1, 5, 20):
                found = from_far([thinned(unit, every) for unit in units], degrees, variance)
                text = " ".join(f"{_time(f.first)}/{_time(f.last)}" for f in found.values())
                what = f"Off by {degrees:g} deg, {known}, {100 // every} Hz: first/for good within 5, EKF, CKF, CDKF"
                claims.append(Claim(what, None, text, "s", reason=_FAR, runs=runs))
    found = from_far(units, 175.0, None)
    text = words([float(np.median(f.bias)) for f in found.values()])
    claims.append(Claim("  bias estimate moved by, sigma given, 100 Hz", None, text, "deg/s", reason=_FAR, runs=runs))
    text = " ".join(f"{_time(f.first)}/{_time(f.last)}" for f in from_far(units, 175.0, None, hold_bias=True).values())
    claims.append(Claim("  the same with the bias held: first/for good", None, text, "s", reason=_FAR, runs=runs))
    text = " ".join(f"{int(np.sum(f.last < 10.0))}/{runs}" for f in from_far(units, 175.0, 100.0).values())
    what = "Off by 175 deg, P = 100 I on q, 100 Hz: runs for good within 5 deg in 10 s"
    claims.append(Claim(what, None, text, "", reason=_LUCK, runs=runs))
    good = from_nothing(units)
    outcome = holds(all(n == runs for n in good.values()))
    claims.append(Claim("Start of the paper (P0 = 1e4 I), R and Q from the ground: runs within 5 deg", "all",
                        _share(good, runs), "", outcome, _ERRATIC, runs))  # fmt: skip
    for what, later in (
        ("  the same, begun a sample later", {"skip": 1}),
        ("  the same, bias known to 0.6 deg/s", {"bias_variance": math.radians(0.6) ** 2}),
        ("  the same, practical R and Q", {"noise": "practical"}),
    ):
        claims.append(Claim(what, None, _share(from_nothing(units, **later), runs), "", reason=_ERRATIC, runs=runs))
    return claims


def _share(good: dict[str, int], runs: int) -> str:
    return " ".join(f"{good[name]}/{runs}" for name in _FILTERS)
