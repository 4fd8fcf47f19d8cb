"""A whole page with a player: its elements, its facts in words, one file that needs no network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import jinja2
from markupsafe import Markup

from gpusimbench import schemas
from gpusimbench.evaluator.player.clip import Clip, labels_of
from gpusimbench.evaluator.player.encode import RESOLUTION_M, RESOLUTION_QUATERNION, encode
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.figures import palette
from gpusimbench.evaluator.render.templating import allowed, page_templates
from gpusimbench.schemas.text import few, ordinal, printable

_HERE = Path(__file__).parent
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


@cache
def script() -> str:
    """The script; it starts every player of the page, needs no network and is the same for all pages."""
    parts = [
        (_HERE / name).read_text(encoding="utf-8") for name in ("data.js", "drawing.js", "picture.js", "player.js")
    ]
    return "\n".join(["(() => {", '"use strict";', *parts, "})();"])


@cache
def style() -> str:
    """The style; the page gives the colours: --page, --ink, --quiet, --rule, --panel, --link and --g0 to --g7."""
    return (_HERE / "player.css").read_text(encoding="utf-8")


def markup(clips: Sequence[Clip]) -> Markup:
    """A player of these clips, one at a time; without scripts, what it would show in words."""
    templates = page_templates(jinja2.FileSystemLoader(_HERE))
    return Markup(
        templates.get_template("player.html.j2").render(
            clips=[(clip, distinct(clip), sentences(clip), Markup(encode(clip))) for clip in clips],
            resolution_mm=f"{RESOLUTION_M * 1e3:.2g}",
            resolution_quaternion=f"{RESOLUTION_QUATERNION:.0e}",
        )
    )


def render_page(clip: Clip, recordings: Sequence[Recording], *, command: str) -> str:
    """The page's text.

    command  that made the page, as a shell would take it
    """
    page_style = (_HERE / "page.css").read_text(encoding="utf-8")
    dark = f"@media (prefers-color-scheme: dark) {{ :root {{ {palette.variables(dark=True)} }} }}"
    styles = "\n".join([f":root {{ {palette.variables(dark=False)} }}", dark, page_style, style()])
    environment = page_templates(jinja2.FileSystemLoader(_HERE))
    sources = labels_of(recordings).sources
    return environment.get_template("page.html.j2").render(
        title=clip.title,
        policy=Markup(
            f"default-src 'none'; script-src {allowed(script())}; style-src {allowed(styles)}; "
            "base-uri 'none'; form-action 'none'"
        ),
        style=Markup(styles),
        script=Markup(script()),
        player=markup([clip]),
        distinct=distinct(clip),
        first=first_divergence(clip),
        recordings=[
            (source, [(name, printable(value)) for name, value in _facts(recording)])
            for source, recording in zip(sources, recordings, strict=True)
        ],
        command=printable(command),
        version=schemas.__version__,
    )


def _facts(recording: Recording) -> Iterator[tuple[str, str]]:
    c, s = recording.configuration, recording.simulation
    yield "file", recording.path.name
    yield "simulator", f"{c.simulator} {s.version if s else '(it was never built)'}"
    if s:
        yield "device", s.device
    yield "scene", c.scene
    yield "environments", str(c.n_env)
    yield "steps", f"{c.steps} of {c.dt:g} s{'' if c.stride == 1 else f', states of every {ordinal(c.stride)}'}"
    yield "determinism", c.determinism
    yield "run", str(c.run_index)
    yield "status", f"{recording.status}{': ' if recording.reason else ''}{recording.reason}"
    for lost in recording.dropouts:
        yield "lost data", lost
    yield "content hash", recording.content_hash or "none: the recording has no end"
    yield "made (UTC)", recording.provenance.created_utc
