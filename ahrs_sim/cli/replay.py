"""`ahrs-sim replay`: run estimators on a log or on a recording."""

import argparse
import contextlib
import json
import sys
from pathlib import Path

from ahrs_sim.cli.common import (
    Commands,
    Progress,
    add_code,
    add_estimators,
    add_live,
    add_span,
    gate,
    moment,
    open_live,
    positive,
    temporary_folder,
)


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("replay", help="run estimators on a log or on a recording of a real vehicle")
    command.add_argument("log", type=Path, help="a log of ours or any recording (docs/replay.md)")
    command.add_argument(
        "-o", "--output", type=Path, metavar="OUT", help="write the input's messages and the estimates"
    )
    add_estimators(command, "of the log's scenario or the map, METHOD@SUITE, or METHOD for a bag; may be repeated")
    add_code(command)
    command.add_argument(
        "--map", type=Path, metavar="TOML", help="name topics and axes of a recording (docs/replay.md), or preset:NAME"
    )
    command.add_argument("--date", type=moment, help="set the date of a log whose times start near 0: 2026-06-01")
    command.add_argument(
        "--calibrate",
        action="append",
        default=[],
        choices=["mag", "gyro", "auto", "none"],
        help="calibrate from the recording itself; auto (default): hard and soft iron, if the rest agrees",
    )
    add_span(command, "errors ")
    command.add_argument("--skip", type=positive, metavar="S", help="start estimators S seconds into the log")
    command.add_argument("--until", type=positive, metavar="S", help="end estimators S seconds into the log")
    command.add_argument("--align", choices=["heading", "frames"], help="remove a constant rotation before comparing")
    command.add_argument(
        "--smooth",
        action="store_true",
        help="add estimates smoothed over the whole recording, as /est/NAME_smoothed (ins-cal)",
    )
    command.add_argument(
        "--sync", action="store_true", help="remove the delay of a recording's reference from its gyro"
    )
    command.add_argument("--reference", metavar="TOPIC", help="take errors against this attitude of the recording")
    command.add_argument(
        "--find",
        action="store_true",
        help="only find the installation: delays, lever arm, boresight, scale",
    )
    command.add_argument("--force", action="store_true", help="replace an existing log")
    command.add_argument("--all", action="store_true", help="add 95th percentiles and maxima of every angle")
    command.add_argument("--json", action="store_true", help="print the accuracy as JSON")
    add_live(command)
    return command


def run(arguments: argparse.Namespace) -> None:
    """Run estimators on a log or a recording and print the accuracy table."""
    from ahrs_sim import playback
    from ahrs_sim.errors import FlightError

    if arguments.find:
        _find(arguments)
        return
    changed = arguments.map or arguments.calibrate or arguments.sync or arguments.align
    changed = changed or arguments.smooth or arguments.skip or arguments.until or arguments.reference or arguments.date
    if not (arguments.output or changed or arguments.live is not None) and _evaluate_only(arguments):
        return
    live = open_live(arguments)
    with live or contextlib.nullcontext(), temporary_folder() as folder:
        output = arguments.output or Path(folder) / arguments.log.with_suffix(".mcap").name
        failure, notes = None, []
        try:
            notes = playback.replay(
                arguments.log,
                output,
                estimators=arguments.estimator,
                map_file=arguments.map,
                calibrate=arguments.calibrate or ["auto"],
                sync=arguments.sync,
                reference=arguments.reference,
                date=arguments.date,
                skip=arguments.skip,
                until=arguments.until,
                only_estimates=arguments.output is None and live is None,
                smooth=arguments.smooth,
                force=arguments.force,
                live=live,
                gate=gate(arguments.allow_code),
                progress=Progress(f"replaying {arguments.log.name}", hidden=arguments.json),
            )
        except FlightError as error:
            failure = error  # the accuracy of the others comes first
        Progress.clear()
        if notes and not arguments.json:
            print("\n".join(notes), end="\n\n")
        result = playback.accuracy(output, start=arguments.start, end=arguments.end, align=arguments.align)
        missing = playback.unknown(output, result) if result else []
    if result is None:
        print("no truth and no reference attitude in it: nothing to compare with", file=sys.stderr)
        return
    from ahrs_sim.review import compare

    result["log"] = str(arguments.output or arguments.log)
    text = compare.table(result, details=arguments.all, reasons=missing)
    print(json.dumps(result, indent=1) if arguments.json else text)
    if arguments.output and not arguments.json:
        print(arguments.output)
    if failure:
        raise failure


def _find(arguments: argparse.Namespace) -> None:
    """Print how the sensors of a recording are installed, and the lines for a map."""
    import math

    from ahrs_sim.recordings.recording import open_bag

    span = (arguments.skip or 0.0, arguments.until or math.inf)
    calibrate = arguments.calibrate or ["auto"]
    with open_bag(arguments.log, map_file=arguments.map, calibrate=calibrate, span=span) as bag:
        found = bag.installation()
        print("\n".join([*bag.notes, "", *found.lines]))
    lines = found.toml()
    print(f"\nlines for a map:\n{lines}" if lines else "\nnothing to put into a map")


def _evaluate_only(arguments: argparse.Namespace) -> bool:
    """Print how good estimators are on a log of ours, of which nothing has to be kept; false: not a log of ours."""
    from ahrs_sim import playback

    result = playback.evaluate(
        arguments.log,
        estimators=arguments.estimator,
        start=arguments.start,
        end=arguments.end,
        gate=gate(arguments.allow_code),
        progress=Progress(f"replaying {arguments.log.name}", hidden=arguments.json),
    )
    if result is None:
        return False
    from ahrs_sim.review import compare

    Progress.clear()
    print(json.dumps(result, indent=1) if arguments.json else compare.table(result, details=arguments.all))
    return True
