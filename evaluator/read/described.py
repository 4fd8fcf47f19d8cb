"""What a recording says of itself, whether it is open or read and closed."""

from __future__ import annotations

from abc import ABC, abstractmethod

from gpusimbench.evaluator.read.actions import apart_by_design
from gpusimbench.evaluator.read.confirmed import unconfirmed
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import LOGGED, Provenance, Simulation


class Described(ABC):
    """What an open recording and what remains of it have in common.

    path          of the file, or its location
    status        complete, incomplete (no end record), failed (the run said why) or invalid (a validity gate fired)
    reason        why the status is not "complete"
    cause         what kind of thing it was: "device memory", "buffer", "timeout", ...; empty where nothing is said
    content_hash  the identity that the end record claims, empty without one
    provenance    by whom, where, with what software
    simulation    what the simulator said of itself; None where the run ended before it was built
    """

    path: Place
    status: str
    reason: str
    cause: str
    content_hash: str
    provenance: Provenance
    simulation: Simulation | None

    @property
    @abstractmethod
    def dropouts(self) -> tuple[str, ...]:
        """One sentence for each stretch of data that the recorder says was lost."""

    @property
    @abstractmethod
    def action_names(self) -> tuple[str, ...]:
        """Names of the recorded action streams."""

    @property
    def configuration(self) -> RunConfiguration:
        """What was asked."""
        return self.provenance.configuration

    @property
    def usable(self) -> bool:
        """Whether metrics may be computed from it: the run ended well and nothing was lost."""
        return self.status == "complete" and not self.dropouts

    @property
    def unconfirmed(self) -> str:
        """Why a recording with an end record may not be on the disk; empty where nothing speaks against it."""
        return unconfirmed(self.path) if self.status != "incomplete" else ""

    @property
    def of_program(self) -> bool:
        """Whether a program logged it, and no adapter of gsb-record stepped the engine."""
        return self.simulation is not None and self.simulation.fresh_start == LOGGED

    @property
    def fields(self) -> tuple[StateField, ...]:
        """The state fields, in recording order; empty where the run ended before the simulator was built."""
        return self.simulation.fields if self.simulation else ()

    @property
    def apart_by_design(self) -> str:
        """Why the environments differ whatever the engine does; empty where they should be alike."""
        return apart_by_design(self.action_names, self.fields, self.configuration)
