"""What of a flight lives where in its log: every topic, for writing and for reading back.

    with FlightLog("flight.mcap", epoch_ns=epoch, suites={"chr": ["imu", "mag"]}, estimators=["ekf"]) as log:
        log.truth(truth)
        log.record("chr", "imu", records)
        log.estimates("ekf", estimates)
        log.advance(t)

    with FlightReader("flight.mcap") as log:
        truth, imu, estimates = log.truth(), log.record("chr", "imu"), log.estimates("ekf")

Numbers are stored as they are (float64), so they come back bit for bit; of the estimates covariances, sigmas,
innovations and adaptation are float32. Frames are `map_ned` and `base_link_frd`, tied to the `map` and `base_link` of
ROS by `/tf_static`.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np

from ahrs_sim import consistency, metrics
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.flight.truth import Event, Setpoints, Truth
from ahrs_sim.log.reader import LogReader, quaternion, stamps, vector
from ahrs_sim.log.writer import Listener, LogChannel, LogWriter
from ahrs_sim.sensors.records import (
    AirRecord,
    AttitudeRecord,
    FixRecord,
    HeadingRecord,
    ImuErrorsRecord,
    ImuRecord,
    MagRecord,
    PhaseRecord,
    PressureRecord,
    Record,
    SuiteBlock,
    VelocityRecord,
)
from ahrs_sim.world import wgs84
from estimators.types import Columns, Estimates, blank

NED = "map_ned"
FRD = "base_link_frd"

TRUTH_RATE = 100.0  # Hz, of the truth in the log
TF_RATE = 50.0  # Hz, of the moving frame
FIX_RATE = 5.0  # Hz, of the true position for maps
TEMPERATURE_EVERY = 50  # IMU messages
PLOT_RATE = 10.0  # Hz, of attitudes and errors for plots

HOLD_S = 0.5
"""How long after its own time a message may still come: sensors deliver late, estimates follow them."""

_REMEMBERED_S = 5.0  # of the reference, longer than estimates lag behind it

_UNKNOWN = np.r_[-1.0, np.zeros(8)]  # ROS for a field that is not reported
_HALF = float(np.sqrt(0.5))

B = TypeVar("B", bound=Columns)


@dataclass(frozen=True, slots=True)
class Route:
    """One topic and the columns of a block that go there.

    `fields` names a column for each field of the message, or column and index for one of its components.
    """

    topic: str
    type_name: str
    frame: str
    about: str
    fields: Mapping[str, str | tuple[str, int]] = field(default_factory=dict)
    constant: Mapping[str, Any] = field(default_factory=dict)

    def channel(self, writer: LogWriter, prefix: str = "") -> LogChannel:
        """The channel in a new log, its topic behind `prefix`."""
        return writer.add_channel(prefix + self.topic, self.type_name, constant=self.constant, frame_id=self.frame)

    def columns(self, block: Columns) -> dict[str, np.ndarray]:
        """Fields of the messages from the columns of a block."""
        return {
            path: getattr(block, place) if isinstance(place, str) else getattr(block, place[0])[:, place[1]]
            for path, place in self.fields.items()
        }

    def put(self, columns: dict[str, np.ndarray], array: np.ndarray) -> None:
        """The other way: an array from `LogReader.read` into the columns of a block, in place."""
        for path, place in self.fields.items():
            values = array
            for name in path.split("."):
                values = values[name]
            if values.dtype.names:
                values = quaternion(values) if "w" in values.dtype.names else vector(values)
            if isinstance(place, str):
                columns[place][...] = values.reshape(columns[place].shape)
            else:
                columns[place[0]][:, place[1]] = values


# ----------------------------------------------------------------------------------------------- the topics

TRUTH: tuple[Route, ...] = (
    Route(
        "/truth/odometry",
        "nav_msgs/msg/Odometry",
        NED,
        "Of the centre of gravity: position from where the flight began (m), attitude, velocity (m/s) and inertial "
        "rate (rad/s), both in body axes.",
        {"pose.pose.orientation": "q_nb"},
        {"child_frame_id": FRD},
    ),
    Route(
        "/truth/imu",
        "sensor_msgs/msg/Imu",
        FRD,
        "What a perfect IMU at the centre of gravity reads: inertial rate (rad/s), specific force (m/s2, -9.81 on z at "
        "rest); and the attitude.",
        {"orientation": "q_nb", "angular_velocity": "rate_ib_b", "linear_acceleration": "accel_b"},
    ),
    Route(
        "/truth/state",
        "ahrs_sim_msgs/msg/TruthState",
        NED,
        "The rest of the state of motion.",
        {
            "lla": "lla",
            "velocity": "vel_n",
            "angular_acceleration": "rate_dot_b",
            "centre_of_gravity": "cg_b",
        },
    ),
    Route(
        "/truth/air",
        "ahrs_sim_msgs/msg/TruthAir",
        FRD,
        "Air, engine and wheels.",
        {
            "wind": "wind_n",
            **{
                name: name
                for name in (
                    [
                        "airspeed",
                        "alpha",
                        "beta",
                        "pressure",
                        "temperature",
                        "rpm",
                        "throttle",
                        "height_agl",
                        "on_ground",
                    ]
                )
            },
        },
    ),
)
ODOMETRY = TRUTH[0]
TRUTH_FIX = Route(
    "/truth/fix",
    "sensor_msgs/msg/NavSatFix",
    FRD,
    f"The position for maps, deg and m above the ellipsoid, {FIX_RATE:g} Hz.",
    constant={"status": {"service": 1}},
)
TRUTH_ATTITUDE = Route(
    "/truth/attitude",
    "ahrs_sim_msgs/msg/Attitude",
    NED,
    f"Roll, pitch and heading for plots, {PLOT_RATE:g} Hz.",
)
TF = Route(
    "/tf",
    "tf2_msgs/msg/TFMessage",
    "",
    f"Where the aircraft is, `{NED}` to `{FRD}`, {TF_RATE:g} Hz.",
    constant={"transforms": [{"header": {"frame_id": NED}, "child_frame_id": FRD}]},
)
TF_STATIC = Route(
    "/tf_static",
    "tf2_msgs/msg/TFMessage",
    "",
    f"`map` (ENU) to `{NED}` and `{FRD}` to `base_link` (FLU), once at the beginning.",
    constant={
        "transforms": [
            {
                "header": {"frame_id": "map"},
                "child_frame_id": NED,
                "transform": {"rotation": (0.0, _HALF, _HALF, 0.0)},  # rpy(pi, 0, pi/2)
            },
            {
                # base_link hangs below base_link_frd: a frame has one parent, and that of base_link_frd is map_ned.
                "header": {"frame_id": FRD},
                "child_frame_id": "base_link",
                "transform": {"rotation": (0.0, 1.0, 0.0, 0.0)},  # rpy(pi, 0, 0), its own inverse
            },
        ]
    },
)

INSTRUMENTS: dict[str, tuple[type[Record], Route]] = {
    "imu": (
        ImuRecord,
        Route(
            "/imu/data_raw",
            "sensor_msgs/msg/Imu",
            FRD,
            "Angular rate (rad/s) and specific force (m/s2, -9.81 on z at rest) as measured.",
            {"angular_velocity": "gyro_b", "linear_acceleration": "accel_b"},
            {"orientation_covariance": _UNKNOWN},
        ),
    ),
    "imu_errors": (
        ImuErrorsRecord,
        Route(
            "/imu/errors",
            "ahrs_sim_msgs/msg/ImuErrors",
            FRD,
            "The true biases behind every message of the IMU, turn-on and in-run together: for reports, not for "
            "estimators.",
            {"gyro_bias": "gyro_bias", "accel_bias": "accel_bias"},
        ),
    ),
    "mag": (
        MagRecord,
        Route("/imu/mag", "sensor_msgs/msg/MagneticField", FRD, "Magnetic field, T.", {"magnetic_field": "mag_b"}),
    ),
    "fix": (
        FixRecord,
        Route(
            "/gps/fix",
            "sensor_msgs/msg/NavSatFix",
            FRD,
            "Latitude and longitude in deg, height above the ellipsoid in m, covariance in m2 (east, north, up) as the "
            "receiver reports it.",
            {
                "status.status": "fix",
                "latitude": ("lla_deg", 0),
                "longitude": ("lla_deg", 1),
                "altitude": ("lla_deg", 2),
            },
            {"status": {"service": 1}, "position_covariance_type": 2},
        ),
    ),
    "velocity": (
        VelocityRecord,
        Route(
            "/gps/vel",
            "geometry_msgs/msg/TwistStamped",
            NED,
            "Velocity relative to the Earth, m/s, north, east, down.",
            {"twist.linear": "vel_n"},
        ),
    ),
    "heading": (
        HeadingRecord,
        Route(
            "/gps/heading",
            "ahrs_sim_msgs/msg/Heading",
            NED,
            "Heading of a two-antenna receiver.",
            {"heading": "heading", "sigma": "sigma", "satellites": "satellites"},
        ),
    ),
    "diff_pressure": (
        PressureRecord,
        Route(
            "/air/diff_pressure",
            "sensor_msgs/msg/FluidPressure",
            FRD,
            "Pitot minus static pressure, Pa.",
            {"fluid_pressure": "pressure"},
        ),
    ),
    "static_pressure": (
        PressureRecord,
        Route(
            "/air/static_pressure",
            "sensor_msgs/msg/FluidPressure",
            FRD,
            "Static pressure, Pa.",
            {"fluid_pressure": "pressure"},
        ),
    ),
    "air": (
        AirRecord,
        Route(
            "/air/data",
            "ahrs_sim_msgs/msg/AirData",
            FRD,
            "What the air data computer makes of the pressures.",
            {name: name for name in ("indicated_airspeed", "airspeed", "alpha", "beta")},
        ),
    ),
    "interferometer": (
        PhaseRecord,
        Route(
            "/interferometer/phase",
            "ahrs_sim_msgs/msg/EmitterPhase",
            FRD,
            "Two-antenna interferometer on a ground emitter.",
            {name: name for name in ("phase", "phase_rate", "bearing")},
        ),
    ),
}
"""Block type and topic of each instrument of a suite; the topic goes behind `/<suite>`."""

HEARD = ("imu", "mag", "fix", "velocity", "heading", "air")
"""Instruments that estimators listen to."""

STATUS: dict[str, Route] = {
    instrument: Route(topic, "ahrs_sim_msgs/msg/SensorStatus", FRD, about, fields)
    for instrument, topic, about, fields in (
        (
            "imu",
            "/imu/status",
            "First message of the IMU, then each at which `saturated` changes.",
            {"saturated": "saturated"},
        ),
        ("mag", "/imu/mag_status", "The same for the magnetometer.", {"saturated": "saturated"}),
        ("fix", "/gps/status", "Satellites behind every fix.", {"satellites": "satellites"}),
    )
}
TEMPERATURE = Route(
    "/imu/temperature",
    "sensor_msgs/msg/Temperature",
    FRD,
    f"Of the IMU's chip, deg C, every {TEMPERATURE_EVERY}th message.",
)

STATE = Route(
    "/state",
    "ahrs_sim_msgs/msg/EstimatorState",
    NED,
    "Everything that an estimator says, one message per IMU sample.",
    {
        "status": "status",
        "orientation": "q_nb",
        "down": "down_b",
        "gyro_bias": "gyro_bias",
        "accel_bias": "accel_bias",
        "lla": "lla",
        "velocity": "vel_n",
        "attitude_covariance": "att_cov",
        "gyro_bias_sigma": "gyro_bias_sigma",
        "accel_bias_sigma": "accel_bias_sigma",
        "innovation": "innovation",
        "innovation_variance": "innovation_var",
        "adaptation": "adaptation",
    },
)
ESTIMATED_IMU = Route(
    "/imu",
    "sensor_msgs/msg/Imu",
    FRD,
    f"The same attitude for viewers, `{FRD}` to `{NED}`, with its covariance (rad2; 0: not known); absent while there "
    "is none.",
    {"orientation": "q_nb"},
    {"angular_velocity_covariance": _UNKNOWN, "linear_acceleration_covariance": _UNKNOWN},
)
ATTITUDE = Route(
    "/attitude",
    "ahrs_sim_msgs/msg/Attitude",
    NED,
    f"Roll, pitch and heading for plots, {PLOT_RATE:g} Hz.",
)
ERRORS = Route(
    "/errors",
    "ahrs_sim_msgs/msg/AttitudeErrors",
    NED,
    f"How wrong it is, for plots, {PLOT_RATE:g} Hz: against the truth, in the replay of a bag against its reference.",
)
REFERENCE = Route(
    "/reference/imu",
    "sensor_msgs/msg/Imu",
    FRD,
    f"The reference attitude of a bag that was replayed, `{FRD}` to `{NED}`.",
    {"orientation": "q_nb"},
    {"angular_velocity_covariance": _UNKNOWN, "linear_acceleration_covariance": _UNKNOWN},
)
SETPOINTS = Route(
    "/pilot/setpoints",
    "ahrs_sim_msgs/msg/Setpoints",
    NED,
    "What the pilot asks of the autopilot, and where the surfaces are.",
    {name: name for name in ("step", "roll", "pitch", "heading", "altitude", "climb_rate", "airspeed", "surfaces")},
)
EVENTS = Route("/events", "ahrs_sim_msgs/msg/Event", "", "Worth knowing: a step begins, a fault sets in, a crash.")


# ----------------------------------------------------------------------------------------------- writing


class Every:
    """Picks every k-th row of a stream that comes in blocks of any length."""

    def __init__(self, k: float) -> None:
        self.k = max(1, round(k))
        self.seen = 0

    def rows(self, n: int) -> np.ndarray:
        """Which of the next `n` rows to take."""
        first = -self.seen % self.k
        self.seen += n
        return np.arange(first, n, self.k)


class EstimateTopics:
    """What estimators say, `/est/NAME/state` and `/est/NAME/imu`, into a log not started yet.

    Args:
        writer: of the log.
        epoch_ns: zero of the estimates' time, ns since 1970.
        names: of the estimators.
    """

    def __init__(self, writer: LogWriter, epoch_ns: int, names: Iterable[str]) -> None:
        self.writer, self.epoch_ns = writer, epoch_ns
        self._channels = {
            name: [route.channel(writer, f"/est/{name}") for route in (STATE, ESTIMATED_IMU, ATTITUDE, ERRORS)]
            for name in names
        }
        self._cell = dict.fromkeys(self._channels, -(2**62))  # of PLOT_RATE, the last one plotted
        self._unjudged: dict[str, tuple[np.ndarray, ...]] = {}  # t, q_nb, down_b, att_cov the reference has not reached
        self._reference = np.empty(0), np.empty((0, 4))

    def reference(self, t: np.ndarray, q_nb: np.ndarray) -> None:
        """What errors are taken against, before the estimates of that time: `t` (n,) s rising, `q_nb` (n, 4)."""
        if not len(t):
            return
        times, attitudes = self._reference
        kept = times > (times[-1] if len(times) else 0.0) - _REMEMBERED_S
        self._reference = np.concatenate([times[kept], t]), np.concatenate([attitudes[kept], q_nb])

    def write(self, name: str, block: Estimates) -> None:
        """A block of one estimator."""
        if not len(block):
            return
        times = nanoseconds(self.epoch_ns, block.t)
        state, imu, _, _ = self._channels[name]
        self.writer.write(state, times, times, **STATE.columns(block))
        self._plotted(name, block)
        known = np.isfinite(block.q_nb).all(axis=1)
        if known.any():
            block, times = _picked(block, known), times[known]
            covariance = np.nan_to_num(block.att_cov)
            self.writer.write(imu, times, times, orientation=block.q_nb, orientation_covariance=covariance)

    def _plotted(self, name: str, block: Estimates) -> None:
        """Attitudes and errors of a block, which may have to wait for their reference."""
        _, _, attitude, errors = self._channels[name]
        cell = np.floor(block.t * PLOT_RATE + 1e-6).astype(np.int64)
        rows = np.flatnonzero(np.diff(cell, prepend=self._cell[name]))
        self._cell[name] = int(cell[-1])
        rows = rows[np.isfinite(block.down_b[rows]).all(axis=1)]
        said: tuple[np.ndarray, ...] = block.t[rows], block.q_nb[rows], block.down_b[rows], block.att_cov[rows]
        t, q_nb, down_b, att_cov = said
        times = nanoseconds(self.epoch_ns, t)
        roll, pitch = metrics.roll_pitch(down_b)
        heading = np.mod(metrics.euler(q_nb)[:, 2], 2 * np.pi)
        self.writer.write(attitude, times, times, roll=roll, pitch=pitch, heading=heading)

        if name in self._unjudged:
            said = tuple(np.concatenate(parts) for parts in zip(self._unjudged[name], said, strict=True))
        t, q_nb, down_b, att_cov = said
        reached, reference = self._reference
        wait = t > (reached[-1] if len(reached) > 1 else -np.inf)
        self._unjudged[name] = tuple(column[wait & (t > t[-1:] - HOLD_S)] for column in said)
        if wait.all():
            return
        truth = metrics.interpolate(reached, reference, t)
        known = ~wait & np.isfinite(truth).all(axis=1)
        t, q_nb, down_b, att_cov, truth = t[known], q_nb[known], down_b[known], att_cov[known], truth[known]
        columns = dict(zip(metrics.MEASURES, metrics.attitude_errors(q_nb, down_b, truth).T, strict=True))
        sigma = consistency.euler_sigma(q_nb, att_cov)
        columns |= {f"{axis}_sigma": s for axis, s in zip(metrics.MEASURES, sigma.T, strict=False)}
        times = nanoseconds(self.epoch_ns, t)
        self.writer.write(errors, times, times, **columns)


def nanoseconds(epoch_ns: int, t: np.ndarray) -> np.ndarray:
    """Times of flight `t` (s) in ns since 1970."""
    return epoch_ns + np.rint(t * 1e9).astype(np.int64)


class FlightLog:
    """The log of a flight being flown; see `LogWriter` for how it behaves as a context manager and when it fails.

    Args:
        path: name of the finished log.
        epoch_ns: zero of the flight's time, ns since 1970.
        truth_rate: Hz, rows of the truth per second; logged at `TRUTH_RATE` or less.
        suites: instruments (keys of `INSTRUMENTS`) by name of the suite.
        estimators: their names.
        attachments: contents by file name: scenario, aircraft.
        metadata: records of names and values: seeds, versions, specifications.
        force: overwrite an existing log.
        chunk_s: what a crash can cost, s.
        listener: is given all messages, too.

    Raises:
        InputError: the log exists, or cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        epoch_ns: int,
        truth_rate: float = 400.0,
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
        self._logged = Every(truth_rate / TRUTH_RATE)
        self._moved = Every(truth_rate / TF_RATE)
        self._fixed = Every(truth_rate / FIX_RATE)
        self._plotted = Every(truth_rate / PLOT_RATE)
        self._warmed: dict[str, Every] = {}
        self._saturated: dict[tuple[str, str], bool] = {}

        self._tf_static = self._frames(TF_STATIC)
        self._tf = self._frames(TF)
        self._truth = [(route, route.channel(writer)) for route in TRUTH]
        self._fix = TRUTH_FIX.channel(writer)
        self._attitude = TRUTH_ATTITUDE.channel(writer)
        self._events = EVENTS.channel(writer)
        self._setpoints = SETPOINTS.channel(writer)
        self._instruments: dict[tuple[str, str], LogChannel] = {}
        self._status: dict[tuple[str, str], LogChannel] = {}
        self._temperature: dict[str, LogChannel] = {}
        for suite, instruments in (suites or {}).items():
            for instrument in instruments:
                key = suite, instrument
                self._instruments[key] = INSTRUMENTS[instrument][1].channel(writer, f"/{suite}")
                if instrument in STATUS:
                    self._status[key] = STATUS[instrument].channel(writer, f"/{suite}")
                if instrument == "imu":
                    self._temperature[suite] = TEMPERATURE.channel(writer, f"/{suite}")
                    self._warmed[suite] = Every(TEMPERATURE_EVERY)
        self._estimates = EstimateTopics(writer, epoch_ns, estimators)
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
        """The truth, all rows of the flight in order; every k-th is kept."""
        if not len(block):
            return
        if self._origin is None:
            self._origin = block.lla[0].copy()
        times = self._ns(block.t)
        rows = self._logged.rows(len(block))
        logged = _picked(block, rows)
        for route, channel in self._truth:
            columns = route.columns(logged)
            if route is ODOMETRY:
                columns["pose.pose.position"] = _offset_n(logged.lla, self._origin)
                columns["twist.twist.linear"] = _to_body(logged.q_nb, logged.vel_n)
                columns["twist.twist.angular"] = logged.rate_ib_b
            self.writer.write(channel, times[rows], times[rows], **columns)
        self._estimates.reference((times[rows] - self.epoch_ns) / 1e9, logged.q_nb)  # as a replay will read it
        rows = self._plotted.rows(len(block))
        roll, pitch, heading = metrics.euler(block.q_nb[rows]).T
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
        """What an instrument has sent, in the order of its stamps."""
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
        if (suite, instrument) in self._status:
            rows = np.arange(len(block))
            if isinstance(block, ImuRecord | MagRecord):
                before = np.r_[self._saturated.get((suite, instrument), not block.saturated[0]), block.saturated[:-1]]
                rows = np.flatnonzero(block.saturated != before)
                self._saturated[suite, instrument] = bool(block.saturated[-1])
            columns = STATUS[instrument].columns(_picked(block, rows))
            self.writer.write(self._status[suite, instrument], arrival[rows], stamp[rows], **columns)
        if isinstance(block, ImuRecord):
            rows = self._warmed[suite].rows(len(block))
            celsius = block.temperature[rows] - 273.15
            self.writer.write(self._temperature[suite], arrival[rows], stamp[rows], temperature=celsius)

    def estimates(self, name: str, block: Estimates) -> None:
        """What an estimator says."""
        self._estimates.write(name, block)

    def setpoints(self, block: Setpoints) -> None:
        """What the pilot asks for."""
        times = self._ns(block.t)
        self.writer.write(self._setpoints, times, times, **SETPOINTS.columns(block))

    def events(self, events: Iterable[Event]) -> None:
        """Events, at most `HOLD_S` older than the last `advance`."""
        for event in events:
            t = int(self._ns(np.array(event.t)))
            self.writer.event(self._events, t, level=event.level, name=event.name, text=event.text)

    def advance(self, t: float) -> None:
        """All that happened up to `t` (s of flight) has been given; what is `HOLD_S` older may go to the file."""
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


def _picked(block: B, rows: np.ndarray) -> B:
    return type(block)(*(getattr(block, f.name)[rows] for f in dataclasses.fields(block)))


def _offset_n(lla: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Positions (n, 3) m in the NED frame at `origin` (3,).

    `wgs84.offset_n`, but in sums that round alike however many rows there are (a matrix product does not): the log's
    bytes may not depend on the length of a block.
    """
    x, y, z = (wgs84.ecef(lla) - wgs84.ecef(origin)).T
    return np.stack([x * a + y * b + z * c for a, b, c in wgs84.ned_axes(origin[0], origin[1])], axis=-1)


def _to_body(q_nb: np.ndarray, v_n: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) from NED to body axes."""
    w, axis = q_nb[:, :1], -q_nb[:, 1:]
    t = 2.0 * np.cross(axis, v_n)
    return v_n + w * t + np.cross(axis, t)


# ----------------------------------------------------------------------------------------------- reading


class FlightReader(LogReader):
    """A log of ours as the blocks it was made of.

    Start and end are seconds of flight in log time; `end` itself is left out.
    """

    @property
    def suites(self) -> dict[str, list[str]]:
        """Instruments by suite."""
        found: dict[str, list[str]] = {}
        for topic in self.topics:
            for instrument, (_, route) in INSTRUMENTS.items():
                suite = topic[1 : -len(route.topic)]
                if topic.endswith(route.topic) and suite and "/" not in suite and suite != "truth":
                    found.setdefault(suite, []).append(instrument)
        return found

    @property
    def estimators(self) -> list[str]:
        """Names of the estimators."""
        ends = "/est/", STATE.topic
        return [t[len(ends[0]) : -len(ends[1])] for t in self.topics if t.startswith(ends[0]) and t.endswith(ends[1])]

    def seconds(self, ns: np.ndarray) -> np.ndarray:
        """Time of flight (s) of times in ns since 1970."""
        return (ns - self.epoch_ns) / 1e9

    def truth(self, start: float | None = None, end: float | None = None) -> Truth:
        """The truth at its logged rate.

        Raises:
            InputError: not in this log.
        """
        arrays = self.read([route.topic for route in TRUTH], *self._span(start, end))
        n = min(len(array) for array in arrays.values())  # a recovered log may end between two
        columns = blank(Truth, n)
        for route in TRUTH:
            route.put(columns, arrays[route.topic][:n])
        columns["t"][:] = self.seconds(stamps(arrays[ODOMETRY.topic][:n]))
        return Truth(**columns)

    def record(self, suite: str, instrument: str, start: float | None = None, end: float | None = None) -> Record:
        """What an instrument has sent, in the order of arrival.

        Raises:
            InputError: not in this log.
        """
        if instrument not in INSTRUMENTS:
            raise InputError(f"{self.path}: no instrument '{instrument}'{nearest(instrument, INSTRUMENTS)}")
        kind, route = INSTRUMENTS[instrument]
        span = self._span(start, end)
        array = self.read(f"/{suite}{route.topic}", *span)
        columns = self._columns(kind, route, array)
        if instrument in STATUS and f"/{suite}{STATUS[instrument].topic}" in self.topics:  # a bag's suite has none
            # The last status with a stamp not after the message's.
            status = self.read(f"/{suite}{STATUS[instrument].topic}", None, span[1])
            rows = np.searchsorted(stamps(status), stamps(array), "right") - 1
            if len(status):
                STATUS[instrument].put(columns, status[np.maximum(rows, 0)])
        if kind is ImuRecord and f"/{suite}{TEMPERATURE.topic}" in self.topics:
            array = self.read(f"/{suite}{TEMPERATURE.topic}", *span)
            if len(array):
                kelvin = array["temperature"] + 273.15
                columns["temperature"][:] = np.interp(columns["stamp_ns"], stamps(array) - self.epoch_ns, kelvin)
        return kind(**columns)

    def suite_blocks(
        self, names: Sequence[str], beside: Callable[[dict[str, np.ndarray]], None] | None = None, *topics: str
    ) -> Iterator[dict[str, SuiteBlock]]:
        """What the instruments of several suites have sent, by suite, portion by portion in the order of arrival.

        Only what estimators see: states of saturation and temperatures are left out. The first suite also has the true
        attitude, as `reference`, where the log has it.

        Args:
            names: the suites.
            beside: given, before each portion, the messages of `topics` up to the same log time (no `reference` then).
            topics: see `beside`.

        Raises:
            InputError: a suite is not in this log.
        """
        if unknown := [name for name in names if name not in self.suites]:
            raise InputError(f"{self.path}: no suite '{unknown[0]}'{nearest(unknown[0], self.suites)}")
        heard = [(suite, i) for suite in names for i in self.suites[suite] if i in HEARD]
        instruments = {f"/{suite}{INSTRUMENTS[i][1].topic}": (suite, i) for suite, i in heard}
        satellites = {f"/{suite}{STATUS[i].topic}": suite for suite, i in heard if i == "fix"}
        truth = [ODOMETRY.topic] if ODOMETRY.topic in self.topics and not beside else []
        for messages in self.blocks([*instruments, *satellites, *truth, *topics]):
            if beside:
                beside(messages)
            found: dict[str, SuiteBlock] = {suite: {} for suite in names}
            for topic in truth:
                found[names[0]]["reference"] = AttitudeRecord(
                    **self._columns(AttitudeRecord, ODOMETRY, messages[topic])
                )
            for topic, (suite, instrument) in instruments.items():
                kind, route = INSTRUMENTS[instrument]
                columns = self._columns(kind, route, messages[topic])
                if kind is FixRecord:  # one status a fix, sent with it
                    status = messages[f"/{suite}{STATUS[instrument].topic}"]
                    rows = np.searchsorted(stamps(status), columns["stamp_ns"] + self.epoch_ns, "right") - 1
                    if len(status):
                        STATUS[instrument].put(columns, status[np.maximum(rows, 0)])
                found[suite][instrument] = kind(**columns)
            yield found

    def _columns(self, kind: type[Record], route: Route, array: np.ndarray) -> dict[str, np.ndarray]:
        columns = blank(kind, len(array))
        route.put(columns, array)
        columns["stamp_ns"][:] = stamps(array) - self.epoch_ns
        columns["arrival_ns"][:] = array["log_time"] - self.epoch_ns
        if kind is FixRecord:
            columns["sigma"][:] = np.sqrt(array["position_covariance"][:, [4, 0, 8]])
        return columns

    def estimates(self, name: str, start: float | None = None, end: float | None = None) -> Estimates:
        """What an estimator said.

        Raises:
            InputError: not in this log.
        """
        array = self.read(f"/est/{name}{STATE.topic}", *self._span(start, end))
        columns = blank(Estimates, len(array))
        STATE.put(columns, array)
        columns["t"][:] = self.seconds(stamps(array))
        return Estimates(**columns)

    def setpoints(self, start: float | None = None, end: float | None = None) -> Setpoints:
        """What the pilot asked for."""
        array = self.read(SETPOINTS.topic, *self._span(start, end))
        columns = blank(Setpoints, len(array))
        SETPOINTS.put(columns, array)
        columns["t"][:] = self.seconds(stamps(array))
        return Setpoints(**columns)

    def events(self) -> list[Event]:
        """All events in order."""
        array = self.read(EVENTS.topic)
        return [
            Event(float(t), row["level"], row["name"], row["text"])
            for t, row in zip(self.seconds(stamps(array)), array, strict=True)
        ]

    def _span(self, start: float | None, end: float | None) -> tuple[int | None, int | None]:
        first, last = (None if t is None else self.epoch_ns + round(t * 1e9) for t in (start, end))
        return first, last
