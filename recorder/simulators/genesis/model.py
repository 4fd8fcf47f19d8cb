"""A scene as Genesis' own: an entity for each body, and the robot from MJCF."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Body, Box, Plane, Scene, Sphere
from gpusimbench.recorder.scenes.emit.mjcf import emit_mjcf
from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.genesis.environments import (
    Drive,
    Environments,
    GenesisSizes,
    empty_scene,
    index_of,
    on_device,
)
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.recorder.simulators.mujoco.layout import rotate_to_body
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.fields import StateField, body_fields, joint_field

_LINK = 13  # position 3, orientation wxyz 4, linear velocity 3, angular velocity 3
_COLUMNS = (slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13))


class SceneEnvironments(Environments):
    """N environments of a registered scene."""

    def __init__(self, made: Any, scene: Scene, *, entities: Mapping[str, Any], robot: Any, xml: str) -> None:
        """Environments that were built, in the scene's first state.

        made      genesis.Scene
        entities  by name of the body
        robot     entity of the robot; None where there is none
        xml       MJCF of the robot, empty where there is none
        """
        super().__init__(made)
        self._described, self._robot, self._xml = scene, robot, xml
        self._moving = [(body, entities[body.name].base_link) for body in scene.moving()]
        self._links = np.array([link.idx for _, link in self._moving], dtype=np.int64)
        joints = [] if scene.robot is None else [robot.get_joint(joint.name) for joint in scene.robot.joints()]
        self._joints = np.array([joint.dof_start for joint in joints], dtype=np.int64)
        self._angles = [joint.q_start for joint in joints]
        places = {body.name: index for index, (body, _) in enumerate(self._moving)}
        self._groups = [[places[name] for name in names] for names in scene.groups().values()]
        self._gathered = [index_of(self._links[group]) for group in self._groups]
        self._dofs = index_of(self._joints) if joints else None
        n_env = int(made.n_envs)
        self._parts = {field.name: (n_env, len(field.items), field.width) for field in self.fields("float32")}
        self.place()

    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """See Environments.fields."""
        bodies = body_fields(self._described.groups(), dtype)
        if self._described.robot is None:
            return tuple(bodies)
        joints = tuple(joint.name for joint in self._described.robot.joints())
        return (*bodies, joint_field("robot", "qpos", dtype, joints), joint_field("robot", "qvel", dtype, joints))

    def parts(self) -> Mapping[str, tuple[int, ...]]:
        """See Environments.parts: the fields, in their order."""
        return self._parts

    def store(self, parts: Mapping[str, Any]) -> None:
        """See Environments.store."""
        solver, left = self.solver, iter(parts.values())
        if self._gathered:
            links = (solver.get_links_pos(), solver.get_links_quat(), solver.get_links_vel(), solver.get_links_ang())
            for group in self._gathered:
                for values in links:
                    next(left).copy_(values[:, group])
        if self._dofs is not None:
            for values in (solver.get_dofs_position(), solver.get_dofs_velocity()):
                next(left)[..., 0] = values[:, self._dofs]

    def split(self, parts: Mapping[str, NDArray[np.floating]]) -> States:
        """See Environments.split."""
        return tuple(parts.values())

    def place(self, envs: Envs = None) -> None:
        """See Environments.place: the speeds of bodies and the angles of the robot, which entities are not described
        with."""
        n_env = self.scene.n_envs if envs is None else len(envs)
        speeds = np.zeros((n_env, self.solver.n_dofs))
        for body, link in self._moving:
            # of a free joint: linear in the world frame, angular in the body's
            speeds[:, link.dof_start : link.dof_start + 3] = body.linear_velocity
            speeds[:, link.dof_start + 3 : link.dof_end] = rotate_to_body(
                np.array(body.orientation), np.array(body.angular_velocity)
            )
        if self._described.robot is not None:
            start = np.array(self._described.robot.start)
            self._robot.set_qpos(np.repeat(start[None], n_env, axis=0), envs_idx=envs)
            speeds[:, self._joints] = self._described.robot.speeds()
        self.solver.set_dofs_velocity(speeds, envs_idx=envs)

    def give(self, states: States, envs: Envs) -> None:
        """See Environments.give."""
        qpos = self.solver.get_qpos(envs_idx=envs).cpu().numpy().copy()
        speeds = self.solver.get_dofs_velocity(envs_idx=envs).cpu().numpy().astype(np.float64)
        left = iter(states)
        links = np.empty((len(states[0]), len(self._links), _LINK), dtype=states[0].dtype)
        for group in self._groups:
            for columns in _COLUMNS:
                links[:, group, columns] = next(left)
        for place, (_, link) in enumerate(self._moving):
            given = links[:, place]
            qpos[:, link.q_start : link.q_start + 7] = given[:, :7]
            speeds[:, link.dof_start : link.dof_start + 3] = given[:, 7:10]
            numbers = given.astype(np.float64)
            speeds[:, link.dof_start + 3 : link.dof_end] = rotate_to_body(numbers[:, 3:7], numbers[:, 10:13])
        if self._described.robot is not None:
            qpos[:, self._angles], speeds[:, self._joints] = next(left)[..., 0], next(left)[..., 0]
        self.solver.set_qpos(qpos, envs_idx=envs)
        self.solver.set_dofs_velocity(speeds, envs_idx=envs)

    def drives(self, actions: NDArray[np.floating]) -> Sequence[Drive]:
        """See Environments.drives: targets of the robot's servos."""
        return [Drive(self.solver.control_dofs_position, on_device(actions), self._joints)]

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        if self._described.actions is None:
            return None
        held = self.solver.dyn_state.dofs.ctrl_pos.to_numpy()  # [degree of freedom, env]
        return np.ascontiguousarray(held[self._joints].T, dtype=np.float32)

    def attachments(self) -> dict[str, tuple[str, bytes]]:
        """See Environments.attachments."""
        return {"robot.xml": ("application/xml", self._xml.encode())} if self._xml else {}


def build_scene(
    genesis: Any, scene: Scene, *, n_env: int, dt: float, options: GenesisOptions, sizes: GenesisSizes
) -> SceneEnvironments:
    """Build n_env environments of a registered scene in its initial state on the initialised engine.

    genesis.GenesisException for what it does not accept.
    """
    made = empty_scene(genesis, scene.gravity, dt, options, sizes)
    entities = {body.name: _add(genesis, made, body) for body in scene.bodies}
    robot, xml = None, ""
    if scene.robot is not None:
        xml = emit_mjcf(replace(scene, bodies=()), dt=dt, option={}, geom={})
        robot = made.add_entity(
            genesis.morphs.MJCF(file=ET.fromstring(xml), default_armature=None, visualization=False)
        )
    made.build(n_envs=n_env)
    return SceneEnvironments(made, scene, entities=entities, robot=robot, xml=xml)


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
