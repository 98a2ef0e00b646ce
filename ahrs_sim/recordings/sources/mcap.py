"""MCAP recordings: ROS 2 by our own reader in bulk; ROS 1, JSON and protobuf of standard types message by message."""

import functools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.container import MESSAGE_HEAD
from ahrs_sim.log.mcap.pieces import head_view
from ahrs_sim.log.mcap.reader import LogReader, TopicInfo
from ahrs_sim.recordings.sources.base import DATES_FROM_NS, Topic, extra, one_line
from ahrs_sim.recordings.sources.ros1 import to_arrays
from ahrs_sim.recordings.sources.standard import array_of, standard_name

READ = "ROS 2, and ROS 1, JSON or protobuf of the standard types"


class Mcap:
    """A recording in MCAP."""

    form = "MCAP"
    one_clock = False
    recorded: Mapping[str, str] = {}

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []
        self.reader = LogReader(path, messages.definitions)
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        if self.reader.message_count == 0:
            raise InputError(f"{self.path}: no messages in it; nothing to replay")
        first, last = self.reader.time_range_ns
        self._start: int | None = None
        if first < DATES_FROM_NS <= last:  # recorded before the clock was set
            self._start, first = DATES_FROM_NS, self._first_dated()
            self.notes.append(
                "messages from before the recorder's clock was set (their log time is near 0) are left out"
            )
        self.epoch_ns, self.duration = first, (last - first) / 1e9
        self._native: dict[str, TopicInfo] = {}
        self._foreign: dict[str, str] = {}  # standard type by topic
        refused = []
        for topic, info in self.reader.topics.items():
            if not info.count:
                continue
            why = self._unreadable(info)
            if not why and info.encoding == "cdr":
                self._native[topic] = info
            elif not why:
                self._foreign[topic] = standard_name(info.type_name) or ""
            else:
                refused.append(f"{topic} ({why})")
        self.foreign = bool(self._foreign)
        reasons = ", ".join(refused[:4]) + (f" and {len(refused) - 4} more" if len(refused) > 4 else "")
        if refused:
            self.notes.append(f"not read: {reasons}; read are {READ}")
        if not self._native and not self._foreign:
            raise InputError(f"{self.path}: no topic in it can be read: {reasons}; read are {READ}")

    def _unreadable(self, info: TopicInfo) -> str:
        """Why a topic cannot be read; nothing when it can."""
        form = f"'{info.encoding}' with '{info.schema_encoding or 'no'}' schema"
        if info.encoding == "cdr":
            try:
                self.reader.dtype(info.topic)
            except InputError as error:
                why = str(error).partition(f"{info.topic}: ")[2][:100]
                return f"{form}: {why}" if info.schema_encoding == "ros2msg" else form
            return ""
        if info.encoding not in _DECODERS:
            return form
        if standard_name(info.type_name) is None:
            return f"{form}, type {info.type_name or '-'}"
        return ""

    def _first_dated(self) -> int:
        """Log time of the first message since there was a date."""
        after = [p for p in self.reader.pieces_ns if p[1] >= DATES_FROM_NS]
        numbers = self.reader.carried(list(self.reader.topics))
        if all(start >= DATES_FROM_NS for start, _ in after):
            return min(start for start, _ in after)
        first = np.iinfo(np.int64).max
        for _, found in self.reader.raw_blocks(numbers):
            times = [head_view(rows)["log_time"].astype(np.int64) for batch in found.values() for rows in batch]
            dated = [int(t[t >= DATES_FROM_NS].min()) for t in times if (t >= DATES_FROM_NS).any()]
            if dated:
                first = min(first, *dated)
                break
        return first

    def topics(self) -> list[Topic]:
        """List all topics that can be read."""
        native = [Topic(t.topic, t.type_name, t.count) for t in self._native.values()]
        counts = self.reader.topics
        return native + [Topic(t, kind, counts[t].count) for t, kind in self._foreign.items()]

    def dtype(self, topic: str) -> np.dtype[Any]:
        """Type of the messages of a topic."""
        if topic in self._foreign:
            return self._decoded(topic).dtype
        return self.reader.dtype(topic)

    def blocks(self, topics: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Yield as `LogReader.blocks`; what is decoded message by message goes along with the rest."""
        native = [t for t in topics if t not in self._foreign]
        others = {t: self._decoded(t) for t in topics if t in self._foreign}
        given = dict.fromkeys(others, 0)
        for block in self.reader.blocks(native, start=self._start) if native else ():
            until = max((int(a["log_time"].max()) for a in block.values() if len(a)), default=self.epoch_ns)
            for topic, array in others.items():
                end = int(np.searchsorted(array["log_time"], until, "right"))
                block[topic], given[topic] = array[given[topic] : end], max(end, given[topic])
            yield block
        rest = {t: a[given[t] :] for t, a in others.items()}
        if any(len(a) for a in rest.values()):
            yield {**{t: np.empty(0, self.dtype(t)) for t in native}, **rest}

    @functools.cache  # noqa: B019  # as long as the file is open
    def _decoded(self, topic: str) -> np.ndarray:
        """Decode all messages of a topic that is not ROS 2 into the standard type that it stands for."""
        arrays = []
        numbers = self.reader.carried([topic])
        kind = self._foreign[topic]
        payloads: dict[int, list[tuple[int, bytes]]] = {n: [] for n in numbers}
        for _, found in self.reader.raw_blocks(numbers):
            for number, batches in found.items():
                for rows in batches:
                    times = head_view(rows)["log_time"].astype(np.int64).tolist()
                    bodies = rows[:, MESSAGE_HEAD.size :]
                    payloads[number] += [(t, body.tobytes()) for t, body in zip(times, bodies, strict=True)]
        for number, (channel, schema) in numbers.items():
            try:
                arrays.append(_DECODERS[channel.message_encoding](kind, schema, payloads[number]))
            except (ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
                raise InputError(f"{self.path}: topic {topic}: damaged: {one_line(error)}") from None
        array = np.concatenate(arrays)
        array = array[np.argsort(array["log_time"], kind="stable")]
        return array if self._start is None else array[array["log_time"] >= self._start]

    def close(self) -> None:
        """Close the file."""
        self.reader.close()


def _json(kind: str, schema: Any, rows: list[tuple[int, bytes]]) -> np.ndarray:
    return array_of(kind, [t for t, _ in rows], [json.loads(body) for _, body in rows])


def _protobuf(kind: str, schema: Any, rows: list[tuple[int, bytes]]) -> np.ndarray:
    pool_module = extra("google.protobuf.descriptor_pool", "protobuf", "bags")
    descriptor = extra("google.protobuf.descriptor_pb2", "protobuf", "bags")
    factory = extra("google.protobuf.message_factory", "protobuf", "bags")
    files = descriptor.FileDescriptorSet()
    try:
        files.ParseFromString(schema.data)
        pool = pool_module.DescriptorPool()
        for file in files.file:
            pool.Add(file)
        message_class = factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
        decoded = []
        for _, body in rows:
            message = message_class()
            message.ParseFromString(body)
            decoded.append(_as_dict(message))
    except Exception as error:  # protobuf raises kinds of its own, which differ between its versions
        raise ValueError(f"no protobuf of {schema.name}: {one_line(error)}") from None
    return array_of(kind, [t for t, _ in rows], decoded)


def _as_dict(message: Any) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if hasattr(value, "DESCRIPTOR"):
            if message.HasField(field.name):
                values[field.name] = _as_dict(value)
        else:
            values[field.name] = list(value) if hasattr(value, "append") or hasattr(value, "add") else value
    return values


def _ros1(kind: str, schema: Any, rows: list[tuple[int, bytes]]) -> np.ndarray:
    return to_arrays(kind, rows)


_DECODERS: dict[str, Callable[[str, Any, list[tuple[int, bytes]]], np.ndarray]] = {
    "json": _json,
    "protobuf": _protobuf,
    "ros1": _ros1,
}
"""By encoding of the messages; see https://mcap.dev/spec/registry."""
