"""Latency between an instrument and its receiver: messages arrive some time after their stamps, in order."""

import dataclasses
from typing import Any

import numpy as np

from ahrs_sim.sensors.faults import Channel
from ahrs_sim.sensors.records import Record
from estimators.types import blank


class LatencyBuffer:
    """Buffers messages until they arrive, so that a block holds what has arrived by its end, however long it is.

    Args:
        cls: type of the records.
        channel: its `dropout` and `delay` faults.
        latency: s from slot to arrival.
    """

    def __init__(self, cls: type[Record], channel: Channel, latency: float) -> None:
        self._empty = cls(**blank(cls, 0))
        self._channel = channel
        self._latency_ns = round(latency * 1e9)
        self._waiting: Any = self._empty
        self._held = 0  # records waiting
        self._last = np.iinfo(np.int64).min  # ns, latest arrival so far

    def push(self, records: Any, t: np.ndarray, now: float) -> Any:
        """Queue records sampled at `t` (m,) s; `arrival_ns` must equal the sampling time and becomes the arrival time.

        Returns:
            The records that have arrived by `now` (s), of these and earlier ones.
        """
        touched = self._channel.deliver(t)
        if touched is None and not self._latency_ns and not self._held:
            if len(t):
                self._last = max(self._last, int(records.arrival_ns[-1]))
            return records
        if len(t):
            arrival = records.arrival_ns + self._latency_ns
            keep = np.ones(len(t), bool)
            if touched is not None:
                keep = touched[0]
                arrival = arrival + np.rint(touched[1] * 1e9).astype(np.int64)
            # A serial line: nothing overtakes.
            arrival = np.maximum.accumulate(np.maximum(arrival[keep], self._last))
            if len(arrival):
                self._last = int(arrival[-1])
                kept = dataclasses.replace(records[keep], arrival_ns=arrival)
                self._waiting = type(records).concatenate([self._waiting, kept]) if self._held else kept
                self._held += len(arrival)
        return self.pop(now)

    def pop(self, now: float) -> Any:
        """Return the records that have arrived by `now` (s)."""
        if not self._held:
            return self._empty
        there = int(np.searchsorted(self._waiting.arrival_ns, round(now * 1e9), side="right"))
        if not there:
            return self._empty
        arrived, self._waiting = self._waiting[:there], self._waiting[there:]
        self._held -= there
        return arrived
