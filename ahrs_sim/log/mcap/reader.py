"""Read a log, ours or any ROS 2 bag in MCAP: whole topics as structured NumPy arrays.

    with LogReader("flight.mcap") as log:
        imu = log.read("/chr/imu/data_raw")             # one row a message, fields as in the message, and log_time
        gyro_b = vector(imu["angular_velocity"])        # (n, 3)
        for block in log.blocks(["/truth/imu", "/est/ekf-chr/state"]):      # bounded memory, in order of log time
            ...

Damage is reported as one `InputError` that names the file.
"""

import contextlib
import functools
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.log.mcap.cdr import CdrError, Definitions, decode, message_dtype, parse_definitions
from ahrs_sim.log.mcap.container import MESSAGE_HEAD, RECORD_HEAD
from ahrs_sim.log.mcap.pieces import LogFile, Messages, Piece, head_view, message_heads, rows_at

if TYPE_CHECKING:
    import pandas

_BATCH = 2 << 20  # bytes of messages decoded together
_PORTION = 4 << 20  # bytes of messages given out together


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a log."""

    topic: str
    type_name: str
    encoding: str
    count: int
    schema_encoding: str = ""  # empty: without schema

    @property
    def readable(self) -> bool:
        """Tell whether messages of a channel can be decoded, by profile and encoding: ROS 2."""
        return self.encoding == "cdr" and self.schema_encoding == "ros2msg"


class LogReader:
    """An open log. Closes as a context manager, by `close` or when forgotten; may be used from several threads.

    Args:
        path: an MCAP file.
        known: definitions of a type by its name (KeyError: none), for CDR whose schema is of another form.

    Raises:
        InputError: not there, not MCAP, unfinished or damaged; the message names the remedy.
    """

    def __init__(self, path: str | Path, known: Callable[[str], Definitions] | None = None) -> None:
        self.path = Path(path)
        self._known = known
        self._file = LogFile(self.path)
        self._contents = self._file.contents
        self._definitions: dict[int, Definitions] = {}  # by channel, of those that have been asked for
        self._dtypes: dict[int, np.dtype[Any]] = {}
        self._topics: dict[str, list[int]] = {}
        for number, channel in sorted(self._contents.channels.items()):
            self._topics.setdefault(channel.topic, []).append(number)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # ------------------------------------------------------------------------------------------- contents

    @property
    def profile(self) -> str:
        """`ros2` for logs that can be decoded."""
        return self._contents.header.profile

    @property
    def library(self) -> str:
        """Library that wrote the file."""
        return self._contents.header.library

    @property
    def size(self) -> int:
        """Size of the file, bytes."""
        return self._file.size

    @property
    def topics(self) -> dict[str, TopicInfo]:
        """Topics in the order of their channels."""
        found = {}
        for topic, channels in self._topics.items():
            channel = self._contents.channels[channels[0]]
            schema = self._contents.schemas.get(channel.schema_id)
            count = sum(self._contents.counts.get(c, 0) for c in channels)
            name, encoding = (schema.name, schema.encoding) if schema else ("", "")
            found[topic] = TopicInfo(topic, name, channel.message_encoding, count, encoding)
        return found

    @property
    def message_count(self) -> int:
        """Number of messages in the log."""
        return sum(self._contents.counts.values())

    @property
    def time_range_ns(self) -> tuple[int, int]:
        """Log time of the first and the last message, ns since 1970; (0, 0) without messages."""
        pieces = self._contents.pieces
        return min((p.start for p in pieces), default=0), max((p.end for p in pieces), default=0)

    @property
    def pieces_ns(self) -> list[tuple[int, int]]:
        """First and last log time of each portion of the file, ns since 1970."""
        return [(p.start, p.end) for p in self._contents.pieces]

    @property
    def epoch_ns(self) -> int:
        """Zero of the time of flight, ns since 1970: as our logs state it, else the first log time."""
        with contextlib.suppress(KeyError, ValueError):
            stated = int(self.metadata["log"]["epoch_ns"])
            if 0 <= stated < 2**63:
                return stated
        return self.time_range_ns[0]

    @property
    def schemas(self) -> dict[str, str]:
        """Definition text by type name."""
        return {s.name: s.data.decode(errors="replace") for s in self._contents.schemas.values()}

    @functools.cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata records by name; of equal names the last."""
        return {
            m.name: m.metadata
            for m in (self._file.indexed(i, Opcode.METADATA, Metadata.read) for i in self._contents.metadata)
        }

    @property
    def attachments(self) -> dict[str, int]:
        """Size in bytes of the attachments, by name."""
        return {a.name: a.data_size for a in self._contents.attachments}

    def attachment(self, name: str) -> bytes:
        """Read an attachment's content.

        Raises:
            InputError: there is none of that name, or it is damaged.
        """
        for index in self._contents.attachments:
            if index.name == name:
                item: Attachment = self._file.indexed(index, Opcode.ATTACHMENT, Attachment.read)
                return item.data
        raise InputError(f"{self.path}: no attachment '{name}'{nearest(name, self.attachments)}")

    def dtype(self, topic: str) -> np.dtype[Any]:
        """Make the type of `read(topic)`: `log_time` (int64, ns since 1970), then the fields of the message.

        Raises:
            InputError: no such topic, or one that is not ROS 2 CDR.
        """
        return self._dtype(self._plan(topic))

    # ------------------------------------------------------------------------------------------- messages

    @overload
    def read(  # type: ignore[overload-overlap]  # a str is meant as one topic
        self, topics: str, start: int | None = None, end: int | None = None
    ) -> np.ndarray: ...
    @overload
    def read(
        self, topics: Sequence[str], start: int | None = None, end: int | None = None
    ) -> dict[str, np.ndarray]: ...
    def read(
        self, topics: str | Sequence[str], start: int | None = None, end: int | None = None
    ) -> np.ndarray | dict[str, np.ndarray]:
        """Read all messages of one topic, or of several by topic, sorted by log time.

        Args:
            topics: one or several.
            start: from this log time on, ns since 1970.
            end: up to and without this log time.

        Returns:
            A structured array (n,) of type `dtype(topic)`: nested like the message; strings are `str`, sequences
            hold an array per message.

        Raises:
            InputError: no such topic, one that is not ROS 2 CDR, or a damaged file.
        """
        if isinstance(topics, str):
            return self.read([topics], start, end)[topics]
        plans = {topic: self._plan(topic) for topic in topics}

        def action() -> dict[str, np.ndarray]:
            rows = {number: _Rows() for number in _numbers(plans)}
            for messages in self._loaded(self._chosen(plans, start, end), set(rows)):
                self._gather(messages, rows, start, end)
            return {topic: _in_order(self._decoded(numbers, rows)) for topic, numbers in plans.items()}

        return self._file.guard(action)

    @overload
    def blocks(  # type: ignore[overload-overlap]
        self, topics: str, start: int | None = None, end: int | None = None
    ) -> Iterator[np.ndarray]: ...
    @overload
    def blocks(
        self, topics: Sequence[str], start: int | None = None, end: int | None = None
    ) -> Iterator[dict[str, np.ndarray]]: ...
    def blocks(
        self, topics: str | Sequence[str], start: int | None = None, end: int | None = None
    ) -> Iterator[np.ndarray] | Iterator[dict[str, np.ndarray]]:
        """Read as `read`, portion by portion in memory that does not grow with the file.

        Log times of a portion are not before those of the one before it. With several topics each portion has all of
        them, some maybe empty.
        """
        if isinstance(topics, str):
            return (block[topics] for block in self._blocks({topics: self._plan(topics)}, start, end))
        return self._blocks({topic: self._plan(topic) for topic in topics}, start, end)

    def _blocks(
        self, plans: dict[str, list[int]], start: int | None, end: int | None
    ) -> Iterator[dict[str, np.ndarray]]:
        pieces = self._chosen(plans, start, end)
        held = {topic: np.empty(0, self._dtype(numbers)) for topic, numbers in plans.items()}
        rows = {number: _Rows() for number in _numbers(plans)}
        loaded = self._loaded(pieces, set(rows))
        for i in range(len(pieces)):
            last = i == len(pieces) - 1
            self._file.guard(functools.partial(self._gather, self._file.guard(loaded.__next__), rows, start, end))
            if not last and sum(r.size for r in rows.values()) < _PORTION:
                continue
            ready = {}
            for topic, numbers in plans.items():
                array = self._file.guard(functools.partial(self._decoded, numbers, rows))
                if len(held[topic]):
                    array = np.concatenate([held[topic], array])
                array = _in_order(array)
                # Pieces may overlap: what the next one could still precede has to wait.
                cut = len(array) if last else int(np.searchsorted(array["log_time"], pieces[i + 1].start, "left"))
                ready[topic], held[topic] = array[:cut], array[cut:]
            if any(len(array) for array in ready.values()):
                yield ready

    def carried(self, topics: Collection[str]) -> dict[int, tuple[Channel, Schema | None]]:
        """Collect channels of `topics` with their schemas, by number, for `LogWriter.carry`."""
        channels = self._contents.channels
        return {
            n: (channels[n], self._contents.schemas.get(channels[n].schema_id))
            for topic, numbers in self._topics.items()
            if topic in topics
            for n in numbers
        }

    def raw_blocks(self, numbers: Collection[int]) -> Iterator[tuple[int, dict[int, list[np.ndarray]]]]:
        """Yield message records of channels unchanged, in bounded memory, whatever their encoding.

        Yields:
            A log time (ns) before which nothing will follow, and records (n, size) uint8 by channel, in the order of
            the file but for messages of different sizes.
        """
        pieces = sorted(
            (p for p in self._contents.pieces if p.index is None or set(numbers) & p.index.keys()),
            key=lambda p: p.start,
        )
        loaded = self._loaded(pieces, set(numbers))
        for i, piece in enumerate(pieces):
            rows = {number: _Rows() for number in numbers}
            self._file.guard(functools.partial(self._gather, self._file.guard(loaded.__next__), rows, None, None))
            found = {n: [batch for batch, _ in r.batches()] for n, r in rows.items() if r.count}
            yield (pieces[i + 1].start if i + 1 < len(pieces) else piece.end), found

    def frame(self, topic: str, start: int | None = None, end: int | None = None) -> "pandas.DataFrame":
        """Read one topic as a pandas frame indexed by log time, a column for each number (`angular_velocity.x`).

        Raises:
            InputError: as `read`.
        """
        import pandas

        array = self.read(topic, start, end)
        columns = dict(flatten(array))
        return pandas.DataFrame(
            columns, index=pandas.DatetimeIndex(columns.pop("log_time"), name="log_time"), copy=False
        )

    # ------------------------------------------------------------------------------------------- choosing

    def _plan(self, topic: str) -> list[int]:
        """Find the channels of a topic and check that they can be decoded."""
        if topic not in self._topics:
            raise InputError(f"{self.path}: no topic '{topic}'{nearest(topic, self._topics)}")
        numbers = self._topics[topic]
        kinds = set()
        for number in numbers:
            channel = self._contents.channels[number]
            schema = self._contents.schemas.get(channel.schema_id)
            if channel.message_encoding != "cdr" or schema is None or not self._described(schema):
                form = f"'{channel.message_encoding}' with '{schema.encoding if schema else 'no'}' schema"
                raise InputError(
                    f"{self.path}: topic {topic} is {form}; only ROS 2 messages ('cdr' with 'ros2msg') can be read"
                )
            if number not in self._definitions:
                try:
                    if schema.encoding == "ros2msg":
                        definitions = parse_definitions(schema.name, schema.data.decode(errors="replace"))
                    else:
                        definitions = self._of_known(schema.name) or {}
                    inner = message_dtype(definitions, schema.name)
                    columns = [("log_time", "<i8"), *((name, inner[name]) for name in inner.names or ())]
                    self._dtypes[number] = np.dtype(columns)
                    self._definitions[number] = definitions
                except (CdrError, ValueError) as error:
                    raise InputError(f"{self.path}: topic {topic}: {error}") from None
            # Texts may differ in comments; what counts is the fields.
            kinds.add((schema.name, tuple(sorted(self._definitions[number].items()))))
        if len(kinds) > 1:
            raise InputError(
                f"{self.path}: topic {topic} carries messages of different types; it cannot be read as one"
            )
        return numbers

    def _described(self, schema: Schema) -> bool:
        """Test whether a schema defines its messages, or names a type that is known."""
        return schema.encoding == "ros2msg" or (
            schema.encoding == "ros2idl" and self._of_known(schema.name) is not None
        )

    def _of_known(self, name: str) -> Definitions | None:
        try:
            return self._known(name) if self._known else None
        except KeyError:
            return None

    def _dtype(self, numbers: list[int]) -> np.dtype[Any]:
        return self._dtypes[numbers[0]]

    def _type_name(self, number: int) -> str:
        return self._contents.schemas[self._contents.channels[number].schema_id].name

    def _chosen(self, plans: dict[str, list[int]], start: int | None, end: int | None) -> list[Piece]:
        wanted = _numbers(plans)
        chosen = [
            p
            for p in self._contents.pieces
            if (p.index is None or wanted & p.index.keys())
            and (start is None or p.end >= start)
            and (end is None or p.start < end)
        ]
        return sorted(chosen, key=lambda p: p.start)

    def _loaded(self, pieces: Sequence[Piece], wanted: set[int]) -> Iterator[Messages]:
        """Yield pieces uncompressed, the next one prepared by another thread: zstd and CRC release Python's lock."""
        with ThreadPoolExecutor(1) as worker:
            ahead = [worker.submit(self._file.load, piece, wanted) for piece in pieces[:1]]
            for i in range(len(pieces)):
                messages = ahead.pop().result()
                ahead += [worker.submit(self._file.load, piece, wanted) for piece in pieces[i + 1 : i + 2]]
                yield messages

    def _gather(self, messages: Messages, rows: "dict[int, _Rows]", start: int | None, end: int | None) -> None:
        """Add the messages of a piece to the rows of their channels."""
        data, offsets = messages
        present = [number for number, places in offsets.items() if len(places)]
        if not present:
            return
        places = np.concatenate([offsets[number] for number in present])
        counts = [len(offsets[number]) for number in present]
        heads = message_heads(data, places, np.repeat(present, counts))
        sizes = heads["length"].astype(np.int64) + RECORD_HEAD.size
        times = heads["log_time"].astype(np.int64)
        keep = np.ones(len(times), bool)
        if start is not None:
            keep &= times >= start
        if end is not None:
            keep &= times < end
        at = 0
        for number, n in zip(present, counts, strict=True):
            chosen = slice(at, at + n)
            at += n
            if keep[chosen].all():
                rows[number].add(data, places[chosen], sizes[chosen])
            else:
                kept = keep[chosen]
                rows[number].add(data, places[chosen][kept], sizes[chosen][kept])

    def _decoded(self, numbers: list[int], rows: "dict[int, _Rows]") -> np.ndarray:
        """Decode the gathered messages of some channels of one topic, in the order of the file; empty the rows."""
        dtype = self._dtype(numbers)
        arrays = []
        for number in numbers:
            gathered, rows[number] = rows[number], _Rows()
            out = np.empty(gathered.count, dtype)
            for part, places in gathered.batches():
                into = out[places] if isinstance(places, slice) else np.empty(len(part), dtype)
                into["log_time"] = head_view(part)["log_time"]
                payload = np.ascontiguousarray(part[:, MESSAGE_HEAD.size :])
                decode(self._definitions[number], self._type_name(number), payload, into)
                if not isinstance(places, slice):
                    out[places] = into
            arrays.append(out)
        return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _numbers(plans: dict[str, list[int]]) -> set[int]:
    return {number for numbers in plans.values() for number in numbers}


def _in_order(array: np.ndarray) -> np.ndarray:
    """Sort by log time; equal times keep their order."""
    times = np.ascontiguousarray(array["log_time"])
    return array if (times[1:] >= times[:-1]).all() else array[np.argsort(times, kind="stable")]


class _Rows:
    """Messages of one channel as rows of bytes."""

    def __init__(self) -> None:
        self.count = 0
        self.size = 0  # bytes
        self._by_size: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}  # rows and which messages they are

    def add(self, data: np.ndarray, offsets: np.ndarray, sizes: np.ndarray) -> None:
        """Copy the records at `offsets` of `data`."""
        if not len(offsets):
            return
        which = np.arange(self.count, self.count + len(offsets))
        self.count += len(offsets)
        self.size += int(sizes.sum())
        if (sizes == sizes[0]).all():
            self._by_size.setdefault(int(sizes[0]), []).append((rows_at(data, offsets, int(sizes[0])), which))
            return
        for size in np.unique(sizes):
            same = sizes == size
            self._by_size.setdefault(int(size), []).append((rows_at(data, offsets[same], int(size)), which[same]))

    def batches(self) -> Iterator[tuple[np.ndarray, np.ndarray | slice]]:
        """Yield rows of equal size in handy portions with the numbers of their messages; empty the rows."""
        uniform = len(self._by_size) == 1
        for parts in self._by_size.values():
            parts.reverse()
            while parts:
                batch = [parts.pop()]
                size = batch[0][0].size
                while parts and size < _BATCH:
                    batch.append(parts.pop())
                    size += batch[-1][0].size
                rows = batch[0][0] if len(batch) == 1 else np.concatenate([r for r, _ in batch])
                if uniform:
                    yield rows, slice(int(batch[0][1][0]), int(batch[-1][1][-1]) + 1)
                else:
                    yield rows, np.concatenate([which for _, which in batch])


# ----------------------------------------------------------------------------------------------- columns


def vector(column: np.ndarray) -> np.ndarray:
    """Make an array (n, 3) from a column of `geometry_msgs/Vector3` or `Point`."""
    return np.stack([column["x"], column["y"], column["z"]], axis=-1)


def quaternion(column: np.ndarray) -> np.ndarray:
    """Make an array (n, 4), scalar first, from a column of `geometry_msgs/Quaternion`."""
    return np.stack([column["w"], column["x"], column["y"], column["z"]], axis=-1)


def is_stamped(dtype: np.dtype[Any]) -> bool:
    """Tell whether messages of this type have a header with a stamp in numbers."""
    for name in ("header", "stamp"):
        if name not in (dtype.names or ()) or dtype[name].shape:
            return False
        dtype = dtype[name]
    return all(name in (dtype.names or ()) and dtype[name].kind in "iu" for name in ("sec", "nanosec"))


def stamps(array: np.ndarray) -> np.ndarray:
    """Convert the header stamps of an array from `read` (see `is_stamped`) to (n,) int64, ns since 1970."""
    stamp = array["header"]["stamp"]
    nanoseconds: np.ndarray = stamp["sec"].astype(np.int64) * 1_000_000_000 + stamp["nanosec"]
    return nanoseconds


def flatten(array: np.ndarray, prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and values of every column of an array from `read`: `angular_velocity.x`, `innovation.0`."""
    for name in array.dtype.names or ():
        column = array[name]
        path = f"{prefix}{name}"
        if column.dtype.names:
            if column.ndim == 1:
                yield from flatten(column, f"{path}.")
            else:
                for i in range(column.shape[1]):
                    yield from flatten(column[:, i], f"{path}.{i}.")
        elif column.ndim == 1:
            yield path, column
        else:
            for i in range(column.shape[1]):
                yield f"{path}.{i}", column[:, i]
