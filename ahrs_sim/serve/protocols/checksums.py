"""Checksums and framing that several protocols share."""

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
