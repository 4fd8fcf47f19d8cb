"""What N environments on Genesis have in common, whatever they hold; and how much room their contact buffers get,
counted on MuJoCo C, which Genesis brings along."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.buffer_sizes import measure
from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.fields import StateField

_MARGIN = 2.0  # over MuJoCo's contact points: Genesis has most while bodies that just touch settle into each other


@dataclass(frozen=True)
class Drive:
    """What some degrees of freedom are given at each of some steps.

    control  method of the solver that takes values [env, dof], indices of degrees of freedom and of environments
    values   tensor [step, env, dof] on the device
    dofs     indices in the solver
    """

    control: Callable[..., None]
    values: Any
    dofs: NDArray[np.int64]

    def give(self, step: int, envs: Envs = None) -> None:
        """Give what one of the steps has."""
        self.control(self.values[step], self.dofs, envs_idx=envs)


class Environments(ABC):
    """N environments, built.

    scene   genesis.Scene
    solver  its rigid solver
    """

    def __init__(self, scene: Any) -> None:
        self.scene = scene
        self.solver = scene.rigid_solver

    @abstractmethod
    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """Layout of the arrays of `split`."""

    @abstractmethod
    def parts(self) -> Mapping[str, tuple[int, ...]]:
        """What a state consists of on the device: shapes [env, ...] by name."""

    @abstractmethod
    def store(self, parts: Mapping[str, Any]) -> None:
        """Enqueue: copy the present state into tensors on the device; nothing waits for it."""

    @abstractmethod
    def split(self, parts: Mapping[str, NDArray[np.floating]]) -> States:
        """Stored parts [row, env, ...] of a range of environments as an array [row, env, item, width] for each field,
        which may share their memory."""

    @abstractmethod
    def place(self, envs: Envs = None) -> None:
        """Give environments that were just reset what Genesis does not know of the scene's first state."""

    @abstractmethod
    def give(self, states: States, envs: Envs) -> None:
        """Give environments that were just reset another state [env of envs, item, width], an array for each field."""

    @abstractmethod
    def drives(self, actions: NDArray[np.floating]) -> Sequence[Drive]:
        """What actions [step, env, action] make the solver do."""

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        return None

    def attachments(self) -> dict[str, tuple[str, bytes]]:
        """Files worth keeping, as of Description."""
        return {}

    def reset(self, envs: Envs = None) -> None:
        """Bring environments to the scene's first state."""
        self.scene.reset(envs_idx=envs)
        self.place(envs)


def index_of(numbers: NDArray[np.int64]) -> Any:
    """These numbers as an index of tensors on the device: a slice where they follow each other."""
    import genesis
    import torch

    first = int(numbers[0])
    if np.array_equal(numbers, np.arange(first, first + len(numbers))):
        return slice(first, first + len(numbers))
    return torch.as_tensor(numbers, device=genesis.device)


def on_device(values: NDArray[np.floating]) -> Any:
    """A tensor of these values in the engine's precision."""
    import genesis
    import torch

    return torch.as_tensor(values, dtype=genesis.tc_float, device=genesis.device)


def empty_scene(
    genesis: Any,
    gravity: tuple[float, float, float],
    dt: float,
    options: GenesisOptions,
    sizes: GenesisSizes,
    **more: Any,
) -> Any:
    """A genesis.Scene without entities on the initialised engine; `more` as of genesis.options.RigidOptions."""
    return genesis.Scene(
        sim_options=genesis.options.SimOptions(dt=dt, substeps=options.substeps, gravity=gravity),
        rigid_options=genesis.options.RigidOptions(**_rigid_options(genesis, options, sizes), **more),
        profiling_options=genesis.options.ProfilingOptions(show_FPS=False),
        show_viewer=False,
    )


def _rigid_options(genesis: Any, options: GenesisOptions, sizes: GenesisSizes) -> dict[str, Any]:
    chosen: dict[str, Any] = {
        "integrator": genesis.integrator[options.integrator],
        "constraint_solver": genesis.constraint_solver[options.solver],
        "iterations": options.iterations,
        "ls_iterations": options.ls_iterations,
        "noslip_iterations": options.noslip_iterations,
        "friction_cone": genesis.friction_cone[options.cone],
        "constraint_timeconst": options.constraint_timeconst,
        "use_gjk_collision": options.use_gjk_collision,
        "box_box_detection": options.box_box_detection,
        "enable_mujoco_compatibility": options.mujoco_compatibility,
        "enable_neutral_collision": True,  # the scene says which links never collide
        "max_collision_pairs": sizes.pairs,
        "max_contacts": sizes.contacts,
        "multiplier_collision_broad_phase": options.broad_phase_multiplier,
    }
    if options.tolerance:
        chosen["tolerance"] = options.tolerance
    if options.impratio:
        chosen["impratio"] = options.impratio
    if options.contact_resolution != "auto":
        chosen["contact_resolution"] = genesis.contact_resolution[options.contact_resolution]
    if options.broadphase != "auto":
        chosen["broadphase_traversal"] = genesis.broadphase_traversal[options.broadphase]
    return chosen


@dataclass(frozen=True)
class GenesisSizes:
    """Room in one environment.

    pairs        colliding pairs of shapes
    contacts     contact points that the solver takes
    pairs_by     how `pairs` came about, in words
    contacts_by  how `contacts` came about, in words
    """

    pairs: int
    contacts: int
    pairs_by: str
    contacts_by: str


def choose_sizes(compiled: MjcfModel, *, dt: float, seed: int, options: GenesisOptions) -> GenesisSizes:
    """Room for what MuJoCo C needs of the same scene, and a margin; options that ask for a size get it.

    Pairs are those whose bounding spheres overlap, which are more than those that touch.
    """
    need = measure(compiled, dt=dt, seed=seed)
    of_contacts = replace(need, margin=max(_MARGIN, need.margin))
    return GenesisSizes(
        pairs=options.max_collision_pairs or need.size(need.pairs),
        contacts=options.max_contacts or of_contacts.size(need.contacts),
        pairs_by="asked for" if options.max_collision_pairs else need.sized_by(need.pairs),
        contacts_by="asked for" if options.max_contacts else of_contacts.sized_by(need.contacts),
    )
