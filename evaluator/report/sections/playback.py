"""Environments in motion, a group at a time, coloured by which of them are bit-identical so far."""

from __future__ import annotations

from markupsafe import Markup

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.player.page import markup, script, style
from gpusimbench.evaluator.render.document import Block, Embed, Item, Items, Section, Text
from gpusimbench.evaluator.report.sections.rows import without
from gpusimbench.evaluator.report.source import Source
from gpusimbench.schemas.text import plural

_HOW = (
    "Environments of a group over simulated time, all its complete runs together. Environments whose states were "
    "bit-identical at every step so far have one colour: colours split where bits split. One environment of each class "
    "is shown, those that split off first; groups that part first come first. Groups that only "
    "gsb-probe needs are left out."
)


def section(source: Source) -> Section | Missing | None:
    """None where playback was not asked for or nothing was captured, Missing where no group can be shown."""
    found = source.playback
    if found is None or not (found.clips or found.not_shown):
        return None
    if not found.clips:
        return without("Playback", (f"{'; '.join(one.labels)}: {one.reason}" for one in found.not_shown))
    blocks: list[Block] = [Text(_HOW), Embed(markup(found.clips), Markup(style()), Markup(script()))]
    if found.not_shown:
        not_shown = tuple(Item(f"{'; '.join(one.labels)}: {one.reason}") for one in found.not_shown)
        blocks.append(Section("not-played", "Not shown", (Items(not_shown),)))
    return Section("playback", "Playback", tuple(blocks), f"{plural(len(found.clips), 'group')} to watch", folded=True)
