"""Intermediate code of kernels, whichever process compiled them."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from estimators import emit

KERNEL = """
@numba.dynamic.globals.7f00 = linkonce global ptr inttoptr (i64 {address} to ptr)
@.const.table.{number} = internal constant [2 x double] [double 1.0, double {last}]

define linkonce_odr double @sineB3v{number}d(double %x) #0 {{
  %y = load double, ptr @.const.table.{number}
  %z = call double @reducedB3v{next}d(double %y)
  ret double %z
}}

define linkonce_odr double @reducedB3v{next}d(double %x) #0 {{
  %y = fadd double %x, {step}, !prof !{number}
  ret double %y
}}

define void @cfunc.kernel(ptr %x) #0 {{
  %y = call double @sineB3v{number}d(double 0.0)
  %place = load ptr, ptr @numba.dynamic.globals.7f00
  ret void
}}

!{number} = !{{!"branch_weights", i32 1, i32 {weight}}}
"""
FIRST = {"number": 4, "next": 5, "address": 100, "last": 2.0, "step": 1.0, "weight": 99}


def shared(**changed: float) -> list[str]:
    """Names of the functions that other kernels may have as well, in order of their definitions."""
    code = emit._named_by_contents(KERNEL.format(**{**FIRST, **changed}))
    assert "@cfunc.kernel(ptr" in code and "B3v" not in code
    names = [line.split("@")[1].split("(")[0] for line in code.splitlines() if line.startswith("define linkonce_odr")]
    assert all(code.count(f"call double @{name}(") == 1 for name in names)
    return names


def test_a_function_has_one_name_whichever_process_numbered_it() -> None:
    assert shared() == shared(number=14, next=3, address=7)


def test_other_contents_have_another_name_and_so_have_their_callers() -> None:
    table, step = shared(last=3.0), shared(step=2.0)
    assert shared(weight=9)[1] != shared()[1]
    assert table[0] != shared()[0] and table[1] == shared()[1]
    assert not set(step) & set(shared())


def test_a_function_that_a_kernel_has_twice_is_defined_once() -> None:
    code = KERNEL.format(**FIRST)
    again = code.split("\n\n")[2].replace("B3v5d", "B3v6d") + "\n\ndefine void @cfunc.other(ptr %x) #0 {\n"
    again += "  %y = call double @reducedB3v6d(double 1.0)\n  ret void\n}\n"
    made = emit._named_by_contents(code + again)
    definitions = [line for line in made.splitlines() if line.startswith("define linkonce_odr")]
    assert len(definitions) == len(set(definitions)) == 2
    name = definitions[1].split("@")[1].split("(")[0]
    assert made.count(f"call double @{name}(double") == 2


def test_intermediate_code_is_compiled_once_for_rows_of_a_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = []

    def compile_it() -> SimpleNamespace:
        compiled.append(None)
        library = SimpleNamespace(get_llvm_str=lambda: KERNEL.format(**FIRST))
        return SimpleNamespace(native_name="cfunc.kernel", _library=library)

    first = emit._intermediate(tmp_path, "models.marg.load", compile_it)
    assert emit._intermediate(tmp_path, "models.marg.load", compile_it) == first
    assert len(compiled) == 1 and first[0] == "cfunc.kernel"
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:20])
    assert emit._intermediate(tmp_path, "models.marg.load", compile_it) == first
    monkeypatch.setattr("estimators.native.CAPACITY", 41)
    emit._intermediate(tmp_path, "models.marg.load", compile_it)
    assert len(compiled) == 3
