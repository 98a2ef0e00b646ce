"""MCAP recordings, by our own reader."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.log.mcap.reader import LogReader
from ahrs_sim.recordings.sources.base import Topic


class Mcap:
    """A ROS 2 bag in MCAP."""

    form = "MCAP"
    recorded: Mapping[str, str] = {}

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []
        self.reader = LogReader(path)
        first, last = self.reader.time_range_ns
        self.epoch_ns, self.duration = first, (last - first) / 1e9
        refused = ""
        if self.reader.message_count == 0:
            refused = "no messages in it; nothing to replay"
        elif self.reader.profile not in ("ros2", ""):
            refused = f"profile {self.reader.profile!r}; only ROS 2 bags ('ros2') can be replayed"
        if refused:
            self.close()
            raise InputError(f"{path}: {refused}")

    def topics(self) -> list[Topic]:
        """All topics of messages in CDR."""
        found = self.reader.topics.values()
        return [Topic(t.topic, t.type_name, t.count) for t in found if t.encoding == "cdr" and t.count]

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """As `LogReader.blocks`."""
        return self.reader.blocks(list(topics))

    def dtype(self, topic: str) -> np.dtype[Any]:
        """Type of the messages of a topic."""
        return self.reader.dtype(topic)

    def close(self) -> None:
        """Close the file."""
        self.reader.close()
