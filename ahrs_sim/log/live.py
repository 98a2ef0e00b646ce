"""`ahrs-sim fly SCENARIO --live`: the messages of a log over WebSocket while it is being written.

Viewers get what the file gets, in the same order: topics, `ros2msg` schemas, CDR, log times. Messages are sent at
their log time on a clock that runs `rate` times as fast as a real one; the flight waits, so that it is a few seconds
ahead at most. Foxglove and Lichtblick connect with *Open connection, Foxglove WebSocket*.
"""

import socket
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ahrs_sim.errors import InputError

if TYPE_CHECKING:
    from ahrs_sim.log.mcap.writer import Topic

PORT = 8765
"""Where viewers look first."""

_TICK_S = 0.02  # between two portions, of a real clock: smooth to the eye
_BACKLOG = 100_000  # messages that a viewer may be behind before it loses the oldest
_LATCHED = "/tf_static"  # in the log once; repeated for who comes later
_REPEAT_NS = 10**9


class Live:
    """WebSocket server of one flight: `with Live(...) as live: pipeline.fly(..., live=live)`.

    Args:
        port: on this machine; 0: any that is free, see `port`.
        rate: seconds of flight a second.
        stopped: true ends the waiting: the rest goes out at once.

    Raises:
        InputError: foxglove-sdk is missing, or the port is taken.
    """

    def __init__(self, port: int = PORT, rate: float = 1.0, stopped: Callable[[], bool] = lambda: False) -> None:
        try:
            import foxglove
        except ImportError:
            raise InputError("--live needs foxglove-sdk; pip install 'ahrs-sim[live]'") from None
        self._foxglove, self._rate, self._stopped = foxglove, rate, stopped
        self._context = foxglove.Context()
        self._channels: dict[int, Any] = {}
        self._latched: tuple[Any, bytes] | None = None  # channel and message
        self._repeated_ns = 0
        self._zero: tuple[float, int] | None = None  # real clock, s, and log time, ns, of the first message
        self._server: Any = None
        try:  # reported before anything flies; the server itself waits for the topics, see begin()
            with socket.create_server(("127.0.0.1", port)) as tried:
                self.port = int(tried.getsockname()[1])
        except OSError as error:
            raise _taken(port, error) from None

    def begin(self, topics: Sequence["Topic"]) -> None:
        """Open the server with all topics: a client that connected earlier could miss one.

        Raises:
            InputError: another program has taken the port meanwhile.
        """
        for topic in topics:
            schema = self._foxglove.Schema(name=topic.type_name, encoding=topic.schema_encoding, data=topic.schema)
            self._channels[topic.number] = self._foxglove.Channel(
                topic.name, schema=schema, message_encoding=topic.encoding, context=self._context
            )
        try:
            self._server = self._foxglove.start_server(
                name="ahrs-sim",
                host="127.0.0.1",  # nobody but this machine
                port=self.port,
                capabilities=[self._foxglove.Capability.Time],
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except (RuntimeError, OSError) as error:
            raise _taken(self.port, error) from None

    def send(self, channels: np.ndarray, log_time_ns: np.ndarray, messages: Sequence[memoryview]) -> None:
        """Send messages, each at its time.

        Args:
            channels: (n,) numbers of their topics.
            log_time_ns: (n,) ns since 1970, in order.
            messages: (n,) of CDR.
        """
        if not len(messages):
            return
        if self._zero is None:
            self._zero = time.monotonic(), int(log_time_ns[0])
        begun, zero = self._zero
        at = 0
        while at < len(messages):
            now = zero + int((time.monotonic() - begun) * self._rate * 1e9)
            end = len(messages) if self._stopped() else int(np.searchsorted(log_time_ns, now, "right"))
            for i in range(at, end):
                channel, message = self._channels[int(channels[i])], bytes(messages[i])
                channel.log(message, log_time=int(log_time_ns[i]))
                if channel.topic() == _LATCHED:
                    self._latched, self._repeated_ns = (channel, message), int(log_time_ns[i])
            if end > at:
                self._report_time(int(log_time_ns[end - 1]))
            at = max(at, end)
            if at < len(messages):
                time.sleep(_TICK_S)

    def _report_time(self, now_ns: int) -> None:
        """Broadcast the current time and re-send the latched message every second."""
        self._server.broadcast_time(now_ns)
        if self._latched and now_ns - self._repeated_ns >= _REPEAT_NS:
            self._repeated_ns = now_ns
            channel, message = self._latched
            channel.log(message, log_time=now_ns)

    def close(self) -> None:
        """Close the connections to the viewers."""
        for channel in self._channels.values():
            channel.close()
        if self._server:
            self._server.stop()

    def __enter__(self) -> "Live":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _taken(port: int, error: Exception) -> InputError:
    return InputError(f"--live={port}: {getattr(error, 'strerror', None) or error}; choose another port")
