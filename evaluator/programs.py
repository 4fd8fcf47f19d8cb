"""gsb-run: recordings of several runs of one program, whether they are the same, and what is said of it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.compute.recorder import ProgramRun
from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.brief import brief, verdict_of
from gpusimbench.evaluator.diff.compare import compare
from gpusimbench.evaluator.diff.result import Difference, DiffVerdict
from gpusimbench.evaluator.diff.sections import remarks
from gpusimbench.evaluator.json_values import document_of, dump, values_of
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import Block, Cell, Document, Item, Items, Text, Tone, facts
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.errors import NothingComparable, RecordingError
from gpusimbench.schemas.text import few, plural

_HOW = " The program has to record: gpusimbench.wrap(envs, 'a.mcap'), or RecordingWriter, with a relative path."
_NAMES = 4
_MIB = 1 << 20


@dataclass(frozen=True)
class ComparedRun:
    """A recording of the first run beside that of the same name of another run.

    name         of the recording within the folder of a run
    run          number of the other run, from 1
    difference   a is of the first run; or why they cannot be compared
    """

    name: str
    run: int
    difference: Difference | Missing


@dataclass(frozen=True)
class Comparison:
    """What runs of one program came to.

    command    the program and its arguments
    runs       in order
    compared   by recording, then by run
    left_out   what could not be compared, a sentence each
    damaged    files named like recordings that are none, or not whole: a sentence each
    """

    command: tuple[str, ...]
    runs: tuple[ProgramRun, ...]
    compared: tuple[ComparedRun, ...]
    left_out: tuple[str, ...]
    damaged: tuple[str, ...]

    @property
    def verdict(self) -> DiffVerdict | None:
        """What all comparisons come to; None where there is none."""
        found = [one.difference.verdict for one in self.compared if one.difference]
        order = list(DiffVerdict)
        return order[max(map(order.index, found))] if found else None

    @property
    def failed(self) -> bool:
        """Whether a run did not end with exit code 0."""
        return any(run.status != "ended" for run in self.runs)

    @property
    def whole(self) -> bool:
        """Whether all recordings of all runs were compared, in all that they have."""
        differences = [one.difference for one in self.compared if one.difference]
        return not (self.left_out or self.damaged) and not any(d.compared.left_out or d.lost for d in differences)


def compare_runs(command: Sequence[str], runs: Sequence[ProgramRun]) -> Comparison:
    """Hold the recordings of the first run against those of the same names of all others.

    A file that is no recording, or not what it says, is left out, and named with its run.
    """
    found = [_by_name(run) for run in runs]
    damaged: list[str] = []
    names = sorted(set().union(*found))
    left_out = [
        f"{name}: written by run {', run '.join(str(i) for i in there)} of {plural(len(runs), 'run')}"
        for name in names
        if len(there := [i for i, run in enumerate(found) if name in run]) < len(runs)
    ]
    left_out += [
        f"{path}: the recording was not ended: close the environment or the writer"
        for run in runs
        for path in run.partial
    ]
    pairs = [
        (name, number, found[0][name], found[number][name])
        for name in names
        for number in range(1, len(runs))
        if name in found[0] and name in found[number]
    ]
    compared: list[ComparedRun] = []
    first, known = None, ""
    for name, number, a, b in each(pairs, "comparing runs"):
        if known != name:
            first, known = _verified(a, 0, damaged), name
        other = _verified(b, number, damaged)
        if first is not None and other is not None:
            compared.append(_compared(name, number, first, other))
    left_out += [
        f"{one.name} of run {one.run}: {one.difference.reason}"
        for one in compared
        if isinstance(one.difference, Missing)
    ]
    return Comparison(tuple(command), tuple(runs), tuple(compared), tuple(left_out), tuple(damaged))


def _by_name(run: ProgramRun) -> dict[str, Path]:
    return {path.relative_to(run.folder).as_posix(): path for path in run.recordings}


def _verified(path: Path, run: int, damaged: list[str]) -> Recording | None:
    """The whole recording; None where it is not whole, which `damaged` gets as a sentence."""
    try:
        recording = Recording(path)
        verify(recording)
    except RecordingError as error:
        damaged.append(f"run {run}: {error}")
        return None
    return recording


def _compared(name: str, number: int, a: Recording, b: Recording) -> ComparedRun:
    try:
        return ComparedRun(name, number, compare(a, b))
    except NothingComparable as error:
        return ComparedRun(name, number, Missing(str(error)))


def runs_document(found: Comparison) -> Document:
    """The verdict, each run, and of the first two recordings that differ what gsb-diff says."""
    blocks: list[Block] = [*_verdicts(found), facts(("program", shlex.join(found.command)), ("runs", _runs(found)))]
    if found.damaged:
        blocks.append(Items(tuple(Item(f"  no recording: {said}", Tone.BAD) for said in found.damaged)))
    if found.left_out:
        blocks.append(Items(tuple(Item(f"  not compared: {said}", Tone.WARNING) for said in found.left_out)))
    shown = _shown(found)
    if shown is not None and shown.difference:
        blocks.append(Text(f"  {shown.name} of run 0 (a) and of run {shown.run} (b):"))
        blocks += [brief(shown.difference, every=False), *remarks(shown.difference, every=False)]
        if shown.difference.program is not None and shown.difference.different:
            blocks.append(words.section(shown.difference.program, shown.difference.a.dt))
    return Document("", tuple(blocks))


def dump_json(found: Comparison) -> str:
    """The document that ``gsb-run --json`` writes."""
    verdict = found.verdict.value if found.verdict else None
    return dump(document_of({"verdict": verdict, "all_compared": found.whole, **values_of(found)}))


def _shown(found: Comparison) -> ComparedRun | None:
    """The pair that is shown at length: the first that differs, else that was not compared in all, else the first."""

    def order(one: ComparedRun) -> tuple[bool, bool]:
        of = one.difference
        return not (of and of.different), not (of and (of.compared.left_out or of.lost))

    return min((one for one in found.compared if one.difference), key=order, default=None)


def _verdicts(found: Comparison) -> list[Block]:
    runs = plural(len(found.runs), "run")
    if found.verdict is None:
        recorded = any(run.recordings or run.partial for run in found.runs)
        how = _HOW if not recorded and any(run.status == "ended" for run in found.runs) else ""
        return [Text(f"No verdict: the runs have no recordings to compare.{how}", Tone.WARNING)]
    if found.verdict is DiffVerdict.IDENTICAL:
        names = few(list(dict.fromkeys(one.name for one in found.compared)), _NAMES)
        if found.failed:
            failed = sum(run.status != "ended" for run in found.runs)
            common = f"what the runs recorded in common is bit-identical: {names}"
            return [Text(f"{failed} of {runs} failed; {common}.", Tone.WARNING)]
        if not found.whole:
            return [Text(f"The {runs} are equal bit for bit as far as compared: {names}.", Tone.WARNING)]
        return [Text(f"The {runs} are bit-identical: {names}.", Tone.GOOD)]
    several = len({one.name for one in found.compared}) > 1
    return [
        verdict_of(one.difference, f"Run 0 and run {one.run}{f' of {one.name}' if several else ''}")
        for one in found.compared
        if one.difference
    ]


def _runs(found: Comparison) -> Cell:
    first, *others = [_run(number, run) for number, run in enumerate(found.runs)]
    return Cell(first, notes=tuple(others))


def _run(number: int, run: ProgramRun) -> str:
    memory = [f"{source} {used / _MIB:,.0f} MiB" for source, used in sorted(run.peaks_bytes.items(), reverse=True)]
    ended = run.reason or "ended"
    return f"{number}: {ended}, {run.seconds:.1f} s, peak memory {', '.join(memory) or 'not known'}; {run.folder}"
