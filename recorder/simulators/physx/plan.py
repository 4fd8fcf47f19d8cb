"""What PhysX is given of a compiled model file: an articulation for each tree of MuJoCo's bodies that moves, and which
shapes it must be told to keep apart, because MuJoCo does.

An articulation has one joint between two links, and a link has one parent. A body with several joints therefore hangs
on a chain of links, all but the last of which are added here and nearly massless; a tree whose root is not free begins
with a link that is fixed to the world.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.emit.usd_prim import identifiers
from gpusimbench.recorder.simulators.mujoco.model import collides

ADDED_SHARE = 1e-5
"""Mass and inertia of a link that is added between the joints of a body, as a share of the body's."""

_SHAPES = {f"mjGEOM_{word}" for word in ("PLANE", "SPHERE", "CAPSULE", "BOX", "CYLINDER", "MESH")}
_WORLD = 0  # number of MuJoCo's body


@dataclass(frozen=True)
class Link:
    """A rigid body of PhysX.

    prim    name
    frame   MuJoCo's body whose frame the link has in the reference state
    body    MuJoCo's body that the link is; -1 for one that is added
    parent  number of a link of the same tree; -1 for the first
    joint   MuJoCo's joint to the parent; -1 for a weld, or none
    within  whether the parent has the same frame
    """

    prim: str
    frame: int
    body: int
    parent: int
    joint: int = -1
    within: bool = False


@dataclass(frozen=True)
class Tree:
    """An articulation.

    prim   name of the prim that holds links and joints
    free   MuJoCo's joint by which the first link moves freely; -1: the first link is fixed to the world
    links  parents first
    """

    prim: str
    free: int
    links: tuple[Link, ...]

    def is_a_body(self) -> bool:
        """Whether it is a free body, to which nothing is joined."""
        return len(self.links) == 1

    def joints(self) -> tuple[int, ...]:
        """MuJoCo's hinges and slides, in the order of the links."""
        return tuple(link.joint for link in self.links if link.joint >= 0)


@dataclass(frozen=True)
class Plan:
    """What PhysX is given of a mujoco.MjModel.

    model         itself
    trees         in the order of MuJoCo's bodies
    joint_prims   by MuJoCo's joint, the name of its prim
    fixed_geoms   MuJoCo's geoms that collide and never move
    fixed_prims   by such a geom, the name of its prim
    """

    model: Any
    trees: tuple[Tree, ...]
    joint_prims: dict[int, str]
    fixed_prims: dict[int, str]

    def place_of(self) -> dict[int, tuple[Tree, Link]]:
        """By MuJoCo's body, where it is among the links; without bodies that never move."""
        return {link.body: (tree, link) for tree in self.trees for link in tree.links if link.body >= 0}


def plan(model: Any, file: str) -> Plan:
    """Which links and joints a mujoco.MjModel becomes. Refused where it has something that PhysX is not given here."""
    _refuse(model, file)
    roots = [
        b for b in range(1, model.nbody) if model.body_weldid[b] and not _moves(model, int(model.body_parentid[b]))
    ]
    labels = [model.body(b).name or f"body{b}" for b in range(model.nbody)]
    words = list(identifiers([f"{label} {b}" for b, label in enumerate(labels)]).values())  # numbers keep them apart
    trees = tuple(_tree(model, root, words) for root in roots)
    named = [f"{model.joint(j).name or 'joint'} {j} joint" for j in range(model.njnt)]
    still = [
        g for g in range(model.ngeom)
        if collides(model, g) and not _moves(model, int(model.geom_bodyid[g]))
    ]  # fmt: skip
    prims = identifiers([f"{model.geom(g).name or 'geom'} {g} fixed" for g in still])
    return Plan(
        model, trees, dict(enumerate(identifiers(named).values())), dict(zip(still, prims.values(), strict=True))
    )


def _tree(model: Any, root: int, words: list[str]) -> Tree:
    free = -1
    links: list[Link] = []
    at: dict[int, int] = {}
    if model.body_jntnum[root] and model.jnt_type[model.body_jntadr[root]] == mujoco.mjtJoint.mjJNT_FREE:
        free = int(model.body_jntadr[root])
        links.append(Link(words[root], root, root, -1))
    else:
        links.append(Link(f"{words[root]}_base", int(model.body_parentid[root]), -1, -1))
        links += _hung(model, root, 0, len(links), words[root])
    at[root] = len(links) - 1
    for body in range(root + 1, model.nbody):
        parent = int(model.body_parentid[body])
        if parent in at:
            links += _hung(model, body, at[parent], len(links), words[body])
            at[body] = len(links) - 1
    return Tree(f"{words[root]}_tree", free, tuple(links))


def _hung(model: Any, body: int, parent: int, count: int, word: str) -> Iterator[Link]:
    """The links of a body: one for each joint, the last of which is the body."""
    first, number = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if not number:
        yield Link(word, body, body, parent)
    for k in range(number):
        last = k == number - 1
        name = word if last else f"{word}_{k}"
        yield Link(name, body, body if last else -1, parent if k == 0 else count + k - 1, first + k, within=k > 0)


def _moves(model: Any, body: int) -> bool:
    return bool(model.body_weldid[body] != _WORLD)


def _refuse(model: Any, file: str) -> None:
    """Name what PhysX and Isaac Lab's backends are not given here, and what would otherwise be missing."""
    kinds = mujoco.mjtGeom
    said: list[str] = []
    balls = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_BALL]
    said += [f"ball joint '{model.joint(j).name or f'joint{j}'}'" for j in balls]
    for g in range(model.ngeom):
        if not collides(model, g):
            continue
        kind, name = kinds(int(model.geom_type[g])), model.geom(g).name or f"geom{g}"
        if kind.name not in _SHAPES:
            said.append(f"{kind.name.removeprefix('mjGEOM_').lower()} '{name}', which collides")
        elif kind == kinds.mjGEOM_PLANE and _moves(model, int(model.geom_bodyid[g])):
            said.append(f"plane '{name}', which moves")
    said += [
        f"constraint of equality '{model.equality(e).name or f'equality{e}'}'"
        for e in range(model.neq) if model.eq_active0[e]
    ]  # fmt: skip
    for t in range(model.ntendon):
        words = ("stiffness", "damping", "frictionloss", "limited", "armature")
        if has := [word for word in words if np.any(getattr(model, f"tendon_{word}")[t])]:
            said.append(f"tendon '{model.tendon(t).name or f'tendon{t}'}', which has {', '.join(has)}")
    said += [f"contact pair {p}, with parameters of its own" for p in range(model.npair)]
    flexes = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, f) or f"flex{f}" for f in range(model.nflex)]
    said += [f"flexible body '{name}'" for name in flexes]
    said += [
        f"gravity compensation of joint '{model.joint(j).name or f'joint{j}'}' within its actuatorfrcrange"
        for j in np.flatnonzero(model.jnt_actgravcomp & model.jnt_actfrclimited)
    ]
    if said:
        more = f", and {len(said) - 3} more" if len(said) > 3 else ""
        what = f"the {', '.join(said[:3])}{more} of {file}"
        raise Refused(f"PhysX and Isaac Lab are not given {what}; MuJoCo's engines and the simulator newton are")


def joint_frame(model: Any, joint: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origin and orientation wxyz, in the body's frame, of a hinge or slide whose axis is the frame's z."""
    origin = model.jnt_pos[joint] if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE else np.zeros(3)
    turn = np.zeros(4)
    mujoco.mju_quatZ2Vec(turn, model.jnt_axis[joint])
    return np.array(origin), turn


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
