"""Shapes of a view: what a viewer draws has the size and the place of the body."""

from __future__ import annotations

import math

import pytest

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.view.foxglove import entity
from gpusimbench.schemas.view.geometry import Shape, Solid, links_of, solids_of
from gpusimbench.schemas.view.kinematics import Link

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
