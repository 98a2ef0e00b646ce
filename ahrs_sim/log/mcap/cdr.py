"""ROS 2 message definitions and their binary form (CDR), whole columns at a time.

A definition is the text of a `.msg` file with those of its dependencies behind it, as an MCAP log carries it. From it
follow

    parse_definitions   the fields of a message
    encode              one message as bytes, with the place of each number: a template for thousands like it
    decode              many messages at once into one structured NumPy array

Nearly all messages of a channel differ in their numbers only: with the same strings and array lengths, every number
has the same place. `decode` reads each field of all of them with one strided copy, and groups messages whose lengths
differ.

Plain CDR as every ROS 2 middleware writes it: 4 bytes of header, then each value aligned to its own size (at most 8),
counted from behind the header; strings as length with NUL, NUL-terminated; sequences as length, then elements.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

HEADER = b"\x00\x01\x00\x00"
"""Little-endian plain CDR."""

PRIMITIVES = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
TIMES = ("builtin_interfaces/Time", "builtin_interfaces/Duration")
VECTORS = ("geometry_msgs/Vector3", "geometry_msgs/Point")
QUATERNION = "geometry_msgs/Quaternion"

# Types that definitions may name without carrying them along.
_KNOWN = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
}
_ABBREVIATED = {"time": TIMES[0], "duration": TIMES[1], "Header": "std_msgs/Header"}
_LEAVES = 100_000
_DEPTH = 32
_FIXED = 1 << 20


class CdrError(ValueError):
    """A definition that cannot be parsed, or bytes that contradict their definition."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message; `count` is None for one value, n for an array, -1 for a sequence of any length."""

    name: str
    type: str
    count: int | None


Definitions = dict[str, tuple[Field, ...]]
"""Fields by message type, `package/Type`."""


# ----------------------------------------------------------------------------------------------- definitions


def short_name(name: str) -> str:
    """Shorten `package/msg/Type` to `package/Type`."""
    return name.replace("/msg/", "/")


def parse_definitions(name: str, text: str) -> Definitions:
    """Parse the definitions in a `ros2msg` schema: that of `name` and of all it needs.

    Raises:
        CdrError: a line, a type or a dependency is unknown.
    """
    definitions: Definitions = {}
    current = short_name(name)
    lines: list[str] = []
    for line in [*text.splitlines(), "MSG: "]:
        if line.startswith("MSG: "):
            definitions.setdefault(current, _fields(current, lines))
            current, lines = short_name(line[5:].strip()), []
        elif not line.startswith("====="):
            lines.append(line)
    needed = {short_name(name): None}
    waiting = [short_name(name)]
    for used in waiting:
        if used not in definitions:
            if used not in _KNOWN:
                raise CdrError(f"{name}: the definition of {used} is missing")
            definitions[used] = _fields(used, _KNOWN[used].splitlines())
        inner = dict.fromkeys(f.type for f in definitions[used] if f.type not in PRIMITIVES and f.type != "string")
        waiting += [kind for kind in inner if kind not in needed]
        needed |= inner
    definitions = {used: definitions[used] for used in needed}
    if _leaves(definitions, short_name(name), {}) > _LEAVES:
        raise CdrError(f"{name}: more than {_LEAVES} fields")
    if _least_size(definitions, short_name(name)) > _FIXED:
        raise CdrError(f"{name}: more than {_FIXED} bytes of fixed arrays")
    return definitions


def _fields(owner: str, lines: Sequence[str]) -> tuple[Field, ...]:
    fields = []
    for line in lines:
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) == 1:
            raise CdrError(f"{owner}: line '{line.strip()[:60]}' is not understood")
        kind, name = words[:2]
        if "=" in name or (len(words) > 2 and words[2].startswith("=")):
            continue  # a constant
        base, bracket, size = kind.partition("[")
        count: int | None = None
        if bracket:
            size = size.rstrip("]")
            try:
                count = -1 if not size or size.startswith("<=") else int(size)
                if count < 0 < len(size) and not size.startswith("<="):
                    raise ValueError
            except ValueError:
                raise CdrError(f"{owner}.{name}: array size '{size[:20]}' is not understood") from None
        base = base.partition("<=")[0]
        if base not in PRIMITIVES and base != "string":
            if base == "wstring" or not base.replace("/", "").replace("_", "").isalnum():
                raise CdrError(f"{owner}.{name}: type '{base[:60]}' is not supported")
            base = _ABBREVIATED.get(base, short_name(base))
            if "/" not in base:
                base = f"{owner.partition('/')[0]}/{base}"
        fields.append(Field(name, base, count))
    # A structure may not be empty in CDR; ROS puts this byte there.
    return tuple(fields) or (Field("structure_needs_at_least_one_member", "uint8", None),)


def _leaves(definitions: Definitions, name: str, seen: dict[str, int], depth: int = 0) -> int:
    """List values and arrays in a message, at any depth; refuse circles."""
    if depth > _DEPTH:
        raise CdrError(f"{name}: types within types, more than {_DEPTH} levels deep")
    if name not in seen:
        seen[name] = _LEAVES + 1  # until it is known: whoever meets it meanwhile is inside it
        total = 0
        for field in definitions[name]:
            one = _leaves(definitions, field.type, seen, depth + 1) if field.type in definitions else 1
            repeated = max(field.count or 1, 1) if field.type not in PRIMITIVES else 1
            total += one * repeated
        seen[name] = total
    return seen[name]


def message_dtype(definitions: Definitions, name: str) -> np.dtype[Any]:
    """Make the NumPy type that `decode` returns for a message type: nested like the message, whatever the bytes.

    Numbers and fixed arrays of them keep their types; strings become `str` objects, sequences objects that hold one
    array a message.
    """
    columns: list[tuple[Any, ...]] = []
    for field in definitions[short_name(name)]:
        kind: Any = PRIMITIVES.get(field.type, object)
        if field.type in definitions:
            kind = message_dtype(definitions, field.type)
        if field.count == -1:
            columns.append((field.name, object))
        elif field.count is None:
            columns.append((field.name, kind))
        else:
            columns.append((field.name, kind, (field.count,)))
    try:
        return np.dtype(columns)
    except (ValueError, TypeError) as error:
        raise CdrError(f"{name}: {error}") from None


def _least_size(definitions: Definitions, name: str) -> int:
    """Count the bytes that a message needs at least, alignment not counted."""
    size = 0
    for field in definitions[name]:
        if field.count == -1 or field.type == "string":
            one = 4
        elif field.type in definitions:
            one = _least_size(definitions, field.type)
        else:
            one = np.dtype(PRIMITIVES[field.type]).itemsize
        size += one * (field.count if field.count is not None and field.count >= 0 else 1)
    return size


# ----------------------------------------------------------------------------------------------- encoding


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a number, or of an array of them, in an encoded message."""

    offset: int  # bytes from the start of the payload, header included
    dtype: str
    shape: tuple[int, ...]
    kind: str = (
        "plain"  # "quaternion": given scalar first, stored scalar last; "time": given in ns, stored as sec, nanosec
    )

    def set(self, rows: np.ndarray, values: Any, start: int = 0) -> None:
        """Put `values`, one row per message or one for all, into messages.

        Args:
            rows: (n, size) uint8, C-contiguous.
            values: (n, ...) or one value for all.
            start: bytes in a row before its payload.

        Raises:
            ValueError: the shape of `values` does not fit.
        """
        n = len(rows)
        values = np.asarray(values)
        if self.kind == "time":
            self._view(rows, start, "<i4", ())[...] = values // 1_000_000_000
            self._view(rows, start + 4, "<u4", ())[...] = values % 1_000_000_000
            return
        if values.shape[:1] == (n,) and values.size == n * math.prod(self.shape):
            values = values.reshape(n, *self.shape)
        elif values.size == math.prod(self.shape):
            values = values.reshape(self.shape)
        elif values.size != 1:
            raise ValueError(f"shape {values.shape} does not fit {n} messages of shape {self.shape}")
        view = self._view(rows, start, self.dtype, self.shape)
        if self.kind == "quaternion":
            view[:, :3], view[:, 3] = values[..., 1:], values[..., 0]
        else:
            view[...] = values

    def _view(self, rows: np.ndarray, shift: int, dtype: str, shape: tuple[int, ...]) -> np.ndarray:
        kind = np.dtype(dtype)
        inner = tuple(kind.itemsize for _ in shape)  # shapes are () or (k,)
        return np.ndarray((len(rows), *shape), kind, rows, self.offset + shift, (rows.strides[0], *inner))


class _Encoder:
    def __init__(self, definitions: Definitions) -> None:
        self.definitions = definitions
        self.out = bytearray()
        self.places: dict[str, Place] = {}

    def reserve(self, dtype: str, path: str, shape: tuple[int, ...], kind: str = "plain") -> Place:
        item = np.dtype(dtype)
        self.out += bytes(-len(self.out) % item.itemsize)
        place = Place(len(HEADER) + len(self.out), "<" + dtype, shape, kind)
        self.out += bytes(item.itemsize * math.prod(shape))
        self.places[path] = place
        return place

    def length(self, n: int) -> None:
        self.out += bytes(-len(self.out) % 4) + n.to_bytes(4, "little")

    def message(self, name: str, value: Mapping[str, Any], path: str) -> None:
        unknown = set(value) - {f.name for f in self.definitions[name]}
        if unknown:
            raise ValueError(f"{name} has no field {', '.join(sorted(unknown))}")
        for field in self.definitions[name]:
            given = value.get(field.name)
            inner = f"{path}.{field.name}" if path else field.name
            if field.count is None:
                self.one(field.type, given, inner)
                continue
            n = field.count
            if n == -1:
                n = 0 if given is None else len(given)
                self.length(n)
            if field.type in PRIMITIVES:
                if n:
                    self.fill(self.reserve(PRIMITIVES[field.type], inner, (n,)), given)
                continue
            for i in range(n):
                self.one(field.type, None if given is None else given[i], f"{inner}.{i}")

    def one(self, kind: str, given: Any, path: str) -> None:
        if kind in PRIMITIVES:
            self.fill(self.reserve(PRIMITIVES[kind], path, ()), given)
        elif kind == "string":
            text = (given or "").encode() + b"\0"
            self.length(len(text))
            self.out += text
        elif kind in TIMES:
            self.out += bytes(-len(self.out) % 4)
            self.fill(self.reserve("u4", path, (2,), "time"), given)
        elif kind in VECTORS or kind == QUATERNION:
            shape, form = ((4,), "quaternion") if kind == QUATERNION else ((3,), "plain")
            place = self.reserve("f8", path, shape, form)
            for i, axis in enumerate("xyzw"[: shape[0]]):
                self.places[f"{path}.{axis}"] = Place(place.offset + 8 * i, place.dtype, ())
            self.fill(place, given)
        else:
            self.message(kind, given or {}, path)

    def fill(self, place: Place, given: Any) -> None:
        if given is not None:
            payload = np.frombuffer(self.out, np.uint8)[np.newaxis]
            Place(place.offset - len(HEADER), place.dtype, place.shape, place.kind).set(payload, given)


def encode(definitions: Definitions, name: str, value: Mapping[str, Any]) -> tuple[bytes, dict[str, Place]]:
    """Encode one message as CDR; also return the place of every number in it.

    Args:
        definitions: from `parse_definitions`.
        name: type of the message.
        value: fields as nested mappings; what is missing is zero or empty. A vector is given as (3,), a quaternion as
            (4,) scalar first, a time as int ns.

    Returns:
        The bytes, and places by dotted path (`twist.twist.linear`, `transforms.0.transform.rotation`).

    Raises:
        ValueError: an unknown field, or a value whose shape does not fit.
    """
    encoder = _Encoder(definitions)
    encoder.message(short_name(name), value, "")
    return HEADER + bytes(encoder.out), encoder.places


# ----------------------------------------------------------------------------------------------- decoding


class _Varies(Exception):
    """Messages differ in the length stored at `offset`."""

    def __init__(self, offset: int) -> None:
        self.offset = offset


class _Decoder:
    """Walks the definition once for all rows; `at` is the offset behind the CDR header, the same in every row."""

    def __init__(self, definitions: Definitions, rows: np.ndarray, order: str) -> None:
        self.definitions = definitions
        self.rows = rows
        self.order = order
        self.at = 0
        self.size = rows.shape[1] - len(HEADER)

    def take(self, kind: str, shape: tuple[int, ...]) -> np.ndarray:
        dtype = np.dtype(self.order + kind)
        start = self.at + (-self.at % dtype.itemsize)
        count = shape[0] if shape else 1
        self.at = start + dtype.itemsize * count
        if self.at > self.size:
            raise CdrError("a message ends too early")
        strides = (self.rows.strides[0], *(dtype.itemsize for _ in shape))
        return np.ndarray((len(self.rows), *shape), dtype, self.rows, len(HEADER) + start, strides)

    def length(self) -> int:
        counts = self.take("u4", ())
        n = int(counts[0])
        if (counts != n).any():
            raise _Varies(self.at - 4)
        if n > self.size - self.at:
            raise CdrError("a length points behind the end of its message")
        return n

    def message(self, name: str, out: np.ndarray) -> None:
        for field in self.definitions[name]:
            column = out[field.name]
            if field.count is None:
                self.one(field.type, column)
            elif field.count >= 0:
                self.many(field.type, field.count, column)
            else:
                n = self.length()
                dtype: Any = PRIMITIVES.get(field.type, object)
                if field.type in self.definitions:
                    least = _least_size(self.definitions, field.type)
                    if n * least > self.size - self.at:
                        raise CdrError("a length points behind the end of its message")
                    dtype = message_dtype(self.definitions, field.type)
                if field.type not in PRIMITIVES and n > _LEAVES:
                    raise CdrError(f"a sequence of more than {_LEAVES} elements in a message")
                elements = np.empty((len(out), n), dtype)
                self.many(field.type, n, elements)
                for i in range(len(out)):
                    column[i] = elements[i]

    def many(self, kind: str, n: int, column: np.ndarray) -> None:
        if kind in PRIMITIVES:
            if n:
                self.plain(kind, (n,), column)
        else:
            for i in range(n):
                self.one(kind, column[:, i])

    def one(self, kind: str, column: np.ndarray) -> None:
        if kind in PRIMITIVES:
            self.plain(kind, (), column)
        elif kind == "string":
            self.string(column)
        else:
            self.message(kind, column)

    def plain(self, kind: str, shape: tuple[int, ...], column: np.ndarray) -> None:
        if kind == "bool":
            column[...] = self.take("u1", shape) != 0
        else:
            column[...] = self.take(PRIMITIVES[kind], shape)

    def string(self, column: np.ndarray) -> None:
        n = self.length()
        start = len(HEADER) + self.at
        text = self.rows[:, start : start + max(n - 1, 0)]
        self.at += n
        if not len(text) or (text == text[0]).all():
            # One object for all, and for all arrays that are read: comparing them stays cheap.
            column[...] = sys.intern(bytes(text[0]).decode(errors="replace")) if len(text) else ""
            return
        for i, row in enumerate(text):
            column[i] = bytes(row).decode(errors="replace")


def decode(definitions: Definitions, name: str, rows: np.ndarray, out: np.ndarray) -> None:
    """Decode many messages of the same size.

    Args:
        definitions: from `parse_definitions`.
        name: type of the messages.
        rows: (n, size) uint8, C-contiguous, one payload a row, CDR header included.
        out: (n,) structured array with at least the fields of `message_dtype`; filled in place.

    Raises:
        CdrError: the bytes do not follow the definition.
    """
    if not len(rows):
        return
    name = short_name(name)
    if rows.shape[1] - len(HEADER) < _least_size(definitions, name):
        raise CdrError("a message ends too early")
    endian = rows[:, 1]
    if rows[:, 0].any() or (endian > 1).any():
        raise CdrError(f"CDR representation {rows[0, :2].tolist()} is not supported")
    todo = [(np.flatnonzero(endian == e), "<" if e else ">") for e in np.unique(endian)]
    while todo:
        chosen, order = todo.pop()
        every = len(chosen) == len(rows)
        part = out if every else np.empty(len(chosen), out.dtype)
        decoder = _Decoder(definitions, rows if every else rows[chosen], order)
        try:
            decoder.message(name, part)
        except _Varies as varies:
            decoder.at = varies.offset
            values = decoder.take("u4", ())
            todo += [(chosen[values == value], order) for value in np.unique(values)]
            continue
        if not every:
            for field in definitions[name]:
                out[field.name][chosen] = part[field.name]
