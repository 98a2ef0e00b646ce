"""A flight in a process of its own, some blocks ahead of whoever uses it.

JSBSim and the sensors, estimators and log behind it take about as long as each other and JSBSim does not let go of
Python's lock, so two processes halve the wait. Only for flights that nothing is fed back to.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from ahrs_sim.errors import AhrsSimError, FlightError
from ahrs_sim.flight import Event, Setpoints, Truth, open_flight
from ahrs_sim.scenario import Scenario
from estimators.types import blank

DONE = "done"


def end_with_parent() -> None:
    """Have this process of `multiprocessing` end with the one that started it, however that ended.

    A worker that waits for work on a pipe which its brothers hold open, too, would wait for ever.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="end with parent", daemon=True).start()


def _fly(scenario: Scenario, rows: int, pipe: Connection) -> None:
    """Run the worker process: send flight metadata, then blocks; the pipe's buffer holds it back."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the user's Ctrl-C is for the process that writes the log
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the reader has gone: killed, or stopped
        try:
            flight = open_flight(scenario)
            pipe.send((flight.dt, flight.start_lla, flight.expected_duration, flight.attachments()))
            while len(truth := flight.fly(rows)):
                pipe.send((truth, flight.take_setpoints(), flight.take_events()))
            pipe.send((DONE, flight.error, flight.take_events()))
        except AhrsSimError as error:
            pipe.send(error)


class FlightAhead:
    """A `Flight` whose blocks come from another process.

    Args:
        scenario: one without feedback from an estimator.
        rows: of a block; `process` gives no others.

    Raises:
        InputError: as `open_flight`, from `ready`.
    """

    dt: float
    start_lla: np.ndarray
    expected_duration: float | None

    def __init__(self, scenario: Scenario, rows: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe(duplex=False)
        self._process = context.Process(target=_fly, args=(scenario, rows, theirs), daemon=True)
        self._process.start()
        theirs.close()
        self.done = False
        self.error: str | None = None
        self._setpoints: list[Setpoints] = []
        self._events: list[Event] = []

    def ready(self) -> "FlightAhead":
        """Wait until it is about to begin."""
        self.dt, self.start_lla, self.expected_duration, self._attachments = self._receive()
        return self

    def _receive(self) -> Any:
        try:
            received = self._pipe.recv()
        except EOFError:
            self._process.join()
            raise FlightError(f"JSBSim ended with code {self._process.exitcode}") from None
        if isinstance(received, Exception):
            raise received
        return received

    def fly(self, n: int) -> Truth:
        """Receive the next block, whatever `n`; empty when the flight is over."""
        if not self.done:
            first, second, events = self._receive()
            self._events += events
            if not isinstance(first, str):
                self._setpoints.append(second)
                return first  # type: ignore[no-any-return]
            self.done, self.error = True, second
            self.close()
        return Truth(**blank(Truth, 0))

    def take_setpoints(self) -> Setpoints:
        """Collect the pilot's set-points since the last call."""
        taken, self._setpoints = Setpoints.concatenate(self._setpoints), []
        return taken

    def take_events(self) -> list[Event]:
        """Collect events since the last call, in order."""
        taken, self._events = self._events, []
        return taken

    def feedback(self, q_nb: np.ndarray, rate_b: np.ndarray) -> None:
        """Refuse: the flight is ahead already."""
        raise FlightError("a flight ahead of its estimators cannot be flown on them")

    def attachments(self) -> dict[str, bytes]:
        """Collect the files of the aircraft that flies, by relative path."""
        return dict(self._attachments)

    def close(self) -> None:
        """End the other process."""
        self._pipe.close()
        self._process.join(1.0)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()
