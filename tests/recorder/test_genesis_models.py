"""Model files on Genesis: kinematics, accelerations, contacts and constraints against MuJoCo's, and what Genesis has
otherwise.

All of it on the CPU, in float32. Genesis' integrator Euler is MuJoCo's, so that the two can be compared closely.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("genesis")

from gpusimbench.evaluator.imports.motion import poses, responses
from gpusimbench.evaluator.imports.parameters import compare
from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.run.import_phase import tried
from gpusimbench.recorder.scenes.model import ModelScene, model_scene
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.recorder.simulators.mujoco.imported import of_c
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.model_files import pack
from tests.recorder import engines
from tests.recorder.mixed_model import MIXED, hold_places, scene_of, step_alike, stepped, wedge

WALKER = Path(__file__).parents[2] / "examples" / "walker" / "walker.xml"
_FEET = "".join(f'<exclude body1="{side}foot" body2="{side}shin"/>' for side in ("left", "right"))
EULER = MIXED.replace("implicitfast", "Euler").replace("</contact>", f"{_FEET}</contact>")
# Feet are welded to what shins hang on, so that MuJoCo keeps them apart by itself, and Genesis does not.

# Genesis leaves the picture on its ground planes open
pytestmark = [
    pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def _world(body: str, rest: str = "", option: str = 'timestep="0.002"') -> str:
    return f"<mujoco><option {option}/><worldbody>{body}</worldbody>{rest}</mujoco>"


_open: list[Simulator] = []


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    """Ends the engine that a test leaves, since a process has one at a time."""
    yield
    while _open:
        _open.pop().close()


def _genesis(scene: ModelScene, **options: Any) -> tuple[Any, Description]:
    while _open:
        _open.pop().close()
    simulator = engines.make("genesis", scene, **options)
    _open.append(simulator)
    return simulator, simulator.build()


def _both(scene: ModelScene, steps: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """States of Genesis and of MuJoCo C under the same controls."""
    other, described = engines.build("mujoco", scene)
    wanted = stepped(other, described, steps)
    other.close()
    return stepped(*_genesis(scene), steps), wanted


@pytest.mark.parametrize("which", ["mixed", "walker"])
def test_kinematics(which: str, tmp_path: Path) -> None:
    """Put the bodies of random states where MuJoCo puts them, and read the states back: offsets, references, chains of
    joints, welds and ball joints are all as MuJoCo means them, in every environment."""
    scene = scene_of(EULER, tmp_path) if which == "mixed" else model_scene("walker", pack(WALKER))
    simulator, description = _genesis(scene, n_env=5)
    assert simulator.imported().names["bodies"] == of_c(simulator._model.compiled.model).names["bodies"]
    for seed in range(3):
        hold_places(simulator, description, seed)


def test_accelerations(tmp_path: Path) -> None:
    """Make the step of MuJoCo from random states: masses, inertias, gravity, armature, damping, motors of joints and of
    a tendon, clamped controls and forces, and servos, in floating and fixed trees."""
    simulator, description = _genesis(scene_of(EULER, tmp_path), n_env=4)
    for seed in range(3):
        step_alike(simulator, description, seed, 2e-4)


def test_the_walker() -> None:
    """Follow MuJoCo C over 35 steps with contacts, a ball joint, springs, and a tendon's motor beside a servo."""
    genesis, wanted = _both(model_scene("walker", pack(WALKER)), 35)
    for name, array in wanted.items():
        np.testing.assert_allclose(genesis[name], array, atol=1e-5, err_msg=name)
    assert (genesis["joints/qpos"][-1, 0] != genesis["joints/qpos"][-1, 1]).any()


HINGE = '<body name="r"><joint name="j" axis="0 0 1" {0}/><geom type="capsule" size=".1 .2" mass="1"/></body>'


def _held(joint: str, actuators: str, controls: str, folder: Path) -> ModelScene:
    """A hinge whose actuators are given these controls."""
    text = _world(
        HINGE.format(joint),
        f'<actuator>{actuators}</actuator><keyframe><key ctrl="{controls}"/></keyframe>',
        'gravity="0 0 0" timestep="0.01"',
    )
    return scene_of(text, folder, actions="keyframe")


HELD = {
    "a servo and its limit": ('damping="1"', '<position joint="j" kp="9" kv=".2" forcerange="-2 3"/>', ".8"),
    "a servo, a spring and a reference": (
        'damping="1" stiffness="3" ref="10" springref="10"', '<position joint="j" kp="6"/>', ".8",
    ),
    "a velocity servo": ('damping="1"', '<velocity joint="j" kv=".3"/>', "2"),
    "a motor beside a servo": ('damping="1"', '<position joint="j" kp="9"/><motor joint="j" gear="2"/>', ".3 1.5"),
    "two motors, and their limits": (
        'damping="1" actuatorfrcrange="-3 3"',
        '<motor joint="j" gear="5" forcerange="-2 .4"/><motor joint="j" gear="-1"/>',
        "1 -9",
    ),
    "dry friction": ('frictionloss="1"', '<motor joint="j"/>', "1.5"),
}  # fmt: skip


@pytest.mark.parametrize("which", HELD)
def test_actuators(which: str, tmp_path: Path) -> None:
    """Turn a hinge as MuJoCo C does."""
    genesis, wanted = _both(_held(*HELD[which], tmp_path), 60)
    assert np.abs(wanted["joints/qpos"][-1]).max() > 0.02
    for name, array in wanted.items():
        np.testing.assert_allclose(genesis[name], array, atol=2e-3, err_msg=name)


def test_what_may_touch(tmp_path: Path) -> None:
    """Rest and slide where MuJoCo C does, keep apart by masks and excludes, and brake by the larger friction."""
    ball = '<body name="{0}" pos="{1} 1"><freejoint/><geom size=".1" contype="{2}" conaffinity="{2}"/></body>'
    text = _world(
        '<geom type="plane" size="5 5 .1" contype="3" conaffinity="3" friction=".1"/>'
        '<body name="table" pos="0 0 .5"><geom type="box" size=".5 .5 .1"/></body>'
        + ball.format("through", "0 0", 2)
        + ball.format("stays", ".3 .3", 1)
        + ball.format("let", "-.3 .3", 1)
        + '<body name="box" pos="2 0 .1"><freejoint/><geom type="box" size=".2 .2 .1" friction=".5"/></body>',
        '<contact><exclude body1="table" body2="let"/></contact>'
        f'<keyframe><key qvel="{"0 " * 18}2 0 0 0 0 0"/></keyframe>',
        'timestep="0.005"',
    )
    genesis, wanted = _both(scene_of(text, tmp_path), 200)
    heights = genesis["bodies/position"][-1, :, :, 2]
    np.testing.assert_allclose(heights, [[0.1, 0.7, 0.1, 0.1]] * 2, atol=2e-3)
    np.testing.assert_allclose(heights, wanted["bodies/position"][-1, :, :, 2], atol=2e-3)
    simulator: Any = _open[0]
    assert simulator.imported().names["excludes"] == ("let - table",)
    speed, wanted_speed = (found["bodies/linear_velocity"][:, 0, 3, 0] for found in (genesis, wanted))
    assert wanted_speed[20] < 2 - 0.4 * 9.81 * 0.1
    np.testing.assert_allclose(speed, wanted_speed, atol=5e-3)


def test_friction_against_turning(tmp_path: Path) -> None:
    """Brake a ball that rolls and one that spins on the spot as MuJoCo C does, where condim asks for it."""
    text = _world(
        '<geom type="plane" size="5 5 .1" condim="6" friction="1 .05 .01"/>'
        '<body name="rolls" pos="0 0 .1"><freejoint/><geom size=".1" condim="6" friction="1 .05 .01"/></body>'
        '<body name="spins" pos="2 0 .05"><freejoint/><geom size=".05" condim="4" friction="1 .05 .01"/></body>',
        '<keyframe><key qvel="1 0 0 0 10 0 0 0 0 0 0 20"/></keyframe>',
    )
    genesis, wanted = _both(scene_of(text, tmp_path), 200)
    turning = wanted["bodies/angular_velocity"][-1, 0]
    assert turning[0, 1] < 8 and turning[1, 2] < 1
    for name, array in wanted.items():
        np.testing.assert_allclose(genesis[name], array, atol=1e-4, err_msg=name)


def test_equalities(tmp_path: Path) -> None:
    """Close a loop by a connect constraint and couple two hinges, as MuJoCo C does, and hold their parameters."""
    bar = '<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" contype="0" conaffinity="0"/>'
    text = _world(
        f'<body name="a" pos="0 0 1"><joint name="ja" axis="0 1 0"/>{bar}'
        f'<body name="b" pos="0 0 -.3"><joint name="jb" axis="0 1 0" damping=".01"/>{bar}</body></body>'
        f'<body name="c" pos=".2 0 1"><joint name="jc" axis="0 1 0"/>{bar}</body>',
        '<equality><connect name="loop" body1="b" anchor="0 0 -.3"/>'
        '<joint name="gear" joint1="jc" joint2="ja" polycoef="0 .5 0 0 0"/></equality>'
        '<keyframe><key qvel=".5 -.5 0"/></keyframe>',
    )
    genesis, wanted = _both(scene_of(text, tmp_path), 100)
    for name, array in wanted.items():
        np.testing.assert_allclose(genesis[name], array, atol=2e-3, err_msg=name)
    simulator: Any = _open[0]
    assert not [
        f for kind in compare(of_c(simulator._model.compiled.model), simulator.imported()) for f in kind.findings
    ]


def test_its_states(tmp_path: Path) -> None:
    """Save, restore and reset states, also of some environments; the others keep their bits, and steps go on with the
    same bits."""
    simulator, description = _genesis(scene_of(EULER, tmp_path, actions="none"), n_env=3)
    first = simulator.state()
    simulator.step(3)
    saved = simulator.snapshot()
    after = simulator.states(3)
    simulator.restore(saved)
    for a, b in zip(after, simulator.states(3), strict=True):
        assert a.tobytes() == b.tobytes()
    before = simulator.state()
    simulator.reset(np.array([1]))
    for field, was, now, begun in zip(description.fields, before, simulator.state(), first, strict=True):
        assert now[[0, 2]].tobytes() == was[[0, 2]].tobytes(), field.name
        assert now[1].tobytes() == begun[1].tobytes(), field.name


def test_what_it_holds(tmp_path: Path) -> None:
    """Hold MuJoCo's masses, inertias, frames, limits, friction and shapes, as read from the engine, but no tendon; and
    a model with another mass, limit, axis, damping, size and friction differs in these."""
    simulator, description = _genesis(scene_of(EULER, tmp_path))
    held = simulator.imported()
    found = [f for kind in compare(of_c(mujoco.MjModel.from_xml_string(EULER)), held) for f in kind.findings]
    assert {(f.kind, f.parameter) for f in found} == {("tendons", "")}
    said = {d.parameter: d for d in description.deviations}
    assert said.keys() == {"tendons", "option.tolerance", "contact.pairs"}
    assert said["contact.pairs"].wanted == "stand and arm collide"  # the stand is fixed to the world
    changes = (
        ('mass="2"', 'mass="2.1"'), ("-90 90", "-90 91"), ('name="turn" axis="0 0 1"', 'name="turn" axis="0 0 -1"'),
        ('damping="2"', 'damping="2.1"'), ('size=".05 .2"', 'size=".06 .2"'), ('"5 5 .1"', '"5 5 .1" friction=".9"'),
    )  # fmt: skip
    other = EULER
    for was, now in changes:
        assert was in other
        other = other.replace(was, now, 1)
    changed = compare(of_c(mujoco.MjModel.from_xml_string(other)), held)
    items = {(f.item, f.parameter) for kind in changed for f in kind.findings if f.parameter}
    assert {
        ("arm", "mass"), ("leftroll", "range"), ("turn", "axis"), ("leftreach", "damping"), ("arm/geom0", "size"),
        ("world/geom0", "friction"),
    } <= items  # fmt: skip
    assert {item for item, _ in items} == {"arm", "leftroll", "turn", "leftreach", "arm/geom0", "world/geom0"}


def test_trials(tmp_path: Path) -> None:
    """Answer the trials of gsb-import as MuJoCo C does: kinematics, joints and actuators."""
    scene = scene_of(EULER, tmp_path)

    def made(name: str) -> Any:
        found = tried(scene, lambda still, n_env: engines.make(name, replace(still), n_env=n_env), dt=0.001, seed=0)
        assert found is not None
        return found

    ours, theirs = made("mujoco"), made("genesis")
    simulator, description = engines.build("mujoco", scene)
    simulator.close()
    items = {field.name: field.items for field in description.fields}
    where, moved = poses(ours, theirs, (items, items)), responses(ours, theirs, (items, items))
    assert not where.wrong
    assert not moved.wrong
    assert sum(one.agrees is True for one in moved.each) > 15


REFUSED = {
    "hfield 'ground', which collides": (
        '<mujoco><asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1" elevation="0 0 0 0"/></asset><worldbody>'
        '<geom name="ground" type="hfield" hfield="h"/><body><joint/><geom size=".1"/></body></worldbody></mujoco>'
    ),
    "constraint of equality 'taut', tendon": _world(
        '<body><joint name="j"/><geom size=".1"/></body>',
        '<tendon><fixed name="rope"><joint joint="j" coef="1"/></fixed></tendon>'
        '<equality><tendon name="taut" tendon1="rope"/></equality>',
    ),
    "constraint of equality 'loop', which is off": _world(
        '<body name="r"><joint/><geom size=".1"/></body>',
        '<equality><connect name="loop" body1="r" anchor="0 0 0" active="false"/></equality>',
    ),
    "constraint of equality 'loop', of things without names": _world(
        '<body><joint/><geom size=".1"/><site name="s"/></body><site name="t"/>',
        '<equality><connect name="loop" site1="s" site2="t"/></equality>',
    ),
    "tendon 'rope', which has stiffness": _world(
        '<body><joint name="j"/><geom size=".1"/></body>',
        '<tendon><fixed name="rope" stiffness="3"><joint joint="j" coef="1"/></fixed></tendon>',
    ),
    "stiffness of joint 'shoulder'": _world(
        '<body><joint name="shoulder" type="ball" stiffness="2"/><geom size=".1"/></body>'
    ),
    "contact pair 0": _world(
        '<geom name="f" type="plane" size="1 1 1"/><body><joint/><geom name="g" size=".1"/></body>',
        '<contact><pair geom1="f" geom2="g"/></contact>',
    ),
    "actuator 'muscle'": _world(
        '<body><joint name="j"/><geom size=".1"/></body>',
        '<actuator><muscle name="muscle" joint="j" lengthrange="0 1"/></actuator>',
    ),
    "joint 'j' has a motor beside a servo with a limit": _world(
        '<body><joint name="j"/><geom size=".1"/></body>',
        '<actuator><motor joint="j"/><position joint="j" kp="1" forcerange="-1 1"/></actuator>',
    ),
}


@pytest.mark.parametrize("said", REFUSED)
def test_refusals(said: str, tmp_path: Path) -> None:
    """Refuse by its name what Genesis is not given, before it starts."""
    simulator = engines.make("genesis", scene_of(REFUSED[said], tmp_path))
    with pytest.raises(Refused) as raised:
        simulator.build()
    assert said in str(raised.value)
    assert "_genesis" not in vars(simulator)


def test_the_options_of_a_model(tmp_path: Path) -> None:
    """Take a model's own solver as far as Genesis has it, and what the user says before it."""
    text = _world(HINGE, option='integrator="RK4" solver="PGS" iterations="7" cone="elliptic" impratio="3"')
    scene = scene_of(text.replace("{0}", ""), tmp_path)
    options = engines.make("genesis", scene).options
    assert (options.integrator, options.solver, options.iterations) == ("Euler", "Newton", 7)
    assert (options.cone, options.impratio, options.tolerance) == ("elliptic", 3.0, 0.0)
    assert options.contact_resolution == "convex"
    assert engines.make("genesis", scene, iterations=9, precision=64).options.tolerance == 1e-8
    assert engines.make("genesis", scene, iterations=9).options.iterations == 9
    with pytest.raises(UsageError, match="solref"):
        engines.make("genesis", scene, solref="0.02 1")


def test_what_it_has_otherwise(tmp_path: Path) -> None:
    """Name what Genesis has otherwise or not at all."""
    text = _world(
        '<geom name="floor" type="plane" size="1 1 1"/>'
        '<body name="up" gravcomp="1" pos="0 0 1"><joint name="j" stiffness="2" springref="20" frictionloss=".1" '
        'solreffriction=".05 1" range="-9 9" margin=".1" limited="true"/>'
        '<geom name="smooth" size=".1" condim="1" margin=".01" priority="1"/></body>'
        '<body name="near" pos="1 0 1"><geom name="still" type="box" size=".1 .1 .1" friction="0"/>'
        '<body name="arm"><joint name="k" type="ball" limited="true" range="0 40"/>'
        '<geom name="slippery" size=".1" friction="0"/></body></body>',
        option='density="3" viscosity=".1" wind="1 0 0" integrator="RK4" timestep="0.002"><flag damper="disable"/>'
        "</option><option",
    )
    _, description = _genesis(scene_of(text, tmp_path))
    assert {d.parameter for d in description.deviations} == {
        "model.wind", "model.density", "model.viscosity", "bodies.gravity_compensation", "joints.range",
        "joints.spring_reference", "joints.margin", "joints.solreffriction", "geoms.margin", "geoms.priority",
        "contact.friction", "contact.condim", "contact.pairs", "option.tolerance", "option.integrator",
        "option.disableflags",
    }  # fmt: skip


def test_a_mesh(tmp_path: Path) -> None:
    """Rest a mesh on its face, as high as MuJoCo does, and hold it where it is."""
    simulator, description = _genesis(wedge(tmp_path))
    assert {d.parameter for d in description.deviations} == {"option.tolerance"}
    height = stepped(simulator, description, 150)["bodies/position"][-1, :, 0, 2]
    np.testing.assert_allclose(height, 0.05, atol=2e-3)
