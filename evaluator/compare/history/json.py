"""A history as JSON."""

from __future__ import annotations

from typing import Any

from gpusimbench.evaluator.compare.history.curves import Curve
from gpusimbench.evaluator.compare.history.history import Fact, History, Traced
from gpusimbench.evaluator.compare.history.series import ORDER
from gpusimbench.evaluator.compare.history.words import headline
from gpusimbench.evaluator.json_values import document_of, dump, picked, values_of
from gpusimbench.evaluator.results.metric import Axis


def dump_json(history: History) -> str:
    """The document as text."""
    settings = history.settings
    return dump(
        document_of({
            "verdict": headline(history),
            "exit_code": int(history.exit_code),
            "order": ORDER,
            "settings": {
                **picked(settings, "alpha threshold outcome_cm"),
                "gates": [axis.value for axis in Axis if axis in settings.gates] if history.gated else [],
                "curves_tested": history.tests,
            },
            "points": [
                {
                    "label": point.label,
                    "begins_utc": point.begins or None,
                    "n_recording": len(point.runs),
                    "unreadable": [{"file": values_of(u.path), "reason": str(u.error)} for u in point.unreadable],
                }
                for point in history.points
            ],
            "configurations": [_configuration(one, history) for one in history.traced],
            "undecided": [
                {
                    "label": one.series.heading,
                    "device": one.series.device,
                    "axis": axis.value,
                    "title": title,
                    "reason": why,
                }
                for one, axis, title, why in history.undecided
            ],
            "notes": list(history.notes),
        })
    )  # fmt: skip


def _configuration(one: Traced, history: History) -> dict[str, Any]:
    return {
        "label": one.series.label,
        **picked(one.series.key, "simulator scene n_env dt determinism"),
        "device": one.series.device,
        "groups": [
            {
                "point": entry.point,
                "version": entry.group.key.version,
                "n_run": len(entry.group.complete),
                "outcomes": entry.group.outcomes,
            }
            for entry in one.series.entries
        ],
        "curves": [_curve(curve, history) for curve in one.curves],
        "facts": [_fact_record(fact, history) for fact in one.facts],
    }


def _curve(curve: Curve, history: History) -> dict[str, Any]:
    metric = curve.metric
    return {
        **picked(metric, "name title unit"),
        "axis": curve.axis.value,
        **picked(metric, "direction method"),
        "scale": "logarithm" if curve.logs else "value",
        "exact": curve.exact,
        "smallest_visible": curve.visible,
        "changes_missing": curve.changes_missing,
        "samples": [picked(sample, "point value ci95 n") for sample in curve.samples],
        "changes": [
            {**values_of(shift), "label": history.points[shift.point].label, "exact": curve.exact}
            for shift in curve.shifts
        ],
    }


def _fact_record(fact: Fact, history: History) -> dict[str, Any]:
    finding = fact.finding
    return {
        **picked(fact, "point previous"),
        "label": history.points[fact.point].label,
        **picked(finding, "axis name title change"),
        "said": {"before": finding.said[0], "after": finding.said[1]},
        "before": finding.base,
        "after": finding.head,
        "unit": finding.unit,
        "note": finding.note or None,
    }
