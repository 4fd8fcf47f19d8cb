"""MJX's limits on contacts (impl=jax), how large they must be, and what shows that they were large enough.

MJX gives every pair of shapes that may ever touch its contact slots at each step, unless the model carries two numbers:

    max_geom_pairs      in each collision function (a pair of shape types), only so many pairs go on to collision, those
                        with the nearest bounding spheres; functions of planes and height fields are not limited
    max_contact_points  of each contact dimension, only so many contacts go on to the solver, the deepest ones

What is beyond a limit is dropped in silence. Two counts at each step show that nothing was:

    CANDIDATE_PAIRS  more pairs have overlapping bounding spheres than the limit. Shapes can only touch where their
                     bounding spheres overlap, and overlapping ones are kept first: as long as the bit is not set,
                     every pair that could touch went on to collision.
    CONTACT_POINTS   every kept contact of a limited dimension is active (nearer than its margin; all margins are equal
                     here). Kept ones are the deepest: as long as one of them is inactive, every dropped one is too.

So no bit proves that nothing was dropped; a bit says that something may have been.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.simulators.buffer_sizes import Need, measure
from gpusimbench.recorder.simulators.evidence import CANDIDATE_PAIRS
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel
from gpusimbench.schemas.provenance import Buffer, Counter, OverflowBit

_TOUCHING_M = 1e-5

MAX_GEOM_PAIRS = "max_geom_pairs"
MAX_CONTACT_POINTS = "max_contact_points"

BITS = (OverflowBit(0, "CANDIDATE_PAIRS", fatal=True), OverflowBit(1, "CONTACT_POINTS", fatal=True))


@dataclass(frozen=True)
class PairGroup:
    """The pairs of one collision function.

    pairs    geom ids, shape [pair, 2]
    condim   contact dimension of all of them
    points   contacts that the function makes of a pair
    limited  whether max_geom_pairs applies to it
    """

    pairs: NDArray[np.int64]
    condim: int
    points: int
    limited: bool


def pair_groups(model: Any) -> tuple[PairGroup, ...]:
    """The collision functions that MJX runs for a mujoco.MjModel.

    NotImplementedError names the kinds of two shapes between which MJX has no collisions.
    """
    import mujoco
    from mujoco.mjx._src import collision_driver

    # MJX tells its grouping nowhere else; made anew here, it could come to differ unseen.
    groups = collision_driver._geom_groups(model)
    for key in groups:
        if key.types not in collision_driver._COLLISION_FUNC:
            a, b = (mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower() for kind in key.types)
            raise NotImplementedError(f"no collisions between {a} and {b}")
    return tuple(
        PairGroup(
            pairs=np.array(members, dtype=np.int64)[:, :2],
            condim=int(key.condim),
            points=int(collision_driver._COLLISION_FUNC[key.types].ncon),
            limited=not set(key.types) & collision_driver._GEOM_NO_BROADPHASE,
        )
        for key, members in groups.items()
    )


@dataclass(frozen=True)
class Caps:
    """The limits of one model.

    max_geom_pairs, max_contact_points  as the model carries them
    buffers                             as a recording describes them
    """

    max_geom_pairs: int
    max_contact_points: int
    buffers: tuple[Buffer, ...]

    @property
    def numerics(self) -> dict[str, str]:
        """As custom numbers of the model."""
        return {MAX_GEOM_PAIRS: str(self.max_geom_pairs), MAX_CONTACT_POINTS: str(self.max_contact_points)}


def choose(
    compiled: MjcfModel, *, dt: float, seed: int, max_geom_pairs: int, max_contact_points: int, varied: bool = False
) -> Caps:
    """Limits as given, 0 standing for what MuJoCo C is seen to need, with a margin (``buffer_sizes``)."""
    pairs_by, contacts_by = "asked for", "asked for"
    if not (max_geom_pairs and max_contact_points):
        need = measure(compiled, dt=dt, seed=seed, varied=varied)
        if not max_geom_pairs:
            candidates = _most_candidates(compiled, need, seed)
            max_geom_pairs, pairs_by = need.size(candidates), f"bounding spheres: {need.sized_by(candidates)}"
        if not max_contact_points:
            touching = _contacts_of_touching_shapes(compiled)
            most = max(touching, need.contacts)
            max_contact_points, contacts_by = need.size(most), need.sized_by(need.contacts)
            if touching > need.contacts:
                contacts_by = (
                    f"{touching} if every two shapes that start within {_TOUCHING_M:g} m of each other are in contact, "
                    f"times {need.margin:g}; {need.contacts} needed by MuJoCo C"
                )
    return Caps(
        max_geom_pairs,
        max_contact_points,
        (
            Buffer(MAX_GEOM_PAIRS, max_geom_pairs, "env", counter=CANDIDATE_PAIRS.name, sized_by=pairs_by),
            Buffer(MAX_CONTACT_POINTS, max_contact_points, "env", counter="contacts", sized_by=contacts_by),
        ),
    )


def _contacts_of_touching_shapes(compiled: MjcfModel) -> int:
    # Shapes that the scene sets side by side touch or not by the last bit of a float32, so one engine sees all of them
    # in contact where another sees none.
    inflated = copy.copy(compiled.model)
    inflated.geom_size[:] += np.where(inflated.geom_size > 0, _TOUCHING_M, 0.0)
    inflated.geom_rbound[:] += np.where(inflated.geom_rbound > 0, 2 * _TOUCHING_M, 0.0)
    inflated.geom_aabb[:, 3:] += _TOUCHING_M
    data = mujoco.MjData(inflated)
    data.qpos[:] = compiled.qpos0
    mujoco.mj_forward(inflated, data)
    touching = {frozenset(pair) for pair in data.contact.geom.tolist()}
    groups = pair_groups(compiled.model)
    return sum(g.points for g in groups for pair in g.pairs.tolist() if frozenset(pair) in touching)


def _most_candidates(compiled: MjcfModel, need: Need, seed: int) -> int:
    groups = [group for group in pair_groups(compiled.model) if group.limited]
    most = 0
    for data in compiled.rollout(n_step=need.steps, seed=seed, n_env=need.envs):
        for group in groups:
            overlaps = _gaps(data.geom_xpos, compiled.model.geom_rbound, group.pairs, np) < 0
            most = max(most, int(overlaps.sum()))
    return most


def _gaps(centres: Any, radii: NDArray[np.floating], pairs: NDArray[np.int64], numbers: Any) -> Any:
    """Distances between bounding spheres [m], [..., pair], negative where they overlap; centres [..., geom, 3], radii
    [..., geom].

    numbers  numpy or jax.numpy
    """
    apart = centres[..., pairs[:, 1], :] - centres[..., pairs[:, 0], :]
    reach = radii[..., pairs[:, 0]] + radii[..., pairs[:, 1]]
    return numbers.linalg.norm(apart, axis=-1) - reach.astype(np.float32)


def check_read(model: Any, caps: Caps) -> None:
    """Refused where MJX reads other limits from a mujoco.MjModel than those that were written into it.

    It would drop contacts, and no bit of the certificate would speak of it.
    """
    from mujoco.mjx._src import collision_driver

    for name, asked in caps.numerics.items():
        if (read := collision_driver._numeric(model, name)) != int(asked):
            raise Refused(f"MJX reads {name} = {read} from the model, which says {asked}")


class Certificate:
    """Counts on the device what the limits did to the last step.

    model  mujoco.MjModel with the limits in it
    radii  of the geoms' bounding spheres [m], [env, geom]; None: the model's
    """

    counter: Counter = CANDIDATE_PAIRS

    def __init__(self, model: Any, caps: Caps, radii: NDArray[np.floating] | None = None) -> None:
        groups = pair_groups(model)
        self._radii = model.geom_rbound if radii is None else radii
        self._limit = caps.max_geom_pairs
        self._groups = [group.pairs for group in groups if group.limited]
        slots: dict[int, int] = {}
        for group in groups:
            kept = min(len(group.pairs), caps.max_geom_pairs) if group.limited else len(group.pairs)
            slots[group.condim] = slots.get(group.condim, 0) + kept * group.points
        self._crowded = [condim for condim, count in slots.items() if count > caps.max_contact_points]

    def candidates(self, centres: Any) -> Any:
        """Pairs with overlapping bounding spheres in the fullest limited function, int32 [env]; centres of the geoms
        [env, geom, 3] as the step's collisions saw them."""
        import jax.numpy as jnp

        most = jnp.zeros(centres.shape[0], jnp.int32)
        for pairs in self._groups:
            overlaps = _gaps(centres, self._radii, pairs, jnp) < 0
            most = jnp.maximum(most, overlaps.sum(axis=-1, dtype=jnp.int32))
        return most

    def bits(self, candidates: Any, active: Any, dim: NDArray[np.integer]) -> Any:
        """Overflow bits, uint32 [env].

        candidates  as counted, [env]
        active      of the kept contacts, bool [env, slot]
        dim         their dimensions, [slot]
        """
        import jax.numpy as jnp

        bits = jnp.where(candidates > self._limit, jnp.uint32(1), jnp.uint32(0))
        for condim in self._crowded:
            full = active[:, dim == condim].all(axis=-1)
            bits |= jnp.where(full, jnp.uint32(2), jnp.uint32(0))
        return bits
