"""Flights made up of random numbers, for the tests of the log."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.flight.truth import Event, Setpoints, Truth
from ahrs_sim.log.flight_log import FlightLog
from ahrs_sim.log.topics import INSTRUMENTS
from ahrs_sim.sensors.records import Record
from ahrs_sim.turning import Turning
from estimators.types import Columns, Estimates, blank

EPOCH = 1_780_308_000_000_000_000  # 2026-06-01
SHARED = Path(__file__).parents[2].parent / "shared" / "data"
SUITES = {"chr": ["imu", "mag"], "sbg": list(INSTRUMENTS)}
ESTIMATORS = ["ekf-chr", "ins"]
RATES = {"imu": 100, "mag": 50, "fix": 4, "velocity": 4, "heading": 20}


def random_block(kind: type, n: int, seed: int, **given: Any) -> Any:
    """A block of random columns; `given` ones as they are."""
    random = np.random.default_rng(seed)
    columns = blank(kind, n)
    for name, column in columns.items():
        if name in given:
            column[...] = given[name]
        elif column.dtype == np.float64:
            column[...] = random.normal(size=column.shape)
        elif column.dtype == bool:
            column[...] = random.random(column.shape) < 0.1
        else:
            column[...] = random.integers(0, 3, column.shape)
    return kind(**columns)


class MadeUpFlight:
    """Blocks of a flight of `duration` s; what is measured arrives late."""

    def __init__(self, duration: float = 5.0) -> None:
        n = round(duration * 400)
        self.duration = duration
        lla = np.array([0.76, 0.026, 150.0]) + 1e-6 * np.arange(n)[:, None]
        self.truth: Truth = random_block(Truth, n, 1, t=np.arange(n) * 2_500_000 / 1e9, lla=lla)
        self.records: dict[tuple[str, str], Record] = {}
        for seed, (suite, instrument) in enumerate((s, i) for s, found in SUITES.items() for i in found):
            period = 1_000_000_000 // RATES.get(instrument, 25)
            stamp = np.arange(1, round(duration * 1e9) // period) * period
            late = np.random.default_rng(seed).integers(0, 150_000_000, len(stamp))
            self.records[suite, instrument] = random_block(
                INSTRUMENTS[instrument][0], len(stamp), seed, stamp_ns=stamp, arrival_ns=stamp + np.sort(late)
            )
        n = round(duration * 100)
        self.estimates: dict[str, Estimates] = {}
        for seed, name in enumerate(ESTIMATORS):
            e: Estimates = random_block(Estimates, n, seed, t=np.arange(n) / 100)
            e.q_nb[:50] = np.nan
            self.estimates[name] = e
        self.turns: dict[str | None, Turning] = {
            name: random_block(Turning, n // 10, seed, t=np.arange(n // 10) / 10)
            for seed, name in enumerate([None, *ESTIMATORS])
        }
        self.setpoints: Setpoints = random_block(Setpoints, n // 2, 9, t=np.arange(n // 2) / 50)
        self.events = [Event(k * 7 / 10, "info", "pilot", "x" * k) for k in range(int(duration / 0.7))]

    def write(self, path: Path, block: float = 2.0, **settings: Any) -> None:
        """Fly it into a log, in blocks of `block` s."""
        with FlightLog(path, **self.header(), **settings) as log:
            self.feed(log, block)

    def header(self) -> dict[str, Any]:
        """What a `FlightLog` is made with."""
        return {
            "epoch_ns": EPOCH,
            "suites": SUITES,
            "estimators": ESTIMATORS,
            "attachments": {"scenario.toml": b"seed = 1\n", "trainer.xml": b"<x/>" * 1000},
            "metadata": {"flight": {"seed": "1"}, "suite chr": {"gyro": "0.03 deg/s"}},
        }

    def feed(self, log: FlightLog, block: float = 2.0) -> None:
        """Give the log everything, in blocks."""
        at = 0.0
        while at < self.duration + 0.2:
            log.truth(_between(self.truth, self.truth.t, at, at + block))
            for key, record in self.records.items():
                log.record(*key, _between(record, record.arrival_ns / 1e9, at, at + block))
            for name, estimates in self.estimates.items():
                log.estimates(name, _between(estimates, estimates.t, at, at + block))
            for who, turning in self.turns.items():
                log.turning(who, _between(turning, turning.t, at, at + block))
            log.setpoints(_between(self.setpoints, self.setpoints.t, at, at + block))
            log.events([e for e in self.events if at <= e.t < at + block])
            at += block
            log.advance(at)


def _between(block: Any, t: np.ndarray, start: float, end: float) -> Any:
    first, last = np.searchsorted(t, [start, end])
    return block[int(first) : int(last)]


def same(a: Columns, b: Columns, single: tuple[str, ...] = (), close: tuple[str, ...] = ()) -> None:
    """Blocks equal bit for bit; columns `single` as float32, `close` but for rounding."""
    assert type(a) is type(b)
    assert len(a) == len(b)
    for name in (f.name for f in dataclasses.fields(a)):
        x, y = getattr(a, name), getattr(b, name)
        if name in close:
            np.testing.assert_allclose(x, y, rtol=1e-15, err_msg=name)
        elif name in single:
            np.testing.assert_array_equal(x.astype(np.float32), y.astype(np.float32), err_msg=name)
        else:
            np.testing.assert_array_equal(x, y, err_msg=name)
            assert x.dtype == y.dtype
