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
from numba import types
from numba.extending import intrinsic, overload, register_jitable


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


def borrowed(value: Any) -> Any:
    """The same array, or NamedTuple of arrays, without counting references: each count is an atomic operation.

    For the outermost kernel, which its caller's arrays outlive; what is borrowed must not leave it.
    """
    return value


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value=value)
        array.meminfo = array.meminfo.type(None)
        array.parent = array.parent.type(None)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for i, part in enumerate(kind.types):  # type: ignore[attr-defined]
            inside = _without_owner(context, builder, part, builder.extract_value(value, i))
            value = builder.insert_value(value, inside, i)
    return value


@intrinsic
def _borrowed(typing_context: Any, value: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _without_owner(context, builder, signature.return_type, arguments[0])

    return value(value), generate


@overload(borrowed, jit_options={"forceinline": True})
def _choose_borrowed(value):  # type: ignore[no-untyped-def]
    def taken(value):  # type: ignore[no-untyped-def]
        return _borrowed(value)  # type: ignore[call-arg]

    return taken
