"""Audits as JSON, for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from evaluator.audit.audit import Audit
from evaluator.audit.checking import RULES, Check
from evaluator.audit.verdict import Level
from evaluator.recording import Recording

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
    return json.dumps(_plain(document), indent=1, allow_nan=False) + "\n"


def _findings(found: Mapping[Path, tuple[str, ...]]) -> list[dict[str, Any]]:
    return [{"file": path, "findings": sentences} for path, sentences in found.items()]


def _audit(audit: Audit, required: Level) -> dict[str, Any]:
    d, replays = audit.difference, audit.replays
    return {
        "originals": [_recording(r) for r in audit.originals],
        "command": replays.command if replays else None,
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
            "bit_identical": d.bit_identical,
            "same_up_to_env_order": d.same_up_to_env_order,
            "max_ulp": d.max_ulp,
            "compared": d.compared,
            "first": d.first,
            "notes": d.notes,
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


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Path):
        return str(value).encode("utf-8", "backslashreplace").decode()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
