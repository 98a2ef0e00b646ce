"""The border that estimates of a user's own estimator cross: what they must be, and what is filled in for them."""

import traceback
from dataclasses import fields
from pathlib import Path
from typing import Protocol

import numpy as np

import estimators as library
from ahrs_sim import attitude
from ahrs_sim.flight.truth import Event
from estimators import Estimates, Samples, Status
from estimators.types import blank

NORM_TOLERANCE = 1e-3
"""How far the norm of `q_nb` and `down_b` may be from 1."""


_OURS = Path(__file__).parents[1], Path(library.__file__).parent


class Processes(Protocol):
    """Describes the one method that an estimator must have: `process`."""

    def process(self, samples: Samples) -> Estimates:
        """Return one row of estimates for each row of samples."""
        ...


class Guarded:
    """An estimator from outside, whose estimates are checked and whose failures end it alone.

    `q_nb` without `down_b` gives the tilt as well. Rows that are RUNNING or COASTING without an attitude, or with
    one that is not a unit quaternion, count as DIVERGED; the first of a kind is an event.

    Args:
        name: of the estimator, for messages.
        estimator: anything with `process(samples)`; a `failure` text of its own ends it, too.
    """

    def __init__(self, name: str, estimator: Processes) -> None:
        self.name, self.estimator = name, estimator
        self.failure: str | None = None
        self._events: list[Event] = []
        self._reported: set[str] = set()

    def process(self, samples: Samples) -> Estimates:
        """Return one row of checked estimates for each row of samples."""
        if self.failure is not None:
            return _nothing(samples)
        try:
            estimates = self.estimator.process(samples)
        except Exception as error:  # code of others: whatever it raises ends this estimator and nothing else
            return self._fail(samples, located(error))
        own = getattr(self.estimator, "failure", None)
        if own is not None:
            return self._fail(samples, str(own))
        problem = _misshapen(estimates, samples)
        if problem:
            return self._fail(samples, problem)
        return self._completed(estimates)

    def reset(self) -> None:
        """Forget everything seen."""
        self.failure = None
        self._reported.clear()
        if callable(reset := getattr(self.estimator, "reset", None)):
            reset()

    def take_events(self) -> list[Event]:
        """Return what happened since the last call."""
        events, self._events = self._events, []
        return events

    def _fail(self, samples: Samples, reason: str) -> Estimates:
        self.failure = reason
        t = float(samples.t[0]) if len(samples) else 0.0
        self._events.append(Event(t, "error", self.name, f"{reason}; no estimates from here on"))
        return _nothing(samples)

    def _completed(self, estimates: Estimates) -> Estimates:
        q, down, status = estimates.q_nb, estimates.down_b, estimates.status
        some = np.isfinite(q).all(axis=1)
        tilt = some & ~np.isfinite(down).all(axis=1)
        if tilt.any():
            with np.errstate(invalid="ignore", divide="ignore"):
                unit = q / np.linalg.norm(q, axis=1, keepdims=True)
            down = np.where(tilt[:, None], attitude.down(unit), down)
        working = (status == Status.RUNNING) | (status == Status.COASTING)
        nothing = working & ~np.isfinite(down).all(axis=1)
        with np.errstate(invalid="ignore"):
            norm_off = np.abs(np.linalg.norm(q, axis=1) - 1.0) > NORM_TOLERANCE
            norm_off |= np.abs(np.linalg.norm(down, axis=1) - 1.0) > NORM_TOLERANCE
        not_unit = working & norm_off
        self._report(estimates.t, nothing, "reports RUNNING without an attitude (NaN): counted as DIVERGED")
        self._report(estimates.t, not_unit, "q_nb or down_b is not of length 1: counted as DIVERGED")
        if not tilt.any() and not (nothing | not_unit).any():
            return estimates
        status = np.where(nothing | not_unit, np.uint8(Status.DIVERGED), status).astype(np.uint8)
        wrong = not_unit[:, None]
        columns = {name: getattr(estimates, name) for name in estimates.__match_args__}
        columns |= {"status": status, "q_nb": np.where(wrong, np.nan, q), "down_b": np.where(wrong, np.nan, down)}
        return Estimates(**columns)

    def _report(self, t: np.ndarray, rows: np.ndarray, text: str) -> None:
        if rows.any() and text not in self._reported:
            self._reported.add(text)
            self._events.append(Event(float(t[np.argmax(rows)]), "warning", self.name, text))


def _nothing(samples: Samples) -> Estimates:
    columns = blank(Estimates, len(samples))
    columns["t"][:], columns["status"][:] = samples.t, Status.DIVERGED
    return Estimates(**columns)


def _misshapen(estimates: object, samples: Samples) -> str | None:
    """Describe what is wrong with the form of a block of estimates, if anything."""
    if not isinstance(estimates, Estimates):
        return f"process() returned {type(estimates).__name__}, not estimators.Estimates"
    n = len(samples)
    for f in fields(Estimates):
        column, shape = getattr(estimates, f.name), (n, *f.metadata["shape"])
        if not isinstance(column, np.ndarray) or column.shape != shape:
            found = getattr(column, "shape", type(column).__name__)
            return f"process() returned {f.name} of shape {found}, expected {shape}"
        if column.dtype.kind not in "fiub":
            return f"process() returned {f.name} of type {column.dtype}, expected numbers"
    if not np.array_equal(estimates.t, samples.t):
        return "process() returned other time stamps `t` than the samples'; copy samples.t"
    if n and estimates.status.max() > max(Status):
        return f"process() returned status {estimates.status.max()}; see estimators.Status"
    return None


def located(error: Exception) -> str:
    """Format an exception as one line with the innermost place in the user's code, not in a library that it calls."""
    frames = traceback.extract_tb(error.__traceback__)
    known = [(f, Path(f.filename)) for f in frames if not any(o in Path(f.filename).parents for o in _OURS)]
    home = known[0][1].parent if known else Path()  # of what we have called
    own = [f for f, p in known if home in p.parents and "site-packages" not in p.relative_to(home).parts]
    frame = (own or frames)[-1]
    return f"{type(error).__name__}: {' '.join(str(error).split())} ({Path(frame.filename).name}, line {frame.lineno})"
