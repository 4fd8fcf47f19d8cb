"""A scene as Newton's model: N worlds at the same place, which do not see each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Plane, Quaternion, Scene, Sphere, Vector, solid_inertia
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.mujoco.drives import disabled
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel
from gpusimbench.recorder.simulators.newton.imported import Imported, import_mjcf
from gpusimbench.recorder.simulators.newton.layout import BodyLayout, Layout
from gpusimbench.recorder.simulators.newton.options import NewtonOptions

_FREE = 6  # speeds of a free joint: linear of the centre of mass, then angular, both in the world frame


@dataclass(frozen=True)
class World:
    """One environment.

    builder   newton.ModelBuilder
    layout    where the fields of a recording are
    imported  None for scenes whose bodies are built one by one
    multiccd  whether MuJoCo makes several contacts of two convex shapes, where else it would make one; None likewise
    """

    builder: Any
    layout: Layout
    imported: Imported | None = None
    multiccd: bool | None = None


def comes_as_mjcf(scene: Scene) -> bool:
    """Whether Newton reads the scene by its importer of MJCF: model files, and scenes with a robot."""
    return isinstance(scene, ModelScene) or scene.robot is not None


def one_world(scene: Scene, compiled: MjcfModel, options: NewtonOptions, register: Callable[[Any], None]) -> World:
    """A scene in Newton's builder, where nothing comes as MJCF in the order of Scene.moving.

    compiled  the scene as MuJoCo compiles it
    register  adds the attributes of a solver to a builder, before it has any shapes

    Refused as of imported.import_mjcf.
    """
    import newton

    if comes_as_mjcf(scene):

        def prepare(builder: Any) -> None:
            register(builder)
            shapes = builder.default_shape_cfg  # for what a geom does not say
            shapes.gap = detection_distance(options)
            shapes.ke, shapes.kd, shapes.kf = options.ke, options.kd, options.kf

        imported = import_mjcf(scene, compiled, direct=options.solver == "mujoco", prepare=prepare)
        if scene.robot is not None and options.solver != "mujoco":
            _give_materials(imported.builder, scene, options)
        return World(imported.builder, imported.layout, imported, multiccd=not disabled(compiled.model, "MULTICCD"))
    world = newton.ModelBuilder(gravity=scene.gravity)
    register(world)
    for body in scene.bodies:
        _add(world, body, options)
    return World(world, BodyLayout(scene))


def build_model(world: World, *, n_env: int, options: NewtonOptions, register: Callable[[Any], None]) -> Any:
    """The newton.Model of n_env replicas of a world on Warp's present device; register as of one_world."""
    import newton

    replicas = newton.ModelBuilder(gravity=tuple(world.builder.gravity))
    register(replicas)
    replicas.replicate(world.builder, n_env)
    if options.solver == "vbd":
        replicas.color()  # groups of bodies that VBD may move at the same time
    return replicas.finalize()


def detection_distance(options: NewtonOptions) -> float:
    """The gap of every shape [m]; MuJoCo's collision detection has none, as in MJCF."""
    return options.gap if options.own_contacts else 0.0


def _give_materials(builder: Any, scene: Scene, options: NewtonOptions) -> None:
    # MJCF has no restitution, and its solref and its friction against spinning and rolling are not the scene's
    assert scene.robot is not None
    for shape, label in enumerate(builder.shape_label):
        materials = (body.material for body in scene.bodies if label.endswith(f"/{body.name}"))
        builder.shape_material_restitution[shape] = next(materials, scene.robot.material).restitution
        builder.shape_material_mu_torsional[shape] = builder.shape_material_mu_rolling[shape] = 0.0
        builder.shape_material_ke[shape], builder.shape_material_kd[shape] = options.ke, options.kd


def _add(builder: Any, body: Body, options: NewtonOptions) -> None:
    import newton

    pose = _pose(body.position, body.orientation)
    material = newton.ModelBuilder.ShapeConfig(
        density=0.0,  # masses are the scene's
        mu=body.material.kinetic_friction,
        restitution=body.material.restitution,
        mu_torsional=0.0,  # the scene has friction against sliding only
        mu_rolling=0.0,
        ke=options.ke,
        kd=options.kd,
        kf=options.kf,
        gap=detection_distance(options),
    )
    if body.mass is None:
        _add_shape(builder, body, material, body=-1, pose=pose)
        return
    xx, yy, zz = solid_inertia(body.shape, body.mass)
    index = builder.add_body(
        xform=pose, mass=body.mass, inertia=((xx, 0.0, 0.0), (0.0, yy, 0.0), (0.0, 0.0, zz)), label=body.name
    )
    _add_shape(builder, body, material, body=index, pose=_pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    speeds = (*body.linear_velocity, *body.angular_velocity)
    builder.body_qd[index] = speeds
    builder.joint_qd[-_FREE:] = speeds  # of the free joint that the body has just been given


def _add_shape(builder: Any, described: Body, material: Any, *, body: int, pose: Any) -> None:
    common = {"xform": pose, "cfg": material, "label": described.name}
    match described.shape:
        case Box((x, y, z)):
            builder.add_shape_box(body, hx=x / 2, hy=y / 2, hz=z / 2, **common)
        case Sphere(radius):
            builder.add_shape_sphere(body, radius=radius, **common)
        case Capsule(radius, length):
            builder.add_shape_capsule(body, radius=radius, half_height=length / 2, **common)
        case Plane():
            builder.add_shape_plane(None, body=body, width=0.0, length=0.0, **common)  # 0: without an edge


def _pose(position: Vector, orientation: Quaternion) -> Any:
    import warp as wp

    w, x, y, z = orientation
    return wp.transform(wp.vec3(*position), wp.quat(x, y, z, w))
