"""The player as a piece of a page: its elements with the data in them, and script and style that go with it once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import jinja2
from markupsafe import Markup

from gpusimbench.evaluator.player.clip import Clip
from gpusimbench.evaluator.player.encode import RESOLUTION_M, RESOLUTION_QUATERNION, encode
from gpusimbench.evaluator.player.words import distinct, sentences
from gpusimbench.evaluator.render.templating import page_templates

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
