"""`ahrs-sim export-code METHOD --target T -o DIR`: an estimator as native code, without Python."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ahrs_sim.cli.common import Commands

if TYPE_CHECKING:
    from estimators import SensorInfo

_TARGETS = ("x86_64-linux", "aarch64-linux", "cortex-m4f", "cortex-m7", "wasm32", "riscv32")


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("export-code", help="write an estimator as native code behind a C header")
    add_choice(command)
    command.add_argument("--target", choices=_TARGETS, default="x86_64-linux", help="default: x86_64-linux")
    command.add_argument("--float32", action="store_true", help="compute in single precision")
    command.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="a new folder")
    return command


def add_choice(command: argparse.ArgumentParser, optional: bool = False) -> None:
    """Add what says which estimator, for which sensors."""
    command.add_argument(
        "method",
        nargs="?" if optional else None,
        metavar="METHOD",
        help="a method of the catalogue (ahrs-sim list estimators)",
    )
    command.add_argument(
        "--suite", default="chr", metavar="NAME", help="suite whose data sheet is built in (default: chr)"
    )
    command.add_argument(
        "--scenario", default="circuit", metavar="NAME", help="scenario that has the suite (default: circuit)"
    )
    command.add_argument(
        "--setting", action="append", default=[], metavar="NAME=VALUE", help="setting of the method; may be repeated"
    )


def chosen(arguments: argparse.Namespace) -> "tuple[dict[str, Any], SensorInfo]":
    """Settings of the method, and the data sheet of the suite."""
    from ahrs_sim.plugins import export

    settings = export.parsed(export.method(arguments.method).settings, arguments.setting)
    return settings, export.suite_info(arguments.suite, arguments.scenario)


def run(arguments: argparse.Namespace) -> None:
    """Write the folder and print its files and sizes."""
    from ahrs_sim.plugins import export

    settings, sensors = chosen(arguments)
    made = export.export(
        arguments.method, settings, arguments.suite, sensors, arguments.target, arguments.output, arguments.float32
    )
    for path in sorted(arguments.output.iterdir()):
        print(path)
    print(
        f"{arguments.method} for {arguments.target}: {made.text / 1000:.1f} kB of code, "
        f"{made.constant / 1000:.1f} kB of constants, {made.memory / 1000:.1f} kB of static memory, "
        f"at most {made.stack / 1000:.1f} kB of stack"
    )
