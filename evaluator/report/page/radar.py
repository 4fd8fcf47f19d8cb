"""Six axes scaled over the groups that can be compared."""

from __future__ import annotations

from markupsafe import Markup

from evaluator.metrics.radar import Axis
from evaluator.report.figures import lines, radar_chart
from evaluator.report.page.section import Section, Source

_AXIS_UNITS = {
    Axis.THROUGHPUT: "env-steps/s",
    Axis.MEMORY: "GB",
    Axis.EMD_TO_REAL: "cm",
    Axis.PARALLEL: "cm",
    Axis.RUN_TO_RUN: "cm",
}


def section(source: Source) -> Section:
    """The figure, and the values that it scales."""
    compared = source.evaluation.comparison
    context = {
        "radar": Markup(radar_chart.radar_chart(compared.radar)) if compared.radar else None,
        "contenders": compared.contenders,
        "axes": list(Axis),
        "axis_units": _AXIS_UNITS,
        "swatches": [Markup(lines.swatch(i)) for i in range(len(compared.contenders))],
    }
    return Section("radar", "Radar", context)
