"""What a library in a process of its own costs beside the same library in this process: us a row, blocks of 4 s."""

import ctypes
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from ahrs_sim.cli import main
from ahrs_sim.plugins import layout
from ahrs_sim.plugins.library import LibraryEstimator
from estimators import Samples, SensorInfo, Site

ROWS, BLOCKS, ROUNDS = 400, 100, 9
SITE, SENSORS = Site((0.76, 0.026, 150.0)), SensorInfo()


def block(k: int) -> Samples:
    rng = np.random.default_rng(k)
    t = (k * ROWS + np.arange(ROWS)) * 0.01
    return Samples.make(t, rng.normal(0, 0.1, (ROWS, 3)), np.array([0, 0, -9.8]) + rng.normal(0, 0.1, (ROWS, 3)))


def inside(library: ctypes.CDLL, blocks: list[np.ndarray]) -> float:
    """Seconds of the library itself."""
    estimates = np.zeros(ROWS, layout.ESTIMATE)
    library.ahrs_create.restype = ctypes.c_void_p
    handle = ctypes.c_void_p(library.ahrs_create(layout.constants(SITE), layout.constants(SENSORS), b""))
    begun = time.perf_counter()
    for rows in blocks:
        library.ahrs_process(handle, ctypes.c_void_p(rows.ctypes.data), ROWS, ctypes.c_void_p(estimates.ctypes.data))
    return time.perf_counter() - begun


def outside(estimator: LibraryEstimator, blocks: list[Samples]) -> float:
    begun = time.perf_counter()
    for samples in blocks:
        estimator.process(samples)
    return time.perf_counter() - begun


with tempfile.TemporaryDirectory() as folder:
    main(["new", "estimator", "mine", "--lang", "c", "-o", f"{folder}/mine"])
    subprocess.run(["make", "-s", "-C", f"{folder}/mine", "libmine.so"], check=True)
    path = Path(folder, "mine", "libmine.so")
    samples = [block(k) for k in range(BLOCKS)]
    rows = [np.zeros(ROWS, layout.SAMPLE) for _ in samples]
    for given, packed in zip(samples, rows, strict=True):
        layout.write_samples(given, packed)
    library, estimator = ctypes.CDLL(str(path)), LibraryEstimator(path, site=SITE, sensors=SENSORS)
    found = []
    for _ in range(ROUNDS):
        estimator.reset()
        found.append((inside(library, rows), outside(estimator, samples)))
    estimator.close()
scale = 1e6 / (ROWS * BLOCKS)
alone, apart = (statistics.median(times) * scale for times in zip(*found, strict=True))
print(f"library itself {alone:.2f} us a row, in a process of its own {apart:.2f}, overhead {apart - alone:.2f}")
