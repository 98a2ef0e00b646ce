"""Checksums, frames and times that several protocols share."""

from collections.abc import Callable, Iterator

_REFLECTED = 0x8408  # x16 + x12 + x5 + 1, least significant bit first


def _row(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (_REFLECTED if byte & 1 else 0)
    return byte


_TABLE = [_row(byte) for byte in range(256)]


def crc16_reflected(data: bytes, crc: int = 0) -> int:
    """Compute the CRC-16 of CCITT's polynomial, low bit first: of MAVLink (from 0xFFFF) and sbgECom (from 0)."""
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


_LONGEST = 512
"""Bytes of a frame: what claims more is none, and must not keep the next ones waiting."""


class Frames:
    """Finds frames in a stream, whatever else is in it.

    Args:
        sync: how each begins.
        head: bytes that must be there to know the size.
        size: of the whole frame, from its beginning; 0: no frame.
        good: whether the checksum of a whole frame is right.
    """

    def __init__(self, sync: bytes, head: int, size: Callable[[bytes], int], good: Callable[[bytes], bool]) -> None:
        self._sync, self._head, self._size, self._good = sync, head, size, good
        self._pending = b""

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the frames that are whole."""
        self._pending += data
        while True:
            start = self._pending.find(self._sync)
            if start < 0:
                self._pending = self._pending[-(len(self._sync) - 1) :] if len(self._sync) > 1 else b""
                return
            self._pending = self._pending[start:]
            if len(self._pending) < self._head:
                return
            size = self._size(self._pending)
            size = size if size <= _LONGEST else 0
            if len(self._pending) < size:
                return
            frame = self._pending[:size]
            if size and self._good(frame):
                self._pending = self._pending[size:]
                yield frame
            else:
                self._pending = self._pending[1:]


WEEK_MS = 604_800_000


def gps_time(ns: int) -> tuple[int, int]:
    """Convert ns since 1970 (UTC) to the GPS week and the ns in it; 18 leap seconds, those since 2017."""
    since = ns - (315_964_800 - 18) * 10**9
    return since // (WEEK_MS * 10**6), since % (WEEK_MS * 10**6)
