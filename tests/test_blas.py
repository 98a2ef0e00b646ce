"""The same seed gives the same bytes whichever kernel of the BLAS library the processor chooses."""

import hashlib
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

DIGITS = """
import numpy as np
rng = np.random.default_rng(1)
A = rng.standard_normal((61, 61))
print((A @ A @ A).tobytes().hex())
"""


def run(kernel: str | None, *arguments: str) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_CORETYPE"}
    environment |= {"OPENBLAS_CORETYPE": kernel} if kernel else {}
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, check=True)
    return done.stdout


@pytest.mark.long
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="the kernel is one of another processor")
def test_a_flight_is_the_same_with_an_old_kernel(tmp_path: Path) -> None:
    if run(None, "-c", DIGITS) == run("Nehalem", "-c", DIGITS):
        pytest.skip("the kernels give the same digits here, or NumPy has another BLAS")
    hashes = set()
    for kernel in (None, "Nehalem"):
        log = tmp_path / f"{kernel}.mcap"
        run(kernel, "-m", "ahrs_sim", "fly", "circuit", "--duration", "24", "-o", str(log), "--quiet")
        hashes.add(hashlib.sha256(log.read_bytes()).hexdigest())
    assert len(hashes) == 1
