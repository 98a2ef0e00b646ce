"""One short flight for all reviews."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from ahrs_sim import pipeline, scenario
from ahrs_sim.review.traces import FlightTraces, gather


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A log of a minute and a half: standing, take-off, climb; two estimators."""
    path = tmp_path_factory.mktemp("review") / "short.mcap"
    estimators = ["ekf-chr", "ekf-sbg"]
    pipeline.fly(scenario.load("circuit", duration=90.0, estimators=estimators), path)
    yield path


@pytest.fixture(scope="session")
def traces(flown: Path) -> FlightTraces:
    return gather(flown)
