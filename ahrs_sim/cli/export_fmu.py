"""`ahrs-sim export-fmu METHOD|--sensors SUITE -o FILE.fmu`: an estimator or a sensor suite as a co-simulation unit."""

import argparse
from pathlib import Path

from ahrs_sim.cli.common import Commands
from ahrs_sim.cli.export_code import add_choice, chosen
from ahrs_sim.errors import InputError


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser(
        "export-fmu", help="write an estimator or a sensor suite as a co-simulation unit (FMI)"
    )
    add_choice(command, optional=True)
    command.add_argument(
        "--sensors", metavar="SUITE", help="suite to write instead of a METHOD: truth in, readings out"
    )
    command.add_argument("--fmi", choices=("2.0", "3.0"), default="2.0", help="version of the standard (default: 2.0)")
    command.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="a new file, NAME.fmu")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Write the unit and print how to use it."""
    from ahrs_sim.plugins import export_fmu

    output = arguments.output
    if (arguments.method is None) == (arguments.sensors is None):
        raise InputError("export-fmu: give a METHOD, or --sensors SUITE")
    if arguments.sensors is not None:
        if arguments.setting:
            raise InputError("export-fmu: --setting is for a METHOD, not for --sensors")
        export_fmu.export_sensors(arguments.scenario, arguments.sensors, output, arguments.fmi)
        print(f"{output}: sensors of {arguments.sensors}; truth in, readings out, in steps of the truth")
        return
    settings, sensors = chosen(arguments)
    export_fmu.export_fmu(arguments.method, settings, arguments.suite, sensors, output, arguments.fmi)
    print(f"{output}: {arguments.method}; ahrs-sim fly circuit --estimator fmu:{output}@{arguments.suite}")
