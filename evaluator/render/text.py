"""Text of strangers, made harmless to whatever shows it."""

from gpusimbench.schemas.text import block, line, printable

__all__ = ["block", "line", "printable"]
