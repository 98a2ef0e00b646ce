"""Logs as files: exact, reproducible, readable by others, recoverable; damaged and foreign ones."""

import os
import random
import resource
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import lz4.frame
import mcap.writer
import numpy as np
import pytest
from log_helpers import EPOCH, ESTIMATORS, SHARED, SUITES, MadeUpFlight, same
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from ahrs_sim.cli import main
from ahrs_sim.errors import InputError, LogError
from ahrs_sim.log import info, messages
from ahrs_sim.log.flight_log import HOLD_S
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.cdr import encode
from ahrs_sim.log.mcap.container import Container
from ahrs_sim.log.mcap.reader import LogReader, stamps, vector
from ahrs_sim.log.mcap.recover import recover
from ahrs_sim.log.mcap.writer import LogWriter


@pytest.fixture(scope="module")
def flight() -> MadeUpFlight:
    return MadeUpFlight()


@pytest.fixture(scope="module")
def log(flight: MadeUpFlight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "flight.mcap"
    flight.write(path)
    return path


def simple(path: Path, n: int = 10, **settings: Any) -> None:
    """A log of one pressure channel."""
    with LogWriter(path, epoch_ns=EPOCH, **settings) as writer:
        channel = writer.add_channel("/p", "sensor_msgs/msg/FluidPressure", frame_id="f")
        writer.start()
        t = EPOCH + np.arange(n) * 100_000_000
        writer.write(channel, t, t, fluid_pressure=np.arange(n))


# ---------------------------------------------------------------------------------------------- ours


def test_everything_comes_back(flight: MadeUpFlight, log: Path) -> None:
    with FlightReader(log) as back:
        assert back.suites == SUITES
        assert back.estimators == ESTIMATORS
        assert back.epoch_ns == EPOCH
        assert back.metadata["flight"] == {"seed": "1"}
        assert back.attachment("trainer.xml") == b"<x/>" * 1000
        same(back.truth(), flight.truth[::4])
        for (suite, instrument), record in flight.records.items():
            # The chip's temperature is there now and then, sigmas are logged as variances.
            got = back.record(suite, instrument)
            if instrument == "imu":
                object.__setattr__(record, "temperature", got.temperature)  # type: ignore[attr-defined]
            if instrument == "fix":
                object.__setattr__(record, "sigma", np.abs(record.sigma))  # type: ignore[attr-defined]
            same(got, record, close=("sigma",))
        single = (
            "att_cov",
            "pos_cov",
            "vel_cov",
            "gyro_bias_sigma",
            "accel_bias_sigma",
            "innovation",
            "innovation_var",
            "adaptation",
        )
        for name, estimates in flight.estimates.items():
            same(back.estimates(name), estimates, single)
        same(back.setpoints(), flight.setpoints)
        assert back.events() == flight.events


def test_spans(flight: MadeUpFlight, log: Path) -> None:
    with FlightReader(log) as back:
        whole = back.read("/truth/imu")
        part = back.read("/truth/imu", EPOCH + 1_000_000_000, EPOCH + 3_500_000_000)
        assert len(part) == 250
        assert (part == whole[100:350]).all()
        assert len(back.truth(1.0, 2.0)) == 100
        assert len(back.read("/truth/imu", EPOCH + 10**15)) == 0
        late = back.record("chr", "imu", 2.0, 3.0)
        assert (late.arrival_ns >= 2e9).all()
        assert (late.arrival_ns < 3e9).all()
        record: Any = flight.records["chr", "imu"]
        inside = (record.arrival_ns >= 2e9) & (record.arrival_ns < 3e9)
        assert (late.saturated == record.saturated[inside]).all()  # type: ignore[attr-defined]


def test_blocks_are_the_whole(log: Path) -> None:
    with LogReader(log) as back:
        topics = list(back.topics)
        whole = back.read(topics)
        parts: dict[str, list[np.ndarray]] = {t: [] for t in topics}
        before = 0
        for block in back.blocks(topics):
            times = np.concatenate([a["log_time"] for a in block.values()])
            assert times.min() >= before
            before = times.max()
            for topic, array in block.items():
                parts[topic].append(array)
        for topic in topics:
            joined = np.concatenate(parts[topic])
            assert joined.dtype == whole[topic].dtype == back.dtype(topic)
            assert len(joined) == len(whole[topic])
            if topic not in ("/tf", "/tf_static", "/events"):  # strings and sequences are objects
                assert joined.tobytes() == whole[topic].tobytes()
        (single,) = back.blocks("/truth/air")
        assert single.tobytes() == whole["/truth/air"].tobytes()


@pytest.mark.parametrize("block", [0.01, 0.37, 5.0])
def test_bytes_do_not_depend_on_blocks(flight: MadeUpFlight, log: Path, tmp_path: Path, block: float) -> None:
    flight.write(tmp_path / "again.mcap", block)
    assert (tmp_path / "again.mcap").read_bytes() == log.read_bytes()


def test_chunks_are_cut_by_time(log: Path) -> None:
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    seconds = [c.message_start_time // 10**9 for c in summary.chunk_indexes]
    assert seconds == [c.message_end_time // 10**9 for c in summary.chunk_indexes]
    assert seconds == sorted(set(seconds))


def test_the_mcap_reader_agrees(log: Path) -> None:
    with LogReader(log) as ours, log.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        counts: dict[str, int] = {}
        last = 0
        for _, channel, message in reader.iter_messages():
            assert message.log_time >= last
            last = message.log_time
            assert message.sequence == counts.get(channel.topic, 0)
            counts[channel.topic] = message.sequence + 1
        assert counts == {t.topic: t.count for t in ours.topics.values() if t.count}
        assert {m.name: m.metadata for m in reader.iter_metadata()} == ours.metadata
        assert [(a.name, len(a.data)) for a in reader.iter_attachments()] == list(ours.attachments.items())
        stream.seek(0)
        assert sum(1 for _ in StreamReader(stream, validate_crcs=True).records) > 100


def test_rosbags_agrees(log: Path) -> None:
    with LogReader(log) as ours, AnyReader([log]) as theirs:
        seen: dict[str, list[Any]] = {}
        for connection, time_ns, raw in theirs.messages():
            seen.setdefault(connection.topic, []).append((time_ns, theirs.deserialize(raw, connection.msgtype)))
        assert {t: len(m) for t, m in seen.items()} == {t.topic: t.count for t in ours.topics.values()}
        for topic, found in seen.items():
            array = ours.read(topic)
            assert array["log_time"].tolist() == [t for t, _ in found]
            for row, (_, message) in list(zip(array, found, strict=True))[::37]:
                assert_equal_message(row, message)


def assert_equal_message(ours: Any, theirs: Any) -> None:
    for name in ours.dtype.names:
        if name == "log_time":
            continue
        a, b = ours[name], getattr(theirs, name)
        if isinstance(a, np.void):
            assert_equal_message(a, b)
        elif isinstance(a, np.ndarray) and a.dtype.names:
            assert len(a) == len(b)
            for x, y in zip(a, b, strict=True):
                assert_equal_message(x, y)
        else:
            np.testing.assert_array_equal(a, b)


def test_read_gives_plain_columns(flight: MadeUpFlight, log: Path) -> None:
    with LogReader(log) as back:
        array = back.read("/sbg/imu/data_raw")
        record: Any = flight.records["sbg", "imu"]
        np.testing.assert_array_equal(vector(array["angular_velocity"]), record.gyro_b)
        np.testing.assert_array_equal(stamps(array), EPOCH + record.stamp_ns)
        assert set(array["header"]["frame_id"]) == {"base_link_frd"}
        frame = back.frame("/sbg/imu/data_raw")
        np.testing.assert_array_equal(frame["linear_acceleration.z"], record.accel_b[:, 2])
        assert frame["orientation_covariance.0"].eq(-1).all()
        assert back.frame("/events")["text"].tolist() == [e.text for e in flight.events]


def test_frames_form_one_tree(log: Path) -> None:
    with LogReader(log) as back:
        parents = {}
        for topic in ("/tf", "/tf_static"):
            for row in back.read(topic)["transforms"]:
                for t in row:
                    assert parents.setdefault(t["child_frame_id"], t["header"]["frame_id"]) == t["header"]["frame_id"]
        assert parents == {"map_ned": "map", "base_link_frd": "map_ned", "base_link": "base_link_frd"}


def test_info(log: Path) -> None:
    found = info.summary(log)
    topics = {t["topic"]: t for t in found["topics"]}
    assert topics["/truth/imu"]["messages"] == 500
    assert topics["/truth/imu"]["rate_hz"] == pytest.approx(100, rel=0.05)
    assert topics["/events"]["type"] == "ahrs_sim_msgs/msg/Event"
    text = info.text(log)
    assert "/chr/imu/data_raw" in text
    assert "gyro = 0.03 deg/s" in text


def test_info_fits_a_screen(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(log)]) == 0
    short = capsys.readouterr().out
    assert main(["info", str(log), "--all"]) == 0
    assert len(short.splitlines()) < len(capsys.readouterr().out.splitlines())
    assert "--all shows the rest: " in short
    assert "gyro = 0.03 deg/s" not in short


# ---------------------------------------------------------------------------------------------- writing


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    simple(path)
    with pytest.raises(InputError, match=r"exists already.*--force"):
        simple(path)
    simple(path, n=5, force=True)
    with LogReader(path) as log:
        assert log.message_count == 5
    part = tmp_path / "b.mcap.part"
    part.write_bytes(b"precious")
    with pytest.raises(InputError, match="recover"):
        simple(tmp_path / "b.mcap")
    assert part.read_bytes() == b"precious"


def test_unwritable_place(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be created"):
        simple(tmp_path / "file" / "a.mcap")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_surfaces(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = LogWriter(path, epoch_ns=EPOCH)
    channel = writer.add_channel("/p", "sensor_msgs/msg/FluidPressure", frame_id="f")
    writer.start()
    with Path("/dev/full").open("wb", buffering=0) as full:
        writer._file._stream = full
        with pytest.raises(LogError, match="No space left"):
            for second in range(1000):
                t = EPOCH + second * 10**9 + np.arange(1000) * 1000
                writer.write(channel, t, t, fluid_pressure=np.random.default_rng(0).normal(size=1000))
                writer.advance(int(t[-1]))
                time.sleep(0.001)
        writer.abort()
    assert not path.exists()


def test_misuse_is_refused(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", epoch_ns=EPOCH) as writer:
        channel = writer.add_channel("/p", "sensor_msgs/msg/FluidPressure", frame_id="f")
        t = EPOCH + np.arange(3)
        with pytest.raises(ValueError, match="start"):
            writer.write(channel, t, t)
        with pytest.raises(ValueError, match="once"):
            writer.add_channel("/p", "sensor_msgs/msg/FluidPressure")
        writer.start()
        with pytest.raises(ValueError, match="pressur"):
            writer.write(channel, t, t, pressur=1.0)
        with pytest.raises(ValueError, match="/p: fluid_pressure: shape"):
            writer.write(channel, t, t, fluid_pressure=np.zeros(4))
        writer.write(channel, t, t, fluid_pressure=1.0)
        writer.advance(EPOCH + 10**10)
        with pytest.raises(ValueError, match="advance"):
            writer.write(channel, t, t)


def test_error_in_flight_keeps_the_part(flight: MadeUpFlight, log: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    from ahrs_sim.log.flight_log import FlightLog

    with pytest.raises(RuntimeError), FlightLog(path, **flight.header()) as writer:
        flight.feed(writer)
        raise RuntimeError
    assert not path.exists()
    part = tmp_path / "a.mcap.part"
    with pytest.raises(InputError, match="recover"):
        LogReader(part)
    recover(part, path)
    with LogReader(path) as back, LogReader(log) as whole:
        assert back.message_count == whole.message_count


def test_an_empty_log_is_a_log(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", epoch_ns=EPOCH) as writer:
        writer.add_channel("/p", "sensor_msgs/msg/FluidPressure", frame_id="f")
    with LogReader(tmp_path / "a.mcap") as log:
        assert len(log.read("/p")) == 0
        assert list(log.blocks("/p")) == []
        assert "no messages" in info.text(tmp_path / "a.mcap")


# ---------------------------------------------------------------------------------------------- recovery


def test_recovering_a_finished_log_changes_nothing(log: Path, tmp_path: Path) -> None:
    result = recover(log, tmp_path / "a.mcap")
    assert result.complete
    assert (tmp_path / "a.mcap").read_bytes() == log.read_bytes()
    with pytest.raises(InputError, match="exists"):
        recover(log, tmp_path / "a.mcap")


def test_killed_while_writing(tmp_path: Path) -> None:
    code = f"""
        import sys
        from pathlib import Path
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        from log_helpers import MadeUpFlight
        from ahrs_sim.log.flight_log import FlightLog
        flight = MadeUpFlight(3.0)
        log = FlightLog(sys.argv[1], **flight.header())
        flight.feed(log, 0.5)
        print("fed", flush=True)
        sys.stdin.read()
    """
    path = tmp_path / "k.mcap"
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdin
    assert process.stdout
    with process, process.stdin, process.stdout:
        assert process.stdout.readline() == b"fed\n"
        time.sleep(0.3)  # the worker is a few chunks behind at most
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert not path.exists()
    result = recover(tmp_path / "k.mcap.part", path)
    assert not result.complete
    with FlightReader(path) as back:
        truth = back.truth()
        assert len(truth) >= 100 * int(3.0 - HOLD_S)
        same(truth, MadeUpFlight(3.0).truth[::4][: len(truth)])
        assert back.metadata["recovered"]["messages"] == str(result.messages)


def test_cut_off_anywhere(log: Path, tmp_path: Path) -> None:
    """Each prefix is refused in one line by the reader, and what is whole in it comes back."""
    data = log.read_bytes()
    choose = random.Random(1)
    cuts = [0, 1, 7, 8, 9, 16, 17, 30, 40, 100, len(data) - 1, len(data) - 8, len(data) - 9, len(data) - 40]
    cuts += [choose.randrange(len(data)) for _ in range(30)]
    with LogReader(log) as whole:
        truth = whole.read("/truth/state")
        total = whole.message_count
    part, out = tmp_path / "p.mcap.part", tmp_path / "o.mcap"
    last = 0
    for cut in sorted(cuts):
        part.write_bytes(data[:cut])
        with pytest.raises(InputError) as error:
            LogReader(part)
        assert str(part) in str(error.value)
        assert "\n" not in str(error.value)
        if cut < 40:
            with pytest.raises(InputError):
                recover(part, out, force=True)
            assert not out.exists()
            continue
        result = recover(part, out, force=True)
        assert result.messages >= last
        last = result.messages
        with LogReader(out) as back:
            assert back.message_count == result.messages
            if "/truth/state" in back.topics:
                kept = back.read("/truth/state")
                assert kept.tobytes() == truth[: len(kept)].tobytes()
    assert last == total


def test_recover_leaves_its_source_alone(log: Path, tmp_path: Path) -> None:
    part = tmp_path / "a.mcap.part"
    part.write_bytes(log.read_bytes()[:-100])
    recover(part, tmp_path / "a.mcap")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "a.mcap.part"]
    with pytest.raises(InputError, match="another name"):
        recover(part, part, force=True)


# ---------------------------------------------------------------------------------------------- other people's


@pytest.mark.parametrize(
    "content", [b"", b"\x89", b"PK\3\4" * 100, b"\x89MCAP0\r\n", b"\0" * 4096, b"\x89MCAP0\r\n" * 9]
)
def test_not_a_log(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    for action in (LogReader, info.summary, lambda p: recover(p, tmp_path / "o.mcap")):
        with pytest.raises(InputError, match=r"x\.mcap") as error:
            action(path)
        assert "\n" not in str(error.value)


def test_what_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    for path in (tmp_path / "gone.mcap", tmp_path, tmp_path / "pipe.mcap"):
        with pytest.raises(InputError, match="cannot be read"):
            LogReader(path)


def foreign(path: Path, **settings: Any) -> None:
    """A log by the mcap package: two types, strings of changing length, disordered times."""
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream, chunk_size=2000, **settings)
        writer.start(profile="ros2", library="other")
        channels = {}
        for topic, kind in (("/imu", "sensor_msgs/msg/Imu"), ("/events", "ahrs_sim_msgs/msg/Event")):
            schema = writer.register_schema(kind, "ros2msg", messages.schema_text(kind).encode())
            channels[topic] = kind, writer.register_channel(topic, "cdr", schema)
        writer.register_channel("/json", "json", writer.register_schema("x", "jsonschema", b"{}"))
        writer.add_metadata("m", {"a": "b"})
        writer.add_attachment(1, 2, "n", "text/plain", b"content")
        for k in range(100):
            t = EPOCH + (k ^ 3) * 10**7
            for topic, (kind, channel) in channels.items():
                value: dict[str, Any] = {"header": {"stamp": t, "frame_id": "f" * (1 + k % 3)}}
                value |= {"angular_velocity": (k, 2, 3)} if topic == "/imu" else {"text": "é" * (k % 7)}
                payload, _ = encode(messages.definitions(kind), kind, value)
                writer.add_message(channel, t, payload, t, k)
        writer.finish()


FOREIGN: dict[str, dict[str, Any]] = {
    "zstd": {},
    "lz4": {"compression": mcap.writer.CompressionType.LZ4},
    "none": {"compression": mcap.writer.CompressionType.NONE},
    "unchunked": {"use_chunking": False},
    "no summary": {
        "index_types": mcap.writer.IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
    "no message index": {"index_types": mcap.writer.IndexType.CHUNK},
    "no channels in the summary": {"repeat_channels": False, "repeat_schemas": False},
}


@pytest.mark.parametrize("how", FOREIGN)
def test_foreign_logs(how: str, tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    foreign(path, **FOREIGN[how])
    recover(path, tmp_path / "r.mcap")
    for found in (path, tmp_path / "r.mcap"):
        with LogReader(found) as log:
            assert log.message_count == 200
            assert log.metadata["m"] == {"a": "b"}
            assert log.attachment("n") == b"content"
            imu = log.read("/imu")
            assert imu["log_time"].tolist() == [EPOCH + k * 10**7 for k in range(100)]
            assert imu["angular_velocity"]["x"].tolist() == [k ^ 3 for k in range(100)]
            assert imu["header"]["frame_id"].tolist() == ["f" * (1 + (k ^ 3) % 3) for k in range(100)]
            np.testing.assert_array_equal(np.concatenate(list(log.blocks("/imu"))), imu)
            assert log.read("/events")["text"].tolist() == ["é" * ((k ^ 3) % 7) for k in range(100)]
            with pytest.raises(InputError, match=r"topic /json.*only ROS 2"):
                log.read("/json")
            with pytest.raises(InputError, match=r"no topic '/imy'; did you mean '/imu'"):
                log.read("/imy")
        assert "/json" in info.text(found)


def others(path: Path, profile: str = "", n: int = 20, **settings: Any) -> None:
    """A log of other people's with nothing of ROS 2 in it but one topic whose type is in another language."""
    kinds = {
        "/pose": ("foxglove.PoseInFrame", "protobuf", b"\x0a\x01x", "protobuf"),
        "/json": ("State", "jsonschema", b"{}", "json"),
        "/ros1": ("geometry_msgs/Twist", "ros1msg", b"float64 x", "ros1"),
        "/idl": ("sensor_msgs/msg/Imu", "ros2idl", b"module x {};", "cdr"),
        "/odd": ("odd\x1b[31m\ntype", "?", b"\xff\xfe", "nobody's"),
    }
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream, chunk_size=500, **settings)
        writer.start(profile=profile, library="other\nline")
        channels = [
            writer.register_channel(topic, message, writer.register_schema(name, form, data))
            for topic, (name, form, data, message) in kinds.items()
        ]
        channels.append(writer.register_channel("/none", "cbor", 0))
        for k in range(n):
            for channel in channels:
                writer.add_message(channel, EPOCH + k * 10**8, b"content", EPOCH)
        writer.finish()


@pytest.mark.parametrize("how", ["zstd", "unchunked", "no summary"])
@pytest.mark.parametrize("profile", ["", "px4", "a\nb"])
def test_info_says_what_it_can_of_anything(
    profile: str, how: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "o.mcap"
    others(path, profile, **FOREIGN[how])
    lines = info.text(path).splitlines()
    assert lines[0].endswith(f"profile {profile.replace(chr(10), ' ') or '-'}, written by other line")
    assert lines[1].endswith("1.900 s, 120 messages")
    rows = dict(line.split(maxsplit=1) for line in lines[4:10])
    assert rows["/pose"].split() == ["foxglove.PoseInFrame", "(protobuf)", "20", "10.0"]
    assert rows["/json"].split() == ["State", "(json,", "jsonschema)", "20", "10.0"]
    assert rows["/idl"].split() == ["sensor_msgs/msg/Imu", "(cdr,", "ros2idl)", "20", "10.0"]
    assert rows["/odd"].startswith("odd?[31m type")
    assert rows["/none"].split() == ["(cbor)", "20", "10.0"]
    assert "not read" in lines[-1]
    for command in ("compare", "replay", "allan", "export --to csv -o"):
        words = command.split()
        assert main([*words[:1], str(path), *words[1:], *([str(tmp_path / "out")] if "-o" in words else [])]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"ahrs-sim: {path}: "), command
        assert error.count("\n") == 1, command


def test_info_of_what_cannot_be_uncompressed_or_is_empty(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty, path, bare = (tmp_path / name for name in ("e.mcap", "o.mcap", "b.mcap"))
    others(empty, n=0)
    assert "no messages" in info.text(empty)
    for file, how in ((path, "zstd"), (bare, "no summary")):
        others(file, **FOREIGN[how])
        data = file.read_bytes().replace(b"\4\0\0\0zstd", b"\4\0\0\0brot")
        end = len(data) - 37
        file.write_bytes(data[: end + 25] + b"\0\0\0\0" + data[end + 29 :])  # no checksum of the summary
    assert "120 messages" in info.text(path)  # the summary is not compressed
    assert main(["info", str(bare)]) == 2
    assert capsys.readouterr().err.startswith(f"ahrs-sim: {bare}: unknown compression 'brot'")
    assert main(["recover", str(bare), "-o", str(tmp_path / "r.mcap")]) == 0
    assert "no whole messages" in capsys.readouterr().out


def test_unknown_compression_and_type(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    foreign(path, compression=mcap.writer.CompressionType.ZSTD)
    data = path.read_bytes().replace(b"\4\0\0\0zstd", b"\4\0\0\0brot")
    end = len(data) - 37
    path.write_bytes(data[: end + 25] + b"\0\0\0\0" + data[end + 29 :])  # no checksum of the summary
    with LogReader(path) as log, pytest.raises(InputError, match="unknown compression 'brot'"):
        log.read("/imu")


def mutations(data: bytes, n: int, seed: int) -> Any:
    choose = random.Random(seed)
    ends = list(range(max(0, len(data) - 3000), len(data))) + list(range(3000))
    for _ in range(n):
        wrong = bytearray(data)
        for _ in range(choose.choice((1, 1, 2, 8))):
            at = choose.choice(ends) if choose.random() < 0.5 else choose.randrange(len(data))
            at = min(at, len(wrong) - 1)  # it may have become shorter
            what = choose.random()
            if what < 0.4:
                wrong[at] ^= 1 << choose.randrange(8)
            elif what < 0.6:
                wrong[at : at + 8] = choose.randbytes(8)
            elif what < 0.8:
                wrong[at : at + 8] = choose.choice((2**64 - 1, 2**63 - 1, 2**40, 2**31, 0)).to_bytes(8, "little")
            else:
                del wrong[at : at + choose.randrange(1, 20)]
        yield bytes(wrong)


@pytest.mark.parametrize("how", ["zstd", "lz4", "none", "unchunked", "no summary", "no message index"])
def test_damaged_files_never_hang_or_crash(how: str, tmp_path: Path) -> None:
    """Whatever is wrong: a result, or one InputError; in bounded memory."""
    path, out = tmp_path / "f.mcap", tmp_path / "o.mcap"
    foreign(path, enable_crcs=False, **FOREIGN[how])
    data = path.read_bytes()
    memory = _peak_memory()
    for wrong in mutations(data, 60, seed=list(FOREIGN).index(how)):
        path.write_bytes(wrong)
        begun = time.monotonic()
        try:
            with LogReader(path) as log:
                for topic in log.topics:
                    log.read(topic)
                list(log.blocks([t for t in log.topics if log.topics[t].encoding == "cdr"]))
        except InputError as error:
            assert "\n" not in str(error)
        try:
            recover(path, out, force=True)
            LogReader(out).close()
        except InputError as error:
            assert "\n" not in str(error)
        assert time.monotonic() - begun < 5
    assert _peak_memory() - memory < 500e6


def _peak_memory() -> float:
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def test_a_chunk_may_not_promise_gigabytes(tmp_path: Path) -> None:
    """Sizes that a file states of itself are not allocated before they are checked."""
    path = tmp_path / "bomb.mcap"
    kind = "sensor_msgs/msg/Imu"
    bomb = lz4.frame.compress(b"\0" * (64 << 20))
    for size in (64 << 20, 2**62):
        with path.open("wb") as stream:
            file = Container(stream, mcap.records.Header("ros2", ""))
            file.schema(mcap.records.Schema(1, messages.schema_text(kind).encode(), "ros2msg", kind))
            file.channel(mcap.records.Channel(1, "/imu", "cdr", {}, 1))
            entries = np.array([[EPOCH, 0]], np.uint64)
            file.chunk(mcap.records.Chunk("lz4", bomb, EPOCH, EPOCH, 0, size), {1: entries})
            file.finish()
        with LogReader(path) as log, pytest.raises(InputError, match="damaged"):
            log.read("/imu")


@pytest.mark.skipif(not SHARED.is_dir(), reason="the real recordings are not here (../shared/data)")
def test_a_real_recording(tmp_path: Path) -> None:
    path = SHARED / "thor_flight75" / "thor_flight75.mcap"
    with LogReader(path) as log, AnyReader([path]) as theirs:
        topics = list(log.topics)
        arrays = log.read(topics)
        assert {t: len(a) for t, a in arrays.items()} == {t: log.topics[t].count for t in topics}
        at = dict.fromkeys(topics, 0)
        for k, (connection, time_ns, raw) in enumerate(theirs.messages()):
            row = arrays[connection.topic][at[connection.topic]]
            at[connection.topic] += 1
            if k % 997 == 0:
                assert row["log_time"] == time_ns
                assert_equal_message(row, theirs.deserialize(raw, connection.msgtype))
    assert recover(path, tmp_path / "r.mcap").messages == sum(map(len, arrays.values()))


@pytest.mark.skipif(not SHARED.is_dir(), reason="the real recordings are not here (../shared/data)")
@pytest.mark.parametrize("path", sorted(SHARED.glob("*/*.mcap")), ids=lambda p: p.stem)
def test_all_real_recordings_can_be_read(path: Path) -> None:
    with LogReader(path) as log:
        for topic, about in log.topics.items():
            array = log.read(topic)
            assert len(array) == about.count
            assert (np.diff(stamps(array)) >= 0).all()
        assert log.topics[topic].count


def test_fields_of_later_versions_may_be_absent() -> None:
    from ahrs_sim.log import messages
    from ahrs_sim.log.mcap.cdr import message_dtype

    for name, field in (("EstimatorState", "position_covariance"), ("ImuErrors", "gyro_effective_bias")):
        kind = f"ahrs_sim_msgs/msg/{name}"
        whole = message_dtype(messages.definitions(kind), kind)
        older = np.dtype([(n, whole[n]) for n in whole.names if n != field])
        assert messages.difference(kind, older) == ""
        first = np.dtype([(n, whole[n]) for n in whole.names if n != whole.names[1]])
        assert "is missing" in messages.difference(kind, first)
