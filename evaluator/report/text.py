"""Text of strangers, made harmless to whatever shows it."""

from schemas.printable import printable

__all__ = ["printable"]
