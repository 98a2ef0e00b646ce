"""The process in which a plug-in library runs: started by `ahrs_sim.plugins.library`, needs the standard library only.

    python host.py LIBRARY MEMORY_FD COMMAND_FD ANSWER_FD ROWS SAMPLE_SIZE VERSION

Samples lie in shared memory, `ROWS` of them, then as many estimates. A command is eight bytes, a word of four letters
and a number; each is answered by a line of JSON, `{}` or `{"error": text}`.
"""

import ctypes
import json
import mmap
import os
import signal
import struct
import sys

_SYMBOLS = ("version", "create", "process", "reset", "destroy", "error")
_COMMAND = struct.Struct("<4sI")


class Refused(Exception):
    """A library that cannot be used, with the reason."""


_MACHINES = {3: "x86", 40: "ARM", 62: "x86-64", 183: "AArch64", 243: "RISC-V"}  # e_machine


def machine(path: str) -> str:
    """Name the machine that an ELF file is for; empty for any other file."""
    fd = os.open(path, os.O_RDONLY)  # an import of pathlib would cost more time than all else here
    head = os.read(fd, 20)
    os.close(fd)
    if len(head) < 20 or not head.startswith(b"\x7fELF"):
        return ""
    number = int.from_bytes(head[18:20], "little" if head[5] == 1 else "big")
    return f"{_MACHINES.get(number, f'machine {number} of ELF')}, {32 * head[4]} bits"


def load(path: str, version: int) -> ctypes.CDLL:
    """Load a library and declare its functions.

    Raises:
        Refused: not a library of this machine, a function missing, or another version of the interface.
    """
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
        theirs, ours = machine(path), machine(sys.executable)
        if theirs and ours and theirs != ours:
            raise Refused(f"was compiled for {theirs}, this machine is {ours}; compile it for this one") from None
        raise Refused(f"cannot be loaded: {error}") from None
    for name in _SYMBOLS:
        if not hasattr(library, f"ahrs_{name}"):
            raise Refused(f"has no function ahrs_{name}; export the six functions of ahrs_estimator.h")
    pointer, text = ctypes.c_void_p, ctypes.c_char_p
    library.ahrs_version.restype = ctypes.c_int32
    library.ahrs_create.restype, library.ahrs_create.argtypes = pointer, [pointer, pointer, text]
    library.ahrs_process.restype = ctypes.c_int32
    library.ahrs_process.argtypes = [pointer, pointer, ctypes.c_uint32, pointer]
    library.ahrs_reset.restype, library.ahrs_reset.argtypes = None, [pointer]
    library.ahrs_destroy.restype, library.ahrs_destroy.argtypes = None, [pointer]
    library.ahrs_error.restype, library.ahrs_error.argtypes = text, [pointer]
    found = library.ahrs_version()
    if found != version:
        raise Refused(
            f"was compiled for version {found} of ahrs_estimator.h, this is version {version}; compile it anew"
        )
    return library


class Library:
    """A loaded library and its one estimator.

    Args:
        path: the shared library.
        version: of the interface that it must have.
        base: address of the shared memory, where the samples lie.
        estimates: address of the estimates.
    """

    def __init__(self, path: str, version: int, base: int, estimates: int) -> None:
        self._library, self._base, self._estimates = load(path, version), base, estimates
        self._estimator: int | None = None

    def make(self, site: int, sensors: int, settings: int) -> str:
        """Create the estimator from what lies at these offsets of the memory; return an error or ""."""
        base = self._base
        self._estimator = self._library.ahrs_create(base + site, base + sensors, ctypes.string_at(base + settings))
        return "" if self._estimator else self._explained("ahrs_create returned NULL and no reason")

    def rows(self, n: int) -> str:
        """Estimate `n` rows; return an error or ""."""
        code = self._library.ahrs_process(self._estimator, self._base, n, self._estimates)
        return self._explained(f"ahrs_process returned {code} and no reason") if code else ""

    def reset(self) -> str:
        """Forget everything seen."""
        self._library.ahrs_reset(self._estimator)
        return ""

    def end(self) -> None:
        """End the estimator."""
        self._library.ahrs_destroy(self._estimator)

    def _explained(self, otherwise: str) -> str:
        text = (self._library.ahrs_error(self._estimator) or b"").decode(errors="replace")
        return " ".join(text.split()) or otherwise


def serve(made, memory: mmap.mmap, commands: int, answers: int) -> None:  # type: ignore[no-untyped-def]
    """Answer commands with an object like `Library` until the other side ends."""
    while len(command := os.read(commands, _COMMAND.size)) == _COMMAND.size:
        word, number = _COMMAND.unpack(command)
        if word == b"stop":
            made.end()
            return
        if word == b"make":  # offsets of site, sensors and settings lie where the samples will
            error = made.make(*struct.unpack_from("<III", memory))
        else:
            error = made.rows(number) if word == b"rows" else made.reset()
        os.write(answers, json.dumps({"error": error} if error else {}).encode() + b"\n")


def start(make) -> None:  # type: ignore[no-untyped-def]
    """Serve what `make(path, version, base, estimates, rows)` loads, with the arguments of this process."""
    path, *numbers = sys.argv[1:]
    memory_fd, commands, answers, rows, sample, version = map(int, numbers)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the flight, which then ends this process
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: no orphan that hangs
    memory = mmap.mmap(memory_fd, 0)
    base = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    try:
        made = make(path, version, base, base + rows * sample, rows)
    except Refused as refused:
        os.write(answers, json.dumps({"error": str(refused)}).encode() + b"\n")
        return
    os.write(answers, b"{}\n")
    serve(made, memory, commands, answers)
    os._exit(0)  # a library's own clean-up may crash; everything has been answered


if __name__ == "__main__":
    start(lambda path, version, base, estimates, rows: Library(path, version, base, estimates))
