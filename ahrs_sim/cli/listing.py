"""`ahrs-sim list`: scenarios, aircraft, grades, estimators, layouts, maps, the C interface."""

import argparse
import json
from typing import Any

from ahrs_sim.cli.common import Commands


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("list", help="list scenarios, aircraft, grades, estimators or layouts")
    command.add_argument("what", choices=[*_LISTS, "interface"])
    command.add_argument("--json", action="store_true")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print the scenarios, aircraft, grades, estimators or layouts there are."""
    if arguments.what == "interface":
        from ahrs_sim.plugins.layout import HEADER

        print(HEADER.read_text(encoding="utf-8"), end="")
        return
    rows = _LISTS[arguments.what]()
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    table = [[str(v) for v in row.values() if not isinstance(v, dict)] for row in rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for cells in table:
        print("  ".join(f"{cell:{width}s}" for cell, width in zip(cells, widths, strict=True)).rstrip())


def _scenarios() -> list[dict[str, Any]]:
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.scenario.shipped import scenario_dir

    loaded = [scenarios.load(str(path)) for path in sorted(scenario_dir().glob("*.toml"))]
    return [{"name": s.name, "title": s.data.get("title", "")} for s in loaded]


def _aircraft() -> list[dict[str, Any]]:
    from ahrs_sim.flight.fdm import aircraft
    from ahrs_sim.scenario.shipped import aircraft_dir

    ours = aircraft_dir()
    return [{"name": n, "from": "ahrs_sim" if ours in p.parents else "JSBSim"} for n, p in aircraft().items()]


def _grades() -> list[dict[str, Any]]:
    from ahrs_sim import sensors

    return sensors.grades()


def _estimators() -> list[dict[str, Any]]:
    import estimators

    return [
        {
            "name": m.name,
            "source": m.source if m.installed else f"{m.source}; '{m.package}' is not installed",
            "text": m.text,
            "settings": {k: v.default for k, v in m.settings.items()},
        }
        for m in estimators.describe()
    ]


def _manoeuvres() -> list[dict[str, Any]]:
    from ahrs_sim import reference

    return [
        {
            "name": name,
            "text": " ".join(text.partition("\n\n")[0].split()),
            "keys": {k: {"value": reference.limits(v), "default": reference.default(v)} for k, v in keys.items()},
        }
        for name, (text, keys) in reference.manoeuvres().items()
    ]


def _faults() -> list[dict[str, Any]]:
    from ahrs_sim import reference

    return [{"name": kind, "keys": ", ".join(keys)} for kind, keys in reference.faults().items()]


def _maps() -> list[dict[str, Any]]:
    from ahrs_sim.recordings import presets

    return [dict(row) for row in presets.describe()]


def _layouts() -> list[dict[str, Any]]:
    from ahrs_sim.log import layouts

    return layouts.describe()


_LISTS = {
    "scenarios": _scenarios,
    "aircraft": _aircraft,
    "grades": _grades,
    "estimators": _estimators,
    "layouts": _layouts,
    "maps": _maps,
    "manoeuvres": _manoeuvres,
    "faults": _faults,
}
