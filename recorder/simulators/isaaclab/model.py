"""A model file under Isaac Lab: the stage that PhysX is given of it, spawned, cloned and taken as assets; and its
articulations.

Positions [env, nq] and velocities [env, nv] are at MuJoCo's places, in PhysX's own terms, as in
recorder.simulators.physx.articulations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.emit.usd import MATERIALS, env_path
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.isaaclab.options import IsaacLabOptions
from gpusimbench.recorder.simulators.isaaclab.physx import Physx
from gpusimbench.recorder.simulators.isaaclab.world import World
from gpusimbench.recorder.simulators.physx.articulations import first_state, layout_of, reference_poses
from gpusimbench.recorder.simulators.physx.model import Model
from gpusimbench.recorder.simulators.physx.options import NO_THRESHOLD, PhysxOptions, apis
from gpusimbench.recorder.simulators.physx.plan import Plan, Tree
from gpusimbench.recorder.simulators.physx.servos import TARGETS
from gpusimbench.recorder.simulators.physx.stage import SHARED
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.fields import StateField

_ROOT = "{ENV_REGEX_NS}/model"
_SETTINGS = (
    "spacing", "position_iterations", "velocity_iterations", "external_forces_every_iteration", "contact_offset",
    "rest_offset", "friction_combine", "restitution_combine",
)  # fmt: skip


def as_physx(options: IsaacLabOptions) -> PhysxOptions:
    """The same settings in the words of PhysX's adapter, which writes the stage and names what PhysX has otherwise."""
    given = {name: getattr(options, name) for name in _SETTINGS}
    return PhysxOptions(**given, bounce_threshold=max(options.bounce_threshold, NO_THRESHOLD))


def scene_cfg(model: Model, *, n_env: int, options: IsaacLabOptions, gpu: bool) -> tuple[Any, dict[str, Tree]]:
    """The InteractiveSceneCfg of a model file, and by their names in it what moves: its articulations, and free bodies
    without joints, which are rigid objects. Refused where such a body has others welded to it."""
    from isaaclab.actuators import ImplicitActuatorCfg
    from isaaclab.assets import ArticulationCfg, AssetBaseCfg, RigidObjectCfg
    from isaaclab.scene import InteractiveSceneCfg
    from isaaclab.sim.spawners import SpawnerCfg

    newton = options.backend == "newton"  # whose importer would take PhysX's offsets for the file's
    settings = {} if newton else apis(as_physx(options), gpu=gpu, enhanced=False, capacities={})
    text = model.usd(settings, spacing=options.spacing, isaac_lab=True)
    cfg = InteractiveSceneCfg(num_envs=n_env, env_spacing=options.spacing)
    parts = {"materials": (MATERIALS, MATERIALS), "shared": (SHARED, SHARED), "model": (env_path(0), _ROOT)}
    if newton:  # all is within each environment
        del parts["materials"], parts["shared"]
    for name, (source, target) in parts.items():
        asset = AssetBaseCfg(
            prim_path=target,
            spawn=SpawnerCfg(func=_copying(text, source)),
            collision_group=-1 if name == "shared" else 0,
        )
        setattr(cfg, name, asset)
    trees = {f"tree_{number}": tree for number, tree in enumerate(model.plan.trees)}
    for name, tree in trees.items():
        if tree.is_a_body():
            setattr(cfg, name, RigidObjectCfg(prim_path=f"{_ROOT}/{tree.prim}/{tree.links[0].prim}", spawn=None))
            continue
        if not tree.joints():
            number = next(link.body for link in tree.links if link.body >= 0)  # behind its base, if it has one
            body = model.compiled.model.body(number).name or f"body{number}"
            raise Refused(f"Isaac Lab has no articulation without joints, such as that of body '{body}' and its parts")
        articulation = ArticulationCfg(
            prim_path=f"{_ROOT}/{tree.prim}",
            spawn=None,
            init_state=ArticulationCfg.InitialStateCfg(joint_pos=_within_limits(model.plan, tree.joints())),
            actuators={"drives": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=None, damping=None)},
        )
        setattr(cfg, name, articulation)
    return cfg, trees


def _within_limits(plan: Plan, joints: Sequence[int]) -> dict[str, float]:
    """By name of the prim, a position within the joint's limits: Isaac Lab refuses to begin elsewhere, as some models
    do; the recorder writes the model's own first state afterwards."""
    model = plan.model
    return {
        plan.joint_prims[j]: float(np.mean(model.jnt_range[j]) - model.qpos0[model.jnt_qposadr[j]])
        if model.jnt_limited[j]
        else 0.0
        for j in joints
    }


def _copying(text: str, source: str) -> Callable[..., Any]:
    """A spawner that copies a prim of a stage's text; paths below this prim are moved with it."""

    def spawn(prim_path: str, cfg: Any, translation: Any = None, orientation: Any = None, **kwargs: Any) -> Any:
        from isaaclab.sim.utils.stage import get_current_stage
        from pxr import Sdf

        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.ImportFromString(text)
        stage = get_current_stage()
        Sdf.CreatePrimInLayer(stage.GetRootLayer(), prim_path)
        Sdf.CopySpec(layer, source, stage.GetRootLayer(), prim_path)
        return stage.GetPrimAtPath(prim_path)

    return spawn


_COMMANDS = dict(zip(TARGETS, ("set_position_index", "set_velocity_index", "set_effort_index"), strict=True))
"""By name of PhysX's tensor, of Isaac Lab's command of an articulation's actuators."""


class ModelWorld(World):
    """All environments of a model file."""

    def __init__(
        self, model: Model, physics: Physx, *, n_env: int, dt: float, options: IsaacLabOptions, device: str
    ) -> None:
        self._model, self._n_env = model, n_env
        self._layout = layout_of(model.compiled)
        self._given: list[list[tuple[Any, str, Any]]] = []  # for each step to come, last first
        described, self._trees = scene_cfg(model, n_env=n_env, options=options, gpu=device != "cpu")
        super().__init__(described, physics, gravity=model.gravity, dt=dt, device=device)
        model.attach(self)

    def _begin(self, environments: Any) -> None:
        import torch

        compiled, plan = self._model.compiled.model, self._model.plan
        self._assets = [(environments[name], tree) for name, tree in self._trees.items()]
        self._joints: list[list[int]] = []  # MuJoCo's, in the order of each asset
        at_q: list[int] = []
        at_qd: list[int] = []
        for asset, tree in self._assets:
            numbers = {plan.joint_prims[joint]: joint for joint in tree.joints()}
            names = asset.joint_names if numbers else []
            if sorted(names) != sorted(numbers):
                raise GsbError(f"Isaac Lab has the joints {', '.join(names)} in {tree.prim}")
            joints = [numbers[name] for name in names]
            self._joints.append(joints)
            if tree.free >= 0:
                at_q += range(compiled.jnt_qposadr[tree.free], compiled.jnt_qposadr[tree.free] + 7)
                at_qd += range(compiled.jnt_dofadr[tree.free], compiled.jnt_dofadr[tree.free] + 6)
            at_q += [int(compiled.jnt_qposadr[joint]) for joint in joints]
            at_qd += [int(compiled.jnt_dofadr[joint]) for joint in joints]
        self._places = [torch.as_tensor(np.argsort(at), device=self._device) for at in (at_q, at_qd)]
        self._at = np.array(at_q), np.array(at_qd)
        self._origins = self.origins.numpy()
        self.hold(np.zeros((self._n_env, compiled.nu)))
        self.put(*first_state(plan, self._layout, self._origins), None)

    def state(self) -> tuple[Any, Any]:
        """See World.state."""
        import torch

        positions, velocities = [], []
        for asset, tree in self._assets:
            if tree.free >= 0:
                positions.append(asset.data.root_link_pose_w.torch)
                velocities.append(asset.data.root_com_vel_w.torch)
            if tree.joints():
                positions.append(asset.data.joint_pos.torch)
                velocities.append(asset.data.joint_vel.torch)
        parts = zip((positions, velocities), self._places, strict=True)
        found, moving = (torch.cat(arrays, dim=1)[:, places] for arrays, places in parts)
        return found, moving

    def put(self, positions: Any, velocities: Any, envs: Envs) -> None:
        """See World.put."""
        import torch

        ids = None if envs is None else torch.as_tensor(envs, dtype=torch.int32, device=self._device)
        given = zip((positions, velocities), self._at, strict=True)
        left, moving = (
            torch.as_tensor(np.asarray(array)[:, at], dtype=torch.float32, device=self._device) for array, at in given
        )
        for asset, tree in self._assets:
            if tree.free >= 0:
                asset.write_root_link_pose_to_sim_index(root_pose=left[:, :7].contiguous(), env_ids=ids)
                asset.write_root_com_velocity_to_sim_index(root_velocity=moving[:, :6].contiguous(), env_ids=ids)
                left, moving = left[:, 7:], moving[:, 6:]
            if count := len(tree.joints()):
                asset.write_joint_state_to_sim_index(
                    position=left[:, :count].contiguous(), velocity=moving[:, :count].contiguous(), env_ids=ids
                )
                left, moving = left[:, count:], moving[:, count:]
            asset.update(0.0)
            # as in BodyWorld.put: Newton would clear its solver's starting point, which is put next
            _ = asset.data.body_link_pose_w.torch

    def prepare(self, controls: NDArray[np.float32]) -> None:
        """Take the controls of the next steps, [step, env, actuator]."""
        self._take(controls, self._model.driven.uses)

    def hold(self, controls: NDArray[np.float64]) -> None:
        """Hold these controls, [env, actuator], until others are given."""
        self._take(controls[None], frozenset(TARGETS))  # where no control acts, a target is where a spring rests
        self._command()

    def _take(self, controls: NDArray[np.floating], names: frozenset[str]) -> None:
        import torch

        self._given = [[] for _ in controls]
        driven, compiled = self._model.driven, self._model.compiled.model
        for (asset, _), joints in zip(self._assets, self._joints, strict=True):
            if not joints:
                continue
            for name, values in driven.of(compiled, joints, controls).items():
                if name in names:
                    moved = torch.as_tensor(values, device=self._device)
                    for step, given in enumerate(self._given):
                        given.append((asset, _COMMANDS[name], moved[step]))
        self._given.reverse()

    def _command(self) -> None:
        for asset, command, values in self._given.pop():
            getattr(asset.actuators.target_command, command)(value=values)

    def step(self) -> None:
        """See World.step."""
        if self._given:
            self._command()
        for asset, _ in self._assets:
            asset.write_data_to_sim()
        self.sim.step(render=False)
        for asset, _ in self._assets:
            asset.update(self._dt)

    def rehearse(self) -> None:
        """See World.rehearse."""
        given, self._given = self._given, []
        self.step()
        self._given = given

    def fields(self) -> tuple[StateField, ...]:
        """See World.fields."""
        return self._layout.fields()

    def split(self, positions: NDArray[np.float32], velocities: NDArray[np.float32]) -> States:
        """See World.split."""
        return self._layout.split(positions, velocities)

    def merged(self, states: States, positions: NDArray[Any], velocities: NDArray[Any]) -> tuple[Any, Any]:
        """See World.merged: all numbers are among the fields'."""
        return self._layout.joined(states)

    def held(self, tree: Tree, name: str) -> tuple[Sequence[str], Sequence[str], NDArray[np.float32]]:
        """See recorder.simulators.physx.held_parameters.Source."""
        from ovphysx.types import TensorType

        view = next(asset.root_view for asset, other in self._assets if other == tree)
        body = tree.is_a_body()
        rows = view.get_attribute(TensorType[f"RIGID_{name}" if body else f"ARTICULATION_{name}"]).numpy()
        first = f"/env_0/model/{tree.prim}"
        (index,) = [row for row, path in enumerate(view.prim_paths) if first in path]
        if body:
            return [tree.links[0].prim], [], rows[[index]]
        return list(view.body_names), list(view.dof_names), rows[index]

    def link_poses(self) -> NDArray[np.float32]:
        """See recorder.simulators.physx.held_parameters.Source."""
        found = reference_poses(self._model.compiled, self._origins)
        for asset, tree in self._assets:
            poses = asset.data.body_link_pose_w.torch.cpu().numpy()
            links = {link.prim: link.body for link in tree.links if link.body >= 0}
            for number, name in enumerate(asset.body_names):
                if name in links:
                    found[:, links[name]] = poses[:, number][:, [0, 1, 2, 6, 3, 4, 5]]
        return found

    def _let_go(self) -> None:
        for name in ("_assets", "_given", "_places"):
            vars(self).pop(name, None)
