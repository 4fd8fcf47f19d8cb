"""An evaluation as JSON, for programs."""

from __future__ import annotations

import json
from typing import Any

from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.json_values import document_of, dump, entry, picked, values_of
from gpusimbench.evaluator.metrics.memory import MemoryModel
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.probe.json import probe_record
from gpusimbench.evaluator.report.evidence_json import (
    capability_record,
    contender_record,
    divergence_records,
    family_record,
    faults_record,
)
from gpusimbench.evaluator.report.sections.mechanics import fidelity_record
from gpusimbench.evaluator.report.timed import timed_record
from gpusimbench.evaluator.results.canonical import Law, Unmeasured
from gpusimbench.evaluator.results.convergence import Convergence
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.group_runs import Reference
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.paper_tables import capability
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import SOURCES, Accumulation, Sweep, SweepPoint
from gpusimbench.evaluator.results.validity import Validity
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.jackknife import Interval
from gpusimbench.evaluator.statistics.matched import Variability


def to_json(evaluation: Evaluation) -> dict[str, Any]:
    """The document that ``gsb-eval --json`` prints; plain JSON values only."""
    reference, comparison = evaluation.reference, evaluation.comparison
    document = {  # of results, which document_of makes JSON of
        "sample_time_s": evaluation.sample_time,
        **entry("reference", _reference(reference, evaluation) if reference else Missing(evaluation.reference_note)),
        "notes": evaluation.notes,
        "groups": [_group(result) for result in evaluation.results],
        "recordings": [
            *(_recording(r) for result in evaluation.results for r in result.group.recordings),
            *(
                {"file": str(u.path), "content_hash": None, "status": "unreadable", "reason": str(u.error)}
                for u in evaluation.unreadable
            ),
        ],
        "sweeps": [_sweep(sweep) for sweep in evaluation.sweeps],
        "accumulation": [_accumulation(one) for one in evaluation.accumulation],
        "convergence": [_convergence(one) for one in evaluation.convergences],
        "radar": {
            name: {axis.value: value for axis, value in axes.items()}
            for name, axes in (comparison.radar.values if comparison.radar else {}).items()
        },
        "compared": [contender_record(contender) for contender in comparison.contenders],
        "guidelines": comparison.guidelines,
        "protocol": {"rules": PROTOCOL, "findings": evaluation.unmet.count, "by_rule": dict(evaluation.unmet.findings)},
        "price_list": [family_record(family) for family in evaluation.price_list],
        "probes": [probe_record(one) for one in evaluation.probed],
        "capability": [capability_record(row) for row in capability(evaluation.sweeps, evaluation.results)],
    }
    return document_of(document)


def _reference(reference: Reference, evaluation: Evaluation) -> dict[str, Any]:
    return {"file": reference.path, **picked(reference, "label measured"), "note": evaluation.reference_note}


def _accumulation(one: Accumulation) -> dict[str, Any]:
    points = [
        {
            **picked(point, "n_env n_run size n_draw run_to_run_draw_sd parallel_draw_sd"),
            "matched": _variability(point.matched),
            **entry("raw", point.raw and _variability(point.raw)),
        }
        for point in one.points
    ]
    return {**picked(one, "label scene size draws seed"), "points": points}


def _variability(found: Variability) -> dict[str, Any]:
    return {
        "run_to_run": found.run_to_run and _interval(found.run_to_run),
        "parallel": found.parallel and _interval(found.parallel),
        "floor": found.floor,
    }


def _interval(found: Interval) -> dict[str, Any]:
    return {**picked(found, "estimate standard_error ci95"), "ci95_method": found.method}


def _convergence(one: Convergence) -> dict[str, Any]:
    found = one.found
    record = {
        **picked(one, "label scene"), "time_s": one.time, "finest_dt": one.finest, **picked(one, "what unit left_out"),
    }  # fmt: skip
    if isinstance(found, Missing):
        return {**record, **entry("order", found)}
    return {
        **record,
        **picked(found, "order ci95 asymptotic"),
        "dt": found.steps,
        "error": found.errors,
        "local_orders": [known(order) for order in found.local],
    }


def dump_json(evaluation: Evaluation) -> str:
    """The same as text, ending in a newline."""
    return dump(to_json(evaluation))


def _group(result: GroupResult) -> dict[str, Any]:
    key = result.group.key
    return {
        "label": result.label,
        **picked(key, "simulator version device scene n_env dt seed determinism"),
        **key.told,
        "options": key.parsed_options,
        "switches": json.loads(key.switches) if key.switches else {},
        "n_run": len(result.group.complete),
        "n_recording": len(result.group.recordings),
        "outcomes": result.group.outcomes,
        "metrics": {name: _metric(metric) for name, metric in result.metrics.items()},
        "timed": timed_record(result.timed),
        "validity": _validity(result.validity),
        "faults": faults_record(faults(result)),
        "divergence": divergence_records(result),
        "physics": fidelity_record(result.fidelity),
        "laws": [_law(law) for law in result.laws],
        "deviations": _deviations(result),
        "notes": result.notes,
    }


def _law(law: Law | Unmeasured) -> dict[str, Any]:
    if isinstance(law, Unmeasured):
        return {**picked(law, "label scene key title"), "missing": law.reason}
    return {**values_of(law), "missing": ""}


def _validity(validity: Validity) -> dict[str, Any]:
    return {
        "counters": validity.counted,
        "buffers": [{**vars(b.buffer), "needed": b.needed, "share": b.share} for b in validity.buffers],
        "overflow": validity.overflow,
        "overflow_told_by_all": validity.overflow_told.yes,
        "actions": validity.actions,
    }


def _sweep(sweep: Sweep) -> dict[str, Any]:
    return {
        "label": sweep.label,
        **picked(sweep.key, "simulator version device scene dt determinism"),
        **sweep.key.told,
        "n_env_max": sweep.n_max,
        **picked(sweep, "ends"),
        "points": [_point(point) for point in sweep.points],
        "memory_models": {name: model and _model(model) for name, model in sweep.models.items()},
    }


def _point(point: SweepPoint) -> dict[str, Any]:
    return {
        "n_env": point.n_env,
        "group": point.result.label,
        **{name: known(point.result.metrics[name].value) for name in ("fps", *SOURCES)},
        "timed": timed_record(point.result.timed),
        "n_run": point.complete,
        "n_recording": len(point.recordings),
        "failures": [failure._asdict() for failure in point.failures],
    }


def _model(model: MemoryModel) -> dict[str, Any]:
    return {
        "fixed_bytes": model.fixed,
        "per_env_bytes": model.per_env,
        "fixed_se_bytes": model.fixed_se,
        "per_env_se_bytes": model.per_env_se,
        "n_env": model.n,
        "relative_residuals": model.residuals,
        "largest_relative_residual": model.largest_residual,
        "worst_n_env": model.worst_n,
        "holds": model.holds,
        "missing": "",
    }


def _deviations(result: GroupResult) -> tuple[Any, ...]:
    return next((r.simulation.deviations for r in result.group.recordings if r.simulation), ())


def _metric(metric: Estimate) -> dict[str, Any]:
    return {
        **picked(metric, "value unit sd ci95 n"),
        "direction": metric.metric.direction,
        **picked(metric, "method exactness"),
        **({"extra": extra} if (extra := metric.details.record()) else {}),
    }


def _recording(recording: Run) -> dict[str, Any]:
    return {
        "file": str(recording.path),
        "content_hash": recording.content_hash or None,
        **picked(recording, "status reason cause"),
        "run_id": recording.provenance.run_id,
        "run_index": recording.configuration.run_index,
        "created_utc": recording.provenance.created_utc,
        "lost": list(recording.dropouts),
    }
