"""One run that is to be made, as data, which can be sent to the machine that makes it."""

from __future__ import annotations

import uuid
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from gpusimbench.recorder.plan import utc_now
from gpusimbench.recorder.process.cage import Cage
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.provenance import Provenance, ReplayOf


@dataclass(frozen=True)
class PlannedRun:
    """A run to be made.

    provenance  what is known of it already: its id, the time, the user's command, the configuration, and the recording
                that it is a replay of
    end_killed  where it has to be killed after its timeout, write a recording that says so
    cage        what it may take of the machine; None: anything
    inputs      files that it is given, by name
    """

    provenance: Provenance
    end_killed: bool = False
    cage: Cage | None = None
    inputs: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def configuration(self) -> RunConfiguration:
        """The configuration that is asked of the run."""
        return self.provenance.configuration

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "provenance": self.provenance.to_json(),
            "end_killed": self.end_killed,
            "cage": asdict(self.cage) if self.cage else None,
            "inputs": {name: b64encode(data).decode() for name, data in self.inputs.items()},
        }

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> PlannedRun:
        """The run of what to_json gave."""
        return cls(
            Provenance.from_json(record["provenance"]),
            record["end_killed"],
            Cage(**record["cage"]) if record["cage"] else None,
            {name: b64decode(data) for name, data in record["inputs"].items()},
        )


def provenance_now(
    configuration: RunConfiguration, argv: tuple[str, ...], replay_of: ReplayOf | None = None
) -> Provenance:
    """The provenance of a run that is to be made now, before its machine is known."""
    return Provenance(str(uuid.uuid4()), utc_now(), argv, configuration, replay_of=replay_of)
