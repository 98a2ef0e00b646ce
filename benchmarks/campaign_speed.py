"""What a campaign costs: a warm flight, its overhead, a second worker, and the coordinator's memory.

    python benchmarks/campaign_speed.py [--flights 50]

The flight is 120 s of the circuit with four estimators. Overhead and memory are measured with runs that answer at once
with the figures of a real one, so that nothing but sending, receiving and writing is left.
"""

import argparse
import functools
import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Callable

from ahrs_sim import scenario
from ahrs_sim.runs import campaign, campaign_report
from ahrs_sim.runs import pool as runs
from ahrs_sim.runs.campaign import Plan, Store
from ahrs_sim.runs.pool import Outcome, Run

DURATION = 120.0


@functools.cache
def _figures() -> dict[str, dict[str, object]]:
    """Of a real flight, flown once in each worker."""
    plan = Plan.make(scenario.load("circuit", duration=30.0), 1)
    return dict(_fly(plan.run(0)).figures)


_fly = runs.fly


def echo(run: Run) -> Outcome:
    """A run without the flight."""
    return Outcome(run.key, _figures())


def flown(count: int, workers: int) -> float:
    """Seconds from the first run sent to the last result, workers warm."""
    plan = Plan.make(scenario.load("circuit", duration=DURATION), count)
    with runs.local_pool(workers) as pool:
        runs.warm_up(pool, [plan.run(0)] * workers)
        begun = time.perf_counter()
        failed = [o.error for o in runs.fly_all(pool, (plan.run(k) for k in range(count))) if o.error]
        assert not failed, failed[0]
        return time.perf_counter() - begun


def answered(count: int, report: Callable[[float, float], None]) -> None:
    """Seconds a run and MB of a coordinator whose runs answer at once."""
    runs.fly = echo
    plan = Plan.make(scenario.load("circuit", duration=DURATION), count, ["wind.speed_mps=uniform:0..8"])
    with tempfile.TemporaryDirectory() as folder, runs.local_pool(1) as pool:
        store = Store(folder)
        list(runs.fly_all(pool, (plan.run(0) for _ in range(3))))  # the workers' own flight
        begun = time.perf_counter()
        campaign.fly(plan, store, pool)
        took = time.perf_counter() - begun
        campaign_report.make(store)
    report(took / count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def _child(count: int, pipe: "multiprocessing.connection.Connection") -> None:
    answered(count, lambda *result: pipe.send(result))


def apart(count: int) -> tuple[float, float]:
    """`answered` in a process of its own: the peak of memory never falls."""
    mine, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_child, args=(count, theirs))
    process.start()
    result: tuple[float, float] = mine.recv()
    process.join()
    return result


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=50)
    arguments = parser.parse_args()
    one, two = flown(arguments.flights, 1), flown(arguments.flights, 2)
    print(f"{arguments.flights} flights of {DURATION:.0f} s, four estimators")
    print(f"  one worker   {one:7.1f} s, {one / arguments.flights:.3f} s a flight")
    print(f"  two workers  {two:7.1f} s, {two / arguments.flights:.3f} s a flight: {one / two:.2f} x")
    print(f"  1000 flights on two workers: {1000 * two / arguments.flights / 60:.1f} min")
    few, many = apart(200), apart(2000)
    print(f"overhead of a run {1000 * many[0]:.1f} ms: {100 * many[0] / (one / arguments.flights):.1f} % of a flight")
    print(f"memory of the coordinator with its report: 200 runs {few[1]:.0f} MB, 2000 runs {many[1]:.0f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
