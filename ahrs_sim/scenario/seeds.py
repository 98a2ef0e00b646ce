"""Random numbers: one seed a flight, one independent stream a name.

A stream depends on the seed and its own name only, so adding a sensor, a fault or an estimator leaves every other
stream unchanged, and values are drawn row by row, so the length of blocks does not matter.
"""

import numpy as np


def generator(seed: int, *name: str) -> np.random.Generator:
    """Make the generator of the stream `name` (e.g. `"suite", "chr", "gyro"`) under `seed` (>= 0)."""
    key = "\0".join(name).encode()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=tuple(key))))


def integer(seed: int, *name: str) -> int:
    """Draw a 31-bit seed for a generator of another library (JSBSim's) under the same rule."""
    return int(generator(seed, *name).integers(1, 2**31 - 1))
