"""How late a unit answers, and how evenly: figures and histograms in real time."""

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

_BARS = 40


@dataclass
class Timing:
    """Times of one flight, s of a real clock."""

    latency: "array[float]" = field(default_factory=lambda: array("d"))  # from sending a sample to its answer
    spacing: "array[float]" = field(default_factory=lambda: array("d"))  # of two answers, less that of their samples
    lateness: "array[float]" = field(default_factory=lambda: array("d"))  # of what was sent, behind its time
    sent: int = 0
    foreign: int = 0  # answers whose time is not of the stream's clock
    late: int = 0  # answers on a sample more than two seconds old: left out
    repeated: int = 0  # answers not newer than the one before: left out
    damaged: int = 0  # answers whose attitude is no rotation: left out

    def lines(self) -> list[str]:
        """Describe the whole flight for a terminal, histograms included."""
        answered = len(self.latency) + self.foreign
        text = [f"{self.sent} samples sent, {answered} answers"]
        for count, what in (
            (self.foreign, "answers with times of another clock: taken as of the newest sample, latency unknown"),
            (self.late, "answers on samples more than two seconds old: left out"),
            (self.repeated, "answers no newer than the one before: left out"),
            (self.damaged, "answers with an attitude that is no rotation: left out"),
        ):
            if count:
                text.append(f"{count} {what}")
        text.append(f"{'ms':10s}{'median':>9s}{'p95':>9s}{'p99':>9s}{'max':>9s}")
        for name, shares in self._shares().items():
            text.append(f"{name:10s}" + "".join(f"{1e3 * x:9.2f}" for x in shares))
        for name, values in (("latency", self.latency), ("jitter", np.abs(self.spacing))):
            text += [f"{name}, ms", *histogram(values)] if len(values) else []
        return text

    def result(self) -> dict[str, Any]:
        """Return the counts, and median, 95th, 99th percentile and maximum of each time, s, for JSON."""
        counts = {k: getattr(self, k) for k in ("sent", "foreign", "late", "repeated", "damaged")}
        times = {f"{name}_s": shares for name, shares in self._shares().items()}
        return {**counts, "answers": len(self.latency) + self.foreign, **times}

    def _shares(self) -> dict[str, list[float]]:
        """Median, 95th, 99th percentile and maximum (s) of what there is."""
        times = {"latency": self.latency, "jitter": np.abs(self.spacing), "sending": self.lateness}
        kept = {name: np.asarray(values) for name, values in times.items()}
        return {k: [float(x) for x in np.percentile(v, [50, 95, 99, 100])] for k, v in kept.items() if len(v)}


def histogram(values: Sequence[float] | np.ndarray) -> list[str]:
    """Draw how often values (s) lie between powers of two of a millisecond, a line each."""
    bins = np.floor(np.log2(np.maximum(1e3 * np.asarray(values), 1e-3))).astype(int)
    lowest, counts = int(bins.min()), np.bincount(bins - bins.min())
    lines = []
    for k, count in enumerate(counts):
        low, high = 2.0 ** (lowest + k), 2.0 ** (lowest + k + 1)
        bar = "#" * math.ceil(_BARS * count / counts.max())
        lines.append(f"{low:8.3g} to {high:<8.3g} {count:7d} {bar}")
    return lines
