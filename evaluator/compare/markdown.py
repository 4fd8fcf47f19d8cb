"""A comparison of two sets as a comment for a pull request, in GitHub's and GitLab's Markdown."""

from __future__ import annotations

from gpusimbench.evaluator.compare import words
from gpusimbench.evaluator.compare.compare import Compared, Result
from gpusimbench.evaluator.compare.finding import Change
from gpusimbench.evaluator.render.markdown import code, safe

_ROOM = 40_000  # characters for details, and rows of the first table: a comment may have 65,536 characters
_ROWS = 40

_HELD, _FAILED, _OPEN = ":white_check_mark:", ":x:", ":grey_question:"


def markdown(result: Result, command: str) -> str:
    """The document: a line with the verdict, a table of what differs, and all findings folded away."""
    mark = _FAILED if result.failing else _HELD if result.comparable and not result.open else _OPEN
    parts = [f"{mark} **gsb-compare: {safe(words.headline(result))}**", ""]
    parts += _differing(result)
    for side, unreadable in result.unreadable:
        parts += [f"- :warning: {side}: {code(str(unreadable.error))}"]
    for side, label, why in result.alone:
        parts += [f"- without a partner: {code(label)} of {side}: {safe(why)}"]
    parts += [f"- {safe(note)}" for note in result.notes]
    parts += _all_folded(result)
    parts += ["", *(f"<sub>{safe(line)}</sub><br>" for line in _legend(result))]
    return "\n".join([*parts, "", f"<sub>{code(command)}</sub>", ""])


def _differing(result: Result) -> list[str]:
    rows = [
        (compared, finding)
        for compared in result.compared
        for finding in compared.findings
        if finding.change not in (Change.SAME, Change.WITHIN, Change.UNCLEAR, Change.NOT_COMPARED)
        or finding.undecided(result.settings)
    ]
    rows.sort(key=lambda row: (not row[1].fails(result.settings), not row[1].undecided(result.settings)))
    if not rows:
        return []
    lines = [_row("configuration", *words.TITLES), _rule(1 + len(words.TITLES))]
    for compared, finding in rows[:_ROWS]:
        cells = [safe(cell) for cell in words.cells(finding, result)]
        if finding.fails(result.settings):
            cells[-1] = f"**{cells[-1]}**"
        lines.append(_row(code(words.heading(compared)), *cells))
    if len(rows) > _ROWS:
        lines += ["", f"and {len(rows) - _ROWS} more"]
    return [*lines, ""]


def _legend(result: Result) -> list[str]:
    return [*words.methods(result.compared), *words.legend(result), words.settings_line(result)]


def _all_folded(result: Result) -> list[str]:
    """Details of as many configurations as a comment has room for, those that fail first."""
    ordered = sorted(result.compared, key=lambda one: not any(f.fails(result.settings) for f in one.findings))
    lines: list[str] = []
    room = _ROOM
    for index, compared in enumerate(ordered):
        folded = ["", *_folded(compared, result)]
        room -= sum(map(len, folded)) + len(folded)
        if room < 0:
            return [*lines, "", f"and {len(ordered) - index} more configurations, which have no room here"]
        lines += folded
    return lines


def _folded(compared: Compared, result: Result) -> list[str]:
    failing = sum(finding.fails(result.settings) for finding in compared.findings)
    undecided = words.undecided(compared, result)
    mark = f"{_FAILED} {failing}" if failing else _OPEN if undecided else _HELD
    lines = [f"<details><summary>{mark} {code(words.heading(compared))}</summary>", "", safe(words.runs(compared)), ""]
    if compared.pair.differs:
        lines += [f"differs: {', '.join(map(code, compared.pair.differs))}", ""]
    lines += [_row(*words.TITLES), _rule(len(words.TITLES))]
    told = [finding for finding in compared.findings if finding.change is not Change.NOT_COMPARED]
    lines += [_row(*(safe(cell) for cell in words.cells(finding, result))) for finding in told]
    lines += ["", *(f"- {_OPEN} undecided: {safe(line)}" for line in undecided)]
    lines += [f"- :warning: {safe(warning)}" for warning in compared.warnings]
    lines += [f"- {safe(line)}" for line in (*words.tests(compared), *words.remarks(compared))]
    return [*lines, "", "</details>"]


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _rule(columns: int) -> str:
    return f"|{' --- |' * columns}"
