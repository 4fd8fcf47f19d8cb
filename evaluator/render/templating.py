"""Templates of pages: every value is escaped, and its characters can be shown."""

from __future__ import annotations

from typing import Any

import jinja2
from markupsafe import Markup

from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.text import printable


def page_templates(loader: jinja2.BaseLoader) -> jinja2.Environment:
    """What renders HTML templates; what recordings say is a stranger's text, and a name that is missing an error."""
    made = jinja2.Environment(
        loader=loader,
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.tests["missing"] = lambda value: isinstance(value, Missing)
    return made


def _visible(value: Any) -> Any:
    """Text without characters that a page cannot hold; markup of our own is left alone."""
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value
