"""The compile decorator of this package (see `estimators.jit`): its cache follows the sources that are compiled."""

from pathlib import Path

import estimators
from estimators.jit import compiler

_HERE = Path(__file__).parent
njit = compiler(_HERE / "sensors", _HERE / "world", _HERE / "flight", Path(estimators.__file__).parent)
