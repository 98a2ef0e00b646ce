"""A unit under test on a wire: sees the sensors of a suite in real time, answers with its attitude.

The flight runs a little ahead of the clock; a thread sends each reading when its time has come, another takes answers.
"""

import bisect
import contextlib
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.flight.truth import Event, Truth
from ahrs_sim.sensors.records import Answers, SuiteBlock
from ahrs_sim.serve.links import Link, LinkLost
from ahrs_sim.serve.protocols import Answer, Protocol
from ahrs_sim.serve.readings import SWITCHED_ON_NS, Reading, Readings
from ahrs_sim.serve.timing import Timing
from estimators.types import Samples, Status, blank

BLOCK_S = 0.1
"""s of flight that are computed at a time."""

OLDEST_NS = 2 * 10**9
"""ns of flight that an answer may be behind the newest sample."""

_AHEAD_S, _MOST_AHEAD_S = 0.3, 1.0  # of a real clock; of the flight, whatever the rate
_KEPT = 4096  # stamps of samples sent
_LAST_S = 0.5  # silence after which no more answers are waited for


class Unit:
    """The unit at the other end of a link.

    Args:
        name: of its estimates in the log.
        suite: whose sensors it sees.
        link: open, nobody there yet.
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
        self._failure: Exception | None = None  # of a thread
        self._book = _Book(protocol.resolution_ns, self.timing)
        self._threads: list[threading.Thread] = []
        self._ended = threading.Event()
        self._switch = sys.getswitchinterval()

    def wait(self) -> bool:
        """Wait until the unit is there; False when stopped first."""
        return self._link.wait(self._stopped)

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
        lines = self.timing.lines() if self._threads else []
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


class _Book:
    """What was sent and what has come; both threads and the flight write and read it."""

    def __init__(self, resolution_ns: int, timing: Timing) -> None:
        self.newest_ns = -SWITCHED_ON_NS  # stamp sent last
        self.count = 0  # answers taken
        self._resolution_ns, self._timing = resolution_ns, timing
        self._stamps: deque[int] = deque(maxlen=_KEPT)
        self._sent: dict[int, float] = {}
        self._last: tuple[int, float] | None = None  # stamp and real time of the answer before
        self._answers: list[tuple[int, float, Answer]] = []
        self._unanswered: list[int] = []  # stamps sent before the first answer
        self._lock = threading.Lock()

    def sent(self, t_ns: int, now: float, due: float) -> None:
        """Note that the sample of a stamp goes out now (s of the real clock)."""
        with self._lock:
            if len(self._stamps) == _KEPT:
                del self._sent[self._stamps[0]]
            self._stamps.append(t_ns)
            self._sent[t_ns] = now
            self.newest_ns = t_ns
            if self._last is None:
                self._unanswered.append(t_ns)
        self._timing.sent += 1
        self._timing.lateness.append(now - due)

    def received(self, answer: Answer, now: float, arrival: float) -> None:
        """Note an answer that has come now (s of the real clock), at `arrival` (s of flight)."""
        norm = float(np.linalg.norm(answer.q_nb))
        if np.isnan(norm):
            return  # not aligned yet
        if abs(norm - 1.0) > 1e-2:
            self._timing.damaged += 1
            return
        with self._lock:
            if not self._stamps:
                return
            known = self._match(answer.t_ns)
            t_ns = self.newest_ns if known is None else known
            if self._last is not None and t_ns <= self._last[0]:
                self._timing.repeated += 1
                return
            if t_ns < self.newest_ns - OLDEST_NS:
                self._timing.late += 1
                return
            if known is None:
                self._timing.foreign += 1
            else:
                self._timing.latency.append(now - self._sent[t_ns])
            if self._last is not None and self._last[0] in self._sent:
                apart = self._sent[t_ns] - self._sent[self._last[0]]
                self._timing.spacing.append(now - self._last[1] - apart)
            self._last = t_ns, now
            self.count += 1
            self._answers.append((t_ns, arrival, answer))

    def _match(self, t_ns: int) -> int | None:
        """Find the stamp that an answer's time means; None: it is of another clock."""
        at = bisect.bisect_left(self._stamps, t_ns)
        near = [self._stamps[i] for i in (at - 1, at) if 0 <= i < len(self._stamps)]
        best = min(near, key=lambda stamp: abs(stamp - t_ns))
        return best if abs(best - t_ns) <= self._resolution_ns else None

    def take(self) -> Answers:
        """Return the answers since the last call; a row without attitude for each sample before the first of them."""
        with self._lock:
            taken, self._answers = self._answers, []
            until = taken[0][0] if taken else self.newest_ns - OLDEST_NS
            waiting = [t_ns for t_ns in self._unanswered if t_ns < until]
            self._unanswered = [] if self._last else self._unanswered[len(waiting) :]
        columns = blank(Answers, len(waiting) + len(taken))
        for i, t_ns in enumerate(waiting):
            columns["t"][i] = columns["arrival"][i] = (t_ns + SWITCHED_ON_NS) * 1e-9
        for i, (t_ns, arrival, answer) in enumerate(taken, len(waiting)):
            t = (t_ns + SWITCHED_ON_NS) * 1e-9
            columns["t"][i], columns["arrival"][i] = t, max(arrival, t)
            columns["status"][i] = Status.RUNNING
            columns["q_nb"][i] = answer.q_nb / np.linalg.norm(answer.q_nb)
            if answer.sigma is not None:
                columns["att_cov"][i] = _covariance(columns["q_nb"][i], answer.sigma)
        columns["down_b"] = attitude.down(columns["q_nb"])
        return Answers(**columns)


def _covariance(q_nb: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Make the covariance (3, 3) rad2 of the body rotation from the sigmas (3,) rad of roll, pitch and heading.

    As if the three were independent: body rotation is J d(roll, pitch, heading), Titterton and Weston, equation 3.52.
    """
    roll, pitch, _ = attitude.euler(q_nb[None])[0]
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    slope = np.array([[1.0, 0.0, -sp], [0.0, cr, sr * cp], [0.0, -sr, cr * cp]])
    made: np.ndarray = (slope * sigma**2) @ slope.T
    return made
