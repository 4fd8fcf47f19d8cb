"""Six axes scaled over the groups that can be compared."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from gpusimbench.evaluator.metrics.radar import Axis, Radar
from gpusimbench.evaluator.render.figures import lines, radar_chart
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.page.picture import Numbers, Picture
from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.results.ranking import Contender

_AXIS_UNITS = {
    Axis.THROUGHPUT: "env-steps/s",
    Axis.MEMORY: "GB",
    Axis.EMD_TO_REAL: "cm",
    Axis.PARALLEL: "cm",
    Axis.RUN_TO_RUN: "cm",
}

_CAPTION = (
    "Rim: the best of these groups. Middle: the worst of them. The scale is relative: another set of groups gives "
    "another picture. An outline is open at an axis without a value. Where all groups are equal they stand at the rim."
)

_UNITS_OF_FILES = {**_AXIS_UNITS, Axis.PARALLELISM: "log2 of environments"}


def section(source: Source) -> Section:
    """The figure, and the values that it scales."""
    compared = source.evaluation.comparison
    names = {c.speed.label: c.figures.name for c in compared.contenders if c.speed}
    context = {
        "radar": _picture(compared.contenders, compared.radar) if compared.radar else None,
        "contenders": compared.contenders,
        "axes": list(Axis),
        "axis_units": _AXIS_UNITS,
        "notes": timed.remarks((c.speed for c in compared.contenders if c.speed), named=lambda r: names[r.label]),
        "swatches": [Markup(lines.swatch(i)) for i in range(len(compared.contenders))],
    }
    return Section("radar", "Radar", context)


def _picture(contenders: Sequence[Contender], radar: Radar) -> Picture:
    rows = [
        (c.figures.name, axis.value, value, _UNITS_OF_FILES.get(axis, ""), radar.values[c.figures.name][axis],
         c.why_not.get(axis, "") if value is None else "")
        for c in contenders for axis, value in c.figures.axis_values().items()
    ]  # fmt: skip
    titles = ("group", "axis", "value", "unit", "scaled: 1 is the best of these, 0 the worst", "why there is no value")
    svg = Markup(radar_chart.radar_chart(radar))
    return Picture("Six axes, scaled over these groups", _CAPTION, svg, "radar", Numbers(titles, rows))
