"""`ahrs-sim serve`: a flight for a unit or an autopilot outside, whose attitude is logged beside the estimators."""

import argparse
import re
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from ahrs_sim.cli import fly
from ahrs_sim.cli.common import Commands, natural, positive
from ahrs_sim.errors import InputError, nearest

if TYPE_CHECKING:
    from ahrs_sim.serve.simulators import Autopilot
    from ahrs_sim.serve.unit import Unit


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser(
        "serve", help="stream a flight to a connected unit and log the attitude that it returns"
    )
    command.add_argument("scenario", help="a TOML file, or the name of a shipped one (ahrs-sim list scenarios)")
    command.add_argument("--serial", metavar="WIRE", help="pty, tcp:PORT, or a device: /dev/ttyUSB0@115200")
    command.add_argument("--protocol", metavar="NAME", help="mavlink, vectornav, sbg or ubx+nmea")
    command.add_argument("--rate", type=positive, default=1.0, metavar="X", help="multiple of real time")
    command.add_argument(
        "--wait", type=positive, default=600.0, metavar="S", help="longest wait for the unit or autopilot, s (600)"
    )
    command.add_argument(
        "--simulator", choices=["px4", "ardupilot"], help="simulate for this autopilot instead of a wire"
    )
    command.add_argument("--port", type=natural, metavar="N", help="port that the autopilot connects to (4560; 9002)")
    command.add_argument("--mavlink", type=natural, metavar="N", help="port of the autopilot's attitude (14540; 5760)")
    command.add_argument(
        "--suite", metavar="NAME", help="suite whose sensors the unit sees (default: the scenario's first)"
    )
    command.add_argument("--name", help="name in log and table (default: unit, px4 or ardupilot)")
    fly.add_flight(command, "fly along: only this one, or METHOD@SUITE; may be repeated")
    command.add_argument("--force", action="store_true", help="replace an existing log")
    command.add_argument("--all", action="store_true", help="add 95th percentiles and maxima of every angle")
    command.add_argument("--json", action="store_true", help="print the accuracy as JSON")
    command.set_defaults(campaign=None, number=None, pilot=None, quiet=False, live=None, ros_axes=False)
    return command


def run(arguments: argparse.Namespace) -> None:
    """Wait for the unit, fly for it, and print the accuracy table and how it kept time.

    Raises:
        KeyboardInterrupt: stopped by Ctrl-C, after log and table have been completed.
    """
    from ahrs_sim.serve.unit import BLOCK_S

    given = [bool(x) for x in (arguments.serial, arguments.protocol, arguments.simulator)]
    if given not in ([True, True, False], [False, False, True]):
        raise InputError("serve: give --serial WIRE and --protocol NAME, or --simulator px4|ardupilot")
    scenario = fly.scenario_of(arguments)
    suites = [s.name for s in scenario.suites]
    suite = arguments.suite or suites[0]
    if suite not in suites:
        raise InputError(f"{scenario.where}: no [suite.{suite}]{nearest(suite, suites)}")
    name = arguments.name or arguments.simulator or "unit"
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", name):
        raise InputError(f"serve: --name {name}: letters, digits, - and _, a letter first")
    if name in [e.name for e in scenario.estimators]:
        raise InputError(f"{scenario.where}: --name {name}: an estimator of the scenario has this name")
    output = fly.output_of(arguments, scenario)
    stop: list[int] = []
    make = _autopilot if arguments.simulator else _unit
    unit = make(arguments, name, suite, scenario.epoch_ns, lambda: bool(stop))
    awaited = arguments.simulator or "unit"
    print(f"ahrs-sim: waiting for the {awaited} at {unit.where}", file=sys.stderr, flush=True)
    try:
        if not unit.wait(arguments.wait):
            late = f"no {awaited} at {unit.where} after {arguments.wait:g} s"
            raise InputError(f"serve: {late}; start it, or --wait longer")
        fly.carry_out(arguments, scenario, output, stop, block_s=BLOCK_S, unit=unit)
    finally:
        unit.close()


def _unit(
    arguments: argparse.Namespace, name: str, suite: str, epoch_ns: int, stopped: Callable[[], bool]
) -> "Unit | Autopilot":
    from ahrs_sim.serve import protocols
    from ahrs_sim.serve.links import open_link
    from ahrs_sim.serve.unit import Unit

    protocol = protocols.make(arguments.protocol, epoch_ns)
    return Unit(name, suite, open_link(arguments.serial), protocol, rate=arguments.rate, stopped=stopped)


def _autopilot(
    arguments: argparse.Namespace, name: str, suite: str, epoch_ns: int, stopped: Callable[[], bool]
) -> "Unit | Autopilot":
    from ahrs_sim.serve.readings import SWITCHED_ON_NS
    from ahrs_sim.serve.simulators import AUTOPILOTS

    if arguments.rate != 1.0:
        raise InputError("serve: --rate is for --serial; an autopilot in lockstep goes as fast as it can")
    cls = AUTOPILOTS[arguments.simulator]
    asked = (arguments.port, arguments.mavlink)
    port, answers = (b if a is None else a for a, b in zip(asked, cls.PORTS, strict=True))
    return cls(name, suite, epoch_ns + SWITCHED_ON_NS, stopped, port=port, answers=answers)
