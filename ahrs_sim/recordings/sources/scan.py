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
    """Find all messages of a DataFlash log.

    Args:
        data: (n,) uint8, the file.
        lengths: (256,) int64 of the types, zeros but for FMT; filled in from the log's own FMT messages.
        offsets: int64, filled in, as many as fit.
        kinds: likewise uint8: the type of each.

    Returns:
        Number of messages, and of bytes that belong to none.
    """
    at, count, lost = 0, 0, 0
    n = data.size
    length = _dataflash_step(data, lengths, at)
    while at < n:
        good = length > 0
        if good and data[at + 2] == FMT and data[at + 4] >= 3 and lengths[data[at + 3]] == 0:
            lengths[data[at + 3]] = data[at + 4]
        following = 0
        if good and at + length < n:  # a head alone may be chance, or the rest of the message lost: another must follow
            following = _dataflash_step(data, lengths, at + length)
            good = following != 0
        if not good:
            at, lost = at + 1, lost + 1
            length = _dataflash_step(data, lengths, at)
            continue
        if count < offsets.size:
            offsets[count], kinds[count] = at, data[at + 2]
        at, count, length = at + length, count + 1, following
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
    """Test whether `count` messages follow from `at` on, or as many as there are."""
    for _ in range(count):
        if at >= end:
            return at == end
        length = _ulog_step(data, sizes, shortest, at)
        if length == 0 or (length < 0 and end - at > _LONG):
            return False
        if length < 0:
            return True
        at += length
    return True


@njit
def ulog(
    data: np.ndarray,
    start: int,
    end: int,
    sizes: np.ndarray,
    shortest: np.ndarray,
    with_data: bool,
    offsets: np.ndarray,
) -> tuple[int, int]:  # pragma: no cover
    """Find the messages of a ULog between `start` and `end`.

    Args:
        data: (n,) uint8, the file.
        start: offset of the first.
        end: where to stop.
        sizes: (65536,) int64, of the data of each subscription; -1: any, -2: there is none of this number.
        shortest: likewise, without trailing padding.
        with_data: data messages are wanted, too.
        offsets: filled in, as many as fit.

    Returns:
        Number of messages wanted, and of bytes that belong to none.
    """
    at, count, lost, skipped = start, 0, 0, 0
    length = _ulog_step(data, sizes, shortest, at)
    while at < end:
        after, following = at + length, 0
        good = length > 0 and after <= end
        if good and after < end:  # a head alone may be chance, or the rest of the message lost: another must follow
            following = _ulog_step(data, sizes, shortest, after)
            good = following > 0 or (following < 0 and end - after <= _LONG)
        if good and skipped:
            number = np.int64(data[at + 3]) | np.int64(data[at + 4]) << 8 if length > 4 else np.int64(0)
            # A long message by chance would hide all that it covers.
            fitting = data[at + 2] == 68 and sizes[number] + 5 == length
            good = (length <= _LONG or fitting) and _ulog_follows(data, sizes, shortest, after, end, 3)
        if not good:
            at, lost, skipped = at + 1, lost + 1, skipped + 1
            length = _ulog_step(data, sizes, shortest, at)
            continue
        if with_data or data[at + 2] != 68:
            if count < offsets.size:
                offsets[count] = at
            count += 1
        at, length, skipped = after, following, 0
    return count, lost


@njit
def gather(data: np.ndarray, offsets: np.ndarray, out: np.ndarray) -> None:  # pragma: no cover
    """Copy the bytes at `offsets` (n,) into the rows of `out` (n, size); beyond the end of `data` they stay."""
    size = out.shape[1]
    for i in range(offsets.size):
        at = offsets[i]
        for k in range(min(size, data.size - at)):
            out[i, k] = data[at + k]
