"""What gsb-record needs of the engine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ballistic.engine import World
from gpusimbench.recorder.abilities import BODIES, Ability
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.evidence import CONTACTS, Evidence
from gpusimbench.schemas.fields import BODY_FIELDS, body_field
from gpusimbench.schemas.provenance import Deviation


@dataclass(frozen=True)
class Options:
    """Options of ballistic; --option substeps=80."""

    substeps: int = 40

    def __post_init__(self) -> None:
        if self.substeps < 1:
            raise ValueError("substeps is 1 or more")


class Ballistic(Simulator):
    """N environments in one set of arrays."""

    Options = Options
    abilities = BODIES - {Ability.CAPSULES}

    def build(self) -> Description:
        """See Simulator.build."""
        self.world = World(self.scene, self.n_env)
        self.counts = np.zeros((1, self.n_env), dtype=np.int64)
        groups = self.scene.groups()
        places = {body.name: index for index, body in enumerate(self.scene.moving())}
        self.rows = [[places[name] for name in names] for names in groups.values()]
        return Description(
            version="1.0",
            device="cpu",
            options={"substeps": self.options.substeps},
            switches={"precision": "float64"},
            deviations=_deviations(self.scene),
            fields=tuple(
                body_field(g, field, "float64", names) for g, names in groups.items() for field in BODY_FIELDS
            ),
            timing_covers="numpy on all environments",
            counters=(CONTACTS,),
        )

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        for _ in range(n_step):
            self.world.step(self.dt, self.options.substeps)
        self.counts = self.world.contacts[None]

    def state(self) -> States:
        """See Simulator.state."""
        arrays = (self.world.position, self.world.orientation, self.world.velocity, self.world.spin)
        return tuple(array[:, rows] for rows in self.rows for array in arrays)

    def states(self, n_step: int) -> States:
        """See Simulator.states; counts are kept as well."""
        found, counts = [], []
        for _ in range(n_step):
            self.step(1)
            found.append(self.state())
            counts.append(self.counts)
        self.counts = np.concatenate(counts)
        return tuple(np.stack(column) for column in zip(*found, strict=True))

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""
        return Evidence({CONTACTS.name: self.counts})


def _deviations(scene: Scene) -> tuple[Deviation, ...]:
    found = [
        Deviation("contact", "between all bodies", "corners and spheres with faces", "edges meet no edges"),
        Deviation("contact.friction_combination", "not given", "the mean of the two", "as restitution"),
    ]
    for name, material in {body.material.name: body.material for body in scene.bodies}.items():
        wanted, used = str(material.static_friction), str(material.kinetic_friction)
        found.append(
            Deviation(f"{name}.static_friction", wanted, used, "one coefficient, and slip below it is viscous")
        )
    return tuple(found)
