"""Changes to a file that keep its form: the damage lies behind the checks of lengths and checksums, not in front.

Every mutator takes a generator and the bytes of a sound file and gives the bytes of a changed one.
"""

import json
import sqlite3
import struct
import tempfile
import tomllib
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
import zstandard

Rng = np.random.Generator
MAGIC = b"\x89MCAP0\r\n"
_WORDS = [
    "",
    "x",
    "../../etc/passwd",
    "\u2028<script>",
    "=1+1",
    "nan",
    "-1",
    "os:system",
    ":x",
    "é",
    "a" * 3000,
    "\0",
    "1e999",
]
_NUMBERS = [
    0,
    -1,
    1,
    2,
    7,
    255,
    2**31 - 1,
    -(2**31),
    2**53,
    2**63 - 1,
    1e-300,
    1e9,
    1e300,
    float("nan"),
    float("inf"),
    -0.0,
    0.5,
]
_ODD = [*_WORDS, *_NUMBERS, True, [], {}, [[]], [1, 2], ["a", 1], {"a": 1}, [float("nan")] * 3, [0.0] * 9, [None]]


def pick(rng: Rng, items: Any) -> Any:
    """One of several things."""
    return items[int(rng.integers(len(items)))]


def some_bytes(rng: Rng, data: bytes) -> bytes:
    """A few bytes changed, cut out, repeated, or a number put over them."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(len(out) + 1))
        n = int(min(rng.integers(1, 17), len(out) - at))
        how = int(rng.integers(6))
        if how == 0 and out:
            at = min(at, len(out) - 1)
            out[at] ^= 1 << int(rng.integers(8))
        elif how == 1:
            del out[at : at + n]
        elif how == 2:
            out[at:at] = out[at : at + n]
        elif how == 3:
            out[at : at + n] = rng.bytes(n)
        else:
            form, number = pick(rng, ["<B", "<H", "<I", "<Q", "<f", "<d"]), pick(rng, _NUMBERS)
            at -= at % 4 if rng.random() < 0.7 else 0
            size = struct.calcsize(form)
            if form in ("<f", "<d"):
                text = struct.pack(form, min(max(float(number), -3e38), 3e38) if form == "<f" else float(number))
            else:
                number = 0 if number != number or abs(number) == float("inf") else int(number)
                text = (number & (2 ** (8 * size) - 1)).to_bytes(size, "little")
            out[at : at + size] = text
    return bytes(out)


def text(rng: Rng, data: bytes) -> bytes:
    """Lines and words of a text exchanged, repeated, left out."""
    lines = data.split(b"\n")
    for _ in range(int(rng.integers(1, 4))):
        k, other = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
        how = int(rng.integers(5))
        if how == 0 and len(lines) > 1:
            del lines[k]
        elif how == 1:
            lines[k] = lines[other]
        elif how == 2:
            words = lines[k].split(b" ")
            words[int(rng.integers(len(words)))] = str(pick(rng, _WORDS + _NUMBERS)).encode()
            lines[k] = b" ".join(words)
        elif how == 3:
            lines[k] = some_bytes(rng, lines[k])
        else:
            lines.insert(k, lines[other])
    return b"\n".join(lines)


# ----------------------------------------------------------------------------------------------- trees


def tree(rng: Rng, data: Any) -> Any:
    """A value somewhere in nested tables replaced, left out, renamed, moved."""
    places: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, inner in items:
            places.append((value, key))
            walk(inner)

    walk(data)
    for _ in range(int(rng.integers(1, 4))):
        if not places:
            break
        owner, key = pick(rng, places)
        how = int(rng.integers(8))
        try:
            if how == 0:
                del owner[key]
            elif how == 1 and isinstance(owner, dict):
                owner[str(pick(rng, [*_WORDS, key + "x", key.upper()]))] = owner.pop(key)
            elif how == 2:
                other, name = pick(rng, places)
                owner[key] = json.loads(json.dumps(other[name], default=str))
            elif how == 3 and isinstance(owner[key], int | float):
                owner[key] = owner[key] * pick(rng, [-1, 0, 1e3, 1e-3, 1e12, 1000])
            elif how == 4 and isinstance(owner[key], str):
                owner[key] = text(rng, owner[key].encode()).decode(errors="replace")
            elif how == 5:
                owner[key] = [owner[key]] * int(rng.integers(1, 4))
            else:
                owner[key] = pick(rng, _ODD)
        except (KeyError, IndexError, TypeError, OverflowError):
            continue
    return data


def toml(rng: Rng, data: bytes) -> bytes:
    """TOML: a change in the tree, seldom in the text."""
    if rng.random() < 0.15:
        return text(rng, data)
    try:
        return tomli_w.dumps(tree(rng, tomllib.loads(data.decode()))).encode()
    except (TypeError, ValueError, UnicodeError):
        return text(rng, data)


def json_(rng: Rng, data: bytes) -> bytes:
    """JSON likewise; a scenario inside of it is changed as TOML."""
    if rng.random() < 0.1:
        return text(rng, data)
    found = json.loads(data)
    if "scenario" in found and rng.random() < 0.4:
        found["scenario"] = toml(rng, found["scenario"].encode()).decode(errors="replace")
    else:
        found = tree(rng, found)
    return json.dumps(found, default=str).encode()


def csv(rng: Rng, data: bytes) -> bytes:
    """A table: cells, the head, rows out of order."""
    rows = [line.split(b",") for line in data.split(b"\n")]
    for _ in range(int(rng.integers(1, 6))):
        row = rows[0] if rng.random() < 0.2 else pick(rng, rows)
        how = int(rng.integers(5))
        if how == 0:
            row[int(rng.integers(len(row)))] = str(pick(rng, _WORDS + _NUMBERS)).encode()
        elif how == 1:
            rows.insert(int(rng.integers(len(rows))), row)
        elif how == 2:
            column, value = int(rng.integers(13)), str(pick(rng, _NUMBERS)).encode()
            for other in rows[int(rng.integers(len(rows))) :]:
                if column < len(other):
                    other[column] = value
        elif how == 3:
            del rows[int(rng.integers(len(rows))) :][: int(rng.integers(1, 50))]
            row.append(b"9")
        else:
            return some_bytes(rng, data)
    return b"\n".join(b",".join(row) for row in rows)


# ----------------------------------------------------------------------------------------------- binary forms


def _records(data: bytes) -> list[tuple[int, bytes]]:
    found, at = [], 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def _joined(records: list[tuple[int, bytes]]) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(body)) + body for opcode, body in records)


def _changed(rng: Rng, records: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """Some records changed: texts as texts, messages behind their heads."""
    for _ in range(int(rng.integers(1, 4))):
        if not records:
            break
        rare = [k for k, (opcode, _) in enumerate(records) if opcode != 5]
        k = pick(rng, rare) if rare and rng.random() < 0.6 else int(rng.integers(len(records)))
        opcode, body = records[k]
        how = rng.random()
        if how < 0.1:
            del records[k]
        elif how < 0.2:
            records.insert(int(rng.integers(len(records))), records[k])
        elif how < 0.25:
            records[k] = int(rng.integers(16)), body
        elif opcode in (3, 9, 12) and how < 0.8:  # schema, attachment, metadata
            records[k] = opcode, _resized(rng, opcode, body)
        elif opcode == 5 and how < 0.7:  # the same change to every message of that channel
            change = rng.integers(2**32)
            for i, (other, message) in enumerate(records):
                if other == 5 and message[:2] == body[:2]:
                    records[i] = 5, message[:22] + some_bytes(np.random.default_rng(change), message[22:])
        else:
            records[k] = opcode, some_bytes(rng, body)
    return records


def _resized(rng: Rng, opcode: int, body: bytes) -> bytes:
    """A schema or metadata with another text and the right lengths."""
    try:
        if opcode == 3:
            number, rest = body[:2], body[2:]
            parts = []
            for _ in range(3):
                (n,) = struct.unpack_from("<I", rest)
                parts.append(rest[4 : 4 + n])
                rest = rest[4 + n :]
            parts[2] = text(rng, parts[2]) if rng.random() < 0.8 else parts[2]
            parts[0] = text(rng, parts[0]) if rng.random() < 0.2 else parts[0]
            return number + b"".join(struct.pack("<I", len(p)) + p for p in parts)
        if opcode == 12:
            (n,) = struct.unpack_from("<I", body)
            name, rest = body[4 : 4 + n], body[8 + n :]
            pairs = []
            while rest:
                (n,) = struct.unpack_from("<I", rest)
                pairs.append(rest[4 : 4 + n])
                rest = rest[4 + n :]
            if pairs:
                pairs[int(rng.integers(len(pairs)))] = str(pick(rng, _WORDS + _NUMBERS)).encode()
            inner = b"".join(struct.pack("<I", len(p)) + p for p in pairs)
            return struct.pack("<I", len(name)) + name + struct.pack("<I", len(inner)) + inner
        log, create, n = struct.unpack_from("<QQI", body)
        name = body[20 : 20 + n]
        (m,) = struct.unpack_from("<I", body, 20 + n)
        media = body[24 + n : 24 + n + m]
        (size,) = struct.unpack_from("<Q", body, 24 + n + m)
        data = body[32 + n + m : 32 + n + m + size]
        data = toml(rng, data) if name.endswith(b".toml") else text(rng, data)
        head = struct.pack("<QQI", log, create, n) + name + struct.pack("<I", m) + media + struct.pack("<Q", len(data))
        return head + data + struct.pack("<I", zlib.crc32(head + data))
    except (struct.error, UnicodeError):
        return some_bytes(rng, body)


def mcap(rng: Rng, data: bytes) -> bytes:
    """A log: records inside of chunks or outside, with checksums mended, or bytes with the summary's mended."""
    if rng.random() < 0.1:
        return some_bytes(rng, data)
    top = _records(data[8:-8])
    if rng.random() < 0.25:  # the summary
        end = next((k for k, (opcode, _) in enumerate(top) if opcode == 15), 0) + 1
        summary = _joined(_changed(rng, top[end:-1]))
        start = len(MAGIC) + len(_joined(top[:end]))
        footer = struct.pack("<BQQQ", 2, 20, start if summary else 0, 0)
        return MAGIC + _joined(top[:end]) + summary + footer + struct.pack("<I", zlib.crc32(summary + footer)) + MAGIC
    kept = [(opcode, body) for opcode, body in top if opcode in (1, 3, 4, 6, 9, 12)]
    chunks = [k for k, (opcode, _) in enumerate(kept) if opcode == 6]
    if chunks and rng.random() < 0.8:
        k = pick(rng, chunks) if rng.random() < 0.5 else chunks[0]
        kept[k] = 6, _chunk(rng, kept[k][1])
    else:
        kept = kept[:1] + _changed(rng, kept[1:])
    whole = MAGIC + _joined(kept)
    return whole + _joined([(15, bytes(4)), (2, bytes(20))]) + MAGIC


def _chunk(rng: Rng, body: bytes) -> bytes:
    start, end, size, _, n = struct.unpack_from("<QQQII", body)
    content = zstandard.ZstdDecompressor().decompress(body[32 + n + 8 :], max_output_size=size) if n else body[40:]
    content = _joined(_changed(rng, _records(content)))
    squeezed = zstandard.ZstdCompressor(1).compress(content)
    head = struct.pack("<QQQII", start, end, len(content), zlib.crc32(content), 4) + b"zstd"
    return head + struct.pack("<Q", len(squeezed)) + squeezed


def ulog(rng: Rng, data: bytes) -> bytes:
    """A ULog: messages behind the head of 16 bytes, with their lengths mended."""
    if rng.random() < 0.15:
        return some_bytes(rng, data)
    messages, at = [], 16
    while at + 3 <= len(data):
        size, kind = struct.unpack_from("<HB", data, at)
        messages.append((kind, data[at + 3 : at + 3 + size]))
        at += 3 + size
    for _ in range(int(rng.integers(1, 5))):
        rare = [k for k, (kind, _) in enumerate(messages) if kind != ord("D")]
        k = pick(rng, rare) if rare and rng.random() < 0.7 else int(rng.integers(len(messages)))
        kind, body = messages[k]
        how = rng.random()
        if how < 0.15:
            del messages[k]
        elif how < 0.3:
            messages.insert(int(rng.integers(len(messages))), messages[k])
        elif kind == ord("F"):
            messages[k] = kind, text(rng, body.replace(b";", b"\n")).replace(b"\n", b";")
        else:
            messages[k] = kind, some_bytes(rng, body)
    return data[:16] + b"".join(struct.pack("<HB", len(b) & 0xFFFF, k) + b for k, b in messages)


def dataflash(rng: Rng, data: bytes) -> bytes:
    """A DataFlash log: the formats at its beginning, else any bytes."""
    if rng.random() < 0.5:
        at = 89 * int(rng.integers(1, 20))
        return data[:at] + some_bytes(rng, data[at : at + 89]) + data[at + 89 :]
    return some_bytes(rng, data)


def db3(rng: Rng, data: bytes) -> bytes:
    """A database: values of its tables, seldom its pages."""
    if rng.random() < 0.2:
        return some_bytes(rng, data)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        path.write_bytes(data)
        base = sqlite3.connect(path)
        try:
            table = pick(rng, ["messages", "topics", "messages", "message_definitions", "schema"])
            columns = [row[1] for row in base.execute(f"pragma table_info({table})")]
            rows = base.execute(f"select rowid, * from {table}").fetchall()
            for _ in range(int(rng.integers(1, 30))):
                if not rows or not columns:
                    break
                row, column = pick(rng, rows), int(rng.integers(len(columns)))
                value = row[1 + column]
                if isinstance(value, bytes) and rng.random() < 0.8:
                    value = some_bytes(rng, value)
                elif isinstance(value, str) and rng.random() < 0.7:
                    value = text(rng, value.encode()).decode(errors="replace")
                else:
                    value = pick(rng, [*_WORDS, 0, -1, 2**62, 1.5, None, b""])
                base.execute(f"update {table} set {columns[column]} = ? where rowid = ?", (value, row[0]))
            base.commit()
        except sqlite3.Error:
            return some_bytes(rng, data)
        finally:
            base.close()
        return path.read_bytes()


MUTATORS: dict[str, Callable[[Rng, bytes], bytes]] = {
    "mcap": mcap,
    "toml": toml,
    "json": json_,
    "csv": csv,
    "ulog": ulog,
    "dataflash": dataflash,
    "db3": db3,
}
