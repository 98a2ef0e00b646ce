"""Repair the log of an interrupted flight, or any MCAP file that is cut off or damaged.

Everything whole is kept as it is: whole chunks, loose messages, schemas, metadata, attachments. The indexes and the
summary are made anew. A log that was finished comes out byte for byte the same.
"""

import contextlib
import datetime
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Header, Metadata

from ahrs_sim.errors import InputError, LogError
from ahrs_sim.log.mcap.container import MAGIC, RECORD_HEAD, Container, Index
from ahrs_sim.log.mcap.pieces import (
    Contents,
    Damaged,
    find_messages,
    message_heads,
    open_file,
    parse,
    read_at,
    register,
    uncompress,
)

_OPCODES = frozenset(Opcode)
_RUN = 1 << 20  # bytes of loose messages that make a chunk
_DAMAGE = (Damaged, struct.error, UnicodeDecodeError, OverflowError)


@dataclass(frozen=True, slots=True)
class Recovered:
    """Counts of what was recovered."""

    messages: int
    end_ns: int  # latest log time, ns since 1970; 0 without messages
    damaged: int  # chunks and other records that had to be left out
    lost_bytes: int  # at the end of the file, behind the last whole record
    complete: bool  # the log had been finished, and is as it was

    def __str__(self) -> str:
        if not self.messages:
            return "no whole messages found"
        end = datetime.datetime.fromtimestamp(self.end_ns // 10**9, datetime.UTC).isoformat(sep=" ")[:19]
        text = f"{self.messages} messages recovered, the last at {end} UTC"
        if self.complete:
            return text + "; nothing was missing"
        return text + f"; {self.damaged} damaged records and {self.lost_bytes} bytes at the end left out"


def recover(part: str | Path, output: str | Path, *, force: bool = False) -> Recovered:
    """Write a log `output` from all that is whole in `part`, which is not changed.

    Raises:
        InputError: `part` is not (the beginning of) an MCAP file, or `output` exists or cannot be created.
        LogError: `output` cannot be written on.
    """
    part, output = Path(part), Path(output)
    if output.exists() and not force:
        raise InputError(f"{output}: exists already; choose another name, overwrite with --force")
    if output.exists() and output.samefile(part):
        raise InputError(f"{output}: is the file to recover from; choose another name")
    unfinished = output.with_name(output.name + ".recovering")
    with open_file(part) as source:
        walk = _Walk(part, source)
        try:
            output.parent.mkdir(parents=True, exist_ok=True)
            if force:
                unfinished.unlink(missing_ok=True)
            stream = unfinished.open("xb")
        except FileExistsError:
            raise InputError(
                f"{unfinished}: exists already, another recovery may be running; remove it, or overwrite with --force"
            ) from None
        except OSError as error:
            raise InputError(f"{output}: cannot be created: {error.strerror or error}; choose another place") from None
        try:
            with stream:
                result = walk.into(stream)
            unfinished.replace(output)
        except OSError as error:
            raise LogError(f"{output}: cannot be written: {error.strerror or error}") from None
        finally:
            with contextlib.suppress(OSError):
                unfinished.unlink(missing_ok=True)
    return result


class _Walk:
    """Walks through the records of a file and copies the whole ones."""

    def __init__(self, path: Path, source: IO[bytes]) -> None:
        self.source = source
        self.size = path.stat().st_size
        self.at = len(MAGIC)
        self.found = Contents(Header("", ""))
        self.damaged = 0
        self.run: list[bytes] = []
        if self.size == 0:
            raise InputError(f"{path}: empty file; there is nothing to recover")
        with contextlib.suppress(*_DAMAGE, OSError):
            if read_at(source, self.size, 0, len(MAGIC)) == MAGIC:
                opcode, body = self.next()
                if opcode == Opcode.HEADER:
                    self.header = parse(Header.read, body)
                    return
        raise InputError(f"{path}: not the beginning of an MCAP log; there is nothing to recover")

    def next(self) -> tuple[int, bytes]:
        """Read the next record; stay in front of it when it is not whole."""
        opcode, length = RECORD_HEAD.unpack(read_at(self.source, self.size, self.at, RECORD_HEAD.size))
        known = opcode in _OPCODES  # others may be of any length; nothing is done with them
        body = read_at(self.source, self.size, self.at + RECORD_HEAD.size, length) if known else b""
        if length > self.size - self.at - RECORD_HEAD.size:
            raise Damaged("a record is longer than the file")
        self.at += RECORD_HEAD.size + length
        return opcode, body

    def into(self, stream: IO[bytes]) -> Recovered:
        """Write all whole records from here on."""
        self.file = Container(stream, self.header)
        complete, lost = False, 0
        while True:
            try:
                opcode, body = self.next()
            except _DAMAGE:
                lost = self.size - self.at
                break
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):  # a summary behind it is made anew
                complete = self.damaged == 0 and self.ends_well()
                break
            try:
                self.record(opcode, body)
            except _DAMAGE:
                self.damaged += 1
        self.end_run()
        result = Recovered(self.file.message_count, self.file.end_time, self.damaged, lost, complete)
        if not complete:
            values = {"messages": str(result.messages), "end_ns": str(result.end_ns), "damaged": str(self.damaged)}
            self.file.metadata("recovered", values)
        self.file.finish()
        return result

    def ends_well(self) -> bool:
        """Test for a footer at the end of the file."""
        tail = RECORD_HEAD.size + 20 + len(MAGIC)
        end = read_at(self.source, self.size, max(self.size - tail, 0), min(tail, self.size))
        return end.endswith(MAGIC) and end.startswith(RECORD_HEAD.pack(Opcode.FOOTER, 20))

    def record(self, opcode: int, body: bytes) -> None:
        """Copy one record."""
        if opcode == Opcode.MESSAGE:
            self.run.append(RECORD_HEAD.pack(opcode, len(body)) + body)
            if sum(map(len, self.run[-64:])) > _RUN or len(self.run) >= 4096:
                self.end_run()
            return
        if opcode == Opcode.CHUNK:
            self.end_run()
            self.chunk(parse(Chunk.read, body), uncompress(memoryview(body)))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            register(self.found, opcode, body)
            self.declare()
        elif opcode == Opcode.METADATA:
            metadata = parse(Metadata.read, body)
            self.file.metadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.ATTACHMENT:
            self.file.attachment(parse(Attachment.read, body))

    def declare(self) -> None:
        """Write the schemas and channels found since."""
        for schema in self.found.schemas.values():
            self.file.schema(schema)
        for channel in self.found.channels.values():
            self.file.channel(channel)

    def chunk(self, chunk: Chunk, content: bytes) -> None:
        """Copy a chunk and index it."""
        data = np.frombuffer(content, np.uint8)
        index: Index = {}
        for number, offsets in sorted(find_messages(content, None, self.found).items()):
            if number not in self.found.channels:
                raise Damaged(f"messages of an unknown channel {number}")
            times = message_heads(data, offsets, number)["log_time"]
            index[number] = np.column_stack((times, offsets.astype(np.uint64)))
        self.declare()
        if index:
            # Found, not as the chunk states: readers choose by these.
            chunk.message_start_time = min(int(entries[:, 0].min()) for entries in index.values())
            chunk.message_end_time = max(int(entries[:, 0].max()) for entries in index.values())
        self.file.chunk(chunk, index)

    def end_run(self) -> None:
        """Make a chunk of the loose messages gathered."""
        content = b"".join(self.run)
        self.run = []
        if content:
            data = zstandard.ZstdCompressor(level=1).compress(content)
            try:
                self.chunk(Chunk("zstd", data, 0, 0, zlib.crc32(content), len(content)), content)
            except _DAMAGE:
                self.damaged += 1
