"""The process in which a plug-in library runs: started by `ahrs_sim.plugins.library`, needs the standard library only.

    python host.py LIBRARY MEMORY_FD COMMAND_FD ANSWER_FD ROWS SAMPLE_SIZE ESTIMATE_SIZE VERSION

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


def load(path: str, version: int) -> ctypes.CDLL:
    """Load a library and declare its functions.

    Raises:
        Refused: not a library of this machine, a function missing, or another version of the interface.
    """
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
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


def explained(library: ctypes.CDLL, estimator: int | None, otherwise: str) -> str:
    """What the library says of its last error, on one line."""
    text = (library.ahrs_error(estimator) or b"").decode(errors="replace").strip()
    return " ".join(text.split()) or otherwise


def serve(
    library: ctypes.CDLL, memory: mmap.mmap, commands: int, answers: int, rows: int, sizes: tuple[int, int]
) -> None:
    """Answer commands until the other side ends."""
    base = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    samples, estimates = base, base + rows * sizes[0]
    estimator: int | None = None
    while len(command := os.read(commands, _COMMAND.size)) == _COMMAND.size:
        word, number = _COMMAND.unpack(command)
        error = ""
        if word == b"make":  # site, sensors and settings lie where the samples will
            site, sensors, settings = struct.unpack_from("<III", memory)
            estimator = library.ahrs_create(base + site, base + sensors, ctypes.string_at(base + settings))
            if not estimator:
                error = explained(library, None, "ahrs_create returned NULL and no reason")
        elif word == b"rows":
            code = library.ahrs_process(estimator, samples, number, estimates)
            if code:
                error = explained(library, estimator, f"ahrs_process returned {code} and no reason")
        elif word == b"zero":
            library.ahrs_reset(estimator)
        elif word == b"stop":
            library.ahrs_destroy(estimator)
            return
        os.write(answers, json.dumps({"error": error} if error else {}).encode() + b"\n")


def main() -> None:
    """Run the plug-in named by the arguments."""
    path, *numbers = sys.argv[1:]
    memory_fd, commands, answers, rows, sample, estimate, version = map(int, numbers)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the flight, which then ends this process
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: no orphan that hangs
    memory = mmap.mmap(memory_fd, 0)
    try:
        library = load(path, version)
    except Refused as refused:
        os.write(answers, json.dumps({"error": str(refused)}).encode() + b"\n")
        return
    os.write(answers, b"{}\n")
    serve(library, memory, commands, answers, rows, (sample, estimate))
    os._exit(0)  # a library's own clean-up may crash; everything has been answered


if __name__ == "__main__":
    main()
