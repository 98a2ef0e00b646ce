"""Any recording as topics of standard ROS messages: structured arrays as `LogReader` gives them, block by block.

mcap        MCAP: ROS 2 by our own reader; ROS 1, JSON, protobuf of the standard types
rosbag      ROS 2 bags in SQLite and ROS 1 bags, by rosbags
ulog        PX4's ULog
dataflash   ArduPilot's DataFlash
tables      CSV and the like, as a map says; text: one such file, by pandas

What is no bag is laid out as the standard messages, so that whatever follows knows one form only.
"""

from pathlib import Path

from ahrs_sim.errors import InputError
from ahrs_sim.recordings.sources.base import DATES_FROM_NS, UNITS, Source, Topic
from ahrs_sim.scenario.table import Table

__all__ = ["DATES_FROM_NS", "UNITS", "Source", "Topic", "is_mcap", "looks_like_text", "open_source"]

READS = (
    "MCAP, ROS bags (.mcap, .db3, their folder, .bag), PX4 (.ulg), ArduPilot (.bin), "
    "and .csv or any table of text with [csv] in --map"
)


def open_source(path: Path, mapping: Table) -> Source:
    """Open the recording at `path`, by how it begins or else by its suffix.

    Args:
        path: a file or folder.
        mapping: the user's map; a table of text needs its `[csv]`.

    Raises:
        InputError: not there, cannot be read, or of no kind known here.
    """
    kind = _kind(path, mapping)
    if kind == "db3" and path.is_dir() and not (path / "metadata.yaml").is_file():
        raise InputError(_no_bag(path))
    if kind == "mcap":
        from ahrs_sim.recordings.sources.mcap import Mcap

        return Mcap(path)
    if kind in ("db3", "ros1"):
        from ahrs_sim.recordings.sources.rosbag import Rosbag

        return Rosbag(path, version=1 if kind == "ros1" else 2)
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


def _no_bag(folder: Path) -> str:
    """Say what to do with a folder that is no ROS 2 bag."""
    there = sorted(p for p in folder.iterdir() if p.is_file())
    one = next((p.name for p in there if p.suffix in (".mcap", ".db3", ".bag", ".ulg", ".bin", ".BIN")), "")
    if one:
        return f"{folder}: a folder without metadata.yaml; name the file in it, {one}"
    if any(p.suffix in (".csv", ".txt") for p in there):
        return f"{folder}: a folder of tables needs a --map with [csv], or preset:NAME (ahrs-sim list maps)"
    return f"{folder}: a folder with no recording in it; can be read: {READS}"


def looks_like_text(path: Path) -> bool:
    """Test whether a file begins like a table of text: no zero bytes, and of no kind known by its first bytes."""
    try:
        with path.open("rb") as stream:
            beginning = stream.read(4096)
    except OSError:
        return False
    known = any(beginning.startswith(magic) for magic, _ in _BEGINNINGS)
    return bool(beginning) and not known and (b"\0" not in beginning or beginning[:2] in (b"\xff\xfe", b"\xfe\xff"))


def is_mcap(path: Path) -> bool:
    """Test whether to read it as an MCAP file: it begins as one, or as nothing else that is known."""
    return _kind(path, Table({}, "")) == "mcap"


_SUFFIXES = {
    ".mcap": "mcap",
    ".db3": "db3",
    ".ulg": "ulog",
    ".ulog": "ulog",
    ".bin": "dataflash",
    ".csv": "csv",
    ".bag": "ros1",
}
_BEGINNINGS = (
    (b"\x89MCAP0\r\n", "mcap"),
    (b"SQLite format 3\0", "db3"),
    (b"\x55\x4c\x6f\x67\x01\x12\x35", "ulog"),
    (b"\xa3\x95\x80", "dataflash"),
    (b"#ROSBAG V2", "ros1"),
)


def _kind(path: Path, mapping: Table) -> str:
    if path.is_dir():
        return "csv" if mapping.has("csv") else "db3"
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
