"""Recordings of a model file by several engines, made by gsb-record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.compute.recorder import about, as_path, record
from gpusimbench.evaluator.imports.audit import REFERENCE, Audit, audited, refused
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verified
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.errors import GsbError, UsageError
from gpusimbench.schemas.imported import IMPORTED
from gpusimbench.schemas.location import place


@dataclass(frozen=True)
class ModelRuns:
    """What engines make of a model file.

    seed  of what is drawn: poses, and the joints and actuators that are moved
    out   folder of the recordings
    """

    model: Path
    seed: int
    out: Path

    def audited(self, engines: Sequence[str], options: Sequence[str]) -> tuple[Audit, ...]:
        """Record the model with MuJoCo C and with each engine, and compare them; options are of all engines.

        UsageError for an engine that there is not, or a model that MuJoCo C refuses; GsbError where a run ends
        without its recording.
        """
        for name in engines:
            about(name)  # wrong usage where there is none
        reference = self._recording(REFERENCE, [])
        if isinstance(reference, str):
            raise UsageError(reference)
        if reference.attachment(IMPORTED) is None:
            why = f"{reference.status}: {reference.reason} ({reference.path})"
            raise GsbError(f"{REFERENCE} could not be recorded: {why}")
        audits: list[Audit] = []
        for name in each(engines, "recording what engines make of the model"):
            recording = self._recording(name, options)
            if isinstance(recording, str):
                audits.append(refused(name, options, recording))
            else:
                audits += audited([reference, recording])
        return tuple(audits)

    def _recording(self, simulator: str, options: Sequence[str]) -> Recording | str:
        """The recording of an engine, or why it takes no such model."""
        given = ["--sim", simulator, "--model", as_path(self.model), "--phases", "import", "--runs", "1"]
        given += ["--n-env", "1", *(f"--option={option}" for option in options)]
        given += ["--seed", str(self.seed), "--compression", "zstd", "--out", str(self.out)]
        made, refusal = record(given, lambda text: None)
        if refusal:
            return refusal
        (run,) = made
        if run.file is None or run.status == "stopped":
            raise GsbError(f"{simulator} could not be recorded: {run.status}: {run.reason}")
        (recording,) = verified([place(str(run.file))])
        return recording
