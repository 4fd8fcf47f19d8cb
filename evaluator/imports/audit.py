"""Recordings of a model file by several engines, each compared with that of MuJoCo C; made by gsb-record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusimbench.evaluator.compute.recorder import about, as_path, record
from gpusimbench.evaluator.imports.motion import Items, Poses, Responses, poses, responses
from gpusimbench.evaluator.imports.parameters import ComparedKind, ParameterDifference, compare
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verified
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.errors import GsbError, NothingComparable, UsageError, damage_in
from gpusimbench.schemas.imported import DROP, IMPORTED, TRIALS, Drop, Imported, Trials
from gpusimbench.schemas.location import Place, place
from gpusimbench.schemas.provenance import engine_name

WINDOW_S = 0.1
"""Over which the force is averaged, at the end of the drop [s]."""

REFERENCE = "mujoco"
"""The simulator whose compiled model is the reference."""


@dataclass(frozen=True)
class Landing:
    """What came of a drop.

    time     of the first recorded step at which a shape reaches into one that does not move [s]; Missing without any
    height   of the centre of mass then [m]
    carried  share of the weight that the ground carries, on average over the last WINDOW_S of the drop
    """

    time: float | Missing
    height: float | Missing
    carried: float | Missing


@dataclass(frozen=True)
class Landings:
    """Of MuJoCo C and of an engine, from the same state, both without controls and for the same time.

    duration  of the drop [s]
    """

    duration: float
    reference: Landing
    engine: Landing


def landings(reference: Drop, engine: Drop) -> Landings | Missing:
    """Both landings; Missing where the drops have other times."""
    if len(reference.time) != len(engine.time) or not np.allclose(reference.time, engine.time):
        return Missing("the drops have other time steps")
    return Landings(float(reference.time[-1]), _landing(reference), _landing(engine))


def _landing(drop: Drop) -> Landing:
    # the momentum changes by what carries the model, less its weight
    last = len(drop.time) - 1
    first = int(np.searchsorted(drop.time, drop.time[-1] - WINDOW_S - 1e-9))
    gained = (drop.momentum[last] - drop.momentum[first]) / (drop.time[last] - drop.time[first])
    share = float(1 + gained / drop.weight)
    carried = share if np.isfinite(share) else Missing("states are not finite")
    touching = np.flatnonzero(drop.contact)
    if not touching.size:
        none = Missing("nothing touches the ground")
        return Landing(none, none, carried)
    return Landing(float(drop.time[touching[0]]), float(drop.height[touching[0]]), carried)


@dataclass(frozen=True)
class Audit:
    """What an engine made of a model file.

    simulator, version, device, options  of the run
    model      the model's own file
    same_file  whether the reference has the same files, to the byte
    file       of the recording; None where none was made
    missing    why there is nothing to compare: the engine does not take the model; empty where it does
    kinds      parameters, by kind of things
    poses      the engine's kinematics
    responses  the engine's dynamics
    landings   how the model comes to the ground, which is no part of the verdict
    """

    simulator: str
    version: str
    device: str
    options: tuple[str, ...]
    model: str
    same_file: bool
    file: Place | None
    missing: str
    kinds: tuple[ComparedKind, ...]
    poses: Poses | Missing
    responses: Responses | Missing
    landings: Landings | Missing

    @property
    def findings(self) -> tuple[ParameterDifference, ...]:
        """All differences of parameters."""
        return tuple(finding for kind in self.kinds for finding in kind.findings)

    @property
    def agrees(self) -> bool:
        """Whether nothing differs, is missing, or is refused; what could not be compared aside."""
        moved = [part.wrong for part in (self.poses, self.responses) if not isinstance(part, Missing)]
        return not self.missing and not self.findings and not any(moved)


def refused(simulator: str, options: Sequence[str], why: str) -> Audit:
    """The audit of an engine that does not take the model."""
    none = Missing("the model was refused")
    return Audit(simulator, "", "", tuple(options), "", True, None, why, (), none, none, none)


def audited(recordings: Sequence[Recording]) -> tuple[Audit, ...]:
    """Each recording of a model that is not of MuJoCo C, compared with MuJoCo C's of the same files; where there is
    none, and one of other files alone, with that.

    NothingComparable where there is no recording to be compared, or nothing to compare with.
    """
    of_models = [recording for recording in recordings if recording.configuration.model]
    references = [r for r in of_models if r.configuration.simulator == REFERENCE and r.attachment(IMPORTED) is not None]
    others = [r for r in of_models if r.configuration.simulator != REFERENCE]
    if not others:
        raise NothingComparable("these recordings hold no model file on another simulator than MuJoCo C")
    if not references:
        raise NothingComparable(
            "there is no recording of MuJoCo C to compare with: gsb-record --sim mujoco --model FILE.xml "
            "--phases import"
        )
    return tuple(_audit(other, _reference_of(other, references)) for other in others)


def _reference_of(recording: Recording, references: Sequence[Recording]) -> Recording:
    same = [r for r in references if r.configuration.model == recording.configuration.model]
    files = {r.configuration.model for r in references}
    if not same and len(files) > 1:
        raise NothingComparable(f"{recording.path} has other model files than any recording of MuJoCo C")
    # one that was tried, if there is any; of several, the latest
    return max(same or references, key=lambda r: (r.attachment(TRIALS) is not None, r.provenance.created_utc))


def _audit(recording: Recording, reference: Recording) -> Audit:
    c, simulation = recording.configuration, recording.simulation
    held = recording.attachment(IMPORTED)
    if held is None:
        why = recording.reason or "the recording does not say what the engine holds of the model"
        if recording.status == "complete":
            raise NothingComparable(f"{recording.path}: {why}")
        return refused(c.simulator, c.option_words, why)
    ours = reference.attachment(IMPORTED)
    assert ours is not None
    with damage_in(f"{recording.path} or {reference.path}"):
        kinds = compare(Imported.decoded(ours), Imported.decoded(held))
        moved: tuple[Poses | Missing, Responses | Missing] = _moved(recording, reference)
        landed = _landed(recording, reference)
    return Audit(
        simulator=engine_name(c.simulator, simulation),
        version=simulation.version if simulation else "",
        device=simulation.device if simulation else "",
        options=tuple(c.option_words),
        model=str(recording.scene.get("file", c.scene)),
        same_file=c.model == reference.configuration.model,
        file=recording.path,
        missing="",
        kinds=kinds,
        poses=moved[0],
        responses=moved[1],
        landings=landed,
    )


def _moved(recording: Recording, reference: Recording) -> tuple[Poses | Missing, Responses | Missing]:
    data = [one.attachment(TRIALS) for one in (reference, recording)]
    for one, found in zip((reference, recording), data, strict=True):
        if found is None:
            said = f": {one.reason}" if one.reason else "; --phases import records it"
            why = Missing(f"{one.configuration.simulator} was not tried{said}")
            return why, why
    ours, theirs = (Trials.decoded(found) for found in data if found is not None)
    items = _items(reference), _items(recording)
    return poses(ours, theirs, items), responses(ours, theirs, items)


def _landed(recording: Recording, reference: Recording) -> Landings | Missing:
    ours, theirs = (one.attachment(DROP) for one in (reference, recording))
    if ours is None or theirs is None:
        return Missing("there is no drop: --phases import records it of a model with a free body")
    return landings(Drop.decoded(ours), Drop.decoded(theirs))


def _items(recording: Recording) -> Items:
    return {field.name: field.items for field in recording.fields}


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
