"""Compiled kernels that call each other through pointers: compiled once, in any combination.

A filter does not know the model that it works on. Were the model's type an argument, Numba would compile the filter
anew for every model. Here every kernel of a model, a filter or a policy becomes a C function of its own that takes
pointers, and a *handle*, a record of the addresses of these functions, stands for the model, filter or policy:

    @entry("pippfp")
    def propagate(model, count, x, u, dt, out): ...       # the contract: its own body is never run

    propagate(handle, 1, x, u, dt, out)                   # in a kernel: calls what the handle's field `propagate` says

The C functions are kept on disk in the folder of `jit` (a file each, keyed by the sources), ready to run.
With `NUMBA_DISABLE_JIT=1` the same calls run plain Python.
"""

import contextlib
import ctypes
import gc
import hashlib
import os
import pickle
import sys
import tempfile
import types as types_
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Self, TypeAlias, TypeVar, cast, get_args, get_type_hints

import numba
import numpy as np
from llvmlite import binding as llvm  # type: ignore[import-untyped]
from llvmlite import ir
from numba import types
from numba.core import cgutils, registry
from numba.core.imputils import lower_builtin
from numba.core.runtime.nrt import rtsys
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.np.arrayobj import populate_array

from estimators.jit import FOLDER, JIT, inner

CAPACITY = int(os.environ.get("AHRS_SIM_ROW", "72"))
"""Most components of a state or an error; every matrix of the loop has rows of this length (nine cache lines).

Code that is exported (`emit`) has rows as long as its method needs.
"""

Kernel: TypeAlias = Callable[..., Any]
"""A function that Numba compiles, or the body of a C function."""

Number = Annotated[float, np.dtype(np.float64)]
Integer = Annotated[int, np.dtype(np.int64)]
Flag = Annotated[bool, np.dtype(np.bool_)]
Address = Annotated[int, np.dtype(np.int64)]


def shaped(*shape: int, dtype: Any = np.float64) -> np.dtype:
    """Describe an array inside a record, as the second part of its annotation."""
    return np.dtype((dtype, shape))


Vector3 = Annotated[np.ndarray, shaped(3)]
Vector4 = Annotated[np.ndarray, shaped(4)]
Flags3 = Annotated[np.ndarray, shaped(3, dtype=np.uint8)]  # 0 or 1
Matrix3 = Annotated[np.ndarray, shaped(3, 3)]


class Record:
    """A NumPy record (a structured array without dimensions) whose fields are attributes; nothing is copied.

        class State(Record):
            q_nb: Vector4
            gyro_bias: Vector3

    `State.dtype` is made of the annotations. `State.zeros()`, `State.nans()` and `State.of(gyro_bias=..., ...)` make
    one; `data` is its memory.
    """

    dtype: np.dtype

    def __init_subclass__(cls, size: int = 0) -> None:
        """Make `dtype`; `size`, when given, is the number of bytes from one record to the next."""
        fields = []
        for name, kind in get_type_hints(cls, include_extras=True).items():
            if name != "dtype":
                nested = isinstance(kind, type) and issubclass(kind, Record)
                fields.append((name, kind.dtype if nested else get_args(kind)[1]))
        packed = np.dtype(fields, align=True)
        if size:
            offsets = [packed.fields[name][1] for name in packed.names]  # type: ignore[index,union-attr]
            packed = np.dtype(
                {
                    "names": [n for n, _ in fields],
                    "formats": [k for _, k in fields],
                    "offsets": offsets,
                    "itemsize": size,
                },
                align=True,
            )
        cls.dtype = packed

    def __init__(self, data: np.ndarray) -> None:
        object.__setattr__(self, "data", data)

    def __getattr__(self, name: str) -> Any:
        value = object.__getattribute__(self, "data")[name]
        if value.dtype.names:
            return Record(value)
        return value if value.ndim else value.item()

    __getitem__ = __getattr__

    def __setattr__(self, name: str, value: Any) -> None:
        self.data[name] = value

    @classmethod
    def joined(cls, parts: Mapping[str, type["Record"]], size: int = 0) -> type["Record"]:
        """A record of this one's fields and a record for each of `parts`."""
        fields = {**get_type_hints(cls, include_extras=True), **parts}
        fields.pop("dtype", None)
        body = {"__annotations__": fields, "__module__": cls.__module__, "__doc__": cls.__doc__}
        return _made(cls.__name__, body, size)

    @classmethod
    def flags(cls, size: int = 0) -> type["Record"]:
        """A record of the same fields and shapes, of flags (0 or 1)."""
        fields: dict[str, Any] = {}
        for name in cls.dtype.names or ():
            kind = cls.dtype[name]
            if kind.names:
                fields[name] = _nested(kind).flags()
            else:
                fields[name] = Annotated[
                    np.ndarray, shaped(*kind.shape, dtype=np.uint8) if kind.shape else np.dtype(np.uint8)
                ]
        body = {"__annotations__": fields, "__module__": cls.__module__, "__doc__": f"Flags of {cls.__name__}."}
        return _made("Used", body, size)

    @classmethod
    def zeros(cls) -> Self:
        """A record of zeros."""
        return cls(np.zeros((), cls.dtype))

    @classmethod
    def nans(cls) -> Self:
        """A record whose real fields are NaN, the others zero."""
        made = np.zeros((), cls.dtype)
        _spoil(made)
        return cls(made)

    @classmethod
    def of(cls, **values: Any) -> Self:
        """A record of these values, all of them.

        Raises:
            TypeError: a field is missing or unknown.
        """
        names = set(cls.dtype.names or ())
        if names != set(values):
            raise TypeError(f"{cls.__qualname__}: missing {names - set(values)}, unknown {set(values) - names}")
        made = np.zeros((), cls.dtype)
        for name, value in values.items():
            made[name] = value
        return cls(made)


def _made(name: str, body: dict[str, Any], size: int) -> type[Record]:
    return types_.new_class(name, (Record,), {"size": size}, lambda space: space.update(body))


def _nested(kind: np.dtype) -> type[Record]:
    class Nested(Record):
        pass

    Nested.dtype = kind
    return Nested


def _spoil(made: np.ndarray) -> None:
    for name in made.dtype.names or ():
        if made[name].dtype.names:
            _spoil(made[name])
        elif made[name].dtype.kind == "f":
            made[name] = np.nan


def same_integers(one: np.ndarray, other: np.ndarray) -> bool:
    """Tell whether two records of a dtype agree in all integers and flags: sizes, offsets, choices."""
    for name in one.dtype.names or ():
        a, b = one[name], other[name]
        if not (same_integers(a, b) if a.dtype.names else a.dtype.kind == "f" or bool((a == b).all())):
            return False
    return True


# Views of memory behind a pointer. In plain Python the "pointer" is the array itself.


def record(pointer: Any, dtype: np.dtype, index: int = 0) -> Any:
    """The record at `pointer`, the `index`-th of a row of such records."""
    if isinstance(pointer, Record | Plain):
        return pointer
    if pointer.dtype == dtype:
        return Record(pointer if pointer.ndim == 0 else pointer[index : index + 1].reshape(()))
    row = pointer[index] if pointer.ndim > 1 else pointer
    return Record(row[: dtype.itemsize // row.dtype.itemsize].view(dtype).reshape(()))


def vector(pointer: Any, index: int = 0) -> np.ndarray:
    """The vector (CAPACITY,) at `pointer`, the `index`-th row of a matrix; or the numbers of a record."""
    if isinstance(pointer, Record):
        pointer = pointer.data.reshape(1).view(np.float64)
    return pointer[index] if pointer.ndim > 1 else pointer  # type: ignore[no-any-return]


def matrix(pointer: Any) -> np.ndarray:
    """The matrix at `pointer`, with rows of CAPACITY."""
    return pointer  # type: ignore[no-any-return]


def flags(pointer: Any) -> np.ndarray:
    """The vector of flags (0 or 1) at `pointer`; or the bytes of a record."""
    if isinstance(pointer, Record):
        pointer = pointer.data.reshape(1).view(np.uint8)
    return pointer  # type: ignore[no-any-return]


def local(*shape: int) -> np.ndarray:
    """Memory of a kernel's own (on the stack), which ends with it; its contents are not set. Constant shape."""
    return np.empty(shape)


def _pointer(builder: Any, kind: Any, value: Any) -> Any:
    return builder.inttoptr(value, cgutils.voidptr_t) if isinstance(kind, types.Integer) else value


def _array(context: Any, builder: Any, kind: Any, pointer: Any, shape: tuple[int, ...]) -> Any:
    """An array value that owns nothing."""
    made = context.make_array(kind)(context, builder)
    item = context.get_abi_sizeof(context.get_data_type(kind.dtype))
    strides = [item * int(np.prod(shape[i + 1 :])) for i in range(len(shape))]
    intp = context.get_value_type(types.intp)
    fill: Any = populate_array
    fill(
        made,
        data=builder.bitcast(pointer, made.data.type),
        shape=[intp(n) for n in shape],
        strides=[intp(n) for n in strides],
        itemsize=intp(item),
        meminfo=None,
    )
    return made._getvalue()


def _builtin(function: Any, kind: Callable[..., Any], generate: Callable[..., Any]) -> None:
    """Let compiled code call `function`: `kind(*types)` is the type of the result, `generate` writes its code."""

    class Template(AbstractTemplate):
        key = function
        prefer_literal = True

        def generic(self, args: Any, kws: Any) -> Any:
            made: Any = signature
            return made(kind(*args), *args)

    numba_: Any = (infer_global, lower_builtin, types)
    register, lower, kinds = numba_
    register(function, kinds.Function(Template))
    lower(function, kinds.VarArg(kinds.Any))(generate)


def _at(context: Any, builder: Any, given: Any, arguments: Any, index: int, stride: int) -> Any:
    """The pointer, `stride` bytes further for each of the index."""
    base = _pointer(builder, given.args[0], arguments[0])
    if len(arguments) <= index:
        return base
    step = context.cast(builder, arguments[index], given.args[index], types.intp)
    return builder.gep(base, [builder.mul(step, step.type(stride))])


def _generate_record(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
    kind = given.return_type
    return builder.bitcast(_at(context, builder, given, arguments, 2, kind.size), context.get_value_type(kind))


def _generate_view(stride: int, *shape: int) -> Callable[..., Any]:
    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        return _array(context, builder, given.return_type, _at(context, builder, given, arguments, 1, stride), shape)

    return generate


def _generate_local(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
    shape = tuple(kind.literal_value for kind in given.args)
    allocate: Any = cgutils.alloca_once
    space = allocate(builder, context.get_data_type(types.float64), size=int(np.prod(shape)))
    return _array(context, builder, given.return_type, builder.bitcast(space, cgutils.voidptr_t), shape)


_REALS, _MATRIX = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_builtin(record, lambda pointer, dtype, index=0: dtype.dtype, _generate_record)
_builtin(vector, lambda pointer, index=0: _REALS, _generate_view(8 * CAPACITY, CAPACITY))
_builtin(matrix, lambda pointer: _MATRIX, _generate_view(0, CAPACITY, CAPACITY))
_builtin(flags, lambda pointer: types.Array(types.uint8, 1, "C"), _generate_view(0, CAPACITY))
_builtin(local, lambda *shape: types.Array(types.float64, len(shape), "C"), _generate_local)


# Calls through pointers


_Function = TypeVar("_Function", bound=Callable[..., Any])


class Plain:
    """A handle in plain Python: its attributes are functions and numbers themselves instead of addresses."""

    def __init__(self, **fields: Any) -> None:
        self.__dict__.update(fields)


def entry(arguments: str, returns: Any = None) -> Callable[[_Function], _Function]:
    """Make a function of the contract: a call goes to the C function whose address its first argument, a handle, has.

    Args:
        arguments: a letter each, of all: `p` pointer (an array or a record), `i` int64, `f` float64.
        returns: None, bool, int or float.
    """
    result = {None: types.none, bool: types.boolean, int: types.int64, float: types.float64}[returns]

    def decorate(function: _Function) -> _Function:
        name = function.__name__

        def call(handle: Any, *given: Any) -> Any:
            return getattr(handle, name)(handle, *given)

        call.__name__, call.__doc__, call.__module__ = name, function.__doc__, function.__module__
        call.arguments, call.returns = arguments, returns  # type: ignore[attr-defined]
        _builtin(call, lambda *kinds: result, _generate_call(name))
        return cast("_Function", call)

    return decorate


def adapts(called: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Give an entry its adapter: `adapter(owner, kernel)` returns the C function's body, with pointers for arguments.

    `owner` says what the pointers point to, `kernel` is the function that a model, filter or policy has of that name.
    """

    def decorate(adapter: Callable[..., Any]) -> Callable[..., Any]:
        called.adapter = adapter
        return adapter

    return decorate


def source_key(kernel: Callable[..., Any] | None, default: str) -> str:
    """Name of the module that a kernel comes from, for the disk cache; one outside this package carries its source."""
    if kernel is None:
        return default
    package, _, name = kernel.__module__.partition(".")
    source = getattr(sys.modules[kernel.__module__], "__file__", None)
    if package == __name__.partition(".")[0] or source is None:
        return name
    return f"{kernel.__module__}-{hashlib.sha256(Path(source).read_bytes()).hexdigest()[:12]}"


def supplied(called: Any, owner: Any, kernel: Callable[..., Any] | None, key: str) -> Any:
    """The address of an entry's C function for `owner`; in plain Python the function itself.

    Args:
        called: the entry.
        owner: a model, filter or policy; passed to the entry's adapter.
        kernel: its function; None when the adapter needs none.
        key: names the owner in the disk cache.
    """
    if not JIT:
        return called.adapter(owner, kernel and getattr(kernel, "py_func", kernel))
    name = f"{key}.{called.__name__}"
    if name not in _LOADED:
        body = called.adapter(owner, kernel and inner(getattr(kernel, "py_func", kernel), forceinline=True))
        if not (address := compiled(name, body, called.arguments, called.returns)):
            return 0  # listed by `planning`
        _LOADED[name] = address
    return _LOADED[name]


def pointer(memory: Any) -> int:
    """Address of an array or a record."""
    return int((memory.data if isinstance(memory, Record) else memory).ctypes.data)


def loaded(called: Any, key: str) -> Callable[..., Any]:
    """An entry without an owner, as a Python function of what `passed` makes."""
    return caller(called, supplied(called, None, None, key))


def passed(*memory: Any) -> list[Any]:
    """Arrays, records and handles as a `caller` takes them."""
    return [pointer(one) for one in memory] if JIT else list(memory)


def joined(kind: type[Record], parts: Mapping[str, Any], numbers: Mapping[str, Any]) -> Any:
    """A record of the addresses of its parts, which must outlive it, and of numbers."""
    if not JIT:
        return Plain(**parts, **numbers)
    return kind.of(**{name: pointer(part) for name, part in parts.items()}, **numbers)


def argument(memory: Any) -> Any:
    """A record or handle as an argument of an `njit` function; nothing is copied."""
    return memory.data[()] if JIT else memory


def caller(called: Any, address: Any) -> Callable[..., Any]:
    """An entry's C function as a Python function of addresses; in plain Python the function itself."""
    if not JIT:
        return address  # type: ignore[no-any-return]
    kinds = {"p": ctypes.c_void_p, "i": ctypes.c_int64, "f": ctypes.c_double}
    result = {None: None, bool: ctypes.c_bool, int: ctypes.c_int64, float: ctypes.c_double}[called.returns]
    return ctypes.CFUNCTYPE(result, *[kinds[letter] for letter in called.arguments])(address)


def _generate_call(name: str) -> Callable[..., Any]:
    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        handle = given.args[0]
        field = builder.gep(builder.bitcast(arguments[0], cgutils.voidptr_t), [cgutils.intp_t(handle.offset(name))])
        address = builder.load(builder.bitcast(field, cgutils.intp_t.as_pointer()))
        values = [_passed(context, builder, k, v) for k, v in zip(given.args, arguments, strict=True)]
        result = _C_RESULT[given.return_type]
        kind = ir.FunctionType(result, [value.type for value in values])
        got = builder.call(builder.inttoptr(address, kind.as_pointer()), values)
        if given.return_type == types.none:
            return context.get_dummy_value()
        return builder.icmp_signed("!=", got, got.type(0)) if given.return_type == types.boolean else got

    return generate


_C_RESULT = {
    types.none: cgutils.voidptr_t,  # what a C function of Numba's returns: some machines compare types
    types.boolean: ir.IntType(64),
    types.int64: ir.IntType(64),
    types.float64: ir.DoubleType(),
}


def _passed(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        value = context.make_array(kind)(context, builder, value=value).data
    if isinstance(kind, types.Array | types.Record):
        return builder.bitcast(value, cgutils.voidptr_t)
    if isinstance(kind, types.Float):
        return context.cast(builder, value, kind, types.float64)
    return context.cast(builder, value, kind, types.int64)


# Compilation


_LOADED: dict[str, int] = {}
_KEEP: list[Any] = []
listeners: list[Callable[[], None]] = []
"""Called before each compilation of a C function, not when it comes from the disk."""


_planned: dict[Path, Callable[[], object]] | None = None


@contextlib.contextmanager
def planning() -> Iterator[dict[Path, Callable[[], object]]]:
    """List what is not on the disk yet instead of compiling it: by file, what makes it.

    What is created meanwhile has no kernels and must not be run.
    """
    global _planned
    _planned = {}
    try:
        yield _planned
    finally:
        _planned = None


def compiled(name: str, function: Callable[..., Any], arguments: str, returns: Any) -> int:
    """Address of `function` as a C function; loaded from disk if it was ever compiled before. 0 while `planning`.

    Args:
        name: unique in all the sources.
        function: its body; may call `njit` functions and entries.
        arguments: a letter each: `p` pointer, `i` int64, `f` float64.
        returns: None, bool, int or float.
    """
    context = registry.cpu_target.target_context
    rtsys.initialize(context)  # what is loaded may name its symbols, and nothing may have been compiled before
    codegen = context.codegen()
    path = FOLDER / f"{name}.{hashlib.sha256(repr(codegen.magic_tuple()).encode()).hexdigest()[:12]}.kernel"
    found = _read(path)
    if found is None:
        if _planned is not None:
            _planned[path] = lambda: _read_or_compile(path, function, arguments, returns)
            return 0
        found = _read_or_compile(path, function, arguments, returns)
    symbol, state = found
    _KEEP.append(codegen.unserialize_library(state))
    return int(codegen._engine.get_function_address(symbol))


def _read(path: Path) -> Any:
    try:
        return pickle.loads(path.read_bytes())
    except (OSError, EOFError, ValueError, pickle.UnpicklingError):
        return None


def _read_or_compile(path: Path, function: Kernel, arguments: str, returns: Any) -> Any:
    with _alone(path):
        found = _read(path)
        if found is None:
            found = _compile(function, arguments, returns)
            store(path, pickle.dumps(found))
    return found


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Wait until no other process compiles for this file; where there are no locks, several do."""
    with contextlib.ExitStack() as held:
        with contextlib.suppress(ImportError, OSError):
            import fcntl

            path.parent.mkdir(parents=True, exist_ok=True)
            lock = held.enter_context((path.parent / "lock").open("ab"))
            place = int.from_bytes(hashlib.sha256(path.name.encode()).digest()[:4], "little") >> 1
            fcntl.lockf(lock, fcntl.LOCK_EX, 1, place)  # a byte for each kernel; free when its owner ends
        yield


_ARGUMENTS = {"p": types.voidptr, "i": types.int64, "f": types.float64}
_RETURNS = {None: types.void, bool: types.int64, int: types.int64, float: types.float64}


def cfunc(function: Callable[..., Any], arguments: str, returns: Any) -> Any:
    """Numba's C function of a body."""
    kind = _RETURNS[returns](*[_ARGUMENTS[letter] for letter in arguments])
    options: Any = {"error_model": "numpy", "_nrt": False}  # without reference counts: a kernel cannot allocate
    return numba.cfunc(kind, **options)(function)


def _compile(function: Callable[..., Any], arguments: str, returns: Any) -> tuple[str, Any]:
    for listener in listeners:
        listener()
    collects = gc.isenabled()
    gc.disable()  # a tenth of the time would go into looking for circles among the compiler's objects
    try:
        made = cfunc(function, arguments, returns)
    finally:
        if collects:
            gc.enable()
    name, _, (code, _) = made._library.serialize_using_object_code()
    nothing = llvm.parse_assembly("").as_bitcode()
    return made.native_name, (name, "object", (code, nothing))


def store(path: Path, content: bytes) -> None:
    """Write at once or not at all: processes that compile at the same time do not see halves."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(content)
        Path(file.name).replace(path)
    except OSError:
        pass  # no cache then: compiled again the next time
