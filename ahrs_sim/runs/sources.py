"""Digests of the files that a campaign's figures come from: runs of two states of them are not mixed."""

import hashlib
import importlib.util
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

import ahrs_sim
import estimators
from ahrs_sim.flight.jsbsim_flight import model_files
from ahrs_sim.plugins import FMU, LIBRARY, located
from ahrs_sim.scenario import Scenario
from ahrs_sim.sensors import correction as corrections
from ahrs_sim.sensors import grade
from ahrs_sim.sensors.suite import SECTIONS

_KINDS = {".py", ".toml", ".xml"}


def digests(scenario: Scenario, code: Sequence[str]) -> dict[str, str]:
    """Digest the sources of the project, the aircraft, own grades and corrections, and code from outside, by name.

    Raises:
        InputError: an aircraft that cannot be loaded, or a file of an estimator that is not there.
    """
    ours = {"ahrs_sim": _ours(ahrs_sim.__file__), "estimators": _ours(estimators.__file__)}
    if scenario.motion is None:
        ours["aircraft"] = _digest(model_files(scenario))
    for suite in scenario.suites:
        name = str(suite.settings.get("grade"))
        if ".toml" in name:  # of the user's own; the shipped ones are sources of the project
            figures = repr(grade.load(name, SECTIONS, where=suite.where).layer)
            ours[name] = hashlib.sha256(figures.encode()).hexdigest()[:16]
        if correction := suite.settings.get("correction"):
            name = str(correction)
            ours[name] = hashlib.sha256(repr(corrections.load(name, suite.where)).encode()).hexdigest()[:16]
    return ours | {method: _digest(_files(method, Path(scenario.where).parent)) for method in code}


@cache
def _ours(file: str) -> str:
    return _digest(_below(Path(file).parent))


def _below(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.suffix in _KINDS)


def _files(method: str, folder: Path) -> list[Path]:
    """List the files of code from outside: a library, a file, or the package that a module belongs to."""
    if method.startswith((LIBRARY, FMU)):
        return [located(method.partition(":")[2], folder)]
    place = method.rpartition(":")[0]
    if place.endswith(".py"):
        return [located(place, folder)]
    top = place.partition(".")[0]
    spec = importlib.util.find_spec(top)  # what is installed comes first, as when it is imported
    if spec is not None and spec.origin:
        origin = Path(spec.origin)
        return _below(origin.parent) if origin.name == "__init__.py" else [origin]
    beside = [place for place in (folder, Path()) if (place / f"{top}.py").is_file()]
    return [place / f"{top}.py" for place in beside[:1]] or _below(folder / top)


def _digest(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]
