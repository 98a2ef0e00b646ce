"""What all tests share."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

import pytest

LONGEST = (
    "test_check.py",
    "test_closed_loop.py",
    "test_any_aircraft.py",
    "test_attitude_papers.py",
    "test_flights.py",
    "test_campaign.py",
    "test_kills.py",
    "test_fuzz.py",
    "test_bad_samples.py",
    "test_scenarios.py",
    "test_soak.py",
    "test_replay.py",
    "test_disks.py",
)
"""Files that take the longest, in this order."""


def pytest_configure(config: pytest.Config) -> None:
    """Compile the catalogue before the workers begin, when all tests run: each would compile most of it for itself."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if whole and getattr(config.option, "numprocesses", None) and not config.option.collectonly:
        subprocess.run([sys.executable, "-c", COMPILE], check=True)


COMPILE = """
import estimators
methods = [(method.name, {}) for method in estimators.describe() if method.own]
estimators.prepare(methods, lambda name, number, count: print(f"compiling {name}, {number} of {count}", flush=True))
"""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the exhaustive cases, and begin with the longest files.

    Workers take whole files, and the last one should not be alone with a long one.
    """
    if not os.environ.get("AHRS_SIM_EXHAUSTIVE"):
        beyond = [item for item in items if item.get_closest_marker("exhaustive")]
        config.hook.pytest_deselected(items=beyond)
        items[:] = [item for item in items if item not in beyond]
    rank = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))


@pytest.fixture(autouse=True)
def _exceptions_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the command line raise what is unforeseen, here and in its subprocesses, instead of reporting it."""
    monkeypatch.setenv("AHRS_SIM_DEBUG", "1")


class _BegunHere:
    """Stands for a flight in a process of its own: there is none, so that the pipeline opens one in this process."""

    def __init__(self, *_: Any) -> None: ...

    def ready(self) -> None: ...


@pytest.fixture(autouse=True)
def _flights_begin_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have `main(["fly", ...])` fly in this process: to start another takes longer than most flights of the tests.

    Commands in processes of their own fly as users do; tests/test_flights.py compares the bytes of both.
    """
    monkeypatch.setattr("ahrs_sim.flight.ahead.FlightAhead", _BegunHere)


class _Here(Executor):
    """Does what it is given at once, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        done: Future[Any] = Future()
        done.set_result(fn(*args, **kwargs))
        return done


@pytest.fixture
def pool_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a pool of one worker fly in this process; pools of more are of processes, as a user's are."""
    from ahrs_sim.runs import pool

    processes = pool.local_pool

    @contextlib.contextmanager
    def local_pool(workers: int | None = None) -> Iterator[pool.Pool]:
        if workers == 1:
            yield pool.Pool(_Here, 1)
        else:
            with processes(workers) as made:
                yield made

    monkeypatch.setattr(pool, "local_pool", local_pool)
