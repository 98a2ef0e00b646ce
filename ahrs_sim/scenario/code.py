"""Code from outside: which names in a file may be imported and run.

`method = "package.module:Class"` in a scenario, a map, a suite or the scenario kept in a log means: import that package
and run it. A file of somebody else must not decide that, so every such name passes a gate that knows what the user has
allowed:

    gate = Gate(("mine", "theirs.filters:Ukf"))    # of the command line: --allow-code, --estimator METHOD@SUITE
    gate.check("mine.ekf:Ekf", "bag.toml: [estimator.a]")      # reported
    gate.check("setuptools:setup", "bag.toml: [estimator.b]")  # InputError

The names of the catalogue and of installed entry points have no colon and pass. Whatever else is run from outside (a
shared library, a model of another tool) takes a name with a colon, `KIND:PLACE`, and goes the same way.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ahrs_sim.errors import InputError

ANY = ("*",)
"""Allows every name: for a scenario that the user wrote, as `ahrs-sim fly SCENARIO`."""

_OURS = ("name", "site", "sensors")


def from_outside(method: str) -> bool:
    """Tell whether a method is neither of the catalogue nor an entry point of an installed package."""
    return ":" in method


def named(estimators: Sequence[str]) -> tuple[str, ...]:
    """Return the code that `METHOD@SUITE` or `METHOD` of a command line names."""
    return tuple(m for m in (name.partition("@")[0] for name in estimators) if from_outside(m))


@dataclass(frozen=True)
class Gate:
    """Decides which code from outside may run.

    Attributes:
        allowed: `package`, `package.module` or `package.module:Class`; `ANY`: all.
        report: called with one line for each name that passes.
    """

    allowed: tuple[str, ...] = ()
    report: Callable[[str], object] = lambda line: None

    def check(self, method: str, where: str) -> None:
        """Let a method pass.

        Args:
            method: name in the catalogue, of an entry point, or of code from outside.
            where: file and table that name it.

        Raises:
            InputError: it is code from outside that the user has not allowed.
        """
        if not from_outside(method):
            return
        if not any(_covers(name, method) for name in self.allowed):
            raise InputError(
                f"{where}: method: '{method}' is code from outside, which this file may not run; "
                f"if you trust it, allow it: --allow-code {method}"
            )
        self.report(f"{where}: runs {method}, code from outside")

    def check_estimator(self, settings: Mapping[str, Any], where: str) -> None:
        """Let the method of an `[estimator.NAME]` table pass, with its settings.

        Raises:
            InputError: as `check`, or a setting has the name of what every estimator is given anyway.
        """
        self.check(str(settings.get("method", "")), where)
        for key in _OURS:
            if key in settings:
                raise InputError(f"{where}: {key}: is not a setting; leave it out")

    def also(self, names: Sequence[str]) -> "Gate":
        """Return a gate that lets `names` pass, too."""
        return Gate((*self.allowed, *names), self.report)


def _covers(allowed: str, method: str) -> bool:
    """Tell whether an allowed name is the method, its module or a package above it."""
    module = method.partition(":")[0]
    return allowed in (*ANY, method, module) or module.startswith(f"{allowed}.") or _file(allowed) == _file(method)


def _file(method: str) -> tuple[str, Path, str]:
    """Kind, whole path and class of `lib:PATH` or `PATH.py:Class`, however the path is written."""
    kind, _, place = method.partition(":")
    if kind in ("lib", "fmu"):
        return kind, Path(place).resolve(), ""
    place, _, attribute = method.rpartition(":")
    return ("py", Path(place).resolve(), attribute) if place.endswith(".py") else ("", Path(), method)
