"""What several commands share: types of arguments, groups of options, the progress bar, the live server."""

import argparse
import contextlib
import datetime
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import threading

    from ahrs_sim.log.live import Live
    from ahrs_sim.scenario import Gate

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def count(text: str) -> int:
    """Read a number of things: 1 or more."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not 1 or more")
    return value


def natural(text: str) -> int:
    """Read a seed or the number of a run: 0 or more."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is negative; a seed is 0 or more")
    return value


def positive(text: str) -> float:
    """Read a duration, s, or a rate: above 0, below 1e9."""
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    if not value < 1e9:
        raise argparse.ArgumentTypeError(f"{text} is too large; it must be below 1e9")
    return value


def moment(text: str) -> datetime.datetime:
    """Read a date, with or without a time; without an offset it is UTC."""
    try:
        date = datetime.datetime.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is no date; write it like 2026-06-01 or 2026-06-01T10:00") from None
    return date if date.tzinfo else date.replace(tzinfo=datetime.UTC)


def _port(text: str) -> int:
    if not text.isdigit() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text} is not a port; write --live=PORT, or put --live last")
    return int(text)


def add_estimators(command: argparse.ArgumentParser, text: str) -> None:
    """Add `--estimator NAME`, which may be repeated: a list, empty when it was not given."""
    command.add_argument("--estimator", action="append", default=[], metavar="NAME", help=text)


def add_code(command: argparse.ArgumentParser) -> None:
    """Add `--allow-code NAME`, which may be repeated and which `gate` reads."""
    command.add_argument(
        "--allow-code",
        action="append",
        default=[],
        metavar="NAME",
        help="let estimators run this outside code: package, or package.module:Class; may be repeated",
    )


def gate(allowed: Sequence[str], quiet: bool = False) -> "Gate":
    """Make the gate for code from outside; each name that passes is reported on the terminal once."""
    from ahrs_sim.scenario import Gate

    seen: set[str] = set()

    def report(line: str) -> None:
        if line not in seen and not quiet:
            print(f"ahrs-sim: {line}", file=sys.stderr)
        seen.add(line)

    return Gate(tuple(allowed), report)


def add_map(command: argparse.ArgumentParser) -> None:
    """Add `--map TOML`: what the columns of a table of text are."""
    command.add_argument("--map", type=Path, metavar="TOML", help="name the columns of a .csv, or preset:NAME")


def add_span(command: argparse.ArgumentParser, what: str = "") -> None:
    """Add `--from T` and `--to T`: `start` and `end` in s, None when not given."""
    command.add_argument("--from", dest="start", type=float, metavar="T", help=f"{what}from this time, s")
    command.add_argument("--to", dest="end", type=float, metavar="T", help=f"{what}up to this time, s")


def add_live(command: argparse.ArgumentParser) -> None:
    """Add `--live[=PORT]` and `--rate X`, which `open_live` reads."""
    command.add_argument(
        "--live",
        nargs="?",
        type=_port,
        const=8765,
        metavar="PORT",
        help="stream the flight to viewers, too (write --live=PORT)",
    )
    command.add_argument("--rate", type=positive, default=1.0, metavar="X", help="multiple of real time, with --live")


def open_live(arguments: argparse.Namespace, stopped: Callable[[], bool] = lambda: False) -> "Live | None":
    """Open the server that `--live` asks for; None when it was not given."""
    if arguments.live is None:
        return None
    from ahrs_sim.log.live import Live

    live = Live(arguments.live, arguments.rate, stopped)
    print(f"live at ws://localhost:{live.port} (Foxglove: Open connection, Foxglove WebSocket)", file=sys.stderr)
    return live


@contextlib.contextmanager
def temporary_folder() -> Iterator[str]:
    """Make a private folder that goes with the command; one that a killed command has left goes with the next."""
    import os
    import shutil
    import tempfile

    found = Path(tempfile.gettempdir()).glob("ahrs_sim-run-*-*") if hasattr(os, "getuid") else ()
    for left in found:
        pid = left.name.split("-")[2]
        with contextlib.suppress(OSError):
            if pid.isdecimal() and left.lstat().st_uid == os.getuid() and not _runs(int(pid)):
                shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=f"ahrs_sim-run-{os.getpid()}-") as folder:
        yield folder


def _runs(pid: int) -> bool:
    import os

    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's now
        return True
    return True


class CompileNotice:
    """A line on stderr for each method whose compilation takes longer than a second: silence looks like a fault."""

    def __init__(self, *, hidden: bool = False) -> None:
        self.hidden = hidden
        self._timer: threading.Timer | None = None

    def __call__(self, name: str, number: int, count: int) -> None:
        """Begin with a method, the `number`-th of `count`."""
        import threading

        self.end()
        if not self.hidden:
            text = f"ahrs-sim: compiling {name}, {number} of {count}"
            self._timer = threading.Timer(1.0, lambda: print(text, file=sys.stderr, flush=True))
            self._timer.daemon = True
            self._timer.start()

    def end(self) -> None:
        """Say nothing of a method that was ready sooner."""
        if self._timer is not None:
            self._timer.cancel()


class Progress:
    """A bar on the terminal for whatever takes longer than two seconds; nothing when stderr is not one."""

    def __init__(self, title: str, *, unit: str = "s", hidden: bool = False) -> None:
        import time

        self.title, self.unit = title, unit
        self.hidden = hidden or not sys.stderr.isatty()
        self.clock = time.monotonic
        self.begun = self.clock()
        self.drawn = self.begun + 1.8
        self.first: float | None = None  # how much had been done before, when a campaign goes on

    def __call__(self, t: float, end: float | None) -> None:
        """Draw the bar at `t` of `end`, in the bar's unit; without an end, only how far it is."""
        now = self.clock()
        if self.first is None:
            self.first, self.begun = t, now
        if self.hidden or now - self.drawn < 0.2:
            return
        self.drawn = now
        done = min(1.0, t / end) if end else 0.0
        bar = f"[{'#' * round(30 * done):30s}] {100 * done:3.0f} %" if end else ""
        left = ""
        if end and t > self.first:
            left = f", {(now - self.begun) * (end - t) / (t - self.first):.0f} s left "
        print(f"\r{self.title} {bar} {t:6.0f} {self.unit}{left}", end="", file=sys.stderr, flush=True)

    @staticmethod
    def clear() -> None:
        """Remove the bar from the terminal."""
        if sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)
