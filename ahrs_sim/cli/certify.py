"""`ahrs-sim certify`: a sheet that says which requirements an estimator meets, and whether that is shown."""

import argparse
import json
import sys
import time
from pathlib import Path

from ahrs_sim.cli.common import Commands, Progress, add_code, count, gate


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser(
        "certify", help="test an estimator against requirements, manoeuvre by manoeuvre; exit 1 unless all are met"
    )
    command.add_argument(
        "estimators", nargs="+", metavar="ESTIMATOR[@SUITE]", help="SUITE: chr (default), sbg, ideal, or a grade"
    )
    command.add_argument("--limits", metavar="TOML", help="requirements of your own, laid over the shipped standard")
    command.add_argument(
        "--runs", type=count, metavar="N", help="flights of each kind (default: the fewest that can show it)"
    )
    command.add_argument("-o", "--output", metavar="DIR", help="folder of the flights (default: logs/certify-NAME...)")
    where = command.add_mutually_exclusive_group()
    where.add_argument("--workers", type=count, metavar="N", help="processes (default: one per processor)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="run on a Dask cluster, e.g. tcp://head:8786")
    add_code(command)
    command.add_argument(
        "--html", type=Path, metavar="FILE", help="write a page with links to the worst moments in reports"
    )
    command.add_argument("--junit", type=Path, metavar="FILE", help="write the result as JUnit XML")
    form = command.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print JSON")
    form.add_argument("--markdown", action="store_true", help="print a page such as docs/certify.md")
    return command


def run(arguments: argparse.Namespace) -> int:
    """Fly what a standard asks for and print a sheet an estimator; returns 1 when not all is shown to be met."""
    from ahrs_sim.runs import certify, certify_sheet
    from ahrs_sim.runs import pool as pools
    from ahrs_sim.scenario.code import named

    standard = certify.load(arguments.limits)
    runs = arguments.runs or standard.runs
    chosen = certify.candidates(standard, arguments.estimators)
    allowed = gate([*arguments.allow_code, *named(arguments.estimators)], arguments.json)
    plans = certify.plans(standard, chosen, runs, allowed)
    folder = arguments.output or f"logs/certify-{'+'.join(chosen)}"
    begun = time.perf_counter()
    with pools.pool(arguments.workers, arguments.scheduler) as pool:
        stores = certify.fly(
            plans, folder, pool, lambda name: Progress(f"flying {name}", unit="runs", hidden=arguments.json)
        )
    seconds = time.perf_counter() - begun
    sheets = certify.evaluate(standard, chosen, stores, runs)
    if arguments.html:
        with pools.local_pool(arguments.workers) as pool:  # the workers of a cluster may not see this disk
            links = certify_sheet.reports(
                plans, sheets, arguments.html.with_name(f"{arguments.html.stem}-reports"), pool
            )
        arguments.html.write_text(certify_sheet.page(standard, sheets, links), encoding="utf-8")
    Progress.clear()
    if arguments.junit:
        arguments.junit.write_text(certify_sheet.junit(sheets, seconds), encoding="utf-8")
    if arguments.json:
        print(json.dumps(certify_sheet.as_json(standard, sheets), indent=1))
    elif arguments.markdown:
        command = f"ahrs-sim certify {' '.join(arguments.estimators)} --runs {runs} --markdown"
        print(certify_sheet.markdown(standard, sheets, command), end="")
    else:
        print("\n\n".join(certify_sheet.text(standard, sheet) for sheet in sheets))
        print(f"flights in {folder}", file=sys.stderr)
    return 0 if all(sheet.passed for sheet in sheets) else 1
