"""What all tests share."""

import os

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
