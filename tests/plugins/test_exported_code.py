"""Exported code against Python: the same bytes from a shared library, from WebAssembly in Node, and on a Cortex-M."""

import functools
import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import estimators
from ahrs_sim import attitude, pipeline, scenario
from ahrs_sim.cli import main
from ahrs_sim.plugins import export, layout
from ahrs_sim.plugins.exercise import swinging
from ahrs_sim.plugins.library import FmuEstimator, LibraryEstimator
from ahrs_sim.runs import log_tuning
from ahrs_sim.runs.log_tuning import Recorded
from ahrs_sim.scenario.code import Gate
from estimators import Samples, SensorInfo, Site
from estimators.emit import Emitted, emit
from estimators.emit_single import image

SENSORS = SensorInfo(gyro_delay=0.005, accel_delay=0.008, mag_delay=0.02, antenna_b=(0.5, 0.1, -1.0), gnss_pos=2.0)
RUN_ELSEWHERE = ["marg-ekf", "marg-ckf", "sekf", "ins21"]
EXPORTED = [m.name for m in estimators.describe() if m.own]
# Every model, every filter's engine and every policy of the catalogue; the others differ from these in numbers.
KINDS = ("marg-ekf", "marg-iekf", "marg-ckf", "marg-srukf", "fakf", "sekf", "ins9-ukf", "ins21", "ins-cal")


def _benchmark() -> ModuleType:
    path = Path(__file__).parents[2] / "benchmarks" / "export_size.py"
    spec = importlib.util.spec_from_file_location("export_size", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


bench = _benchmark()
BLOCK, SITE = swinging()


def same(block: Any, other: Any) -> bool:
    names = block.__match_args__
    return all(
        np.ascontiguousarray(getattr(block, n)).tobytes() == np.ascontiguousarray(getattr(other, n)).tobytes()
        for n in names
    )


def expected(method: str, **settings: Any) -> Any:
    made = estimators.create(method, site=SITE, sensors=SENSORS, **settings).process(BLOCK)
    assert (made.status != estimators.Status.ALIGNING).mean() > 0.3
    return made


def loaded(folder: Path, method: str, block: Samples = BLOCK, site: Site = SITE, sensors: SensorInfo = SENSORS) -> Any:
    """Build the exported library and give it the samples, twice: after `reset` it is as before."""
    subprocess.run(["make", "-s", "CFLAGS=-Werror -pedantic"], cwd=folder, check=True)
    kernels = f"{method.replace('-', '_')}_kernels.o"
    missing = subprocess.run(["nm", "-u", kernels], cwd=folder, check=True, capture_output=True, text=True).stdout
    assert set(missing.split()) <= {"U", "memcpy", "memset"}
    library = LibraryEstimator(folder / f"lib{method.replace('-', '_')}.so", site=site, sensors=sensors)
    once = library.process(block)
    library.reset()
    again = library.process(block)
    library.close()
    assert library.failure is None
    assert same(once, again)
    return once


@pytest.mark.long
@pytest.mark.parametrize(
    "method", [m if m in KINDS else pytest.param(m, marks=pytest.mark.exhaustive) for m in EXPORTED]
)
def test_a_library_gives_the_bytes_of_python(tmp_path: Path, method: str) -> None:
    folder = tmp_path / "code"
    export.export(method, {}, "chr", SENSORS, "x86_64-linux", folder)
    assert same(loaded(folder, method), expected(method))


@pytest.mark.long
def test_settings_go_with_it_and_the_example_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, chosen = tmp_path / "code", ["--setting", "aiding=airspeed", "--setting", "adaptation=magnetic"]
    assert main(["export-code", "marg-ckf", *chosen, "-o", str(folder)]) == 0
    assert "kB of static memory" in capsys.readouterr().out
    assert same(loaded(folder, "marg-ckf"), expected("marg-ckf", aiding="airspeed", adaptation="magnetic"))
    subprocess.run(["make", "-s", "example"], cwd=folder, check=True)
    printed = subprocess.run(["./example"], cwd=folder, check=True, capture_output=True, text=True).stdout
    assert printed.startswith("status 2, q_nb 1.0000")  # coasting: the example has no airspeed
    assert "aiding = airspeed" in (folder / "README.md").read_text()


@pytest.mark.long
@pytest.mark.parametrize(("method", "most"), [("marg-ekf", 0.05), ("ins21", 0.5)])
def test_single_precision_is_near(tmp_path: Path, minute: Recorded, method: str, most: float) -> None:
    folder = tmp_path / "code"
    export.export(method, {}, "chr", minute.sensors, "x86_64-linux", folder, single=True)
    found = loaded(folder, method, minute.samples, minute.site, minute.sensors)
    wanted = estimators.create(method, site=minute.site, sensors=minute.sensors).process(minute.samples)
    assert (found.status != wanted.status).mean() < 0.001
    both = np.isfinite(wanted.q_nb[:, 0])
    assert (np.isfinite(found.q_nb[:, 0]) == both).mean() > 0.999 and both.mean() > 0.5
    off = np.degrees(np.linalg.norm(attitude.rotation_vector(found.q_nb[both], wanted.q_nb[both]), axis=1))
    assert 0.0 < np.nanmax(off) < most
    assert "Single precision" in (folder / "README.md").read_text()


def test_the_first_contents_of_single_precision_are_the_same_each_time() -> None:
    """Between a record's fields lie bytes that belong to none: they are copied, too."""
    record = np.zeros((), np.dtype([("flag", np.uint8), ("number", np.float64)], align=True))
    record["number"] = 2.0
    record.reshape(1).view(np.uint8)[1:8] = 7
    assert image(record) == bytes([0, *[7] * 7]) + np.float32(2.0).tobytes() + bytes(4)


@pytest.fixture(scope="module")
def minute(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """What the sensors of a flown minute say: standing, take-off, climb."""
    log = tmp_path_factory.mktemp("flown") / "minute.mcap"
    pipeline.fly(scenario.load("takeoff", duration=60.0, estimators=["ekf-chr"]), log)
    return log_tuning.read(log, "ekf-chr", gate=Gate())


@pytest.fixture(scope="module")
def emitted(minute: Recorded) -> Callable[[str], dict[str, Emitted]]:
    """Code of a method for all machines that are run here."""
    return functools.cache(lambda method: emit(method, {}, minute.site, minute.sensors, ("wasm32", *bench.CORES)))


def in_python(method: str, minute: Recorded, rows: int = 6001) -> bytes:
    made = estimators.create(method, site=minute.site, sensors=minute.sensors).process(minute.samples[:rows])
    assert len(made) == rows and (made.status != estimators.Status.ALIGNING).mean() > 0.4
    return bytes_of(made)


def bytes_of(made: Any) -> bytes:
    return b"".join(np.ascontiguousarray(getattr(made, name)).tobytes() for name in made.__match_args__)


@pytest.mark.long
@pytest.mark.skipif(not bench.available("ziglang") or shutil.which("node") is None, reason="no ziglang, or no Node")
@pytest.mark.parametrize("method", [*RUN_ELSEWHERE, "ins-cal"])
def test_webassembly_gives_the_bytes_of_python(
    tmp_path: Path, minute: Recorded, emitted: Callable[[str], dict[str, Emitted]], method: str
) -> None:
    folder = tmp_path / "code"
    export.write(method, {}, "chr", minute.sensors, "wasm32", emitted(method)["wasm32"], folder)
    module = bench.link(folder, method.replace("-", "_"), "wasm32")
    (tmp_path / "known").write_bytes(layout.constants(minute.site) + layout.constants(minute.sensors))
    (tmp_path / "samples").write_bytes(bench.rows_of(minute.samples).tobytes())
    files = [str(tmp_path / name) for name in ("known", "samples", "out")]
    sizes = [str(layout.SAMPLE.itemsize), str(layout.ESTIMATE.itemsize), str(len(layout.constants(minute.site)))]
    subprocess.run(["node", Path(__file__).parent / "run_wasm.mjs", module, *files, *sizes], check=True)
    assert bytes_of(_read((tmp_path / "out").read_bytes())) == in_python(method, minute)


@pytest.mark.long
@pytest.mark.skipif(not bench.available("ziglang", "unicorn"), reason="no ziglang, or no unicorn")
@pytest.mark.parametrize("method", RUN_ELSEWHERE)
@pytest.mark.parametrize(("target", "rows"), [("cortex-m7", 6001), ("cortex-m4f", 4000)])
def test_a_cortex_gives_the_bytes_of_python(
    tmp_path: Path, minute: Recorded, emitted: Callable[[str], dict[str, Emitted]], target: str, rows: int, method: str
) -> None:
    """On the M4F, where every operation is a call, forty seconds of the minute."""
    folder = tmp_path / "code"
    export.write(method, {}, "chr", minute.sensors, target, emitted(method)[target], folder)
    board = bench.Board(bench.link(folder, method.replace("-", "_"), target))
    board.begin(layout.constants(minute.site) + layout.constants(minute.sensors))
    assert bytes_of(_read(board.process(bench.rows_of(minute.samples[:rows])))) == in_python(method, minute, rows)


@pytest.mark.long
@pytest.mark.skipif(not bench.available("ziglang", "unicorn"), reason="no ziglang, or no unicorn")
def test_a_cortex_gives_the_bytes_of_single_precision_here(tmp_path: Path, minute: Recorded) -> None:
    here, there = "x86_64-linux", "cortex-m4f"
    made = emit("marg-ekf", {}, minute.site, minute.sensors, (here, there), single=True)
    for target in made:
        export.write("marg-ekf", {}, "chr", minute.sensors, target, made[target], tmp_path / target)
    board = bench.Board(bench.link(tmp_path / there, "marg_ekf", there))
    board.begin(layout.constants(minute.site) + layout.constants(minute.sensors))
    found = bytes_of(_read(board.process(bench.rows_of(minute.samples))))
    assert found == bytes_of(loaded(tmp_path / here, "marg-ekf", minute.samples, minute.site, minute.sensors))


def _read(answers: bytes) -> Any:
    return layout.read_estimates(np.frombuffer(answers, layout.ESTIMATE).copy())


@pytest.mark.skipif(sys.platform != "linux", reason="a compiler is needed")
def test_the_square_root_is_that_of_the_processor(tmp_path: Path) -> None:
    source = Path(export.__file__).parent / "templates" / "export" / "sqrt.c"
    (tmp_path / "root.c").write_text(f'#include <stdint.h>\n#include "{source}"\n')
    command = ["cc", "-std=c99", "-Wall", "-Werror", "-pedantic", "-O2", "-fPIC", "-shared", "-o", "root.so", "root.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    import ctypes

    root = ctypes.CDLL(str(tmp_path / "root.so")).ahrs_kernel_sqrt
    bits = np.random.default_rng(1).integers(0, 0x7FF0000000000000, 20000)
    bits[:1000] &= 0xFFFFFFFFFFFFF  # subnormal
    numbers = np.concatenate([bits.view(np.float64), np.arange(1000.0), [0.0, -0.0, np.inf, np.nan, -1.0]])
    with np.errstate(invalid="ignore"):
        wanted = np.sqrt(numbers)
    for number, value in zip(numbers, wanted, strict=True):
        place = ctypes.c_double(number)
        root(ctypes.byref(place))
        np.testing.assert_array_equal(place.value, value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["vqf"], "vqf comes from another package"),
        (["marg-efk"], "no estimator 'marg-efk'; did you mean 'marg-ekf'?"),
        (["marg-ekf", "--suite", "chx"], "has no such suite; did you mean 'chr'?"),
        (["marg-ekf", "--setting", "aiding"], "expected NAME=VALUE"),
        (["marg-ekf", "--setting", "aidng=none"], "no setting 'aidng'; did you mean 'aiding'?"),
        (["marg-ekf", "--setting", "align_s=long"], "expected a number"),
        (["marg-ekf", "--setting", "aiding=wind"], "'wind' is not a choice"),
    ],
)
def test_what_cannot_be_exported_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert main(["export-code", *arguments, "-o", str(tmp_path / "code")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "code").exists()


@pytest.mark.long
@pytest.mark.parametrize(("method", "fmi"), [("ins21", "2.0"), ("sekf", "3.0"), ("marg-ekf", "3.0")])
def test_a_unit_for_co_simulation_gives_the_numbers_of_python(
    tmp_path: Path, method: str, fmi: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("fmpy")
    path, sensors = tmp_path / "unit.fmu", export.suite_info("chr", "circuit")
    assert main(["export-fmu", method, "--fmi", fmi, "-o", str(path)]) == 0
    assert f"--estimator fmu:{path}@chr" in capsys.readouterr().out
    import fmpy
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(path)) == []
    assert fmpy.read_model_description(str(path)).fmiVersion == fmi
    unit = FmuEstimator(path, site=SITE, sensors=sensors)
    found = unit.process(BLOCK)
    unit.reset()
    again = unit.process(BLOCK)
    unit.close()
    assert unit.failure is None
    wanted = estimators.create(method, site=SITE, sensors=sensors).process(BLOCK)
    for name in ("status", "q_nb", "down_b", "gyro_bias", "gyro_bias_sigma", "accel_bias", "lla", "vel_n"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))
        np.testing.assert_array_equal(getattr(again, name), getattr(wanted, name))


def test_a_unit_that_is_there_already_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "unit.fmu").write_text("")
    assert main(["export-fmu", "marg-ekf", "-o", str(tmp_path / "unit.fmu")]) == 2
    assert "unit.fmu: exists; choose another -o" in capsys.readouterr().err
