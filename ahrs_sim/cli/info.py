"""`ahrs-sim info`: what is in a log."""

import argparse
import json
from pathlib import Path

from ahrs_sim.cli.common import Commands


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("info", help="what is in a log")
    command.add_argument("log", type=Path)
    command.add_argument("--json", action="store_true")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print what is in a log."""
    from ahrs_sim.log import info

    print(json.dumps(info.summary(arguments.log), indent=1) if arguments.json else info.text(arguments.log))
