"""The answers of a probe as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gpusimbench.evaluator.json_values import document_of, dump, picked, values_of
from gpusimbench.evaluator.probe.finding import Finding, verdict_of
from gpusimbench.evaluator.probe.questions import Probed


def dump_probe(probed: Sequence[Probed], prices: Sequence[dict[str, Any]]) -> str:
    """The document that ``gsb-probe --json`` writes; `prices` are records of what levels of determinism cost."""
    probes = [probe_record(one) for one in probed]
    return dump(document_of({"probes": probes, "prices": prices}))


def probe_record(probed: Probed) -> dict[str, Any]:
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
