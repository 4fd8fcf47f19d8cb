"""Controls of a model's actuators from a file: what is accepted, given to each engine, recorded and replayed."""

from __future__ import annotations

import hashlib
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench import open_recording
from gpusimbench.recorder.scenes.actions import packed
from gpusimbench.recorder.scenes.model import model_scene
from gpusimbench.schemas import arrays
from gpusimbench.schemas.action_generator import Controls, JointTargets, Streams
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.model_files import MODEL, pack
from gpusimbench.schemas.treatment import CONTROLS, FromFile
from gpusimbench.schemas.view.geometry import GEOMETRY
from tests.conftest import call

WALKER = Path(__file__).parents[2] / "examples" / "walker" / "walker.xml"
NAMES = ("left", "right", "shin", "spread")
_SHORT = ("--n-env", "2", "--runs", "1", "--timed-steps", "5", "--warmup", "2", "--no-view")
ROWS = np.random.default_rng(1).uniform(-0.4, 0.4, (30, 2, 4)).astype(np.float32)


def _file(folder: Path, **content: Any) -> Path:
    path = folder / "actions.npz"
    np.savez(path, **content)
    return path


def _record(folder: Path, file: Path, *arguments: object, sim: str = "mujoco") -> Path:
    asked = ("--sim", sim, "--model", WALKER, "--actions", file, *_SHORT, *arguments)
    call("gsb-record", *asked, "--out", folder, code=0)
    (path,) = folder.glob("*.mcap")
    return path


def _from(file: Path) -> JointTargets:
    text, data = packed(str(file))
    found = model_scene("walker", pack(WALKER), actions=text, file=data).actions
    assert found is not None
    return found


def test_what_is_recorded(tmp_path: Path) -> None:
    """Give each environment its own row of each step, columns by the names of the actuators, for as many steps as the
    file has, and keep file and digest; an audit's replay needs the recording alone."""
    order = (3, 2, 1, 0)
    file = _file(tmp_path, controls=ROWS[..., order], actuators=[NAMES[k] for k in order])
    path = _record(tmp_path / "out", file)
    read = open_recording(path)
    np.testing.assert_array_equal(read.actions("controls"), ROWS)
    assert read.configuration.steps == 30
    attached = arrays.decode(CONTROLS, Container(path).attachment(CONTROLS) or b"")
    np.testing.assert_array_equal(attached["controls"], ROWS[..., order])
    found = FromFile.parse(read.configuration.actions)
    assert found.each
    assert read.apart_by_design
    file.unlink()
    done = call("gsb-record", "--replay", path, "--allow-model", "--out", tmp_path / "again", code=0)
    (again,) = (tmp_path / "again").glob("*.mcap")
    assert call("gsb-diff", path, again).stdout.startswith("The two recordings are bit-identical")
    done = call("gsb-info", path)
    assert f"actions file-by-env:{found.sha256[:12]}" in " ".join(done.stdout.split())


def test_environments_alike(tmp_path: Path) -> None:
    """Compare environments with each other where a file or a keyframe gives all of them the same controls."""
    path = _record(tmp_path / "one", _file(tmp_path, controls=ROWS[:, 0]))
    read = open_recording(path)
    np.testing.assert_array_equal(read.actions("controls"), np.repeat(ROWS[:, :1], 2, axis=1))
    position = read.state("bodies", "position")[:]
    assert position[:, 0].tobytes() == position[:, 1].tobytes()
    assert read.apart_by_design == ""
    held = _record(tmp_path / "held", Path("keyframe"), "--steps", "10")
    assert open_recording(held).apart_by_design == ""


def test_rows_begin_anew(tmp_path: Path) -> None:
    """Take rows in order, and the first again after the last, which is for timed steps beyond the file."""
    found = _from(_file(tmp_path, controls=ROWS))
    drawn = found.draw(0, n_env=2, first_step=28, n_step=4)
    np.testing.assert_array_equal(drawn, ROWS[[28, 29, 0, 1]])
    np.testing.assert_array_equal(found.draw(9, n_env=2, first_step=3, n_step=1)[0, 1], ROWS[3, 1])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({}, "has 0 arrays of numbers"),
        ({"a": ROWS, "b": ROWS}, "has 2 arrays of numbers"),
        ({"a": ROWS[0, 0]}, r"an array of float32, \(4,\)"),
        ({"a": np.array(["x"])}, "an array of <U1"),
        ({"a": ROWS[:0]}, r"\(0, 2, 4\)"),
        ({"a": np.full((3, 4), np.nan)}, r"element \[0, 0\] is no finite number"),
        ({"a": np.full((3, 4), 1e39)}, "is no finite number in float32"),
        ({"a": ROWS[..., :3]}, "has 3 columns, and the model has the actuators left, right, shin, spread"),
        ({"a": ROWS, "actuators": ["left", "right", "shin", "tail"]}, "it lacks spread; the model has no tail"),
        ({"a": ROWS, "actuators": ["left", "left", "right", "shin", "spread"]}, "some of them twice"),
        ({"a": 2 * ROWS}, r"gives actuator 'right' .* in step \d+, and its range is -0.6 to 0.4"),
    ],
)
def test_files_that_cannot_be(content: dict[str, NDArray[Any]], said: str, tmp_path: Path) -> None:
    """Say which element, actuator or range is wrong."""
    with pytest.raises(UsageError, match=said):
        _from(_file(tmp_path, **content))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--steps", "31"), "has controls of 30 steps, fewer than --steps, 31"),
        (("--n-env", "3"), "has controls of 2 environments, and --n-env is 3"),
    ],
)
def test_runs_that_cannot_be(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    """Refuse before a run begins a file that is too short, or of other environments."""
    file = _file(tmp_path, controls=ROWS)
    asked = ("gsb-record", "--sim", "mujoco", "--model", WALKER, "--actions", file, *_SHORT, *arguments)
    done = call(*asked, "--out", tmp_path / "out", code=ExitCode.USAGE)
    assert said in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--model", WALKER, "--actions", "gone.npz"), "No such file"),
        (("--model", WALKER, "--actions", "{folder}/text.npz"), "is no archive of arrays"),
        (("--scene", "franka", "--actions", "a.npz"), "--actions is for a model file"),
    ],
)
def test_what_is_no_file(arguments: tuple[object, ...], said: str, tmp_path: Path) -> None:
    """Say that there is none, or what a file has to be."""
    (tmp_path / "text.npz").write_text("left,right")
    asked = [str(word).format(folder=tmp_path) for word in arguments]
    done = call("gsb-record", "--sim", "mujoco", *asked, "--out", tmp_path / "out", code=ExitCode.USAGE)
    assert said in done.stderr


def test_a_sweep(tmp_path: Path) -> None:
    """Refuse controls of each environment where their number changes."""
    file = _file(tmp_path, controls=ROWS)
    asked = ("gsb-record", "--sim", "mujoco", "--model", WALKER, "--actions", file, "--sweep", "2..4")
    done = call(*asked, "--out", tmp_path / "out", code=ExitCode.USAGE)
    assert "whose number --sweep changes" in done.stderr


def test_another_file_than_named(tmp_path: Path) -> None:
    """Take no file whose digest is not the configuration's, and none that holds something else."""
    text, data = packed(str(_file(tmp_path, controls=ROWS)))
    with pytest.raises(UsageError, match="is not the one that the configuration names"):
        model_scene("walker", pack(WALKER), actions=text, file=data + b" ")
    strange = arrays.encode({"something": ROWS})
    named = str(FromFile(hashlib.sha256(strange).hexdigest()))
    with pytest.raises(UsageError, match="the file of actions: an array of float64"):
        model_scene("walker", pack(WALKER), actions=named, file=strange)


@pytest.mark.parametrize("each", [True, False])
def test_on_a_device(each: bool, tmp_path: Path) -> None:
    """Copy rows on the device as the host takes them, for Warp and for JAX; and draw there as before."""
    given = _from(_file(tmp_path, controls=ROWS if each else ROWS[:, 0]))
    usual, others = Streams.usual(2), Streams(np.array([1, 0], dtype=np.uint32), np.array([0, 7], dtype=np.uint32))
    drawn_here = Controls.within("controls", dict.fromkeys(NAMES, (-1.0, 2.0)))
    for actions, streams in product((given, drawn_here), (usual, others)):
        wanted = actions.draw(5, n_env=2, first_step=0, n_step=33, streams=streams)
        if find_spec("warp"):
            import warp as wp

            from gpusimbench.recorder.simulators.warp import runtime
            from gpusimbench.recorder.simulators.warp.runtime import DeviceActions

            runtime.start("cpu")
            drawn, ctrl = DeviceActions(actions, 5, usual), wp.zeros((2, 4), dtype=float)
            drawn.follow(streams)
            for step in range(33):
                drawn.enqueue(ctrl)
                np.testing.assert_array_equal(ctrl.numpy(), wanted[step])
        if find_spec("jax"):
            from gpusimbench.recorder.simulators.jax.simulator import device_draw

            draw = device_draw(actions, seed=5)
            for step in (0, 1, 29, 30, 32):
                np.testing.assert_array_equal(
                    np.asarray(draw(np.uint32(step), streams.env, streams.begun)), wanted[step]
                )


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("sim", ["warp", "mjx"])
def test_on_another_engine(sim: str, tmp_path: Path) -> None:
    """Move as on MuJoCo C with the controls of the same file, which each recording has, in the same layout and look."""
    file = _file(tmp_path, controls=ROWS[:5])
    captured = ("--phases", "capture")  # MJX compiles a program for each phase
    paths = [_record(tmp_path / name, file, *captured, sim=name) for name in ("mujoco", sim)]
    own, other = map(open_recording, paths)
    np.testing.assert_array_equal(own.actions("controls"), other.actions("controls"))
    layouts = [[(f.name, f.items, f.units) for f in read.simulation.fields] for read in (own, other)]
    assert layouts[0] == layouts[1]
    for field in (("joints", "qpos"), ("bodies", "position")):
        np.testing.assert_allclose(own.state(*field)[5], other.state(*field)[5], atol=2e-4)
    assert Container(paths[0]).attachment(GEOMETRY) == Container(paths[1]).attachment(GEOMETRY)
    assert Container(paths[0]).attachment(CONTROLS) == Container(paths[1]).attachment(CONTROLS)
    assert Container(paths[0]).attachment(MODEL) == Container(paths[1]).attachment(MODEL)
