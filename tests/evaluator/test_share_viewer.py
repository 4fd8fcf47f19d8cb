"""Views: what a viewer draws is where the recording says that things were."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from gpusimbench import open_recording
from gpusimbench.evaluator.player.viewer import write_view
from gpusimbench.schemas.errors import DamagedRecording, NotARecording, UsageError
from gpusimbench.schemas.view.geometry import links_of
from gpusimbench.schemas.view.kinematics import about, product, rotate
from tests.conftest import run_python
from tests.evaluator.test_share_pack import share
from tests.evaluator.viewing import placed, read
from tests.synthetic import changing, grid, write_recording
from tests.test_docs import ROOT

SHIPPED = ROOT / "recordings" / "mujoco-amd-r0.mcap"
WITH_ORIGINS = ROOT / "recordings" / "protocol-h200" / "isaaclab-ovphysx-inclined-collision-n16-r0.mcap"


def layout_of(path: Path) -> Any:
    """The attached layout."""
    with path.open("rb") as stream:
        (attachment,) = make_reader(stream).iter_attachments()
    assert attachment.name == "foxglove-layout.json"
    return json.loads(attachment.data)


def test_bodies_are_where_they_were(tmp_path: Path) -> None:
    """Show recorded poses at their simulated time, not more often than asked, shapes locked to their frames."""
    view = write_view(SHIPPED, tmp_path / "v.mcap", envs=[3, 0], rate=30, spread=0.5)
    recording = open_recording(SHIPPED)
    found, summary = read(view.path)
    times = [time for time, _ in found["/tf"]]
    assert np.diff(times).min() >= 1e9 / 30
    assert len(times) == view.times == 126  # one of 4 rows of 10 ms: 25 Hz
    assert times[-1] - times[0] == 5_000_000_000
    states = recording.state("cubes", "position")
    turns = recording.state("cubes", "orientation")
    row = 4 * 77
    frames = placed(found["/tf"][77][1])
    for env, y in ((3, 0.0), (0, 0.5)):
        for item, name in enumerate(states.field.items):
            position, orientation = frames[f"env{env}/{name}"]
            assert np.allclose(position, states[row, env, item] + [0, y, 0], atol=1e-12)
            assert np.allclose(orientation, turns[row, env, item], atol=1e-12)
        poses = found[f"/env{env}/cubes/poses"][77][1]
        assert poses.frame_id == f"env{env}"
        assert [p.position.x for p in poses.poses] == states[row, env, :, 0].tolist()
    ((_, scene),) = found["/scene"]
    assert all(entity.frame_locked and entity.frame_id in frames for entity in scene.entities)
    sizes = {e.id: e.cubes[0].size.x for e in scene.entities if e.cubes}
    assert sizes["env0/board"] == 0.6
    assert sizes["env3/cube_0_0_0"] == 0.02
    assert next(e for e in scene.entities if e.id == "env0/ball").spheres[0].size.z == 0.035
    assert summary.statistics.message_count == sum(map(len, found.values()))
    assert len(summary.chunk_indexes) > 0


def test_origins_are_kept(tmp_path: Path) -> None:
    """Put environments at their own origins, where the engine had them."""
    view = write_view(WITH_ORIGINS, tmp_path / "v.mcap", envs=[0, 5], rate=30, spread=0.0)
    found, _ = read(view.path)
    frames = placed(found["/tf"][-1][1])
    states = open_recording(WITH_ORIGINS).state("cubes", "position")
    for env in (0, 5):
        assert np.allclose(frames[f"env{env}/cube_1_1_1"][0], states[-1, env, 13], atol=1e-6)
    assert not any("same place" in note for note in view.notes)


def test_links_are_where_the_engine_puts_them(arms: Path, tmp_path: Path) -> None:
    """Chain the links' frames to what MuJoCo's own kinematics gives for the recorded joint angles."""
    view = write_view(arms, tmp_path / "v.mcap", envs=[1], rate=100, spread=0.0)
    recording = open_recording(arms)
    model = mujoco.MjModel.from_xml_string((recording.attachment("scene.xml") or b"").decode())
    data = mujoco.MjData(model)
    found, _ = read(view.path)
    states = recording.state("robot", "qpos")
    assert len(found["/tf"]) == len(states) == 51
    for row in (0, 17, 50):
        data.qpos[:] = states[row, 1, :, 0]
        mujoco.mj_kinematics(model, data)
        frames = placed(found["/tf"][row][1])
        for link in ("link1", "link4", "hand"):
            position, orientation = frames[f"env1/{link}"]
            body = data.body(link)
            assert np.allclose(position, body.xpos, atol=1e-6)
            assert min(np.abs(orientation - body.xquat).max(), np.abs(orientation + body.xquat).max()) < 1e-6
    assert view.notes == ()
    ((_, scene),) = found["/scene"]
    assert sum(len(e.cylinders) for e in scene.entities) > 5


def test_events_and_status(tmp_path: Path) -> None:
    """Log events with their wall time at the beginning of the axis, and end with how the run ended."""
    source = write_recording(tmp_path, grid(1), steps=3, status="INVALID", reason="contacts were dropped")
    found, _ = read(write_view(source, tmp_path / "v.mcap", envs=[0], rate=30, spread=0.0).path)
    _, last = found["/log"][-1]
    assert last.message == "status invalid: contacts were dropped"
    assert last.level == last.ERROR
    shipped, _ = read(write_view(SHIPPED, tmp_path / "w.mcap", envs=[0], rate=1, spread=0.0).path)
    assert {time for time, _ in shipped["/log"]} == {1_000_000_000}
    assert "phase begin capture" in [m.message for _, m in shipped["/log"]]


def test_the_layout_names_what_is_there(tmp_path: Path) -> None:
    """Attach a layout whose panels and topics exist."""
    view = write_view(SHIPPED, tmp_path / "v.mcap", envs=[0], rate=1, spread=0.0)
    layout, topics = layout_of(view.path), set(read(view.path)[0])
    panels = layout["configById"]
    assert {layout["layout"]["first"], layout["layout"]["second"]} == set(panels)
    assert set(panels["3D!scene"]["topics"]) < topics
    assert panels["RosOut!events"]["topicToRender"] in topics


def test_what_has_no_shape_is_shown_as_a_frame(tmp_path: Path) -> None:
    """Show frames alone where the scene describes no shapes, and say so."""

    def change(name: str, record: dict[str, Any]) -> None:
        if name == "scene.json":
            record["bodies"] = [{**b, "shape": {"kind": "mesh"}} for b in record["bodies"]]

    source = write_recording(tmp_path, grid(2), steps=3, change=change)
    view = write_view(source, tmp_path / "v.mcap", envs=[0, 1], rate=30, spread=0.0)
    assert any("no shape in the scene for cube_0_0_0" in note for note in view.notes)
    assert any("--spread" in note for note in view.notes)
    assert len(placed(read(view.path)[0]["/tf"][0][1])) == 1 + 2 * 28


def test_a_view_is_no_recording(tmp_path: Path) -> None:
    """Be refused by the evaluator by name."""
    view = write_view(SHIPPED, tmp_path / "v.mcap", envs=[0], rate=1, spread=0.0)
    with pytest.raises(NotARecording, match="not a recording"):
        open_recording(view.path)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"envs": [16]}, "a number from 0 to 15"),
        ({"envs": [-1]}, "a number from 0 to 15"),
        ({"rate": 0.0}, "--rate"),
        ({"rate": float("nan")}, "--rate"),
        ({"spread": float("inf")}, "--spread"),
    ],
)
def test_what_cannot_be_shown(keywords: dict[str, Any], message: str, tmp_path: Path) -> None:
    """Refuse environments, rates and distances that there are not."""
    with pytest.raises(UsageError, match=message):
        write_view(SHIPPED, tmp_path / "v.mcap", **{"envs": [0], "rate": 30.0, "spread": 0.0, **keywords})
    assert not list(tmp_path.iterdir())


def test_without_states(tmp_path: Path) -> None:
    """Refuse a recording that holds no states."""
    source = write_recording(tmp_path, None, n_env=2)
    with pytest.raises(UsageError, match="holds no states"):
        write_view(source, tmp_path / "v.mcap", envs=[0], rate=30, spread=0.0)


@pytest.mark.parametrize(
    "body",
    [
        {"name": 3},
        {"shape": {"kind": "box", "size": [1, 2]}},
        {"shape": {"kind": "sphere", "radius": "large"}},
        {"shape": "box"},
        {"mass": None, "position": [1, 2, "x"]},
    ],
)
def test_a_strangers_scene(body: dict[str, Any], tmp_path: Path) -> None:
    """Name what is wrong with a scene that cannot be read, and leave no file."""

    def change(name: str, record: dict[str, Any]) -> None:
        if name == "scene.json":
            record["bodies"][0] = {**record["bodies"][0], **body}

    source = write_recording(tmp_path, grid(1), steps=3, change=change)
    with pytest.raises(DamagedRecording, match=source.name):
        write_view(source, tmp_path / "out" / "v.mcap", envs=[0], rate=30, spread=0.0)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_names_of_strangers(tmp_path: Path) -> None:
    """Write names that are no text that protobuf takes in a form that it does."""

    def change(name: str, record: dict[str, Any]) -> None:
        if name == "scene.json":
            record["bodies"][0]["name"] = "\ud800\x1b[2J"

    source = write_recording(tmp_path, grid(1), steps=3, change=change)
    found, _ = read(write_view(source, tmp_path / "v.mcap", envs=[0], rate=30, spread=0.0).path)
    assert "env0/\\ud800\\x1b[2J" in {e.id for e in found["/scene"][0][1].entities}


def test_it_needs_no_other_package(tmp_path: Path) -> None:
    """Write a view where the messages' own package is not installed."""
    code = (
        "import sys\nsys.modules['foxglove_schemas_protobuf'] = None\n"
        "from gpusimbench.evaluator.cli.share import main\n"
        f"sys.exit(main(['viewer', {str(SHIPPED)!r}, '--out', {str(tmp_path / 'v.mcap')!r}]))"
    )
    run_python(code)


def test_the_command(tmp_path: Path) -> None:
    """Write a view and its layout, and say what is in it."""
    done = share("viewer", SHIPPED, "--out", tmp_path / "v.mcap", "--layout", tmp_path / "layout.json", code=0)
    assert "30 shapes, 28 moving frames at 126 times in 5 s" in done.stdout
    assert json.loads((tmp_path / "layout.json").read_text()) == layout_of(tmp_path / "v.mcap")
    again = share("viewer", SHIPPED, "--out", tmp_path / "v.mcap", code=2)
    assert "exists already" in again.stderr


def test_a_layout_whose_name_is_taken(tmp_path: Path) -> None:
    """Refuse it before anything is written, and one of the same name as the view."""
    (tmp_path / "layout.json").write_text("{}")
    for layout in ("layout.json", "v.mcap"):
        share("viewer", SHIPPED, "--out", tmp_path / "v.mcap", "--layout", tmp_path / layout, code=2)
        assert [p.name for p in tmp_path.iterdir()] == ["layout.json"]


def test_a_view_of_a_file_cut_short(tmp_path: Path) -> None:
    """Show what is there, say that it is not all, and end with 3."""
    cut = write_recording(tmp_path, grid(1), end=False)
    done = share("viewer", cut, "--out", tmp_path / "v.mcap", code=3)
    assert "cut short" in done.stderr


@given(st.floats(-7, 7), st.floats(-7, 7))
def test_rotations_add_up(a: float, b: float) -> None:
    """Turn by two angles as by their sum, and a vector as the angle says."""
    q = product(about((0, 0, 1), np.array(a)), about((0, 0, 1), np.array(b)))
    assert np.allclose(q, about((0, 0, 1), np.array(a + b)))
    assert np.allclose(rotate(q, np.array([1.0, 0.0, 2.0])), [np.cos(a + b), np.sin(a + b), 2.0])


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ({"links": [{"name": "a", "parent": "b"}, {"name": "b", "parent": "a"}]}, "before its parent"),
        ({"links": [{"name": str(i)} for i in range(1001)]}, "at most 1000"),
        ({"links": [{"name": "a"}, {"name": "a"}]}, "there twice"),
        ({"links": 3}, "links is not a list"),
    ],
)
def test_a_strangers_robot(robot: dict[str, Any], message: str, tmp_path: Path) -> None:
    """Refuse links that hang on themselves, are there twice, or are too many."""

    source = write_recording(tmp_path, None, change=changing("scene.json", robot=robot))
    with pytest.raises(DamagedRecording, match=message):
        links_of(open_recording(source).scene)
