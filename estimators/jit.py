"""Compilation: one decorator for every kernel, and a disk cache that is never stale.

Numba's cache looks at the file of the function it compiles, not at the files of the functions that one calls: an edited
kernel would leave its callers returning the old answer. The cache therefore lies in a folder named by a hash of all
sources that take part, chosen before anything is decorated.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.extending import register_jitable


def _cache_root() -> Path:
    """`$NUMBA_CACHE_DIR`, else the user's cache folder, else a temporary one when that is not writable."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen)
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ahrs_sim"
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError:
        return Path(tempfile.gettempdir()) / "ahrs_sim"
    return root if os.access(root, os.W_OK) else Path(tempfile.gettempdir()) / "ahrs_sim"


def compiler(*packages: Path) -> Callable[..., Any]:
    """A decorator like `numba.njit(cache=True)` whose cache is keyed by all sources of `packages` and the versions."""
    digest = hashlib.sha256(f"{numba.__version__} {np.__version__}".encode())
    for package in packages:
        for source in sorted(package.rglob("*.py")):
            digest.update(source.read_bytes())
    folder = str(_cache_root() / f"kernels-{digest.hexdigest()[:16]}")

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


njit = compiler(Path(__file__).parent)


def inner(function: Callable[..., Any]) -> Callable[..., Any]:
    """For parts of kernels that take tuples: compiled into their callers, plain Python when called from there."""
    chosen: Callable[..., Any] = register_jitable(error_model="numpy", forceinline=True)(function)
    return chosen
