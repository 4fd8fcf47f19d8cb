"""What stands beside every throughput, in every table: which steps were timed, for how long, with which settings.

A table that people read takes `columns` for its rows and shows `remarks` below; a table in a file takes `ALL`; a place
without columns takes `beside`. A renderer adds nothing of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.timed_work import (
    SETTINGS,
    SHORT_S,
    TimedWork,
    differing_settings,
    most_common,
)
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural

_NAMED = 6  # rows that a remark names
_SHORT = f"(< {SHORT_S:g} s)"
_JUST_SHORT = 0.999  # [s]: what is marked as shorter is not shown as SHORT_S


@dataclass(frozen=True)
class Column:
    """One thing that stands beside a throughput."""

    title: str
    cell: Callable[[TimedWork], str]


def steps(work: TimedWork) -> str:
    """The timed steps of the scene and how many they are: "100 to 1,100 (1,000)"."""
    return ", ".join(f"{w.first:,} to {w.last:,} ({w.steps:,})" for w in work.windows) or NONE


def seconds(work: TimedWork) -> str:
    """How long the timed phase of a run took [s], marked where that is too short."""
    if work.seconds is None:
        return NONE
    low, high = (f"{min(value, _JUST_SHORT) if value < SHORT_S else value:.3g}" for value in work.seconds)
    told = low if low == high else f"{low} to {high}"
    return f"{told} {_SHORT}" if work.short else told


def settings(work: TimedWork) -> str:
    """Cone, iterations and tolerance in force, a dash for what the engine does not state."""
    told = [work.settings.get(name) or NONE for name in SETTINGS]
    return NONE if set(told) == {NONE} else ", ".join(told)


def unmet(work: TimedWork) -> str:
    """How many rules of the protocol are not met, and how often."""
    count, rules = work.unmet.count, len(work.unmet.findings)
    return f"{rules}; {count} in all" if count > rules else str(rules)


_STEPS = Column("timed steps", steps)
_SECONDS = Column("seconds timed", seconds)
SETTINGS_IN_FORCE = Column(", ".join(SETTINGS), settings)
_UNMET = Column(f"{PROTOCOL} rules not met", unmet)


LEGEND = f"{PROTOCOL} rules not met: how many rules, and how often; gsb-check --protocol names them"
"""What the last column counts."""

NOT_COMPARABLE = "NOT comparable by throughput"
"""How the line on rows that were timed over other steps begins."""

TOO_SHORT = (
    f"timed too briefly: less than {SHORT_S:g} s, or fewer steps than {PROTOCOL} asks for; record with more "
    "--timed-steps or --n-env"
)
"""What a sign beside a throughput means."""

ALL = (_STEPS, _SECONDS, SETTINGS_IN_FORCE, _UNMET)
"""Everything that stands beside a throughput."""


def columns(works: Iterable[TimedWork]) -> tuple[Column, ...]:
    """The seconds, and what differs between the rows of a table; what does not is one of its remarks."""
    found = [work for work in works if work.windows]
    return tuple(c for c in ALL if c is _SECONDS or len({c.cell(work) for work in found}) > 1)


def cells(shown: Iterable[Column], work: TimedWork) -> tuple[str, ...]:
    """A row's texts."""
    return tuple(column.cell(work) for column in shown)


def beside(work: TimedWork) -> list[str]:
    """The same in short phrases, for a place without columns: below a throughput, behind a name."""
    if not work.windows:
        return []
    lines = [f"steps {steps(work)} in {seconds(work)} s".replace(f" {_SHORT} s", f" s {_SHORT}")]
    if any(work.settings.values()):
        lines.append(", ".join(f"{name} {value}" for name, value in work.settings.items() if value))
    if work.unmet.findings:
        rules = len(work.unmet.findings)
        lines.append(f"{rules} {'rule' if rules == 1 else 'rules'} of {PROTOCOL} not met")
    return lines


def shared(works: Iterable[TimedWork]) -> list[str]:
    """What all rows have in common, in one line; none where no row was timed."""
    found = [work for work in works if work.windows]
    same = [(c.title, c.cell(found[0])) for c in ALL if found and c not in columns(found)]
    alike = [f"{title}: {cell}" for title, cell in same if cell != NONE]
    return ["; ".join(alike)] if alike else []


def remarks(results: Iterable[GroupResult], *, named: Callable[[GroupResult], str] | None = None) -> list[str]:
    """What must be known to compare the throughputs of a table's rows; nothing where all are alike and long.

    named  how the table names a row; by its label
    """
    found = [(named(r) if named else r.label, r) for r in results if r.timed.windows]
    rows = [(name, r.timed) for name, r in found]
    works = [work for _, work in rows]
    lines = [f"all rows: {line}" for line in shared(works)]
    lines += _incomparable(rows)
    if short := list(dict.fromkeys(name for name, work in rows if work.short)):
        lines.append(f"timed for less than {SHORT_S:g} s, which is too short to rely on: {_listed(short)}")
    if others := list(
        dict.fromkeys(f"{name} ({told})" for name, r in found if (told := words.shared(r.metrics["fps"])))
    ):
        lines.append(f"another process was on the GPU, and throughput may be lower for it: {_listed(others)}")
    if differing_settings(works):
        lines.append(
            f"solver settings ({', '.join(SETTINGS)}) differ between rows: a step is not the same amount of work in all"
        )
    if any(work.unmet.findings for work in works):
        lines.append(LEGEND)
    return lines


def incomparable(results: Iterable[GroupResult]) -> list[str]:
    """Which rows were timed over other steps than most, in one line; none where all were timed over the same.

    Many are counted instead of named.
    """
    return _incomparable([(r.label, r.timed) for r in results if r.timed.windows], counted=True)


def _incomparable(rows: Sequence[tuple[str, TimedWork]], *, counted: bool = False) -> list[str]:
    by_window = gathered((work.windows, name) for name, work in rows)
    if len(by_window) < 2:
        return []
    usual = most_common([work.windows for _, work in rows])
    others = {window: list(dict.fromkeys(names)) for window, names in by_window.items() if window != usual}
    counted = counted and sum(map(len, others.values())) >= _NAMED
    whose = [(w, plural(len(n), "group") if counted else _listed(n)) for w, n in others.items()]
    whose.append((next(window for window in by_window if window == usual), "all others"))
    said = "; those of ".join(f"{name} are {steps(TimedWork(windows=w))}" for w, name in whose)
    return [f"{NOT_COMPARABLE}: the timed steps of {said}"]


def of_sides(base: TimedWork, head: TimedWork) -> list[str]:
    """What stands against comparing the throughputs of two groups, a sentence each."""
    if not (base.windows and head.windows):
        return []
    sides = (("base", base), ("head", head))
    lines = []
    if base.windows != head.windows:
        lines.append(
            f"throughput is NOT comparable: base was timed over {base.said} of the scene, head over {head.said}"
        )
    if short := [f"{name} ({seconds(work)} s)".replace(f" {_SHORT} s", " s") for name, work in sides if work.short]:
        lines.append(f"timed for less than {SHORT_S:g} s, which is too short to rely on: {', '.join(short)}")
    if base.settings != head.settings:
        lines.append(
            f"solver settings ({', '.join(SETTINGS)}) differ: base has {settings(base)}; head has {settings(head)}"
        )
    if base.unmet.findings.keys() != head.unmet.findings.keys():
        lines.append(f"rules of {PROTOCOL} that are not met: {_rules(base)} in base, {_rules(head)} in head")
    return lines


def _rules(work: TimedWork) -> str:
    return ", ".join(work.unmet.findings) or "none"


def timed_record(work: TimedWork) -> dict[str, Any]:
    """What a throughput was measured over, as JSON has it."""
    return {
        "windows": [{"first_step": w.first, "last_step": w.last, "steps": w.steps} for w in work.windows],
        "seconds": list(work.seconds) if work.seconds else None,
        "under_1_s": work.short,
        "settings": {name: work.settings.get(name) or None for name in SETTINGS},
        "protocol_not_met": dict(work.unmet.findings),
        "protocol_findings": work.unmet.count,
    }


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names) if more < 2 else f"{', '.join(names[:_NAMED])} and {more} more"
