"""What exported code costs: its deepest stack by LLVM's frame sizes, its operations of doubles by running it here."""

import contextlib
import ctypes
import functools
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from estimators.records import ESTIMATE, SAMPLE, blank_estimates

_WATCHED = '"warn-stack-size"="0"'  # LLVM then says on standard error how large each frame is
_FRAME = re.compile(r"stack frame size \((\d+)\) exceeds limit \(0\) in function '([^']+)'")
_FUNCTION = re.compile(r'^define [^@]*@"?([\w.]+)"?\(.*?^}$', re.MULTILINE | re.DOTALL)
_CALL = re.compile(r'\bcall [^@%\n]*?([@%])"?([\w.]+)"?\(')
_COUNTED = re.compile(r"= f(?:add|sub|mul|div)\b|call double @llvm\.sqrt\.")
_LAST = re.compile(r"^  (?:br|ret|switch|unreachable)\b", re.MULTILINE)
_LEVELS = ("instance", "method", "policy", "model")  # a kernel calls those of later ones by their addresses


def watched(code: str) -> str:
    """Intermediate code whose compilation says how large the frames are."""
    return re.sub(r"^(define .*?)((?: !dbg \S+)? \{)$", rf"\1 {_WATCHED}\2", code, flags=re.MULTILINE)


@contextlib.contextmanager
def frames() -> Iterator[dict[str, int]]:
    """Collect the bytes of the frames, by function, of what is compiled inside."""
    found: dict[str, int] = {}
    kept = os.dup(2)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            yield found
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            found.update({name: int(size) for size, name in _FRAME.findall(file.read().decode())})


def stack(code: str, sizes: Mapping[str, int], blocks: Mapping[str, Any], prefix: str, per_call: int) -> int:
    """The most bytes of stack of optimised intermediate code: the largest sum of frames along its calls.

    Args:
        code: text of the module.
        sizes: of its frames, bytes.
        blocks: `emit.Block` by name: kernels in them are called by address.
        prefix: of the kernels' names.
        per_call: bytes of a return address that belongs to no frame.
    """
    calls = {m[1]: _CALL.findall(m[0]) for m in _FUNCTION.finditer(code)}
    levels = {
        kernel: level
        for level, name in enumerate(_LEVELS, 1)
        for kernel in (blocks[name].addresses.values() if name in blocks else ())
        if kernel.startswith(prefix)
    }

    @functools.cache
    def depth(function: str, level: int) -> int:
        below = [0]
        for kind, name in calls[function]:
            if kind == "@" and name in calls:
                below.append(depth(name, level))
            elif kind == "%":
                below += [depth(kernel, of) for kernel, of in levels.items() if of > level]
        return sizes.get(function, 0) + per_call + max(below)

    return max(depth(name, levels.get(name, 0)) for name in calls if name.startswith(prefix))


def counting(code: str) -> str:
    """Optimised intermediate code that adds its operations of doubles to `@operations` while it runs."""

    def counted(function: re.Match[str]) -> str:
        parts = re.split(r"(?m)^(?=[\w.$\"]+:)", function[0])
        return "".join(_with_count(part, f"{function.start()}.{k}") for k, part in enumerate(parts))

    return (
        _FUNCTION.sub(counted, code.replace("warn-stack-size", "stack-size-known")) + "\n@operations = global i64 0\n"
    )


def _with_count(block: str, name: str) -> str:
    number, end = len(_COUNTED.findall(block)), _LAST.search(block)
    if not number or end is None:
        return block
    added = f"  %count.{name} = load i64, ptr @operations\n  %more.{name} = add i64 %count.{name}, {number}\n"
    added += f"  store i64 %more.{name}, ptr @operations\n"
    return block[: end.start()] + added + block[end.start() :]


def operations(
    code: str, machine: Any, records: Mapping[str, Any], blocks: Mapping[str, Any], rows: np.ndarray, prefix: str
) -> np.ndarray:
    """Operations of doubles (+, -, *, /, square root) of each row of samples after the first estimate, as run here.

    Args:
        code: as `counting` makes it, for this machine.
        machine: LLVM's target machine of it.
        records: the memory that the kernels work on; their addresses are put in.
        blocks: `emit.Block` by name.
        rows: samples (records); those before the first estimate are not in the answer.
        prefix: of the kernels' names.
    """
    from llvmlite import binding as llvm  # type: ignore[import-untyped]

    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(code), machine)
    engine.finalize_object()
    for name, record in records.items():
        memory = record.data.reshape(1).view(np.uint8)
        for offset, what in blocks[name].addresses.items():
            if what.startswith(prefix):
                memory[offset : offset + 8].view(np.int64)[0] = engine.get_function_address(what)
    instance = records["instance"].data.ctypes.data
    kind = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p)
    process: Callable[..., int] = kind(engine.get_function_address(f"{prefix}process"))
    ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(engine.get_function_address(f"{prefix}forget"))(instance)
    count = ctypes.c_int64.from_address(engine.get_global_value_address("operations"))
    given, out, found = rows.astype(SAMPLE), blank_estimates(len(rows)), np.empty(len(rows), np.int64)
    for k in range(len(rows)):
        count.value = 0
        at = given.ctypes.data + k * SAMPLE.itemsize
        if process(instance, at, 1, out.ctypes.data + k * ESTIMATE.itemsize) >= 0:
            raise RuntimeError(f"row {k} has an impossible time stamp")
        found[k] = count.value
    return found[np.flatnonzero(out["status"])[1:]]
