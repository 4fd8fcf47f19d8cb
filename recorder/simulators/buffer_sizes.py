"""How large an engine's contact buffers must be, measured on MuJoCo C before the engine is built.

The same model is stepped there for as long as the protocol runs, and what it needs is counted; the engine gets that and
a margin. Whether it was enough is counted again by the engine itself, at every step: an overflow makes the run invalid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, compile_scene
from gpusimbench.recorder.simulators.mujoco.options import own_options

_PROTOCOL_STEPS = 1100  # warm-up and timed steps
_PILOT_ENVS = 16  # of a scene whose environments are given different actions
_MARGIN = 1.1  # over one trajectory that all environments repeat
_MARGIN_OF_SAMPLE = 2.0  # over a sample of trajectories, of which many more, or others, will be run
_ROUND = 32


@dataclass(frozen=True)
class Need:
    """What MuJoCo C needed at its fullest step, in one environment.

    contacts  contact points
    rows      scalar constraints
    pairs     pairs of shapes of different bodies whose bounding spheres overlap: what a broad phase may let through
    steps     that were counted
    envs      that were counted
    margin    by which buffers should be larger
    """

    contacts: int
    rows: int
    pairs: int
    steps: int
    envs: int
    margin: float

    @property
    def pool(self) -> int:
        """Entries of a buffer that holds first the pairs and then the contacts, as MuJoCo Warp's does."""
        return max(self.contacts, self.pairs)

    def size(self, needed: int) -> int:
        """The buffer for what was needed."""
        return max(_ROUND, -(-int(needed * self.margin) // _ROUND) * _ROUND)

    def sized_by(self, needed: int) -> str:
        """How the size came about."""
        what = f"{self.envs} envs of MuJoCo C" if self.envs > 1 else "MuJoCo C"
        return f"{needed} needed by {what} in {self.steps} steps, times {self.margin:g}, to a multiple of {_ROUND}"


def measure(compiled: MjcfModel, *, dt: float, seed: int, varied: bool = False) -> Need:
    """Count what the scene needs over the protocol's steps, or its sample time where that is longer.

    varied  environments will have other parameters than the scene; how many there are makes no difference here
    """
    steps = max(_PROTOCOL_STEPS, round(compiled.scene.sample_time / dt))
    drawn = compiled.scene.actions is not None
    envs = _PILOT_ENVS if drawn else 1
    overlapping = BoundingSpheres(compiled.model)
    contacts = rows = pairs = 0
    for data in compiled.rollout(n_step=steps, seed=seed, n_env=envs):
        contacts, rows = max(contacts, data.ncon), max(rows, data.nefc)
        pairs = max(pairs, overlapping.count(data.geom_xpos))
    return Need(contacts, rows, pairs, steps, envs, _MARGIN_OF_SAMPLE if drawn or varied else _MARGIN)


def measure_from_afar(scene: Scene, *, dt: float, seed: int, reach: float) -> Need:
    """The same of a scene whose shapes see each other from this distance on [m], as those of PhysX do."""
    compiled = compile_scene(scene, dt=dt, options=own_options(scene))
    compiled.model.geom_gap[:] = reach  # of each shape of a pair
    bounded = compiled.model.geom_rbound > 0  # planes are not
    compiled.model.geom_rbound[bounded] += reach
    return measure(compiled, dt=dt, seed=seed)


class BoundingSpheres:
    """Pairs of geoms of different bodies of a mujoco.MjModel that may collide; a plane overlaps with everything."""

    def __init__(self, model: object) -> None:
        body = np.asarray(model.geom_bodyid)  # type: ignore[attr-defined]
        radius = np.asarray(model.geom_rbound)  # type: ignore[attr-defined]
        kind, with_ = np.asarray(model.geom_contype), np.asarray(model.geom_conaffinity)  # type: ignore[attr-defined]
        one, other = np.triu_indices(len(body), k=1)
        apart = (body[one] != body[other]) & (((kind[one] & with_[other]) | (kind[other] & with_[one])) != 0)
        self._one, self._other = one[apart], other[apart]
        unbounded = (radius[self._one] == 0) | (radius[self._other] == 0)
        self._reach = np.where(unbounded, np.inf, radius[self._one] + radius[self._other])

    def count(self, centres: NDArray[np.float64]) -> int:
        """Overlapping pairs with the geoms' centres at [geom, 3]."""
        offset = centres[self._one] - centres[self._other]
        return int(np.count_nonzero(np.einsum("ij,ij->i", offset, offset) <= self._reach**2))
