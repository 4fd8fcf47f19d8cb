"""Replays: made by gsb-record in a process of its own, and each beside the original that it is closest to: what was the
same, and what of the original was not looked at."""

from __future__ import annotations

import math
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gpusimbench.evaluator.audit.verdict import Match
from gpusimbench.evaluator.compute.recorder import COMMAND, Made, ProgramRun, as_path, record, run_program
from gpusimbench.evaluator.diff.result import Basis, Difference, Setting
from gpusimbench.evaluator.diff.settings import is_other_package
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import RecordingError, UsageError
from gpusimbench.schemas.text import first, plural

_PHASES = ("capture", "timed")
_MOST_NAMED = 3
_FREE = ("compression", "timeout")  # a replay's own; they decide no number

# A file says how long its run took, and its options may ask for any amount of work: neither is to be trusted.
_LEAST_S, _MOST_S, _LONGER = 600, 86_400, 20


def match_of(found: Difference, original: Recording, replay: Recording) -> Match:
    """What a comparison of an original (its side a) with a replay came to."""
    steps = found.compared.state_steps
    return Match(
        bit_identical=found.bit_identical,
        same_up_to_env_order=False if found.other_program else found.same_up_to_env_order,
        max_ulp=found.max_ulp,
        steps=steps.count if steps else 0,
        left_out=_listed(list(_left_out(found, original, replay))),
        signs_differ=found.signs_differ,
        no_ulps=_listed(list(_no_ulps(found))),
    )


def compared(found: Difference) -> str:
    """What is the same where a replay is bit-identical."""
    c = found.compared
    if c.state_steps:
        return "every bit"
    if c.hash_phase == "timed" and c.hash_steps:
        return f"the {c.hash_steps.count} state hashes of the timed phase"
    return "every state hash (no states were recorded)"


def _left_out(found: Difference, original: Recording, replay: Recording) -> Iterator[str]:
    c, asked = found.compared, original.configuration
    missing = [phase for phase in asked.phases if phase not in replay.configuration.phases]
    yield from (f"the {phase} phase" for phase in missing)
    yield from c.left_out
    if c.n_env < asked.n_env:
        yield f"{asked.n_env - c.n_env} of {plural(asked.n_env, 'environment')}"
    states = c.state_steps.count if c.state_steps else 0
    recorded = max((len(original.state(f.group, f.field).steps) for f in original.fields), default=0)
    if recorded > states and "capture" not in missing:
        yield f"{recorded - states} of {recorded} recorded states"
    looked_at = {"capture": states, "timed": c.timed_steps.count if c.timed_steps else 0}
    if c.hash_steps:
        looked_at[c.hash_phase] = max(looked_at[c.hash_phase], c.hash_steps.count)
    for phase in _PHASES:
        hashes = original.fingerprints(phase)
        rows = 0 if hashes is None else len(hashes.steps)
        if rows > looked_at[phase] and phase not in missing:
            why = f" ({c.hash_steps_missing})" if c.hash_steps_missing else ""
            yield f"state hashes of {rows - looked_at[phase]} of {plural(rows, 'step')} of the {phase} phase{why}"


def _no_ulps(found: Difference) -> Iterator[str]:
    c = found.compared
    others = [field.field for field in c.fields if field.basis is not Basis.BITS]
    if others:
        yield f"{_listed(others)} cannot be compared by bits"
    if c.unseen_steps:
        yield f"state hashes differ at {plural(c.unseen_steps, 'step')} of which no state was recorded"
    if found.other_program:
        yield "arrays of the program were compared by hashes alone"


def _listed(parts: Sequence[str]) -> str:
    return "; ".join(first(parts, _MOST_NAMED))


def trajectories(recordings: Sequence[Recording]) -> list[list[bytes]]:
    """State hashes of each environment of each recording, step after step, of the phases that all have hashes of, as
    far as all go."""
    found = [[recording.fingerprints(phase) for recording in recordings] for phase in _PHASES]
    whole = [[h.hashes for h in phase if h is not None] for phase in found if None not in phase]
    common = [[hashes[: min(map(len, phase))] for hashes in phase] for phase in whole]
    return [
        [b"".join(columns) for columns in zip(*(_columns(phase[i]) for phase in common), strict=True)]
        for i in range(len(recordings))
    ]


def _columns(hashes: np.ndarray[tuple[int, ...], np.dtype[np.uint64]]) -> list[bytes]:
    return [column.tobytes() for column in np.ascontiguousarray(hashes.T)]


def closest(replay: Recording, originals: Sequence[Recording]) -> Recording:
    """The original with the replay's state hashes; else with those of its environments in any order; else the first."""
    pairs = [trajectories([original, replay]) for original in originals]
    for original, (theirs, ours) in zip(originals, pairs, strict=True):
        if theirs and theirs == ours:
            return original
    for original, (theirs, ours) in zip(originals, pairs, strict=True):
        if theirs and sorted(theirs) == sorted(ours):
            return original
    return originals[0]


def distinct(originals: Sequence[Recording], replays: Sequence[Recording]) -> tuple[int, int, int] | None:
    """How many recordings are distinct by their state hashes: of the originals, of the replays, and of both.

    None where they have no state hashes of the same phase.
    """
    found = [b"".join(envs) for envs in trajectories([*originals, *replays])]
    if not all(found):
        return None
    there, here = set(found[: len(originals)]), set(found[len(originals) :])
    return len(there), len(here), len(there | here)


def unreproduced(originals: Sequence[Recording], replays: Sequence[Recording]) -> str:
    """Originals whose states no replay gave, in a sentence; empty where there are none."""
    found = trajectories([*originals, *replays])
    if not all(found):
        return "of several originals, it is not known which were replayed: not all have state hashes"
    made = found[len(originals) :]
    left = [o.path.name for o, states in zip(originals, found, strict=False) if states not in made]
    return f"of several originals, no replay gave the states of {_listed(left)}" if left else ""


@dataclass(frozen=True)
class DifferingSettings:
    """Differing settings.

    deciding  those that can explain other numbers
    packages  how many other installed packages differ: those that no recorder lists among what computes
    """

    deciding: tuple[Setting, ...] = ()
    packages: int = 0


def sorted_out(differing: tuple[Setting, ...], original: Recording, replay: Recording) -> DifferingSettings:
    """Those of the differing settings of two recordings that can explain other numbers."""
    others = [setting for setting in differing if is_other_package(setting, original, replay)]
    return DifferingSettings(tuple(s for s in differing if s not in others and s.name not in _FREE), len(others))


@dataclass(frozen=True)
class ReplayPlan:
    """How replays are made, as of gsb-record's arguments.

    out      folder of their recordings
    runs     how many
    python   interpreter that makes them; None: whichever gsb-record chooses
    timeout  of each [s]; 0: none; None: by what the original took, see `within`
    options  NAME=VALUE, instead of what was recorded
    phases   comma separated; None: those that were recorded
    models   whether the model files that recordings carry may be loaded
    command  the user's program that made the recording, as a shell takes it, {seed} for the recorded seed; it is run
             instead of gsb-record; None: gsb-record is
    """

    out: Path
    runs: int = 1
    python: Path | None = None
    timeout: float | None = None
    options: tuple[str, ...] = ()
    phases: str | None = None
    models: bool = False
    command: str | None = None

    def within(self, ran: float) -> ReplayPlan:
        """The same with a time limit: 20 times what the original took [s], at least ten minutes, at most a day.

        The user's own program has none, since no file decides what it does.
        """
        if self.timeout is not None or self.command is not None:
            return self
        return replace(self, timeout=float(min(max(_LEAST_S, math.ceil(_LONGER * ran)), _MOST_S)))

    def arguments(self, recording: Path) -> list[str]:
        """Arguments of gsb-record that replay a recording."""
        given = ["--replay", as_path(recording), "--runs", str(self.runs), "--out", as_path(self.out)]
        if self.python is not None:
            given += ["--python", as_path(self.python)]
        if self.timeout:
            given += ["--timeout", f"{self.timeout:g}"]
        if self.phases is not None:
            given.append(f"--phases={self.phases}")
        if self.models:
            given.append("--allow-model")
        given += [f"--option={option}" for option in self.options]
        return given

    def program(self, seed: int) -> list[str]:
        """Words of the user's command. UsageError where a shell would not take it."""
        assert self.command is not None
        try:
            words = shlex.split(self.command)
        except ValueError as error:
            raise UsageError(f"--command '{self.command}' is no command: {error}") from None
        if not words:
            raise UsageError(
                "--command is the program and its arguments as one quoted argument, such as 'python train.py'"
            )
        return [word.replace("{seed}", str(seed)) for word in words]


@dataclass(frozen=True)
class Replays:
    """What became of a recording's replays.

    command  as a user would type it
    made     those that were begun
    refused  why none was; empty where at least one was
    seconds  from the start of the first to the end of the last [s]
    """

    command: str
    made: tuple[Made, ...]
    refused: str
    seconds: float = 0.0


def make_replays(original: Recording, path: Path, plan: ReplayPlan, say: Callable[[str], None]) -> Replays:
    """Run gsb-record, or the user's program, and wait for its end; what is said on the way goes to `say`, by line.

    path  of the original

    Raises as `record`.
    """
    begun = time.monotonic()
    if plan.command is not None:
        words = plan.program(original.configuration.seed)
        runs = run_program(words, plan.runs, plan.out, plan.timeout or 0, say)
        took = time.monotonic() - begun
        return Replays(shlex.join(words), tuple(_recording_beside(run, original, path.name) for run in runs), "", took)
    given = plan.arguments(path)
    made, refused = record(given, say)
    return Replays(shlex.join([COMMAND, *given]), made, refused, time.monotonic() - begun)


def _recording_beside(run: ProgramRun, original: Recording, name: str) -> Made:
    """Of a program's run the recording that belongs beside the original: that of its name, or the only one alike."""
    if run.status != "ended":
        return Made("stopped" if run.status == "timeout" else "failed", f"the program {run.reason}", None)
    found, reasons = [], []
    for path in run.recordings:
        try:
            recording = Recording(path)
        except RecordingError as error:
            reasons.append(str(error))
            continue
        if _alike(recording, original):
            found.append(recording)
    named = [recording for recording in found if recording.path.name == name] or found
    if len(named) != 1:
        wrote = f"the program wrote {len(run.recordings)} recordings into {run.folder}, of which {len(found)} have the"
        why = f"{wrote} simulator, scene, environments and steps of the original"
        return Made("failed", "; ".join([why, *reasons]), None)
    return Made(named[0].status, named[0].reason, Path(str(named[0].path)))


def _alike(a: Recording, b: Recording) -> bool:
    one, other = a.configuration, b.configuration
    return all(getattr(one, of) == getattr(other, of) for of in ("simulator", "scene", "n_env", "dt", "steps"))
