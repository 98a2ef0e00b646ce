"""Contents of a log: any MCAP file, ours or not."""

import datetime
from pathlib import Path
from typing import Any

from ahrs_sim.log.mcap.reader import LogReader


def summary(source: str | Path | Any) -> dict[str, Any]:
    """Summarise the contents of a log, fit for JSON: times in ns since 1970, rates in Hz, the size in bytes.

    Args:
        source: path of an MCAP file, or anything open with the properties of a `LogReader`, which is closed.

    Raises:
        InputError: the file is not a log, or not a whole one.
    """
    with LogReader(source) if isinstance(source, (str, Path)) else source as log:
        first, last = log.time_range_ns
        duration = (last - first) / 1e9
        topics = [
            {
                "topic": t.topic,
                "type": t.type_name,
                "encoding": t.encoding,
                "schema_encoding": t.schema_encoding,
                "messages": t.count,
                "rate_hz": round((t.count - 1) / duration, 3) if t.count > 1 and duration > 0 else None,
            }
            for t in log.topics.values()
        ]
        return {
            "path": str(log.path),
            "size": log.size,
            "profile": log.profile,
            "library": log.library,
            "start_ns": first,
            "end_ns": last,
            "duration_s": duration,
            "messages": log.message_count,
            "topics": topics,
            "metadata": log.metadata,
            "attachments": log.attachments,
        }


def text(source: str | Path | Any, *, everything: bool = True) -> str:
    """Format `summary` for a reader.

    Args:
        source: as for `summary`.
        everything: also each topic of every estimator, specifications and settings; else what fits a screen.

    Raises:
        InputError: the file is not a log, or not a whole one.
    """
    s = summary(source)
    start = datetime.datetime.fromtimestamp(s["start_ns"] // 10**9, datetime.UTC)
    profile, library = (_one_line(s[key]) or "-" for key in ("profile", "library"))
    lines = [
        f"{s['path']}: {s['size'] / 1e6:.1f} MB, profile {profile}, written by {library}",
        f"{start:%Y-%m-%d %H:%M:%S} UTC, {s['duration_s']:.3f} s, {s['messages']} messages"
        if s["messages"]
        else "no messages",
        "",
    ]
    rows = [("topic", "type", "messages", "Hz")]
    for t in s["topics"] if everything else _together(s["topics"]):
        rate = "" if t["rate_hz"] is None else f"{t['rate_hz']:.1f}"
        form = "" if (t["encoding"], t["schema_encoding"]) == ("cdr", "ros2msg") else _form(t)
        kind = " ".join(word for word in (t["type"], form) if word)
        rows.append((_one_line(t["topic"]), _one_line(kind), str(t["messages"]), rate))
    width = [max(len(row[i]) for row in rows) for i in range(4)]
    lines += [
        f"{topic:{width[0]}}  {kind:{width[1]}}  {count:>{width[2]}}  {rate:>{width[3]}}".rstrip()
        for topic, kind, count, rate in rows
    ]
    names = dict.fromkeys(t["topic"].split("/")[2] for t in s["topics"] if t["topic"].startswith("/est/"))
    if names and not everything:
        lines += ["", f"estimators: {', '.join(_one_line(name) for name in names)}"]
    shown = s["metadata"] if everything else {k: v for k, v in s["metadata"].items() if k == "flight"}
    for name, values in shown.items():
        entries = (f"  {_one_line(key)} = {_one_line(value)}" for key, value in values.items())
        lines += ["", f"{_one_line(name)}:", *entries]
    if len(shown) < len(s["metadata"]):
        rest = sorted({name.partition(" ")[0] for name in s["metadata"]} - set(shown))
        lines += ["", f"--all shows the rest: {', '.join(_one_line(name) for name in rest)}"]
    if s["attachments"] and everything:
        sizes = (f"  {_one_line(name)}, {size} bytes" for name, size in s["attachments"].items())
        lines += ["", "attachments:", *sizes]
    if any((t["encoding"], t["schema_encoding"]) != ("cdr", "ros2msg") for t in s["topics"]):
        lines += [
            "",
            "in brackets: not ROS 2 ('cdr' with 'ros2msg'); but for standard types it is carried along, not read",
        ]
    return "\n".join(lines)


def _together(topics: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Merge the topics of estimators: one row for each of `/est/*/state` instead of one an estimator."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for t in topics:
        parts = t["topic"].split("/")
        name = "/".join(["/est/*", *parts[3:]]) if parts[:2] == ["", "est"] and len(parts) == 4 else t["topic"]
        row = found.setdefault((name, t["type"]), {**t, "topic": name, "messages": 0})
        row["messages"] += t["messages"]
    estimators = dict.fromkeys(t["topic"].split("/")[2] for t in topics if t["topic"].startswith("/est/"))
    for (name, _), row in found.items():
        row["topic"] = name.replace("*", next(iter(estimators))) if len(estimators) == 1 else name
    return list(found.values())


def _form(topic: dict[str, Any]) -> str:
    """Name the encoding of a topic's messages, and of their schema where it differs."""
    message, schema = topic["encoding"] or "-", topic["schema_encoding"]
    return f"({message}, {schema})" if schema and schema != message else f"({message})"


def _one_line(value: str) -> str:
    """Make a text from a file fit for a terminal: one line, no control characters."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(value.split()))
    return line if len(line) <= 100 else line[:97] + "..."
