"""`ahrs-sim allan`: Allan deviation of the inertial channels of a log."""

import argparse
import json
from pathlib import Path

from ahrs_sim.cli.common import Commands, add_map


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("allan", help="compute the Allan deviation of inertial channels")
    command.add_argument("log", type=Path, help="a log, or any recording that replay reads")
    command.add_argument("--topic", action="append", default=[], help="an Imu topic (default: all); may be repeated")
    add_map(command)
    command.add_argument("--plot", type=Path, metavar="PNG", help="draw the curves")
    command.add_argument("--json", action="store_true", help="print JSON")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print the Allan deviation of the inertial channels of a log; draw the curves when asked for."""
    from ahrs_sim.review import allan

    result = allan.of_log(arguments.log, topics=arguments.topic, map_file=arguments.map)
    print(json.dumps(allan.as_json(result), indent=1) if arguments.json else allan.text(result))
    if arguments.plot:
        allan.plot(result, arguments.plot)
