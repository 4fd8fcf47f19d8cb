"""A model file, or a scene with a robot, as Newton's own importer of MJCF reads it, and where MuJoCo's bodies, joints
and actuators are in the result."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.mujoco.drives import disabled
from gpusimbench.recorder.simulators.mujoco.layout import Balls, FreeBodies, Joints, StateGroup
from gpusimbench.recorder.simulators.mujoco.model import SCENE_FILE, MjcfModel
from gpusimbench.recorder.simulators.newton.layout import ModelLayout, NewtonBalls, NewtonFreeBodies, NewtonJoints
from gpusimbench.schemas.model_files import unpack
from gpusimbench.schemas.scratch import empty_folder
from gpusimbench.schemas.writing import write_file

_KINDS = {"FREE": (7, 6), "BALL": (4, 3)}  # numbers of a joint in joint_q and joint_qd
_FREE, _BALL, _SLIDE = 0, 1, 2  # of mujoco.mjtJoint


@dataclass(frozen=True)
class Imported:
    """What ModelBuilder.add_mjcf made of MJCF: one world.

    builder  newton.ModelBuilder
    bodies   by number of MuJoCo's, the builder's; -1 for the world
    joints   by number of MuJoCo's, the builder's, which may have several of MuJoCo's
    at_q     by number of MuJoCo's joint, where its first number is in joint_q, and
    at_qd    where it is in joint_qd
    layout   where the fields of a recording are
    """

    builder: Any
    bodies: NDArray[np.int64]
    joints: NDArray[np.int64]
    at_q: NDArray[np.int64]
    at_qd: NDArray[np.int64]
    layout: ModelLayout


def import_mjcf(scene: Scene, compiled: MjcfModel, *, direct: bool, prepare: Callable[[Any], None]) -> Imported:
    """Read a model's files, or the MJCF of a registered scene, with newton.ModelBuilder.add_mjcf.

    compiled  the same MJCF as MuJoCo compiles it
    direct    actuators are MuJoCo's and are given controls; else servos are Newton's joint targets
    prepare   sets defaults of a new builder, before it has any shapes

    Refused where Newton does not read them, or where what it makes of them has other bodies or joints.
    """
    import newton

    gravity_off = disabled(compiled.model, "GRAVITY")
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0) if gravity_off else scene.gravity)
    prepare(builder)
    with empty_folder() as folder:
        main = _placed(scene, compiled, folder)
        _as_it_reads(folder)
        try:
            # MuJoCo's equalities are MuJoCo's: as loop joints they would add coordinates that no recording has
            builder.add_mjcf(str(main), ctrl_direct=direct, convert_mjc_equality_constraints=False)
        except (ValueError, NotImplementedError, KeyError, IndexError, OSError, ImportError) as error:
            said = " ".join(str(error).replace(str(folder), "").split())
            raise Refused(f"Newton's importer does not read {_file(scene)}: {type(error).__name__}: {said}") from None
    return _matched(_file(scene), compiled, builder)


def _placed(scene: Scene, compiled: MjcfModel, folder: Path) -> Path:
    # the MJCF that is to be read, in this folder
    if not isinstance(scene, ModelScene):
        path = folder / _file(scene)
        write_file(path, compiled.xml.encode(), durable=False)
        return path
    main = unpack(scene.archive, folder)
    return _as_mjcf(main) if ET.parse(main).getroot().tag == "robot" else main


def _file(scene: Scene) -> str:
    return scene.file if isinstance(scene, ModelScene) else SCENE_FILE


def _as_mjcf(urdf: Path) -> Path:
    """What MuJoCo makes of a URDF file, as MJCF in the same folder, so that paths hold: Newton's importers differ."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(urdf))
    spec.compile()
    path = urdf.with_name(f"{urdf.stem}-as-mjcf.xml")
    write_file(path, spec.to_xml().encode(), durable=False)
    return path


def _as_it_reads(folder: Path) -> None:
    # The importer stops at solver="PGS" and warns of the flag autoreset. Which solver is used is an option of the
    # simulator, and always given; Newton never resets a state that went bad.
    for path in folder.rglob("*.xml"):
        tree = ET.parse(path)
        options = [option for option in tree.iter("option") if option.get("solver", "").lower() == "pgs"]
        flags = [flag for flag in tree.iter("flag") if "autoreset" in flag.attrib]
        for option in options:
            del option.attrib["solver"]
        for flag in flags:
            del flag.attrib["autoreset"]
        if options or flags:
            write_file(path, ET.tostring(tree.getroot()), durable=False)


def _matched(file: str, compiled: MjcfModel, builder: Any) -> Imported:
    model = compiled.model
    joint_of: dict[int, int] = {}  # of a body in the builder, the joint that it hangs on
    for joint, child in enumerate(builder.joint_child):
        joint_of.setdefault(int(child), joint)
    bodies = _bodies(file, model, builder, joint_of)
    joints, at_q, at_qd = (np.full(model.njnt, -1, dtype=np.int64) for _ in range(3))
    for body in range(1, model.nbody):
        own = [j for j in range(model.njnt) if model.jnt_bodyid[j] == body]
        joint = joint_of[int(bodies[body])]
        kind = _kind(builder, joint)
        wanted = [int(model.jnt_type[j]) for j in own]
        slides = [j for j in own if model.jnt_type[j] == _SLIDE]
        simple = kind not in _KINDS
        if simple and not {_FREE, _BALL} & set(wanted):
            order = [*slides, *(j for j in own if j not in slides)]  # slides come first in Newton's joint
            if order != own:
                raise Refused(
                    f"Newton puts the slides of body '{_name(model, body)}' before its hinges, and {file} has "
                    "them in another order, which moves otherwise"
                )
            count = builder.joint_dof_dim[joint]
            if sum(count) != len(own):
                raise _other_joints(file, model, body, kind)
            places = [(builder.joint_q_start[joint] + k, builder.joint_qd_start[joint] + k) for k in range(len(own))]
        elif wanted == [{"FREE": _FREE, "BALL": _BALL}.get(kind)]:
            places = [(builder.joint_q_start[joint], builder.joint_qd_start[joint])]
        else:
            raise _other_joints(file, model, body, kind)
        for j, (q, qd) in zip(own, places, strict=True):
            joints[j], at_q[j], at_qd[j] = joint, q, qd
    layout = _layout(compiled, builder, bodies, at_q, at_qd)
    builder.joint_q[:], builder.joint_qd[:] = layout.joint_q.tolist(), layout.joint_qd.tolist()
    return Imported(builder, bodies, joints, at_q, at_qd, layout)


def _bodies(file: str, model: Any, builder: Any, joint_of: dict[int, int]) -> NDArray[np.int64]:
    """By number of MuJoCo's bodies, the builder's: those of the same parent by name, those without a name in order."""
    children: dict[int, list[int]] = {}
    for body in range(builder.body_count):
        children.setdefault(int(builder.joint_parent[joint_of[body]]), []).append(body)
    found = np.full(model.nbody, -1, dtype=np.int64)
    for parent in range(model.nbody):
        own = [body for body in range(1, model.nbody) if model.body_parentid[body] == parent]
        left = children.get(int(found[parent]), [])
        if len(left) != len(own):
            raise Refused(
                f"Newton makes {len(left)} bodies of the {len(own)} that hang on '{_name(model, parent)}' as MuJoCo "
                f"compiles {file}, such as bodies that MuJoCo merges (fusestatic)"
            )
        for body in sorted(own, key=lambda b: not model.body(b).name):
            label = "/" + model.body(body).name.replace("-", "_")  # as newton's sanitize_name
            named = (b for b in left if builder.body_label[b].endswith(label))
            match = next(named, None) if model.body(body).name else left[0]
            if match is None:
                raise Refused(f"Newton's importer makes no body '{_name(model, body)}' of {file}")
            left.remove(match)
            found[body] = match
    return found


def _layout(
    compiled: MjcfModel,
    builder: Any,
    bodies: NDArray[np.int64],
    at_q: NDArray[np.int64],
    at_qd: NDArray[np.int64],
) -> ModelLayout:
    model = compiled.model
    parts: list[StateGroup] = []
    for part in compiled.layout:
        addresses = np.asarray(model.jnt_qposadr)
        joints = [int(np.flatnonzero(addresses == first)[0]) for first in part.at_qpos[:, 0]]
        widths = part.widths
        q, qd = (at[joints][:, None] + np.arange(width) for at, width in zip((at_q, at_qd), widths, strict=True))
        match part:
            case FreeBodies():
                centres = np.array([list(builder.body_com[bodies[model.jnt_bodyid[j]]]) for j in joints])
                parts.append(NewtonFreeBodies(part.group, part.names, q, qd, centres=centres.astype(np.float32)))
            case Joints():
                reference = model.qpos0[part.at_qpos].astype(np.float32)
                parts.append(NewtonJoints(part.group, part.names, q, qd, slides=part.slides, reference=reference))
            case Balls():
                parts.append(NewtonBalls(part.group, part.names, q, qd))
    joint_q = np.array(builder.joint_q, dtype=np.float64)
    joint_qd = np.array(builder.joint_qd, dtype=np.float64)
    blank = ModelLayout(tuple(parts), joint_q, joint_qd)
    first = compiled.split(compiled.qpos0[None], compiled.qvel0[None])
    first_q, first_qd = blank.joined(first)
    return ModelLayout(tuple(parts), first_q[0], first_qd[0])


def _kind(builder: Any, joint: int) -> str:
    import newton

    return str(newton.JointType(builder.joint_type[joint]).name)


def _name(model: Any, body: int) -> str:
    return str(model.body(body).name or f"body{body}")


def _other_joints(file: str, model: Any, body: int, kind: str) -> Refused:
    return Refused(
        f"Newton's importer makes one joint of kind {kind} of the joints of body '{_name(model, body)}' in {file}"
    )
