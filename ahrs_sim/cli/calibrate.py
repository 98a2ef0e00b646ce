"""`ahrs-sim calibrate`: a unit's correction from a flight."""

import argparse
import math
from pathlib import Path

from ahrs_sim.cli.common import Commands, add_code, gate, positive


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("calibrate", help="write what a flight shows of a unit's errors as their correction")
    command.add_argument("log", type=Path, help="a log of ours, or any recording that replay reads")
    command.add_argument(
        "--estimator", default="ins-cal", metavar="NAME", help="one of the log's, ins-cal@SUITE, or ins-cal (default)"
    )
    command.add_argument(
        "--map", type=Path, metavar="FILE", help="name topics and axes of a recording (docs/replay.md)"
    )
    command.add_argument("--until", type=positive, metavar="S", help="use the first S seconds only")
    command.add_argument("-o", "--output", type=Path, required=True, metavar="TOML", help="write the correction")
    command.add_argument("--force", action="store_true", help="replace an existing file")
    add_code(command)
    return command


def run(arguments: argparse.Namespace) -> None:
    """Write the correction and print how much of each error the flight has shown."""
    from ahrs_sim.errors import InputError
    from ahrs_sim.runs import calibrate, log_tuning

    if arguments.output.exists() and not arguments.force:
        raise InputError(f"{arguments.output}: exists already; choose another name, overwrite with --force")
    recorded = log_tuning.read(
        arguments.log,
        arguments.estimator,
        map_file=arguments.map,
        calibrate=("none",),
        gate=gate(arguments.allow_code),
    )
    found = calibrate.calibrate(recorded, arguments.log.name, arguments.until or math.inf)
    arguments.output.write_text(found.toml(), encoding="utf-8")
    print(found.text())
    print(f'\n{arguments.output}; in a suite or a map: correction = "{arguments.output.name}"')
