"""`ahrs-sim export`: a log as tables, one per topic.

Columns are named like the numbers in the messages (`angular_velocity.x`, `innovation.0`), `t` is in front: seconds of
flight, from the header's stamp where there is one. Sequences of any length (`/tf`) have no place in a table and are
left out, as are the parts of the header.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ahrs_sim.errors import InputError
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
    """Yield the columns that fit into a table."""
    for name, values in flatten(array):
        if name == "log_time" or name.startswith("header."):
            continue
        if values.dtype != object or len(values) == 0 or isinstance(values[0], str):
            yield name, values


def _seconds(log: "LogReader | RecordingLog", array: np.ndarray) -> np.ndarray:
    ns = stamps(array) if is_stamped(array.dtype) else array["log_time"]
    return (ns - log.epoch_ns) / 1e9


def frame(log: LogReader, array: np.ndarray) -> "pandas.DataFrame":
    """Make a frame of messages of a topic: column `t` and what fits into a table."""
    import pandas

    return pandas.DataFrame({"t": _seconds(log, array), **dict(_columns(array))}, copy=False)


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
    """Make the text of a CSV cell: one that a spreadsheet would take for a formula gets a `'` in front."""
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
