"""Actions of a run to blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recorder.capture.sink import Sink
from recorder.capture.states import env_block
from recorder.scenes.actions import JointTargets
from schemas import topics
from schemas.blocks import encode_action
from schemas.configuration import sim_time_ns


def declare_actions(sink: Sink, actions: JointTargets, *, n_env: int) -> None:
    """The channels of a stream of actions."""
    metadata = {
        "shape": "step,env,joint",
        "joints": ",".join(actions.joints),
        "unit": "rad",
        "dtype": "float32",
        "meaning": "target position of each joint, held during the step",
    }
    for start in range(0, n_env, env_block(n_env)):
        sink.channel(topics.action(actions.name, start), "gsb.v1.ActionBlock", metadata)


def write_actions(sink: Sink, name: str, actions: NDArray[np.float32], *, first_step: int, dt: float) -> None:
    """Actions [step, env, action] of consecutive steps."""
    n_env = actions.shape[1]
    time = sim_time_ns(first_step, dt)
    for start in range(0, n_env, env_block(n_env)):
        part = actions[:, start : start + env_block(n_env)]
        data = encode_action(part, first_step=first_step, stride=1, env_start=start, sim_time_ns=time)
        sink.write(topics.action(name, start), data, sim_ns=time)
