"""How fast recordings of others are read: DataFlash beside pymavlink, ULog beside pyulog, one file in one run.

    .venv/bin/python benchmarks/recording_speed.py [MEGABYTES]

Read means: every IMU, magnetometer, GNSS and attitude message as columns; `as_messages` lays them out as ROS messages,
too, which is what a replay takes. The others' ways are their usual loop over the messages, and pyulog's own arrays.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ahrs_sim.recordings.sources import open_source
from ahrs_sim.scenario.table import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "recordings"))


def write_files(folder: Path, megabytes: float) -> tuple[Path, Path]:
    from bag_helpers import motion
    from dataflash_helpers import write_dataflash
    from ulog_helpers import attitude, inertial, magnetometer, receiver, write

    def scaled(make: Callable[[Path, float], object], path: Path) -> Path:
        make(path, 60.0)
        if megabytes * 1e6 > path.stat().st_size:
            make(path, 60.0 * megabytes * 1e6 / path.stat().st_size)
        return path

    def dataflash(path: Path, duration: float) -> None:
        write_dataflash(path, motion(duration, still=10.0))

    def ulog(path: Path, duration: float) -> None:
        m = motion(duration, rate=200.0, still=10.0)
        write(path, inertial(m), magnetometer(m), attitude(m), receiver(m))

    return scaled(dataflash, folder / "log.bin"), scaled(ulog, folder / "log.ulg")


def ours(path: Path) -> int:
    """All topics as columns."""
    return sum(t.count for t in open_source(path, Table({}, "")).topics())


def as_messages(path: Path) -> int:
    """All topics as messages in arrays."""
    source = open_source(path, Table({}, ""))
    topics = [t.name for t in source.topics()]
    return sum(len(a) for block in source.blocks(topics) for a in block.values())


def pymavlink(path: Path) -> int:
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path))
    rows: dict[str, list[list[float]]] = {}
    wanted = ["IMU", "MAG", "GPS", "BARO", "ARSP", "ATT", "XKF1"]
    while (message := log.recv_match(type=wanted)) is not None:
        rows.setdefault(message.get_type(), []).append([getattr(message, f) for f in message.get_fieldnames()])
    return sum(len(np.array(r)) for r in rows.values())


def pyulog(path: Path) -> int:
    import pyulog

    return sum(len(d.data["timestamp"]) for d in pyulog.ULog(str(path)).data_list)


def by_message(path: Path) -> int:
    """A loop over the messages of pyulog, a row each, as a converter of messages has it."""
    import pyulog

    count = 0
    for item in pyulog.ULog(str(path)).data_list:
        names = list(item.data)
        for i in range(len(item.data["timestamp"])):
            _ = [item.data[name][i] for name in names]
            count += 1
    return count


def best(action: Callable[[Path], int], path: Path, repeats: int) -> tuple[float, int]:
    seconds = []
    for _ in range(repeats):
        begun = time.perf_counter()
        count = action(path)
        seconds.append(time.perf_counter() - begun)
    return min(seconds), count


def main() -> None:
    megabytes = float(sys.argv[1]) if len(sys.argv) > 1 else 100.0
    with tempfile.TemporaryDirectory() as folder:
        small = write_files(Path(folder), 0.1)
        for path in small:
            ours(path)  # compiled before it is timed
        for path, others in zip(
            write_files(Path(folder), megabytes), ((pymavlink,), (by_message, pyulog)), strict=True
        ):
            size = path.stat().st_size / 1e6
            taken, count = best(ours, path, 3)
            laid_out, _ = best(as_messages, path, 2)
            print(f"{path.name}: {size:.0f} MB, {count} messages")
            print(f"  {'ours':12s} {taken:7.2f} s  {count / taken / 1e6:6.2f} million messages a second")
            print(f"  {'as_messages':12s} {laid_out:7.2f} s")
            for other in others:
                theirs, n = best(other, path, 1 if other is not pyulog else 2)
                print(
                    f"  {other.__name__:12s} {theirs:7.2f} s  {n / theirs / 1e6:6.2f}  {theirs / taken:5.1f} times ours"
                )


if __name__ == "__main__":
    main()
