"""Environments in motion, a group at a time, coloured by which of them are bit-identical so far."""

from __future__ import annotations

from gpusimbench.evaluator.player.markup import markup, script, style
from gpusimbench.evaluator.report.page.section import Section, Source


def section(source: Source) -> Section | None:
    """None where nothing can be played."""
    found = source.playback
    if found is None or not (found.clips or found.not_shown):
        return None
    context = {"player": markup(found.clips) if found.clips else None, "not_shown": found.not_shown}
    if not found.clips:
        return Section("playback", "Playback", context)
    return Section("playback", "Playback", context, style=style(), script=script())
