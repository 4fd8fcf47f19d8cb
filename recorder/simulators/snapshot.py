"""What an adapter can do with the state of an engine: save it, restore it, reset it, set it.

A trajectory depends on more than positions and velocities: on warm starts of the solver, caches of contacts, counters
and random numbers. So an adapter claims for each operation how much of that it covers, and the conformance suite holds
the claims.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

Envs = NDArray[np.int64] | None
"""Indices of environments, each at most once; None for all of them."""


def rows_of(envs: Envs) -> slice | NDArray[np.int64]:
    """What picks these environments along an array's first axis."""
    return slice(None) if envs is None else envs


def picked(arrays: Mapping[str, NDArray[Any]], envs: Envs) -> dict[str, NDArray[Any]]:
    """The rows of these environments of arrays whose first axis is the environment."""
    return {name: array[rows_of(envs)] for name, array in arrays.items()}


class Extent(Enum):
    """How much of an operation an adapter covers."""

    COMPLETE = "complete"
    PARTIAL = "partial"
    NONE = "none"


@dataclass(frozen=True)
class Claim:
    """What an adapter says of one operation.

    extent  complete: the steps that follow have the same bits, wherever the engine repeats itself
    why     what is missing, or why there is none; empty where complete
    """

    extent: Extent
    why: str = ""

    def __str__(self) -> str:
        return f"{self.extent.value}: {self.why}" if self.why else self.extent.value


COMPLETE = Claim(Extent.COMPLETE)

UNKNOWN = Claim(Extent.NONE, "the adapter does not offer it")


def partial(missing: str) -> Claim:
    """Covered but for what is missing, a noun phrase."""
    return Claim(Extent.PARTIAL, missing)


def absent(why: str) -> Claim:
    """Not there, and why."""
    return Claim(Extent.NONE, why)


@dataclass(frozen=True)
class StateClaims:
    """What an adapter says of the operations on state (``Simulator.snapshot`` to ``Simulator.set_state``).

    snapshot   save all environments, and restore all of them
    some       restore some environments while the others stay as they are
    reset      bring some environments back to the first state while the others stay as they are
    set_state  give some environments positions and velocities; also before the first step, where it makes the initial
               state of each environment
    """

    snapshot: Claim = UNKNOWN
    some: Claim = UNKNOWN
    reset: Claim = UNKNOWN
    set_state: Claim = UNKNOWN


@dataclass(frozen=True)
class Snapshot:
    """The state of all environments between two steps.

    step    steps made since the build; the next action is that of this step
    arrays  whatever decides the next step, by the engine's own names; the first axis is the environment
    """

    step: int
    arrays: dict[str, NDArray[np.generic]]
