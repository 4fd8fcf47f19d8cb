"""What gsb-audit says of an audit: the verdict, what was run here, which levels of agreement hold, and what differs."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.audit.audit import Audit, Outcome
from gpusimbench.evaluator.audit.checking import RULES, Check
from gpusimbench.evaluator.audit.settings import Settings
from gpusimbench.evaluator.audit.verdict import Level
from gpusimbench.evaluator.diff.result import Divergence
from gpusimbench.evaluator.render.document import Cell, Document, Facts, Tone
from gpusimbench.evaluator.runs.groups import shown_status

_TICKS = {True: "[x]", False: "[ ]", None: "[?]"}  # plain characters: no terminal shows them alike

_NO_VERDICT = {
    Outcome.MADE: "the replay cannot be compared",
    Outcome.NOT_TRIED: "there is nothing to replay",
    Outcome.REFUSED: "the replay was refused",
    Outcome.STOPPED: "the replay was stopped",
    Outcome.FAILED: "no replay came to its end",
}

_VALUE, _COMMAND = 60, 200
_FILES = 3


def audit_document(audit: Audit, checked: Check) -> Document:
    """The report of one audit."""
    return Document(_heading(audit), (Facts(tuple(_facts(audit, checked))),))


def _facts(audit: Audit, checked: Check) -> Iterator[tuple[str, Cell]]:
    original = audit.originals[0]
    tones = {Level.BIT_IDENTICAL: Tone.GOOD, Level.DIFFERENT: Tone.BAD, None: Tone.WARNING}
    tone = tones.get(audit.level, Tone.PLAIN)
    yield "verdict", Cell(_verdict(audit), notes=(audit.why_not,), tone=tone)
    if audit.verdict is not None:
        for rung in audit.verdict.rungs:
            yield _TICKS[rung.holds], Cell(f"{rung.level.value}: {rung.said}")
    if audit.difference is not None and audit.difference.first is not None:
        yield "differs", _first(audit.difference.first)
    yield "recorded", Cell(_where(audit))
    paths = [recording.path for recording in audit.originals]
    broken = dict.fromkeys(sentence for path in paths for sentence in checked.broken.get(path, ()))
    warnings = dict.fromkeys(sentence for path in paths for sentence in checked.warnings.get(path, ()))
    holds = "is broken" if broken else "holds, with warnings" if warnings else "holds"
    yield "check", Cell(f"{RULES} {holds}; content hash {original.content_hash}", notes=(*broken, *warnings))
    yield "asked", Cell(_short(" ".join(original.provenance.argv), _COMMAND), code=True)
    if audit.replays is not None:
        yield "tried" if audit.replays.refused else "run here", Cell(audit.replays.command, code=True)
    replays = [f"{replay.status}: {replay.reason}" for replay in audit.failed]
    replays += [f"complete: {recording.path}" for recording in audit.recordings[:_FILES]]
    if len(audit.recordings) > _FILES:
        replays.append(f"and {len(audit.recordings) - _FILES} more")
    if replays:
        yield "replay", Cell(replays[0], notes=tuple(replays[1:]))
    if audit.recordings:
        yield "runs", Cell(_distinct(audit))
    if audit.difference is not None:
        for note in (*audit.difference.compared.left_out, *audit.difference.notes):
            yield "note", Cell(note)
        yield "settings", _settings(audit.settings, full=not audit.difference.bit_identical)


def _heading(audit: Audit) -> str:
    original = audit.originals[0]
    c, simulation = original.configuration, original.simulation
    version = f" {simulation.version}" if simulation else ""
    others = len(audit.originals) - 1
    files = original.path.name + (f" and {others} more of its set" if others else "")
    return f"{files}: {c.simulator}{version}, {c.scene}, {c.n_env} envs, dt {c.dt:g} s, {shown_status(original)}"


def _where(audit: Audit) -> str:
    original = audit.originals[0]
    where = original.provenance.host.get("cpu", "")
    device = original.simulation.device if original.simulation else ""
    machine = where if device in ("", "cpu", where) else f"{device}, {where}"
    return f"{original.provenance.created_utc}, {machine}"


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


def _first(first: Divergence) -> Cell:
    of = " of the timed phase" if first.phase == "timed" else ""
    envs = f"env {first.env_a}; {first.envs} envs at that step"
    said = f"from step {first.step_a} ({first.time:g} s){of}, {envs}"
    if first.state is None:
        return Cell(said)
    n, at = first.state.number, first.state
    later = "" if first.located else f" (first recorded state: step {at.step})"
    ulp = "" if n.ulp is None else f", {n.ulp:,} ULP"
    distance = "" if n.distance is None else f", {n.distance:.3g} {n.unit}"
    number = f"{n.field} {n.item} {n.component}{later}: {n.a} there, {n.b} here{ulp}{distance}"
    return Cell(said, notes=(number,))


def _settings(settings: Settings, *, full: bool) -> Cell:
    more = f"{settings.packages} other installed packages" if settings.packages else ""
    if not settings.deciding:
        return Cell(f"the same{f' but for {more}' if more else ''}")
    if full:
        differing = [f"{s.name}: {_short(s.a)} | {_short(s.b)}" for s in settings.deciding]
        return Cell("that differ, there | here", notes=(*differing, *([f"and {more}"] if more else ())))
    names = ", ".join([s.name for s in settings.deciding] + ([more] if more else []))
    return Cell(f"different, and the numbers are the same: {names}")


def _short(text: str, most: int = _VALUE) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."
