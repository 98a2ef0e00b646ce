"""The MCAP container for reading: contents of a file, and its pieces uncompressed.

Lengths and offsets in a file are not trusted: each is checked against what is there before anything is allocated.
Knows nothing of messages' contents; the other direction is `ahrs_sim.log.mcap.container`.
"""

import os
import struct
import threading
import zlib
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple, TypeVar

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

from ahrs_sim.errors import InputError
from ahrs_sim.log.mcap.cdr import CdrError
from ahrs_sim.log.mcap.container import MAGIC, MESSAGE_HEAD, RECORD_HEAD

T = TypeVar("T")

MAX_CHUNK = 256 << 20
"""Largest chunk or record that is read, bytes uncompressed; a larger size is taken for damage."""

_LAST_NS = 2**63 - 1
_FOOTER = RECORD_HEAD.size + 20
_CHUNK_HEAD = struct.Struct("<QQQI")  # start, end, uncompressed size, checksum
_PIECE = 8 << 20  # of an unchunked file, at a time
_WINDOW = 1 << 18  # of a file that is walked through, at a time


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
    """Contents of a log as stated by its summary, or found by a search."""

    header: Header
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    pieces: list[Piece] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)


class LogFile:
    """An open MCAP file and what is in it; may be used from several threads.

    Args:
        path: an MCAP file.

    Raises:
        InputError: not there, not MCAP, unfinished or damaged; the message names the remedy.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._stream = open_file(path)
        try:
            self.size = self._stream.seek(0, os.SEEK_END)
            self.contents = self.guard(self._open)
        except BaseException:
            self._stream.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def guard(self, action: Callable[[], T]) -> T:
        """Run `action` and raise any damage that it finds as one `InputError`."""
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
            return read_at(self._stream, self.size, offset, length)

    def _open(self) -> Contents:
        if self.size == 0:
            raise InputError(f"{self.path}: empty file; nothing was ever logged in it")
        if self._at(0, min(len(MAGIC), self.size)) != MAGIC[: self.size]:
            raise InputError(f"{self.path}: not an MCAP log")
        tail = _FOOTER + len(MAGIC)
        if self.size < 2 * len(MAGIC) + _FOOTER or self._at(self.size - len(MAGIC), len(MAGIC)) != MAGIC:
            raise InputError(
                f"{self.path}: unfinished or cut off; save what is there with 'ahrs-sim recover {self.path} -o OUT'"
            )
        end = self._at(self.size - tail, _FOOTER)
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
        """Read the contents from the summary; None when it is incomplete."""
        data = self._at(footer.summary_start, self.size - len(MAGIC) - _FOOTER - footer.summary_start)
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
                if max(chunk.message_start_time, chunk.message_end_time) > _LAST_NS:
                    raise Damaged("a chunk is of after the year 2262")
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
        """Find the contents by walking through a file whose summary is incomplete."""
        contents = Contents(header)
        run_start = at = len(MAGIC)
        run_messages = False

        def close_run(end: int) -> None:
            if run_messages:
                contents.pieces.append(Piece(run_start, end - run_start, 0, 0, chunked=False))

        window, begun, before = b"", 0, (0, 0)
        while at + RECORD_HEAD.size <= self.size:
            if not begun <= at <= begun + len(window) - RECORD_HEAD.size:
                window, begun = self._at(at, min(_WINDOW, self.size - at)), at
            opcode, length = RECORD_HEAD.unpack_from(window, at - begun)
            if length > self.size - at - RECORD_HEAD.size:
                raise Damaged(f"the record at {at} is longer than the file")
            whole = RECORD_HEAD.size + length
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            if opcode == Opcode.MESSAGE:
                run_messages = True
                if (opcode, length) == before and whole <= len(window) - (at - begun):  # one more of the same size
                    whole = alike(np.frombuffer(window, np.uint8)[at - begun :], whole).size
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
            elif length > _PIECE:  # an unknown record is not loaded with the messages around it
                close_run(at)
                run_start, run_messages = at + whole, False
            at, before = at + whole, (opcode, length)
            if run_messages and at - run_start > _PIECE:
                close_run(at)
                run_start, run_messages = at, False
        close_run(at)
        for piece in contents.pieces:
            messages = self.load(piece, None, contents)
            times = []
            for number, offsets in messages.offsets.items():
                if number not in contents.channels:
                    raise Damaged(f"messages of an unknown channel {number}")
                contents.counts[number] = contents.counts.get(number, 0) + len(offsets)
                seen = message_heads(messages.data, offsets, number)["log_time"].astype(np.int64)
                times += [int(seen.min()), int(seen.max())]
            piece.start, piece.end = min(times, default=0), max(times, default=0)
        return contents

    def load(self, piece: Piece, wanted: set[int] | None, found: Contents | None = None) -> Messages:
        """Uncompress a piece and find the messages of the channels `wanted` (None: of all) in it.

        Schemas and channels in it are added to `found`.
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

    def indexed(self, index: AttachmentIndex | MetadataIndex, opcode: Opcode, read: Callable[[ReadDataStream], T]) -> T:
        """Read the attachment or metadata record that an index points at.

        Raises:
            InputError: it is damaged.
        """

        def action() -> T:
            data = self._at(index.offset, index.length)
            if len(data) < RECORD_HEAD.size or RECORD_HEAD.unpack_from(data) != (opcode, len(data) - RECORD_HEAD.size):
                raise Damaged(f"no {opcode.name.lower()} at {index.offset}")
            return parse(read, data[RECORD_HEAD.size :])

        return self.guard(action)


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
    """Read bytes of a file of `size` bytes.

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


def records(data: bytes | memoryview, at: int = 0) -> Iterator[tuple[int, int, int]]:
    """Find opcode, offset and length of the content of each record from `at` on.

    Raises:
        Damaged: the last one is longer than the data.
    """
    size = len(data)
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
    """Uncompress the content of a chunk record.

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
        raise Damaged("a chunk is longer or shorter than its header states")
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
        raise Damaged("a chunk has not the size that its header states")
    if crc and zlib.crc32(content) != crc:
        raise Damaged("a chunk does not match its checksum")
    return content


def _zstd(data: memoryview, size: int) -> bytes:
    import zstandard

    try:
        # A valid frame knows its size or has none; asked first, because it decides what is allocated.
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
    """Find the messages in a run of records: offsets by channel; add schemas and channels to `found`."""
    offsets: dict[int, array[int]] = {}
    channel_of = struct.Struct("<H").unpack_from
    whole = np.frombuffer(data, np.uint8)
    at, size, before = 0, len(data), b""
    while at < size:
        opcode, body, length = next(records(data, at))
        head = bytes(data[at:body])
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE_HEAD.size - RECORD_HEAD.size:
                raise Damaged("a message is cut off")
            if head == before:  # one more of the same size: all of them at once
                rows = alike(whole[at:], RECORD_HEAD.size + length)
                channels = rows[:, 9].astype(np.int64) | rows[:, 10].astype(np.int64) << 8
                places = at + np.arange(len(rows), dtype=np.int64) * rows.shape[1]
                for channel in np.unique(channels).tolist():
                    if wanted is None or channel in wanted:
                        offsets.setdefault(channel, array("q")).frombytes(places[channels == channel].tobytes())
                at += rows.size
                continue
            (channel,) = channel_of(data, body)
            if wanted is None or channel in wanted:
                offsets.setdefault(channel, array("q")).append(at)
        elif found is not None and opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            register(found, opcode, bytes(data[body : body + length]))
        at, before = body + length, head
    return {channel: np.frombuffer(places, np.int64) for channel, places in offsets.items()}


def alike(data: np.ndarray, size: int) -> np.ndarray:
    """Select the whole records of `size` bytes (n, size) at the beginning of `data` with one opcode and length."""
    rows = data[: len(data) // size * size].reshape(-1, size)
    n, step = 1, 16
    while n < len(rows):
        same = (rows[n : n + step, : RECORD_HEAD.size] == rows[0, : RECORD_HEAD.size]).all(axis=1)
        if not same.all():
            return rows[: n + int(np.argmin(same))]
        n, step = n + len(same), 2 * step
    return rows


def register(contents: Contents, opcode: int, body: bytes) -> None:
    """Note a schema or a channel."""
    if opcode == Opcode.SCHEMA:
        schema = parse(Schema.read, body)
        contents.schemas.setdefault(schema.id, schema)
    else:
        channel = parse(Channel.read, body)
        contents.channels.setdefault(channel.id, channel)


def parse(read: Callable[[ReadDataStream], T], body: bytes) -> T:
    """Parse a record from its content.

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


def head_view(rows: np.ndarray) -> np.ndarray:
    """View the heads of messages that are rows of bytes (n, size)."""
    return np.ndarray((len(rows),), _HEAD_TYPE, rows, 0, (rows.strides[0],))


def rows_at(data: np.ndarray, offsets: np.ndarray, size: int) -> np.ndarray:
    """Copy `size` bytes at each offset, (n, size); the caller has checked that they are inside."""
    copy: np.ndarray = np.ndarray((data.size - size + 1, size), np.uint8, data, 0, (1, 1))[offsets]
    return copy


def message_heads(data: np.ndarray, offsets: np.ndarray, channel: int | np.ndarray) -> np.ndarray:
    """Read the heads of a channel's messages at `offsets`; check channel, size and time.

    Raises:
        Damaged: they are not.
    """
    last = data.size - MESSAGE_HEAD.size
    if offsets.min() < 0 or offsets.max() > last:
        raise Damaged("a message lies outside of its chunk")
    heads = head_view(rows_at(data, offsets, MESSAGE_HEAD.size))
    ends = heads["length"] + np.uint64(RECORD_HEAD.size)
    if (heads["opcode"] != Opcode.MESSAGE).any() or (heads["channel"] != channel).any():
        raise Damaged("a message index points elsewhere")
    if (heads["length"] < MESSAGE_HEAD.size - RECORD_HEAD.size).any() or (heads["length"] > data.size).any():
        raise Damaged("a message is longer than its chunk")
    if (offsets + ends.astype(np.int64) > data.size).any():
        raise Damaged("a message is longer than its chunk")
    if (heads["log_time"] > _LAST_NS).any():
        raise Damaged("a message is of after the year 2262")
    return heads
