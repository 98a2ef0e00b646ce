"""`ahrs-sim choose`: units and estimators ranked by how well they meet a need in a scenario."""

import argparse
import contextlib
import json

from ahrs_sim.cli.common import Commands, Progress, count, gate, natural, positive, temporary_folder
from ahrs_sim.errors import InputError


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("choose", help="rank units, calibrations and estimators by whether they meet a need")
    command.add_argument("scenario", help="a TOML file, or the name of a shipped scenario")
    command.add_argument(
        "--need",
        required=True,
        metavar="tilt=0.5,heading=1",
        help="[PHASE.]MEASURE[_STATISTIC]=DEG,... (95th percentile)",
    )
    command.add_argument(
        "--grade",
        action="append",
        default=[],
        metavar="GRADE",
        help="only this unit; may be repeated (default: the shop)",
    )
    command.add_argument(
        "--with",
        dest="parts",
        metavar="GRADES",
        help="grades that complete a unit (default: rm3100 + zed_f9p + ms4525do)",
    )
    command.add_argument("--estimator", action="append", default=[], metavar="METHOD", help="may be repeated")
    command.add_argument("--runs", type=count, default=5, metavar="N", help="number of flights (5)")
    command.add_argument("--seed", type=natural, metavar="N", help="seed of the first flight")
    command.add_argument("--duration", type=positive, metavar="S", help="end every flight after S seconds")
    command.add_argument(
        "--quantile", type=_share, default=0.5, metavar="Q", help="share of the flights that must meet the need (0.5)"
    )
    command.add_argument("--confidence", type=_share, default=0.95, metavar="P", help="confidence of that share (0.95)")
    command.add_argument("-o", "--output", metavar="DIR", help="keep the flights here, to resume (default: not kept)")
    command.add_argument("--workers", type=count, metavar="N", help="processes (default: one per processor)")
    command.add_argument("--json", action="store_true", help="print JSON")
    return command


def _share(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 1")
    return value


def run(arguments: argparse.Namespace) -> int:
    """Fly a scenario with every unit and estimator, and print their ranking; returns 1 when none meets the need."""
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.runs import campaign, choose
    from ahrs_sim.runs import pool as pools

    needs = choose.Need.read_all(arguments.need)
    made = choose.suites(arguments.grade, arguments.parts or choose.PARTS)
    scenario = scenarios.load(
        arguments.scenario, seed=arguments.seed, duration=arguments.duration, gate=gate(scenarios.ANY, arguments.json)
    )
    allowed = gate(scenarios.code.named(arguments.estimator), arguments.json)
    plan = choose.plan(scenario, made, arguments.estimator, arguments.runs, allowed)
    with contextlib.ExitStack() as stack:
        store = campaign.Store(arguments.output or stack.enter_context(temporary_folder()))
        with pools.pool(arguments.workers) as pool:
            campaign.fly(plan, store, pool, Progress(f"flying {plan.name}", unit="runs", hidden=arguments.json))
        Progress.clear()
        choices = choose.rank(store, made, needs, arguments.quantile, arguments.confidence)
        if not choices:
            errors = [e for e in store.table(["error"])["error"].to_pylist() if e]
            raise InputError(f"{arguments.scenario}: no flight was completed: {errors[0] if errors else 'no runs'}")
    if arguments.json:
        print(json.dumps(choose.as_json(choices), indent=1))
    else:
        print(choose.text(choices, arguments.quantile, arguments.confidence, arguments.runs))
    return 0 if choices[0].result == "met" else 1
