"""A scene in the words of Isaac Lab: what its InteractiveScene spawns and clones."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Plane, Quaternion, Scene, Sphere
from gpusimbench.recorder.scenes.emit.usd import MATERIALS
from gpusimbench.recorder.scenes.emit.usd_prim import identifiers
from gpusimbench.recorder.simulators.isaaclab.options import IsaacLabOptions

_AMBIGUOUS = (6, 7)
"""Numbers of bodies for which Isaac Lab 3.0 takes a binding of velocities (6 numbers a body) or of poses (7) for one
that is laid out otherwise, and mixes bodies up; see _read_binding_into_instance_major in isaaclab_ov."""
_APART = 5

BODY_LIMITS: dict[str, Any] = {
    "linear_damping": 0.0,
    "angular_damping": 0.0,
    "sleep_threshold": 0.0,
    "stabilization_threshold": 0.0,
    "max_angular_velocity": 5729.58,
    "max_depenetration_velocity": 3.0,
    "enable_gyroscopic_forces": True,
}
"""What PhysX is told of each moving body: no damping and no sleep, which the scene does not have, and the schema's
own defaults for the rest, so that they are on record. The angular velocity is in degrees per second there."""


def scene_cfg(scene: Scene, *, n_env: int, options: IsaacLabOptions) -> tuple[Any, dict[str, tuple[str, ...]]]:
    """The InteractiveSceneCfg of a scene, and what each collection in it calls its bodies, by the collection's name.

    Moving bodies form one collection, or two where one would not do, in the order of Scene.moving.
    """
    from isaaclab.assets import AssetBaseCfg, RigidObjectCfg, RigidObjectCollectionCfg
    from isaaclab.scene import InteractiveSceneCfg

    names = identifiers(body.name for body in scene.bodies)
    materials = identifiers({body.material.name: None for body in scene.bodies})
    cfg = InteractiveSceneCfg(num_envs=n_env, env_spacing=options.spacing)
    for body in scene.bodies:
        if body.fixed:
            shared = isinstance(body.shape, Plane)  # with the bodies of all environments
            asset = AssetBaseCfg(
                prim_path=f"/World/{names[body.name]}" if shared else f"{{ENV_REGEX_NS}}/fixed_{names[body.name]}",
                spawn=_spawner(body, materials[body.material.name], options),
                init_state=AssetBaseCfg.InitialStateCfg(pos=body.position, rot=xyzw(body.orientation)),
                collision_group=-1 if shared else 0,
            )
            setattr(cfg, f"fixed_{names[body.name]}", asset)
    collections = {}
    for part, bodies in _parts(scene.moving()).items():
        members = {
            names[body.name]: RigidObjectCfg(
                prim_path=f"{{ENV_REGEX_NS}}/{part}_{names[body.name]}",  # by which Newton finds a collection's bodies
                spawn=_spawner(body, materials[body.material.name], options),
                init_state=RigidObjectCfg.InitialStateCfg(pos=body.position, rot=xyzw(body.orientation)),
            )
            for body in bodies
        }
        setattr(cfg, part, RigidObjectCollectionCfg(rigid_objects=members))
        collections[part] = tuple(members)
    return cfg, collections


def _parts(bodies: tuple[Body, ...]) -> dict[str, tuple[Body, ...]]:
    if len(bodies) in _AMBIGUOUS:
        return {"first": bodies[:_APART], "second": bodies[_APART:]}
    return {"moving": bodies}


def xyzw(orientation: Quaternion) -> tuple[float, float, float, float]:
    """A quaternion wxyz in Isaac Lab's order."""
    w, x, y, z = orientation
    return x, y, z, w


def _spawner(body: Body, material: str, options: IsaacLabOptions) -> Any:
    import isaaclab.sim as lab
    from isaaclab.sim.schemas import MassCfg, UsdPhysicsCollisionCfg, UsdPhysicsRigidBodyCfg
    from isaaclab.sim.spawners.materials import UsdPhysicsRigidBodyMaterialCfg
    from isaaclab_physx.sim.schemas import PhysxCollisionCfg, PhysxRigidBodyCfg
    from isaaclab_physx.sim.spawners.materials import PhysxMaterialCfg

    # these write attributes of USD prims and nothing else; Newton reads the offsets as well
    common: dict[str, Any] = {
        "collision_props": [
            UsdPhysicsCollisionCfg(),
            PhysxCollisionCfg(contact_offset=options.contact_offset, rest_offset=options.rest_offset),
        ],
        "physics_material": [
            UsdPhysicsRigidBodyMaterialCfg(
                static_friction=body.material.static_friction,
                dynamic_friction=body.material.kinetic_friction,
                restitution=body.material.restitution,
            ),
            PhysxMaterialCfg(
                friction_combine_mode=options.friction_combine, restitution_combine_mode=options.restitution_combine
            ),
        ],
    }
    if options.backend != "newton":  # whose importer reads an environment without what is beside it
        # one for all environments: PhysX has at most 65,536, fewer than bodies of 4,096 environments
        common["physics_material_path"] = f"{MATERIALS}/{material}"
    if body.mass is not None:
        common["mass_props"] = [MassCfg(mass=body.mass)]
        common["rigid_props"] = [
            UsdPhysicsRigidBodyCfg(),
            PhysxRigidBodyCfg(
                solver_position_iteration_count=options.position_iterations,
                solver_velocity_iteration_count=options.velocity_iterations,
                **BODY_LIMITS,
            ),
        ]
    match body.shape:
        case Box(size):
            return lab.CuboidCfg(size=size, **common)
        case Sphere(radius):
            return lab.SphereCfg(radius=radius, **common)
        case Capsule(radius, length):
            return lab.CapsuleCfg(radius=radius, height=length, axis="Z", **common)
        case Plane():
            return lab.ShapeCfg(func=_spawn_plane, **common)


def _spawn_plane(prim_path: str, cfg: Any, translation: Any = None, orientation: Any = None, **kwargs: Any) -> Any:
    """Isaac Lab's own ground plane is a file that it downloads."""
    from isaaclab.sim.spawners.shapes.shapes import spawn_geom_from_prim_type

    return spawn_geom_from_prim_type(prim_path, cfg, "Plane", {"axis": "Z"}, translation, orientation)
