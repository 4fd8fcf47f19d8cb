"""Environments in motion, a group at a time, coloured by which of them are bit-identical so far."""

from __future__ import annotations

from markupsafe import Markup

from gpusimbench.evaluator.player.markup import markup, script, style
from gpusimbench.evaluator.render.document import Block, Embed, Item, Items, Section, Text
from gpusimbench.evaluator.render.numbers import plural
from gpusimbench.evaluator.report.source import Source

_HOW = (
    "Environments of a group over simulated time, all its complete runs together. Environments whose states were "
    "bit-identical at every step so far have one colour: colours split where bits split. One environment of each class "
    "is shown, those that split off first; groups that part first come first. Groups that only "
    "gsb-probe needs are left out."
)


def section(source: Source) -> Section | None:
    """None where nothing can be played."""
    found = source.playback
    if found is None or not (found.clips or found.not_shown):
        return None
    blocks: list[Block] = []
    if found.clips:
        blocks += [Text(_HOW), Embed(markup(found.clips), Markup(style()), Markup(script()))]
    if found.not_shown:
        not_shown = tuple(Item(f"{', '.join(one.labels)}: {one.reason}") for one in found.not_shown)
        blocks.append(Section("not-played", "Not shown", (Items(not_shown),)))
    said = f"{plural(len(found.clips), 'group')} to watch" if found.clips else "no group to watch"
    return Section("playback", "Playback", tuple(blocks), said, folded=True)
