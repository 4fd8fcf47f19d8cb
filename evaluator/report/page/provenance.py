"""Where everything comes from, and how every metric was computed."""

from __future__ import annotations

from typing import Any

from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.run import Run


def section(source: Source) -> Section:
    """For every group what was asked, what the engine said, the machines and the commands."""
    groups = [(result, _simulation_of(result), _origins(result)) for result in source.evaluation.results]
    return Section("provenance", "Provenance", {"groups": groups})


def _simulation_of(result: GroupResult) -> Any:
    return next((r.simulation for r in result.group.recordings if r.simulation), None)


def _origins(result: GroupResult) -> list[tuple[str, Run]]:
    """One recording for each machine and software that the group's runs come from, with those runs' indices."""
    alike: dict[str, list[Run]] = {}
    for recording in result.group.recordings:
        p = recording.provenance
        alike.setdefault(repr((p.host, p.gpus, p.software, p.environment)), []).append(recording)
    return [(", ".join(str(r.configuration.run_index) for r in runs), runs[0]) for runs in alike.values()]
