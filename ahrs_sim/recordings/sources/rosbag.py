"""Bags of ROS that are no MCAP file, by rosbags: ROS 2 in SQLite or a folder of MCAP, ROS 1."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.cdr import Definitions, parse_definitions
from ahrs_sim.recordings.sources.base import Topic, dtype_of, extra, one_line
from ahrs_sim.recordings.sources.ros1 import in_bulk, to_arrays
from ahrs_sim.recordings.sources.standard import standard_name

_BATCH = 20000  # messages decoded together


class Rosbag:
    """A bag of ROS 1 or 2."""

    recorded: Mapping[str, str] = {}
    one_clock = False

    def __init__(self, path: Path, *, version: int) -> None:
        self.path = path
        self.form = f"ROS {version} bag"
        self.notes: list[str] = []
        self._version = version
        if not path.exists():
            raise InputError(f"{path}: cannot be read: no such file")
        module = extra("rosbags.rosbag1" if version == 1 else "rosbags.rosbag2", "rosbags", "bags")
        try:
            self._reader = module.Reader(path)
            self._reader.open()
        except Exception as error:  # sqlite3 and rosbags raise many kinds for a file that is none
            raise InputError(f"{path}: no {self.form}: {one_line(error)}") from None
        try:
            self._connections: dict[str, list[Any]] = {}
            for connection in self._reader.connections:
                self._connections.setdefault(connection.topic, []).append(connection)
            self.epoch_ns, self.duration = self._reader.start_time, self._reader.duration / 1e9
            empty = self._reader.message_count == 0
            self._types = self._readable()
        except Exception as error:
            self.close()
            raise InputError(f"{path}: no {self.form}: {one_line(error)}") from None
        if empty:
            self.close()
            raise InputError(f"{path}: no messages in it; nothing to replay")

    def _readable(self) -> dict[str, tuple[str, Definitions]]:
        """Type and definitions by topic; a topic that cannot be read is noted and left out."""
        found: dict[str, tuple[str, Definitions]] = {}
        refused = []
        for topic, connections in self._connections.items():
            connections.sort(key=lambda c: -c.msgcount)
            main = connections[0]
            self._connections[topic] = [c for c in connections if c.msgtype == main.msgtype]
            definitions = self._definitions(main)
            if definitions is None:
                refused.append(f"{topic} ({main.msgtype})")
            elif main.msgcount:
                found[topic] = main.msgtype, definitions
        if refused:
            more = f" and {len(refused) - 4} more" if len(refused) > 4 else ""
            self.notes.append(f"not read, their types are not known: {', '.join(refused[:4])}{more}")
        return found

    def _definitions(self, connection: Any) -> Definitions | None:
        name = connection.msgtype
        standard = standard_name(name)
        if self._version == 1:
            return messages.definitions(standard) if standard else None
        try:
            if connection.msgdef.data and connection.msgdef.format.name == "MSG":
                definitions = parse_definitions(name, connection.msgdef.data)
                dtype_of(name, definitions)
                return definitions
        except (KeyError, ValueError):  # a CdrError is one
            pass
        return messages.definitions(standard) if standard else None

    def topics(self) -> list[Topic]:
        """List all topics whose type is known."""
        counts = {t: sum(c.msgcount for c in connections) for t, connections in self._connections.items()}
        return [Topic(t, kind, counts[t]) for t, (kind, _) in self._types.items()]

    def dtype(self, topic: str) -> np.dtype[Any]:
        """Type of the messages of a topic."""
        kind, definitions = self._types[topic]
        return dtype_of(kind, definitions)

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Yield batches of messages."""
        chosen = [c for t in topics for c in self._connections[t]]
        waiting: dict[str, list[tuple[int, bytes]]] = {t: [] for t in topics}
        try:
            for i, (connection, time, data) in enumerate(self._reader.messages(chosen), 1):
                waiting[connection.topic].append((time, bytes(data)))
                if i % _BATCH == 0:
                    yield {t: self._decoded(t, rows) for t, rows in waiting.items()}
                    waiting = {t: [] for t in topics}
            yield {t: self._decoded(t, rows) for t, rows in waiting.items()}
        except InputError:
            raise
        except Exception as error:  # sqlite3 and rosbags raise many kinds for a damaged file
            raise InputError(f"{self.path}: damaged: {one_line(error)}") from None

    def _decoded(self, topic: str, rows: list[tuple[int, bytes]]) -> np.ndarray:
        kind, definitions = self._types[topic]
        return to_arrays(kind, rows) if self._version == 1 else in_bulk(definitions, kind, rows)

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
