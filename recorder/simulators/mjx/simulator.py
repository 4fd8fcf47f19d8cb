"""MJX: MuJoCo in JAX, or in Warp kernels that JAX calls."""

from __future__ import annotations

from abc import abstractmethod
from importlib import metadata
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, ROBOTS, VARIED, Ability
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.jax import runtime as jax_runtime
from gpusimbench.recorder.simulators.jax.simulator import JaxSimulator, Physics
from gpusimbench.recorder.simulators.mjx import physics as mjx_physics
from gpusimbench.recorder.simulators.mjx.physics import MjxModel, MjxOptions
from gpusimbench.schemas.imported import Imported

if TYPE_CHECKING:  # it imports MuJoCo
    from gpusimbench.recorder.simulators.mujoco.model import MjcfModel


class MjxSimulator(JaxSimulator):
    """N environments stepped by MJX. A subclass says how (``_physics_of``).

    name    of the simulator
    covers  what one timed call runs
    """

    abilities = BODIES | ROBOTS | {Ability.CHAINS, Ability.LOOPS, Ability.MODELS}
    name: ClassVar[str]
    covers: ClassVar[str]

    def _load(self, device: Any) -> tuple[Physics, Description]:
        impl = self._implementation()
        with mjx_physics.refusals(impl):
            model = self._model = mjx_physics.load(
                self.scene,
                n_env=self.n_env,
                dt=self.dt,
                seed=self.seed,
                options=self.options,
                impl=impl,
                variation=self.variation,
            )
            self._on_device = model.put(device)
            physics = self._physics_of(model, self._on_device, device)
        actions = "" if self.scene.actions is None else "the actions of each step are made in it; "
        return physics, Description(
            version=metadata.version(self.distribution),
            device=jax_runtime.name_of(device),
            options=model.options(self.options, self.name),
            switches={
                **jax_runtime.switches(self.determinism),
                "implementation": impl,
                "mjx": metadata.version("mujoco-mjx"),
                "mujoco": metadata.version("mujoco"),
            },
            deviations=model.compiled.deviations,
            fields=model.compiled.fields("float32"),
            timing_covers=(
                f"{self.covers}, until the device is done; {actions}overflow bits are gathered on the device after "
                "each step; nothing is copied"
            ),
            attachments=model.compiled.attachments,
            buffers=model.buffers,
            counters=model.counters,
            overflow_bits=model.overflow_bits,
        )

    def _implementation(self) -> str:
        """jax or warp."""
        impl: str = self.options.impl
        return impl

    @abstractmethod
    def _physics_of(self, model: MjxModel, on_device: Any, device: Any) -> Physics:
        """How the model is stepped on a jax.Device, on which its mjx.Model is."""

    def imported(self) -> Imported:
        """See Simulator.imported."""
        from gpusimbench.recorder.simulators.mujoco.imported import imported

        def read(name: str) -> NDArray[Any]:
            owner, _, field = name.rpartition(".")
            return np.asarray(getattr(self._on_device.opt if owner else self._on_device, field))

        return imported(self._compiled.model, read, f"MJX (impl={self._model.impl})")

    def link_poses(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """See Simulator.link_poses: mjx.kinematics."""
        import jax
        from mujoco import mjx

        kept = self._physics.kept(self._state)
        first = self._model.first_data(self._device, kept["qpos"][0], kept["qvel"][0])

        def poses(qpos: Any) -> Any:
            data = mjx.kinematics(self._on_device, first.replace(qpos=qpos))
            return data.xpos, data.xquat

        positions, orientations = jax.jit(jax.vmap(poses))(kept["qpos"])
        return np.asarray(positions), np.asarray(orientations)

    def _program(self, name: str) -> Any:
        with mjx_physics.refusals(self._model.impl):
            return super()._program(name)

    @property
    def _compiled(self) -> MjcfModel:
        compiled: MjcfModel = self._model.compiled
        return compiled

    def _split(self, seen: dict[str, NDArray[Any]]) -> States:
        fields: States = self._model.compiled.split(seen["qpos"], seen["qvel"])
        return fields

    def allocator_bytes(self) -> tuple[int, int] | None:
        """See Simulator.allocator_bytes; with impl=warp, both allocators of the device, the sum of their peaks."""
        found = super().allocator_bytes()
        if found is None or self._model.impl != "warp":
            return found
        import warp as wp

        from gpusimbench.recorder.simulators.warp import runtime as warp_runtime

        also = warp_runtime.allocator_bytes(wp.device_from_jax(self._device)) or (0, 0)
        return found[0] + also[0], found[1] + also[1]


class Mjx(MjxSimulator):
    """N environments: mjx.step, vmapped over a batched mjx.Data."""

    Options = MjxOptions
    name = "mjx"
    distribution = "mujoco-mjx"
    covers = "a compiled loop (jax.lax.fori_loop) of vmapped mjx.step over all environments"
    abilities = MjxSimulator.abilities | frozenset(VARIED.values())

    @classmethod
    def withheld(cls, options: Any) -> dict[Ability, str]:
        """See Simulator.withheld."""
        return {} if options.impl == "jax" else dict.fromkeys(VARIED.values(), "--impl jax")

    def _physics_of(self, model: MjxModel, on_device: Any, device: Any) -> Physics:
        import jax
        import jax.numpy as jnp
        from mujoco import mjx

        from gpusimbench.recorder.simulators.mjx.physics import batched

        model_on_device, axes = batched(on_device, model.varied) if model.varied else (on_device, None)
        step = jax.vmap(mjx.step, (axes, 0))

        # array by array, each copy would be a program of its own to compile
        copies = jax.jit(lambda one, qpos, qvel: jax.vmap(lambda q, v: one.replace(qpos=q, qvel=v))(qpos, qvel))

        def initial(qpos: Any, qvel: Any) -> Any:
            return copies(model.first_data(device, jnp.asarray(qpos[0]), jnp.asarray(qvel[0])), qpos, qvel)

        def advance(data: Any, actions: Any) -> Any:
            return step(model_on_device, data if actions is None else data.replace(ctrl=actions))

        return Physics(
            initial=initial,
            advance=advance,
            observe=mjx_physics.observe,
            count=model.count,
            kept=mjx_physics.kept,
            put=lambda data, arrays: data.replace(**arrays),
            forget=lambda data: mjx_physics.forget(data, model.impl),
            applied=lambda data: data.ctrl,
            lazy=model.impl == "warp",
            gathers=model.impl == "warp",
        )

    def hold(self, controls: NDArray[np.float64]) -> None:
        """See Simulator.hold."""
        import jax.numpy as jnp

        self._state = self._physics.put(self._state, {"ctrl": jnp.asarray(controls, jnp.float32)})
