"""A whole page with a player and the facts of its recordings: one file that needs no network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import jinja2
from markupsafe import Markup

from gpusimbench import schemas
from gpusimbench.evaluator.player.clip import Clip
from gpusimbench.evaluator.player.labels import labels_of
from gpusimbench.evaluator.player.markup import markup, script, style
from gpusimbench.evaluator.player.words import distinct, first_divergence
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.figures import palette
from gpusimbench.evaluator.render.scripts import allowed
from gpusimbench.evaluator.render.templating import page_templates
from gpusimbench.schemas.text import printable

_HERE = Path(__file__).parent


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
    yield "steps", f"{c.steps} of {c.dt:g} s{'' if c.stride == 1 else f', states of every {c.stride}th'}"
    yield "determinism", c.determinism
    yield "run", str(c.run_index)
    yield "status", f"{recording.status}{': ' if recording.reason else ''}{recording.reason}"
    for lost in recording.dropouts:
        yield "lost data", lost
    yield "content hash", recording.content_hash or "none: the recording has no end"
    yield "made (UTC)", recording.provenance.created_utc
