"""A comparison of two sets as JSON."""

from __future__ import annotations

from typing import Any

from gpusimbench.evaluator.compare import words
from gpusimbench.evaluator.compare.compare import Compared, Result, counts
from gpusimbench.evaluator.compare.finding import Finding
from gpusimbench.evaluator.json_values import dump, picked, values_of
from gpusimbench.evaluator.report.timed import timed_record
from gpusimbench.evaluator.results.metric import Axis

SCHEMA_VERSION = 1
"""Version of the JSON that ``gsb-compare --json`` prints."""


def dump_json(result: Result) -> str:
    """The document as text."""
    settings = result.settings
    return dump(
        {
            "schema_version": SCHEMA_VERSION,
            "verdict": words.headline(result),
            "exit_code": int(result.exit_code),
            "undecided": [axis.value for axis in result.undecided],
            "settings": {
                **picked(settings, "alpha threshold outcome_cm"),
                "gates": [axis.value for axis in Axis if axis in settings.gates],
                "expect_same": settings.expect_same,
                "statistical_comparisons": result.tests,
            },
            "compared": [_configuration(compared, result) for compared in result.compared],
            "without_partner": [{"side": s, "label": label, "reason": why} for s, label, why in result.alone],
            "unreadable": [
                {"side": side, "path": values_of(u.path), "error": str(u.error)} for side, u in result.unreadable
            ],
            "notes": list(result.notes),
        }
    )


def _configuration(compared: Compared, result: Result) -> dict[str, Any]:
    pair = compared.pair
    sides = {
        name: {
            **picked(group.key, "version device"),
            "complete": len(group.complete),
            "outcomes": group.outcomes,
            "timed": timed_record(work),
            "recordings": [
                {**picked(r, "path"), **picked(r.provenance, "run_id created_utc"), **picked(r, "status")}
                for r in group.recordings
            ],
        }
        for name, group, work in zip(("base", "head"), (pair.base, pair.head), compared.timed, strict=True)
    }
    return {
        "label": pair.label,
        **picked(pair.base.key, "simulator scene n_env dt"),
        **sides,
        **picked(pair, "differs same_machine"),
        "order": "".join("B" if head else "A" for head in compared.order.head),
        "interleaved": compared.order.interleaved,
        "findings": [_finding(finding, result) for finding in compared.findings],
        "warnings": list(compared.warnings),
        "notes": list(compared.notes),
    }


def _finding(finding: Finding, result: Result) -> dict[str, Any]:
    record: dict[str, Any] = values_of(finding)
    return {
        **record,
        "said": dict(zip(("base", "head"), finding.said, strict=True)),
        "n": dict(zip(("base", "head"), finding.n, strict=True)),
        "gated": counts(finding.axis, result.settings),
        "fails": finding.fails(result.settings),
        "undecided": finding.undecided(result.settings),
    }
