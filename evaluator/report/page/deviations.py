"""Parameters of a scene that engines could not honour."""

from __future__ import annotations

from evaluator.report.page.section import Section, Source
from evaluator.results import Evaluation
from schemas.provenance import Deviation


def section(source: Source) -> Section:
    """Every deviation, with the groups that it holds for."""
    return Section(
        "deviations", "Deviations from the scene", {"deviations": _deviations(source.evaluation)}, link="Deviations"
    )


def _deviations(evaluation: Evaluation) -> list[tuple[Deviation, list[str]]]:
    """Every parameter that was not honoured, once, with the groups that it holds for."""
    found: dict[Deviation, list[str]] = {}
    for result in evaluation.results:
        simulation = next((r.simulation for r in result.group.recordings if r.simulation), None)
        for deviation in dict.fromkeys(simulation.deviations if simulation else ()):
            found.setdefault(deviation, []).append(result.label)
    return list(found.items())
