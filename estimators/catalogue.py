"""Named combinations of filter and model, and the way to a user's own class.

    estimator = create("marg-ckf", site=site, sensors=sensors, aiding="airspeed")
    estimates = estimator.process(samples)

A class of your own joins as `create("package.module:Class")` or under a name of the entry-point group
`ahrs_sim.estimators`; it is made with `Class(site=..., sensors=..., **settings)` and needs a method `process(samples)
-> Estimates`. `create` imports what its caller names; names that come from a file of somebody else are the caller's to
check (`ahrs_sim.scenario.code` does so for the whole test bench).
"""

import importlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib import metadata
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, cast

from estimators.errors import SettingError
from estimators.settings import Setting, checked, nearest
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
    filter: str  # module:maker; empty: the setting "filter" says which
    model: str  # module with `build`
    settings: Mapping[str, Setting]
    filter_settings: tuple[str, ...] = ()  # those that its maker takes
    own: bool = True  # false: of another installed package, by its entry point
    package: str = ""  # that it needs besides

    @property
    def installed(self) -> bool:
        """Whether the package that it needs is there."""
        return not self.package or find_spec(self.package) is not None


_START = {
    "initialisation": Setting(
        "aligned", "aligned: from a stationary stretch; paper: fixed state, large covariance", ("aligned", "paper")
    ),
    "align_s": Setting(20.0, "s, stationary stretch that is averaged", minimum=1.0, maximum=3600.0),
    "wait_s": Setting(60.0, "s, wait for it so long, then align coarsely", minimum=1.0, maximum=3600.0),
}


def _adaptation(default: str = "none", turn_deg: float = 2.0, accel: float = 0.02) -> dict[str, Setting]:
    """Settings of `estimators.adaptation`, for any method."""
    return {
        "adaptation": Setting(
            default, "how far measurements are trusted", ("none", "switched", "fuzzy", "gate", "magnetic")
        ),
        "switch_turn_rate": Setting(math.radians(turn_deg), "rad/s, switched: turning above it", above=0.0),
        "switch_accel": Setting(accel, "switched: accelerating when |f|/g is further than that from 1", above=0.0),
        "fuzzy_memory": Setting(0.98, "fuzzy: b, forgetting of the innovations", minimum=0.9, maximum=0.9999),
        "fuzzy_lowest": Setting(0.1, "fuzzy: least share of the variance", above=0.0, maximum=1.0),
        "fuzzy_highest": Setting(1e6, "fuzzy: most, in multiples of the variance", minimum=1.0),
        "gate_sigma": Setting(4.0, "gate: innovations beyond are refused", above=0.0),
        "gate_patience": Setting(5.0, "s, gate: refused so long without a break, believed again", minimum=0.0),
        "magnetic_norm": Setting(0.06, "magnetic: the field's strength is that far from the known one", above=0.0),
        "magnetic_dip": Setting(0.07, "rad, magnetic: its dip likewise", above=0.0),
        "magnetic_turn": Setting(0.12, "rad, magnetic: its direction likewise, as the gyro has carried it", above=0.0),
        "magnetic_hold": Setting(1.0, "s, magnetic: refused so long after it was last disturbed", minimum=0.0),
        "magnetic_patience": Setting(30.0, "s, magnetic: refused so long without a break, believed again", minimum=0.0),
    }


_MARG = {
    **_START,
    "aiding": Setting("none", "what is added to gravity in the accelerometer's model", ("none", "airspeed", "gnss")),
    "noise": Setting(
        "auto",
        "from-ground: R and Q from the stationary stretch (the paper); practical: the settings below; "
        "auto: from-ground without aiding, practical with it",
        ("auto", "from-ground", "practical"),
    ),
    "accel_sigma": Setting(3.0, "m/s2, practical: vibration, turbulence and model errors, not sensor noise", above=0.0),
    "mag_sigma": Setting(4e-6, "T, practical", above=0.0),
    "rate_noise": Setting(0.035, "rad/s per sqrt(s), practical: how fast the body rate may change", above=0.0),
    "bias_walk": Setting(3e-5, "rad/s per sqrt(s), random walk of the gyro bias", minimum=0.0),
    "speed_filter": Setting(0.5, "s, time constant of the derivative of the airspeed", above=0.0),
    "speed_min": Setting(8.0, "m/s, below it the airspeed may be wind on the ground: not used", minimum=0.0),
    "incidence": Setting(
        0.05, "rad, angle of attack without vane; aeroplanes cruise at 2 to 4 deg", minimum=-0.3, maximum=0.3
    ),
    "scale_share": Setting(0.4, "practical: of the gyro's scale error, noise that grows with the rate", minimum=0.0),
    "scale_time": Setting(5.0, "s, practical: how long a rate lasts: correlation of that noise", above=0.0),
    "unaided_factor": Setting(11.0, "on the accelerometer's variance while the aid is silent", minimum=1.0),
    **_adaptation(),
}
_FILTERS = {
    "ekf": "estimators.filters.ekf:Ekf",
    "ckf": "estimators.filters.ckf:ckf",
    "cdkf": "estimators.filters.cdkf:cdkf",
    "ukf": "estimators.filters.ukf:ukf",
    "srckf": "estimators.filters.square_root:srckf",
    "srcdkf": "estimators.filters.square_root:srcdkf",
    "srukf": "estimators.filters.square_root:srukf",
}


def _ins(aiding: str, states: str = "21", **values: float) -> dict[str, Setting]:
    """Settings of the navigators; `values` are defaults of this one that differ."""
    known = {
        "filter": Setting("ekf", "how the errors are estimated", tuple(_FILTERS)),
        **{name: setting for name, setting in _START.items() if name != "initialisation"},
        "aiding": Setting(aiding, "what keeps the velocity", ("none", "gnss", "airspeed", "gnss+airspeed")),
        "states": Setting(
            states, "15, or 21 with gyro scale and hard iron (and the wind with gnss+airspeed)", ("15", "21")
        ),
        "heading_aid": Setting(True, "use the dual-antenna heading where there is one"),
        "gyro_noise": Setting(1e-3, "rad/s/sqrt(Hz), beside the data sheet's: vibration", minimum=0.0),
        "scale_share": Setting(0.5, "of the gyro's scale error, left as noise that grows with the rate", minimum=0.0),
        "scale_time": Setting(5.0, "s, how long a rate lasts: correlation of that noise", above=0.0),
        "accel_noise": Setting(0.05, "m/s2/sqrt(Hz), beside the data sheet's: vibration, turbulence", minimum=0.0),
        "accel_share": Setting(0.014, "1/sqrt(Hz), besides, of the acceleration: scale, lever arm", minimum=0.0),
        "jerk_share": Setting(2.0, "of the gyro's variance between samples, left as noise of one step", minimum=0.0),
        "bias_time": Setting(300.0, "s, correlation of the in-run biases", above=0.0),
        "velocity_share": Setting(1.0, "of the receiver's velocity sigma", above=0.0),
        "position_share": Setting(0.2, "of the receiver's position sigma, noise from fix to fix", above=0.0),
        "position_time": Setting(60.0, "s, over which the rest of a fix's error wanders", above=0.0),
        "gnss_time": Setting(0.02, "s, error of the time of a fix: noise while accelerating", minimum=0.0),
        "heading_share": Setting(4.5, "of the dual-antenna sigma, whose error is correlated", above=0.0),
        "mag_share": Setting(1.7, "of the hard iron left over: noise of the field's direction", minimum=0.0),
        "mag_sigma": Setting(0.008, "rad, besides, of the direction of the field", above=0.0),
        "field_period": Setting(
            1.0, "s, from one use of the field to the next: errors between are the same", minimum=0.0
        ),
        "norm_scale": Setting(0.05, "relative error of the field's norm that doubles the noise", above=0.0),
        "dip_scale": Setting(0.1, "rad, error of the dip that doubles the noise", above=0.0),
        "speed_sigma": Setting(1.0, "m/s, of the airspeed along the body", above=0.0),
        "incidence": Setting(
            0.05, "rad, angle of attack without vane; aeroplanes cruise at 2 to 4 deg", minimum=-0.3, maximum=0.3
        ),
        "side": Setting(0.1, "of the airspeed, sideways, without vane", above=0.0),
        "vertical": Setting(0.15, "of the airspeed, downwards, without vane", above=0.0),
        "speed_min": Setting(8.0, "m/s, below it the airspeed may be wind on the ground: not used", minimum=0.0),
        "wind_walk": Setting(0.3, "m/s per sqrt(s), random walk of the wind", minimum=0.0),
        **_adaptation(),
    }
    return known | {name: replace(known[name], default=value) for name, value in values.items()}


_ALIGNED = {name: setting for name, setting in _START.items() if name != "initialisation"}


def _attitude_error(adaptation: str) -> dict[str, Setting]:
    return {
        "filter": Setting("ekf", "how the errors are estimated", tuple(_FILTERS)),
        **_ALIGNED,
        "noise": Setting(
            "practical",
            "sensors: R from the data sheet; from-ground: from the stationary stretch; practical: the settings below",
            ("practical", "from-ground", "sensors"),
        ),
        "accel_sigma": Setting(3.0, "m/s2, practical: manoeuvres and vibration, not sensor noise", above=0.0),
        "mag_sigma": Setting(4e-6, "T, practical", above=0.0),
        "bias_walk": Setting(3e-5, "rad/s per sqrt(s), random walk of the gyro bias", minimum=0.0),
        **_adaptation(adaptation),
    }


def _tilt(adaptation: str) -> dict[str, Setting]:
    return {
        "filter": Setting("ekf", "how the errors are estimated", tuple(_FILTERS)),
        **_ALIGNED,
        "accel_sigma": Setting(0.05, "of the measured direction of gravity, in parts of gravity", above=0.0),
        "gyro_noise": Setting(3e-4, "rad/s/sqrt(Hz), at least that, beside the data sheet's", minimum=0.0),
        "bias_time": Setting(100.0, "s, low-pass of the gyro bias; shorter swings with the tilt", above=0.0),
        "bias_start": Setting("aligned", "gyro bias before it is learned", ("aligned", "zero")),
        **_adaptation(adaptation, accel=0.01),
    }


_INS9 = {
    **_ALIGNED,
    "heading_aid": Setting(True, "use dual antenna and course; false: place and velocity alone"),
    "rodrigues_a": Setting(1.0, "a of the generalised Rodrigues parameters", minimum=0.0, maximum=1.0),
    "gyro_noise": Setting(1e-3, "rad/s/sqrt(Hz), at least that: biases and scale, which are no states", minimum=0.0),
    "accel_noise": Setting(0.05, "m/s2/sqrt(Hz), at least that, likewise", minimum=0.0),
    "position_share": Setting(3.0, "of the receiver's position sigma, whose error is correlated", above=0.0),
    "velocity_share": Setting(1.5, "of the receiver's velocity sigma", above=0.0),
    "heading_share": Setting(3.0, "of the dual-antenna sigma, whose error is correlated", above=0.0),
    "drift_sigma": Setting(0.02, "rad, between course and heading; an aircraft in wind: wind over airspeed", above=0.0),
    "course_speed": Setting(3.0, "m/s, no course below it", above=0.0),
    "wind_north": Setting(
        0.0, "m/s, known wind (towards north), taken off before the course", minimum=-100, maximum=100
    ),
    "wind_east": Setting(0.0, "m/s, towards east", minimum=-100, maximum=100),
    **_adaptation("switched", accel=1000.0),
}
_UKF = {
    "alpha": Setting(1.0, "spread of the sigma points", above=0.0, maximum=2.0),
    "beta": Setting(2.0, "weight of the centre in the covariance, 2 for a Gaussian", minimum=0.0),
    "kappa": Setting(0.0, "further spread, n + kappa", minimum=0.0),
}
_CDKF = {"h": Setting(math.sqrt(3.0), "interval of the central differences", minimum=1.0)}
_PAPER_0 = "Han, Gan, He and Alazard 2013"
_PAPER_1 = "Zhao, Jia, Jin, Tian and Xiong 2015"
_PAPER_2 = "Tian, Sun, Li and Yan 2011"
_PAPER_4 = "Yao 2012"
_OWN = "beyond the papers"

_METHODS = (
    Method(
        "marg-ekf", "Extended Kalman filter on quaternion, body rate and gyro bias", _PAPER_0,
        "estimators.filters.ekf:Ekf", "estimators.models.marg", _MARG,
    ),
    Method(
        "marg-ckf", "Cubature Kalman filter on quaternion, body rate and gyro bias", _PAPER_0,
        "estimators.filters.ckf:ckf", "estimators.models.marg", _MARG,
    ),
    Method(
        "marg-cdkf", "Central difference Kalman filter on quaternion, body rate and gyro bias", _PAPER_0,
        "estimators.filters.cdkf:cdkf", "estimators.models.marg", {**_MARG, **_CDKF}, ("h",),
    ),
    Method(
        "marg-ukf", "Unscented Kalman filter on quaternion, body rate and gyro bias", _OWN,
        "estimators.filters.ukf:ukf", "estimators.models.marg", {**_MARG, **_UKF}, tuple(_UKF),
    ),
    Method(
        "marg-srckf", "marg-ckf in square-root form: keeps the Cholesky factor of the covariance", _OWN,
        "estimators.filters.square_root:srckf", "estimators.models.marg", _MARG,
    ),
    Method(
        "marg-srcdkf", "marg-cdkf in square-root form", _OWN,
        "estimators.filters.square_root:srcdkf", "estimators.models.marg", {**_MARG, **_CDKF}, ("h",),
    ),
    Method(
        "marg-srukf", "marg-ukf in square-root form", _OWN,
        "estimators.filters.square_root:srukf", "estimators.models.marg", {**_MARG, **_UKF}, tuple(_UKF),
    ),
    Method(
        "fakf", "Attitude error and gyro bias, noise of each sensor adapted to its innovations (fuzzy)", _PAPER_2,
        "", "estimators.models.attitude_error", _attitude_error("fuzzy"),
    ),
    Method(
        "akf-standard", "Attitude error and gyro bias, noise as told: what fakf is compared with", _PAPER_2,
        "", "estimators.models.attitude_error", _attitude_error("none"),
    ),
    Method(
        "sekf", "Direction of gravity, no heading; the gyro alone while turning or accelerating", _PAPER_4,
        "", "estimators.models.tilt", _tilt("switched"),
    ),
    Method(
        "tilt-ekf", "Direction of gravity, no heading: what sekf is compared with", _PAPER_4,
        "", "estimators.models.tilt", _tilt("none"),
    ),
    Method(
        "ins9-ukf", "Inertial navigator, 9 states; dual antenna or course by number of satellites", _PAPER_1,
        "estimators.filters.ukf:ukf", "estimators.models.ins9", {**_INS9, **_UKF}, tuple(_UKF),
    ),
    Method(
        "ins9-ekf", "The same, extended Kalman filter", _PAPER_1,
        "estimators.filters.ekf:Ekf", "estimators.models.ins9", _INS9,
    ),
    Method(
        "ins21", "Inertial navigator, GNSS velocity and position, magnetic heading, 21 states", _OWN,
        "", "estimators.models.ins", _ins("gnss"),
    ),
    Method(
        "ins15", "Inertial navigator, GNSS velocity and position, magnetic heading, 15 states", _OWN,
        "", "estimators.models.ins", _ins("gnss", "15"),
    ),
    Method(
        "air-ins", "Inertial navigator in the air mass: airspeed as body velocity, magnetic heading", _OWN,
        "", "estimators.models.ins", _ins("airspeed", accel_noise=0.15),
    ),
    Method(
        "hand-ins", "Inertial navigator that stays where it is: hand-held, no velocity aid", _OWN,
        "", "estimators.models.ins", _ins("none", mag_share=6.0, mag_sigma=0.02, field_period=0.1, scale_share=0.4),
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
        return Method(point.name, f"cannot be loaded: {error}", "", "", point.value, {}, own=False)
    text = (made.__doc__ or "").strip().partition("\n")[0].removesuffix(".")
    source, package = (str(getattr(made, told, "")) for told in ("SOURCE", "PACKAGE"))
    settings: Mapping[str, Setting] = getattr(made, "SETTINGS", {})
    return Method(point.name, text, source, "", point.value, settings, own=False, package=package)


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


def _create(method: Method, site: Site, sensors: SensorInfo, settings: Mapping[str, Any]) -> "Estimator":
    values = checked(method.name, method.settings, settings)
    from estimators.estimator import FilterEstimator  # compiles or loads kernels: not before it is needed

    module, _, attribute = (method.filter or _FILTERS[str(values["filter"])]).partition(":")
    make_filter = getattr(importlib.import_module(module), attribute)
    build = importlib.import_module(method.model).build
    filter_ = make_filter(**{key: values[key] for key in method.filter_settings})
    return FilterEstimator(method.name, filter_, build, values, site, sensors)


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
    values = {f"site.{f.name}": getattr(site, f.name) for f in fields(site)}
    values |= {f"sensors.{f.name}": getattr(sensors, f.name) for f in fields(sensors)}
    for key, value in values.items():
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(math.isfinite(number) for number in numbers):
            raise SettingError(f"{key}: {value} is not finite")
        if key.startswith("sensors.") and key != "sensors.antenna_b" and min(numbers) < 0.0:
            raise SettingError(f"{key}: {value} is negative")
    if not site.gravity > 0.0:
        raise SettingError(f"site.gravity: {site.gravity} must be positive")
    if not math.hypot(site.mag_n[0], site.mag_n[1]) > 0.0:
        raise SettingError("site.mag_n: a vertical field gives no heading")
    if not sensors.rate > 0.0:
        raise SettingError(f"sensors.rate: {sensors.rate} must be positive")
