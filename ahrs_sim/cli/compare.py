"""`ahrs-sim compare`: accuracy of every estimator in a log."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from ahrs_sim.cli.common import Commands, add_span


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("compare", help="print the accuracy of every estimator in a log")
    command.add_argument("log", type=Path, nargs="+", help="logs of ours")
    command.add_argument(
        "--reference",
        metavar="NAME",
        help="take errors against an estimator, an orientation topic or smoothed, not the truth",
    )
    command.add_argument("--align", choices=["heading", "frames"], help="remove a constant rotation before comparing")
    command.add_argument("--sync", action="store_true", help="remove a constant delay before comparing")
    command.add_argument("--against", metavar="NAME", help="add paired differences of every estimator from this one")
    add_span(command)
    command.add_argument("--lag", action="store_true", help="print the delay of every attitude and its rate, ms")
    command.add_argument("--all", action="store_true", help="add 95th percentiles and maxima of every angle")
    command.add_argument(
        "--report", type=Path, metavar="HTML", help="write a page with all plots, to open in a browser"
    )
    command.add_argument("--png", type=Path, metavar="DIR", help="write the main figures")
    form = command.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print JSON")
    form.add_argument("--csv", action="store_true", help="print CSV")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print the accuracy of every estimator in every log; draw the report and the figures asked for."""
    from ahrs_sim.errors import InputError
    from ahrs_sim.recordings.sources import is_mcap
    from ahrs_sim.review import compare

    if foreign := [log for log in arguments.log if not is_mcap(log)]:
        raise InputError(f"{foreign[0]}: no log with estimates; 'ahrs-sim replay {foreign[0]}' makes and compares them")
    if arguments.png:
        from ahrs_sim.review import figures

        figures.require()  # before anything is computed
    span = {"reference": arguments.reference, "start": arguments.start, "end": arguments.end}
    options = {"align": arguments.align, "sync": arguments.sync}
    results = [compare.compare(log, **span, **options, against=arguments.against) for log in arguments.log]
    texts = [compare.table(result, details=arguments.all) for result in results]
    if arguments.lag:
        from ahrs_sim.review import lag

        for i, path in enumerate(arguments.log):
            late = lag.of_log(path, **span)
            texts[i] += f"\n\n{lag.table(late)}"
            for name, values in late.items():
                results[i]["estimators"][name] |= values
    if arguments.json:
        print(json.dumps(results[0] if len(results) == 1 else results, indent=1))
    elif arguments.csv:
        first, *rest = (compare.csv(result) for result in results)
        print("\n".join([first, *(text.partition("\n")[2] for text in rest)]))
    else:
        if arguments.against and len(results) > 1:
            texts[-1] += f"\n\n{compare.over_logs(results, arguments.against)}"
        titles = [f"{log}\n" if len(results) > 1 else "" for log in arguments.log]
        print("\n\n".join(title + text for title, text in zip(titles, texts, strict=True)))
    if arguments.report or arguments.png:
        _draw(arguments, span | options)


def _draw(arguments: argparse.Namespace, span: dict[str, Any]) -> None:
    from ahrs_sim.review import report, traces

    flights = [traces.gather(log, **span) for log in arguments.log]
    if arguments.report:
        size = report.write(flights, arguments.report)
        print(f"{arguments.report}: {size / 1e6:.1f} MB", file=sys.stderr)
    if arguments.png:
        from ahrs_sim.review import figures

        for flight in flights:
            print(*figures.draw(flight, arguments.png), sep="\n", file=sys.stderr)
