"""Bags of ROS that are no MCAP file, by rosbags."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.cdr import CdrError, decode, message_dtype, parse_definitions
from ahrs_sim.recordings.sources.base import Topic, extra, one_line

_BATCH = 20000  # messages decoded together


class Db3:
    """A ROS 2 bag in SQLite."""

    form = "ROS 2 bag"
    recorded: Mapping[str, str] = {}

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []
        if not path.exists():
            raise InputError(f"{path}: cannot be read: no such file")
        module = extra("rosbags.rosbag2", "rosbags", "bags")
        self._error: Any = (module.ReaderError, OSError, ValueError, KeyError)
        try:
            self._reader = module.Reader(path)
            self._reader.open()
        except Exception as error:  # sqlite3 and rosbags raise many kinds for a file that is none
            raise InputError(f"{path}: no ROS 2 bag: {one_line(error)}") from None
        try:
            self._connections = {c.topic: c for c in self._reader.connections}
            self.epoch_ns, self.duration = self._reader.start_time, self._reader.duration / 1e9
            empty = self._reader.message_count == 0
        except Exception as error:
            self.close()
            raise InputError(f"{path}: no ROS 2 bag: {one_line(error)}") from None
        if empty:
            self.close()
            raise InputError(f"{path}: no messages in it; nothing to replay")

    def topics(self) -> list[Topic]:
        """All topics."""
        return [Topic(c.topic, c.msgtype, c.msgcount) for c in self._connections.values() if c.msgcount]

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Batches of messages."""
        chosen = [self._connections[t] for t in topics]
        kinds = {c.topic: self._definitions(c) for c in chosen}
        waiting: dict[str, list[tuple[int, bytes]]] = {t: [] for t in topics}
        try:
            for i, (connection, time, data) in enumerate(self._reader.messages(chosen), 1):
                waiting[connection.topic].append((time, data))
                if i % _BATCH == 0:
                    yield {t: _decoded(*kinds[t], rows) for t, rows in waiting.items()}
                    waiting = {t: [] for t in topics}
            yield {t: _decoded(*kinds[t], rows) for t, rows in waiting.items()}
        except (CdrError, *self._error) as error:
            raise InputError(f"{self.path}: damaged: {one_line(error)}") from None

    def dtype(self, topic: str) -> np.dtype[Any]:
        """Type of the messages of a topic."""
        return _decoded(*self._definitions(self._connections[topic]), []).dtype

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def _definitions(self, connection: Any) -> tuple[Any, str]:
        name, text = connection.msgtype, connection.msgdef.data
        try:
            if not text or connection.msgdef.format.name != "MSG":
                return messages.definitions(name), name
            return parse_definitions(name, text), name
        except (KeyError, CdrError) as error:
            raise InputError(f"{self.path}: topic {connection.topic}: type {name} is not known: {error}") from None


def _decoded(definitions: Any, name: str, rows: list[tuple[int, bytes]]) -> np.ndarray:
    inner = message_dtype(definitions, name)
    out = np.empty(len(rows), [("log_time", "<i8"), *((f, inner[f]) for f in inner.names or ())])
    if not rows:
        return out
    out["log_time"] = [time for time, _ in rows]
    sizes = np.array([len(data) for _, data in rows])
    for size in np.unique(sizes):
        which = np.flatnonzero(sizes == size)
        payload = np.frombuffer(b"".join(rows[i][1] for i in which), np.uint8).reshape(len(which), size)
        part = np.empty(len(which), out.dtype)
        part["log_time"] = out["log_time"][which]
        decode(definitions, name, payload, part)
        out[which] = part
    return out
