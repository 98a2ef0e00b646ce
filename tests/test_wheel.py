"""A wheel with kernels: what its build hook adds runs where it is installed, and nothing is compiled there."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from estimators import jit

ROOT = Path(__file__).parents[1]
METHOD = "tilt-ekf"  # of all methods the one that compiles soonest
USE = f"""
import estimators
from estimators import jit, native
compiled = []
native.listeners.append(lambda: compiled.append(None))
estimators.create({METHOD!r}).prepare()
print(estimators.__file__, jit.USES_SHIPPED, len(compiled))
"""


@pytest.fixture
def hook(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    pytest.importorskip("hatchling")
    monkeypatch.syspath_prepend(str(ROOT))
    import hatch_build

    monkeypatch.setattr(hatch_build, "FILL", f"import estimators; estimators.prepare([({METHOD!r}, {{}})])")
    return hatch_build


def build(hook: ModuleType, folder: Path) -> dict[str, Any]:
    """Have the hook add to a wheel what it adds."""
    made: dict[str, Any] = {"force_include": {}}
    project = SimpleNamespace(core=SimpleNamespace(dependencies=[]))
    hook.Kernels(str(ROOT), {}, None, project, str(folder), "wheel").initialize("standard", made)
    return made


def test_a_plain_wheel_has_no_kernels(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AHRS_SIM_COMPILE", raising=False)
    assert build(hook, tmp_path) == {"force_include": {}}


@pytest.mark.long
@pytest.mark.skipif(not jit.JIT, reason="compiles nothing")
def test_an_installed_wheel_compiles_nothing(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AHRS_SIM_COMPILE", "1")
    made = build(hook, tmp_path)
    assert made["infer_tag"] and not made["pure_python"]
    ((kernels, place),) = made["force_include"].items()
    installed = tmp_path / "site"
    shutil.copytree(ROOT / "estimators", installed / "estimators", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.move(kernels, installed / place)
    unwanted = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
    environment = {k: v for k, v in os.environ.items() if k not in unwanted}
    environment |= {"PYTHONPATH": str(installed), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", USE], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    file, uses_shipped, compiled = done.stdout.split()
    assert Path(file).is_relative_to(installed)
    if uses_shipped == "False":
        pytest.skip("a processor without what x86-64-v3 has")
    assert compiled == "0"
