"""A model file on its way into Isaac Lab: the stage that PhysX is given of it, spawned, cloned and taken as assets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.emit.usd import MATERIALS, env_path
from gpusimbench.recorder.simulators.isaaclab.options import IsaacLabOptions
from gpusimbench.recorder.simulators.physx.model import Model
from gpusimbench.recorder.simulators.physx.options import NO_THRESHOLD, PhysxOptions, apis
from gpusimbench.recorder.simulators.physx.plan import Plan, Tree
from gpusimbench.recorder.simulators.physx.stage import SHARED

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
