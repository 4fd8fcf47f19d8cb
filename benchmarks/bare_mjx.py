"""MJX (jax) with nothing around it: python -m benchmarks.bare_mjx MODEL N_ENV WARMUP STEPS 0 0."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path


def main() -> None:
    """Step and print env-steps/s."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    import jax
    import mujoco
    from mujoco import mjx

    n_env, warmup, steps = map(int, sys.argv[2:5])
    model = mjx.put_model(mujoco.MjModel.from_xml_string(Path(sys.argv[1]).read_text()))
    data = jax.vmap(lambda _: mjx.make_data(model))(jax.numpy.arange(n_env))
    step = jax.vmap(mjx.step, in_axes=(None, 0))

    def rollout(count: int) -> object:
        return jax.jit(lambda d: jax.lax.scan(lambda d, _: (step(model, d), None), d, length=count)[0])

    compiled = {count: rollout(count).lower(data).compile() for count in (warmup, steps)}  # type: ignore[attr-defined]
    data = jax.block_until_ready(compiled[warmup](data))
    began = time.perf_counter()
    jax.block_until_ready(compiled[steps](data))
    print(n_env * steps / (time.perf_counter() - began))


if __name__ == "__main__":
    main()
