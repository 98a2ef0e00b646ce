"""`ahrs-sim recover`: a log of what an interrupted flight has left."""

import argparse
from pathlib import Path

from ahrs_sim.cli.common import Commands


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("recover", help="recover the log of an interrupted flight")
    command.add_argument("part", type=Path, help="LOG.part, or any truncated log")
    command.add_argument("-o", "--output", type=Path, required=True, metavar="LOG")
    command.add_argument("--force", action="store_true", help="replace an existing log")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Make a log of what an interrupted flight has left."""
    from ahrs_sim.log.mcap.recover import recover

    result = recover(arguments.part, arguments.output, force=arguments.force)
    print(f"{arguments.output}: {result}")
