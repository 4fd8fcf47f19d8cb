"""Identical bodies that exchange their states: which are identical, and that nothing is changed but their order."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.recorder.scenes.registry import make_scene, scene_names
from gpusimbench.schemas.fields import body_fields
from gpusimbench.schemas.symmetry import Relabelling


def _described(name: str = "inclined-collision") -> dict[str, Any]:
    found: dict[str, Any] = json.loads(make_scene(name).to_json())
    return found


def _masses(*groups: tuple[float, ...]) -> dict[str, Any]:
    """A scene with groups of cubes of these masses, and a fixed one, each at a place of its own."""
    cube = next(body for body in _described("free-fall")["bodies"] if body.get("mass"))
    bodies = [
        {**cube, "name": f"{group}-{at}", "group": f"of {group}", "mass": mass, "position": [group, at, 0.0]}
        for group, masses in enumerate(groups)
        for at, mass in enumerate(masses)
    ]
    return {"bodies": [{**cube, "name": "held", "mass": None}, *bodies]}


def test_scenes() -> None:
    """Tell from the descriptions alone which scenes have identical bodies, and how many get another one's state."""
    found = {name: Relabelling.of(_described(name)) for name in scene_names()}
    without = {name for name, relabelling in found.items() if relabelling.why_not}
    assert without == {"franka", "cube-toss", "pendulum", "double-pendulum", "four-bar"}
    assert {found[name].why_not for name in without} == {"has no two identical bodies that move"}
    exchanged = {name: {g: len(of) for g, of in found[name].partners.items()} for name in found.keys() - without}
    assert exchanged == {
        "inclined-collision": {"cubes": 26}, "free-fall": {"cubes": 26}, "sliding-block": {"cubes": 4},
        "free-body": {"boxes": 2}, "ball-drop": {"balls": 2}, "dice-drop": {"cubes": 12},
    }  # fmt: skip


def test_within_a_kind_alone() -> None:
    """Reverse the order of the bodies of one mass in one group; nobody gets the state of a heavier one."""
    found = Relabelling.of(_masses((1.0, 2.0, 1.0, 2.0, 1.0, 3.0), (2.0, 2.0)))
    assert found.partners == {
        "of 0": {"0-0": "0-4", "0-4": "0-0", "0-1": "0-3", "0-3": "0-1"},
        "of 1": {"1-0": "1-1", "1-1": "1-0"},
    }
    assert Relabelling.of(_masses((1.0,), (1.0,))).why_not == "has no two identical bodies that move"


@pytest.mark.parametrize(("part", "key"), [("shape", "size"), ("material", "restitution")])
def test_what_tells_bodies_apart(part: str, key: str) -> None:
    """Exchange no body with one of another size or surface; another initial state is what is exchanged."""
    scene = _masses((1.0, 1.0))
    scene["bodies"][1]["linear_velocity"] = [1.0, 0.0, 0.0]
    assert Relabelling.of(scene).why_not == ""
    scene["bodies"][1][part] = {**scene["bodies"][1][part], key: [1.0, 1.0, 1.0] if key == "size" else 0.123}
    assert Relabelling.of(scene).why_not == "has no two identical bodies that move"


@given(
    kinds=st.lists(st.lists(st.sampled_from([1.0, 2.0]), min_size=1, max_size=6), min_size=1, max_size=3),
    seed=st.integers(0, 999),
)
def test_exact_and_undone_by_itself(kinds: list[list[float]], seed: int) -> None:
    """Give every number back, and change no body's group or mass; only bodies that have no partner stay."""
    scene = _masses(*map(tuple, kinds))
    relabelling = Relabelling.of(scene)
    groups = {f"of {at}": tuple(f"{at}-{body}" for body in range(len(of))) for at, of in enumerate(kinds)}
    masses = {body["name"]: body["mass"] for body in scene["bodies"]}
    for layout in body_fields(groups, "float32"):
        values = np.random.default_rng(seed).standard_normal((2, 3, len(layout.items), layout.width), "float32")
        image = relabelling.image(layout, values)
        assert relabelling.why_unknown(layout) == ""
        assert relabelling.image(layout, image).tobytes() == values.tobytes()
        assert sorted(map(bytes, image[0, 0])) == sorted(map(bytes, values[0, 0]))
        for at, name in enumerate(layout.items):
            partner = relabelling.partners.get(layout.group, {}).get(name, name)
            assert masses[partner] == masses[name]
            assert np.array_equal(image[..., at, :], values[..., layout.items.index(partner), :])
            assert (partner == name) == np.array_equal(image[..., at, :], values[..., at, :])


def test_what_is_not_known() -> None:
    """Know no partners in a field without them, in model files, and where each body has parameters of its own."""
    relabelling = Relabelling.of(_described())
    few = body_fields({"cubes": ("cube_0_0_0",)}, "float32")[0]
    assert relabelling.why_unknown(few) == "cubes/position has no body 'cube_0_0_1'"
    assert "a model file" in Relabelling.of({**_described(), "files_sha256": "0"}).why_not
    assert "--vary" in Relabelling.of(_described(), "mass:0.1").why_not


@pytest.mark.parametrize("spoiled", [{}, {"bodies": 1}, {"bodies": [1]}, {"bodies": [{"mass": 1.0}]}])
def test_descriptions_of_strangers(spoiled: dict[str, Any]) -> None:
    """Say of a description that makes no sense that it cannot be read, and raise nothing."""
    assert Relabelling.of(spoiled).why_not == "has a description that cannot be read"
