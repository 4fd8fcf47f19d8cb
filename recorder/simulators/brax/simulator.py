"""Brax: its own three physics pipelines, in JAX. Collisions are MJX's."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.brax.options import BraxOptions, deviations
from gpusimbench.recorder.simulators.evidence import CANDIDATE_PAIRS, CONTACTS
from gpusimbench.recorder.simulators.jax import runtime as jax_runtime
from gpusimbench.recorder.simulators.jax.block import OVERFLOW
from gpusimbench.recorder.simulators.jax.simulator import JaxSimulator, Physics
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from gpusimbench.schemas.fields import BODY_FIELDS, StateField, body_fields

if TYPE_CHECKING:  # it imports MuJoCo
    from gpusimbench.recorder.simulators.mujoco.model import MjcfModel


class Brax(JaxSimulator):
    """N environments: the step of a Brax pipeline, vmapped over its State.

    Brax keeps no contacts in its state: they are counted at the poses after each step, by the same collision code.
    Spring and generalized begin the next step with these poses; positional collides at poses that it predicts within
    the step, which differ by what bodies move in one step.
    """

    Options = BraxOptions
    distribution = "brax"
    abilities = BODIES  # its solvers have no position actuators with a scene's force limits

    def _load(self, device: Any) -> tuple[Physics, Description]:
        options: BraxOptions = self.options
        compiled, caps = _compile(self, options)
        self._made_of = compiled
        with _unheeded():
            from brax.io import mjcf

            pipeline = import_module(f"brax.{options.solver}.pipeline")
            system = mjcf.load_model(compiled.model)
        names = list(system.link_names)
        self._links = [[names.index(body) for body in bodies] for bodies in self.scene.groups().values()]
        return self._physics_of(pipeline, system, compiled, caps), Description(
            version=metadata.version("brax"),
            device=jax_runtime.name_of(device),
            options={
                "solver": options.solver,
                "device": options.device,
                "compile_cache": options.compile_cache,
                "collide_scale": _short(system.collide_scale),
                "baumgarte_erp": _short(system.baumgarte_erp),
                "restitution": options.restitution,
                "solver_iterations": int(system.solver_iterations),
                "solver_maxls": int(system.solver_maxls),
            },
            switches={
                **jax_runtime.switches(self.determinism),
                "mjx": metadata.version("mujoco-mjx"),
                "mujoco": metadata.version("mujoco"),
            },
            deviations=deviations(self.scene, options),
            fields=self._fields(),
            timing_covers=(
                f"a compiled loop (jax.lax.fori_loop) of the vmapped step of brax.{options.solver}.pipeline, until the "
                "device is done; overflow bits are gathered on the device after each step; nothing is copied"
            ),
            attachments=compiled.attachments,
            buffers=caps.buffers,
            counters=(CONTACTS, CANDIDATE_PAIRS),
            overflow_bits=_bits(),
        )

    def _physics_of(self, pipeline: Any, system: Any, compiled: Any, caps: Any) -> Physics:
        import jax
        import jax.numpy as jnp
        from brax import contact
        from mujoco.mjx._src import collision_driver

        from gpusimbench.recorder.simulators.mjx.caps import Certificate

        certificate = Certificate(compiled.model, caps)
        dim = collision_driver.make_condim(compiled.model)
        body = np.asarray(compiled.model.geom_bodyid)
        fixed = jnp.asarray(compiled.model.geom_pos, jnp.float32)
        no_actions = jnp.zeros(0, jnp.float32)
        step = jax.vmap(lambda state: pipeline.step(system, state, no_actions))

        def count(state: Any) -> dict[str, Any]:
            # a body of a scene has one shape, at its centre
            centres = jnp.where((body == 0)[:, None], fixed, state.x.pos[:, body - 1])
            candidates = certificate.candidates(centres)
            if dim.size:
                active = jax.vmap(lambda x: contact.get(system, x).dist)(state.x) < 0
            else:
                active = jnp.zeros((self.n_env, 0), bool)
            return {
                CONTACTS.name: active.sum(axis=-1, dtype=jnp.int32),
                CANDIDATE_PAIRS.name: candidates,
                OVERFLOW: certificate.bits(candidates, active, dim),
            }

        return Physics(
            initial=jax.jit(jax.vmap(lambda q, qd: pipeline.init(system, q, qd))),
            advance=lambda state, actions: step(state),
            observe=lambda state: {
                "position": state.x.pos,
                "orientation": state.x.rot,
                "linear_velocity": state.xd.vel,
                "angular_velocity": state.xd.ang,
            },
            count=count,
            kept=_leaves,
            put=lambda state, arrays: jax.tree.unflatten(
                jax.tree.structure(state), [arrays[name] for name in _leaves(state)]
            ),
        )

    @property
    def _compiled(self) -> MjcfModel:
        compiled: MjcfModel = self._made_of
        return compiled

    def _restart(self) -> None:
        with _unheeded():
            super()._restart()

    def _program(self, name: str) -> Any:
        with _unheeded():
            return super()._program(name)

    def _fields(self) -> tuple[StateField, ...]:
        return body_fields(self.scene.groups(), "float32")

    def _split(self, seen: dict[str, NDArray[Any]]) -> States:
        return tuple(seen[field][..., links, :] for links in self._links for field in BODY_FIELDS)


def _leaves(state: Any) -> dict[str, Any]:
    """Every array of a pipeline's State by its path: each pipeline carries something else from step to step."""
    import jax

    return {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(state)}


@contextmanager
def _unheeded() -> Iterator[None]:
    # Brax warns that its pipelines are no longer developed, and MJX that Brax reads names that have moved
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _short(number: Any) -> float:
    return float(str(np.float32(number)))  # as it was given, not as its float32 reads in double precision


def _bits() -> Any:
    from gpusimbench.recorder.simulators.mjx.caps import BITS

    return BITS


def _compile(simulator: Brax, options: BraxOptions) -> tuple[Any, Any]:
    """The scene's model as Brax takes it, with MJX's limits in it, and these limits."""
    from gpusimbench.recorder.simulators.mjx import caps as mjx_caps
    from gpusimbench.recorder.simulators.mujoco.model import compile_scene

    # all that Brax accepts; of MuJoCo's solver options it reads only the iterations, and those in generalized alone
    physics = MjcfOptions(integrator="Euler", cone="pyramidal", iterations=options.solver_iterations)
    scene, dt = simulator.scene, simulator.dt
    plain = compile_scene(scene, dt=dt, options=physics)
    restitution = {body.name: body.material.restitution for body in scene.bodies}
    elasticity = [restitution[plain.model.geom(index).name] for index in range(plain.model.ngeom)]
    caps = mjx_caps.choose(
        plain,
        dt=dt,
        seed=simulator.seed,
        max_geom_pairs=options.max_geom_pairs,
        max_contact_points=options.max_contact_points,
    )
    numerics = {
        **caps.numerics,
        "collide_scale": repr(options.collide_scale),
        "baumgarte_erp": repr(options.baumgarte_erp),
        "solver_maxls": str(options.solver_maxls),
    }
    if options.restitution:
        numerics["elasticity"] = " ".join(map(repr, elasticity))
    limited = compile_scene(scene, dt=dt, options=physics, numerics=numerics)
    mjx_caps.check_read(limited.model, caps)
    return limited, caps
