"""A flight from scenario to log: one loop over blocks.

    flight -> sensors -> estimators -> log, accuracy

Every stage takes a block and gives one (`Flight.fly`, `Chain.sense`, `assemble`, `estimate`) and keeps its own state.
When an estimator flies the aircraft a block is one IMU sample long, else seconds; nothing else differs, and the log's
bytes do not depend on it.
"""

import contextlib
import dataclasses
import platform
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ahrs_sim import attitude, plugins
from ahrs_sim.chain import Chain, described, site
from ahrs_sim.errors import FlightError
from ahrs_sim.evaluation.decimate import RowDecimator, take
from ahrs_sim.flight import BLOCK_S, Flight, open_flight
from ahrs_sim.flight.truth import Event, Setpoints, Truth
from ahrs_sim.log.flight_log import FlightLog
from ahrs_sim.log.mcap.writer import Listener
from ahrs_sim.scenario import Scenario, create_estimator
from ahrs_sim.sensors import make_suite
from ahrs_sim.sensors.faults import check_suites
from ahrs_sim.sensors.records import Answers, Record, SuiteBlock
from ahrs_sim.turning import TurnAndSlip, Turning
from estimators.types import Estimates, Samples, SensorInfo, Site

if TYPE_CHECKING:
    from ahrs_sim.evaluation.accuracy import Accuracy


LATE_S = 4.0
"""s of flight behind the newest truth up to which a unit outside may answer."""


class Outside(Protocol):
    """A unit outside that sees the sensors of a suite and answers with its attitude (`ahrs_sim.serve`)."""

    name: str
    """Of its estimates in the log."""
    suite: str
    error: str | None
    """Why it answers no more: ends the flight."""

    def exchange(self, truth: Truth, records: SuiteBlock, samples: Samples) -> Answers:
        """Give it a block, and return what it has answered since the last one."""
        ...

    def finish(self) -> Answers:
        """Return its last answers."""
        ...

    def take_events(self) -> list[Event]:
        """Return what is worth knowing of it, once it has finished."""
        ...


def fly(
    scenario: Scenario,
    output: Path | None,
    *,
    accuracy: "Accuracy | None" = None,
    force: bool = False,
    block_s: float = BLOCK_S,
    flight: Flight | None = None,
    outside: Outside | None = None,
    live: Listener | None = None,
    ros_axes: bool = False,
    progress: Callable[[float, float | None], None] = lambda t, end: None,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Fly a scenario into a log, evaluate its estimators, or both.

    Args:
        scenario: what to fly.
        output: the log; `output.part` until it is complete. None: no log.
        accuracy: gathers errors of the estimators during the flight.
        force: replace an existing log.
        block_s: length of the blocks, s; the log does not depend on it.
        flight: the scenario's flight, if it has begun already (see `flight.ahead`).
        outside: a unit that flies along; its answers are estimates beside those of the scenario.
        live: is given every message of the log, too (see `ahrs_sim.log.live`).
        ros_axes: IMU topics a second time in the axes of ROS (see `ahrs_sim.log.ros_axes`).
        progress: called with the time reached and the expected end (None: unknown), s.
        stopped: asked after every block; true ends the flight and completes the log.

    Raises:
        InputError: something in the scenario is wrong, or the output cannot be written.
        FlightError: the flight did not reach its end, or `outside` was lost; the log is complete up to there.
    """
    closed_loop = scenario.pilot_attitude != "truth"
    rows = max(1, round(block_s * scenario.rate))
    if flight is None:
        flight = open_flight(scenario)
    place = site(flight.start_lla, scenario.epoch)
    chains = _chains(scenario, place, flight)
    if closed_loop:
        rows = _rows_per_sample(scenario, chains)
    with contextlib.ExitStack() as stack:
        log = None
        if output is not None:
            log = FlightLog(
                output,
                epoch_ns=scenario.epoch_ns,
                truth_rate=scenario.rate,
                logged_rate=scenario.truth_rate,
                ros_axes=ros_axes,
                suites={c.suite.name: c.suite.instruments for c in chains},
                estimators=[*(name for c in chains for name in c.estimators), *([outside.name] if outside else [])],
                attachments={"scenario.toml": scenario.toml().encode(), **flight.attachments()},
                metadata=_metadata(scenario, place, chains),
                force=force,
                listener=live,
            )
            stack.enter_context(log)
        record = _Recorder(log, accuracy, scenario.rate / scenario.truth_rate, hold_s=LATE_S if outside else 0.0)
        record.events([Event(0.0, "warning", "scenario", note) for note in scenario.notes])
        while len(truth := flight.fly(rows)):
            t = float(truth.t[-1])
            record.truth(truth)
            record.setpoints(flight.take_setpoints())
            due = record.due(t)
            for chain in chains:
                chain.pending.append(truth)
                seen = outside if outside and outside.suite == chain.suite.name else None
                if due or not closed_loop or seen or scenario.pilot_attitude in chain.estimators:
                    _run(chain, record, flight, scenario.pilot_attitude, seen)
            record.events(flight.take_events())
            progress(t, scenario.duration or flight.expected_duration)
            if outside and outside.error:
                break
            if stopped():
                record.events([Event(t, "warning", "flight", "stopped by the user")])
                break
            if due:
                record.flush(t)
        for chain in chains:
            _run(chain, record, flight, scenario.pilot_attitude)
        record.events(flight.take_events())
        if outside:
            record.estimates(outside.name, outside.finish())
            record.events(outside.take_events())
        record.flush()
    if error := flight.error or (outside and outside.error):
        kept = f"; the log is complete up to there: {output}" if output else ""
        raise FlightError(f"{scenario.where}: {error}{kept}")
    if failed := plugins.failures(e for c in chains for e in c.estimators.values()):
        raise FlightError(f"{scenario.where}: {failed}")


def _run(chain: Chain, record: "_Recorder", flight: Flight, pilot: str, outside: Outside | None = None) -> None:
    """Take what was flown since the last call through the sensors and estimators of a chain, and to who sees them."""
    if not chain.pending:
        return
    truth = Truth.concatenate(chain.pending)
    records = chain.sense(truth)
    chain.pending.clear()
    for instrument, sent in records.items():
        record.record(chain.suite.name, instrument, sent)
    samples = chain.assemble(records)
    for name, estimates in chain.estimate(samples):
        record.estimates(name, estimates)
        record.turning(name, chain.turning(name, samples, estimates))
        if name == pilot:
            _feed_back(flight, estimates, samples.gyro_b)
    if outside:
        record.estimates(outside.name, outside.exchange(truth, records, samples))
    record.events(chain.take_events())


class _Recorder:
    """Buffers blocks and hands them on once every `BLOCK_S`, because the overhead of a call dominates."""

    def __init__(self, log: FlightLog | None, accuracy: "Accuracy | None", every: float, hold_s: float = 0.0) -> None:
        self.log, self.accuracy = log, accuracy
        self.hold_s = hold_s  # how much later than usual something may still come
        self.compared = RowDecimator(every)  # what the log keeps, so that both give the same figures
        self.truths: list[Truth] = []
        self.setpoint_list: list[Setpoints] = []
        self.records: dict[tuple[str, str], list[Record]] = {}
        self.estimate_lists: dict[str, list[Estimates]] = {}
        self.turn_lists: dict[str | None, list[Turning]] = {}  # None: the truth
        self.true_turn = TurnAndSlip()
        self.event_list: list[Event] = []
        self.flushed_to = 0.0

    def truth(self, block: Truth) -> None:
        """Buffer the truth."""
        self.truths.append(block)

    def setpoints(self, block: Setpoints) -> None:
        """Buffer setpoints of the pilot."""
        if len(block):
            self.setpoint_list.append(block)

    def record(self, suite: str, instrument: str, block: Record) -> None:
        """Buffer what an instrument has sent."""
        if len(block):
            self.records.setdefault((suite, instrument), []).append(block)

    def estimates(self, name: str, block: Estimates) -> None:
        """Buffer what an estimator reports."""
        if len(block):
            self.estimate_lists.setdefault(name, []).append(block)

    def turning(self, name: str | None, block: Turning) -> None:
        """Buffer turn rate and slip of an estimator, or of the truth (None)."""
        if len(block):
            self.turn_lists.setdefault(name, []).append(block)

    def events(self, events: list[Event]) -> None:
        """Buffer events."""
        self.event_list.extend(events)

    def due(self, t: float) -> bool:
        """Decide whether to flush at `t` (s): true once every `BLOCK_S`."""
        due = t - self.flushed_to >= BLOCK_S
        self.flushed_to = t if due else self.flushed_to
        return due

    def flush(self, t: float | None = None) -> None:
        """Hand on what is buffered; with `t` (s), everything up to there has come."""
        truth = Truth.concatenate(self.truths) if self.truths else None
        estimates = {name: type(blocks[0]).concatenate(blocks) for name, blocks in self.estimate_lists.items()}
        seen = take(truth, self.compared.rows(len(truth))) if truth is not None else None
        if seen is not None:
            down_b = attitude.down(seen.q_nb)
            self.turning(None, self.true_turn.add(seen.t, seen.rate_ib_b, seen.accel_b, down_b))
        turns = {name: Turning.concatenate(blocks) for name, blocks in self.turn_lists.items()}
        if self.log:
            self._write(self.log, truth, estimates, turns, t)
        if self.accuracy:
            if seen is not None:
                self.accuracy.add_truth(seen.t, seen.q_nb, seen.vel_n, seen.on_ground)
            for steps in self.setpoint_list:
                self.accuracy.add_steps(steps.t, steps.step)
            for name, block in estimates.items():
                self.accuracy.add_estimates(name, block)
            for who, turning in turns.items():
                self.accuracy.add_turning(who, turning.t, turning.turn_rate, turning.slip)
        for buffer in (
            self.truths, self.setpoint_list, self.records, self.estimate_lists, self.turn_lists, self.event_list,
        ):  # fmt: skip
            buffer.clear()

    def _write(
        self,
        log: FlightLog,
        truth: Truth | None,
        estimates: dict[str, Estimates],
        turns: dict[str | None, Turning],
        t: float | None,
    ) -> None:
        if truth is not None:
            log.truth(truth)
        if self.setpoint_list:
            log.setpoints(Setpoints.concatenate(self.setpoint_list))
        for (suite, instrument), blocks in self.records.items():
            log.record(suite, instrument, type(blocks[0]).concatenate(blocks))
        for name, block in estimates.items():
            log.estimates(name, block)
        for who, turning in turns.items():
            log.turning(who, turning)
        log.events(self.event_list)
        if t is not None:
            log.advance(t - self.hold_s)


def _chains(scenario: Scenario, place: Site, flight: Flight) -> list[Chain]:
    chains = []
    check_suites(scenario.faults, [s.name for s in scenario.suites])
    for component in scenario.suites:
        suite = make_suite(
            component,
            seed=scenario.seed,
            dt=flight.dt,
            epoch=scenario.epoch,
            start_lla=np.array(place.lla),
            faults=scenario.faults,
        )
        fed = {
            e.name: create_estimator(e, place, suite.info)
            for e in scenario.estimators
            if e.settings["suite"] == suite.name
        }
        chains.append(Chain(suite, fed))
    return chains


def _rows_per_sample(scenario: Scenario, chains: list[Chain]) -> int:
    """Count rows of truth between samples of the IMU whose estimator flies."""
    rate = next(c.suite.info.rate for c in chains if scenario.pilot_attitude in c.estimators)
    return max(1, round(scenario.rate / rate))


def _feed_back(flight: Flight, estimates: Estimates, gyro_b: np.ndarray) -> None:
    """Give the last estimate to the autopilot, once there is one."""
    if len(estimates) and np.isfinite(estimates.q_nb[-1, 0]):
        flight.feedback(estimates.q_nb[-1], gyro_b[-1] - np.nan_to_num(estimates.gyro_bias[-1]))


def _metadata(scenario: Scenario, place: Site, chains: list[Chain]) -> dict[str, dict[str, str]]:
    from importlib.metadata import version

    packages = ("ahrs-sim", "jsbsim", "numpy", "numba", "wmm-calculator")
    flight = {
        "scenario": scenario.name,
        "seed": str(scenario.seed),
        "epoch": scenario.epoch.isoformat(),
        "rate_hz": f"{scenario.rate:g}",
        "pilot_attitude": scenario.pilot_attitude,
    }
    versions = {"python": platform.python_version(), **{name: version(name) for name in packages}}
    suites = {f"suite {c.suite.name}": c.suite.specification() for c in chains}
    sheets = {f"sensors {c.suite.name}": exactly(c.suite.info) for c in chains}
    made = {name: estimator for c in chains for name, estimator in c.estimators.items()}
    methods = {f"estimator {e.name}": described(e, made[e.name]) for e in scenario.estimators}
    return {"flight": flight, "versions": versions, "site": exactly(place), **sheets, **suites, **methods}


def exactly(known: Site | SensorInfo) -> dict[str, str]:
    """Serialise a site or a data sheet losslessly for the log's metadata: a replay needs neither grades nor models."""
    values = dataclasses.asdict(known)
    return {k: " ".join(repr(float(x)) for x in np.atleast_1d(v)) for k, v in values.items()}
