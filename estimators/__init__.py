"""Attitude estimators on NumPy and Numba, usable without the simulator.

    import estimators

    estimator = estimators.create("marg-ckf", site=site, sensors=sensors)
    estimates = estimator.process(samples)          # blocks of any length, one row for each row

Conventions, everywhere: navigation frame n = local north-east-down, body frame b = forward-right-down; `q_nb` turns
body into navigation vectors, scalar first, Hamilton; `C_bn` maps navigation to body vectors; specific force of a body
at rest is `C_bn (0, 0, -g)`; true heading; SI and radians; missing is NaN.

Layers: `rotations` and `linalg` (one equation per kernel), `filters` (how to estimate), `models` (what to estimate),
`adaptation` (how far to trust a measurement), `run` (the loop over rows), `alignment`, `catalogue` (named
combinations); `native` compiles kernels and lets them call each other. Importing this package compiles nothing.

References, by the names that comments use:

    Han 2013        Han, Gan, He and Alazard: aircraft attitude estimation method based on CKF (in Chinese)
    Zhao 2015       Zhao, Jia, Jin, Tian and Xiong: attitude estimation by UKF for satcom-on-the-move
    Tian 2011       Tian, Sun, Li and Yan: algorithm for the adaptive Kalman filter in AHRS (in Chinese)
    Yao 2012        Yao: attitude estimation based on switched extended Kalman filter (in Chinese)
    Baseline 2021   locating with a single-baseline interferometer and multiple bearing hypotheses (in Chinese; 2021 is
                    the year of the copy, which names no authors)
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimators.catalogue import create, describe, names, prepare
    from estimators.errors import EstimationError, SampleError, SettingError
    from estimators.estimator import Estimator
    from estimators.types import Estimates, Samples, SensorInfo, Site, Status

_HOME = {
    "create": "catalogue", "describe": "catalogue", "names": "catalogue", "prepare": "catalogue",
    "EstimationError": "errors", "SampleError": "errors", "SettingError": "errors",
    "Estimator": "estimator",
    "Estimates": "types", "Samples": "types", "SensorInfo": "types", "Site": "types", "Status": "types",
}  # fmt: skip

__all__ = [
    "EstimationError", "Estimates", "Estimator", "SampleError", "Samples", "SensorInfo", "SettingError", "Site",
    "Status", "create", "describe", "names", "prepare",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'estimators' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(f"estimators.{_HOME[name]}"), name)
