"""What a recording shows of the work that it says was done, and what that work took.

Whoever forges a file can forge traces, but must put them into it. So a configuration may ask for as many environments
and steps as the file's content, decompressed, has hashes, states and clock readings of. Traces of the same value
compress to next to nothing, so that for each byte of the file no more than a few are believed as well.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gpusimbench.recorder.capture.flight import MOST
from gpusimbench.recorder.simulators.flight import AFTER, BEFORE
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import STATE_HEAD_BYTES, decode_fingerprints, state_bytes, state_header_in
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.mcap.contents import Message
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.messages import message_class

_MOST_PER_INTERVAL = 1000
"""Steps between two clock readings, of which one trace is left; no adapter takes more than a hundred."""

# No recording that was made has had more than 2 environments and 1 step for a byte.
_ENVS_PER_BYTE = 4
_STEPS_PER_BYTE = 64

_HASH_BYTES = 8
_CLOCK_BYTES = 16
_TIMED_ROWS = 2  # of hashes: at the beginning and the end of the timed phase
_KEPT_ROWS = 2  # of hashes, where failing environments alone are kept: likewise of the capture

Fields = tuple[StateField, ...]


def check_traces(container: Container, c: RunConfiguration, fields: Fields) -> None:
    """UsageError where a recording asks for more environments or steps than it has traces of."""
    asked = []
    if "capture" in c.phases:
        asked += _of_failing(container, c) if c.keep else _captured(container, c, fields)
    if "timed" in c.phases:
        asked += [(f"{phase} steps", n, _clocked(container, phase)) for phase, n in _timed(c)]
        asked.append(("timed environments", c.n_env, _hashes(container, "timed") // _TIMED_ROWS))
    for what, wanted, there in asked:
        if there < wanted:
            raise UsageError(
                f"{container.path} cannot be replayed: it asks for {c.n_env} environments and {wanted} {what}, and has "
                f"traces of {max(there, 0)} {what}"
            )
    _check_size(container, c)


def _captured(container: Container, c: RunConfiguration, fields: Fields) -> list[tuple[str, int, int]]:
    asked = [("captured steps", c.captured_steps, _hashes(container, "capture") // c.n_env - 1)]
    rows = c.captured_steps // c.stride + 1
    for field in fields:
        row = c.n_env * _row_bytes((field,))
        asked.append((f"rows of {field.name}", rows, _stored(container, field) // row))
    return asked


def _of_failing(container: Container, c: RunConfiguration) -> list[tuple[str, int, int]]:
    # where failing environments alone are kept, all that is left of the others is hashes and clocks
    environments = _hashes(container, "capture") // _KEPT_ROWS
    return [
        ("captured steps", c.steps, _clocked(container, "capture")),
        ("captured environments", c.n_env, environments),
    ]


def content_bytes(container: Container, c: RunConfiguration, fields: Fields) -> int:
    """What another recording of that configuration holds, uncompressed [bytes]: by what is asked, or as this one."""
    size = 0
    if "capture" in c.phases and c.keep:
        size += MOST * _row_bytes(fields) * (BEFORE + 1 + AFTER) + c.n_env * _HASH_BYTES * _KEPT_ROWS
    elif "capture" in c.phases:
        size += c.n_env * (
            _row_bytes(fields) * (c.captured_steps // c.stride + 1) + _HASH_BYTES * (c.captured_steps + 1)
        )
    if "timed" in c.phases:
        size += c.n_env * _HASH_BYTES * _TIMED_ROWS + _CLOCK_BYTES * sum(n for _, n in _timed(c))
    return max(size, container.content_bytes)


def least_memory(c: RunConfiguration, fields: Fields) -> int:
    """What one state of all environments takes [bytes]: no engine can do with less."""
    return c.n_env * _row_bytes(fields)


def peak_bytes(container: Container, said: int) -> int:
    """The most that the recording's run took of host and GPU memory together [bytes]; 0 where nothing is said.

    said  what its end record says of host memory
    """
    host = max([said, *_used(container, topics.MEMORY_HOST)])
    devices = {topic.split("/")[2] for topic in container.channels if topic.startswith("/memory/gpu")}
    return host + sum(_device_bytes(container, device.removeprefix("gpu")) for device in devices)


def ran_s(container: Container) -> float | None:
    """How long the run took [s]; None where it does not say."""
    events = [_parsed("gsb.v1.Event", content).monotonic_ns for content in container.in_sequence(topics.RUN_EVENT)]
    return (max(events) - min(events)) / 1e9 if events else None


def _check_size(container: Container, c: RunConfiguration) -> None:
    size = container.size
    captured = c.captured_steps if "capture" in c.phases else 0
    steps = captured + (c.warmup + c.timed_steps if "timed" in c.phases else 0)
    for what, asked, most in (("environments", c.n_env, _ENVS_PER_BYTE), ("steps", steps, _STEPS_PER_BYTE)):
        if asked > most * size:
            raise UsageError(
                f"{container.path} cannot be replayed: it asks for {asked} {what}, and its {size} bytes can hold "
                f"traces of {most * size} at most"
            )


def _row_bytes(fields: Fields) -> int:
    # of one environment's state
    return sum(np.dtype(f.dtype).itemsize * len(f.items) * f.width for f in fields)


def _timed(c: RunConfiguration) -> tuple[tuple[str, int], ...]:
    return ("warmup", c.warmup), ("timed", c.timed_steps)


def _hashes(container: Container, phase: str) -> int:
    contents = container.in_sequence(topics.fingerprint(phase))
    return sum(decode_fingerprints(content)[1].size for content in contents)


def _stored(container: Container, field: StateField) -> int:
    # bytes of a field's arrays, decompressed
    own = topics.states_of(container.channels, field.group, field.field)
    number = np.dtype(field.dtype).itemsize
    return sum(_array_bytes(container, message, number) for topic in own for message in container.messages(topic))


def _array_bytes(container: Container, message: Message, number: int) -> int:
    # of an array of a block that is not packed, its head tells the size, which the message's own bears out
    size, head = container.peek(message, STATE_HEAD_BYTES)
    header = state_header_in(head, size)
    if header is None or header.encoding:
        return state_bytes(container.read(message)[1])
    return min(size, header.steps * header.envs * header.items * header.width * number)


def _clocked(container: Container, phase: str) -> int:
    found = [_parsed("gsb.v1.StepTiming", content) for content in container.in_sequence(topics.timing(phase))]
    return sum(_intervals(timing) * min(timing.steps_per_interval, _MOST_PER_INTERVAL) for timing in found)


def _intervals(timing: Any) -> int:
    # a step takes time: only intervals that do are traces
    return sum(end > start for start, end in zip(timing.start_ns, timing.end_ns, strict=False))


def _used(container: Container, topic: str) -> list[int]:
    contents = container.in_sequence(topic) if topic in container.channels else ()
    return [_parsed("gsb.v1.MemorySample", content).used_bytes for content in contents]


def _device_bytes(container: Container, device: str) -> int:
    # of a GPU: by its process and its allocator, and what the whole device had more than at its least
    own = [*_used(container, f"/memory/gpu{device}/process"), *_used(container, f"/memory/gpu{device}/allocator")]
    whole = _used(container, f"/memory/gpu{device}/device")
    return max([0, *own, max(whole, default=0) - min(whole, default=0)])


def _parsed(message: str, content: memoryview) -> Any:
    try:
        return message_class(message).FromString(bytes(content))
    except Exception as error:  # protobuf's DecodeError differs between its backends
        raise DamagedRecording(f"a {message} message cannot be parsed: {error}") from None
