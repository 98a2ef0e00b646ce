"""`ahrs-sim budget`: how much each sensor error contributes to an estimator's attitude error."""

import argparse
import json
from pathlib import Path

from ahrs_sim.cli.common import Commands, Progress, add_span, count, gate, natural, positive


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser(
        "budget", help="split an estimator's attitude error into the contributions of the sensor errors"
    )
    command.add_argument("scenario", help="a TOML file, or the name of a shipped scenario")
    command.add_argument("--estimator", required=True, metavar="NAME", help="one of the scenario's, or METHOD@SUITE")
    command.add_argument("--suite", metavar="NAME", help="on this suite")
    command.add_argument("--seeds", type=count, default=1, metavar="N", help="flights (default: one)")
    command.add_argument("--seed", type=natural, metavar="N", help="first seed, instead of the scenario's")
    command.add_argument("--duration", type=positive, metavar="S", help="end every flight after S seconds")
    add_span(command, "errors ")
    command.add_argument("--workers", type=count, metavar="N", help="processes (default: one per processor)")
    command.add_argument("--png", type=Path, metavar="FILE", help="draw the table as bars")
    command.add_argument("--json", action="store_true", help="print JSON")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print how much each sensor error contributes to an estimator's attitude error."""
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.runs import budget

    if arguments.png:
        from ahrs_sim.review import figures

        figures.require()  # before anything is flown
    scenario = scenarios.load(
        arguments.scenario, seed=arguments.seed, duration=arguments.duration, gate=gate(scenarios.ANY)
    )
    unit = "s" if arguments.seeds == 1 else "flights"
    made = budget.make(
        scenario,
        arguments.estimator,
        suite=arguments.suite,
        seeds=arguments.seeds,
        start=arguments.start,
        end=arguments.end,
        workers=arguments.workers,
        progress=Progress(f"budget of {arguments.estimator}", unit=unit, hidden=arguments.json),
    )
    Progress.clear()
    print(json.dumps(made.as_json(), indent=1) if arguments.json else made.text())
    if arguments.png:
        made.plot(arguments.png)
