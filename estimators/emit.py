"""An estimator of the catalogue as object code for another machine: its kernels, linked, without Python.

    emitted = emit("marg-ekf", {"aiding": "airspeed"}, site, sensors, ["cortex-m7"])["cortex-m7"]
    emitted.code        # an object file: ahrs_kernel_process, ahrs_kernel_forget and what they call
    emitted.blocks      # the memory that they work on, with its first contents

Numba compiles for the machine it runs on, and has no intermediate code of what comes from its cache. A process of its
own therefore compiles the kernels afresh, without optimisation and with rows only as long as this method needs, and
LLVM does the rest for the target. The intermediate code is kept on disk beside the compiled kernels: methods whose rows
have the same length share it. The arithmetic is the same: nothing is contracted or reordered, and all functions that
differ from one C library to the next are those of `estimators.elementary`.
"""

import functools
import hashlib
import json
import os
import pickle
import re
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from estimators import emit_costs as costs
from estimators.emit_single import image
from estimators.emit_single import single as as_single
from estimators.errors import SettingError
from estimators.records import pack
from estimators.types import Samples, SensorInfo, Site


class Target(NamedTuple):
    """A machine, as LLVM knows it."""

    triple: str
    cpu: str = ""
    features: str = ""
    abi: str = ""
    relocation: str = "static"
    model: str = "default"
    return_address: int = 0  # bytes that a call puts on the stack outside of the frames
    red_zone: int = 0  # bytes below the stack that a function may use which calls none
    has_sqrt: bool = True  # an instruction for the square root of a double


TARGETS = {
    "x86_64-linux": Target("x86_64-unknown-linux-gnu", relocation="pic", return_address=8, red_zone=128),
    "aarch64-linux": Target("aarch64-unknown-linux-gnu", relocation="pic"),
    "cortex-m4f": Target("thumbv7em-unknown-none-eabihf", "cortex-m4", has_sqrt=False),
    "cortex-m7": Target("thumbv7em-unknown-none-eabihf", "cortex-m7", "+fp-armv8d16"),
    "wasm32": Target("wasm32-unknown-unknown"),
    "riscv32": Target("riscv32-unknown-elf", "generic-rv32", "+m,+a,+c,+f,+d", "ilp32d"),
}
"""Machines that code can be exported for, by name."""

PREFIX = "ahrs_kernel_"


@dataclass(frozen=True)
class Block:
    """A piece of memory."""

    size: int  # bytes
    image: bytes  # its first contents; empty: zeros
    addresses: Mapping[int, str]  # by offset, what a field points to: a block or a kernel
    constant: bool = False  # never written


@dataclass(frozen=True)
class Emitted:
    """An estimator for a target."""

    code: bytes  # object file
    blocks: Mapping[str, Block]
    text: int  # bytes of instructions and constants
    stack: int  # bytes at most
    operations: tuple[float, int] | None  # of numbers in a row of samples, mean and most; None: not counted
    single: bool = False  # floats in the places of doubles, see `emit_single`

    @property
    def memory(self) -> int:
        """Bytes of static memory."""
        return sum(block.size for block in self.blocks.values() if not block.constant)

    @property
    def constant(self) -> int:
        """Bytes of the memory's first contents."""
        return sum(len(block.image) for block in self.blocks.values())


def emit(
    name: str, settings: Mapping[str, Any], site: Site, sensors: SensorInfo, targets: Iterable[str],
    exercise: Samples | None = None, single: bool = False,
) -> dict[str, Emitted]:  # fmt: skip
    """Compile a method with these settings for some of `TARGETS`; what there is by target.

    Args:
        name: of the method.
        settings: those that differ from its defaults.
        site: place and field of `exercise`, else any.
        sensors: data sheet figures.
        targets: names of `TARGETS`.
        exercise: samples that the code is run on here, to count operations from its alignment on.
        single: numbers are floats instead of doubles.

    Raises:
        SettingError: a method that is not of the catalogue.
    """
    from estimators.catalogue import create
    from estimators.estimator import Compiled
    from estimators.jit import FOLDER

    made = create(name, site=site, sensors=sensors, **settings)
    if not isinstance(made, Compiled):
        raise SettingError(f"{name} cannot be exported as code: it is not of the catalogue ({type(made).__name__})")
    with tempfile.TemporaryDirectory() as folder:
        environment = {
            **os.environ, "NUMBA_CACHE_DIR": folder, "NUMBA_OPT": "0", "NUMBA_LOOP_VECTORIZE": "0",
            "NUMBA_SLP_VECTORIZE": "0", "NUMBA_DISABLE_JIT": "0", "AHRS_SIM_ROW": str(made.row_length()),
            "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]),
        }  # fmt: skip
        task: dict[str, Any] = {
            "name": name,
            "settings": dict(settings),
            "site": asdict(site),
            "sensors": asdict(sensors),
        }
        task |= {"targets": list(targets), "folder": folder, "exercised": exercise is not None, "single": single}
        task["kept"] = str(FOLDER)
        if exercise is not None:
            pack(exercise).tofile(Path(folder) / "exercise")
        command = [sys.executable, "-W", "ignore", "-c", "from estimators.emit import _main; _main()"]
        ran = subprocess.run(command, input=json.dumps(task), env=environment, capture_output=True, text=True)
        if ran.returncode != 0:
            raise RuntimeError(f"{name} cannot be emitted: {ran.stderr.strip()}")
        found = json.loads((Path(folder) / "blocks.json").read_text())
        codes = {target: (Path(folder) / f"{target}.o").read_bytes() for target in task["targets"]}
    blocks = {
        key: Block(b["size"], bytes.fromhex(b["image"]), {int(k): v for k, v in b["addresses"].items()}, b["constant"])
        for key, b in found["blocks"].items()
    }
    operations = found["operations"] and tuple(found["operations"])
    return {t: Emitted(code, blocks, _size(code), found["stack"][t], operations, single) for t, code in codes.items()}


# In the process of its own


def _main() -> None:
    task = json.loads(sys.stdin.read())
    from estimators import native

    kernels: dict[str, tuple[str, str]] = {}  # by entry: symbol, intermediate code

    def collected(name: str, function: Any, arguments: str, returns: Any) -> int:
        entry = name.rpartition(".")[2]
        kernels[entry] = _intermediate(Path(task["kept"]), name, lambda: native.cfunc(function, arguments, returns))
        return _fake(len(kernels) - 1)

    native.compiled = collected
    estimator = _estimator(task)
    parts, instance = estimator.assemble()
    records = {**parts, "instance": instance}
    blocks = _blocks(records, list(kernels), image if task["single"] else np.ndarray.tobytes)
    blocks["work"] = replace(blocks["work"], size=estimator.work_size(), image=b"")
    folder, stack = Path(task["folder"]), {}
    written = (
        {entry: (symbol, as_single(code)) for entry, (symbol, code) in kernels.items()} if task["single"] else kernels
    )
    for target in task["targets"]:
        machine = TARGETS[target]._replace(has_sqrt=True) if task["single"] else TARGETS[target]
        code, stack[target] = _object(written, machine, blocks)
        (folder / f"{target}.o").write_bytes(code)
    described = {
        name: {"size": b.size, "image": b.image.hex(), "addresses": dict(b.addresses), "constant": b.constant}
        for name, b in blocks.items()
    }
    operations = _operations(kernels, records, blocks, folder / "exercise") if task["exercised"] else None
    (folder / "blocks.json").write_text(json.dumps({"blocks": described, "stack": stack, "operations": operations}))


def _intermediate(kept: Path, name: str, compiled: Callable[[], Any]) -> tuple[str, str]:
    """Symbol and intermediate code of a kernel: read from the folder `kept`, or compiled and put there.

    It depends on the length of rows and on the machine that compiles, besides what `kept` is named by.
    """
    from numba.core import registry

    from estimators import native

    made_for = (native.CAPACITY, registry.cpu_target.target_context.codegen().magic_tuple())
    path = kept / f"{name}.{hashlib.sha256(repr(made_for).encode()).hexdigest()[:12]}.code"
    try:
        symbol, code = pickle.loads(zlib.decompress(path.read_bytes()))
    except (OSError, EOFError, ValueError, zlib.error, pickle.UnpicklingError):
        made = compiled()
        symbol, code = made.native_name, _named_by_contents(made._library.get_llvm_str())
        native.store(path, zlib.compress(pickle.dumps((symbol, code)), 1))
    return symbol, code


def _named_by_contents(code: str) -> str:
    """Name the functions that kernels share after what they do.

    Numba numbers functions as they come in a process: two of the same name may be different ones, and one has as many
    names as there were processes. Kernels of several processes are linked by these names.
    """
    defined = {found["function"] or found["variable"]: found for found in _DEFINED.finditer(code)}
    notes = dict(re.findall(r"^!(\d+) = (.*)$", code, re.MULTILINE))  # numbered by kernel

    @functools.cache
    def contents(name: str) -> str:
        if name not in defined:
            return name
        text = _NAME.sub(lambda used: "" if used[1] == name else contents(used[1]), defined[name][0])
        text = _OBJECT.sub("", _NOTE.sub(lambda used: notes.get(used[1], ""), text))
        return hashlib.sha256(text.encode()).hexdigest()

    shared = {name for name, found in defined.items() if found["linkage"] == "linkonce_odr"}
    first = {contents(name): name for name in reversed(defined) if name in shared}

    def once(found: re.Match[str]) -> str:
        name = found["function"]
        return "" if name in shared and first[contents(name)] != name else found[0]

    def renamed(used: re.Match[str]) -> str:
        return f"@inner.{contents(used[1])}" if used[1] in shared else used[0]

    return _NAME.sub(renamed, _DEFINED.sub(once, code))


_DEFINED = re.compile(
    r"^define (?P<linkage>\w+) [^@]*@(?P<function>[\w.$]+)\(.*?^}|^@(?P<variable>\"[^\"]+\"|[\w.$]+) = [^\n]*$",
    re.MULTILINE | re.DOTALL,
)
_NAME = re.compile(r"@(\"[^\"]+\"|[\w.$]+)")
_NOTE = re.compile(r"!(\d+)\b")
_OBJECT = re.compile(r"inttoptr \(i64 \d+ to ptr\)")  # of Python, for exceptions that kernels do not raise


def _operations(
    kernels: Mapping[str, tuple[str, str]], records: Mapping[str, Any], blocks: Mapping[str, Block], exercise: Path
) -> tuple[float, int]:
    """Operations of doubles in a row of samples once the method is aligned, mean and most."""
    from llvmlite import binding as llvm  # type: ignore[import-untyped]

    from estimators.records import SAMPLE

    here = Target(llvm.get_process_triple(), relocation="default", model="jitdefault")
    whole, machine = _optimised(kernels, here)
    rows = np.fromfile(exercise, SAMPLE)
    found = costs.operations(costs.counting(str(whole)), machine, records, blocks, rows, PREFIX)
    return float(found.mean()), int(found.max())


def _estimator(task: Mapping[str, Any]) -> Any:
    from estimators.catalogue import create

    def frozen(values: Mapping[str, Any]) -> dict[str, Any]:
        return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}

    site, sensors = Site(**frozen(task["site"])), SensorInfo(**frozen(task["sensors"]))
    return create(task["name"], site=site, sensors=sensors, **task["settings"])


def _fake(number: int) -> int:
    """An address that stands for a kernel: none that memory has."""
    return -1 - number


def _blocks(records: Mapping[str, Any], kernels: list[str], image: Callable[[np.ndarray], bytes]) -> dict[str, Block]:
    """The records' memory, with names in the place of addresses."""
    known = {record.data.ctypes.data: name for name, record in records.items()}
    return {name: _block(name, image(record.data), known, kernels) for name, record in records.items()}


def _block(name: str, contents: bytes, known: Mapping[int, str], kernels: list[str]) -> Block:
    image, addresses = bytearray(contents), {}
    for offset in range(0, len(image) - len(image) % 8, 8) if name in _POINTING else ():
        value = int(np.frombuffer(image, np.int64, 1, offset)[0])
        if value in known:
            addresses[offset] = known[value]
        elif -len(kernels) <= value < 0:
            addresses[offset] = PREFIX + kernels[-1 - value]
        else:
            continue
        image[offset : offset + 8] = bytes(8)
    known_first = any(image) and name not in _SET_BY_KERNELS
    return Block(len(image), bytes(image) if known_first else b"", addresses, name in _CONSTANT)


_POINTING = ("instance", "method", "policy", "model", "work")
_CONSTANT = ("blank",)
_SET_BY_KERNELS = ("stretch", "memory", "parameters", "policy_parameters", "site", "sensors", "tape")


def _object(kernels: Mapping[str, tuple[str, str]], target: Target, blocks: Mapping[str, Block]) -> tuple[bytes, int]:
    """Compile intermediate code for the target: an object file, and the most bytes of stack."""
    whole, machine = _optimised(kernels, target)
    with costs.frames() as sizes:
        made: bytes = machine.emit_object(whole)
    deepest = costs.stack(str(whole), sizes, blocks, PREFIX, target.return_address)
    return made, deepest + target.red_zone


def _optimised(kernels: Mapping[str, tuple[str, str]], target: Target) -> tuple[Any, Any]:
    """Link and optimise intermediate code for a target: LLVM's module and target machine."""
    from llvmlite import binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu,
        features=target.features,
        opt=2,
        reloc=target.relocation,
        codemodel=target.model,
        abiname=target.abi,
    )
    whole = llvm.parse_assembly(_NO_PYTHON + ("" if target.has_sqrt else _SQRT))
    for entry, (symbol, code) in kernels.items():
        module = llvm.parse_assembly(_portable(code, target, str(machine.target_data)))
        module.get_function(symbol).name = PREFIX + entry
        whole.link_in(module)
    whole.triple, whole.data_layout = target.triple, str(machine.target_data)
    for number, value in enumerate((*whole.functions, *whole.global_variables)):
        if not value.is_declaration and not value.name.startswith(PREFIX):
            value.linkage, value.name = "internal", f"inner.{number}"
        elif not value.is_declaration:
            value.linkage = "external"
    whole.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.loop_vectorization = options.slp_vectorization = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(whole, builder)
    foreign = {f.name for f in whole.functions if f.is_declaration and _FOREIGN.match(f.name)}
    foreign -= {"llvm.sqrt.f64", "llvm.sqrt.f32"} if target.has_sqrt else set()
    if foreign:
        raise RuntimeError(f"kernels call {', '.join(foreign)}, which differ between C libraries")
    return whole, machine


_FOREIGN = re.compile(
    rf"(?!llvm\.|{PREFIX}|mem(?:set|cpy)$)|llvm\.(sqrt|pow|exp|log|sin|cos|tan|floor|ceil|trunc|rint|round|fma)"
)
"""Functions that code must not call: of a C library, or intrinsic ones that some machines have from there."""


def _size(code: bytes) -> int:
    """Bytes of instructions and constants of an object file."""
    from llvmlite import binding as llvm

    parts = llvm.ObjectFileRef.from_data(code).sections()
    return sum(part.size() for part in parts if re.match(rb"\.(text|rodata)|CODE|DATA", part.name() or b""))


def _portable(code: str, target: Target, layout: str) -> str:
    """Intermediate code without what belongs to the machine that Numba ran on."""
    code = re.sub(r"^target (triple|datalayout) = .*$", "", code, flags=re.MULTILINE)
    code = f'target datalayout = "{layout}"\ntarget triple = "{target.triple}"\n{code}'
    code = costs.watched(re.sub(r'"target-(cpu|features)"="[^"]*"', "", code))
    return re.sub(r"@(llvm\.sqrt\.f64|sqrt)\b", "@llvm.sqrt.f64" if target.has_sqrt else "@root", code)


_SQRT = f"""
declare void @{PREFIX}sqrt(ptr)
define double @root(double %x) {{
  %place = alloca double
  store double %x, ptr %place
  call void @{PREFIX}sqrt(ptr %place)
  %y = load double, ptr %place
  ret double %y
}}
"""
"""By address: how doubles are passed on machines without their arithmetic is not the same for all compilers."""


_NO_PYTHON = """
declare void @llvm.trap()
define i32 @numba_gil_ensure() {
  call void @llvm.trap()
  unreachable
}
"""
"""No kernel raises; what would report it to an interpreter ends the program instead."""
