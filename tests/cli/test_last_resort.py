"""Whatever goes wrong is one line: full disks, terminals that know ASCII only, faults of the program itself."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ahrs_sim import cli


def run(*arguments: str | bytes, **environment: str) -> subprocess.CompletedProcess[bytes]:
    environment = {**os.environ, "AHRS_SIM_DEBUG": "", **environment}
    return subprocess.run([sys.executable, "-m", "ahrs_sim", *arguments], capture_output=True, env=environment)


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (ZeroDivisionError("a\nb"), 3, "unforeseen ZeroDivisionError: a b; please report it"),
        (RecursionError("x" * 999), 3, "unforeseen RecursionError: xxx"),
        (PermissionError(13, "Permission denied", "/there"), 2, "/there: Permission denied"),
        (OSError(28, "No space left on device"), 2, "output: No space left on device"),
        (MemoryError(), 2, "not enough memory"),
    ],
)
def test_an_exception_is_one_line_unless_asked_for(
    error: Exception, code: int, words: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def fail(arguments: object) -> None:
        raise error

    monkeypatch.setattr("ahrs_sim.cli.listing.run", fail)
    monkeypatch.setattr("ahrs_sim.cli._discard_output", lambda: None)
    with pytest.raises(type(error)):
        cli.main(["list", "grades"])
    monkeypatch.delenv("AHRS_SIM_DEBUG")
    assert cli.main(["list", "grades"]) == code
    line = capfd.readouterr().err
    assert line.startswith(f"ahrs-sim: {words}")
    assert line.count("\n") == 1
    assert len(line) < 400
    for arguments in (["--debug", "list", "grades"], ["list", "grades", "--debug"]):
        with pytest.raises(type(error)):
            cli.main(arguments)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_a_redirection() -> None:
    with Path("/dev/full").open("w") as full:
        for arguments in (["list", "grades"], ["list", "estimators", "--json"]):
            command = [sys.executable, "-m", "ahrs_sim", *arguments]
            environment = {**os.environ, "AHRS_SIM_DEBUG": ""}
            done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, env=environment)
            assert (done.returncode, done.stderr) == (2, b"ahrs-sim: output: No space left on device\n")


@pytest.mark.parametrize("name", ["\u00e9t\u00e9.mcap".encode(), b"\xff\xfe.mcap", "\u98de\u884c".encode()])
def test_any_name_on_a_terminal_that_knows_ascii_only(name: bytes, tmp_path: Path) -> None:
    path = os.fsencode(tmp_path) + b"/" + name
    Path(os.fsdecode(path)).write_bytes(b"")
    done = run("info", path, PYTHONIOENCODING="ascii", LC_ALL="C")
    assert done.returncode == 2
    assert done.stderr.count(b"\n") == 1
    assert b"empty file" in done.stderr


def test_numbers_of_threads_that_are_none() -> None:
    for number in ("0", "-3"):
        done = run("list", "estimators", NUMBA_NUM_THREADS=number)
        assert (done.returncode, done.stderr.count(b"\n")) == (2, 1)
        assert f"NUMBA_NUM_THREADS={number}: must be 1 or more".encode() in done.stderr


@pytest.mark.parametrize(
    ("text", "words"),
    [("1e12", "is too large; it must be below 1e9"), ("-1", "is not a positive number"), ("nan", "is not a positive")],
)
def test_durations_say_what_is_wrong_with_them(text: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["fly", "circuit", f"--duration={text}"])
    assert words in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs processes as POSIX has them")
def test_a_temporary_folder_is_private_and_goes_even_after_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import tempfile

    from ahrs_sim.cli.common import temporary_folder

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
    left, running, other = (tmp_path / f"ahrs_sim-run-{x}-abc" for x in (ended.pid, os.getpid(), "x"))
    for folder in (left, running, other):
        folder.mkdir()
        (folder / "a.mcap").write_text("")
    (tmp_path / f"ahrs_sim-run-{ended.pid}-link").symlink_to(other)
    with temporary_folder() as folder:
        assert not Path(folder).stat().st_mode & 0o077
        assert not left.exists()
        assert (running / "a.mcap").exists()
        assert (other / "a.mcap").exists()
    assert not Path(folder).exists()
