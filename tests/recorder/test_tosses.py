"""Sets of tosses: read from either form without executing anything, corrected, and given to environments."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.scenes.cube_toss import EDGE, RATE
from gpusimbench.recorder.trials.tosses import PUBLISHED, SYNTHETIC, read_tosses
from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.initial import GIVEN, Given
from gpusimbench.schemas.tosses import NOTICE, TOSSES, TossSet
from gpusimbench.schemas.view.kinematics import rotate
from tests.conftest import Command

MEASURED = Path(__file__).resolve().parents[3] / "shared" / "cube_toss"
"""The measured set, on machines that have it beside the project."""


def _short(text: str) -> bytes:
    return b"X" + struct.pack("<I", len(text)) + text.encode()


def torch_file(table: NDArray[np.float64], *, called: str = "torch._utils\n_rebuild_tensor_v2") -> bytes:
    """What torch.save wrote before PyTorch 1.6 for a tensor of shape [1, row, column]."""
    rows, columns = table.shape
    size = rows * columns

    def count(value: int) -> bytes:
        return b"K" + bytes([value]) if value < 256 else b"M" + struct.pack("<H", value)

    head = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19." + b"\x80\x02M\xe9\x03." + b"\x80\x02}q\x00."
    tensor = (
        b"\x80\x02c" + called.encode() + b"\nq\x00((" + _short("storage") + b"q\x01ctorch\nDoubleStorage\nq\x02"
        + _short("1234") + b"q\x03" + _short("cpu") + b"q\x04" + count(size) + b"Ntq\x05Q" + count(0) + count(1)
        + count(rows) + count(columns) + b"\x87q\x06" + count(size) + count(columns) + count(1)
        + b"\x87q\x07\x89ccollections\nOrderedDict\nq\x08)Rq\x09tq\nRq\x0b."
    )  # fmt: skip
    keys = b"\x80\x02]q\x00" + _short("1234") + b"q\x01a."
    return head + tensor + keys + struct.pack("<q", size) + np.ascontiguousarray(table, dtype="<f8").tobytes()


def _as_published(folder: Path) -> Path:
    """The synthetic set in the published form, in half edges."""
    raw = np.load(SYNTHETIC)
    folder.mkdir()
    for number, (begin, end) in enumerate(zip(raw["first"][:-1], raw["first"][1:], strict=True)):
        table = np.zeros((end - begin, 19))
        for name, columns in (("position", slice(0, 3)), ("quaternion", slice(3, 7)), ("velocity", slice(7, 10))):
            table[:, columns] = raw[name][begin:end].astype(np.float64)
        table[:, 10:13] = raw["angular_velocity"][begin:end]
        table[:, :3] /= EDGE / 2
        table[:, 7:10] /= EDGE / 2
        (folder / f"{number}.pt").write_bytes(torch_file(table))
    return folder


def test_both_forms(tmp_path: Path) -> None:
    """Give the same tosses from the published form as from an archive."""
    archive, folder = read_tosses(None), read_tosses(_as_published(tmp_path / "tosses"))
    assert folder.known.rows == archive.known.rows
    for name, rows in folder.fields().items():
        np.testing.assert_allclose(rows, archive.fields()[name], rtol=0, atol=1e-12)


@pytest.mark.skipif(not MEASURED.is_dir(), reason="the measured set is not beside the project")
def test_the_measured_set() -> None:
    """Recognise the published set, and find what its card says of it."""
    tosses = read_tosses(MEASURED)
    assert tosses.known.sha256 == PUBLISHED
    assert (len(tosses), sum(tosses.known.rows)) == (570, 59_953)
    assert tosses.known.length_scale == pytest.approx(0.0524 / 0.05125, rel=2e-3)
    assert "BSD" in tosses.notice


def test_known_scale() -> None:
    """Find the scale that the synthetic set was made with, but for the depth at which a soft contact rests."""
    tosses = read_tosses(None)
    assert tosses.synthetic
    assert tosses.known.length_scale == pytest.approx(1 / 0.98, rel=3e-3)
    assert "off 9.81 m/s2" in tosses.known.corrections[0]


@given(st.tuples(*[st.floats(-3, 3)] * 3), st.tuples(*[st.floats(-1, 1)] * 4))
def test_rotated(vector: tuple[float, ...], quaternion: tuple[float, ...]) -> None:
    """Turn as the rotation matrix of SciPy does."""
    from scipy.spatial.transform import Rotation

    q = np.array(quaternion) + [2.0, 0, 0, 0]
    q /= np.linalg.norm(q)
    expected = Rotation.from_quat([*q[1:], q[0]]).apply(np.array(vector))
    np.testing.assert_allclose(rotate(q[None], np.array(vector)[None])[0], expected, atol=1e-12)


def test_first_states() -> None:
    """Begin as the toss does, faster downwards by half an interval of gravity; more environments begin again."""
    tosses = read_tosses(None)
    text, data = tosses.initial(len(tosses) + 2)
    found = arrays.decode(GIVEN, data)
    assert Given.parse(text).step is None
    begin = tosses.first[:-1]
    np.testing.assert_array_equal(found["cubes/position"][: len(tosses), 0], tosses.position[begin])
    np.testing.assert_array_equal(found["cubes/position"][len(tosses) :], found["cubes/position"][:2])
    faster = found["cubes/linear_velocity"][: len(tosses), 0] - tosses.linear_velocity[begin]
    np.testing.assert_allclose(faster, [[0, 0, -9.81 / RATE / 2]] * len(tosses), atol=1e-12)


def test_the_licence_travels(tmp_path: Path, gsb_record: Command) -> None:
    """Put the licence that lies beside the data into the reference, and into every run that begins with them."""
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "tosses.npz").write_bytes(SYNTHETIC.read_bytes())
    (folder / "LICENSE").write_text("Share as you like.", encoding="utf-8")
    gsb_record("--sim", "real", "--scene", "cube-toss", "--tosses", str(folder), "--out", str(tmp_path / "out"))
    gsb_record(
        "--sim", "mujoco", "--scene", "cube-toss", "--tosses", str(folder), "--n-env", "3", "--runs", "1",
        "--steps", "4", "--phases", "capture", "--out", str(tmp_path / "run"),
    )  # fmt: skip
    (reference,) = (tmp_path / "out").glob("*.mcap")
    assert Recording(reference).attachment("LICENSE") == b"Share as you like."
    (run,) = (tmp_path / "run").glob("*.mcap")
    given_states = arrays.decode(GIVEN, Recording(run).attachment(GIVEN) or b"")
    assert str(given_states[NOTICE]) == "Share as you like."


def test_reference(tmp_path: Path, gsb_record: Command) -> None:
    """Record a set as an environment for each toss, which keeps its last row."""
    gsb_record("--sim", "real", "--scene", "cube-toss", "--out", str(tmp_path))
    (path,) = tmp_path.glob("*.mcap")
    recording, tosses = Recording(path), read_tosses(None)
    known = TossSet.from_json(recording.attachment(TOSSES) or b"", recording.configuration.n_env)
    assert known == tosses.known
    position = recording.state("cubes", "position")
    assert position.shape == (442, len(tosses), 1, 3)
    for toss, rows in enumerate(known.rows):
        begin = tosses.first[toss]
        np.testing.assert_array_equal(position[:rows, toss, 0], tosses.position[begin : begin + rows])
        assert (position[rows:, toss, 0] == tosses.position[begin + rows - 1]).all()


def _archive(path: Path, **changed: NDArray[np.float64] | None) -> Path:
    raw = {**np.load(SYNTHETIC), **changed}
    np.savez(path, **{name: array for name, array in raw.items() if array is not None})
    return path


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"velocity": None}, "no array 'velocity'"),
        ({"first": np.array([0, 1, 5])}, "fewer than two rows"),
        ({"first": np.array([0.0, 5410.0])}, "whole numbers"),
        ({"position": np.zeros((4, 3))}, "[5410, 3]"),
        ({"quaternion": np.ones((5410, 4))}, "unit quaternions"),
        ({"angular_velocity": np.full((5410, 3), np.nan)}, "finite"),
    ],
)
def test_no_set(tmp_path: Path, changed: dict[str, NDArray[np.float64] | None], said: str) -> None:
    """Say what is wrong with an archive that is no set of tosses."""
    with pytest.raises(UsageError, match=re.escape(said)):
        read_tosses(_archive(tmp_path / "tosses.npz", **changed))


def test_no_table(tmp_path: Path) -> None:
    """Refuse a .pt file that would call anything, is cut short, or is no toss; nothing of it is run."""
    good = torch_file(np.zeros((5, 19)))
    hostile = {
        "something else": torch_file(np.zeros((5, 19)), called="os\nsystem"),
        "not as long": good[:-8],
        "no matrix": b"PK\x03\x04" + good,
        "a toss has 1": torch_file(np.zeros((5, 18))),
    }
    for said, data in hostile.items():
        (tmp_path / "0.pt").write_bytes(data)
        with pytest.raises(UsageError, match=said):
            read_tosses(tmp_path)
    (tmp_path / "2.pt").write_bytes(good)
    with pytest.raises(UsageError, match="1.pt is missing"):
        read_tosses(tmp_path)
    with pytest.raises(UsageError, match="neither tosses.npz nor"):
        (tmp_path / "empty").mkdir()
        read_tosses(tmp_path / "empty")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--sim", "mujoco", "--tosses", "x"), "--tosses is for scene cube-toss"),
        (("--sim", "real", "--tosses", "x"), "--tosses is for scene cube-toss"),
        (("--sim", "real", "--scene", "cube-toss", "--unit", "m"), "--unit is for positions from a CSV file"),
        (("--sim", "mujoco", "--scene", "cube-toss", "--tosses", "x"), "--tosses x: No such file"),
        (("--sim", "mujoco", "--scene", "cube-toss", "--tosses", "x", "--initial", "random:1"), "give one of them"),
    ],
)
def test_refused(arguments: tuple[str, ...], said: str, gsb_record: Command, tmp_path: Path) -> None:
    """Say what does not go together."""
    ended = gsb_record(*arguments, "--out", str(tmp_path), code=2)
    assert said in ended.stderr


def test_scene_says_what_is_not_known(gsb_record: Command, tmp_path: Path) -> None:
    """Judge mechanics by the most that restitution can be, where nobody knows it."""
    from gpusimbench.evaluator.runs.physics.world import World, world_of

    gsb_record(
        "--sim", "mujoco", "--scene", "cube-toss", "--n-env", "2", "--runs", "1", "--steps", "2", "--phases", "capture",
        "--out", str(tmp_path),
    )  # fmt: skip
    (path,) = tmp_path.glob("*.mcap")
    world = world_of(Recording(path), [("cubes", "cube")])
    assert isinstance(world, World)
    assert world.restitution == 1.0
    assert json.loads(Recording(path).attachment("scene.json") or b"{}")["parameters"] == {"restitution_known": False}


@pytest.mark.slow
def test_another_friction(gsb_record: Command, tmp_path: Path) -> None:
    """Simulate another friction as another scene; the published value leaves the scene as it is, to the byte."""
    run = ("--sim", "mujoco", "--scene", "cube-toss", "--n-env", "2", "--runs", "1", "--steps", "60", "--phases")
    paths = {}
    for value in ("", "0.18", "0.9"):
        option = ("--option", f"friction={value}") if value else ()
        gsb_record(*run, "capture", *option, "--out", tmp_path / (value or "none"), code=0)
        (paths[value],) = (tmp_path / (value or "none")).glob("*.mcap")
    scenes = {value: Recording(path).attachment("scene.json") for value, path in paths.items()}
    states = {value: np.asarray(Recording(path).state("cubes", "position")) for value, path in paths.items()}
    assert scenes[""] == scenes["0.18"] != scenes["0.9"]
    np.testing.assert_array_equal(states[""], states["0.18"])
    assert not np.array_equal(states[""], states["0.9"])
    rough = Recording(paths["0.9"])
    assert {body["material"]["kinetic_friction"] for body in rough.scene["bodies"]} == {0.9}
    assert rough.simulation.options["friction"] == 0.9
    assert gsb_record("--replay", paths["0.9"], "--out", tmp_path / "again").returncode == 0
    (again,) = (tmp_path / "again").glob("*.mcap")
    np.testing.assert_array_equal(states["0.9"], np.asarray(Recording(again).state("cubes", "position")))


@pytest.mark.parametrize(
    ("scene", "value", "said"),
    [
        ("cube-toss", "-1", "a number from 0 to 10"),
        ("cube-toss", "nan", "a number from 0 to 10"),
        ("cube-toss", "much", "a number from 0 to 10"),
        ("free-fall", "0.3", "has no option 'friction'"),
    ],
)
def test_no_friction(scene: str, value: str, said: str, gsb_record: Command, tmp_path: Path) -> None:
    """Refuse what is no friction, and the option in scenes that do not have it."""
    done = gsb_record("--sim", "mujoco", "--scene", scene, "--option", f"friction={value}", "--out", tmp_path, code=2)
    assert said in " ".join(done.stderr.split())


def test_the_reference_as_json(gsb_record: Command, tmp_path: Path) -> None:
    """Name the recording on standard output as runs are named."""
    done = gsb_record("--sim", "real", "--scene", "cube-toss", "--out", tmp_path, "--json")
    (run,) = json.loads(done.stdout)["runs"]
    assert run["status"] == "complete"
    assert Path(run["file"]) in set(tmp_path.glob("*.mcap"))
