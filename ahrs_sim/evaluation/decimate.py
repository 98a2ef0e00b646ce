"""Thinning of streams that come in blocks of any length: the same rows are taken however the stream is cut."""

from typing import TypeVar

import numpy as np

from estimators.types import Columns

BlockT = TypeVar("BlockT", bound=Columns)


class Decimator:
    """Takes the first row of every cell of 1 / rate, counted from time zero.

    Args:
        rate: Hz.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._cell = -(2**62)  # the last one from which a row was taken

    def rows(self, t: np.ndarray) -> np.ndarray:
        """Choose rows (k,) of the next block, which has times `t` (n,) s, rising."""
        if not len(t):
            return np.empty(0, np.int64)
        cells = np.floor(t * self._rate + 1e-6).astype(np.int64)
        chosen = np.flatnonzero(np.diff(cells, prepend=self._cell))
        self._cell = int(cells[-1])
        return chosen


class RowDecimator:
    """Takes every k-th row, the first one included.

    Args:
        k: rounded, at least 1.
    """

    def __init__(self, k: float) -> None:
        self._k = max(1, round(k))
        self._seen = 0

    def rows(self, n: int) -> np.ndarray:
        """Choose rows of the next block, which has `n`."""
        first = -self._seen % self._k
        self._seen += n
        return np.arange(first, n, self._k)


def take(block: BlockT, rows: np.ndarray) -> BlockT:
    """Take rows of a block: their numbers (k,) or a mask (n,)."""
    return type(block)(*(getattr(block, name)[rows] for name in block.__match_args__))
