"""How fast a log is replayed: `ahrs-sim replay`, process start included, against the time that was flown.

    python benchmarks/replay_speed.py            ratio to real time, and to the bare JSBSim loop of as many steps
    python benchmarks/replay_speed.py --memory   peak memory with a 60 min log against a 10 min one

Four estimators on a flight of two suites with all instruments: the two navigators, EKF and CKF. The bare loop is
measured beside every replay, to compare machines. The kernels are compiled before.
"""

import argparse
import statistics
import sys
import tempfile
from pathlib import Path

from flight_speed import BARE, SCENE, measured

ESTIMATORS = ("ins21@chr", "air-ins@chr", "marg-ekf@chr", "marg-ckf@sbg")


def main() -> None:
    """Print the figures asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--memory", action="store_true")
    options = parser.parse_args()
    command = [sys.executable, "-m", "ahrs_sim"]
    chosen = [word for name in ESTIMATORS for word in ("--estimator", name)]
    with tempfile.TemporaryDirectory() as folder:
        scene, log, kept = (Path(folder) / name for name in ("scene.toml", "log.mcap", "kept.mcap"))
        scene.write_text(SCENE.format(seconds=options.seconds))
        fly = [*command, "fly", str(scene), "-o", str(log), "--force", *chosen]
        ways = {
            "figures alone": [*command, "replay", str(log), *chosen],
            "new log as well": [*command, "replay", str(log), *chosen, "-o", str(kept), "--force"],
        }
        if options.memory:
            measured([*fly, "--duration", "600"])
            short = {way: measured(replay)[1] for way, replay in ways.items()}
            measured([*fly, "--duration", "3600"])
            for way, replay in ways.items():
                long = measured(replay)[1]
                print(f"{way}: peak memory 10 min {short[way]:.0f} MB, 60 min {long:.0f} MB")
            return
        measured(fly)
        steps = str(round(400 * options.seconds))
        for way, replay in ways.items():
            times, ratios = [], []
            for _ in range(options.repeat):
                bare = float(measured([sys.executable, "-c", BARE, str(scene), steps])[2])
                whole, memory, _ = measured(replay)
                times.append(whole)
                ratios.append(whole / bare)
            print(
                f"{way}: {options.seconds / statistics.median(times):.0f} x real time at the median, "
                f"{options.seconds / min(times):.0f} at best, {statistics.median(ratios):.2f} x the bare loop, "
                f"{memory:.0f} MB"
            )


if __name__ == "__main__":
    main()
