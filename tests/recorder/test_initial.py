"""gsb-record --initial: environments that do not all begin alike."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.recorder.run.intervention import DOING
from gpusimbench.recorder.run.start import GRID, draw, images, parse
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.fields import body_fields
from gpusimbench.schemas.initial import MOST_SPREAD, Initial
from gpusimbench.schemas.symmetry import Mirror, Relabelling, mirrored
from gpusimbench.schemas.treatment import KINDS, Intervention
from tests.conftest import Command, call

_SHORT = ("--n-env", "4", "--steps", "3", "--phases", "capture", "--initial", "random:0.1", "--seed", "7")
_WORD = 0xFFFFFFFF
FALL = make_scene("free-fall")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two runs of four environments of MuJoCo C."""
    done = call("gsb-record", "--sim", "mujoco", "--runs", "2", *_SHORT, "--out", tmp_path_factory.mktemp("initial"))
    assert done.returncode == 0, done.stderr
    one, other = map(Path, done.stdout.split())
    return one, other


def _mix(word: int) -> int:
    word ^= word >> 16
    word = word * 0x85EBCA6B & _WORD
    word ^= word >> 13
    word = word * 0xC2B2AE35 & _WORD
    return word ^ word >> 16


def _as_documented(seed: int, spread: float, *counters: int) -> float:
    golden = 0x9E3779B9
    word = _mix((seed & _WORD) + golden & _WORD)
    word = _mix(word + (seed >> 32 & _WORD) + golden & _WORD)
    word = _mix(word + 0x494E4954 & _WORD)
    for counter in counters:
        word = _mix(word + (counter + 1) * golden & _WORD)
    k = int(spread / GRID)
    return (((word >> 16) * (2 * k + 1) >> 16) - k) * GRID


@given(seed=st.integers(0, 2**64 - 1), spread=st.floats(GRID, MOST_SPREAD), field=st.integers(0, 7))
def test_the_generator(seed: int, spread: float, field: int) -> None:
    """Draw what the documented formula says, in whole parts of the grid, never beyond the spread."""
    found = draw(Initial(spread), seed, field, (3, 2, 3))
    for at in np.ndindex(found.shape):
        assert found[at] == _as_documented(seed, spread, field, *at)
    assert np.abs(found).max() <= spread


def test_shifted() -> None:
    """Begin each environment as the one K places further, and the last ones as the first."""
    plain = draw(Initial(0.1), 3, 0, (5, 2, 3))
    assert np.array_equal(draw(Initial(0.1, shift=2), 3, 0, (5, 2, 3)), np.roll(plain, -2, axis=0))


def test_all_but_one() -> None:
    """Begin one environment as it does, and every other one otherwise."""
    plain, other = (draw(initial, 3, 0, (5, 2, 3)) for initial in (Initial(0.1), Initial(0.1, but=1)))
    assert np.flatnonzero((plain == other).all(axis=(1, 2))).tolist() == [1]


def test_of_more_environments() -> None:
    """Begin an environment alike whatever their number."""
    assert np.array_equal(draw(Initial(0.1), 3, 0, (5, 2, 3)), draw(Initial(0.1), 3, 0, (64, 2, 3))[:5])


@given(st.sampled_from(sorted(KINDS)), st.integers(1, 10**9 - 1), st.integers(1, 10**9 - 1))
def test_interventions(kind: str, step: int, more: int) -> None:
    """Read an intervention back as it is written."""
    made = Intervention(kind, step, more if KINDS[kind].more else 0)
    assert Intervention.parse(str(made)) == made


def test_every_kind_of_intervention_is_done() -> None:
    """Have for each declared kind the claim that it needs, and what does it."""
    assert DOING.keys() == KINDS.keys()
    assert [kind for kind, (_, do) in DOING.items() if do is None] == [k.name for k in KINDS.values() if k.repeats]


@pytest.mark.parametrize(
    "text", ["", "reset", "reset@", "reset@-1", "set@1+2", "excursion@5", "jump@3", "reset@01", "teacher@0"]
)
def test_no_interventions(text: str) -> None:
    """Refuse what is none."""
    with pytest.raises(ValueError):
        Intervention.parse(text)


def test_the_first_state(recorded: tuple[Path, Path]) -> None:
    """Add velocities to the scene's first state, other ones in each environment, and move nothing."""
    recording, scene = open_recording(recorded[0]), make_scene("inclined-collision")
    assert recording.configuration.initial == "random:0.1"
    for place, layout in enumerate(recording.fields):
        first = np.asarray(recording.state(layout.group, layout.field))[0]
        if layout.field == "linear_velocity":
            assert np.array_equal(first, draw(Initial(0.1), 7, place, first.shape))
            assert len({env.tobytes() for env in first}) == 4
        elif layout.field == "position":
            bodies = {body.name: body for body in scene.moving()}
            assert np.array_equal(first, np.broadcast_to([bodies[item].position for item in layout.items], first.shape))
        else:
            assert all(np.array_equal(env, first[0]) for env in first)


def test_mirror_images(recorded: tuple[Path, Path], gsb_record: Command, tmp_path: Path) -> None:
    """Begin each environment in the mirror image of its usual state, to the last bit; zeros have no sign."""
    again = ("--sim", "mujoco", "--runs", "1", *_SHORT, "--initial", "random:0.1,mirror:y", "--out", tmp_path)
    images, usual = open_recording(Path(gsb_record(*again, code=0).stdout.strip())), open_recording(recorded[0])
    assert images.configuration.initial == "random:0.1,mirror:y"
    for layout in usual.fields:
        one, other = (np.asarray(r.state(layout.group, layout.field))[0] for r in (usual, images))
        assert other.tobytes() == mirrored(layout.field, one, "y").tobytes()
        assert layout.field != "linear_velocity" or (other[..., 1] == -one[..., 1]).all()


def test_scenes_without_mirror_images(gsb_record: Command, tmp_path: Path) -> None:
    """Refuse to mirror states among fixed bodies that are not mirrored, and say which."""
    for scene, axes, image, why in (
        ("franka", "y", "mirror image", "it has a robot, whose mirror image is not known"),
        ("inclined-collision", "xy", "half-turn image", "no fixed body is the half-turn image of 'board'"),
    ):
        asked = ("--sim", "mujoco", "--scene", scene, "--initial", f"random:0.1,mirror:{axes}", "--out", tmp_path)
        assert f"scene '{scene}' is not its own {image}: {why}" in gsb_record(*asked, code=2).stderr


def test_images_beside_origins() -> None:
    """Mirror positions in the plane through the origin of their environment, and velocities as everywhere."""
    fields, origins = body_fields(FALL.groups(), "float64"), ((0.0, 0.0, 0.0), (0.0, 8.0, 0.0))
    states = tuple(np.ones((2, len(layout.items), layout.width)) for layout in fields)
    found = dict(zip([f.field for f in fields], images(states, Mirror("y"), fields, origins), strict=True))
    assert found["position"][:, 0].tolist() == [[1, -1, 1], [1, 15, 1]]
    assert found["linear_velocity"][:, 0].tolist() == [[1, -1, 1]] * 2


def test_exchanged_states(recorded: tuple[Path, Path], gsb_record: Command, tmp_path: Path) -> None:
    """Begin each cube in the state of another one, from the last to the first, and the ball in its own."""
    again = ("--sim", "mujoco", "--runs", "1", *_SHORT, "--initial", "random:0.1,relabel:reverse", "--out", tmp_path)
    relabelled, usual = open_recording(Path(gsb_record(*again, code=0).stdout.strip())), open_recording(recorded[0])
    assert relabelled.configuration.initial == "random:0.1,relabel:reverse"
    for layout in usual.fields:
        one, other = (np.asarray(r.state(layout.group, layout.field))[0] for r in (usual, relabelled))
        back = slice(None, None, -1 if layout.group == "cubes" else 1)
        assert other.tobytes() == one[:, back].tobytes()
        assert layout.field != "linear_velocity" or len(set(map(bytes, one[0]))) == len(layout.items)


def test_bodies_that_are_not_identical(gsb_record: Command, tmp_path: Path) -> None:
    """Refuse to exchange the states of bodies that are not known to be identical, and say why."""
    for more, why in (
        (("--scene", "cube-toss"), "scene 'cube-toss' has no two identical bodies that move"),
        (("--vary", "mass:0.1"), "has no identical bodies: each has parameters of its own (--vary)"),
    ):
        asked = ("--sim", "mujoco", *more, "--initial", "random:0.1,relabel:reverse", "--out", tmp_path)
        assert why in gsb_record(*asked, code=2).stderr


def test_exchanged_beside_origins() -> None:
    """Exchange states without rounding a position at another place."""
    fields, origins = body_fields(FALL.groups(), "float64"), ((0.0, 0.0, 0.0), (1e3, 8.0, 0.0))
    states = tuple(np.random.default_rng(0).random((2, len(layout.items), layout.width)) for layout in fields)
    found = images(states, Relabelling.of(json.loads(FALL.to_json())), fields, origins)
    assert all(np.array_equal(now, before[:, ::-1]) for now, before in zip(found, states, strict=True))


def test_runs_begin_alike(recorded: tuple[Path, Path]) -> None:
    """Begin environment by environment in the same state in each run: what differs is then the engine's doing."""
    one, other = (open_recording(path) for path in recorded)
    for layout in one.fields:
        states = [np.asarray(recording.state(layout.group, layout.field)) for recording in (one, other)]
        assert states[0].tobytes() == states[1].tobytes()


@pytest.mark.slow
def test_engines_begin_alike(recorded: tuple[Path, Path], gsb_record: Command, tmp_path: Path) -> None:
    """Begin on another engine in the same state, to its precision."""
    done = gsb_record("--sim", "warp", "--option", "device=cpu", "--runs", "1", *_SHORT, "--out", tmp_path, code=0)
    double, single = open_recording(recorded[0]), open_recording(Path(done.stdout.strip()))
    for layout in double.fields:
        there, here = (np.asarray(r.state(layout.group, layout.field))[0] for r in (double, single))
        assert here.dtype == np.float32
        assert np.array_equal(there.astype(np.float32), here), layout.name


def test_robots(gsb_record: Command, tmp_path: Path) -> None:
    """Begin a robot's joints at angles of their own, within their limits, at rest."""
    done = gsb_record(
        "--sim", "mujoco", "--scene", "franka", "--runs", "1", "--n-env", "8", "--steps", "2", "--phases", "capture",
        "--initial", "random:3", "--out", tmp_path, code=0,
    )  # fmt: skip
    recording = open_recording(Path(done.stdout.strip()))
    angles = np.asarray(recording.state("robot", "qpos"))[0, ..., 0]
    robot = make_scene("franka").robot
    lower, upper = np.array([(joint.lower, joint.upper) for joint in robot.joints()]).T
    assert (lower <= angles).all()
    assert (angles <= upper).all()
    assert (np.ptp(angles, axis=0) > 1).all()
    assert not np.asarray(recording.state("robot", "qvel"))[0].any()


def test_a_replay(recorded: tuple[Path, Path], gsb_record: Command, tmp_path: Path) -> None:
    """Begin a replay as its recording began."""
    done = gsb_record("--replay", recorded[0], "--out", tmp_path, code=0)
    assert "seed 7, initial random:0.1, 3 captured steps" in done.stderr
    assert call("gsb-diff", recorded[0], done.stdout.strip()).returncode == 0


def test_what_is_evaluated(recorded: tuple[Path, Path], gsb_eval: Command, tmp_path: Path) -> None:
    """Compare runs, and not environments, which differ by design; keep such runs apart from others."""
    plain = call("gsb-record", "--sim", "mujoco", "--runs", "1", *_SHORT[:6], "--seed", "7", "--out", tmp_path)
    gsb_eval(*recorded, plain.stdout.strip(), "--json", tmp_path / "results.json", code=0)
    alike, apart = sorted(json.loads((tmp_path / "results.json").read_text())["groups"], key=lambda g: g["initial"])
    assert [alike["initial"], apart["initial"]] == ["", "random:0.1"]
    assert alike["label"] != apart["label"]
    assert apart["metrics"]["distinct_runs"]["value"] == 1
    assert alike["metrics"]["distinct_envs"]["value"] == 1
    for name in ("distinct_envs", "w1_parallel", "equality_envs", "divergence_rate"):
        assert "began in different states" in apart["metrics"][name]["value_missing"]


@pytest.mark.parametrize(
    "text",
    [
        "random:",
        "random:0",
        "random:nan",
        "random:4",
        "random:-1",
        "random:1,shift:",
        "random:1,shift:1,but:0",
    ],
)
def test_nothing_that_can_be_drawn(text: str, gsb_record: Command, tmp_path: Path) -> None:
    """Refuse what is no spread, on the command line and in a file."""
    done = gsb_record("--sim", "mujoco", "--initial", text, "--out", tmp_path, code=2)
    named = re.search(r"--initial is random:SPREAD, with a spread from (\S+) to (\S+) ", done.stderr)
    assert named
    for limit in named.groups():
        assert parse(f"random:{limit}", 16, FALL)
    with pytest.raises(UsageError):
        parse(text, 16, FALL)
    known = RunConfiguration("mujoco", "free-fall", 1, 0.01, 10, initial="random:0.1").to_json()
    with pytest.raises(DamagedRecording, match="initial has an unknown value"):
        RunConfiguration.from_json({**known, "initial": text})


def test_what_is_kept() -> None:
    """Keep a spread to the last digit, and say nothing of what begins as its scene does."""
    assert Initial.parse(parse("random:1e-1", 1, FALL)).spread == 0.1
    plain = RunConfiguration("mujoco", "free-fall", 1, 0.01, 10)
    assert "initial" not in plain.to_json()
    drawn = RunConfiguration.from_json({**plain.to_json(), "initial": "random:0.30000000000000004"})
    assert RunConfiguration.from_json(drawn.to_json()) == drawn
    assert Initial.parse(drawn.initial).spread == 0.30000000000000004


def test_an_engine_without(gsb_record: Command, tmp_path: Path) -> None:
    """Refuse an engine whose adapter cannot set states, before anything is begun."""
    done = gsb_record("--sim", "madrona", "--initial", "random:0.1", "--out", tmp_path, code=2)
    assert "'madrona' has no initial states per environment (--initial): the adapter does not offer it" in done.stderr
    assert not any(tmp_path.iterdir())
