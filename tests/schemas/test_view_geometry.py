"""What a view draws has the size and the place of the body; what of a stranger's file is drawn, and what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from gpusimbench.schemas.checks import load
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField, ball_fields, body_fields, joint_field
from gpusimbench.schemas.view import geometry
from gpusimbench.schemas.view.foxglove import entity
from gpusimbench.schemas.view.geometry import GEOMETRY, Shape, Solid, links_of, look_of, solids_of
from gpusimbench.schemas.view.kinematics import Link
from gpusimbench.schemas.view.motion import Motion
from gpusimbench.schemas.view.recorded import EnvView

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
LYING = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)  # z to x
COLOUR = (0.1, 0.2, 0.3)


def size(primitive: object) -> tuple[float, float, float]:
    """Of a primitive along its axes [m]."""
    found = primitive.size  # type: ignore[attr-defined]
    return found.x, found.y, found.z


def place(primitive: object) -> tuple[float, float, float]:
    """Of a primitive's centre [m]."""
    found = primitive.pose.position  # type: ignore[attr-defined]
    return found.x, found.y, found.z


def test_a_capsule_is_a_tube_with_two_ends() -> None:
    """Draw a cylinder of the capsule's diameter and length, and a ball of its diameter around each end."""
    shape = Shape("capsule", (0.25, 2.0), position=(1.0, 2.0, 3.0), orientation=LYING)
    drawn = entity(5, "frame", "name", [shape], COLOUR)
    (tube,) = drawn.cylinders
    assert size(tube) == (0.5, 0.5, 2.0)
    assert (tube.bottom_scale, tube.top_scale) == (1.0, 1.0)
    assert place(tube) == (1.0, 2.0, 3.0)
    assert [size(ball) for ball in drawn.spheres] == [(0.5, 0.5, 0.5)] * 2
    assert [place(ball) for ball in drawn.spheres] == [pytest.approx((0.0, 2.0, 3.0)), pytest.approx((2.0, 2.0, 3.0))]
    assert [c.a for c in (tube.color, *(ball.color for ball in drawn.spheres))] == [1.0] * 3


def test_a_box_and_a_ball() -> None:
    """Draw a box of its edges and a ball of its diameter."""
    shapes = [
        Shape("box", (1.0, 2.0, 3.0), position=(0.0, 0.0, 1.0), orientation=UPRIGHT),
        Shape("sphere", (0.25,), position=(0.0, 1.0, 0.0), orientation=UPRIGHT),
    ]
    drawn = entity(5, "frame", "name", shapes, COLOUR)
    assert [size(box) for box in drawn.cubes] == [(1.0, 2.0, 3.0)]
    assert [size(ball) for ball in drawn.spheres] == [(0.5, 0.5, 0.5)]
    assert (drawn.frame_id, drawn.id, drawn.frame_locked) == ("frame", "name", True)


def test_what_a_scene_leaves_out() -> None:
    """Put bodies and links without a pose at the origin of their frame, upright."""
    box = {"kind": "box", "size": [1, 2, 3]}
    (wall,) = solids_of({"bodies": [{"name": "wall", "shape": box}]})
    assert wall.shapes == (Shape("box", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0), UPRIGHT),)
    assert links_of({"robot": {"links": [{"name": "hand"}]}}) == (Link("hand", None, (0.0, 0.0, 0.0), UPRIGHT),)


def test_shapes_that_are_known() -> None:
    """Draw boxes, balls, capsules and planes of a scene, and of anything else its frame alone."""
    shapes = [
        {"kind": "sphere", "radius": 0.25}, {"kind": "capsule", "radius": 0.25, "length": 2}, {"kind": "plane"},
        {"kind": "teapot"},
    ]  # fmt: skip
    bodies = [{"name": str(n), "group": "g", "mass": 1.0, "shape": one} for n, one in enumerate(shapes)]
    ball, capsule, plane, teapot = solids_of({"bodies": bodies})
    assert ball == Solid("0", "g", (Shape("sphere", (0.25,)),))
    assert capsule.shapes == (Shape("capsule", (0.25, 2.0)),)
    assert [(one.kind, one.size[:2]) for one in plane.shapes] == [("box", (4.0, 4.0))]
    assert teapot.shapes == ()


@pytest.mark.parametrize(
    "links",
    [
        [{"name": "a"}, {"name": "a"}],
        [{"name": "b", "parent": "a"}, {"name": "a"}],
        [{"name": ""}],
        [{"name": str(n)} for n in range(1001)],
    ],
)
def test_links_that_make_no_robot(links: list[dict[str, str]]) -> None:
    """Refuse links of one name, before their parent, and more than are drawn."""
    with pytest.raises(DamagedRecording):
        links_of({"robot": {"links": links}})
    assert len(links_of({"robot": {"links": [{"name": str(n)} for n in range(1000)]}})) == 1000


GOOD: dict[str, Any] = {
    "bodies": [
        {"name": "world", "shapes": [{"shape": {"kind": "plane"}}]},
        {"name": "cart", "parent": 0, "joints": [{"kind": "free", "group": "bodies", "name": "cart"}],
         "shapes": [{"shape": {"kind": "mesh", "mesh": 0}, "position": [0, 0, 1]}]},
        {"name": "pole", "parent": 1, "joints": [
            {"kind": "hinge", "group": "joints", "name": "turn", "axis": [0, 1, 0], "reference": 0},
            {"kind": "ball", "group": "balls", "name": "swing"}]},
        {"name": "tip", "parent": 2, "position": [0, 0, 1], "shapes": [{"shape": {"kind": "sphere", "radius": 1}}]},
    ],
    "meshes": [{"points": [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1], "triangles": [0, 1, 2, 0, 3, 1]}],
    "simplified": ["a sentence"],
}  # fmt: skip

FIELDS: tuple[StateField, ...] = (
    *body_fields({"bodies": ("cart",)}, "float64", {}),
    joint_field("joints", "qpos", "float64", ("turn",)),
    *ball_fields("balls", "float64", ("swing",)),
)


def changed(path: str, value: object) -> dict[str, Any]:
    """A good geometry with another value at a path such as "bodies.1.parent"."""
    record = deepcopy(GOOD)
    *parents, last = (int(part) if part.isdigit() else part for part in path.split("."))
    at: Any = record
    for part in parents:
        at = at[part]
    at[last] = value
    return record


def test_frames_and_entities() -> None:
    """Hang each body on the frame of its parent, and draw shapes in the frames that they move with."""
    look = look_of({"bodies": "not read beside a geometry"}, load(GEOMETRY, json.dumps(GOOD)))
    motion = Motion(FIELDS, look)
    assert [(p.group, p.name, p.parent) for p in motion.parts] == [
        ("bodies", "cart", None), ("robot", "pole", 0), ("robot", "tip", 1),
    ]  # fmt: skip
    view = EnvView(3, (0.0, 0.0, 0.0), motion, look.solids)
    assert [(e.id, e.frame_id) for e in view.entities()] == [
        ("env3/world", "env3"), ("env3/cart", "env3/cart"), ("env3/tip", "env3/tip"),
    ]  # fmt: skip
    frames = motion.frames([np.ones((1, len(f.items), f.width)) for f in motion.fields])
    pairs = [(t.parent_frame_id, t.child_frame_id) for t in view.transforms(frames, 0, 0)]
    assert pairs == [("world", "env3"), ("env3", "env3/cart"), ("env3/cart", "env3/pole"), ("env3/pole", "env3/tip")]
    assert look.notes == ("a sentence",)


def test_a_mesh_is_its_triangles() -> None:
    """Draw the points and corners of a mesh at its pose, a cylinder as one, an ellipsoid by its diameters."""
    shapes = [*look_of({}, GOOD).solids[1].shapes]
    for shape in ({"kind": "cylinder", "radius": 1, "length": 3}, {"kind": "ellipsoid", "size": [1, 2, 3]}):
        shapes += look_of({}, changed("bodies.3.shapes.0.shape", shape)).solids[3].shapes
    drawn = entity(5, "frame", "name", shapes, (0.1, 0.2, 0.3))
    (mesh,) = drawn.triangles
    assert [(p.x, p.y, p.z) for p in mesh.points] == [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    assert list(mesh.indices) == [0, 1, 2, 0, 3, 1]
    assert (mesh.pose.position.z, mesh.pose.orientation.w, mesh.color.a) == (1, 1, 1)
    assert [(c.size.x, c.size.y, c.size.z, c.top_scale) for c in drawn.cylinders] == [(2, 2, 3, 1)]
    assert [(s.size.x, s.size.y, s.size.z) for s in drawn.spheres] == [(1, 2, 3)]


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("bodies", 3, "bodies is not a list"),
        ("bodies", [{"name": str(at), "parent": 0} for at in range(1001)], "more than 1000 bodies"),
        ("bodies.1.parent", 1, "parent is not a whole number from 0 to 0"),
        ("bodies.2.parent", -1, "parent is not a whole number"),
        ("bodies.3.name", "pole", "there twice"),
        ("bodies.1.joints.0.group", "", "of no group"),
        ("bodies.2.joints.0.kind", "free", "of no kind that is known beside others"),
        ("bodies.2.joints.0.axis", [0, 2, 0], "an axis is not of length 1"),
        ("bodies.2.joints.0.axis", [0, 1e308, 1e308], "an axis is not of length 1"),
        ("bodies.2.joints.0.anchor", [0, 2e6, 0], "an anchor is further"),
        ("bodies.2.joints.0.reference", "x", "reference is not a number"),
        ("bodies.2.joints", GOOD["bodies"][2]["joints"] * 9, "has 18 joints"),
        ("bodies.2.orientation", [0, 0, 0, 0], "an orientation is not of length 1"),
        ("bodies.2.position", [0, 0, 1e9], "a position is further"),
        ("bodies.3.shapes", [{"shape": {"kind": "sphere", "radius": 1}}] * 4001, "4000 shapes"),
        ("bodies.3.shapes.0.shape", {"kind": "box", "size": [1, -1, 1]}, "a size that is not from 0"),
        ("bodies.1.shapes.0.shape.mesh", 1, "mesh is not a whole number from 0 to 0"),
        ("meshes", [], "mesh is not a whole number from 0 to -1"),
        ("meshes.0.points", [0, 0, 0, 1], "a mesh of 4 coordinates"),
        ("meshes.0.points", [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1e7], "a mesh has a point further"),
        ("meshes.0.points", [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, "z"], "the points of a mesh is not a list"),
        ("meshes.0.triangles", [0, 1, 4], "a corner that is none of its points"),
        ("meshes.0.triangles", [0, 1, True], "a corner that is none of its points"),
        ("meshes.0.triangles", [], "a mesh of 12 coordinates and 0 corners"),
        ("simplified", [3], "simplified is not a text"),
    ],
)  # fmt: skip
def test_nonsense(path: str, value: object, said: str) -> None:
    """Refuse what no recorder writes, and say what."""
    look_of({}, GOOD)
    with pytest.raises(DamagedRecording, match=said):
        look_of({}, changed(path, value))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("bodies.3.shapes.0.shape", lambda far: {"kind": "box", "size": [far, 0, 1]}),
        ("bodies.2.joints.0.anchor", lambda far: [0, -far, 0]),
        ("bodies.2.position", lambda far: [0, 0, far]),
        ("meshes.0.points", lambda far: [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, -far / 2]),
    ],
)
def test_how_far_a_view_reaches(path: str, value: Callable[[float], object]) -> None:
    """Read lengths up to a million metres, zero among them, and none beyond."""
    look_of({}, changed(path, value(1e6)))
    with pytest.raises(DamagedRecording, match="further than|a size that is not from 0 to 1e\\+06 m"):
        look_of({}, changed(path, value(float(np.nextafter(1e6, 2e6)))))


def test_no_more_triangles_than_are_drawn() -> None:
    """Count a mesh as often as a shape names it, so that a small file cannot ask for a large drawing."""
    record = changed("meshes.0.triangles", [0, 1, 2] * 1000)
    record["bodies"][3]["shapes"] = [{"shape": {"kind": "mesh", "mesh": 0}}] * (geometry.MAX_TRIANGLES // 1000)
    with pytest.raises(DamagedRecording, match="more than 65536 triangles"):
        look_of({}, record)
    record["bodies"][3]["shapes"].pop()
    look_of({}, record)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        (FIELDS[:5], "no balls/orientation of the joint 'swing'"),
        (FIELDS[4:], "no pose of the body that 'pole' hangs on"),
        (
            (*FIELDS[:4], joint_field("joints", "qpos", "float64", ("other",)), *FIELDS[5:]),
            "no joints/qpos of the joint",
        ),
    ],
)
def test_states_of_another_model(fields: tuple[StateField, ...], said: str) -> None:
    """Refuse states that have not all that the geometry needs; without any joint of it, bodies alone are drawn."""
    look = look_of({}, GOOD)
    with pytest.raises(DamagedRecording, match=said):
        Motion(fields, look)
    assert [part.name for part in Motion(FIELDS[:4], look).parts] == ["cart"]
    assert Motion((), look).parts == ()
