"""How much room Genesis' contact buffers get: counted on MuJoCo C, which Genesis brings along."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gpusimbench.recorder.simulators.buffer_sizes import measure
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel

_MARGIN = 2.0  # over MuJoCo's contact points: Genesis has most while bodies that just touch settle into each other


@dataclass(frozen=True)
class Sizes:
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


def choose_sizes(compiled: MjcfModel, *, dt: float, seed: int, options: GenesisOptions) -> Sizes:
    """Room for what MuJoCo C needs of the same scene, and a margin; options that ask for a size get it.

    Pairs are those whose bounding spheres overlap, which are more than those that touch.
    """
    need = measure(compiled, dt=dt, seed=seed)
    of_contacts = replace(need, margin=max(_MARGIN, need.margin))
    return Sizes(
        pairs=options.max_collision_pairs or need.size(need.pairs),
        contacts=options.max_contacts or of_contacts.size(need.contacts),
        pairs_by="asked for" if options.max_collision_pairs else need.sized_by(need.pairs),
        contacts_by="asked for" if options.max_contacts else of_contacts.sized_by(need.contacts),
    )
