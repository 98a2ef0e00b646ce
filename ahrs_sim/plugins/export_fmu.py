"""Co-simulation units (FMI): an estimator as exported code in a wrapper, without Python; a sensor suite in Python."""

import hashlib
import importlib.util
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

from ahrs_sim.errors import InputError
from ahrs_sim.plugins import export
from ahrs_sim.plugins.fmu_host import INPUTS, OUTPUTS
from ahrs_sim.scenario import Component
from estimators.types import SensorInfo

VERSIONS = ("2.0", "3.0")
_TEMPLATES = Path(__file__).parent / "templates" / "fmu"
_FLAGS = ("mag_new", "gnss_new", "heading_new", "air_new")
_SITE = {
    "site_latitude": "lla[0]", "site_longitude": "lla[1]", "site_height": "lla[2]", "site_gravity": "gravity",
    "site_mag_north": "mag_n[0]", "site_mag_east": "mag_n[1]", "site_mag_down": "mag_n[2]",
}  # fmt: skip
_STARTS = {"site_gravity": 9.80665, "site_mag_north": 2.2e-5, "site_mag_down": 4.2e-5}


class Variable(NamedTuple):
    """A variable of the unit, whose value reference is its place in the list of all."""

    name: str
    kind: str  # float, flag, status
    causality: str
    place: str  # in C
    start: str = ""


def variables(sensors: SensorInfo) -> list[Variable]:
    """The unit's variables by the names that `fmu_host` knows: inputs, parameters, outputs; flags and status last."""
    made = [
        Variable(name, "float", "input", _place("sample", column, index), "0.0")
        for name, (column, index) in INPUTS.items() if name not in _FLAGS
    ]  # fmt: skip
    for name, member in _SITE.items():
        made.append(Variable(name, "float", "parameter", f"where.{member}", str(_STARTS.get(name, 0.0))))
    made.append(Variable("sample_rate", "float", "parameter", "what.rate", str(sensors.rate)))
    for name, (column, index) in OUTPUTS.items():
        if name != "status":
            made.append(Variable(name, "float", "output", _place("answer", column, index)))
    made += [Variable(name, "flag", "input", f"sample.{name}", "false") for name in _FLAGS]
    return [*made, Variable("status", "status", "output", "answer.status")]


def _place(structure: str, column: str, index: int) -> str:
    return f"{structure}.{column}" + (f"[{index}]" if index >= 0 else "")


def export_fmu(
    name: str, settings: Mapping[str, Any], suite: str, sensors: SensorInfo, path: Path, fmi: str = "2.0"
) -> None:
    """Write the unit, built for this machine, with its sources.

    Args:
        name: of the method.
        settings: those that differ from its defaults.
        suite: name of the suite.
        sensors: its data sheet.
        path: of the unit, made new.
        fmi: version of the standard, one of `VERSIONS`.

    Raises:
        InputError: the file exists, no C compiler, a machine other than x86_64 Linux.
        SettingError: see `export.export`.
    """
    if path.exists():
        raise InputError(f"{path}: exists; choose another -o")
    if shutil.which("cc") is None:
        raise InputError("export-fmu: needs a C compiler; install one that is called cc")
    if sys.platform != "linux" or platform.machine() != "x86_64":
        raise InputError(f"export-fmu: builds on x86_64 Linux only, this is {platform.machine()} {sys.platform}")
    with tempfile.TemporaryDirectory() as parent:
        folder, as_name, known = Path(parent) / "code", name.replace("-", "_"), variables(sensors)
        export.export(name, settings, suite, sensors, "x86_64-linux", folder)
        front = f"fmi{fmi[0]}.c"
        for source in ("unit.c", front):
            (folder / source).write_text(_filled(_TEMPLATES / source, name, as_name, known), encoding="utf-8")
        flags = ["-std=c99", "-O2", "-fPIC", "-ffp-contract=off", "-fvisibility=hidden", "-shared"]
        command = ["cc", *flags, "-o", f"{as_name}.so", front, f"{as_name}_kernels.o", "-lm"]
        built = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if built.returncode != 0:
            raise InputError(f"export-fmu: the C compiler fails: {' '.join(built.stderr.split())}")
        token = hashlib.sha256(b"".join(p.read_bytes() for p in sorted(folder.glob("*.c")))).hexdigest()[:32]
        describe = _described_2 if fmi == "2.0" else _described_3
        _archive(path, folder, as_name, fmi, describe(name, as_name, known, f"{{{token}}}"))


def _filled(template: Path, name: str, as_name: str, known: list[Variable]) -> str:
    numbers = [v for v in known if v.kind == "float"]
    texts = {
        "METHOD": name, "NAME": as_name, "REALS": "\n".join(f"    &{v.place}," for v in numbers),
        "SETTABLE": str(sum(v.causality != "output" for v in numbers)),
        "FLAGS": ", ".join(f"&{v.place}" for v in known if v.kind == "flag"),
    }  # fmt: skip
    text = template.read_text(encoding="utf-8")
    for key, value in texts.items():
        text = text.replace(f"@{key}@", value)
    return text


_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="{}" modelName={} {}="{}" '
_HEAD += 'generationTool="ahrs_sim" variableNamingConvention="flat">\n<CoSimulation modelIdentifier="{}" '
_HEAD += (
    'canHandleVariableCommunicationStepSize="true" canBeInstantiatedOnlyOncePerProcess="true"/>\n<ModelVariables>\n'
)


def _attributes(variable: Variable, reference: int) -> str:
    variability = "fixed" if variable.causality == "parameter" else "discrete"
    return (
        f'name={quoteattr(variable.name)} valueReference="{reference}" causality="{variable.causality}" '
        f'variability="{variability}"'
    )


def _start(variable: Variable) -> str:
    return f" start={quoteattr(variable.start)}" if variable.start else ""


def _described_2(name: str, as_name: str, known: list[Variable], token: str) -> str:
    kinds = {"float": "Real", "flag": "Boolean", "status": "Integer"}
    rows = [
        f"  <ScalarVariable {_attributes(v, i)}><{kinds[v.kind]}{_start(v)}/></ScalarVariable>\n"
        for i, v in enumerate(known)
    ]
    listed = "".join(f'<Unknown index="{i}"/>' for i, v in enumerate(known, 1) if v.causality == "output")
    return (
        _HEAD.format("2.0", quoteattr(name), "guid", token, as_name) + "".join(rows) + "</ModelVariables>\n"
        f"<ModelStructure><Outputs>{listed}</Outputs><InitialUnknowns>{listed}</InitialUnknowns></ModelStructure>\n"
        "</fmiModelDescription>\n"
    )


def _described_3(name: str, as_name: str, known: list[Variable], token: str) -> str:
    kinds = {"float": "Float64", "flag": "Boolean", "status": "Int32"}
    rows = [f"  <{kinds[v.kind]} {_attributes(v, i)}{_start(v)}/>\n" for i, v in enumerate(known)]
    time = f'  <Float64 name="time" valueReference="{len(known)}" causality="independent" variability="continuous"/>\n'
    outputs = [i for i, v in enumerate(known) if v.causality == "output"]
    listed = "".join(f'<{kind} valueReference="{i}"/>' for kind in ("Output", "InitialUnknown") for i in outputs)
    return (
        _HEAD.format("3.0", quoteattr(name), "instantiationToken", token, as_name) + "".join(rows) + time
        + f"</ModelVariables>\n<ModelStructure>{listed}</ModelStructure>\n</fmiModelDescription>\n"
    )  # fmt: skip


_PLACES = {"2.0": ("binaries/linux64", "sources"), "3.0": ("binaries/x86_64-linux", "extra/sources")}
"""Of the library and of its sources, which need the object file beside them."""


def _archive(path: Path, folder: Path, as_name: str, fmi: str, description: str) -> None:
    binaries, sources = _PLACES[fmi]
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(folder / f"{as_name}.so", f"{binaries}/{as_name}.so")
        archive.write(folder / "README.md", "documentation/README.md")
        for source in (f"fmi{fmi[0]}.c", "unit.c", f"{as_name}.c", "ahrs_estimator.h", f"{as_name}_kernels.o"):
            archive.write(folder / source, f"{sources}/{source}")


_SCRIPT = """import {library}
from {library} import {slave}

from ahrs_sim.plugins.sensor_unit import Sensors


class {name}(Sensors, {slave}):
    library, known = {library}, {known!r}
"""
_LIBRARIES = {"2.0": ("pythonfmu", "Fmi2Slave"), "3.0": ("pythonfmu3", "Fmi3Slave")}


def export_sensors(scenario: str, suite: str, path: Path, fmi: str = "2.0") -> None:
    """Write a suite as a unit that PythonFMU runs; see `sensor_unit`.

    Args:
        scenario: that has the suite, its faults, date and seed.
        suite: its name.
        path: of the unit, made new.
        fmi: version of the standard, one of `VERSIONS`.

    Raises:
        InputError: the file exists, no such scenario or suite, no PythonFMU.
    """
    if path.exists():
        raise InputError(f"{path}: exists; choose another -o")
    library, slave = _LIBRARIES[fmi]
    if importlib.util.find_spec(library) is None:
        raise InputError(f"export-fmu --sensors: FMI {fmi} needs {library}; pip install 'ahrs-sim[fmu]'")
    made, component = export.suite_component(suite, scenario)
    known = {
        "suite": _plain(component), "faults": [_plain(f) for f in made.faults], "epoch": made.epoch.isoformat(),
        "seed": made.seed,
    }  # fmt: skip
    name = re.sub(r"\W", "_", suite) + "_sensors"
    with tempfile.TemporaryDirectory() as parent:
        script = Path(parent) / f"{name}.py"
        script.write_text(_SCRIPT.format(library=library, slave=slave, name=name, known=known), encoding="utf-8")
        command = [sys.executable, "-c", _BUILD.format(library=library), str(script), parent]
        built = subprocess.run(command, capture_output=True, text=True)
        if built.returncode != 0:
            raise InputError(f"export-fmu: {library} fails: {' '.join(built.stderr.split())}")
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(script.with_suffix(".fmu"), path)


_BUILD = "import sys; from {library}.builder import FmuBuilder; FmuBuilder.build_FMU(sys.argv[1], dest=sys.argv[2])"
"""In a process of its own: it imports the script, and has it written anew the next time."""


def _plain(component: Component) -> dict[str, Any]:
    file, colon, table = component.where.partition(":")
    where = f"{Path(file).resolve()}:{table}" if colon and Path(file).exists() else component.where
    return {"name": component.name, "settings": dict(component.settings), "where": where}
