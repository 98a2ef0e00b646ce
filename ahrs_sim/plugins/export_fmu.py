"""An estimator of the catalogue as a co-simulation unit of FMI 2.0: exported code in a wrapper, no Python inside."""

import hashlib
import platform
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
from estimators.types import SensorInfo

_WRAPPER = Path(__file__).parent / "templates" / "fmu" / "fmi2.c"
_FLAGS = ("mag_new", "gnss_new", "heading_new", "air_new")
_SITE = {
    "site_latitude": "lla[0]", "site_longitude": "lla[1]", "site_height": "lla[2]", "site_gravity": "gravity",
    "site_mag_north": "mag_n[0]", "site_mag_east": "mag_n[1]", "site_mag_down": "mag_n[2]",
}  # fmt: skip
_STARTS = {"site_gravity": 9.80665, "site_mag_north": 2.2e-5, "site_mag_down": 4.2e-5}


class Variable(NamedTuple):
    """A variable of the unit."""

    name: str
    kind: str  # Real, Boolean, Integer
    causality: str
    reference: int
    place: str  # in C
    start: str = ""


def variables(sensors: SensorInfo) -> list[Variable]:
    """The unit's variables by the names that `fmu_host` knows: inputs, parameters, outputs."""
    made: list[Variable] = []
    for name, (column, index) in INPUTS.items():
        if name not in _FLAGS:
            made.append(Variable(name, "Real", "input", len(made), _place("sample", column, index), "0.0"))
    for name, member in _SITE.items():
        made.append(Variable(name, "Real", "parameter", len(made), f"where.{member}", str(_STARTS.get(name, 0.0))))
    made.append(Variable("sample_rate", "Real", "parameter", len(made), "what.rate", str(sensors.rate)))
    for name, (column, index) in OUTPUTS.items():
        if name != "status":
            made.append(Variable(name, "Real", "output", len(made), _place("answer", column, index)))
    made += [Variable(name, "Boolean", "input", i, f"sample.{name}", "false") for i, name in enumerate(_FLAGS)]
    return [*made, Variable("status", "Integer", "output", 0, "answer.status")]


def _place(structure: str, column: str, index: int) -> str:
    return f"{structure}.{column}" + (f"[{index}]" if index >= 0 else "")


def export_fmu(name: str, settings: Mapping[str, Any], suite: str, sensors: SensorInfo, path: Path) -> None:
    """Write the unit, built for this machine, with its sources.

    Args:
        name: of the method.
        settings: those that differ from its defaults.
        suite: name of the suite.
        sensors: its data sheet.
        path: of the unit, made new.

    Raises:
        InputError: the file exists, no C compiler, a machine that FMI 2.0 has no name for.
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
        (folder / "fmi2.c").write_text(_wrapper(name, as_name, known), encoding="utf-8")
        flags = ["-std=c99", "-O2", "-fPIC", "-ffp-contract=off", "-fvisibility=hidden", "-shared"]
        command = ["cc", *flags, "-o", f"{as_name}.so", "fmi2.c", f"{as_name}_kernels.o", "-lm"]
        built = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if built.returncode != 0:
            raise InputError(f"export-fmu: the C compiler fails: {' '.join(built.stderr.split())}")
        _archive(path, folder, as_name, _description(name, as_name, known, built_from=folder))


def _wrapper(name: str, as_name: str, known: list[Variable]) -> str:
    reals = [v for v in known if v.kind == "Real"]
    texts = {
        "METHOD": name, "NAME": as_name, "REALS": "\n".join(f"    &{v.place}," for v in reals),
        "SETTABLE": str(sum(v.causality != "output" for v in reals)),
        "FLAGS": ", ".join(f"&{v.place}" for v in known if v.kind == "Boolean"),
    }  # fmt: skip
    text = _WRAPPER.read_text(encoding="utf-8")
    for key, value in texts.items():
        text = text.replace(f"@{key}@", value)
    return text


def _description(name: str, as_name: str, known: list[Variable], built_from: Path) -> str:
    digest = hashlib.sha256(b"".join(p.read_bytes() for p in sorted(built_from.glob("*.c")))).hexdigest()[:32]
    rows, outputs = [], []
    for number, v in enumerate(known, 1):
        start = f" start={quoteattr(v.start)}" if v.start else ""
        variability = "fixed" if v.causality == "parameter" else "discrete"
        rows.append(
            f'  <ScalarVariable name={quoteattr(v.name)} valueReference="{v.reference}" causality="{v.causality}" '
            f'variability="{variability}"><{v.kind}{start}/></ScalarVariable>'
        )
        if v.causality == "output":
            outputs.append(f'<Unknown index="{number}"/>')
    listed = "".join(outputs)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(name)} guid="{{{digest}}}" '
        'generationTool="ahrs_sim" variableNamingConvention="flat">\n'
        f'<CoSimulation modelIdentifier="{as_name}" canHandleVariableCommunicationStepSize="true" '
        'canBeInstantiatedOnlyOncePerProcess="true"/>\n<ModelVariables>\n' + "\n".join(rows) + "\n</ModelVariables>\n"
        f"<ModelStructure><Outputs>{listed}</Outputs><InitialUnknowns>{listed}</InitialUnknowns></ModelStructure>\n"
        "</fmiModelDescription>\n"
    )


def _archive(path: Path, folder: Path, as_name: str, description: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(folder / f"{as_name}.so", f"binaries/linux64/{as_name}.so")
        archive.write(folder / "README.md", "documentation/README.md")
        for source in ("fmi2.c", f"{as_name}.c", "ahrs_estimator.h", f"{as_name}_kernels.o"):
            archive.write(folder / source, f"sources/{source}")
