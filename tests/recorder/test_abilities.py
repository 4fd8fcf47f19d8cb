"""Scenes need, engines can: every pair is decided by that alone, before an engine is imported."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.recorder.abilities import BODIES, ROBOTS, Ability, titles
from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Plane, Scene, Sphere
from gpusimbench.recorder.scenes.cube_stack import SMOOTH_WOOD
from gpusimbench.recorder.scenes.registry import SCENES, make_scene
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.registry import BUILT_IN, able, find_simulator
from gpusimbench.schemas.errors import UsageError
from tests.conftest import Command, distribution

A = Ability
ENGINES = [entry.name for entry in BUILT_IN]
WITH_ROBOTS = {name for name in ENGINES if Ability.FIXED_BASE in find_simulator(name).adapter().abilities}

abilities = st.frozensets(st.sampled_from(Ability))


@dataclass(frozen=True)
class Needing(Scene):
    """A scene that needs what it is told to."""

    told: frozenset[Ability] = frozenset()

    def needs(self) -> frozenset[Ability]:
        return self.told


class Idle(Simulator):
    """An engine that declares nothing."""

    Options = dict

    def build(self):
        raise AssertionError("what is refused is not built")

    step = state = build


def refusal(simulator: str, scene: Scene, **options: Any) -> str:
    """Why a simulator refuses a scene."""
    adapter = find_simulator(simulator).adapter()
    return adapter.refusal(simulator, scene, adapter.Options(**options))


def body(shape: Any, *, mass: float | None = 0.1, tilt: float = 0.0) -> Scene:
    """A scene of one body."""
    turned = ((1 - tilt**2) ** 0.5, tilt, 0.0, 0.0)
    one = Body("it", shape, SMOOTH_WOOD, position=(0.0, 0.0, 1.0), mass=mass, group="it", orientation=turned)
    return Scene("one-body", "", (one,))


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("simulator", ENGINES)
def test_every_pair(simulator: str, scene: str) -> None:
    """Take what the engine has the abilities for, and refuse the rest in one sentence, from the constructor as well."""
    made, adapter = make_scene(scene), find_simulator(simulator).adapter()
    missing = made.needs() - adapter.offered(adapter.Options())
    said = refusal(simulator, made)
    if not missing:
        assert not said
        adapter(made, n_env=1, dt=made.dt, seed=0, options=adapter.Options())
        return
    *lacks, last = titles(missing)
    why = f"it has no {', '.join(lacks)}{' or ' * bool(lacks)}{last}"
    assert said == f"simulator '{simulator}' cannot simulate scene '{scene}': {why}"
    with pytest.raises(UsageError, match=why):
        adapter(made, n_env=1, dt=made.dt, seed=0, options=adapter.Options())


def test_simulators_that_can_are_named() -> None:
    """Name them for a scene whose environments begin differently, too, which no engine lists among its abilities."""
    can = set(able(make_scene("cube-toss")))
    assert {"mujoco", "warp"} <= can
    assert "madrona" not in can


@given(abilities, abilities, abilities)
def test_exactly_what_is_missing_is_named(
    needs: frozenset[Ability], has: frozenset[Ability], off: frozenset[A]
) -> None:
    """Refuse where an ability is missing or withheld, and name all of these and no other."""

    class Engine(Idle):
        abilities = has

        @classmethod
        def withheld(cls, options: Any) -> dict[Ability, str]:
            return dict.fromkeys(off & has, "--option on=1")

    said = Engine.refusal("idle", Needing("new", "", (), told=needs), {})
    missing = needs - has or needs & off
    assert bool(said) == bool(missing)
    assert said.endswith("use --option on=1") == bool(needs <= has and missing)
    words = said.partition(": ")[2].replace(" or ", ", ")
    assert [title for title in words.partition("has no ")[2].partition(":")[0].split(", ") if title] == titles(missing)


def test_needs_are_those_of_the_description() -> None:
    """Read them off shapes, robot and actions."""
    franka = make_scene("franka")
    box = body(Box((0.1, 0.1, 0.1)))
    assert make_scene("inclined-collision").needs() == {A.FREE_BODIES, A.BOXES, A.SPHERES}
    assert make_scene("free-fall").needs() == {A.FREE_BODIES, A.BOXES, A.PLANES}
    assert franka.needs() == {A.FIXED_BASE, A.HINGES, A.ACTIONS}
    assert replace(franka, actions=None).needs() == {A.FIXED_BASE, A.HINGES}
    assert replace(franka, bodies=box.bodies).needs() == ROBOTS | {A.FREE_BODIES, A.BOXES}
    assert body(Capsule(0.1, 0.1)).needs() == {A.FREE_BODIES, A.CAPSULES}
    assert body(Sphere(0.1), mass=None).needs() == {A.SPHERES}
    assert body(Plane(), mass=None).needs() == {A.PLANES}
    assert body(Plane(), mass=None, tilt=1e-3).needs() == {A.TILTED_PLANES}
    assert body(Plane(), mass=None, tilt=1e-3).needs() | box.needs() <= BODIES


def test_no_description_grows_by_its_needs() -> None:
    """Keep needs out of the recorded description: hashes of scenes stay."""
    scene = make_scene("free-fall")
    assert "needs" not in scene.to_json()
    assert {field.name for field in fields(Scene)}.isdisjoint({"needs", "abilities"})


@pytest.mark.parametrize(
    ("simulator", "options", "scene", "why"),
    [
        ("genesis", {}, body(Capsule(0.1, 0.1)), "it has no capsules"),
        ("calibration", {}, body(Capsule(0.1, 0.1)), "it has no capsules"),
        ("isaaclab", {}, body(Plane(), mass=None, tilt=0.1), "it has no tilted planes"),
        ("physx", {}, body(Plane(), mass=None, tilt=0.1),
         "with these options it has no tilted planes: use a box, or --option spacing=0 on a GPU"),
        ("physx", {"spacing": 0.0}, body(Plane(), mass=None, tilt=0.1), ""),
        ("physx", {}, replace(make_scene("franka"), bodies=body(Sphere(0.1)).bodies),
         "it has no robots among free bodies"),
        ("sapien", {}, make_scene("franka"), ""),
        ("sapien", {"device": "cuda"}, make_scene("franka"),
         "with these options it has no fixed-base robots, hinge joints or actions: use --option device=cpu"),
    ],
)  # fmt: skip
def test_what_single_engines_lack(simulator: str, options: dict[str, Any], scene: Scene, why: str) -> None:
    """Say which ability it is, and what gives it back."""
    assert refusal(simulator, scene, **options).partition(f"scene '{scene.name}': ")[2] == why


@pytest.fixture
def added(tmp_path: Path) -> dict[str, str]:
    """The environment in which a distribution adds a scene that no engine has the abilities for, and an engine that
    has none; importing any real engine ends the process."""
    (tmp_path / "theirs.py").write_text(
        """
from dataclasses import dataclass, replace
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.franka import franka
from gpusimbench.recorder.simulators.base import Ability, Simulator

class Walker(Scene):
    def needs(self):
        return super().needs() - {Ability.FIXED_BASE} | {Ability.FLOATING_BASE}

def walker():
    return Walker("walker", "a robot that walks", (), robot=franka().robot, actions=franka().actions)

@dataclass(frozen=True)
class Options:
    pass

class Idle(Simulator):
    Options = Options

    def build(self):
        raise AssertionError

    step = state = build
"""
    )
    for name in ("mujoco", "warp", "jax", "torch"):
        (tmp_path / f"{name}.py").write_text("import os; os._exit(9)\n")
    points = "[gsb.scenes]\nwalker = theirs:walker\n[gsb.simulators]\nidle = theirs:Idle\n"
    return distribution(tmp_path, "theirs", points)


def test_what_fits_nothing_is_listed(added: dict[str, str], gsb_record: Command) -> None:
    """List a scene that needs what no engine has and an engine that has nothing, with what is missing."""
    assert "not walker: it has no floating-base robots\n" in gsb_record("--list", "mujoco", env=added).stdout
    text = gsb_record("--list", "idle", env=added).stdout
    assert "not walker: it has no floating-base robots, hinge joints or actions\n" in text
    assert "not free-fall: it has no free bodies, boxes or planes\n" in text
    record = json.loads(gsb_record("--list", "--json", env=added).stdout)
    known = {about["name"]: about for about in record["simulators"]}
    lacks = [about["refused"]["walker"] for about in known.values() if "walker" in about["refused"]]
    assert lacks.count(["floating-base robots"]) == len(WITH_ROBOTS)
    assert lacks.count(["floating-base robots", "hinge joints", "actions"]) == len(ENGINES) - len(WITH_ROBOTS) + 1
    assert (known["idle"]["abilities"], known["idle"]["scenes"]) == ([], [])
    assert known["mujoco"]["refused"] == {"walker": ["floating-base robots"]}
    assert known["mujoco"]["scenes"] == list(SCENES)
    needs = {scene["name"]: scene["needs"] for scene in record["scenes"]}
    assert needs["walker"] == known["idle"]["refused"]["walker"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--sim", "mujoco", "--scene", "walker"),
         "simulator 'mujoco' cannot simulate scene 'walker': it has no floating-base robots"),
        (("--sim", "warp", "--scene", "walker", "--sweep", "1..1024"),
         "simulator 'warp' cannot simulate scene 'walker': it has no floating-base robots"),
        (("--sim", "idle", "--scene", "franka"),
         "simulator 'idle' cannot simulate scene 'franka': it has no fixed-base robots, hinge joints or actions"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(
    added: dict[str, str], gsb_record: Command, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    """Say so in one sentence, with the simulators that can if there are any, and write nothing."""
    done = gsb_record(*arguments, "--out", tmp_path / "out", env=added, code=2)
    why, _, others = done.stderr.partition("; simulators that can: ")
    assert why.rstrip("\n") == f"gsb-record: {message}"
    assert done.stderr.count("\n") == 1
    assert set(filter(None, others.strip().split(", "))) == (WITH_ROBOTS if "franka" in arguments else set())
    assert not (tmp_path / "out").exists()
