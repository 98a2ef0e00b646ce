"""`ahrs-sim campaign`: hundreds of flights of one scenario with varied seeds and values, as a Parquet data set.

    plan = Plan.make(scenario, runs=200, vary=["wind.speed_mps=uniform:0..8"])
    store = Store("out")
    with pool.local_pool(2) as processes:
        fly(plan, store, processes)
    print(campaign_report.text(campaign_report.make(store)))

Run k is the scenario with seed `seed + k` and values that depend on the campaign's seed, the key and k alone, so every
run can be flown again by itself, in any order, on any machine. Of a run one row per estimator is kept:

    run, seed             which flight
    vary.KEY              the values it had
    estimator             null when the run failed
    error                 why it failed, else null
    FIGURE, PHASE.FIGURE  what `compare` says: tilt_rmse_deg, straight.heading_p95_deg, ...; NaN: not known
    nees, nis             means per degree of freedom
    bands.tilt, .heading  RMSE (deg) of every `band_s` since the start, as lists

Files are only ever added, each whole or not at all; a campaign that was stopped goes on where its files end.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from ahrs_sim.errors import InputError
from ahrs_sim.runs import pool as flights
from ahrs_sim.runs.campaign_plan import Plan as Plan
from ahrs_sim.runs.campaign_store import Store as Store
from ahrs_sim.runs.pool import Outcome, Pool, Run
from ahrs_sim.scenario import Gate, Scenario, parse

_FOREIGN = Gate()
BATCH_RUNS, BATCH_S = 100, 20.0
"""A file is written after so many runs or seconds: what a kill can cost."""


def flown(plan: Plan, store: Store) -> int:
    """Count the runs of a plan that are in its store.

    Raises:
        InputError: the store holds a different campaign.
    """
    store.check(plan)
    return len(store.done().intersection(range(plan.runs)))


def fly(plan: Plan, store: Store, pool: Pool, progress: Callable[[int, int], None] = lambda done, all_: None) -> int:
    """Fly what is missing of a campaign into its store.

    Args:
        plan: what to fly.
        store: where the rows go; rows that are there are not flown again.
        pool: the workers.
        progress: called with the number of runs done and of all.

    Returns:
        How many runs were flown now.

    Raises:
        InputError: the store holds a different campaign, or no run can be flown as the scenario is.
    """
    store.check(plan)
    done = store.done()
    missing = [k for k in range(plan.runs) if k not in done]
    of = plan.values()
    if missing:
        flights.warm_up(pool, [plan.run(missing[0], of(missing[0]))])
    store.begin(plan)  # a plan of which no run can be flown leaves nothing
    if not missing:
        return 0
    number = 1 + max((int(name[5:-8]) for name in store.files()), default=-1)
    waiting: list[Outcome] = []
    written = time.monotonic()
    try:
        for count, outcome in enumerate(flights.fly_all(pool, (plan.run(k, of(k)) for k in missing)), 1):
            waiting.append(outcome)
            progress(plan.runs - len(missing) + count, plan.runs)
            if len(waiting) >= BATCH_RUNS or time.monotonic() - written > BATCH_S:
                batch, waiting = waiting, []
                store.add(number, batch, plan)
                number, written = number + 1, time.monotonic()
    finally:  # an interrupt keeps what has been flown
        if waiting:
            store.add(number, waiting, plan)
    return len(missing)


def keep_logs(plan: Plan, numbers: Sequence[int], folder: Path, pool: Pool) -> Iterator[tuple[int, Path, str | None]]:
    """Fly runs once more into logs: cheaper than keeping all of them, and the same to the byte.

    Yields:
        Number of the run, its log and what went wrong.
    """
    folder.mkdir(parents=True, exist_ok=True)
    of = plan.values()

    def again() -> Iterator[Run]:
        for k in numbers:
            run = plan.run(k, of(k))
            yield replace(run, band_s=None, log=str((folder / f"run-{k:06d}.mcap").absolute()))

    for outcome in flights.fly_all(pool, again()):
        yield outcome.key, folder / f"run-{outcome.key:06d}.mcap", outcome.error


def scenario_of(place: str, number: int, gate: Gate = _FOREIGN) -> Scenario:
    """Read the scenario of one run of a campaign, as it was flown; its code from outside runs as `gate` allows.

    Raises:
        InputError: no campaign there, or no such run in it.
    """
    plan = replace(Store(place).plan(), code=gate.allowed)
    if not 0 <= number < plan.runs:
        raise InputError(f"{place}: --run {number}: its runs are 0 to {plan.runs - 1}")
    run = plan.run(number)
    return parse(dict(run.data), run.where, run.name, gate=gate)
