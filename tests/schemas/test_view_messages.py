"""Messages for viewers: the public definitions, and the same messages however rows come."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import schemas
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.build_descriptors import build
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField, body_field, joint_field
from gpusimbench.schemas.messages import DESCRIPTOR_SETS, embedded_schema, message_class
from gpusimbench.schemas.topics import has_digest, parse_state, parse_view, view
from gpusimbench.schemas.view.geometry import look_of
from gpusimbench.schemas.view.motion import Motion, one_of
from gpusimbench.schemas.view.recorded import RecordedView, layout

TYPES = ("SceneUpdate", "FrameTransforms", "PosesInFrame", "Log")


def fields_of(descriptor: Any, seen: dict[str, Any]) -> dict[str, Any]:
    """Everything that a message consists of, down to its numbers: by full name."""
    if descriptor.full_name not in seen:
        seen[descriptor.full_name] = {
            f.name: (f.number, f.type, f.is_repeated, f.message_type and f.message_type.full_name,
                     f.enum_type and {v.name: v.number for v in f.enum_type.values})
            for f in descriptor.fields
        }  # fmt: skip
        for field in descriptor.fields:
            if field.message_type is not None:
                fields_of(field.message_type, seen)
    return seen


@pytest.mark.parametrize("name", TYPES)
def test_the_definitions_are_the_public_ones(name: str) -> None:
    """Define what Foxglove's own package defines, to the last field of the last message."""
    module = pytest.importorskip(f"foxglove_schemas_protobuf.{name}_pb2")
    ours = message_class(f"foxglove.{name}").DESCRIPTOR
    assert fields_of(ours, {}) == fields_of(getattr(module, name).DESCRIPTOR, {})


def test_the_descriptor_set_is_that_of_the_definitions(tmp_path: Path) -> None:
    """Hold the descriptor set to its .proto files; make proto rebuilds it."""
    pytest.importorskip("grpc_tools")
    build(tmp_path / "new.binpb", "foxglove")
    kept = Path(schemas.__file__).with_name(DESCRIPTOR_SETS["foxglove"])
    ours, new = (descriptor_pb2.FileDescriptorSet.FromString(p.read_bytes()) for p in (kept, tmp_path / "new.binpb"))
    assert [f for f in ours.file if f.package == "foxglove"] == [f for f in new.file if f.package == "foxglove"]


@pytest.mark.parametrize("name", TYPES)
def test_a_schema_stands_alone(name: str) -> None:
    """Embed all that a definition refers to, and nothing else."""
    files = descriptor_pb2.FileDescriptorSet.FromString(embedded_schema(f"foxglove.{name}")).file
    known: set[str] = set()
    for file in files:
        assert set(file.dependency) <= known
        known.add(file.name)
    assert len(files) == {"Log": 2, "SceneUpdate": 4}.get(name, 3)


def test_topics_of_a_view() -> None:
    """Know topics of a view from those of states; neither has a digest of its messages."""
    topic = view("cubes_poses", 3)
    assert topic == "/state/view/cubes_poses/000003"
    assert parse_view(topic) == ("cubes_poses", 3)
    assert parse_state(topic) is None
    assert parse_view("/state/cubes/position/000003") is None
    assert [has_digest(t) for t in (topic, "/state/cubes/position/000003", "/run/end", "/run/event")] == [False] * 3 + [
        True
    ]


FIELDS = tuple(body_field("cubes", name, "float64", ("cube_0_0_0", "b")) for name in ("orientation", "position"))


def recorded_view(stride: int) -> RecordedView:
    """Of the second of two environments."""
    scene = json.loads(make_scene("inclined-collision").to_json())
    return RecordedView(
        1, fields=FIELDS, look=look_of(scene), env_origins=[(0, 0, 0), (1, 2, 3)], dt=0.01, stride=stride
    )


@given(st.lists(st.integers(1, 50), min_size=1, max_size=6), st.integers(1, 7))
def test_blocks_make_no_difference(sizes: list[int], stride: int) -> None:
    """Show the same rows at the same times, however long the blocks are that they come in."""
    shown = recorded_view(stride)
    states = [np.random.default_rng(5).normal(size=(sum(sizes), 2, f.width)) for f in shown.fields]
    begin, found = 0, []
    for size in sizes:
        first = -begin % shown.one_of
        rows = range(begin + first, begin + size, shown.one_of)
        found += list(shown.rows(rows, [s[begin : begin + size][first :: shown.one_of] for s in states]))
        begin += size
    whole = list(shown.rows(range(0, begin, shown.one_of), [s[:: shown.one_of] for s in states]))
    assert [m.message.SerializeToString() for m in found] == [m.message.SerializeToString() for m in whole]
    assert [m.log_time for m in found] == [m.log_time for m in whole]
    times = sorted({m.log_time for m in whole})
    assert all(later - earlier >= 1e9 / 30 - 1 for earlier, later in zip(times, times[1:], strict=False))


@given(st.floats(1e-3, 1e3), st.floats(1e-6, 1), st.integers(1, 100))
def test_no_more_rows_than_asked_for(rate: float, dt: float, stride: int) -> None:
    """Show as many rows as the rate allows, and no more."""
    step = one_of(rate, dt=dt, stride=stride) * dt * stride
    assert step >= 1 / rate * (1 - 1e-6)
    assert one_of(rate, dt=dt, stride=stride) == 1 or step - dt * stride < 1 / rate * (1 + 1e-6)


def test_states_that_are_not_of_the_format() -> None:
    """Refuse fields whose numbers would be drawn as what they are not."""
    scene: dict[str, Any] = {}
    other = body_field("cubes", "orientation", "float64", ("b", "cube_0_0_0"))
    with pytest.raises(DamagedRecording, match="cubes/orientation is not of this format"):
        Motion((FIELDS[1], other), look_of(scene))
    with pytest.raises(DamagedRecording, match="no bodies or joints"):
        RecordedView(0, fields=(), look=look_of(scene), env_origins=(), dt=0.1, stride=1)


def test_things_of_one_name() -> None:
    """Give everything that moves a frame of its own, and all that is drawn an entity, whatever they are called."""
    box = {"kind": "box", "size": [1, 1, 1]}
    bodies = [("", "wall"), ("", "wall"), ("one", "a"), ("two", "a"), ("two", ""), ("two", "\x1b"), ("two", "\\x1b")]
    scene = {"bodies": [{"name": n, "group": g, "shape": box, **({"mass": 1.0} if g else {})} for g, n in bodies]}
    fields = [body_field("one", "position", "float64", ("a",)),
              body_field("two", "position", "float64", ("a", "", "\x1b", "\\x1b"))]  # fmt: skip
    view = RecordedView(0, fields=fields, look=look_of(scene), env_origins=(), dt=0.01, stride=1)
    states = [np.zeros((1, 1, 3)), np.zeros((1, 4, 3))]
    transforms = next(view.rows([0], states)).message.transforms
    frames = [t.child_frame_id for t in transforms]
    assert frames[:3] == ["env0", "env0/a", "env0/a#1"]
    assert len(set(frames)) == len(frames) == 6
    origin = transforms[0].translation
    assert (origin.x, origin.y, origin.z) == (0, 0, 0), "an env without an origin is where its states say"
    assert all(t.parent_frame_id == "env0" for t in transforms[1:])
    entities = view.scene().message.entities
    assert len({entity.id for entity in entities}) == len(entities) == 7
    assert [entity.frame_id for entity in entities] == ["env0", "env0", *frames[1:]]


def colours_of(scene: str, field: StateField) -> tuple[list[Any], list[Any]]:
    """Of what is fixed in a scene's view, and of what moves: one of each entity, red, green, blue and alpha."""
    made = RecordedView(
        0, fields=[field], look=look_of(json.loads(make_scene(scene).to_json())), env_origins=(), dt=0.01, stride=1
    )
    found: tuple[list[Any], list[Any]] = [], []
    for entity in made.scene().message.entities:
        shapes = (*entity.cubes, *entity.spheres, *entity.cylinders)
        (colour,) = {(shape.color.r, shape.color.g, shape.color.b, shape.color.a) for shape in shapes}
        found[entity.frame_id != "env0"].append(colour)
    return found


def test_colours_tell_things_apart() -> None:
    """Draw in colours that viewers have, and so that neighbours differ: what is fixed, bodies, and a robot's links."""
    cubes = make_scene("inclined-collision").groups()["cubes"]
    fixed, bodies = colours_of("inclined-collision", body_field("cubes", "position", "float64", cubes))
    none, links = colours_of("franka", joint_field("robot", "qpos", "float64", tuple(f"joint{i}" for i in range(1, 8))))
    assert (len(fixed), len(bodies), len(none), len(links)) == (2, 27, 0, 9)
    assert all(a != b for moving in (bodies, links) for a, b in pairwise(moving))
    assert len({*fixed, *bodies, *links}) == len({*fixed}) + len({*bodies}) + len({*links})
    assert all(0 <= part <= 1 and alpha == 1 for *parts, alpha in (*fixed, *bodies, *links) for part in parts)


def test_a_layout_shows_scenes_and_hides_poses() -> None:
    """Stay with the frame that is asked for, show scenes and the log, hide poses, and play as fast as it was."""
    found = json.loads(layout(scenes=["/scene"], log="/log", poses=["/env0/poses"], root="env0"))
    scene, events = found["configById"]["3D!scene"], found["configById"]["RosOut!events"]
    assert scene["topics"] == {"/scene": {"visible": True}, "/env0/poses": {"visible": False}}
    assert scene["followTf"] == scene["layers"]["grid"]["frameId"] == "env0"
    assert events["topicToRender"] == "/log"
    assert found["playbackConfig"]["speed"] == 1
