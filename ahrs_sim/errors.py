"""The exceptions of ahrs_sim.

    AhrsSimError
    +-- InputError      something the user gave is wrong: file, key, value; exit code 2
    +-- FlightError     the flight ended before its scenario did (crash, time-out, diverged); exit code 1
    +-- CheckError      a check the user asked for has failed; exit code 1
    +-- LogError        the log could not be written or read on (disk full, worker died); exit code 2

`estimators` is usable without this package and has its own root, `estimators.EstimationError`. The command line
catches both roots, prints one line (what, where, what to do) and exits; nothing else catches them.
"""

import difflib
from collections.abc import Iterable


class AhrsSimError(Exception):
    """Root of the tree; `str(error)` is one line fit for a user, whatever names from files are in it."""

    exit_code = 1

    def __init__(self, text: str = "") -> None:
        super().__init__(printable(text))


class InputError(AhrsSimError):
    """Bad input: the message names file and key and says what to do."""

    exit_code = 2


class FlightError(AhrsSimError):
    """A flight that could not be completed; its log is whole up to that moment."""


class CheckError(AhrsSimError):
    """A check that the user asked for has failed."""


class LogError(AhrsSimError):
    """A log could not be written, or not be read to its end."""

    exit_code = 2


def printable(text: str) -> str:
    """Make a text fit for a terminal's line: replace the unprintable by `?`, cut the middle of a very long one."""
    if not text.isprintable():
        text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 3000 else f"{text[:1500]} ... {text[-1000:]}"


def nearest(word: str, known: Iterable[str]) -> str:
    """Make the tail of an error message: `"; did you mean 'x'?"` for a misspelt word, else the choices."""
    choices = sorted(known)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.6)
    if close:
        return f"; did you mean '{close[0]}'?"
    return f"; known: {', '.join(choices)}" if choices else ""
