"""Topic names of a recording."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

RUN_EVENT = "/run/event"
RUN_END = "/run/end"
RUN_DROPOUT = "/run/dropout"
RUN_FAILING = "/run/failing"
MEMORY_HOST = "/memory/host"
HARDWARE_HOST = "/hardware/host"

VIEW = "view"
"""No group of states has this name: /state/view/... is what viewers draw, which is made of states (schemas.view)."""

_ACTION = re.compile(r"/action/([a-z0-9_]+)/([0-9]{1,9})")
_PROGRAM = re.compile(r"/program/([a-z0-9_]+)")
_COUNT = re.compile(r"/count/([a-z0-9_]+)/([a-z0-9_]+)")
_STATE = re.compile(r"/state/([a-z0-9_]+)/([a-z0-9_]+)/([0-9]{1,9})")
_ENV_DIGITS = 6


class StateTopic(NamedTuple):
    """Parts of a state topic."""

    group: str
    field: str
    env_start: int


class ViewTopic(NamedTuple):
    """Parts of a view's topic: what it shows, such as "scene", and of which environment."""

    kind: str
    env: int


class ActionTopic(NamedTuple):
    """Parts of an action topic."""

    name: str
    env_start: int


def state(group: str, field: str, env_start: int) -> str:
    """Topic of the state blocks of one field whose first environment is `env_start`."""
    return f"/state/{group}/{field}/{env_start:0{_ENV_DIGITS}d}"


def parse_state(topic: str) -> StateTopic | None:
    """Parts of a state topic, or None where the topic is another."""
    match = _STATE.fullmatch(topic)
    return StateTopic(match[1], match[2], int(match[3])) if match and match[1] != VIEW else None


def states_of(names: Iterable[str], group: str, field: str) -> dict[str, int]:
    """Of these topics those of the state blocks of one field, and the first environment of each."""
    prefix = f"/state/{group}/{field}/"
    parsed = ((name, parse_state(name)) for name in names if name.startswith(prefix))
    return {name: parts.env_start for name, parts in parsed if parts}


def view(kind: str, env: int) -> str:
    """Topic of a part of the view of an environment."""
    return f"/state/{VIEW}/{kind}/{env:0{_ENV_DIGITS}d}"


def parse_view(topic: str) -> ViewTopic | None:
    """Parts of a view's topic, or None where the topic is another."""
    match = _STATE.fullmatch(topic)
    return ViewTopic(match[2], int(match[3])) if match and match[1] == VIEW else None


def flight(env: int, group: str, field: str) -> str:
    """Topic of the last states of one field of an environment that failed."""
    return f"/flight/{env:0{_ENV_DIGITS}d}/{group}/{field}"


def has_digest(topic: str) -> bool:
    """Whether the messages of a topic have a digest in the end record, as they are.

    States have one by field, whatever their encoding; a view follows from them; the end record is where digests are.
    """
    return topic != RUN_END and _STATE.fullmatch(topic) is None


def action(name: str, env_start: int) -> str:
    """Topic of the actions of one actuator group."""
    return f"/action/{name}/{env_start:0{_ENV_DIGITS}d}"


def parse_action(topic: str) -> ActionTopic | None:
    """Parts of an action topic, or None where the topic is another."""
    match = _ACTION.fullmatch(topic)
    return ActionTopic(match[1], int(match[2])) if match else None


def timing(phase: str) -> str:
    """Topic of the clocks of a phase."""
    return f"/timing/{phase}"


def fingerprint(phase: str) -> str:
    """Topic of the state hashes of a phase."""
    return f"/fingerprint/{phase}"


def program(name: str) -> str:
    """Topic of the hashes of arrays that a program has beside its simulator."""
    return f"/program/{name}"


def parse_program(topic: str) -> str | None:
    """Name of these arrays, or None where the topic is another."""
    match = _PROGRAM.fullmatch(topic)
    return match[1] if match else None


def count(phase: str, name: str) -> str:
    """Topic of one counter of a phase."""
    return f"/count/{phase}/{name}"


def parse_count(topic: str) -> tuple[str, str] | None:
    """Phase and name of a counter's topic, or None where the topic is another."""
    match = _COUNT.fullmatch(topic)
    return (match[1], match[2]) if match else None


def overflow(phase: str) -> str:
    """Topic of the buffers and limits that a phase ran into."""
    return f"/overflow/{phase}"


def action_stream(phase: str) -> str:
    """Topic of what a phase applied."""
    return f"/action_stream/{phase}"


def gpu_memory(device: int, source: str) -> str:
    """Topic of one memory source ("device", "process" or "allocator") of a GPU."""
    return f"/memory/gpu{device}/{source}"


def gpu_hardware(device: int) -> str:
    """Topic of the clock rates and the like of a GPU."""
    return f"/hardware/gpu{device}"
