"""A unit under test on a wire: sees the sensors of a suite in real time, answers with its attitude.

The flight runs a little ahead of the clock; a thread sends each reading when its time has come, another takes answers.
"""

import contextlib
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator

from ahrs_sim.flight.truth import Event, Truth
from ahrs_sim.sensors.records import Answers, SuiteBlock
from ahrs_sim.serve.book import Book
from ahrs_sim.serve.links import Link, LinkLost
from ahrs_sim.serve.protocols import Protocol
from ahrs_sim.serve.readings import SWITCHED_ON_NS, Reading, Readings
from ahrs_sim.serve.timing import Timing
from estimators.types import Samples

BLOCK_S = 0.1
"""s of flight that are computed at a time."""

_AHEAD_S, _MOST_AHEAD_S = 0.3, 1.0  # of a real clock; of the flight, whatever the rate
_LAST_S = 0.5  # silence after which no more answers are waited for


class Unit:
    """The unit at the other end of a link.

    Args:
        name: of its estimates in the log.
        suite: whose sensors it sees.
        link: open, not connected yet.
        protocol: what both speak.
        rate: seconds of flight a second.
        stopped: true ends all waiting.
    """

    def __init__(
        self,
        name: str,
        suite: str,
        link: Link,
        protocol: Protocol,
        *,
        rate: float = 1.0,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self.name, self.suite, self.rate = name, suite, rate
        self.timing = Timing()
        self.error: str | None = None
        self._link, self._protocol, self._stopped = link, protocol, stopped
        self._readings = Readings()
        self._queue: queue.SimpleQueue[Reading | None] = queue.SimpleQueue()
        self._begun = 0.0  # real clock at t = 0 of the flight, s
        self._reached = 0.0  # s of flight that were handed over
        self._sent = 0.0  # s of flight that were sent
        self._bits = 0  # sent in the first second
        self._failure: Exception | None = None  # of a thread
        self._book = Book(protocol.resolution_ns, self.timing)
        self._threads: list[threading.Thread] = []
        self._ended = threading.Event()
        self._switch = sys.getswitchinterval()

    @property
    def where(self) -> str:
        """Return the address or device that the unit opens."""
        return self._link.name

    def wait(self, seconds: float) -> bool:
        """Wait until the unit is there; return False after so many seconds without it, or when stopped first."""
        until = time.monotonic() + seconds
        return self._link.wait(lambda: self._stopped() or time.monotonic() > until)

    def exchange(self, truth: Truth, records: SuiteBlock, samples: Samples) -> Answers:
        """Send the readings of a block, each in its time; return the answers that have come."""
        readings = list(self._readings.make(samples, records))
        if self.error or not readings:
            return self._book.take()
        if not self._threads:
            self._begin(readings[0].arrival_ns)
        self._reached = float(truth.t[-1])
        for reading in readings:
            self._queue.put(reading)
        until = readings[-1].arrival_ns / 1e9 - min(_AHEAD_S * self.rate, _MOST_AHEAD_S)
        while min(self._now(), self._sent) < until and not (self.error or self._failure or self._stopped()):
            time.sleep(0.005)
        return self._taken()

    def finish(self) -> Answers:
        """Send the rest, and return the last answers."""
        self._queue.put(None)
        if self._threads:
            while self._threads[0].is_alive() and not self._stopped():
                self._threads[0].join(0.1)
            count = -1
            while count < (count := self._book.count) and not (self.error or self._stopped()):
                time.sleep(_LAST_S)
        self.close()
        return self._taken()

    def _taken(self) -> Answers:
        if self._failure:
            raise self._failure
        return self._book.take()

    def take_events(self) -> list[Event]:
        """Return what is worth knowing at the end: how the unit kept time, or why the link was lost."""
        pace = f"{self.suite} at {self._link.name}, {self.rate:g} times real time"
        lines = [pace, *self.timing.lines()] if self._threads else []
        events = [Event(self._reached, "info", self.name, line) for line in lines]
        return events + ([Event(self._reached, "error", self.name, self.error)] if self.error else [])

    def close(self) -> None:
        """End the threads and close the link."""
        self._ended.set()
        self._queue.put(None)
        for thread in self._threads:
            thread.join(3.0)
        self._link.close()
        sys.setswitchinterval(self._switch)

    def _now(self) -> float:
        """Time of flight on the real clock, s."""
        return (time.monotonic() - self._begun) * self.rate

    def _begin(self, first_ns: int) -> None:
        self._begun = time.monotonic() + 0.05 - first_ns / 1e9 / self.rate
        sys.setswitchinterval(5e-4)  # the sender must not wait for a block to be computed
        for target in (self._send, self._receive):
            thread = threading.Thread(target=target, name=f"{self.name}: {target.__name__}", daemon=True)
            self._threads.append(thread)
            thread.start()

    def _send(self) -> None:
        with self._guarded():
            while (reading := self._queue.get()) is not None:
                due = self._begun + reading.arrival_ns / 1e9 / self.rate
                data = self._protocol.encode(reading)
                if (left := due - time.monotonic()) > 0.0 and self._ended.wait(left):
                    return
                self._book.sent(reading.t_ns, time.monotonic(), due)
                self._link.write(data)
                self._sent = reading.arrival_ns / 1e9
                self._check_speed(len(data))

    def _check_speed(self, size: int) -> None:
        """Compare what goes out in the first second with what the wire carries.

        Raises:
            LinkLost: it is too slow.
        """
        if self._link.baud is None or self._sent > 1.0:
            return
        self._bits += 10 * size  # a byte with its start and stop bit
        if self._bits * self.rate > self._link.baud:
            raise LinkLost(f"the stream takes more than {self._link.baud} baud; use a faster one, or a lower rate_hz")

    def _receive(self) -> None:
        with self._guarded():
            while not self._ended.is_set():
                data = self._link.read()
                now = time.monotonic()
                for answer in self._protocol.feed(data) if data else ():
                    self._book.received(answer, now, (now - self._begun) * self.rate)

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except LinkLost as error:
            if not self._ended.is_set():
                t = (self._book.newest_ns + SWITCHED_ON_NS) / 1e9
                self.error = f"{self._link.name}: link lost at {t:.1f} s of flight ({error})"
                self._ended.set()
        except Exception as error:  # of this program: raised where the flight can end with it
            self._failure = error
            self._ended.set()
