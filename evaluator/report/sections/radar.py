"""Six axes scaled over the groups that can be compared."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from gpusimbench.evaluator.metrics.radar import Axis, Radar
from gpusimbench.evaluator.render.document import Figure, Numbers
from gpusimbench.evaluator.render.figures import radar_chart
from gpusimbench.evaluator.results.metrics import on_radar
from gpusimbench.evaluator.results.ranking import Contender

_CAPTION = (
    "Rim: the best of these groups. Middle: the worst of them. The scale is relative: another set of groups gives "
    "another picture. An outline is open at an axis without a value. Where all groups are equal they stand at the rim."
)


def _title(axis: Axis) -> str:
    shown = on_radar(axis)
    return shown.title if shown else axis.value


def _unit(axis: Axis) -> str:
    shown = on_radar(axis)
    return shown.unit if shown else "log2 of environments"


def picture(contenders: Sequence[Contender], radar: Radar) -> Figure:
    """The radar with the values that it scales; without a drawing where outlines could not be told apart."""
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
        return Figure(title, why_not, None)
    svg = Markup(radar_chart.radar_chart(radar))
    return Figure(title, _CAPTION, svg, "radar", Numbers(titles, rows))
