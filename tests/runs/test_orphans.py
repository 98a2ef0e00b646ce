"""Workers end with their coordinator, however that ended."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

CODE = """
import sys, time
from ahrs_sim.runs import pool
if __name__ == "__main__":
    with pool.local_pool(2) as workers:
        jobs = [workers.executor.submit(time.sleep, s) for s in (0.0, 0.0, 60.0)]
        jobs[0].result(), jobs[1].result()
        print(*workers.executor._processes, flush=True)
        time.sleep(60)
"""


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
def test_idle_and_busy_workers_of_a_killed_coordinator_end_within_seconds(tmp_path: Path) -> None:
    script = tmp_path / "coordinator.py"
    script.write_text(CODE)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as coordinator:
        assert coordinator.stdout
        workers = [int(pid) for pid in coordinator.stdout.readline().split()]
        assert len(workers) == 2
        os.kill(coordinator.pid, signal.SIGKILL)
        until = time.monotonic() + 5.0
        while any(_runs(pid) for pid in workers) and time.monotonic() < until:
            time.sleep(0.05)
        assert not any(_runs(pid) for pid in workers)


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
