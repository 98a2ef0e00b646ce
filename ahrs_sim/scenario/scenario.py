"""A scenario: one TOML file that describes a whole flight.

`load(name_or_path)` finds the file (a path, or the name of a shipped scenario), follows `extends`, applies what the
command line overrides, checks every key and returns a `Scenario`. Angles are degrees in the file, radians from here on.
"""

import copy
import datetime
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.scenario.code import ANY, Gate, named
from ahrs_sim.scenario.component import Component, estimator_component
from ahrs_sim.scenario.shipped import scenario_dir
from ahrs_sim.scenario.table import MAX_DEPTH, Table, is_file, overlay, read_toml

TURBULENCE = {"none": 0.0, "light": 7.62, "moderate": 15.24, "severe": 22.86}
"""Severity -> wind speed at 20 ft above ground in m/s (25, 50, 75 ft/s; MIL-F-8785C, section 3.7.3)."""

DEFAULT_SUITES: dict[str, Any] = {"chr": {"grade": "chr_6dm"}, "sbg": {"grade": "sbg_ig500"}}
DEFAULT_ESTIMATORS: dict[str, Any] = {
    "ekf-chr": {"method": "marg-ekf", "suite": "chr"},
    "ckf-chr": {"method": "marg-ckf", "suite": "chr"},
    "cdkf-chr": {"method": "marg-cdkf", "suite": "chr"},
    "ekf-sbg": {"method": "marg-ekf", "suite": "sbg"},
}
"""The line-up of Han et al. 2013: three filters on the low-cost unit, the EKF on the better one as reference."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_OWN, _FOREIGN = Gate(ANY), Gate()


@dataclass(frozen=True)
class Start:
    """Place, speed and attitude at the start of a flight."""

    latitude: float  # rad, geodetic
    longitude: float  # rad
    altitude: float  # m, of the ground above sea level, taken as the ellipsoid
    heading: float  # rad, true
    on_ground: bool
    height: float  # m above ground, in the air
    airspeed: float  # m/s, in the air
    roll: float  # rad
    pitch: float  # rad


@dataclass(frozen=True)
class Gust:
    """A one-minus-cosine gust: it rises, holds and falls, each for `rise`."""

    at: float  # s
    speed: float  # m/s, peak
    rise: float  # s
    from_: float  # rad, true bearing it comes from


@dataclass(frozen=True)
class Wind:
    """Steady wind, turbulence and gusts."""

    speed: float  # m/s
    from_: float  # rad, true bearing it comes from
    turbulence: str  # a key of TURBULENCE
    at_20ft: float  # m/s, wind at 20 ft (6 m) above ground that sets the turbulence's intensity
    gusts: tuple[Gust, ...]
    roughness: float = 0.0  # m, of the ground: the wind grows with the logarithm of height; 0: the same at every height


@dataclass(frozen=True)
class Scenario:
    """A checked scenario."""

    name: str
    data: dict[str, Any]  # the effective TOML, everything that `extends` and the command line changed included
    where: str  # file, for messages
    aircraft: str
    script: str | None  # a script of JSBSim's instead of steps
    motion: Table | None  # truth from a formula instead of an aircraft
    seed: int
    epoch: datetime.datetime
    rate: float  # Hz, of the truth
    truth_rate: float  # Hz, of the truth in the log
    duration: float | None  # s; None: to the end of the steps
    start: Start
    wind: Wind
    steps: tuple[Table, ...]
    pilot_attitude: str  # "truth", or the estimator that the autopilot flies on
    suites: tuple[Component, ...]
    estimators: tuple[Component, ...]
    faults: tuple[Component, ...]
    notes: tuple[str, ...] = ()  # what the user should know

    @property
    def code(self) -> tuple[str, ...]:
        """Code from outside that its estimators run."""
        return tuple(dict.fromkeys(e.code for e in self.estimators if e.code))

    @property
    def epoch_ns(self) -> int:
        """The epoch in ns since 1970."""
        return int(self.epoch.timestamp()) * 10**9 + self.epoch.microsecond * 1000

    def unreached(self, end: float) -> list[str]:
        """Name the faults that begin only after the flight's end (s), a line each for the user."""
        late = [(f, at) for f in self.faults if isinstance(at := f.settings.get("at_s"), int | float) and at >= end]
        return [f"{f.where}: at_s = {at:g}: never happens, the flight ends at {end:.0f} s" for f, at in late]

    def toml(self) -> str:
        """Write the effective scenario as TOML; flying this text gives the same log again."""
        import tomli_w

        return tomli_w.dumps(self.data)


def find(name: str) -> Path:
    """Find the file of a scenario given as a path or by the name of a shipped one.

    Raises:
        InputError: there is neither.
    """
    path = Path(name)
    if path.suffix == ".toml" or is_file(path):
        return path
    shipped = {p.stem: p for p in scenario_dir().glob("*.toml")}
    if name in shipped:
        return shipped[name]
    raise InputError(f"{name}: no such scenario{nearest(name, shipped)}")


def load(
    name: str,
    *,
    seed: int | None = None,
    duration: float | None = None,
    estimators: Sequence[str] = (),
    pilot: str | None = None,
    gate: Gate = _OWN,
) -> Scenario:
    """Read and check a scenario.

    Args:
        name: path of a TOML file, or the name of a shipped scenario.
        seed, duration: replace the file's.
        pilot: the estimator that the autopilot flies on, or "truth", instead of the file's.
        estimators: keep only these: names of the file's `[estimator.NAME]`, or `METHOD@SUITE` for one of the catalogue.
        gate: what code from outside it may run: all, as a file of the user's own.

    Raises:
        InputError: what is wrong, in which file and key, and what to do.
    """
    path = find(name)
    return parse(
        _merged(path),
        str(path),
        path.stem,
        seed=seed,
        duration=duration,
        estimators=estimators,
        pilot=pilot,
        gate=gate,
    )


def parse(
    data: dict[str, Any],
    where: str,
    name: str,
    *,
    seed: int | None = None,
    duration: float | None = None,
    estimators: Sequence[str] = (),
    pilot: str | None = None,
    gate: Gate = _FOREIGN,
) -> Scenario:
    """Check TOML data that is already there, e.g. the scenario kept in a log, as `load` does a file.

    Of code from outside only that of `estimators` and what `gate` lets pass may run.
    """
    data = copy.deepcopy(data)
    if seed is not None:
        data["seed"] = seed
    if duration is not None:
        data["duration_s"] = duration
    if pilot is not None:
        data["pilot"] = {"attitude": pilot}
    data.setdefault("suite", copy.deepcopy(DEFAULT_SUITES))
    notes = _add_catalogue(data, where)
    data.setdefault("estimator", _line_up(data["suite"]))
    data = _chosen(data, where)
    if estimators and isinstance(data["estimator"], dict):
        data["estimator"] = _selected(data["estimator"], estimators, f"{where}: --estimator")
    table = Table(data, where)
    table.text("title", "")
    motion = table.table("motion") if table.has("motion") else None
    script = table.text("script", "") or None
    steps = tuple(table.list_of_tables("step"))
    if motion is not None and (script or steps):
        raise table.error("motion", "a motion takes neither script nor [[step]]; keep one of them")
    if script and steps:
        raise table.error("script", "a script and [[step]] exclude each other; keep one of them")
    if motion is None and script is None and not steps:
        raise table.error("step", "missing; add [[step]] tables, or script, or [motion]")
    scenario = Scenario(
        name=name,
        data=data,
        where=where,
        aircraft=table.text("aircraft", "" if motion is not None or script else "trainer"),
        script=script,
        motion=motion,
        seed=table.integer("seed", 0, minimum=0),
        epoch=table.date("epoch", datetime.datetime(2026, 6, 1, 10, tzinfo=datetime.UTC)),
        rate=(rate := table.number("rate_hz", 400.0, minimum=50.0, maximum=2000.0)),
        truth_rate=table.number("truth_rate_hz", min(100.0, rate), minimum=10.0, maximum=rate),
        duration=table.number("duration_s", None, above=0.0),
        start=_start(table.table("start")),
        wind=_wind(table.table("wind")),
        steps=steps,
        pilot_attitude=_pilot(table.table("pilot")),
        suites=_components(table, "suite"),
        estimators=_estimators(table, gate.also(named(estimators)), estimators),
        faults=tuple(Component(f"fault-{i + 1}", t.data, t.where) for i, t in enumerate(table.list_of_tables("fault"))),
        notes=() if estimators else notes,
    )
    table.close()
    _check_links(scenario)
    if scenario.duration is not None and (late := scenario.unreached(scenario.duration)):
        return replace(scenario, notes=(*scenario.notes, *late))
    return scenario


def _line_up(suites: Any) -> dict[str, Any]:
    """Make the estimators of a scenario that names none: the default ones, or the same on the suites that it has."""
    if not isinstance(suites, dict) or not suites or suites.keys() >= DEFAULT_SUITES.keys():
        return copy.deepcopy(DEFAULT_ESTIMATORS)
    first, *others = suites
    made = {f"{name}-{first}": {"method": f"marg-{name}", "suite": first} for name in ("ekf", "ckf", "cdkf")}
    return made | {f"ekf-{suite}": {"method": "marg-ekf", "suite": suite} for suite in others}


def _add_catalogue(data: dict[str, Any], where: str) -> tuple[str, ...]:
    """Expand `catalogue = "SUITE"` into every method on that suite that the scenario does not name itself.

    `METHOD-SUITE`, and `METHOD-air-SUITE` with the airspeed for what does not correct the accelerometer itself.
    Methods whose package is not installed are left out with a note.
    """
    if "catalogue" not in data or not isinstance(data.get("estimator", {}), dict):
        return ()
    suite = Table(data, where).text("catalogue")
    del data["catalogue"]
    from estimators.catalogue import describe

    named: dict[str, Any] = data.get("estimator", {})
    missing: dict[str, None] = {}
    taken = [{"aiding": "none", **settings} for settings in named.values() if isinstance(settings, dict)]
    for method in describe():
        aiding = method.settings.get("aiding")
        aided = aiding is not None and aiding.default == "none" and "states" not in method.settings
        for name, more in ((method.name, {}), *([(f"{method.name}-air", {"aiding": "airspeed"})] if aided else [])):
            wanted = {"method": method.name, "suite": suite, **more}
            if not method.installed:
                missing[method.package] = None
            elif {"aiding": "none", **wanted} not in taken:
                named.setdefault(f"{name}-{suite}", wanted)
    data["estimator"] = named
    if not missing:
        return ()
    return (
        f"without the estimators of {', '.join(missing)}, not installed (the peers: pip install 'ahrs-sim[peers]')",
    )


def _merged(path: Path, seen: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Lay a file's data over those of the scenario that it extends: merge tables, replace everything else."""
    table = read_toml(path)
    parent = table.text("extends", "")
    data = {k: v for k, v in table.data.items() if k != "extends"}
    if not parent:
        return _chosen(data, str(path))
    beside = path.parent / f"{parent}.toml"
    base = beside if is_file(beside) else find(parent)
    if base in (*seen, path):
        raise table.error("extends", f"'{parent}' leads back to this file; break the circle")
    if len(seen) == MAX_DEPTH:
        raise table.error("extends", f"goes through more than {MAX_DEPTH} files; extend one of them directly")
    return _chosen(overlay(_merged(base, (*seen, path)), data), str(path))


def _chosen(data: dict[str, Any], where: str) -> dict[str, Any]:
    """Keep the estimators, inherited ones included, that `estimators = [...]` of the file names."""
    if "estimators" not in data:
        return data
    names = Table(data, where).texts("estimators")
    tables = data.get("estimator", _line_up(data.get("suite", DEFAULT_SUITES)))
    rest = {k: v for k, v in data.items() if k != "estimators"}
    return {**rest, "estimator": _selected(tables, names, f"{where}: estimators")} if isinstance(tables, dict) else rest


def _selected(tables: dict[str, Any], names: Sequence[str], where: str) -> dict[str, Any]:
    chosen: dict[str, Any] = {}
    for name in names:
        method, at, suite = name.rpartition("@")
        if name in tables:
            chosen[name] = tables[name]
        elif at:
            chosen[_key(name)] = {"method": method, "suite": suite}
        else:
            raise InputError(
                f"{where}: {name}: no [estimator.{name}]{nearest(name, tables)} or METHOD@SUITE, e.g. marg-ckf@chr"
            )
    return chosen


def _key(option: str) -> str:
    """Make the name of the estimator that `METHOD@SUITE` asks for."""
    method, _, suite = option.rpartition("@")
    return f"{short_name(method)}-{suite}"


def short_name(method: str) -> str:
    """Make the name of a method's estimator: for a library or an FMU that of its file."""
    if method.startswith(("lib:", "fmu:")):
        method = Path(method.partition(":")[2]).stem
    elif ".py:" in method:
        path, _, name = method.rpartition(":")
        method = f"{Path(path).stem}-{name}"
    return re.sub(r"[^A-Za-z0-9_-]", "-", method).lstrip("-_0123456789") or "plug-in"


def _start(table: Table) -> Start:
    on_ground = table.flag("on_ground", True)
    start = Start(
        latitude=math.radians(table.number("latitude_deg", 43.57, minimum=-89.0, maximum=89.0)),
        longitude=math.radians(table.number("longitude_deg", 1.47, minimum=-180.0, maximum=180.0)),
        altitude=table.number("altitude_m", 150.0, minimum=-400.0, maximum=9000.0),
        heading=math.radians(table.number("heading_deg", 0.0, minimum=-360.0, maximum=360.0)),
        on_ground=on_ground,
        height=0.0 if on_ground else table.number("height_m", 100.0, above=0.0),
        airspeed=0.0 if on_ground else table.number("airspeed_mps", 20.0, above=0.0),
        roll=0.0 if on_ground else math.radians(table.number("roll_deg", 0.0, minimum=-180.0, maximum=180.0)),
        pitch=0.0 if on_ground else math.radians(table.number("pitch_deg", 0.0, minimum=-90.0, maximum=90.0)),
    )
    table.close()
    return start


def _wind(table: Table) -> Wind:
    speed = table.number("speed_mps", 0.0, minimum=0.0, maximum=60.0)
    from_ = math.radians(table.number("from_deg", 0.0, minimum=-360.0, maximum=360.0))
    gusts = []
    for gust in table.list_of_tables("gust"):
        gusts.append(
            Gust(
                at=gust.number("at_s", minimum=0.0),
                speed=gust.number("speed_mps", minimum=0.0, maximum=60.0),
                rise=gust.number("rise_s", 1.0, above=0.0),
                from_=math.radians(gust.number("from_deg", math.degrees(from_), minimum=-360.0, maximum=360.0)),
            )
        )
        gust.close()
    turbulence = table.choice("turbulence", list(TURBULENCE), "none")
    at_20ft = table.number("at_20ft_mps", TURBULENCE[turbulence], minimum=0.0, maximum=60.0)
    roughness = table.number("roughness_m", 0.0, minimum=0.0, maximum=1.0)
    wind = Wind(speed, from_, turbulence, at_20ft, tuple(gusts), roughness)
    table.close()
    return wind


def _pilot(table: Table) -> str:
    attitude = table.text("attitude", "truth")
    table.close()
    return attitude


def _components(table: Table, kind: str) -> tuple[Component, ...]:
    return tuple(Component(name, settings.data, settings.where) for name, settings in _named(table, kind).items())


def _estimators(table: Table, gate: Gate, asked: Sequence[str]) -> tuple[Component, ...]:
    """Make the components; one that the command line asked for as METHOD@SUITE names that option in its errors."""
    options = {_key(name): f"{table.where}: --estimator {name}" for name in asked if "@" in name}
    tables = _named(table, "estimator")
    return tuple(estimator_component(name, t.data, options.get(name, t.where), gate) for name, t in tables.items())


def _named(table: Table, kind: str) -> dict[str, Table]:
    tables = table.named_tables(kind)
    for name, settings in tables.items():
        if not _NAME.fullmatch(name):
            raise settings.error(name, "a name is letters, digits, - and _, a letter first; rename it")
    return tables


def _check_links(scenario: Scenario) -> None:
    """Check that suites, estimators and faults which others name exist."""
    suites = [s.name for s in scenario.suites]
    for component in scenario.estimators:
        table = component.table()
        table.choice("suite", suites)
    names = [e.name for e in scenario.estimators]
    if scenario.pilot_attitude != "truth" and scenario.pilot_attitude not in names:
        choices = ["truth", *names]
        raise InputError(
            f"{scenario.where}: [pilot]: attitude: '{scenario.pilot_attitude}' is no estimator of this scenario"
            f"{nearest(scenario.pilot_attitude, choices)}"
        )
