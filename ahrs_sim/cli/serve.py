"""`ahrs-sim serve`: a flight in real time for a unit outside, whose attitude is logged beside the estimators."""

import argparse
import re
import sys
from pathlib import Path

from ahrs_sim.cli import fly
from ahrs_sim.cli.common import Commands, add_code, add_estimators, natural, positive
from ahrs_sim.errors import InputError, nearest


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("serve", help="fly for a unit on a wire: its sensors out, its attitude into the log")
    command.add_argument("scenario", help="a TOML file, or the name of a shipped one (ahrs-sim list scenarios)")
    command.add_argument(
        "--serial", required=True, metavar="WIRE", help="pty, tcp:PORT, or a device: /dev/ttyUSB0@115200"
    )
    command.add_argument("--protocol", required=True, metavar="NAME", help="mavlink, vectornav, sbg or ubx+nmea")
    command.add_argument("--rate", type=positive, default=1.0, metavar="X", help="so many times real time")
    command.add_argument("--suite", metavar="NAME", help="whose sensors the unit sees (default: the scenario's first)")
    command.add_argument("--name", default="unit", help="of the unit in log and table (default: unit)")
    command.add_argument("-o", "--output", type=Path, metavar="LOG", help="default: logs/SCENARIO-seedN.mcap")
    command.add_argument("--seed", type=natural, metavar="N", help="instead of the scenario's")
    add_estimators(command, "fly along: only this one, or METHOD@SUITE; may be repeated")
    add_code(command)
    command.add_argument("--duration", type=positive, metavar="S", help="stop after S seconds")
    command.add_argument("--force", action="store_true", help="replace an existing log")
    command.add_argument("--all", action="store_true", help="print 95th percentiles and maxima of every angle, too")
    command.add_argument("--json", action="store_true", help="print the accuracy as JSON")
    command.set_defaults(campaign=None, number=None, pilot=None, quiet=False, live=None, ros_axes=False)
    return command


def run(arguments: argparse.Namespace) -> None:
    """Wait for the unit, fly for it, and print the accuracy table and how it kept time.

    Raises:
        KeyboardInterrupt: stopped by Ctrl-C, after log and table have been completed.
    """
    from ahrs_sim.serve import protocols
    from ahrs_sim.serve.links import open_link
    from ahrs_sim.serve.unit import BLOCK_S, Unit

    scenario = fly.scenario_of(arguments)
    suites = [s.name for s in scenario.suites]
    suite = arguments.suite or suites[0]
    if suite not in suites:
        raise InputError(f"{scenario.where}: no [suite.{suite}]{nearest(suite, suites)}")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", arguments.name):
        raise InputError(f"serve: --name {arguments.name}: letters, digits, - and _, a letter first")
    if arguments.name in [e.name for e in scenario.estimators]:
        raise InputError(f"{scenario.where}: --name {arguments.name}: an estimator of the scenario has this name")
    output = fly.output_of(arguments, scenario)
    protocol = protocols.make(arguments.protocol, scenario.epoch_ns)
    link = open_link(arguments.serial)
    stop: list[int] = []
    unit = Unit(arguments.name, suite, link, protocol, rate=arguments.rate, stopped=lambda: bool(stop))
    print(f"ahrs-sim: waiting for the unit at {link.name}", file=sys.stderr, flush=True)
    try:
        unit.wait()
        fly.carry_out(arguments, scenario, output, stop, block_s=BLOCK_S, unit=unit)
    finally:
        unit.close()
