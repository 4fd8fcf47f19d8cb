"""Recordings whose actions are stored as their generator: read, copied and judged like those with arrays."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from numpy.typing import NDArray

from gpusimbench import open_recording
from gpusimbench.evaluator.read.actions import ActionContents, check_actions, read_actions
from gpusimbench.evaluator.read.messages import Messages as Reader
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.evaluator.share.copies import pack, recover, unpack
from gpusimbench.recorder.capture.actions import ActionWriter
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.recorder.scenes.franka import franka
from gpusimbench.schemas.action_generator import GENERATOR, Streams
from gpusimbench.schemas.digest import ContentDigest
from gpusimbench.schemas.errors import DamagedRecording, DataLost, NotARecording
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.messages import message_class
from tests.conftest import Command, call
from tests.encoded import encode_action
from tests.evaluator.damaged import Messages, rewritten
from tests.reading import verified

_NAME, _TOPIC = "joint_target", "/action/joint_target/000000"
_ACTIONS = franka().actions
assert _ACTIONS is not None


def _drawn(steps: int, streams: Streams, seed: int = 0) -> NDArray[np.float32]:
    return _ACTIONS.draw(seed, n_env=len(streams.env), first_step=0, n_step=steps, streams=streams)


def _blocks(path: Path) -> list[Any]:
    with path.open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages(topics=[_TOPIC])
        return [message_class("gsb.v1.ActionBlock").FromString(message.data) for _, _, message in found]


def _profile(path: Path) -> str:
    with path.open("rb") as stream:
        profile: str = make_reader(stream).get_header().profile
    return profile


def test_a_run_without_captured_actions_can_be_read_by_all_versions(tmp_path: Path) -> None:
    """Ask for a newer reader where actions are stored as their generator, and not where none are stored."""
    arm = ("--sim", "mujoco", "--scene", "franka", "--n-env", "2", "--runs", "1", "--no-view", "--out", tmp_path)
    timed = call("gsb-record", *arm, "--phases", "timed", "--warmup", "2", "--timed-steps", "3", code=0)
    kept = call("gsb-record", *arm, "--phases", "capture", "--steps", "5", "--keep", "failing", code=0)
    assert [_profile(Path(done.stdout.strip())) for done in (timed, kept)] == ["gsb.v1", "gsb.v1"]


def test_arrays_have_the_same_identity(arms: Path, tmp_path: Path) -> None:
    """Write the arrays out: same content hash and actions, in a file of the format that all versions read."""
    assert _profile(arms) == "gsb.v1.1"
    raw = unpack(arms, tmp_path / "raw.mcap").path
    assert _profile(raw) == "gsb.v1"
    assert GENERATOR not in Container(raw).channels[_TOPIC].metadata
    before, after = open_recording(arms), open_recording(raw)
    verify(after)
    assert before.content_hash == after.content_hash
    expected = _drawn(50, Streams.usual(2))
    assert np.array_equal(before.actions(_NAME), expected)
    assert np.array_equal(after.actions(_NAME), expected)
    assert [list(block.data) for block in _blocks(raw)] == [expected.ravel().tolist()]
    assert [list(block.data) for block in _blocks(arms)] == [[]]
    packed = pack(arms, tmp_path / "packed.mcap", level=1).path
    assert (_profile(packed), open_recording(packed).content_hash) == ("gsb.v1.1", before.content_hash)
    assert len(call("gsb-check", raw, packed, code=0).stdout) > 0


def test_other_formats_are_refused_by_name(arms: Path, tmp_path: Path) -> None:
    """Refuse a format that is not known as versions before this one refuse that of generated actions."""
    later = tmp_path / "later.mcap"
    later.write_bytes(arms.read_bytes().replace(b"gsb.v1.1", b"gsb.v1.2", 1))
    with pytest.raises(NotARecording, match=r"has format gsb.v1.2, this version reads gsb.v1 and gsb.v1.1: update"):
        open_recording(later)


def test_a_replay_is_judged_alike(arms: Path, tmp_path: Path) -> None:
    """Reproduce a recording with generated actions exactly, as the same recording with arrays."""
    raw = unpack(arms, tmp_path / "raw.mcap").path
    found = []
    for path in (arms, raw):
        out = tmp_path / f"audit of {path.stem}"
        done = call("gsb-audit", path, "--runs", 1, "--out", out, "--json", "-")
        (audit,) = json.loads(done.stdout)["audits"]
        found.append((done.returncode, audit["level"]))
    assert found == [(0, "bit-identical")] * 2


def test_streams_are_in_the_file(gsb_record: Command, tmp_path: Path) -> None:
    """Read the actions of environments that began in other slots and were reset, from the file alone."""
    done = gsb_record(
        "--sim", "mujoco", "--scene", "franka", "--n-env", 4, "--steps", 12, "--phases", "capture", "--runs", 1,
        "--initial", "random:0.1,shift:1", "--intervene", "reset@5", "--out", tmp_path, code=0,
    )  # fmt: skip
    (path,) = map(Path, done.stdout.split())
    streams = Streams(np.array([1, 2, 3, 0], dtype=np.uint32), np.array([5, 0, 5, 0], dtype=np.uint32))
    recording = verified(path)
    assert np.array_equal(recording.actions(_NAME), _drawn(12, streams))
    assert {tuple(block.stream_env) for block in _blocks(path)} == {(1, 2, 3, 0)}
    assert {tuple(block.stream_begun) for block in _blocks(path)} == {(5, 0, 5, 0)}


def test_a_file_cut_short(arms: Path, tmp_path: Path) -> None:
    """Recover the actions of all steps whose hashes are there."""
    data = arms.read_bytes()
    cut = tmp_path / "cut.mcap.partial"
    cut.write_bytes(data[: data.index(b"/run/end") - 1])
    whole = recover(cut, tmp_path / "whole.mcap").path
    assert _profile(whole) == "gsb.v1.1"
    recording = open_recording(whole)
    assert recording.status == "incomplete"
    found = recording.actions(_NAME)
    assert len(found)
    assert np.array_equal(found, _drawn(len(found), Streams.usual(2)))


def _block(**values: int) -> Callable[[Messages], Messages]:
    def change(messages: Messages) -> Messages:
        changed = []
        for topic, sequence, time, content in messages:
            if topic == _TOPIC:
                block = message_class("gsb.v1.ActionBlock").FromString(content)
                for name, value in values.items():
                    setattr(block, name, value)
                content = block.SerializeToString()
            changed.append((topic, sequence, time, content))
        return changed

    return change


def _generator(**values: Any) -> Callable[[dict[str, str]], dict[str, str]]:
    def change(metadata: dict[str, str]) -> dict[str, str]:
        if GENERATOR not in metadata:
            return metadata
        return {**metadata, GENERATOR: json.dumps({**json.loads(metadata[GENERATOR]), **values})}

    return change


@pytest.mark.parametrize(
    ("messages", "metadata", "said"),
    [
        (list, _generator(seed=1), "at step 0 fails its CRC"),
        (list, _generator(lower=[-0.5] * 7, upper=[0.5] * 7), "at step 0 fails its CRC"),
        (list, _generator(generator="philox"), "the generator 'philox', not known here; update gpusimbench"),
        (list, lambda _: {}, f"{_TOPIC} was changed since the recording was made"),
        (_block(crc32=1), dict, "at step 0 fails its CRC"),
        (_block(steps=49), dict, "at step 0 fails its CRC"),
        (_block(steps=2**31), dict, "more than may be drawn"),
        (_block(envs=2**31), dict, "more than may be drawn"),
        (_block(encoding=7), dict, "uses encoding 7, which this version does not read; update gpusimbench"),
    ],
    ids=["seed", "limits", "generator", "nothing", "crc", "steps", "many steps", "many envs", "encoding"],
)
def test_what_was_changed_is_reported(
    arms: Path, tmp_path: Path, gsb_eval: Command, messages: Any, metadata: Any, said: str
) -> None:
    """Name what is wrong with the actions of a file whose CRCs are all right, whoever reads it."""
    same = rewritten(arms, tmp_path / "same.mcap", list)
    verify(open_recording(same))
    path = rewritten(arms, tmp_path / "changed.mcap", messages, metadata=metadata)
    for done in (call("gsb-check", path), gsb_eval(path)):
        assert done.returncode not in (0, 2)
        told = " ".join((done.stdout + done.stderr).split())
        assert said in told
        assert "changed.mcap" in told


def test_a_check_holds_no_arrays(tmp_path: Path) -> None:
    """Check actions a block at a time: a file may have the generator of many times its size of them."""
    streams, steps, n_env = Streams.usual(512), 50, 512
    sink = Sink(tmp_path / "run.mcap", compression="none")
    sink.attach("padding", "application/octet-stream", bytes(9 << 20))  # in place of states and their hashes
    assert _ACTIONS is not None
    writer = ActionWriter(sink, Workers(small=True), _ACTIONS, seed=0, streams=streams, dt=0.01, n_step=20 * steps)
    for first in range(0, 20 * steps, steps):
        held = _ACTIONS.draw(0, n_env=n_env, first_step=first, n_step=steps)
        writer.write(lambda envs, held=held: held[:, envs.start : envs.stop], lambda _: None, first)  # type: ignore[misc]
    sink.finish("COMPLETE", "", last_step=1000, peak_rss_bytes=1)
    messages = Reader(Container(sink.path))
    tracemalloc.start()
    check_actions(messages, _NAME, n_env=n_env, first_step=0, cut_short=False)
    _, checked = tracemalloc.get_traced_memory()
    found = read_actions(messages, _NAME, n_env=n_env, first_step=0, cut_short=False)
    tracemalloc.stop()
    assert found.shape == (1000, n_env, 7)
    assert checked < found.nbytes / 4
    assert sink.path.stat().st_size < found.nbytes


def test_what_an_engine_held_is_what_is_written(tmp_path: Path) -> None:
    """Write a block as an array where an engine held other bits than were drawn, and digest the same either way."""
    streams, n_env = Streams.usual(70), 70
    expected = _drawn(5, streams)
    held = expected.copy()
    held[3, 65, 2] += np.float32(0.5)
    sink = Sink(tmp_path / "run.mcap", compression="none")
    assert _ACTIONS is not None
    writer = ActionWriter(sink, Workers(small=True), _ACTIONS, seed=0, streams=streams, dt=0.01, n_step=5)
    writer.write(lambda envs: expected[:, envs.start : envs.stop], lambda envs: held[:, envs], 0)
    sink.finish("COMPLETE", "", last_step=5, peak_rss_bytes=1)
    container = Container(sink.path)
    contents, digest = ActionContents(container), ContentDigest()
    for start, encoding in ((0, 2), (64, 0)):
        topic, envs = f"/action/{_NAME}/{start:06d}", slice(start, min(start + 64, n_env))
        ((header, array),) = contents.arrays(topic)
        assert (header.encoding, header.envs) == (encoding, array.shape[1])
        assert np.array_equal(array, held[:, envs])
        raw = ContentDigest()
        raw.message(topic, encode_action(held[:, envs], first_step=0, stride=1, env_start=start, sim_time_ns=0))
        ActionContents(container).digest(topic, digest)
        assert sink.digest.digests()[topic] == raw.digests()[topic] == digest.digests()[topic]


@pytest.mark.parametrize("small", [True, False])
def test_actions_that_an_engine_cannot_tell(small: bool, tmp_path: Path) -> None:
    """End no file well in which the actions of some environments are missing and those of others are digested."""
    n_env = 70
    drawn = _drawn(5, Streams.usual(n_env))

    def told(envs: slice) -> NDArray[np.float32]:
        if envs.start:
            raise RuntimeError("the device is lost")
        return drawn[:, envs]

    sink = Sink(tmp_path / "run.mcap", compression="none")
    assert _ACTIONS is not None
    writer = ActionWriter(sink, Workers(small=small), _ACTIONS, seed=0, streams=Streams.usual(n_env), dt=1.0, n_step=5)
    with pytest.raises(DataLost, match="writing stopped: the device is lost; what was written is in"):
        writer.write(lambda envs: drawn[:, envs.start : envs.stop], told, 0)
    with pytest.raises(DataLost, match="the device is lost"):
        sink.finish("FAILED", "the device is lost", last_step=5, peak_rss_bytes=1)
    sink.abandon()
    assert not sink.path.exists()


@pytest.mark.parametrize(("steps", "n_env"), [(1, 2_000_000), (100, 50_000)])
def test_actions_that_no_file_of_this_size_has(steps: int, n_env: int, tmp_path: Path) -> None:
    """Draw no actions for what a file of a few kilobytes is unpacked into: minutes of work for each of them."""
    sink = Sink(tmp_path / "run.mcap", compression="zstd")
    sink.channel("/run/padding", "gsb.v1.Event")
    sink.write("/run/padding", bytes(60 << 20))
    sink.channel(_TOPIC, "gsb.v1.ActionBlock", {GENERATOR: _ACTIONS.describe(0, Streams.usual(0))})
    block = message_class("gsb.v1.ActionBlock")(steps=steps, envs=n_env, width=7, stride=1, encoding=2)
    sink.write(_TOPIC, block.SerializeToString())
    sink.finish("COMPLETE", "", last_step=1, peak_rss_bytes=1)
    assert sink.path.stat().st_size < 20_000
    with pytest.raises(DamagedRecording, match="more than may be drawn"):
        list(ActionContents(Container(sink.path)).arrays(_TOPIC))
