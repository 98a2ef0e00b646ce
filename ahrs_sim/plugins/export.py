"""Write an estimator of the catalogue as a folder: kernels as object code, a wrapper in C, a Makefile, a README."""

import dataclasses
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import estimators
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.plugins import layout
from ahrs_sim.plugins.exercise import swinging
from ahrs_sim.scenario import Component, Scenario
from estimators.emit import PREFIX, TARGETS, Emitted, emit
from estimators.settings import Setting
from estimators.types import SensorInfo

_TEMPLATES = Path(__file__).parent / "templates" / "export"
_PIECES = ("sqrt.c", "double.c", "single.c")  # of NAME.c


def method(name: str) -> Any:
    """Look up the entry of the catalogue.

    Raises:
        InputError: no such method, or one that is not of the catalogue and has no kernels.
    """
    known = {m.name: m for m in estimators.describe()}
    if name not in known:
        raise InputError(f"export: no estimator '{name}'{nearest(name, known)}")
    if not known[name].own:
        raise InputError(f"export: {name} comes from another package: it has no kernels to export")
    return known[name]


def parsed(known: Mapping[str, Setting], given: Iterable[str]) -> dict[str, Any]:
    """Read settings from `NAME=VALUE` texts, each of the type of its default; `create` checks them.

    Raises:
        InputError: no `=`, an unknown name, not a number where one is expected.
    """
    settings: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"--setting {text}: expected NAME=VALUE")
        if name not in known:
            raise InputError(f"--setting {text}: no setting '{name}'{nearest(name, known)}")
        default = known[name].default
        try:
            if isinstance(default, bool):
                settings[name] = {"true": True, "false": False}[value]
            else:
                settings[name] = value if isinstance(default, str) else float(value)
        except (KeyError, ValueError):
            expected = "true or false" if isinstance(default, bool) else "a number"
            raise InputError(f"--setting {text}: expected {expected}") from None
    return settings


def suite_component(suite: str, scenario: str) -> tuple[Scenario, Component]:
    """Find a scenario and its `[suite.NAME]` table.

    Raises:
        InputError: no such scenario or suite.
    """
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.scenario.code import Gate

    made = scenarios.load(scenario, gate=Gate())
    suites = {component.name: component for component in made.suites}
    if suite not in suites:
        raise InputError(f"--suite {suite}: {scenario} has no such suite{nearest(suite, suites)}")
    return made, suites[suite]


def suite_info(suite: str, scenario: str) -> SensorInfo:
    """Return the data-sheet figures of a scenario's suite.

    Raises:
        InputError: no such scenario or suite.
    """
    from ahrs_sim.sensors import make_suite

    made, component = suite_component(suite, scenario)
    return make_suite(component, seed=0, dt=0.0025, epoch=made.epoch, start_lla=np.zeros(3)).info


def export(
    name: str,
    settings: Mapping[str, Any],
    suite: str,
    sensors: SensorInfo,
    target: str,
    folder: Path,
    single: bool = False,
) -> Emitted:
    """Write the folder.

    Args:
        name: of the method.
        settings: those that differ from its defaults.
        suite: name of the suite, for the README.
        sensors: its data sheet.
        target: one of `TARGETS`.
        folder: made new.
        single: numbers are floats.

    Raises:
        InputError: the folder exists.
        SettingError: a method that cannot be exported, a setting that is impossible.
    """
    if folder.exists():
        raise InputError(f"{folder}: exists; choose another -o")
    exercise, place = swinging()
    emitted = emit(name, settings, place, sensors, [target], exercise, single)[target]
    write(name, settings, suite, sensors, target, emitted, folder)
    return emitted


def write(
    name: str, settings: Mapping[str, Any], suite: str, sensors: SensorInfo, target: str, emitted: Emitted, folder: Path
) -> None:  # fmt: skip
    """Write the folder of what was emitted; for the rest see `export`."""
    texts = _texts(name, settings, suite, sensors, target, emitted)
    folder.mkdir(parents=True)
    for path in sorted(p for p in _TEMPLATES.iterdir() if p.name not in _PIECES):
        text = path.read_text(encoding="utf-8")
        for key, value in texts.items():
            text = text.replace(f"@{key}@", value)
        (folder / path.name.replace("NAME", texts["NAME"])).write_text(text, encoding="utf-8")
    (folder / layout.HEADER.name).write_text(layout.HEADER.read_text(encoding="utf-8"), encoding="utf-8")
    (folder / f"{texts['NAME']}_kernels.o").write_bytes(emitted.code)


_GOALS = {"x86_64-linux": "lib{}.so", "aarch64-linux": "lib{}.so", "wasm32": "{}.wasm"}
_FLAGS = {
    "x86_64-linux": "-fPIC -fvisibility=hidden",
    "aarch64-linux": "-fPIC -fvisibility=hidden",
    "cortex-m4f": "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16",
    "cortex-m7": "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16",
    "wasm32": "--target=wasm32 -ffreestanding",
    "riscv32": "-march=rv32imafdc -mabi=ilp32d",
}


def _texts(
    name: str, settings: Mapping[str, Any], suite: str, sensors: SensorInfo, target: str, emitted: Emitted
) -> dict[str, str]:
    import llvmlite  # type: ignore[import-untyped]
    import numba
    from llvmlite import binding

    values = {key: setting.default for key, setting in method(name).settings.items()} | dict(settings)
    as_name, machine = name.replace("-", "_"), TARGETS[target]
    lines = [f"{key} = {str(value).lower() if isinstance(value, bool) else value}" for key, value in values.items()]
    return {
        **_memory(emitted), **_sensors(sensors),
        "SQRT": "" if machine.has_sqrt or emitted.single else _piece("sqrt.c"),
        "NUMBERS": _piece("single.c" if emitted.single else "double.c"),
        "PRECISION": _SINGLE if emitted.single else _DOUBLE,
        "METHOD": name, "NAME": as_name, "TARGET": target, "SUITE": suite, "TEXT": method(name).text,
        "VERSION": version("ahrs-sim"), "NUMBA": numba.__version__, "LLVMLITE": llvmlite.__version__,
        "LLVM": ".".join(map(str, binding.llvm_version_info)), "TRIPLE": machine.triple,
        "CPU": f", {machine.cpu}" if machine.cpu else "", "CODE": str(emitted.text),
        "CONSTANT": str(emitted.constant), "MEMORY": str(emitted.memory), "STACK": str(emitted.stack),
        "WORK": "not counted" if emitted.operations is None else "{:.0f}, at most {}".format(*emitted.operations),
        "NUMPY": np.__version__, "PYTHON": platform.python_version(),
        "GOAL": _GOALS.get(target, "lib{}.a").format(as_name), "CFLAGS": _FLAGS[target],
        "SETTINGS": "\n".join(f"    {line}" for line in lines),
    }  # fmt: skip


def _piece(name: str) -> str:
    return (_TEMPLATES / name).read_text(encoding="utf-8")


_DOUBLE = """Double precision. The kernels need `memset`, `memcpy` and, where the processor has no instruction for it,
  `sqrt` and arithmetic of doubles from the compiler's run time. Sines, arc tangents and exponentials are their own, the
  same that ahrs_sim uses in Python: with IEEE 754 doubles, not contracted, estimates are equal to the last bit."""
_SINGLE = """Single precision: every number of the kernels is a float, in memory laid out for doubles. Samples and
  estimates are converted, and times count from the first sample (a float's step is 0.06 ms after ten minutes, 0.24 ms
  after an hour). Estimates differ from those of ahrs_sim in Python: fly this library beside the method
  (`--estimator lib:...`) to see by how much."""


def _memory(emitted: Emitted) -> dict[str, str]:
    """Write the C of the blocks: declarations, first contents, and what points where."""
    blocks, images, contents, references, calls = [], [], [], [], []
    for name, block in emitted.blocks.items():
        words = -(-block.size // 8)
        if block.constant:
            blocks.append(f"static const uint64_t constant_{name}[{words}] = {_words(block.image)};")
            continue
        blocks.append(f"static uint64_t memory_{name}[{words}];")
        if block.image:
            images.append(f"static const uint64_t image_{name}[{words}] = {_words(block.image)};")
        contents.append(f"    {{memory_{name}, {f'image_{name}' if block.image else 'NULL'}, {words}}},")
        for offset, what in block.addresses.items():
            at = f"&memory_{name}[{offset // 8}]"
            if what.startswith(PREFIX):
                calls.append(f"    {{{at}, {what}}},")
            else:
                constant = emitted.blocks[what].constant
                references.append(f"    {{{at}, {f'constant_{what}' if constant else f'memory_{what}'}}},")
    kernels = sorted(
        {what for b in emitted.blocks.values() for what in b.addresses.values() if what.startswith(PREFIX)}
    )
    return {
        "KERNELS": "\n".join(f"extern void {kernel}(void);" for kernel in kernels),
        "BLOCKS": "\n".join(blocks), "IMAGES": "\n".join(images), "CONTENTS": "\n".join(contents),
        "REFERENCES": "\n".join(references), "CALLS": "\n".join(calls),
    }  # fmt: skip


def _words(image: bytes) -> str:
    padded = image + bytes(-len(image) % 8)
    numbers = [f"0x{int(w):x}u" if w < 1 << 32 else f"0x{int(w):x}ull" for w in np.frombuffer(padded, np.uint64)]
    return "{\n" + "\n".join(f"    {', '.join(numbers[i : i + 5])}," for i in range(0, len(numbers), 5)) + "\n}"


def _sensors(sensors: SensorInfo) -> dict[str, str]:
    """Write the C of the data sheet: what the caller gives, and what the interface does not have."""
    sheet, fit, at = [], [], 0
    for f in dataclasses.fields(sensors):
        values = np.atleast_1d(np.asarray(getattr(sensors, f.name), float))
        for i, value in enumerate(values):
            part = f"[{i}]" if len(values) > 1 else ""
            number = float(value).hex()
            fit.append(f"    put(&to[{at}], {f'sensors->{f.name}{part}' if f.name in layout.SENSORS else number});")
            at += 1
    for name in layout.SENSORS:
        numbers = ", ".join(float(v).hex() for v in np.atleast_1d(np.asarray(getattr(sensors, name), float)))
        sheet.append(f"    .{name} = {numbers if ',' not in numbers else '{' + numbers + '}'},")
    return {"SHEET": "\n".join(sheet), "FIT": "\n".join(fit)}
