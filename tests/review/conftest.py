"""One short flight for all reviews."""

from pathlib import Path

import pytest

from ahrs_sim.review.traces import FlightTraces, gather
from ahrs_sim.testing import FlyScenario


@pytest.fixture(scope="session")
def flown(fly_scenario: FlyScenario) -> Path:
    """A log of a minute and a half: standing, take-off, climb; two estimators."""
    return fly_scenario("circuit", duration=90.0, estimators=["ekf-chr", "ekf-sbg"])


@pytest.fixture(scope="session")
def traces(flown: Path) -> FlightTraces:
    return gather(flown)
