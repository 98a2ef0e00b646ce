"""What exported code costs, on a few lines of intermediate code whose cost is known."""

import ctypes

from llvmlite import binding as llvm  # type: ignore[import-untyped]

from estimators import emit, emit_costs

CODE = """
define void @ahrs_kernel_process(ptr %own, ptr %x, i64 %n) {
entry:
  %space = alloca [20 x double]
  store ptr %space, ptr %x
  br label %loop

loop:
  %k = phi i64 [ 0, %entry ], [ %more, %loop ]
  call void @inner.0(ptr %x)
  %more = add i64 %k, 1
  %done = icmp eq i64 %more, %n
  br i1 %done, label %end, label %loop

end:
  %address = load ptr, ptr %own
  call void %address(ptr %x)
  ret void
}

define internal void @inner.0(ptr %x) noinline {
  %space = alloca [40 x double]
  store ptr %space, ptr %x
  %a = load double, ptr %x
  %b = fmul double %a, %a
  %c = fadd double %a, %b
  %d = call double @llvm.sqrt.f64(double %c)
  %e = fneg double %d
  store double %e, ptr %x
  ret void
}

define void @ahrs_kernel_measure(ptr %x) {
  %space = alloca [100 x double]
  store ptr %space, ptr %x
  ret void
}

declare double @llvm.sqrt.f64(double)
"""
BLOCKS = {"model": emit.Block(8, b"", {0: "ahrs_kernel_measure"})}


def machine(model: str) -> llvm.TargetMachine:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    made: llvm.TargetMachine = llvm.Target.from_default_triple().create_target_machine(opt=2, codemodel=model)
    return made


def test_the_stack_is_the_largest_sum_along_calls_and_addresses() -> None:
    code = emit_costs.watched(CODE)
    with emit_costs.frames() as sizes:
        machine("default").emit_object(llvm.parse_assembly(code))
    arrays = {"ahrs_kernel_process": 160, "inner.0": 320, "ahrs_kernel_measure": 800}
    assert all(sizes[name] >= size - 128 for name, size in arrays.items())  # x86-64 has 128 bytes below the stack
    most = emit_costs.stack(code, sizes, BLOCKS, emit.PREFIX, 8)
    assert most == sizes["ahrs_kernel_process"] + sizes["ahrs_kernel_measure"] + 16
    alone = emit_costs.stack(code, sizes, {}, emit.PREFIX, 8)
    assert alone == max(sizes["ahrs_kernel_measure"] + 8, sizes["ahrs_kernel_process"] + sizes["inner.0"] + 16)


def test_operations_are_counted_as_often_as_they_run() -> None:
    engine = llvm.create_mcjit_compiler(
        llvm.parse_assembly(emit_costs.counting(emit_costs.watched(CODE))), machine("jitdefault")
    )
    engine.finalize_object()
    own = (ctypes.c_uint64 * 1)(engine.get_function_address("ahrs_kernel_measure"))
    x = (ctypes.c_double * 1)(2.0)
    kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
    kind(engine.get_function_address("ahrs_kernel_process"))(own, x, 7)
    assert ctypes.c_int64.from_address(engine.get_global_value_address("operations")).value == 7 * 3
