"""`ahrs-sim bound`: the best attitude that any filter could make of a suite's sensors on a flight."""

import argparse
import json
import math

from ahrs_sim.cli.common import Commands, Progress, add_span, gate, natural, positive


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser(
        "bound", help="compute the least error that any filter can reach with a suite on a flight (Cramer-Rao)"
    )
    command.add_argument("scenario", help="a TOML file, or the name of a shipped scenario")
    command.add_argument("--suite", required=True, metavar="NAME", help="one of the scenario's")
    command.add_argument("--seed", type=natural, metavar="N", help="seed, instead of the scenario's")
    command.add_argument("--duration", type=positive, metavar="S", help="end the flight after S seconds")
    add_span(command, "sigmas ")
    command.add_argument("--json", action="store_true", help="print JSON")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print the bound of tilt and heading for the sensors of a suite."""
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.runs import bound

    scenario = scenarios.load(
        arguments.scenario, seed=arguments.seed, duration=arguments.duration, gate=gate(scenarios.ANY)
    )
    progress = Progress(f"bound of {arguments.suite}", hidden=arguments.json)
    found = bound.make(scenario, arguments.suite, progress=progress)
    Progress.clear()
    low = -math.inf if arguments.start is None else arguments.start
    high = math.inf if arguments.end is None else arguments.end
    if arguments.json:
        print(json.dumps({name: one.as_json(low, high) for name, one in found.items()}, indent=1))
    else:
        print(bound.table(found, low, high))
