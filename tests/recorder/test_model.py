"""Model files of the user's own: their closure, what is recorded of them, replays, and what is refused."""

from __future__ import annotations

import hashlib
import io
import math
import os
import shutil
import zipfile
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest
import zstandard
from hypothesis import assume, given
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.evaluator.cli import probe
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.evaluator.share.dataset.publish import personal
from gpusimbench.recorder.scenes.model import compiled, model_scene
from gpusimbench.schemas.action_generator import Controls, grid_of
from gpusimbench.schemas.errors import DamagedRecording, ExitCode, UsageError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.model_files import COMPRESSED, MODEL, pack, plain, unpack
from tests.conftest import call
from tests.evaluator.damaged import flipped
from tests.forging import forge

WALKER = Path(__file__).parents[2] / "examples" / "walker" / "walker.xml"
_SHORT = ("--n-env", "2", "--runs", "1", "--steps", "60", "--timed-steps", "5", "--warmup", "2", "--no-view")
_UP = "../" * 40


def _record(folder: Path, *arguments: object, sim: str = "mujoco") -> Path:
    call("gsb-record", "--sim", sim, *_SHORT, *arguments, "--out", folder, code=0)
    (path,) = folder.glob("*.mcap")
    return path


def _gymnasium_models() -> list[Path]:
    found = find_spec("gymnasium")
    assets = Path(str(found.origin)).parent / "envs" / "mujoco" / "assets" if found else Path("nowhere")
    return sorted(assets.glob("*.xml"))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The walker on MuJoCo C: a recording."""
    return _record(tmp_path_factory.mktemp("model"), "--model", WALKER)


def test_the_closure(tmp_path: Path) -> None:
    """Pack the model's own file first and all that it refers to, the same bytes each time, and unpack them again."""
    data = pack(WALKER)
    assert data == pack(WALKER)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.namelist() == ["walker.xml", "meshes/foot.obj", "parts/defaults.xml"]
    main = unpack(data, tmp_path)
    assert main.read_bytes() == WALKER.read_bytes()
    assert pack(main) == data


@pytest.mark.parametrize("path", [WALKER, *_gymnasium_models()], ids=lambda path: path.stem)
def test_all_that_mujoco_reads(path: Path) -> None:
    """Pack at least the files that MuJoCo itself lists, and compile the same model from them."""
    with zipfile.ZipFile(io.BytesIO(pack(path))) as archive:
        packed = {archive.getinfo(name).CRC for name in archive.namelist()}
    listed = mujoco.mju_getXMLDependencies(str(path))
    assert {zipfile.crc32(Path(file).read_bytes()) for file in listed} <= packed  # type: ignore[attr-defined]
    alone, whole = compiled(pack(path))[1], mujoco.MjModel.from_xml_path(str(path))
    for name in ("body_mass", "body_inertia", "jnt_axis", "geom_size", "actuator_ctrlrange", "qpos0"):
        assert np.array_equal(getattr(alone, name), getattr(whole, name)), name


def test_files_above_the_model(tmp_path: Path) -> None:
    """Keep the folders that a path with ".." needs, and nothing of where they lie on this machine."""
    (tmp_path / "robots" / "a").mkdir(parents=True)
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "foot.obj").write_bytes((WALKER.parent / "meshes" / "foot.obj").read_bytes())
    path = tmp_path / "robots" / "a" / "robot.xml"
    path.write_text(
        '<mujoco><compiler meshdir="../../meshes"/><asset><mesh name="foot" file="foot.obj"/></asset><worldbody><body>'
        '<joint/><geom type="mesh" mesh="foot"/></body></worldbody></mujoco>'
    )
    data = pack(path)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.namelist() == ["robots/a/robot.xml", "meshes/foot.obj"]
    assert compiled(data)[1].nmesh == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<mujoco", "is no XML"),
        ('<!DOCTYPE a [<!ENTITY b SYSTEM "/etc/passwd">]><mujoco>&b;</mujoco>', "has a DOCTYPE"),
        ('<mujoco><asset><mesh file="gone.obj"/></asset></mujoco>', "no such file"),
        ('<mujoco><asset><mesh file="/etc/hostname"/></asset></mujoco>', "by paths relative to itself"),
        ('<robot><mesh filename="package://robot/foot.obj"/></robot>', "by paths relative to itself: MuJoCo does not"),
        (
            '<robot><mujoco><compiler discardvisual="false"/></mujoco><link><visual><geometry>'
            '<mesh filename="foot.dae"/></geometry></visual></link></robot>',
            "no such file",
        ),
    ],
)
def test_no_closure(text: str, said: str, tmp_path: Path) -> None:
    """Say which file a model refers to that a recording cannot carry."""
    (tmp_path / "robot.xml").write_text(text)
    with pytest.raises(UsageError, match=said):
        pack(tmp_path / "robot.xml")


def test_what_is_only_drawn_of_urdf(tmp_path: Path) -> None:
    """Record a robot of ROS whose visual meshes lie elsewhere: MuJoCo opens none."""
    (tmp_path / "robot.urdf").write_text(
        '<robot name="arm"><material name="m"><texture filename="package://arm/skin.png"/></material><link name="base">'
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<visual><geometry><mesh filename="package://arm/base.dae"/></geometry></visual>'
        '<collision><geometry><mesh filename="foot.obj"/></geometry></collision></link></robot>'
    )
    (tmp_path / "foot.obj").write_bytes((WALKER.parent / "meshes" / "foot.obj").read_bytes())
    data = pack(tmp_path / "robot.urdf")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.namelist() == ["robot.urdf", "foot.obj"]
    assert compiled(data)[1].nmesh == 1


def _archive(**files: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name), text)  # of no time: names of tests are made of these bytes
    return stream.getvalue()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "no archive"),
        (_archive(), "has no files"),
        (_archive(**{"../robot.xml": "<mujoco/>"}), "outside it"),
        (_archive(**{"/tmp/robot.xml": "<mujoco/>"}), "outside it"),
        (_archive(**{"a/../../robot.xml": "<mujoco/>"}), "outside it"),
        (_archive(**{"C:robot.xml": "<mujoco/>"}), "outside it"),
        (_archive(**{"a\\robot.xml": "<mujoco/>"}), "outside it"),
        (_archive(**{"robot\x1b.xml": "<mujoco/>"}), "outside it"),
        (_archive(**{"robot.xml": "<mujoco/>", "robot.xml/a": ""}), "no archive of files"),
        (_archive(**{"robot.xml": '<mujoco><include file="../../etc/hostname"/></mujoco>'}), "no such file|outside"),
        (
            _archive(**{"a/robot.xml": f'<mujoco><asset><mesh file="{_UP}etc/hostname"/></asset></mujoco>'}),
            "outs",
        ),
        (_archive(**{"robot.xml": "<mujoco/>"})[:-30], "no archive"),
    ],
)
def test_hostile_archives(data: bytes, said: str, tmp_path: Path) -> None:
    """Write nothing outside the folder, and let MuJoCo read nothing that lies elsewhere."""
    with pytest.raises(DamagedRecording, match=said):
        unpack(data, tmp_path / "inside")
    assert not {path.name for path in tmp_path.iterdir()} - {"inside"}


def test_the_layout(recording: Path) -> None:
    """Lay states out by the names of bodies and joints, each in its unit, beginning in the first keyframe."""
    read = open_recording(recording)
    items = {field.name: field.items for field in read.simulation.fields}
    assert items["bodies/position"] == ("trunk", "crate")
    assert items["joints/qpos"] == ("left_hip", "right_hip", "right_shin", "joint5")
    assert items["balls/orientation"] == ("left_ankle",)
    units = {field.name: field.units for field in read.simulation.fields}
    assert units["joints/qpos"] == ("rad", "rad", "m", "rad")
    assert units["joints/qvel"] == ("rad/s", "rad/s", "m/s", "rad/s")
    np.testing.assert_array_equal(read.state("bodies", "position")[0, 1], [[0, 0, 0.6], [0.6, 0.2, 0.1]])
    np.testing.assert_array_equal(read.state("joints", "qpos")[0, 0, :, 0], [0.2, -0.2, 0, 0])
    assert (read.configuration.scene, read.configuration.keyframe) == ("walker", "crouched")
    assert read.configuration.actions == "random:1.0"
    assert read.configuration.dt == 0.004


def test_the_states_are_mujocos(recording: Path) -> None:
    """Record, bit for bit, what a loop over mj_step gives with the recorded actions and the solver of the file."""
    read = open_recording(recording)
    drawn = Controls.within("controls", {"left": (-8, 8), "right": (-0.6, 0.4), "shin": (-1, 1), "spread": (-2, 2)})
    actions = drawn.draw(0, n_env=2, first_step=0, n_step=60)
    model = mujoco.MjModel.from_xml_path(str(WALKER))
    assert (model.opt.iterations, read.simulation.options["iterations"]) == (20, 20)
    for env in range(2):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for step in range(60):
            data.ctrl[:] = actions[step, env]
            mujoco.mj_step(model, data)
            np.testing.assert_array_equal(read.state("bodies", "position")[step + 1, env, 0], data.qpos[:3])
            np.testing.assert_array_equal(read.state("balls", "orientation")[step + 1, env, 0], data.qpos[8:12])
            hips = data.qpos[[7, 12]]
            np.testing.assert_array_equal(read.state("joints", "qpos")[step + 1, env, :2, 0], hips)


def test_a_replay(recording: Path, tmp_path: Path) -> None:
    """Replay the model that a recording carries, bit for bit, where the user allows it and not otherwise."""
    done = call("gsb-record", "--replay", recording, "--out", tmp_path, code=ExitCode.USAGE)
    assert "add --allow-model" in done.stderr
    refused = call("gsb-audit", recording, "--out", tmp_path / "audited")
    assert " ".join((refused.stdout + refused.stderr).split()).count("add --allow-model") == 1
    call("gsb-record", "--replay", recording, "--allow-model", "--out", tmp_path, code=0)
    (again,) = tmp_path.glob("*.mcap")
    assert call("gsb-diff", recording, again).stdout.startswith("The two recordings are bit-identical")
    assert Container(again).attachment(MODEL) == pack(WALKER)


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A model of 200 kB, and a recording of it."""
    folder = tmp_path_factory.mktemp("large") / "walker"
    shutil.copytree(WALKER.parent, folder)
    model = folder / "walker.xml"
    model.write_text(model.read_text() + f"<!-- jane@example.org {'0123456789' * 20_000} -->")
    return model, _record(folder.parent / "out", "--model", model, "--phases", "capture")


def test_a_large_model_is_compressed(large: tuple[Path, Path], recording: Path, tmp_path: Path) -> None:
    """Record a large model as one frame, whose archive is the model's identity, and replay it; leave a small one."""
    model, path = large
    read = open_recording(path)
    assert MODEL not in read.attachment_names()
    archive = plain(COMPRESSED, read.attachment(COMPRESSED) or b"")
    assert archive == pack(model)
    assert read.configuration.model == hashlib.sha256(archive).hexdigest()
    assert path.stat().st_size < len(archive)
    assert open_recording(recording).attachment(MODEL) == pack(WALKER)
    call("gsb-record", "--replay", path, "--allow-model", "--out", tmp_path, code=0)
    (again,) = tmp_path.glob("*.mcap")
    assert call("gsb-diff", path, again).stdout.startswith("The two recordings are bit-identical")
    assert open_recording(again).attachment(COMPRESSED) == read.attachment(COMPRESSED)


def test_a_large_model_that_was_attached_as_it_is(large: tuple[Path, Path], tmp_path: Path) -> None:
    """Replay what earlier versions recorded of a large model, with the same bits; the way of storing is no setting."""
    model, path = large
    earlier = forge(path, tmp_path / "earlier.mcap", _nothing, renamed={COMPRESSED: (MODEL, pack(model))})
    call("gsb-check", earlier, code=0)
    call("gsb-record", "--replay", earlier, "--allow-model", "--out", tmp_path / "again", code=0)
    (again,) = (tmp_path / "again").glob("*.mcap")
    assert COMPRESSED in open_recording(again).attachment_names()
    told = call("gsb-diff", earlier, again, "--all").stdout
    assert told.startswith("The two recordings are bit-identical")
    assert MODEL not in told


def test_a_flipped_bit_of_a_compressed_model(large: tuple[Path, Path], tmp_path: Path) -> None:
    """Say which attachment was changed, and do not replay it."""
    _, path = large
    data = path.read_bytes()
    frame = open_recording(path).attachment(COMPRESSED) or b""
    changed = tmp_path / "changed.mcap"
    changed.write_bytes(flipped(data, data.index(frame) + len(frame) // 2))
    assert f"the attachment {COMPRESSED}" in call("gsb-check", changed, code=ExitCode.DATA_LOST).stdout
    replayed = call("gsb-record", "--replay", changed, "--allow-model", "--out", tmp_path, code=ExitCode.DATA_LOST)
    assert COMPRESSED in replayed.stderr


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        (COMPRESSED, zstandard.compress(b"another model"), "is not the model whose SHA-256 the configuration names"),
        (COMPRESSED, zstandard.compress(bytes(1 << 29)), "announces 536870912 bytes, and at most"),
        (COMPRESSED, b"no frame", "model.zip.zst: "),
        (MODEL, b"another model", "is not the model whose SHA-256 the configuration names"),
    ],
    ids=["another", "bomb", "no-frame", "another-as-it-is"],
)
def test_a_recording_with_another_model(
    name: str, data: bytes, said: str, large: tuple[Path, Path], tmp_path: Path
) -> None:
    """Name a model that is not the one that was asked for, where digests and content hash were made to fit."""
    forged = forge(large[1], tmp_path / "forged.mcap", _nothing, renamed={COMPRESSED: (name, data)})
    with pytest.raises(DamagedRecording, match=rf"forged\.mcap: .*{said}"):
        verify(open_recording(forged))
    assert said in " ".join(call("gsb-check", forged, code=ExitCode.DATA_LOST).stdout.split())
    replayed = call("gsb-record", "--replay", forged, "--allow-model", "--out", tmp_path)
    assert replayed.returncode in (ExitCode.USAGE, ExitCode.DATA_LOST)
    assert not list((tmp_path).glob("mujoco*"))


def test_what_may_be_personal_in_a_compressed_model(large: tuple[Path, Path]) -> None:
    """Find an address of mail in a file of the model."""
    assert ("jane@example.org", COMPRESSED) in {(found.text, found.where) for found in personal(large[1])}


def _nothing(document: object) -> None:
    """Leave provenance.json as it is."""


def test_a_snapshot(tmp_path: Path) -> None:
    """Go on in the middle of a run of a model, with the same bits."""
    whole = _record(tmp_path / "whole", "--model", WALKER, "--snapshot", "30", "--phases", "capture")
    call("gsb-record", "--replay", whole, "--allow-model", "--from", "30", "--out", tmp_path / "rest", code=0)
    (rest,) = (tmp_path / "rest").glob("*.mcap")
    first, second = open_recording(whole), open_recording(rest)
    np.testing.assert_array_equal(first.state("joints", "qpos")[30:], second.state("joints", "qpos")[:])


def test_initial_states_of_their_own(tmp_path: Path) -> None:
    """Draw angles within the limits of the model's joints, and speeds of its free bodies."""
    read = open_recording(_record(tmp_path, "--model", WALKER, "--initial", "random:3"))
    angles = read.state("joints", "qpos")[0, :, :, 0]
    assert (np.abs(angles[:, :2]) <= math.radians(60)).all()
    assert (np.abs(angles[:, 2]) <= 0.05).all()
    assert (angles[0] != angles[1]).any()
    assert (read.state("bodies", "linear_velocity")[0] != 0).any()


def test_actions_that_are_held(tmp_path: Path) -> None:
    """Hold the controls of a keyframe to the last bit of a float32."""
    path = _record(tmp_path, "--model", WALKER, "--actions", "keyframe")
    topics = [topic for topic in Container(path).channels if topic.startswith("/action/controls/")]
    assert topics
    assert open_recording(path).configuration.actions == "keyframe"
    values = {"a": 0.5, "b": 0.1, "c": 0.0, "d": -1e-30}
    held = Controls.within("controls", {name: (value, value) for name, value in values.items()})
    drawn = held.draw(7, n_env=2, first_step=3, n_step=2)
    np.testing.assert_array_equal(drawn, np.broadcast_to(np.float32([0.5, 0.1, 0.0, -1e-30]), drawn.shape))


@given(
    lower=st.floats(-(2.0**66), 2.0**66, width=32),
    upper=st.floats(-(2.0**66), 2.0**66, width=32),
    seed=st.integers(0, 2**64 - 1),
)
def test_controls_stay_within_their_range(lower: float, upper: float, seed: int) -> None:
    """Draw exact multiples of a power of two within any range, and near both of its ends."""
    assume(lower <= upper and (lower == upper or upper - lower > 1e-30))
    assume(all(end == 0 or abs(end) > 1e-30 for end in (lower, upper)))  # what is smaller is taken as zero
    drawn = Controls.within("controls", {"a": (lower, upper)}).draw(seed, n_env=50, first_step=0, n_step=20).ravel()
    grid = grid_of(lower, upper)
    assert math.frexp(grid)[0] == 0.5
    assert (drawn >= np.float32(lower)).all()
    assert (drawn <= np.float32(upper)).all()
    assert (np.remainder(drawn.astype(np.float64), grid) == 0).all()
    if upper - lower > 1e-6 * max(abs(lower), abs(upper)):
        assert drawn.min() <= lower + 0.1 * (upper - lower)
        assert drawn.max() >= upper - 0.1 * (upper - lower)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--scene", "franka"), "give one of them"),
        (("--keyframe", "crouchd"), "no keyframe 'crouchd'; it has crouched, turned, none; did you mean 'crouched'?"),
        (("--actions", "wild"), "--actions is none, random"),
        (("--actions", "random:1.5"), "--actions is none, random"),
        (("--keyframe", "none", "--actions", "keyframe"), "environments begin in none"),
        (("--option", "condim=4"), "the geoms of walker.xml have their own"),
    ],
)
def test_arguments_that_cannot_be(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    """Refuse before a run begins, and say what there is."""
    done = call("gsb-record", "--sim", "mujoco", "--model", WALKER, *arguments, "--out", tmp_path, code=ExitCode.USAGE)
    assert said in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("simulator", ["sapien", "brax"])
def test_engines_that_take_no_models(simulator: str, tmp_path: Path) -> None:
    """Name the ability that an engine lacks, and the simulators that have it."""
    done = call("gsb-record", "--sim", simulator, "--model", WALKER, "--out", tmp_path, code=ExitCode.USAGE)
    assert f"simulator '{simulator}' cannot simulate scene 'walker': it has no model files; " in done.stderr
    others = done.stderr.partition("simulators that can: ")[2].strip().split(", ")
    assert {"mujoco", "newton", "genesis", "physx", "isaaclab"} <= set(others)
    assert not {"sapien", "brax", "maniskill", "calibration"} & set(others)


def test_what_is_no_model_file(tmp_path: Path) -> None:
    """Say what to give instead of a compiled model, and of what cannot be read twice."""
    compiled_model = tmp_path / "robot.mjb"
    mujoco.mj_saveModel(mujoco.MjModel.from_xml_string(_SLEEPING), str(compiled_model), None)
    with pytest.raises(UsageError, match="give the MJCF or URDF that it was made from"):
        pack(compiled_model)
    pipe = tmp_path / "pipe.xml"
    os.mkfifo(pipe)
    for other in (pipe, tmp_path):
        with pytest.raises(UsageError, match="give a file with the model, MJCF or URDF"):
            pack(other)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<mujoco/>", "has no joint, so that nothing in it moves: give a body a <freejoint/>"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "does not compile robot.xml"),
        (
            '<mujoco><worldbody><body name="a,b"><freejoint/><geom size=".1"/></body></worldbody></mujoco>',
            "a name with a comma in it",
        ),
        (
            '<mujoco><worldbody><body mocap="true" name="m"><geom size=".1"/></body><body><freejoint/><geom size=".1"/>'
            '</body></worldbody><keyframe><key mpos="1 0 0"/></keyframe></mujoco>',
            "moves mocap bodies",
        ),
        (
            '<mujoco><worldbody><body pos="0 0 nan"><freejoint/><geom size=".1"/></body></worldbody></mujoco>',
            "robot.xml has numbers that are not finite: MuJoCo compiles it with qpos0, body_pos of NaN or inf",
        ),
    ],
)
def test_models_that_cannot_be(text: str, said: str, tmp_path: Path) -> None:
    """Say what of a model a recording cannot hold, or MuJoCo's own message."""
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(UsageError, match=said):
        model_scene("robot", pack(path))


_SEVERAL = """
<mujoco><option integrator="discrete"/><worldbody>
  <body><joint name="hinge"/><geom size=".1"/></body>
  <body pos="1 0 0"><joint name="other"/><geom size=".1"/></body>
</worldbody><actuator>
  <dcmotor name="servo" joint="hinge" motorconst="1" resistance="1" input="pos vel" controller="10 0 5"/>
  <motor joint="other" ctrlrange="-3 3"/>
</actuator></mujoco>
"""


def test_an_actuator_of_several_controls(tmp_path: Path) -> None:
    """Draw each of its controls under a name of its own, and step with the integrator that the file asks for."""
    path = tmp_path / "several.xml"
    path.write_text(_SEVERAL)
    read = open_recording(_record(tmp_path / "out", "--model", path))
    scene = model_scene("several", pack(path))
    assert scene.actions.joints == ("servo.0", "servo.1", "actuator1")
    assert (scene.actions.lower, scene.actions.upper) == ((-1, -1, -3), (1, 1, 3))
    assert read.actions("controls").shape[-1] == len(scene.actions.joints)
    assert read.simulation.options["integrator"] == "discrete"


_SLEEPING = """
<mujoco><option><flag sleep="enable"/></option><worldbody>
  <geom type="plane" size="5 5 1"/>
  <body pos="0 0 .1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
</worldbody></mujoco>
"""


def test_bodies_that_sleep(tmp_path: Path) -> None:
    """Step models that mujoco.batch does not take, with MuJoCo's own bits; refuse to save a state that lacks a part."""
    path = tmp_path / "sleeping.xml"
    path.write_text(_SLEEPING)
    read = open_recording(_record(tmp_path / "out", "--model", path))
    _, model = compiled(pack(path))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 60)
    np.testing.assert_array_equal(read.state("bodies", "position")[-1, :, 0], np.tile(data.qpos[:3], (2, 1)))
    asked = ("gsb-record", "--sim", "mujoco", "--model", path, *_SHORT)
    saved = call(*asked, "--snapshot", "30", "--out", tmp_path / "saved")
    assert saved.returncode != ExitCode.OK
    assert 'set <flag sleep="disable"/> in the model' in saved.stderr
    batch = call(*asked, "--option", "stepping=batch", "--out", tmp_path / "batch")
    assert "use stepping=mj_step" in batch.stderr


def test_a_model_named_like_a_scene(tmp_path: Path) -> None:
    """Tell a file called franka.xml from the registered scene."""
    path = tmp_path / "franka.xml"
    path.write_text('<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody></mujoco>')
    made = _record(tmp_path / "out", "--model", path)
    assert open_recording(made).configuration.scene == "franka-model"


_OWN_NUMBERS = """
<mujoco>
  <custom><numeric name="start" data="0 0 0"/><numeric name="max_contact_points" data="1"/></custom>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="ball" pos="0 0 .12"><freejoint/><geom size=".1"/></body>
  </worldbody>
</mujoco>
"""


def test_numbers_of_an_engine_stand_before_those_of_a_model(tmp_path: Path) -> None:
    """Put a limit where MJX looks for it: a model's own array of numbers before it took all contacts from the model."""
    path = tmp_path / "own.xml"
    path.write_text(_OWN_NUMBERS)
    _, model = compiled(pack(path), {"max_geom_pairs": "3", "max_contact_points": "4"})
    assert [model.numeric(i).name for i in range(model.nnumeric)] == ["max_geom_pairs", "max_contact_points", "start"]
    assert model.numeric_data.tolist() == [3, 4, 0, 0, 0]
    assert list(model.numeric_adr) == [0, 1, 2]


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
def test_a_model_with_numbers_of_its_own_keeps_its_contacts(tmp_path: Path) -> None:
    """Let a ball come to rest on a plane in MJX; it fell through."""
    pytest.importorskip("mujoco.mjx")
    path = tmp_path / "own.xml"
    path.write_text(_OWN_NUMBERS)
    found = open_recording(_record(tmp_path / "out", "--model", path, "--phases", "capture", sim="mjx"))
    assert abs(found.state("bodies", "position")[-1, :, 0, 2] - 0.1).max() < 0.01


@pytest.mark.parametrize("command", ["gsb-info", "gsb-check", "gsb-eval"])
def test_what_is_said_of_it(command: str, recording: Path) -> None:
    """Inspect, check and evaluate a recording of a model."""
    done = call(command, recording, code=0)
    assert "walker" in done.stdout or command == "gsb-check"
    assert "begins in keyframe crouched; actions random:1.0" in " ".join(done.stdout.split()) or command != "gsb-info"


@pytest.mark.slow
def test_a_probe(tmp_path: Path) -> None:
    """Ask of a model what results depend on; go on in its folder, but not where the model's files are others."""
    asked = ("--sim", "mujoco", "--quick", "--steps", "30", "--n-env", "3", "--numbers", "1,4", "--out", tmp_path)
    call("gsb-probe", "--model", WALKER, *asked, "--gate", code=0)
    made = sorted(tmp_path.glob("*.mcap"))
    assert {open_recording(path).configuration.actions for path in made} == {"random:1.0"}
    assert call("gsb-probe", "--model", WALKER, *asked).returncode == 0
    assert sorted(tmp_path.glob("*.mcap")) == made
    shutil.copytree(WALKER.parent, tmp_path / "heavier")
    heavier = tmp_path / "heavier" / "walker.xml"
    heavier.write_text(heavier.read_text().replace('mass="3"', 'mass="4"'))
    for model, same in ((WALKER, True), (heavier, False)):
        (plan,) = probe._plans(probe.parser().parse_args([*map(str, asked), "--model", str(model)]))
        assert all(plan.has(open_recording(path).configuration) is same for path in made)
