"""How the recording of an environment ends: with the environment, or before it; and hashes between its steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from gpusimbench.recorder.capture.array_hashes import Hashed, checked_name, hashed
from gpusimbench.schemas.errors import UsageError

Write = Callable[[str, Hashed, int], None]
"""Writes hashes under a name, and how many states precede them."""


class Ending:
    """What recorded environments have in common: hashes of a program's arrays, close, and the with statement."""

    def fingerprint(self, name: str, arrays: Any) -> None:
        """Hash arrays of an update, such as a policy, a gradient or a batch; see RecordingWriter.fingerprint.

        With fingerprints, the recording ends when step is called more often than `steps`, or when the environment is
        closed: so that what follows the last step is in it. Later calls are not recorded.

        UsageError as there, and where the recording has ended before the first call.
        """
        self._hash(name, arrays)

    def close(self, **keywords: Any) -> None:
        """Close the environment, and end the recording.

        With fewer steps than were asked for the recording ends as failed, and says so.
        """
        try:
            self._end(None)
        finally:
            self._close(**keywords)

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        """Close the environment, and end the recording; an error is its reason."""
        try:
            self._end(error)
        finally:
            self.close()

    def _hash(self, name: str, arrays: Any) -> None:
        raise NotImplementedError

    def _end(self, error: BaseException | None) -> None:
        """End the recording; an error is its reason."""
        raise NotImplementedError

    def _close(self, **keywords: Any) -> None:
        """Close the environment."""
        raise NotImplementedError


class Hashes:
    """Hashes of a program's arrays on their way to a recording, which begins with the first step.

    given  whether there are some: then the recording does not end with its last step
    """

    def __init__(self) -> None:
        self.given = False
        self._waiting: list[tuple[str, Hashed, int]] = []

    def take(self, name: str, arrays: Any, *, states: int, ended: bool, write: Write | None) -> None:
        """Hash arrays.

        states  that precede them
        ended   whether the recording has ended: nothing is hashed, and without earlier hashes it is a UsageError
        write   None before the recording begins
        """
        if ended:
            if not self.given:
                raise UsageError("the recording has ended: call fingerprint before the last of the recorded steps, too")
            return
        self.given = True
        found = name, hashed(arrays, checked_name(name)), states
        if write is None:
            self._waiting.append(found)
        else:
            write(*found)

    def begin(self, write: Write) -> None:
        """Write what was hashed before the recording began."""
        for found in self._waiting:
            write(*found)
        self._waiting.clear()
