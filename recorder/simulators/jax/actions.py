"""Action streams made on the device, bit for bit what ``schemas.action_generator`` draws on the host."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gpusimbench.recorder.scenes.actions import table
from gpusimbench.schemas.action_generator import JointTargets
from gpusimbench.schemas.mixing import GOLDEN32, mix32


def device_draw(actions: JointTargets, *, seed: int) -> Callable[[Any, Any, Any], Any]:
    """A traceable function of the step (uint32 scalar) and of both arrays of the environments' Streams that gives the
    targets of all environments [rad], [env, joint].

    The chain of JointTargets.draw in 32-bit wrapping integers; its last two operations, an integer to float32 and a
    product with a power of two, are exact.
    """
    import jax.numpy as jnp

    rows = table(actions)
    if rows is not None:
        given = jnp.asarray(rows)
        steps, envs = np.uint32(rows.shape[0]), np.uint32(rows.shape[1])
        return lambda step, env, begun: given[jnp.where(step >= begun, step - begun, step) % steps, env % envs]
    golden = np.uint32(GOLDEN32)
    first, count, grid = (jnp.asarray(numbers) for numbers in actions.grid())

    def draw(step: Any, env: Any, begun: Any) -> Any:
        word: Any = jnp.uint32(actions.seed_word(seed))
        step = jnp.asarray(step, jnp.uint32)
        joint = jnp.arange(len(actions.joints), dtype=jnp.uint32)[None, :]
        for counter in (env[:, None], jnp.where(step >= begun, step - begun, step)[:, None], joint):
            word = mix32(word + (counter + np.uint32(1)) * golden)
        index = (word >> np.uint32(16)) * count >> np.uint32(16)
        return (first + index.astype(jnp.int32)).astype(jnp.float32) * grid

    return draw
