"""A page of a task's recording without places to draw: reward, actions and observations over steps, as curves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gpusimbench.evaluator.player.clip import MOST_SHOWN, check_shown, labels_of
from gpusimbench.evaluator.player.poses import recorded_steps
from gpusimbench.evaluator.read.episodes import has_episodes, has_rewards
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import Block, Code, Document, Figure, Section, Text
from gpusimbench.evaluator.render.figures.curves import End, curves_chart
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.vector import IMAGE_HASH

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
