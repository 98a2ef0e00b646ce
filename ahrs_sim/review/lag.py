"""`ahrs-sim compare --lag`: how late an estimate is. An RMS error hides a lag; a control loop does not."""

import math
from pathlib import Path

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError
from ahrs_sim.evaluation import metrics
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.reader import quaternion, stamps, vector
from ahrs_sim.log.topics import REFERENCE, STATE
from ahrs_sim.review import compare

LONGEST = 0.5
"""s: no lag is looked for beyond."""

WINDOW = 1.0
"""s over which the motion of an attitude is taken: slow errors (a bias, a turn taken for level flight) are no lag."""

LEAST_RATE = math.radians(1.0)
"""rad/s, RMS of the true motion: with less there is nothing to tell a lag by."""

LEAST_CORRELATION = 0.3
"""What the two motions must have in common."""

STEEP = math.radians(75.0)
"""rad of pitch beyond which Euler angles say little."""


def delay(truth: np.ndarray, signal: np.ndarray, dt: float) -> float:
    """Estimate by how many s a signal is later than the truth: where their cross-correlation peaks.

    The peak is a parabola through the three highest points, which is good to a small part of `dt` for a signal that
    is slow against it.

    Args:
        truth: (n, c) every `dt`; rows with NaN are left out.
        signal: (n, c) at the same times.
        dt: s.

    Returns:
        The delay (s, negative: earlier); NaN when the two have too little in common within `LONGEST`.
    """
    both = np.isfinite(truth).all(axis=1) & np.isfinite(signal).all(axis=1)
    n = len(both)
    reach = min(math.ceil(LONGEST / dt), n // 4)
    if reach < 2 or both.sum() < 8 * reach:
        return math.nan
    a, b = (np.where(both[:, None], x - x[both].mean(axis=0), 0.0) for x in (truth, signal))
    m = both.astype(float)
    correlation = np.zeros(2 * reach + 1)
    for k in range(-reach, reach + 1):
        early, late = slice(max(0, -k), n - max(0, k)), slice(max(0, k), n - max(0, -k))
        # Only pairs that both exist: a gap has no say, nor in what the sum is divided by.
        power = np.sqrt(np.sum((a[early] * m[late, None]) ** 2) * np.sum((b[late] * m[early, None]) ** 2))
        correlation[reach + k] = np.sum(a[early] * b[late]) / power if power > 0.0 else 0.0
    top = int(np.argmax(correlation))
    if correlation[top] < LEAST_CORRELATION or top in (0, 2 * reach):
        return math.nan
    left, peak, right = correlation[top - 1 : top + 2]
    return float((top - reach + 0.5 * (left - right) / (left - 2.0 * peak + right)) * dt)


def lags(t: np.ndarray, truth: np.ndarray, estimate: np.ndarray) -> tuple[float, float]:
    """Estimate the lag of an attitude and of its rate, s.

    Attitude: change of roll, pitch and heading over `WINDOW`; rate: from one sample to the next.

    Args:
        t: (n,) s, rising, the stamps of the estimates.
        truth: (n, 3) roll, pitch, heading in rad at these times.
        estimate: (n, 3) likewise, a column of NaN where a method has none (no heading).

    Returns:
        Attitude and rate lag, positive when the estimate comes late; NaN when the flight does not tell.
    """
    has = (np.isfinite(truth) & np.isfinite(estimate)).any(axis=0)
    if len(t) < 3 or not has.any():
        return math.nan, math.nan
    dt = float(np.median(np.diff(t)))
    if not 0.0 < t[-1] - t[0] < 100 * len(t) * dt:  # hardly any sample of a grid would have an estimate near
        return math.nan, math.nan
    at = np.arange(t[0], t[-1], dt)
    right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    gap = np.minimum(at - t[right - 1], t[right] - at) > 0.6 * dt  # between samples that are too far apart
    steep = np.abs(truth[:, 1]) > STEEP

    def uniform(angles: np.ndarray) -> np.ndarray:
        columns = []
        for x in angles.T[has]:
            known = np.isfinite(x)
            values = np.interp(at, t[known], np.unwrap(x[known]))
            columns.append(np.where(gap | (np.interp(at, t, (~known | steep).astype(float)) > 0.0), np.nan, values))
        return np.column_stack(columns)

    true, estimated = uniform(truth), uniform(estimate)
    found = []
    for rows in (max(1, round(WINDOW / dt)), 1):
        moved = [(x[rows:] - x[:-rows]) / (rows * dt) for x in (true, estimated)]
        known = np.isfinite(moved[0]).all(axis=1)
        rms = np.sqrt(np.mean(moved[0][known] ** 2)) if known.any() else 0.0
        found.append(delay(moved[0], moved[1], dt) if rms > LEAST_RATE else math.nan)
    return found[0], found[1]


def of_log(
    path: Path, *, reference: str | None = None, start: float | None = None, end: float | None = None
) -> dict[str, dict[str, float | None]]:
    """Estimate `attitude_lag_ms` and `rate_lag_ms` of every estimator in a log; None: unknown.

    Args:
        path: the log.
        reference: an estimator or topic with orientations instead of the truth.
        start, end: only in this span, s of flight.

    Raises:
        InputError: no such log, nothing to compare with, or no estimates.
    """
    low, high = -math.inf if start is None else start, math.inf if end is None else end
    with FlightReader(path) as log:
        if not log.estimators:
            raise InputError(f"{path}: no estimates in it; replay it with an estimator first")
        if reference is None and compare.TRUTH_TOPIC not in log.topics and REFERENCE.topic in log.topics:
            reference = REFERENCE.topic
        history = compare.attitudes(log, reference)
        return {name: _of(log, name, history, low, high) for name in log.estimators}


def _of(log: FlightReader, name: str, history: metrics.History, low: float, high: float) -> dict[str, float | None]:
    parts = [
        (log.seconds(stamps(b)), quaternion(b["orientation"]), vector(b["down"]))
        for b in log.blocks(f"/est/{name}{STATE.topic}")
        if len(b)
    ]
    if not parts:
        return {"attitude_lag_ms": None, "rate_lag_ms": None}
    t, q_nb, down_b = (np.concatenate(column) for column in zip(*parts, strict=True))
    t, first = np.unique(t, return_index=True)
    kept = first[(t >= max(low, history.t[0])) & (t <= min(high, history.t[-1]))]
    t = t[(t >= max(low, history.t[0])) & (t <= min(high, history.t[-1]))]
    truth = attitude.euler(history.at(t))
    with np.errstate(invalid="ignore"):
        angles = np.column_stack([*attitude.roll_pitch(down_b[kept]), attitude.euler(q_nb[kept])[:, 2]])
    return {
        key: round(1e3 * lag, 2) if math.isfinite(lag) else None
        for key, lag in zip(("attitude_lag_ms", "rate_lag_ms"), lags(t, truth, angles), strict=True)
    }


def table(result: dict[str, dict[str, float | None]]) -> str:
    """Format the lags for a reader."""
    width = max(12, *(len(name) + 2 for name in result))
    lines = [f"{'lag, ms':{width}s}{'attitude':>10s}{'rate':>10s}"]
    for name, values in result.items():
        cells = ("-" if v is None else f"{v:.1f}" for v in values.values())
        lines.append(f"{name:{width}s}" + "".join(f"{c:>10s}" for c in cells))
    return "\n".join(lines)
