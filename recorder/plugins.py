"""Code of other packages: simulators and scenes that installed distributions add."""

from __future__ import annotations

_OLD_ROOTS = ("evaluator", "recorder", "schemas")


def in_words(error: Exception) -> str:
    """What a third party's code raised, in one line, and what to import where a package is named as it was."""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    name = error.name if isinstance(error, ModuleNotFoundError) else None
    if name and name.partition(".")[0] in _OLD_ROOTS:
        text += f"; import gpusimbench.{name} instead (docs/python.md lists what has moved)"
    return text
