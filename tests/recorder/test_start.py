"""Runs that begin with given states, and runs that continue another from a snapshot in the middle."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.recorder.environments.choice import interpreter_for
from gpusimbench.recorder.plan import check
from gpusimbench.recorder.run.start import begin, states_of
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.sets.replay import begun, read_source
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas import arrays
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.fields import body_fields
from gpusimbench.schemas.initial import GIVEN
from tests.conftest import call

_SHORT = ("--runs", "1", "--n-env", "3", "--phases", "capture")
_STEPS = 90
_MIDDLE = 70
"""Cubes have touched by then, so that solvers have caches to lose."""


def _record(*arguments: object) -> Path:
    done = call("gsb-record", *arguments, code=0)
    return Path(done.stdout.strip())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of MuJoCo C with two snapshots."""
    return _record(
        "--sim", "mujoco", *_SHORT, "--steps", _STEPS, "--initial", "random:0.1", "--snapshot", f"{_MIDDLE},30",
        "--out", tmp_path_factory.mktemp("whole"),
    )  # fmt: skip


@pytest.fixture(scope="module")
def rest(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What of it comes after the first snapshot."""
    return _record("--replay", whole, "--from", "30", "--out", tmp_path_factory.mktemp("rest"))


def test_given_positions_are_from_the_origin_of_each_environment() -> None:
    """Add an environment's origin to positions in the frame of the world alone; leave alone what was not given."""
    fields = body_fields({"cubes": ("one", "other")}, "float64")
    present = tuple(np.full((2, 2, field.width), -1.0) for field in fields)
    simulator: Any = SimpleNamespace(n_env=2, state=lambda: present)
    given = {field.name: np.full((2, 2, field.width), 3.0) for field in fields[:-1]}
    for frame in ("world", "env"):
        layout = tuple(replace(field, frame=frame) if field.field == "position" else field for field in fields)
        described: Any = SimpleNamespace(fields=layout, env_origins=((0.0, 0.0, 0.0), (5.0, 6.0, 7.0)))
        found = dict(zip((field.field for field in fields), states_of(given, simulator, described), strict=True))
        origin = np.array(described.env_origins)[:, np.newaxis] if frame == "world" else 0.0
        np.testing.assert_array_equal(found["position"], np.full((2, 2, 3), 3.0) + origin)
        for name, expected in (("orientation", 3.0), ("linear_velocity", 3.0), ("angular_velocity", -1.0)):
            assert (found[name] == expected).all()


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize(
    "arguments",
    [
        pytest.param(("mujoco", "--option", "solver=CG"), marks=pytest.mark.slow),
        ("mujoco", "--scene", "franka"),
        pytest.param(("calibration",), marks=pytest.mark.slow),
        pytest.param(("warp", "--option", "device=cpu"), marks=pytest.mark.slow),
        pytest.param(("mjx", "--scene", "cube-toss"), marks=pytest.mark.slow),
    ],
    ids=" ".join,
)
def test_the_rest_of_a_run(arguments: tuple[str, ...], tmp_path: Path) -> None:
    """Continue in a fresh process with the same bits, actions included; what a run saves does not change it."""
    try:
        interpreter_for(find_simulator(arguments[0]))
    except UsageError as nowhere:
        pytest.skip(str(nowhere))
    asked = ("--sim", *arguments, *_SHORT, "--steps", _STEPS)
    plain = _record(*asked, "--out", tmp_path)
    saved = _record(*asked, "--snapshot", _MIDDLE, "--out", tmp_path)
    continued = _record("--replay", saved, "--from", _MIDDLE, "--out", tmp_path)
    assert call("gsb-diff", plain, saved).returncode == 0
    found = call("gsb-diff", plain, continued)
    assert (found.returncode, found.stdout.splitlines()[0]) == (0, "The two recordings are bit-identical.")
    assert f"from step {_MIDDLE} to {_STEPS}" in found.stdout
    assert call("gsb-check", saved, continued).returncode == 0


@pytest.mark.slow
def test_snapshots_of_a_continued_run(whole: Path, rest: Path, tmp_path: Path) -> None:
    """Save again what is saved behind the beginning, and continue from there, too."""
    assert open_recording(rest).configuration.snapshots == (_MIDDLE,)
    end = _record("--replay", rest, "--from", _MIDDLE, "--out", tmp_path)
    assert call("gsb-diff", whole, end).returncode == 0
    again = _record("--replay", end, "--out", tmp_path)
    assert call("gsb-diff", end, again).returncode == 0


def test_steps_keep_their_numbers(whole: Path, rest: Path) -> None:
    """Number states as the whole run does, and count as made what was made."""
    recording = open_recording(rest)
    state = recording.state("cubes", "position")
    assert (state.steps[0], state.steps[-1]) == (30, _STEPS)
    assert np.array_equal(np.asarray(state), np.asarray(open_recording(whole).state("cubes", "position"))[30:])
    shown = call("gsb-info", rest).stdout
    assert "60 captured steps from step 30 on, each kept" in shown
    assert recording.provenance.replay_of.changed == {"initial": "random:0.1"}


@pytest.mark.slow
def test_an_audit_of_a_continued_run(rest: Path, tmp_path: Path) -> None:
    """Run it again from the snapshot that it holds."""
    done = call("gsb-audit", rest, "--out", tmp_path, code=0)
    assert done.stdout.startswith("Re-execution gives the same bits")


def test_it_is_no_run_from_the_beginning(whole: Path, rest: Path, tmp_path: Path) -> None:
    """Keep it apart from whole runs, and say nothing of motions that are known from the scene's first state."""
    call("gsb-eval", whole, rest, "--json", tmp_path / "results.json", code=0)
    groups = json.loads((tmp_path / "results.json").read_text())["groups"]
    assert len(groups) == 2
    for group in groups:
        checks = group["physics"]["checks"]
        broken = {name for name, check in checks.items() if check["verdict"] == "broken"}
        assert broken <= {"depth_ever", "pair_depth_ever"}, broken  # at 10 ms cubes of MuJoCo C go deep into each other
        assert "did not begin in the scene's first state" in checks["rolling_acceleration"]["reason"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--from", "31"), "no snapshot of step 31; it has 30, 70"),
        (("--from", "30", "--phases", "timed"), "has only capture"),
    ],
)
def test_no_such_snapshot(arguments: tuple[str, ...], said: str, whole: Path, tmp_path: Path) -> None:
    """Say which there are."""
    done = call("gsb-record", "--replay", whole, *arguments, "--out", tmp_path, code=2)
    assert said in done.stderr


@pytest.mark.parametrize("text", ["100", "-1", "1,,2", "x", ",".join(map(str, range(65)))])
def test_no_such_steps(text: str, tmp_path: Path) -> None:
    """Refuse to save states that the run will not have."""
    done = call("gsb-record", "--sim", "mujoco", "--steps", "90", f"--snapshot={text}", "--out", tmp_path, code=2)
    assert "--snapshot is a list of captured steps, from 0 to --steps (90)" in done.stderr


def test_a_snapshot_of_another_configuration(whole: Path, tmp_path: Path) -> None:
    """Refuse arrays that are not like the simulator's own before an engine gets them."""
    source = read_source(whole)
    _, inputs = begun(source, source.configuration, 30)
    data = inputs[GIVEN]
    other = arrays.encode({**arrays.decode("x", data), "qvel": np.zeros((3, 5))})
    simulator = find_simulator("mujoco").load()
    built = simulator(make_scene("inclined-collision"), n_env=3, dt=0.01, seed=0, options=simulator.Options())
    description = built.build()
    digest = f"snapshot:30:{'0' * 64}"
    begin(built, description, digest, data)
    with pytest.raises(
        UsageError, match=r"of 'qvel' it has float64 \(3, 5\), and the simulator has float64 \(3, 168\)"
    ):
        begin(built, description, digest, other)
    with pytest.raises(UsageError, match="they are not there"):
        begin(built, description, digest, None)
    built.close()


def test_a_snapshot_that_was_changed(whole: Path) -> None:
    """Refuse a snapshot that is not the one that the run saved."""
    source = read_source(whole)
    wrong = replace(source, digests={**source.digests, "attachment snapshot-30.npz": "0" * 64})
    with pytest.raises(DamagedRecording, match=r"snapshot-30\.npz is missing, or was changed"):
        begun(wrong, wrong.configuration, 30)
    with pytest.raises(UsageError, match="has no snapshot"):
        begun(source, replace(source.configuration, snapshots=()), 30)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"snapshots": (11,)}, r"from 0 to --steps \(10\)"),
        ({"snapshots": (3,), "initial": f"snapshot:4:{'0' * 64}"}, r"from 4 to --steps \(10\)"),
        ({"snapshots": (1,) * 65}, "at most 64"),
        ({"intervention": "reset@10"}, "comes after a step below --steps, 10"),
    ],
)
def test_what_a_stranger_may_ask(asked: dict[str, Any], said: str) -> None:
    """Refuse a configuration out of a file that would stop the capture at steps that it never makes."""
    known = replace(RunConfiguration("mujoco", "free-fall", 1, 0.01, 10), **asked)
    with pytest.raises(UsageError, match=said):
        check(RunConfiguration.from_json(known.to_json()))


def test_a_run_that_ends_before_it_begins() -> None:
    """Refuse a recording that begins behind its end."""
    known = RunConfiguration("mujoco", "free-fall", 1, 0.01, 10, initial=f"snapshot:9:{'0' * 64}")
    assert RunConfiguration.from_json(known.to_json()) == known
    assert (known.first_step, known.captured_steps) == (9, 1)
    late = {**known.to_json(), "initial": f"snapshot:10:{'0' * 64}"}
    with pytest.raises(DamagedRecording, match="begins at step 10 and ends at step 10"):
        RunConfiguration.from_json(late)


@pytest.mark.slow
def test_states_of_a_recording(whole: Path, tmp_path: Path) -> None:
    """Begin with the positions and velocities of a recording's step, on the same engine and on another."""
    wanted = open_recording(whole)
    for arguments in (("mujoco",), ("warp", "--option", "device=cpu")):
        path = _record("--sim", *arguments, *_SHORT, "--steps", "2", "--initial", f"{whole}@40", "--out", tmp_path)
        recording = open_recording(path)
        assert recording.configuration.initial.startswith("states:")
        for layout in recording.fields:
            mine = np.asarray(recording.state(layout.group, layout.field))[0]
            theirs = np.asarray(wanted.state(layout.group, layout.field))[40]
            assert np.allclose(mine, theirs.astype(mine.dtype), rtol=1e-5, atol=1e-5), layout.name
        assert call("gsb-check", path).returncode == 0
        again = _record("--replay", path, "--out", tmp_path)
        assert call("gsb-diff", path, again).returncode == 0


def test_arrays_of_ones_own(tmp_path: Path) -> None:
    """Take what is given of one environment for all, by the names of the bodies, and the rest from the scene."""
    speed = np.zeros((1, 27, 3))
    names = np.array([f"cube_{x}_{y}_{z}" for x in range(3) for y in range(3) for z in range(3)])[::-1]
    speed[0, :, 2] = np.arange(27)
    np.savez(tmp_path / "given.npz", **{"cubes/linear_velocity": speed, "cubes/items": names})
    path = _record("--sim", "mujoco", *_SHORT, "--steps", "1", "--initial", tmp_path / "given.npz", "--out", tmp_path)
    recording = open_recording(path)
    field = next(f for f in recording.fields if f.name == "cubes/linear_velocity")
    first = np.asarray(recording.state("cubes", "linear_velocity"))[0]
    by_name = dict(zip(names, np.arange(27.0), strict=True))
    assert np.array_equal(first[..., 2], np.broadcast_to([by_name[item] for item in field.items], (3, 27)))
    assert not np.asarray(recording.state("ball", "linear_velocity"))[0].any()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"cubes/linear_velocity": np.zeros((2, 27, 3))}, "of 1 environment or of 3, as --n-env says"),
        ({"cubes/linear_velocity": np.full((1, 27, 3), np.nan)}, "is not all finite numbers"),
        ({"cubes/linear_velocity": np.array([[["x"]]])}, "is not all finite numbers"),
        ({}, "the file has no states"),
    ],
)
def test_arrays_that_cannot_be(given: dict[str, np.ndarray], said: str, tmp_path: Path) -> None:
    """Refuse them before anything is run."""
    np.savez(tmp_path / "given.npz", **given)
    done = call("gsb-record", "--sim", "mujoco", *_SHORT, "--initial", tmp_path / "given.npz", "--out", tmp_path)
    assert done.returncode == 2
    assert said in done.stderr


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"cubes/linear_velocity": np.zeros((1, 26, 3))}, r"have the shape (1, 26, 3), not (3, 27, 3)"),
        ({"cubs/position": np.zeros((1, 27, 3))}, "have 'cubs/position', and the simulator's are"),
    ],
)
def test_arrays_of_another_scene(given: dict[str, np.ndarray], said: str, tmp_path: Path) -> None:
    """Say in the failed recording what does not fit."""
    np.savez(tmp_path / "given.npz", **given)
    done = call("gsb-record", "--sim", "mujoco", *_SHORT, "--initial", tmp_path / "given.npz", "--out", tmp_path)
    assert done.returncode == 1
    assert said in done.stderr


@pytest.mark.parametrize("text", ["random", "nowhere.npz", "nowhere.mcap@3"])
def test_no_such_file(text: str, tmp_path: Path) -> None:
    """Say what is taken."""
    done = call("gsb-record", "--sim", "mujoco", "--initial", text, "--out", tmp_path, code=2)
    assert "it takes a recording, FILE.mcap or FILE.mcap@STEP, or arrays by GROUP/FIELD, FILE.npz" in done.stderr


def test_no_such_step(whole: Path, tmp_path: Path) -> None:
    """Say that the recording ends before."""
    done = call("gsb-record", "--sim", "mujoco", *_SHORT, "--initial", f"{whole}@91", "--out", tmp_path, code=2)
    assert "has no states of step 91" in done.stderr
