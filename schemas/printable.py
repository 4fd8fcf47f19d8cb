"""Text of strangers, made harmless to whatever shows it."""

from __future__ import annotations


def printable(text: str) -> str:
    """Text with control characters and lone surrogates made visible: they move a terminal's cursor and break pages.

    So are those that turn the direction of writing: what follows them reads as something else.
    """
    return "".join(c if _allowed(c) else f"\\x{ord(c):02x}" for c in text)


_DIRECTIONS = frozenset((*range(0x202A, 0x202F), *range(0x2066, 0x206A)))  # embeddings, overrides, isolates


def _allowed(character: str) -> bool:
    code = ord(character)
    if character in "\t\n\r":
        return True
    return (
        code >= 0x20
        and not 0x7F <= code < 0xA0
        and not 0xD800 <= code < 0xE000
        and code not in (0xFFFE, 0xFFFF)
        and code not in _DIRECTIONS
    )
