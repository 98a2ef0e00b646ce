"""What the file system may do: full at any write, two writers of a log, files beyond 4 GB, nowhere to cache."""

import errno
import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import mcap.writer
import pytest
from log_helpers import EPOCH, MadeUpFlight

from ahrs_sim import cli
from ahrs_sim.errors import InputError, LogError
from ahrs_sim.log.flight_log import FlightLog
from ahrs_sim.log.mcap.reader import LogReader
from ahrs_sim.log.mcap.recover import recover


class Full:
    """A stream whose disk is full at the n-th write."""

    def __init__(self, stream: Any, n: int) -> None:
        self.stream, self.left = stream, n

    def write(self, data: bytes) -> int:
        self.left -= 1
        if self.left <= 0:
            self.stream.write(bytes(data)[: len(data) // 2])  # as a disk does: some of it still fits
            raise OSError(errno.ENOSPC, "No space left on device")
        return int(self.stream.write(data))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def fed(path: Path, flight: MadeUpFlight, n: int | None) -> int:
    """Write a log on a disk that is full at the n-th write; how many writes there were."""
    log = FlightLog(path, **flight.header())
    container = log.writer._file
    full = Full(container._stream, n if n is not None else 10**9)
    container._stream = full
    with log:
        flight.feed(log, 0.5)
    return 10**9 - full.left


def test_a_disk_full_at_every_tenth_write_costs_the_last_chunk(tmp_path: Path) -> None:
    flight = MadeUpFlight(4.0)
    writes = fed(tmp_path / "whole.mcap", flight, None)
    whole = (tmp_path / "whole.mcap").read_bytes()
    assert writes > 20
    for n in range(1, writes, 10):
        path = tmp_path / f"{n}.mcap"
        with pytest.raises(LogError, match="No space left on device; 'ahrs-sim recover' saves what is there"):
            fed(path, flight, n)
        assert not path.exists()
        part = path.with_name(f"{n}.mcap.part")
        written = part.read_bytes()
        assert whole.startswith(written)
        if len(written) > 200:
            found = recover(part, path)
            with LogReader(path) as log:
                assert log.message_count == found.messages
            assert found.damaged == 0


def test_two_writers_of_one_log(tmp_path: Path) -> None:
    flight = MadeUpFlight(2.0)
    first = FlightLog(tmp_path / "a.mcap", **flight.header())
    with pytest.raises(InputError, match="exists already"):
        FlightLog(tmp_path / "a.mcap", **flight.header())
    with first:
        flight.feed(first, 0.5)
    with LogReader(tmp_path / "a.mcap") as log:
        assert log.message_count


def test_two_commands_at_once_leave_one_whole_log(tmp_path: Path) -> None:
    """One of them flies; the other reports that, or finds the log finished."""
    command = ["fly", "sway", "--duration", "3", "--estimator", "ekf-chr", "-o", str(tmp_path / "a.mcap"), "--quiet"]
    made = [subprocess.Popen([sys.executable, "-m", "ahrs_sim", *command], stderr=subprocess.PIPE) for _ in range(2)]
    errors = [process.communicate()[1].decode() for process in made]
    codes = [process.returncode for process in made]
    assert sorted(codes) == [0, 2], errors
    loser = errors[codes.index(2)]
    assert loser.count("\n") == 1
    assert "exists" in loser
    with LogReader(tmp_path / "a.mcap") as log:
        assert log.message_count
    assert not (tmp_path / "a.mcap.part").exists()


def test_forced_twice_at_once_the_message_is_true(tmp_path: Path) -> None:
    flight = MadeUpFlight(2.0)
    first = FlightLog(tmp_path / "a.mcap", **flight.header())
    with FlightLog(tmp_path / "a.mcap", force=True, **flight.header()) as second:  # takes the name away
        flight.feed(second, 0.5)
    with pytest.raises(LogError) as caught, first:
        flight.feed(first, 0.5)
    assert "somebody else" in str(caught.value)
    assert "stays" not in str(caught.value)
    with LogReader(tmp_path / "a.mcap") as log:
        assert log.message_count


def test_a_log_beyond_four_gigabytes(tmp_path: Path) -> None:
    """The disk holds nothing of five gigabytes in the middle: a record that nobody knows, in a sparse file."""
    path, hole = tmp_path / "big.mcap", 5 << 30
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream, use_chunking=False, index_types=mcap.writer.IndexType.NONE)
        writer.start(profile="ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema("p/msg/M", "ros2msg", b"int8 a"))
        for k in range(100):
            writer.add_message(channel, EPOCH + k, b"\0\1\0\0" + bytes([k]), EPOCH)
        writer.finish()
    content = path.read_bytes()
    end = content.index(b"\x0f\x04" + bytes(7))
    first = content.index(b"\x05\x1b" + bytes(7))
    with path.open("wb") as stream:
        stream.write(content[:end] + b"\x90" + hole.to_bytes(8, "little"))
        stream.seek(hole, os.SEEK_CUR)
        stream.write(content[first:end] + content[end : end + 13] + b"\x02\x14" + bytes(27) + content[:8])
    assert path.stat().st_size > 5 << 30
    with LogReader(path) as log:
        assert log.message_count == 200
        assert log.read("/a")["a"].tolist() == sorted([*range(100)] * 2)
    assert recover(path, tmp_path / "back.mcap").messages == 200
    with LogReader(tmp_path / "back.mcap") as log:
        assert log.message_count == 200


@pytest.mark.skipif(os.name == "nt", reason="needs permissions")
def test_nowhere_to_cache_and_no_home(tmp_path: Path) -> None:
    """A read-only installation without any place of one's own compiles into a private temporary folder."""
    blocked = tmp_path / "blocked"
    blocked.write_text("a file, not a folder")
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    environment = {k: v for k, v in os.environ.items() if k not in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    code = "from estimators.jit import _cache_root; print(_cache_root())"
    for more in (
        {"NUMBA_CACHE_DIR": str(blocked / "x")},
        {"XDG_CACHE_HOME": str(blocked)},
        {"HOME": "/nonexistent/home"},
        {"HOME": "/proc"},
    ):
        command = [sys.executable, "-c", code]
        done = subprocess.run(
            command, capture_output=True, text=True, env={**environment, **more, "TMPDIR": str(temporary)}
        )
        assert done.returncode == 0, done.stderr
        root = Path(done.stdout.strip())
        assert root.is_relative_to(temporary) or more["HOME"].startswith("/nonexistent"), root
        assert not stat.S_IMODE(root.stat().st_mode) & 0o022


def test_a_cache_that_somebody_else_prepared_is_not_used(tmp_path: Path) -> None:
    mine = tmp_path / f"ahrs_sim-{os.getuid()}"
    mine.mkdir()
    mine.chmod(0o777)
    code = "from estimators.jit import _private_root; print(_private_root())"
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    found = Path(done.stdout.strip())
    assert found != mine
    assert not found.exists()  # and went with its process


def test_a_report_on_a_full_disk_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    flight = MadeUpFlight(4.0)
    with FlightLog(tmp_path / "a.mcap", **flight.header()) as log:
        flight.feed(log, 0.5)
    for option in ("--report", "--png"):
        target = "/dev/full" if option == "--report" else "/dev/full/x"
        assert cli.main(["compare", str(tmp_path / "a.mcap"), option, target]) == 2
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.long
def test_three_first_compilations_at_once(tmp_path: Path) -> None:
    code = """
import numpy as np, estimators
from estimators.types import Samples
t = np.arange(300) / 100
noise = np.random.default_rng(1).normal(size=(3, 300, 3))
field = {"mag_b": np.array([2e-5, 0.0, 4e-5]) + 1e-7 * noise[2], "mag_new": np.ones(300, bool)}
still = Samples.make(t, 1e-3 * noise[0], np.array([0.0, 0.0, -9.8]) + 1e-2 * noise[1], **field)
from estimators import native
compiled = []
native.listeners.append(lambda: compiled.append(None))
print(estimators.create("tilt-ekf", align_s=1.0).process(still).status[-1], len(compiled))
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    made = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)
        for _ in range(3)
    ]
    results = [process.communicate() for process in made]
    assert [process.returncode for process in made] == [0, 0, 0], results
    outputs = [out.split() for out, _ in results]
    assert {status for status, _ in outputs} == {b"1"}
    kernels = list((tmp_path / "cache").rglob("*.kernel"))
    assert len(kernels) > 10
    assert sum(int(compiled) for _, compiled in outputs) == len(kernels), "each is compiled by one of them"
