"""`ahrs-sim list`: scenarios, aircraft, grades, estimators, layouts, maps, the C interface."""

import argparse
import json
import shutil
import sys
import textwrap
from collections.abc import Iterable
from typing import Any

from ahrs_sim.cli.common import Commands
from ahrs_sim.errors import InputError, nearest


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("list", help="list scenarios, aircraft, grades, estimators or layouts")
    command.add_argument("what", choices=[*_LISTS, "interface"])
    command.add_argument("name", nargs="?", metavar="NAME", help="only this one, with every figure or setting")
    command.add_argument("--json", action="store_true", help="print JSON")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print the scenarios, aircraft, grades, estimators or layouts there are."""
    if arguments.what == "interface":
        from ahrs_sim.plugins.layout import HEADER

        print(HEADER.read_text(encoding="utf-8"), end="")
        return
    rows = _LISTS[arguments.what]()
    if arguments.name is not None:
        key = next(iter(rows[0]))
        known = dict.fromkeys(row[key] for row in rows)
        rows = [row for row in rows if row[key] == arguments.name]
        if not rows:
            raise InputError(f"list {arguments.what}: no '{arguments.name}'{nearest(arguments.name, known)}")
    elif arguments.what == "grades" and not arguments.json:
        rows = [{"grade": row["grade"], "title": row["figure"]} for row in rows if not row["mark"]]
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    _print([str(v).rstrip() for v in row.values() if not isinstance(v, dict)] for row in rows)
    if arguments.name is not None:
        for values in (v for row in rows for v in row.values() if isinstance(v, dict)):
            print("\n".join(f"  {key} = {_setting(value)}" for key, value in values.items()))


def _setting(value: dict[str, Any]) -> str:
    """A setting with its default and meaning, or a key of a manoeuvre with what it may be."""
    if "text" in value:
        return f"{json.dumps(value['default'])}  # {value['text']}" + (f"; {value['range']}" if value["range"] else "")
    return f"{value['value']}; default {value['default']}" if value["default"] else str(value["value"])


def _print(table: Iterable[list[str]]) -> None:
    """Print rows in columns; on a terminal what is too long goes on below its first column, elsewhere a line a row."""
    rows = list(table)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    screen = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    for cells in rows:
        line = "  ".join(f"{cell:{width}s}" for cell, width in zip(cells, widths, strict=True)).rstrip()
        if screen and len(line) > screen:
            first, rest = cells[0], "  ".join(cell for cell in cells[1:] if cell)
            indent = " " * (min(widths[0], screen // 3) + 2)
            line = textwrap.fill(rest, screen, initial_indent=f"{first:{len(indent)}s}", subsequent_indent=indent)
        print(line)


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
            "settings": {k: {"default": v.default, "text": v.text, "range": v.bounds()} for k, v in m.settings.items()},
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
