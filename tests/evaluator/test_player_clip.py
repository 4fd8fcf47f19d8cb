"""What a player is given: recorded poses as they are, in bounds, and nothing of a stranger that a page would obey."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench.evaluator.player.clip import make_clip
from gpusimbench.evaluator.player.encode import RESOLUTION_M, RESOLUTION_QUATERNION, encode
from gpusimbench.evaluator.player.page import sentences
from gpusimbench.evaluator.player.poses import items_of
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import DamagedRecording, NothingComparable, UsageError
from tests.synthetic import grid, write_recording

SHIPPED = Path(__file__).resolve().parents[2] / "recordings"


def diverging(folder: Path, **keywords: Any) -> Path:
    """Four environments of 100 steps: env 2 leaves at step 40 by one bit, env 3 at step 60 by centimetres."""

    def path_of(start: NDArray[Any], step: int) -> NDArray[Any]:
        now = start.copy()
        if step >= 40:
            now[2, 5, 0] = np.nextafter(now[2, 5, 0], 1)
        if step >= 60:
            now[3, :, 1] += 0.02 + 0.001 * (step - 60)
        return now

    final = path_of(np.broadcast_to(_start(), (4, 27, 3)), 100)
    return write_recording(folder, final, steps=100, dt=0.01, path_of=path_of, **keywords)


def _start() -> NDArray[np.float64]:
    from gpusimbench.recorder.scenes.registry import make_scene

    return np.array([b.position for b in make_scene("inclined-collision").moving()[-27:]])


def unpacked(text: str) -> tuple[dict[str, Any], NDArray[np.float32], NDArray[np.float64]]:
    """A clip's JSON, its positions [pose, item, 3] and orientations [pose, item, 4]."""
    record = json.loads(text)
    n_item = len(record["items"][0])
    positions = np.frombuffer(base64.b64decode(record["positions"]), "<f4").reshape(-1, n_item, 3)
    orientations = np.frombuffer(base64.b64decode(record["orientations"]), "<i2").reshape(-1, n_item, 4)
    return record, positions, orientations * RESOLUTION_QUATERNION


def test_poses_are_those_of_the_recording() -> None:
    """Unpack every pose of a page to the recorded numbers, within the stated resolution."""
    recording = Recording(SHIPPED / "mujoco-amd-r0.mcap")
    record, positions, orientations = unpacked(encode(make_clip([recording], envs=[3])))
    (track,) = record["tracks"]
    names = [item["name"] for item in record["items"][track["items"]]]
    for group, field in (("ball", "position"), ("cubes", "position")):
        state = recording.state(group, field)
        of_group = [names.index(name) for name in state.field.items]
        recorded = np.stack([state.at_step(step)[3] for step in track["steps"]])
        shown = positions[track["poses"]][:, of_group]
        near = np.abs(recorded) < 64  # what falls off the board is soon far away, where float32 is coarser
        assert np.abs(shown - recorded)[near].max() <= RESOLUTION_M / 2
        turned = recording.state(group, "orientation")
        exact = np.stack([turned.at_step(step)[3] for step in track["steps"]])
        assert np.abs(orientations[track["poses"]][:, of_group] - exact).max() <= RESOLUTION_QUATERNION


def test_one_environment_stands_for_a_class(tmp_path: Path) -> None:
    """Show an environment of each class, every step around the first divergence, and say the rest in words."""
    clip = make_clip([Recording(diverging(tmp_path))])
    assert [track.label for track in clip.tracks] == ["env 0", "env 2", "env 3"]
    assert clip.changes.splits.tolist() == [40, 60]
    assert set(range(28, 64)) <= set(clip.tracks[0].steps.tolist())
    assert len(clip.tracks[0].steps) < 101
    assert clip.tracks[2].apart[-1] == pytest.approx(0.06)
    assert 0 < clip.tracks[1].apart[-1] < 1e-15
    told = " ".join(sentences(clip))
    assert "first differ at step 40 (0.4 s); distinct: 2 from step 40, 3 from step 60." in told
    assert "of 101 recorded states, among them every state around the first divergence." in told


def test_equal_environments_share_their_poses(tmp_path: Path) -> None:
    """Keep poses once that several environments, or several steps, have."""
    record, positions, _ = unpacked(encode(make_clip([Recording(diverging(tmp_path))], envs=[0, 1])))
    assert len(positions) == 1
    assert all(set(track["poses"]) == {0} for track in record["tracks"])


def test_a_clip_keeps_to_its_budget() -> None:
    """Thin a clip that would not fit, keep the steps around the divergence, and say so."""
    recordings = [Recording(SHIPPED / f"mujoco-{name}-r0.mcap") for name in ("xeon", "pyramidal")]
    whole, thin = make_clip(recordings), make_clip(recordings, budget=100_000)
    assert len(encode(whole)) < 400_000
    assert len(encode(thin)) < 130_000 < len(encode(whole))
    assert set(range(0, 25)) <= set(thin.tracks[0].steps.tolist())
    assert any("recorded states" in note and "this page has" in note for note in thin.notes)


def test_origins_are_taken_away(tmp_path: Path) -> None:
    """Show environments at different origins in their own frames, and do not compare their bits."""
    origins = ((0.0, 0.0, 0.0), (0.0, 8.0, 0.0), (8.0, 0.0, 0.0), (8.0, 8.0, 0.0))
    moved = np.array(origins)[:, np.newaxis]
    path = write_recording(tmp_path, grid(4) + moved, origins=origins, path_of=lambda start, _: start + moved)
    clip = make_clip([Recording(path)])
    assert clip.changes is None
    assert "different origins" in clip.not_compared
    assert len(clip.tracks) == 4
    assert np.allclose(clip.tracks[3].items.position[-1], grid(1)[0])


def test_states_that_are_not_finite_are_kept_as_such(tmp_path: Path) -> None:
    """Neither fail nor invent a place for a body whose position is no number."""
    final = grid(1)
    final[0, 3] = np.nan
    record, positions, _ = unpacked(encode(make_clip([Recording(write_recording(tmp_path, final))])))
    assert np.isnan(positions[-1, 3]).all()
    assert np.isfinite(positions[-1, 4]).all()
    assert np.isfinite([record["low"], record["high"]]).all()


def test_a_name_cannot_end_the_data(tmp_path: Path) -> None:
    """Write names of strangers so that no element begins or ends in them."""
    evil = "</script><script>alert(1)</script>\x1b[2J"
    text = encode(make_clip([Recording(write_recording(tmp_path, grid(1), simulator=evil, name="a.mcap"))]))
    assert not {"<", ">", "&", "\x1b"} & set(text)
    assert text.isascii()
    assert json.loads(text)["title"].startswith("</script>")


def test_what_cannot_be_shown_is_said(tmp_path: Path) -> None:
    """Refuse other scenes, other time steps, environments that are not there, too many, and files without states."""
    one = Recording(write_recording(tmp_path, grid(2)))
    slower = Recording(write_recording(tmp_path, grid(2), dt=2.0))
    with pytest.raises(UsageError, match="the same time step"):
        make_clip([one, slower])
    with pytest.raises(UsageError, match="the same scene"):
        make_clip([one, Recording(write_recording(tmp_path, None, scene="franka"))])
    with pytest.raises(UsageError, match="no environment 2: it has 0 to 1"):
        make_clip([one], envs=[2])
    with pytest.raises(UsageError, match="at most 8"):
        make_clip([one] * 5, envs=[0, 1])
    with pytest.raises(NothingComparable, match="no states"):
        make_clip([Recording(write_recording(tmp_path, None))])


def test_a_file_that_was_cut_short_is_shown_as_far_as_it_goes(tmp_path: Path) -> None:
    """Show what was written before the end went missing, and say that it is incomplete."""
    path = diverging(tmp_path, end=False)
    clip = make_clip([Recording(path)])
    assert clip.last_step > 0
    assert any("incomplete" in note for note in clip.notes)


def test_links_are_where_the_engine_has_them(arms: Path) -> None:
    """Place a robot's links by its joint angles where MuJoCo's own kinematics puts them."""
    mujoco = pytest.importorskip("mujoco")
    recording = Recording(arms)
    items = items_of(recording, 1, [range(0, 31, 10)])
    model = mujoco.MjModel.from_xml_string((recording.attachment("scene.xml") or b"").decode())
    data = mujoco.MjData(model)
    field = recording.state("robot", "qpos")
    compared = 0
    for row, step in enumerate(range(0, 31, 10)):
        for joint, angle in zip(field.field.items, field.at_step(step)[1, :, 0], strict=True):
            data.joint(joint).qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        for index, (_, name) in enumerate(items.bodies):
            body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            if body >= 0:
                compared += 1
                assert np.allclose(items.position[row, index], data.xpos[body], atol=1e-6), name
                assert abs(items.orientation[row, index] @ data.xquat[body]) == pytest.approx(1, abs=1e-6), name
    assert compared >= 4 * 8


@pytest.mark.parametrize("size", [[0, 0, 0], [-1, 2, 3], [1e300, 1, 1], [1e-300] * 3])
def test_shapes_of_strangers_stay_in_bounds(tmp_path: Path, size: list[float]) -> None:
    """Draw at most some thousand shapes of any size, and say how many are left out; or refuse the file in words."""

    def crowd(attachment: str, record: dict[str, Any]) -> None:
        if attachment == "scene.json":
            record["bodies"] += [{"name": f"wall {i}", "shape": {"kind": "box", "size": size}} for i in range(5000)]

    path = write_recording(tmp_path, grid(1), change=crowd)
    try:
        clip = make_clip([Recording(path)])
    except DamagedRecording as error:
        assert "size" in str(error)
        return
    record, _, _ = unpacked(encode(clip))
    assert len(record["fixed"]) + len(record["ground"]) <= 4000
    assert np.isfinite([record["low"], record["high"]]).all()
    assert any("shapes of the scene are not drawn" in note for note in clip.notes)
