"""An evaluation as JSON, for programs."""

from __future__ import annotations

import json
import math
from typing import Any

from evaluator.recording import Recording
from evaluator.results import SCHEMA_VERSION, Evaluation, GroupResult, Metric


def to_json(evaluation: Evaluation) -> dict[str, Any]:
    """The document that ``gsb-eval --json`` prints; plain JSON values only."""
    reference = evaluation.reference
    document = {
        "schema_version": SCHEMA_VERSION,
        "sample_time_s": evaluation.sample_time,
        "reference": {"file": str(reference.path), "label": reference.label, "measured": reference.measured}
        if reference
        else None,
        "reference_note": evaluation.reference_note,
        "notes": list(evaluation.notes),
        "groups": [_group(result) for result in evaluation.results],
        "recordings": [
            *(_recording(r) for result in evaluation.results for r in result.group.recordings),
            *(
                {"file": str(u.path), "content_hash": None, "status": "unreadable", "reason": str(u.error)}
                for u in evaluation.unreadable
            ),
        ],
        "radar": {
            name: {axis.value: value for axis, value in axes.items()}
            for name, axes in (evaluation.radar.values if evaluation.radar else {}).items()
        },
        "guidelines": [vars(g) for g in evaluation.guidelines],
    }
    plain: dict[str, Any] = _plain(document)
    return plain


def dump_json(evaluation: Evaluation) -> str:
    """The same as text, ending in a newline."""
    return json.dumps(to_json(evaluation), indent=1, allow_nan=False) + "\n"


def _group(result: GroupResult) -> dict[str, Any]:
    key = result.group.key
    return {
        "label": result.label,
        "simulator": key.simulator,
        "version": key.version,
        "device": key.device,
        "scene": key.scene,
        "n_env": key.n_env,
        "dt": key.dt,
        "seed": key.seed,
        "options": json.loads(key.options),
        "switches": json.loads(key.switches) if key.switches else {},
        "n_run": len(result.group.complete),
        "n_recording": len(result.group.recordings),
        "metrics": {name: _metric(metric) for name, metric in result.metrics.items()},
        "deviations": [vars(d) for d in _deviations(result)],
        "notes": list(result.notes),
    }


def _deviations(result: GroupResult) -> tuple[Any, ...]:
    return next((r.simulation.deviations for r in result.group.recordings if r.simulation), ())


def _metric(metric: Metric) -> dict[str, Any]:
    return {
        "value": metric.value,
        "unit": metric.unit,
        "sd": metric.sd,
        "ci95": list(metric.ci95) if metric.ci95 else None,
        "n": metric.n,
        "direction": metric.direction,
        "method": metric.method,
        "exactness": metric.exactness,
        "why_not": metric.why_not,
        **({"extra": metric.extra} if metric.extra else {}),
    }


def _recording(recording: Recording) -> dict[str, Any]:
    return {
        "file": str(recording.path),
        "content_hash": recording.content_hash or None,
        "status": recording.status,
        "reason": recording.reason,
        "run_id": recording.provenance.run_id,
        "run_index": recording.configuration.run_index,
        "created_utc": recording.provenance.created_utc,
        "lost": list(recording.dropouts),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return _plain(value.item())
