"""Templates of the page: every value is escaped, and its characters can be shown."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.render.csv import to_csv
from gpusimbench.evaluator.render.templating import page_templates
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.page.picture import LARGEST_CSV, Picture
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.sweeps import SOURCES
from gpusimbench.evaluator.runs.groups import shown_status

_DEPTH = 3
_ROWS = 1000  # of a record of a stranger, and items of a list in it
_CHARACTERS = 10_000  # of a text in it


def environment() -> jinja2.Environment:
    """What renders the templates beside this module; what recordings say is a stranger's text."""
    made = page_templates(jinja2.FileSystemLoader(Path(__file__).parent / "templates"))
    made.filters.update(
        mean_sd=numbers.mean_sd,
        interval=_interval,
        figure=numbers.figure,
        pairs=_first_pairs,
        shortened=_shortened,
        power=_power_of_two,
        power_or_count=_power_or_count,
        page_csv=_page_csv,
    )
    made.globals.update(words=words, timed=timed, sources=SOURCES, status_of=shown_status)
    return made


def _interval(metric: Estimate) -> str:
    if metric.ci95 is not None:
        return numbers.interval(metric)
    why_not = words.why_no_interval(metric, "one run" if metric.n == 1 else "")
    return f"no interval: {why_not}" if why_not else "no interval"


def _page_csv(picture: Picture) -> str:
    """A picture's numbers as a page carries them, with its own line ends; empty where there are none, or too many."""
    text = to_csv(picture.numbers.titles, picture.numbers.rows)
    return text.replace("\r\n", "\n") if len(text) <= LARGEST_CSV else ""


def _power_of_two(count: int) -> Markup:
    return Markup("2<sup>{}</sup>").format(count.bit_length() - 1)


def _power_or_count(count: int) -> Markup | str:
    return f"{count:,}" if count & (count - 1) else _power_of_two(count)


def _first_pairs(record: dict[str, Any]) -> list[tuple[str, str]]:
    """Names and values of a record, as many as a person looks at; the last row says where there are more."""
    rows = [(_shortened(name), _shortened(value)) for name, value in islice(_pairs(record), _ROWS + 1)]
    return [*rows[:_ROWS], ("...", "the recording has more of them: gsb-info --json")] if len(rows) > _ROWS else rows


def _shortened(text: str) -> str:
    return text if len(text) <= _CHARACTERS else f"{text[:_CHARACTERS]}... ({len(text)} characters)"


def _pairs(record: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Names and values of a record; nested ones with dotted names down to a depth that can be read, lists as text."""
    for key in record:
        value, name = record[key], f"{prefix}{key}"
        if isinstance(value, dict) and value and prefix.count(".") < _DEPTH:
            yield from _pairs(value, f"{name}.")
        elif isinstance(value, (list, tuple)):
            more = [f"and {len(value) - _ROWS} more"] if len(value) > _ROWS else []
            yield name, ", ".join([*map(str, value[:_ROWS]), *more]) or "none"
        else:
            yield name, "none" if value is None or value in ("", {}) else str(value)
