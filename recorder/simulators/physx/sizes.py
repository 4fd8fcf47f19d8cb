"""How large the buffers of PhysX's GPU pipeline must be, counted on MuJoCo C where it is installed."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.base import Plane, Scene
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.physx.options import LARGEST, PhysxOptions
from gpusimbench.schemas.provenance import Buffer

_MARGIN = 2  # PhysX makes other contacts of the same shapes, and its solvers other motions
_NEIGHBOURS = 26  # of a cube in a stack of cubes
_POINTS = 4  # of contact between two faces
_STACK_LEAST = 64 << 20  # bytes, PhysX's own default
_STACK_OF_PAIR = 256  # bytes; PhysX does not tell what a pair takes
_LEAST = 1024  # of every buffer; PhysX's own default of those for robots


@dataclass(frozen=True)
class PhysxNeed:
    """What one environment needs at its fullest.

    contacts  contact points
    pairs     pairs of shapes whose bounding volumes overlap
    found_by  how that was found out, in words
    """

    contacts: int
    pairs: int
    found_by: str


def choose_buffers(scene: Scene, *, n_env: int, dt: float, seed: int, options: PhysxOptions) -> tuple[Buffer, ...]:
    """Capacities, by their names in USD; options that ask for a size get it. Refused where one is more than PhysX can
    be given."""
    need = measure(scene, dt=dt, seed=seed, options=options)
    pairs = need.pairs * _MARGIN
    buffers = [
        _chosen("gpuMaxRigidContactCount", options.max_contacts, need.contacts, n_env, need.found_by),
        # a pair that touches has a patch or two
        _chosen("gpuMaxRigidPatchCount", options.max_patches, need.pairs, n_env, need.found_by),
        _chosen("gpuFoundLostPairsCapacity", options.max_pairs, need.pairs, n_env, need.found_by),
    ]
    for name in ("gpuFoundLostAggregatePairsCapacity", "gpuTotalAggregatePairsCapacity"):
        needed = need.pairs if scene.robot is not None or isinstance(scene, ModelScene) else 0
        buffers.append(_chosen(name, options.max_aggregate_pairs, needed, n_env, need.found_by))
    # An estimate must not end a sweep: the most there is gets its chance, and an overflow shows in the log.
    stack = min(LARGEST, max(_STACK_LEAST, _STACK_OF_PAIR * pairs * n_env))
    how = f"{_STACK_OF_PAIR} bytes for each of {pairs} pairs in {n_env} envs, from PhysX's default to the most it takes"
    asked_for = options.collision_stack
    buffers.append(
        Buffer("gpuCollisionStackSize", asked_for or stack, "all", sized_by="asked for" if asked_for else how)
    )
    for buffer in buffers:
        if buffer.asked > LARGEST:
            raise Refused(f"PhysX's {buffer.name} is at most {LARGEST}, and {n_env} environments need {buffer.asked}")
    return tuple(buffers)


def _chosen(name: str, asked_for: int, needed: int, n_env: int, found_by: str) -> Buffer:
    if asked_for:
        return Buffer(name, asked_for * n_env, "all", sized_by=f"asked for: {asked_for} in each of {n_env} envs")
    how = f"{needed} {found_by}, times {_MARGIN}, in each of {n_env} envs, and at least {_LEAST}"
    return Buffer(name, max(_LEAST, needed * _MARGIN * n_env), "all", sized_by=how)


def measure(scene: Scene, *, dt: float, seed: int, options: PhysxOptions) -> PhysxNeed:
    """Count on MuJoCo C, whose shapes see each other from as far as PhysX's; without it, by the number of shapes."""
    if find_spec("mujoco") is None:
        return _by_shapes(scene)
    from gpusimbench.recorder.simulators.buffer_sizes import measure_from_afar

    need = measure_from_afar(scene, dt=dt, seed=seed, reach=options.contact_offset)
    return PhysxNeed(need.contacts, need.pairs, f"needed by {need.envs} envs of MuJoCo C in {need.steps} steps")


def _by_shapes(scene: Scene) -> PhysxNeed:
    """As many as in a stack of cubes without end."""
    moving = len(scene.moving()) + sum(len(link.shapes) for link in (scene.robot.links if scene.robot else ()))
    unbounded = sum(isinstance(body.shape, Plane) for body in scene.bodies)
    pairs = moving * (_NEIGHBOURS // 2 + 1 + unbounded)
    return PhysxNeed(_POINTS * pairs, pairs, f"for {moving} moving shapes as in a stack, MuJoCo C not being installed")
