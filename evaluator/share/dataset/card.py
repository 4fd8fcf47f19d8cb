"""README.md of a set: a card for the Hugging Face Hub, and a page for whoever opens the folder."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from gpusimbench import schemas
from gpusimbench.evaluator.json_values import brief
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Code,
    Column,
    Document,
    Facts,
    Section,
    Text,
    facts,
    items,
    key_of,
    table,
)
from gpusimbench.evaluator.render.markdown import render_markdown
from gpusimbench.evaluator.render.numbers import estimate, scaled
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.sections.variability import types_of
from gpusimbench.evaluator.report.verdicts import QUESTIONS
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.group_metrics import REGIME
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import shown_status
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.share.dataset.citation import HUB_NAMES, Publication, quoted
from gpusimbench.evaluator.share.dataset.contents import LookedAt, runs_of
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import cut, plural

CARD = "README.md"

KEYWORDS = ("robotics", "simulation", "benchmark", "reproducibility", "mcap")

_SIZES = ((1000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"))
_MOST_COMMANDS = 40
_LONGEST_COMMAND = 400
_LONGEST_REASON = 300

_FILES = (
    "Each is one MCAP file, which stores what was run, the command, the machine, the versions and options, and how the "
    "run ended. Every number on this page and in the tables was computed from these files; none was typed in."
)


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
    """The page, with the front matter that the Hub reads. The same recordings and words give the same bytes.

    size      of all recordings [byte]
    identity  of their content
    """
    about = f"{publication.about}\n\n" if publication.about else ""  # the publisher's own Markdown
    title = render_markdown(Document(publication.title, ()))
    body = render_markdown(card_document(publication, looked_at, evaluation, size, identity))
    return f"{_front_matter(publication, len(looked_at))}\n{title}\n{about}{body}"


def _front_matter(publication: Publication, recordings: int) -> str:
    hub_licence = HUB_NAMES.get(publication.licence, "other")
    own = [f"license_name: {quoted(publication.licence.lower())}", "license_link: LICENSE"]
    size = next((name for limit, name in _SIZES if recordings < limit), "100K<n<1M")
    lines = [
        f"license: {quoted(hub_licence)}",
        *(own if hub_licence == "other" else []),
        f"pretty_name: {quoted(publication.title)}",
        "task_categories:",
        "  - robotics",
        "tags:",
        *(f"  - {quoted(tag)}" for tag in KEYWORDS),
        "size_categories:",
        f"  - {quoted(size)}",
        "configs:",
        *_config("metrics", "default: true"),
        *_config("runs"),
    ]
    return "\n".join(["---", *lines, "---", ""])


def _config(table_name: str, *more: str) -> list[str]:
    lines = [*more, "data_files:", "  - split: train", f"    path: {table_name}.parquet"]
    return [f"  - config_name: {table_name}", *(f"    {line}" for line in lines)]


def card_document(
    publication: Publication, looked_at: Sequence[LookedAt], evaluation: Evaluation, size: int, identity: str
) -> Document:
    """What the page says below its title and the publisher's words."""
    results = evaluation.results
    held = list(runs_of(looked_at))
    count, groups = plural(len(looked_at), "recording"), plural(len(results), "group")
    blocks: list[Block] = [
        Text(f"{count} of robot simulators, {size / 1e6:.1f} MB, in {groups}. {_FILES}"),
        facts(("Content of all recordings", Cell(f"sha256:{identity}", code=True))),
    ]
    if wrong := problems(looked_at):
        rows = [(one.name, one.what, cut(one.why, _LONGEST_REASON)) for one in wrong]
        said = Text("No metric is computed from these recordings, or from what they lost.")
        blocks.append(
            Section("problems", "Problems", (said, table("problem-files", "", ("file", "what", "why"), rows)))
        )
    blocks += [_scene(*one) for one in gathered((r.group.key.scene, r) for r in results).items()]
    blocks += [
        Section("reading", "How to read the tables", (_legend(results, evaluation.sample_time),)),
        Section("recorded", "How it was recorded", tuple(_recorded(held))),
        Section("check", "How to check it, and to run it again", tuple(_checking(looked_at, held))),
        Section("licence", "Licence", (Text(_licence(publication)),)),
        Section("citation", "Citation", (Text(_cited(publication)), *_address(publication))),
    ]
    return Document("", tuple(blocks))


def _scene(scene: str, results: Sequence[GroupResult]) -> Section:
    columns: tuple[Column | str, ...] = (
        "group", "version", "device", "envs x complete runs", "determinism",
        *(question.column for question in QUESTIONS), "type", f"throughput [{FPS.unit}]",
        *(column.title for column in timed.ALL), "other runs",
    )  # fmt: skip
    shown = table(key_of("scene", scene), "", columns, [_row(one) for one in results]).without_empty_columns()
    beside = timed.incomparable(results)
    notes = [f"{one.label}: {note}" for one in results for note in one.notes]
    return Section(key_of(scene), scene, (shown, *map(Text, beside), *([items(*notes)] if notes else [])))


def _row(result: GroupResult) -> tuple[Cell | str, ...]:
    key, found = result.group.key, result.metrics
    return (
        result.label, key.version, key.device, f"{key.n_env} x {len(result.group.complete)}", key.determinism,
        *(question.answer([result]) for question in QUESTIONS),
        words.regime(found[REGIME.name]), estimate(found[FPS.name]),
        *timed.cells(timed.ALL, result.timed), words.trouble(result.group),
    )  # fmt: skip


def _legend(results: Sequence[GroupResult], sample_time: float) -> Facts:
    said: list[tuple[str, str]] = [(question.title, question.meaning) for question in QUESTIONS]
    if types := list(types_of(results)):
        rounded = f"by GPUSimBench, from planar distances at {sample_time:g} s of simulated time, rounded to 0.01 cm"
        said.append(("type", rounded))
        said += [(name, meaning) for name, _, meaning in (one.partition(": ") for one in types)]
    unmet, _, counted = timed.LEGEND.partition(": ")
    said += [
        (unmet, counted),
        ("throughput", "mean ± SD over runs, and below it the 95 % interval"),
        (
            "metrics.parquet",
            "a row for each metric of each group, with unit, interval and method; where there is no value, the column "
            "value_missing has the reason",
        ),
        ("runs.parquet", "a row for each recording, with its content hash, status and machine"),
    ]
    return facts(*said)


def _recorded(held: Sequence[Run]) -> Iterator[Block]:
    rows = [(one.host, one.gpus, Cell(str(one.recordings), float(one.recordings))) for one in machines(held)]
    yield table("machines", "", ("machine", "GPUs", "recordings"), rows)
    told, more = _commands(held)
    if told:
        yield Text(f"The command of each run is in its recording. Here they are, each once{more}.")
        yield Code(tuple(told))


def _checking(looked_at: Sequence[LookedAt], held: Sequence[Run]) -> Iterator[Block]:
    yield Text("Download the files as they are, from the Hugging Face Hub for example with")
    yield Code(("hf download --repo-type dataset --local-dir DIR REPOSITORY",))
    yield Text("Then check every file in their folder. This needs nothing of gpusimbench:")
    yield Code(("sha256sum -c SHA256SUMS",))
    yield Text(
        f"gpusimbench {schemas.__version__} wrote this page. With this version or a later one, gsb-share verify checks "
        "every file and every content hash, and computes the tables again; gsb-eval makes a report:"
    )
    yield Code(("gsb-share verify .", _evaluate(looked_at)))
    if replay := _replay(held):
        yield Text(
            "gsb-audit runs a recording's own configuration on the machine that it is called on, and says how closely "
            "the result agrees with the recording:"
        )
        yield Code((replay,))


def _licence(publication: Publication) -> str:
    return publication.licence + ("." if publication.licence in HUB_NAMES else ": see the file LICENSE.")


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
        parts.append(scaled(memory, "B"))
    return ", ".join([*parts, *(str(brief(host[key])) for key in ("system", "kernel") if host.get(key))])


def _gpus(summary: Run) -> str:
    found = Counter(
        f"{brief(gpu.get('name', 'a GPU'))}, driver {brief(gpu.get('driver', '?'))}" for gpu in summary.provenance.gpus
    )
    return "; ".join(f"{count} x {name}" for name, count in found.items()) or "none"


def _commands(held: Sequence[Run]) -> tuple[list[str], str]:
    found = Counter(shlex.join(one.provenance.argv) for one in held if one.provenance.argv)
    lines = [
        f"{cut(command, _LONGEST_COMMAND)}   # {count} x" for command, count in sorted(found.items())[:_MOST_COMMANDS]
    ]
    left = len(found) - _MOST_COMMANDS
    return lines, f", the first {_MOST_COMMANDS} of {len(found)}" if left > 0 else ""


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
    told = [authors, publication.title, f"doi:{publication.doi}" if publication.doi else ""]
    return ". ".join(part for part in told if part) + "."


def _address(publication: Publication) -> Iterator[Block]:
    if publication.url:
        yield facts(("Address", Cell(publication.url, code=True)))
    yield Text("CITATION.cff has the same for programs.")
