"""Peak memory of the commands that read logs, on a short log and on one of gigabytes.

    python benchmarks/log_memory.py [--gigabytes 2.0] [--folder DIR]

The long log is a ten-minute flight of two suites and two estimators over and over, its times shifted. What a command
needs for both is the program; what grows is the log that it holds.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from flight_speed import SCENE, measured

from ahrs_sim.log.mcap.container import MESSAGE_HEAD
from ahrs_sim.log.mcap.reader import LogReader
from ahrs_sim.log.mcap.writer import LogWriter

IMU = "/chr/imu/data_raw"
ESTIMATORS = ("ins21@chr", "marg-ekf@chr")
_TIMES = slice(MESSAGE_HEAD.size - 16, MESSAGE_HEAD.size)  # log and publish time, ns
_SECONDS = slice(MESSAGE_HEAD.size + 4, MESSAGE_HEAD.size + 8)  # header.stamp.sec, after the encapsulation


def repeat(source: Path, output: Path, size: float) -> float:
    """Write `source` over and over until there are `size` bytes; returns the s of flight."""
    with LogReader(source) as log, LogWriter(output, epoch_ns=log.epoch_ns) as writer:
        topics = [t for t in log.topics if "header" in (log.dtype(t).names or ())]
        channels = {n: writer.carry(*kind) for n, kind in log.carried(topics).items()}
        for name, values in log.metadata.items():
            writer.metadata(name, values)
        for name in log.attachments:
            writer.attach(name, log.attachment(name), "application/octet-stream")
        writer.start()
        first, last = log.time_range_ns
        lap, laps = (last - first) // 10**9 + 2, 0
        while not laps or output.with_name(output.name + ".part").stat().st_size < size:
            shift, laps = laps * lap, laps + 1
            for floor, found in log.raw_blocks(channels):
                for number, batches in found.items():
                    for batch in batches:
                        rows = batch.copy()
                        times, seconds = (rows[:, part].copy() for part in (_TIMES, _SECONDS))
                        times.view("<u8")[...] += shift * 10**9
                        seconds.view("<u4")[...] += shift
                        rows[:, _TIMES], rows[:, _SECONDS] = times, seconds
                        writer.pass_on(channels[number], rows)
                writer.advance(floor + shift * 10**9)
    return float(laps * lap)


def main() -> None:
    """Print a table of commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--folder", type=Path, help="keep the logs there, and use them when they are there")
    options = parser.parse_args()
    command = [sys.executable, "-m", "ahrs_sim"]
    chosen = [word for name in ESTIMATORS for word in ("--estimator", name)]
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        scene, short, long = (folder / name for name in ("scene.toml", "short.mcap", "long.mcap"))
        scene.write_text(SCENE.format(seconds=600.0))
        if not short.exists():
            measured([*command, "fly", str(scene), "-o", str(short), *chosen, "--quiet"])
        if not long.exists():
            repeat(short, long, options.gigabytes * 1e9)
        print(f"{'':28s}{'MB of log':>12s}{'peak MB':>10s}{'wall s':>10s}")
        for log in (short, long):
            out = Path(scratch) / "out"
            for name, arguments in {
                "info": ["info", str(log)],
                "compare": ["compare", str(log)],
                "replay": ["replay", str(log), *chosen],
                "replay -o": ["replay", str(log), *chosen, "-o", f"{out}.mcap", "--force"],
                "export --topic": ["export", str(log), "--to", "csv", "--topic", IMU, "-o", str(out)],
            }.items():
                wall, memory, _ = measured([*command, *arguments])
                print(f"{name:28s}{log.stat().st_size / 1e6:12.0f}{memory:10.0f}{wall:10.1f}", flush=True)


if __name__ == "__main__":
    main()
