"""The words of the command line: every command and option with its one line of help."""

import argparse
from pathlib import Path
from typing import Any


def parser() -> argparse.ArgumentParser:
    """Of all commands; `command` in what it makes is the name of the one that was given."""
    made = argparse.ArgumentParser(
        prog="ahrs-sim",
        description="Fly a model aircraft, measure it with low-cost sensors, estimate its attitude, say who was wrong.",
    )
    commands = made.add_subparsers(dest="command", metavar="COMMAND", required=True)

    fly = commands.add_parser("fly", help="fly a scenario into a log and print the accuracy table")
    fly.add_argument("scenario", nargs="?", help="a TOML file, or the name of a shipped one (ahrs-sim list scenarios)")
    fly.add_argument("--from", dest="campaign", metavar="DIR", help="instead of a scenario: a run of this campaign")
    fly.add_argument("--run", dest="number", type=_natural, metavar="N", help="with --from: which run")
    fly.add_argument("-o", "--output", type=Path, metavar="LOG", help="default: logs/SCENARIO-seedN.mcap")
    fly.add_argument("--seed", type=_natural, metavar="N", help="instead of the scenario's")
    _add_estimators(fly, "only this one, or METHOD@SUITE; may be repeated")
    fly.add_argument("--duration", type=_positive, metavar="S", help="end after S seconds")
    fly.add_argument("--pilot", metavar="NAME", help="fly on the attitude of this estimator, or on the truth")
    fly.add_argument("--force", action="store_true", help="replace an existing log")
    fly.add_argument("--block", type=_positive, metavar="S", help="seconds a block (the log does not depend on it)")
    fly.add_argument("--json", action="store_true", help="print the accuracy as JSON")
    fly.add_argument("--quiet", action="store_true", help="print nothing but errors")
    _add_live(fly)

    again = commands.add_parser("replay", help="run estimators on a log of ours or on the bag of a real vehicle")
    again.add_argument("log", type=Path, help="a log of ours, a ROS 2 bag (mcap, db3), a PX4 .ulg or a .csv")
    again.add_argument("-o", "--output", type=Path, metavar="OUT", help="write the input's messages and the estimates")
    _add_estimators(again, "of the log's scenario or the map, METHOD@SUITE, or METHOD for a bag; may be repeated")
    again.add_argument("--map", type=Path, metavar="TOML", help="what topics and axes of a bag mean (docs/replay.md)")
    again.add_argument(
        "--calibrate", action="append", default=[], choices=["mag", "gyro"], help="from the bag's own data"
    )
    _add_span(again, "errors ")
    again.add_argument("--align", choices=["heading", "frames"], help="take out a constant rotation first")
    again.add_argument("--sync", action="store_true", help="shift a bag's reference to the time of its gyro")
    again.add_argument("--force", action="store_true", help="replace an existing log")
    again.add_argument("--json", action="store_true", help="print the accuracy as JSON")
    _add_live(again)

    compare = commands.add_parser("compare", help="accuracy of every estimator in a log")
    compare.add_argument("log", type=Path, nargs="+")
    compare.add_argument("--reference", metavar="NAME", help="an estimator or any orientation topic, not the truth")
    compare.add_argument("--align", choices=["heading", "frames"], help="take out a constant rotation first")
    compare.add_argument("--sync", action="store_true", help="take out a constant delay first")
    _add_span(compare)
    compare.add_argument("--lag", action="store_true", help="how late every attitude and its rate are, ms")
    compare.add_argument("--report", type=Path, metavar="HTML", help="one page with all plots, to open in a browser")
    compare.add_argument("--png", type=Path, metavar="DIR", help="the main figures")
    form = compare.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true")
    form.add_argument("--csv", action="store_true")

    info = commands.add_parser("info", help="what is in a log")
    info.add_argument("log", type=Path)
    info.add_argument("--json", action="store_true")

    tables = commands.add_parser("export", help="the topics of a log as tables, or a layout of a viewer for it")
    tables.add_argument("log", type=Path)
    tables.add_argument("--to", dest="form", choices=["parquet", "csv", "layout"], required=True)
    tables.add_argument("--topic", action="append", default=[], help="only this one; may be repeated")
    tables.add_argument("-o", "--output", type=Path, metavar="DIR", help="default: beside the log")

    recover = commands.add_parser("recover", help="make a log of what an interrupted flight has left")
    recover.add_argument("part", type=Path, help="LOG.part, or any truncated log")
    recover.add_argument("-o", "--output", type=Path, required=True, metavar="LOG")
    recover.add_argument("--force", action="store_true", help="replace an existing log")

    allan = commands.add_parser("allan", help="Allan deviation of the inertial channels of a log")
    allan.add_argument("log", type=Path)
    allan.add_argument("--topic", action="append", default=[], help="an Imu topic (default: all); may be repeated")
    allan.add_argument("--plot", type=Path, metavar="PNG", help="draw the curves")
    allan.add_argument("--json", action="store_true")

    _add_check(commands)
    _add_campaign(commands)
    _add_budget(commands)
    _add_papers(commands)

    listing = commands.add_parser("list", help="what there is")
    listing.add_argument("what", choices=["scenarios", "aircraft", "grades", "estimators", "layouts"])
    listing.add_argument("--json", action="store_true")
    return made


def _add_estimators(command: argparse.ArgumentParser, text: str) -> None:
    command.add_argument("--estimator", action="append", default=[], metavar="NAME", help=text)


def _add_span(command: argparse.ArgumentParser, what: str = "") -> None:
    command.add_argument("--from", dest="start", type=float, metavar="T", help=f"{what}from this time, s")
    command.add_argument("--to", dest="end", type=float, metavar="T", help=f"{what}up to this time, s")


def _add_live(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--live",
        nargs="?",
        type=_port,
        const=8765,
        metavar="PORT",
        help="stream it to viewers, too (write --live=PORT)",
    )
    command.add_argument(
        "--rate", type=_positive, default=1.0, metavar="X", help="with --live: so many times real time"
    )


def _add_check(commands: Any) -> None:
    check = commands.add_parser("check", help="accuracy of a suite of flights against its baseline; exit 1 when worse")
    check.add_argument("suite", nargs="?", help="a TOML file (default: the standard suite in tests/baselines)")
    check.add_argument("--renew", action="store_true", help="make the present accuracy the baseline; needs --why")
    check.add_argument("--why", metavar="TEXT", help="the reason, kept in the baseline's history")
    check.add_argument("--workers", type=_count, metavar="N", help="processes (default: one per processor)")
    check.add_argument("--all", action="store_true", help="list what has not changed, too")
    check.add_argument("--junit", type=Path, metavar="FILE", help="write the result as JUnit XML")
    form = check.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true")
    form.add_argument("--markdown", action="store_true", help="print a comment for a pull request")


def _add_campaign(commands: Any) -> None:
    campaign = commands.add_parser("campaign", help="many flights with varied seeds and values; statistics of them")
    campaign.add_argument("scenario", help="a TOML file, or the name of a shipped scenario")
    campaign.add_argument("--runs", type=_count, required=True, metavar="N")
    campaign.add_argument("-o", "--output", metavar="DIR", help="a folder or an fsspec address; needed but for --tune")
    campaign.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="KEY=DIST",
        help="uniform:A..B, normal:M,S, choice:A,B, grid:A,B or lhs:A..B of any scenario value; may be repeated",
    )
    campaign.add_argument("--seed", type=_natural, metavar="N", help="of run 0; run k has the k-th after it")
    _add_estimators(campaign, "as for fly")
    campaign.add_argument("--duration", type=_positive, metavar="S", help="end every flight after S seconds")
    where = campaign.add_mutually_exclusive_group()
    where.add_argument("--workers", type=_count, metavar="N", help="processes (default: one per processor)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster, e.g. tcp://head:8786")
    campaign.add_argument("--keep-logs", metavar="worst:N", help="logs of the N worst runs, or all")
    campaign.add_argument("--metric", default="tilt_rmse_deg", metavar="FIGURE", help="what makes a run bad")
    campaign.add_argument(
        "--tune",
        action="append",
        default=[],
        metavar="EST.SETTING=A..B",
        help="minimise the metric; verdict on N further seeds; may be repeated",
    )
    campaign.add_argument("--json", action="store_true")
    campaign.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _add_budget(commands: Any) -> None:
    budget = commands.add_parser("budget", help="which error of the sensors costs an estimator how much attitude")
    budget.add_argument("scenario", help="a TOML file, or the name of a shipped scenario")
    budget.add_argument("--estimator", required=True, metavar="NAME", help="one of the scenario's, or METHOD@SUITE")
    budget.add_argument("--suite", metavar="NAME", help="on this suite")
    budget.add_argument("--seeds", type=_count, default=1, metavar="N", help="flights (default: one)")
    budget.add_argument("--seed", type=_natural, metavar="N", help="the first seed, instead of the scenario's")
    budget.add_argument("--duration", type=_positive, metavar="S", help="end every flight after S seconds")
    _add_span(budget, "errors ")
    budget.add_argument("--workers", type=_count, metavar="N", help="processes (default: one per processor)")
    budget.add_argument("--png", type=Path, metavar="FILE", help="draw the table as bars")
    budget.add_argument("--json", action="store_true")


def _add_papers(commands: Any) -> None:
    papers = commands.add_parser("papers", help="what the papers claim and what comes out here")
    papers.add_argument("name", nargs="*", help="cubature, adaptive_ins, fuzzy, emitter, switched (default: all)")
    papers.add_argument("--quick", action="store_true", help="few runs, to see that it works")
    papers.add_argument("--json", action="store_true")
    papers.add_argument("--markdown", type=Path, metavar="FILE", help="write the page of results (docs/papers.md)")


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not 1 or more")
    return value


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text} is not a positive number of seconds")
    return value


def _port(text: str) -> int:
    if not text.isdigit() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text} is not a port; write --live=PORT, or put --live last")
    return int(text)


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is negative; a seed is 0 or more")
    return value
