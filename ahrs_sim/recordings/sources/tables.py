"""Tables of numbers (`.csv` and the like), whose columns the user's map names."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.recordings.sources.base import FRD, NED, UNITS, Columns, Held, one_line
from ahrs_sim.scenario.table import Table

_CSV_KINDS: dict[str, tuple[str, dict[str, tuple[str, int]]]] = {  # type, and its fields from keys of the map
    "imu": ("sensor_msgs/msg/Imu", {"gyro": ("angular_velocity", 3), "accel": ("linear_acceleration", 3)}),
    "mag": ("sensor_msgs/msg/MagneticField", {"field": ("magnetic_field", 3)}),
    "fix": (
        "sensor_msgs/msg/NavSatFix",
        {"latitude": ("latitude", 1), "longitude": ("longitude", 1), "altitude": ("altitude", 1)},
    ),
    "velocity": ("geometry_msgs/msg/TwistStamped", {"velocity": ("twist__linear", 3)}),
    "heading": ("ahrs_sim_msgs/msg/Heading", {"heading": ("heading", 1)}),
    "diff_pressure": ("sensor_msgs/msg/FluidPressure", {"pressure": ("fluid_pressure", 1)}),
    "static_pressure": ("sensor_msgs/msg/FluidPressure", {"pressure": ("fluid_pressure", 1)}),
    "air": ("ahrs_sim_msgs/msg/AirData", {"airspeed": ("airspeed", 1)}),
    "reference": ("sensor_msgs/msg/Imu", {"euler": ("orientation", 3), "quaternion": ("orientation", 4)}),
}
_CHANGES_ONLY = ("fix", "velocity", "heading")
_DEGREES = ("latitude", "longitude")


class Csv(Held):
    """Columns by name; `[csv.KIND]` of the map says which and in what units."""

    def __init__(self, path: Path, table: Table) -> None:
        if not path.is_file():
            raise InputError(f"{path}: cannot be read: no such file")
        if not table.data:
            raise InputError(f"{path}: a CSV needs a --map with [csv] saying what its columns are; see docs/replay.md")
        import pandas

        clock = table.table("time")
        separator = table.text("separator", ",")
        try:
            frame = pandas.read_csv(path, sep=separator, skipinitialspace=True)
        except (OSError, ValueError, pandas.errors.ParserError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: no CSV: {one_line(error)}") from None
        self._frame = frame
        ns = np.rint(self._column(clock, "column") * (UNITS[clock.choice("unit", ["s", "ms", "us", "ns"], "s")] * 1e9))
        clock.close()
        arrays = {}
        for kind, (type_name, fields) in _CSV_KINDS.items():
            if table.has(kind):
                arrays[kind] = self._messages(table.table(kind), kind, type_name, fields, ns)
        table.close()
        super().__init__(path, arrays)

    def _messages(
        self, table: Table, kind: str, type_name: str, fields: Mapping[str, tuple[str, int]], ns: np.ndarray
    ) -> Columns:
        frame_id = NED if kind in ("velocity", "heading") else FRD
        columns: dict[str, np.ndarray] = {}
        for key, (place, size) in fields.items():
            if not table.has(key):
                continue
            entry = table.table(key)
            names = entry.value("columns")
            if not isinstance(names, list) or len(names) != size:
                raise entry.error("columns", f"{names!r} is not a list of {size} column names")
            scale = 1.0 if key in _DEGREES else UNITS[entry.choice("unit", list(UNITS), *_default_unit(key))]
            entry.close()
            value = scale * np.column_stack([self._named(entry, name) for name in names])
            if key == "euler":
                from ahrs_sim.attitude import from_euler

                value = from_euler(value)
            columns[place] = value
        table.close()
        if not columns:
            raise table.error(next(iter(fields)), "missing; name its columns")
        values = np.column_stack(list(columns.values()))
        good = np.isfinite(values).all(axis=1) & np.isfinite(ns)
        if kind in _CHANGES_ONLY:  # a table repeats what a slow sensor has said
            good &= np.r_[True, (np.diff(values, axis=0) != 0).any(axis=1)]
        chosen = {k: (v[good] if v.shape[1] > 1 else v[good, 0]) for k, v in columns.items()}
        return Columns(type_name, ns[good].astype(np.int64), chosen, frame_id)

    def _column(self, table: Table, key: str) -> np.ndarray:
        return self._named(table, table.text(key))

    def _named(self, table: Table, name: Any) -> np.ndarray:
        import pandas

        if name not in self._frame:
            known = [str(c) for c in self._frame.columns]
            raise table.error("columns", f"no column '{name}' in the file{nearest(str(name), known)}")
        numbers: np.ndarray = pandas.to_numeric(self._frame[name], errors="coerce").to_numpy(float)
        return numbers


def _default_unit(key: str) -> tuple[str, ...]:
    return ("m",) if key in ("altitude", "quaternion", *_DEGREES) else ()
