"""gsb-record --intervene teacher@STEPS: environments that are set to measured states again and again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.run.intervention import Teacher
from gpusimbench.recorder.scenes.cube_toss import EDGE, RATE
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.recorder.trials.tosses import Tosses, lowest, read_tosses
from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.initial import GIVEN
from tests.conftest import Command, recorded

_FIELDS = ("position", "orientation", "linear_velocity", "angular_velocity")
_RUN = ("--scene", "cube-toss", "--runs", "1", "--phases", "capture", "--no-view", "--n-env", "5")


def _states(path: Path) -> dict[str, NDArray[np.floating]]:
    recording = Recording(path)
    return {name: np.asarray(recording.state("cubes", name)) for name in _FIELDS}


@pytest.mark.parametrize("simulator", ["mujoco", pytest.param("warp", marks=pytest.mark.slow)])
def test_each_setting_is_a_fresh_start(simulator: str, tmp_path: Path) -> None:
    """Go on from a setting as a run does that begins with the measured row: nothing of the steps before is left."""
    steps = ("--steps", "30", "--sim", simulator)
    (taught,) = recorded(*_RUN, *steps, "--intervene", "teacher@10")
    tosses = read_tosses(None)
    rows = tosses.first[:5] + 20
    begin = {f"cubes/{name}": values[rows][:, np.newaxis] for name, values in tosses.states().items()}
    (tmp_path / "row-20.npz").write_bytes(arrays.encode(begin))
    (fresh,) = recorded(*_RUN, "--sim", simulator, "--steps", "10", "--initial", tmp_path / "row-20.npz")
    after, alone = _states(taught), _states(fresh)
    for name in _FIELDS:
        np.testing.assert_array_equal(after[name][21:], alone[name][1:], err_msg=name)
        assert not np.array_equal(after[name][20], alone[name][0]), "step 20 is what was predicted, not what was set"


def test_free_until_the_first_setting() -> None:
    """Be a plain run up to the first setting, and differ after it."""
    (plain,) = recorded(*_RUN, "--sim", "mujoco", "--steps", "30")
    (taught,) = recorded(*_RUN, "--sim", "mujoco", "--steps", "30", "--intervene", "teacher@10")
    for name in _FIELDS:
        one, other = _states(plain)[name], _states(taught)[name]
        np.testing.assert_array_equal(one[:11], other[:11])
        assert (one[11] != other[11]).any(axis=(1, 2)).all()


def test_a_toss_that_ended_is_left_alone() -> None:
    """Set each environment up to the last measured row of its toss, and let it step on after that."""
    (path,) = recorded(*_RUN, "--sim", "mujoco", "--intervene", "teacher@40", "--steps", "200")
    tosses, states = read_tosses(None), _states(path)
    for env, count in enumerate(tosses.known.rows[:5]):
        assert 80 < count < 160
        for step in (40, 80, 120, 160):
            moved = np.linalg.norm(states["position"][step + 1, env, 0] - states["position"][step, env, 0])
            stepped = np.linalg.norm(states["linear_velocity"][step + 1, env, 0]) / RATE
            jumped = abs(moved - stepped) > 1e-5
            assert jumped == (step < count), (env, step)


@pytest.mark.slow
def test_substeps_and_stride(gsb_record: Command, tmp_path: Path) -> None:
    """Count in steps: ten rows are forty steps of a quarter of a row; the predictions are recorded at any stride."""
    shared = ("--sim", "mujoco", "--dt", str(1 / 148 / 4), "--steps", "120", "--intervene", "teacher@40")
    every = _states(recorded(*_RUN, *shared)[0])
    coarse = _states(recorded(*_RUN, *shared, "--stride", "20")[0])
    for name in _FIELDS:
        np.testing.assert_array_equal(every[name][::20], coarse[name])
    given = arrays.decode(GIVEN, Recording(recorded(*_RUN, *shared)[0]).attachment(GIVEN) or b"")
    tosses = read_tosses(None)
    begin, end = given["teacher/first"][:2]
    np.testing.assert_array_equal(
        given["teacher/cubes/position"][begin:end, 0], tosses.position[tosses.first[0] : tosses.first[1]][10::10]
    )
    for wrong, said in (
        (("--intervene", "teacher@42"), "a measured row is 4 steps; give a whole multiple of 4 steps"),
        (("--intervene", "teacher@40", "--stride", "30"), "--stride is 30"),
        (("--intervene", "teacher@40", "--dt", "0.004"), "no whole part of that"),
    ):
        done = gsb_record(*_RUN, *shared[:6], *wrong, "--out", tmp_path, code=2)
        assert said in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--scene", "free-fall", "--intervene", "teacher@10"), "use it with --scene cube-toss"),
        (("--scene", "cube-toss", "--initial", "random:0.1", "--intervene", "teacher@10"), "without --initial"),
        (("--scene", "cube-toss", "--sweep", "1..4", "--intervene", "teacher@10"), "and --sweep"),
        (("--scene", "cube-toss", "--intervene", "teacher@0"), "teacher@STEPS"),
        (("--scene", "cube-toss", "--intervene", "teacher@500"), "comes after a step below --steps, 441"),
        (("--scene", "cube-toss", "--intervene", "teacher@10", "--keep", "failing"), "poison@STEP alone"),
    ],
)
def test_refused(arguments: tuple[str, ...], said: str, gsb_record: Command, tmp_path: Path) -> None:
    """Say what does not go together."""
    done = gsb_record("--sim", "mujoco", *arguments, "--runs", "1", "--phases", "capture", "--out", tmp_path, code=2)
    assert said in " ".join(done.stderr.split())


def test_replayed(gsb_record: Command, tmp_path: Path) -> None:
    """Make the same bits again from the recording alone."""
    (taught,) = recorded(*_RUN, "--sim", "mujoco", "--steps", "30", "--intervene", "teacher@10")
    gsb_record("--replay", taught, "--out", tmp_path, code=0)
    (again,) = tmp_path.glob("*.mcap")
    for name in _FIELDS:
        np.testing.assert_array_equal(_states(taught)[name], _states(again)[name])


def test_velocities() -> None:
    """Add half an interval of gravity to the velocity of every first row and of rows in free flight, and to no other:
    a cube at rest stays at rest."""
    tosses: Tosses = read_tosses(None)
    added = tosses.states()["linear_velocity"] - tosses.linear_velocity
    assert not added[:, :2].any()
    free = added[:, 2] != 0
    np.testing.assert_allclose(added[free, 2], -9.81 / RATE / 2)
    assert free[tosses.first[:-1]].all()
    clear = tosses.position[:, 2] - lowest(tosses.orientation)
    inner = np.setdiff1d(np.arange(len(free)), tosses.first[:-1])
    np.testing.assert_array_equal(free[inner], (clear[inner] > 0.005) & (clear[inner - 1] > 0.005))
    assert not free[tosses.first[1:] - 1].any()


def test_lowest_corner() -> None:
    """Find the lowest of the eight corners, whatever the orientation."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.random(20, random_state=1)
    corners = EDGE / 2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    expected = [-rotation.apply(corners)[:, 2].min() for rotation in turned]
    np.testing.assert_allclose(lowest(np.roll(turned.as_quat(), 1, axis=1)), expected)


@pytest.fixture
def built() -> tuple[Simulator, Description]:
    """Two environments of MuJoCo C."""
    adapter = find_simulator("mujoco").adapter()
    scene = make_scene("cube-toss")
    made = adapter(scene, n_env=2, dt=0.01, seed=0, options=adapter.parsed("mujoco", scene, {}))
    return made, made.build()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (None, "has none"),
        ({"cubes/position": np.zeros((2, 1, 3))}, "has none"),
        ({"teacher/first": np.array([0, 3]), "teacher/cubes/position": np.zeros((2, 1, 3))}, "does not divide 2 rows"),
        ({"teacher/first": np.array([0, 9, 2]), "teacher/cubes/position": np.zeros((2, 1, 3))}, "does not divide"),
        ({"teacher/first": np.zeros((1, 2)), "teacher/cubes/position": np.zeros((2, 1, 3))}, "does not divide"),
        (
            {
                "teacher/first": np.array([0, 2]), "teacher/cubes/position": np.zeros((2, 1, 3)),
                "teacher/cubes/orientation": np.zeros((1, 1, 4)),
            },
            "different numbers of rows",
        ),
    ],
)  # fmt: skip
def test_no_teacher(
    given: dict[str, NDArray[np.float64]] | None, said: str, built: tuple[Simulator, Description]
) -> None:
    """Refuse an attachment of somebody else's that has no rows, or rows that contradict each other."""
    with pytest.raises(UsageError, match=said):
        Teacher(None if given is None else arrays.encode(given), *built)


def test_rows_of_another_simulator(built: tuple[Simulator, Description]) -> None:
    """Refuse rows that the simulator has no field for, or of another shape."""
    for name, rows in (("balls/position", np.zeros((1, 1, 3))), ("cubes/position", np.zeros((1, 7, 3)))):
        teacher = Teacher(arrays.encode({"teacher/first": np.array([0, 1]), f"teacher/{name}": rows}), *built)
        with pytest.raises(UsageError, match="initial states"):
            teacher.set(0)
