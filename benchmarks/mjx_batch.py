"""Which operation of MJX (impl=jax) depends on how many environments there are.

The state of a run of many environments is handed to each part of a step alone, compiled for that many environments and
for fewer. The environments that both have must get the same bits; a part in which they do not depends on the batch.
Then whole runs are made in which some parts are computed environment by environment (`jax.lax.map`): where environment
0 no longer depends on the number of environments, these parts are the cause.

    XLA_FLAGS="--xla_gpu_deterministic_ops=true --xla_gpu_autotune_level=0" python -m benchmarks.mjx_batch
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from benchmarks.warp_batch import first_difference, of_first
from gpusimbench.evaluator.metrics.divergence import differs, ulp_distance
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.mjx.physics import MjxOptions
from gpusimbench.recorder.simulators.mjx.simulator import Mjx
from gpusimbench.schemas.treatment import Initial

Part = Callable[[Any], Any]


def simulator_of(n_env: int, device: str) -> Mjx:
    """Inclined-collision, built; every environment begins in a state of its own."""
    from gpusimbench.recorder.run.start import begin

    scene = make_scene("inclined-collision")
    simulator = Mjx(scene, n_env=n_env, dt=scene.dt, seed=0, options=MjxOptions(device=device))
    description = simulator.build()
    begin(simulator, description, str(Initial(0.1)), None)
    return simulator


def parts_of(model: Any) -> dict[str, Part]:
    """The parts of a step of one environment, in order: mjx.Data -> what the part computes."""
    import jax
    from mujoco.mjx._src import collision_driver, constraint, forward, smooth, solver, support

    def hessian(data: Any) -> Any:
        impl = data._impl
        active = impl.efc_D > 0
        found = (impl.efc_J.T * impl.efc_D * active) @ impl.efc_J + support.full_m(model, data)
        return (found + found.T) * 0.5

    def factor(data: Any) -> Any:
        return jax.scipy.linalg.cho_factor(hessian(data))[0]

    def factor_alone(data: Any) -> Any:
        return jax.scipy.linalg.cho_factor(support.full_m(model, data))[0]

    def solved(data: Any) -> Any:
        return jax.scipy.linalg.cho_solve((support.full_m(model, data), False), data.qfrc_smooth)

    return {
        "kinematics": lambda data: smooth.kinematics(model, data),
        "centres of mass": lambda data: smooth.com_pos(model, data),
        "inertia matrix": lambda data: smooth.crb(model, data),
        "its factor": lambda data: smooth.factor_m(model, data),
        "collision": lambda data: collision_driver.collision(model, data),
        "constraint rows": lambda data: constraint.make_constraint(model, data),
        "velocities": lambda data: forward.fwd_velocity(model, data),
        "smooth acceleration": lambda data: forward.fwd_acceleration(model, data),
        "J v": lambda data: data._impl.efc_J @ data.qvel,
        "J^T f": lambda data: data._impl.efc_J.T @ data._impl.efc_D,
        "Hessian J^T D J + M": hessian,
        "Hessian and its Cholesky factor": factor,
        "Cholesky factor of M": factor_alone,
        "triangular solves": solved,
        "constraint solver": lambda data: solver.solve(model, data),
        "integration": lambda data: forward.implicit(model, data),
    }


def compared(part: Part, data: Any, number: int) -> str:
    """A part compiled for all environments of `data` and for the first `number` of them: what differs in these."""
    import jax

    program = jax.jit(jax.vmap(part))
    first = jax.tree.map(lambda array: array[:number], data)
    alike, differing, most = 0, 0, 0
    for many, few in zip(_leaves(program(data)), _leaves(program(first)), strict=True):
        mask = differs(many[:number], few)
        alike += int(mask.size - mask.sum())
        differing += int(mask.sum())
        if mask.any():
            most = max(most, int(ulp_distance(many[:number], few)[mask].max()))
    return f"{differing} of {alike + differing} numbers, up to {most} ULP" if differing else "same"


def _leaves(tree: Any) -> list[NDArray[Any]]:
    import jax

    arrays = (np.asarray(leaf) for leaf in jax.tree.leaves(tree))
    return [array for array in arrays if array.dtype == np.float32]


def one_by_one(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same, computed environment by environment wherever it is mapped over environments."""
    import jax

    return jax.custom_batching.sequential_vmap(function)  # type: ignore[no-any-return]


def replacements() -> dict[str, Callable[[ExitStack], None]]:
    """What is computed environment by environment in a whole run, by name."""
    import jax
    from mujoco.mjx._src import smooth, solver

    centres = smooth.com_pos
    factor, solve, gradient = jax.scipy.linalg.cho_factor, jax.scipy.linalg.cho_solve, solver._update_gradient

    def alone_factor(matrix: Any) -> Any:
        return one_by_one(lambda one: factor(one)[0])(matrix), False

    def alone_solve(known: Any, right: Any) -> Any:
        return one_by_one(lambda one, b: solve((one, False), b))(known[0], right)

    def alone_gradient(model: Any, data: Any, context: Any) -> Any:
        return one_by_one(lambda d, c: gradient(model, d, c))(data, context)

    def alone_centres(model: Any, data: Any) -> Any:
        def found(one: Any) -> Any:
            done = centres(model, one)
            return done.subtree_com, done._impl.cinert, done.cdof

        names = ("subtree_com", "_impl.cinert", "cdof")
        return data.tree_replace(dict(zip(names, one_by_one(found)(data), strict=True)))

    def masses(stack: ExitStack) -> None:
        stack.enter_context(mock.patch.object(smooth, "com_pos", alone_centres))

    def cholesky(stack: ExitStack) -> None:
        stack.enter_context(mock.patch.object(jax.scipy.linalg, "cho_factor", alone_factor))
        stack.enter_context(mock.patch.object(jax.scipy.linalg, "cho_solve", alone_solve))

    def newton(stack: ExitStack) -> None:
        stack.enter_context(mock.patch.object(solver, "_update_gradient", alone_gradient))

    def both(stack: ExitStack) -> None:
        cholesky(stack)
        newton(stack)

    def all_three(stack: ExitStack) -> None:
        both(stack)
        masses(stack)

    return {
        "nothing": lambda stack: None,
        "Cholesky factors and solves": cholesky,
        "the solver's Newton direction": newton,
        "both": both,
        "centres of mass": masses,
        "all three": all_three,
    }


def trajectory(n_env: int, steps: int, device: str) -> list[NDArray[Any]]:
    """The states of environment 0 after each step, one array a step."""
    return of_first(simulator_of(n_env, device), steps)


def table(head: Sequence[str], rows: Iterator[list[str]]) -> None:
    """As Markdown, each row as soon as it is known."""
    print("| " + " | ".join(head) + " |\n|" + " --- |" * len(head))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)


def main() -> None:
    """Print both tables."""
    p = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    p.add_argument("--many", type=int, default=64, help="environments")
    p.add_argument("--numbers", default="1,2,16,32", help="of environments that are held against the first of these")
    p.add_argument("--at", type=int, default=12, help="step whose state is handed to the parts")
    p.add_argument("--steps", type=int, default=50, help="of whole runs; 0: none")
    p.add_argument("--device", default="auto")
    arguments = p.parse_args()
    numbers = [int(number) for number in arguments.numbers.split(",")]

    simulator = simulator_of(arguments.many, arguments.device)
    simulator.step(arguments.at)
    model, data = simulator._model.put(simulator._device), simulator._state
    parts = parts_of(model)
    head = [f"part of a step, {arguments.many} environments against", *map(str, numbers)]
    table(head, ([name, *(compared(part, data, number) for number in numbers)] for name, part in parts.items()))
    simulator.close()
    if not arguments.steps:
        return

    def runs() -> Iterator[list[str]]:
        for name, replace in replacements().items():
            with ExitStack() as stack:
                replace(stack)
                base = trajectory(arguments.many, arguments.steps, arguments.device)
                others = (trajectory(number, arguments.steps, arguments.device) for number in numbers)
                yield [name, *(first_difference(base, other) for other in others)]

    print()
    table([f"one by one; {arguments.many} environments differ from step, against", *map(str, numbers)], runs())


if __name__ == "__main__":
    main()
