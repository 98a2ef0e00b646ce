"""What is compiled, by whom, and what a wheel brings along."""

import io
import json
import pickle
import shutil
import types
from pathlib import Path

import numba
import pytest
from llvmlite import binding as llvm

from estimators import catalogue, jit, native

pytestmark = pytest.mark.skipif(not jit.JIT, reason="compiles nothing")


def test_a_plan_lists_what_is_missing_and_compiles_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "FOLDER", tmp_path)
    monkeypatch.setattr(native, "_LOADED", {})
    monkeypatch.setattr(native, "_compile", None)
    first, second, again = catalogue._planned([("tilt-ekf", {}), ("sekf", {}), ("tilt-ekf", {})])
    assert len(first) > catalogue.MANY > len(second) > 0 and again == {}
    assert {path.name.split(".")[0] for path in second} == {"adaptation"}  # only its policy is new
    assert not list(tmp_path.iterdir())
    assert native._LOADED == {}, "what is listed has no address"


def test_the_second_process_begins_with_the_last_and_skips_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def plan(*names: str) -> dict[Path, object]:
        return {tmp_path / name: (lambda name=name: done.append(name)) for name in names}

    (tmp_path / "b").touch()
    given = [("tilt-ekf", {}), ("sekf", {"align_s": 3.0})]
    monkeypatch.setattr(catalogue, "_planned", lambda methods: [plan("a", "b"), plan("c")] if methods == given else [])
    monkeypatch.setattr("sys.stdin", types.SimpleNamespace(buffer=io.BytesIO(pickle.dumps(given))))
    catalogue._compile_last()
    assert done == ["c", "a"]


def ship(folder: Path, **changed: str) -> None:
    target = {"cpu": "x86-64-v3", "features": "+avx2", "triple": llvm.get_process_triple(), **changed}
    folder.mkdir(exist_ok=True)
    (folder / "target.json").write_text(json.dumps(target))


@pytest.mark.parametrize(
    ("changed", "fits"),
    [({}, True), ({"triple": "riscv64-unknown-linux-gnu"}, False), ({"features": "+avx2,+none-has-this"}, False)],
)
def test_shipped_kernels_are_used_where_they_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, str], fits: bool
) -> None:
    monkeypatch.delenv("NUMBA_CPU_NAME", raising=False)
    for name in ("CPU_NAME", "CPU_FEATURES"):
        monkeypatch.setattr(numba.config, name, None)
    monkeypatch.setattr(jit, "SHIPPED", tmp_path)
    assert not jit._compile_as_shipped()
    ship(tmp_path, **changed)
    if fits and not llvm.get_host_cpu_features().get("avx2"):
        pytest.skip("a processor without AVX2")
    assert jit._compile_as_shipped() == fits
    assert ("x86-64-v3" if fits else None) == numba.config.CPU_NAME
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")  # the user's word counts
    assert not jit._compile_as_shipped()


def test_a_cache_begins_with_what_was_shipped_for_these_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(jit, "USES_SHIPPED", True)
    monkeypatch.setattr(jit, "SHIPPED", tmp_path / "shipped")
    sources = tmp_path / "sources"
    sources.mkdir()
    (sources / "a.py").write_text("a = 1\n")
    folder = jit.cache_folder(sources)
    assert not folder.exists()
    (tmp_path / "shipped" / folder.name).mkdir(parents=True)
    (tmp_path / "shipped" / folder.name / "a.kernel").touch()
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(sources, elsewhere)
    assert jit.cache_folder(elsewhere) == folder, "wherever the sources are"
    assert [file.name for file in folder.iterdir()] == ["a.kernel"]
    (folder / "a.kernel").write_text("mine")
    assert jit.cache_folder(sources) == folder and (folder / "a.kernel").read_text() == "mine"
    (sources / "a.py").write_text("a = 2\n")
    assert not jit.cache_folder(sources).exists()
    assert sorted(f.name for f in (tmp_path / "cache").iterdir()) == [folder.name]
