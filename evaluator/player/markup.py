"""The player as a piece of a page: its elements with the data in them, and script and style that go with it once."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from evaluator.player.clip import Clip
from evaluator.player.encode import RESOLUTION_M, RESOLUTION_QUATERNION, encode
from evaluator.player.words import distinct, sentences
from evaluator.report.text import printable

_HERE = Path(__file__).parent


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


def policy(text: str) -> str:
    """The source by which a Content-Security-Policy allows a script or style of exactly this text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _visible(value: Any) -> Any:
    """Text without characters that a page cannot hold; markup of our own is left alone."""
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def markup(clips: Sequence[Clip]) -> Markup:
    """A player of these clips, one at a time; without scripts, what it would show in words."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, finalize=_visible,
    )  # fmt: skip
    return Markup(
        environment.get_template("player.html.j2").render(
            clips=[(clip, distinct(clip), sentences(clip), Markup(encode(clip))) for clip in clips],
            resolution_mm=f"{RESOLUTION_M * 1e3:.2g}",
            resolution_quaternion=f"{RESOLUTION_QUATERNION:.0e}",
        )
    )
