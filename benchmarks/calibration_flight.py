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

Without `--search`: what it brings. A unit (its seed) flies `calibration`, `ahrs-sim calibrate` makes a correction of
what `ins-cal` has learnt, and the circuit is flown on another day (another seed: noise, turn-on biases, field) with
that unit as it comes and corrected, GNSS alone; RMS from 80 s on. `benchmarks/turns_accuracy.py --calibrations N` puts
the table into docs/accuracy.md.
"""

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import turns_accuracy

import estimators
from ahrs_sim import attitude, scenario
from ahrs_sim.chain import site
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.runs.bound import PHI, STEP_S, Model, Recursion
from ahrs_sim.runs.calibrate import calibrate
from ahrs_sim.runs.log_tuning import Recorded
from ahrs_sim.sensors import make_suite
from ahrs_sim.sensors.correction import Correction
from estimators.types import SensorInfo

SUITE, METHODS, GOAL, START, OTHER_DAY = "chr", ("ins21", "ins-cal"), (0.3, 0.3), 80.0, 1000
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


def flown(seed: int) -> dict[str, dict[str, float | None]]:
    """Figures of the navigators on the circuit of a unit, as it comes and corrected after its calibration flight."""
    known = scenario.load("calibration").data | {"estimator": {}}
    _, sent = turns_accuracy.sensed(scenario.parse(known, "calibration", "calibration", seed=seed), (SUITE,))
    one = sent[SUITE]
    settings = {"heading_aid": False}
    found = calibrate(Recorded(one.samples, one.place, one.sheet, "ins-cal", settings), "calibration")
    known = scenario.load("circuit").data | {"estimator": {}}
    known["suite"] = {SUITE: known["suite"][SUITE] | {"unit_seed": seed}}
    what = scenario.parse(known, "circuit", "circuit", seed=seed + OTHER_DAY)
    truth, sent = turns_accuracy.sensed(what, (SUITE,))
    figures = {}
    for name, one in (("as it comes", sent[SUITE]), ("corrected", corrected(sent[SUITE], found.correction))):
        for method in METHODS:
            estimator: Any = estimators.create(method, site=one.place, sensors=one.sheet, **settings)
            made, plain = estimator.process(one.samples), method == "ins-cal"
            figures[f"{method} {name}"] = turns_accuracy.figures_of(made, truth, one, START, math.inf, plain)
    return figures


def corrected(one: turns_accuracy.Sensed, unit: Correction) -> turns_accuracy.Sensed:
    """What the same unit would have sent with the correction, and its data sheet then."""
    samples = replace(
        one.samples,
        gyro_b=unit.gyro.applied(one.samples.gyro_b),
        accel_b=unit.accelerometer.applied(one.samples.accel_b),
        mag_b=unit.magnetometer.applied(one.samples.mag_b),
    )
    return replace(one, samples=samples, sheet=SensorInfo(**unit.sheet(asdict(one.sheet))))


def lines(flights: dict[int, list[dict[str, Any]]]) -> list[str]:
    """The table of what `flown` gave by seed, markdown; nothing when none has flown."""
    if not flights:
        return []
    made = ["", "## After a calibration flight, CHR grade", ""]
    which = f"Units {min(flights)} to {max(flights)}, the circuit on another day, GNSS alone; "
    made += [which + "`ahrs-sim fly calibration`, then `ahrs-sim calibrate`.", ""]
    made += ["| | tilt / heading | goal | worst unit | NEES | |", "|---" * 6 + "|"]
    for method in METHODS:
        for name in ("as it comes", "corrected"):
            found = turns_accuracy.summary(flights, f"{method} {name}")
            if found is None:
                continue
            goal = f"{GOAL[0]:g} / {GOAL[1]:g}" if name == "corrected" else ""
            missed = [a for a, x, most in zip(("tilt", "heading"), found[:2], GOAL, strict=True) if x > most]
            met = "" if not goal else "missed: " + ", ".join(missed) if missed else "met"
            cells = f"{found[0]:.2f} / {found[1]:.2f}", goal, f"{found[2]:.2f}", f"{found[3]:.2f}", met
            made.append(f"| `{method}`, unit {name} | {' | '.join(cells)} |")
    return made


def main() -> int:
    """Search, or measure what the manoeuvre brings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--search", action="store_true", help="look for the sequence by the bound")
    parser.add_argument("--seconds", type=float, default=120.0, help="that the sequence may take")
    parser.add_argument("--violent", action="store_true", help="with rolls, loops and pull-ups")
    parser.add_argument("--seeds", default="301..350", help="FIRST..LAST, of the units")
    parser.add_argument("--jobs", type=int, default=2, help="flights at the same time")
    arguments = parser.parse_args()
    if arguments.search:
        found = search(arguments.seconds, {**PARTS, **(VIOLENT if arguments.violent else {})})
        print(", ".join(found))
        return 0
    first, _, last = arguments.seeds.partition("..")
    seeds = range(int(first), int(last or first) + 1)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        flights = {seed: [found] for seed, found in zip(seeds, pool.map(flown, seeds), strict=True)}
    print(*lines(flights), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
