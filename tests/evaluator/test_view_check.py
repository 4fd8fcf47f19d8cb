"""A view that does not say what the states say is found, whatever of it was changed and however well."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import descriptor_pb2
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Channel, Schema

from gpusimbench.evaluator.check.integrity import examine, view
from gpusimbench.evaluator.check.integrity.problem import Kind
from gpusimbench.evaluator.check.integrity.view import difference
from gpusimbench.evaluator.check.rules.findings import check
from gpusimbench.evaluator.check.rules.rule import load_rules
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.messages import message_class
from tests.conftest import call
from tests.evaluator.damaged import rewritten
from tests.forging import copied

POSES, TRANSFORMS, SCENE = "/state/view/cubes_poses/000000", "/state/view/transforms/000000", "/state/view/scene/000000"
LOG = "/state/view/log/000000"

Messages = list[tuple[str, int, int, bytes]]


def parsed(kind: str, data: bytes) -> Any:
    """A message of Foxglove."""
    return message_class(f"foxglove.{kind}").FromString(data)


def changing(topic: str, kind: str, change: Callable[[Any], None], number: int = 3) -> Callable[[Messages], Messages]:
    """One message of a topic with something changed in it."""

    def one(messages: Messages) -> Iterable[tuple[str, int, int, bytes]]:
        for name, sequence, time, data in messages:
            if name == topic and sequence == number:
                message = parsed(kind, data)
                change(message)
                data = message.SerializeToString()
            yield name, sequence, time, data

    return lambda messages: list(one(messages))


def moved(message: Any) -> None:
    """A cube is a micrometre higher than it was."""
    message.poses[5].position.z += 1e-6


def swapped(message: Any) -> None:
    """A quaternion begins with x."""
    q = message.transforms[4].rotation
    q.x, q.y, q.z, q.w = q.w, q.x, q.y, q.z


def renamed(message: Any) -> None:
    """A frame hangs on another one."""
    message.transforms[2].parent_frame_id = "world"


def stamped(message: Any) -> None:
    """A viewer would draw it at another time."""
    message.transforms[0].timestamp.nanos += 1


def larger(message: Any) -> None:
    """A cube is twice as large."""
    message.entities[3].cubes[0].size.x *= 2


def added(message: Any) -> None:
    """There is a wall that nobody simulated."""
    message.entities.add(frame_id="world", id="wall").cubes.add()


def endless(message: Any) -> None:
    """A line of the log is a megabyte long."""
    message.message = "x" * (1 << 20)


def quiet(message: Any) -> None:
    """A line of the log says something else."""
    message.message = "all is well"


def without_last(messages: Messages) -> Messages:
    """The last row is not shown."""
    last = max(sequence for topic, sequence, _, _ in messages if topic == POSES)
    return [m for m in messages if (m[0], m[1]) != (POSES, last)]


def later(messages: Messages) -> Messages:
    """Everything moves a millisecond later."""
    return [(t, n, time + (t == POSES) * 1_000_000, data) for t, n, time, data in messages]


def twice(messages: Messages) -> Messages:
    """The scene is there a second time."""
    (scene,) = (m for m in messages if m[0] == SCENE)
    return [*messages[:-1], (SCENE, 1, scene[2], scene[3]), messages[-1]]


CHANGES = {
    "moved": (changing(POSES, "PosesInFrame", moved), "/state/view/cubes_poses/000000 at 0.12 s: poses[5].position.z"),
    "swapped": (changing(TRANSFORMS, "FrameTransforms", swapped), "transforms[4].rotation.x"),
    "renamed": (changing(TRANSFORMS, "FrameTransforms", renamed), "'world', and should be 'env0'"),
    "stamped": (changing(TRANSFORMS, "FrameTransforms", stamped), "transforms[0].timestamp.nanos"),
    "larger": (changing(SCENE, "SceneUpdate", larger, 0), "entities[3].cubes[0].size.x"),
    "added": (changing(SCENE, "SceneUpdate", added, 0), "entities has 31 entries, not 30"),
    "quiet": (changing(LOG, "Log", quiet), "line 3 of /state/view/log/000000: message is 'all is well'"),
    "endless": (changing(LOG, "Log", endless), "message is 'xxx"),
    "without_last": (without_last, "has 25 messages, and the states are of 26 such times"),
    "later": (later, "has a message at 0.001 s instead of 0 s"),
    "twice": (twice, "has 2 messages, not one"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_view_that_lies(name: str, small: Path, tmp_path: Path) -> None:
    """Find any part of a view that is not what the states say, in a file whose every checksum is right."""
    change, told = CHANGES[name]
    found = examine(rewritten(small, tmp_path / "lie.mcap", change)).problems
    assert set(found.kinds()) == {Kind.view}
    assert any(told in what for what in found.of(Kind.view)), found.of(Kind.view)
    assert all(len(what) < 400 for what in found.of(Kind.view))


def test_a_copy_by_another_tool(small: Path, tmp_path: Path) -> None:
    """Find nothing in a view that the official library wrote again without a change."""
    assert not examine(rewritten(small, tmp_path / "copy.mcap", list)).problems.kinds()


def test_what_is_shown_of_a_file(small: Path) -> None:
    """Say on one screen which environment viewers show, and in JSON."""
    assert "environment 0; for Foxglove" in call("gsb-info", small, "--all").stdout
    (told,) = json.loads(call("gsb-info", small, "--json", "-").stdout)["files"]
    assert told["view"] == [0]


def test_the_command_says_it(small: Path, tmp_path: Path) -> None:
    """Name the rule, say what to do, and end with 3."""
    lie = rewritten(small, tmp_path / "lie.mcap", CHANGES["moved"][0])
    report = check([examine(lie)], [load_rules("integrity-1")])
    assert {finding.rule.id for finding in report.findings} == {"view"}
    done = call("gsb-check", lie, code=ExitCode.DATA_LOST)
    assert "error view: /state/view/cubes_poses/000000 at 0.12 s" in done.stdout
    assert "Trust the states" in done.stdout


def _exchanged(files: Any, file: Any, vector: Any) -> None:
    """By which viewers would read x where y was written."""
    vector.field[0].name, vector.field[1].name = "y", "x"


def _with_defaults(files: Any, file: Any, vector: Any) -> None:
    """By which a number that was not written, since it is 0, would be read as another."""
    file.syntax = "proto2"
    vector.field[0].default_value = "5"


def _twice(files: Any, file: Any, vector: Any) -> None:
    """By which a type is defined twice, and a viewer may take the other one."""
    first = descriptor_pb2.FileDescriptorProto()
    first.CopyFrom(file)
    first.name = "foxglove/Other.proto"
    first.message_type[0].field[0].number = 9
    made = descriptor_pb2.FileDescriptorSet(file=[first, *files.file])
    files.CopyFrom(made)


@pytest.mark.parametrize("spoil", [_exchanged, _with_defaults, _twice])
def test_another_definition_of_a_type(spoil: Callable[[Any, Any, Any], None], small: Path, tmp_path: Path) -> None:
    """Find a definition that is not the public one."""

    def other(record: Any, _: str) -> Any:
        if isinstance(record, Schema) and record.name == "foxglove.PosesInFrame":
            files = descriptor_pb2.FileDescriptorSet.FromString(record.data)
            ((file, vector),) = ((f, m) for f in files.file for m in f.message_type if m.name == "Vector3")
            spoil(files, file, vector)
            record.data = files.SerializeToString()
        return record

    found = examine(copied(small, tmp_path / "other.mcap", other, enable_data_crcs=True)).problems
    assert found.of(Kind.view) == ("the definition of foxglove.PosesInFrame in the file is not the public one",)


@pytest.mark.parametrize(
    ("topic", "told"),
    [
        ("/state/view/ghosts/000000", "nothing is known of /state/view/ghosts/000000"),
        ("/state/view/cubes_poses/000001", "/state/view/cubes_poses/000000 is missing"),
        ("/state/view/cubes_poses/000004", "it shows environment 4, of 4"),
    ],
)
def test_other_topics(topic: str, told: str, small: Path, tmp_path: Path) -> None:
    """Vouch for no topic that is not made of the states, and miss those that should be there."""

    def other(record: Any, _: str) -> Any:
        if isinstance(record, Channel) and record.topic == POSES:
            record.topic = topic
        return record

    found = examine(copied(small, tmp_path / "other.mcap", other, enable_data_crcs=True)).problems
    assert set(found.kinds()) == {Kind.view}
    assert any(told in what for what in found.of(Kind.view)), found.of(Kind.view)


def test_more_environments_than_any_recorder_shows(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Look into none of a view of very many environments."""

    monkeypatch.setattr(view, "MAX_VIEW", 3)
    numbers: dict[str, int] = {}

    def other(record: Any, _: str) -> Any:
        if isinstance(record, Channel) and "/view/" in record.topic and record.topic != LOG:
            record.topic = f"{record.topic[:-6]}{numbers.setdefault(record.topic, len(numbers)):06d}"
        return record

    found = examine(copied(small, tmp_path / "other.mcap", other, enable_data_crcs=True)).problems
    assert found.of(Kind.view) == (f"it shows {len(numbers)} environments; no recorder shows more than 3",)


@pytest.mark.parametrize("there", [5.0, -math.inf, math.nan])
def test_a_body_that_is_nowhere(there: float) -> None:
    """Take no place for one that is not finite."""
    expected, found = (message_class("foxglove.Vector3")(x=x) for x in (math.inf, there))
    assert difference(expected, memoryview(found.SerializeToString())).startswith("x is ")


def test_two_scenes_of_a_run_that_was_cut_short(small: Path, tmp_path: Path) -> None:
    """Find a second scene in a recording without an end, too."""

    def unended(messages: Messages) -> Messages:
        return [m for m in twice(messages) if m[0] != "/run/end"]

    found = examine(rewritten(small, tmp_path / "lie.mcap", unended)).problems
    assert found.of(Kind.view) == (f"{SCENE} has 2 messages, not one",)


@given(st.floats(), st.floats(allow_nan=False, allow_infinity=False, min_value=-10, max_value=10))
def test_numbers_within_what_a_sine_is_worth(value: float, change: float) -> None:
    """Take a number for the same up to 1e-9, NaN for NaN, and nothing else."""
    expected, found = (message_class("foxglove.Vector3")(x=x, y=1) for x in (value, value + change * 1e-9))
    same = value != value or abs(found.x - value) <= 1e-9 * max(1, abs(value)) or found.x == value
    assert (difference(expected, memoryview(found.SerializeToString())) == "") == same


def test_what_is_no_message() -> None:
    """Say that bytes are no message of the type."""
    said = difference(message_class("foxglove.Log")(), memoryview(b"\xff\xff"))
    assert said.startswith("it is no foxglove.Log")
