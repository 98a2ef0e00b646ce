"""Writing the log of a flight, block by block.

    with FlightLog("flight.mcap", epoch_ns=epoch, suites={"chr": ["imu", "mag"]}, estimators=["ekf"]) as log:
        log.truth(truth)
        log.record("chr", "imu", records)
        log.estimates("ekf", estimates)
        log.advance(t)

Topics and their precision are in `ahrs_sim.log.topics`.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.evaluation import metrics
from ahrs_sim.evaluation.decimate import Decimator, RowDecimator, take
from ahrs_sim.evaluation.evaluator import Comparison, Evaluator
from ahrs_sim.flight.truth import Event, Setpoints, Truth
from ahrs_sim.log.mcap.writer import Listener, LogChannel, LogWriter
from ahrs_sim.log.ros_axes import RosTwins
from ahrs_sim.log.topics import (
    ATTITUDE,
    BIASES,
    ERRORS,
    ESTIMATED_IMU,
    ESTIMATES,
    EVENTS,
    FIX_RATE,
    INSTRUMENTS,
    ODOMETRY,
    PLOT_RATE,
    SETPOINTS,
    STATE,
    STATUS,
    TEMPERATURE,
    TEMPERATURE_EVERY,
    TF,
    TF_RATE,
    TF_STATIC,
    TRUTH,
    TRUTH_ATTITUDE,
    TRUTH_FIX,
    TRUTH_RATE,
    TRUTH_TURN,
    TURN,
    Route,
)
from ahrs_sim.sensors.records import Answers, FixRecord, ImuRecord, MagRecord, Record
from ahrs_sim.turning import Turning
from ahrs_sim.world import wgs84
from estimators.types import Estimates

HOLD_S = 0.5
"""s after its own time in which a message may still come: sensors deliver late, estimates follow them."""


class EstimateTopics:
    """Writes what estimators report under `/est/NAME`: state, attitude for viewers, and errors.

    Make it before the log is started.

    Args:
        writer: of the log.
        epoch_ns: zero of the estimates' time, ns since 1970.
        names: of the estimators.
        twins: in the axes of ROS; None: not wanted.
    """

    def __init__(self, writer: LogWriter, epoch_ns: int, names: Iterable[str], twins: RosTwins | None = None) -> None:
        self.writer, self.epoch_ns = writer, epoch_ns
        self._channels = {
            name: {route.topic: route.channel(writer, f"/est/{name}") for route in ESTIMATES} for name in names
        }
        self._twins = twins
        for name in self._channels:
            if twins:
                twins.add(ESTIMATED_IMU, f"/est/{name}")
        self._plotted = {name: Decimator(PLOT_RATE) for name in self._channels}
        self._evaluator = Evaluator(self._write_errors, hold_s=HOLD_S)

    def reference(self, t: np.ndarray, q_nb: np.ndarray) -> None:
        """Extend the reference attitude `q_nb` (n, 4) at `t` (n,) s; call before the estimates of the same times."""
        self._evaluator.add_reference(t, q_nb)

    def write(self, name: str, block: Estimates) -> None:
        """Write a block of one estimator."""
        if not len(block):
            return
        times = nanoseconds(self.epoch_ns, block.t)
        arrival = nanoseconds(self.epoch_ns, block.arrival) if isinstance(block, Answers) else times
        channels = self._channels[name]
        self.writer.write(channels[STATE.topic], arrival, times, **STATE.columns(block))
        self._plot(name, block)
        known = np.isfinite(block.q_nb).all(axis=1)
        if known.any():
            block, times, arrival = take(block, known), times[known], arrival[known]
            covariance = np.nan_to_num(block.att_cov)
            columns = {"orientation": block.q_nb, "orientation_covariance": covariance}
            self.writer.write(channels[ESTIMATED_IMU.topic], arrival, times, **columns)
            if self._twins:
                self._twins.write(ESTIMATED_IMU, f"/est/{name}", arrival, times, columns)

    def turning(self, name: str, block: Turning) -> None:
        """Write turn rate and slip of one estimator."""
        times = nanoseconds(self.epoch_ns, block.t)
        self.writer.write(self._channels[name][TURN.topic], times, times, **TURN.columns(block))

    def _plot(self, name: str, block: Estimates) -> None:
        """Write attitudes and biases at `PLOT_RATE`, and errors as soon as the reference is there."""
        block = take(block, self._plotted[name].rows(block.t))
        block = take(block, np.isfinite(block.down_b).all(axis=1))
        if not len(block):
            return
        channels = self._channels[name]
        times = nanoseconds(self.epoch_ns, block.t)
        roll, pitch = attitude.roll_pitch(block.down_b)
        heading = np.mod(attitude.euler(block.q_nb)[:, 2], 2 * np.pi)
        self.writer.write(channels[ATTITUDE.topic], times, times, roll=roll, pitch=pitch, heading=heading)
        self.writer.write(channels[BIASES.topic], times, times, **BIASES.columns(block))
        self._evaluator.add(name, block)

    def _write_errors(self, name: str, pair: Comparison) -> None:
        known = np.isfinite(pair.reference).all(axis=1)
        pair = Comparison(take(pair.estimates, known), pair.reference[known])
        columns = dict(zip(metrics.MEASURES, pair.errors().T, strict=True))
        columns |= {f"{axis}_sigma": s for axis, s in zip(metrics.MEASURES, pair.sigma().T, strict=False)}
        times = nanoseconds(self.epoch_ns, pair.estimates.t)
        self.writer.write(self._channels[name][ERRORS.topic], times, times, **columns)


def nanoseconds(epoch_ns: int, t: np.ndarray) -> np.ndarray:
    """Convert times of flight `t` (s) to ns since 1970."""
    return epoch_ns + np.rint(t * 1e9).astype(np.int64)


class FlightLog:
    """Log of a flight being flown; context manager and errors as of `LogWriter`.

    Args:
        path: name of the finished log.
        epoch_ns: zero of the flight's time, ns since 1970.
        truth_rate: Hz, rows of the truth per second.
        logged_rate: Hz, of the truth in the log, or less.
        suites: instruments (keys of `INSTRUMENTS`) by name of the suite.
        estimators: their names.
        attachments: contents by file name: scenario, aircraft.
        metadata: records of names and values: seeds, versions, specifications.
        force: overwrite an existing log.
        chunk_s: what a crash can cost, s.
        listener: is given all messages, too.
        ros_axes: IMU and magnetometer topics a second time, in the axes of ROS (see `ahrs_sim.log.ros_axes`).

    Raises:
        InputError: the log exists, or cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        epoch_ns: int,
        truth_rate: float = 400.0,
        logged_rate: float = TRUTH_RATE,
        ros_axes: bool = False,
        suites: Mapping[str, Sequence[str]] | None = None,
        estimators: Iterable[str] = (),
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        force: bool = False,
        chunk_s: float = 1.0,
        listener: Listener | None = None,
    ) -> None:
        self.epoch_ns = epoch_ns
        self.writer = writer = LogWriter(path, epoch_ns=epoch_ns, force=force, chunk_s=chunk_s, listener=listener)
        self._origin: np.ndarray | None = None
        self._logged = RowDecimator(truth_rate / logged_rate)
        self._moved = RowDecimator(truth_rate / TF_RATE)
        self._fixed = RowDecimator(truth_rate / FIX_RATE)
        self._plotted = RowDecimator(truth_rate / PLOT_RATE)
        self._warmed: dict[str, RowDecimator] = {}
        self._saturated: dict[tuple[str, str], bool] = {}

        self._tf_static = self._frames(TF_STATIC)
        self._tf = self._frames(TF)
        self._truth = [(route, route.channel(writer)) for route in TRUTH]
        self._twins = twins = RosTwins(writer) if ros_axes else None
        for route in TRUTH:
            if twins:
                twins.add(route)
        self._fix = TRUTH_FIX.channel(writer)
        self._attitude = TRUTH_ATTITUDE.channel(writer)
        self._turn = TRUTH_TURN.channel(writer)
        self._events = EVENTS.channel(writer)
        self._setpoints = SETPOINTS.channel(writer)
        self._instruments: dict[tuple[str, str], LogChannel] = {}
        self._status: dict[tuple[str, str], LogChannel] = {}
        self._temperature: dict[str, LogChannel] = {}
        for suite, instruments in (suites or {}).items():
            for instrument in instruments:
                key = suite, instrument
                self._instruments[key] = INSTRUMENTS[instrument][1].channel(writer, f"/{suite}")
                if twins:
                    twins.add(INSTRUMENTS[instrument][1], f"/{suite}")
                if instrument in STATUS:
                    self._status[key] = STATUS[instrument].channel(writer, f"/{suite}")
                if instrument == "imu":
                    self._temperature[suite] = TEMPERATURE.channel(writer, f"/{suite}")
                    self._warmed[suite] = RowDecimator(TEMPERATURE_EVERY)
        self._estimates = EstimateTopics(writer, epoch_ns, estimators, twins)
        for name, values in (metadata or {}).items():
            writer.metadata(name, values)
        for name, data in (attachments or {}).items():
            writer.attach(name, data, _MEDIA.get(Path(name).suffix, "application/octet-stream"))
        writer.start()
        now = np.array([epoch_ns])
        writer.write(self._tf_static, now, now)

    def _frames(self, route: Route) -> LogChannel:
        return self.writer.add_channel(route.topic, route.type_name, constant=route.constant)

    def _ns(self, t: np.ndarray) -> np.ndarray:
        return nanoseconds(self.epoch_ns, t)

    def truth(self, block: Truth) -> None:
        """Write the truth: all rows of the flight in order, of which every k-th is kept."""
        if not len(block):
            return
        if self._origin is None:
            self._origin = block.lla[0].copy()
        times = self._ns(block.t)
        rows = self._logged.rows(len(block))
        logged = take(block, rows)
        for route, channel in self._truth:
            columns = route.columns(logged)
            if route is ODOMETRY:
                columns["pose.pose.position"] = _offset_n(logged.lla, self._origin)
                columns["twist.twist.linear"] = attitude.to_body(logged.q_nb, logged.vel_n)
                columns["twist.twist.angular"] = logged.rate_ib_b
            self.writer.write(channel, times[rows], times[rows], **columns)
            if self._twins:
                self._twins.write(route, "", times[rows], times[rows], columns)
        self._estimates.reference((times[rows] - self.epoch_ns) / 1e9, logged.q_nb)  # as a replay will read it
        rows = self._plotted.rows(len(block))
        roll, pitch, heading = attitude.euler(block.q_nb[rows]).T
        heading = np.mod(heading, 2 * np.pi)
        self.writer.write(self._attitude, times[rows], times[rows], roll=roll, pitch=pitch, heading=heading)
        rows = self._moved.rows(len(block))
        moved = {
            "transforms.0.transform.translation": _offset_n(block.lla[rows], self._origin),
            "transforms.0.transform.rotation": block.q_nb[rows],
        }
        self.writer.write(self._tf, times[rows], times[rows], **moved)
        rows = self._fixed.rows(len(block))
        latitude, longitude, height = block.lla[rows].T
        self.writer.write(
            self._fix,
            times[rows],
            times[rows],
            latitude=np.degrees(latitude),
            longitude=np.degrees(longitude),
            altitude=height,
        )

    def record(self, suite: str, instrument: str, block: Record) -> None:
        """Write what an instrument has sent, in the order of its stamps."""
        if not len(block):
            return
        route = INSTRUMENTS[instrument][1]
        columns = route.columns(block)
        arrival, stamp = self.epoch_ns + block.arrival_ns, self.epoch_ns + block.stamp_ns
        if isinstance(block, FixRecord):
            covariance = np.zeros((len(block), 9))
            covariance[:, [4, 0, 8]] = block.sigma**2  # north, east, down of a matrix in east, north, up
            columns["position_covariance"] = covariance
        self.writer.write(self._instruments[suite, instrument], arrival, stamp, **columns)
        if self._twins:
            self._twins.write(route, f"/{suite}", arrival, stamp, columns)
        if (suite, instrument) in self._status:
            rows = np.arange(len(block))
            if isinstance(block, ImuRecord | MagRecord):
                before = np.r_[self._saturated.get((suite, instrument), not block.saturated[0]), block.saturated[:-1]]
                rows = np.flatnonzero(block.saturated != before)
                self._saturated[suite, instrument] = bool(block.saturated[-1])
            columns = STATUS[instrument].columns(take(block, rows))
            self.writer.write(self._status[suite, instrument], arrival[rows], stamp[rows], **columns)
        if isinstance(block, ImuRecord):
            rows = self._warmed[suite].rows(len(block))
            celsius = block.temperature[rows] - 273.15
            self.writer.write(self._temperature[suite], arrival[rows], stamp[rows], temperature=celsius)

    def estimates(self, name: str, block: Estimates) -> None:
        """Write what an estimator reports."""
        self._estimates.write(name, block)

    def turning(self, name: str | None, block: Turning) -> None:
        """Write turn rate and slip of an estimator, or of the truth (None)."""
        if name is not None:
            self._estimates.turning(name, block)
        elif len(block):
            times = self._ns(block.t)
            self.writer.write(self._turn, times, times, **TRUTH_TURN.columns(block))

    def setpoints(self, block: Setpoints) -> None:
        """Write the set-points of the pilot."""
        times = self._ns(block.t)
        self.writer.write(self._setpoints, times, times, **SETPOINTS.columns(block))

    def events(self, events: Iterable[Event]) -> None:
        """Write events, at most `HOLD_S` older than the last `advance`."""
        for event in events:
            t = int(self._ns(np.array(event.t)))
            self.writer.event(self._events, t, level=event.level, name=event.name, text=event.text)

    def advance(self, t: float) -> None:
        """Declare data complete up to `t` (s of flight): chunks older than `t - HOLD_S` may be written."""
        self.writer.advance(self.epoch_ns + round((t - HOLD_S) * 1e9))

    def close(self) -> None:
        """Finish the log and give it its name."""
        self.writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.writer.__exit__(kind, error, trace)


_MEDIA = {".toml": "application/toml", ".xml": "application/xml", ".txt": "text/plain", ".json": "application/json"}


def _offset_n(lla: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Compute positions (n, 3) m in the NED frame at `origin` (3,).

    `wgs84.offset_n`, but in sums that round alike however many rows there are (a matrix product does not): the log's
    bytes may not depend on the length of a block.
    """
    x, y, z = (wgs84.ecef(lla) - wgs84.ecef(origin)).T
    return np.stack([x * a + y * b + z * c for a, b, c in wgs84.ned_axes(origin[0], origin[1])], axis=-1)
