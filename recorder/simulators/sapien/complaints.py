"""What PhysX says when it drops something, in lines of SAPIEN's log and nowhere else."""

from __future__ import annotations

import re

from gpusimbench.recorder.simulators.engine_log import EngineLog
from gpusimbench.schemas.provenance import OverflowBit

_WORDS = {
    "CONTACT_BUFFER": r"Contact buffer overflow detected",
    "PATCH_BUFFER": r"Patch buffer overflow detected",
    "FOUND_LOST_PAIRS": r"foundLostPairsCapacity",
    "COLLISION_STACK": r"collisionStackSize buffer overflow detected",
    "CONTACTS_DROPPED": r"Contacts have been dropped",
}
"""By the name of the bit that stands for it: what the lines have in them, as in PhysX's library for GPUs."""

OVERFLOW_BITS = tuple(OverflowBit(bit, name, fatal=True) for bit, name in enumerate(_WORDS))

_CRITICAL = r"\[critical\]"  # the level at which SAPIEN logs every error and warning of PhysX's


def bits_of(line: str) -> int:
    """The overflow bits that a line of the log stands for; 0 where it is about something else."""
    return sum(1 << bit for bit, words in enumerate(_WORDS.values()) if re.search(words, line))


class Complaints:
    """What PhysX has said since it was last asked."""

    def __init__(self) -> None:
        """Begin to look at what this process prints."""
        self._log = EngineLog()
        self._bits = 0
        self._times: dict[str, int] = {}

    def _look(self) -> None:
        for line in self._log.matches((*_WORDS.values(), _CRITICAL)):
            if bits := bits_of(line):
                self._bits |= bits
            else:
                said = line.rpartition("] ")[2]
                self._times[said] = self._times.get(said, 0) + 1

    def take_bits(self) -> int:
        """The overflow bits of what was said since they were last taken."""
        self._look()
        taken, self._bits = self._bits, 0
        return taken

    def take_sentences(self) -> list[str]:
        """One sentence for each other thing that was said since they were last taken, with how often."""
        self._look()
        taken, self._times = self._times, {}
        return [f"PhysX said, {count} times: {said}" for said, count in taken.items()]

    def close(self) -> None:
        """Look no more."""
        self._log.close()
