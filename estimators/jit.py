"""Compilation: one decorator for every kernel, and a disk cache that is never stale.

Numba's cache looks at the file of the function it compiles, not at the files of the functions that one calls: an edited
kernel would leave its callers returning the old answer. The cache therefore lies in a folder named by a hash of all
sources that take part, chosen before anything is decorated. Nothing in it depends on where the sources are, so that a
wheel can bring such folders along (`hatch_build.py`).
"""

import atexit
import contextlib
import hashlib
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import numba
import numpy as np
from llvmlite import binding as llvm  # type: ignore[import-untyped]
from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserProvidedCacheLocator
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


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
    folder = _cache_root() / f"kernels-{digest.hexdigest()[:16]}"
    shipped = SHIPPED / folder.name
    if USES_SHIPPED and shipped.is_dir() and not folder.exists():
        _copy(shipped, folder)
    return folder


def _copy(shipped: Path, folder: Path) -> None:
    """Copy a folder at once or not at all: then it is compiled."""
    with contextlib.suppress(OSError):
        made = Path(tempfile.mkdtemp(dir=folder.parent))
        try:
            shutil.copytree(shipped, made, dirs_exist_ok=True)
            made.rename(folder)
        except OSError:  # somebody else was first
            shutil.rmtree(made, ignore_errors=True)


SHIPPED = Path(__file__).parent / "kernels"
"""Cache folders of a wheel that was built with `AHRS_SIM_COMPILE=1`, and `target.json`: the processor they are for."""


def _compile_as_shipped() -> bool:
    """Compile for the processor of the shipped kernels, if there are any and this one runs them; tell whether."""
    try:
        target = json.loads((SHIPPED / "target.json").read_text())
    except OSError:
        return False
    features = [name.removeprefix("+") for name in target["features"].split(",")]
    here = llvm.get_host_cpu_features() if target["triple"] == llvm.get_process_triple() else {}
    if "NUMBA_CPU_NAME" in os.environ or not all(here.get(name, False) for name in features):
        return False
    config: Any = numba.config
    config.CPU_NAME, config.CPU_FEATURES = target["cpu"], target["features"]
    return True


USES_SHIPPED = _compile_as_shipped()


def _cache(folder: Path) -> type[FunctionCache]:
    """Numba's cache, in a folder; files are named by modules, wherever these lie."""

    class Locator(UserProvidedCacheLocator):
        def __init__(self, function: Any, file: str) -> None:
            self._py_file, self._lineno = file, function.__code__.co_firstlineno
            self._cache_path = str(folder / function.__module__)

        def get_source_stamp(self) -> str:
            return ""  # the folder has the hash of all sources in its name

        @classmethod
        def from_function(cls, function: Any, file: str) -> Self:
            return cls(function, file)

    class Implementation(CompileResultCacheImpl):
        _locator_classes = [Locator]  # noqa: RUF012

    class Cache(FunctionCache):
        _impl_class = Implementation

        def save_overload(self, sig: Any, data: Any) -> None:
            with contextlib.suppress(OSError):  # a full disk, or none to write to: compiled again the next time
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    return Cache


def compiler(*packages: Path) -> Callable[..., Any]:
    """A decorator like `numba.njit(cache=True)` whose cache is keyed by all sources of `packages` and the versions."""
    cache = _cache(cache_folder(*packages))

    def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
        def decorate(function: Callable[..., Any]) -> Any:
            # Nobody takes these kernels as C callbacks; the wrapper would cost compile time.
            chosen: Any = {"error_model": "numpy", "no_cfunc_wrapper": True, **options}
            made = numba.njit(**chosen)(function)
            if JIT:
                made._cache = cache(function)
            return made

        return decorate(function) if function is not None else decorate

    return njit


_HERE = Path(__file__).parent
JIT = not numba.config.DISABLE_JIT  # type: ignore[attr-defined]
FOLDER = cache_folder(_HERE)
njit = compiler(_HERE)


class _Part(JITCodeLibrary):
    """Code that is only linked into other code: optimised there, where it is inlined, and never run by itself."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._verify_declare_only_symbols()  # type: ignore[no-untyped-call]
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """There is none."""
        return 0

    @property
    def codegen(self) -> "_Part":
        """What sets the environment of code that is run."""
        return self

    def set_env(self, env_name: str, env: Any) -> None:
        """Do nothing: only an exception that Python raises needs an environment."""


class _Parts(Compiler):
    """Numba's compiler, into a library of that kind."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *others: Any) -> None:
        part: Any = _Part
        whole: Any = super().__init__
        whole(typingctx, targetctx, library or part(targetctx.codegen(), "part"), *others)


def inner(function: Callable[..., Any], forceinline: bool = False) -> Any:
    """Compile a part of kernels that nobody calls from Python: no wrapper for it, no file of its own on disk."""
    options: Any = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "error_model": "numpy", "_nrt": False}
    options |= {"forceinline": forceinline, "pipeline_class": _Parts}
    return numba.njit(**options)(function)
