"""Any recording with the interface of `LogReader`: what `info`, `allan` and `export` read is what `replay` reads."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.reader import LogReader, TopicInfo
from ahrs_sim.recordings import presets
from ahrs_sim.recordings.sources import Source, is_mcap, open_source
from ahrs_sim.scenario.table import Table


class RecordingLog:
    """A recording of others as a log; closes as a context manager.

    Args:
        source: the open recording.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self.path = source.path
        self.profile = source.form
        self.library = "-"
        self.notes: Sequence[str] = source.notes
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, int] = {}
        self.epoch_ns = source.epoch_ns
        self.time_range_ns = source.epoch_ns, source.epoch_ns + round(source.duration * 1e9)
        self.topics = {t.name: TopicInfo(t.name, t.type_name, "cdr", t.count, "ros2msg") for t in source.topics()}
        self.message_count = sum(t.count for t in self.topics.values())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    @property
    def size(self) -> int:
        """Return the size of a file, or of all files of a folder, in bytes."""
        files = [p for p in self.path.rglob("*") if p.is_file()] if self.path.is_dir() else [self.path]
        return sum(p.stat().st_size for p in files)

    @property
    def schemas(self) -> dict[str, str]:
        """Definition text by type name, of the types that we know."""
        known = set(messages.type_names())
        kinds = {t.type_name for t in self.topics.values()}
        return {k: messages.schema_text(k) for k in kinds if k in known or k.replace("/msg/", "/") in known}

    def dtype(self, topic: str) -> np.dtype[Any]:
        """Type of `read(topic)`.

        Raises:
            InputError: no such topic.
        """
        self._known(topic)
        return self._source.dtype(topic)

    def read(self, topic: str) -> np.ndarray:
        """Read all messages of a topic.

        Raises:
            InputError: no such topic, or a damaged file.
        """
        self._known(topic)
        arrays = [block[topic] for block in self._source.blocks([topic]) if len(block[topic])]
        return np.concatenate(arrays) if arrays else np.empty(0, self._source.dtype(topic))

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Read messages by topic, portion by portion, in the order of log time.

        Raises:
            InputError: no such topic, or a damaged file.
        """
        for topic in topics:
            self._known(topic)
        return self._source.blocks(topics)

    def _known(self, topic: str) -> None:
        if topic not in self.topics:
            raise InputError(f"{self.path}: no topic '{topic}'{nearest(topic, self.topics)}")


def open_log(path: Path, map_file: Path | None = None) -> LogReader | RecordingLog:
    """Open a log of ours, or any recording that `replay` reads.

    Args:
        path: a file or folder.
        map_file: what the columns of a table of text are.

    Raises:
        InputError: it cannot be read, or the map is wrong.
    """
    if is_mcap(path):
        log = LogReader(path, messages.definitions)
        if all(t.encoding == "cdr" for t in log.topics.values() if t.count) or not log.message_count:
            return log
        log.close()
        return RecordingLog(open_source(path, Table({}, "")))
    preset = presets.fitting(path) if map_file is None else None
    chosen = Path(f"{presets.PREFIX}{preset}") if preset else map_file
    source = open_source(path, presets.read(chosen) if chosen else Table({}, "no map"))
    if preset:
        source.notes.insert(0, f"files and columns are those of --map {presets.PREFIX}{preset}")
    return RecordingLog(source)
