"""Action streams made on the device, bit for bit what ``recorder.scenes.actions`` draws on the host."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gpusimbench.recorder.scenes.actions import JointTargets
from gpusimbench.schemas.mixing import GOLDEN32, mix32


def device_draw(actions: JointTargets, *, seed: int, n_env: int) -> Callable[[Any], Any]:
    """A traceable function of the step (uint32 scalar) that gives the targets of all environments [rad], [env, joint].

    The chain of JointTargets.draw in 32-bit wrapping integers; its last two operations, an integer to float32 and a
    product with a power of two, are exact.
    """
    import jax.numpy as jnp

    rows = actions.table()
    if rows is not None:
        given = jnp.asarray(rows)
        return lambda step: jnp.broadcast_to(given[step % len(rows)], (n_env, rows.shape[2]))
    golden = np.uint32(GOLDEN32)
    first, count, grid = (jnp.asarray(numbers) for numbers in actions.grid())

    def draw(step: Any) -> Any:
        word: Any = jnp.uint32(actions.seed_word(seed))
        env = jnp.arange(n_env, dtype=jnp.uint32)[:, None]
        joint = jnp.arange(len(actions.joints), dtype=jnp.uint32)[None, :]
        for counter in (env, jnp.asarray(step, jnp.uint32), joint):
            word = mix32(word + (counter + np.uint32(1)) * golden)
        index = (word >> np.uint32(16)) * count >> np.uint32(16)
        return (first + index.astype(jnp.int32)).astype(jnp.float32) * grid

    return draw
