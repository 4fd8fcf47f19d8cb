"""One run that is to be made, as data, and how it is made: here, or on a machine that was sent the data."""

from __future__ import annotations

import uuid
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from gpusimbench.recorder.environments.interpreter import Interpreter
from gpusimbench.recorder.plan import reserve, utc_now
from gpusimbench.recorder.process.cage import Cage
from gpusimbench.recorder.process.launch import Interruptions, Progress, Result, launch
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.provenance import ReplayOf


@dataclass(frozen=True)
class Task:
    """A run to be made.

    argv        the user's command
    replay_of   the recording that it is a replay of
    end_killed  where it has to be killed after its timeout, write a recording that says so
    cage        what it may take of the machine; None: anything
    inputs      files that it is given, by the names that its recording attaches them under
    run_id      unique (UUID4)
    created     UTC, ISO 8601; now where nothing else is said
    """

    configuration: RunConfiguration
    argv: tuple[str, ...]
    replay_of: ReplayOf | None = None
    end_killed: bool = False
    cage: Cage | None = None
    inputs: Mapping[str, bytes] = field(default_factory=dict)
    run_id: str = field(default_factory=lambda: str(uuid.uuid4()))
    created: str = field(default_factory=utc_now)

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        of = asdict(self.replay_of) if self.replay_of else None
        inputs = {name: b64encode(data).decode() for name, data in self.inputs.items()}
        return {
            **asdict(self), "configuration": self.configuration.to_json(), "argv": list(self.argv), "replay_of": of,
            "inputs": inputs,
        }  # fmt: skip

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> Task:
        """From what to_json gave."""
        of = record["replay_of"]
        return cls(
            RunConfiguration.from_json(record["configuration"]),
            tuple(record["argv"]),
            ReplayOf.from_json(of) if of else None,
            record["end_killed"],
            Cage(**record["cage"]) if record["cage"] else None,
            {name: b64decode(data) for name, data in record["inputs"].items()},
            record["run_id"],
            record["created"],
        )


def make(
    task: Task, folder: Path, interpreter: Interpreter, progress: Progress, interruptions: Interruptions
) -> Result:
    """Make the run in a fresh process, its recording in `folder`. GsbError where that cannot be begun."""
    run = task.configuration
    result = launch(
        run,
        reserve(folder, run, task.created),
        run_id=task.run_id,
        created=task.created,
        argv=task.argv,
        interpreter=interpreter,
        progress=progress,
        interruptions=interruptions,
        replay_of=task.replay_of,
        cage=task.cage,
        inputs=task.inputs,
    )
    if not (task.end_killed and result.died and result.cause == "TIMEOUT") or interruptions.count:
        return result

    from gpusimbench.recorder.process.killed import record_killed

    path = record_killed(
        folder, run, result.path, run_id=task.run_id, created=task.created, argv=task.argv,
        interpreter=interpreter, reason=result.reason,
    )  # fmt: skip
    return replace(result, status="failed", path=path, exit_code=ExitCode.FAILURE)
