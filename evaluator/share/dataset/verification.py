"""What verifying a set came to."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gpusimbench.evaluator.share.dataset.manifest import Manifest
from gpusimbench.schemas.errors import ExitCode


class Kind(Enum):
    """What can be wrong with a set, in a word, and the exit code that it means."""

    MISSING = ("missing", ExitCode.DATA_LOST)
    CHANGED = ("changed", ExitCode.DATA_LOST)
    DAMAGED = ("damaged", ExitCode.DATA_LOST)
    EXTRA = ("not named", ExitCode.GATE_FAILED)
    DISAGREES = ("disagrees", ExitCode.GATE_FAILED)
    BROKEN = ("breaks a rule", ExitCode.GATE_FAILED)

    @property
    def word(self) -> str:
        """As in a line of the command."""
        return self.value[0]

    @property
    def code(self) -> ExitCode:
        """What the command ends with."""
        return self.value[1]


@dataclass(frozen=True)
class Finding:
    """Something that is wrong, of which file, in a sentence."""

    kind: Kind
    path: str
    said: str


@dataclass(frozen=True)
class Verification:
    """What became of verifying a set.

    manifest       its own
    findings       everything that is wrong
    unchecked      what could not be looked at, and why, a sentence each
    recordings     how many were read whole, evaluated and held against the rules
    bytes          of the files whose digest was computed
    fetched_bytes  that came from elsewhere
    tables         names of the tables whose every value is what the recordings give
    """

    manifest: Manifest
    findings: tuple[Finding, ...]
    unchecked: tuple[str, ...]
    recordings: int
    bytes: int
    fetched_bytes: int
    tables: tuple[str, ...]

    @property
    def exit_code(self) -> ExitCode:
        """3 where anything is missing, changed or damaged, 4 where anything disagrees, 5 without a recording."""
        codes = {finding.kind.code for finding in self.findings}
        if ExitCode.DATA_LOST in codes or ExitCode.GATE_FAILED in codes:
            return min(codes)
        return ExitCode.OK if self.recordings else ExitCode.NOTHING_COMPARABLE
