"""The MCAP container for writing: records in order, their indexes, and the summary at the end.

Shared by the writer (new logs) and `recover` (unfinished ones). Knows nothing of messages' contents.
"""

import struct
import zlib
from typing import IO

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "ros2"
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # the same, channel, sequence, log time, publish time

Index = dict[int, np.ndarray]
"""By channel: (n, 2) uint64, log time and offset of each message in its uncompressed chunk."""


def _encoded(record: McapRecord) -> bytes:
    """Encode a record as it is stored in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


class Container:
    """Writes one MCAP file front to back.

    Args:
        stream: opened for writing, at its start.
        header: profile and library.
    """

    def __init__(self, stream: IO[bytes], header: Header) -> None:
        self._stream = stream
        self._at = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._chunks: list[bytes] = []  # their index records: as objects they would be the most of a long log's memory
        self._span: tuple[int, int] | None = None  # log times, ns
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._write(MAGIC)
        self._record(header)

    def _write(self, data: bytes | memoryview) -> None:
        self._stream.write(data)
        self._at += len(data)

    def _record(self, record: McapRecord) -> tuple[int, int]:
        """Write a record; return its offset and length."""
        start = self._at
        self._write(_encoded(record))
        return start, self._at - start

    def flush(self) -> None:
        """Hand everything to the operating system, so that it survives the death of this process."""
        self._stream.flush()

    def schema(self, schema: Schema) -> None:
        """Write a schema; skip one that is already there."""
        if schema.id not in self._schemas:
            self._schemas[schema.id] = schema
            self._record(schema)

    def channel(self, channel: Channel) -> None:
        """Write a channel; skip one that is already there."""
        if channel.id not in self._channels:
            self._channels[channel.id] = channel
            self._record(channel)

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        offset, length = self._record(Metadata(name=name, metadata=values))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def attachment(self, item: Attachment) -> None:
        """Write an attachment."""
        offset, length = self._record(item)
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                log_time=item.log_time,
                create_time=item.create_time,
                data_size=len(item.data),
                name=item.name,
                media_type=item.media_type,
            )
        )

    def chunk(self, chunk: Chunk, index: Index) -> None:
        """Write a chunk and the index of its messages, and flush: the unit that survives a crash."""
        start, length = self._record(chunk)
        offsets = {}
        for channel, entries in index.items():
            offsets[channel] = self._at
            size = 16 * len(entries)
            head = RECORD_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size) + struct.pack("<HI", channel, size)
            self._write(head + entries.astype("<u8", copy=False).tobytes())
            self._counts[channel] = self._counts.get(channel, 0) + len(entries)
        entry = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=self._at - start - length,
            message_index_offsets=offsets,
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
        self._chunks.append(_encoded(entry))
        low, high = self._span or (chunk.message_start_time, chunk.message_end_time)
        self._span = min(low, chunk.message_start_time), max(high, chunk.message_end_time)
        self.flush()

    @property
    def message_count(self) -> int:
        """Number of messages in the chunks so far."""
        return sum(self._counts.values())

    @property
    def end_time(self) -> int:
        """Latest log time so far, ns; 0 without messages."""
        return self._span[1] if self._span else 0

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._record(DataEnd(0))  # 0: no checksum over the data; every chunk has its own
        summary_start = self._at
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(sorted(self._counts.items())),
            chunk_count=len(self._chunks),
            message_count=self.message_count,
            message_end_time=self.end_time,
            message_start_time=self._span[0] if self._span else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, bytes]] = [
            (Opcode.SCHEMA, b"".join(map(_encoded, self._schemas.values()))),
            (Opcode.CHANNEL, b"".join(map(_encoded, self._channels.values()))),
            (Opcode.STATISTICS, _encoded(statistics)),
            (Opcode.CHUNK_INDEX, b"".join(self._chunks)),
            (Opcode.ATTACHMENT_INDEX, b"".join(map(_encoded, self._attachments))),
            (Opcode.METADATA_INDEX, b"".join(map(_encoded, self._metadata))),
        ]
        offset_start = summary_start
        offsets = []
        for opcode, records in groups:
            if records:
                offsets.append(SummaryOffset(opcode, offset_start, len(records)))
            offset_start += len(records)
        summary = b"".join([*(records for _, records in groups), *map(_encoded, offsets)])
        self._write(summary)
        # The footer's checksum covers the summary and the footer up to the checksum itself.
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offset_start)
        self._record(Footer(summary_start, offset_start, zlib.crc32(head, zlib.crc32(summary))))
        self._write(MAGIC)
        self.flush()
