"""Read a log, ours or any ROS 2 bag in MCAP: whole topics as structured NumPy arrays.

    with LogReader("flight.mcap") as log:
        imu = log.read("/chr/imu/data_raw")             # one row a message, fields as in the message, and log_time
        gyro_b = vector(imu["angular_velocity"])        # (n, 3)
        for block in log.blocks(["/truth/imu", "/est/ekf-chr/state"]):      # bounded memory, in order of log time
            ...

Lengths and offsets in a file are not trusted: each is checked against what is there before anything is allocated, and
what is wrong is one `InputError` naming the file.
"""

import functools
import os
import struct
import threading
import zlib
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, NamedTuple, Self, TypeVar, overload

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.log.cdr import CdrError, Definitions, decode, message_dtype, parse_definitions
from ahrs_sim.log.container import MAGIC, MESSAGE_HEAD, RECORD_HEAD

if TYPE_CHECKING:
    import pandas

T = TypeVar("T")

MAX_CHUNK = 256 << 20
"""Bytes of one chunk or record, uncompressed, that are still believed."""

_FOOTER = RECORD_HEAD.size + 20
_CHUNK_HEAD = struct.Struct("<QQQI")  # start, end, uncompressed size, checksum
_PIECE = 8 << 20  # of an unchunked file, at a time
_BATCH = 2 << 20  # bytes of messages decoded together
_PORTION = 4 << 20  # bytes of messages given out together


class Damaged(Exception):
    """Something in the file contradicts itself; becomes an `InputError` with the file's name."""


class UnknownCompression(Damaged):
    """A chunk is compressed with something else than zstd or lz4; becomes an `InputError` with the file's name."""


class Messages(NamedTuple):
    """The messages of some channels in a piece of a file."""

    data: np.ndarray  # (size,) uint8: message records and others
    offsets: dict[int, np.ndarray]  # by channel, (n,) int64 into `data`


@dataclass(slots=True)
class Piece:
    """A chunk, or a run of records outside of chunks."""

    offset: int  # of its first record in the file
    length: int
    start: int  # log times of its messages, ns
    end: int
    index: dict[int, int] | None = None  # by channel, offset of its MessageIndex; None: not known, must be searched
    index_length: int = 0
    chunked: bool = True


@dataclass(slots=True)
class Contents:
    """What the summary of a log says, or a search found."""

    header: Header
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    pieces: list[Piece] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)


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
        """Whether its messages can be decoded, by the look of it: ROS 2."""
        return self.encoding == "cdr" and self.schema_encoding == "ros2msg"


class LogReader:
    """An open log. Closes as a context manager, by `close` or when forgotten; may be used from several threads.

    Args:
        path: an MCAP file.

    Raises:
        InputError: not there, not MCAP, unfinished or damaged; the message says what to do.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._lock = threading.Lock()
        self._definitions: dict[int, Definitions] = {}  # by channel, of those that have been asked for
        self._dtypes: dict[int, np.dtype[Any]] = {}
        self._stream = open_file(self.path)
        try:
            self._size = self._stream.seek(0, os.SEEK_END)
            self._contents = self._guard(self._open)
        except BaseException:
            self._stream.close()
            raise
        self._topics: dict[str, list[int]] = {}
        for number, channel in sorted(self._contents.channels.items()):
            self._topics.setdefault(channel.topic, []).append(number)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

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
        """What wrote the file."""
        return self._contents.header.library

    @property
    def size(self) -> int:
        """Of the file, bytes."""
        return self._size

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
        """Messages in the log."""
        return sum(self._contents.counts.values())

    @property
    def time_range_ns(self) -> tuple[int, int]:
        """Log time of the first and the last message, ns since 1970; (0, 0) without messages."""
        pieces = self._contents.pieces
        return min((p.start for p in pieces), default=0), max((p.end for p in pieces), default=0)

    @property
    def epoch_ns(self) -> int:
        """Zero of the time of flight, ns since 1970: as our logs state it, else the first log time."""
        try:
            return int(self.metadata["log"]["epoch_ns"])
        except (KeyError, ValueError):
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
            for m in (self._indexed(i, Opcode.METADATA, Metadata.read) for i in self._contents.metadata)
        }

    @property
    def attachments(self) -> dict[str, int]:
        """Size in bytes of the attachments, by name."""
        return {a.name: a.data_size for a in self._contents.attachments}

    def attachment(self, name: str) -> bytes:
        """An attachment's content.

        Raises:
            InputError: there is none of that name, or it is damaged.
        """
        for index in self._contents.attachments:
            if index.name == name:
                item: Attachment = self._indexed(index, Opcode.ATTACHMENT, Attachment.read)
                return item.data
        raise InputError(f"{self.path}: no attachment '{name}'{nearest(name, self.attachments)}")

    def dtype(self, topic: str) -> np.dtype[Any]:
        """The type of `read(topic)`: `log_time` (int64, ns since 1970), then the fields of the message.

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
        """All messages of one topic, or of several by topic, sorted by log time.

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

        return self._guard(action)

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
        """As `read`, portion by portion in memory that does not grow with the file.

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
            self._guard(functools.partial(self._gather, self._guard(loaded.__next__), rows, start, end))
            if not last and sum(r.size for r in rows.values()) < _PORTION:
                continue
            ready = {}
            for topic, numbers in plans.items():
                array = self._guard(functools.partial(self._decoded, numbers, rows))
                if len(held[topic]):
                    array = np.concatenate([held[topic], array])
                array = _in_order(array)
                # Pieces may overlap: what the next one could still precede has to wait.
                cut = len(array) if last else int(np.searchsorted(array["log_time"], pieces[i + 1].start, "left"))
                ready[topic], held[topic] = array[:cut], array[cut:]
            if any(len(array) for array in ready.values()):
                yield ready

    def carried(self, topics: Collection[str]) -> dict[int, tuple[Channel, Schema | None]]:
        """Channels of `topics` with their schemas, by number: for `LogWriter.carry`."""
        channels = self._contents.channels
        return {
            n: (channels[n], self._contents.schemas.get(channels[n].schema_id))
            for topic, numbers in self._topics.items()
            if topic in topics
            for n in numbers
        }

    def raw_blocks(self, numbers: Collection[int]) -> Iterator[tuple[int, dict[int, list[np.ndarray]]]]:
        """Message records of channels as they are, in bounded memory, whatever their encoding.

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
            self._guard(functools.partial(self._gather, self._guard(loaded.__next__), rows, None, None))
            found = {n: [batch for batch, _ in r.batches()] for n, r in rows.items() if r.count}
            yield (pieces[i + 1].start if i + 1 < len(pieces) else piece.end), found

    def frame(self, topic: str, start: int | None = None, end: int | None = None) -> "pandas.DataFrame":
        """One topic as a pandas frame: a column for each number (`angular_velocity.x`, `innovation.0`), index log time.

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
        """Channel numbers of a topic, checked to be decodable."""
        if topic not in self._topics:
            raise InputError(f"{self.path}: no topic '{topic}'{nearest(topic, self._topics)}")
        numbers = self._topics[topic]
        kinds = set()
        for number in numbers:
            channel = self._contents.channels[number]
            schema = self._contents.schemas.get(channel.schema_id)
            if channel.message_encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
                form = f"'{channel.message_encoding}' with '{schema.encoding if schema else 'no'}' schema"
                raise InputError(
                    f"{self.path}: topic {topic} is {form}; only ROS 2 messages ('cdr' with 'ros2msg') can be read"
                )
            kinds.add((schema.name, schema.data))
            if number not in self._definitions:
                try:
                    definitions = parse_definitions(schema.name, schema.data.decode(errors="replace"))
                    inner = message_dtype(definitions, schema.name)
                    columns = [("log_time", "<i8"), *((name, inner[name]) for name in inner.names or ())]
                    self._dtypes[number] = np.dtype(columns)
                    self._definitions[number] = definitions
                except (CdrError, ValueError) as error:
                    raise InputError(f"{self.path}: topic {topic}: {error}") from None
        if len(kinds) > 1:
            raise InputError(
                f"{self.path}: topic {topic} carries messages of different types; it cannot be read as one"
            )
        return numbers

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
        """Pieces uncompressed, the next one by another thread meanwhile: zstd and CRC do without Python's lock."""
        with ThreadPoolExecutor(1) as worker:
            ahead = [worker.submit(self._load, piece, wanted) for piece in pieces[:1]]
            for i in range(len(pieces)):
                messages = ahead.pop().result()
                ahead += [worker.submit(self._load, piece, wanted) for piece in pieces[i + 1 : i + 2]]
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
        """The messages gathered of some channels of one topic, in the order of the file; the rows are used up."""
        dtype = self._dtype(numbers)
        arrays = []
        for number in numbers:
            gathered, rows[number] = rows[number], _Rows()
            out = np.empty(gathered.count, dtype)
            for part, places in gathered.batches():
                into = out[places] if isinstance(places, slice) else np.empty(len(part), dtype)
                into["log_time"] = _head_view(part)["log_time"]
                payload = np.ascontiguousarray(part[:, MESSAGE_HEAD.size :])
                decode(self._definitions[number], self._type_name(number), payload, into)
                if not isinstance(places, slice):
                    out[places] = into
            arrays.append(out)
        return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)

    # ------------------------------------------------------------------------------------------- the file

    def _guard(self, action: Callable[[], T]) -> T:
        """Run `action`; whatever damage it meets becomes one `InputError`."""
        try:
            return action()
        except UnknownCompression as error:
            raise InputError(
                f"{self.path}: unknown compression '{error}' (zstd and lz4 are known); compress it anew: mcap compress"
            ) from None
        except (Damaged, CdrError, struct.error, UnicodeDecodeError, OverflowError) as error:
            reason = str(error) or type(error).__name__
            raise InputError(f"{self.path}: damaged: {reason}; 'ahrs-sim recover' saves what is whole") from None
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror or error}") from None

    def _at(self, offset: int, length: int) -> bytes:
        with self._lock:
            return read_at(self._stream, self._size, offset, length)

    def _open(self) -> Contents:
        if self._size == 0:
            raise InputError(f"{self.path}: empty file; nothing was ever logged in it")
        if self._at(0, min(len(MAGIC), self._size)) != MAGIC[: self._size]:
            raise InputError(f"{self.path}: not an MCAP log")
        tail = _FOOTER + len(MAGIC)
        if self._size < 2 * len(MAGIC) + _FOOTER or self._at(self._size - len(MAGIC), len(MAGIC)) != MAGIC:
            raise InputError(
                f"{self.path}: unfinished or cut off; save what is there with 'ahrs-sim recover {self.path} -o OUT'"
            )
        end = self._at(self._size - tail, _FOOTER)
        if RECORD_HEAD.unpack_from(end) != (Opcode.FOOTER, 20):
            raise Damaged("no footer")
        footer = parse(Footer.read, end[RECORD_HEAD.size :])
        header = self._header()
        if footer.summary_start:
            contents = self._summary(footer, end, header)
            if contents:
                return contents
        return self._search(header)

    def _header(self) -> Header:
        opcode, length = RECORD_HEAD.unpack(self._at(len(MAGIC), RECORD_HEAD.size))
        if opcode != Opcode.HEADER:
            raise Damaged("no header")
        header: Header = parse(Header.read, self._at(len(MAGIC) + RECORD_HEAD.size, length))
        return header

    def _summary(self, footer: Footer, end: bytes, header: Header) -> Contents | None:
        """The contents as the summary states them; None when it does not state enough."""
        data = self._at(footer.summary_start, self._size - len(MAGIC) - _FOOTER - footer.summary_start)
        if footer.summary_crc and zlib.crc32(end[:-4], zlib.crc32(data)) != footer.summary_crc:
            raise Damaged("the summary does not match its checksum")
        contents = Contents(header)
        statistics: Statistics | None = None
        for opcode, offset, length in records(data):
            body = data[offset : offset + length]
            if opcode == Opcode.SCHEMA:
                schema = parse(Schema.read, body)
                contents.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = parse(Channel.read, body)
                contents.channels[channel.id] = channel
            elif opcode == Opcode.STATISTICS:
                statistics = parse(Statistics.read, body)
            elif opcode == Opcode.CHUNK_INDEX:
                chunk = parse(ChunkIndex.read, body)
                index = chunk.message_index_offsets if chunk.message_index_length else None
                contents.pieces.append(
                    Piece(
                        chunk.chunk_start_offset,
                        chunk.chunk_length,
                        chunk.message_start_time,
                        chunk.message_end_time,
                        index,
                        chunk.message_index_length,
                    )
                )
            elif opcode == Opcode.ATTACHMENT_INDEX:
                contents.attachments.append(parse(AttachmentIndex.read, body))
            elif opcode == Opcode.METADATA_INDEX:
                contents.metadata.append(parse(MetadataIndex.read, body))
        if statistics is None:
            return None
        contents.counts = dict(statistics.channel_message_counts)
        if sum(contents.counts.values()) != statistics.message_count:
            return None
        used = {c for p in contents.pieces for c in (p.index or ())} | {c for c, n in contents.counts.items() if n}
        enough = (
            len(contents.pieces) == statistics.chunk_count
            and len(contents.metadata) == statistics.metadata_count
            and len(contents.attachments) == statistics.attachment_count
            and used <= contents.channels.keys()
            and (statistics.message_count == 0 or contents.pieces)
            and all(c.schema_id == 0 or c.schema_id in contents.schemas for c in contents.channels.values())
        )
        return contents if enough else None

    def _search(self, header: Header) -> Contents:
        """The contents as found by walking through a file whose summary says too little."""
        contents = Contents(header)
        run_start = at = len(MAGIC)
        run_messages = False

        def close_run(end: int) -> None:
            if run_messages:
                contents.pieces.append(Piece(run_start, end - run_start, 0, 0, chunked=False))

        while at + RECORD_HEAD.size <= self._size:
            opcode, length = RECORD_HEAD.unpack(self._at(at, RECORD_HEAD.size))
            if length > self._size - at - RECORD_HEAD.size:
                raise Damaged(f"the record at {at} is longer than the file")
            whole = RECORD_HEAD.size + length
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            if opcode == Opcode.MESSAGE:
                run_messages = True
            elif opcode == Opcode.CHUNK:
                close_run(at)
                contents.pieces.append(Piece(at, whole, 0, 0))
                run_start, run_messages = at + whole, False
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                register(contents, opcode, self._at(at + RECORD_HEAD.size, length))
            elif opcode == Opcode.METADATA:
                metadata = parse(Metadata.read, self._at(at + RECORD_HEAD.size, length))
                contents.metadata.append(MetadataIndex(at, whole, metadata.name))
            elif opcode == Opcode.ATTACHMENT:
                item = parse(Attachment.read, self._at(at + RECORD_HEAD.size, length))
                contents.attachments.append(
                    AttachmentIndex(
                        at, whole, item.log_time, item.create_time, len(item.data), item.name, item.media_type
                    )
                )
            at += whole
            if run_messages and at - run_start > _PIECE:
                close_run(at)
                run_start, run_messages = at, False
        close_run(at)
        for piece in contents.pieces:
            messages = self._load(piece, None, contents)
            times = []
            for number, offsets in messages.offsets.items():
                if number not in contents.channels:
                    raise Damaged(f"messages of an unknown channel {number}")
                contents.counts[number] = contents.counts.get(number, 0) + len(offsets)
                seen = message_heads(messages.data, offsets, number)["log_time"].astype(np.int64)
                times += [int(seen.min()), int(seen.max())]
            piece.start, piece.end = min(times, default=0), max(times, default=0)
        return contents

    def _load(self, piece: Piece, wanted: set[int] | None, found: Contents | None = None) -> Messages:
        """A piece uncompressed, and where in it are the messages of the channels `wanted` (None: of all).

        Schemas and channels that are met go into `found`.
        """
        raw = self._at(piece.offset, piece.length + (piece.index_length if piece.index is not None else 0))
        if not piece.chunked:
            data = np.frombuffer(raw, np.uint8)
            return Messages(data, find_messages(raw, wanted, found))
        opcode, length = RECORD_HEAD.unpack_from(raw)
        if opcode != Opcode.CHUNK or length != piece.length - RECORD_HEAD.size:
            raise Damaged(f"no chunk at {piece.offset}")
        content = uncompress(memoryview(raw)[RECORD_HEAD.size : piece.length])
        data = np.frombuffer(content, np.uint8)
        if piece.index is None or wanted is None:
            return Messages(data, find_messages(content, wanted, found))
        offsets = {}
        for number in wanted & piece.index.keys():
            at = piece.index[number] - piece.offset
            if not 0 <= at <= len(raw) - 15:
                raise Damaged(f"the message index of channel {number} lies outside of its chunk's")
            opcode, length, owner, size = struct.unpack_from("<BQHI", raw, at)
            if (
                opcode != Opcode.MESSAGE_INDEX
                or owner != number
                or size != length - 6
                or size % 16
                or size > len(raw) - at - 15
            ):
                raise Damaged(f"the message index of channel {number} is wrong")
            entries = np.frombuffer(raw, "<u8", size // 8, at + 15).reshape(-1, 2)
            offsets[number] = entries[:, 1].astype(np.int64)
        return Messages(data, offsets)

    def _indexed(
        self, index: AttachmentIndex | MetadataIndex, opcode: Opcode, read: Callable[[ReadDataStream], T]
    ) -> T:
        def action() -> T:
            data = self._at(index.offset, index.length)
            if len(data) < RECORD_HEAD.size or RECORD_HEAD.unpack_from(data) != (opcode, len(data) - RECORD_HEAD.size):
                raise Damaged(f"no {opcode.name.lower()} at {index.offset}")
            return parse(read, data[RECORD_HEAD.size :])

        return self._guard(action)


# ----------------------------------------------------------------------------------------------- pieces of files


def open_file(path: Path) -> IO[bytes]:
    """Open a file for reading.

    Raises:
        InputError: it is not there, is no plain file (a pipe would be waited for), or may not be read.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: cannot be read: it is not a file")
        return path.open("rb")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def read_at(stream: IO[bytes], size: int, offset: int, length: int) -> bytes:
    """Bytes of a file of `size` bytes.

    Raises:
        Damaged: they are not all inside, or more than anything should have.
    """
    if not 0 <= offset <= size or not 0 <= length <= size - offset:
        raise Damaged(f"{length} bytes at {offset} lie outside of the file")
    if length > MAX_CHUNK + _PIECE:
        raise Damaged(f"a record of {length} bytes at {offset} is larger than any should be")
    stream.seek(offset)
    data = stream.read(length)
    if len(data) != length:
        raise Damaged("the file became shorter while it was read")
    return data


def records(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and length of the content of each record.

    Raises:
        Damaged: the last one is longer than the data.
    """
    at, size = 0, len(data)
    unpack = RECORD_HEAD.unpack_from
    while at < size:
        if at + 9 > size:
            raise Damaged("a record is cut off")
        opcode, length = unpack(data, at)
        if length > size - at - 9:
            raise Damaged("a record is longer than what holds it")
        yield opcode, at + 9, length
        at += 9 + length


def uncompress(chunk: memoryview) -> bytes:
    """The content of a chunk record.

    Raises:
        Damaged: its compression is unknown, or sizes or checksum do not agree.
    """
    start, end, size, crc = _CHUNK_HEAD.unpack_from(chunk)
    del start, end
    at = _CHUNK_HEAD.size
    (name_length,) = struct.unpack_from("<I", chunk, at)
    if name_length > len(chunk) - at - 12:
        raise Damaged("a chunk's compression has no name")
    compression = bytes(chunk[at + 4 : at + 4 + name_length]).decode()
    at += 4 + name_length
    (stored,) = struct.unpack_from("<Q", chunk, at)
    data = chunk[at + 8 :]
    if stored != len(data):
        raise Damaged("a chunk is longer or shorter than it says")
    if size > MAX_CHUNK:
        raise Damaged(f"a chunk of {size} bytes is larger than any should be")
    if compression == "zstd":
        content = _zstd(data, size)
    elif compression == "lz4":
        content = _lz4(data, size)
    elif compression == "":
        content = bytes(data)
    else:
        raise UnknownCompression(compression)
    if len(content) != size:
        raise Damaged("a chunk has not the size it says")
    if crc and zlib.crc32(content) != crc:
        raise Damaged("a chunk does not match its checksum")
    return content


def _zstd(data: memoryview, size: int) -> bytes:
    import zstandard

    try:
        # An honest frame knows its size or has none; asked first, because it decides what is allocated.
        if size == 0 or zstandard.frame_content_size(data) not in (size, -1):
            return b""
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    except zstandard.ZstdError as error:
        raise Damaged(f"a chunk cannot be uncompressed ({error})") from None


def _lz4(data: memoryview, size: int) -> bytes:
    import lz4.frame

    try:
        return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)  # type: ignore[no-any-return]
    except (RuntimeError, EOFError) as error:
        raise Damaged(f"a chunk cannot be uncompressed ({error})") from None


def find_messages(
    data: bytes | memoryview, wanted: set[int] | None, found: Contents | None = None
) -> dict[int, np.ndarray]:
    """Offsets of the messages in a run of records, by channel; schemas and channels met go into `found`."""
    offsets: dict[int, list[int]] = {}
    channel_of = struct.Struct("<H").unpack_from
    for opcode, at, length in records(data):
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE_HEAD.size - RECORD_HEAD.size:
                raise Damaged("a message is cut off")
            (channel,) = channel_of(data, at)
            if wanted is None or channel in wanted:
                offsets.setdefault(channel, []).append(at - RECORD_HEAD.size)
        elif found is not None and opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            register(found, opcode, bytes(data[at : at + length]))
    return {channel: np.array(places, np.int64) for channel, places in offsets.items()}


def register(contents: Contents, opcode: int, body: bytes) -> None:
    """Note a schema or a channel."""
    if opcode == Opcode.SCHEMA:
        schema = parse(Schema.read, body)
        contents.schemas.setdefault(schema.id, schema)
    else:
        channel = parse(Channel.read, body)
        contents.channels.setdefault(channel.id, channel)


def parse(read: Callable[[ReadDataStream], T], body: bytes) -> T:
    """A record from its content.

    Raises:
        Damaged: the content is not that of such a record.
    """
    try:
        return read(ReadDataStream(BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError) as error:
        raise Damaged(f"a record cannot be understood ({str(error) or type(error).__name__})") from None


_HEAD_TYPE = np.dtype(
    {
        "names": ["opcode", "length", "channel", "sequence", "log_time", "publish_time"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
        "offsets": [0, 1, 9, 11, 15, 23],
        "itemsize": MESSAGE_HEAD.size,
    }
)


def _head_view(rows: np.ndarray) -> np.ndarray:
    return np.ndarray((len(rows),), _HEAD_TYPE, rows, 0, (rows.strides[0],))


def _rows(data: np.ndarray, offsets: np.ndarray, size: int) -> np.ndarray:
    """Copy of `size` bytes at each offset, (n, size); the caller has checked that they are inside."""
    copy: np.ndarray = np.ndarray((data.size - size + 1, size), np.uint8, data, 0, (1, 1))[offsets]
    return copy


def message_heads(data: np.ndarray, offsets: np.ndarray, channel: int | np.ndarray) -> np.ndarray:
    """Heads of the messages of a channel at `offsets`, checked to be that and to lie inside.

    Raises:
        Damaged: they are not.
    """
    last = data.size - MESSAGE_HEAD.size
    if offsets.min() < 0 or offsets.max() > last:
        raise Damaged("a message lies outside of its chunk")
    heads = _head_view(_rows(data, offsets, MESSAGE_HEAD.size))
    ends = heads["length"] + np.uint64(RECORD_HEAD.size)
    if (heads["opcode"] != Opcode.MESSAGE).any() or (heads["channel"] != channel).any():
        raise Damaged("a message index points elsewhere")
    if (heads["length"] < MESSAGE_HEAD.size - RECORD_HEAD.size).any() or (heads["length"] > data.size).any():
        raise Damaged("a message is longer than its chunk")
    if (offsets + ends.astype(np.int64) > data.size).any():
        raise Damaged("a message is longer than its chunk")
    return heads


def _numbers(plans: dict[str, list[int]]) -> set[int]:
    return {number for numbers in plans.values() for number in numbers}


def _in_order(array: np.ndarray) -> np.ndarray:
    """Sorted by log time, equal times as they were."""
    times = np.ascontiguousarray(array["log_time"])
    return array if (times[1:] >= times[:-1]).all() else array[np.argsort(times, kind="stable")]


class _Rows:
    """Messages of one channel, as rows of bytes."""

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
            self._by_size.setdefault(int(sizes[0]), []).append((_rows(data, offsets, int(sizes[0])), which))
            return
        for size in np.unique(sizes):
            same = sizes == size
            self._by_size.setdefault(int(size), []).append((_rows(data, offsets[same], int(size)), which[same]))

    def batches(self) -> Iterator[tuple[np.ndarray, np.ndarray | slice]]:
        """Rows of equal size in handy portions, and which messages they are; used up."""
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
    """(n, 3) from a column of `geometry_msgs/Vector3` or `Point`."""
    return np.stack([column["x"], column["y"], column["z"]], axis=-1)


def quaternion(column: np.ndarray) -> np.ndarray:
    """(n, 4) scalar first from a column of `geometry_msgs/Quaternion`."""
    return np.stack([column["w"], column["x"], column["y"], column["z"]], axis=-1)


def stamps(array: np.ndarray) -> np.ndarray:
    """(n,) int64, ns since 1970: the header stamps of an array from `read`."""
    stamp = array["header"]["stamp"]
    nanoseconds: np.ndarray = stamp["sec"].astype(np.int64) * 1_000_000_000 + stamp["nanosec"]
    return nanoseconds


def flatten(array: np.ndarray, prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Name and values of every column of an array from `read`: `angular_velocity.x`, `innovation.0`."""
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
