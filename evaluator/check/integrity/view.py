"""What viewers are told to draw, made again from the states, their look and the events, and held against the file."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet

from gpusimbench.evaluator.check.integrity.problem import Kind, Problems
from gpusimbench.evaluator.check.integrity.scan import Scan
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import EPOCH_NS, MAX_VIEW
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.messages import embedded_schema
from gpusimbench.schemas.view.foxglove import event_line, status_line
from gpusimbench.schemas.view.recorded import LOG_TOPIC, LOG_TYPE, RecordedView, ViewMessage

_BLOCK_ROWS = 50  # a block's, so that few are decoded twice
_SCHEMA_BYTES = 1 << 20  # a longer definition is not looked into
_TOLERANCE = 1e-9  # of numbers up to 1, and relative to larger ones
_REPR = reprlib.Repr()
_REPR.maxstring = 100  # of a stranger


def check_view(path: Path, recording: Recording, found: Scan, problems: Problems) -> None:
    """Make the view again, and note where the file has another. A file without one is as good.

    path  where the recording's bytes are
    """
    there = [topic for topic in found.streams if topics.parse_view(topic) is not None]
    if not there:
        return
    _Check(Container(path), recording, found, problems).run(there)


class _Check:
    def __init__(self, container: Container, recording: Recording, found: Scan, problems: Problems) -> None:
        self._container = container
        self._recording = recording
        self._found = found
        self._problems = problems
        self._ended = recording.status != "incomplete"

    def run(self, there: Sequence[str]) -> None:
        """Hold every topic of the view against what it should be."""
        envs = sorted({parts.env for topic in there if topic != LOG_TOPIC and (parts := topics.parse_view(topic))})
        if len(envs) > MAX_VIEW:
            self._add(f"it shows {len(envs)} environments; no recorder shows more than {MAX_VIEW}")
            return
        types = {LOG_TOPIC: LOG_TYPE}
        views = []
        for env in envs:
            with self._problems.noting(Kind.view, path=self._recording.path):
                views.append(self._view(env))
                types |= views[-1].types
        made = {view.env for view in views}
        for topic in there:
            # of an environment that has no view at all, that was said
            if topic not in types and (parts := topics.parse_view(topic)) and parts.env in made:
                self._add(f"nothing is known of {topic}, and nothing vouches for it")
        for topic in types:
            if topic in there:
                self._check_type(topic, types[topic])
            elif self._ended and topic != LOG_TOPIC:
                self._add(f"{topic} is missing")
        if LOG_TOPIC in there:
            with self._problems.skipping(Kind.view, path=self._recording.path):
                self._check_log()
        for view in views:
            # states and messages that cannot be read are told as what they are
            with self._problems.skipping(Kind.view, path=self._recording.path):
                self._check_messages(view)

    def _view(self, env: int) -> RecordedView:
        recording, c = self._recording, self._recording.configuration
        if not env < c.n_env:
            raise DamagedRecording(f"it shows environment {env}, of {c.n_env}")
        origins = recording.simulation.env_origins if recording.simulation else ()
        return RecordedView(
            env, fields=recording.fields, look=recording.look, env_origins=origins, dt=c.dt, stride=c.stride
        )

    def _check_type(self, topic: str, kind: str) -> None:
        for channel in self._found.channels.values():
            if channel.topic != topic:
                continue
            schema = self._found.schemas.get(channel.schema_id)
            if schema is None or schema.name != kind:
                self._add(f"{topic} is declared as {schema.name if schema else 'nothing'}, not as {kind}")
            elif not _same_definition(bytes(schema.data), kind):
                self._add(f"the definition of {kind} in the file is not the public one")

    def _check_messages(self, view: RecordedView) -> None:
        expected = {topic: self._messages(topic) for topic in view.types}
        scene, *others = view.types
        count = len(self._container.messages(scene))
        if count > 1 or (self._ended and not count):
            self._add(f"{scene} has {count} messages, not one")
        self._compare(view.scene(), next(expected[scene], None))
        arrays = [self._recording.state(field.group, field.field) for field in view.fields]
        first = self._recording.configuration.first_step // self._recording.configuration.stride
        rows = range(-first % view.one_of, min(map(len, arrays)), view.one_of)
        for topic in others:
            count = len(self._container.messages(topic))
            if count > len(rows) or (self._ended and count < len(rows)):
                self._add(f"{topic} has {count} messages, and the states are of {len(rows)} such times")
        shown = max(len(self._container.messages(topic)) for topic in others)
        for wanted in _expected(view, rows[:shown], arrays, first):
            self._compare(wanted, next(expected[wanted.topic], None))

    def _compare(self, wanted: ViewMessage, found: tuple[int, int, memoryview] | None) -> None:
        if found is None:
            return  # its absence was noted
        log_time, _, content = found
        at = f"{(wanted.log_time - EPOCH_NS) * 1e-9:g} s"
        if log_time != wanted.log_time:
            self._add(f"{wanted.topic} has a message at {(log_time - EPOCH_NS) * 1e-9:g} s instead of {at}")
        elif what := difference(wanted.message, content):
            self._add(f"{wanted.topic} at {at}: {what}")

    def _check_log(self) -> None:
        recording = self._recording
        events = recording.events
        lines = [event_line(event.kind, event.phase, event.text, event.unix_ns) for event in events]
        if self._ended:
            last = events[-1].unix_ns if events else 0
            lines.append(status_line(recording.status, recording.reason, last, good=recording.status == "complete"))
        count = len(self._container.messages(LOG_TOPIC))
        # of a run that was cut short, the line of an event, or that of the end it was about to write, may be the last
        if count != len(lines) if self._ended else count > len(lines) + 1:
            self._add(f"{LOG_TOPIC} has {count} lines, and the events make {len(lines)}")
        for number, (line, found) in enumerate(zip(lines, self._messages(LOG_TOPIC), strict=False)):
            if what := difference(line, found[2]):
                self._add(f"line {number} of {LOG_TOPIC}: {what}")

    def _messages(self, topic: str) -> Iterator[tuple[int, int, memoryview]]:
        # log time, number and content, in order of time, which is that of their numbers
        for number, message in enumerate(self._container.messages(topic)):
            sequence, content = self._container.read(message)
            if sequence != number:
                self._add(f"{topic} runs backwards at its message {sequence}")
            yield message.log_time, sequence, content

    def _add(self, what: str) -> None:
        self._problems.add(Kind.view, what)


def _expected(view: RecordedView, rows: range, arrays: Sequence[StateArray], first: int) -> Iterator[ViewMessage]:
    # of some rows at a time, so that neither states nor messages of a long run are held; `first` is the row that row 0
    # would be if the recording began at step 0
    size = max(1, _BLOCK_ROWS // rows.step)
    for begin in range(0, len(rows), size):
        part = rows[begin : begin + size]
        span, one = slice(part[0], part[-1] + 1), slice(view.env, view.env + 1)
        states = [array.read(span, one)[:: rows.step, 0] for array in arrays]
        yield from view.rows(range(first + part.start, first + part.stop, part.step), states)


def _same_definition(data: bytes, kind: str) -> bool:
    # names, numbers, types and defaults of all fields, of the message and of what it refers to; nothing else is drawn
    if len(data) > _SCHEMA_BYTES:
        return False
    try:
        found = FileDescriptorSet.FromString(data)
    except Exception:  # protobuf's DecodeError differs between its backends
        return False
    return _reached(found, kind) == _reached(FileDescriptorSet.FromString(embedded_schema(kind)), kind)


def _reached(files: Any, kind: str) -> dict[str, list[tuple[Any, ...]]]:
    # each definition of a name, since a viewer may take any of them
    definitions = gathered(
        (f".{file.package}.{message.name}", (file.syntax, message))
        for file in files.file
        for message in file.message_type
    )
    reached: dict[str, list[tuple[Any, ...]]] = {}
    waiting = [f".{kind}"]
    while waiting:
        name = waiting.pop()
        if name in reached or name not in definitions:
            continue
        reached[name] = [(syntax, *_members(message)) for syntax, message in definitions[name]]
        waiting += [f.type_name for _, message in definitions[name] for f in message.field if f.type_name]
    return reached


def _members(message: Any) -> tuple[set[tuple[Any, ...]], set[tuple[Any, ...]]]:
    return (
        {(f.name, f.number, f.type, f.label, f.type_name, f.default_value) for f in message.field},
        {(enum.name, value.name, value.number) for enum in message.enum_type for value in enum.value},
    )


def difference(expected: Any, data: memoryview) -> str:
    """Where a serialised message first differs from the one expected, in words; empty where it does not."""
    if bytes(data) == expected.SerializeToString():
        return ""
    try:
        found = type(expected).FromString(bytes(data))
    except Exception as error:  # protobuf's DecodeError differs between its backends
        return f"it is no {expected.DESCRIPTOR.full_name}: {error}"
    return _first(expected, found, "")


def _first(expected: Any, found: Any, path: str) -> str:
    # as deep as the definitions, which are ours
    for field in expected.DESCRIPTOR.fields:
        name = f"{path}{field.name}"
        one, other = getattr(expected, field.name), getattr(found, field.name)
        if not field.is_repeated:
            pairs = [(name, one, other)]
        elif len(one) != len(other):
            return f"{name} has {len(other)} entries, not {len(one)}"
        else:
            pairs = [(f"{name}[{at}]", *pair) for at, pair in enumerate(zip(one, other, strict=True))]
        for where, wanted, there in pairs:
            if field.message_type is not None:
                if what := _first(wanted, there, f"{where}."):
                    return what
            elif not _same(wanted, there):
                return f"{where} is {_short(there)}, and should be {_short(wanted)}"
    return ""


def _short(value: Any) -> str:
    return repr(value) if isinstance(value, float) else _REPR.repr(value)


def _same(wanted: Any, there: Any) -> bool:
    if not isinstance(wanted, float) or not isinstance(there, float):
        return bool(wanted == there)
    if math.isnan(wanted) or math.isnan(there):
        return math.isnan(wanted) and math.isnan(there)
    if math.isinf(wanted) or math.isinf(there):  # a tolerance relative to it would take every number
        return wanted == there
    return abs(wanted - there) <= _TOLERANCE * max(1.0, abs(wanted))
