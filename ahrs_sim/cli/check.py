"""`ahrs-sim check`: accuracy of a suite of flights against its baseline."""

import argparse
import json
from pathlib import Path

from ahrs_sim.cli.common import Commands, Progress, add_code, count, gate
from ahrs_sim.errors import InputError


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser(
        "check", help="compare the accuracy of a suite of flights with its baseline; exit 1 when worse"
    )
    command.add_argument("suite", nargs="?", help="a TOML file (default: the standard suite in tests/baselines)")
    command.add_argument("--renew", action="store_true", help="store the present accuracy as the baseline; needs --why")
    command.add_argument("--why", metavar="TEXT", help="reason, kept in the baseline's history")
    add_code(command)
    command.add_argument("--workers", type=count, metavar="N", help="processes (default: one per processor)")
    command.add_argument("--all", action="store_true", help="list unchanged figures, too")
    command.add_argument("--junit", type=Path, metavar="FILE", help="write the result as JUnit XML")
    form = command.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print JSON")
    form.add_argument("--markdown", action="store_true", help="print a comment for a pull request")
    return command


def run(arguments: argparse.Namespace) -> int:
    """Fly a suite and compare its accuracy with the baseline, or renew the baseline; returns 1 when worse."""
    from ahrs_sim.runs import check, check_baseline, check_report, check_suite

    if arguments.renew != bool(arguments.why):
        raise InputError("check: --renew and --why TEXT go together: a baseline changes for a reason")
    suite = check_suite.load(arguments.suite, gate(arguments.allow_code))
    if not arguments.renew:
        check_baseline.read(suite)  # a missing one is reported before anything flies
    progress = Progress(f"flying {suite.name}", unit="flights", hidden=arguments.json)
    found = check.fly(suite, workers=arguments.workers, progress=progress)
    Progress.clear()
    if arguments.renew:
        check_baseline.renew(suite, found, arguments.why)
        print(f"{suite.baseline}: renewed")
        return 0
    result = check.compare(suite, found)
    if arguments.junit:
        arguments.junit.write_text(check_report.junit(result), encoding="utf-8")
    if arguments.json:
        print(json.dumps(check_report.as_json(result), indent=1))
    elif arguments.markdown:
        print(check_report.markdown(result))
    else:
        print(check_report.table(result, everything=arguments.all))
    return 0 if result.passed else 1
