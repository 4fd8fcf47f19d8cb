"""A compiled model file as a USD stage for PhysX, one environment of it.

Written from MuJoCo's own compile, number by number, and not by a converter: what PhysX is given is known by
construction, and what it has no place for is told (recorder.simulators.physx.held_parameters).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

import mujoco
import numpy as np

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.base import Box, Capsule, Material, Plane, Quaternion, Shape, Sphere, Vector
from gpusimbench.recorder.scenes.emit.usd import MATERIALS, collider, env_path, material_prim, physics_scene
from gpusimbench.recorder.scenes.emit.usd_prim import Apis, Prim, literal, pose_lines, stage_text, tuple_text
from gpusimbench.recorder.simulators.mujoco.model import collides
from gpusimbench.recorder.simulators.physx.plan import ADDED_SHARE, Link, Plan, Tree, apart, frictions, joint_frame
from gpusimbench.recorder.simulators.physx.servos import Servo

SHARED = "/World/shared"
FAR = 1e6
"""Limits of a hinge that has none [rad]."""

_LEVEL = 1e-9  # sine of the tilt below which a plane is level
_SLIDE = mujoco.mjtJoint.mjJNT_SLIDE
_NONE = math.inf


class Words(Protocol):
    """Lines of properties that an engine's importer reads besides those of PhysX, by numbers of MuJoCo's."""

    def joint(self, joint: int) -> list[str]:
        """Of a hinge or slide."""

    def geom(self, geom: int) -> list[str]:
        """Of a shape that collides."""

    def body(self, body: int) -> list[str]:
        """Of a link."""

    def friction(self, coefficients: Sequence[float]) -> list[str]:
        """Of a material, geom_friction of its geoms."""


def emit_model(
    plan: Plan,
    servos: Mapping[int, Servo],
    *,
    gravity: Vector,
    apis: Apis,
    spacing: float,
    isaac_lab: bool = False,
    words: Words | None = None,
) -> str:
    """The text of a stage with one environment, in the reference state; its prims are those of the plan.

    servos   by MuJoCo's joint, the drive of each hinge and slide
    gravity  [m/s^2]
    apis     as of scenes.emit.usd.emit_usd
    spacing  of environments [m]; 0: all that is fixed serves all of them
    isaac_lab  whether Isaac Lab takes it. Its environments are copies in USD: what is fixed to the world is fixed to
               its environment's prim, and not at a place in the world, which would be the same for all copies. Its
               articulations have joints: a free body without them is none
    words    whose lines are added. All is then within each environment, also materials and planes: Newton's importer
             reads an environment without what is beside it, and its worlds do not see each other

    Refused where environments beside each other would share a plane that is not level.
    """
    return _Writer(plan, servos, apis, spacing, isaac_lab, words).text(gravity)


class _Writer:
    def __init__(
        self, plan: Plan, servos: Mapping[int, Servo], apis: Apis, spacing: float, isaac_lab: bool, words: Words | None
    ) -> None:
        self._plan, self._model, self._servos, self._apis = plan, plan.model, servos, apis
        self._spacing, self._isaac_lab, self._words = spacing, isaac_lab, words
        self._data = mujoco.MjData(plan.model)
        mujoco.mj_kinematics(plan.model, self._data)  # of the reference state
        self._friction: list[tuple[float, ...]] = [(one,) for one in frictions(plan.model)]
        if words is not None:
            self._friction = [tuple(map(float, all_of)) for all_of in plan.model.geom_friction]
        self._frictions = sorted(set(self._friction))
        self._apart = apart(plan)
        self._paths = {
            link.body: f"{env_path(0)}/{tree.prim}/{link.prim}"
            for tree in plan.trees for link in tree.links if link.body >= 0
        }  # fmt: skip

    def text(self, gravity: Vector) -> str:
        world = Prim("Xform", "World")
        world.add(physics_scene(gravity, self._apis))
        if self._words is None:
            self._add_materials(world)
        common = world.add(Prim("Scope", "shared"))
        env = world.add(Prim("Scope", "envs")).add(Prim("Xform", "env0"))
        if self._words is not None:
            self._add_materials(env)
        for geom, name in self._plan.fixed_prims.items():
            (common if self._is_shared(geom) else env).add(self._fixed(geom, name))
        for tree in self._plan.trees:
            env.add(self._tree(tree))
        return stage_text(world)

    def _add_materials(self, above: Prim) -> None:
        materials = above.add(Prim("Scope", "materials"))
        for number, coefficients in enumerate(self._frictions):
            named = Material(f"friction{number}", coefficients[0], coefficients[0], 0.0)
            prim = materials.add(material_prim(named, named.name, self._apis))
            if self._words is not None:
                prim.properties += self._words.friction(coefficients)

    def _material(self, geom: int) -> str:
        where = MATERIALS if self._words is None else f"{env_path(0)}/materials"
        return f"{where}/friction{self._frictions.index(self._friction[geom])}"

    def _is_shared(self, geom: int) -> bool:
        if self._words is not None:
            return False
        plane = self._model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        if plane and self._spacing and abs(self._data.geom_xmat[geom, 8]) < 1 - _LEVEL:
            name = self._model.geom(geom).name or f"geom{geom}"
            raise Refused(f"environments on a grid share plane '{name}', which is not level: spacing=0 on a GPU")
        return not self._spacing or plane

    def _fixed(self, geom: int, name: str) -> Prim:
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, self._data.geom_xmat[geom])
        prim = Prim("Xform", name, [], pose_lines(vector(self._data.geom_xpos[geom]), quaternion(turn)))
        prim.add(self._collider(geom))
        return prim

    def _tree(self, tree: Tree) -> Prim:
        prim = Prim("Xform", tree.prim)
        for number, link in enumerate(tree.links):
            child = prim.add(self._link(link))
            if number == 0 and not (self._isaac_lab and tree.is_a_body()):
                (child if tree.free >= 0 else prim).apis.insert(0, "PhysicsArticulationRootAPI")
                (child if tree.free >= 0 else prim).apply(self._apis, "PhysxArticulationAPI")
            if number or tree.free < 0:
                prim.add(self._joint(tree, link))
        return prim

    def _link(self, link: Link) -> Prim:
        model, frame = self._model, link.frame
        pose = pose_lines(vector(self._data.xpos[frame]), quaternion(self._data.xquat[frame]))
        prim = Prim("Xform", link.prim, ["PhysicsRigidBodyAPI", "PhysicsMassAPI"], pose)
        mass, inertia, centre, axes = mass_of(model, link)
        prim.properties += [
            f"float physics:mass = {literal(mass)}",
            f"point3f physics:centerOfMass = {tuple_text(centre)}",
            f"float3 physics:diagonalInertia = {tuple_text(inertia)}",
            f"quatf physics:principalAxes = {tuple_text(axes)}",
        ]
        own = dict(self._apis.get("PhysxRigidBodyAPI", {}))
        if link.body >= 0 and model.body_gravcomp[link.body] == 1:
            own["bool physxRigidBody:disableGravity"] = True
        prim.apply({"PhysxRigidBodyAPI": own}, "PhysxRigidBodyAPI")
        if link.body >= 0:
            if self._words is not None:
                prim.properties += self._words.body(link.body)
            _filter(prim, [self._paths[other] for other in self._apart.bodies.get(link.body, ())])
            for geom in range(model.ngeom):
                if model.geom_bodyid[geom] == link.body and collides(model, geom):
                    place = prim.add(Prim("Xform", _place(geom)))
                    place.properties = pose_lines(vector(model.geom_pos[geom]), quaternion(model.geom_quat[geom]))
                    place.add(self._collider(geom))
        return prim

    def _collider(self, geom: int) -> Prim:
        model = self._model
        material = self._material(geom)
        kind, sizes = mujoco.mjtGeom(int(model.geom_type[geom])), [float(size) for size in model.geom_size[geom]]
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            prim = self._mesh(geom, material)
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            prim = self._bound("Cylinder", material)
            prim.properties += [
                f"double radius = {literal(sizes[0])}",
                f"double height = {literal(2 * sizes[1])}",
                'uniform token axis = "Z"',
            ]
        else:
            prim = collider(_shape(kind, sizes), material, self._apis)
        _filter(prim, [self._geom_path(other) for other in self._apart.geoms.get(geom, ())])
        if self._words is not None:
            prim.properties += self._words.geom(geom)
        return prim

    def _geom_path(self, geom: int) -> str:
        if geom in self._plan.fixed_prims:
            above = SHARED if self._is_shared(geom) else env_path(0)
            return f"{above}/{self._plan.fixed_prims[geom]}/shape"
        return f"{self._paths[int(self._model.geom_bodyid[geom])]}/{_place(geom)}/shape"

    def _bound(self, kind: str, material: str) -> Prim:
        prim = Prim(kind, "shape", ["PhysicsCollisionAPI", "MaterialBindingAPI"])
        prim.properties = [f"rel material:binding:physics = <{material}>"]
        prim.apply(self._apis, "PhysxCollisionAPI")
        return prim

    def _mesh(self, geom: int, material: str) -> Prim:
        model, mesh = self._model, int(self._model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        points = ", ".join(tuple_text(map(float, point)) for point in model.mesh_vert[first : first + count])
        corners = ", ".join(map(str, model.mesh_face[face : face + faces].ravel()))
        prim = self._bound("Mesh", material)
        prim.apis.append("PhysicsMeshCollisionAPI")
        prim.properties += [
            'uniform token physics:approximation = "convexHull"',
            f"point3f[] points = [{points}]",
            f"int[] faceVertexCounts = [{', '.join(['3'] * faces)}]",
            f"int[] faceVertexIndices = [{corners}]",
        ]
        return prim

    def _joint(self, tree: Tree, link: Link) -> Prim:
        """What holds a link: its hinge or slide, or a weld to its parent or to the world."""
        model, joint = self._model, link.joint
        above = f"{env_path(0)}/{tree.prim}"
        origin, axis = np.zeros(3), np.array([1.0, 0, 0, 0])
        if joint < 0:
            prim = Prim("PhysicsFixedJoint", f"{link.prim}_weld")
        else:
            origin, axis = joint_frame(model, joint)
            prim = self._hinge_or_slide(joint)
            if self._words is not None:
                prim.properties += self._words.joint(joint)
        if link.parent >= 0:
            prim.properties.append(f"rel physics:body0 = <{above}/{tree.links[link.parent].prim}>")
        elif self._isaac_lab:
            prim.properties.append(f"rel physics:body0 = <{above}>")
        if link.parent < 0:
            outer, turn = self._data.xpos[link.frame], self._data.xquat[link.frame]
        elif link.within:
            outer, turn = np.zeros(3), np.array([1.0, 0, 0, 0])
        else:
            outer, turn = model.body_pos[link.frame], model.body_quat[link.frame]
        place, frame = np.zeros(3), np.zeros(4)
        mujoco.mju_rotVecQuat(place, origin, turn)
        mujoco.mju_mulQuat(frame, turn, axis)
        prim.properties += [
            f"rel physics:body1 = <{above}/{link.prim}>",
            f"point3f physics:localPos0 = {tuple_text(vector(outer + place))}",
            f"quatf physics:localRot0 = {tuple_text(quaternion(frame))}",
            f"point3f physics:localPos1 = {tuple_text(vector(origin))}",
            f"quatf physics:localRot1 = {tuple_text(quaternion(axis))}",
        ]
        return prim

    def _hinge_or_slide(self, joint: int) -> Prim:
        model, servo = self._model, self._servos[joint]
        slides = model.jnt_type[joint] == _SLIDE
        kind, way = ("Prismatic", "linear") if slides else ("Revolute", "angular")
        degrees = 1.0 if slides else 180 / math.pi  # USD has degrees
        axis = f"physxJointAxis:{way}"
        prim = Prim(f"Physics{kind}Joint", self._plan.joint_prims[joint])
        prim.apis = [f"PhysicsDriveAPI:{way}", f"PhysicsJointStateAPI:{way}", f"PhysxJointAxisAPI:{way}"]
        dof = int(model.jnt_dofadr[joint])
        prim.properties = ['uniform token physics:axis = "Z"']
        limits = model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]
        if not model.jnt_limited[joint]:
            limits = np.array([-FAR, FAR])  # of a hinge without limits, PhysX wraps the angle at 2 pi
        if model.jnt_limited[joint] or not (slides or self._words):
            for end, limit in zip(("lower", "upper"), limits, strict=True):
                prim.properties.append(f"float physics:{end}Limit = {literal(float(limit) * degrees)}")
        numbers = {
            f"drive:{way}:physics:stiffness": servo.stiffness / degrees,
            f"drive:{way}:physics:damping": servo.damping / degrees,
            f"drive:{way}:physics:targetPosition": servo.rest * degrees,
            f"state:{way}:physics:position": 0.0,
            f"state:{way}:physics:velocity": 0.0,
            f"{axis}:armature": float(model.dof_armature[dof]),
            f"{axis}:staticFrictionEffort": float(model.dof_frictionloss[dof]),
            f"{axis}:dynamicFrictionEffort": float(model.dof_frictionloss[dof]),
        }
        if servo.most < _NONE:
            numbers[f"drive:{way}:physics:maxForce"] = servo.most
        prim.properties.append(f'uniform token drive:{way}:physics:type = "force"')
        prim.properties += [f"float {name} = {literal(value)}" for name, value in numbers.items()]
        return prim


def mass_of(model: Any, link: Link) -> tuple[float, Vector, Vector, Quaternion]:
    """Mass [kg], principal moments [kg m^2], centre and principal axes wxyz of a link, in its own frame.

    A link that is added has a small share of those of the body that hangs on it, in the same place; the first link of a
    tree that is fixed to the world, where it makes no difference, those of a ball of 1 kg.
    """
    if link.body < 0 and link.parent < 0:
        return 1.0, (0.1, 0.1, 0.1), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    share = 1.0 if link.body >= 0 else ADDED_SHARE
    body = link.frame
    mass, moments = float(model.body_mass[body]) * share, np.array(model.body_inertia[body]) * share
    if not mass:  # of a body that is welded to another: MuJoCo lets it have none, and PhysX would make some up
        mass = ADDED_SHARE * float(model.body_subtreemass[model.body_weldid[body]])
    moments = np.where(moments > 0, moments, ADDED_SHARE * mass)
    return mass, vector(moments), vector(model.body_ipos[body]), quaternion(model.body_iquat[body])


def _filter(prim: Prim, others: Sequence[str]) -> None:
    # what is at these paths, and the prim, do not touch each other
    if others:
        prim.apis.append("PhysicsFilteredPairsAPI")
        prim.properties.append(f"rel physics:filteredPairs = [{', '.join(f'<{path}>' for path in others)}]")


def _place(geom: int) -> str:
    return f"geom_{geom}"


def _shape(kind: mujoco.mjtGeom, sizes: list[float]) -> Shape:
    match kind:
        case mujoco.mjtGeom.mjGEOM_BOX:
            return Box((2 * sizes[0], 2 * sizes[1], 2 * sizes[2]))
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return Sphere(sizes[0])
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return Capsule(sizes[0], 2 * sizes[1])
    return Plane()


def vector(numbers: Iterable[float]) -> Vector:
    """Three numbers."""
    x, y, z = map(float, numbers)
    return x, y, z


def quaternion(numbers: Iterable[float]) -> Quaternion:
    """Four numbers."""
    w, x, y, z = map(float, numbers)
    return w, x, y, z
