"""The simulator of a run: closed exactly once, whatever goes wrong."""

from __future__ import annotations

from collections.abc import Callable

from gpusimbench.recorder.run.start import begin
from gpusimbench.recorder.simulators.base import Description, Simulator


class Engine:
    """The present simulator; each one is closed once, before the next or at the end. A context manager."""

    def __init__(self, make: Callable[[], Simulator], initial: str, given: bytes | None) -> None:
        """initial  as a RunConfiguration has it
        given    the attachment of that, for what was not drawn
        """
        self._make = make
        self._initial = initial
        self._given = given
        self._present: Simulator | None = None

    @property
    def simulator(self) -> Simulator:
        """The present one; start comes first."""
        assert self._present is not None
        return self._present

    def start(self) -> Description:
        """Close the present simulator, if any, and build a fresh one, in its initial states."""
        self._close()
        self._present = self._make()
        description = self._present.build()
        begin(self._present, description, self._initial, self._given)
        return description

    def __enter__(self) -> Engine:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._close()

    def _close(self) -> None:
        present, self._present = self._present, None
        if present is not None:
            present.close()
