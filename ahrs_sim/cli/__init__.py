"""The command line: `ahrs-sim COMMAND ...`. A module each command, which loads what it uses only when it runs."""

import argparse
import contextlib
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from ahrs_sim.cli import (
    aircraft,
    allan,
    bound,
    budget,
    calibrate,
    campaign,
    certify,
    check,
    choose,
    compare,
    export,
    export_code,
    export_fmu,
    export_page,
    fly,
    info,
    listing,
    new,
    papers,
    recover,
    replay,
    schema,
    serve,
    tune,
)
from ahrs_sim.errors import AhrsSimError, InputError, printable
from estimators.errors import EstimationError

# in the order of `ahrs-sim --help`
_COMMANDS = (
    fly, serve, replay, compare, info, export, recover, allan, check, campaign, certify, choose, budget, bound, tune,
    calibrate, papers, aircraft, new, export_code, export_fmu, export_page, listing, schema,
)  # fmt: skip


_REPORT = "please report it with the command and its input; --debug shows where"


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns:
        The exit code: 0 done, 1 a flight or check failed, 2 bad input or a file that cannot be read or written,
        3 a fault of this program, 130 stopped.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a name that the terminal cannot show must not end a flight
            stream.reconfigure(errors="backslashreplace")
    arguments = parser().parse_args(argv)
    debug = arguments.debug or bool(os.environ.get("AHRS_SIM_DEBUG"))
    if not (debug or sys.warnoptions):  # numbers from a damaged file overflow: nothing that the user could mend
        warnings.simplefilter("ignore")
    try:
        _check_environment()
        code = int(arguments.command(arguments) or 0)
        sys.stdout.flush()
        return code
    except AhrsSimError as error:
        return _failed(str(error), error.exit_code)
    except EstimationError as error:
        return _failed(str(error), 2)
    except KeyboardInterrupt as error:
        return _failed(str(error) or "stopped", 130)
    except BrokenPipeError:  # `ahrs-sim info LOG | head`
        sys.stderr.close()
        return 0
    except OSError as error:
        if debug:
            raise
        _discard_output()
        return _failed(f"{error.filename or 'output'}: {error.strerror or error}", 2)
    except MemoryError:
        if debug:
            raise
        return _failed("not enough memory for this", 2)
    except Exception as error:
        if debug:
            raise
        return _failed(f"unforeseen {type(error).__name__}: {_one_line(error)}; {_REPORT}", 3)


def _check_environment() -> None:
    """Check what would end the import of Numba.

    Raises:
        InputError: a number of threads that is none.
    """
    threads = os.environ.get("NUMBA_NUM_THREADS", "")
    if threads.removeprefix("-").isdecimal() and int(threads[:9]) < 1:
        raise InputError(f"NUMBA_NUM_THREADS={threads}: must be 1 or more; unset it")


def _failed(line: str, code: int) -> int:
    with contextlib.suppress(OSError):  # stderr may be what is full
        print(f"ahrs-sim: {printable(line)}", file=sys.stderr)
    return code


def _one_line(error: Exception) -> str:
    """Make the text of an exception fit for a line."""
    line = " ".join(str(error).split())
    return line if len(line) <= 200 else line[:197] + "..."


def _discard_output() -> None:
    """Have nothing more written to a stdout that is full, at the end of the program neither."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def parser() -> argparse.ArgumentParser:
    """Make the parser of all commands; `command` of what it parses is the `run` function of the one that was given."""
    made = argparse.ArgumentParser(
        prog="ahrs-sim",
        description="Fly a model aircraft, measure it with low-cost sensors, estimate its attitude, report the errors.",
    )
    made.add_argument("--completion", action=_Completion, metavar="SHELL", help="print a completion script and exit")
    made.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    made.add_argument("--debug", action="store_true", help="print the traceback of an unforeseen error")
    commands = made.add_subparsers(metavar="COMMAND", required=True)
    for command in _COMMANDS:
        added = command.add_parser(commands)
        added.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
        added.set_defaults(command=command.run)
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
