"""The two minutes of flight that calibrate best: a search by the Cramer-Rao bound, and what they bring afterwards.

    python benchmarks/calibration_flight.py --search [--seconds 120] [--violent]
    python benchmarks/calibration_flight.py [--seeds 301..350] [--jobs 2]

The search begins in the air with the errors that the CHR grade states and adds, one after the other, the part that
lowers the bound (`ahrs-sim bound`, magnetometer and GNSS) of a plain flight afterwards most for each second it takes:
turns to both sides, slow and fast flight, doublets of every surface; with `--violent` rolls, a loop and a pull-up, too.
What it found is the manoeuvre `calibrate`. The plain flight is turns of 30 and 45 deg and straight stretches.

Tilt / heading of that flight, deg: 0.48 / 0.53 after nothing, 0.37 / 0.32 after 56 s, 0.36 / 0.31 after 108 s; with
rolls and a loop 0.36 / 0.32 after 34 s. Lower it cannot be made: a rotation that all three sensors have in common
(misalignments of half a degree each: 0.22 deg an axis, 0.31 in tilt) is one of the unit in the aircraft, and no flight
shows it.

Without `--search`: `ins-cal` on the circuit with and without `calibrate` after the first climb, same seeds, RMS of tilt
and heading from the end of that climb, and of `calibrate`, to the landing, GNSS alone; and the bound of the first seed.
"""

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

import estimators
from ahrs_sim import attitude, scenario
from ahrs_sim.chain import Chain, site
from ahrs_sim.evaluation import consistency, metrics
from ahrs_sim.evaluation.metrics import Measure
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.runs.bound import PHI, STEP_S, Model, Recursion
from ahrs_sim.sensors import make_suite

Step = Mapping[str, Any]
Before = tuple[np.ndarray, np.ndarray | None]  # covariance of the errors, and the attitude that it is of
AIDS = ("magnetometer", "gnss")
AIR = {"on_ground": False, "height_m": 120.0, "airspeed_mps": 20.0, "heading_deg": 320.0}

PARTS: dict[str, Step] = {
    **{f"turn {b:+d}": {"do": "turn", "bank_deg": float(b), "for_s": 10.0} for b in (-60, -45, -30, 30, 45, 60)},
    "slow": {"do": "straight", "airspeed_mps": 16.0, "for_s": 8.0},
    "fast": {"do": "straight", "airspeed_mps": 26.0, "for_s": 8.0},
    "aileron": {"do": "doublet", "surface": "aileron", "size": 0.5},
    "elevator": {"do": "doublet", "surface": "elevator", "size": 0.5},
    "rudder": {"do": "doublet", "surface": "rudder", "size": 0.5},
}
VIOLENT: dict[str, Step] = {
    "roll right": {"do": "roll"},
    "roll left": {"do": "roll", "through_deg": -360.0},
    "loop": {"do": "loop"},
    "pull up": {"do": "pull_up", "pitch_deg": 40.0},
}
AFTERWARDS: tuple[Step, ...] = (
    {"do": "straight", "for_s": 10.0},
    {"do": "turn", "bank_deg": 30.0, "for_s": 25.0},
    {"do": "straight", "for_s": 10.0},
    {"do": "turn", "bank_deg": -45.0, "for_s": 15.0},
    {"do": "straight", "for_s": 10.0},
)


def made(steps: Sequence[Step], seed: int = 1, **changed: Any) -> scenario.Scenario:
    """The circuit with other steps, CHR suite alone."""
    data = {**scenario.load("circuit").data, "step": [dict(s) for s in steps], "estimator": {}, **changed}
    data["suite"] = {"chr": data["suite"]["chr"]}
    return scenario.parse(data, "circuit", "circuit", seed=seed)


def matrix(q: np.ndarray) -> np.ndarray:
    """C_nb (3, 3) of a quaternion (4,)."""
    return attitude.to_nav(np.tile(q, (3, 1)), np.eye(3)).T


class Bounds:
    """The bound along trajectories that follow one another, CHR suite."""

    def __init__(self) -> None:
        what = made([{"do": "straight"}], start=AIR)
        self.flight = open_flight(what)
        self.place = site(self.flight.start_lla, what.epoch)
        start = np.array(self.place.lla)
        suite = make_suite(what.suites[0], seed=1, dt=self.flight.dt, epoch=what.epoch, start_lla=start)
        self.model = Model(suite, AIDS)
        self.rows = round(STEP_S / self.flight.dt)
        self.begun: Before = (np.diag(self.model.sigma**2), None)
        self.after = flown_alone(AFTERWARDS)

    def along(self, before: Before, truth: Truth) -> tuple[np.ndarray, Before]:
        """Sigmas of tilt and heading (n, 2), rad, and what is known and the attitude at the end."""
        P, q = before[0].copy(), before[1]
        if q is not None:  # flown apart: errors of attitude that stay in the body go on from the end of the part before
            turn = matrix(truth.q_nb[0]) @ matrix(q).T
            P[PHI : PHI + 3] = turn @ P[PHI : PHI + 3]
            P[:, PHI : PHI + 3] = P[:, PHI : PHI + 3] @ turn.T
        recursion = Recursion(self.model, self.place)
        recursion.P = P
        starts = range(0, len(truth) - self.rows + 1, self.rows)
        sigmas = np.array([recursion.step(truth[k : k + self.rows]) for k in starts])
        return sigmas, (recursion.P, truth.q_nb[starts[-1] + self.rows - 1])

    def afterwards(self, before: Before) -> tuple[float, float]:
        """RMS of the bound of tilt and heading (deg) of a plain flight that follows, from 10 s on."""
        sigmas, _ = self.along(before, self.after)
        tilt, heading = np.degrees(np.sqrt(np.mean(sigmas[round(10.0 / STEP_S) :] ** 2, axis=0)))
        return float(tilt), float(heading)


def flown_alone(steps: Sequence[Step], settled: float = 0.0) -> Truth:
    """The truth of steps flown from level flight, without the first `settled` seconds."""
    flight = open_flight(made(steps, start=AIR))
    blocks = []
    while len(truth := flight.fly(4000)):
        blocks.append(truth)
    if flight.error:
        raise SystemExit(f"{steps}: {flight.error}")
    return Truth.concatenate(blocks)[round(settled / flight.dt) :]


def search(seconds: float, parts: Mapping[str, Step]) -> list[str]:
    """Add the best part for its time until the time is over; each is flown from level flight and ends level."""
    before, after = {"do": "straight", "for_s": 3.0}, {"do": "straight", "airspeed_mps": 20.0, "for_s": 2.0}
    truths = {name: flown_alone([before, step, after], settled=3.0) for name, step in parts.items()}
    bounds = Bounds()
    known, took, chosen = bounds.begun, 0.0, list[str]()
    tilt, heading = bounds.afterwards(known)
    print(f"{'nothing':12s} {0:5.0f} s   {tilt:.3f} / {heading:.3f} deg afterwards", flush=True)
    while True:
        now = math.hypot(tilt, heading)
        tried = {}
        for name, truth in truths.items():
            lasts = float(truth.t[-1] - truth.t[0])
            if took + lasts <= seconds + 2.0:
                ends = bounds.along(known, truth)[1]
                found = bounds.afterwards(ends)
                tried[name] = (math.log(now / math.hypot(*found)) / lasts, lasts, found, ends)
        if not tried:
            return chosen
        best = max(tried, key=lambda name: tried[name][0])
        _, lasts, (tilt, heading), known = tried[best]
        took += lasts
        chosen.append(best)
        print(f"{best:12s} {took:5.0f} s   {tilt:.3f} / {heading:.3f} deg afterwards", flush=True)


def circuit(calibrated: bool) -> list[Step]:
    """The circuit's steps, with `calibrate` after the first climb or without."""
    steps = [dict(step) for step in scenario.load("circuit").data["step"]]
    climb = next(k for k, step in enumerate(steps) if step["do"] == "climb")
    return [*steps[: climb + 1], *([{"do": "calibrate"}] if calibrated else []), *steps[climb + 1 :]]


def flown(seed: int, calibrated: bool, dual: bool) -> list[float]:
    """Tilt and heading RMS (deg) and NEES per degree of freedom of `ins-cal` from the climb, or `calibrate`, on."""
    what = made(circuit(calibrated), seed)
    flight = open_flight(what)
    place = site(flight.start_lla, what.epoch)
    suite = make_suite(what.suites[0], seed=seed, dt=flight.dt, epoch=what.epoch, start_lla=np.array(place.lla))
    chain = Chain(suite, {})
    estimator: Any = estimators.create("ins-cal", site=place, sensors=suite.info, heading_aid=dual)
    last = "(calibrate) ends" if calibrated else "(climb) ends"
    begun, rows, errors, squares = math.inf, [], [], []
    while len(truth := flight.fly(2000)):
        begun = min([begun, *(e.t for e in flight.take_events() if e.text.endswith(last))])
        estimates = estimator.process(chain.assemble(chain.sense(truth)))
        rows.append(estimates)
        reference = metrics.interpolate(truth.t, truth.q_nb, estimates.t)
        errors.append(metrics.attitude_errors(estimates.q_nb, estimates.down_b, reference))
        squares.append(consistency.attitude_nees(estimates.q_nb, estimates.att_cov, reference))
    if flight.error:
        raise SystemExit(f"seed {seed}: {flight.error}")
    after = np.concatenate([e.t for e in rows]) > begun
    error = np.concatenate(errors)[after]
    tilt, heading = (float(np.degrees(np.sqrt(np.nanmean(error[:, m] ** 2)))) for m in (Measure.TILT, Measure.HEADING))
    return [tilt, heading, float(np.nanmean(np.concatenate(squares)[after])) / 3.0]


def measure(seeds: Sequence[int], dual: bool, jobs: int) -> None:
    """Print what `ins-cal` makes of the circuit after `calibrate` and without, and the bound."""
    for calibrated in (False, True):
        with ProcessPoolExecutor(jobs) as pool:
            found = np.array(list(pool.map(flown, seeds, [calibrated] * len(seeds), [dual] * len(seeds))))
        tilt, heading = np.sqrt(np.mean(found[:, :2] ** 2, axis=0))
        worst, nees = found[:, 0].max() / tilt, found[:, 2].mean()
        name = "after calibrate" if calibrated else "without"
        print(f"{name:16s} {tilt:.2f} / {heading:.2f} deg, worst seed {worst:.2f}, NEES {nees:.2f}", flush=True)


def main() -> int:
    """Search, or measure what the manoeuvre brings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--search", action="store_true", help="look for the sequence by the bound")
    parser.add_argument("--seconds", type=float, default=120.0, help="that the sequence may take")
    parser.add_argument("--violent", action="store_true", help="with rolls, loops and pull-ups")
    parser.add_argument("--seeds", default="301..350", help="FIRST..LAST")
    parser.add_argument("--two-antennas", action="store_true", help="with the heading of two GNSS antennas, too")
    parser.add_argument("--jobs", type=int, default=2, help="flights at the same time")
    arguments = parser.parse_args()
    if arguments.search:
        found = search(arguments.seconds, {**PARTS, **(VIOLENT if arguments.violent else {})})
        print(", ".join(found))
        return 0
    first, _, last = arguments.seeds.partition("..")
    measure(range(int(first), int(last or first) + 1), arguments.two_antennas, arguments.jobs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
