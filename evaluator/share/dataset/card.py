"""README.md of a set: a card for the Hugging Face Hub, and a page for whoever opens the folder."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import jinja2

from gpusimbench import schemas
from gpusimbench.evaluator.json_values import brief
from gpusimbench.evaluator.metrics.regime import REGIME_MEANING
from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import shown_status
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.share.dataset.citation import Publication, quoted
from gpusimbench.evaluator.share.dataset.contents import LookedAt, runs_of
from gpusimbench.evaluator.share.dataset.licences import HUB_NAMES
from gpusimbench.evaluator.share.dataset.markdown import cell, fenced

CARD = "README.md"

KEYWORDS = ("robotics", "simulation", "benchmark", "reproducibility", "mcap")

_SIZES = ((1000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"))
_MOST_COMMANDS = 40
_LONGEST_COMMAND = 400


class Row(NamedTuple):
    """A group, as cells."""

    label: str
    version: str
    device: str
    runs: str
    determinism: str
    distinct_envs: str
    distinct_runs: str
    type: str
    throughput: str
    timed: tuple[str, ...]
    interval: str
    trouble: str


class Problem(NamedTuple):
    """A recording that no figure is computed from."""

    name: str
    what: str
    why: str


class Machine(NamedTuple):
    """A kind of machine, and how many recordings are from it."""

    host: str
    gpus: str
    recordings: int


def card(
    publication: Publication, looked_at: Sequence[LookedAt], evaluation: Evaluation, size: int, identity: str
) -> str:
    """The page. The same recordings and words of the publisher give the same bytes.

    size      of all recordings [byte]
    identity  of their content
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("gpusimbench.evaluator.share", "templates"),
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # noqa: S701 - Markdown, whose own markup is escaped by `cell`
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"cell": cell, "quoted": quoted}
    results = evaluation.results
    held = list(runs_of(looked_at))
    told, more = _commands(held)
    return environment.get_template("card.md.j2").render(
        publication=publication,
        hub_licence=HUB_NAMES.get(publication.licence, "other"),
        tags=KEYWORDS,
        size=next((name for limit, name in _SIZES if len(looked_at) < limit), "100K<n<1M"),
        count=numbers.plural(len(looked_at), "recording"),
        groups=numbers.plural(len(results), "group"),
        megabytes=f"{size / 1e6:.1f}",
        identity=identity,
        problems=problems(looked_at),
        scenes=[
            (scene, [_row(r) for r in results if r.group.key.scene == scene])
            for scene in dict.fromkeys(r.group.key.scene for r in results)
        ],
        notes={
            scene: [(r.label, note) for r in results if r.group.key.scene == scene for note in r.notes]
            for scene in {r.group.key.scene for r in results}
        },
        timed=[column.title for column in timed.ALL],
        not_comparable={
            scene: timed.incomparable(r for r in results if r.group.key.scene == scene)
            for scene in {r.group.key.scene for r in results}
        },
        sample_time=evaluation.sample_time,
        types=sorted(REGIME_MEANING.items()),
        machines=machines(held),
        commands_said=f"The command of each run is in its recording. Here they are, each once{more}:",
        commands=fenced(told),
        version=schemas.__version__,
        evaluate=_evaluate(looked_at),
        replay=_replay(held),
        cited=_cited(publication),
    )


def problems(looked_at: Sequence[LookedAt]) -> list[Problem]:
    """Recordings that are damaged, did not end well, or lost data."""
    found = []
    for one in looked_at:
        summary = one.run
        if summary is None:
            found.append(Problem(one.name, "damaged", "; ".join(one.checkup.findings)))
        elif summary.status != "complete":
            found.append(Problem(one.name, shown_status(summary), summary.reason))
        elif summary.dropouts:
            found.append(Problem(one.name, "lost data", summary.dropouts[0]))
        if summary is not None and one.checkup.findings:
            found.append(Problem(one.name, "breaks a rule", "; ".join(one.checkup.findings)))
    return found


def _row(result: GroupResult) -> Row:
    key, found = result.group.key, result.metrics
    return Row(
        label=result.label,
        version=key.version,
        device=key.device,
        runs=f"{key.n_env} x {len(result.group.complete)}",
        determinism=key.determinism,
        distinct_envs=words.count_of(found["distinct_envs"]),
        distinct_runs=words.count_of(found["distinct_runs"]),
        type=words.regime(found["regime_published"]),
        throughput=numbers.mean_sd(found["fps"]),
        timed=timed.cells(timed.ALL, result.timed),
        interval=numbers.interval(found["fps"]),
        trouble=words.trouble(result.group),
    )


def machines(held: Sequence[Run]) -> list[Machine]:
    """The kinds of machines that recorded, as far as recordings tell them apart."""
    found = Counter((_host(one), _gpus(one)) for one in held)
    return [Machine(host, gpus, count) for (host, gpus), count in sorted(found.items())]


def _host(summary: Run) -> str:
    host = summary.provenance.host
    memory = host.get("memory_bytes")
    parts = [str(brief(host.get("cpu", "")) or "not told")]
    if "usable_threads" in host:
        parts.append(f"{brief(host['usable_threads'])} threads")
    if isinstance(memory, int):
        parts.append(words.size(memory))
    return ", ".join([*parts, *(str(brief(host[key])) for key in ("system", "kernel") if host.get(key))])


def _gpus(summary: Run) -> str:
    found = Counter(
        f"{brief(gpu.get('name', 'a GPU'))}, driver {brief(gpu.get('driver', '?'))}" for gpu in summary.provenance.gpus
    )
    return "; ".join(f"{count} x {name}" for name, count in found.items()) or "none"


def _commands(held: Sequence[Run]) -> tuple[list[str], str]:
    found = Counter(shlex.join(one.provenance.argv) for one in held if one.provenance.argv)
    lines = [
        f"{command if len(command) <= _LONGEST_COMMAND else command[: _LONGEST_COMMAND - 3] + '...'}   # {count} x"
        for command, count in sorted(found.items())[:_MOST_COMMANDS]
    ]
    left = len(found) - _MOST_COMMANDS
    return lines or ["none is told"], f", the first {_MOST_COMMANDS} of {len(found)}" if left > 0 else ""


def _evaluate(looked_at: Sequence[LookedAt]) -> str:
    folders = sorted({one.name.rpartition("/")[0] for one in looked_at if one.run is not None})
    globs = [f"{shlex.quote(folder)}/*.mcap" if folder else "*.mcap" for folder in folders]
    return f"gsb-eval {' '.join(globs) or '*.mcap'} --html report"


def _replay(held: Sequence[Run]) -> str:
    first = next((one for one in held if one.usable and one.configuration.simulator != "real"), None)
    if first is None:
        return ""
    name = str(first.path)
    return f"gsb-audit {shlex.quote(name if not name.startswith('-') else f'./{name}')}"


def _cited(publication: Publication) -> str:
    authors = "; ".join(author.shown for author in publication.authors)
    told = [authors, publication.title, f"doi:{publication.doi}" if publication.doi else "", publication.url]
    return ". ".join(part for part in told if part) + "."
