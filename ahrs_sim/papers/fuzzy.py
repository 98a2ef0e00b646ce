"""Paper 002, fuzzy adaptive Kalman filter: a motion table, three noise regimes, with and without adaptation."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ahrs_sim.papers import Claim, Outcome, Reproduction, holds, outcome_of
from ahrs_sim.papers.bench import Flown, fly, measure
from ahrs_sim.world.gravity import STANDARD

RUNS = 5
STILL, LENGTH, SETTLED = 24.0, 240.0, 10.0
"""s: standing for the alignment, the experiment, and its beginning that does not count."""

_SWAY = {
    "motion": {"kind": "sway", "still_s": STILL},
    "duration_s": STILL + LENGTH,
    "rate_hz": 200.0,
}
# White noise of one sample at 100 Hz; a density (single-sided) is that over sqrt(50 Hz).
_ROOT = 50.0**-0.5
_PRINTED = {
    "grade": "ideal",
    "gyro": {"noise_density_dps_rthz": 10.0 / 3600.0 * _ROOT},
    "accelerometer": {"noise_density_mg_rthz": 10e-3 * _ROOT},
    "magnetometer": {"noise_density_mgauss_rthz": 1e-6 * _ROOT},
}
_CHR = {
    "grade": "ideal",
    "gyro": {"noise_density_dps_rthz": 0.03},
    "accelerometer": {"noise_density_mg_rthz": [0.15, 0.15, 0.30]},
    "magnetometer": {"noise_density_mgauss_rthz": 0.8},
}
_VARIANCES = {  # the numbers printed, read as variances of a sample in SI units
    "grade": "ideal",
    "gyro": {"noise_density_dps_rthz": math.degrees(math.sqrt(math.radians(10.0 / 3600.0))) * _ROOT},
    "accelerometer": {"noise_density_mps2_rthz": math.sqrt(10e-6 * STANDARD) * _ROOT},
    "magnetometer": {"noise_density_ut_rthz": math.sqrt(1e-13) * 1e6 * _ROOT},
}
_WALK = {"printed": 1e-8, "variances": 1e-6, "CHR": 1e-6}
"""rad/s per sqrt(s): there is no bias; the filter must allow for some."""
_METHODS = {"standard": "akf-standard", "adaptive": "fakf"}
_AXES = ("roll", "pitch", "heading")

_TOO_GOOD = (
    "With 10 ug, 1e-13 T and 10 deg/h as standard deviations any correct filter errs by less than a thousandth of a "
    'degree. Read as variances in SI units, as the paper itself scales ("noise variance x5"), the same numbers are '
    "0.4 deg/s, 1 mg and 0.32 uT and give what it shows (rows above)."
)
_SIZE = (
    "Half of what the paper shows, as the adaptive filter's error is too: how the two compare (row below) is the "
    "paper's. What its table swung besides, or how often its noise was drawn, it does not say."
)
_STEADY = (
    "With R wrong by 20 the gain is too high and the estimate noisier, not wrong: a Kalman filter with stable gains "
    "does not diverge because R is off. Adaptation lowers the noise."
)
_LINEAR = (
    "Noise a thousandfold is beyond the field itself at CHR grade: innovations are then larger than what a "
    "linearisation stands, and the standard filter, which trusts them, loses the heading. At the noise printed the "
    "thousandfold is still below that of any real magnetometer."
)


def regime(which: str) -> list[dict[str, Any]]:
    """Make faults of "constant", "stepped" (variances x1, x5, x10, x20, a minute each) or "thousand" (magnetometer)."""
    if which == "constant":
        return []
    if which == "thousand":
        return [{"sensor": "magnetometer", "kind": "noise", "sigma_factor": 1000.0, "at_s": STILL}]
    return [
        {"sensor": sensor, "kind": "noise", "variance_factor": factor, "at_s": STILL + 60.0 * minute, "for_s": 60.0}
        for minute, factor in ((1, 5.0), (2, 10.0), (3, 20.0))
        for sensor in ("accelerometer", "magnetometer")
    ]


def errors(flown: Flown, suite: dict[str, Any], walk: float, which: str, runs: int) -> dict[str, np.ndarray]:
    """Per method: RMS (runs, 3) and largest (runs, 3) error in deg of roll, pitch, heading, as (2, runs, 3).

    Of the regime "stepped" the last minute counts, of the others all but the first seconds.
    """
    found: dict[str, list[np.ndarray]] = {name: [] for name in _METHODS}
    for seed in range(1, runs + 1):
        measured = measure(flown, suite, seed, regime(which))
        for name, method in _METHODS.items():
            estimates = measured.estimate(method, noise="sensors", bias_walk=walk)
            start = STILL + (180.0 if which == "stepped" else SETTLED)
            error = measured.errors(estimates)[estimates.t >= start, :3]
            found[name].append(np.array([np.sqrt(np.mean(error**2, axis=0)), np.max(np.abs(error), axis=0)]))
    return {name: np.array(rows).swapaxes(0, 1) for name, rows in found.items()}


def reproduce(quick: bool = False) -> Reproduction:
    """Three regimes at the numbers printed, as variances and as deviations, then at the noise of a CHR-6dm."""
    runs = 1 if quick else RUNS
    flown = fly(_SWAY, "sway")
    return Reproduction(
        name="fuzzy",
        title="Fuzzy adaptive Kalman filter: measurement noise from the innovations",
        source="Paper 002: Tian, Sun, Li, Yan, algorithm for the adaptive Kalman filter in AHRS, 2011 (in Chinese)",
        conditions=(
            "Motion table: pitch 10 + 1 sin(pi/10 t), roll 10 + 1 sin(pi/15 t), heading 30 + 5 sin(pi/20 t) deg, 240 s "
            "at 100 Hz after an alignment at rest. Printed noise: gyro 10 deg/h, accelerometer 10 ug, magnetometer "
            "1e-13 T, read as variances of a sample in SI units, then as standard deviations. Both filters start with "
            "R and Q of that noise. Figures are the largest error of all "
            "runs, deg; at CHR grade (0.03 deg/s and 0.15 to 0.3 mg and 0.8 mG per root hertz) the RMS as well."
        ),
        claims=[*_read(flown, "variances", runs), *_read(flown, "printed", runs), *_chr(flown, runs)],
    )


def _limit(what: str, paper: float, ours: float, runs: int) -> Claim:
    """Make a claim that an error stays below the paper's limit; far below is another experiment."""
    outcome = outcome_of(paper, ours, 0.0)
    if outcome == Outcome.BETTER and ours > 0.25 * paper:
        outcome = Outcome.REPRODUCED
    return Claim(what, paper, ours, "deg", outcome, "" if outcome == Outcome.REPRODUCED else _TOO_GOOD, runs)


def _read(flown: Flown, reading: str, runs: int) -> list[Claim]:
    """Run the paper's three regimes with its printed noise read as "variances" or, "printed", as deviations."""
    claims = []
    suite, walk = {"variances": _VARIANCES, "printed": _PRINTED}[reading], _WALK[reading]
    begin = {"variances": "As variances, ", "printed": "As deviations, "}[reading]
    limits = {"constant": ("(i) constant noise", 0.2, 0.3), "stepped": ("(ii) variance x20", 0.3, 0.5)}
    for which, (text, tilt, heading) in limits.items():
        found = errors(flown, suite, walk, which, runs)
        worst = {name: rows[1].max(axis=0) for name, rows in found.items()}
        standard, adaptive = (np.array([max(worst[name][:2]), worst[name][2]]) for name in _METHODS)
        claims.append(_limit(f"{begin}{text}, adaptive: roll, pitch, at most", tilt, float(adaptive[0]), runs))
        claims.append(_limit(f"{begin}{text}, adaptive: heading, at most", heading, float(adaptive[1]), runs))
        own, what = words(standard.tolist()), f"{begin}{text}, standard: roll or pitch, heading"
        if which == "constant":
            claims.append(Claim(what, None, own, "deg", runs=runs))
            continue
        size = _SIZE if reading == "variances" else _STEADY
        claims.append(Claim(what, "> 0.5 ~1", own, "deg", holds(bool(standard[0] > 0.5)), size, runs))
        ratio = float(np.min(standard / adaptive))
        more = holds(ratio > 1.25)
        claims.append(
            Claim(f"{begin}{text}: largest error, standard over adaptive", "> 1.7", ratio, "", more,
                  "" if more == Outcome.REPRODUCED else _STEADY, runs)
        )  # fmt: skip
        claims.append(_gain(f"{begin}{text}: RMS standard over adaptive, heading", found, runs))
    thousand = errors(flown, suite, walk, "thousand", runs)
    claims.append(_thousand(f"{begin}(iii) magnetometer sigma x1000", thousand, runs))
    return claims


def _gain(what: str, found: dict[str, np.ndarray], runs: int) -> Claim:
    standard, adaptive = (float(np.sqrt(np.mean(found[name][0][:, 2] ** 2))) for name in _METHODS)
    outcome = holds(adaptive < standard)
    return Claim(what, "> 1", standard / adaptive, "", outcome, "" if outcome == Outcome.REPRODUCED else _STEADY, runs)


def _thousand(what: str, found: dict[str, np.ndarray], runs: int) -> Claim:
    worst = [float(found[name][1][:, 2].max()) for name in _METHODS]
    outcome = holds(worst[0] > 30.0 and worst[1] < 0.5 * worst[0])
    return Claim(
        f"{what}: largest heading error, standard, adaptive", "diverges, converges", f"{worst[0]:.2g} {worst[1]:.2g}",
        "deg", outcome, _LINEAR, runs,
    )  # fmt: skip


def _chr(flown: Flown, runs: int) -> list[Claim]:
    claims = []
    suite, walk = _CHR, _WALK["CHR"]
    for which, text in (
        ("constant", "constant noise"),
        ("stepped", "variance x20"),
        ("thousand", "magnetometer x1000"),
    ):
        found = errors(flown, suite, walk, which, runs)
        for name, rows in found.items():
            figures = [float(np.sqrt(np.mean(rows[0][:, i] ** 2))) for i in range(3)]
            claims.append(
                Claim(f"CHR grade, {text}, {name}: RMS roll, pitch, heading", None, words(figures), "deg", runs=runs)
            )
        if which == "thousand":
            claims.append(_thousand("CHR grade, magnetometer x1000", found, runs))
        elif which == "stepped":
            claims.append(_gain("CHR grade, variance x20: RMS standard over adaptive, heading", found, runs))
    return claims


def words(figures: Sequence[float]) -> str:
    """Several figures in one cell."""
    return " ".join(f"{value:.2g}" for value in figures)
