"""Write a log: columns of messages in, one MCAP file out.

    with LogWriter("flight.mcap", epoch_ns=epoch) as log:
        imu = log.add_channel("/chr/imu/data_raw", "sensor_msgs/msg/Imu", frame_id="base_link_frd")
        log.metadata("seeds", {"flight": "1"})
        log.start()
        log.write(imu, arrival_ns, stamp_ns, angular_velocity=gyro_b, linear_acceleration=accel_b)
        log.advance(t_ns)

All messages of a call are encoded at once: a copy of the channel's template for each, then one strided copy a field.
Chunks are cut on a fixed grid of log time, so that the bytes of the file depend on the messages and not on the calls
that wrote them. One worker thread compresses and writes; its queue is short, so memory stays bounded.
"""

import contextlib
import dataclasses
import os
import queue
import threading
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
import zstandard
from mcap.records import Attachment, Channel, Chunk, Header, Schema

from ahrs_sim.errors import InputError, LogError
from ahrs_sim.log import messages
from ahrs_sim.log.mcap.cdr import Place, encode
from ahrs_sim.log.mcap.container import MESSAGE_HEAD, PROFILE, Container, Index

LIBRARY = "ahrs_sim"
SUFFIX = ".part"
"""Appended to the name of a log that is not finished yet."""

_RECORD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_HEAD = _RECORD.itemsize
_END_OF_TIME = np.iinfo(np.int64).max
_QUEUE = 8


@dataclass(frozen=True)
class Topic:
    """A topic as announced to a listener of a log being written."""

    number: int
    name: str
    encoding: str
    type_name: str
    schema_encoding: str
    schema: bytes


class Listener(Protocol):
    """Receiver of every message of a log on its way to the file, in the order of the file (`ahrs_sim.log.live`)."""

    def begin(self, topics: Sequence[Topic]) -> None:
        """Announce the topics, before the first message."""

    def send(self, channels: np.ndarray, log_time_ns: np.ndarray, messages: Sequence[memoryview]) -> None:
        """Send messages: numbers of their topics (n,), log times (n,) ns rising, and their CDR."""


class LogChannel:
    """One topic of a log being written; made by `LogWriter.add_channel`."""

    def __init__(self, number: int, topic: str, type_name: str, constant: Mapping[str, Any]) -> None:
        self.id = number
        self.topic = topic
        self.type_name = type_name
        self.constant = constant
        self.count = 0
        self.pending: list[np.ndarray] = []  # (n, record size) uint8, whole message records
        payload, self.places = encode(messages.definitions(type_name), type_name, constant)
        self.stamps = [p for path, p in self.places.items() if p.kind == "time" and path.endswith("header.stamp")]
        self.template = np.frombuffer(_record_head(number, len(payload)) + payload, np.uint8)

    def place(self, path: str) -> Place:
        """Find where the field `path` lies in a message."""
        try:
            return self.places[path]
        except KeyError:
            raise ValueError(
                f"{self.topic}: {self.type_name} has no field '{path}' to set; it has {', '.join(self.places)}"
            ) from None


class CarriedChannel:
    """One topic of another log, whose messages go into this one as they are; made by `LogWriter.carry`."""

    def __init__(self, number: int, channel: Channel, schema: Schema | None) -> None:
        self.id = number
        self.topic = channel.topic
        self.channel = channel
        self.schema = schema
        self.pending: list[np.ndarray] = []


def _topic(channel: LogChannel | CarriedChannel) -> Topic:
    if isinstance(channel, LogChannel):
        text = messages.schema_text(channel.type_name).encode()
        return Topic(channel.id, channel.topic, "cdr", channel.type_name, "ros2msg", text)
    schema = channel.schema or Schema(id=0, name="", encoding="", data=b"")
    return Topic(channel.id, channel.topic, channel.channel.message_encoding, schema.name, schema.encoding, schema.data)


def _record_head(channel: int, payload: int) -> bytes:
    return MESSAGE_HEAD.pack(5, _HEAD - 9 + payload, channel, 0, 0, 0)


class LogWriter:
    """A log being written, `<path>.part` until `close` renames it.

    In order: `add_channel`, `metadata`, `attach` in any order, `start`, then `write`, `event` and `advance`, at last
    `close`. As a context manager it closes when the block ends well and keeps the `.part` with everything written when
    it does not.

    Args:
        path: name of the finished log.
        epoch_ns: ns since 1970, kept in the metadata record `log`; the time of the attachments.
        chunk_s: length of a chunk in log time; what a crash can cost.
        force: overwrite a finished or an unfinished log of that name.
        listener: is given all messages, too.

    Raises:
        InputError: the log exists, or cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        epoch_ns: int,
        chunk_s: float = 1.0,
        force: bool = False,
        listener: Listener | None = None,
    ) -> None:
        self.path = Path(path)
        self.part = self.path.with_name(self.path.name + SUFFIX)
        self._epoch_ns = epoch_ns
        self._chunk_ns = round(chunk_s * 1e9)
        self._force = force
        self._listener = listener
        self._channels: list[LogChannel | CarriedChannel] = []
        self._schemas: dict[str, int] = {}
        self._metadata: dict[str, dict[str, str]] = {"log": {"epoch_ns": str(epoch_ns)}}
        self._attachments: list[Attachment] = []
        self._written_ns = -1  # everything before is on its way to the file
        self._error: BaseException | None = None
        self._queue: queue.Queue[tuple[memoryview, int, int, Index] | None] = queue.Queue(_QUEUE)
        self._worker: threading.Thread | None = None
        self._closed = False
        if not force:
            for existing, remedy in ((self.path, ""), (self.part, ", or recover it with 'ahrs-sim recover'")):
                if existing.exists():
                    raise InputError(f"{existing}: exists already; choose another name, overwrite with --force{remedy}")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if force:
                self.part.unlink(missing_ok=True)
            self._stream = self.part.open("xb")
        except OSError as error:
            raise InputError(
                f"{self.part}: cannot be created: {error.strerror or error}; choose another place"
            ) from None

    # ------------------------------------------------------------------------------------------- before start

    def add_channel(
        self, topic: str, type_name: str, *, constant: Mapping[str, Any] | None = None, **shorthand: str
    ) -> LogChannel:
        """Add a topic.

        Args:
            topic: `/like/this`.
            type_name: one of `messages.type_names()`.
            constant: fields that are the same in every message, as nested mappings; strings and sequences can only be
                given here.
            shorthand: `frame_id="map_ned"` for the header's, `child_frame_id=...`, or any other string at the top of
                the message.

        Raises:
            ValueError: an unknown field, a topic that is there already, or the log is started.
        """
        if self._worker or any(c.topic == topic for c in self._channels):
            raise ValueError(f"{topic}: channels are added once and before start()")
        fields = {**(constant or {}), **shorthand}
        if "frame_id" in fields:
            fields["header"] = {"frame_id": fields.pop("frame_id")}
        channel = LogChannel(len(self._channels) + 1, topic, type_name, fields)
        self._channels.append(channel)
        self._schemas.setdefault(type_name, len(self._schemas) + 1)
        return channel

    def carry(self, channel: Channel, schema: Schema | None) -> CarriedChannel:
        """Add a topic of another log (`LogReader.carried`), for `pass_on`.

        Raises:
            ValueError: the topic is one of ours already, or the log is started.
        """
        if self._worker or any(isinstance(c, LogChannel) and c.topic == channel.topic for c in self._channels):
            raise ValueError(f"{channel.topic}: channels are added once and before start()")
        carried = CarriedChannel(len(self._channels) + 1, channel, schema)
        self._channels.append(carried)
        return carried

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a record of names and values: seeds, versions, sensor specifications."""
        self._metadata[name] = {key: str(value) for key, value in values.items()}

    def attach(self, name: str, data: bytes, media_type: str = "text/plain") -> None:
        """Attach a file to the log."""
        self._attachments.append(
            Attachment(create_time=self._epoch_ns, log_time=self._epoch_ns, name=name, media_type=media_type, data=data)
        )

    def start(self) -> None:
        """Write everything that comes before the first message."""
        self._guard(self._prologue)
        self._worker = threading.Thread(target=self._work, name=f"log {self.path.name}", daemon=True)
        self._worker.start()
        if self._listener:
            self._listener.begin([_topic(channel) for channel in self._channels])

    def _prologue(self) -> None:
        self._file = Container(self._stream, Header(profile=PROFILE, library=LIBRARY))
        for name, number in self._schemas.items():
            text = messages.schema_text(name).encode()
            self._file.schema(Schema(id=number, data=text, encoding="ros2msg", name=name))
        foreign: dict[tuple[str, str, bytes], int] = {}
        for channel in self._channels:
            if isinstance(channel, CarriedChannel):
                number = 0
                if (schema := channel.schema) is not None:
                    key = schema.name, schema.encoding, schema.data
                    number = foreign.setdefault(key, len(self._schemas) + len(foreign) + 1)
                    self._file.schema(dataclasses.replace(schema, id=number))
                self._file.channel(dataclasses.replace(channel.channel, id=channel.id, schema_id=number))
                continue
            self._file.channel(
                Channel(
                    id=channel.id,
                    topic=channel.topic,
                    message_encoding="cdr",
                    metadata={"offered_qos_profiles": "[]"},
                    schema_id=self._schemas[channel.type_name],
                )
            )
        for name, values in self._metadata.items():
            self._file.metadata(name, values)
        for attachment in self._attachments:
            self._file.attachment(attachment)
        self._file.flush()

    # ------------------------------------------------------------------------------------------- messages

    def write(self, channel: LogChannel, log_time_ns: np.ndarray, stamp_ns: np.ndarray, **columns: Any) -> None:
        """Write messages of one channel, in the order of their sequence numbers.

        Args:
            channel: from `add_channel`.
            log_time_ns: (n,) int64, when each message arrived, ns since 1970; not before the last `advance`.
            stamp_ns: (n,) int64, when its content was true: `header.stamp` of the message and its publish time.
            columns: fields by dotted path (`**{"twist.twist.linear": v}`), one row a message or one for all; a vector
                is (n, 3), a quaternion (n, 4) scalar first, a fixed array (n, k) or any shape of k values. Fields not
                given keep the channel's constant, else zero.

        Raises:
            ValueError: an unknown field, a shape that does not fit, or a message older than the last `advance`.
            LogError: the log could not be written.
        """
        n = len(log_time_ns)
        if n == 0:
            return
        rows = np.empty((n, channel.template.size), np.uint8)
        rows[:] = channel.template
        for place in channel.stamps:
            place.set(rows, stamp_ns, _HEAD)
        for path, values in columns.items():
            try:
                channel.place(path).set(rows, values, _HEAD)
            except ValueError as error:
                raise ValueError(f"{channel.topic}: {path}: {error}") from None
        self._append(channel, rows, log_time_ns, stamp_ns)

    def event(self, channel: LogChannel, log_time_ns: int, stamp_ns: int | None = None, **fields: Any) -> None:
        """Write one message whose strings and sequences are its own: slow, for rare things.

        Args:
            channel: from `add_channel`.
            log_time_ns: ns since 1970.
            stamp_ns: the header's stamp; `log_time_ns` when not given.
            fields: as nested mappings, over the channel's constants.
        """
        stamp_ns = log_time_ns if stamp_ns is None else stamp_ns
        value = {**channel.constant, **fields}
        payload, places = encode(messages.definitions(channel.type_name), channel.type_name, value)
        rows = np.frombuffer(bytearray(_record_head(channel.id, len(payload)) + payload), np.uint8)[np.newaxis]
        for path, place in places.items():
            if path.endswith("header.stamp"):
                place.set(rows, stamp_ns, _HEAD)
        self._append(channel, rows, np.array([log_time_ns]), np.array([stamp_ns]))

    def pass_on(self, channel: CarriedChannel, rows: np.ndarray) -> None:
        """Write message records (n, size) uint8 of `LogReader.raw_blocks`; they are changed in place.

        Raises:
            ValueError: the log is not open, or a message is older than the last `advance`.
            LogError: the log could not be written.
        """
        head = _records(rows)
        self._check_open(channel, int(head["log_time"].min()))
        head["channel"] = channel.id
        channel.pending.append(rows)

    def _check_open(self, channel: LogChannel | CarriedChannel, earliest_ns: int) -> None:
        if self._error:
            self._fail()
        if not self._worker or self._closed:
            raise ValueError(f"{channel.topic}: the log is not open for messages; call start() first")
        if earliest_ns < max(self._written_ns, 0):
            raise ValueError(f"{channel.topic}: a message at {earliest_ns} ns comes after advance({self._written_ns})")

    def _append(self, channel: LogChannel, rows: np.ndarray, log_time_ns: np.ndarray, stamp_ns: np.ndarray) -> None:
        self._check_open(channel, int(log_time_ns.min()))
        n = len(rows)
        head = _records(rows)
        head["sequence"] = np.arange(channel.count, channel.count + n)
        head["log_time"] = log_time_ns
        head["publish_time"] = stamp_ns
        channel.count += n
        channel.pending.append(rows)

    def advance(self, t_ns: int) -> None:
        """Declare data complete up to `t_ns`: whole chunks before it may go to the file.

        Raises:
            LogError: the log could not be written.
        """
        boundary = t_ns // self._chunk_ns * self._chunk_ns
        if boundary > self._written_ns:
            self._emit(boundary)

    def _emit(self, boundary: int) -> None:
        """Send all messages with log time before `boundary` to the worker, chunk by chunk."""
        if self._error:
            self._fail()
        self._written_ns = boundary
        taken: list[tuple[int, np.ndarray, np.ndarray]] = []  # channel, records, log times
        for channel in self._channels:
            later = []
            for rows in channel.pending:
                times = _records(rows)["log_time"].astype(np.int64)
                early = times < boundary
                if early.all():
                    taken.append((channel.id, rows, times))
                    continue
                later.append(rows[~early])
                if early.any():
                    taken.append((channel.id, rows[early], times[early]))
            channel.pending = later
        if not taken:
            return

        # Place every message: by log time, equal times by channel, then in the order written.
        times = np.concatenate([t for _, _, t in taken])
        sizes = np.repeat([rows.shape[1] for _, rows, _ in taken], [len(rows) for _, rows, _ in taken])
        owners = np.repeat([channel for channel, _, _ in taken], [len(rows) for _, rows, _ in taken])
        order = np.argsort(times, kind="stable")
        ends = np.cumsum(sizes[order])
        starts = ends - sizes[order]
        offsets = np.empty_like(starts)
        offsets[order] = starts
        data = np.empty(int(ends[-1]), np.uint8)
        at = 0
        for _, rows, _ in taken:
            n, size = rows.shape
            # Each row of this view is the room for a record at that byte: the rows overlap, the chosen ones do not.
            room = np.ndarray((data.size - size + 1, size), np.uint8, data, 0, (1, 1))
            room[offsets[at : at + n]] = rows
            at += n

        times, owners = times[order], owners[order]
        cuts = np.flatnonzero(np.diff(times // self._chunk_ns)) + 1
        for first, last in zip([0, *cuts], [*cuts, len(times)], strict=True):
            begin, end = int(starts[first]), int(ends[last - 1])
            entries = np.column_stack((times[first:last], starts[first:last] - begin)).astype("<u8")
            inside = owners[first:last]
            by_channel = np.argsort(inside, kind="stable")
            present, at_channel = np.unique(inside[by_channel], return_index=True)
            parts = np.split(entries[by_channel], at_channel[1:])
            index = {int(c): part for c, part in zip(present, parts, strict=True)}
            self._put((data.data[begin:end], int(times[first]), int(times[last - 1]), index))
        if self._listener:
            starts, ends = starts.tolist(), ends.tolist()
            contents = [data.data[start + _HEAD : end] for start, end in zip(starts, ends, strict=True)]
            self._listener.send(owners, times, contents)

    # ------------------------------------------------------------------------------------------- the worker

    def _put(self, item: tuple[memoryview, int, int, Index] | None) -> None:
        while True:
            if self._error:
                self._fail()
            with contextlib.suppress(queue.Full):
                self._queue.put(item, timeout=1.0)
                return

    def _work(self) -> None:
        compressor = zstandard.ZstdCompressor(level=1)
        try:
            while (item := self._queue.get()) is not None:
                data, start, end, index = item
                self._file.chunk(
                    Chunk(
                        compression="zstd",
                        data=compressor.compress(data),
                        message_start_time=start,
                        message_end_time=end,
                        uncompressed_crc=zlib.crc32(data),
                        uncompressed_size=len(data),
                    ),
                    index,
                )
        except BaseException as error:  # carried over to the caller's thread
            self._error = error

    def _fail(self) -> None:
        reason = self._error.strerror if isinstance(self._error, OSError) else None
        raise LogError(
            f"{self.part}: cannot be written: {reason or self._error}; 'ahrs-sim recover' saves what is there"
        ) from self._error

    def _guard(self, action: Any) -> None:
        try:
            action()
        except OSError as error:
            self._error = error
            self._fail()

    # ------------------------------------------------------------------------------------------- the end

    def _drain(self) -> None:
        """Send all messages to the file and finish the worker."""
        if self._worker:
            self._emit(_END_OF_TIME)
            self._put(None)
            self._worker.join()
            if self._error:
                self._fail()

    def close(self) -> None:
        """Finish the log and give it its name.

        Raises:
            LogError: the log could not be written; the `.part` stays.
        """
        if self._closed:
            return
        if not self._worker:
            self.start()
        try:
            self._drain()
            self._closed = True
            self._guard(self._file.finish)
            ours = self._is_ours()
        finally:
            self._closed = True
            with contextlib.suppress(OSError):
                self._stream.close()
        if not ours:
            raise LogError(f"{self.path}: somebody else began the same log meanwhile; this one is lost, write it anew")
        try:
            if not self._force and self.path.exists():
                raise FileExistsError("somebody else made one meanwhile")
            self.part.replace(self.path)
        except OSError as error:
            raise LogError(f"{self.path}: the finished log stays {self.part}: {error.strerror or error}") from None

    def _is_ours(self) -> bool:
        """Tell whether the unfinished file of that name is still the one that was opened here."""
        try:
            return os.path.samestat(os.fstat(self._stream.fileno()), self.part.stat())
        except OSError:
            return False

    def abort(self) -> None:
        """Stop writing: put everything into the `.part`, which stays for `recover`."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(LogError):
            self._drain()
        with contextlib.suppress(OSError):
            self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


def _records(rows: np.ndarray) -> np.ndarray:
    """View the heads of message records (n, size) uint8 as a structured array (n,)."""
    return np.ndarray((len(rows),), _RECORD, buffer=rows, strides=(rows.strides[0],))
