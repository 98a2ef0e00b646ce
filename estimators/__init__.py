"""Attitude estimators on NumPy and Numba, usable without the simulator.

    import estimators

    estimator = estimators.create("marg-ckf", site=site, sensors=sensors)
    estimates = estimator.process(samples)          # blocks of any length, one row for each row

Conventions, everywhere: navigation frame n = local north-east-down, body frame b = forward-right-down; `q_nb` turns
body into navigation vectors, scalar first, Hamilton; `C_bn` maps navigation to body vectors; specific force of a body
at rest is `C_bn (0, 0, -g)`; true heading; SI and radians; missing is NaN.

Layers: `rotations` and `linalg` (one equation per kernel), `filters` (how to estimate), `models` (what to estimate),
`run` (the loop over rows), `alignment`, `catalogue` (named combinations). Importing this package compiles nothing.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimators.catalogue import create, describe, names
    from estimators.errors import EstimationError, SampleError, SettingError
    from estimators.estimator import Estimator
    from estimators.types import Estimates, Samples, SensorInfo, Site, Status

_HOME = {
    "create": "catalogue", "describe": "catalogue", "names": "catalogue",
    "EstimationError": "errors", "SampleError": "errors", "SettingError": "errors",
    "Estimator": "estimator",
    "Estimates": "types", "Samples": "types", "SensorInfo": "types", "Site": "types", "Status": "types",
}  # fmt: skip

__all__ = [
    "EstimationError", "Estimates", "Estimator", "SampleError", "Samples", "SensorInfo", "SettingError", "Site",
    "Status", "create", "describe", "names",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'estimators' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(f"estimators.{_HOME[name]}"), name)
