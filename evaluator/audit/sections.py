"""What gsb-audit says: whether re-execution gave the same, what was checked and compared; and the same as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gpusimbench.evaluator.audit.audit import RULES, Audit, Check, Outcome
from gpusimbench.evaluator.audit.verdict import AuditLevel, Rung
from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.brief import apart, equal_before, gap_before, place_of
from gpusimbench.evaluator.diff.result import Difference, Divergence
from gpusimbench.evaluator.diff.words import differ
from gpusimbench.evaluator.json_values import document_of, dump, entry, picked
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Code,
    Document,
    Item,
    Items,
    Section,
    Text,
    Tone,
    facts,
    items,
    table,
)
from gpusimbench.evaluator.runs.groups import shown_status
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import engine_name
from gpusimbench.schemas.text import cut, few, first, plural

_TICKS = {True: "[x]", False: "[ ]", None: "[?]"}  # plain characters: no terminal shows them alike

_GIVES = {
    AuditLevel.BIT_IDENTICAL: ("Re-execution gives the same bits", Tone.GOOD),
    AuditLevel.SAME_UP_TO_ENV_ORDER: ("Re-execution gives the same bits, in environments of another order", Tone.GOOD),
    AuditLevel.WITHIN_ULPS: ("Re-execution gives other bits, no number further apart than the allowed ULPs", Tone.GOOD),
    AuditLevel.SAME_DISTRIBUTION: ("Re-execution gives other bits; no difference in distribution is found", Tone.GOOD),
    AuditLevel.DIFFERENT: ("Re-execution gives another distribution", Tone.BAD),
}

_NO_VERDICT = {
    Outcome.MADE: "the replay cannot be compared",
    Outcome.NOT_TRIED: "there is nothing to replay",
    Outcome.REFUSED: "the replay was refused",
    Outcome.STOPPED: "the replay was stopped",
    Outcome.FAILED: "no replay came to its end",
}

_VALUE, _COMMAND = 60, 200
_FILES, _NAMES, _NOTES = 3, 4, 3

Pairs = list[tuple[str, Cell | str]]


def audit_document(audit: Audit, checked: Check, *, every: bool = False) -> Document:
    """The verdict and what it rests on; with `every`, all replays, levels and values of settings."""
    blocks: list[Block] = [_verdict(audit, checked), facts(*_facts(audit, checked, every))]
    if audit.difference is not None:
        blocks += _notes(audit.difference, every)
    if audit.replays is not None:
        blocks += [
            Text(f"  {'refused' if audit.replays.refused else 'run here'}:"),
            Code((audit.replays.command,)),
        ]
    recorded = (Code((cut(" ".join(audit.originals[0].provenance.argv), _COMMAND),)),)
    sections = [Section("command", "command of the recording", recorded)]
    if len(audit.recordings) > _FILES:
        paths = items(*(f"  {recording.path}" for recording in audit.recordings))
        sections.append(Section("replays", "complete replays", (paths,)))
    if audit.settings.deciding:
        rows = [[setting.name, cut(setting.a, _VALUE), cut(setting.b, _VALUE)] for setting in audit.settings.deciding]
        sections.append(Section("settings", "settings", (table("settings", "", ("name", "there", "here"), rows),)))
    if every:
        blocks += sections
    else:
        blocks.append(Text(f"  more with --all: {', '.join(section.title for section in sections)}", Tone.QUIET))
    return Document("", tuple(blocks))


def _verdict(audit: Audit, checked: Check) -> Text:
    others = len(audit.originals) - 1
    name = audit.originals[0].path.name + (f" and {others} more of its set" if others else "")
    gives, tone = _answer(audit)
    if any(checked.broken.get(recording.path) for recording in audit.originals):
        return Text(f"{gives}; {'a file' if others else 'the file'} breaks {RULES}: {name}", Tone.BAD)
    return Text(f"{gives}: {name}", tone)


def _answer(audit: Audit) -> tuple[str, Tone]:
    if audit.invalid:
        return f"A replay is invalid, and the recording is not ({AuditLevel.DIFFERENT.value})", Tone.BAD
    if audit.level is not None:
        gives, tone = _GIVES[audit.level]
        return f"{gives} ({audit.level.value})", tone
    if audit.verdict is None:
        return f"No verdict: {_NO_VERDICT[audit.outcome]}", Tone.WARNING
    if any(rung.level is AuditLevel.BIT_IDENTICAL and rung.holds is False for rung in audit.verdict.rungs):
        return "Re-execution gives other bits; undecided whether of the same distribution", Tone.WARNING
    return "Re-execution gives the same bits as far as compared; not everything was compared", Tone.WARNING


def _facts(audit: Audit, checked: Check, every: bool) -> Pairs:
    pairs: Pairs = []
    if audit.why_not and (audit.recordings or not audit.failed):  # what failed says it itself
        pairs.append(("reason", audit.why_not))
    pairs += [*_recording(audit), ("content hash", audit.originals[0].content_hash), ("check", _check(audit, checked))]
    replays = [f"{replay.status}: {replay.reason}" for replay in audit.failed]
    replays += first([f"complete: {recording.path}" for recording in audit.recordings], _FILES)
    if replays:
        pairs.append(("replays", Cell(replays[0], notes=tuple(replays[1:]))))
    if audit.recordings:
        pairs.append(("runs", _distinct(audit)))
    if audit.verdict is not None:
        level = audit.verdict.level
        follows = [rung.holds and rung.level is not level for rung in audit.verdict.rungs]
        pairs += [_rung(rung) for rung, below in zip(audit.verdict.rungs, follows, strict=True) if every or not below]
    if audit.difference is not None:
        program = audit.difference.program
        if program is not None and program.first is not None:
            said = words.sentence(program, program.first, "original and replay", audit.difference.a.dt)
            pairs.append(("differs", said))
        elif audit.difference.first is not None:
            pairs.append(("differs", _first(audit.difference.first)))
        pairs.append(("settings", _settings(audit, audit.difference)))
    return pairs


def _recording(audit: Audit) -> Pairs:
    original = audit.originals[0]
    c, simulation = original.configuration, original.simulation
    version = f" {simulation.version}" if simulation else ""
    where = original.provenance.host.get("cpu", "")
    device = simulation.device if simulation else ""
    machine = where if device in ("", "cpu", where) else f"{device}, {where}"
    engine = engine_name(c.simulator, simulation)
    said = f"{engine}{version}, {c.scene}, {plural(c.n_env, 'env')}, dt {c.dt:g} s, {shown_status(original)}"
    return [("recording", said), ("recorded", f"{original.provenance.created_utc}, {machine}")]


def _check(audit: Audit, checked: Check) -> Cell:
    paths = [recording.path for recording in audit.originals]
    broken = dict.fromkeys(sentence for path in paths for sentence in checked.broken.get(path, ()))
    warnings = dict.fromkeys(sentence for path in paths for sentence in checked.warnings.get(path, ()))
    holds = "is broken" if broken else "holds, with warnings" if warnings else "holds"
    tone = Tone.BAD if broken else Tone.WARNING if warnings else Tone.PLAIN
    return Cell(f"{RULES} {holds}", notes=(*broken, *warnings), tone=tone)


def _distinct(audit: Audit) -> str:
    there, here = len(audit.originals), len(audit.recordings)
    if audit.distinct is None:
        return f"{plural(there, 'original')}, {plural(here, 'replay')}; without state hashes, bits are not compared"
    distinct_there, distinct_here, both = audit.distinct
    originals = f"{plural(there, 'original')}, {distinct_there} distinct by state hashes"
    return f"{originals}; {plural(here, 'replay')}, {distinct_here} distinct; {both} distinct together"


def _rung(rung: Rung) -> tuple[str, Cell]:
    return f"{_TICKS[rung.holds]} {rung.level.value}", Cell(rung.said)


def _first(first: Divergence) -> Cell:
    of = " of the timed phase" if first.phase == "timed" else ""
    envs = f"first in env {first.env_a}, in {plural(first.envs, 'env')} at that step"
    gap = equal_before(first) if gap_before(first) else ""
    said = f"from step {first.step_a} ({first.time:g} s){of}{gap}{';' if gap else ','} {envs}"
    if first.state is None:
        return Cell(said)
    n, at = first.state.number, first.state
    later = "" if first.located else f" (first recorded state: step {at.step})"
    number = ", ".join(filter(None, (f"{place_of(n)}{later}: {n.a} there", f"{n.b} here", apart(n, named=True))))
    return Cell(said, notes=(number,))


def _settings(audit: Audit, difference: Difference) -> str:
    deciding, packages = audit.settings.deciding, audit.settings.packages
    more = f"{plural(packages, 'other installed package')}" if packages else ""
    if not deciding:
        return f"the same{f' but for {more}' if more else ''}"
    names = few([setting.name for setting in deciding], _NAMES)
    same = ", although the bits are the same" if difference.bit_identical else ""
    return f"{differ(len(deciding))}{same}: {names}{f'; and {more}' if more else ''}"


def _notes(difference: Difference, every: bool) -> list[Block]:
    notes = [f"  note: {note}" for note in (*difference.compared.left_out, *difference.notes)]
    if not every and len(notes) > _NOTES + 1:
        notes = [*notes[:_NOTES], f"  and {len(notes) - _NOTES} more notes, printed with --all"]
    return [Items(tuple(map(Item, notes)))] if notes else []


def dump_json(audits: Sequence[Audit], checked: Check, required: AuditLevel) -> str:
    """What ``gsb-audit --json`` writes."""
    document = {
        "require": required,
        "audits": [_audit(audit, required) for audit in audits],
        "rules": RULES,
        "damaged": _findings(checked.damaged),
        "broken": _findings(checked.broken),
        "warnings": _findings(checked.warnings),
    }
    return dump(document_of(document))


def _findings(found: Mapping[Place, tuple[str, ...]]) -> list[dict[str, Any]]:
    return [{"file": path, "findings": sentences} for path, sentences in found.items()]


def _audit(audit: Audit, required: AuditLevel) -> dict[str, Any]:
    d, replays = audit.difference, audit.replays
    return {
        "originals": [_recording_record(r) for r in audit.originals],
        "command": replays.command if replays else None,
        "outcome": audit.outcome,
        "replays": replays.made if replays else [],
        "compared": [_recording_record(r) for r in audit.recordings],
        **entry("level", audit.level, "" if audit.level else audit.why_not),
        "meets_requirement": audit.meets(required),
        **entry("rungs", audit.verdict.rungs if audit.verdict else [], audit.why_not),
        "law": audit.verdict.law if audit.verdict else None,
        "difference": None
        if d is None
        else {
            "a": d.a.file,
            "b": d.b.file,
            **picked(d, "bit_identical same_up_to_env_order max_ulp compared first program notes"),
        },
        "settings": audit.settings.deciding,
        "other_packages": audit.settings.packages,
    }


def _recording_record(recording: Recording) -> dict[str, Any]:
    made = recording.provenance
    return {
        "file": recording.path,
        "run_id": made.run_id,
        "content_hash": recording.content_hash,
        "status": recording.status,
        "replay_of": made.replay_of,
    }
