"""Estimates beside a reference attitude: the one place where the two meet.

    evaluator = Evaluator(lambda name, pair: print(name, pair.errors()[:, Measure.TILT]))
    evaluator.add_reference(truth.t, truth.q_nb)
    evaluator.add("ekf", estimates)

Truth and estimates come in blocks of their own lengths and rates, and sensors deliver late. What the reference has not
reached yet waits; then it is interpolated, and both go on as a `Comparison`, of which the caller makes messages of a
log, a table, a plot or a sum of squares.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.evaluation import consistency, metrics
from ahrs_sim.evaluation.decimate import take
from ahrs_sim.evaluation.metrics import History
from estimators.types import Estimates

KEEP_S = 5.0
"""s of the reference that are kept behind its newest time: longer than estimates lag behind it."""


@dataclass(frozen=True)
class Comparison:
    """Estimates and the reference attitude at their times; every column below has n rows."""

    estimates: Estimates
    reference: np.ndarray  # (n, 4) q_nb; NaN where the reference has a gap

    def errors(self) -> np.ndarray:
        """Compute errors (n, 5) in rad; columns by `metrics.Measure`."""
        return metrics.attitude_errors(self.estimates.q_nb, self.estimates.down_b, self.reference)

    def sigma(self) -> np.ndarray:
        """Compute the claimed uncertainty (n, 3) of roll, pitch and heading: one sigma, rad."""
        return consistency.euler_sigma(self.estimates.q_nb, self.estimates.att_cov)

    def nees(self) -> np.ndarray:
        """Compute the NEES (n,) of the attitude per degree of freedom (three)."""
        covariance = self.estimates.att_cov.astype(float)
        return consistency.attitude_nees(self.estimates.q_nb, covariance, self.reference) / consistency.FREEDOM

    def nis(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute the NIS and its degrees of freedom, (n,) each."""
        return consistency.nis(self.estimates.innovation, self.estimates.innovation_var)

    def within(self) -> np.ndarray:
        """Test whether all three Euler errors lie inside three claimed sigma: (n,) 1, 0, or NaN where not known."""
        error = attitude.wrap(attitude.euler(self.estimates.q_nb) - attitude.euler(self.reference))
        return consistency.within(error, self.sigma())


class Evaluator:
    """Matches estimates with a reference while both arrive.

    Args:
        sink: called with the name of an estimator and each comparison, in the order of its estimates.
        against: complete references by estimator; None: one that comes by `add_reference`.
        keep_s: s of the reference that are kept behind its newest time.
        hold_s: s behind an estimator's newest row after which a row stops waiting for the reference and is dropped.
    """

    def __init__(
        self,
        sink: Callable[[str, Comparison], None],
        *,
        against: Mapping[str, History] | None = None,
        keep_s: float = KEEP_S,
        hold_s: float = math.inf,
    ) -> None:
        self._sink, self._against = sink, against
        self._keep_s, self._hold_s = keep_s, hold_s
        self._recent = metrics.NOTHING
        self._waiting: dict[str, Estimates] = {}

    @property
    def reached(self) -> float:
        """Newest time of the reference that came by `add_reference`, s; -inf before any."""
        return float(self._recent.t[-1]) if len(self._recent.t) else -math.inf

    def add_reference(self, t: np.ndarray, q_nb: np.ndarray) -> None:
        """Extend the reference by attitudes `q_nb` (n, 4) at times `t` (n,) s, rising."""
        if not len(t):
            return
        self._recent = self._recent.extended(t, q_nb, self._keep_s)
        waiting, self._waiting = self._waiting, {}
        for name, block in waiting.items():
            self._match(name, block)

    def add(self, name: str, block: Estimates) -> None:
        """Compare a block of an estimator; rows that the reference has not reached wait for it."""
        if name in self._waiting:
            block = Estimates.concatenate([self._waiting.pop(name), block])
        self._match(name, block)

    def _match(self, name: str, block: Estimates) -> None:
        history = self._recent if self._against is None else self._against[name]
        if self._against is None:
            covered = history.covers(block.t)
            if not covered.all():
                waits = ~covered & (block.t > block.t[-1] - self._hold_s)
                if waits.any():
                    self._waiting[name] = take(block, waits)
                block = take(block, covered)
        if len(block):
            self._sink(name, Comparison(block, history.at(block.t)))
