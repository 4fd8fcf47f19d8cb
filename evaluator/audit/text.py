"""An audit as text: what was asked, what was run here, which levels hold, and what differs."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from gpusimbench.evaluator.audit.audit import Audit, Outcome
from gpusimbench.evaluator.audit.checking import RULES, Check
from gpusimbench.evaluator.audit.settings import Settings
from gpusimbench.evaluator.audit.verdict import Rung
from gpusimbench.evaluator.diff.result import Divergence
from gpusimbench.evaluator.runs.groups import shown_status
from gpusimbench.schemas.text import Block, block

_TICKS = {True: "[x]", False: "[ ]", None: "[?]"}  # plain characters: no terminal shows them alike

_NO_VERDICT = {
    Outcome.MADE: "the replay cannot be compared",
    Outcome.NOT_TRIED: "there is nothing to replay",
    Outcome.REFUSED: "the replay was refused",
    Outcome.STOPPED: "the replay was stopped",
    Outcome.FAILED: "no replay came to its end",
}

_COLUMNS = 120
_VALUE = 60
_FILES = 3


def text_of(audit: Audit, checked: Check) -> Block:
    """The report of one audit."""
    return block(_lines(audit, checked))


def _lines(audit: Audit, checked: Check) -> Iterator[str]:
    original = audit.originals[0]
    yield from _heading(audit)
    paths = [recording.path for recording in audit.originals]
    broken = dict.fromkeys(sentence for path in paths for sentence in checked.broken.get(path, ()))
    warnings = dict.fromkeys(sentence for path in paths for sentence in checked.warnings.get(path, ()))
    holds = "is broken" if broken else "holds, with warnings" if warnings else "holds"
    yield f"  check     {RULES} {holds}; content hash {original.content_hash}"
    yield from (f"            {sentence}" for sentence in (*broken, *warnings))
    command = " ".join(original.provenance.argv)
    yield f"  asked     {_short(command, 200)}"
    if audit.replays is not None:
        yield f"  {'tried' if audit.replays.refused else 'run here':<9} {audit.replays.command}"
    for replay in audit.failed:
        yield f"  replay    {replay.status}: {replay.reason}"
    for recording in audit.recordings[:_FILES]:
        yield f"  replay    complete: {recording.path}"
    if len(audit.recordings) > _FILES:
        yield f"            and {len(audit.recordings) - _FILES} more"
    if audit.recordings:
        yield f"  runs      {_distinct(audit)}"
    yield f"  verdict   {_verdict(audit)}"
    if audit.why_not:
        yield f"            {audit.why_not}"
    if audit.verdict is not None:
        width = max(len(rung.level.value) for rung in audit.verdict.rungs)
        yield from (_rung(rung, width) for rung in audit.verdict.rungs)
    if audit.difference is not None:
        for note in (*audit.difference.compared.left_out, *audit.difference.notes):
            yield f"  note      {note}"
        if audit.difference.first is not None:
            yield from _first(audit.difference.first)
        yield from _settings(audit.settings, full=not audit.difference.bit_identical)


def _heading(audit: Audit) -> Iterator[str]:
    original = audit.originals[0]
    c, simulation = original.configuration, original.simulation
    version = f" {simulation.version}" if simulation else ""
    others = len(audit.originals) - 1
    files = original.path.name + (f" and {others} more of its set" if others else "")
    yield f"{files}: {c.simulator}{version}, {c.scene}, {c.n_env} envs, dt {c.dt:g} s, {shown_status(original)}"
    where = original.provenance.host.get("cpu", "")
    device = simulation.device if simulation else ""
    machine = where if device in ("", "cpu", where) else f"{device}, {where}"
    yield f"  recorded  {original.provenance.created_utc}, {machine}"


def _verdict(audit: Audit) -> str:
    if audit.level is not None:
        return audit.level.value
    return "undecided" if audit.verdict else f"none: {_NO_VERDICT[audit.outcome]}"


def _distinct(audit: Audit) -> str:
    if audit.distinct is None:
        return (
            f"{len(audit.originals)} there, {len(audit.recordings)} here; without state hashes, bits are not compared"
        )
    there, here, both = audit.distinct
    counts = f"{len(audit.originals)} there, {there} distinct by state hashes; {len(audit.recordings)} here, {here}"
    return f"{counts} distinct; {both} together"


def _rung(rung: Rung, width: int) -> str:
    return f"  {_TICKS[rung.holds]}       {rung.level.value:<{width}}  {rung.said}"


def _first(first: Divergence) -> Iterator[str]:
    of = " of the timed phase" if first.phase == "timed" else ""
    envs = f"env {first.env_a}; {first.envs} envs at that step"
    yield f"  differs   from step {first.step_a} ({first.time:g} s){of}, {envs}"
    if first.state is None:
        return
    n, at = first.state.number, first.state
    later = "" if first.located else f" (first recorded state: step {at.step})"
    ulp = "" if n.ulp is None else f", {n.ulp:,} ULP"
    distance = "" if n.distance is None else f", {n.distance:.3g} {n.unit}"
    yield f"            {n.field} {n.item} {n.component}{later}: {n.a} there, {n.b} here{ulp}{distance}"


def _settings(settings: Settings, *, full: bool) -> Iterator[str]:
    more = f"{settings.packages} other installed packages" if settings.packages else ""
    if not settings.deciding:
        yield f"  settings  the same{f' but for {more}' if more else ''}"
    elif full:
        yield "  settings  that differ, there | here"
        yield from (f"            {s.name}: {_short(s.a)} | {_short(s.b)}" for s in settings.deciding)
        if more:
            yield f"            and {more}"
    else:
        names = ", ".join([s.name for s in settings.deciding] + ([more] if more else []))
        yield from _wrapped("  settings  ", f"different, and the numbers are the same: {names}")


def _wrapped(head: str, text: str) -> Iterator[str]:
    yield from textwrap.wrap(
        text, _COLUMNS, initial_indent=head, subsequent_indent=" " * len(head), break_long_words=False
    )


def _short(text: str, most: int = _VALUE) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."
