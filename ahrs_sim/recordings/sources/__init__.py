"""Any recording as topics of standard ROS messages: structured arrays as `LogReader` gives them, block by block.

mcap        ROS 2 bags in MCAP, by our own reader
rosbag      ROS 2 bags in SQLite, by rosbags
ulog        PX4's ULog
dataflash   ArduPilot's DataFlash
tables      CSV and the like, by pandas

What is no bag is laid out as the standard messages, so that whatever follows knows one form only.
"""

from pathlib import Path

from ahrs_sim.errors import InputError
from ahrs_sim.recordings.sources.base import UNITS, Source, Topic
from ahrs_sim.scenario.table import Table

__all__ = ["UNITS", "Source", "Topic", "is_mcap", "open_source"]

READS = (
    "ROS 2 bags (.mcap, .db3, their folder), PX4 (.ulg), ArduPilot (.bin), "
    "and .csv or any table of text with [csv] in --map"
)


def open_source(path: Path, mapping: Table) -> Source:
    """The recording at `path`, by how it begins or else by its suffix.

    Args:
        path: a file or folder.
        mapping: the user's map; a table of text needs its `[csv]`.

    Raises:
        InputError: not there, cannot be read, or of no kind known here.
    """
    kind = _kind(path, mapping)
    if kind == "mcap":
        from ahrs_sim.recordings.sources.mcap import Mcap

        return Mcap(path)
    if kind == "db3":
        from ahrs_sim.recordings.sources.rosbag import Db3

        return Db3(path)
    if kind == "ulog":
        from ahrs_sim.recordings.sources.ulog import Ulog

        return Ulog(path)
    if kind == "dataflash":
        from ahrs_sim.recordings.sources.dataflash import DataFlash

        return DataFlash(path)
    if kind == "csv":
        from ahrs_sim.recordings.sources.tables import Csv

        return Csv(path, mapping.table("csv"))
    raise InputError(f"{path}: not a recording known here; can be read: {READS}")


def is_mcap(path: Path) -> bool:
    """Whether it is to be read as an MCAP file: it begins as one, or nothing says that it is something else."""
    return _kind(path, Table({}, "")) == "mcap"


_SUFFIXES = {".mcap": "mcap", ".db3": "db3", ".ulg": "ulog", ".ulog": "ulog", ".bin": "dataflash", ".csv": "csv"}
_BEGINNINGS = (
    (b"\x89MCAP0\r\n", "mcap"),
    (b"SQLite format 3\0", "db3"),
    (b"\x55\x4c\x6f\x67\x01\x12\x35", "ulog"),
    (b"\xa3\x95\x80", "dataflash"),
)


def _kind(path: Path, mapping: Table) -> str:
    if path.is_dir():
        return "db3"
    try:
        with path.open("rb") as stream:
            beginning = stream.read(16)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    for magic, kind in _BEGINNINGS:
        if beginning.startswith(magic):
            return kind
    if mapping.has("csv"):
        return "csv"
    return _SUFFIXES.get(path.suffix.lower(), "mcap" if not beginning else "unknown")
