"""Reference of the files that a user writes: every key with its form, limits and default, as the readers declare them.

Nothing is stated here a second time: the readers run on empty tables while `scenario.table.declaring` collects what
they ask.
`ahrs-sim list manoeuvres`, the JSON Schemas and docs/scenario.md are made of it.
"""

import contextlib
import datetime
import inspect
import math
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim.errors import AhrsSimError
from ahrs_sim.scenario.table import Declarations, Key, Table, declaring

Keys = dict[str, Key]
KINDS = ("scenario", "grade", "map", "suite")
"""Files for which there is a JSON Schema."""

_UNITS = {
    "_deg": "deg", "_dps": "deg/s", "_mps": "m/s", "_mps2": "m/s2", "_m": "m", "_s": "s", "_hz": "Hz", "_am2": "A m2",
    "_kg": "kg", "_pct": "%", "_ut": "uT",
}  # fmt: skip


def collected(read: Callable[[], object]) -> dict[str, Keys]:
    """Run a reader twice, with optional keys there and not there; return the keys of every table it read."""
    found: dict[str, Keys] = {}
    for present in (True, False):
        with declaring(present) as made, contextlib.suppress(AhrsSimError, ValueError):
            read()
        _merge(found, made)
    return found


def _merge(found: dict[str, Keys], made: Declarations) -> None:
    for where, keys in made.tables.items():
        known = found.setdefault(where, {})
        for name, key in keys.items():
            if name not in known or known[name].form == "any" or not key.required:
                known[name] = key


def manoeuvres() -> dict[str, tuple[str, Keys]]:
    """Collect by name what a manoeuvre does (its docstring), and its keys."""
    from ahrs_sim.flight.manoeuvres import MANOEUVRES

    found = {}
    for name, cls in MANOEUVRES.items():
        keys = collected(lambda cls=cls: cls(Table({}, "step")))["step"]  # type: ignore[misc]
        found[name] = (inspect.cleandoc(cls.__doc__ or ""), keys)
    return found


def motions() -> dict[str, tuple[str, Keys]]:
    """Collect by kind what a motion is, and its keys."""
    from ahrs_sim.flight import motion
    from ahrs_sim.scenario import scenario

    start = scenario._start(Table({}, "start"))
    found = {}
    for kind in motion.MOTIONS:
        cls = getattr(motion, kind.capitalize())
        arguments = (start, 0) if "seed" in inspect.signature(cls).parameters else (start,)
        read = collected(lambda cls=cls, a=arguments: cls(Table({"leg": [{}]}, "motion"), *a))  # type: ignore[misc]
        found[kind] = (inspect.cleandoc(cls.__doc__ or ""), read.get("motion", {}))
    return found


def scenario_tables() -> dict[str, Keys]:
    """Collect by table ("" is the file itself) the keys of a scenario, without steps, motions, faults and figures."""
    from ahrs_sim.scenario import parse
    from ahrs_sim.sensors import make_suite

    data = {"wind": {"gust": [{}]}, "step": [{"do": "wait", "for_s": 1.0}], "suite": {}, "estimator": {}}
    found = collected(lambda: parse(data, "file", "file"))
    air = {**data, "start": {"on_ground": False}}
    for where, keys in collected(lambda: parse(air, "file", "file")).items():
        found[where] = {**found.get(where, {}), **keys}
    top = found["file"] | {"motion": Key("table", False)}
    tables = {"": {"extends": Key("text", False), **top, "catalogue": Key("text", False)}}
    tables[""]["estimators"] = Key("texts", False)
    for name in ("start", "wind", "pilot"):
        tables[name] = found[f"file: [{name}]"]
    tables["wind.gust"] = found["file: [wind]: [[gust]] 1"]
    from ahrs_sim.scenario import Component

    component = Component("NAME", {"grade": "chr_6dm"}, "suite")
    epoch = datetime.datetime(2026, 6, 1, tzinfo=datetime.UTC)
    suite = collected(lambda: make_suite(component, seed=0, dt=0.0025, epoch=epoch, start_lla=np.zeros(3)))
    tables["suite.NAME"] = suite["suite"]
    tables["estimator.NAME"] = {"method": Key("text", True), "suite": Key("text", True)}
    return tables


def faults() -> dict[str, Keys]:
    """Collect the keys of each kind of fault."""
    from ahrs_sim.scenario import Component
    from ahrs_sim.sensors import faults as module
    from ahrs_sim.sensors.suite import INSTRUMENTS

    found: dict[str, Keys] = {}
    for kind in module.KINDS:
        for sensor in sorted(module.SENSORS):
            part = Component("fault", {"sensor": sensor, "kind": kind}, "fault")
            read = collected(
                lambda part=part: module.make_faults([part], suite="chr", instruments=INSTRUMENTS, seed=0)  # type: ignore[misc]
            )
            for name, key in read.get("fault", {}).items():
                known = found.setdefault(kind, {}).setdefault(name, key)
                if known.required and not key.required:
                    found[kind][name] = key
    return found


def figures() -> dict[str, list[tuple[str, list[str], float | tuple[float, ...], int]]]:
    """Collect by section of a grade: name of each figure, its keys (with units), default in SI, components."""
    from ahrs_sim.sensors.grade import _keys
    from ahrs_sim.sensors.suite import SECTIONS

    found = {}
    for name, section in SECTIONS.items():
        by_field: dict[str, list[str]] = {}
        for key, (field, _) in _keys(section).items():
            by_field.setdefault(field, []).append(key)
        found[name] = [
            (f.name, by_field[f.name], f.metadata["default"], f.metadata["size"]) for f in fields(section.figures)
        ]
    return found


def map_tables() -> dict[str, Keys]:
    """Collect by table the keys of a map."""
    from ahrs_sim.recordings import mapping

    found = collected(lambda: mapping.load(None))
    return {re.sub(r"^no map(: )?", "", where).strip("[]").replace("]: [", "."): keys for where, keys in found.items()}


def suite_tables() -> dict[str, Keys]:
    """Collect by table the keys of a suite for `ahrs-sim check`."""
    from ahrs_sim.runs import check_suite

    text = 'baseline = "x.json"\n[[flight]]\nscenario = "standing"\n'
    text += '[[flight]]\ncertification = "restart"\nestimators = ["ins15@chr"]\n'
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "suite.toml"
        file.write_text(text)
        found = collected(lambda: check_suite.load(str(file)))
        prefix = str(file)
    tables: dict[str, Keys] = {}
    for where, keys in found.items():
        if where.startswith(prefix):
            name = re.sub(r" \d+$", "", where.removeprefix(prefix).removeprefix(": ")).strip("[]")
            known = tables.setdefault(name, dict(keys))
            for key in {*known, *keys}:  # what only one of two flights needs is not needed
                if not (key in known and key in keys):
                    known[key] = replace((known if key in known else keys)[key], required=False)
    return tables


def unit(key: str) -> str:
    """Find the unit that a key's name ends in, "" when it has none."""
    for suffix in sorted(_UNITS, key=len, reverse=True):
        if key.endswith(suffix):
            return _UNITS[suffix]
    return ""


def limits(key: Key) -> str:
    """Describe the values that a key takes."""
    if key.choices:
        return ", ".join(f"`{c}`" for c in key.choices)
    if key.form == "vector":
        return f"{key.size} numbers"
    parts = [f"> {key.above:g}"] if key.above > -math.inf else []
    parts += [f">= {key.minimum:g}"] if key.minimum > -1e15 and key.above == -math.inf else []
    parts += [f"<= {key.maximum:g}"] if key.maximum < 1e15 else []
    words = {"texts": "list of texts", "flag": "true or false", "date": "date and time", "integer": "whole number"}
    form = words.get(key.form, key.form)
    return " and ".join([form, *parts]) if key.form in ("number", "integer") else form


def default(key: Key) -> str:
    """Describe the default of a key."""
    if key.required:
        return "required"
    value = key.default
    if value is None or value == "" or key.form in ("table", "named tables", "list of tables"):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, datetime.datetime):
        return value.strftime("%Y-%m-%dT%H:%M:%SZ")
    return str(value)


_INTRODUCTION = (
    'A scenario is one TOML file. `extends = "circuit"` lays it over another one: tables are merged key by key, lists',
    "(`[[step]]`, `[[fault]]`) and everything else are replaced. A key's unit is the end of its name. Unknown keys,",
    "wrong types and values out of range are errors that name file, table and key.",
)


def markdown() -> str:
    """Write the scenario reference as Markdown (docs/scenario.md)."""
    return "\n".join(_lines()) + "\n"


def _lines() -> Iterator[str]:
    yield "# Scenario reference"
    yield ""
    yield "<!-- made by `python -m ahrs_sim.reference`; a test says when it is due -->"
    yield ""
    yield from _INTRODUCTION
    titles = {"": "The file itself", "wind.gust": "`[[wind.gust]]`"}
    for name, keys in scenario_tables().items():
        yield from ("", f"## {titles.get(name, f'`[{name}]`')}", "")
        yield from _table(keys)
        if name == "suite.NAME":
            yield from (
                "",
                "Further tables override figures of the grade, e.g. `[suite.chr.gyro]`: see *Grades* below.",
            )
        if name == "estimator.NAME":
            yield from (
                "",
                "Other keys are settings of the method: `ahrs-sim list estimators NAME`. Without any such table the",
            )
            yield "line-up of the paper flies: EKF, CKF and CDKF on the first suite, the EKF on each other."
    yield from ("", "## `[[step]]`: manoeuvres", "")
    yield from ('Each step says `do = "NAME"`. They are flown one after the other.',)
    for name, (text, keys) in manoeuvres().items():
        yield from ("", f"### `{name}`", "", text, "")
        yield from _table({k: v for k, v in keys.items() if k != "do"})
    yield from ("", "## `[motion]`: truth from a formula", "", "`kind` says which.")
    for name, (text, keys) in motions().items():
        yield from ("", f"### `{name}`", "", text, "")
        yield from _table({k: v for k, v in keys.items() if k != "kind"})
    yield from ("", "## `[[fault]]`", "")
    common, rest = _common(faults())
    yield "Every fault has"
    yield ""
    yield from _table(common)
    yield from ("", "and, by `kind`,", "", "| kind | further keys |", "|---|---|")
    for kind, keys in rest.items():
        yield f"| `{kind}` | {', '.join(f'`{k}`' for k in keys) or ''} |"
    yield from (
        "",
        "## Grades",
        "",
        "Tables of a grade file, and of `[suite.NAME.TABLE]`. A figure has one key per unit.",
    )
    for section, rows in figures().items():
        yield from ("", f"### `[{section}]`", "", "| figure | keys | components |", "|---|---|---|")
        for name, units, _, size in rows:
            yield f"| {name.replace('_', ' ')} | {', '.join(f'`{k}`' for k in units)} | {size or 1} |"


def _common(kinds: dict[str, Keys]) -> tuple[Keys, dict[str, Keys]]:
    shared = set.intersection(*(set(keys) for keys in kinds.values()))
    first = next(iter(kinds.values()))
    common = {name: first[name] for name in first if name in shared}
    return common, {kind: {n: k for n, k in keys.items() if n not in shared} for kind, keys in kinds.items()}


def _table(keys: Keys) -> Iterator[str]:
    if not keys:
        yield "No keys of its own."
        return
    yield "| key | value | default |"
    yield "|---|---|---|"
    for name, key in keys.items():
        yield f"| `{name}` | {limits(key)} | {default(key)} |"


def schema(kind: str) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a kind of file: `scenario`, `grade`, `map` or `suite`."""
    made = {"scenario": _scenario_schema, "grade": _grade_schema, "map": _map_schema, "suite": _suite_schema}[kind]()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"ahrs_sim {kind}", **made}


def _object(keys: Keys, more: Iterable[tuple[str, Any]] = (), *, closed: bool = True) -> dict[str, Any]:
    properties = {name: _property(name, key) for name, key in keys.items()} | dict(more)
    made: dict[str, Any] = {"type": "object", "properties": properties}
    if required := [name for name, key in keys.items() if key.required]:
        made["required"] = required
    if closed:
        made["additionalProperties"] = False
    return made


def _property(name: str, key: Key) -> dict[str, Any]:
    made: dict[str, Any] = {}
    forms = {"number": "number", "integer": "integer", "flag": "boolean", "text": "string", "choice": "string"}
    if key.form in forms:
        made["type"] = forms[key.form]
    elif key.form == "vector":
        made = {"type": "array", "items": {"type": "number"}, "minItems": key.size, "maxItems": key.size}
    elif key.form == "texts":
        made = {"type": "array", "items": {"type": "string"}}
    elif key.form in ("table", "named tables"):
        made["type"] = "object"
    elif key.form == "list of tables":
        made = {"type": "array", "items": {"type": "object"}}
    if key.choices:
        made["enum"] = list(key.choices)
    if key.minimum > -1e15:
        made["minimum"] = key.minimum
    if key.maximum < 1e15:
        made["maximum"] = key.maximum
    if key.above > -math.inf:
        made["exclusiveMinimum"] = key.above
    if (
        isinstance(key.default, (bool, int, float, str))
        and key.default != ""
        and key.default not in (math.inf, -math.inf)
    ):
        made["default"] = key.default
    if text := unit(name):
        made["description"] = f"in {text}"
    return made


def _scenario_schema() -> dict[str, Any]:
    tables = scenario_tables()
    overrides = _grade_schema()["properties"]
    steps = [
        _object(keys, [("do", {"const": name, "description": text.partition("\n")[0]})])
        | {"required": ["do", *(k for k, v in keys.items() if v.required and k != "do")]}
        for name, (text, keys) in manoeuvres().items()
    ]
    bends = [_object(keys, [("kind", {"const": name}), *_motion_extra(keys)]) for name, (_, keys) in motions().items()]
    wrong = [
        _object({k: v for k, v in keys.items() if k != "kind"}, [("kind", {"const": kind})], closed=False)
        for kind, keys in faults().items()
    ]
    wind = _object(tables["wind"], [("gust", {"type": "array", "items": _object(tables["wind.gust"])})])
    own = ("title", "extends", "calibration")
    figures_too = [(k, v) for k, v in overrides.items() if k not in (*tables["suite.NAME"], *own)]
    suites = _object(tables["suite.NAME"], figures_too)
    more = [
        ("start", _object(tables["start"])),
        ("wind", wind),
        ("pilot", _object(tables["pilot"])),
        ("suite", {"type": "object", "additionalProperties": suites}),
        ("estimator", {"type": "object", "additionalProperties": _object(tables["estimator.NAME"], closed=False)}),
        ("step", {"type": "array", "items": {"type": "object", "oneOf": steps}}),
        ("motion", {"type": "object", "oneOf": bends}),
        ("fault", {"type": "array", "items": {"type": "object", "anyOf": wrong}}),
        ("epoch", {}),
    ]
    return _object({k: v for k, v in tables[""].items() if not v.required}, more)


def _motion_extra(keys: Keys) -> list[tuple[str, Any]]:
    """Collect the keys that belong to all motions."""
    return [("leg", {"type": "array", "items": {"type": "object"}})] if "leg" in keys else []


def _grade_schema() -> dict[str, Any]:
    properties: dict[str, Any] = {name: {"type": "string"} for name in ("title", "extends", "calibration")}
    for section, rows in figures().items():
        keys: dict[str, Any] = {}
        for _, names, _, size in rows:
            number: dict[str, Any] = {"type": "number"}
            if size:
                number = {"anyOf": [number, {"type": "array", "items": number, "minItems": size, "maxItems": size}]}
            stated = {
                "type": "object",
                "properties": {"value": number, "source": {"type": "string"}, "mark": {"type": "string"}},
                "required": ["value"],
                "additionalProperties": False,
            }
            keys |= {key: {"anyOf": [number, stated]} for key in names}
        properties[section] = {"type": "object", "properties": keys, "additionalProperties": False}
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _map_schema() -> dict[str, Any]:
    tables = map_tables()
    more = [(name, _object(keys)) for name, keys in tables.items() if name]
    named = ("estimator", {"type": "object", "additionalProperties": {"type": "object", "required": ["method"]}})
    return _object(tables[""], [*more, named, ("csv", {"type": "object"})])


def _suite_schema() -> dict[str, Any]:
    tables = suite_tables()
    flights = ("flight", {"type": "array", "items": _object(tables["flight"])})
    more = [(name, _object(keys)) for name, keys in tables.items() if name in ("tolerance", "every")]
    estimators = {"type": "object", "additionalProperties": {"type": "object", "required": ["method", "suite"]}}
    return _object(tables[""], [*more, flights, ("estimator", estimators)])


if __name__ == "__main__":
    Path("docs/scenario.md").write_text(markdown(), encoding="utf-8")
