"""The canonical scene of a closed loop: what closes it, what its laws see, and what they say of MuJoCo's soft pin."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from benchmarks.law_changes import Change, changed_scene
from gpusimbench import RecordingWriter, Scene, open_recording
from gpusimbench.evaluator.metrics.physics.closed_form import FourBar, wrapped
from gpusimbench.evaluator.results.canonical import Law, Unmeasured, laws
from gpusimbench.evaluator.runs.physics.facts import PhysicsFacts
from gpusimbench.evaluator.runs.physics.laws import laws_of
from gpusimbench.recorder.run import start
from gpusimbench.recorder.scenes import loop
from gpusimbench.recorder.scenes.base import Vector
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import joint_field
from gpusimbench.schemas.initial import Initial
from tests.conftest import call

ENVS = 8
STEADY = {"integrator": "RK4", "solref": "0.004 1"}
"""Options with which MuJoCo C errs little at a step of 2 ms: a pin that is as stiff as the step allows."""

share = st.floats(0.1, 0.9)


def _bars(ground: float, crank: float, coupler: float, rocker: float) -> FourBar:
    return FourBar(ground, crank, coupler, rocker, (0.01, 0.08, 0.05), 1.0, 0.2)


def _judged(recording: Path) -> dict[str, Law | Unmeasured]:
    found = laws_of(open_recording(recording))
    facts = PhysicsFacts("four-bar", ENVS, ((0, ENVS - 1),), {}, laws=found)
    return {law.key: law for law in laws("", [facts])}


def _stepped(path: Path, scene: Scene, *, dt: float = 0.002, seconds: float = 4.0, **options: str) -> Path:
    """A recording that declares the scene four-bar, of what MuJoCo C makes of this one."""
    adapter = find_simulator("mujoco").load()
    simulator = adapter(scene, n_env=ENVS, dt=dt, seed=2, options=adapter.parsed("mujoco", scene, options))
    made = simulator.build()
    begun = start.drawn_states(Initial(0.8), scene, made.fields, simulator.state(), 2)
    simulator.set_state(begun)
    steps = round(seconds / dt)
    writer = RecordingWriter(
        path, simulator="mujoco", version=made.version, scene=make_scene("four-bar"), n_env=ENVS, dt=dt, steps=steps,
        fields=made.fields, view=(),
    )  # fmt: skip
    with writer as log:
        log.append(*begun)
        log.append(*simulator.states(steps))
    simulator.close()
    return path


def _changed(parameter: str, by: float) -> Scene:
    """The scene with a longer or heavier link, by this share."""
    return changed_scene(make_scene("four-bar"), [Change(parameter, "", by)])


@given(share, share, share, st.floats(-50.0, 50.0), st.floats(-9.0, 9.0))
def test_freudenstein_closes_the_loop(one: float, other: float, third: float, angle: float, speed: float) -> None:
    """Agree with the recorder's circles, in every linkage whose crank turns; its speeds are the angles' derivative."""
    crank, coupler, rocker = 0.2, 0.2 + one, 0.2 + other
    nearest, farthest = crank + abs(coupler - rocker), coupler + rocker - crank
    ground = nearest + third * (farthest - nearest)
    bars = _bars(ground, crank, coupler, rocker)
    assume(bars.turns())
    drawn = loop.FourBar(ground, crank, coupler, rocker)
    angles = drawn.angles(angle)
    of_coupler, of_rocker = bars.angles(np.array(angle))
    assert abs(wrapped(np.array(angles[0] + angles[1] - of_coupler))) < 1e-9
    assert abs(wrapped(np.array(angles[2] - of_rocker))) < 1e-9
    assert float(bars.gap(np.array(angle), of_coupler, of_rocker)) < 1e-12
    change = wrapped(drawn.angles(angle + 1e-6) - drawn.angles(angle - 1e-6)) / 2e-6
    assert np.allclose(drawn.speeds(angles, speed), change * speed, rtol=1e-4, atol=1e-5)


def test_only_cranks_turn() -> None:
    """Refuse links that are too long, and a crank that is not the shortest."""
    assert _bars(0.6, 0.2, 0.5, 0.4).turns()
    assert not _bars(0.9, 0.2, 0.5, 0.4).turns() and not _bars(0.2, 0.6, 0.5, 0.4).turns()


def test_the_energy_is_that_of_points() -> None:
    """Agree with m v^2 / 2 of points on the three links, from their places at two times."""
    masses, places = np.array([0.5, 0.25, 0.75, 1.5]), np.array([0.1, 0.1, 0.4, 0.3])
    crank, first, second, rocker = masses * places**2
    bars = FourBar(0.6, 0.2, 0.5, 0.4, (crank, first + second, rocker), 1.0, float(masses[1:3] @ places[1:3]))

    def at(angle: np.ndarray) -> np.ndarray:
        a, c, r = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.stack([0.1 * a, 0.2 * a + 0.1 * c, 0.2 * a + 0.4 * c, 0.3 * r])

    angle, speed = np.array([0.7, -0.4, 2.1]), np.array([3.0, -2.0, 5.0])
    velocity = (at(angle + 1e-6 * speed) - at(angle - 1e-6 * speed)) / 2e-6
    expected = float((masses[:, None] * velocity**2).sum()) / 2.0
    assert float(bars.energy(angle[1] - angle[0], *speed)) == pytest.approx(expected, rel=1e-8)


def test_a_crank_alone_turns_evenly() -> None:
    """Take the turn of a heavy crank, with links that weigh almost nothing, to be 2 pi over its speed."""
    bars = FourBar(0.6, 0.2, 0.5, 0.4, (0.1, 1e-12, 1e-12), 1e-12, 0.25)
    energy = bars.energy_at(np.array([0.3, 4.0]), np.array([5.0, 2.0]))
    assert np.allclose(bars.period(energy), 2.0 * math.pi / np.array([5.0, 2.0]), rtol=1e-9)


def test_every_environment_begins_with_a_closed_loop(tmp_path: Path) -> None:
    """Draw angle and speed of the crank; let coupler and rocker follow, in places and speeds."""
    done = call(
        "gsb-record", "--sim", "mujoco", "--scene", "four-bar", "--n-env", "16", "--runs", "1", "--phases", "capture",
        "--steps", "2", "--no-view", "--initial", "random:0.8", "--out", tmp_path,
    )  # fmt: skip
    recording = open_recording(Path(done.stdout.split()[0]))
    qpos, qvel = (
        recording.state("robot", name).read(slice(0, 1), slice(None))[0, :, :, 0] for name in ("qpos", "qvel")
    )
    robot = make_scene("four-bar").robot
    drawn = np.stack([qpos[:, 0] - robot.start[0], qvel[:, 0] - robot.speeds()[0]])
    share = np.array([[0.4], [0.8]])
    assert (np.abs(drawn) <= share + 1e-12).all() and (np.ptp(drawn, axis=1, keepdims=True) > share).all()
    assert abs(np.corrcoef(drawn)[0, 1]) < 0.9
    bars = _bars(0.6, 0.2, 0.5, 0.4)

    def links(joint: np.ndarray) -> np.ndarray:
        return np.stack([joint[:, 0], joint[:, 0] + joint[:, 1], joint[:, 2]])

    assert bars.gap(*links(qpos)).max() < 1e-12
    assert bars.gap(*links(qpos + 1e-5 * qvel)).max() < 1e-8  # no first-order opening


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Law | Unmeasured]:
    """The laws of a linkage on which MuJoCo C errs little."""
    return _judged(_stepped(tmp_path_factory.mktemp("kept") / "kept.mcap", make_scene("four-bar"), **STEADY))


def test_a_stiff_pin_and_runge_kutta_keep_all_laws(kept: dict[str, Law | Unmeasured]) -> None:
    """Hold every law, by much less than is tolerated; none depends on the mass of all links."""
    assert set(kept) == {"gap", "coupler_angle", "rocker_angle", "energy_change", "period"}
    for law in kept.values():
        assert isinstance(law, Law) and law.held and law.count == ENVS
        assert abs(law.difference or 0.0) < law.tolerance / 2.0
        sizes = {one.parameter: one.breaks for one in law.sensitivities}
        assert sizes.pop("mass") is None and sizes.popitem()[1]


def test_claims_last_with_other_initial_states(kept: dict[str, Law | Unmeasured]) -> None:
    """Claim a size that exceeds the tolerance of 98 of 100 recordings that begin with other speeds."""
    bars, generator = _bars(0.6, 0.2, 0.5, 0.4), np.random.default_rng(1)
    angle, speed = (
        3.8 + generator.uniform(-0.4, 0.4, (2, 500, ENVS)),
        5.0 + generator.uniform(-0.8, 0.8, (2, 500, ENVS)),
    )
    before, after = bars.towards_axes(bars.energy_at(angle, speed)).mean(axis=-1)
    for key in ("gap", "coupler_angle", "rocker_angle"):
        assert isinstance(law := kept[key], Law)
        one = law.sensitivities[-1]
        assert one.breaks is not None and one.slope is not None
        claimed = one.breaks * abs(one.slope) - abs(law.difference or 0.0)
        assert (after < before * claimed / law.tolerance).mean() > 0.98


@pytest.mark.parametrize(
    ("key", "most", "changed"),
    [
        ("rocker_angle", 1e-3, "coupler's length"),
        pytest.param("coupler_angle", 1e-3, "rocker's length", marks=pytest.mark.slow),
        pytest.param("period", 0.1, "rocker's mass", marks=pytest.mark.slow),
    ],
)
def test_other_links_are_seen(
    tmp_path: Path, kept: dict[str, Law | Unmeasured], key: str, most: float, changed: str
) -> None:
    """Break a law by little more than the change of a link that a single recording claims to see."""
    assert isinstance(law := kept[key], Law)
    size = law.sensitivities[-1].breaks
    assert size is not None and 0.0 < size < most
    seen = _judged(_stepped(tmp_path / "other.mcap", _changed(changed, 1.2 * size), **STEADY))
    assert isinstance(law := seen[key], Law) and not law.held
    if key == "period":
        assert isinstance(law := seen["rocker_angle"], Law) and law.held


def test_a_soft_pin_yields(tmp_path: Path) -> None:
    """See MuJoCo's default pin open, and its default integrator lose energy, at a step of 2 ms."""
    found = _judged(_stepped(tmp_path / "soft.mcap", make_scene("four-bar")))
    for key, least in (("gap", 1e-4), ("energy_change", -1.0)):
        assert isinstance(law := found[key], Law) and not law.held and law.measured > least
    assert isinstance(law := found["rocker_angle"], Law) and law.held


def _written(path: Path, scene: Scene, crank: np.ndarray, side: np.ndarray) -> Path:
    """A recording of one linkage whose crank has these angles, assembled with sign 1 as the scene says, with -1 as its
    mirror image; angles [row]."""
    bars = _bars(0.6, 0.2, 0.5, 0.4)
    coupler, rocker = (side * angle for angle in bars.angles(side * crank))
    qpos = np.stack([crank, coupler - crank, rocker], axis=-1)[:, None, :, None]
    qvel = np.broadcast_to(np.array([5.0, -5.0, 0.0])[:, None], qpos.shape)
    names = tuple(joint.name for joint in scene.robot.joints())
    fields = tuple(joint_field("robot", name, "float64", names) for name in ("qpos", "qvel"))
    with RecordingWriter(
        path, simulator="none", version="1", scene=scene, n_env=1, dt=0.01, steps=len(crank) - 1, fields=fields,
        view=(),
    ) as log:  # fmt: skip
        log.append(qpos, qvel)
    return path


def test_the_other_assembly_is_seen(tmp_path: Path) -> None:
    """Break Freudenstein's equation, and not the gap, where the loop closes on the other side from the second state."""
    crank = 3.8 + 0.05 * np.arange(401)
    side = np.where(np.arange(401) < 1, 1.0, -1.0)
    found = _judged(_written(tmp_path / "flipped.mcap", make_scene("four-bar"), crank, side))
    for key, held in (("gap", True), ("coupler_angle", False), ("rocker_angle", False)):
        assert isinstance(law := found[key], Law) and law.held is held


@pytest.mark.parametrize(
    ("coupler", "gravity", "reason"),
    [
        (0.1, (0.0, 0.0, -9.81), "cannot turn all the way round"),
        (-0.5, (0.0, 0.0, -9.81), "links of positive lengths"),
        (0.5, (0.0, -9.81, 0.0), "lies level"),
    ],
)
def test_other_linkages_are_not_judged(tmp_path: Path, coupler: float, gravity: Vector, reason: str) -> None:
    """Say what a scene of this name has to be."""
    scene = make_scene("four-bar")
    assert scene.robot is not None and scene.robot.loop is not None
    pin = replace(scene.robot.loop, on_coupler=(coupler, 0.0, -0.05))
    spoiled = replace(scene, robot=replace(scene.robot, loop=pin), gravity=gravity)
    path = _written(tmp_path / "spoiled.mcap", spoiled, 3.8 + 0.05 * np.arange(3), np.ones(3))
    with pytest.raises(DamagedRecording, match=reason):
        laws_of(open_recording(path))
