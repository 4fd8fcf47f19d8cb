"""CRC-32 (ISO-HDLC, as in zlib) of A followed by B from those of A and of B, or that of B from the two others, without
reading either again.

A CRC is the remainder of a polynomial over GF(2). Appending n bytes multiplies what came before by x^(8n) modulo the
CRC's polynomial, so crc(A B) = crc(A) * x^(8 |B|) + crc(B), the inversions at begin and end cancelling out.
"""

from __future__ import annotations

from array import array
from functools import lru_cache

# The bit of x^0 is the highest: a CRC-32 is computed in reflected order.
_POLYNOMIAL = 0xEDB88320
_ONE = 1 << 31


def combine(first: int, second: int, size: int) -> int:
    """CRC of two parts one after another, from theirs; `size` is that of the second [byte]."""
    return _moved(first, size) ^ second


def second(both: int, first: int, size: int) -> int:
    """CRC of the second of two parts, from those of both together and of the first; `size` is its own [byte]."""
    return both ^ _moved(first, size)


def _moved(crc: int, size: int) -> int:
    # times x^(8 size): a sum over the crc's eight groups of four bits
    of = _products(size)
    return (
        of[crc & 15] ^ of[16 + (crc >> 4 & 15)] ^ of[32 + (crc >> 8 & 15)] ^ of[48 + (crc >> 12 & 15)]
        ^ of[64 + (crc >> 16 & 15)] ^ of[80 + (crc >> 20 & 15)] ^ of[96 + (crc >> 24 & 15)] ^ of[112 + (crc >> 28)]
    )  # fmt: skip


@lru_cache(maxsize=1024)
def _products(size: int) -> array[int]:
    # x^(8 size) times each number of four bits, by the group in which they stand, the lowest first; blocks of a
    # recording have few different sizes, and a table takes 0.6 kB
    product = _shift(size)
    single = []  # times one bit, the highest first
    for _ in range(32):
        single.append(product)
        product = _times_x(product)
    found = array("I")
    for lowest in range(0, 32, 4):
        row = [0]
        for bit in range(lowest, lowest + 4):
            row += [known ^ single[31 - bit] for known in row]
        found.extend(row)
    return found


def _times_x(b: int) -> int:
    return b >> 1 ^ (_POLYNOMIAL if b & 1 else 0)


def _times(a: int, b: int) -> int:
    # product modulo the polynomial
    product, bit = 0, _ONE
    while bit:
        if a & bit:
            product ^= b
        b = _times_x(b)
        bit >>= 1
    return product


def _shift(size: int) -> int:
    # x^(8 size)
    result, power, left = _ONE, _ONE >> 8, size
    while left:
        if left & 1:
            result = _times(power, result)
        power = _times(power, power)
        left >>= 1
    return result
