"""`ahrs-sim fly`: fly a scenario into a log and print the accuracy table."""

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ahrs_sim.cli.common import (
    Commands,
    CompileNotice,
    Progress,
    add_code,
    add_estimators,
    add_live,
    gate,
    natural,
    open_live,
    positive,
)
from ahrs_sim.errors import FlightError, InputError

if TYPE_CHECKING:
    from ahrs_sim.scenario import Scenario
    from ahrs_sim.serve.simulators import Autopilot
    from ahrs_sim.serve.unit import Unit


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("fly", help="fly a scenario into a log and print the accuracy table")
    command.add_argument(
        "scenario", nargs="?", help="a TOML file, or the name of a shipped one (ahrs-sim list scenarios)"
    )
    command.add_argument(
        "--from", dest="campaign", metavar="DIR", help="fly a run of this campaign instead of a scenario"
    )
    command.add_argument("--run", dest="number", type=natural, metavar="N", help="number of the run, with --from")
    add_flight(command, "only this one, or METHOD@SUITE; may be repeated")
    command.add_argument("--pilot", metavar="NAME", help="close the loop on this estimator's attitude, or on the truth")
    command.add_argument("--force", action="store_true", help="replace an existing log")
    command.add_argument(
        "--block", type=positive, metavar="S", help="block length in seconds (the log does not depend on it)"
    )
    command.add_argument(
        "--ros-axes", action="store_true", help="repeat the IMU topics under /ros in ENU and FLU (REP-103)"
    )
    command.add_argument(
        "--smooth",
        action="store_true",
        help="add estimates smoothed over the whole flight, as /est/NAME_smoothed (ins-cal)",
    )
    command.add_argument("--all", action="store_true", help="add 95th percentiles and maxima of every angle")
    command.add_argument("--json", action="store_true", help="print the accuracy as JSON")
    command.add_argument("--quiet", action="store_true", help="print nothing but errors")
    add_live(command)
    return command


def add_flight(command: argparse.ArgumentParser, estimators: str) -> None:
    """Add where a flight goes, and what replaces values of its scenario; `estimators` is the help of --estimator."""
    command.add_argument("-o", "--output", type=Path, metavar="LOG", help="default: logs/SCENARIO-seedN.mcap, or -runN")
    command.add_argument("--seed", type=natural, metavar="N", help="seed, instead of the scenario's")
    add_estimators(command, estimators)
    add_code(command)
    command.add_argument("--duration", type=positive, metavar="S", help="stop after S seconds")


def run(arguments: argparse.Namespace) -> None:
    """Fly a scenario into a log and print the accuracy table.

    Raises:
        KeyboardInterrupt: stopped by Ctrl-C, after log and table have been completed.
    """
    from ahrs_sim.flight import BLOCK_S

    scenario = scenario_of(arguments)
    if arguments.smooth and not any(e.settings["method"] == "ins-cal" for e in scenario.estimators):
        raise InputError("--smooth: none of the estimators can be smoothed; name one with --estimator ins-cal@SUITE")
    output = output_of(arguments, scenario)
    carry_out(arguments, scenario, output, [], block_s=arguments.block or BLOCK_S, smooth=arguments.smooth)


def carry_out(
    arguments: argparse.Namespace,
    scenario: "Scenario",
    output: Path,
    stop: list[int],
    *,
    block_s: float,
    unit: "Unit | Autopilot | None" = None,
    smooth: bool = False,
) -> None:
    """Fly, and print the accuracy table.

    Args:
        arguments: of the command line.
        scenario, output: what to fly, and into which log.
        stop: gets an entry at Ctrl-C.
        block_s: length of the blocks, s.
        unit: that flies along outside, there already.

    Raises:
        FlightError: it did not reach its end; the table up to there was printed.
        KeyboardInterrupt: stopped by Ctrl-C, after log and table have been completed.
    """
    live = open_live(arguments, lambda: bool(stop))
    flight = None
    if scenario.pilot_attitude == "truth":  # flies on while the estimators are being loaded
        from ahrs_sim.flight.ahead import FlightAhead

        flight = FlightAhead(scenario, max(1, round(block_s * scenario.rate)))
    from ahrs_sim import pipeline
    from ahrs_sim.evaluation.accuracy import Accuracy

    if not arguments.quiet:
        for note in scenario.notes:
            print(f"ahrs-sim: {note}", file=sys.stderr)
    _compile(scenario, hidden=arguments.quiet or arguments.json)
    accuracy = Accuracy([*(e.name for e in scenario.estimators), *([unit.name] if unit else [])])
    failure: FlightError | None = None
    previous = signal.signal(signal.SIGINT, lambda *_: stop.append(1))
    try:
        pipeline.fly(
            scenario,
            output,
            accuracy=accuracy,
            force=arguments.force,
            block_s=block_s,
            flight=flight.ready() if flight else None,
            outside=unit,
            live=live,
            ros_axes=arguments.ros_axes,
            progress=Progress(f"flying {scenario.name}", hidden=arguments.quiet or arguments.json),
            stopped=lambda: bool(stop),
        )
    except FlightError as error:
        failure = error  # the accuracy up to there comes first
    finally:
        signal.signal(signal.SIGINT, previous)
        Progress.clear()
        if live:
            live.close()
    smooth = smooth and not (stop or failure)
    if smooth:
        _smooth(output, scenario)
    if not arguments.quiet:
        result = {"log": str(output), **accuracy.result()}
        if smooth:
            from ahrs_sim.review import compare

            result = compare.compare(output)
        _print(arguments, result, unit)
        if scenario.duration is None and not (stop or failure):  # else it was known before
            for note in scenario.unreached(accuracy.span()[1]):
                print(f"ahrs-sim: {note}", file=sys.stderr)
    if failure:
        raise failure
    if stop:
        raise KeyboardInterrupt(f"stopped at {accuracy.span()[1]:.0f} s; the log is complete up to there")


def _smooth(output: Path, scenario: "Scenario") -> None:
    """Write the log anew, smoothed estimates beside the filtered ones: a replay of it, which gives the same bytes."""
    from ahrs_sim.playback import replay
    from ahrs_sim.scenario import Gate

    made = output.with_name(f"{output.name}.smoothed")
    try:
        replay(output, made, smooth=True, force=True, gate=Gate(scenario.code))
        made.replace(output)
    finally:
        made.unlink(missing_ok=True)


def _print(arguments: argparse.Namespace, result: dict[str, Any], unit: "Unit | Autopilot | None") -> None:
    from ahrs_sim.review import compare

    if arguments.json:
        print(json.dumps({**result, **({"timing": unit.timing.result()} if unit else {})}, indent=1))
        return
    if result["estimators"]:
        print(compare.table(result, details=arguments.all))
    if unit:
        print(*unit.timing.lines(), sep="\n")
    print(result["log"])


def _compile(scenario: "Scenario", hidden: bool) -> None:
    """Compile what has never been compiled, with a line for what takes its time."""
    import estimators

    notice = CompileNotice(hidden=hidden)
    methods = []
    for component in scenario.estimators:
        settings = {k: v for k, v in component.settings.items() if k not in ("method", "suite")}
        methods.append((component.settings["method"], settings))
    try:
        estimators.prepare(methods, notice)
    except estimators.SettingError:
        pass  # reported where the estimator is made, with the place in the scenario
    finally:
        notice.end()


def scenario_of(arguments: argparse.Namespace) -> "Scenario":
    """Load the scenario, or the one that a campaign flew in a run."""
    from ahrs_sim import scenario as scenarios

    if (arguments.campaign is None) != (arguments.number is None) or (arguments.campaign and arguments.scenario):
        raise InputError("fly: give a scenario, or --from DIR and --run N")
    if arguments.campaign is not None:
        from ahrs_sim.runs import campaign

        changed = (arguments.seed, arguments.duration, arguments.pilot)
        if arguments.estimator or any(value is not None for value in changed):
            raise InputError("fly: --from repeats a run as it was; leave --seed, --duration, --estimator, --pilot out")
        return campaign.scenario_of(arguments.campaign, arguments.number, gate(arguments.allow_code, arguments.quiet))
    if arguments.scenario is None:
        raise InputError("fly: no scenario given; see ahrs-sim list scenarios")
    return scenarios.load(
        arguments.scenario,
        seed=arguments.seed,
        duration=arguments.duration,
        estimators=arguments.estimator,
        pilot=arguments.pilot,
        gate=gate(scenarios.ANY, arguments.quiet),  # the user's own file
    )


def output_of(arguments: argparse.Namespace, scenario: "Scenario") -> Path:
    """Choose the file of the log; what exists stays unless `--force` is given."""
    run = getattr(arguments, "number", None)  # of a campaign: varied, so not what its seed alone gives
    name = f"{scenario.name}-seed{scenario.seed}" if run is None else f"{scenario.name}-run{run}"
    output: Path = arguments.output or Path("logs") / f"{name}.mcap"
    if output.exists() and not arguments.force:
        raise InputError(f"{output}: exists; give another -o or --force")
    if arguments.output is None:
        output.parent.mkdir(exist_ok=True)
    return output
