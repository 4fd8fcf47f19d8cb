"""The parameters that an engine of MuJoCo's family holds: MjModel, mujoco_warp.Model and mjx.Model name them alike.

Names come from the compiled model, whose numbering the others keep; every number is read from the engine's own model.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtBias, mjtDyn, mjtEq, mjtGain, mjtGeom, mjtJoint, mjtObj, mjtTrn, mjtWrap
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.model import actuator_names
from gpusimbench.schemas.imported import PARAMETERS, Imported, Values

Read = Callable[[str], NDArray[Any]]
"""An array of the engine's model by its name in MjModel, "opt." before those of options; AttributeError without it."""

_DOFS = 6  # of a free joint, which has the most

_PLAIN = {
    "bodies": {
        "position": "body_pos", "orientation": "body_quat", "mass": "body_mass", "centre_of_mass": "body_ipos",
        "gravity_compensation": "body_gravcomp",
    },
    "joints": {"stiffness": "jnt_stiffness"},
    "geoms": {
        "friction": "geom_friction", "condim": "geom_condim", "contype": "geom_contype",
        "conaffinity": "geom_conaffinity",
        "priority": "geom_priority", "solref": "geom_solref", "solimp": "geom_solimp", "solmix": "geom_solmix",
        "margin": "geom_margin", "gap": "geom_gap",
    },
    "pairs": {
        "condim": "pair_dim", "friction": "pair_friction", "solref": "pair_solref", "solimp": "pair_solimp",
        "margin": "pair_margin", "gap": "pair_gap",
    },
    "tendons": {
        "stiffness": "tendon_stiffness", "spring_length": "tendon_lengthspring", "damping": "tendon_damping",
        "armature": "tendon_armature", "frictionloss": "tendon_frictionloss",
    },
    "equalities": {"active": "eq_active0", "solref": "eq_solref", "solimp": "eq_solimp"},
    "actuators": {
        "gain": "actuator_gainprm", "bias": "actuator_biasprm", "dynamics": "actuator_dynprm",
    },
}  # fmt: skip
_RANGES = {
    "joints/range": ("jnt_limited", "jnt_range"),
    "joints/force_range": ("jnt_actfrclimited", "jnt_actfrcrange"),
    "tendons/range": ("tendon_limited", "tendon_range"),
    "tendons/force_range": ("tendon_actfrclimited", "tendon_actfrcrange"),
    "actuators/control_range": ("actuator_ctrllimited", "actuator_ctrlrange"),
    "actuators/force_range": ("actuator_forcelimited", "actuator_forcerange"),
    "actuators/activation_range": ("actuator_actlimited", "actuator_actrange"),
}
_OF_BODIES = {"bodies/parent": "body_parentid", "joints/body": "jnt_bodyid", "geoms/body": "geom_bodyid"}
_OF_LIMITS = {"joints/limit_solref": "jnt_solref", "joints/limit_solimp": "jnt_solimp", "joints/margin": "jnt_margin"}
_OF_DOFS = {
    "joints/damping": "dof_damping", "joints/armature": "dof_armature", "joints/frictionloss": "dof_frictionloss",
}  # fmt: skip
_OF_KINDS = {  # of joints, and the kinds of which it has a meaning: others turn about nothing
    "joints/anchor": ("jnt_pos", (mjtJoint.mjJNT_HINGE, mjtJoint.mjJNT_BALL)),
    "joints/axis": ("jnt_axis", (mjtJoint.mjJNT_HINGE, mjtJoint.mjJNT_SLIDE)),
}
_WORDS = {
    "joints/type": ("jnt_type", mjtJoint), "geoms/type": ("geom_type", mjtGeom), "equalities/type": ("eq_type", mjtEq),
    "actuators/gain_type": ("actuator_gaintype", mjtGain), "actuators/bias_type": ("actuator_biastype", mjtBias),
    "actuators/dynamics_type": ("actuator_dyntype", mjtDyn),
}  # fmt: skip
_DATA = {  # of an equality constraint, how many of its numbers have a meaning
    mjtEq.mjEQ_CONNECT: 6, mjtEq.mjEQ_WELD: 11, mjtEq.mjEQ_JOINT: 5, mjtEq.mjEQ_TENDON: 5,
}  # fmt: skip
_SIZES = {  # of a geom, likewise: compilers keep what they like in the rest; planes have no edge
    mjtGeom.mjGEOM_PLANE: 0, mjtGeom.mjGEOM_SPHERE: 1, mjtGeom.mjGEOM_CAPSULE: 2, mjtGeom.mjGEOM_CYLINDER: 2,
    mjtGeom.mjGEOM_ELLIPSOID: 3, mjtGeom.mjGEOM_BOX: 3,
}  # fmt: skip


def imported(model: Any, read: Read, engine: str, names: Mapping[str, Sequence[str]] | None = None) -> Imported:
    """What an engine holds.

    model   the mujoco.MjModel with the names
    read    the engine's own arrays
    engine  its name, for the reasons why something is not there
    names   by kind, of bodies, joints, geoms or actuators, where they are others than in the MjModel
    """
    reader = _Reader(model, read, names or {})
    values: dict[str, Values] = {}
    unread: dict[str, str] = {}
    for parameter in PARAMETERS:
        if not reader.names[parameter.kind]:
            continue
        try:
            rows = np.asarray(reader.rows(parameter.kind, parameter.name))
        except AttributeError as error:
            unread[parameter.key] = f"{engine} has no {error.name}"
            continue
        rows = rows.reshape(len(rows), -1)
        values[parameter.key] = rows if rows.dtype.kind == "U" else rows.astype(np.float64)
    return Imported(reader.names, values, unread)


def of_c(model: Any) -> Imported:
    """What MuJoCo C holds in a mujoco.MjModel."""

    def read(name: str) -> NDArray[Any]:
        owner, _, field = name.rpartition(".")
        return np.asarray(getattr(model.opt if owner else model, field))

    return imported(model, read, "MuJoCo C")


class _Reader:
    def __init__(self, model: Any, read: Read, names: Mapping[str, Sequence[str]]) -> None:
        self._model, self._read = model, read
        self._body = _named(names.get("bodies") or [model.body(i).name or f"body{i}" for i in range(model.nbody)])
        self._joint = _named(
            names.get("joints") or [model.joint(i).name or self._joint_name(i) for i in range(model.njnt)]
        )
        self._geom = _named(
            names.get("geoms") or [model.geom(i).name or self._geom_name(i) for i in range(model.ngeom)]
        )
        self._site = [model.site(i).name or f"site{i}" for i in range(model.nsite)]
        self._tendon = _named([model.tendon(i).name or f"tendon{i}" for i in range(model.ntendon)])
        self._actuator = _named(names.get("actuators") or actuator_names(model))
        self.names: dict[str, tuple[str, ...]] = {
            "model": ("model",),
            "bodies": self._body,
            "joints": self._joint,
            "geoms": self._geom,
            "pairs": _named(
                [
                    " - ".join(sorted((self._geom[int(a)], self._geom[int(b)])))
                    for a, b in zip(read("pair_geom1"), read("pair_geom2"), strict=True)
                ]
            ),
            "excludes": _named(
                [
                    " - ".join(sorted((self._body[int(pair) >> 16], self._body[int(pair) & 0xFFFF])))
                    for pair in read("exclude_signature")
                ]
            ),
            "tendons": self._tendon,
            "equalities": _named([self._equality_name(i) for i in range(len(read("eq_type")))]),
            "actuators": self._actuator,
        }

    def _joint_name(self, joint: int) -> str:
        # of its body, and its number there: a joint that is missing elsewhere changes no other's name
        body = int(self._model.jnt_bodyid[joint])
        return f"{self._body[body]}/joint{joint - int(self._model.body_jntadr[body])}"

    def _geom_name(self, geom: int) -> str:
        body = int(self._model.geom_bodyid[geom])
        return f"{self._body[body]}/geom{geom - int(self._model.body_geomadr[body])}"

    def _equality_name(self, index: int) -> str:
        if name := self._model.equality(index).name if index < self._model.neq else "":
            return str(name)
        return f"{_word(mjtEq, self._read('eq_type')[index])} {self._objects(index)}"

    def rows(self, kind: str, name: str) -> NDArray[Any] | Sequence[Any]:
        """A row for each thing of the kind."""
        if kind == "model":
            return self._read(f"opt.{name}").reshape(1, -1)
        if field := _PLAIN.get(kind, {}).get(name):
            return self._read(field)
        key = f"{kind}/{name}"
        if pair := _RANGES.get(key):
            limited, found = (self._read(field) for field in pair)
            ranges = np.where(limited.reshape(-1, 1).astype(bool), found, [[-np.inf, np.inf]])
            return self._by_actuator(ranges, "ctrl") if key == "actuators/control_range" else ranges
        if field := _OF_BODIES.get(key):
            return [self._body[int(body)] for body in self._read(field)]
        if field := _OF_LIMITS.get(key):
            limited = self._read("jnt_limited").astype(bool).reshape(-1, 1)
            return np.where(limited, self._read(field).reshape(len(limited), -1), np.nan)
        if field := _OF_DOFS.get(key):
            values, of = self._read(field), self._read("dof_jntid")
            return np.array([_first(values[of == joint], _DOFS) for joint in range(len(self._joint))])
        if key in _OF_KINDS:
            field, kinds = _OF_KINDS[key]
            meant = np.isin(self._read("jnt_type"), [int(one) for one in kinds])
            return np.where(meant[:, np.newaxis], self._read(field), np.nan)
        if key in _WORDS:
            field, words = _WORDS[key]
            return [_word(words, number) for number in self._read(field)]
        rows: NDArray[Any] | Sequence[Any] = getattr(self, f"_{kind}_{name}")()
        return rows

    def _bodies_inertia(self) -> NDArray[np.float64]:
        moments, turned = self._read("body_inertia"), self._read("body_iquat")
        return np.array([tensor(row, quat) for row, quat in zip(moments, turned, strict=True)])

    def _joints_reference(self) -> Sequence[float]:
        return self._of_single("qpos0")

    def _joints_spring_reference(self) -> NDArray[np.float64]:
        return np.where(self._read("jnt_stiffness") != 0, self._of_single("qpos_spring"), np.nan)

    def _of_single(self, field: str) -> Sequence[float]:
        # of hinges and slides; of others it is a pose, of which the body's is
        values = self._read(field)
        single = (int(mjtJoint.mjJNT_HINGE), int(mjtJoint.mjJNT_SLIDE))
        kinds, places = self._read("jnt_type"), self._read("jnt_qposadr")
        return [
            float(values[int(at)]) if int(kind) in single else np.nan for kind, at in zip(kinds, places, strict=True)
        ]

    def _geoms_size(self) -> NDArray[np.float64]:
        kinds, sizes = self._read("geom_type"), self._read("geom_size")
        found = [_first(size, _SIZES.get(mjtGeom(int(kind)), 0)) for kind, size in zip(kinds, sizes, strict=True)]
        return self._with_boxes(np.array(found), 1)

    def _geoms_position(self) -> NDArray[np.float64]:
        return self._with_boxes(np.array(self._read("geom_pos"), dtype=np.float64), 0)

    def _geoms_orientation(self) -> NDArray[np.float64]:
        found = np.array(self._read("geom_quat"), dtype=np.float64)
        found[self._read("geom_type") == int(mjtGeom.mjGEOM_MESH)] = np.nan
        return found

    def _with_boxes(self, rows: NDArray[np.float64], which: int) -> NDArray[np.float64]:
        # Each compiler moves a mesh into a frame of its own. What a mesh is in the end is compared by the box around
        # its points, along the body's axes: its centre (0) and half its edges (1).
        for geom in np.flatnonzero(self._read("geom_type") == int(mjtGeom.mjGEOM_MESH)):
            mesh = int(self._read("geom_dataid")[geom])
            first, count = (int(self._read(f"mesh_{name}")[mesh]) for name in ("vertadr", "vertnum"))
            turn = rotation(self._read("geom_quat")[geom])
            points = self._read("mesh_vert").reshape(-1, 3)[first : first + count] @ turn.T
            low, high = points.min(axis=0), points.max(axis=0)
            rows[geom] = (high - low) / 2 if which else (low + high) / 2 + self._read("geom_pos")[geom]
        return rows

    def _tendons_path(self) -> Sequence[str]:
        kinds, objects, numbers = (self._read(f"wrap_{name}") for name in ("type", "objid", "prm"))
        paths = []
        for first, count in zip(self._read("tendon_adr"), self._read("tendon_num"), strict=True):
            parts = range(int(first), int(first) + int(count))
            paths.append(", ".join(self._wrap(int(kinds[i]), int(objects[i]), float(numbers[i])) for i in parts))
        return paths

    def _wrap(self, kind: int, number: int, parameter: float) -> str:
        if kind == int(mjtWrap.mjWRAP_JOINT):
            return f"joint {self._joint[number]} * {parameter:.6g}"
        if kind == int(mjtWrap.mjWRAP_SITE):
            return f"site {self._site[number]}"
        if kind == int(mjtWrap.mjWRAP_PULLEY):
            return f"pulley {parameter:.6g}"
        return f"geom {self._geom[number]}" if 0 <= number < len(self._geom) else _word(mjtWrap, kind)

    def _equalities_objects(self) -> Sequence[str]:
        return [self._objects(index) for index in range(len(self.names["equalities"]))]

    def _objects(self, index: int) -> str:
        kind = int(self._read("eq_type")[index])
        objects = [int(self._read(name)[index]) for name in ("eq_obj1id", "eq_obj2id")]
        of = {int(mjtEq.mjEQ_JOINT): self._joint, int(mjtEq.mjEQ_TENDON): self._tendon}.get(kind, self._body)
        if int(self._read("eq_objtype")[index]) == int(mjtObj.mjOBJ_SITE):
            of = tuple(self._site)
        return " - ".join(of[number] for number in objects if 0 <= number < len(of))

    def _equalities_data(self) -> NDArray[np.float64]:
        kinds, data = self._read("eq_type"), self._read("eq_data")
        most = max(_DATA.values())
        used = [_first(row, _DATA.get(mjtEq(int(kind)), 0)) for kind, row in zip(kinds, data, strict=True)]
        return np.array([_first(row, most) for row in used])

    def _by_actuator(self, rows: NDArray[Any], of: str) -> NDArray[Any]:
        """Rows of controls ("ctrl") or of outputs ("out") as a row for each actuator, some of which have several of
        them: NaN where another actuator has more."""
        counts = getattr(self._model, f"actuator_{of}num", np.empty(0))  # releases before 4.0 have one for each
        if (counts == 1).all() or len(rows) != counts.sum():
            return rows
        widest = int(counts.max()) * rows.shape[1]
        return np.array([_first(part.ravel(), widest) for part in np.split(rows, np.cumsum(counts)[:-1])])

    def _actuators_gear(self) -> NDArray[Any]:
        return self._by_actuator(self._read("actuator_gear"), "out")

    def _actuators_target(self) -> Sequence[str]:
        targets = self._read("actuator_trnid").reshape(len(self._actuator), -1)
        kinds = self._read("actuator_trntype")
        return [self._target(mjtTrn(int(kind)), int(row[0])) for kind, row in zip(kinds, targets, strict=True)]

    def _target(self, kind: mjtTrn, number: int) -> str:
        of: Sequence[str] = {
            mjtTrn.mjTRN_JOINT: self._joint,
            mjtTrn.mjTRN_JOINTINPARENT: self._joint,
            mjtTrn.mjTRN_TENDON: self._tendon,
            mjtTrn.mjTRN_SITE: self._site,
            mjtTrn.mjTRN_SLIDERCRANK: self._site,
            mjtTrn.mjTRN_BODY: self._body,
        }.get(kind, ())
        named = of[number] if 0 <= number < len(of) else str(number)
        return f"{_word(mjtTrn, kind)} {named}"


def tensor(moments: NDArray[Any], orientation: NDArray[Any]) -> NDArray[np.float64]:
    """Principal moments [3] and the orientation of their axes, wxyz, as xx, yy, zz, xy, xz, yz."""
    turn = rotation(orientation)
    full = turn @ np.diag(np.asarray(moments, dtype=np.float64)) @ turn.T
    return six(full)


def rotation(orientation: NDArray[Any]) -> NDArray[np.float64]:
    """The matrix [3, 3] of a unit quaternion wxyz."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(orientation, dtype=np.float64))
    return matrix.reshape(3, 3)


def six(full: NDArray[Any]) -> NDArray[np.float64]:
    """A symmetric tensor [3, 3] as xx, yy, zz, xy, xz, yz."""
    return np.array([full[0, 0], full[1, 1], full[2, 2], full[0, 1], full[0, 2], full[1, 2]], dtype=np.float64)


def _first(row: NDArray[Any], count: int) -> NDArray[np.float64]:
    # the first numbers of a row, and NaN for what is missing or has no meaning
    found = np.full(max(len(row), count), np.nan)
    found[: min(count, len(row))] = row[:count]
    return found


def _word(kinds: Any, number: Any) -> str:
    """mjJNT_HINGE as "hinge"."""
    return str(kinds(int(number)).name.partition("_")[2].lower())


def _named(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(_numbered(names))


def _numbered(names: Sequence[str]) -> Iterator[str]:
    # two things of one name are told apart by their order
    seen: Counter[str] = Counter()
    for name in names:
        seen[name] += 1
        yield name if seen[name] == 1 else f"{name}#{seen[name]}"
