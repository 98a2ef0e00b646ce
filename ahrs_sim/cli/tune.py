"""`ahrs-sim tune`: settings of an estimator that fit a log or a recording."""

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from ahrs_sim.cli.common import Commands, Progress, add_code, gate


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("tune", help="fit an estimator's settings to a log or a recording")
    command.add_argument("log", type=Path, help="a log of ours, or any recording that replay reads")
    command.add_argument("--estimator", required=True, metavar="NAME", help="one of the log's, METHOD@SUITE, or METHOD")
    command.add_argument(
        "--setting",
        action="append",
        default=[],
        metavar="NAME[=A..B]",
        help="search this one; may be repeated (default: the noises of the method)",
    )
    command.add_argument(
        "--objective",
        choices=["likelihood", "error"],
        default="likelihood",
        help="maximise the innovation likelihood (default), or minimise the error against truth or reference",
    )
    command.add_argument(
        "--map", type=Path, metavar="FILE", help="name topics and axes of a recording (docs/replay.md)"
    )
    command.add_argument("--reference", metavar="TOPIC", help="take errors against this attitude of the recording")
    add_code(command)
    command.add_argument("--json", action="store_true", help="print JSON")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print the settings to paste and what they are worth on the half of the recording that the search has not seen."""
    from ahrs_sim.runs import log_tuning

    recorded = log_tuning.read(
        arguments.log,
        arguments.estimator,
        map_file=arguments.map,
        reference=arguments.reference,
        gate=gate(arguments.allow_code),
    )
    progress = Progress(f"tuning {recorded.method}", unit="passes", hidden=arguments.json)
    found = log_tuning.tune(recorded, arguments.setting, arguments.objective, progress)
    Progress.clear()
    print(json.dumps(asdict(found), indent=1) if arguments.json else found.text())
