"""Brax: its own three physics pipelines, in JAX. Collisions are MJX's."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES
from gpusimbench.recorder.options import AT_LEAST_1, MEASURED, one_of, require
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import LARGER, MEAN, combination, materials, other_restitution
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.captured import row_index
from gpusimbench.recorder.simulators.evidence import CANDIDATE_PAIRS, CONTACTS
from gpusimbench.recorder.simulators.jax import runtime as jax_runtime
from gpusimbench.recorder.simulators.jax.block import OVERFLOW
from gpusimbench.recorder.simulators.jax.runtime import JaxOptions
from gpusimbench.recorder.simulators.jax.simulator import JaxSimulator, Physics
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from gpusimbench.schemas.fields import BODY_FIELDS, StateField, body_fields
from gpusimbench.schemas.provenance import Deviation

if TYPE_CHECKING:  # it imports MuJoCo
    from gpusimbench.recorder.simulators.mujoco.model import MjcfModel


SOLVERS = ("positional", "spring", "generalized")

_STATIC = {
    "positional": (
        "1",
        "a contact holds while its tangential correction is smaller than its normal one, whatever the material; "
        "sliding has the kinetic coefficient",
    ),
    "spring": ("none", "tangential speeds above 1 mm/s are opposed with the kinetic coefficient; nothing sticks"),
    "generalized": ("the kinetic coefficient", "there is one friction coefficient"),
}


@dataclass(frozen=True)
class BraxOptions(JaxOptions):
    """Options of Brax; defaults are Brax's own.

    solver              positional: position-based dynamics; spring: impulses; generalized: constraint forces in joint
                        coordinates. Positional is the default, since it alone has restitution and friction that holds
    collide_scale       positional: share of each position correction that is applied
    baumgarte_erp       spring: share of a penetration that is pushed out in a step
    restitution         positional, spring: whether contacts rebound by the scene's coefficients
    solver_iterations   generalized: iterations of projected gradient descent, at most
    solver_maxls        generalized: line-search trials in each, at most
    max_geom_pairs      pairs that a collision function keeps; 0: measured
    max_contact_points  contacts of an environment that are kept; 0: measured
    """

    solver: str = "positional"
    collide_scale: float = 1.0
    baumgarte_erp: float = 0.1
    restitution: bool = True
    solver_iterations: int = 100
    solver_maxls: int = 20
    max_geom_pairs: int = 0
    max_contact_points: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("solver", self.solver, SOLVERS)
        require(self, (lambda v: 0 < v <= 1, "a number above 0, at most 1"), "collide_scale", "baumgarte_erp")
        require(self, AT_LEAST_1, "solver_iterations", "solver_maxls")
        require(self, MEASURED, "max_geom_pairs", "max_contact_points")


def deviations(scene: Scene, options: BraxOptions) -> tuple[Deviation, ...]:
    """The parameters that the chosen solver honours otherwise than the scene gives them, or not at all.

    Each pair of shapes gets the larger friction of the two, by MJX's collision code; and, but for generalized, the
    mean of their restitutions, by Brax's.
    """
    solver, rebounds = options.solver, options.solver != "generalized" and options.restitution
    found = [combination("friction", LARGER, "rule of MJX, whose collision code Brax uses")]
    if rebounds:
        found.append(combination("restitution", MEAN, "Brax's rule"))
    for material in materials(scene):
        used, why = _STATIC[solver]
        if solver == "generalized":
            used = str(material.kinetic_friction)
        found.append(Deviation(f"{material.name}.static_friction", str(material.static_friction), used, why))
        if not rebounds:
            springs = "contacts are damped springs (solref, solimp), as MuJoCo's"
            why = springs if solver == "generalized" else "switched off"
            found.append(other_restitution(material, "0", why))
    return tuple(found)


class Brax(JaxSimulator):
    """N environments: the step of a Brax pipeline, vmapped over its State.

    Brax keeps no contacts in its state. Those that a step finds are counted where it finds them, in the one search for
    collisions that it makes: spring searches at the poses at which the step begins, generalized at those at which it
    ends, positional at poses that it predicts within the step.
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
        self.system = system
        names = list(system.link_names)
        self._links = [row_index([names.index(body) for body in bodies]) for bodies in self.scene.groups().values()]
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
                "device is done; overflow bits are gathered on the device from the contacts that the step found; "
                "nothing is copied"
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

        def counts(centres: Any, active: Any) -> dict[str, Any]:
            candidates = certificate.candidates(centres)
            return {
                CONTACTS.name: active.sum(axis=-1, dtype=jnp.int32),
                CANDIDATE_PAIRS.name: candidates,
                OVERFLOW: certificate.bits(candidates, active, dim),
            }

        def seen(x: Any, found: Any) -> tuple[Any, Any]:
            # a body of a scene has one shape, at its centre
            return jnp.where((body == 0)[:, None], fixed, x.pos[body - 1]), (
                jnp.zeros(0, bool) if found is None else found.dist < 0
            )

        def step(state: Any) -> tuple[Any, tuple[Any, Any]]:
            with _watched(contact) as searches:
                stepped = pipeline.step(system, state, no_actions)
            [(x, found)] = searches
            return stepped, seen(x, found)

        def advance(state: _Counted, _: Any) -> _Counted:
            stepped, collisions = jax.vmap(step)(state.state)
            return _Counted(stepped, counts(*collisions))

        def initial(qpos: Any, qvel: Any) -> _Counted:
            first = jax.vmap(lambda q, qd: pipeline.init(system, q, qd))(qpos, qvel)
            return _Counted(first, counts(*jax.vmap(lambda x: seen(x, contact.get(system, x)))(first.x)))

        return Physics(
            initial=jax.jit(initial),
            advance=advance,
            observe=lambda counted: {
                "position": counted.state.x.pos,
                "orientation": counted.state.x.rot,
                "linear_velocity": counted.state.xd.vel,
                "angular_velocity": counted.state.xd.ang,
            },
            count=lambda counted: counted.counts,
            kept=lambda counted: _leaves(counted.state),
            put=lambda counted, arrays: counted._replace(
                state=jax.tree.unflatten(
                    jax.tree.structure(counted.state), [arrays[name] for name in _leaves(counted.state)]
                )
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


class _Counted(NamedTuple):
    """A pipeline's State of all environments, and the counts of the step that led to it, [env] by counter name."""

    state: Any
    counts: dict[str, Any]


@contextmanager
def _watched(contact: Any) -> Iterator[list[tuple[Any, Any]]]:
    """The searches for collisions that a pipeline makes while JAX traces it: poses, and the contacts found."""
    searches: list[tuple[Any, Any]] = []
    search = contact.get

    def get(system: Any, x: Any) -> Any:
        found = search(system, x)
        searches.append((x, found))
        return found

    contact.get = get
    try:
        yield searches
    finally:
        contact.get = search


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
