"""Message definitions and their bytes, against rosbags."""

import itertools
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ahrs_sim.log import messages
from ahrs_sim.log.mcap.cdr import CdrError, decode, encode, message_dtype, parse_definitions

STANDARD = [name for name in messages.type_names() if not name.startswith("ahrs_sim_msgs")]


def typestore(name: str, text: str) -> Any:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, name))
    return store


def some_value(definitions: Any, name: str, count: itertools.count) -> dict[str, Any]:
    """A message in which every number differs, with two elements in a sequence."""
    value: dict[str, Any] = {}
    for field in definitions[name]:
        n = 2 if field.count == -1 else field.count
        if field.type == "string":
            one = lambda: "abcdefghi"[: next(count) % 9]  # noqa: E731
        elif field.type == "bool":
            one = lambda: next(count) % 2 == 0  # noqa: E731
        elif field.type in definitions:
            one = lambda t=field.type: some_value(definitions, t, count)  # noqa: E731
        else:
            one = lambda: next(count) % 100  # noqa: E731
        value[field.name] = one() if n is None else [one() for _ in range(n)]
    # Our own notation for these three.
    if name == "geometry_msgs/Quaternion":
        return [value[k] for k in "wxyz"]  # type: ignore[return-value]
    if name in ("geometry_msgs/Vector3", "geometry_msgs/Point"):
        return [value[k] for k in "xyz"]  # type: ignore[return-value]
    if name == "builtin_interfaces/Time":
        return value["sec"] * 10**9 + value["nanosec"]  # type: ignore[return-value]
    return value


def as_rosbags(store: Any, name: str, value: Any) -> Any:
    """The same value as rosbags' object."""
    kind = store.types[name]
    if name.endswith("/Quaternion"):
        value = dict(zip("wxyz", value, strict=True))
    elif name.endswith(("/Vector3", "/Point")):
        value = dict(zip("xyz", value, strict=True))
    elif name.endswith("/Time"):
        value = {"sec": value // 10**9, "nanosec": value % 10**9}
    arguments = {}
    for field, (tag, detail) in store.fielddefs[name][1]:
        given = value[field]
        tag = int(tag)
        if tag == 1:
            arguments[field] = given
        elif tag == 2:
            arguments[field] = as_rosbags(store, detail, given)
        else:
            (inner, inner_name), _ = detail
            if int(inner) == 2:
                arguments[field] = [as_rosbags(store, inner_name, g) for g in given]
            elif inner_name[0] == "string":
                arguments[field] = given
            else:
                arguments[field] = np.array(given, dtype=np.dtype(inner_name[0]))
    return kind(**arguments)


@pytest.mark.parametrize("name", messages.type_names())
def test_bytes_are_those_of_rosbags(name: str) -> None:
    definitions = messages.definitions(name)
    store = typestore(name, messages.schema_text(name))
    for first in range(9):  # other lengths of strings, so other alignments
        value = some_value(definitions, name.replace("/msg/", "/"), itertools.count(first))
        if not isinstance(value, dict):
            return  # vectors and quaternions appear inside of others
        ours, _ = encode(definitions, name, value)
        assert ours == bytes(store.serialize_cdr(as_rosbags(store, name, value), name))


@pytest.mark.parametrize("name", STANDARD)
def test_standard_types_are_as_ros_has_them(name: str) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    ours = [(f.name, f.type) for f in messages.definitions(name)[name.replace("/msg/", "/")]]
    theirs = [f for f, _ in store.fielddefs[name][1]]
    assert [f for f, _ in ours] == theirs
    own = typestore(name, messages.schema_text(name))
    assert own.fielddefs[name][1] == store.fielddefs[name][1]


def test_schema_text_carries_all_dependencies() -> None:
    text = messages.schema_text("nav_msgs/msg/Odometry")
    parts = text.split("=" * 80 + "\n")
    assert parts[0] == messages.definition("nav_msgs/msg/Odometry")
    assert all(part.startswith("MSG: ") for part in parts[1:])
    assert parse_definitions("nav_msgs/msg/Odometry", text) == messages.definitions("nav_msgs/msg/Odometry")


TEXT = """
# a comment
uint8 A=1
string B = "a # b"
bool[<=3] flags   # bounded
string<=10[2] names
Inner[] inners
float32 x 1.5
wide/Pair[2] pairs
Nothing nothing
int16[] shorts
================================================================================
MSG: my/Inner
string text
float64 value
time when
================================================================================
MSG: wide/Pair
int8 a
uint64 b
================================================================================
MSG: my/Nothing
"""


def test_general_messages_both_ways() -> None:
    """Strings and sequences of every kind, in messages that differ in every length."""
    definitions = parse_definitions("my/msg/Top", TEXT)
    values: list[dict[str, Any]] = [
        {
            "flags": [True, False][:k],
            "names": ["a" * k, ""],
            "inners": [{"text": "é" * j, "value": j + 0.5, "when": 10**9 * j + 7} for j in range(k)],
            "x": 0.25 * k,
            "pairs": [{"a": -k, "b": 2**63 + k}, {}],
            "shorts": list(range(k * 2)),
        }
        for k in (0, 1, 2, 1, 0, 2)
    ]
    for value in values:
        payload, _ = encode(definitions, "my/msg/Top", value)
        rows = np.frombuffer(payload, np.uint8)[np.newaxis]
        out = np.empty(1, message_dtype(definitions, "my/msg/Top"))
        decode(definitions, "my/msg/Top", rows, out)
        row = out[0]
        assert row["flags"].tolist() == value["flags"]
        assert row["names"].tolist() == value["names"]
        assert [r["text"] for r in row["inners"]] == [i["text"] for i in value["inners"]]
        assert [int(r["when"]["sec"]) for r in row["inners"]] == [i["when"] // 10**9 for i in value["inners"]]
        assert row["x"] == value["x"]
        assert row["pairs"]["b"].tolist() == [value["pairs"][0]["b"], 0]
        assert row["shorts"].tolist() == value["shorts"]


def test_rows_of_equal_size_may_differ_in_lengths() -> None:
    definitions = parse_definitions("my/Two", "string a\nstring b\nfloat64 x")
    values = [("ab", "c", 1.0), ("a", "bc", 2.0), ("ab", "d", 3.0), ("", "abc", 4.0)]
    payloads = [encode(definitions, "my/Two", dict(zip("abx", v, strict=True)))[0] for v in values]
    size = len(payloads[0])
    assert {len(p) for p in payloads} == {size}
    out = np.empty(4, message_dtype(definitions, "my/Two"))
    decode(definitions, "my/Two", np.frombuffer(b"".join(payloads), np.uint8).reshape(4, size), out)
    assert [tuple(row) for row in out] == values


def test_big_endian() -> None:
    definitions = parse_definitions("my/T", "uint16 a\nstring s\nfloat64 x")
    payload = b"\0\0\0\0" + b"\1\2\0\0" + b"\0\0\0\3hi\0" + b"\0" * 5 + np.array(1.5, ">f8").tobytes()
    out = np.empty(1, message_dtype(definitions, "my/T"))
    decode(definitions, "my/T", np.frombuffer(payload, np.uint8)[np.newaxis], out)
    assert tuple(out[0]) == (258, "hi", 1.5)


@pytest.mark.parametrize(
    "text",
    [
        "float64",
        "my/Gone x",
        "wstring x",
        "float64[x] y",
        "Self x\n====\nMSG: my/Self\nSelf x",
        "\n".join(
            [
                "Self1[1000] x",
                *(f"====\nMSG: my/Self{i}\nSelf{i + 1}[1000] x" for i in range(1, 9)),
                "====\nMSG: my/Self9\nint8 x",
            ]
        ),
    ],
)
def test_bad_definitions_are_refused(text: str) -> None:
    with pytest.raises(CdrError):
        parse_definitions("my/T", text)


def test_bad_bytes_are_refused() -> None:
    definitions = parse_definitions("my/T", "string s\nfloat64[] x")
    payload, _ = encode(definitions, "my/T", {"s": "abc", "x": [1.0, 2.0]})
    for cut in range(len(payload)):
        with pytest.raises(CdrError):
            decode(
                definitions,
                "my/T",
                np.frombuffer(payload[:cut], np.uint8)[np.newaxis],
                np.empty(1, message_dtype(definitions, "my/T")),
            )
    for at, header in ((1, 2), (0, 1), (1, 7)):
        wrong = bytearray(payload)
        wrong[at] = header
        with pytest.raises(CdrError, match="representation"):
            decode(
                definitions,
                "my/T",
                np.frombuffer(wrong, np.uint8)[np.newaxis],
                np.empty(1, message_dtype(definitions, "my/T")),
            )


def test_encode_names_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="no field linear_accel"):
        encode(messages.definitions("sensor_msgs/msg/Imu"), "sensor_msgs/msg/Imu", {"linear_accel": 1})
