"""Why a step of MJX (impl=jax) on a GPU depends on how many environments there are.

Environments of inclined-collision that begin in states of their own are stepped as a batch of MANY; the first FEW of
them are also stepped as a batch of their own. Inputs are the same bits, so the results must be. Two tables:

1. Each primitive of a step by itself, as jaxprs have them, none fused with another: those whose result differs in the
   other batch. For each of them the step is computed once more in which it alone gives the first FEW environments what
   it gives them in the other batch: does what moves (positions, velocities, the solver's warm start) change?
2. Whole compiled steps, each in a process of its own: triangular systems solved, and matrices factorised, by the
   primitives or column by column, with XLA's fusion of operations and without: the first step at which the first FEW
   environments differ.

    python -m benchmarks.mjx_batch [--many 64] [--few 16] [--at 2] [--steps 40]

It compiles for one to two minutes for each line of the second table, and as long for the first.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.divergence import differs, ulp_distance
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.mjx.physics import MjxOptions
from gpusimbench.recorder.simulators.mjx.simulator import Mjx
from gpusimbench.schemas.initial import Initial

RUN_TO_RUN = "--xla_gpu_deterministic_ops=true --xla_gpu_autotune_level=0"
NO_FUSION = "--xla_disable_hlo_passes=" + ",".join(
    (
        "fusion", "fusion_merger", "fusion-block-level-rewriter", "horizontal-loop-fusion", "horizontal_input_fusion",
        "horizontal_loop_fusion", "multi_output_fusion", "priority-fusion", "triton-softmax-rewriter",
    )
)  # fmt: skip
"""Each operation stays a kernel of its own. XLA ignores names of passes that it does not have."""

MOVES = ("qpos", "qvel", "qacc_warmstart")
"""What the next step reads of a state; everything else is computed anew."""

EXACT = {"transpose", "reshape", "broadcast_in_dim", "slice", "dynamic_slice", "squeeze", "concatenate", "gather"}
"""Primitives that only move numbers, which are not compared."""

_COLUMNS = ("none", "solve", "factor and solve")
_LINES = (("none", "yes"), ("none", "no"), ("solve", "yes"), ("solve", "no"), ("factor and solve", "no"))

Place = tuple[str, str, str]
"""Of a primitive: its name, where MJX calls it, and the shapes of its operands for FEW environments."""


def by_columns(factor: tuple[Any, bool], right: Any) -> Any:
    """x of A x = b, as ``jax.scipy.linalg.cho_solve``, without a sum whose order a batch could decide.

    factor  of ``cho_factor``: (triangle [n, n], whether it is the lower one)
    right   b [n]

    Each column of the triangle, times the element of x that it yields, is subtracted from what is left of b.
    """
    import jax
    import jax.numpy as jnp

    triangle, is_lower = factor
    lower = triangle if is_lower else triangle.T
    n = lower.shape[0]
    rows = jnp.arange(n)

    def down(j: Any, x: Any) -> Any:
        at = x[j] / lower[j, j]
        return jnp.where(rows == j, at, jnp.where(rows > j, x - lower[:, j] * at, x))

    def up(turn: Any, x: Any) -> Any:
        j = n - 1 - turn
        at = x[j] / lower[j, j]
        return jnp.where(rows == j, at, jnp.where(rows < j, x - lower[j, :] * at, x))

    half = jax.lax.fori_loop(0, n, down, right, unroll=4)
    return jax.lax.fori_loop(0, n, up, half, unroll=4)


def factor_by_columns(matrix: Any, **_: Any) -> tuple[Any, bool]:
    """The upper triangle [n, n] of ``jax.scipy.linalg.cho_factor``, without a sum whose order a batch could decide.

    What each column of its transpose makes of the matrix is subtracted before the next column is computed.
    """
    import jax
    import jax.numpy as jnp

    n = matrix.shape[0]
    rows = jnp.arange(n)

    def column(j: Any, state: tuple[Any, Any]) -> tuple[Any, Any]:
        left, triangle = state
        pivot = jnp.sqrt(left[j, j])
        found = jnp.where(rows > j, left[:, j] / pivot, jnp.where(rows == j, pivot, 0.0))
        return left - found[:, None] * found[None, :], triangle.at[:, j].set(found)

    return jax.lax.fori_loop(0, n, column, (matrix, jnp.zeros_like(matrix)))[1].T, False


def batched_step(many: int, device: str) -> tuple[Any, Any]:
    """mjx.Data -> mjx.Data of a batch, and the batch of MANY initial states."""
    import jax
    from mujoco import mjx

    from gpusimbench.recorder.run.start import begin

    scene = make_scene("inclined-collision")
    simulator = Mjx(scene, n_env=many, dt=scene.dt, seed=0, options=MjxOptions(device=device))
    begin(simulator, simulator.build(), str(Initial(0.1)), None)
    model = simulator._model.put(simulator._device)
    return jax.vmap(lambda data: mjx.step(model, data)), simulator._state


def moved(data: Any) -> list[Any]:
    """What the next step reads."""
    return [getattr(data, name) for name in MOVES]


def first(tree: Any, few: int) -> Any:
    """The first environments of a batch."""
    import jax

    return jax.tree.map(lambda array: array[:few], tree)


def difference(ours: Sequence[Any], theirs: Sequence[Any]) -> tuple[int, int]:
    """How many float32 numbers differ in their bits, and by how many units in the last place at most."""
    count, most = 0, 0
    for a, b in zip(ours, theirs, strict=True):
        x, y = np.asarray(a), np.asarray(b)
        if x.dtype == np.float32 and (mask := differs(x, y)).any():
            count, most = count + int(mask.sum()), max(most, int(ulp_distance(x, y)[mask].max()))
    return count, most


def cut(array: Any, shape: Sequence[int]) -> Any:
    """The part of a batch's array that has the shape which the smaller batch's has."""
    return array[tuple(slice(0, n) for n in shape)] if array.shape != tuple(shape) else array


class Step:
    """The jaxpr of a step for MANY environments, run equation by equation beside that for FEW.

    perturbed  a place at which the first FEW environments get what the smaller batch's primitive gives them; None:
               primitives are compared instead, into `found`
    """

    def __init__(self, many: Any, few: Any, perturbed: Place | None = None) -> None:
        self.many, self.few, self.perturbed = many, few, perturbed
        self.found: dict[Place, tuple[int, int, int]] = {}
        self.executed = 0

    def __call__(self, arguments: Sequence[Any]) -> list[NDArray[Any]]:
        """What moves, after the step."""
        return self._run(self.many, self.few, arguments)

    def _run(self, many: Any, few: Any, arguments: Sequence[Any]) -> list[Any]:
        from jax.extend.core import Literal

        jaxpr, small, consts = getattr(many, "jaxpr", many), getattr(few, "jaxpr", few), getattr(many, "consts", ())
        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *arguments], strict=True))

        def read(atom: Any) -> Any:
            return atom.val if isinstance(atom, Literal) else values[atom]

        for equation, smaller in zip(jaxpr.eqns, small.eqns, strict=True):
            results = self._equation(equation, smaller, [read(atom) for atom in equation.invars])
            values.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def _equation(self, equation: Any, smaller: Any, operands: list[Any]) -> list[Any]:
        many, few = (e.params.get("jaxpr", e.params.get("call_jaxpr")) for e in (equation, smaller))
        name = equation.primitive.name
        if name in ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call"):
            return self._run(many, few, operands)
        if name == "while":
            return self._loop(equation.params, smaller.params, operands)
        results = _results(equation, operands)
        if name in EXACT or (self.perturbed and self.perturbed != place_of(smaller)):
            return results
        fewer = [cut(np.asarray(o), v.aval.shape) for o, v in zip(operands, smaller.invars, strict=True)]
        others = _results(smaller, fewer)
        if self.perturbed:
            rows = [tuple(slice(0, n) for n in other.shape) for other in others]
            return [r if r.shape == o.shape else r.at[s].set(o) for r, o, s in zip(results, others, rows, strict=True)]
        self.executed += 1
        count, most = difference([cut(r, o.shape) for r, o in zip(results, others, strict=True)], others)
        if count:
            times, numbers, worst = self.found.get(place_of(smaller), (0, 0, 0))
            self.found[place_of(smaller)] = times + 1, numbers + count, max(worst, most)
        return results

    def _loop(self, many: dict[str, Any], few: dict[str, Any], operands: list[Any]) -> list[Any]:
        import jax
        import jax.numpy as jnp

        n, m = many["cond_nconsts"], many["body_nconsts"]
        asked, consts, carry = operands[:n], operands[n : n + m], operands[n + m :]
        going_on = jax.jit(jax.extend.core.jaxpr_as_fun(many["cond_jaxpr"]))
        while bool((going := going_on(*asked, *carry)[0]).any()):
            done = self._run(many["body_jaxpr"], few["body_jaxpr"], [*consts, *carry])
            if going.ndim:  # of each environment: those that have ended keep what they have
                wide = [going.reshape(going.shape + (1,) * (new.ndim - going.ndim)) for new in done]
                done = [jnp.where(w, new, old) for w, new, old in zip(wide, done, carry, strict=True)]
            carry = done
        return carry


def _results(equation: Any, operands: Sequence[Any]) -> list[Any]:
    results = equation.primitive.bind(*operands, **equation.params)
    return list(results) if equation.primitive.multiple_results else [results]


def place_of(equation: Any) -> Place:
    """Of a primitive of the smaller batch."""
    from jax._src import source_info_util

    where = source_info_util.summarize(equation.source_info).rsplit("/", 1)[-1]
    shapes = " ".join(str(tuple(atom.aval.shape)) for atom in equation.invars)
    return equation.primitive.name, where, shapes


def primitives(many: int, few: int, at: int, device: str) -> None:
    """The first table, for the step number `at`."""
    import jax.extend
    from jax.interpreters import partial_eval

    step, data = batched_step(many, device)
    program = jax.jit(step)
    for _ in range(at - 1):
        data = program(data)
    leaves, tree = jax.tree.flatten(data)

    def traced(batch: list[Any]) -> Any:
        closed = jax.make_jaxpr(lambda *args: moved(step(jax.tree.unflatten(tree, args))))(*batch)
        alive, _ = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(MOVES), instantiate=True)
        return type(closed)(alive, closed.consts)

    pair = traced(leaves), traced(first(leaves, few))
    compared = Step(*pair)
    plain = first(compared(leaves), few)
    print(f"step {at}: {compared.executed} executions of primitives in a batch of {many} and in a batch of {few}")
    print("| primitive | at | operands | times | numbers that differ | at most, ULP | what moves |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for place, counts in compared.found.items():
        changed, _ = difference(plain, first(Step(*pair, place)(leaves), few))
        reaches = f"{changed} numbers change" if changed else "the same bits"
        print("| " + " | ".join(str(cell) for cell in (*place, *counts, reaches)) + " |", flush=True)


def parting(many: int, few: int, steps: int, device: str, columns: str) -> str:
    """The first step after which the first FEW of MANY environments differ from FEW alone."""
    import jax.scipy.linalg

    solve: dict[str, Any] = {"cho_solve": by_columns}
    both = solve | {"cho_factor": factor_by_columns}
    own = {"none": {}, "solve": solve, "factor and solve": both}[columns]
    with mock.patch.multiple(jax.scipy.linalg, **own) if own else nullcontext():
        step, data = batched_step(many, device)
        alone = first(data, few)
        programs = [jax.jit(step).lower(batch).compile() for batch in (data, alone)]
    for number in range(1, steps + 1):
        data, alone = programs[0](data), programs[1](alone)
        if difference(moved(first(data, few)), moved(alone))[0]:
            return f"from step {number}"
    return f"not in {steps} steps"


def main() -> None:
    """Print both tables."""
    p = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    p.add_argument("--many", type=int, default=64, help="environments")
    p.add_argument("--few", type=int, default=16, help="environments of the smaller batch")
    p.add_argument("--at", type=int, default=2, help="step of the first table; 0: none")
    p.add_argument("--steps", type=int, default=40, help="of the second table; 0: none")
    p.add_argument("--device", default="auto")
    p.add_argument("--columns", choices=_COLUMNS, help=argparse.SUPPRESS)
    a = p.parse_args()
    if a.columns:
        print(parting(a.many, a.few, a.steps, a.device, a.columns))
        return
    if a.at:
        os.environ.setdefault("XLA_FLAGS", RUN_TO_RUN)
        primitives(a.many, a.few, a.at, a.device)
    if a.steps:
        print(f"\n| column by column | fusion | the first {a.few} of {a.many} environments differ from {a.few} alone |")
        print("| --- | --- | --- |")
    for columns, fused in _LINES if a.steps else ():
        flags = RUN_TO_RUN if fused == "yes" else f"{RUN_TO_RUN} {NO_FUSION}"
        command = [sys.executable, "-m", "benchmarks.mjx_batch", *sys.argv[1:], "--columns", columns]
        done = subprocess.run(command, env={**os.environ, "XLA_FLAGS": flags}, capture_output=True, text=True)
        said = done.stdout.strip() or f"failed: {done.stderr.strip().splitlines()[-1]}"
        print(f"| {columns} | {fused} | {said} |", flush=True)


if __name__ == "__main__":
    main()
