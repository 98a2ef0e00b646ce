"""Named combinations of filter and model, and the way to a user's own class.

    estimator = create("marg-ckf", site=site, sensors=sensors, aiding="airspeed")
    estimates = estimator.process(samples)

A class of your own joins as `create("package.module:Class")` or under a name of the entry-point group
`ahrs_sim.estimators`; it is made with `Class(site=..., sensors=..., **settings)` and needs a method `process(samples)
-> Estimates`. `create` imports what its caller names; names that come from a file of somebody else are the caller's to
check (`ahrs_sim.scenario.code` does so for the whole test bench).
"""

import contextlib
import importlib
import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from estimators.errors import SettingError
from estimators.navigator.settings import SETTINGS as NAVIGATOR
from estimators.settings import Setting, SettingValue, checked, nearest
from estimators.types import SensorInfo, Site

if TYPE_CHECKING:
    from estimators.estimator import Estimator

GROUP = "ahrs_sim.estimators"


@dataclass(frozen=True)
class Method:
    """One line of the catalogue."""

    name: str
    text: str  # what it is, one line
    source: str  # the paper
    filter: str  # of `estimators.filters`; empty: the setting "filter" says which
    model: str  # of `estimators.models`; of an estimator by itself or of another package, module:Class
    defaults: Mapping[str, SettingValue] = field(default_factory=dict)  # those that differ from the model's
    own: bool = True  # false: of another installed package, by its entry point
    package: str = ""  # that it needs besides
    given: Mapping[str, Setting] | None = None  # the settings, if they are not those of model and filter
    aiding: str = "none"  # what keeps the velocity, as in the setting of that name, where there is none

    @property
    def installed(self) -> bool:
        """Tell whether the package that the method needs is installed."""
        return not self.package or find_spec(self.package) is not None

    @cached_property
    def settings(self) -> Mapping[str, Setting]:
        """Return all settings with their defaults: the method's, then the model's, then the filter's."""
        if self.given is not None:
            return self.given
        known: dict[str, Setting] = {}
        if not self.filter:
            known["filter"] = Setting("ekf", "how the errors are estimated", FILTERS)
        known |= _module("models", self.model).SETTINGS
        if self.filter:
            known |= getattr(_module("filters", self.filter), "SETTINGS", {})
        return known | {name: replace(known[name], default=value) for name, value in self.defaults.items()}


def _module(kind: str, name: str) -> Any:
    return importlib.import_module(f"estimators.{kind}.{name}")


FILTERS = ("ekf", "iekf", "ckf", "cdkf", "ukf", "srckf", "srcdkf", "srukf")
_HAN = "Han, Gan, He and Alazard 2013"
_ZHAO = "Zhao, Jia, Jin, Tian and Xiong 2015"
_TIAN = "Tian, Sun, Li and Yan 2011"
_YAO = "Yao 2012"
_BELL = "Bell and Cathey 1993"
_OWN = "this project"

_METHODS = (
    Method("marg-ekf", "Extended Kalman filter on quaternion, body rate and gyro bias", _HAN, "ekf", "marg"),
    Method("marg-iekf", "marg-ekf that linearises a measurement again where it leads", _BELL, "iekf", "marg"),
    Method("marg-ckf", "Cubature Kalman filter on quaternion, body rate and gyro bias", _HAN, "ckf", "marg"),
    Method(
        "marg-cdkf", "Central difference Kalman filter on quaternion, body rate and gyro bias", _HAN, "cdkf", "marg"
    ),
    Method("marg-ukf", "Unscented Kalman filter on quaternion, body rate and gyro bias", _OWN, "ukf", "marg"),
    Method(
        "marg-srckf", "marg-ckf in square-root form: keeps the Cholesky factor of the covariance", _OWN, "srckf", "marg"
    ),
    Method("marg-srcdkf", "marg-cdkf in square-root form", _OWN, "srcdkf", "marg"),
    Method("marg-srukf", "marg-ukf in square-root form", _OWN, "srukf", "marg"),
    Method(
        "fakf", "Attitude error and gyro bias, noise of each sensor adapted to its innovations (fuzzy)", _TIAN,
        "", "attitude_error", {"adaptation": "fuzzy"},
    ),
    Method(
        "akf-standard", "Attitude error and gyro bias, noise as given: what fakf is compared with", _TIAN,
        "", "attitude_error",
    ),
    Method(
        "sekf", "Direction of gravity, no heading; the gyro alone while turning or accelerating", _YAO,
        "", "tilt", {"adaptation": "switched"},
    ),
    Method("tilt-ekf", "Direction of gravity, no heading: what sekf is compared with", _YAO, "", "tilt"),
    Method(
        "ins9-ukf", "Inertial navigator, 9 states; dual antenna or course by number of satellites", _ZHAO,
        "ukf", "ins9",
        aiding="gnss",
    ),
    Method("ins9-ekf", "The same, extended Kalman filter", _ZHAO, "ekf", "ins9", aiding="gnss"),
    Method("ins21", "Inertial navigator, GNSS velocity and position, magnetic heading, 21 states", _OWN, "", "ins"),
    Method(
        "ins-cal", "Inertial navigator that calibrates its sensors: GNSS, magnetic field, 61 states", _OWN,
        "", "estimators.navigator.navigator:Navigator", given=NAVIGATOR, aiding="gnss",
    ),
    Method(
        "ins15", "Inertial navigator, GNSS velocity and position, magnetic heading, 15 states", _OWN,
        "", "ins", {"states": "15"},
    ),
    Method(
        "air-ins", "Inertial navigator in the air mass: airspeed as body velocity, magnetic heading", _OWN,
        "", "ins",
        {"aiding": "airspeed", "accel_noise": 0.15, "scale_share": 0.5, "turn_share": 0.0, "heading_aid": False},
    ),
    Method(
        "hand-ins", "Inertial navigator that stays where it is: hand-held, no velocity aid", _OWN,
        "", "ins",
        {
            "aiding": "none", "mag_share": 6.0, "mag_sigma": 0.02, "field_period": 0.1, "scale_share": 0.4,
            "force_share": 0.0, "turn_share": 0.0, "shake_share": 0.0,
        },
    ),
)  # fmt: skip
_CATALOGUE = {method.name: method for method in _METHODS}


def names() -> list[str]:
    """The names `create` knows: the catalogue's, then those of installed packages (entry points)."""
    return [*_CATALOGUE, *sorted(point.name for point in metadata.entry_points(group=GROUP))]


def describe() -> list[Method]:
    """The catalogue: name, one line, source and settings with their defaults, of each method.

    Those of installed packages follow, as their classes say of themselves: first line of the docstring, `SOURCE`,
    `SETTINGS` (by name) and `PACKAGE`, what they need besides.
    """
    points = sorted(metadata.entry_points(group=GROUP), key=lambda point: point.name)
    return [*_METHODS, *map(_found, points)]


def _found(point: metadata.EntryPoint) -> Method:
    try:
        made = point.load()
    except Exception as error:  # of a package that is broken; the others can be listed all the same
        return Method(point.name, f"cannot be loaded: {error}", "", "", point.value, own=False, given={})
    text = (made.__doc__ or "").strip().partition("\n")[0].removesuffix(".")
    source, package = (str(getattr(made, name, "")) for name in ("SOURCE", "PACKAGE"))
    settings: Mapping[str, Setting] = getattr(made, "SETTINGS", {})
    return Method(point.name, text, source, "", point.value, own=False, package=package, given=settings)


def create(name: str, *, site: Site | None = None, sensors: SensorInfo | None = None, **settings: Any) -> "Estimator":
    """An estimator of the catalogue, of an entry point, or of a class given as `package.module:Class`.

    Args:
        name: see `names`.
        site: place, gravity and magnetic field; the default is a mid-latitude field without declination.
        sensors: data sheet figures; the default is a consumer grade MEMS.
        settings: see `describe`.

    Raises:
        SettingError: unknown name or setting (with the nearest one), a value of the wrong type or out of range.
    """
    site = site if site is not None else Site((0.0, 0.0, 0.0))
    sensors = sensors if sensors is not None else SensorInfo()
    _check_given(site, sensors)
    if name in _CATALOGUE:
        return _create(_CATALOGUE[name], site, sensors, settings)
    return _create_foreign(name, site, sensors, settings)


def prepare(
    methods: Sequence[tuple[str, Mapping[str, Any]]], progress: Callable[[str, int, int], None] = lambda *_: None
) -> None:
    """Compile, or load from the disk, the kernels of some methods, so that none of them does later.

    When there is much to compile, a second process begins with the last of it.

    Args:
        methods: name and settings of each; what is not of this catalogue is left out.
        progress: called with name, number and count of a method when something of it has to be compiled.

    Raises:
        SettingError: as `create`.
    """
    from estimators import native

    own = [(name, settings) for name, settings in methods if name in _CATALOGUE]
    plans = _planned(own)
    with _second(own) if sum(map(len, plans)) >= MANY else contextlib.nullcontext():
        for number, ((name, settings), plan) in enumerate(zip(own, plans, strict=True), 1):
            reported: list[None] = []

            def report(name: str = name, number: int = number, reported: list[None] = reported) -> None:
                if not reported:
                    reported.append(None)
                    progress(name, number, len(own))

            if plan:
                report()
            native.listeners.append(report)
            try:
                prepare_one = getattr(create(name, **settings), "prepare", None)
                if prepare_one is not None:
                    prepare_one()
            finally:
                native.listeners.remove(report)


MANY = 8
"""Kernels to compile from which on a second process is worth its start."""

_Plans = list[dict[Path, Callable[[], object]]]


def _planned(methods: Sequence[tuple[str, Mapping[str, Any]]]) -> _Plans:
    """List by method the kernels that are not on the disk and that no method before it has: file, and what makes it."""
    from estimators import native

    plans: _Plans = []
    with native.planning() as listed:
        for name, settings in methods:
            before = len(listed)
            made = create(name, **settings)
            if hasattr(made, "assemble"):
                made.assemble()
            plans.append(dict(list(listed.items())[before:]))
    return plans


@contextlib.contextmanager
def _second(methods: Sequence[tuple[str, Mapping[str, Any]]]) -> Iterator[None]:
    """Have a process of its own compile, last kernels first, whatever is not there yet."""
    from estimators.jit import FOLDER

    path = [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(FOLDER.parent), "PYTHONPATH": os.pathsep.join(path)}
    command = [sys.executable, "-W", "ignore", "-c", "from estimators.catalogue import _compile_last; _compile_last()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment) as process:
        try:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(pickle.dumps([(n, dict(s)) for n, s in methods]))  # type: ignore[union-attr]
                process.stdin.close()  # type: ignore[union-attr]
            yield
        finally:
            process.kill()


def _compile_last() -> None:
    """Run the second process."""
    plans = _planned(pickle.load(sys.stdin.buffer))
    for plan in reversed(plans):
        for path, compile_it in reversed(plan.items()):
            if not path.exists():
                compile_it()


def _create(method: Method, site: Site, sensors: SensorInfo, settings: Mapping[str, Any]) -> "Estimator":
    values = checked(method.name, method.settings, settings)
    if ":" in method.model:
        package, _, made = method.model.partition(":")
        return cast("Estimator", getattr(importlib.import_module(package), made)(method.name, values, site, sensors))
    from estimators.estimator import FilterEstimator  # compiles or loads kernels: not before it is needed
    from estimators.filters.base import Method as Filter

    module = _module("filters", method.filter or str(values["filter"]))
    filter_ = Filter(module, module.make(values))
    return FilterEstimator(method.name, filter_, _module("models", method.model), values, site, sensors)


def _create_foreign(name: str, site: Site, sensors: SensorInfo, settings: Mapping[str, Any]) -> "Estimator":
    made = _loaded(name)
    if not (isinstance(made, type) and callable(getattr(made, "process", None))):  # before anything is called
        raise SettingError(f"estimator '{name}' is not a class with a method 'process(samples)'")
    try:
        estimator = made(site=site, sensors=sensors, **settings)
    except TypeError as error:
        raise SettingError(f"estimator '{name}': {error}") from error
    return cast("Estimator", estimator)


def _loaded(name: str) -> Any:
    """The object of an entry point, or the one named `package.module:Class`."""
    points = [point for point in metadata.entry_points(group=GROUP) if point.name == name]
    module, colon, attribute = name.partition(":")
    if not points and not colon:
        raise SettingError(f"no estimator '{name}'{nearest(name, names())}")
    if not points and not all(part.isidentifier() for part in [*module.split("."), attribute]):
        raise SettingError(f"estimator '{name}' is not written package.module:Class")
    try:
        return points[0].load() if points else getattr(importlib.import_module(module), attribute)
    except Exception as error:  # whatever the module does when it is imported
        raise SettingError(f"estimator '{name}' cannot be loaded: {error or type(error).__name__}") from error


def _check_given(site: Site, sensors: SensorInfo) -> None:
    values = {f"site.{f.name}": (getattr(site, f.name), f.default) for f in fields(site)}
    values |= {f"sensors.{f.name}": (getattr(sensors, f.name), f.default) for f in fields(sensors)}
    for key, (value, default) in values.items():
        count = 3 if key == "site.lla" else len(default) if isinstance(default, tuple) else 0
        numbers = tuple(value) if count else (value,)
        if len(numbers) != max(count, 1):
            raise SettingError(f"{key}: {value} has {len(numbers)} numbers, expected {count}")
        if not all(math.isfinite(number) for number in numbers):
            raise SettingError(f"{key}: {value} is not finite")
        if key.startswith("sensors.") and key != "sensors.antenna_b" and min(numbers) < 0.0:
            raise SettingError(f"{key}: {value} is negative")
    latitude, longitude, height = site.lla
    if not (abs(latitude) <= math.pi / 2 and abs(longitude) <= 2.0 * math.pi and abs(height) < 1e6):
        raise SettingError(f"site.lla: {site.lla} is no place on Earth (latitude rad, longitude rad, height m)")
    if not site.gravity > 0.0:
        raise SettingError(f"site.gravity: {site.gravity} must be positive")
    if not math.hypot(site.mag_n[0], site.mag_n[1]) > 0.0:
        raise SettingError("site.mag_n: a vertical field gives no heading")
    if not sensors.rate > 0.0:
        raise SettingError(f"sensors.rate: {sensors.rate} must be positive")
