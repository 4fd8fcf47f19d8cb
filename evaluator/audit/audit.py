"""An audit of recordings that were asked for the same: which of them can be trusted, run again here, and held against
each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.audit.distribution import LawTest, same_law
from gpusimbench.evaluator.audit.replays import (
    DifferingSettings,
    ReplayPlan,
    Replays,
    closest,
    compared,
    distinct,
    make_replays,
    match_of,
    sorted_out,
    unreproduced,
)
from gpusimbench.evaluator.audit.verdict import AuditLevel, AuditVerdict, ladder
from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.rules.findings import Unchecked, check
from gpusimbench.evaluator.check.rules.rule import Severity, load_rules
from gpusimbench.evaluator.compute.recorder import Made
from gpusimbench.evaluator.diff.compare import compare
from gpusimbench.evaluator.diff.result import Difference
from gpusimbench.evaluator.metrics.variability import sampling_step
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.groups import Group
from gpusimbench.evaluator.runs.positions import OutcomeArray, outcome_of, sample_positions
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.commands.progress import each, sizes
from gpusimbench.schemas.errors import DamagedRecording, NothingComparable, UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Location, Place
from gpusimbench.schemas.provenance import REAL

RULES = "integrity-1"


class Outcome(Enum):
    """What became of an audit's replays."""

    MADE = "made"
    NOT_TRIED = "not tried"  # nothing of the recordings can be replayed anywhere
    REFUSED = "refused"  # not begun
    STOPPED = "stopped"  # one took more of this machine than a replay may
    FAILED = "failed"  # none came to an end for another reason


@dataclass(frozen=True)
class Audit:
    """What became of one set of recordings.

    originals    the recordings, of one key; the first is the one that was replayed
    replays      None where there is nothing to replay
    recordings   of the replays that are complete
    difference   the first original beside the first of these, or beside the one that it was found to be closest to
    settings     what those two say of themselves and disagree on
    distinct     how many are distinct bit for bit, by their state hashes: of the originals, the replays, and of both;
                 None where they have none
    verdict      None, and `why_not` says why
    """

    originals: tuple[Recording, ...]
    replays: Replays | None = None
    recordings: tuple[Recording, ...] = ()
    difference: Difference | None = None
    settings: DifferingSettings = DifferingSettings()
    distinct: tuple[int, int, int] | None = None
    verdict: AuditVerdict | None = None
    why_not: str = ""

    @property
    def failed(self) -> tuple[Made, ...]:
        """Replays that ended otherwise than complete."""
        return tuple(r for r in self.replays.made if r.status != "complete") if self.replays else ()

    @property
    def outcome(self) -> Outcome:
        """What became of the replays, whatever the verdict is."""
        if self.replays is None:
            return Outcome.NOT_TRIED
        if self.replays.refused:
            return Outcome.REFUSED
        if any(replay.status == "stopped" for replay in self.replays.made):
            return Outcome.STOPPED
        return Outcome.MADE if self.recordings else Outcome.FAILED

    @property
    def level(self) -> AuditLevel | None:
        """The verdict's level; a replay that is invalid where the original is not makes it `different`."""
        if self.invalid:
            return AuditLevel.DIFFERENT
        return self.verdict.level if self.verdict else None

    @property
    def invalid(self) -> bool:
        """Whether a replay tripped a validity gate that the original did not."""
        return any(replay.status == "invalid" for replay in self.failed)

    def meets(self, required: AuditLevel) -> bool | None:
        """Whether the required level holds, or a stronger one; None where that could not be decided."""
        if self.invalid:
            return False
        return self.verdict.meets(required) if self.verdict else None


def audit(group: Group[Recording], plan: ReplayPlan, *, max_ulps: int, say: Callable[[str], None]) -> Audit:
    """Replay the first complete recording of a group, and hold what came out against all complete ones.

    max_ulps  largest distance in units in the last place that counts as "within"
    say       takes what the replays say on the way

    GsbError where the replays cannot be started or what they wrote cannot be read.
    """
    originals = group.complete
    if group.key.simulator == REAL:
        return Audit(group.recordings, why_not="measured trials: no simulator can replay them")
    if not originals:
        ended = " ".join(f"{count} {status}" for status, count in group.outcomes.items() if count)
        return Audit(
            group.recordings, why_not=f"no run is complete ({ended}): there is nothing to compare a replay with"
        )
    asked = originals[0].path
    if isinstance(asked, Location):
        raise UsageError(f"{asked} is not on this machine: download it to replay it")
    replays = make_replays(originals[0], asked, plan.within(_ran(originals[0])), say)
    done = Audit(originals, replays)
    if replays.refused:
        return Audit(originals, replays, why_not=replays.refused)
    found = tuple(_open(replay) for replay in replays.made if replay.status == "complete")
    if not found:
        reasons = dict.fromkeys(f"{replay.status}: {replay.reason}" for replay in done.failed)
        return Audit(originals, replays, why_not="; ".join(reasons) or "no replay was made")
    return judge_replays(originals, replays, found, max_ulps=max_ulps)


def judge_replays(
    originals: tuple[Recording, ...], replays: Replays, found: tuple[Recording, ...], *, max_ulps: int
) -> Audit:
    """What replays wrote, held against all originals; of the replays, one that differs is shown, where there is one.

    max_ulps  see `audit`
    """
    try:
        pairs = [(closest(replay, originals), replay) for replay in found]
        differences = [compare(original, replay) for original, replay in each(pairs, "comparing with replays")]
    except NothingComparable as error:
        return Audit(originals, replays, found, why_not=str(error))
    matches = [match_of(d, *pair) for d, pair in zip(differences, pairs, strict=True)]
    if len(originals) > 1 and (left := unreproduced(originals, found)):
        # a file beside honest ones is not shown to be one of them
        matches = [replace(m, left_out="; ".join(filter(None, (m.left_out, left)))) for m in matches]
    verdict = ladder(
        matches,
        lambda: law_of(originals, found),
        max_ulps=max_ulps,
        originals=len(originals),
        compared=compared(differences[0]),
        each_s=replays.seconds / len(found),
    )
    shown = next((i for i, d in enumerate(differences) if not d.bit_identical), 0)
    return Audit(
        originals=originals,
        replays=replays,
        recordings=found,
        difference=differences[shown],
        settings=sorted_out(differences[shown].settings, *pairs[shown]),
        distinct=distinct(originals, found),
        verdict=verdict,
    )


def _ran(recording: Recording) -> float:
    # from its first event to its last [s]
    clocks = [event.monotonic_ns for event in recording.events]
    return (max(clocks) - min(clocks)) / 1e9 if clocks else 0.0


def _open(replay: Made) -> Recording:
    if replay.file is None:
        raise DamagedRecording("a replay that is complete has left no file")
    recording = Recording(replay.file)
    verify(recording)
    return recording


def law_of(originals: Sequence[Recording], replays: Sequence[Recording]) -> LawTest | str:
    """The test of one law over planar positions of the outcome's bodies at the sample time, or why there is none."""
    outcome = outcome_of(originals[0])
    if isinstance(outcome, Missing):
        return outcome.reason
    time = _sample_time(originals[0], outcome)
    if time is None:
        return "no positions were captured, and the test needs them"
    sides: list[list[npt.NDArray[np.float64]]] = []
    for side in (originals, replays):
        sides.append([])
        for recording in side:
            positions = sample_positions(recording, time)
            if isinstance(positions, Missing):
                return f"{recording.path.name}: {positions.reason}"
            sides[-1].append(positions.planar)
    if len({run.shape for side in sides for run in side}) > 1:
        return "the replays have a different number of environments or bodies"
    try:
        return same_law(*sides, time=time)
    except ValueError as error:
        return str(error)


def _sample_time(recording: Recording, outcome: Sequence[StateField]) -> float | None:
    # the scene's own, where it was recorded; else the last recorded step's
    steps, dt = OutcomeArray(recording, outcome).steps, recording.configuration.dt
    if not len(steps):
        return None
    wanted = recording.scene.get("sample_time")
    if isinstance(wanted, (int, float)) and 0 < wanted < 1e9 and sampling_step(wanted, dt) in steps:
        return float(wanted)
    return float(steps[-1] * dt)


@dataclass(frozen=True)
class Check:
    """What became of checking files: findings by file, one sentence each.

    recordings  those that can be audited, each run once
    damaged     of each of the others; copies are named among the warnings of the file that is kept
    broken      broken rules of those that can be audited
    warnings    of those likewise
    """

    recordings: tuple[Recording, ...]
    damaged: dict[Place, tuple[str, ...]]
    broken: dict[Place, tuple[str, ...]]
    warnings: dict[Place, tuple[str, ...]]


def check_files(paths: Sequence[Place]) -> Check:
    """Hold files against the rules of RULES; those that are damaged or have lost data are set aside, and copies."""
    wanted = list(dict.fromkeys(paths))
    files = [examine(path) for path in each(wanted, "checking recordings", sizes(wanted))]
    report = check(files, [load_rules(RULES)])
    errors = [finding for finding in report.findings if finding.rule.level is Severity.error]
    found = [(path, f"{f.rule.id}: {f.found}") for f in errors if f.rule.damage for path in f.files]
    said = {path for path, _ in found}
    found += [(f.path, f.not_opened) for f in files if f.recording is None and f.path not in said]
    found += _unasked(report.unchecked, {path for path, _ in found})
    damaged = _by_file(found)
    whole = [f.recording for f in files if isinstance(f.recording, Recording) and f.path not in damaged]
    good, copies = _without_copies(whole)
    kept = {recording.path for recording in good}
    broken = [(path, f"{f.rule.id}: {f.found}") for f in errors for path in f.files if path in kept]
    warned = [f for f in report.findings if f.rule.level is Severity.warning]
    warnings = [(path, f"{f.rule.id}: {f.found}") for f in warned for path in f.files if path in kept]
    return Check(good, damaged, _by_file(broken), _by_file([*copies, *warnings]))


def _unasked(unchecked: Sequence[Unchecked], damaged: Set[Place]) -> list[tuple[Place, str]]:
    # of files that nothing else is known of, rules by what keeps them from being asked
    rules = gathered(
        ((u.file, u.reason), u.rule.id) for u in unchecked if u.rule.level is Severity.error and u.file not in damaged
    )
    return [(path, f"{', '.join(ids)} cannot be checked: {reason}") for (path, reason), ids in rules.items()]


def _without_copies(recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], list[tuple[Place, str]]]:
    # files of one run with different contents are damaged by RULES, and so are those without a content hash
    kept: dict[str, Recording] = {}
    copies = []
    for recording in recordings:
        first = kept.setdefault(recording.content_hash, recording)
        if first is not recording:
            copies.append((first.path, f"{recording.path} is a copy of {first.path.name}; it counts once"))
    return tuple(kept.values()), copies


def _by_file(findings: Sequence[tuple[Place, str]]) -> dict[Place, tuple[str, ...]]:
    return {path: tuple(dict.fromkeys(sentences)) for path, sentences in gathered(findings).items()}
