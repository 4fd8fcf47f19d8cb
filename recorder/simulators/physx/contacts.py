"""Which shapes of a model PhysX must be told to keep apart, because MuJoCo does."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import mujoco

from gpusimbench.recorder.simulators.mujoco.model import collides
from gpusimbench.recorder.simulators.physx.trees import Plan


@dataclass(frozen=True)
class Apart:
    """What does not collide.

    bodies  by MuJoCo's body, others none of whose geoms may touch its own; each pair once
    geoms   by MuJoCo's geom, others that it may not touch, where other geoms of the two bodies may
    lost    pairs of bodies that collide in MuJoCo, and as neighbours in an articulation never in PhysX
    """

    bodies: dict[int, list[int]]
    geoms: dict[int, list[int]]
    lost: list[tuple[int, int]]


def apart(plan: Plan) -> Apart:
    """Compare what MuJoCo lets collide with what PhysX would by itself: everything but neighbours in an articulation,
    and what never moves."""
    model = plan.model
    places = plan.place_of()
    shapes: dict[int, list[int]] = defaultdict(list)
    for geom in range(model.ngeom):
        if collides(model, geom):
            shapes[int(model.geom_bodyid[geom])].append(geom)
    bodies: dict[int, list[int]] = defaultdict(list)
    geoms: dict[int, list[int]] = defaultdict(list)
    lost: list[tuple[int, int]] = []
    for a in sorted(shapes):
        for b in sorted(shapes):
            if a >= b or (a not in places and b not in places):
                continue
            never = [(g, h) for g in shapes[a] for h in shapes[b] if not may_touch(model, g, h)]
            every = len(never) == len(shapes[a]) * len(shapes[b])
            if _neighbours(plan, a, b):
                lost += [] if every else [(a, b)]
            elif every and a in places and b in places:
                bodies[a].append(b)
            else:
                for g, h in never:  # kept by one that moves: what is fixed may serve all environments
                    one, other = (g, h) if a in places else (h, g)
                    geoms[one].append(other)
    return Apart(bodies, geoms, lost)


def _neighbours(plan: Plan, a: int, b: int) -> bool:
    # links that hang on each other
    for tree in plan.trees:
        for link in tree.links:
            if link.parent >= 0 and {link.body, tree.links[link.parent].body} == {a, b}:
                return True
    return False


def may_touch(model: Any, a: int, b: int) -> bool:
    """Whether two geoms of different bodies collide in MuJoCo (engine_collision_driver.c, mj_collision)."""
    kind, with_ = model.geom_contype, model.geom_conaffinity
    if not (kind[a] & with_[b] or kind[b] & with_[a]):
        return False
    one, other = (int(model.geom_bodyid[g]) for g in (a, b))
    weld, parent = model.body_weldid, model.body_parentid
    if weld[one] == weld[other]:
        return False
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    if (one, other) in excluded or (other, one) in excluded:
        return False
    filtered = not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    up, up_other = (int(weld[parent[weld[body]]]) for body in (one, other))
    return not (filtered and weld[one] and weld[other] and (weld[one] == up_other or weld[other] == up))


def friction_of(model: Any, g: int, h: int) -> float:
    """Coefficient of a pair against sliding in MuJoCo; 0 for contacts without friction."""
    first, second = (int(model.geom_priority[x]) for x in (g, h))
    meant = [x for x, priority in ((g, first), (h, second)) if priority == max(first, second)]
    if max(int(model.geom_condim[x]) for x in meant) == 1:
        return 0.0
    return max(float(model.geom_friction[x, 0]) for x in meant)


def frictions(model: Any) -> list[float]:
    """By geom, the coefficient that PhysX is given: MuJoCo's, or none where all contacts of the geom have none."""
    shapes = [g for g in range(model.ngeom) if collides(model, g)]
    found = [float(friction) for friction in model.geom_friction[:, 0]]
    for g in shapes:
        others = [h for h in shapes if model.geom_bodyid[h] != model.geom_bodyid[g] and may_touch(model, g, h)]
        if others and not any(friction_of(model, g, h) for h in others):
            found[g] = 0.0
    return found
