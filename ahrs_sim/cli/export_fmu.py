"""`ahrs-sim export-fmu METHOD -o FILE.fmu`: an estimator as a unit for co-simulation, without Python."""

import argparse
from pathlib import Path

from ahrs_sim.cli.common import Commands
from ahrs_sim.cli.export_code import add_choice, chosen


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("export-fmu", help="write an estimator as a co-simulation unit (FMI 2.0)")
    add_choice(command)
    command.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="a new file, NAME.fmu")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Write the unit and print how to fly it."""
    from ahrs_sim.plugins.export_fmu import export_fmu

    settings, sensors = chosen(arguments)
    export_fmu(arguments.method, settings, arguments.suite, sensors, arguments.output)
    place = f"{arguments.output}@{arguments.suite}"
    print(f"{arguments.output}: {arguments.method}; ahrs-sim fly circuit --estimator fmu:{place}")
