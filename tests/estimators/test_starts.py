"""Every start of the table in docs/replay.md: an attitude within seconds, and a flight that goes on from there."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import starts


@pytest.mark.parametrize("kind", starts.STARTS)
def test_start(kind: str) -> None:
    result = starts.run("ins21", kind, 2)
    stood = {"standing": float(kind.partition(" ")[2] or 0.0), "catapult": 3.0, "wandering": 20.0}.get(
        kind.split()[0], 0.0
    )
    assert max(result.first_s) <= (min(stood + 1.1, 20.1) if stood else 5.1)
    assert max(result.then) < 6.0
    assert max(result.rms) < 3.5
    assert max(result.last) < 1.0
