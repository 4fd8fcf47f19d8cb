"""Audits as JSON, for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gpusimbench.evaluator.audit.audit import Audit
from gpusimbench.evaluator.audit.checking import RULES, Check
from gpusimbench.evaluator.audit.verdict import Level
from gpusimbench.evaluator.json_values import dump, picked, values_of
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.location import Place

SCHEMA_VERSION = 1


def dump_json(audits: Sequence[Audit], checked: Check, required: Level) -> str:
    """What ``gsb-audit --json`` writes."""
    document = {
        "schema_version": SCHEMA_VERSION,
        "require": required,
        "audits": [_audit(audit, required) for audit in audits],
        "rules": RULES,
        "damaged": _findings(checked.damaged),
        "broken": _findings(checked.broken),
        "warnings": _findings(checked.warnings),
    }
    return dump(values_of(document))


def _findings(found: Mapping[Place, tuple[str, ...]]) -> list[dict[str, Any]]:
    return [{"file": path, "findings": sentences} for path, sentences in found.items()]


def _audit(audit: Audit, required: Level) -> dict[str, Any]:
    d, replays = audit.difference, audit.replays
    return {
        "originals": [_recording(r) for r in audit.originals],
        "command": replays.command if replays else None,
        "outcome": audit.outcome,
        "replays": replays.made if replays else [],
        "compared": [_recording(r) for r in audit.recordings],
        "level": audit.level,
        "meets_requirement": audit.meets(required),
        "why_not": audit.why_not,
        "rungs": audit.verdict.rungs if audit.verdict else [],
        "law": audit.verdict.law if audit.verdict else None,
        "difference": None
        if d is None
        else {
            "a": d.a.path,
            "b": d.b.path,
            **picked(d, "bit_identical same_up_to_env_order max_ulp compared first program notes"),
        },
        "settings": audit.settings.deciding,
        "other_packages": audit.settings.packages,
    }


def _recording(recording: Recording) -> dict[str, Any]:
    made = recording.provenance
    return {
        "file": recording.path,
        "run_id": made.run_id,
        "content_hash": recording.content_hash,
        "status": recording.status,
        "replay_of": made.replay_of,
    }
