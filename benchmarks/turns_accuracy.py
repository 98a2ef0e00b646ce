"""Tilt and heading in sustained turns: every filter and every peer on the same flights, on seeds not used in tuning.

    python benchmarks/turns_accuracy.py [--seeds 101..120] [--peers 3] [--duration 400] [--markdown docs/accuracy.md]
    python benchmarks/turns_accuracy.py --figures FILE --markdown docs/accuracy.md     # of what has been flown, anew

Flies `turns` and `circuit` (30 and 45 deg of bank) in 5 m/s of wind and light turbulence. Each flight is flown and
sensed once; every estimator of a suite gets the same samples. A figure is the RMS over flights from 80 s on; "worst"
is the worst seed's tilt over it; NEES and NIS are means per degree of freedom. The row with an outage counts its 60 s
only, all of them in a turn of `turns`. The peers of plain Python are slow: they fly with the first `--peers` seeds only
(0: none). The Cramer-Rao bound (`ahrs-sim bound`) is that of the first seeds' flights: it depends on the trajectory,
not on what is drawn. `--figures FILE` keeps what every flight gave, seed by seed. `--planted N` flies N seeds of the
flights with one planted cause each as well, `--calibrations N` N units through a calibration flight and a circuit
(`benchmarks/calibration_flight.py`).
"""

import argparse
import json
import math
import sys
import time
import warnings
from collections import ChainMap
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import estimators
from ahrs_sim import scenario
from ahrs_sim.chain import Chain, site
from ahrs_sim.evaluation import consistency, metrics
from ahrs_sim.evaluation.decimate import take
from ahrs_sim.evaluation.metrics import Measure
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.runs import bound
from ahrs_sim.sensors import make_suite
from ahrs_sim.world import wgs84
from estimators.navigator.smoother import smooth
from estimators.types import Estimates, Samples, SensorInfo, Site

SCENARIOS, SUITES = ("turns", "circuit"), ("chr", "sbg")
START, OUTAGE, OUTAGE_S = 80.0, 240.0, 60.0
BLOCK_S, TRUTH_RATE, FIGURES_RATE = 5.0, 100.0, 10.0
WORST = 1.6
PEERS = ("vqf", "imufusion", "madgwick", "mahony", "ahrs-ekf", "turbo-ckf", "attipy", "smsfusion")
WITH_VELOCITY = ("attipy", "smsfusion")  # peers that take the velocity of GNSS

BOUNDS = {"gnss": "magnetometer, GNSS", "dual": "magnetometer, GNSS, two antennas"}
BOUND_OF = {"ins15": "gnss", "ins21": "gnss", "cal": "gnss", "dual": "dual", "cal-dual": "dual"}
"""The bound of the same sensors, by row; those with airspeed have none."""

# key: what it is, settings, goals by suite (tilt, heading; deg), bounds of NEES and NIS
ROWS: dict[str, tuple[str, dict[str, Any], tuple[tuple[float, float], ...], tuple[float, float]]] = {
    "paper": ("`marg-ckf` as the paper says: magnetometer", {"method": "marg-ckf"}, (), (0.0, math.inf)),
    "ekf-air": (
        "`marg-ekf`: magnetometer, airspeed",
        {"method": "marg-ekf", "aiding": "airspeed"},
        ((1.1, 2.0), (0.45, 0.75)),
        (0.0, 3.0),
    ),
    "ckf-air": (
        "`marg-ckf`: magnetometer, airspeed",
        {"method": "marg-ckf", "aiding": "airspeed"},
        ((1.1, 2.0), (0.45, 0.75)),
        (0.0, 3.0),
    ),
    "air-ins": (
        "`air-ins`: magnetometer, airspeed",
        {"method": "air-ins", "heading_aid": False},
        ((0.75, 1.2), (0.38, 0.68)),
        (0.0, 3.0),
    ),
    "ins15": (
        "`ins15`: magnetometer, GNSS",
        {"method": "ins15", "heading_aid": False},
        ((0.85, 1.4), (0.2, 0.3)),
        (0.0, 3.0),
    ),
    "ins21": (
        "`ins21`: magnetometer, GNSS",
        {"method": "ins21", "heading_aid": False},
        ((0.6, 0.6), (0.15, 0.25)),
        (0.5, 2.0),
    ),
    "air-dual": (
        "`air-ins`: magnetometer, airspeed, two antennas",
        {"method": "air-ins", "heading_aid": True},
        (),
        (0.0, 3.0),
    ),
    "dual": (
        "`ins21`: magnetometer, GNSS, two antennas",
        {"method": "ins21", "heading_aid": True},
        ((0.6, 0.35), (0.15, 0.22)),
        (0.5, 2.0),
    ),
    "cal": (
        "`ins-cal`: magnetometer, GNSS",
        {"method": "ins-cal", "heading_aid": False},
        ((0.42, 0.36), (0.14, 0.2)),
        (0.5, 2.0),
    ),
    "cal-dual": (
        "`ins-cal`: magnetometer, GNSS, two antennas",
        {"method": "ins-cal"},
        ((0.35, 0.2), (0.14, 0.2)),
        (0.5, 2.0),
    ),
    "outage": (
        "`ins21`: magnetometer, GNSS, airspeed; 60 s without GNSS in a turn",
        {"method": "ins21", "aiding": "gnss+airspeed", "heading_aid": False},
        ((0.9, 1.3), (0.3, 0.5)),
        (0.0, 3.0),
    ),
}

SMOOTHED: dict[str, tuple[str, tuple[float, float]]] = {
    "cal": ("`ins-cal` smoothed: magnetometer, GNSS", (0.4, 0.3)),
    "cal-dual": ("`ins-cal` smoothed: magnetometer, GNSS, two antennas", (0.26, 0.14)),
}
"""Rows that are smoothed afterwards as well, low-cost unit: what it is, goal (tilt, heading; deg)."""
SMOOTHED_SUITE, SMOOTHED_NEES = "chr", (0.5, 3.0)

STATES = {"nees": "attitude", "nees_velocity": "velocity", "nees_place": "position", "nees_gyro": "gyro bias",
          "nees_accel": "accelerometer bias"}  # fmt: skip
"""Figures of consistency, and of what they are."""

SHAKEN = {
    "gyro": {"vibration_band_dps": 2.0},
    "accelerometer": {"vibration_band_mps2": 3.0, "vibration_line_mps2": 6.0},
}
"""About ten times what the grade has of an electric motor."""

# key: what is planted, scenario, changes of the suite, from when on (s)
PLANTED: dict[str, tuple[str, str, dict[str, Any], float]] = {
    "none": ("nothing", "short_turns", {}, 45.0),
    "shaken": (
        "vibration: gyro 2 deg/s, accelerometer 3 m/s2 in the band, 6 m/s2 of lines",
        "short_turns",
        SHAKEN,
        45.0,
    ),
    "mag": ("magnetometer turned by 60 degrees", "mag_turned", {}, 45.0),
    "wires": ("magnetometer beside the motor's wires", "motor_wires", {}, 45.0),
    "late": ("fixes 0.3 s late, not declared", "gnss_late", {}, 45.0),
    "lag": ("velocity behind a filter of 0.3 s", "gnss_lag", {}, 45.0),
    "hover": ("ten minutes of hover, shaken by rotors", "hover", {}, START),
}
PLANTED_ROWS = ("ins21", "cal")

INTRO = """# Accuracy in turns

Made by `python benchmarks/turns_accuracy.py --markdown docs/accuracy.md`; do not edit.

{flights}. RMS over flights from {start:.0f} s on, tilt / heading in degrees; "worst seed" is the tilt of the worst
seed over that RMS (goal: {worst} at most). NEES and NIS are means per degree of freedom, 1 for a consistent filter.
After the colon: what an estimator uses besides gyro and accelerometer; two antennas give the heading of their baseline.
{peers}
"""

NOTES = """
## Consistency, drawn

![Errors in the estimator's own three sigma, and NEES in its 95 % bounds](consistency.png)

`ins21` and the CKF of the paper on the circuit, CHR grade (`ahrs-sim fly circuit --estimator ins21@chr --estimator
ckf-chr`, then `ahrs-sim compare LOG --png DIR`). The CKF takes every acceleration for gravity: it is a thousand of its
own sigmas off and does not know.

## Where a goal is missed, and why

"x the bound" is tilt and heading over the Cramer-Rao bound of the same sensors (`ahrs-sim bound`), which no filter's
RMS over many seeds is below; the bound is that of the first seed's two flights. Estimators with airspeed have none.
The goals were set on a prototype with its own sensors; the grades here say what each unit's data sheet says
(`ahrs-sim list grades`), every axis of scale, misalignment and hard iron drawn anew for each seed. Terms on alone, by
`ahrs-sim budget` (`turns`, 80 to 340 s, seeds 1 to 3, CHR without the dual antenna), tilt / heading in degrees:

| term | `air-ins` | `ins21` | `marg-ckf`, airspeed aided |
|---|---|---|---|
| no error of any sensor: turbulence | 0.33 / 0.28 | 0.02 / 0.02 | 0.20 / 0.24 |
| scale of the gyro | 0.37 / 0.29 | 0.09 / 0.10 | 0.36 / 0.72 |
| misalignment of the gyro | 0.53 / 0.40 | 0.33 / 0.34 | 0.33 / 0.42 |
| bias of the gyro in run | 0.44 / 0.47 | 0.18 / 0.26 | 0.31 / 0.48 |
| bias of the accelerometer | 0.38 / 0.34 | 0.12 / 0.07 | 0.25 / 0.35 |
| misalignment of the accelerometer | 0.58 / 0.67 | 0.37 / 0.27 | 0.43 / 0.69 |
| hard iron | 0.33 / 0.44 | 0.05 / 0.10 | 0.52 / 0.43 |
| soft iron | 0.34 / 0.51 | 0.10 / 0.20 | 0.42 / 0.50 |
| misalignment of the magnetometer | 0.34 / 0.55 | 0.15 / 0.31 | 0.37 / 0.62 |
| scale of the airspeed | 0.77 / 0.38 | 0.02 / 0.02 | 0.42 / 0.57 |
| velocity of GNSS | | 0.18 / 0.10 | |
| all | 1.07 / 1.40 | 0.61 / 0.63 | 0.92 / 1.62 |

* **`air-ins`** trusts the airspeed: V w is its whole centripetal acceleration, and an airspeed that is k too large
  banks it by k sin cos of the bank, 0.25 deg per percent at 30 degrees. The grade's pitot (4 % of pressure, 2 % place
  of the ports, 3 Pa) is good to 2.4 %. States for the airspeed's scale and direction were tried and made it worse (they
  trade with the accelerometer's bias); no setting of its noise improved the tilt by more than 3 % (seeds 1 to 3).
* **`marg-*`** weighs the gyro more and is fooled less by the pitot, but has no bias of the accelerometer to learn.
* **`ins15` and `ins21`** have no states for misalignment, which is the largest part of what is left to them: `ins21` is
  at about twice the bound. Of some twenty settings of its noises tried on ten seeds none was better in both.
* **`ins-cal`** has the three matrices of gyro, accelerometer and magnetometer as states: with the low-cost unit and
  GNSS alone it is near the bound (an RMS over few seeds may lie below it). The noise of its accelerometer grows with
  the scatter between samples; without that its tilt was a sixth larger on the same seeds. With the better unit it is at
  1.5 times; a fifth of the assumed noise of gyro and accelerometer changes nothing there (0.138 and 0.139 deg of tilt,
  seeds 1 and 2). Its NIS of 0.4 is that of field and place: velocity has 1.1. A dual antenna's wrong ambiguity, 11 deg
  off for 8 s, is left out; believed, it was half a degree of heading over one seed's flight.
* **Smoothed** (`ahrs-sim replay --smooth`): what changes with time is halved in roll and pitch, from 0.15 to 0.08 deg
  on seeds 101 to 103; the rest is a rotation of up to 0.5 deg that stays, the one that all sensors have in common, and
  no reading shows it. The smoother's own covariance says 0.36 / 0.29 deg with GNSS alone and 0.30 / 0.18 with two
  antennas on those seeds: the goal for two antennas lies below it. Smoothing takes 3.8 times what the filter does.
  Where a filter's tilt is mostly that rotation, chance says which of the two is lower.
* **After a calibration flight** a third of the errors of `ins21` is gone, which has no states for them. `ins-cal`
  learns most of it in any flight: it gains a twentieth in tilt and loses a tenth in heading, for a reason not found.
  The correction has the common rotation in it, 0.31 deg in tilt by the grade, so that 0.3 deg cannot be reached.
* **Consistency**: the velocity of `ins-cal` is off by more than it states, because its state for a delay of the fixes
  is: it learns 0.002 to 0.029 s that are not there, on six flights and suites of seeds 101 to 103, states 0.002 s for
  them, and its velocity lags by as much. Without that state (`late_sigma = 0`) the NEES of its velocity is 0.9 to 1.2
  there, and the heading of the better unit up to a fifth smaller. Its biases are compared with turn-on, in-run and
  warming up; what g-sensitivity and vibration add counts as an error.
* **Planted causes**: a magnetometer 60 degrees off is given up in the take-off run, and the heading set to what motion
  shows. Vibration may double an error: `ins21` stays below that, `ins-cal` in tilt but not in heading. What sampling
  folds down of it is in the inertial unit alone, and states are fitted to it: a delay, the heading, the matrices of
  accelerometer and magnetometer. So a delay is learnt only from an acceleration that lasts, and where the gyro
  scatters `ins-cal` takes rate and force for its slopes from their mean over a moment and trusts the field less.
* **The shaken hover** has no turn to tell errors of the accelerometer from a tilt: standing, its bias and misalignment
  make 0.9 to 1.05 deg (seeds 101, 102, 105), and only the dip of the field tells a little of that.
* **A delay that is not declared** is learnt from the receiver's velocity, and `ins-cal` takes a lag of the receiver's
  own filter for one: its velocity is then off by more than it knows (NEES 21 on `gnss_lag`, seed 101). Slopes by the
  acceleration at the time of the fix mend that (0.60 / 0.39 for 0.78 / 0.60 deg), but made heading with the better
  unit twice as bad (0.42 for 0.22 deg on `turns`, seeds 1, 2 and 102), so that they are not used.
* **What the sensors allow** is the bound: half a degree of misalignment of every sensor is seen only in turns, and a
  rotation of all sensors together never. A lower one takes a better calibrated unit or another manoeuvre.
* **Worst seed**: the largest of many draws lies further out than that of twenty, of which the goal speaks.
* **Dual antenna**: its multipath wanders (0.18 deg over 60 s) and the baseline is mounted to 0.15 deg; the bound of
  heading with it is 0.18 deg, and 0.12 with the better unit.
* **NIS**: what wanders in a fix over a minute is in the estimated place (`position_time`), field and baseline count
  once a second, and the measurements keep the noise from one to the next. The airspeed of `air-ins` stays below 1: its
  noise is the incidence and sideslip that it does not measure, which change slowly.

The covariance of `marg-*` was 10 to 17 times too small (NEES, CHR) while it knew only white noise; noise that grows
with the rate and the errors that no average removes (`estimators/models/marg.py`) make it consistent.
"""


@dataclass
class Sensed:
    """A flight, and what a suite sent of it."""

    samples: Samples
    errors: Any  # ImuErrorsRecord, the true biases
    sheet: SensorInfo
    place: Site


def sensed(what: scenario.Scenario, names: Sequence[str]) -> tuple[Truth, dict[str, Sensed]]:
    """Fly a scenario once: the truth at `TRUTH_RATE`, and what the suites of these names sent."""
    flight = open_flight(what)
    place = site(flight.start_lla, what.epoch)
    made = {"seed": what.seed, "dt": flight.dt, "epoch": what.epoch, "start_lla": np.array(place.lla)}
    chains = {s.name: Chain(make_suite(s, **made), {}) for s in what.suites if s.name in names}
    truths: list[Truth] = []
    samples: dict[str, list[Samples]] = {name: [] for name in chains}
    errors: dict[str, list[Any]] = {name: [] for name in chains}
    every = round(what.rate / TRUTH_RATE)
    while len(truth := flight.fly(round(BLOCK_S * what.rate))):
        truths.append(truth[::every])
        for name, chain in chains.items():
            records = chain.sense(truth)
            errors[name].append(records["imu_errors"])
            samples[name].append(chain.assemble(records))
    if flight.error:
        raise SystemExit(f"{what.name}, seed {what.seed}: {flight.error}")
    found = {
        name: Sensed(Samples.concatenate(samples[name]), errors[name][0].concatenate(errors[name]), c.suite.info, place)
        for name, c in chains.items()
    }
    return Truth.concatenate(truths), found


def figures_of(made: Estimates, truth: Truth, sent: Sensed, low: float, high: float, plain: bool) -> dict[str, Any]:
    """Errors from `low` to `high` (s), and how consistent they are with what the estimator states.

    Args:
        made: of the whole flight.
        truth: of the whole flight.
        sent: what the suite sent.
        low, high: s.
        plain: scale and misalignment are states, so that the states of the biases mean the biases alone.
    """
    span = np.flatnonzero((made.t >= low) & (made.t <= min(high, truth.t[-1])))
    squares, freedom = consistency.nis(made.innovation[span], made.innovation_var[span])
    some = take(made, span[:: round(sent.sheet.rate / FIGURES_RATE)])
    q = metrics.interpolate(truth.t, truth.q_nb, some.t)
    error = np.degrees(metrics.attitude_errors(some.q_nb, some.down_b, q))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # what a method does not estimate is NaN
        found = {
            "tilt_rmse_deg": float(np.sqrt(np.nanmean(error[:, Measure.TILT] ** 2))),
            "heading_rmse_deg": float(np.sqrt(np.nanmean(error[:, Measure.HEADING] ** 2))),
            "nis": float(np.nansum(squares) / np.nansum(freedom)) if np.nansum(freedom) else math.nan,
            "nees": float(np.nanmean(consistency.attitude_nees(some.q_nb, some.att_cov, q))) / 3.0,
            **{key: float(np.nanmean(x)) / 3.0 for key, x in state_nees(some, truth, sent, plain).items()},
        }
    return {k: v if math.isfinite(v) else None for k, v in found.items()}


def state_nees(some: Estimates, truth: Truth, sent: Sensed, plain: bool) -> dict[str, np.ndarray]:
    """NEES (n,) of velocity, place and the biases of gyro and accelerometer, three degrees of freedom each."""

    def at(t: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(some.t, t, column) for column in rows.T])

    lla = at(truth.t, truth.lla)
    axes = wgs84.ned_axes(np.asarray(sent.place.lla[0]), np.asarray(sent.place.lla[1]))
    place = (wgs84.ecef(some.lla) - wgs84.ecef(lla)) @ axes.T
    found = {
        "nees_velocity": consistency.nees(some.vel_n - at(truth.t, truth.vel_n), some.vel_cov),
        "nees_place": consistency.nees(place, some.pos_cov),
    }
    stamps = sent.errors.stamp_ns / 1e9
    for name in ("gyro", "accel"):
        true = at(stamps, getattr(sent.errors, f"{name}_bias" if plain else f"{name}_effective_bias"))
        off, sigma = getattr(some, f"{name}_bias") - true, getattr(some, f"{name}_bias_sigma")
        found[f"nees_{name}"] = np.sum((off / np.where(sigma > 0.0, sigma, np.nan)) ** 2, axis=1)
    return found


def without_gnss(samples: Samples) -> Samples:
    """Samples with no fix from `OUTAGE` on for `OUTAGE_S`."""
    lost = (samples.t >= OUTAGE) & (samples.t < OUTAGE + OUTAGE_S)
    blank = {k: np.where(lost[:, None], np.nan, getattr(samples, k)) for k in ("lla", "vel_n")}
    return replace(samples, gnss_new=samples.gnss_new & ~lost, **blank)


def windy(name: str, seed: int, duration: float | None) -> scenario.Scenario:
    """Load a scenario with 5 m/s of wind and no estimators."""
    known = scenario.load(name).data
    known.pop("catalogue", None)
    data = known | {"wind": known["wind"] | {"speed_mps": 5.0, "at_20ft_mps": 5.0}, "estimator": {}}
    return scenario.parse(data, name, name, seed=seed, duration=duration)


def flight(name: str, seed: int, duration: float | None) -> dict[str, dict[str, Any]]:
    """Figures of every estimator of one flight: `ROW-SUITE`."""
    truth, suites = sensed(windy(name, seed, duration), SUITES)
    found: dict[str, dict[str, Any]] = {}
    for suite, sent in suites.items():
        for key, (_, settings, _, _) in ROWS.items():
            lasts = name == "turns" and truth.t[-1] > OUTAGE + OUTAGE_S
            if key == "outage" and not lasts:  # where else it turns when the satellites go is chance
                continue
            method, own = settings["method"], {k: v for k, v in settings.items() if k != "method"}
            estimator: Any = estimators.create(method, site=sent.place, sensors=sent.sheet, **own)
            samples, low, high = sent.samples, START, math.inf
            if key == "outage":
                samples, low, high = without_gnss(samples), OUTAGE, OUTAGE + OUTAGE_S
            plain = method == "ins-cal"
            found[f"{key}-{suite}"] = figures_of(estimator.process(samples), truth, sent, low, high, plain)
            if key in SMOOTHED and suite == SMOOTHED_SUITE:
                made = smooth(estimator, samples)
                found[f"{key}-smoothed-{suite}"] = figures_of(made, truth, sent, low, high, plain)
    return found


def peers(name: str, seed: int, duration: float | None) -> dict[str, dict[str, Any]]:
    """Figures of the peers on one flight: `PEER-SUITE`, with the aid between where they have one."""
    truth, suites = sensed(windy(name, seed, duration), SUITES)
    found = {}
    for suite, sent in suites.items():
        for peer in PEERS:
            for end, own in (("", {}), ("-air", {"aiding": "airspeed"}), ("-gnss", {"aiding": "gnss"})):
                if end != "-gnss" or peer in WITH_VELOCITY:
                    estimator: Any = estimators.create(peer, site=sent.place, sensors=sent.sheet, **own)
                    made = estimator.process(sent.samples)
                    found[f"{peer}{end}-{suite}"] = figures_of(made, truth, sent, START, math.inf, False)
    return found


def bounds(name: str, seed: int, duration: float | None) -> dict[str, dict[str, Any]]:
    """The bounds of a flight as if they were estimators: `bound-AIDS-SUITE`."""
    found = {}
    for suite in SUITES:
        aids = {key: bound.AIDS[aids] for key, aids in BOUNDS.items()}
        for key, one in bound.make(windy(name, seed, duration), suite, aids=aids).items():
            tilt, heading = (math.degrees(x) for x in one.rms(START))
            found[f"bound-{key}-{suite}"] = {
                "tilt_rmse_deg": tilt, "heading_rmse_deg": heading, "nees": None, "nis": None,
            }  # fmt: skip
    return found


def planted_flight(key: str, seed: int) -> dict[str, dict[str, Any]]:
    """Figures of the navigators, low-cost unit, on one flight with a planted cause: `KEY-ROW`."""
    _, name, changes, low = PLANTED[key]
    known = scenario.load(name).data
    known.pop("catalogue", None)
    suite = dict(known["suite"]["chr"])
    for instrument, figures in changes.items():
        suite[instrument] = {**suite.get(instrument, {}), **figures}
    data = known | {"suite": {"chr": suite}, "estimator": {}}
    truth, suites = sensed(scenario.parse(data, name, name, seed=seed), ("chr",))
    found = {}
    for row in PLANTED_ROWS:
        method, own = ROWS[row][1]["method"], {k: v for k, v in ROWS[row][1].items() if k != "method"}
        sent = suites["chr"]
        estimator: Any = estimators.create(method, site=sent.place, sensors=sent.sheet, **own)
        made = estimator.process(sent.samples)
        found[f"{key}-{row}"] = figures_of(made, truth, sent, low, math.inf, method == "ins-cal")
    return found


def planted_lines(flown: dict[int, list[dict[str, Any]]]) -> list[str]:
    """The table of the planted causes, markdown; nothing when none has flown."""
    if not flown:
        return []
    made = [
        "", "## One cause planted, CHR grade", "",
        f"Seeds {min(flown)} to {max(flown)}; magnetometer and GNSS; `ahrs-sim list scenarios` has the flights.", "",
        "| planted | " + " | ".join(f"`{ROWS[row][1]['method']}` | NEES" for row in PLANTED_ROWS) + " |",
        "|---" * (1 + 2 * len(PLANTED_ROWS)) + "|",
    ]  # fmt: skip
    for key, (title, *_) in PLANTED.items():
        found = [summary(flown, f"{key}-{row}") for row in PLANTED_ROWS]
        cells = [f"{one[0]:.2f} / {one[1]:.2f} | {one[3]:.3g}" for one in found if one is not None]
        if len(cells) == len(PLANTED_ROWS):
            made.append(f"| {title} | " + " | ".join(cells) + " |")
    return made


def rms(values: list[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def mean(values: list[Any]) -> float:
    """Of those that are known; NaN when none is."""
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else math.nan


def summary(flown: dict[int, list[dict[str, Any]]], key: str) -> tuple[float, float, float, float, float] | None:
    """Tilt and heading RMS (deg), worst seed's share of the tilt, NEES, NIS; None when it has not flown."""
    by_seed = {seed: [f[key] for f in flights if key in f] for seed, flights in flown.items()}
    by_seed = {seed: rows for seed, rows in by_seed.items() if rows}
    if not by_seed:
        return None
    rows = [row for found in by_seed.values() for row in found]
    tilt, heading = (rms([r[f"{m}_rmse_deg"] for r in rows]) for m in ("tilt", "heading"))
    worst = max(rms([r["tilt_rmse_deg"] for r in found]) for found in by_seed.values())
    return tilt, heading, worst / tilt, mean([r["nees"] for r in rows]), mean([r["nis"] for r in rows])


def outcome(
    found: tuple[float, ...], goal: tuple[float, float], bounds: tuple[float, float], with_nis: bool = True
) -> str:
    """What is met and what is not."""
    tilt, heading, worst, nees, nis = found
    missed = [name for name, value, most in (("tilt", tilt, goal[0]), ("heading", heading, goal[1])) if value > most]
    missed += ["worst seed"] if worst > WORST else []
    ratios = [("NEES", nees), ("NIS", nis)] if with_nis else [("NEES", nees)]
    missed += [name for name, value in ratios if not bounds[0] <= value <= bounds[1]]
    return "missed: " + ", ".join(missed) if missed else "met"


def lines(flown: dict[int, list[dict[str, Any]]]) -> list[str]:
    """The tables, markdown."""
    made = []
    for suite in SUITES:
        made += ["", f"## {suite.upper()} grade", ""]
        made += ["| | tilt / heading | x the bound | goal | worst seed | NEES | NIS | |", "|---" * 8 + "|"]
        for key, (title, _, goals, bounds) in ROWS.items():
            found = summary(flown, f"{key}-{suite}")
            if found is None:
                continue
            goal, met = "", ""
            if key == "paper":
                goal, met = "above 15 in tilt", "shown" if found[0] > 15.0 else "not shown"
            if goals:
                asked = goals[SUITES.index(suite)]
                goal, met = f"{asked[0]:g} / {asked[1]:g}", outcome(found, asked, bounds)
            made.append(row(title, found, times_bound(flown, key, suite), goal, f"{found[4]:.2g}", met))
        for key, (title, asked) in SMOOTHED.items():
            if (found := summary(flown, f"{key}-smoothed-{suite}")) is not None:
                met = outcome(found, asked, SMOOTHED_NEES, with_nis=False)
                made.append(row(title, found, "", f"{asked[0]:g} / {asked[1]:g}", "", f"{met}; {better(flown, key)}"))
        made += peer_lines(flown, suite)
        for key, aids in BOUNDS.items():
            if (found := summary(flown, f"bound-{key}-{suite}")) is not None:
                made.append(f"| bound of any filter: {aids} | {found[0]:.2f} / {found[1]:.2f} | 1 | | | | | |")
        made += consistency_lines(flown, suite)
    return made


def row(title: str, found: tuple[float, ...], times: str, goal: str, nis: str, met: str) -> str:
    """A row of the table."""
    cells = title, f"{found[0]:.2f} / {found[1]:.2f}", times, goal, f"{found[2]:.2f}", f"{found[3]:.3g}", nis, met
    return f"| {' | '.join(cells)} |"


def peer_lines(flown: dict[int, list[dict[str, Any]]], suite: str) -> list[str]:
    """Rows of the peers."""
    made = []
    for name in PEERS:
        for key, title in (
            (name, f"{name}, raw"),
            (f"{name}-air", f"{name}, accelerometer corrected by airspeed"),
            (f"{name}-gnss", f"{name}, velocity of GNSS"),
        ):
            if (found := summary(flown, f"{key}-{suite}")) is not None:
                made.append(f"| {title} | {found[0]:.2f} / {found[1]:.2f} | | | {found[2]:.2f} | | | |")
    return made


def better(flown: dict[int, list[dict[str, Any]]], key: str) -> str:
    """On how many seeds the smoothed tilt and heading are below the filter's."""
    below = [0, 0]
    names = f"{key}-{SMOOTHED_SUITE}", f"{key}-smoothed-{SMOOTHED_SUITE}"
    for flights in flown.values():
        for k, angle in enumerate(("tilt", "heading")):
            before, after = (rms([f[name][f"{angle}_rmse_deg"] for f in flights]) for name in names)
            below[k] += after < before
    return f"below its filter on {below[0]} / {below[1]} of {len(flown)} seeds"


def consistency_lines(flown: dict[int, list[dict[str, Any]]], suite: str) -> list[str]:
    """NEES of what each navigator estimates, markdown."""
    titles = {key: title for key, (title, *_) in ROWS.items()}
    titles |= {f"{key}-smoothed": title for key, (title, _) in SMOOTHED.items()}
    made = ["", f"NEES by what is estimated, {suite.upper()} grade:", ""]
    made += [f"| | {' | '.join(STATES.values())} |", "|---" * (1 + len(STATES)) + "|"]
    for key, title in titles.items():
        rows = [f[f"{key}-{suite}"] for flights in flown.values() for f in flights if f"{key}-{suite}" in f]
        means = [mean([one.get(state) for one in rows]) for state in STATES]
        if math.isfinite(means[1]):
            made.append(f"| {title} | " + " | ".join("" if math.isnan(x) else f"{x:.2f}" for x in means) + " |")
    return made


def times_bound(flown: dict[int, list[dict[str, Any]]], key: str, suite: str) -> str:
    """Tilt and heading of a row as multiples of the bound of its sensors, on the flights that have one."""
    aids = BOUND_OF.get(key)
    with_bound = {s: [f for f in flights if f"bound-{aids}-{suite}" in f] for s, flights in flown.items()}
    least = summary(with_bound, f"bound-{aids}-{suite}")
    found = summary(flown, f"{key}-{suite}")
    if least is None or found is None:
        return ""
    return f"{found[0] / least[0]:.2f} / {found[1] / least[1]:.2f}"


PARTS = ("peers", "bounds", "planted", "calibrations", "flights")


class Kept:
    """What has flown, by part and seed, in a file where one is named."""

    def __init__(self, file: Path | None) -> None:
        self.file = file
        self.parts: dict[str, dict[str, Any]] = {part: {} for part in PARTS}
        if file and file.exists():
            self.parts |= json.loads(file.read_text())

    def add(self, part: str, seed: int, found: Any) -> None:
        """Keep what a seed gave."""
        self.parts[part][str(seed)] = found
        if self.file:
            self.file.write_text(json.dumps(self.parts))

    def of(self, part: str) -> dict[int, Any]:
        """Return what is there, by seed, rising."""
        return {int(seed): self.parts[part][seed] for seed in sorted(self.parts[part], key=int)}

    def flown(self) -> dict[int, list[dict[str, Any]]]:
        """Return the flights by seed, with what the peers made of them and their bounds."""
        beside = [self.of(part) for part in ("peers", "bounds")]
        flights = self.of("flights")
        for seed, pair in flights.items():
            more = [one[seed] for one in beside if seed in one]
            flights[seed] = [dict(ChainMap(*parts)) for parts in zip(pair, *more, strict=True)]
        return flights


def fly_all(arguments: argparse.Namespace, seeds: range, kept: Kept) -> None:
    """Fly what is not there yet."""
    from calibration_flight import flown as calibration  # which needs this module

    begun = time.perf_counter()
    with ProcessPoolExecutor(arguments.jobs) as pool:

        def both(made: Callable[..., Any], seed: int) -> list[Any]:
            return [pool.submit(made, name, seed, arguments.duration) for name in SCENARIOS]

        submit: dict[str, tuple[int, Callable[[int], list[Any]]]] = {
            "peers": (arguments.peers, lambda seed: both(peers, seed)),
            "bounds": (arguments.bounds, lambda seed: both(bounds, seed)),
            "planted": (arguments.planted, lambda seed: [pool.submit(planted_flight, key, seed) for key in PLANTED]),
            "calibrations": (arguments.calibrations, lambda seed: [pool.submit(calibration, seed)]),
            "flights": (len(seeds), lambda seed: both(flight, seed)),
        }
        waiting = [
            (part, seed, fly(seed))
            for part, (count, fly) in submit.items()
            for seed in seeds[:count]
            if str(seed) not in kept.parts[part]
        ]
        for part, seed, flights in waiting:
            kept.add(part, seed, [one.result() for one in flights])
            print(f"{part}, seed {seed}, {time.perf_counter() - begun:.0f} s", file=sys.stderr, flush=True)


def main() -> int:
    """Fly, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="101..150", help="FIRST..LAST")
    parser.add_argument("--jobs", type=int, default=2, help="flights at the same time")
    parser.add_argument("--peers", type=int, default=3, help="seeds that the peers fly with as well")
    parser.add_argument("--bounds", type=int, default=1, help="seeds whose bound is computed")
    parser.add_argument("--planted", type=int, default=0, help="seeds that fly with the planted causes")
    parser.add_argument("--calibrations", type=int, default=0, help="units that fly a calibration flight first")
    parser.add_argument("--more", action="store_true", help="with --figures: fly the seeds that are not in it yet")
    parser.add_argument("--duration", type=float, help="s, of each flight at most")
    parser.add_argument("--markdown", type=Path, help="write the page there")
    parser.add_argument("--figures", type=Path, metavar="FILE", help="keep what the flights give; go on from there")
    arguments = parser.parse_args()
    first, _, last = arguments.seeds.partition("..")
    kept = Kept(arguments.figures)
    if not kept.of("flights") or arguments.more:
        fly_all(arguments, range(int(first), int(last or first) + 1), kept)
    flown = kept.flown()
    length = f"the first {arguments.duration:.0f} s" if arguments.duration else "whole flights"
    flights = f"`turns` and `circuit`, {length}, wind 5 m/s, light turbulence, seeds {min(flown)} to {max(flown)}"
    from calibration_flight import lines as calibration_lines

    table = lines(flown) + calibration_lines(kept.of("calibrations")) + planted_lines(kept.of("planted"))
    print(flights, *table, sep="\n")
    if arguments.markdown:
        count = len(kept.of("peers"))
        which = "first" if count == 1 else f"first {count}"
        peers_flew = f"The peers flew with the {which} of these seeds." if count else ""
        head = INTRO.format(
            flights=flights.replace("`turns`", "Scenarios `turns`", 1), start=START, worst=WORST, peers=peers_flew
        )
        arguments.markdown.write_text(head + "\n".join(table) + "\n" + NOTES)
    return 0


if __name__ == "__main__":
    sys.exit(main())
