"""What viewers find in a recording: read by the mcap package and by rerun, never by our own readers."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from gpusimbench import open_recording
from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.diff.settings import differing_settings
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.evaluator.share.copies import pack, recover
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.view import ViewWriter
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.plan import view_of
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, ExitCode, UsageError
from gpusimbench.schemas.fields import body_field
from gpusimbench.schemas.mcap.reader import Container
from tests.conftest import Command, call, finished
from tests.evaluator.viewing import placed, read, states
from tests.test_docs import ROOT, commands, shell

LAYOUT = ROOT / "viewers" / "foxglove-layout.json"
RERUN = shutil.which("rerun") or shutil.which("rerun", path=str(Path(sys.executable).parent))

SCENE, TRANSFORMS = "/state/view/scene/{:06d}", "/state/view/transforms/{:06d}"


def recorded(folder: Path, *arguments: object) -> Path:
    """One recording of MuJoCo, states alone."""
    done = call(
        "gsb-record", "--sim", "mujoco", "--runs", 1, "--phases", "capture", "--n-env", 4, "--steps", 60,
        "--out", folder, *arguments, code=0,
    )  # fmt: skip
    return Path(done.stdout.strip())


def nothing_wrong(path: Path) -> bool:
    """Whether gsb-check finds nothing, and looked at the view."""
    found = examine(path).problems
    return not found.kinds()


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording as the command makes it; must not be written to."""
    return recorded(tmp_path_factory.mktemp("view"))


def test_types_that_viewers_know(plain: Path) -> None:
    """Write the view in Foxglove's types, under their names, each with its definition."""
    with plain.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    types = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values() if "/view/" in c.topic}
    assert types == {
        "/state/view/log/000000": "foxglove.Log",
        "/state/view/scene/000000": "foxglove.SceneUpdate",
        "/state/view/transforms/000000": "foxglove.FrameTransforms",
        "/state/view/ball_poses/000000": "foxglove.PosesInFrame",
        "/state/view/cubes_poses/000000": "foxglove.PosesInFrame",
    }


def test_what_viewers_need_to_seek(plain: Path) -> None:
    """Index every chunk and every message of it, and count them."""
    found, summary = read(plain)
    assert summary.statistics.message_count == sum(map(len, found.values()))
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 0
    assert all(index.message_index_offsets for index in summary.chunk_indexes)
    assert summary.statistics.message_start_time == 1_000_000_000
    for topic in (topic for topic in found if "/view/" in topic):
        times = [time for time, _ in found[topic]]
        assert times == sorted(set(times))


def test_frames_are_where_the_states_are(plain: Path) -> None:
    """Chain frames from the root to the recorded poses, at several times, with w first in states and last here."""
    found, _ = read(plain)
    shown = found[TRANSFORMS.format(0)]
    assert len(shown) == 16  # rows 0, 4, 8, ... of 61: 25 Hz
    names = make_scene("inclined-collision").groups()["cubes"]
    for time, transforms in (shown[0], shown[7], shown[-1]):
        frames = placed(transforms)
        position = states(found, "/state/cubes/position/000000", time)
        orientation = states(found, "/state/cubes/orientation/000000", time)
        for item, name in enumerate(names):
            at, q = frames[f"env0/{name}"]
            assert np.array_equal(at, position[0, item])
            assert np.array_equal(q, orientation[0, item])
        assert {t.timestamp.ToNanoseconds() for t in transforms.transforms} == {time}
    ((time, scene),) = found[SCENE.format(0)]
    assert time == 1_000_000_000
    assert all(entity.frame_locked and entity.frame_id in frames for entity in scene.entities)
    assert len(scene.entities) == 30
    last = found["/state/view/cubes_poses/000000"][-1][1]
    assert last.frame_id == "env0"
    assert [pose.position.z for pose in last.poses] == position[0, :, 2].tolist()


def test_events_are_shown(plain: Path) -> None:
    """Show the run's events as a log at the times that they have in the file, and how the run ended."""
    found, _ = read(plain)
    lines = [line.message for _, line in found["/state/view/log/000000"]]
    assert lines[0] == "phase begin baseline"
    assert lines[-1] == "status complete"
    assert len(lines) == len(found["/run/event"]) + 1


def test_the_layout_ships(plain: Path) -> None:
    """Keep the layout in the file, and the same in the repository."""
    with plain.open("rb") as stream:
        (record,) = (r for r in make_reader(stream).iter_metadata() if r.name == "gsb-view")
    assert record.metadata["environments"] == "0"
    layout = record.metadata["layout"]
    assert layout == LAYOUT.read_text()
    panels = json.loads(layout)["configById"]
    topics = {*panels["3D!scene"]["topics"], panels["RosOut!events"]["topicToRender"]}
    assert topics < set(read(plain)[0])


@pytest.mark.parametrize(
    "arguments",
    [
        ("--view-env", 3, "--view-env", 1),
        pytest.param(("--stride", 3), marks=pytest.mark.slow),
        pytest.param(("--capture", "memory", "--compression", "zstd"), marks=pytest.mark.slow),
        ("--scene", "franka", "--compression", "lz4"),
    ],
    ids=str,
)
def test_the_view_is_that_of_the_states(arguments: tuple[object, ...], tmp_path: Path) -> None:
    """Find the view in agreement with the states however these are recorded, and packed."""
    path = recorded(tmp_path, *arguments)
    envs = [3, 1] if "--view-env" in arguments else [0]
    found, _ = read(path)
    for env in envs:
        times = [time for time, _ in found[TRANSFORMS.format(env)]]
        assert np.diff(times).min() >= 1e9 / 30
        assert np.diff(times).max() < 2e9 / 30
    assert len([topic for topic in found if "/transforms/" in topic]) == len(envs)
    assert open_recording(path).configuration.view == tuple(envs)
    assert nothing_wrong(path)
    packed = pack(path, tmp_path / "packed.mcap", level=1)
    assert packed.content_hash == open_recording(path).content_hash
    assert nothing_wrong(packed.path)


def test_links_are_where_the_engine_puts_them(tmp_path: Path) -> None:
    """Chain a robot's links to what MuJoCo's own kinematics gives for the recorded joint angles."""
    path = recorded(tmp_path, "--scene", "franka", "--view-env", 2)
    found, _ = read(path)
    model = mujoco.MjModel.from_xml_string((open_recording(path).attachment("scene.xml") or b"").decode())
    data = mujoco.MjData(model)
    for time, transforms in found[TRANSFORMS.format(2)][::5]:
        data.qpos[:] = states(found, "/state/robot/qpos/000000", time)[2, :, 0]
        mujoco.mj_kinematics(model, data)
        frames = placed(transforms)
        for link in ("link1", "link4", "hand"):
            at, q = frames[f"env2/{link}"]
            body = data.body(link)
            assert np.allclose(at, body.xpos, atol=1e-6)
            assert min(np.abs(q - body.xquat).max(), np.abs(q + body.xquat).max()) < 1e-6


def without_view(source: Path, target: Path) -> Path:
    """The same recording as --no-view would have written it, but for what it was asked for."""
    from gpusimbench.schemas.mcap.writer import McapWriter

    with source.open("rb") as stream, target.open("xb", buffering=0) as out:
        writer: Any = None
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for record in StreamReader(stream).records:
            match type(record).__name__:
                case "Header":
                    writer = McapWriter(out, profile=record.profile, library=record.library)
                case "Schema":
                    if record.id not in schemas and not record.name.startswith("foxglove."):
                        schemas[record.id] = writer.schema(record.name, record.encoding, record.data)
                case "Channel":
                    if record.id not in channels and "/view/" not in record.topic:
                        number = schemas[record.schema_id]
                        channels[record.id] = writer.channel(record.topic, number, record.metadata)
                case "Attachment":
                    r = record
                    writer.attachment(r.name, r.media_type, r.data, log_time=r.log_time, create_time=r.create_time)
                case "Message":
                    if record.channel_id in channels:
                        writer.message(
                            channels[record.channel_id], record.data, log_time=record.log_time,
                            publish_time=record.publish_time, sequence=record.sequence,
                        )  # fmt: skip
                case "DataEnd":
                    writer.finish()
                    break
    return target


def test_the_view_has_no_part_in_the_content_hash(plain: Path, tmp_path: Path) -> None:
    """Keep content hash and verdict of a recording whose view was taken out."""
    bare = without_view(plain, tmp_path / "bare.mcap")
    assert not any("/view/" in topic for topic in read(bare)[0])
    one, other = open_recording(plain), open_recording(bare)
    verify(one)
    verify(other)
    assert one.content_hash == other.content_hash
    assert nothing_wrong(bare)


def test_no_view(tmp_path: Path) -> None:
    """Write nothing for viewers where that is asked for."""
    path = recorded(tmp_path, "--no-view", "--steps", 4)
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert [record.name for record in reader.iter_metadata()] == ["gsb"]
    assert not [c.topic for c in summary.channels.values() if "/view/" in c.topic]
    assert open_recording(path).configuration.view == ()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--view-env", "4"), "--view-env is from 0 to 3, as --n-env is 4, not 4"),
        (("--view-env", "-1"), "--view-env is from 0 to 3"),
        (("--view-env", "1", "--view-env", "1"), "at most 4 environments, each once, not 1, 1"),
        (("--view-env", "1", "--no-view"), "give one of them"),
        (("--view-env", "1", "--phases", "timed"), "--phases has no capture"),
    ],
)
def test_what_cannot_be_shown(arguments: tuple[str, ...], message: str, gsb_record: Command, tmp_path: Path) -> None:
    """Refuse environments that there are not, and answers that contradict each other."""
    done = gsb_record("--sim", "mujoco", "--n-env", "4", *arguments, "--out", tmp_path / "out", code=ExitCode.USAGE)
    assert message in done.stderr


def test_five_environments_are_too_many() -> None:
    """Take the environments that were named, or the first; five are refused by the check of a configuration."""
    assert view_of((), off=False, phases=("capture",)) == (0,)
    assert view_of((), off=False, phases=("timed",)) == ()
    assert view_of((7, 2), off=False, phases=("timed", "capture")) == (7, 2)
    from gpusimbench.recorder.plan import check

    with pytest.raises(UsageError, match="at most 4"):
        check(RunConfiguration("mujoco", "free-fall", n_env=9, dt=0.01, steps=1, view=(0, 1, 2, 3, 4)))


def test_a_replay_has_a_view_of_its_own(plain: Path, gsb_record: Command, tmp_path: Path) -> None:
    """Show what the user of a replay names, whatever the recording shows."""
    done = gsb_record("--replay", plain, "--view-env", "2", "--out", tmp_path, code=0)
    made = Path(done.stdout.strip())
    assert open_recording(made).configuration.view == (2,)
    settings = {setting.name for setting in differing_settings(open_recording(plain), open_recording(made))}
    assert "view" not in settings


def test_what_a_crash_leaves(tmp_path: Path) -> None:
    """Keep the view up to the last whole block in a file without an end, and in what is recovered of it."""
    scene = make_scene("free-fall")
    names = scene.groups()["cubes"]
    field = body_field("cubes", "position", "float32", names)
    configuration = RunConfiguration("test", "free-fall", n_env=2, dt=0.01, steps=400, view=(1,))
    sink = Sink(tmp_path / "run.mcap", compression="none")
    view = ViewWriter(sink, configuration, fields=(field,), scene=scene, attachments={}, env_origins=())
    sink.flush()
    rows = np.zeros((50, 2, len(names), 3), dtype=np.float32)
    for block in range(3):
        view.rows(block * 50, [(rows,)], 64)
    sink.flush()
    view.rows(150, [(rows,)], 64)  # not flushed: lost
    sink.abandon()
    kept = Container(tmp_path / "run.mcap.partial")
    assert len(kept.messages(SCENE.format(1))) == 1
    assert len(kept.messages(TRANSFORMS.format(1))) == 38  # of rows 0, 4, ... 148


def test_a_run_that_was_cut_short(plain: Path, tmp_path: Path) -> None:
    """Recover the view with the states, and find nothing wrong with it wherever the file was cut."""
    data = plain.read_bytes()
    shown = 0
    for part in (5, 7, 9):
        cut = tmp_path / f"{part}.mcap.partial"
        cut.write_bytes(data[: len(data) * part // 10])
        whole = recover(cut, tmp_path / f"{part}.recovered.mcap").path
        found = read(whole)[0]
        shown += len(found[TRANSFORMS.format(0)])
        assert {kind.name for kind in examine(whole).problems.kinds()} <= {"end"}
    assert shown > 0


def test_origins_and_float32(tmp_path: Path) -> None:
    """Show an environment at its origin, with the engine's own float32 numbers relative to it."""
    names = ("a", "b")
    fields = (body_field("cubes", "position", "float32", names), body_field("cubes", "orientation", "float32", names))
    origins = ((0.0, 0.0, 0.0), (7.3, -2.1, 0.5))
    rng = np.random.default_rng(3)
    path = tmp_path / "logged.mcap"
    with RecordingWriter(
        path, simulator="mine", version="1", scene="toss", n_env=2, dt=0.01, steps=9, fields=fields,
        env_origins=origins, view=(1, 0),
    ) as log:  # fmt: skip
        log.append(*(rng.normal(size=(10, 2, 2, width)).astype(np.float32) for width in (3, 4)))
    found, _ = read(path)
    for env in (0, 1):
        for time, transforms in found[TRANSFORMS.format(env)]:
            position = states(found, "/state/cubes/position/000000", time)[env]
            own = {t.child_frame_id: t.translation for t in transforms.transforms}
            assert own[f"env{env}"].x == origins[env][0]
            assert own[f"env{env}/b"].y == float(position[1, 1]) - origins[env][1]
            assert np.allclose(placed(transforms)[f"env{env}/a"][0], position[0], atol=1e-12)
    assert nothing_wrong(path)


def test_states_that_are_no_places(tmp_path: Path) -> None:
    """Record states of which nothing can be shown, without a view."""
    path = tmp_path / "logged.mcap"
    with RecordingWriter(
        path, simulator="mine", version="1", scene="none", n_env=1, dt=0.1, steps=1,
        fields=(body_field("cubes", "linear_velocity", "float64", ("a",)),),
    ) as log:  # fmt: skip
        log.append(np.zeros((2, 1, 1, 3)))
    assert not any("/view/" in topic for topic in read(path)[0])
    assert nothing_wrong(path)


def test_a_group_named_view(tmp_path: Path) -> None:
    """Leave the view out where states have the name that its topics begin with."""
    sink = Sink(tmp_path / "run.mcap", compression="none")
    configuration = RunConfiguration("test", "none", n_env=1, dt=0.1, steps=1, view=(0,))
    with pytest.raises(DamagedRecording, match="the name that topics of views begin with"):
        ViewWriter(
            sink, configuration, fields=(body_field("view", "position", "float64", ("a",)),), scene=None,
            attachments={}, env_origins=(),
        )  # fmt: skip
    sink.abandon()


@pytest.mark.slow
def test_the_commands_of_the_document(tmp_path: Path) -> None:
    """Run every command that the page on viewers shows."""
    (tmp_path / "recordings").mkdir()
    shutil.copy(ROOT / "recordings" / "mujoco-amd-r0.mcap", tmp_path / "recordings")
    lines = commands(ROOT / "docs" / "viewers.md")
    assert len(lines) == 4
    for line in lines:
        shell(line, tmp_path)
    assert read(tmp_path / "view.mcap")[1].statistics.message_count > 250


@pytest.mark.skipif(RERUN is None, reason="rerun is not installed: pip install rerun-sdk")
def test_rerun_reads_it(plain: Path, tmp_path: Path) -> None:
    """Pass rerun's own check, and find every part of the view in what it makes of the file."""
    assert RERUN is not None

    def rerun(*arguments: object) -> str:
        done = finished([RERUN, *map(str, arguments)])
        return done.stdout + done.stderr

    checked = rerun("mcap", "check", plain, "--full").splitlines()
    rows = [line.split() for line in checked if " /state/view/" in line]
    assert len(rows) == 5
    assert {row[0] for row in rows} == {"ok"}
    rerun("mcap", "convert", plain, "-o", tmp_path / "plain.rrd")
    stats = rerun("rrd", "stats", tmp_path / "plain.rrd")
    for topic in (topic for topic in read(plain)[0] if "/view/" in topic):
        assert f"{topic}: " in stats
    shown = rerun("rrd", "print", "-vvv", "--entity", TRANSFORMS.format(0), tmp_path / "plain.rrd")
    assert "Transform3D:child_frame" in shown


def test_a_blueprint_for_rerun(plain: Path, tmp_path: Path) -> None:
    """Make a blueprint of a recording, which rerun takes for one of that file."""
    pytest.importorskip("rerun", reason="rerun is not installed: pip install rerun-sdk")
    assert RERUN is not None
    target = tmp_path / "plain.rbl"
    for command in (
        [sys.executable, ROOT / "viewers" / "rerun_blueprint.py", plain, target],
        [RERUN, "rrd", "verify", target],
        [RERUN, "rrd", "print", "-vvv", target],
    ):
        done = finished(list(map(str, command)))
    for kind in ("Boxes3D:half_sizes", "Ellipsoids3D:half_sizes", "TransformAxes3D:axis_length", plain.stem):
        assert kind in done.stdout
