"""Whole pages: with a player, in one file that needs no network; and of a task without places to draw: reward, actions
and observations over steps, as curves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gpusimbench import schemas
from gpusimbench.evaluator.player.clip import MOST_SHOWN, Clip, check_shown, labels_of
from gpusimbench.evaluator.player.encode import RESOLUTION_M, RESOLUTION_QUATERNION, encode
from gpusimbench.evaluator.player.poses import recorded_steps
from gpusimbench.evaluator.read.episodes import has_episodes, has_rewards
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import Block, Code, Document, Figure, Section, Text
from gpusimbench.evaluator.render.figures import palette
from gpusimbench.evaluator.render.figures.curves import End, curves_chart
from gpusimbench.evaluator.render.templating import allowed, page_templates
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.text import few, ordinal, plural, printable
from gpusimbench.schemas.vector import IMAGE_HASH

_HERE = Path(__file__).parent
_MOST_SPLITS = 8

_SHOWN = 4
"""Environments that are shown unless others are named."""

_MOST_CURVES = 8
"""Components of an array in one picture: as many as there are colours."""

_KINDS = ("reward", "action", "observation")

_HOW = (
    "A dashed line is the end of an episode that the task terminated, a dotted line that of a truncated episode. "
    "Curves have gaps where a new episode begins, and where a call of step made no step. A longer recording is divided "
    "into 400 stretches: lines are drawn through the smallest and the largest value of each, and of more than 400 ends "
    "of episodes those that come first in each."
)


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


def only_curves(recordings: Sequence[Recording]) -> bool:
    """Whether recordings are those of tasks, and none has a place of a body or a joint."""
    return all(has_episodes(one) and not len(recorded_steps(one)) for one in recordings)


def task_document(recordings: Sequence[Recording], envs: Sequence[int], command: str) -> Document:
    """The curves of some environments of each recording.

    envs  default: the first ones
    UsageError where recordings do not go together, or have no such environment.
    """
    check_shown(recordings, envs)
    labels = labels_of(recordings)
    each = max(1, min(_SHOWN, MOST_SHOWN // len(recordings)))
    parts = [
        _section(recording, labels.track(index, env), env, f"{index}-{env}")
        for index, recording in enumerate(recordings)
        for env in (dict.fromkeys(envs) or range(min(each, recording.configuration.n_env)))
    ]
    known = [Text(f"{labels.legend(recordings)}.")] if labels.lettered else []
    return Document(labels.title, (Text(_HOW), *known, *parts), made_by=(Text("Made with:"), Code((command,))))


def _section(recording: Recording, title: str, env: int, key: str) -> Section:
    n_row = min(len(recording.state(field.group, field.field)) for field in recording.fields)  # of a file cut short
    steps = np.asarray(recording.state(ENV, "reward").steps[:n_row], dtype=np.int64)
    flags = {name: _column(recording, name, env)[:n_row] for name in ("stepped", "episode", "terminated", "truncated")}
    ends = [
        End(int(steps[row]), bool(flags["terminated"][row]))
        for row in np.flatnonzero((flags["stepped"] != 0) & ((flags["terminated"] != 0) | (flags["truncated"] != 0)))
    ]
    begins = np.append(False, np.diff(flags["episode"]) != 0)
    blocks: list[Block] = []
    for name, width in _arrays(recording):
        values = recording.state(ENV, name)[:n_row, env, 0, :_MOST_CURVES].astype(np.float64)
        closed = begins if name.startswith("observation") else flags["stepped"] == 0
        blocks += _picture(name, width, values, steps, ends, closed, f"{key}-{name}", title)
    said = f"{plural(len(ends), 'episode')} ended in {plural(len(steps) - 1, 'step')}"
    return Section(f"env-{key}", title[0].upper() + title[1:], tuple(blocks), said)


def _arrays(recording: Recording) -> Iterator[tuple[str, int]]:
    """Names and widths of what is drawn: rewards, actions, observations; hashes of pictures are no curves."""
    for kind in _KINDS:
        for field in recording.fields:
            if field.group != ENV or not (field.field == kind or field.field.startswith(f"{kind}_")):
                continue
            if not field.field.endswith(IMAGE_HASH) and (kind != "reward" or has_rewards(recording)):
                yield field.field, field.width


def _column(recording: Recording, name: str, env: int) -> NDArray[np.float64]:
    column: NDArray[np.float64] = recording.state(ENV, name)[:, env, 0, 0].astype(np.float64)
    return column


def _picture(
    name: str,
    width: int,
    values: NDArray[np.float64],
    steps: NDArray[np.int64],
    ends: Sequence[End],
    closed: NDArray[np.bool_],
    key: str,
    title: str,
) -> Iterator[Block]:
    """A figure of an array, and its legend; rows that are `closed` do not continue the row before."""
    labels = [name] if width == 1 else [f"{name}[{i}]" for i in range(values.shape[1])]
    if name.startswith("observation"):  # the value stands there: an empty row before it opens the line
        rows = np.flatnonzero(closed)
        values, steps = np.insert(values, rows, np.nan, axis=0), np.insert(steps, rows, steps[rows])
    else:
        values = np.where(closed[:, None], np.nan, values)
    left = width - values.shape[1]
    more = f"the first {values.shape[1]} of {width} numbers" if left > 0 else ""
    svg = curves_chart(list(zip(labels, values.T, strict=True)), steps, ends, name=f"{name} of {title} over steps")
    yield Figure(name, more or ("" if svg else "no finite value"), Markup(svg) if svg else None, key)
