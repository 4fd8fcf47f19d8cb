"""A leaderboard as one HTML page that needs nothing but itself: no script, no network, no other file.

What recordings say is a stranger's text: the template escapes every value.
"""

from __future__ import annotations

import jinja2
from markupsafe import Markup

from gpusimbench import schemas
from gpusimbench.evaluator.metrics.regime import REGIME_MEANING
from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.render.figures import palette
from gpusimbench.evaluator.render.templating import page_templates
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report import words as report_words
from gpusimbench.evaluator.share.leaderboard import words
from gpusimbench.evaluator.share.leaderboard.board import Board


def render(board: Board) -> str:
    """The page's text; the same recordings give the same page."""
    templates = page_templates(jinja2.PackageLoader("gpusimbench.evaluator.share", "templates"))
    environment = templates.overlay(keep_trailing_newline=True)
    environment.filters |= {
        "short": words.short,
        "mean_sd": numbers.mean_sd,
        "interval": numbers.interval,
        "amount": report_words.amount,
        "shared": report_words.shared,
    }
    return environment.get_template("leaderboard.html.j2").render(
        board=board,
        words=words,
        timed=timed,
        types=sorted(REGIME_MEANING.items()),
        version=schemas.__version__,
        colours={
            "light": Markup(palette.variables(dark=False)),
            "dark": Markup(palette.variables(dark=True)),
            "figures": "",
        },
    )
