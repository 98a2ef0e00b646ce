"""Matches answers with the samples that were sent, and makes rows of estimates of them."""

import bisect
import threading
from collections import deque

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.sensors.records import Answers
from ahrs_sim.serve.protocols import Answer
from ahrs_sim.serve.readings import SWITCHED_ON_NS
from ahrs_sim.serve.timing import Timing
from estimators.types import Status, blank

OLDEST_NS = 2 * 10**9
"""ns of flight that an answer may be behind the newest sample."""

_KEPT = 4096  # stamps of samples sent


class Book:
    """Records what was sent and received; safe for several threads.

    Args:
        resolution_ns: of the times in answers.
        timing: is kept up to date.
    """

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
