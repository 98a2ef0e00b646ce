"""Fly for a day: estimators must not drift away, covariances stay positive, memory stay flat.

    python benchmarks/day_flight.py                    # 24 h of motion from a formula
    python benchmarks/day_flight.py --truth jsbsim     # of the trainer in JSBSim, circling
    python benchmarks/day_flight.py --hours 2

Prints a line an hour: RMS of tilt and heading errors (deg), share of samples that are RUNNING, the least eigenvalues of
the attitude covariance (rad2) and of the whole state's correlations, and memory. Low-cost suite; `ins21`, `ckf-air`.

The motion ends some 130 km from where it started. `ckf-air`, which has no GNSS, keeps the magnetic field of the start:
the dip changes by a degree on the way and its tilt error with it. The trainer circles one place, and shows no such
growth.
"""

import argparse
import math
import re
import sys
import time
from pathlib import Path

import numpy as np

from ahrs_sim.chain import Chain, site
from ahrs_sim.evaluation.evaluator import Comparison, Evaluator
from ahrs_sim.evaluation.metrics import Measure
from ahrs_sim.flight import open_flight
from ahrs_sim.scenario import create_estimator, parse
from ahrs_sim.sensors import make_suite
from estimators import Status

IMU_HZ = 50.0
BLOCK_S = 60.0
ESTIMATORS = {"ins21": {"method": "ins21"}, "ckf-air": {"method": "marg-ckf", "aiding": "airspeed"}}

TRUTH = {
    # Turns of up to 30 deg of bank to one side for half an hour, then to the other, a minute of level flight between.
    "motion": {
        "rate_hz": 100.0,
        "motion": {"kind": "weave", "period_s": 3600.0, "straight_s": 60.0},
    },
    "jsbsim": {
        "rate_hz": 200.0,
        "start": {"on_ground": False, "height_m": 300.0, "airspeed_mps": 20.0},
        "step": [
            step
            for _ in range(200)
            for step in (
                {"do": "straight", "for_s": 60.0},
                {"do": "turn", "bank_deg": -30.0, "for_s": 400.0},
                {"do": "turn", "bank_deg": 20.0, "for_s": 400.0},
            )
        ],
    },
}


def memory_mb() -> float:
    """Memory of this process now, MB."""
    found = re.search(r"VmRSS:\s+(\d+)", Path("/proc/self/status").read_text())
    return int(found[1]) / 1024 if found else math.nan


class Hour:
    """What has been seen of an estimator since the last line."""

    def __init__(self) -> None:
        self.squares = np.zeros(2)
        self.samples = self.running = self.diverged = 0
        self.least = math.inf  # eigenvalue of the attitude covariance

    def add(self, comparison: Comparison) -> None:
        """Add a block of estimates with their errors."""
        estimates, errors = comparison.estimates, comparison.errors()
        two = np.degrees(errors[:, [Measure.TILT, Measure.HEADING]])
        self.squares += np.nansum(two**2, axis=0)
        self.samples += len(estimates)
        self.running += int((estimates.status == Status.RUNNING).sum())
        self.diverged += int((estimates.status == Status.DIVERGED).sum())
        some = estimates.att_cov[::50]
        some = some[np.isfinite(some).all(axis=(1, 2))]
        if len(some):
            self.least = min(self.least, float(np.linalg.eigvalsh(some).min()))


def fly(truth: str, hours: float) -> bool:
    """Fly and print; returns whether nothing diverged and every covariance stayed positive."""
    suite = {"grade": "chr_6dm", "rate_hz": IMU_HZ, "magnetometer": {"rate_hz": IMU_HZ}, "air_data": {"rate_hz": 25.0}}
    tables = {name: {**settings, "suite": "chr"} for name, settings in ESTIMATORS.items()}
    data = {**TRUTH[truth], "duration_s": hours * 3600.0, "suite": {"chr": suite}, "estimator": tables}
    scenario = parse(data, "day", "day")
    flight = open_flight(scenario)
    place = site(flight.start_lla, scenario.epoch)
    made = make_suite(
        scenario.suites[0], seed=1, dt=flight.dt, epoch=scenario.epoch, start_lla=np.array(place.lla), faults=()
    )
    chain = Chain(made, {e.name: create_estimator(e, place, made.info) for e in scenario.estimators})
    seen = {name: Hour() for name in chain.estimators}
    evaluator = Evaluator(lambda name, comparison: seen[name].add(comparison))
    good, hour, begun, t = True, 0, time.monotonic(), 0.0

    def report() -> bool:
        sound = True
        for name, found in seen.items():
            tilt, heading = np.sqrt(found.squares / max(found.samples, 1))
            covariance = chain.estimators[name].state()["filter"]["P"]
            spread = np.sqrt(np.diag(covariance))
            least = float(np.linalg.eigvalsh(covariance / np.outer(spread, spread)).min())
            print(
                f"{t / 3600:5.1f} h  {name:8s} tilt {tilt:5.2f}  heading {heading:5.2f}  "
                f"running {100 * found.running / max(found.samples, 1):5.1f} %  diverged {found.diverged}  "
                f"least {found.least:.1e}, {least:.1e}  {memory_mb():.0f} MB  {time.monotonic() - begun:.0f} s",
                flush=True,
            )
            sound &= found.diverged == 0 and found.least > 0.0 and least > 0.0
            seen[name] = Hour()
        return bool(sound)

    while len(block := flight.fly(round(BLOCK_S / flight.dt))):
        t = float(block.t[-1])
        evaluator.add_reference(block.t, block.q_nb)
        for name, estimates in chain.estimate(chain.assemble(chain.sense(block))):
            evaluator.add(name, estimates)
        flight.take_setpoints()
        flight.take_events()
        chain.take_events()
        if t >= 3600.0 * (hour + 1):
            hour += 1
            good &= report()
    good &= report() if any(found.samples for found in seen.values()) else True
    if flight.error:
        print(flight.error)
    return good and not flight.error


def main() -> int:
    """Fly; returns 1 when something diverged."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--truth", choices=list(TRUTH), default="motion")
    arguments = parser.parse_args()
    return 0 if fly(arguments.truth, arguments.hours) else 1


if __name__ == "__main__":
    sys.exit(main())
