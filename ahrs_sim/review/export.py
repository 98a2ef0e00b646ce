"""`ahrs-sim export` and `ahrs_sim.read_log`: a log as tables, one per topic.

Columns are named like the numbers in the messages (`angular_velocity.x`, `innovation.0`), `t` is in front: seconds of
flight, from the header's stamp where there is one. Sequences of any length (`/tf`) have no place in a table and are
left out, as are the parts of the header.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.errors import InputError
from ahrs_sim.evaluation import metrics
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.reader import LogReader, flatten, is_stamped, stamps

if TYPE_CHECKING:
    import pandas

    from ahrs_sim.recordings.as_log import RecordingLog

_UNITS: dict[str, dict[str, str]] = {
    "sensor_msgs/msg/Imu": {
        "angular_velocity": "rad/s",
        "angular_velocity_covariance": "rad2/s2",
        "linear_acceleration": "m/s2",
        "linear_acceleration_covariance": "m2/s4",
        "orientation": "1",
        "orientation_covariance": "rad2",
    },
    "sensor_msgs/msg/MagneticField": {"magnetic_field": "T", "magnetic_field_covariance": "T2"},
    "sensor_msgs/msg/NavSatFix": {"latitude": "deg", "longitude": "deg", "altitude": "m", "position_covariance": "m2"},
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": "Pa", "variance": "Pa2"},
    "sensor_msgs/msg/Temperature": {"temperature": "degC", "variance": "K2"},
    "geometry_msgs/msg/TwistStamped": {"twist.linear": "m/s", "twist.angular": "rad/s"},
    "nav_msgs/msg/Odometry": {
        "pose.pose.position": "m",
        "pose.pose.orientation": "1",
        "twist.twist.linear": "m/s",
        "twist.twist.angular": "rad/s",
    },
}
"""Of the types of ROS, by message and field; our own types have their units in their definitions."""

_UNIT = re.compile(r"^(rad/s2|rad/s|rad2|rad|m/s2|m/s|m|Pa|K|T|deg|1/min|0\.\.1)\b")
_MIXED = {"lla": ("rad", "rad", "m")}


def units(log: "LogReader | RecordingLog", topic: str) -> dict[str, str]:
    """Unit by column of a topic's table; columns without or with an unknown unit are not there.

    Raises:
        InputError: no such topic, or one that cannot be read.
    """
    kind = log.topics[topic].type_name if topic in log.topics else ""
    by_field = dict(_UNITS.get(kind, {}))
    for line in log.schemas.get(kind, "").split("=" * 80)[0].splitlines():
        declaration, _, comment = line.partition("#")
        words = declaration.split()
        if len(words) == 2 and (found := _UNIT.match(comment.strip())):
            by_field.setdefault(words[1], found[1].replace("0..1", "1"))
    result = {"t": "s"}
    for name, _ in _columns(np.empty(0, log.dtype(topic))):
        parts = name.split(".")
        if parts[0] in _MIXED and len(parts) == 2:
            result[name] = _MIXED[parts[0]][int(parts[1])]
        for k in range(len(parts), 0, -1):
            if (unit := by_field.get(".".join(parts[:k]))) and name not in result:
                result[name] = unit
    return result


def _columns(array: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """The columns that fit into a table."""
    for name, values in flatten(array):
        if name == "log_time" or name.startswith("header."):
            continue
        if values.dtype != object or len(values) == 0 or isinstance(values[0], str):
            yield name, values


def _seconds(log: "LogReader | RecordingLog", array: np.ndarray) -> np.ndarray:
    ns = stamps(array) if is_stamped(array.dtype) else array["log_time"]
    return (ns - log.epoch_ns) / 1e9


def _frame(log: LogReader, array: np.ndarray) -> "pandas.DataFrame":
    import pandas

    return pandas.DataFrame({"t": _seconds(log, array), **dict(_columns(array))}, copy=False)


class LogFrames(Mapping[str, "pandas.DataFrame"]):
    """A log as pandas frames by topic, each read when it is asked for; index `t`, s of flight.

    Also `truth`, `estimates` and `errors` with angles in degrees for reading, `metadata`, `events`. Closes as a context
    manager or by `close`.

    Raises:
        InputError: not a log.
    """

    def __init__(self, path: str | Path) -> None:
        self._log = FlightReader(path)

    def __getitem__(self, topic: str) -> "pandas.DataFrame":
        """All messages of a topic.

        Raises:
            KeyError: no such topic.
            InputError: it cannot be read.
        """
        if topic not in self._log.topics:
            raise KeyError(topic)
        frame = _frame(self._log, self._log.read(topic)).set_index("t")
        frame.attrs["units"] = units(self._log, topic)
        return frame

    def __iter__(self) -> Iterator[str]:
        return iter(self._log.topics)

    def __len__(self) -> int:
        return len(self._log.topics)

    def close(self) -> None:
        """Close the file."""
        self._log.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._log.close()

    @property
    def estimators(self) -> list[str]:
        """Names of the estimators."""
        return self._log.estimators

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Seeds, versions, specifications and settings by record."""
        return self._log.metadata

    @property
    def events(self) -> "pandas.DataFrame":
        """What happened: columns level, name, text."""
        return self["/events"][["level", "name", "text"]]

    def truth(self) -> "pandas.DataFrame":
        """Roll, pitch and heading in deg, north, east and height in m, airspeed in m/s, on_ground."""
        import pandas

        from ahrs_sim.world import wgs84

        truth = self._log.truth()
        offset = wgs84.offset_n(truth.lla, truth.lla[0]) if len(truth) else np.empty((0, 3))
        return pandas.DataFrame(
            {
                **_angles(truth.q_nb),
                "north": offset[:, 0],
                "east": offset[:, 1],
                "height": -offset[:, 2],
                "airspeed": truth.airspeed,
                "on_ground": truth.on_ground,
            },
            index=pandas.Index(truth.t, name="t"),
        )

    def estimates(self, name: str) -> "pandas.DataFrame":
        """Roll, pitch and heading of an estimator in deg, its gyro biases in deg/s, its status.

        Raises:
            InputError: no such estimator.
        """
        import pandas

        e = self._log.estimates(name)
        bias = np.degrees(e.gyro_bias)
        columns = {f"gyro_bias_{axis}": bias[:, k] for k, axis in enumerate("xyz")}
        return pandas.DataFrame({**_angles(e.q_nb), **columns, "status": e.status}, index=pandas.Index(e.t, name="t"))

    def errors(self, name: str) -> "pandas.DataFrame":
        """Errors of an estimator against the truth in deg: roll, pitch, heading, tilt, total.

        Raises:
            InputError: no such estimator, or no truth.
        """
        import pandas

        e, truth = self._log.estimates(name), self._log.truth()
        errors = np.degrees(metrics.attitude_errors(e.q_nb, e.down_b, attitude.interpolate(truth.t, truth.q_nb, e.t)))
        return pandas.DataFrame(errors, columns=list(metrics.MEASURES), index=pandas.Index(e.t, name="t"))


def _angles(q_nb: np.ndarray) -> dict[str, np.ndarray]:
    roll, pitch, heading = np.degrees(attitude.euler(q_nb)).T
    return {"roll": roll, "pitch": pitch, "heading": np.mod(heading, 360.0)}


def export(path: Path, form: str, folder: Path, topics: Sequence[str] = (), map_file: Path | None = None) -> list[Path]:
    """Write topics as tables, in memory that does not grow with the log.

    Args:
        path: any recording that can be read.
        form: `parquet` (units in the metadata of the columns) or `csv`.
        folder: made when it is not there; files are named like the topics, `chr_imu_data_raw.csv`.
        topics: which; none: all that have columns and messages.
        map_file: what the columns of a table of text are.

    Returns:
        The files written.

    Raises:
        InputError: not a log, an unknown topic, nothing to write, pyarrow missing, or a folder that cannot be used.
    """
    table: type[_CsvTable] | type[_ParquetTable] = _ParquetTable if form == "parquet" else _CsvTable
    from ahrs_sim.recordings.as_log import open_log

    with open_log(path, map_file) as log, ExitStack() as stack:
        chosen = list(topics) or [t.topic for t in log.topics.values() if t.count and t.readable]
        tables: dict[str, _CsvTable | _ParquetTable] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for arrays in log.blocks(chosen):  # one pass: uncompressing is what costs
                for topic, array in arrays.items():
                    columns = dict(_columns(array)) if len(array) else {}
                    if not columns:
                        continue
                    if topic not in tables:
                        output = folder / (re.sub(r"[^A-Za-z0-9.-]+", "_", topic).strip("_") + f".{form}")
                        tables[topic] = stack.enter_context(closing(table(log, topic, output)))
                    tables[topic].write({"t": _seconds(log, array), **columns})
        except OSError as error:
            raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None
        if not tables:
            raise InputError(f"{path}: no messages that fit into a table")
        return [tables[topic].output for topic in chosen if topic in tables]


def plain_cell(text: str) -> str:
    """Text for a cell of a CSV: one that a spreadsheet would take for a formula gets a `'` in front."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text


def _plain_cells(values: np.ndarray) -> np.ndarray:
    return np.array([plain_cell(str(x)) for x in values], object) if values.dtype == object else values


class _CsvTable:
    """A topic as comma-separated values."""

    def __init__(self, log: "LogReader | RecordingLog", topic: str, output: Path) -> None:
        del log, topic  # no place for units
        self.output = output
        self.stream = output.open("w", encoding="utf-8", newline="")
        self.empty = True

    def write(self, columns: dict[str, np.ndarray]) -> None:
        import pandas

        plain = {plain_cell(name): _plain_cells(values) for name, values in columns.items()}
        frame = pandas.DataFrame(plain, copy=False)
        frame.to_csv(self.stream, index=False, header=self.empty, lineterminator="\n")
        self.empty = False

    def close(self) -> None:
        self.stream.close()


class _ParquetTable:
    """A topic in Parquet, the unit of a column in its metadata."""

    def __init__(self, log: "LogReader | RecordingLog", topic: str, output: Path) -> None:
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            raise InputError("--to parquet needs pyarrow; pip install 'ahrs-sim[export]'") from None
        self.output, self.arrow, self.parquet = output, pyarrow, parquet
        self.units = units(log, topic)
        self.about = {"topic": topic, "type": log.topics[topic].type_name, "epoch_ns": str(log.epoch_ns)}
        self.writer: Any = None

    def write(self, columns: dict[str, np.ndarray]) -> None:
        arrays = [self.arrow.array(np.ascontiguousarray(values)) for values in columns.values()]
        fields = [
            self.arrow.field(n, a.type, metadata={"unit": self.units[n]} if n in self.units else None)
            for n, a in zip(columns, arrays, strict=True)
        ]
        schema = self.arrow.schema(fields, metadata=self.about)
        if self.writer is None:
            self.writer = self.parquet.ParquetWriter(self.output, schema, compression="zstd")
        self.writer.write_table(self.arrow.Table.from_arrays(arrays, schema=schema))

    def close(self) -> None:
        if self.writer is not None:
            self.writer.close()
