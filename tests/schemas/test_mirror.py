"""Mirror images of states and scenes: derived from rotation matrices, and exact."""

from __future__ import annotations

import json
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.registry import make_scene, scene_names
from gpusimbench.schemas.initial import AXES
from gpusimbench.schemas.symmetry import can_mirror, mirrored, why_unlike_its_image
from tests.rotations import rotation

SIGNS = {"x": (-1.0, 1.0, 1.0), "y": (1.0, -1.0, 1.0), "xy": (-1.0, -1.0, 1.0)}

_NUMBER = st.floats(-4, 4, width=32)
_VECTOR = st.tuples(_NUMBER, _NUMBER, _NUMBER)


def _skew(w: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def test_in_the_plane_of_the_probe() -> None:
    """Change these signs in the plane y = 0, and by a half turn, and no others."""
    assert mirrored("position", np.array([1.0, 2.0, 3.0]), "y").tolist() == [1, -2, 3]
    assert mirrored("linear_velocity", np.array([1.0, 2.0, 3.0]), "y").tolist() == [1, -2, 3]
    assert mirrored("angular_velocity", np.array([1.0, 2.0, 3.0]), "y").tolist() == [-1, 2, -3]
    assert mirrored("orientation", np.array([1.0, 2.0, 3.0, 4.0]), "y").tolist() == [1, -2, 3, -4]
    for field in ("position", "linear_velocity", "angular_velocity"):  # a half turn keeps handedness
        assert mirrored(field, np.array([1.0, 2.0, 3.0]), "xy").tolist() == [-1, -2, 3]
    assert mirrored("orientation", np.array([1.0, 2.0, 3.0, 4.0]), "xy").tolist() == [1, -2, -3, 4]


@pytest.mark.parametrize("axes", AXES)
@given(body=_VECTOR, place=_VECTOR, spin=_VECTOR, quaternion=st.tuples(_NUMBER, _NUMBER, _NUMBER, _NUMBER))
def test_a_point_of_a_body_is_mirrored(
    axes: str, body: tuple[float, ...], place: tuple[float, ...], spin: tuple[float, ...],
    quaternion: tuple[float, ...],
) -> None:  # fmt: skip
    """Put the mirror image of each point of a body, and its velocity, where the image of the state puts them."""
    s = np.array(SIGNS[axes])
    of_body, centre, omega = (np.array(one, dtype=np.float64) for one in (body, place, spin))
    turned = mirrored("orientation", np.array(quaternion, dtype=np.float64), axes)
    # the image of a body that is its own mirror image: the point with mirrored coordinates in the body's own axes
    point = rotation(quaternion) @ of_body
    image = rotation(turned.tolist()) @ (s * of_body)
    assert np.array_equal(image + mirrored("position", centre, axes), s * (point + centre))
    moving = _skew(mirrored("angular_velocity", omega, axes)) @ image + mirrored("linear_velocity", centre, axes)
    assert np.array_equal(moving, s * (_skew(omega) @ point + centre))


@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_exact_and_undone_by_itself(axes: str, dtype: str) -> None:
    """Give every number back, to the last bit, in its own precision; zeros lose their sign, and nothing else does."""
    numbers = np.array([1.1, -0.3, 5e-324, -1e-40, np.inf, np.nan], dtype=dtype).repeat(4).reshape(-1, 4)
    for field in ("position", "orientation", "linear_velocity", "angular_velocity"):
        values = numbers if field == "orientation" else numbers[:, :3]
        again = mirrored(field, mirrored(field, values, axes), axes)
        assert again.dtype == values.dtype
        assert again.tobytes() == (values + values.dtype.type(0)).tobytes()
        zeros = np.array([0.0, -0.0, 0.0, -0.0], dtype=dtype)[: values.shape[1]]
        assert not np.signbit(mirrored(field, zeros, axes)).any()
    assert not can_mirror("qpos")


def _described(name: str) -> dict[str, Any]:
    return json.loads(make_scene(name).to_json())


def test_scenes() -> None:
    """Tell which scenes are their own mirror images; a slope is in one plane alone, and robots are never asked."""
    unlike = {axes: {n: w for n in scene_names() if (w := why_unlike_its_image(_described(n), axes))} for axes in AXES}
    robots = {"franka", "pendulum", "double-pendulum", "four-bar"}
    assert unlike["y"].keys() == {*robots, "sliding-block"}
    assert unlike["x"].keys() == unlike["xy"].keys() == {*robots, "sliding-block", "inclined-collision"}
    assert {unlike["y"][name] for name in robots} == {"it has a robot, whose mirror image is not known"}
    assert unlike["y"]["sliding-block"].startswith("no fixed body is the mirror image of 'plank-")
    assert unlike["x"]["inclined-collision"] == "no fixed body is the mirror image of 'board'"
    assert unlike["xy"]["inclined-collision"] == "no fixed body is the half-turn image of 'board'"


def _changed(**of_slope: Any) -> dict[str, Any]:
    scene = _described("inclined-collision")
    next(body for body in scene["bodies"] if body["name"] == "slope").update(of_slope)
    return scene


def test_what_breaks_the_symmetry() -> None:
    """Notice one unit in the last place of a fixed body, gravity that is not upright, and what has no known image."""
    assert why_unlike_its_image(_changed(), "y") == ""
    for broken in ({"position": [-0.28191, 5e-324, 0.12261]}, {"orientation": [0.9, 1e-9, 0.4, 0.0]}):
        assert why_unlike_its_image(_changed(**broken), "y") == "no fixed body is the mirror image of 'slope'"
    tilted = {**_changed(), "gravity": [0.0, 0.1, -9.81]}
    assert why_unlike_its_image(tilted, "y") == "gravity is not along z"
    assert "mirror image of the shape of 'slope'" in why_unlike_its_image(_changed(shape={"kind": "mesh"}), "y")
    assert "a model file" in why_unlike_its_image({**_changed(), "files_sha256": "0"}, "y")
    assert "actions" in why_unlike_its_image({**_changed(), "actions": {"kind": "joint"}}, "y")


def test_walls_that_change_places() -> None:
    """Take a pair of fixed bodies that are each other's mirror images, and no pair of other sizes or surfaces."""
    scene = _described("free-fall")
    left = {**_changed()["bodies"][0], "name": "left", "position": [0.0, 0.5, 0.0], "orientation": [0.8, 0.6, 0.0, 0.0]}
    right = {**deepcopy(left), "name": "right", "position": [0.0, -0.5, 0.0], "orientation": [-0.8, 0.6, 0.0, 0.0]}
    scene["bodies"] += [left, right]
    assert why_unlike_its_image(scene, "y") == ""
    for part, key in (("shape", "size"), ("material", "restitution")):
        other = deepcopy(scene)
        other["bodies"][-1][part][key] = [1.0, 1.0, 1.0] if key == "size" else 0.123
        assert why_unlike_its_image(other, "y") == "no fixed body is the mirror image of 'left'"
    left["position"], right["position"] = [0.2, 0.5, 0.0], [-0.2, -0.5, 0.0]
    assert why_unlike_its_image(scene, "y") == "no fixed body is the mirror image of 'left'"
    assert why_unlike_its_image(scene, "xy") == ""
    left["position"][0] = right["position"][0] = 0.0
    scene["bodies"].append(left)  # twice, and its image once
    assert why_unlike_its_image(scene, "y") == "no fixed body is the mirror image of 'left'"


@pytest.mark.parametrize(
    "spoiled",
    [
        {},
        {"bodies": 1},
        {"bodies": [1]},
        {"gravity": "down"},
        {"gravity": [0, 0]},
        {"bodies": [{"name": "x", "shape": {}}]},
    ],
)
def test_descriptions_of_strangers(spoiled: dict[str, Any]) -> None:
    """Say of a description that makes no sense that it cannot be read, and raise nothing."""
    scene = {**_described("free-fall"), **spoiled} if spoiled else {}
    assert why_unlike_its_image(scene, "y") == "its description cannot be read"
    placed = _changed(position=[0.0, "a", 0.0]), _changed(position=[0.0]), _changed(orientation=None)
    assert {why_unlike_its_image(one, "y") for one in placed} == {"its description cannot be read"}
