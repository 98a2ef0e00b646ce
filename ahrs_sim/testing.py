"""For the tests of whoever builds an estimator: fly a scenario, demand an accuracy. A pytest plugin.

    def test_my_estimator(fly_scenario):
        log = fly_scenario("circuit", duration=120, estimators={"mine": {"method": "my.module:Filter", "suite": "chr"}})
        assert_accuracy(log, {"mine": {"tilt_rmse_deg": 2.0, "straight.heading_p95_deg": 5.0}})

Installed with the package; everything heavy is imported when it is used.
"""

import fcntl
import hashlib
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest


def accuracy(log: str | Path) -> dict[str, dict[str, float]]:
    """Compute figures of every estimator in a log, by the names that `assert_accuracy` takes.

    Raises:
        InputError: there is no such log, or nothing in it to compare.
    """
    from ahrs_sim.review.compare import compare
    from ahrs_sim.runs.pool import flat

    return {name: flat(values) for name, values in compare(Path(log))["estimators"].items()}


def assert_accuracy(log: str | Path, limits: Mapping[str, Mapping[str, float]]) -> None:
    """Fail unless every figure is at most its limit; `availability` must be at least it.

    Args:
        log: of a flight.
        limits: by estimator and figure: `tilt_rmse_deg`, `heading_p95_deg`, `straight.roll_max_deg`, `availability`.

    Raises:
        AssertionError: naming every figure that does not hold, its value and its limit.
        InputError: the log cannot be compared.
    """
    __tracebackhide__ = True
    from ahrs_sim.errors import nearest

    found = accuracy(log)
    wrong = []
    for estimator, figures in limits.items():
        if estimator not in found:
            wrong.append(f"{estimator}: not in the log{nearest(estimator, found)}")
            continue
        for figure, limit in figures.items():
            value = found[estimator].get(figure)
            if value is None:
                wrong.append(f"{estimator}: no figure '{figure}'{nearest(figure, found[estimator])}")
            elif math.isnan(value):
                wrong.append(f"{estimator}: {figure} is not known (limit {limit:g})")
            elif value < limit if figure.endswith("availability") else value > limit:
                wrong.append(f"{estimator}: {figure} is {value:.4g}, limit {limit:g}")
    if wrong:
        raise AssertionError("\n".join([f"{log}:", *wrong]))


FlyScenario = Callable[..., Path]
"""`fly_scenario(scenario, *, duration=None, seed=None, estimators=())` gives the log's path."""


@pytest.fixture(scope="session")
def fly_scenario(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FlyScenario]:
    """Provide a function that flies a scenario into a log; the same flight is flown once a session, whichever worker.

    Its arguments: `scenario`, a name or a path; `duration` in s; `seed`; `estimators`, names as for `ahrs-sim fly
    --estimator`, or the tables of a scenario's `[estimator.NAME]` by name.
    """
    folder = _shared_folder(tmp_path_factory)

    def fly(
        scenario: str | Path,
        *,
        duration: float | None = None,
        seed: int | None = None,
        estimators: Sequence[str] | Mapping[str, Mapping[str, Any]] = (),
    ) -> Path:
        from ahrs_sim import pipeline
        from ahrs_sim.scenario import ANY, Gate, load, parse

        named = () if isinstance(estimators, Mapping) else estimators
        checked = load(str(scenario), seed=seed, duration=duration, estimators=named)
        if isinstance(estimators, Mapping):
            tables = {name: dict(settings) for name, settings in estimators.items()}
            checked = parse({**checked.data, "estimator": tables}, checked.where, checked.name, gate=Gate(ANY))
        key = hashlib.sha256(checked.toml().encode()).hexdigest()[:16]
        log = folder / f"{checked.name}-{key}.mcap"
        with (folder / f"{key}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # gone with its owner, if that dies
            if not log.exists():
                pipeline.fly(checked, log, force=True)
        return log

    yield fly


def _shared_folder(factory: pytest.TempPathFactory) -> Path:
    """Make the folder of a session's flights, which the workers of pytest-xdist share."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "flights"
    folder.mkdir(exist_ok=True)
    return folder
