"""What calibration states bring: `ins-cal` on held-out seeds, filtered and smoothed, and without each group of states.

    python benchmarks/calibration.py [--seeds 101..150] [--ablation 6] [--jobs 2] [--markdown docs/calibration.md]

Flies `turns` and `circuit` (30 and 45 deg of bank) in 5 m/s of wind and light turbulence, senses each flight once, and
runs every variant on the same samples. A group of states is left out by a sigma of zero in the data sheet; nothing else
is changed, so NEES says what the filter then does not know. Figures are RMS over flights from 80 s on.
"""

import argparse
import dataclasses
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import estimators
from ahrs_sim import scenario
from ahrs_sim.chain import Chain, site
from ahrs_sim.evaluation import consistency, metrics
from ahrs_sim.evaluation.metrics import Measure
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.sensors import make_suite
from estimators.navigator.smoother import smooth
from estimators.types import Estimates, Samples, SensorInfo, Site

SCENARIOS, SUITES, START, BLOCK_S, WORST = ("turns", "circuit"), ("chr", "sbg"), 80.0, 5.0, 1.6

# name: dual antenna, goals by suite (tilt, heading; deg); None: no goal
ROWS: dict[str, tuple[bool, tuple[Any, Any]]] = {
    "`ins-cal`": (False, ((0.42, 0.36), (0.14, 0.20))),
    "`ins-cal` and dual antenna": (True, ((0.35, 0.20), None)),
    "`ins-cal` smoothed": (False, ((0.40, 0.30), None)),
    "`ins-cal` and dual antenna, smoothed": (True, ((0.26, 0.14), None)),
}

GROUPS: dict[str, dict[str, Any]] = {
    "all": {},
    "without the gyro's matrix": {"gyro_scale_factor": 0.0, "gyro_misalignment": 0.0},
    "without the accelerometer's matrix": {"accel_scale_factor": 0.0, "accel_misalignment": 0.0},
    "without the magnetometer's matrix": {"mag_scale_factor": 0.0, "mag_misalignment": 0.0, "soft_iron": 0.0},
    "without hard iron": {"mag_bias": 0.0, "mag_wander": 0.0},
    "without the field's own error": {"field_error": (0.0, 0.0, 0.0)},
    "without the walk of biases": {"gyro_drift": 0.0, "accel_drift": 0.0, "accel_instability": 0.0},
}
GROUPS["without any of the matrices"] = {
    key: value for name, group in GROUPS.items() if "matrix" in name for key, value in group.items()
}


def sensed(name: str, seed: int) -> tuple[Truth, dict[str, tuple[Samples, SensorInfo]], Site]:
    """Fly once; samples of each suite."""
    known = scenario.load(name).data
    for key in ("catalogue", "estimator"):
        known.pop(key, None)
    data = known | {"wind": known["wind"] | {"speed_mps": 5.0, "at_20ft_mps": 5.0}}
    what = scenario.parse(data, name, name, seed=seed)
    flight = open_flight(what)
    place = site(flight.start_lla, what.epoch)
    chains = {
        s.name: Chain(make_suite(s, seed=seed, dt=flight.dt, epoch=what.epoch, start_lla=np.array(place.lla)), {})
        for s in what.suites
        if s.name in SUITES
    }
    truths, samples = [], {suite: [] for suite in chains}
    while len(truth := flight.fly(max(1, round(BLOCK_S * what.rate)))):
        every = max(1, round(what.rate / 100.0))
        truths.append(truth[::every])
        for suite, chain in chains.items():
            samples[suite].append(chain.assemble(chain.sense(truth)))
    whole = {suite: (Samples.concatenate(samples[suite]), chain.suite.info) for suite, chain in chains.items()}
    return Truth.concatenate(truths), whole, place


def figures(estimates: Estimates, truth: Truth) -> list[float]:
    """Tilt and heading RMS (deg), NEES and NIS per degree of freedom."""
    rows = (estimates.t >= START) & (estimates.t <= truth.t[-1])
    q, reference = estimates.q_nb[rows], metrics.interpolate(truth.t, truth.q_nb, estimates.t[rows])
    errors = metrics.attitude_errors(q, estimates.down_b[rows], reference)
    tilt, heading = (np.degrees(np.sqrt(np.mean(errors[:, m] ** 2))) for m in (Measure.TILT, Measure.HEADING))
    nees = np.nanmean(consistency.attitude_nees(q, estimates.att_cov[rows], reference)) / 3.0
    squares, freedom = consistency.nis(estimates.innovation[rows], estimates.innovation_var[rows])
    return [float(tilt), float(heading), float(nees), float(np.nansum(squares) / max(np.nansum(freedom), 1.0))]


def flight(name: str, seed: int, ablation: bool) -> dict[str, list[float]]:
    """Figures of a flight by suite and variant."""
    truth, whole, place = sensed(name, seed)
    found = {}
    for suite, (samples, sheet) in whole.items():
        for dual in (False, True):
            estimator: Any = estimators.create("ins-cal", site=place, sensors=sheet, heading_aid=dual)
            plain, smoothed = (row for row, (antenna, _) in ROWS.items() if antenna == dual)
            found[f"{suite} {plain}"] = figures(estimator.process(samples), truth)
            found[f"{suite} {smoothed}"] = figures(smooth(estimator, samples), truth)
        for group, changed in GROUPS.items() if ablation and suite == "chr" else ():
            without = dataclasses.replace(sheet, **changed)
            estimator = estimators.create("ins-cal", site=place, sensors=without, heading_aid=False)
            found[f"{suite} {group}"] = figures(estimator.process(samples), truth)
    return found


def rms(values: Any) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def lines(flown: dict[int, list[dict[str, list[float]]]]) -> list[str]:
    """The tables, markdown."""
    made = []
    for k, suite in enumerate(SUITES):
        made += ["", f"## {suite.upper()} grade", "", "| | tilt / heading | goal | worst seed | NEES | NIS | better |"]
        made += ["|---|---|---|---|---|---|---|"]
        for row, (_, goals) in ROWS.items():
            key = f"{suite} {row}"
            all_ = np.array([f[key] for flights in flown.values() for f in flights])
            by_seed = [rms([f[key][0] for f in flights]) for flights in flown.values()]
            goal = "" if goals[k] is None else f"{goals[k][0]:g} / {goals[k][1]:g}"
            better = ""
            if "smoothed" in row:
                plain = key.replace(", smoothed", "").replace(" smoothed", "")
                before = [rms([f[plain][0] for f in flights]) for flights in flown.values()]
                better = f"{sum(a < b for a, b in zip(by_seed, before, strict=True))} of {len(before)} seeds"
            tilt, heading, nees, nis = rms(all_[:, 0]), rms(all_[:, 1]), all_[:, 2].mean(), all_[:, 3].mean()
            made.append(
                f"| {row} | {tilt:.2f} / {heading:.2f} | {goal} | {max(by_seed) / tilt:.2f} | {nees:.2f} | {nis:.2f} "
                f"| {better} |"
            )
    rows = [f for flights in flown.values() for f in flights if "chr all" in f]
    if rows:
        made += ["", "## What each group of states brings", ""]
        made += [f"CHR, GNSS alone, {len(rows)} flights.", "", "| | tilt / heading | NEES |", "|---|---|---|"]
        for group in GROUPS:
            found = np.array([f[f"chr {group}"] for f in rows])
            made.append(f"| {group} | {rms(found[:, 0]):.2f} / {rms(found[:, 1]):.2f} | {found[:, 2].mean():.1f} |")
    return made


HEAD = """# The navigator that calibrates its sensors

Made by `python benchmarks/calibration.py --markdown docs/calibration.md`; do not edit.

{flights}. RMS over flights from 80 s on, tilt / heading in degrees; "worst seed" is the tilt of the worst
seed over that RMS (goal: {worst} at most). NEES and NIS are means per degree of freedom, 1 for a consistent filter.
"""


def main() -> int:
    """Fly, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="101..150", help="FIRST..LAST")
    parser.add_argument("--ablation", type=int, default=6, help="seeds that fly without each group of states as well")
    parser.add_argument("--jobs", type=int, default=2, help="flights at the same time")
    parser.add_argument("--markdown", type=Path, help="write the page there")
    arguments = parser.parse_args()
    first, _, last = arguments.seeds.partition("..")
    seeds = range(int(first), int(last or first) + 1)
    flown: dict[int, list[dict[str, list[float]]]] = {}
    with ProcessPoolExecutor(arguments.jobs) as pool:
        waiting = [
            (seed, pool.submit(flight, name, seed, k < arguments.ablation))
            for k, seed in enumerate(seeds)
            for name in SCENARIOS
        ]
        for n, (seed, done) in enumerate(waiting):
            flown.setdefault(seed, []).append(done.result())
            if n % len(SCENARIOS) == len(SCENARIOS) - 1:
                print(f"seeds {seeds[0]} to {seed}", *lines(flown), sep="\n", file=sys.stderr, flush=True)
    flights = f"Scenarios `turns` and `circuit`, whole flights, wind 5 m/s, seeds {seeds[0]} to {seeds[-1]}"
    print(flights, *lines(flown), sep="\n")
    if arguments.markdown:
        arguments.markdown.write_text(HEAD.format(flights=flights, worst=WORST) + "\n".join(lines(flown)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
