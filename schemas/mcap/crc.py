"""CRC-32 (ISO-HDLC, as in zlib) of A followed by B from those of A and of B, or that of B from the two others, without
reading either again.

A CRC is the remainder of a polynomial over GF(2). Appending n bytes multiplies what came before by x^(8n) modulo the
CRC's polynomial, so crc(A B) = crc(A) * x^(8 |B|) + crc(B), the inversions at begin and end cancelling out.
"""

from __future__ import annotations

from functools import lru_cache

# The bit of x^0 is the highest: a CRC-32 is computed in reflected order.
_POLYNOMIAL = 0xEDB88320
_ONE = 1 << 31


def combine(first: int, second: int, size: int) -> int:
    """CRC of two parts one after another, from theirs; `size` is that of the second [byte]."""
    return _times(_shift(size), first) ^ second


def second(both: int, first: int, size: int) -> int:
    """CRC of the second of two parts, from those of both together and of the first; `size` is its own [byte]."""
    return both ^ _times(_shift(size), first)


def _times(a: int, b: int) -> int:
    # product modulo the polynomial
    product, bit = 0, _ONE
    while bit:
        if a & bit:
            product ^= b
        b = b >> 1 ^ (_POLYNOMIAL if b & 1 else 0)
        bit >>= 1
    return product


@lru_cache(maxsize=1024)
def _shift(size: int) -> int:
    # x^(8 size); blocks of a recording have few different sizes
    result, power, left = _ONE, _ONE >> 8, size
    while left:
        if left & 1:
            result = _times(power, result)
        power = _times(power, power)
        left >>= 1
    return result
