"""Compilation: one decorator for every kernel, and a disk cache that is never stale.

Numba's cache looks at the file of the function it compiles, not at the files of the functions that one calls: an edited
kernel would leave its callers returning the old answer. The cache therefore lies in a folder named by a hash of all
sources that take part, chosen before anything is decorated.
"""

import atexit
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np


def _cache_root() -> Path:
    """`$NUMBA_CACHE_DIR`, else the user's cache folder, else a private temporary one when that is not writable."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        root = Path(chosen)
    else:
        try:
            root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ahrs_sim"
        except RuntimeError:  # a user without a home
            return _private_root()
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError:
        return _private_root()
    return root if os.access(root, os.W_OK) else _private_root()


def _private_root() -> Path:
    """A temporary folder that nobody else can write to: what lies in it is run."""
    if not hasattr(os, "getuid"):
        return Path(tempfile.gettempdir()) / "ahrs_sim"  # of the user alone, on Windows
    root = Path(tempfile.gettempdir()) / f"ahrs_sim-{os.getuid()}"
    try:
        root.mkdir(mode=0o700, exist_ok=True)
        found = root.lstat()
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022:
            return root
    except OSError:
        pass
    made = tempfile.mkdtemp(prefix="ahrs_sim-")  # compiled anew every time: somebody else has that name
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return Path(made)


def cache_folder(*packages: Path) -> Path:
    """Folder of the kernels compiled from these packages: another one for any other state of sources or versions."""
    digest = hashlib.sha256(f"{numba.__version__} {np.__version__}".encode())
    for package in packages:
        for source in sorted(package.rglob("*.py")):
            digest.update(source.read_bytes())
    return _cache_root() / f"kernels-{digest.hexdigest()[:16]}"


def compiler(*packages: Path) -> Callable[..., Any]:
    """A decorator like `numba.njit(cache=True)` whose cache is keyed by all sources of `packages` and the versions."""
    folder = str(cache_folder(*packages))

    def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
        def decorate(function: Callable[..., Any]) -> Any:
            config: Any = numba.config
            before = config.CACHE_DIR
            config.CACHE_DIR = folder
            try:
                # Nobody takes these kernels as C callbacks; the wrapper would cost compile time.
                chosen: Any = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True, **options}
                return numba.njit(**chosen)(function)
            finally:
                config.CACHE_DIR = before

        return decorate(function) if function is not None else decorate

    return njit


_HERE = Path(__file__).parent
FOLDER = cache_folder(_HERE)
JIT = not numba.config.DISABLE_JIT  # type: ignore[attr-defined]
njit = compiler(_HERE)


def on_disk(kernel: Any) -> bool:
    """Tell whether a kernel (`njit`) was ever compiled from these sources, by Numba's index of it."""
    name = f"{kernel.__module__.rpartition('.')[2]}.{kernel.__name__}-*.nbi"
    return any(Path(FOLDER).rglob(name))


def inner(function: Callable[..., Any], forceinline: bool = False) -> Any:
    """Compile a part of kernels that nobody calls from Python: no wrapper for it, no file of its own on disk."""
    options: Any = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "error_model": "numpy", "_nrt": False}
    options["forceinline"] = forceinline
    return numba.njit(**options)(function)
