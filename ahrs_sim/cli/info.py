"""`ahrs-sim info`: what is in a log."""

import argparse
import json
from pathlib import Path

from ahrs_sim.cli.common import Commands, add_map


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("info", help="summarise a log or a recording")
    command.add_argument("log", type=Path, help="a log, or any recording that replay reads")
    add_map(command)
    command.add_argument("--all", action="store_true", help="print every topic and all metadata")
    command.add_argument("--json", action="store_true", help="print JSON")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print what is in a log."""
    from ahrs_sim.log import info
    from ahrs_sim.recordings.as_log import open_log
    from ahrs_sim.recordings.sources import is_mcap

    log = arguments.log if is_mcap(arguments.log) else open_log(arguments.log, arguments.map)
    notes = getattr(log, "notes", [])
    if arguments.json:
        print(json.dumps(info.summary(log), indent=1))
    else:
        print("\n".join([info.text(log, everything=arguments.all), *notes]))
