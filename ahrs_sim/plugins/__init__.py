"""Estimators from outside: shared libraries in C or C++, FMUs, and Python classes of the user's own.

layout          the structures of `interface/ahrs_estimator.h` as NumPy records
library         LibraryEstimator, FmuEstimator: run by `host` and `fmu_host` in processes of their own
border          Guarded: what estimates from outside must be; a failure ends that estimator alone
templates/      what `ahrs-sim new estimator` writes
"""

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import estimators
from ahrs_sim.errors import InputError
from ahrs_sim.plugins import border
from ahrs_sim.plugins.border import Guarded, Processes
from ahrs_sim.scenario.table import named_file
from estimators import SensorInfo, Site

__all__ = ["FMU", "LIBRARY", "Guarded", "Processes", "create", "failures", "located"]

LIBRARY, FMU = "lib:", "fmu:"


def create(
    name: str, method: str, folder: Path, *, site: Site, sensors: SensorInfo, settings: Mapping[str, Any]
) -> Guarded:
    """Make an estimator of code from outside.

    Args:
        name: of the estimator, for events.
        method: `lib:PATH`, `fmu:PATH`, `package.module:Class`, or `PATH.py:Class`.
        folder: of the file that names it: paths are relative to it, or to the current folder, and modules are found
            there when no installed package has their name.
        site: place and field.
        sensors: data sheet figures.
        settings: passed on.

    Raises:
        InputError: a library that cannot be used, or a class whose constructor raises.
        SettingError: a class that cannot be used.
    """
    if method.startswith((LIBRARY, FMU)):
        from ahrs_sim.plugins.library import FmuEstimator, LibraryEstimator

        hosted = LibraryEstimator if method.startswith(LIBRARY) else FmuEstimator
        path = located(method.partition(":")[2], folder)
        return Guarded(name, hosted(path, site=site, sensors=sensors, **settings))
    module = _importable(method, folder)
    try:
        return Guarded(name, estimators.create(module, site=site, sensors=sensors, **settings))
    except estimators.SettingError:
        raise
    except Exception as error:  # code of others: whatever it raises is theirs to know
        raise InputError(f"estimator '{name}' cannot be made: {border.located(error)}") from error


def _importable(method: str, folder: Path) -> str:
    """Return `module:Class` for a class in a file, or in a module that may lie beside the scenario.

    The folders go to the end of the module path, behind everything that is installed, and stay there for what the
    module imports later.
    """
    place, _, attribute = method.rpartition(":")
    folders = [folder.resolve(), Path().resolve()]
    if place.endswith(".py"):
        path = located(place, folder).resolve()
        folders, method = [path.parent], f"{path.stem}:{attribute}"
    sys.path += [str(f) for f in folders if str(f) not in sys.path]
    return method


def located(path: str, folder: Path) -> Path:
    """Find a file named in a scenario: beside it, else in the current folder.

    Raises:
        InputError: there is no such file in either.
    """
    if found := named_file(path, folder):
        return found
    raise InputError(f"{path}: no such file beside the scenario ({folder}) or in the current folder")


def failures(made: Iterable[Processes]) -> str:
    """Name the estimators that failed and why, on one line; empty when none did."""
    failed = [e for e in made if isinstance(e, Guarded) and e.failure is not None]
    return "; ".join(f"estimator '{e.name}' {e.failure}" for e in failed)
