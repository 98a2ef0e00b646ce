"""Kernels in single precision: the same intermediate code with every number a float in the place of a double.

Memory stays as it is laid out, eight bytes a number, of which a float takes the first four: records, arrays and their
strides are those of the double version, and only what is loaded, computed and stored changes.
"""

import re

import numpy as np

_PLACES = re.compile(
    r" = (?:alloca|getelementptr(?: inbounds)?(?: nuw| nusw)*) double\b"
)  # sizes and strides: they stay
_NUMBER = re.compile(r"(?<![\w.])(?:0x[0-9A-F]{16}|-?\d+\.\d+e[+-]\d+)\b")


def single(code: str) -> str:
    """Rewrite intermediate code of doubles to floats."""
    code = re.sub(r"@sqrt\b", "@llvm.sqrt.f64", code)
    return "\n".join(_line(line) if "double" in line else line for line in code.splitlines())


def _line(line: str) -> str:
    if _PLACES.search(line):
        return line
    line = re.sub(r"\bdouble\b", "float", line).replace(".f64(", ".f32(")
    return _NUMBER.sub(lambda found: _rounded(found[0]), line)


def _rounded(text: str) -> str:
    """Round a constant to a float, as LLVM writes one: the bits of the double of that value."""
    value = np.uint64(int(text, 16)).view(np.float64) if text.startswith("0x") else np.float64(text)
    with np.errstate(over="ignore", under="ignore"):
        return f"0x{int(np.float64(np.float32(value)).view(np.uint64)):016X}"


def image(data: np.ndarray) -> bytes:
    """The bytes of a record (an array without dimensions) with every double a float in its place, gaps as they are."""
    made = np.frombuffer(bytearray(data.tobytes()), data.dtype)  # a copy of the fields alone has anything in the gaps
    _convert(made)
    return made.tobytes()


def _convert(array: np.ndarray) -> None:
    """Replace the doubles of an array, records included, in place."""
    if array.dtype.names:
        for name in array.dtype.names:
            _convert(array[name])
    elif array.dtype == np.float64:
        bits = np.zeros(array.shape, np.uint64)
        with np.errstate(over="ignore", under="ignore"):
            bits[...] = array.astype(np.float32).view(np.uint32)
        array[...] = bits.view(np.float64)
