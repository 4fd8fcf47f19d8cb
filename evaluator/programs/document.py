"""What gsb-run says: whether the runs are the same, and if not, where they part first; and the same as JSON."""

from __future__ import annotations

import shlex

from gpusimbench.evaluator.compute.recorder import ProgramRun
from gpusimbench.evaluator.diff import program_words
from gpusimbench.evaluator.diff.brief import brief
from gpusimbench.evaluator.diff.result import Verdict
from gpusimbench.evaluator.diff.sections import remarks
from gpusimbench.evaluator.diff.verdict import verdict_of
from gpusimbench.evaluator.json_values import dump, values_of
from gpusimbench.evaluator.programs.comparison import Compared, Comparison
from gpusimbench.evaluator.render.document import Block, Cell, Document, Item, Items, Text, Tone, facts
from gpusimbench.schemas.text import few, plural

SCHEMA_VERSION = 1

_HOW = " The program has to record: gpusimbench.wrap(envs, 'a.mcap'), or RecordingWriter, with a relative path."
_NAMES = 4
_MIB = 1 << 20


def runs_document(found: Comparison) -> Document:
    """The verdict, each run, and of the first two recordings that differ what gsb-diff says."""
    blocks: list[Block] = [*_verdicts(found), facts(("program", shlex.join(found.command)), ("runs", _runs(found)))]
    if found.damaged:
        blocks.append(Items(tuple(Item(f"  no recording: {said}", Tone.BAD) for said in found.damaged)))
    if found.left_out:
        blocks.append(Items(tuple(Item(f"  not compared: {said}", Tone.WARNING) for said in found.left_out)))
    shown = _shown(found)
    if shown is not None and shown.difference is not None:
        blocks.append(Text(f"  {shown.name} of run 0 (a) and of run {shown.run} (b):"))
        blocks += [brief(shown.difference, every=False), *remarks(shown.difference, every=False)]
        if shown.difference.program is not None and shown.difference.different:
            blocks.append(program_words.section(shown.difference.program, shown.difference.a.dt))
    return Document("", tuple(blocks))


def dump_json(found: Comparison) -> str:
    """The document that ``gsb-run --json`` writes."""
    verdict = found.verdict.value if found.verdict else None
    return dump({"schema_version": SCHEMA_VERSION, "verdict": verdict, "all_compared": found.whole, **values_of(found)})


def _shown(found: Comparison) -> Compared | None:
    """The pair that is shown at length: the first that differs, else that was not compared in all, else the first."""

    def order(one: Compared) -> tuple[bool, bool]:
        of = one.difference
        return not (of and of.different), not (of and (of.compared.left_out or of.lost))

    return min((one for one in found.compared if one.difference is not None), key=order, default=None)


def _verdicts(found: Comparison) -> list[Block]:
    runs = plural(len(found.runs), "run")
    if found.verdict is None:
        how = "" if found.failed or any(run.recordings or run.partial for run in found.runs) else _HOW
        return [Text(f"No verdict: the runs have no recordings to compare.{how}", Tone.WARNING)]
    if found.verdict is Verdict.IDENTICAL:
        names = few(list(dict.fromkeys(one.name for one in found.compared)), _NAMES)
        if not found.whole:
            return [Text(f"The {runs} are equal bit for bit as far as compared: {names}.", Tone.WARNING)]
        return [Text(f"The {runs} are bit-identical: {names}.", Tone.GOOD)]
    several = len({one.name for one in found.compared}) > 1
    return [
        verdict_of(one.difference, f"Run 0 and run {one.run}{f' of {one.name}' if several else ''}")
        for one in found.compared
        if one.difference is not None
    ]


def _runs(found: Comparison) -> Cell:
    first, *others = [_run(number, run) for number, run in enumerate(found.runs)]
    return Cell(first, notes=tuple(others))


def _run(number: int, run: ProgramRun) -> str:
    memory = [f"{source} {used / _MIB:,.0f} MiB" for source, used in sorted(run.peaks.items(), reverse=True)]
    ended = run.reason or "ended"
    return f"{number}: {ended}, {run.seconds:.1f} s, peak memory {', '.join(memory) or 'not known'}; {run.folder}"
