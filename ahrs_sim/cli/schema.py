"""`ahrs-sim schema KIND`: JSON Schema of the files a user writes, for editors that complete and check."""

import argparse
import json

from ahrs_sim.cli.common import Commands


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("schema", help="print the JSON Schema of a kind of file, for an editor")
    command.add_argument("kind", choices=["scenario", "grade", "map", "suite"])
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print the schema."""
    from ahrs_sim import reference

    print(json.dumps(reference.schema(arguments.kind), indent=1))
