"""Many flights at once: a run is flown, compared and forgotten; what stays is a flat row of figures per estimator.

    with local_pool(2) as pool:
        warm_up(pool, [scenario])
        for outcome in fly_all(pool, runs, ahead=4):
            ...

Workers are persistent and started afresh (spawn), so that they inherit nothing. Any executor of `concurrent.futures`
will do, a Dask cluster's too. Runs are made while others fly and outcomes come as they are ready: the memory of the
coordinator does not depend on their number. A worker that dies takes no run with it.
"""

import concurrent.futures as futures
import contextlib
import math
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import AhrsSimError, FlightError, InputError
from ahrs_sim.flight.ahead import end_with_parent
from ahrs_sim.scenario import Scenario

ATTEMPTS = 3
"""Workers that may die under a run before it counts as failed."""

WARM_S = 30.0
"""s of flight that touch every kernel: alignment takes 20."""


@dataclass(frozen=True)
class Span:
    """A part of a flight that is summarised by itself, too."""

    name: str
    steps: tuple[int, int] | None = None  # first and last step, numbered from 1, or ...
    times: tuple[float, float] = (0.0, math.inf)  # ... s
    skip: float = 0.0  # s left out at its beginning

    def within(self, begins: Mapping[int, float]) -> tuple[float, float]:
        """Find its first and last time, s, of when the steps of the flight began; empty if it was not reached."""
        low, high = self.times
        if self.steps is not None:
            low, high = begins.get(self.steps[0], math.inf), begins.get(self.steps[1] + 1, math.inf)
        return low + self.skip, high


@dataclass(frozen=True)
class Run:
    """A flight to be flown somewhere."""

    key: Any  # of the caller
    name: str  # of the scenario
    where: str  # its file, for messages
    data: Mapping[str, Any]  # its effective TOML
    log: str | None = None  # keep the whole log there
    band_s: float | None = None  # also the RMS error of every so many seconds
    code: tuple[str, ...] = ()  # from outside, that its estimators may run
    spans: tuple[Span, ...] = ()  # `SPAN.FIGURE` beside the figures of the whole flight, and `SPAN.MEASURE_worst_s`

    def scenario(self) -> Scenario:
        """Parse and check the scenario."""
        return scenarios.parse(dict(self.data), self.where, self.name, gate=scenarios.Gate(self.code))


@dataclass(frozen=True)
class Outcome:
    """Holds the result of a run: figures by estimator, or an error."""

    key: Any
    figures: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    error: str | None = None
    bad_input: bool = False  # the error is the user's, every such run will have it
    seconds: float = 0.0  # that it took


def fly(run: Run) -> Outcome:
    """Fly a run here and now and compare it; whatever goes wrong is in the outcome."""
    begun = time.perf_counter()
    return replace(_outcome(run), seconds=time.perf_counter() - begun)


def _outcome(run: Run) -> Outcome:
    try:
        scenario = run.scenario()
        return Outcome(run.key, _flown(scenario, run))
    except FlightError as error:
        return Outcome(run.key, error=str(error).partition("; the log")[0])
    except AhrsSimError as error:
        return Outcome(run.key, error=str(error), bad_input=isinstance(error, InputError))
    except Exception as error:  # one run must not end the others, whatever it has found
        return Outcome(run.key, error=f"{type(error).__name__}: {error}")


def _flown(scenario: Scenario, run: Run) -> dict[str, dict[str, Any]]:
    from ahrs_sim import pipeline
    from ahrs_sim.evaluation.accuracy import Accuracy

    accuracy = Accuracy([e.name for e in scenario.estimators], with_consistency=run.band_s is not None)
    pipeline.fly(scenario, Path(run.log) if run.log else None, accuracy=accuracy, force=True)
    result = accuracy.result(band_s=run.band_s)
    rows = {name: flat(values) for name, values in result["estimators"].items()}
    for span in run.spans:
        for name, values in accuracy.part(*span.within(accuracy.begins)).items():
            rows[name] |= flat(values, f"{span.name}.")
    return rows


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten the figures of one estimator to one name each: `tilt_rmse_deg`, `straight.tilt_rmse_deg`.

    None becomes NaN, what is neither a number nor a list of numbers is left out.
    """
    row: dict[str, Any] = {}
    for key, value in values.items():
        name = prefix + key
        if isinstance(value, Mapping):
            row |= flat(value, "" if key == "phases" else f"{name}.")
        elif value is None:
            row[name] = float("nan")
        elif isinstance(value, list):
            row[name] = [float("nan") if x is None else float(x) for x in value]
        elif isinstance(value, int | float) and not isinstance(value, bool):
            row[name] = float(value)
    return row


# ----------------------------------------------------------------------------------------------- executors


def workers_here() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass
class Pool:
    """An executor that can be made again when its workers have died."""

    make: Callable[[], futures.Executor]
    workers: int
    executor: futures.Executor = field(init=False)

    def __post_init__(self) -> None:
        self.executor = self.make()

    def renew(self) -> None:
        """Replace dead workers by new ones."""
        self.executor.shutdown(wait=False, cancel_futures=True)
        self.executor = self.make()


@contextlib.contextmanager
def local_pool(workers: int | None = None) -> Iterator[Pool]:
    """Start persistent processes on this machine, one per processor by default."""
    count = workers or workers_here()
    context = multiprocessing.get_context("spawn")
    pool = Pool(lambda: futures.ProcessPoolExecutor(count, mp_context=context, initializer=_start), count)
    try:
        yield pool
    except BaseException:
        _kill(pool.executor)  # nobody waits for the flights of an interrupted campaign
        raise
    finally:
        pool.executor.shutdown(wait=True, cancel_futures=True)


def _start() -> None:
    """Prepare a new worker: leave Ctrl-C to the coordinator, import heavy modules while the others start."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    from ahrs_sim import pipeline
    from ahrs_sim.review import compare

    assert pipeline
    assert compare


def _kill(executor: futures.Executor) -> None:
    for process in list((getattr(executor, "_processes", None) or {}).values()):
        process.terminate()


@contextlib.contextmanager
def dask_pool(address: str) -> Iterator[Pool]:
    """Connect to the workers of a Dask cluster.

    Raises:
        InputError: Dask is not installed, or nothing answers at `address`.
    """
    try:
        import distributed
    except ImportError:
        raise InputError("--scheduler needs Dask: pip install 'ahrs-sim[cluster]'") from None
    try:
        client: Any = distributed.Client(address, timeout="10s", set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {address}: no Dask scheduler there ({error}); start one") from None
    with client:
        count = max(1, sum(client.nthreads().values()))
        # Dask itself gives the runs of a lost worker to another one.
        yield Pool(lambda: client.get_executor(pure=False, retries=ATTEMPTS), count)


def pool(workers: int | None = None, scheduler: str | None = None) -> contextlib.AbstractContextManager[Pool]:
    """Start local processes, or connect to a cluster when there is a scheduler's address."""
    return dask_pool(scheduler) if scheduler else local_pool(workers)


# ----------------------------------------------------------------------------------------------- flying


def warm_up(pool: Pool, runs: Iterable[Run]) -> None:
    """Have every estimator of `runs` compiled once, spread over the workers, before all of them ask for it.

    The compiled kernels lie in a cache on disk; without this every worker would compile every kernel.

    Raises:
        InputError: a scenario, or an estimator's settings, cannot be flown at all.
    """
    short: list[Run] = []
    seen: set[str] = set()
    for run in runs:
        scenario = run.scenario()
        for estimator in scenario.estimators:
            method = estimator.settings["method"]
            if method not in seen:
                seen.add(method)
                duration = min(WARM_S, scenario.duration or WARM_S)
                alone = {**run.data, "estimator": {estimator.name: dict(estimator.settings)}, "duration_s": duration}
                if scenario.pilot_attitude not in ("truth", estimator.name):
                    alone["pilot"] = {}
                short.append(replace(run, key=len(short), data=alone, log=None, band_s=None))
    for outcome in fly_all(pool, short):
        if outcome.bad_input:
            raise InputError(str(outcome.error))


def fly_all(
    pool: Pool, runs: Iterable[Run], ahead: int | None = None, task: Callable[[Run], Outcome] = fly
) -> Iterator[Outcome]:
    """Fly runs on the workers of a pool.

    Args:
        pool: the workers.
        runs: taken one by one, `ahead` more than have come back.
        ahead: default two per worker, so that none waits for the coordinator.
        task: what a worker does with a run.

    Yields:
        Outcomes as they come.
    """
    todo = iter(runs)
    limit = ahead or 2 * pool.workers
    flying: dict[futures.Future[Outcome], Run] = {}
    suspects: list[Run] = []  # flew while a worker died: again, one at a time, to see whose fault it was
    deaths: dict[int, int] = {}

    def send(run: Run) -> None:
        try:
            flying[pool.executor.submit(task, run)] = run
        except BrokenProcessPool:  # died between two flights
            pool.renew()
            flying[pool.executor.submit(task, run)] = run

    while True:
        if suspects:
            if not flying:
                send(suspects.pop())
        else:
            while len(flying) < limit and (run := next(todo, None)) is not None:
                send(run)
        if not flying:
            return
        done, _ = futures.wait(flying, return_when=futures.FIRST_COMPLETED)
        dead: list[Run] = []
        for future in done:
            run = flying.pop(future)
            error = future.exception()
            if error is None:
                yield future.result()
            elif isinstance(error, BrokenProcessPool):
                dead.append(run)
            else:
                yield Outcome(run.key, error=f"{type(error).__name__}: {error}")
        if dead:
            dead += flying.values()
            flying.clear()
            pool.renew()
        for run in dead:
            deaths[id(run)] = deaths.get(id(run), 0) + 1
            if deaths[id(run)] < ATTEMPTS:
                suspects.append(run)
            else:
                yield Outcome(run.key, error=f"its worker died {ATTEMPTS} times (killed, out of memory, or a crash)")
