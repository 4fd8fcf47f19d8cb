"""What a program announces of its recording: checked before a file is made, attached once there is one."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gpusimbench.recorder.plan import check
from gpusimbench.recorder.probes.host import package_list
from gpusimbench.recorder.programs.folder import description
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.mcap.writer import COMPRESSIONS
from gpusimbench.schemas.provenance import (
    PACKAGES,
    PROGRAM,
    PROVENANCE,
    REAL,
    SCENE,
    SIMULATION,
    Provenance,
    Simulation,
)


@dataclass(frozen=True)
class Announced:
    """What a program announces of its recording.

    scene        a description; None where the program has a name alone
    attachments  the program's own: media type and bytes, by name
    open_end     whether the number of steps is known only when the recording ends
    """

    configuration: RunConfiguration
    simulation: Simulation
    scene: Scene | None
    attachments: Mapping[str, tuple[str, bytes]]
    open_end: bool

    def check(self) -> None:
        """UsageError for what cannot be recorded, in words of the arguments of `log.RecordingWriter`."""
        _check(self.configuration, self.simulation)
        if taken := sorted({PROVENANCE, PACKAGES, PROGRAM, SIMULATION, SCENE} & set(self.attachments)):
            raise UsageError(f"every recording has attachments named {', '.join(taken)}: choose other names")

    def attached(self, provenance: Provenance) -> dict[str, tuple[str, bytes]]:
        """All attachments of the recording: media type and bytes, by name."""
        found = {
            PROVENANCE: ("application/json", provenance.to_json().encode()),
            PACKAGES: ("text/plain", package_list().encode()),
            SIMULATION: ("application/json", self.simulation.to_json().encode()),
        }
        if self.scene:
            found[SCENE] = ("application/json", self.scene.to_json().encode())
        if program := description():
            found[PROGRAM] = ("application/json", program)
        return {**found, **self.attachments}


def _check(c: RunConfiguration, s: Simulation) -> None:
    check(c, named=lambda name: {"view_env": "view"}.get(name, name))
    for what, text in (
        ("simulator", c.simulator),
        ("version", s.version),
        ("scene", c.scene),
        ("device", s.device),
    ):
        if not text:
            raise UsageError(f"a recording needs the name of its {what}")
    if c.simulator == REAL:
        raise UsageError(f"'{REAL}' is the name of measured trials: gsb-record --sim {REAL} records them")
    if c.compression not in COMPRESSIONS:
        raise UsageError(f"compression is one of {', '.join(COMPRESSIONS)}, not '{c.compression}'")
    _check_fields(s.fields)
    if c.run_index < 0:
        raise UsageError(f"run_index is at least 0, not {c.run_index}")
    try:
        RunConfiguration.from_json(json.loads(json.dumps(c.to_json())))
        Simulation.from_json(s.to_json())
    except TypeError as error:  # such as numbers of numpy
        raise UsageError(f"options, switches and counts must be values of JSON: {error}") from None
    except DamagedRecording as error:
        raise UsageError(f"the recording could not be read again: {error}") from None
    if s.env_origins and len(s.env_origins) != c.n_env:
        raise UsageError(f"there are {len(s.env_origins)} env origins, and {c.n_env} environments")


def _check_fields(fields: Sequence[StateField]) -> None:
    if not fields:
        raise UsageError("a recording of states needs at least one field")
    if twice := [name for name, count in Counter(field.name for field in fields).items() if count > 1]:
        raise UsageError(f"two fields have the same group and name, {twice[0]}")
    for field in fields:
        if topics.parse_state(topics.state(field.group, field.field, 0)) is None:
            raise UsageError(
                f"a group and a field are named by small letters, digits and _, no group is named {topics.VIEW}: "
                f"not {field.group!r}, {field.field!r}"
            )
        if not field.items or not field.components:
            raise UsageError(f"{field.name} has no items or no components")
        if field.item_units and len(field.item_units) != len(field.items):
            raise UsageError(f"{field.name} has {len(field.item_units)} units, and {len(field.items)} items")
        if len(set(field.items)) < len(field.items):
            raise UsageError(f"two items of {field.name} have the same name")
