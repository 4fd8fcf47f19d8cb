"""Brax with nothing around it: one compiled jax.lax.scan of the step of one of its pipelines, vmapped.

The system (model) and the initial state are those of the recorder.
"""

from __future__ import annotations

import time
from importlib import import_module
from typing import Any

from benchmarks.bare.loop import Built
from benchmarks.bare.work import Work


class Bare(Built):
    """See loop.Loop. The adapter has the first state, and takes the last one to read it."""

    def __init__(self, work: Work) -> None:
        super().__init__(work)
        import jax
        import jax.numpy as jnp

        pipeline = import_module(f"brax.{work.options.solver}.pipeline")
        system = self.simulator.system
        step = jax.vmap(lambda state: pipeline.step(system, state, jnp.zeros(0, jnp.float32)))
        self._rollout: Any = jax.jit(
            lambda state, n_step: jax.lax.scan(lambda s, _: (step(s), None), state, length=n_step)[0],
            static_argnums=1,
            donate_argnums=0,
        )
        self._compiled: dict[int, Any] = {}  # by the number of steps

    def step(self, first_step: int, n_step: int) -> float:
        """See Loop.step."""
        import jax

        if not n_step:
            return 0.0
        counted = self.simulator._state
        state = counted.state
        if n_step not in self._compiled:
            self._compiled[n_step] = self._rollout.lower(state, n_step).compile()
        began = time.perf_counter()
        stepped = jax.block_until_ready(self._compiled[n_step](state))
        elapsed_s = time.perf_counter() - began
        self.simulator._state = counted._replace(state=stepped)
        return elapsed_s

    def contacts(self) -> None:
        """See Loop.contacts: only the adapter counts them."""
