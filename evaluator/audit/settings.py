"""What original and replay say of themselves and disagree on: what can explain a difference, apart from the rest."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.evaluator.diff.result import Setting
from gpusimbench.evaluator.read.recording import Recording

_FREE = ("compression", "timeout")  # a replay's own; they decide no number
_PACKAGE = "software.packages."


@dataclass(frozen=True)
class Settings:
    """Differing settings.

    deciding  those that can explain other numbers
    packages  how many other installed packages differ: those that no recorder lists among what computes
    """

    deciding: tuple[Setting, ...] = ()
    packages: int = 0


def sorted_out(differing: tuple[Setting, ...], original: Recording, replay: Recording) -> Settings:
    """Of all that differs between two recordings, what can explain other numbers."""
    computing: set[str] = set()
    for recording in (original, replay):
        packages = recording.provenance.software.get("packages", {})
        computing |= {f"{_PACKAGE}{name}" for name in packages} if isinstance(packages, dict) else set()
    others = [s for s in differing if s.name.startswith(_PACKAGE) and s.name not in computing]
    return Settings(tuple(s for s in differing if s not in others and s.name not in _FREE), len(others))
