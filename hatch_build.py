"""Compiled kernels for a wheel: `AHRS_SIM_COMPILE=1 pip wheel --no-build-isolation .` (two minutes).

Without the variable the wheel is plain Python. It cannot be built in pip's isolation: JSBSim finds no data there.
A wheel with kernels compiles nothing for a first flight where Python, Numba and NumPy are the versions that it was
built with and the processor has what x86-64-v3 has (AVX2, since 2013). Anywhere else it compiles as if there were none.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

FEATURES = "+avx,+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe,+popcnt,+sse4.2,+xsave"
TARGET = {"cpu": "x86-64-v3", "features": FEATURES, "triple": "x86_64-unknown-linux-gnu"}
FILL = """
import estimators
from ahrs_sim import cli, pipeline, scenario
estimators.prepare([(m.name, {}) for m in estimators.describe() if m.own])
pipeline.fly(scenario.load("circuit", duration=75.0), None)
"""


class Kernels(BuildHookInterface):
    """Compiles every method of the catalogue and what the circuit needs, into the package."""

    def dependencies(self) -> list[str]:
        """What is compiled has to run."""
        return list(self.metadata.core.dependencies) if _asked() else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the cache folders, and what they are for."""
        if not _asked() or version == "editable":
            return
        folder = Path(tempfile.mkdtemp())
        environment = {
            **os.environ, "NUMBA_CACHE_DIR": str(folder), "NUMBA_CPU_NAME": TARGET["cpu"],
            "NUMBA_CPU_FEATURES": TARGET["features"],
            "PYTHONPATH": os.pathsep.join([self.root, os.environ.get("PYTHONPATH", "")]),  # pip's, of its build
        }  # fmt: skip
        subprocess.run([sys.executable, "-c", FILL], env=environment, check=True)
        (folder / "target.json").write_text(json.dumps(TARGET))
        build_data["force_include"][str(folder)] = "estimators/kernels"
        build_data["pure_python"], build_data["infer_tag"] = False, True


def _asked() -> bool:
    return os.environ.get("AHRS_SIM_COMPILE") == "1"
