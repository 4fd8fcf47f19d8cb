"""The simulator of a run: the environment variables that it needs, and its end, exactly once, whatever goes wrong."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping

from gpusimbench.recorder.run.start import begin
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.recorder.simulators.snapshot import Extent
from gpusimbench.schemas.errors import UsageError

_FLAGS = "XLA_FLAGS"  # a list of flags, to which more can be added


def apply_environment(wanted: Mapping[str, str]) -> None:
    """Set variables of this process: what the user has set stays, flags are added to the user's.

    UsageError where a flag is set already to something else.
    """
    for name, value in wanted.items():
        given = os.environ.get(name)
        if given is None:
            os.environ[name] = value
        elif name == _FLAGS:
            known = {flag.partition("=")[0]: flag for flag in given.split()}
            for flag in value.split():
                if known.get(flag.partition("=")[0], flag) != flag:
                    raise UsageError(f"{_FLAGS} has {known[flag.partition('=')[0]]}, and this run needs {flag}")
            more = [flag for flag in value.split() if flag.partition("=")[0] not in known]
            os.environ[name] = " ".join([given, *more])


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
        self._description: Description | None = None

    @property
    def simulator(self) -> Simulator:
        """The present one; start comes first."""
        assert self._present is not None
        return self._present

    def start(self) -> Description:
        """Close the present simulator, if any, and build a fresh one, in its initial states."""
        self._close()
        self._present = self._make()
        self._description = description = self._present.build()
        begin(self._present, description, self._initial, self._given)
        return description

    @property
    def can_begin_again(self) -> bool:
        """Whether the present simulator can be brought back to its initial states."""
        return self.simulator.state_claims(self.simulator.options).reset.extent is not Extent.NONE

    def begin_again(self) -> None:
        """Bring the present simulator back to its initial states, and to the actions of step 0, without a new build."""
        assert self._description is not None
        self.simulator.reset()
        begin(self.simulator, self._description, self._initial, self._given)

    def __enter__(self) -> Engine:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._close()

    def _close(self) -> None:
        present, self._present = self._present, None
        if present is not None:
            present.close()
