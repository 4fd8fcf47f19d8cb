"""How the recording of an environment ends: with the environment, or before it."""

from __future__ import annotations

from typing import Any, Self

from gpusimbench.schemas.errors import UsageError


class Ending:
    """The with statement of a recorded environment: behind it, both the recording and the environment are closed."""

    def _end(self, error: BaseException | None) -> None:
        """End the recording; an error is its reason."""
        raise NotImplementedError

    def close(self) -> Any:
        """Close the environment, and end the recording."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        """Close the environment, and end the recording; an error is its reason."""
        try:
            self._end(error)
        finally:
            self.close()


def refuses_hashes(*, ended: bool, hashing: bool) -> bool:
    """Whether hashes of a program's arrays are left out, since the recording has ended.

    hashing  whether some were given before; UsageError where a recording has ended without any
    """
    if ended and not hashing:
        raise UsageError("the recording has ended: call fingerprint before the last of the recorded steps, too")
    return ended
