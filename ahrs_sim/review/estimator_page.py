"""`ahrs-sim export-page -o try.html`: one page that runs estimators in a browser on recordings that are dropped on it.

The estimators are exported code for WebAssembly, linked and written into the page in base64; readers, samples and
errors are the programs in `page/try`, by the rules of a replay. The page's policy lets it connect to nothing.
"""

import base64
import dataclasses
import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import InputError
from ahrs_sim.plugins import export, layout
from ahrs_sim.review import colors, one_file
from ahrs_sim.scenario import Component, Gate
from ahrs_sim.world import magnetic
from estimators import SensorInfo, Site

_EXPORTED = ("ahrs_create", "ahrs_process", "ahrs_reset", "page_sensors", "__heap_base")
_PROGRAMS = ("reading.js", "samples.js", "running.js", "page.js")
_PARTS = {
    "STYLE": "report.css", "UPLOT_STYLE": "uplot.css", "UPLOT_LICENSE": "uplot-LICENSE.txt", "UPLOT": "uplot.js",
    "OWN_STYLE": "try/page.css", "FZSTD": "try/fzstd.js", "FZSTD_LICENSE": "try/fzstd-LICENSE.txt",
}  # fmt: skip
_IGRF_SINCE = 1990


def write(
    output: Path,
    scenario: str,
    names: Sequence[str] = (),
    progress: Callable[[float, float | None], None] = lambda done, end: None,
) -> int:
    """Make the page; returns its size in bytes.

    Args:
        output: the HTML file, replaced when there.
        scenario: whose estimators go into it.
        names: only these of it, or `METHOD@SUITE`.
        progress: called with the number of estimators done and of all.

    Raises:
        InputError: no linker, an unknown scenario or estimator, an output that cannot be written.
        SettingError: an estimator that cannot be exported.
    """
    if importlib.util.find_spec("ziglang") is None:
        raise InputError("export-page: needs a linker for WebAssembly: pip install 'ahrs-sim[cross]'")
    components = scenarios.load(scenario, estimators=names, gate=Gate()).estimators
    if not components:
        raise InputError(f"export-page: {scenario} has no estimators; name one with --estimator METHOD@SUITE")
    methods = [export.method(str(c.settings["method"])) for c in components]
    code: dict[str, str] = {}
    listed = []
    for i, (component, method) in enumerate(zip(components, methods, strict=True)):
        progress(i, len(components))
        key = json.dumps({k: v for k, v in component.settings.items() if k != "suite"}, sort_keys=True)
        if key not in code:
            code[key] = base64.b64encode(_module(component)).decode()
        listed.append({**_described(component, method.text), "code": list(code).index(key)})
    text = _page({"estimators": listed, "code": list(code.values()), **_known()}).encode()
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_bytes(text)
    except OSError as error:
        raise InputError(f"{output}: cannot be written: {error.strerror or error}") from None
    return len(text)


def _described(component: Component, text: str) -> dict[str, str]:
    suite, settings = str(component.settings["suite"]), {**component.settings}
    method = settings.pop("method")
    given = [f"{k} = {str(v).lower() if isinstance(v, bool) else v}" for k, v in settings.items() if k != "suite"]
    about = f"{', '.join([str(method), *given])}: {text}"
    return {"name": component.name, "kind": component.name.removesuffix(f"-{suite}"), "suite": suite, "text": about}


def _module(component: Component) -> bytes:
    """Compile and link an estimator for WebAssembly."""
    settings = {k: v for k, v in component.settings.items() if k not in ("method", "suite")}
    method = str(component.settings["method"])
    name = method.replace("-", "_")
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "code"
        export.export(method, settings, "any", SensorInfo(), "wasm32", folder)
        wrapper = (resources.files("ahrs_sim.review") / "page" / "try" / "wrapper.c").read_text(encoding="utf-8")
        (folder / "page.c").write_text(wrapper.replace("@NAME@", name), encoding="utf-8")
        kept = [f"-Wl,--export={symbol}" for symbol in _EXPORTED]
        flags = ["-target", "wasm32-freestanding", "-O2", "-std=c99", "-ffp-contract=off", "-g0", "-Wl,--no-entry"]
        command = [sys.executable, "-m", "ziglang", "cc", *flags, "-Wl,--strip-all", *kept, "-o", "page.wasm"]
        built = subprocess.run(
            [*command, "page.c", f"{name}_kernels.o"], cwd=folder, capture_output=True, text=True, check=False
        )
        if built.returncode != 0:
            raise InputError(f"export-page: linking {component.name} fails: {' '.join(built.stderr.split())[:300]}")
        return (folder / "page.wasm").read_bytes()


def _known() -> dict[str, Any]:
    """What the programs need to know of structures, data sheets, fields and colours."""
    return {
        "sample": _structure(layout.SAMPLE),
        "estimate": _structure(layout.ESTIMATE),
        "sheet": dataclasses.asdict(SensorInfo()),
        "field": Site((0.0, 0.0, 0.0)).mag_n,
        "fields": [*_fields_before_wmm(), _wmm()],
        "colors": [colors.pair(i) for i in range(20)],
    }


def _structure(kind: np.dtype[Any]) -> dict[str, Any]:
    places = {name: place for name, (_, place, *_) in (kind.fields or {}).items()}
    return {"size": kind.itemsize, "at": places}


def _wmm() -> dict[str, Any]:
    """Coefficients of the World Magnetic Model: rows of degree, order, g, h in nT and their change a year."""
    text = (resources.files("wmm") / "coefs" / "WMM.COF").read_text(encoding="ascii")
    rows = [line.split() for line in text.splitlines()]
    terms = [[int(n), int(m), *map(float, values)] for n, m, *values in (r for r in rows[1:] if len(r) == 6)]
    return {"to": 1e9, "epoch": float(rows[0][0]), "degree": max(t[0] for t in terms), "terms": terms}


def _fields_before_wmm() -> list[dict[str, Any]]:
    """IGRF-14 from one of its epochs to the next, as `_wmm`."""
    return [
        {"to": later, "epoch": epoch, "degree": degree, "terms": terms}
        for epoch, later, degree, terms in magnetic.igrf_terms(_IGRF_SINCE)
    ]


def _page(known: Mapping[str, Any]) -> str:
    folder = resources.files("ahrs_sim.review") / "page"
    parts = {mark: (folder / name).read_text(encoding="utf-8") for mark, name in _PARTS.items()}
    programs = [(folder / "try" / name).read_text(encoding="utf-8") for name in _PROGRAMS]
    reading = 'const data = JSON.parse(document.getElementById("data").textContent);'
    data = one_file.json_in_script(json.dumps(known, separators=(",", ":"), allow_nan=False))
    parts |= {"DATA": data, "PROGRAM": "\n".join(['"use strict";', reading, *programs]), "VERSION": version("ahrs-sim")}
    template = (folder / "try" / "template.html").read_text(encoding="utf-8")
    return one_file.filled(template, parts, scripts="'wasm-unsafe-eval'")
