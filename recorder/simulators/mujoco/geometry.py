"""What viewers draw of a compiled model: bodies, joints, and the shapes that MuJoCo's viewer shows, meshes cut down;
and its level planes that hold free bodies up, so that a recording can tell what fell through."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtDisableBit, mjtGeom, mjtJoint, mjtWrap
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.model import BALLS, BODIES, JOINTS, moving
from gpusimbench.schemas.view.geometry import MAX_LINKS, MAX_SHAPES

_LEVEL = 1 - 1e-12  # of the normal's component along z


def floors_of(model: Any) -> list[dict[str, Any]]:
    """Planes of a mujoco.MjModel that are level, never move, and collide with every free body or what hangs on it.

    height   of the plane [m]
    reach    no point of a free body, or of what hangs on it, is ever further from the body's origin [m]
    reaches  the same of each free body, by its name
    """
    if model.opt.disableflags & int(mjtDisableBit.mjDSBL_CONTACT | mjtDisableBit.mjDSBL_CONSTRAINT):
        return []
    free = moving(model, mjtJoint.mjJNT_FREE)
    roots = [int(model.jnt_bodyid[joint]) for joint in free.joints]
    solids = [[g for g in range(model.ngeom) if root in _line(model, int(model.geom_bodyid[g]))] for root in roots]
    reaches = [max((_reach(model, root, g) for g in of), default=0.0) for root, of in zip(roots, solids, strict=True)]
    reach = max(reaches, default=0.0)
    if not all(solids) or not 0 < reach < math.inf:
        return []
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    planes = [
        geom
        for geom in np.flatnonzero(model.geom_type == mjtGeom.mjGEOM_PLANE).tolist()
        if not model.body_weldid[model.geom_bodyid[geom]] and data.geom_xmat[geom][8] >= _LEVEL
    ]
    return [
        {
            "height": float(data.geom_xpos[plane][2]),
            "reach": reach,
            "reaches": dict(zip(free.names, reaches, strict=True)),
        }
        for plane in planes
        if all(any(_collide(model, plane, geom) for geom in some) for some in solids)
    ]


def _line(model: Any, body: int) -> Iterator[int]:
    # a body and what it hangs on, up to the world
    while body:
        yield body
        body = int(model.body_parentid[body])


def _reach(model: Any, root: int, geom: int) -> float:
    # bound of the distance from the root's origin: every link stretched out, every slide moved out
    far = float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
    if model.geom_rbound[geom] == 0:
        return math.inf  # a plane
    for body in _line(model, int(model.geom_bodyid[geom])):
        if body == root:
            break
        far += float(np.linalg.norm(model.body_pos[body]))
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            if model.jnt_type[joint] == mjtJoint.mjJNT_SLIDE:
                reference = model.qpos0[model.jnt_qposadr[joint]]
                far += float(np.abs(model.jnt_range[joint] - reference).max()) if model.jnt_limited[joint] else math.inf
            else:  # turns the body about a point that need not be its origin
                far += 2 * float(np.linalg.norm(model.jnt_pos[joint]))
    return far


def _collide(model: Any, plane: int, geom: int) -> bool:
    one, other = sorted((int(model.geom_bodyid[plane]), int(model.geom_bodyid[geom])))
    if (one << 16) + other in model.exclude_signature:
        return False
    types, affinities = model.geom_contype, model.geom_conaffinity
    return bool(types[plane] & affinities[geom] or types[geom] & affinities[plane])


TRIANGLES = 8000
"""Of all meshes that are drawn, together; about 200 kB of JSON."""

_MOST, _LEAST = 800, 60  # triangles of a mesh; where there is no room for the least, its bounding box is drawn
_GROUPS = 3  # of geoms; MuJoCo's viewer shows the first three at the beginning, collision shapes are in others
_PLANE_M = 20.0  # of a plane, so much is drawn at most
_DIGITS = 5  # of a mesh's coordinates, as shares of its size
_JOINTS = {
    int(mjtJoint.mjJNT_FREE): ("free", BODIES),
    int(mjtJoint.mjJNT_HINGE): ("hinge", JOINTS),
    int(mjtJoint.mjJNT_SLIDE): ("slide", JOINTS),
    int(mjtJoint.mjJNT_BALL): ("ball", BALLS),
}
Points = NDArray[np.float64]
Triangles = NDArray[np.int64]
# along the longest side, the most first; np.unique would import numpy.ma, in each recording of MuJoCo's
_CELLS = np.array(sorted({int(cells) for cells in np.geomspace(2, 96, 32)}, reverse=True))


def geometry_of(model: Any) -> bytes:
    """Bodies, joints and shapes of a mujoco.MjModel as geometry.json (schemas.view.geometry), at most a few hundred kB.

    The body that everything hangs on comes first, each other one after its parent. Of a model that is larger than what
    viewers draw, nothing but that it is.
    """
    shapes = _Shapes(model)
    if model.nbody > MAX_LINKS or len(shapes.shown) > MAX_SHAPES:
        said = f"the model has {model.nbody} bodies and {len(shapes.shown)} shapes, which are too many to be drawn"
        return json.dumps({"bodies": [], "simplified": [said]}).encode()
    names = _names(model)
    joints = dict(_joints(model))
    bodies = [
        {
            "name": names[body],
            **({"parent": int(model.body_parentid[body])} if body else {}),
            "position": model.body_pos[body].tolist(),
            "orientation": model.body_quat[body].tolist(),
            "joints": [joints[j] for j in range(model.njnt) if model.jnt_bodyid[j] == body],
            "shapes": shapes.of(body),
        }
        for body in range(model.nbody)
    ]
    record = {"bodies": bodies, "meshes": shapes.meshes, "simplified": list(shapes.simplified())}
    if floors := floors_of(model):
        record["floors"] = floors
    return json.dumps(record, separators=(",", ":")).encode()


def _names(model: Any) -> list[str]:
    names = [model.body(body).name or f"body{body}" for body in range(model.nbody)]
    count = Counter(names)
    return [name if count[name] == 1 or model.body(body).name else f"{name}#" for body, name in enumerate(names)]


def _joints(model: Any) -> Iterator[tuple[int, dict[str, Any]]]:
    for kind, (word, group) in _JOINTS.items():
        found = moving(model, mjtJoint(kind))
        for name, joint in zip(found.names, found.joints, strict=True):
            record: dict[str, Any] = {"kind": word, "group": group, "name": name}
            if word != "free":
                record |= {"anchor": model.jnt_pos[joint].tolist()}
            if group == JOINTS:
                reference = float(model.qpos0[model.jnt_qposadr[joint]])
                record |= {"axis": model.jnt_axis[joint].tolist(), "reference": reference}
            yield joint, record


class _Shapes:
    """The shapes that one sees.

    shown   numbers of their geoms
    meshes  that were needed so far, as of the format
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self.shown = [geom for geom in range(model.ngeom) if self._seen(geom)] or list(range(model.ngeom))
        solid = [geom for geom in self.shown if self._triangles(geom) is not None]
        self._most = min(_MOST, TRIANGLES // max(1, len(solid)))
        self.meshes: list[dict[str, list[Any]]] = []
        self._numbers: dict[tuple[int, int], int | None] = {}  # of meshes, by kind and number in the model
        self._reduced: dict[tuple[int, int], tuple[int, int]] = {}

    def of(self, body: int) -> list[dict[str, Any]]:
        """The shapes of a body."""
        return [self._record(geom) for geom in self.shown if self._model.geom_bodyid[geom] == body]

    def simplified(self) -> Iterator[str]:
        """Sentences: what is drawn otherwise than it is."""
        m = self._model
        if self._reduced:
            left, before = map(sum, zip(*self._reduced.values(), strict=True))
            yield (
                f"{len(self._reduced)} meshes or height fields are drawn with {left} of their {before} triangles: "
                "points near each other are merged"
            )
        if boxes := sum(number is None for number in self._numbers.values()):
            yield f"{boxes} meshes or height fields are drawn as boxes: there is no room for their triangles"
        if hidden := m.ngeom - len(self.shown):
            yield f"{hidden} shapes are not drawn, as in MuJoCo's own viewer: transparent ones, and geom groups 3 to 5"
        others = {
            "flexible bodies": m.nflex,
            "skins": m.nskin,
            "spatial tendons": sum(
                self._visible(m.tendon_group, m.tendon_rgba, m.tendon_matid, t) for t in _spatial(m)
            ),
            "sites": sum(self._visible(m.site_group, m.site_rgba, m.site_matid, site) for site in range(m.nsite)),
        }
        if said := [f"{what} ({n})" for what, n in others.items() if n]:
            yield f"{' and '.join([*([', '.join(said[:-1])] if said[1:] else []), said[-1]])} are not drawn"

    def _seen(self, geom: int) -> bool:
        m = self._model
        return self._visible(m.geom_group, m.geom_rgba, m.geom_matid, geom)

    def _visible(self, groups: Any, colours: Any, materials: Any, number: int) -> bool:
        material = materials[number]
        alphas = [colours[number, 3], *([self._model.mat_rgba[material, 3]] if material >= 0 else [])]
        return bool(groups[number] < _GROUPS and min(alphas) > 0)

    def _record(self, geom: int) -> dict[str, Any]:
        m = self._model
        position, orientation = m.geom_pos[geom].tolist(), m.geom_quat[geom].tolist()
        shape = self._shape(geom)
        if shape["kind"] == "box" and self._triangles(geom) is not None:  # the box about a mesh, not about its origin
            turned = np.zeros(3)
            mujoco.mju_rotVecQuat(turned, m.geom_aabb[geom, :3], m.geom_quat[geom])
            position = (m.geom_pos[geom] + turned).tolist()
        return {"shape": shape, "position": position, "orientation": orientation}

    def _shape(self, geom: int) -> dict[str, Any]:
        m = self._model
        a, b, c = m.geom_size[geom].tolist()
        match int(m.geom_type[geom]):
            case mjtGeom.mjGEOM_PLANE:
                edges = [min(2 * half, _PLANE_M) if half > 0 else _PLANE_M for half in (a, b)]
                return {"kind": "plane", "size": edges}
            case mjtGeom.mjGEOM_SPHERE:
                return {"kind": "sphere", "radius": a}
            case mjtGeom.mjGEOM_CAPSULE:
                return {"kind": "capsule", "radius": a, "length": 2 * b}
            case mjtGeom.mjGEOM_CYLINDER:
                return {"kind": "cylinder", "radius": a, "length": 2 * b}
            case mjtGeom.mjGEOM_ELLIPSOID:
                return {"kind": "ellipsoid", "size": [2 * a, 2 * b, 2 * c]}
            case mjtGeom.mjGEOM_BOX:
                return {"kind": "box", "size": [2 * a, 2 * b, 2 * c]}
        number = self._mesh(geom)
        if number is not None:
            return {"kind": "mesh", "mesh": number}
        return {"kind": "box", "size": (2 * m.geom_aabb[geom, 3:]).tolist()}

    def _triangles(self, geom: int) -> int | None:
        m = self._model
        data = m.geom_dataid[geom]
        match int(m.geom_type[geom]):
            case mjtGeom.mjGEOM_MESH | mjtGeom.mjGEOM_SDF if data >= 0:
                return int(m.mesh_facenum[data])
            case mjtGeom.mjGEOM_HFIELD:
                return 2 * int((m.hfield_nrow[data] - 1) * (m.hfield_ncol[data] - 1))
        return None

    def _mesh(self, geom: int) -> int | None:
        m = self._model
        data = int(m.geom_dataid[geom])
        key = int(m.geom_type[geom]) == mjtGeom.mjGEOM_HFIELD, data
        if key in self._numbers:
            return self._numbers[key]
        self._numbers[key] = None
        before = self._triangles(geom)
        if before and self._most >= _LEAST:
            if key[0]:
                rows, columns, begin = m.hfield_nrow[data], m.hfield_ncol[data], m.hfield_adr[data]
                x, y, top, _ = m.hfield_size[data].tolist()
                whole = grid(top * m.hfield_data[begin : begin + rows * columns].reshape(rows, columns), x, y)
            else:
                points = m.mesh_vert[m.mesh_vertadr[data] :][: m.mesh_vertnum[data]]
                whole = points.astype(np.float64), m.mesh_face[m.mesh_faceadr[data] :][:before].astype(np.int64)
            if found := fewer(*whole, self._most):
                self._numbers[key] = len(self.meshes)
                digits = _DIGITS - math.ceil(math.log10(float(np.ptp(found[0], axis=0).max()) or 1.0))
                self.meshes.append(
                    {"points": found[0].round(digits).ravel().tolist(), "triangles": found[1].ravel().tolist()}
                )
                if len(found[1]) < before:
                    self._reduced[key] = len(found[1]), before
        return self._numbers[key]


def _spatial(model: Any) -> list[int]:
    """Tendons that run through space, and are no sums of joints."""
    return [t for t in range(model.ntendon) if model.wrap_type[model.tendon_adr[t]] != mjtWrap.mjWRAP_JOINT]


def fewer(points: Points, triangles: Triangles, most: int) -> tuple[Points, Triangles] | None:
    """A mesh of at most so many triangles: points within a cell of a grid become their mean, and triangles that lose a
    corner are left out (vertex clustering, Rossignac and Borrel 1993). None where even the coarsest grid leaves more.

    points     [point, 3]
    triangles  [triangle, 3], numbers of points
    """
    found = _used(points, triangles)
    if len(found[1]) <= most:
        return found
    points, triangles = found
    low, longest = points.min(axis=0), float(np.ptp(points, axis=0).max())
    for cells in _CELLS:
        place = np.minimum((points - low) / longest * cells, cells - 1).astype(np.int64)
        _, cell = np.unique(place @ (1, cells, cells**2), return_inverse=True)
        left = np.unique(_turned(cell[triangles]), axis=0)
        left = left[(left[:, 0] != left[:, 1]) & (left[:, 1] != left[:, 2]) & (left[:, 2] != left[:, 0])]
        if 0 < len(left) <= most:
            count = np.bincount(cell)
            means = [np.bincount(cell, weights=points[:, axis]) / count for axis in range(3)]
            return _used(np.stack(means, axis=1), left)
    return None


def grid(heights: NDArray[np.float64], x: float, y: float) -> tuple[Points, Triangles]:
    """A surface of heights [row, column] [m] above a rectangle from -x to x and from -y to y, seen from above."""
    rows, columns = heights.shape
    at_x, at_y = np.meshgrid(np.linspace(-x, x, columns), np.linspace(-y, y, rows))
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    corners = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([at_x, at_y, heights], axis=-1).reshape(-1, 3), corners


def _used(points: Points, triangles: Triangles) -> tuple[Points, Triangles]:
    kept, corners = np.unique(triangles, return_inverse=True)
    return points[kept], corners.reshape(-1, 3)


def _turned(triangles: Triangles) -> Triangles:
    # the same triangles, each from its lowest number on
    first = triangles.argmin(axis=1)[:, np.newaxis]
    return np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
