"""What all tests share."""

import pytest


@pytest.fixture(autouse=True)
def _exceptions_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the command line raise what is unforeseen, here and in its subprocesses, instead of reporting it."""
    monkeypatch.setenv("AHRS_SIM_DEBUG", "1")
