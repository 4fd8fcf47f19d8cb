"""What the page is made of: sections, each of a title and a template with what it shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

from gpusimbench.evaluator.report.page.picture import Picture
from gpusimbench.evaluator.report.source import Source as Source


@dataclass(frozen=True)
class Section:
    """One section.

    key      its anchor, and the name of its template
    title    its heading
    link     its name in the list of sections; the title where it is empty
    context  what its template shows
    style    that it needs beyond the page's, CSS
    script   that it needs, JavaScript: the page's policy allows this text and no other
    """

    key: str
    title: str
    context: Mapping[str, Any]
    link: str = ""
    style: str = ""
    script: str = ""

    def pictures(self) -> Iterator[Picture]:
        """All figures among what its template shows, in order."""
        yield from _found(self.context.values())


def _found(values: Iterable[Any]) -> Iterator[Picture]:
    for value in values:
        if isinstance(value, Picture):
            yield value
        elif isinstance(value, Mapping):
            yield from _found(value.values())
        elif isinstance(value, list | tuple):
            yield from _found(value)
        elif is_dataclass(value) and type(value).__module__.startswith("gpusimbench.evaluator.report."):
            yield from _found(getattr(value, field.name) for field in fields(value))
