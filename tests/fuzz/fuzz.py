"""Mutated inputs of every kind against every command that reads them: `python tests/fuzz/fuzz.py --mutations 10000`.

A mutation fails when anything but an exception of the project's own comes out, when a refusal is not one line, when it
takes more than 20 s of processor time or more than 1 GB of memory. Mutations run in processes forked from one that has
everything loaded and compiled; the same seed gives the same mutations of the same sound files.
"""

import argparse
import contextlib
import io
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import inputs
import mutate

from ahrs_sim.errors import AhrsSimError
from estimators.errors import EstimationError

CPU_S, MEGABYTES = 20, 1024
_BATCH = 20  # mutations in one forked process
_RESULT = re.compile(r"^(\d+)\t(.*)\t([\d.]+)\t(\d+)$")


@dataclass
class Report:
    """What became of the mutations."""

    count: Counter[str] = field(default_factory=Counter)  # by kind
    refused: int = 0
    seconds: float = 0.0  # the longest, of processor time
    megabytes: int = 0  # the most
    failures: dict[str, list[tuple[str, int]]] = field(default_factory=dict)  # by what: kind and number

    def __str__(self) -> str:
        lines = [
            f"{self.count.total()} mutations ({', '.join(f'{k} {n}' for k, n in self.count.items())}): "
            f"{self.refused} refused, {sum(map(len, self.failures.values()))} failed; "
            f"longest {self.seconds:.1f} s of processor, most {self.megabytes} MB"
        ]
        return "\n".join([*lines, *(f"{what}: {len(w)} times, first {w[0]}" for what, w in self.failures.items())])


def attempt(kind: str, number: int, seed: int, sound: Path, folder: Path) -> str:
    """Do with one mutation what is done with such a file.

    Returns:
        "done", "refused", or what went wrong.
    """
    file = folder / inputs.KINDS[kind].file
    content = (sound / file.name).read_bytes()
    file.write_bytes(mutate.MUTATORS[inputs.KINDS[kind].form](rng(kind, number, seed), content))
    for beside in ("table.csv", *inputs.BESIDE):
        if beside != file.name:
            shutil.copy(sound / beside, folder)
    actions = inputs.KINDS[kind].actions
    return outcome(kind, file, number % len(actions), folder)


def outcome(kind: str, file: Path, action: int, folder: Path) -> str:
    """Run an action on a file; see `attempt`."""
    out = folder / "out"
    out.mkdir()
    stderr = io.StringIO()
    before = Path.cwd()
    os.chdir(out)
    try:
        with contextlib.redirect_stderr(stderr), contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            code = inputs.KINDS[kind].actions[action](file, out)
    except (AhrsSimError, EstimationError) as error:
        return _line(f"{error}\n")
    except SystemExit as error:
        return f"SystemExit {error.code}"
    except BaseException as error:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if "/tests/fuzz/" not in f.filename]
        ours = [f for f in frames if "/ahrs_sim/" in f.filename or "/estimators/" in f.filename] or frames
        place = f"{'/'.join(Path(ours[-1].filename).parts[-2:])}:{ours[-1].lineno}" if ours else "?"
        return f"{type(error).__name__} at {place}: {' '.join(str(error).split())[:100]}"
    finally:
        os.chdir(before)
    if isinstance(code, int) and code in (1, 2):
        return _line("".join(x for x in stderr.getvalue().splitlines(keepends=True) if "ahrs-sim:" in x))
    return "done"


def _line(text: str) -> str:
    """Whether this is the one line that a refusal is."""
    if text.count("\n") != 1 or len(text) < 12 or not text.rstrip("\n").isprintable():
        return f"not one line: {text[:200]!r}"
    return "refused" if len(text) < 4000 else f"a line of {len(text)} characters"


def rng(kind: str, number: int, seed: int) -> np.random.Generator:
    """The generator of one mutation."""
    return np.random.default_rng([seed, number, *kind.encode()])


def _peak() -> int:
    """Most memory (MB) since it was last asked."""
    status = Path("/proc/self/status").read_text()
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    found = re.search(r"VmHWM:\s+(\d+)", status)
    return int(found[1]) // 1024 if found else 0


def _child(kind: str, numbers: range, seed: int, sound: Path, pipe: int) -> None:
    """In a forked process: attempt mutations and write a line for each."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    _peak()
    for number in numbers:
        used = resource.getrusage(resource.RUSAGE_SELF)
        limit = int(used.ru_utime + used.ru_stime) + CPU_S + 1
        resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.getrlimit(resource.RLIMIT_CPU)[1]))
        signal.alarm(10 * CPU_S)  # waits for something
        begun = time.process_time()
        with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
            try:
                what = attempt(kind, number, seed, sound, Path(folder))
            except Exception:
                what = f"the fuzzer itself: {traceback.format_exc()[-300:]}"
        seconds, megabytes = time.process_time() - begun, _peak()
        if megabytes > MEGABYTES:
            what = f"{megabytes} MB ({what[:60]})"
        clean = "".join(c if c.isprintable() else "?" for c in what)
        os.write(pipe, f"{number}\t{clean}\t{seconds:.2f}\t{megabytes}\n".encode())


def _forked(kind: str, numbers: range, seed: int, sound: Path) -> Iterator[tuple[int, str, float, int]]:
    """Attempts in a process of their own; a death or a hang is of the one that it was at."""
    while numbers:
        read, write = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(read)
            try:
                _child(kind, numbers, seed, sound, write)
            finally:
                os._exit(0)
        os.close(write)
        with os.fdopen(read) as lines:
            done = numbers.start
            for line in lines:
                if found := _RESULT.match(line):
                    done = int(found[1]) + 1
                    yield int(found[1]), found[2], float(found[3]), int(found[4])
        _, status = os.waitpid(pid, 0)
        if done < numbers.stop:
            number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
            hung = number in (signal.SIGXCPU, signal.SIGALRM, signal.SIGKILL)
            yield done, "hang" if hung else f"ended by signal {number}", 0.0, 0
            done += 1
        numbers = range(done, numbers.stop)


def run(mutations: int, seed: int, kinds: list[str] | None = None, first: int = 0) -> Report:
    """Attempt `mutations`, shared out to the kinds, from the `first` of each on."""
    chosen = kinds or list(inputs.KINDS)
    report = Report()
    each = -(-mutations // len(chosen))
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        sound = Path(folder)
        inputs.write_all(sound)
        for kind in chosen:  # sound files are read, and everything is loaded and compiled
            for action in range(len(inputs.KINDS[kind].actions)):
                with tempfile.TemporaryDirectory(prefix="fuzz-") as place:
                    shutil.copytree(sound, place, dirs_exist_ok=True)
                    what = outcome(kind, Path(place) / inputs.KINDS[kind].file, action, Path(place))
                if what != "done":
                    report.failures.setdefault(f"{kind}, action {action}, sound: {what}", []).append((kind, -1))
        for kind in chosen:
            for start in range(first, first + each, _BATCH):
                numbers = range(start, min(start + _BATCH, first + each))
                for number, what, seconds, megabytes in _forked(kind, numbers, seed, sound):
                    report.count[kind] += 1
                    report.refused += what == "refused"
                    report.seconds, report.megabytes = max(report.seconds, seconds), max(report.megabytes, megabytes)
                    if what not in ("done", "refused"):
                        report.failures.setdefault(f"{kind}: {what}", []).append((kind, number))
                    elif seconds > CPU_S:
                        report.failures.setdefault(f"{kind}: {seconds:.0f} s of processor", []).append((kind, number))
    return report


def save(kind: str, number: int, seed: int, output: Path) -> None:
    """Write the file of one mutation."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        sound = Path(folder)
        inputs.write_all(sound)
        content = (sound / inputs.KINDS[kind].file).read_bytes()
    output.write_bytes(mutate.MUTATORS[inputs.KINDS[kind].form](rng(kind, number, seed), content))


def main() -> int:
    """Run the fuzzer; returns 1 when a mutation failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--mutations", type=int, default=1000, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", action="append", choices=list(inputs.KINDS))
    parser.add_argument(
        "--first", type=int, default=0, metavar="N", help="the number of the first mutation of each kind"
    )
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the one mutation of --kind and --first")
    arguments = parser.parse_args()
    if arguments.save:
        save(arguments.kind[0], arguments.first, arguments.seed, arguments.save)
        return 0
    report = run(arguments.mutations, arguments.seed, arguments.kind, arguments.first)
    print(report)
    return 1 if report.failures else 0


if __name__ == "__main__":
    os.environ["AHRS_SIM_DEBUG"] = "1"
    sys.exit(main())
