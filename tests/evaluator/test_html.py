"""The HTML report."""

from __future__ import annotations

import base64
import hashlib
import html
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.inputs.reader import Unreadable, read_run
from gpusimbench.evaluator.metrics import variability
from gpusimbench.evaluator.metrics.density import HexGrid, marginal
from gpusimbench.evaluator.metrics.guidelines import guidelines
from gpusimbench.evaluator.metrics.levels import Worst
from gpusimbench.evaluator.metrics.radar import SimulatorResult, radar
from gpusimbench.evaluator.missing import Missing, known, why_missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.templating import script
from gpusimbench.evaluator.report.document import render_html, write_html
from gpusimbench.evaluator.report.source import playback_of
from gpusimbench.evaluator.results import group_metrics, published
from gpusimbench.evaluator.results.details import (
    BetweenEnvs,
    BetweenRuns,
    Details,
    DistinctEnvs,
    DistinctRuns,
    Equality,
    OffTheBoard,
    SunkCubes,
)
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.metric import Estimate, missing
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.ranking import Comparison, Contender
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.results.result import Cloud, GroupResult, Map
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.errors import DamagedRecording
from tests.pages import part
from tests.synthetic import write_recording, write_sweep

ROOT = Path(__file__).parents[2]
HOSTILE = "\"'><script>alert(1)</script><img src=https://x.example/>"
COMMAND = "gsb-eval a.mcap --html report"
GRID = HexGrid((-0.2, 0.7, -0.4, 0.4), 0.01)
EDGES = (np.linspace(-0.2, 0.7, 91), np.linspace(-0.4, 0.4, 81))
VOID = {"meta", "br", "hr", "img", "link", "input"}
FETCHING = {"src", "href", "srcset", "data", "action", "poster", "background", "xlink:href"}


class Page(HTMLParser):
    """Elements of a page as a browser would find them, and whether they nest."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.opened: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.scripts: list[str] = []
        self.feed(text)
        self.close()
        assert self.opened == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.opened.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.opened.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.opened[-1:] == ["script"]:
            self.scripts.append(data)
        else:
            self.words.append(data)

    @property
    def text(self) -> str:
        """What is read, in one line; without the style sheet."""
        shown = " ".join(w for w in self.words if "prefers-color-scheme" not in w)
        return re.sub(r"\s+", " ", shown)


@pytest.fixture(scope="module")
def recorded(small: Path) -> Run:
    """A small recording of MuJoCo."""
    return read_run(Recording(small), 5.0)


def cloud(positions: np.ndarray) -> Cloud:
    """A cloud of positions [m], shape [run, env, item, 2]."""
    sides = (marginal(positions[..., 0], EDGES[0]), marginal(positions[..., 1], EDGES[1]))
    return Cloud(positions, GRID.bin(positions), sides)


def result(base: GroupResult, label: str, seed: int, *, off_map: int = 0) -> GroupResult:
    """A group with every value, all of them made up, and positions around the board's middle."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(0.2, 0.05, (3, 4, 27, 2)) * [1.0, 0.3]
    positions.reshape(-1, 2)[:off_map] = 9.0
    half = np.triu(rng.random((4, 4)), k=1)

    def made(name: str, value: float, details: Details | None = None, **rest: Any) -> Estimate:
        return Estimate(METRICS[name], value, "m", details=details or Details(), **rest)

    several_envs = BetweenEnvs(matrix_cm=half + half.T)
    runs = BetweenRuns(matrix_cm=np.zeros((3, 3)))
    apart = Equality(text="different", worst=Worst((0, 1), 0, 0, 0, 0.012, 1.0))
    found = [
        made("fps", 1_234_567.0 + seed, n=3, sd=321.0, ci95=(1_233_000.0, 1_236_000.0)),
        made("memory_peak_increment", 2.5 + seed, n=3, sd=0.25, ci95=(2.0, 3.0)),
        made("process_memory_peak", 2.25 + seed, n=3, sd=0.25, ci95=(2.0, 3.0)),
        made("host_memory_peak_increment", 77.25, n=3, sd=0.5, ci95=(76.0, 78.0)),
        made("distinct_envs", 3.0, DistinctEnvs(first_difference_step=118), n=4),
        made("distinct_runs", 1.0, DistinctRuns(first_difference_step=None), n=3),
        made("capture_changes_states", 0.0, n=3),
        made("w1_parallel", 0.00001234 + seed, several_envs, n=3, sd=0.0, ci95=(0.0, 0.5)),
        made("w1_run_to_run", 0.0, runs, n=3, sd=0.0, ci95=(0.0, 0.0)),
        made("w1_real", 3.375 + seed, n=3, sd=0.125, ci95=(3.0, 4.0)),
        made("w1_parallel_clamped", 0.0625, n=3, sd=0.0),
        made("w1_run_to_run_clamped", 0.0, n=3, sd=0.0),
        made("w1_real_clamped", 2.125, n=3, sd=0.125),
        made("left_board", 0.25, OffTheBoard(total=3, of=324), n=12),
        made("sank", 0.5, SunkCubes(total=6, of=324, first_step=17), n=12),
        made("regime_published", 1.0),
        made("allocator_peak", 1.5, n=3, sd=0.0),
        made("equality_envs", 4.0, apart),
        made("equality_runs", 0.0, Equality(text="bit-identical")),
        made("build_time", 1.25, n=3),
        made("compile_time", 33.0, n=3),
    ]
    estimates = {name: missing(metric, f"no {name} here") for name, metric in METRICS.items()}
    estimates |= {one.name: one for one in found}
    return GroupResult(
        group=base.group, label=label, metrics=estimates, cloud=cloud(positions),
        validity=base.validity, fidelity=base.fidelity,
        notes=(f"a note on {label}",),
    )  # fmt: skip


@pytest.fixture(scope="module")
def alone(recorded: Run) -> Evaluation:
    """One real group and no reference, sampled at a step that was recorded."""
    return evaluate_files([recorded.path], sample_time=0.1)


@pytest.fixture(scope="module")
def several(alone: Evaluation) -> Evaluation:
    """Three groups with made-up values and a reference."""
    results = tuple(result(alone.results[0], f"engine {i}", i, off_map=101 if i == 2 else 0) for i in range(3))
    real = np.random.default_rng(9).normal(0.2, 0.05, (16, 27, 2))
    clouds = [r.cloud.density for r in results if r.cloud] + [GRID.bin(real)]
    figures = [SimulatorResult(r.label, fps=known(r.metrics["fps"].value), w1_real=known(r.metrics["w1_real"].value))
               for r in results]  # fmt: skip
    contenders = tuple(Contender(r, None, None, f, {}) for r, f in zip(results, figures, strict=True))
    return Evaluation(
        sample_time=5.0,
        results=results,
        unreadable=(Unreadable(Path("/data/torn.mcap"), DamagedRecording("torn.mcap: chunk 7 fails its CRC")),),
        reference=Reference(
            "16 real trials", Path("/data/trials.mcap"), "run", True, "inclined-collision", real, clouds[-1]
        ),
        reference_note="compared with 16 real trials",
        sweeps=(),
        accumulation=(),
        comparison=Comparison(contenders, radar(figures), tuple(guidelines(figures))),
        maps={"inclined-collision": Map(GRID, EDGES, max(int(d.counts.max()) for d in clouds if len(d.counts)))},
        notes=("a note on the whole set",),
    )


def render(evaluation: Evaluation, *, published: bool = False) -> str:
    """The page's text."""
    return render_html(evaluation, published=published, command=COMMAND)


def pictures(page: str) -> list[ET.Element]:
    """All pictures of a page, parsed as XML."""
    return [ET.fromstring(one) for one in re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)]


def assert_own_scripts(text: str) -> None:
    """The scripts of a page are ours, letter by letter, and its policy allows them and nothing else."""
    page = Page(text)
    own = [str(script("page.js")), str(script("download.js"))]
    assert page.scripts == own
    assert [a for tag, a in page.tags if tag == "script"] == [{}, {}]
    digests = [base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in own]
    policies = [a["content"] for tag, a in page.tags if a.get("http-equiv") == "Content-Security-Policy"]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    assert policies == [
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
    ]


@pytest.mark.parametrize("kind", ["alone", "several"])
def test_page_is_well_formed(kind: str, request: pytest.FixtureRequest) -> None:
    """Close every element that is opened, and draw pictures that are XML."""
    text = render(request.getfixturevalue(kind), published=True)
    page = Page(text)
    identities = [a["id"] for _, a in page.tags if "id" in a]
    assert len(identities) == len(set(identities))
    assert len(pictures(text)) == text.count("<svg")


@pytest.mark.parametrize("kind", ["alone", "several", "swept"])
def test_page_needs_nothing_else(kind: str, request: pytest.FixtureRequest) -> None:
    """Refer to places in the page only: no script but our own, no import, no address but names of namespaces."""
    text = render(request.getfixturevalue(kind), published=True)
    assert_own_scripts(text)
    for tag, attributes in Page(text).tags:
        assert tag not in {"link", "iframe", "object", "embed", "img", "base", "form"}
        for name, value in attributes.items():
            assert not name.startswith("on")
            assert name not in FETCHING or str(value).startswith("#")
    assert "@import" not in text
    assert set(re.findall(r"https?://[^\"'<\s]*", text)) == {"http://www.w3.org/2000/svg"}
    assert set(re.findall(r"url\(([^)]*)\)", text)) <= {"#hatch"}


def test_sections_of_the_contents_exist(several: Evaluation) -> None:
    """Lead from every link to a heading."""
    page = Page(render(several, published=True))
    identities = {a.get("id") for _, a in page.tags}
    links = [str(a["href"]) for tag, a in page.tags if tag == "a"]
    assert links
    assert all(link.removeprefix("#") in identities for link in links)


def test_every_group_and_metric_appears(several: Evaluation) -> None:
    """Name every group, every metric and every note."""
    text = Page(render(several)).text
    for group in several.results:
        assert group.label in text
        assert all(note in text for note in group.notes)
        assert all(name in text for name in group.metrics)
    assert "a note on the whole set" in text
    assert all(g.need in text and g.rule in text for g in several.comparison.guidelines)
    for guideline in several.comparison.guidelines:
        assert all(said in text for said in (*guideline.ranking, *guideline.disqualified, why_missing(guideline.pick)))


def test_values_have_sensible_digits(several: Evaluation) -> None:
    """Print thousands separators, the SD and interval, and no rounded zero for what is not zero."""
    text = Page(render(several)).text
    assert "1,234,567 ± 321" in text
    assert "[1,233,000 to 1,236,000]" in text
    assert "3.375 ± 0.125" in text
    assert "1.2e-05" in text
    assert "3 of 4" in text
    assert "first differ at step 118" in text
    assert "different, 1.2 cm apart" in text
    assert "3 of 324" in text


def test_missing_values_are_reasons(alone: Evaluation) -> None:
    """Print why there is no value, in its row, and never a zero."""
    text = render(alone)
    for metric in alone.results[0].metrics.values():
        if isinstance(metric.value, Missing):
            assert metric.value.reason
            assert f"not computed: {metric.value.reason}" in Page(text).text
    base = alone.results[0]
    reasons = {name: missing(metric, f"reason of {name}") for name, metric in METRICS.items()}
    unseen = replace(base.fidelity, rows=(), checks_missing="no states were recorded")
    empty = replace(base, metrics=reasons, cloud=None, fidelity=unseen)
    text = render(replace(alone, results=(empty,), maps={}))
    rows = re.findall(r"<tbody>(.*?)</tbody>", text, flags=re.DOTALL)
    for name in reasons:
        assert f"not computed: reason of {name}" in Page(text).text
    for row in rows[:2]:
        assert not re.search(r'<td class="num">\s*\d', row)
    assert "Consistency matrices: reason of w1_parallel; reason of w1_run_to_run" in text
    assert "Mechanics: no states were recorded" in Page(text).text


def test_off_map_counts_are_printed(several: Evaluation) -> None:
    """Say how many positions a map leaves out."""
    assert "101 are off the map" in Page(render(several)).text


def test_maps_share_one_colour_scale(several: Evaluation) -> None:
    """Draw one scale, labelled with the largest count, for the reference and all groups."""
    text = render(several)
    assert text.count("Colour scale: 1 to") == 1
    assert f"Colour scale: 1 to {several.maps['inclined-collision'].max_count:,} positions" in text
    assert text.count('aria-label="Density map of') == 4
    assert text.index("Density map of reference: 16 real trials") < text.index("Density map of engine 0")
    tops = set(re.findall(r'<text x="[\d.]+" y="11" class="small">(\d+ %)</text>', text))
    assert len(tops) == 1  # and one for the marginals


def test_problems_stand_above_the_results(several: Evaluation, recorded: Run) -> None:
    """Name files that were damaged, failed or cut short, with their reasons, before any table."""
    failed = replace(recorded, status="failed", reason="the engine ran out of memory")
    base = several.results[0]
    bad = replace(base, group=replace(base.group, recordings=(failed,)))
    text = Page(render(replace(several, results=(bad, *several.results[1:])))).text
    before = text[: text.index("W1 between envs [cm]")]
    assert "What is wrong with this set: 1 file could not be read; 1 run of" in before
    assert "torn.mcap" in before
    assert "chunk 7 fails its CRC" in before
    assert recorded.path.name in before
    assert "failed the engine ran out of memory" in before
    assert "2 files with problems" in before
    assert "Files that are in no figure" not in Page(render(replace(several, unreadable=()))).text


def test_hostile_text_stays_text(several: Evaluation, recorded: Run) -> None:
    """Let nothing that a file says become an element or an attribute."""
    deviation = replace(recorded.simulation.deviations[0], parameter=HOSTILE, reason=HOSTILE, used=HOSTILE)
    hostile = replace(
        recorded, status="failed", reason=HOSTILE, content_hash=HOSTILE,
        path=Path(f"{HOSTILE.replace('/', '|')}\udcff.mcap"),
        simulation=replace(
            recorded.simulation, version=HOSTILE, deviations=(deviation,),
            options={HOSTILE: {HOSTILE: [HOSTILE, "\x00"]}},
        ),
        provenance=replace(
            recorded.provenance, argv=(HOSTILE,), host={"cpu": HOSTILE}, gpus=({"name": HOSTILE},),
            created_utc=HOSTILE,
        ),
    )  # fmt: skip
    base = several.results[0]
    group = replace(base.group, recordings=(hostile,), key=replace(base.group.key, scene=HOSTILE, version=HOSTILE))
    metrics = {**base.metrics, "fps": missing(METRICS["fps"], HOSTILE)}
    one = replace(base, group=group, label=HOSTILE, metrics=metrics, notes=(HOSTILE,))
    assert several.reference is not None
    evaluation = replace(
        several,
        results=(one, *several.results[1:]),
        unreadable=(Unreadable(Path("x.mcap"), DamagedRecording(HOSTILE)),),
        reference=replace(several.reference, label=HOSTILE),
        reference_note=HOSTILE,
        notes=(HOSTILE,),
    )
    plain = Page(render(several))
    text = render_html(evaluation, published=False, command=HOSTILE)
    page = Page(text)
    assert {tag for tag, _ in page.tags} <= {tag for tag, _ in plain.tags} | {
        "section",
        "pre",
        "p",
        "h4",
        "select",
        "option",
    }
    assert not any(name.startswith("on") or name == "src" for _, a in page.tags for name in a)
    assert page.text.count(HOSTILE) > 10
    assert_own_scripts(text)
    assert "\x00" not in text
    assert len(pictures(text)) == text.count("<svg")


def test_deviations_are_told(alone: Evaluation) -> None:
    """List what the engine could not honour, with the reason."""
    shown = re.sub(r"<[^>]*>", "", html.unescape(part(render(alone), "deviations")))
    simulation = alone.results[0].group.recordings[0].simulation
    for deviation in simulation.deviations:
        assert deviation.parameter in shown
        assert deviation.reason in shown


def test_provenance_is_complete(alone: Evaluation, recorded: Run) -> None:
    """Show the machine, the software, the switches and the recording's full hash."""
    text = render(alone)
    page = Page(text)
    for record in (recorded.provenance.host, recorded.simulation.switches, recorded.simulation.options):
        for name, value in record.items():
            assert name in page.text
            if isinstance(value, str) and value:
                assert value in page.text
    assert recorded.content_hash in page.text
    assert recorded.path.name in page.text
    assert recorded.provenance.created_utc in page.text
    assert COMMAND in page.text


def test_published_figures_are_marked_as_the_papers(several: Evaluation) -> None:
    """Show the paper's figures only when asked, under its name, and beside results in rows marked as the paper's."""
    assert published.SOURCE not in render(several)
    text = Page(render(several, published=True)).text
    assert "These are the paper's figures, not results of this report." in text
    assert published.SOURCE in text
    start = text.index(published.SOURCE)
    marked = re.compile(r'<tr class="paper">.*?</tr>', re.DOTALL)
    results = marked.sub("", render(several, published=True)).partition(published.SOURCE)[0]
    for row in published.VARIABILITY:
        assert text.index(str(row.w1_real), start) > start
        assert str(row.w1_real) not in results
    assert "11,124,000" in text[start:]
    assert "not supported" in text[start:]


def test_published_types_follow_from_the_published_values() -> None:
    """Copy the paper's tables without a slip that its own rule would show."""
    for row in published.VARIABILITY:
        present = (row.parallel.mean > 0, row.run_to_run.mean > 0)
        assert row.regime == {(True, False): 1, (False, False): 2, (True, True): 3, (False, True): 4}[present]
    assert {r.simulator for r in published.SCALING} == {r.simulator for r in published.VARIABILITY}
    assert {r.simulator for r in published.SCALING} == set(published.SIMULATOR_VERSIONS)


def test_evaluation_of_nothing_is_a_page(several: Evaluation) -> None:
    """Write a page even where no group is left, with the files that could not be read."""
    nothing = Evaluation(5.0, (), several.unreadable, None, "no reference", (), (), Comparison(), {})
    text = Page(render(nothing)).text
    assert "torn.mcap" in text


def test_page_is_written_whole(several: Evaluation, tmp_path: Path) -> None:
    """Make the folder, write one file in it, and put a new page in the place of the old one."""
    folder = tmp_path / "new" / "report"
    page = write_html(several, folder, published=False, command=COMMAND)
    assert page == folder / "index.html"
    playback = playback_of(several.results)
    whole = render_html(several, published=False, command=COMMAND, playback=playback)
    assert page.read_text(encoding="utf-8") == whole
    write_html(several, folder, published=True, command="gsb-eval 'caf\udce9.mcap'")
    assert [p.name for p in folder.iterdir()] == ["index.html"]
    assert published.SOURCE in page.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """Two sweeps of two simulators on one scene; one ends for want of memory."""
    folder = tmp_path_factory.mktemp("swept")
    write_sweep(folder, (1, 4, 16), simulator="one", scene="free-fall", fails=16)
    write_sweep(folder, (1, 4, 16), simulator="two", scene="free-fall", allocator_peak=3 * 10**9)
    return evaluate_files(sorted(folder.glob("*.mcap")))


def test_scaling_is_drawn_and_tabulated(swept: Evaluation) -> None:
    """Draw throughput and memory of all sweeps of a scene, with every value in a table below."""
    text = render(swept, published=True)
    section = part(text, "scaling")
    assert section.count('role="img"') == 2
    words = re.sub(r"<[^>]*>", " ", section)
    for value in ("501 MB", "504 MB", "100,000", "failed at 16: device memory: no memory for the contacts", "3.00 GB"):
        assert value in words, value
    assert "largest N in these recordings" in words
    assert len(pictures(text)) == text.count("<svg")
    Page(text)


def test_published_points_stand_in_their_own_section(swept: Evaluation) -> None:
    """Draw the paper's N_env^max beside the sweeps only there, and only when asked."""
    assert 'class="foreign"' not in render(swept)
    before, _, after = render(swept, published=True).partition('<h2 id="published">')
    assert 'class="foreign"' not in before
    assert after.count('class="foreign"') == 2 * (7 + 6)
    assert "the paper&#39;s figures beside these sweeps" in after
    assert "this report has no sweep of this scene" in after  # of franka


def test_same_evaluation_gives_the_same_page(several: Evaluation) -> None:
    """Render without clock, chance or order of a set."""
    assert render(several) == render(several)


def test_too_many_environments_for_a_matrix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the mean without a matrix, and say why there is none."""
    final = np.random.default_rng(0).uniform(0.0, 0.1, size=(4, 27, 3))
    path = write_recording(tmp_path, final, n_env=4)
    with_matrix = evaluate_files([path]).results[0]
    for module in (variability, group_metrics):
        monkeypatch.setattr(module, "MATRIX_ENVS", 3)
    evaluation = evaluate_files([path])
    without = evaluation.results[0]
    assert with_matrix.metrics["w1_parallel"].of(BetweenEnvs).matrix_cm is not None
    assert without.metrics["w1_parallel"].of(BetweenEnvs).matrix_cm is None
    assert without.metrics["w1_parallel"].value == pytest.approx(with_matrix.metrics["w1_parallel"].value, rel=1e-12)
    assert "Consistency matrices: 4 environments are too many for one (limit: 3)" in Page(render(evaluation)).text


@pytest.mark.parametrize("number", [8, 9])
def test_a_radar_of_eight_groups_at_most(several: Evaluation, number: int) -> None:
    """Draw a radar of up to eight groups; of more, say why there is none and keep the values."""
    figures = [SimulatorResult(f"engine {i}", fps=100.0 + i, parallel=float(i)) for i in range(number)]
    contenders = tuple(Contender(several.results[0], None, None, f, {}) for f in figures)
    text = render(replace(several, comparison=Comparison(contenders, radar(figures), ())))
    assert ('data-file="radar"' in text) == (number == 8)
    assert ("No radar: 9 groups are compared" in text) == (number == 9)
    assert "Values behind the radar" in text
