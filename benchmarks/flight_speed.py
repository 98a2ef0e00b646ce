"""What a whole flight costs: `ahrs-sim fly`, process start included, against the bare JSBSim loop of as many steps.

    python benchmarks/flight_speed.py            ratio of times, start of the command line
    python benchmarks/flight_speed.py --memory   peak memory of a 60 min flight against a 10 min one
    python benchmarks/flight_speed.py --cold     the first flight ever, compilation included

Two suites with all instruments, the paper's four filters, the full log. Ratios are taken pair by pair in one run.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SCENE = """
epoch = 2026-06-01T10:00:00Z
duration_s = {seconds}
[start]
on_ground = false
height_m = 100.0
[wind]
speed_mps = 4.0
from_deg = 310.0
turbulence = "light"
[[step]]
do = "turn"
bank_deg = 30.0
for_s = 1e5
timeout_s = 2e5
"""
BARE = """
import sys, time
from ahrs_sim import scenario
from ahrs_sim.flight.jsbsim_flight import JsbsimFlight
run = JsbsimFlight(scenario.load(sys.argv[1]))._fdm.exec.run
start = time.perf_counter()
for _ in range(int(sys.argv[2])):
    run()
print(time.perf_counter() - start)
"""


def measured(command: list[str], **environment: str) -> tuple[float, float, str]:
    """Wall time (s), peak memory (MB) and output of a command."""
    start = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | environment) as process:
        assert process.stdout is not None
        out = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{command} ended with {process.returncode}")
    return time.perf_counter() - start, usage.ru_maxrss / 1024, out


def main() -> None:
    """Print the figures asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--cold", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scene, log = Path(folder) / "scene.toml", Path(folder) / "log.mcap"
        scene.write_text(SCENE.format(seconds=options.seconds))
        command = [sys.executable, "-m", "ahrs_sim"]
        fly = [*command, "fly", str(scene), "-o", str(log), "--force"]
        if options.cold:
            cold, _, _ = measured([*command, "fly", "circuit", "-o", str(log), "--force"], NUMBA_CACHE_DIR=folder)
            print(f"first flight of the circuit, compilation included: {cold:.1f} s")
            return
        measured([*fly, "--duration", "10"])  # compiles
        if options.memory:
            short = measured([*fly, "--duration", "600"])[1]
            long = measured([*fly, "--duration", "3600"])[1]
            print(f"peak memory: 10 min {short:.0f} MB, 60 min {long:.0f} MB, ratio {long / short:.2f}")
            return
        steps = str(round(400 * options.seconds))
        pairs = []
        for _ in range(options.repeat):
            bare = float(measured([sys.executable, "-c", BARE, str(scene), steps])[2])
            whole, memory, _ = measured(fly)
            pairs.append((bare, whole))
            print(f"bare loop {bare:6.2f} s, whole flight {whole:6.2f} s, ratio {whole / bare:.2f}, {memory:.0f} MB")
        print(f"median ratio of whole flight to bare loop: {statistics.median(w / b for b, w in pairs):.2f}")
        helps = [measured([*command, "--help"])[0] for _ in range(10)]
        print(f"ahrs-sim --help: {1e3 * min(helps):.0f} ms at best, {1e3 * statistics.median(helps):.0f} ms median")


if __name__ == "__main__":
    main()
