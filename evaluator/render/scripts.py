"""Scripts of the page, and the policy that lets a browser run them and nothing else."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

_FOLDER = Path(__file__).parent


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
