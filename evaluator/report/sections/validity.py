"""What shows that the steps did their work: contacts that were counted, buffers, overflow, actions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from gpusimbench.evaluator.render.document import Block, Cell, Column, Row, Section, Table, Tone, key_of, table
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.sections.rows import FEW, Reasons, of_groups, ordered
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.validity import BufferUse, Counted
from gpusimbench.schemas.text import plural

_COUNTED = "Counts are per step and environment: mean / mean of the 95th percentile / largest."
_HASH = 12  # digits of a hash that are shown


def section(source: Source) -> Section | None:
    """A row for each group, those without states as well; of many groups, first what is wrong and a summary."""
    results = [*source.shown, *source.hidden]
    if not results:
        return None
    every = _of_groups(source, results)
    if len(results) <= FEW:
        blocks: tuple[Block, ...] = (every,)
    else:
        listed = Section("validity-groups", "Every group", (every,), plural(len(results), "group"), folded=True)
        blocks = (*_deviating(source, results), _by_simulator(results), listed)
    invalid = sum(any(run.status == "invalid" for run in r.group.recordings) for r in results)
    said = f"{plural(invalid, 'group')} with INVALID runs" if invalid else "no run is INVALID"
    misplaced = sum(bool(faults(r).misplaced) for r in results)
    also = f"; {plural(misplaced, 'group')} with misplaced contacts" if misplaced else ""
    return Section("validity", "Validity", blocks, said + also, folded=True)


def _of_groups(source: Source, results: Sequence[GroupResult]) -> Table:
    columns = [
        (Column("runs"), _runs),
        (Column("counted"), _counts),
        (Column("buffers: needed of asked"), _buffers),
        (Column("overflow"), _overflow),
        (Column("actions"), _actions),
    ]
    legend = [_COUNTED, *_meanings(results)]
    return of_groups(source, "validity", "", results, columns, Reasons(), legend)


def _deviating(source: Source, results: Sequence[GroupResult]) -> Iterator[Table]:
    """Groups in which a run is not complete, a buffer overflowed or a contact is misplaced."""
    found = [r for r in results if _ended(r).keys() - {"complete"} or r.validity.overflow or faults(r).misplaced]
    if found:
        columns = [(Column("runs"), _runs), (Column("fullest buffer"), _fullest), (Column("overflow"), _overflow)]
        caption = "Groups with runs that are not complete, with an overflow, or with misplaced contacts"
        yield of_groups(source, "validity-deviating", caption, found, columns, Reasons())


def _by_simulator(results: Sequence[GroupResult]) -> Table:
    rows = [_of_simulator(*one) for one in ordered(results, "simulator").items()]
    rows.sort(key=lambda row: all(cell.tone is not Tone.BAD for cell in row.cells))  # what deviates comes first
    titles = ("simulator", "groups", "runs", "contacts counted", "fullest buffer", "overflow")
    return table("validity-simulators", "All groups, by simulator", titles, rows)


def _of_simulator(name: str, results: Sequence[GroupResult]) -> Row:
    ended: Counter[str] = Counter()
    for result in results:
        ended.update(_ended(result))
    counted = sum(result.validity.of("contacts") is not None for result in results)
    of = plural(len(results), "group")
    fullest = max(results, key=lambda result: max((use.share or 0.0 for use in result.validity.buffers), default=0.0))
    return Row(
        (
            Cell(name, link=key_of("simulator", name)),
            Cell(str(len(results)), float(len(results))),
            _endings(ended),
            Cell(f"in {counted} of {of}", tone=Tone.PLAIN if counted else Tone.QUIET),
            _fullest(fullest),
            _overflows(results),
        ),
        {"simulator": name},
    )


def _overflows(results: Sequence[GroupResult]) -> Cell:
    told = [result.validity for result in results if result.validity.overflow_told.holds or result.validity.overflow]
    fired = sum(bool(one.overflow) for one in told)
    fatal = any(seen.fatal for one in told for seen in one.overflow or ())
    silent = len(results) - len(told)
    notes = (f"not reported by {plural(silent, 'group')}",) if silent else ()
    if not told:
        return Cell("not reported", tone=Tone.QUIET)
    if not fired:
        return Cell(f"none in {plural(len(told), 'group')}", notes=notes)
    return Cell(f"in {plural(fired, 'group')}", notes=notes, tone=Tone.BAD if fatal else Tone.PLAIN)


def _ended(result: GroupResult) -> dict[str, int]:
    """How many runs ended how."""
    return {how: count for how, count in result.group.outcomes.items() if count}


def _runs(result: GroupResult) -> Cell:
    ended, misplaced = _endings(_ended(result)), faults(result).misplaced
    return replace(ended, notes=(misplaced,), tone=Tone.BAD) if misplaced else ended


def _endings(ended: dict[str, int]) -> Cell:
    complete_first = sorted(ended.items(), key=lambda one: one[0] != "complete")
    text = ", ".join(f"{count} {'INVALID' if how == 'invalid' else how}" for how, count in complete_first)
    return Cell(text, tone=Tone.BAD if ended.keys() - {"complete"} else Tone.PLAIN)


def _lines(lines: list[str], nothing: str) -> Cell:
    return Cell(lines[0], notes=tuple(lines[1:])) if lines else Cell(nothing, tone=Tone.QUIET)


def _counts(result: GroupResult) -> Cell:
    """A line for each counter, then at how many steps it was read."""
    found = result.validity.counted
    lines = []
    for name in dict.fromkeys(one.name for one in found):
        phases = "; ".join(f"{_three(one)} ({one.phase})" for one in found if one.name == name)
        lines.append(f"{_spaced(name)}: {phases}")
    read = dict.fromkeys(f"{one.phase}: {plural(one.rows, 'step')} of {plural(one.n_run, 'run')}" for one in found)
    return _lines([*lines, *([f"counted in {'; '.join(read)}"] if read else [])], "nothing was counted")


def _three(one: Counted) -> str:
    return " / ".join(map(words.count, (one.mean, one.p95, one.max)))


def _spaced(name: str) -> str:
    return name.replace("_", " ")


def _meanings(results: Sequence[GroupResult]) -> Iterator[str]:
    """What counters count and how buffers were sized, with the simulators that say so, each sentence once."""
    said: dict[str, dict[str, None]] = {}
    for result in results:
        name = result.group.key.simulator
        for one in result.validity.counted:
            if one.meaning:
                said.setdefault(f"{_spaced(one.name)}: {one.meaning}", {}).setdefault(name)
        for use in result.validity.buffers:
            if use.buffer.sized_by:
                said.setdefault(f"{use.buffer.name}: {use.buffer.sized_by}", {}).setdefault(name)
    for sentence, names in said.items():
        yield f"{sentence} ({', '.join(names)})"


def _fullest(result: GroupResult) -> Cell:
    """The buffer of which most was needed."""
    known = [use for use in result.validity.buffers if use.share is not None]
    if not known:
        return Cell("not told" if result.validity.buffers else "none is stated", tone=Tone.QUIET)
    fullest = max(known, key=lambda use: use.share or 0.0)
    return Cell(f"{fullest.buffer.name}: {words.share(fullest)}", notes=(_needed(fullest),))


def _buffers(result: GroupResult) -> Cell:
    return _lines([_buffer(use) for use in result.validity.buffers], "none is stated")


def _buffer(use: BufferUse) -> str:
    return f"{use.buffer.name}: {_needed(use)}{f' ({words.share(use)})' if use.share is not None else ''}"


def _needed(use: BufferUse) -> str:
    needed = words.count(use.needed) if use.needed is not None else "not told"
    per = "for all envs" if use.buffer.per == "all" else f"per {use.buffer.per}"
    return f"{needed} of {words.count(use.buffer.asked)} {per}"


def _overflow(result: GroupResult) -> Cell:
    validity = result.validity
    if validity.overflow is None:
        return Cell("the engine does not tell", tone=Tone.QUIET)
    if not validity.overflow:
        return Cell(words.overflow(validity), tone=Tone.PLAIN if validity.overflow_told.holds else Tone.QUIET)
    lines = []
    for seen in validity.overflow:
        where = f"in {plural(seen.n_run, 'run')}, {seen.phase} phase first, at most {seen.envs} envs"
        lines += [words.fired(seen), where]
    tone = Tone.BAD if any(seen.fatal for seen in validity.overflow) else Tone.PLAIN
    return Cell(lines[0], notes=tuple(lines[1:]), tone=tone)


def _actions(result: GroupResult) -> Cell:
    lines = []
    for one in result.validity.actions:
        lines.append(f"{one.phase}: verified in {one.verified} of {plural(one.n_run, 'run')}")
        if len(one.sha256) > 1:  # the runs were not given the same
            lines += [f"first step {first[:_HASH]}, last {last[:_HASH]}" for first, last in one.sha256]
    return _lines(lines, NONE)
