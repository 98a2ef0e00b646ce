"""How fast a log is written and read, against the `mcap` package and `rosbags` in the same run.

    python benchmarks/log_speed.py [--seconds 600]

The log is that of a flight with 30 channels of mixed rates: truth, three sensor suites, four estimators. CPU time
includes the worker thread. The `mcap` package gets and gives messages as bytes: encoding and decoding come on top.
"""

import argparse
import itertools
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mcap.writer
import numpy as np
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from ahrs_sim.log.mcap.reader import LogReader
from ahrs_sim.log.mcap.writer import LogWriter

EPOCH = 1_780_308_000_000_000_000
BLOCK_S = 2
IMU = "/suite0/imu/data_raw"
CHANNELS: list[tuple[str, str, float, list[str]]] = [  # topic, type, Hz, columns of three random numbers
    ("/truth/odometry", "nav_msgs/msg/Odometry", 100, ["pose.pose.position", "twist.twist.linear"]),
    ("/truth/imu", "sensor_msgs/msg/Imu", 100, ["angular_velocity", "linear_acceleration"]),
    ("/truth/air", "ahrs_sim_msgs/msg/TruthAir", 100, ["wind"]),
    *(
        (f"/est/{i}/state", "ahrs_sim_msgs/msg/EstimatorState", 100, ["gyro_bias", "accel_bias", "down"])
        for i in range(4)
    ),
    *((f"/est/{i}/imu", "sensor_msgs/msg/Imu", 100, ["angular_velocity"]) for i in range(4)),
    *(
        (f"/suite{i}/imu/data_raw", "sensor_msgs/msg/Imu", 100, ["angular_velocity", "linear_acceleration"])
        for i in range(3)
    ),
    *((f"/suite{i}/imu/mag", "sensor_msgs/msg/MagneticField", 50, ["magnetic_field"]) for i in range(3)),
    *((f"/suite{i}/gps/vel", "geometry_msgs/msg/TwistStamped", 5, ["twist.linear"]) for i in range(3)),
    *((f"/suite{i}/air/static_pressure", "sensor_msgs/msg/FluidPressure", 25, []) for i in range(3)),
    *((f"/suite{i}/air/diff_pressure", "sensor_msgs/msg/FluidPressure", 25, []) for i in range(3)),
    *((f"/suite{i}/air/data", "ahrs_sim_msgs/msg/AirData", 25, []) for i in range(3)),
    ("/pilot/setpoints", "ahrs_sim_msgs/msg/Setpoints", 50, []),
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=600, help="length of the flight, s")
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        n, wall, cpu = timed(lambda: write(path, seconds))
        size = path.stat().st_size
        print(f"{n} messages on {len(CHANNELS)} channels, {seconds} s, {size / 1e6:.0f} MB")
        print(f"\nwriting                   us/message  CPU us/message\n{line('ahrs_sim', wall / n, cpu / n)}")
        found = first_messages(path, 50_000)
        few, wall, cpu = timed(lambda: peer_write(found, Path(folder) / "peer.mcap"))
        print(line("mcap, encoded already", wall / few, cpu / few))

        print("\nreading                        wall s     CPU s    ratio of CPU")
        ours = reading("one topic, ahrs_sim, frame", lambda: LogReader(path).frame(IMU), 3)
        reading("one topic, mcap, bytes", lambda: read_mcap(path, [IMU]), 1, ours)
        reading("one topic, rosbags, decoded", lambda: read_rosbags(path, [IMU]), 1, ours)
        reading("all topics, ahrs_sim, blocks", lambda: read_blocks(path), 1)
    print(f"\npeak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def line(name: str, wall: float, cpu: float) -> str:
    return f"{name:24s}{1e6 * wall:12.2f}{1e6 * cpu:16.2f}"


def timed(action: Callable[[], Any]) -> tuple[Any, float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    result = action()
    return result, time.perf_counter() - wall, time.process_time() - cpu


def reading(name: str, action: Callable[[], Any], times: int, ours: float | None = None) -> float:
    """Print the best of some runs; its CPU time."""
    cpu, wall = min((c, w) for _, w, c in (timed(action) for _ in range(times)))
    print(f"{name:28s}{wall:9.2f}{cpu:10.2f}" + (f"{cpu / ours:12.1f} x" if ours else ""))
    return cpu


def write(path: Path, seconds: int) -> int:
    noise = np.random.default_rng(0).normal(size=(100 * BLOCK_S, 3))
    count = 0
    with LogWriter(path, epoch_ns=EPOCH) as log:
        channels = [log.add_channel(topic, kind, frame_id="base_link_frd") for topic, kind, _, _ in CHANNELS]
        log.start()
        for block in range(0, seconds, BLOCK_S):
            for channel, (_, _, rate, columns) in zip(channels, CHANNELS, strict=True):
                t = EPOCH + block * 10**9 + np.arange(int(rate * BLOCK_S)) * round(1e9 / rate)
                values = np.roll(noise, block + channel.id, axis=0)[: len(t)]
                log.write(channel, t, t, **dict.fromkeys(columns, values))
                count += len(t)
            log.advance(EPOCH + (block + BLOCK_S) * 10**9)
    return count


def first_messages(path: Path, few: int) -> list[Any]:
    with path.open("rb") as stream:
        return list(itertools.islice(make_reader(stream).iter_messages(), few))


def peer_write(found: list[Any], path: Path) -> int:
    """Messages with the `mcap` package."""
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start("ros2")
        numbers: dict[int, int] = {}
        for schema, channel, message in found:
            if channel.id not in numbers:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.id] = writer.register_channel(channel.topic, "cdr", kind)
            number = numbers[channel.id]
            writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)
        writer.finish()
    return len(found)


def read_mcap(path: Path, topics: list[str]) -> int:
    with path.open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages(topics))


def read_rosbags(path: Path, topics: list[str]) -> int:
    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic in topics]
        return sum(reader.deserialize(raw, c.msgtype) is not None for c, _, raw in reader.messages(wanted))


def read_blocks(path: Path) -> int:
    with LogReader(path) as log:
        return sum(len(array) for block in log.blocks(list(log.topics)) for array in block.values())


if __name__ == "__main__":
    main()
