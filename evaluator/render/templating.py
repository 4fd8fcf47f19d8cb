"""Templates and scripts of pages: every value is escaped; a browser may run our scripts and nothing else."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.text import printable

_FOLDER = Path(__file__).parent


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


def escaped(text: str) -> Markup:
    """A stranger's text: what it holds is shown, and none of it is markup."""
    return escape(printable(text))


def script(name: str) -> Markup:
    """A script beside this module: static text, in which nothing is filled in."""
    return Markup("\n" + (_FOLDER / name).read_text(encoding="utf-8"))


def allowed(text: str) -> str:
    """The source by which a Content-Security-Policy allows a script or style of exactly this text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def policy(scripts: Sequence[Markup]) -> str:
    """The Content-Security-Policy of a page with these scripts, each the whole text of its element."""
    sources = " ".join(map(allowed, scripts)) or "'none'"
    return f"default-src 'none'; script-src {sources}; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
