"""Flights over WebSocket: viewers get the messages of the log, at their time."""

import json
import socket
import struct
import sys
import threading
import time
from pathlib import Path

import pytest

from ahrs_sim import cli
from ahrs_sim.log.mcap.reader import LogReader

pytest.importorskip("foxglove")
sync_client = pytest.importorskip("websockets.sync.client")

MESSAGE, TIME = 1, 2  # opcodes of binary frames


class Viewer(threading.Thread):
    """Connects as soon as somebody answers, subscribes to everything, keeps what comes until good-bye."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.port = port
        self.channels: dict[int, dict[str, str]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {}
        self.arrivals: list[tuple[float, int]] = []  # s of a real clock, ns of the flight's
        self.clock: list[int] = []
        self.start()

    def run(self) -> None:
        for _ in range(600):
            try:
                connection = sync_client.connect(
                    f"ws://127.0.0.1:{self.port}", subprotocols=["foxglove.sdk.v1"], max_size=None
                )
                break
            except OSError:
                time.sleep(0.1)
        with connection:
            for frame in connection:
                if isinstance(frame, str):
                    self.answer(connection, json.loads(frame))
                elif frame[0] == MESSAGE:
                    subscription, log_time = struct.unpack("<IQ", frame[1:13])
                    topic = self.channels[subscription]["topic"]
                    self.messages.setdefault(topic, []).append((log_time, frame[13:]))
                    self.arrivals.append((time.monotonic(), log_time))
                elif frame[0] == TIME:
                    self.clock.append(struct.unpack("<Q", frame[1:9])[0])

    def answer(self, connection: object, message: dict) -> None:
        if message["op"] == "advertise":
            self.channels |= {c["id"]: c for c in message["channels"]}
            wanted = [{"id": c["id"], "channelId": c["id"]} for c in message["channels"]]
            connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))  # type: ignore[attr-defined]


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def watched(arguments: list[str], rate: float) -> Viewer:
    """What a viewer saw of a command."""
    port = free_port()
    viewer = Viewer(port)
    assert cli.main([*arguments, f"--live={port}", "--rate", str(rate)]) == 0
    viewer.join(30)
    assert not viewer.is_alive()
    return viewer


def compare_with_log(viewer: Viewer, path: Path) -> None:
    """Every topic is there as the log has it, and from the first message seen on nothing is missing."""
    with LogReader(path) as log:
        schemas = {c.topic: s for c, s in log.carried(list(log.topics)).values()}
        blocks = log.raw_blocks(log.carried(list(log.topics)))
        logged: dict[str, list[tuple[int, bytes]]] = {}
        numbers = {n: c.topic for n, (c, _) in log.carried(list(log.topics)).items()}
        for _, found in blocks:
            for number, batches in found.items():
                for rows in batches:
                    logged.setdefault(numbers[number], []).extend(
                        (int.from_bytes(r[15:23].tobytes(), "little"), r[31:].tobytes()) for r in rows
                    )
    assert {c["topic"] for c in viewer.channels.values()} == set(schemas)
    for channel in viewer.channels.values():
        schema = schemas[channel["topic"]]
        assert schema is not None
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        assert (channel["schemaName"], channel["schema"]) == (schema.name, schema.data.decode())
    begun = viewer.arrivals[0][1]
    seen = 0
    (static,) = logged.pop("/tf_static")  # repeated every second
    assert len(viewer.messages["/tf_static"]) >= 5
    assert {content for _, content in viewer.messages["/tf_static"]} == {static[1]}
    for topic, messages in logged.items():
        late = [m for m in messages if m[0] > begun + 200_000_000]  # its subscriptions are a matter of milliseconds
        got = [m for m in viewer.messages.get(topic, []) if m[0] > begun + 200_000_000]
        assert got == late, topic
        seen += len(got)
    assert seen > 2000  # of some 13 000: on a busy machine the subscriptions come late


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Viewer]:
    path = tmp_path_factory.mktemp("live") / "flight.mcap"
    arguments = ["fly", "circuit", "--duration", "8", "--estimator", "ekf-chr", "-o", str(path), "--quiet"]
    return path, watched(arguments, 4.0)


def test_a_viewer_sees_what_the_log_has(flown: tuple[Path, Viewer]) -> None:
    path, viewer = flown
    compare_with_log(viewer, path)


def test_the_flight_keeps_to_the_clock(flown: tuple[Path, Viewer]) -> None:
    _, viewer = flown
    (a, first), (b, last) = viewer.arrivals[0], viewer.arrivals[-1]
    assert b - a > 0.95 * (last - first) / 4e9  # never early; a busy machine may be late
    assert viewer.clock == sorted(viewer.clock)
    assert viewer.clock[-1] == last


def test_the_log_is_that_of_a_flight_without_viewers(flown: tuple[Path, Viewer], tmp_path: Path) -> None:
    path, _ = flown
    plain = tmp_path / "plain.mcap"
    assert cli.main(["fly", "circuit", "--duration", "8", "--estimator", "ekf-chr", "-o", str(plain), "--quiet"]) == 0
    assert plain.read_bytes() == path.read_bytes()


def test_a_replay_is_streamed_too(flown: tuple[Path, Viewer], tmp_path: Path) -> None:
    out = tmp_path / "again.mcap"
    compare_with_log(watched(["replay", str(flown[0]), "-o", str(out)], 20.0), out)


def test_what_goes_wrong_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["fly", "circuit", "--duration", "1", "-o", str(tmp_path / "x.mcap")]
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert cli.main([*arguments, f"--live={taken.getsockname()[1]}"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "choose another port" in error
    monkeypatch.setitem(sys.modules, "foxglove", None)
    assert cli.main([*arguments, "--live"]) == 2
    assert capsys.readouterr().err == "ahrs-sim: --live needs foxglove-sdk; pip install 'ahrs-sim[live]'\n"
    with pytest.raises(SystemExit):
        cli.main(["fly", "--live", "circuit"])
    assert "write --live=PORT" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
