"""What adapters on JAX share: the two compiled loops over the state of all environments.

One program advances by any number of steps; the other one does the same and keeps what a recording wants of each step
in a ring on the device, from which it is copied at once. Both make the same step: ``Physics.advance``.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.actions import table
from gpusimbench.recorder.simulators.base import Captured, Description, Simulator, States
from gpusimbench.recorder.simulators.captured import BLOCK_BYTES, BLOCK_STEPS, RING_BLOCKS
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.jax import runtime as jax_runtime
from gpusimbench.recorder.simulators.jax.block import OVERFLOW, JaxBlock, Rings, begin_copy, evidence_of
from gpusimbench.recorder.simulators.snapshot import COMPLETE, Envs, Snapshot, StateClaims, rows_of
from gpusimbench.schemas.action_generator import JointTargets
from gpusimbench.schemas.mixing import GOLDEN32, mix32

if TYPE_CHECKING:  # it imports MuJoCo
    from gpusimbench.recorder.simulators.mujoco.model import MjcfModel


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


@dataclass(frozen=True)
class Physics:
    """An engine's step, as functions that JAX traces; a state is that of all environments, in any form.

    initial      qpos [env, nq] and qvel [env, nv], float32, as MuJoCo has them -> the first state; called on the host,
                 again for each fresh start
    advance      state, targets [env, action] or None -> state after one step
    observe      state -> what `split` of the adapter needs, arrays [env, ...] by name
    count        state -> counts of the step that led to it, int32 [env] by counter name; and, under OVERFLOW, bits
                 uint32 [env] where the engine has any
    kept         state -> what decides the next step, arrays [env, ...] by name
    put          state, arrays as of `kept` -> the state with these
    forget       state -> the same with its overflow bits cleared
    applied      state -> the actions that it holds, [env, action]
    lazy         the step builds kernels when it is first executed, not when it is compiled
    gathers      the engine itself adds up overflow bits over steps
    """

    initial: Callable[[NDArray[np.float32], NDArray[np.float32]], Any]
    advance: Callable[[Any, Any], Any]
    observe: Callable[[Any], dict[str, Any]]
    count: Callable[[Any], dict[str, Any]]
    kept: Callable[[Any], dict[str, Any]]
    put: Callable[[Any, dict[str, Any]], Any]
    forget: Callable[[Any], Any] = lambda state: state
    applied: Callable[[Any], Any] | None = None
    lazy: bool = False
    gathers: bool = False


class JaxSimulator(Simulator):
    """N environments on an engine written in JAX. A subclass says what its physics is (``_load``) and how a state is
    laid out (``_split``)."""

    # One reading of the clock for so many steps: inside, nothing but the engine's own loop runs.
    timing_interval = 100
    determinism_levels = jax_runtime.LEVELS
    levels_without_effect = {
        "cpu": dict.fromkeys(jax_runtime.LEVELS_OF_GPUS, "its flags are those of XLA's compiler for GPUs")
    }
    draws_actions = True
    blocks_ahead = 2

    @classmethod
    def environment(cls, options: Any, determinism: str) -> dict[str, str]:
        """See Simulator.environment."""
        return jax_runtime.environment(options, determinism)

    @abstractmethod
    def _load(self, device: Any) -> tuple[Physics, Description]:
        """The physics of the scene on a jax.Device, and what the simulator says of itself."""

    @abstractmethod
    def _split(self, seen: dict[str, NDArray[Any]]) -> States:
        """What was observed, arrays [..., env, ...] by name, as the state's fields."""

    def build(self) -> Description:
        """See Simulator.build."""
        self._device = jax_runtime.start(self.options)
        self._physics, description = self._load(self._device)
        actions = self.scene.actions
        self._draw = None if actions is None else device_draw(actions, seed=self.seed)
        self._programs: dict[str, Any] = {}
        self._counted: Evidence | None = None  # of the last states; None: to be counted when asked
        self._restart()
        # as many rows as a block of the recorder has: all of a ring is copied, filled or not
        row = sum(array.nbytes for array in self.state())
        self._ring = self.options.ring or max(1, min(BLOCK_STEPS, BLOCK_BYTES // max(1, row)))
        description.options["ring"] = self._ring
        return description

    @property
    @abstractmethod
    def _compiled(self) -> MjcfModel:
        """The scene as MuJoCo compiles it, from which the engine takes its model."""

    def _restart(self) -> None:
        self._state = self._first_state(None, None)
        self._step = np.uint32(0)
        self._bits = np.zeros(self.n_env, np.uint32)  # overflow bits of the steps since they were asked for

    def _first_state(self, states: States | None, envs: Envs) -> Any:
        # of all environments; those of `envs` with these positions and velocities
        compiled, rows = self._compiled, rows_of(envs)
        qpos, qvel = (
            np.tile(values.astype(np.float32), (self.n_env, 1)) for values in (compiled.qpos0, compiled.qvel0)
        )
        if states is not None:
            qpos[rows], qvel[rows] = compiled.joined(states)
        return self._physics.initial(qpos, qvel)

    def _seen(self) -> dict[str, NDArray[Any]]:
        return {name: np.asarray(array) for name, array in self._physics.observe(self._state).items()}

    def _program(self, name: str) -> Any:
        """The compiled program of that name: "advance", "record" or "count"."""
        if name not in self._programs:
            self._programs[name] = self._lowered(name).compile()
        return self._programs[name]

    def _lowered(self, name: str) -> Any:
        """The program of that name as XLA is given it, the same whichever way the present state came about."""
        import jax

        # Arrays that JAX may still move to another device make another program. Placed here, a state that was restored
        # or set is stepped by the program of the first state, which JAX's cache then has.
        state = jax.device_put(self._state, self._device)
        # The state's memory is handed over to the program that steps it: there is never a second copy.
        arguments = {
            "advance": (state, self._bits, self._step, np.int32(1), *self._drawn_by()),
            "record": (state, self._step, np.int32(1), *self._drawn_by()),
            "count": (state,),
        }[name]
        traced = {
            "advance": lambda: jax.jit(self._advance, donate_argnums=0),
            "record": lambda: jax.jit(self._record, donate_argnums=0),
            "count": lambda: jax.jit(self._physics.count),
        }[name]()
        return traced.lower(*arguments)

    def _drawn_by(self) -> tuple[NDArray[np.uint32], ...]:
        # of scenes with actions: arguments, so that one program makes the steps of all runs, whatever their streams are
        return () if self._draw is None else (self.streams.env, self.streams.begun)

    def _one(self, state: Any, step: Any, streams: tuple[Any, ...]) -> Any:
        return self._physics.advance(state, None if self._draw is None else self._draw(step, *streams))

    def _advance(self, state: Any, bits: Any, first: Any, n_step: Any, *streams: Any) -> Any:
        """Traced: n_step steps, the first of them number `first`, and the overflow bits with theirs added.

        Of what is counted only the bits are wanted, so the compiler leaves out the rest.
        """
        import jax

        def body(i: Any, carry: Any) -> Any:
            state, bits = carry
            state = self._one(state, first + i.astype(np.uint32), streams)
            if not self._physics.gathers:
                bits = bits | self._physics.count(state).get(OVERFLOW, np.uint32(0))
            return state, bits

        return jax.lax.fori_loop(0, n_step, body, (state, bits))

    def _record(self, state: Any, first: Any, n_step: Any, *streams: Any) -> Any:
        """Traced: as _advance, with observations and counts of each step in rings of `_ring` rows."""
        import jax

        def body(i: Any, carry: Any) -> Any:
            state, rings = carry
            state = self._one(state, first + i.astype(np.uint32), streams)
            rings = jax.tree.map(lambda ring, value: ring.at[i].set(value), rings, self._row(state))
            return self._physics.forget(state), rings

        return jax.lax.fori_loop(0, n_step, body, (state, self._rings(state)))

    def _row(self, state: Any) -> Rings:
        # what a recording wants of one step
        return {"seen": self._physics.observe(state), "counts": self._physics.count(state)}

    def _rings(self, state: Any) -> Rings:
        # as many empty rows as a ring has
        import jax
        import jax.numpy as jnp

        shapes = jax.eval_shape(self._row, state)
        rings: Rings = jax.tree.map(lambda shape: jnp.zeros((self._ring, *shape.shape), shape.dtype), shapes)
        return rings

    def compile(self, phase: str) -> None:
        """See Simulator.compile; kernels that are built when they first run are run once, and the state made anew."""
        import jax

        name = "advance" if phase == "timed" else "record"
        program = self._program(name)
        if name == "advance":
            self._program("count")
        elif self._device.platform != "cpu":
            # locking the pages of a block takes as long as ten steps; JAX keeps them for the blocks to come
            rings = self._rings(self._state)
            jax.block_until_ready([begin_copy(rings) for _ in range(RING_BLOCKS)])
        if self._physics.lazy:
            begun = self.snapshot()
            bits = (self._bits,) if name == "advance" else ()
            jax.block_until_ready(program(self._state, *bits, self._step, np.int32(1), *self._drawn_by()))
            self._restart()
            self.restore(begun)

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        import jax

        self._state, self._bits = jax.block_until_ready(
            self._program("advance")(self._state, self._bits, self._step, np.int32(n_step), *self._drawn_by())
        )
        self._step = np.uint32(self._step + n_step)
        self._counted = None

    def state(self) -> States:
        """See Simulator.state."""
        return self._split(self._seen())

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims: a state is a value, which has all that a step reads."""
        return StateClaims(COMPLETE, COMPLETE, COMPLETE, COMPLETE)

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot."""
        kept = self._physics.kept(self._state).items()
        return Snapshot(int(self._step), {name: np.array(array) for name, array in kept})

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        import jax.numpy as jnp

        arrays = {name: jnp.asarray(array) for name, array in snapshot.arrays.items()}
        if envs is None:
            self._step = np.uint32(snapshot.step)
        else:
            arrays = self._mixed(arrays, self._physics.kept(self._state), envs)
        self._state = self._physics.put(self._state, arrays)
        self._counted = None

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: the first state is made again, and selected for these environments."""
        self._select(self._first_state(None, None), envs)

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state: a first state is made of them, and selected for these environments."""
        self._select(self._first_state(states, envs), envs)

    def _select(self, first: Any, envs: Envs) -> None:
        if envs is None:
            self._state, self._step = first, np.uint32(0)
        else:
            self._state = self._mixed(first, self._state, envs)
        self._counted = None

    def _mixed(self, new: Any, present: Any, envs: NDArray[np.int64]) -> Any:
        """`present` with the rows of these environments from `new`, trees of the same arrays."""
        import jax

        def mixed(new: Any, present: Any, envs: Any) -> Any:
            # what has no axis of environments is a buffer that all share, filled anew in each step
            if not present.ndim or present.shape[0] != self.n_env:
                return present
            return present.at[envs].set(new[envs])

        # one program for all arrays: by themselves, a hundred of them are a hundred programs to compile
        if "mixed" not in self._programs:
            self._programs["mixed"] = jax.jit(
                lambda new, present, envs: jax.tree.map(lambda a, b: mixed(a, b, envs), new, present)
            )
        return self._programs["mixed"](new, present, envs)

    def begin_states(self, n_step: int) -> Captured:
        """See Simulator.begin_states: JAX returns before its device is done."""
        program = self._program("record")
        parts = []
        for first in range(0, n_step, self._ring):
            rows = min(self._ring, n_step - first)
            self._state, rings = program(self._state, self._step, np.int32(rows), *self._drawn_by())
            self._step = np.uint32(self._step + rows)
            parts.append((rows, rings))
        return JaxBlock(parts, self._split)

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        block = self.begin_states(n_step)
        block.wait()
        self._counted = block.evidence()
        return block.states(slice(None))

    def evidence(self) -> Evidence:
        """See Simulator.evidence. After ``step``, counts are made from the last step's state, outside the timed loop,
        which gathers overflow bits alone."""
        import jax

        if self._counted is not None:
            return self._counted
        counted = jax.device_get(self._program("count")(self._state))
        rows = {name: array[None] for name, array in counted.items()}
        if OVERFLOW in rows:
            rows[OVERFLOW] = rows[OVERFLOW] | np.asarray(self._bits)
        self._state = self._physics.forget(self._state)
        self._bits = np.zeros(self.n_env, np.uint32)
        return evidence_of(rows)

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        if self._draw is None or self._physics.applied is None:
            return None
        return np.asarray(self._physics.applied(self._state))

    def allocator_bytes(self) -> tuple[int, int] | None:
        """See Simulator.allocator_bytes."""
        return jax_runtime.allocator_bytes(self._device)

    def close(self) -> None:
        """See Simulator.close."""
        self._state = None
        self._programs = {}
