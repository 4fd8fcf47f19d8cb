"""Six axes scaled over the groups that can be compared."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from gpusimbench.evaluator.metrics.radar import Axis, Radar
from gpusimbench.evaluator.render.figures import lines, radar_chart
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.page.picture import Numbers, Picture
from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.results.metrics import on_radar
from gpusimbench.evaluator.results.ranking import Contender

_CAPTION = (
    "Rim: the best of these groups. Middle: the worst of them. The scale is relative: another set of groups gives "
    "another picture. An outline is open at an axis without a value. Where all groups are equal they stand at the rim."
)


def section(source: Source) -> Section:
    """The figure, and the values that it scales."""
    compared = source.evaluation.comparison
    names = {c.speed.label: c.figures.name for c in compared.contenders if c.speed}
    context = {
        "radar": _picture(compared.contenders, compared.radar) if compared.radar else None,
        "contenders": compared.contenders,
        "axes": [(axis, on_radar(axis)) for axis in Axis],
        "notes": timed.remarks((c.speed for c in compared.contenders if c.speed), named=lambda r: names[r.label]),
        "swatches": [Markup(lines.swatch(i)) for i in range(len(compared.contenders))],
    }
    return Section("radar", "Radar", context)


def _title(axis: Axis) -> str:
    shown = on_radar(axis)
    return shown.title if shown else axis.value


def _unit(axis: Axis) -> str:
    shown = on_radar(axis)
    return shown.unit if shown else "log2 of environments"


def _picture(contenders: Sequence[Contender], radar: Radar) -> Picture:
    rows = [
        (c.figures.name, _title(axis), value, _unit(axis), radar.values[c.figures.name][axis],
         c.why_not.get(axis, "") if value is None else "")
        for c in contenders for axis, value in c.figures.axis_values().items()
    ]  # fmt: skip
    titles = ("group", "axis", "value", "unit", "scaled: 1 is the best of these, 0 the worst", "why there is no value")
    title = "Six axes, scaled over these groups"
    if len(radar.values) > radar_chart.AT_MOST:
        why_not = (
            f"No radar: {len(radar.values)} groups are compared, and more than {radar_chart.AT_MOST} outlines cannot "
            "be told apart. The dot plots show the same values with intervals."
        )
        return Picture(title, why_not, None)
    svg = Markup(radar_chart.radar_chart(radar))
    return Picture(title, _CAPTION, svg, "radar", Numbers(titles, rows))
