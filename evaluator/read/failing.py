"""The environments that failed in a run that kept the states of these alone, and their last states as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.messages import Messages
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import decode_state
from gpusimbench.schemas.checks import MAX_COUNT
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.messages import enum_values

MOST_LISTED = 1024
"""Failures that are read; a recorder lists 16."""

KINDS = ("not finite", "overflow", "out of bounds")

ONLY_FAILING = "only failing environments are kept (--keep failing)"
"""Why such a recording has no states of all environments."""


@dataclass(frozen=True)
class EnvFailure:
    """What first happened to an environment.

    env         its number
    step        simulator step after which it first showed
    kind        one of KINDS, or a number that this version does not know
    field       "group/field" of the number that is wrong; empty for an overflow, and so are the next two
    item        body or joint
    component   of the item
    value       of the number; a position that is out of bounds is relative to the environment's origin [m]
    overflow    bits that overflowed in that step, as simulation.json says
    first_step  of the recorded states
    steps       recorded states
    """

    env: int
    step: int
    kind: str
    field: str
    item: str
    component: str
    value: float
    overflow: int
    first_step: int
    steps: int


@dataclass(frozen=True)
class Failing:
    """The environments that failed.

    failures   the first of them, by step and number: those that have states
    counts     environments that failed, by what first happened to each: in the order of KINDS
    last_step  the last one in which all environments were looked at
    """

    failures: tuple[EnvFailure, ...]
    counts: tuple[int, int, int]
    last_step: int

    @property
    def total(self) -> int:
        """Environments that failed."""
        return sum(self.counts)


@dataclass(frozen=True)
class LastStates:
    """States of one environment around its failure.

    steps   simulator steps, shape [row]
    states  by "group/field", arrays [row, item, width]
    """

    steps: NDArray[np.int64]
    states: dict[str, NDArray[np.floating]]


def read_failing(messages: Messages, *, n_env: int) -> Failing | None:
    """The list of a run that kept failing environments alone; None where it has none.

    DamagedRecording where it cannot be.
    """
    found = messages.read(topics.RUN_FAILING, "gsb.v1.FailingEnvs", 2)
    if not found:
        return None
    if len(found) > 1:
        raise messages.damaged(f"{topics.RUN_FAILING} lists the failing environments {len(found)} times")
    record = found[0]
    names = {number: name for name, number in enum_values("gsb.v1.FailureKind").items()}
    if len(record.failures) > MOST_LISTED:
        raise messages.damaged(f"{topics.RUN_FAILING} has {len(record.failures)} failures; {MOST_LISTED} are read")
    failures = tuple(
        EnvFailure(
            env=f.env,
            step=f.step,
            kind=names.get(f.kind, f"kind {f.kind}").removeprefix("FAILURE_KIND_").replace("_", " ").lower(),
            field=f"{f.group}/{f.field}" if f.field else "",
            item=f.item,
            component=f.component,
            value=f.value,
            overflow=f.overflow_bits,
            first_step=f.first_step,
            steps=f.steps,
        )
        for f in record.failures
    )
    made = Failing(failures, (record.not_finite, record.overflow, record.out_of_bounds), record.last_step)
    envs = {failure.env for failure in failures}
    if len(envs) < len(failures) or any(env >= n_env for env in envs):
        raise messages.damaged(f"{topics.RUN_FAILING} names an environment twice, or one that is not there")
    if not len(failures) <= made.total <= n_env:
        raise messages.damaged(f"{topics.RUN_FAILING} counts {made.total} of {n_env} environments")
    if any(not f.first_step <= f.step < f.first_step + f.steps <= MAX_COUNT for f in failures):
        raise messages.damaged(f"{topics.RUN_FAILING} has a failure outside of the states that are kept of it")
    return made


def read_last_states(messages: Messages, fields: tuple[StateField, ...], failure: EnvFailure) -> LastStates:
    """The states of an environment that failed; DamagedRecording where they are not those that the list names."""
    states = {}
    for field in fields:
        topic = topics.flight(failure.env, field.group, field.field)
        blocks = [decode_state(content) for content in messages.contents(topic)] if messages.has(topic) else []
        if len(blocks) != 1:
            raise messages.damaged(f"{topic} has {len(blocks)} blocks of states, not one")
        header, array = blocks[0]
        where = (header.first_step, header.steps, header.stride, header.env_start)
        shape = (failure.steps, 1, len(field.items), field.width)
        if where != (failure.first_step, failure.steps, 1, failure.env) or array.shape != shape:
            raise messages.damaged(f"{topic} has other states than {topics.RUN_FAILING} says")
        if array.dtype != np.dtype(field.dtype):
            raise messages.damaged(f"{topic} is {array.dtype}, and simulation.json says {field.dtype}")
        states[field.name] = array[:, 0]
    return LastStates(np.arange(failure.first_step, failure.first_step + failure.steps), states)
