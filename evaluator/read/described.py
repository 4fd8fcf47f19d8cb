"""What a recording says of itself, whether it is open or read and closed; parameters that differ among environments."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.actions import apart_by_design
from gpusimbench.schemas import PARTIAL, arrays
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import LOGGED, Provenance, Simulation
from gpusimbench.schemas.treatment import VARIED


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
    @abstractmethod
    def acted(self) -> bool:
        """Whether actions were applied in any phase."""

    @property
    def configuration(self) -> RunConfiguration:
        """The configuration that was asked of the run."""
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
        return apart_by_design(self.acted, self.fields, self.configuration)


def unconfirmed(path: Place) -> str:
    """A sentence on a file that has an end record, and still the name under which it was written; empty for others.

    The end record is written before the flush to the disk and the renaming. If the flush fails, what is read here can
    be whole because the operating system still has it in memory, and be lost when the machine is restarted.
    """
    if not path.name.endswith(PARTIAL):
        return ""
    return f"not confirmed by its recorder to be on the disk: its name still ends in {PARTIAL}"


@dataclass(frozen=True)
class Factors:
    """The factors of one quantity, such as "mass".

    items   names of the bodies and links, or of the robot
    values  by which the scene's parameters are multiplied, shape [env, item]
    """

    items: tuple[str, ...]
    values: NDArray[np.float64]


def factors_of(configuration: RunConfiguration, attached: bytes | None) -> dict[str, Factors]:
    """The factors by quantity; empty where all environments have the scene's parameters.

    attached  of the name VARIED

    DamagedRecording where they are missing, or are not what the configuration asks for.
    """
    if not configuration.vary:
        return {}
    if attached is None:
        raise DamagedRecording(f"environments have other parameters ({configuration.vary}), and {VARIED} is not there")
    given, found = arrays.decode(VARIED, attached), {}
    for quantity, spread in configuration.varied.items():
        values, items = given.get(quantity), given.get(f"{quantity}/items")
        if values is None or items is None or values.dtype.kind != "f" or items.dtype.kind != "U" or items.ndim != 1:
            raise DamagedRecording(f"{VARIED} has no factors of {quantity}")
        if values.shape != (configuration.n_env, items.size):
            raise DamagedRecording(
                f"{VARIED} has factors of {quantity} of the shape {values.shape}, not of {configuration.n_env} "
                f"environments and {items.size} items"
            )
        if not (np.abs(values - 1.0) <= spread).all():
            raise DamagedRecording(f"{VARIED} has factors of {quantity} that are not within 1 +- {spread:g}")
        found[quantity] = Factors(tuple(map(str, items)), values)
    return found
