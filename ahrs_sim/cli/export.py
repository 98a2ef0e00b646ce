"""`ahrs-sim export`: the topics of a log as tables, or a layout of a viewer."""

import argparse
from pathlib import Path

from ahrs_sim.cli.common import Commands, add_map


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("export", help="write the topics of a log as tables, or a viewer's layout for it")
    command.add_argument("log", type=Path, help="a log, or any recording that replay reads")
    command.add_argument("--to", dest="form", choices=["parquet", "csv", "layout"], required=True)
    command.add_argument("--topic", action="append", default=[], help="only this one; may be repeated")
    add_map(command)
    command.add_argument("-o", "--output", type=Path, metavar="DIR", help="default: beside the log")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Write the topics of a log as tables, or the layout of a viewer for it."""
    from ahrs_sim.review.export import export

    if arguments.form == "layout":
        from ahrs_sim.log import layouts

        print(layouts.of_log(arguments.log, arguments.output or arguments.log.with_suffix(".layout.json")))
        return
    folder = arguments.output or _beside(arguments.log)
    print(*export(arguments.log, arguments.form, folder, arguments.topic, arguments.map), sep="\n")


def _beside(log: Path) -> Path:
    """Choose a folder named like the log; for a folder, one beside it."""
    return log.with_name(f"{log.name}_tables") if log.is_dir() else log.with_suffix("")
