"""A model file on Genesis: MuJoCo's compile of it, read by Genesis' own importer, and MuJoCo's places in the result.

`genesis.morphs.MJCF` compiles a file with MuJoCo and reads the mujoco.MjModel. Here it is given that model at once:
written as XML, a model would lose digits, and a file would get other defaults of solref than MuJoCo's.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtDisableBit, mjtEq, mjtGeom, mjtJoint
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.genesis.controls import Controls
from gpusimbench.recorder.simulators.genesis.environments import (
    Drive,
    Environments,
    GenesisSizes,
    empty_scene,
    on_device,
)
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, collides, compile_scene
from gpusimbench.recorder.simulators.mujoco.options import own_options
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.text import few

GEOMS = (
    mjtGeom.mjGEOM_PLANE, mjtGeom.mjGEOM_SPHERE, mjtGeom.mjGEOM_ELLIPSOID, mjtGeom.mjGEOM_CYLINDER,
    mjtGeom.mjGEOM_CAPSULE, mjtGeom.mjGEOM_BOX, mjtGeom.mjGEOM_MESH,
)  # fmt: skip
"""MuJoCo's kinds of shapes in the order of genesis.GEOM_TYPE."""

EQUALITIES = (mjtEq.mjEQ_CONNECT, mjtEq.mjEQ_WELD, mjtEq.mjEQ_JOINT)
"""MuJoCo's kinds of constraints of equality in the order of genesis.EQUALITY_TYPE."""

_TURNING, _ROLLING = 4, 6  # the least condim of a geom with friction against it
_SHOWN = 3  # what is named of what is refused


@dataclass(frozen=True)
class Match:
    """Where MuJoCo's things are in Genesis' rigid solver.

    links   by body, index of the link; -1 for a world that Genesis leaves out
    joints  by joint, index of the joint
    geoms   by Genesis' geom, number of MuJoCo's

    Positions and velocities are where MuJoCo has them.
    """

    links: NDArray[np.int64]
    joints: NDArray[np.int64]
    geoms: NDArray[np.int64]


class ModelEnvironments(Environments):
    """N environments of a model file.

    compiled  by MuJoCo
    match     where its things are
    """

    def __init__(self, made: Any, compiled: MjcfModel, match: Match, controls: Controls) -> None:
        """Environments that were built, in the scene's first state; made is a genesis.Scene."""
        super().__init__(made)
        self.compiled, self.match, self._controls = compiled, match, controls
        controls.prepare(self.solver)
        self.place()

    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """See Environments.fields: MuJoCo's, whose coordinates Genesis has."""
        return tuple(replace(f, note=f.note.replace("MuJoCo", "Genesis")) for f in self.compiled.fields(dtype))

    def parts(self) -> Mapping[str, tuple[int, ...]]:
        """See Environments.parts."""
        n_env, model = int(self.scene.n_envs), self.compiled.model
        return {"qpos": (n_env, int(model.nq)), "qvel": (n_env, int(model.nv))}

    def store(self, parts: Mapping[str, Any]) -> None:
        """See Environments.store."""
        parts["qpos"].copy_(self.solver.get_qpos())
        parts["qvel"].copy_(self.solver.get_dofs_velocity())

    def split(self, parts: Mapping[str, NDArray[np.floating]]) -> States:
        """See Environments.split."""
        states: States = self.compiled.split(parts["qpos"], parts["qvel"])
        return states

    def place(self, envs: Envs = None) -> None:
        """See Environments.place: the keyframe, and controls of zero."""
        n_env = self.scene.n_envs if envs is None else len(envs)
        self._put(np.tile(self.compiled.qpos0, (n_env, 1)), np.tile(self.compiled.qvel0, (n_env, 1)), envs)
        self.hold(np.zeros((n_env, self.compiled.model.nu)), envs)

    def give(self, states: States, envs: Envs) -> None:
        """See Environments.give."""
        self._put(*self.compiled.joined(states), envs)

    def _put(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64], envs: Envs) -> None:
        self.solver.set_qpos(on_device(qpos), envs_idx=envs)
        self.solver.set_dofs_velocity(on_device(qvel), envs_idx=envs)

    def drives(self, actions: NDArray[np.floating]) -> Sequence[Drive]:
        """See Environments.drives."""
        return self._controls.drives(self.solver, actions)

    def hold(self, controls: NDArray[np.float64], envs: Envs = None) -> None:
        """Hold these controls, [env of envs, actuator]."""
        for drive in self.drives(controls[np.newaxis]):
            drive.give(0, envs)

    def attachments(self) -> dict[str, tuple[str, bytes]]:
        """See Environments.attachments."""
        return self.compiled.attachments

    def link_poses(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """See Simulator.link_poses, of MuJoCo's bodies; a world that Genesis leaves out is where it is."""
        positions, orientations = (
            get().cpu().numpy() for get in (self.solver.get_links_pos, self.solver.get_links_quat)
        )
        place = np.where((self.match.links >= 0)[:, np.newaxis], positions[:, self.match.links], 0)
        still = np.array([1, 0, 0, 0], dtype=orientations.dtype)
        turn = np.where((self.match.links >= 0)[:, np.newaxis], orientations[:, self.match.links], still)
        return place, turn


def compile_model(scene: ModelScene, *, dt: float) -> MjcfModel:
    """A model file as MuJoCo compiles it, with its own options. Refused where it has what Genesis is not given, such as
    an actuator."""
    compiled = compile_scene(scene, dt=dt, options=own_options(scene))
    _refuse(compiled.model, scene.file)
    Controls(compiled.model)
    return compiled


def build_model(
    genesis: Any, compiled: MjcfModel, *, n_env: int, dt: float, options: GenesisOptions, sizes: GenesisSizes
) -> ModelEnvironments:
    """Build n_env environments of a compiled model in its initial state on the initialised engine.

    genesis.GenesisException for what it does not accept; Refused where it makes other bodies or joints of it than
    MuJoCo.
    """
    model = compiled.model
    off = int(model.opt.disableflags)
    condim = max((int(model.geom_condim[g]) for g in range(model.ngeom) if collides(model, g)), default=0)
    x, y, z = (0.0, 0.0, 0.0) if off & int(mjtDisableBit.mjDSBL_GRAVITY) else map(float, model.opt.gravity)
    made = empty_scene(
        genesis, (x, y, z), dt, options, sizes,
        enable_torsional_friction=condim >= _TURNING,
        enable_rolling_friction=condim >= _ROLLING,
    )  # fmt: skip
    # a copy: the importer writes into the model
    morph = _morph(genesis, copy.copy(model))
    made.add_entity(morph, material=genesis.materials.Rigid())
    made.build(n_envs=n_env)
    return ModelEnvironments(made, compiled, _matched(made.rigid_solver, model), Controls(model))


def _morph(genesis: Any, model: Any) -> Any:
    class Compiled(genesis.morphs.MJCF):  # type: ignore[misc]
        """A morph of a mujoco.MjModel: Genesis' importer takes it, its check of a file's name does not."""

        def is_format(self, format: str) -> bool:
            return bool(format == ".xml")

        def _identifier(self) -> str:
            return "model"

    return Compiled(
        file=model,
        default_armature=None,  # as the model has it
        align=False,  # frames of bodies stay where they are
        visualization=False,
        decimate=False,
        decompose_object_error_threshold=float("inf"),  # meshes are convex hulls, as MuJoCo's are
    )


def _matched(solver: Any, model: Any) -> Match:
    """By name, in MuJoCo's order, which Genesis keeps: depth first."""
    left_out = model.nbody - len(solver.links)
    if left_out not in (0, 1):
        raise Refused(f"Genesis makes {len(solver.links)} links of the model's {model.nbody} bodies")
    links = np.full(model.nbody, -1, dtype=np.int64)
    joints = np.full(model.njnt, -1, dtype=np.int64)
    for body in range(left_out, model.nbody):
        link = solver.links[body - left_out]
        own = [j for j in range(model.njnt) if model.jnt_bodyid[j] == body]
        if link.name != model.body(body).name:
            raise Refused(f"Genesis has link '{link.name}' where the model has body '{model.body(body).name}'")
        parent = int(model.body_parentid[body]) - left_out
        if link.parent_idx not in ({parent, -1} if parent <= 0 else {parent}):
            raise Refused(f"Genesis hangs link '{link.name}' on another than the model does")
        made = [joint for joint in link.joints if joint.n_dofs]
        if len(made) != len(own):
            raise Refused(f"Genesis makes {len(made)} joints of the {len(own)} of body '{link.name}'")
        links[body] = link.idx
        for j, joint in zip(own, made, strict=True):
            joints[j] = joint.idx
            if (joint.q_start, joint.dof_start) != (model.jnt_qposadr[j], model.jnt_dofadr[j]):
                raise Refused(f"Genesis has the numbers of joint '{joint.name}' in another place than MuJoCo")
    return Match(links, joints, _geoms(solver, model, links))


def _geoms(solver: Any, model: Any, links: NDArray[np.int64]) -> NDArray[np.int64]:
    """In the order of each link. Genesis has names of shapes, but shapes that are alike share one."""
    shapes = [g for g in range(model.ngeom) if collides(model, g)]
    found: list[int] = []
    for geom in solver.geoms:
        own = [g for g in shapes if links[model.geom_bodyid[g]] == geom.link.idx and g not in found]
        if not own or int(GEOMS[int(geom.type)]) != model.geom_type[own[0]]:
            raise Refused(f"Genesis makes other shapes of link '{geom.link.name}' than the model's")
        found.append(own[0])
    if len(found) < len(shapes):
        lost = next(g for g in shapes if g not in found)
        raise Refused(f"Genesis makes nothing of geom '{model.geom(lost).name or f'geom{lost}'}', which collides")
    return np.array(found, dtype=np.int64)


def _refuse(model: Any, file: str) -> None:
    """Name what Genesis is not given here, and what would otherwise be missing without a word."""
    said: list[str] = []
    for g in range(model.ngeom):
        if collides(model, g) and model.geom_type[g] not in [int(shape) for shape in GEOMS]:
            word = mjtGeom(int(model.geom_type[g])).name.removeprefix("mjGEOM_").lower()
            said.append(f"{word} '{model.geom(g).name or f'geom{g}'}', which collides")
    for e in range(model.neq):
        name = model.equality(e).name or f"equality{e}"
        if model.eq_type[e] not in [int(kind) for kind in EQUALITIES]:
            word = mjtEq(int(model.eq_type[e])).name.removeprefix("mjEQ_").lower()
            said.append(f"constraint of equality '{name}', {word}")
        elif not model.eq_active0[e]:
            said.append(f"constraint of equality '{name}', which is off")
        elif not all(_objects(model, e)):
            said.append(f"constraint of equality '{name}', of things without names")
    for t in range(model.ntendon):
        words = ("stiffness", "damping", "frictionloss", "limited", "armature")
        if has := [word for word in words if np.any(getattr(model, f"tendon_{word}")[t])]:
            said.append(f"tendon '{model.tendon(t).name or f'tendon{t}'}', which has {', '.join(has)}")
    for j in range(model.njnt):
        if model.jnt_type[j] in (int(mjtJoint.mjJNT_BALL), int(mjtJoint.mjJNT_FREE)) and np.any(model.jnt_stiffness[j]):
            said.append(f"stiffness of joint '{model.joint(j).name or f'joint{j}'}', a ball or free joint")
    said += [f"contact pair {p}, with parameters of its own" for p in range(model.npair)]
    if model.nflex:
        said.append("flexible bodies")
    if said:
        raise Refused(f"Genesis is not given the {few(said, _SHOWN)} of {file}; MuJoCo's engines are")


def _objects(model: Any, equality: int) -> list[str]:
    """Names of what a constraint ties; the world is not named by it."""
    numbers = [int(getattr(model, f"eq_obj{k}id")[equality]) for k in (1, 2)]
    if model.eq_type[equality] == int(mjtEq.mjEQ_JOINT):
        return [model.joint(n).name for n in numbers if n >= 0]
    if model.eq_objtype[equality] == int(mujoco.mjtObj.mjOBJ_SITE):
        numbers = [int(model.site_bodyid[n]) for n in numbers]
    return [model.body(n).name for n in numbers]
