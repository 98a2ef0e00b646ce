"""Estimators that run in a process of their own: shared libraries behind `ahrs_estimator.h`, and FMUs.

Whatever the code there does (crash, hang, exit), the flight goes on: its rows are NaN from then on and `failure` says
why.
"""

import contextlib
import json
import mmap
import os
import select
import signal
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.plugins import layout
from ahrs_sim.plugins.host import __file__ as _HOST
from estimators.types import Estimates, Samples, SensorInfo, Site, Status

_ROWS = 4096  # of one call of the library; a longer block is handed over in parts
_START_S = 10.0
_COMMAND = struct.Struct("<4sI")


class HostedEstimator:
    """An estimator in a process of its own.

    Args:
        path: of what the host loads.
        site: place and field.
        sensors: data sheet figures.
        time_limit_s: longest wait for one block, s; then the library counts as hung.
        settings: passed to the library as text, one `name=value` a line.

    Raises:
        InputError: it cannot be loaded here, or refuses a setting: why.
    """

    host: ClassVar[tuple[str, ...]]
    """Arguments of the interpreter that start the process."""

    def __init__(
        self, path: Path, *, site: Site, sensors: SensorInfo, time_limit_s: float = 10.0, **settings: Any
    ) -> None:
        self.failure: str | None = None
        self._path, self._limit = path, time_limit_s
        self._known = site, sensors, settings
        self._start()

    def _start(self) -> None:
        if not self._path.is_file():
            raise InputError(f"{self._path}: no such file")
        size = _ROWS * (layout.SAMPLE.itemsize + layout.ESTIMATE.itemsize)
        memory_fd = _anonymous_file(size)
        self._memory = mmap.mmap(memory_fd, size)
        whole = np.frombuffer(self._memory, np.uint8)
        split = _ROWS * layout.SAMPLE.itemsize
        self._samples, self._estimates = whole[:split].view(layout.SAMPLE), whole[split:].view(layout.ESTIMATE)
        command_read, self._command = os.pipe()
        self._answer, answer_write = os.pipe()
        numbers = (memory_fd, command_read, answer_write, _ROWS, layout.SAMPLE.itemsize, layout.VERSION)
        self._process = subprocess.Popen(
            [sys.executable, *self.host, str(self._path.resolve()), *map(str, numbers)],
            pass_fds=(memory_fd, command_read, answer_write),
            stdin=subprocess.DEVNULL,
            stdout=sys.stderr.fileno() if _is_real(sys.stderr) else subprocess.DEVNULL,
        )
        for fd in (memory_fd, command_read, answer_write):
            os.close(fd)
        self._pending = b""
        refusal = self._await(_START_S) or self._make()
        if refusal:
            self.close()
            raise InputError(f"{self._path}: {refusal}")

    def _make(self) -> str | None:
        site, sensors, settings = self._known
        texts = settings_text(settings).encode() + b"\0"
        parts = [layout.constants(site), layout.constants(sensors), texts]
        offsets = np.cumsum([16, *map(len, parts)])[:3]
        block = struct.pack("<IIII", *offsets, 0) + b"".join(parts)
        self._memory[: len(block)] = block
        return self._ask(b"make", 0, _START_S)

    def process(self, samples: Samples) -> Estimates:
        """Return one row of estimates for each row of samples; NaN rows after a failure."""
        parts = [self._part(samples[i : i + _ROWS]) for i in range(0, len(samples), _ROWS)]
        return Estimates.concatenate(parts) if parts else layout.read_estimates(self._estimates[:0])

    def _part(self, samples: Samples) -> Estimates:
        n = len(samples)
        rows, answer = self._samples[:n], self._estimates[:n]
        layout.blank_estimates(samples.t, answer)
        if self.failure is None:
            layout.write_samples(samples, rows)
            problem = self._ask(b"rows", n, self._limit)
            if problem:
                self.failure = problem
                self.close()
                layout.blank_estimates(samples.t, answer)
        estimates = layout.read_estimates(answer)
        if self.failure is not None:
            estimates.status[:] = Status.DIVERGED
        return estimates

    def reset(self) -> None:
        """Forget everything seen; a library that has failed is started anew."""
        if self.failure is None:
            self.failure = self._ask(b"zero", 0, self._limit)
        if self.failure is not None:
            self.close()
            self.failure = None
            self._start()

    def _ask(self, word: bytes, number: int, limit: float) -> str | None:
        try:
            os.write(self._command, _COMMAND.pack(word, number))
        except BrokenPipeError:
            return self._death()
        return self._await(limit)

    def _await(self, limit: float) -> str | None:
        """Wait for an answer; return its error, or the reason why there is none."""
        while b"\n" not in self._pending:
            ready, _, _ = select.select([self._answer], [], [], limit)
            if not ready:
                self._process.kill()
                return f"gave no answer within {limit:g} s (hung): stopped"
            part = os.read(self._answer, 1 << 16)
            if not part:
                return self._death()
            self._pending += part
        line, _, self._pending = self._pending.partition(b"\n")
        error: str | None = json.loads(line).get("error")
        return error

    def _death(self) -> str:
        code = self._process.wait()
        if code < 0:
            return f"crashed ({signal.Signals(-code).name})"
        return f"ended the process it runs in (exit code {code})"

    def close(self) -> None:
        """End the process."""
        process = getattr(self, "_process", None)
        if process is None or self._command < 0:
            return
        with contextlib.suppress(BrokenPipeError):
            os.write(self._command, _COMMAND.pack(b"stop", 0))
        os.close(self._command)
        os.close(self._answer)
        self._command = self._answer = -1
        try:
            process.wait(1.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def __del__(self) -> None:
        self.close()


class LibraryEstimator(HostedEstimator):
    """A shared library behind `ahrs_estimator.h`."""

    host = ("-I", "-S", _HOST)  # needs nothing installed, and starts in a hundredth of a second


class FmuEstimator(HostedEstimator):
    """A co-simulation unit (FMI 2.0 or 3.0) whose variables are mapped by name: see `fmu_host`."""

    host = ("-m", "ahrs_sim.plugins.fmu_host")

    def __init__(self, path: Path, **known: Any) -> None:
        from importlib.util import find_spec

        if find_spec("fmpy") is None:
            raise InputError(f"{path}: an FMU needs FMPy; pip install 'ahrs-sim[fmu]'")
        super().__init__(path, **known)


def _anonymous_file(size: int) -> int:
    """Make a file of `size` bytes of zeros that no other process can open."""
    if hasattr(os, "memfd_create"):
        fd = os.memfd_create("ahrs_sim plug-in")
    else:
        with tempfile.TemporaryFile() as file:
            fd = os.dup(file.fileno())
    os.ftruncate(fd, size)
    return fd


def _is_real(stream: Any) -> bool:
    try:
        stream.fileno()
    except (AttributeError, OSError, ValueError):
        return False
    return True


def _text(value: Any) -> str:
    """Format a setting: true and false, numbers that read back to the same bits, texts unchanged."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def settings_text(settings: Mapping[str, Any], prefix: str = "") -> str:
    """Format the settings as a library receives them; those of a table within are named `table.key`."""
    lines = ""
    for name, value in settings.items():
        inside = isinstance(value, Mapping)
        lines += settings_text(value, f"{prefix}{name}.") if inside else f"{prefix}{name}={_text(value)}\n"
    return lines
