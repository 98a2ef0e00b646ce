"""`ahrs-sim export-page -o try.html`: estimators in a page that runs them in a browser, on recordings dropped on it."""

import argparse
from pathlib import Path

from ahrs_sim.cli.common import Commands, Progress, add_estimators


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("export-page", help="estimators in one page that runs them in a browser")
    command.add_argument(
        "scenario", nargs="?", default="circuit", help="whose estimators go into the page (default: circuit)"
    )
    add_estimators(command, "of the scenario, or METHOD@SUITE; may be repeated")
    command.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="the page, NAME.html")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Write the page and print its size."""
    from ahrs_sim.review import estimator_page

    progress = Progress("exporting", unit="estimators")
    size = estimator_page.write(arguments.output, arguments.scenario, arguments.estimator, progress)
    Progress.clear()
    print(f"{arguments.output}: {size / 1e6:.1f} MB; open it in a browser and drop a log on it")
