"""The command line: `ahrs-sim COMMAND ...`. A module each command, which loads what it uses only when it runs."""

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from ahrs_sim.cli import (
    aircraft,
    allan,
    budget,
    campaign,
    check,
    compare,
    export,
    fly,
    info,
    listing,
    new,
    papers,
    recover,
    replay,
    schema,
)
from ahrs_sim.errors import AhrsSimError
from estimators.errors import EstimationError

# in the order of `ahrs-sim --help`
_COMMANDS = (
    fly, replay, compare, info, export, recover, allan, check, campaign, budget, papers, aircraft, new, listing, schema,
)  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 1 a flight or check failed, 2 bad input, 130 stopped."""
    arguments = parser().parse_args(argv)
    try:
        return int(arguments.command(arguments) or 0)
    except AhrsSimError as error:
        print(f"ahrs-sim: {error}", file=sys.stderr)
        return error.exit_code
    except EstimationError as error:
        print(f"ahrs-sim: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("ahrs-sim: stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:  # `ahrs-sim info LOG | head`
        sys.stderr.close()
        return 0


def parser() -> argparse.ArgumentParser:
    """Make the parser of all commands; `command` of what it parses is the `run` function of the one that was given."""
    made = argparse.ArgumentParser(
        prog="ahrs-sim",
        description="Fly a model aircraft, measure it with low-cost sensors, estimate its attitude, say who was wrong.",
    )
    made.add_argument("--completion", action=_Completion, metavar="SHELL", help="print a completion script and exit")
    made.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = made.add_subparsers(metavar="COMMAND", required=True)
    for command in _COMMANDS:
        command.add_parser(commands).set_defaults(command=command.run)
    return made


class _Version(argparse.Action):
    """Print the version of the installed package; it is looked up only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(f"{parser.prog} {version('ahrs-sim')}")
        parser.exit()


class _Completion(argparse.Action):
    """Print the completion script of a shell: bash, zsh or tcsh."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: object, values: object, *_: Any) -> None:
        import shtab

        if values not in shtab.SUPPORTED_SHELLS:
            parser.error(f"--completion: '{values}' is no shell it knows; known: {', '.join(shtab.SUPPORTED_SHELLS)}")
        print(shtab.complete(parser, shell=str(values)))
        parser.exit()
