"""Commands killed (-9) at random moments: `python tests/fuzz/kills.py --runs 200`.

What must hold after each kill: a finished file is whole and as it would have been; an unfinished log is the beginning
of that same file, and all of it but the last piece comes back with `recover`; the same command run again does the rest;
nothing that the command had started is left running.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.log.mcap.reader import LogReader
from ahrs_sim.log.mcap.recover import recover
from ahrs_sim.runs import campaign

SCENARIO = """
seed = 5
duration_s = 60.0
[motion]
kind = "sway"
still_s = 25.0
[estimator.a]
method = "marg-ekf"
suite = "chr"
"""

SUITE = '[[flight]]\nscenario = "s.toml"\nseeds = [1]\nduration_s = 5.0\n'
LATEST_S = 10.0  # after which nothing may be left running


@dataclass
class Killed:
    """What the kills have shown."""

    count: Counter[str] = field(default_factory=Counter)  # by command
    moments: Counter[str] = field(default_factory=Counter)  # by what there was when it was killed
    lost: list[int] = field(default_factory=list)  # bytes at the end of unfinished logs
    failures: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        found = ", ".join(f"{n} {what}" for what, n in self.moments.items())
        lost = f"; bytes behind the last whole record: at most {max(self.lost)}" if self.lost else ""
        commands = ", ".join(f"{k} {n}" for k, n in self.count.items())
        head = f"{self.count.total()} kills ({commands}): {found}{lost}; {len(self.failures)} failed"
        return "\n".join([head, *self.failures])


class Place:
    """A folder with the inputs, what each command makes when it is left alone, and how long it takes."""

    def __init__(self, folder: Path, kinds: set[str]) -> None:
        self.folder = folder
        (folder / "s.toml").write_text(SCENARIO)
        (folder / "suite.toml").write_text(SUITE)
        self.whole: dict[str, bytes] = {}
        self.seconds: dict[str, float] = {}
        for kind in ("fly", *kinds):
            if kind in self.seconds:
                continue
            for _ in range(2):  # the first may compile
                out = folder / "reference"
                begun = time.monotonic()
                done = subprocess.run(self.command(kind, out), cwd=folder, capture_output=True, text=True)
                self.seconds[kind] = time.monotonic() - begun
                assert done.returncode == 0, done.stderr
            if out.is_file():
                self.whole[kind] = out.read_bytes()
            if kind == "fly":
                out.rename(folder / "flown.mcap")

    def command(self, kind: str, out: Path) -> list[str]:
        """The command line that makes `out`; again and again."""
        arguments = {
            "fly": ["fly", "s.toml", "-o", str(out), "--force", "--quiet"],
            "first": ["fly", "s.toml", "-o", str(out), "--force", "--quiet"],
            "replay": ["replay", "flown.mcap", "-o", str(out), "--force"],
            "recover": ["recover", "flown.mcap", "-o", str(out), "--force"],
            "campaign": ["campaign", "s.toml", "--runs", "2", "--duration", "4", "--workers", "1", "-o", f"{out}-runs"],
            "check": ["check", "suite.toml", "--workers", "1", "--renew", "--why", "killed"],
        }
        return [sys.executable, "-m", "ahrs_sim", *arguments[kind]]


def _children(pid: int) -> list[int]:
    try:
        found = [int(x) for x in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []
    return found + [grandchild for child in found for grandchild in _children(child)]


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def kill(place: Place, kind: str, rng: np.random.Generator, out: Path, result: Killed) -> None:
    """Start a command, kill it at a random moment, see what is left."""
    part = out.with_name(out.name + (".recovering" if kind == "recover" else ".part"))
    with subprocess.Popen(
        place.command(kind, out), cwd=place.folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        if kind == "first":  # while the first second is being written
            while not part.exists() and process.poll() is None:
                time.sleep(0.002)
            time.sleep(float(rng.uniform(0.0, 0.05)))
        else:
            time.sleep(float(rng.uniform(0.0, place.seconds[kind])))
        children = _children(process.pid)
        process.send_signal(signal.SIGKILL)
    until = time.monotonic() + LATEST_S
    while any(map(_runs, children)) and time.monotonic() < until:
        time.sleep(0.05)
    if left := [pid for pid in children if _runs(pid)]:
        result.failures.append(f"{kind}: still running after {LATEST_S:g} s: {left}")
    result.count[kind] += 1
    _CHECKS.get(kind, _check_log)(place, kind, out, result)


def _check_log(place: Place, kind: str, out: Path, result: Killed) -> None:
    whole = place.whole["fly" if kind == "first" else kind]
    part = out.with_name(out.name + ".part")
    if out.exists():
        result.moments["finished"] += 1
        if out.read_bytes() != whole:
            result.failures.append(f"{kind}: the finished log is another")
    elif not part.exists():
        result.moments["not begun"] += 1
    else:
        written = part.read_bytes()
        if not whole.startswith(written):
            result.failures.append(f"{kind}: the unfinished log is not the beginning of the whole one")
        back = out.with_name("back.mcap")
        try:
            found = recover(part, back, force=True)
        except InputError as error:
            result.moments["nothing written"] += 1
            if len(written) > 200:
                result.failures.append(f"{kind}: {len(written)} bytes, and {error}")
            return
        result.moments["unfinished"] += 1
        result.lost.append(found.lost_bytes)
        with LogReader(back) as log:
            if log.message_count != found.messages:
                result.failures.append(f"{kind}: {found.messages} messages recovered, {log.message_count} in the log")
        with LogReader(place.folder / "flown.mcap") as log:
            largest = max(piece.length for piece in log._contents.pieces)
        if found.damaged or found.lost_bytes > 2 * largest:
            result.failures.append(f"{kind}: {found}; a chunk has at most {largest} bytes")


def _check_recover(place: Place, kind: str, out: Path, result: Killed) -> None:
    result.moments["recovered" if out.exists() else "not recovered"] += 1
    if (place.folder / "flown.mcap").read_bytes() != place.whole["fly"]:
        result.failures.append("recover: its source is another")
    if out.exists() and out.read_bytes() != place.whole["fly"]:
        result.failures.append("recover: the finished log is another")


def _check_campaign(place: Place, kind: str, out: Path, result: Killed) -> None:
    store = campaign.Store(f"{out}-runs")
    result.moments[f"{len(store.done()) if store.files() else 0} runs kept"] += 1
    for name in store.files():
        store.table(["run"])
        if not store.read(name):
            result.failures.append(f"campaign: {name} is empty")


def _check_baseline(place: Place, kind: str, out: Path, result: Killed) -> None:
    result.moments["baseline kept"] += 1
    if (place.folder / "suite.json").exists():
        import json

        json.loads((place.folder / "suite.json").read_text())


_CHECKS: dict[str, Callable[[Place, str, Path, Killed], None]] = {
    "recover": _check_recover,
    "campaign": _check_campaign,
    "check": _check_baseline,
}


def again(place: Place, kind: str, out: Path, result: Killed) -> None:
    """Run the killed command once more and to its end."""
    done = subprocess.run(place.command(kind, out), cwd=place.folder, capture_output=True, text=True)
    if done.returncode:
        result.failures.append(f"{kind}: again: {done.stderr}")
    elif kind == "campaign" and campaign.Store(f"{out}-runs").done() != {0, 1}:
        result.failures.append("campaign: again: not all runs are there")
    elif out.is_file() and out.read_bytes() != place.whole["fly" if kind == "first" else kind]:
        result.failures.append(f"{kind}: again: another log")


_SHARES = {"fly": 0.45, "first": 0.2, "replay": 0.15, "recover": 0.05, "campaign": 0.08, "check": 0.07}


def run(runs: int, seed: int, resume: int = 4) -> Killed:
    """Kill `runs` commands; every `resume`-th is run again to its end."""
    rng = np.random.default_rng(seed)
    result = Killed()
    kinds = list(_SHARES)
    order = rng.choice(len(kinds), runs, p=list(_SHARES.values()))
    order[: len(kinds)] = np.arange(len(kinds))[:runs]  # each at least once
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        place = Place(Path(folder), {kinds[k] for k in order})
        for number, k in enumerate(order):
            kind, out = kinds[k], place.folder / f"out-{number}"
            kill(place, kind, rng, out, result)
            if number % resume == 0 or number < len(kinds):
                again(place, kind, out, result)
            for path in place.folder.glob(f"out-{number}*"):
                if path.is_file():
                    path.unlink()
    return result


def main() -> int:
    """Run the kills; returns 1 when something was lost."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    result = run(arguments.runs, arguments.seed)
    print(result)
    return 1 if result.failures else 0


if __name__ == "__main__":
    os.environ.setdefault("PYTHONDONTWRITEBYTECODE", "1")
    sys.exit(main())
