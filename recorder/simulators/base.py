"""The contract of a simulator adapter. This page is all that an engine must provide.

An adapter holds N identical environments of one scene. The recorder calls, in this order: the constructor, ``build``
once, then ``prepare``, ``step`` or ``states`` and ``gates`` any number of times, ``close``. A capture that needs a
fresh start gets a new instance, so nothing has to be reset.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from recorder.scenes.base import Scene
from schemas.fields import StateField
from schemas.provenance import Deviation

States = tuple[NDArray[np.floating], ...]
"""One array per state field, in the order of Description.fields."""


@dataclass(frozen=True)
class Description:
    """What a built simulator says of itself; all of it goes into the recording.

    version        of the engine
    device         "cpu", or the name of the GPU that steps
    options        every option in force, defaults included
    switches       whatever decides which numbers come out: determinism modes, implementations, precision
    deviations     parameters of the scene that the engine could not honour
    fields         layout of the state
    timing_covers  what lies between two clock readings around ``step``
    attachments    files worth keeping, such as the model that was loaded: name -> (media type, bytes)
    env_origins    origin of each environment in the engine's world frame [m]; empty when all are at zero
    """

    version: str
    device: str
    options: dict[str, Any]
    switches: dict[str, Any]
    deviations: tuple[Deviation, ...]
    fields: tuple[StateField, ...]
    timing_covers: str
    attachments: dict[str, tuple[str, bytes]] = field(default_factory=dict)
    env_origins: tuple[tuple[float, float, float], ...] = ()


class Simulator(ABC):
    """N identical environments of one scene on one engine.

    Options          frozen dataclass of the engine's own options; every field has a default
    timing_interval  steps between two clock readings of the timed phase; 1 unless reading the clock would cost
    """

    Options: ClassVar[type]
    timing_interval: ClassVar[int] = 1

    def __init__(self, scene: Scene, *, n_env: int, dt: float, seed: int, options: Any) -> None:
        """Keep the arguments; touch no device yet.

        n_env    number of environments
        dt       step [s]
        seed     of whatever the engine draws at random
        options  an instance of Options
        """
        self.scene = scene
        self.n_env = n_env
        self.dt = dt
        self.seed = seed
        self.options = options

    @abstractmethod
    def build(self) -> Description:
        """Load the scene into the engine, in its initial state, ready to step.

        Raises UsageError where the engine cannot simulate this scene or was given an option it does not have.
        """

    def prepare(self, actions: NDArray[np.float32] | None) -> None:  # noqa: B027 - most scenes have no actions
        """Take the actions of the next steps, shape [step, env, action]; None where the scene has none.

        Outside the timed region: an adapter moves them to its device here. The steps that follow use them in order,
        one row a step; row i is held during step i.
        """

    @abstractmethod
    def step(self, n_step: int) -> None:
        """Advance all environments by n_step steps; return when the device is done, with nothing copied to the host."""

    @abstractmethod
    def state(self) -> States:
        """The present state: one array [env, item, width] per field, exactly the numbers that the engine holds."""

    def states(self, n_step: int) -> States:
        """Advance by n_step steps and return the state after each: arrays [step, env, item, width].

        Engines that can snapshot on the device override this loop.
        """
        rows = []
        for _ in range(n_step):
            self.step(1)
            rows.append(tuple(array.copy() for array in self.state()))
        return tuple(np.stack(column) for column in zip(*rows, strict=True))

    def gates(self) -> list[str]:
        """Validity gates that fired since the last call, one sentence each: dropped contacts, solver failures, resets.

        Non-finite states need no mention; the recorder looks for them itself.
        """
        return []

    def close(self) -> None:  # noqa: B027 - an engine without resources of its own has nothing to do here
        """Release the device. Called once, also after an error."""
