"""What adapters over MJX share: options, buffers of each implementation, counts of a step, layout of the state,
and models whose fields differ from environment to environment."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.options import one_of
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.variation import Variation
from gpusimbench.recorder.simulators.evidence import (
    CANDIDATE_PAIRS,
    CONSTRAINT_ROWS,
    CONTACTS,
    MISPLACED_CONTACTS,
    SOLVER_ITERATIONS,
)
from gpusimbench.recorder.simulators.jax.block import OVERFLOW
from gpusimbench.recorder.simulators.jax.runtime import JaxOptions
from gpusimbench.recorder.simulators.mujoco.contacts import misplaced
from gpusimbench.recorder.simulators.mujoco.options import (
    CONES,
    STATE_COMPONENTS,
    MjcfOptions,
    replacement,
)
from gpusimbench.schemas.provenance import Buffer, Counter, OverflowBit

IMPLEMENTATIONS = ("jax", "warp")

_INFORMATION = ("ITERATIONS", "LS_ITERATIONS")  # bits that say that the solver stopped early, not that it lost anything


_CONE = {"jax": "pyramidal", "warp": "elliptic"}  # of each implementation, where none was asked for


@dataclass(frozen=True)
class MjxOptions(JaxOptions, MjcfOptions):
    """Options of MJX: MuJoCo's, with the defaults that MuJoCo C has here, the cone apart, and its own.

    With impl=jax and the elliptic cone, cubes of the collision scene are thrown at 20 m/s where all other
    implementations of the same equations let them slide: MJX 3.17 bounds the cube of a contact's slip speed by the
    constant that bounds the speed itself, so that the solver's matrix is indefinite for slow slip (mujoco_warp's
    pull request 1660 describes it). It also keeps a dense matrix of all constraint rows. So the cone is pyramidal
    there, unless asked for otherwise.

    cone                auto (pyramidal with impl=jax, elliptic with impl=warp), elliptic or pyramidal
    impl                jax or warp
    max_geom_pairs      impl=jax: pairs that a collision function keeps; 0: measured
    max_contact_points  impl=jax: contacts of an environment that are kept; 0: measured
    naconmax            impl=warp: contacts, and before them candidate pairs, that all environments have room for
                        together; 0: measured
    njmax               impl=warp: constraint rows that an environment has room for; 0: measured
    """

    cone: str = "auto"
    impl: str = "jax"
    max_geom_pairs: int = 0
    max_contact_points: int = 0
    naconmax: int = 0
    njmax: int = 0

    def __post_init__(self) -> None:
        one_of("cone", self.cone, ("auto", *CONES))
        self.physics(IMPLEMENTATIONS[0])  # its own check of all the rest
        JaxOptions.__post_init__(self)
        self._check_impl()
        for name in ("max_geom_pairs", "max_contact_points", "naconmax", "njmax"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is 0 (measured) or a positive number")

    def physics(self, impl: str) -> MjcfOptions:
        """MuJoCo's options for an implementation."""
        given = {option.name: getattr(self, option.name) for option in fields(MjcfOptions)}
        return MjcfOptions(**{**given, "cone": _CONE[impl] if self.cone == "auto" else self.cone})

    def _check_impl(self) -> None:
        one_of("impl", self.impl, IMPLEMENTATIONS)


@dataclass(frozen=True)
class MjxModel:
    """A scene for one implementation of MJX.

    compiled       by MuJoCo, with the limits of impl=jax in it
    impl           jax or warp
    sizes          arguments of mjx.make_data
    buffers, counters, overflow_bits  as in a Description
    count          a batched mjx.Data -> counts and bits of its last step (``jax_simulator.Physics.count``)
    varied         fields of mjx.Model that differ from environment to environment, as of mjx.varied
    """

    compiled: Any
    impl: str
    sizes: dict[str, int]
    buffers: tuple[Buffer, ...]
    counters: tuple[Counter, ...]
    overflow_bits: tuple[OverflowBit, ...]
    count: Callable[[Any], dict[str, Any]] = field(repr=False)
    varied: dict[str, NDArray[Any]] = field(default_factory=dict, repr=False)

    def options(self, asked: MjxOptions, simulator: str) -> dict[str, Any]:
        """All options in force."""
        return {
            **self.compiled.in_force(asked.physics(self.impl), simulator),
            "impl": self.impl,
            "device": asked.device,
            "compile_cache": asked.compile_cache,
        }

    def put(self, device: Any) -> Any:
        """The mjx.Model on a jax.Device."""
        from mujoco import mjx

        model = mjx.put_model(self.compiled.model, device=device, impl=self.impl)
        if self.impl == "warp":
            # the bits are recorded; printed by each environment at each step they would fill the log
            model = model.tree_replace({"opt._impl.warn_overflow": 0})
        return model

    def first_data(self, device: Any, qpos: Any, qvel: Any) -> Any:
        """mjx.Data of one environment with these positions and velocities, its buffers large enough for all."""
        from mujoco import mjx

        data = mjx.make_data(self.compiled.model, device=device, impl=self.impl, **self.sizes)
        return data.replace(qpos=qpos, qvel=qvel)


def load(
    scene: Scene,
    *,
    n_env: int,
    dt: float,
    seed: int,
    options: MjxOptions,
    impl: str,
    variation: Variation | None = None,
) -> MjxModel:
    """Compile a scene for MJX and size its buffers on MuJoCo C; parameters vary with impl=jax alone."""
    from gpusimbench.recorder.simulators.mujoco.model import compile_scene

    physics = options.physics(impl)
    compiled = compile_scene(scene, dt=dt, options=physics)
    if impl == "warp":
        return _for_warp(compiled, n_env=n_env, dt=dt, seed=seed, options=options)
    from gpusimbench.recorder.simulators.mjx import caps as mjx_caps
    from gpusimbench.recorder.simulators.mujoco.model import compile_varied

    caps = mjx_caps.choose(
        compiled,
        dt=dt,
        seed=seed,
        max_geom_pairs=options.max_geom_pairs,
        max_contact_points=options.max_contact_points,
        varied=variation is not None,
    )
    limited = compile_scene(scene, dt=dt, options=physics, numerics=caps.numerics)
    mjx_caps.check_read(limited.model, caps)
    models = compile_varied(scene, variation, n_env=n_env, dt=dt, options=physics, numerics=caps.numerics)
    varied = model_fields(limited.model, models)
    radii = varied.get("geom_rbound", limited.model.geom_rbound)
    certificate = mjx_caps.Certificate(limited.model, caps, radii)
    return MjxModel(
        limited,
        impl,
        sizes={},
        buffers=caps.buffers,
        counters=(CONTACTS, CONSTRAINT_ROWS, CANDIDATE_PAIRS, MISPLACED_CONTACTS),
        overflow_bits=mjx_caps.BITS,
        count=lambda data: _count_jax(data, certificate, radii, elliptic=physics.cone == "elliptic"),
        varied=varied,
    )


def _for_warp(compiled: Any, *, n_env: int, dt: float, seed: int, options: MjxOptions) -> MjxModel:
    import mujoco
    import warp as wp
    from mujoco.mjx.third_party.mujoco_warp._src.types import OverflowType

    from gpusimbench.recorder.simulators.buffer_sizes import measure

    wp.config.quiet = True  # one line for each of some hundred modules
    naconmax, njmax = options.naconmax, options.njmax
    contacts_by, rows_by = "asked for", "asked for"
    if not (naconmax and njmax):
        need = measure(compiled, dt=dt, seed=seed)
        if not naconmax:
            naconmax = need.size(need.pool) * n_env
            contacts_by = f"{n_env} envs, each: {need.sized_by(need.pool)}"
        if not njmax:
            njmax, rows_by = need.size(need.rows), need.sized_by(need.rows)
    # MuJoCo Warp never restarts a simulation that went bad, and takes no model that says that it must not.
    model = copy.copy(compiled.model)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    bits = [bit for bit in OverflowType if bit and not bit & (bit - 1)]
    return MjxModel(
        replace(compiled, model=model),
        "warp",
        sizes={"naconmax": naconmax, "njmax": njmax},
        buffers=(
            Buffer("naconmax", naconmax, "all", counter=CONTACTS.name, sized_by=contacts_by),
            Buffer("njmax", njmax, "env", counter=CONSTRAINT_ROWS.name, sized_by=rows_by),
        ),
        counters=(CONTACTS, CONSTRAINT_ROWS, SOLVER_ITERATIONS, MISPLACED_CONTACTS),
        overflow_bits=tuple(
            OverflowBit(int(bit).bit_length() - 1, str(bit.name), fatal=bit.name not in _INFORMATION) for bit in bits
        ),
        count=lambda data: _count_warp(data, model.geom_rbound),
    )


def _count_jax(data: Any, certificate: Any, radii: NDArray[np.floating], *, elliptic: bool) -> dict[str, Any]:
    """Counts of the last step from a batched mjx.Data, whose contacts and poses are those that the step began with.

    radii  of the geoms' bounding spheres [m], [geom] or [env, geom]
    """
    import jax.numpy as jnp

    inner = data._impl
    active = inner.contact.dist < inner.contact.includemargin
    dim = np.asarray(inner.contact.dim)
    rows_each = np.where(dim == 1, 1, dim if elliptic else 2 * (dim - 1)).astype(np.int32)
    limits = slice(inner.ne + inner.nf, inner.ne + inner.nf + inner.nl)
    at_limit = inner.efc_pos[:, limits] < inner.efc_margin[:, limits]
    candidates = certificate.candidates(data.geom_xpos)
    env = jnp.arange(len(active))[:, None]
    outside = active & _misplaced(inner.contact.pos, inner.contact.dist, inner.contact.geom, env, data, radii)
    return {
        CONTACTS.name: active.sum(axis=-1, dtype=jnp.int32),
        CONSTRAINT_ROWS.name: (active * rows_each).sum(axis=-1, dtype=jnp.int32)
        + at_limit.sum(axis=-1, dtype=jnp.int32)
        + jnp.int32(inner.ne + inner.nf),
        CANDIDATE_PAIRS.name: candidates,
        MISPLACED_CONTACTS.name: outside.sum(axis=-1, dtype=jnp.int32),
        OVERFLOW: certificate.bits(candidates, active, dim),
    }


def _misplaced(points: Any, distances: Any, geoms: Any, env: Any, data: Any, radii: NDArray[np.floating]) -> Any:
    """As of mujoco.contacts, of contacts between geoms [..., 2] of the environments `env`, [...]; -1: no geom, and no
    point is outside."""
    import jax.numpy as jnp

    of_env = jnp.broadcast_to(jnp.asarray(radii, jnp.float32), data.geom_xpos.shape[:2])[env[..., None], geoms]
    centres = data.geom_xpos[env[..., None], geoms]
    return misplaced(points, distances, centres, jnp.where(geoms < 0, 0, of_env), jnp)


def _count_warp(data: Any, radii: NDArray[np.floating]) -> dict[str, Any]:
    """Counts of the last step from a batched mjx.Data; overflow bits are those since they were cleared.

    Contacts of all environments lie in one pool, in no order; each says whose it is.

    radii  of the geoms' bounding spheres [m], [geom]
    """
    import jax.numpy as jnp

    inner = data._impl
    n_env = data.qpos.shape[0]
    used = jnp.arange(inner.contact__worldid.shape[0]) < inner.nacon[0]
    env, none = inner.contact__worldid, jnp.zeros(n_env, jnp.int32)
    outside = used & _misplaced(inner.contact__pos, inner.contact__dist, inner.contact__geom, env, data, radii)
    return {
        CONTACTS.name: none.at[env].add(used.astype(jnp.int32), mode="drop"),
        CONSTRAINT_ROWS.name: inner.nefc.reshape(n_env),
        SOLVER_ITERATIONS.name: inner.solver_niter.reshape(n_env),
        MISPLACED_CONTACTS.name: none.at[env].add(outside.astype(jnp.int32), mode="drop"),
        OVERFLOW: inner.overflow.reshape(n_env).astype(jnp.uint32),
    }


def observe(data: Any) -> dict[str, Any]:
    """What a state consists of, arrays [env, ...]."""
    return {"qpos": data.qpos, "qvel": data.qvel}


def kept(data: Any) -> dict[str, Any]:
    """What decides the next step, arrays [env, ...] by MuJoCo's names."""
    return {name: getattr(data, name) for name in STATE_COMPONENTS if hasattr(data, name)}


def forget(data: Any, impl: str) -> Any:
    """The data with its overflow bits cleared; MJX's copy of MuJoCo Warp only ever adds to them."""
    import jax.numpy as jnp

    return data.tree_replace({"_impl.overflow": jnp.zeros_like(data._impl.overflow)}) if impl == "warp" else data


@contextmanager
def refusals(impl: str) -> Iterator[None]:
    """Refused where MJX has not implemented what was asked."""
    try:
        yield
    except NotImplementedError as error:
        said = f"MJX (impl={impl}) does not take these options or this scene: {error}"
        raise Refused(f"{said}{replacement(said)}") from None


_STATISTICS = ("meaninertia", "meanmass", "meansize")  # the first scales the solver's tolerance


def model_fields(model: Any, models: Sequence[Any]) -> dict[str, NDArray[Any]]:
    """Fields of mjx.Model that differ between the mujoco.MjModels of environments, [env, ...], by their path in it.

    What else differs MJX does not have, or reads for height fields alone (`geom_rbound_hfield`).
    """
    from mujoco import mjx

    from gpusimbench.recorder.simulators.mujoco.model import varied_fields

    known = {field.name for field in fields(mjx.Model)}
    found = {name: array for name, array in varied_fields(model, models).items() if name in known}
    for name in _STATISTICS:
        values = np.array([getattr(one.stat, name) for one in models])
        if (values != getattr(model.stat, name)).any():
            found[f"stat.{name}"] = values
    return found


def batched(model: Any, varied: Mapping[str, NDArray[Any]]) -> tuple[Any, Any]:
    """The mjx.Model with these fields, and which of its arrays jax.vmap is to take apart."""
    import jax
    import jax.numpy as jnp

    whole = model.tree_replace({name: jnp.asarray(array, jnp.float32) for name, array in varied.items()})
    axes = jax.tree.map(lambda array: None, model).tree_replace(dict.fromkeys(varied, 0))
    return whole, axes
