"""What shows that the steps did their work: contacts that were counted, buffers, overflow, actions."""

from __future__ import annotations

from gpusimbench.evaluator.render.document import Cell, Column, Section, Tone
from gpusimbench.evaluator.render.numbers import NONE, plural
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.sections.rows import Reasons
from gpusimbench.evaluator.report.sections.values import of_groups
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.validity import BufferUse, Counted

_COUNTED = "Counts are per step and environment: mean / mean of the 95th percentile / largest."
_HASH = 12  # digits of a hash that are shown


def section(source: Source) -> Section | None:
    """A row for each group, those without states as well."""
    results = [*source.shown, *source.hidden]
    if not results:
        return None
    columns = [
        (Column("runs"), _runs),
        (Column("counted"), _counts),
        (Column("buffers: needed of asked"), _buffers),
        (Column("overflow"), _overflow),
        (Column("actions"), _actions),
    ]
    shown = of_groups("validity", "", results, columns, Reasons(), [_COUNTED])
    invalid = sum(any(run.status == "invalid" for run in r.group.recordings) for r in results)
    said = f"{plural(invalid, 'group')} with INVALID runs" if invalid else "no run is INVALID"
    return Section("validity", "Validity", (shown,), said, folded=True)


def _runs(result: GroupResult) -> Cell:
    found = {how: count for how, count in result.group.outcomes.items() if count}
    said = ", ".join(f"{count} {'INVALID' if how == 'invalid' else how}" for how, count in found.items())
    return Cell(said, tone=Tone.BAD if set(found) - {"complete"} else Tone.PLAIN)


def _lines(lines: list[str], nothing: str) -> Cell:
    return Cell(lines[0], notes=tuple(lines[1:])) if lines else Cell(nothing, tone=Tone.QUIET)


def _counts(result: GroupResult) -> Cell:
    return _lines([line for one in result.validity.counted for line in _count(one)], "nothing was counted")


def _count(one: Counted) -> list[str]:
    values = " / ".join(map(words.count, (one.mean, one.p95, one.max)))
    rows, runs = plural(one.rows, "recorded step"), plural(one.runs, "run")
    meaning = f": {one.meaning}" if one.meaning else ""
    return [f"{one.name.replace('_', ' ')}: {values}", f"{one.phase} phase, {rows} of {runs}{meaning}"]


def _buffers(result: GroupResult) -> Cell:
    return _lines([line for use in result.validity.buffers for line in _buffer(use)], "none is stated")


def _buffer(use: BufferUse) -> list[str]:
    needed = words.count(use.needed) if use.needed is not None else "not told"
    per = "for all envs" if use.buffer.per == "all" else f"per {use.buffer.per}"
    share = f" ({words.share(use)})" if use.share is not None else ""
    return [f"{use.buffer.name}: {needed} of {words.count(use.buffer.asked)} {per}{share}", use.buffer.sized_by]


def _overflow(result: GroupResult) -> Cell:
    validity = result.validity
    if validity.overflow is None:
        return Cell("the engine does not tell", tone=Tone.QUIET)
    if not validity.overflow:
        return Cell(words.overflow(validity), tone=Tone.PLAIN if validity.overflow_told.holds else Tone.QUIET)
    lines = []
    for seen in validity.overflow:
        where = f"in {plural(seen.runs, 'run')}, {seen.phase} phase first, at most {seen.envs} envs"
        lines += [words.fired(seen), where]
    tone = Tone.BAD if any(seen.fatal for seen in validity.overflow) else Tone.PLAIN
    return Cell(lines[0], notes=tuple(lines[1:]), tone=tone)


def _actions(result: GroupResult) -> Cell:
    lines = []
    for one in result.validity.actions:
        lines.append(f"{one.phase}: verified in {one.verified} of {plural(one.runs, 'run')}")
        lines += [f"first step {first[:_HASH]}, last {last[:_HASH]}" for first, last in one.sha256]
    return _lines(lines, NONE)
