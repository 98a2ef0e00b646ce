"""Some kills in CI; two hundred by hand: `python tests/fuzz/kills.py --runs 200`."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")
@pytest.mark.long
def test_what_is_killed_loses_its_last_piece_at_most(capfd: pytest.CaptureFixture[str]) -> None:
    script = str(Path(__file__).parent / "kills.py")
    with capfd.disabled():  # the counts belong into the output
        done = subprocess.run(
            [sys.executable, script, "--runs", "10", "--seed", "3"], stdout=subprocess.PIPE, text=True
        )
        print(f"\n{done.stdout}", end="")
    assert done.returncode == 0, done.stdout
