"""Recordings in the encodings of others: JSON, protobuf, ROS 1."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_helpers import LLA, Motion, ns
from mcap.writer import Writer

FLU = np.diag([1.0, -1.0, -1.0])


def vector(v: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", v.tolist(), strict=True))


def write_json(path: Path, m: Motion) -> None:
    """Standard messages in JSON as bridges write them, the fix as Foxglove's own type."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="")
        schema = {
            n: writer.register_schema(n, "jsonschema", b"{}") for n in ("sensor_msgs/Imu", "foxglove.LocationFix")
        }
        imu = writer.register_channel("/imu", "json", schema["sensor_msgs/Imu"])
        fix = writer.register_channel("/fix", "json", schema["foxglove.LocationFix"])
        log = writer.register_channel("/log", "json", writer.register_schema("foxglove.Log", "jsonschema", b"{}"))
        for i, t in enumerate(ns(m.t).tolist()):
            stamp = {"sec": t // 10**9, "nsec": t % 10**9}
            body = {"header": {"stamp": stamp, "frame_id": "imu_link"}, "angular_velocity": vector(FLU @ m.gyro_b[i]),
                    "linear_acceleration": vector(FLU @ m.accel_b[i])}  # fmt: skip
            writer.add_message(imu, t, json.dumps(body).encode(), t)
            if i % 20 == 0:
                body = {
                    "timestamp": stamp,
                    "frame_id": "gps",
                    "latitude": LLA[0],
                    "longitude": LLA[1],
                    "altitude": LLA[2],
                }
                writer.add_message(fix, t, json.dumps(body).encode(), t)
                writer.add_message(log, t, b"{}", t)
        writer.finish()


def write_protobuf(path: Path, m: Motion) -> None:
    pytest.importorskip("google.protobuf")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="all.proto", package="sensor_msgs", syntax="proto3")
    kinds = descriptor_pb2.FieldDescriptorProto

    def message(name: str, *fields: tuple[str, str]) -> None:
        made = file.message_type.add(name=name)
        for i, (field, kind) in enumerate(fields, 1):
            number = {"double": kinds.TYPE_DOUBLE, "string": kinds.TYPE_STRING, "int64": kinds.TYPE_INT64}.get(kind)
            more = {"type": number} if number else {"type": kinds.TYPE_MESSAGE, "type_name": f".sensor_msgs.{kind}"}
            made.field.add(name=field, number=i, label=kinds.LABEL_OPTIONAL, **more)

    message("Vector3", *((a, "double") for a in "xyz"))
    message("Time", ("seconds", "int64"), ("nanos", "int64"))
    message("Imu", ("timestamp", "Time"), ("frame_id", "string"), ("angular_velocity", "Vector3"),
            ("linear_acceleration", "Vector3"))  # fmt: skip
    message("NavSatFix", ("timestamp", "Time"), ("latitude", "double"), ("longitude", "double"), ("altitude", "double"))
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    classes = {n: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"sensor_msgs.{n}"))
               for n in ("Imu", "NavSatFix", "Vector3", "Time")}  # fmt: skip
    data = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        imu, fix = (
            writer.register_channel(t, "protobuf", writer.register_schema(f"sensor_msgs.{n}", "protobuf", data))
            for t, n in (("/imu", "Imu"), ("/fix", "NavSatFix"))
        )
        for i, t in enumerate(ns(m.t).tolist()):
            time = classes["Time"](seconds=t // 10**9, nanos=t % 10**9)
            turn, force = (classes["Vector3"](**vector(FLU @ v)) for v in (m.gyro_b[i], m.accel_b[i]))
            body = classes["Imu"](timestamp=time, frame_id="imu", angular_velocity=turn, linear_acceleration=force)
            writer.add_message(imu, t, body.SerializeToString(), t)
            if i % 20 == 0:
                body = classes["NavSatFix"](timestamp=time, latitude=LLA[0], longitude=LLA[1], altitude=LLA[2])
                writer.add_message(fix, t, body.SerializeToString(), t)
        writer.finish()


def ros1(m: Motion) -> list[tuple[str, str, int, bytes]]:
    """Topic, type, time and content of each message."""
    types = pytest.importorskip("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS1_NOETIC)
    T = store.types
    out = []
    for i, t in enumerate(ns(m.t).tolist()):
        stamp = T["builtin_interfaces/msg/Time"](sec=t // 10**9, nanosec=t % 10**9)
        head = T["std_msgs/msg/Header"](seq=i, stamp=stamp, frame_id="imu_link")
        turn, force = (T["geometry_msgs/msg/Vector3"](**vector(FLU @ v)) for v in (m.gyro_b[i], m.accel_b[i]))
        none = np.zeros(9)
        q = T["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=0.0)
        imu = T["sensor_msgs/msg/Imu"](head, q, np.r_[-1.0, np.zeros(8)], turn, none, force, none)
        out.append(("/imu", "sensor_msgs/msg/Imu", t, bytes(store.serialize_ros1(imu, "sensor_msgs/msg/Imu"))))
        if i % 20 == 0:
            status = T["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
            fix = T["sensor_msgs/msg/NavSatFix"](head, status, *LLA, none, 0)
            body = bytes(store.serialize_ros1(fix, "sensor_msgs/msg/NavSatFix"))
            out.append(("/fix", "sensor_msgs/msg/NavSatFix", t, body))
    return out


def write_ros1_mcap(path: Path, m: Motion) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros1")
        channels: dict[str, int] = {}
        for topic, kind, t, body in ros1(m):
            if topic not in channels:
                schema = writer.register_schema(kind.replace("/msg/", "/"), "ros1msg", b"")
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            writer.add_message(channels[topic], t, body, t)
        writer.finish()


def write_ros1_bag(path: Path, m: Motion) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    types = pytest.importorskip("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS1_NOETIC)
    with rosbag1.Writer(path) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, t, body in ros1(m):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], t, body)
