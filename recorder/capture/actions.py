"""Actions of a run to blocks, and what a phase applied without storing it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.states import env_block
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.schemas import topics
from gpusimbench.schemas.action_generator import JointTargets, Streams
from gpusimbench.schemas.blocks import action_parts
from gpusimbench.schemas.configuration import sim_time_ns
from gpusimbench.schemas.mcap.writer import Part
from gpusimbench.schemas.messages import message_class


def declare_actions(sink: Sink, actions: JointTargets, *, n_env: int) -> None:
    """The channels of a stream of actions."""
    metadata = {
        "shape": "step,env,joint",
        "joints": ",".join(actions.joints),
        "unit": actions.unit,
        "dtype": "float32",
        "meaning": actions.meaning,
    }
    for start in range(0, n_env, env_block(n_env)):
        sink.channel(topics.action(actions.name, start), "gsb.v1.ActionBlock", metadata)


Actions = Callable[[range], NDArray[np.float32]]
"""What is applied in consecutive steps to the environments of a range, [step, env, action]."""


def write_actions(
    sink: Sink, workers: Workers, name: str, actions: Actions, *, n_env: int, first_step: int, dt: float
) -> None:
    """Actions of consecutive steps, the first of them leading on from the state of `first_step`."""
    time = sim_time_ns(first_step, dt)

    def encoded(envs: range) -> tuple[Part, ...]:
        parts = action_parts(actions(envs), first_step=first_step, stride=1, env_start=envs.start, sim_time_ns=time)
        sink.digest.message(topics.action(name, envs.start), *(part.data for part in parts))
        return parts

    size = env_block(n_env)
    blocks = [range(start, min(start + size, n_env)) for start in range(0, n_env, size)]
    for envs, parts in zip(blocks, workers.start(encoded, blocks), strict=True):
        sink.write_parts(topics.action(name, envs.start), parts, sim_ns=time)
    sink.flush()


def write_action_stream(
    sink: Sink,
    phase: str,
    actions: JointTargets,
    *,
    seed: int,
    streams: Streams,
    first_step: int,
    n_step: int,
    applied: NDArray[np.float32] | None,
) -> str | None:
    """What a phase applied; returns what is wrong with the last actions that the engine holds, if anything.

    applied  those actions, [env, action]; None where the engine cannot tell
    """
    n_env = len(streams.env)
    rows = [
        actions.draw(seed, n_env=n_env, first_step=step, n_step=1, streams=streams)[0]
        for step in (first_step, first_step + n_step - 1)
    ]
    same = applied is not None and np.array_equal(applied, rows[1])
    message = message_class("gsb.v1.ActionStream")(
        generator=actions.describe(seed, streams),
        first_step=first_step,
        steps=n_step,
        envs=n_env,
        first_sha256=_sha256(rows[0]),
        last_sha256=_sha256(rows[1]),
        verified=same,
    )
    sink.channel(topics.action_stream(phase), "gsb.v1.ActionStream")
    sink.write(topics.action_stream(phase), message.SerializeToString())
    if applied is None or same:
        return None
    wrong = int(np.count_nonzero((applied != rows[1]).any(axis=1))) if applied.shape == rows[1].shape else n_env
    return f"the engine's actions of step {first_step + n_step - 1} are not those it was given, in {wrong} envs"


def _sha256(array: NDArray[np.float32]) -> str:
    return hashlib.sha256(np.ascontiguousarray(array, dtype="<f4").tobytes()).hexdigest()
