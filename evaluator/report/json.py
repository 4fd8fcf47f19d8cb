"""An evaluation as JSON, for programs; and the answers of a probe."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.json_values import document_of, dump, entry, picked, values_of
from gpusimbench.evaluator.metrics.divergence import FIT_LIMIT_M, first_reaching
from gpusimbench.evaluator.metrics.memory import MemoryModel
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.probe.finding import Finding, verdict_of
from gpusimbench.evaluator.probe.questions import Probed
from gpusimbench.evaluator.report.sections.mechanics import fidelity_record
from gpusimbench.evaluator.report.timed import timed_record
from gpusimbench.evaluator.results.canonical import Law, Unmeasured
from gpusimbench.evaluator.results.convergence import Convergence
from gpusimbench.evaluator.results.determinism_cost import Cost, Family, Price
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.faults import Faults, faults
from gpusimbench.evaluator.results.fidelity import CheckVerdict
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.paper_tables import AtMax, Capability, capability
from gpusimbench.evaluator.results.ranking import Contender
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.results.result import GroupResult, RunSpread
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
        "compared": [_contender(contender) for contender in comparison.contenders],
        "guidelines": comparison.guidelines,
        "protocol": {"rules": PROTOCOL, "findings": evaluation.unmet.count, "by_rule": dict(evaluation.unmet.findings)},
        "price_list": [_family(family) for family in evaluation.price_list],
        "probes": [_probe(one) for one in evaluation.probed],
        "capability": [_capability(row) for row in capability(evaluation.sweeps, evaluation.results)],
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
    """The JSON document of an evaluation as text, ending in a newline."""
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
        "faults": _faults(faults(result)),
        "divergence": [_apart(one) for one in result.spreads],
        "physics": fidelity_record(result.fidelity),
        "laws": [_law(law) for law in result.laws],
        "deviations": _deviations(result),
        "notes": result.notes,
    }


def _law(law: Law | Unmeasured) -> dict[str, Any]:
    if isinstance(law, Unmeasured):
        return {**picked(law, "label scene key title"), "missing": law.reason}
    return {**values_of(law), "missing": ""}


def _faults(found: Faults) -> dict[str, str]:
    """`misplaced` where there is something to say."""
    return {name: said for name, said in vars(found).items() if said or name != "misplaced"}


def _validity(validity: Validity) -> dict[str, Any]:
    return {
        "counters": validity.counted,
        "buffers": [{**vars(b.buffer), "needed": b.needed, "share": b.share} for b in validity.buffers],
        "overflow": validity.overflow,
        "overflow_told_by_all": validity.overflow_told.yes,
        "actions": validity.actions,
        **({"misplaced_contacts": validity.misplaced} if validity.misplaced else {}),
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


def _family(family: Family) -> dict[str, Any]:
    """A configuration under all its levels of determinism."""
    first = family.base or family.prices[0].result
    return {
        **picked(first.group.key, "simulator scene n_env device"),
        "options": first.group.recordings[0].configuration.options,
        "default": _level(family.base) if family.base else None,
        "levels": [_level_price(price) for price in family.prices],
    }


def _capability(row: Capability) -> dict[str, Any]:
    """A simulator at its N_env^max, by scene."""
    return {
        "label": row.label,
        **picked(row.key, "simulator version device determinism"),
        "elsewhere": list(row.elsewhere),
        "scenes": {scene: _at_max(at) for scene, at in row.at.items()},
    }


def _contender(contender: Contender) -> dict[str, Any]:
    """What radar, dot plots and guidelines are made of; a value that is missing has its reason."""
    checked = contender.group.fidelity if contender.group else None
    return {
        "name": contender.figures.name,
        "group": contender.group.label if contender.group else None,
        "sweep": contender.sweep.label if contender.sweep else None,
        "sweep_with_robot": contender.robot.label if contender.robot else None,
        "n_env_max": contender.figures.n_max,
        "values": {
            axis.value: entry("value", found) if isinstance(found, Missing) else estimate_record(found)
            for axis, found in contender.metrics.items()
        },
        "checks_broken": len(checked.of(CheckVerdict.BROKEN)) if checked and checked.rows else None,
        "checks_held": checked.held if checked and checked.rows else None,
        "checks_by": checked.revision.value if checked and checked.rows else None,
        "timed": timed_record(contender.speed.timed) if contender.speed else None,
        "barred": contender.figures.barred,
        "barred_with_robot": contender.figures.barred_articulated,
    }


def _level(result: GroupResult) -> dict[str, Any]:
    return {
        "group": result.label,
        "determinism": result.group.key.determinism,
        "outcomes": result.group.outcomes,
        "distinct_envs": known(result.metrics["distinct_envs"].value),
        "distinct_runs": known(result.metrics["distinct_runs"].value),
        "faults": _faults(faults(result)),
        "timed": timed_record(result.timed),
    }


def _level_price(price: Price) -> dict[str, Any]:
    costs = {"throughput_of_default": _cost(price.speed), "memory_of_default": _cost(price.memory)}
    return {**_level(price.result), "in_force": list(price.differs), **costs}


def _cost(cost: Cost) -> dict[str, Any]:
    return {**picked(cost, "ratio ci95"), "cannot_be_told_apart_from_1": cost.undecided}


def _at_max(at: AtMax) -> dict[str, Any]:
    return {
        "n_env_max": at.n_max,
        "fps": estimate_record(at.fps) if at.fps else None,
        "memory": estimate_record(at.memory) if at.memory else None,
        "limit": at.limit.name.lower(),
        "ends": at.ends,
        "contacts_per_env": at.contacts,
        "timed": timed_record(at.timed) if at.timed else None,
        "faults": _faults(at.faults),
    }


def estimate_record(estimate: Estimate) -> dict[str, Any]:
    """The figures of an estimate, or why there are none."""
    return {"metric": estimate.name, **picked(estimate, "value unit sd ci95 n")}


def _apart(one: RunSpread) -> dict[str, Any]:
    found = one.spread
    if isinstance(found, Missing):
        return {"run": one.run, "missing": found.reason}
    times, largest = np.array(found.times), np.array([np.nan if v is None else v for v in found.largest])
    apart = np.flatnonzero(largest > 0)
    return {
        "run": one.run,
        "missing": "",
        "recorded_steps": len(found.steps),
        "first_apart_s": float(times[apart[0]]) if len(apart) else None,
        "reaches_limit_s": first_reaching(times, largest, FIT_LIMIT_M),
        f"limit_{found.unit}": FIT_LIMIT_M,
        f"largest_at_end_{found.unit}": found.largest[-1],
        f"rms_at_end_{found.unit}": found.rms[-1],
        **picked(found, "fit"),
    }


def dump_probe(probed: Sequence[Probed], prices: Sequence[Family]) -> str:
    """The document that ``gsb-probe --json`` writes, with what levels of determinism cost."""
    return dump(document_of({"probes": [*map(_probe, probed)], "prices": [*map(_family, prices)]}))


def _probe(probed: Probed) -> dict[str, Any]:
    """One configuration and its answers."""
    arms, findings = probed
    return {
        **picked(arms.key, "simulator version device scene determinism options seed"),
        # what the arms of a probe differ in is no setting of all of them
        **{name: value for name, value in arms.key.told.items() if name not in ("initial", "intervention")},
        "n_env": arms.n_env,
        "numbers": sorted(arms.by_number),
        "verdict": verdict_of(findings),
        "failed": dict(arms.failed),
        "answers": [_finding(finding) for finding in findings],
    }


def _finding(finding: Finding) -> dict[str, Any]:
    found = None if finding.found is None else {**values_of(finding.found), "level": finding.found.level.name.lower()}
    return {**values_of(finding), "found": found}
