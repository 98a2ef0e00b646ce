"""Is one estimator better than another? Differences in pairs: of the same flights, or of the same seconds of one.

What both have in common, the sensors' errors and the manoeuvres, drops out of a difference, so that far fewer flights
decide than two separate distributions need.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ahrs_sim.evaluation.bootstrap import block_interval, block_length

BETTER, WORSE, UNCLEAR = "better", "worse", "unclear"

FEWEST = 6
"""Pairs below which nothing is clear: even five that agree in sign do so by chance once in sixteen times."""

BIN_S = 2.0
"""s of a flight that are one pair."""


@dataclass(frozen=True)
class Difference:
    """An error of one estimator less that of another, in deg: negative where the one is more accurate."""

    change: float  # mean over the pairs; of one flight: of the RMS errors
    low: float  # its 95 % interval, NaN with fewer than `FEWEST` pairs
    high: float
    smaller: int  # pairs in which the error is smaller
    pairs: int

    @property
    def result(self) -> str:
        """Say what the interval shows: `BETTER`, `WORSE` or `UNCLEAR`."""
        return BETTER if self.high < 0 else WORSE if self.low > 0 else UNCLEAR

    def plain(self) -> dict[str, Any]:
        """Convert to data for JSON; None: not known."""
        values = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(self).items()}
        return {**values, "result": self.result}


def over_runs(values: np.ndarray, against: np.ndarray) -> Difference | None:
    """Compare a figure over runs (n,) with that of another estimator in the same runs; None: not known in any.

    A run counts where both are finite.
    """
    both = np.isfinite(values) & np.isfinite(against)
    differences = np.asarray(values, float)[both] - np.asarray(against, float)[both]
    if not len(differences):
        return None
    low, high = math.nan, math.nan
    if len(differences) >= FEWEST:
        rows = np.column_stack([differences, np.ones(len(differences))])
        low, high = block_interval(rows, lambda sums: sums[:, 0] / sums[:, 1], 1)
    return Difference(float(differences.mean()), low, high, int(np.sum(differences < 0)), len(differences))


@dataclass(frozen=True)
class Binned:
    """Squared errors of an estimator, summed over spans of `BIN_S`: deg2, and how many samples there are."""

    squares: np.ndarray  # (bins, measures)
    counts: np.ndarray  # (bins, measures)

    @classmethod
    def of(cls, t: np.ndarray, errors: np.ndarray, bins: int) -> "Binned":
        """Sum errors (n, measures) rad at times `t` (n,) s, in bins counted from t = 0."""
        number = np.clip(np.floor(t / BIN_S + 1e-6).astype(int), 0, bins - 1)
        squares, counts = np.zeros((bins, errors.shape[1])), np.zeros((bins, errors.shape[1]))
        for k, column in enumerate(errors.T):
            known = np.isfinite(column)
            squares[:, k] = np.bincount(number[known], np.degrees(column[known].astype(float)) ** 2, bins)
            counts[:, k] = np.bincount(number[known], minlength=bins)
        return cls(squares, counts)


def over_time(one: Binned, other: Binned, measure: int, rows: np.ndarray) -> Difference | None:
    """Compare the RMS error of one estimator in a flight with that of another; None: no bin in which both have one.

    Neighbouring errors are nearly the same, so the interval comes from a block bootstrap. It is of this flight, as if
    it went on in the same way: errors that last for a whole flight, as of a turn-on bias, it cannot know.

    Args:
        one, other: with equally many bins.
        measure: a column.
        rows: (bins,) mask: only these.
    """
    used = rows & (one.counts[:, measure] > 0) & (other.counts[:, measure] > 0)
    if not used.any():
        return None
    columns = [b[used, measure] for b in (one.squares, one.counts, other.squares, other.counts)]
    sums = np.column_stack(columns)
    mean, mean_other = columns[0] / columns[1], columns[2] / columns[3]
    low, high = math.nan, math.nan
    if len(sums) >= 2 * FEWEST:
        low, high = block_interval(sums, _rms_difference, block_length(mean - mean_other))
    change = float(_rms_difference(sums.sum(axis=0)[None])[0])
    return Difference(change, low, high, int(np.sum(mean < mean_other)), len(sums))


def _rms_difference(sums: np.ndarray) -> np.ndarray:
    """Difference of RMS errors (m,) from sums (m, 4): squares and counts of one, and of the other."""
    difference: np.ndarray = np.sqrt(sums[:, 0] / sums[:, 1]) - np.sqrt(sums[:, 2] / sums[:, 3])
    return difference


def cells(values: Mapping[str, Any] | None) -> str:
    """Format a `Difference.plain` in 30 places: `-19.2 (-28.1 to -9.5) better`."""
    if values is None:
        return f"{'-':>30s}"
    if values["low"] is None:
        return f"{signed(values['change'])} {UNCLEAR}".rjust(30)
    span = f"({signed(values['low'])} to {signed(values['high'])})"
    return f"{signed(values['change'])} {span} {values['result']}".rjust(30)


def signed(value: float) -> str:
    """Format a difference with its sign, in three digits."""
    size = abs(value)
    return f"{value:+.{3 if size < 0.0995 else 2 if size < 9.995 else 1 if size < 99.95 else 0}f}"
