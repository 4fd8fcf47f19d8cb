"""A clip in sentences, for readers whose browser runs no scripts, and for a terminal."""

from __future__ import annotations

from gpusimbench.evaluator.player.clip import Clip
from gpusimbench.schemas.text import few

_MOST_SPLITS = 8


def sentences(clip: Clip) -> list[str]:
    """What the player shows, and what it does not."""
    shown = "; ".join(track.label for track in clip.tracks)
    return [f"Shown: {shown}.", _divergence(clip), *(f"{note[0].upper()}{note[1:]}." for note in clip.notes)]


def distinct(clip: Clip) -> str:
    """How many different environments there are in the end, so far as that is known."""
    if clip.changes is None:
        return f"not compared: {clip.not_compared}"
    return f"{clip.changes.so_far[-1]} of {clip.n_member} {clip.whose}"


def first_divergence(clip: Clip) -> str:
    """The step and time at which the first of them part."""
    if clip.changes is None:
        return "not known: bits are not compared"
    if clip.n_member < 2:
        return "none: there is one environment"
    first = clip.changes.first_divergence
    if first is None:
        return f"none up to step {clip.changes.last_compared}"
    return f"step {first} ({first * clip.dt:g} s)"


def _divergence(clip: Clip) -> str:
    found = clip.changes
    if found is None:
        return f"Bits are not compared: {clip.not_compared}."
    if clip.n_member < 2:
        return "There is one environment; there is nothing to compare its bits with."
    if found.first_divergence is None:
        return f"All {clip.n_member} {clip.whose} are bit-identical up to step {found.last_compared}."
    told = [
        f"{count} from step {step}"
        for step, count in zip(found.steps.tolist(), found.so_far.tolist(), strict=True)
        if step in set(found.splits.tolist())
    ]
    return (
        f"The {clip.n_member} {clip.whose} first differ at step {found.first_divergence} "
        f"({found.first_divergence * clip.dt:g} s); distinct: {few(told, _MOST_SPLITS, ' splits')}."
    )
