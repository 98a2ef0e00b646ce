"""Cost of exported estimators by target: `python benchmarks/export_size.py [--float32] [METHOD ...]`.

Needs `ziglang` to link for other machines, and `unicorn`, whose Cortex-M counts instructions and shows the stack that
is used, which is within the bound. The rows are those of a swinging flight. The table is that of docs/doors.md.
"""

import importlib.util
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.plugins import export, layout
from ahrs_sim.plugins.exercise import swinging
from estimators import SensorInfo
from estimators.emit import Emitted, emit

HERE = Path(__file__).parent
LINK = """ENTRY(table)
SECTIONS { . = 0x08000000; .table : { KEEP(*(.table)) } .text : { *(.text*) *(.rodata*) }
/DISCARD/ : { *(.ARM.exidx*) *(.ARM.extab*) } . = 0x20000000; .data : { *(.data*) } .bss : { *(.bss*) *(COMMON) } }
"""
TABLE = """#include "ahrs_estimator.h"
__attribute__((section(".table"), used))
const void *const table[] = {(const void *)ahrs_create, (const void *)ahrs_process};
"""
COUNTED_FROM, COUNTED = 1500, 20  # rows
WRAPPER = 300  # bytes of stack of the wrapper in C, and of the compiler's run time
CORES = {"cortex-m4f": "cortex_m4", "cortex-m7": "cortex_m7"}


def available(*modules: str) -> bool:
    """Whether the packages are installed."""
    return all(importlib.util.find_spec(name) for name in modules)


def link(folder: Path, name: str, target: str) -> Path:
    """Link an exported folder for a target: a program for the emulator, or a WebAssembly module."""
    zig = [sys.executable, "-m", "ziglang", "cc", "-O2", "-std=c99", "-ffp-contract=off", "-g0"]
    sources = [f"{name}.c", f"{name}_kernels.o"]
    if target == "wasm32":
        kept = [f"-Wl,--export={symbol}" for symbol in ("ahrs_create", "ahrs_process", "__heap_base")]
        command = [*zig, "-target", "wasm32-freestanding", "-Wl,--no-entry", *kept]
        made = folder / f"{name}.wasm"
    else:
        (folder / "link.ld").write_text(LINK)
        (folder / "table.c").write_text(TABLE)
        command = [*zig, "-target", "thumb-freestanding-eabihf", f"-mcpu={CORES[target]}", "-T", "link.ld", "table.c"]
        made = folder / f"{name}.elf"
    subprocess.run([*command, "-o", made.name, *sources], cwd=folder, check=True, capture_output=True)
    return made


class Board:
    """A Cortex-M in the emulator, with an estimator in its memory."""

    FLASH, RAM, DATA, STACK, RETURN = 0x08000000, 0x20000000, 0x60000000, 0x70000000, 0x08700000

    def __init__(self, program: Path) -> None:
        import unicorn
        from unicorn import arm_const

        self._arm = arm_const
        self.machine = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB)
        self.machine.ctl_set_cpu_model(arm_const.UC_CPU_ARM_MAX)  # its Cortex-M7 has no arithmetic of doubles
        for base in (self.FLASH, self.RAM, self.DATA, self.STACK):
            self.machine.mem_map(base, 0x800000)
        code = program.read_bytes()
        (offset,), (count,) = struct.unpack_from("<I", code, 28), struct.unpack_from("<H", code, 44)
        for i in range(count):
            kind, at, address, _, size, _ = struct.unpack_from("<6I", code, offset + 32 * i)
            if kind == 1 and size:
                self.machine.mem_write(address, code[at : at + size])
        access = self.machine.reg_read(arm_const.UC_ARM_REG_C1_C0_2)
        self.machine.reg_write(arm_const.UC_ARM_REG_C1_C0_2, access | 0xF << 20)
        self.machine.reg_write(arm_const.UC_ARM_REG_FPEXC, 0x40000000)
        self._create, self._step = struct.unpack("<2I", self.machine.mem_read(self.FLASH, 8))
        self.instructions = 0

    def call(self, function: int, *arguments: int) -> int:
        """Call a function with up to four words."""
        arm = self._arm
        registers = (arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3)
        for register, value in zip(registers, arguments, strict=False):
            self.machine.reg_write(register, value)
        self.machine.reg_write(arm.UC_ARM_REG_SP, self.STACK + 0x400000)
        self.machine.reg_write(arm.UC_ARM_REG_LR, self.RETURN | 1)
        self.machine.emu_start(function | 1, self.RETURN)
        return int(self.machine.reg_read(arm.UC_ARM_REG_R0))

    def begin(self, known: bytes) -> None:
        """Make the estimator, once, of the bytes of site and sensors."""
        self.machine.mem_write(self.DATA, known)
        self._made = self.call(self._create, self.DATA, self.DATA + 56, 0)
        if not self._made:
            raise RuntimeError("ahrs_create returned NULL")

    def process(self, rows: np.ndarray) -> bytes:
        """Give it samples; the bytes of the estimates."""
        into, out, answers = self.DATA + 0x1000, self.DATA + 0x100000, b""
        for first in range(0, len(rows), 100):
            part = rows[first : first + 100]
            blank = np.zeros(len(part), layout.ESTIMATE)
            layout.blank_estimates(part["t"], blank)
            self.machine.mem_write(into, part.tobytes())
            self.machine.mem_write(out, blank.tobytes())
            if self.call(self._step, self._made, into, len(part), out):
                raise RuntimeError("ahrs_process failed")
            answers += bytes(self.machine.mem_read(out, blank.nbytes))
        return answers

    def count(self) -> None:
        """Count instructions from here on."""
        import unicorn

        def one(*_: Any) -> None:
            self.instructions += 1

        self.machine.ctl_remove_cache(self.FLASH, self.FLASH + 0x700000)
        self.machine.hook_add(unicorn.UC_HOOK_CODE, one)

    def stack(self) -> int:
        """The most bytes of stack that were used."""
        memory = np.frombuffer(self.machine.mem_read(self.STACK, 0x400000), np.uint8)
        return 0x400000 - int(np.argmax(memory != 0))


def rows_of(block: Any) -> np.ndarray:
    """Samples as structures of the interface."""
    rows = np.zeros(len(block.t), layout.SAMPLE)
    layout.write_samples(block, rows)
    return rows


def measured(method: str, target: str, made: Emitted, sensors: SensorInfo) -> str:
    """A row of the table."""
    block, site = swinging(20.0)
    work, deepest = "", 0
    with tempfile.TemporaryDirectory() as folder:
        export.write(method, {}, "chr", sensors, target, made, Path(folder) / "code")
        if target in CORES and available("ziglang", "unicorn"):
            board = Board(link(Path(folder) / "code", method.replace("-", "_"), target))
            rows = rows_of(block)
            board.begin(layout.constants(site) + layout.constants(sensors))
            board.process(rows[:COUNTED_FROM])
            board.count()
            board.process(rows[COUNTED_FROM : COUNTED_FROM + COUNTED])
            deepest, work = board.stack(), f"{board.instructions / COUNTED / 1000:.1f}"
    assert deepest <= made.stack + WRAPPER, (method, target, deepest, made.stack)
    assert made.operations is not None
    sizes = f"{made.text / 1000:.0f} | {made.memory / 1000:.1f} | {made.stack / 1000:.1f}"
    precision = " float32" if made.single else ""
    return f"| `{method}`{precision} | {target} | {sizes} | {work} | {made.operations[0] / 1000:.1f} |"


def main() -> None:
    """Print the table."""
    single = "--float32" in sys.argv
    methods = [a for a in sys.argv[1:] if a != "--float32"] or ["marg-ekf", "marg-ckf", "sekf", "ins21", "ins-cal"]
    sensors, (exercise, place) = export.suite_info("chr", "circuit"), swinging()
    columns = "method | target | code, kB | memory, kB | stack, kB | 1000 instructions a row | 1000 operations a row"
    print(f"| {columns} |\n|{'---|' * 7}")
    for method in methods:
        targets = ["cortex-m4f"] if single else export.TARGETS  # it has no arithmetic of doubles
        for target, made in emit(method, {}, place, sensors, targets, exercise, single).items():
            print(measured(method, target, made, sensors), flush=True)


if __name__ == "__main__":
    main()
