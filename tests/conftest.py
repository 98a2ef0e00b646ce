"""What all tests share."""

import pytest

LONGEST = (
    "test_check.py",
    "test_flights.py",
    "test_campaign.py",
    "test_emitter_paper.py",
    "test_sensor_long.py",
    "test_soak.py",
)
"""Files that take minutes, the longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files: workers take whole files, and the last one should not be alone with a long one."""
    rank = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))


@pytest.fixture(autouse=True)
def _exceptions_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the command line raise what is unforeseen, here and in its subprocesses, instead of reporting it."""
    monkeypatch.setenv("AHRS_SIM_DEBUG", "1")
