"""A scene as Genesis' own: an entity for each body, and the robot from MJCF."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Body, Box, Plane, Scene, Sphere
from gpusimbench.recorder.scenes.emit.mjcf import emit_mjcf
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.recorder.simulators.genesis.sizes import Sizes
from gpusimbench.recorder.simulators.mujoco.layout import rotate_to_body
from gpusimbench.recorder.simulators.snapshot import Envs


@dataclass(frozen=True)
class Model:
    """N environments of a scene, built.

    scene   genesis.Scene
    solver  its rigid solver
    links   index in the solver of each moving body, in the order of Scene.moving
    joints  index in the solver of each joint's degree of freedom, in the robot's order
    xml     MJCF of the robot, empty where there is none
    """

    scene: Any
    solver: Any
    links: NDArray[np.int64]
    joints: NDArray[np.int64]
    xml: str
    _described: Scene
    _entities: dict[str, Any]
    _robot: Any

    def reset(self, envs: Envs = None) -> None:
        """Bring environments to the scene's initial state."""
        self.scene.reset(envs_idx=envs)
        self.place(envs)

    def place(self, envs: Envs = None) -> None:
        """Give the bodies their speeds and the robot its angles, which entities are not described with."""
        n_env = self.scene.n_envs if envs is None else len(envs)
        speeds = np.zeros((n_env, self.solver.n_dofs))
        for body, link in self._moving():
            # of a free joint: linear in the world frame, angular in the body's
            speeds[:, link.dof_start : link.dof_start + 3] = body.linear_velocity
            speeds[:, link.dof_start + 3 : link.dof_end] = rotate_to_body(
                np.array(body.orientation), np.array(body.angular_velocity)
            )
        if self._robot is not None and self._described.robot is not None:
            start = np.array(self._described.robot.start)
            self._robot.set_qpos(np.repeat(start[None], n_env, axis=0), envs_idx=envs)
        self.solver.set_dofs_velocity(speeds, envs_idx=envs)

    def give(self, links: NDArray[np.floating], joints: NDArray[np.floating], envs: Envs) -> None:
        """Give environments that were just reset other poses and velocities.

        links   [env of envs, body, 13] in the order of Scene.moving: position, orientation wxyz, linear and angular
                velocity in the world frame
        joints  [env of envs, joint, 2]: angles and speeds
        """
        qpos = self.solver.get_qpos(envs_idx=envs).cpu().numpy().copy()
        speeds = self.solver.get_dofs_velocity(envs_idx=envs).cpu().numpy().astype(np.float64)
        for place, (_, link) in enumerate(self._moving()):
            given = links[:, place]
            qpos[:, link.q_start : link.q_start + 7] = given[:, :7]
            speeds[:, link.dof_start : link.dof_start + 3] = given[:, 7:10]
            numbers = given.astype(np.float64)
            speeds[:, link.dof_start + 3 : link.dof_end] = rotate_to_body(numbers[:, 3:7], numbers[:, 10:13])
        if self._robot is not None and self._described.robot is not None:
            angles = [self._robot.get_joint(joint.name).q_start for joint in self._described.robot.joints()]
            qpos[:, angles], speeds[:, self.joints] = joints[..., 0], joints[..., 1]
        self.solver.set_qpos(qpos, envs_idx=envs)
        self.solver.set_dofs_velocity(speeds, envs_idx=envs)

    def _moving(self) -> list[tuple[Body, Any]]:
        return [(body, self._entities[body.name].base_link) for body in self._described.moving()]


def build_model(genesis: Any, scene: Scene, *, n_env: int, dt: float, options: GenesisOptions, sizes: Sizes) -> Model:
    """Build n_env environments of a scene in its initial state on the initialised engine.

    genesis.GenesisException for what it does not accept.
    """
    made = genesis.Scene(
        sim_options=genesis.options.SimOptions(dt=dt, substeps=options.substeps, gravity=scene.gravity),
        rigid_options=genesis.options.RigidOptions(**_rigid_options(genesis, options, sizes)),
        profiling_options=genesis.options.ProfilingOptions(show_FPS=False),
        show_viewer=False,
    )
    entities = {body.name: _add(genesis, made, body) for body in scene.bodies}
    robot: Any = None
    xml, joints = "", []
    if scene.robot is not None:
        xml = emit_mjcf(replace(scene, bodies=()), dt=dt, option={}, geom={})
        robot = made.add_entity(
            genesis.morphs.MJCF(file=ET.fromstring(xml), default_armature=None, visualization=False)
        )
    made.build(n_envs=n_env)
    if scene.robot is not None:
        joints = [robot.get_joint(joint.name).dof_start for joint in scene.robot.joints()]
    model = Model(
        scene=made,
        solver=made.rigid_solver,
        links=np.array([entities[body.name].base_link.idx for body in scene.moving()], dtype=np.int64),
        joints=np.array(joints, dtype=np.int64),
        xml=xml,
        _described=scene,
        _entities=entities,
        _robot=robot,
    )
    model.place()
    return model


def _rigid_options(genesis: Any, options: GenesisOptions, sizes: Sizes) -> dict[str, Any]:
    chosen: dict[str, Any] = {
        "integrator": genesis.integrator[options.integrator],
        "constraint_solver": genesis.constraint_solver[options.solver],
        "iterations": options.iterations,
        "ls_iterations": options.ls_iterations,
        "noslip_iterations": options.noslip_iterations,
        "friction_cone": genesis.friction_cone[options.cone],
        "constraint_timeconst": options.constraint_timeconst,
        "use_gjk_collision": options.use_gjk_collision,
        "box_box_detection": options.box_box_detection,
        "enable_mujoco_compatibility": options.mujoco_compatibility,
        "enable_neutral_collision": True,  # the scene says which links never collide
        "max_collision_pairs": sizes.pairs,
        "max_contacts": sizes.contacts,
        "multiplier_collision_broad_phase": options.broad_phase_multiplier,
    }
    if options.tolerance:
        chosen["tolerance"] = options.tolerance
    if options.impratio:
        chosen["impratio"] = options.impratio
    if options.contact_resolution != "auto":
        chosen["contact_resolution"] = genesis.contact_resolution[options.contact_resolution]
    if options.broadphase != "auto":
        chosen["broadphase_traversal"] = genesis.broadphase_traversal[options.broadphase]
    return chosen


def _add(genesis: Any, made: Any, body: Body) -> Any:
    material = genesis.materials.Rigid(
        rho=None if body.mass is None else body.mass / _volume(body), friction=body.material.kinetic_friction
    )
    return made.add_entity(_morph(genesis, body), material=material)


def _morph(genesis: Any, body: Body) -> Any:
    common = {"pos": body.position, "quat": body.orientation, "fixed": body.fixed, "visualization": False}
    match body.shape:
        case Box(size):
            return genesis.morphs.Box(size=size, **common)
        case Sphere(radius):
            return genesis.morphs.Sphere(radius=radius, **common)
        case Plane():
            return genesis.morphs.Plane(**common)
    raise TypeError(body.shape)


def _volume(body: Body) -> float:
    """[m3]; Genesis makes mass and inertia of a uniform density."""
    match body.shape:
        case Box((x, y, z)):
            return x * y * z
        case Sphere(radius):
            return 4.0 / 3.0 * math.pi * radius**3
    raise TypeError(body.shape)
