"""What an adapter said and did in one build of the conformance scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.conformance.frames import drift, local, rounding
from gpusimbench.recorder.conformance.verdict import NotApplicable
from gpusimbench.recorder.scenes.base import Body, Scene
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.evidence import Evidence


@dataclass(frozen=True)
class Trajectory:
    """States of all steps, and what was said on the way.

    described   state() after build: arrays [env, item, width] as the adapter gave them
    compiled    the same after compile
    states      one array [step, env, item, width] per field; row 0 is `compiled`
    kept        what the first call of states returned, looked at after the last
    blocks      steps that each call of states made
    evidence    what evidence() returned after each of these calls
    gates       that fired
    allocator   what allocator_bytes() returned at the end
    """

    scene: Scene
    n_env: int
    dt: float
    description: Description
    described: States
    compiled: States
    states: States
    kept: States
    blocks: tuple[int, ...]
    evidence: tuple[Evidence | None, ...]
    gates: tuple[str, ...]
    allocator: tuple[int, int] | None

    @property
    def time(self) -> NDArray[np.floating]:
        """Simulated time of each row [s], shape [step, 1, 1], to go with `of`."""
        rows = sum(self.blocks) + 1
        return (self.dt * np.arange(rows))[:, None, None]

    def body(self, name: str) -> Body:
        """The scene's body of that name."""
        return next(body for body in self.scene.moving() if body.name == name)

    def of(self, name: str, field: str) -> NDArray[np.floating]:
        """One field of one body, [step, env, component], in the scene's frame; NotApplicable where it is not recorded.

        Positions are relative to the env's origin.
        """
        for layout, array in zip(self.description.fields, self.states, strict=False):
            if layout.field == field and name in layout.items:
                item = layout.items.index(name)
                part = array[..., item : item + 1, :]
                return (local(self.description, layout, part) if field == "position" else part)[..., 0, :]
        raise NotApplicable(f"the adapter does not record {field} of {name}")

    @property
    def rounding(self) -> NDArray[np.float64]:
        """What the origin of each environment leaves of a position, to go with `of`: [env, 1] [m]; 0 at zero."""
        return rounding(self.description, self.n_env)[:, None]

    @property
    def drift(self) -> NDArray[np.float64]:
        """How far a body may go astray in all steps because positions are rounded, [env, 1] [m]."""
        return drift(self.description, self.n_env, sum(self.blocks))[:, None]

    def count(self, name: str) -> NDArray[np.integer]:
        """One counter at every step but the initial state, [step, env]; NotApplicable where it is not counted."""
        if name not in {counter.name for counter in self.description.counters}:
            raise NotApplicable(f"the adapter does not count {name}")
        rows = [e.counts[name] for e in self.evidence if e is not None and name in e.counts]
        if not rows:
            raise AssertionError(f"counter '{name}' is declared, and evidence() never had it")
        return np.concatenate(rows)
