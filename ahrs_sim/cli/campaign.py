"""`ahrs-sim campaign`: many flights with varied seeds and values."""

import argparse
import json
import sys
from pathlib import Path

from ahrs_sim.cli.common import Commands, Progress, add_estimators, count, gate, natural, positive
from ahrs_sim.errors import InputError, nearest


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("campaign", help="fly many flights with varied seeds and values; print statistics")
    command.add_argument("scenario", help="a TOML file, or the name of a shipped scenario")
    command.add_argument("--runs", type=count, required=True, metavar="N", help="number of flights")
    command.add_argument(
        "-o", "--output", metavar="DIR", help="a folder or an fsspec address; required unless --tune is given"
    )
    command.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="KEY=DIST",
        help="uniform:A..B, normal:M,S, choice:A,B, grid:A,B or lhs:A..B of any scenario value; may be repeated",
    )
    command.add_argument("--seed", type=natural, metavar="N", help="seed of run 0; run k has the k-th after it")
    add_estimators(command, "as for fly")
    command.add_argument("--duration", type=positive, metavar="S", help="end every flight after S seconds")
    where = command.add_mutually_exclusive_group()
    where.add_argument("--workers", type=count, metavar="N", help="processes (default: one per processor)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="run on a Dask cluster, e.g. tcp://head:8786")
    command.add_argument("--keep-logs", metavar="worst:N", help="keep the logs of the N worst runs, or all")
    command.add_argument("--metric", default="tilt_rmse_deg", metavar="FIGURE", help="figure used to rank runs")
    command.add_argument("--worst-of", metavar="NAME", help="rank runs by this estimator (default: the worst of each)")
    command.add_argument(
        "--against", metavar="NAME", help="take paired differences from this estimator (default: the most accurate)"
    )
    command.add_argument(
        "--tune",
        action="append",
        default=[],
        metavar="EST.SETTING=A..B",
        help="minimise the metric, then compare on N further seeds; may be repeated",
    )
    command.add_argument("--json", action="store_true", help="print JSON")
    command.add_argument("--quiet", action="store_true", help="print nothing but errors")
    return command


def run(arguments: argparse.Namespace) -> int:
    """Fly a campaign and write its report, or tune settings of estimators; returns 1 when every run failed."""
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.runs import campaign, campaign_report, tuning
    from ahrs_sim.runs import pool as pools

    scenario = scenarios.load(
        arguments.scenario,
        seed=arguments.seed,
        duration=arguments.duration,
        estimators=arguments.estimator,
        gate=gate(scenarios.ANY, arguments.quiet),
    )
    campaign_report.check_metric(arguments.metric)
    for option, name in (("--worst-of", arguments.worst_of), ("--against", arguments.against)):
        if name is not None and name not in (known := [e.name for e in scenario.estimators]):
            raise InputError(f"{option} {name}: no such estimator in {scenario.name}{nearest(name, known)}")
    if not arguments.quiet:
        for note in scenario.notes:
            print(f"ahrs-sim: {note}", file=sys.stderr)
    plan = campaign.Plan.make(scenario, arguments.runs, arguments.vary)
    keep = _worst(arguments.keep_logs, arguments.runs)
    hidden = arguments.quiet or arguments.json
    if arguments.tune:
        knobs = [tuning.Knob.read(text, scenario) for text in arguments.tune]
        with pools.pool(arguments.workers, arguments.scheduler) as pool:
            progress = Progress("tuning", unit="trials", hidden=hidden)
            tuned = tuning.tune(plan, knobs, arguments.metric, pool, progress=progress)
        Progress.clear()
        print(json.dumps(vars(tuned), indent=1) if arguments.json else tuned.text())
        return 0
    if arguments.output is None:
        raise InputError("campaign: -o DIR is missing: where the results go")
    store = campaign.Store(arguments.output)
    if keep and store.remote:
        raise InputError("--keep-logs needs a local -o; fly single runs with ahrs-sim fly --from DIR --run N")
    if (there := campaign.flown(plan, store)) and not arguments.quiet:
        print(f"{store.place}: {there} of {plan.runs} runs are there, {plan.runs - there} to fly", file=sys.stderr)
    try:
        with pools.pool(arguments.workers, arguments.scheduler) as pool:
            campaign.fly(plan, store, pool, Progress(f"flying {plan.name}", unit="runs", hidden=hidden))
    except KeyboardInterrupt:
        there = campaign.flown(plan, store)
        kept = f"{there} of {plan.runs} runs are in {store.place}; the same command flies the rest"
        raise KeyboardInterrupt(f"stopped; {kept}") from None
    if keep:
        worst = campaign_report.worst_runs(store, arguments.metric, keep, arguments.worst_of)
        with pools.local_pool(arguments.workers) as pool:  # the workers of a cluster may not see this disk
            for _ in campaign.keep_logs(plan, worst, Path(arguments.output) / "logs", pool):
                pass  # runs that fail leave a log up to there
    Progress.clear()
    report = campaign_report.make(store, arguments.metric, against=arguments.against, worst_of=arguments.worst_of)
    text = campaign_report.text(report)
    store.write("report.json", json.dumps(report, indent=1).encode())
    store.write("report.txt", f"{text}\n".encode())
    if picture := campaign_report.drawn(report):
        store.write("report.png", picture)
    if not arguments.quiet:
        print(json.dumps(report, indent=1) if arguments.json else text)
    return 0 if report["failed"] < report["runs"] else 1


def _worst(text: str | None, runs: int) -> int:
    """Read how many logs `--keep-logs` asks for."""
    if text is None:
        return 0
    if text == "all":
        return runs
    kind, _, number = text.partition(":")
    if kind != "worst" or not number.isdigit():
        raise InputError(f"--keep-logs {text}: write worst:N or all")
    return int(number)
