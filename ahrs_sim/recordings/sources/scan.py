"""Finding messages in binary logs whose length stands in front of each: one pass over the bytes, compiled."""

from pathlib import Path

import numpy as np

from estimators.jit import compiler

njit = compiler(Path(__file__).parent)

FMT, FMT_LENGTH = 128, 89
_LONG = 300  # bytes


@njit
def _dataflash_step(data: np.ndarray, lengths: np.ndarray, at: int) -> int:  # pragma: no cover
    """Length of the message at `at`; 0: there is none, -1: it is cut off by the end."""
    n = data.size
    if at + 3 > n:
        return -1
    if data[at] != 0xA3 or data[at + 1] != 0x95:
        return 0
    length = lengths[data[at + 2]]
    if length == 0:
        return 0
    return length if at + length <= n else -1


@njit
def dataflash(
    data: np.ndarray, lengths: np.ndarray, offsets: np.ndarray, kinds: np.ndarray
) -> tuple[int, int]:  # pragma: no cover
    """Find all messages of a DataFlash log; with empty arrays for the results, only count them.

    Args:
        data: (n,) uint8, the file.
        lengths: (256,) int64 of the types, zeros but for FMT; filled in from the log's own FMT messages.
        offsets: (messages,) int64, filled in.
        kinds: likewise uint8: the type of each.

    Returns:
        Number of messages, and of bytes that belong to none.
    """
    at, count, lost, skipped = 0, 0, 0, 0
    n = data.size
    while at < n:
        length = _dataflash_step(data, lengths, at)
        if length > 0 and _dataflash_step(data, lengths, at + length) == 0 and at + length < n and data[at + 2] != FMT:
            length = 0  # a head alone may be chance, or the rest of the message lost: another must follow
        if length <= 0:
            at, lost, skipped = at + 1, lost + 1, skipped + 1
            continue
        kind = data[at + 2]
        if kind == FMT and data[at + 4] >= 3 and lengths[data[at + 3]] == 0:
            lengths[data[at + 3]] = data[at + 4]
        if count < offsets.size:
            offsets[count], kinds[count] = at, kind
        at, count, skipped = at + length, count + 1, 0
    return count, lost


@njit
def _ulog_step(data: np.ndarray, sizes: np.ndarray, shortest: np.ndarray, at: int) -> int:  # pragma: no cover
    """Length of the message at `at` with its head; 0: there is none, -1: it is cut off by the end."""
    n = data.size
    if at + 3 > n:
        return -1
    size = int(data[at]) | int(data[at + 1]) << 8
    kind = data[at + 2]
    # A B C D F I L M O P Q R S
    if not (65 <= kind <= 68 or kind in (70, 73, 76, 77, 79, 80, 81, 82, 83)) or size == 0:
        return 0
    if kind == 68:
        if size < 2:
            return 0
        if at + 5 > n:
            return -1
        number = int(data[at + 3]) | int(data[at + 4]) << 8
        if sizes[number] >= 0 and not shortest[number] <= size - 2 <= sizes[number]:
            return 0
        if sizes[number] == -2:  # never announced
            return 0
    elif kind == 79 and size != 2:
        return 0
    return size + 3 if at + size + 3 <= n else -1


@njit
def _ulog_follows(
    data: np.ndarray, sizes: np.ndarray, shortest: np.ndarray, at: int, end: int, count: int
) -> bool:  # pragma: no cover
    """Whether `count` messages follow from `at` on, or as many as there are."""
    for _ in range(count):
        if at >= end:
            return at == end
        length = _ulog_step(data, sizes, shortest, at)
        if length == 0 or (length < 0 and end - at > 1000):
            return False
        if length < 0:
            return True
        at += length
    return True


@njit
def ulog(
    data: np.ndarray, start: int, end: int, sizes: np.ndarray, shortest: np.ndarray, offsets: np.ndarray
) -> tuple[int, int]:  # pragma: no cover
    """Find all messages of a ULog between `start` and `end`; with an empty `offsets`, only count them.

    Args:
        data: (n,) uint8, the file.
        start: offset of the first.
        end: where to stop.
        sizes: (65536,) int64, of the data of each subscription; -1: any, -2: there is none of this number.
        shortest: likewise, without trailing padding.
        offsets: (messages,) int64, filled in.

    Returns:
        Number of messages, and of bytes that belong to none.
    """
    at, count, lost, skipped = start, 0, 0, 0
    while at < end:
        length = _ulog_step(data, sizes, shortest, at)
        if skipped and length > _LONG and sizes[int(data[at + 3]) | int(data[at + 4]) << 8] + 5 != length:
            length = 0  # a long message by chance would hide all that it covers
        if length > 0 and not _ulog_follows(data, sizes, shortest, at + length, end, 3 if skipped else 1):
            length = 0  # a head alone may be chance, or the rest of the message lost: others must follow
        if length <= 0 or at + length > end:
            at, lost, skipped = at + 1, lost + 1, skipped + 1
            continue
        if count < offsets.size:
            offsets[count] = at
        at, count, skipped = at + length, count + 1, 0
    return count, lost


@njit
def gather(data: np.ndarray, offsets: np.ndarray, out: np.ndarray) -> None:  # pragma: no cover
    """Copy the bytes at `offsets` (n,) into the rows of `out` (n, size); beyond the end of `data` they stay."""
    size = out.shape[1]
    for i in range(offsets.size):
        at = offsets[i]
        for k in range(min(size, data.size - at)):
            out[i, k] = data[at + k]
