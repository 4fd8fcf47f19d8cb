"""What PhysX says while it runs, which is the only sign of contacts that it dropped.

ovphysx hands every line of its process to one receiver, whatever its source, beside printing it. The receiver is shut
off with the last instance.
"""

from __future__ import annotations

import logging
import re
from collections import Counter

_LOGGER = "gpusimbench.recorder.simulators.physx"

_DROPPED = re.compile(
    r"buffer overflow detected|have been dropped|will miss interactions|collide with all environments"
    r"|accept dropped contacts|ran out of buffer space|falling back to (CPU|default parameters)",
    re.IGNORECASE,
)
"""Lines of PhysX's GPU library that mean that steps did not do all of their work, whatever their level.

"Contact buffer overflow detected, ...", "Patch buffer overflow detected, ...", "PxGpuDynamicsMemoryConfig::
collisionStackSize buffer overflow detected, ... Contacts have been dropped.", "The application needs to increase
PxGpuDynamicsMemoryConfig::foundLostPairsCapacity to ..., otherwise, the simulation will miss interactions"; and of its
clones: "the clone will collide with all environments". On the CPU: "ran out of buffer space for narrow phase", "Either
accept dropped contacts". And what is not simulated as asked for: "falling back to CPU simulation", "to default
parameters".
"""


_NUMBER = re.compile(r"\d+")


def is_fatal(level: int, text: str) -> bool:
    """Whether a line makes a run worthless: an error of the engine's, or a sign of dropped contacts at any level."""
    return level >= logging.ERROR or bool(_DROPPED.search(text))


class NativeLog(logging.Handler):
    """Keeps the fatal lines, each once, with how often it came. To be opened when an instance is there.

    Lines that differ in their numbers alone, such as sizes that a buffer would need, are one; the first is kept.
    """

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._fatal: Counter[str] = Counter()
        self._first: dict[str, str] = {}  # line without its numbers -> line
        self._logger = logging.getLogger(_LOGGER)

    def open(self) -> None:
        """Begin to listen."""
        import ovphysx

        self._logger.setLevel(logging.WARNING)
        self._logger.propagate = False  # the engine prints its lines itself
        self._logger.addHandler(self)
        ovphysx.set_log_level(ovphysx.LogLevel.WARNING)
        ovphysx.enable_python_logging(_LOGGER, min_severity=ovphysx.LogLevel.WARNING)

    def emit(self, record: logging.LogRecord) -> None:
        """Take a line; called from the engine's threads, one at a time."""
        text = " ".join(record.getMessage().split())
        if is_fatal(record.levelno, text):
            self._fatal[self._first.setdefault(_NUMBER.sub("#", text), text)] += 1

    def take(self) -> list[str]:
        """The fatal lines since the last call, one sentence each, once all that were said have arrived."""
        import ovphysx

        ovphysx.flush_log()
        found, self._fatal, self._first = self._fatal, Counter(), {}
        return [f"PhysX says, {count} times: {text}" for text, count in found.items()]

    def peek(self) -> list[str]:
        """The same, left for the next call of `take`."""
        import ovphysx

        ovphysx.flush_log()
        return list(self._fatal)

    def close(self) -> None:
        """Stop listening."""
        import ovphysx

        self._logger.removeHandler(self)
        ovphysx.disable_python_logging()
        super().close()
