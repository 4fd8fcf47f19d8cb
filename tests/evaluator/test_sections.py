"""What holds for the tables of every topic of the report, as data: width, facets, reasons, and values."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from gpusimbench.evaluator.metrics.guidelines import Guideline
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Items, Section, Table, Tone
from gpusimbench.evaluator.report.document import SECTIONS, report
from gpusimbench.evaluator.report.sections import (
    determinism_cost,
    mechanics,
    scaling,
    throughput,
    validity,
    variability,
)
from gpusimbench.evaluator.report.sections.comparison import guidelines
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.identity_metrics import DISTINCT_RUNS, identical
from tests.pages import text_of
from tests.synthetic import write_recording, write_sweep

TOPICS = (determinism_cost, mechanics, scaling, throughput, validity, variability)
FACETS = {"simulator", "scene", "device", "level"}
WIDEST = 9
RECORDINGS = Path(__file__).parents[2] / "recordings"


@pytest.fixture(scope="module")
def source() -> Source:
    """MuJoCo on two hosts with two cones: recordings that ship."""
    return Source(evaluate_files(sorted(RECORDINGS.glob("*.mcap"))), False, "gsb-eval")


@pytest.fixture(scope="module")
def made(source: Source) -> dict[str, Section]:
    """The sections of the topics, by module."""
    found = {topic.__name__.rpartition(".")[2]: topic.section(source) for topic in TOPICS}
    return {name: section for name, section in found.items() if section is not None}


def tables(section: Section) -> list[Table]:
    """Tables that stand in a section itself."""
    return [block for block in section.blocks if isinstance(block, Table)]


def test_topics_of_these_recordings_are_folded_and_have_a_summary(made: dict[str, Section]) -> None:
    assert {"throughput", "validity", "variability"} <= set(made)
    for name, section in made.items():
        assert section.folded, name
        assert section.summary, name


def test_no_table_is_wider_than_the_page_and_rows_can_be_filtered(made: dict[str, Section]) -> None:
    found = [table for section in made.values() for table in tables(section)]
    assert found
    for table in found:
        assert len(table.columns) <= WIDEST, table.caption
        assert all(set(row.facets) == FACETS for row in table.rows), table.caption


def test_a_reason_stands_once_in_a_legend_and_each_letter_in_a_cell_is_explained(made: dict[str, Section]) -> None:
    for table in (table for section in made.values() for table in tables(section)):
        assert not [line for line, times in Counter(table.legend).items() if times > 1], table.caption
        explained = {line.partition(" ")[0] for line in table.legend}
        quiet = [cell for row in table.rows for cell in row.cells if cell.tone is Tone.QUIET and cell.notes]
        assert all(set(cell.notes) <= explained for cell in quiet), table.caption


def test_throughput_has_each_group_with_the_value_and_interval_of_its_estimate(
    source: Source, made: dict[str, Section]
) -> None:
    (table,) = [one for one in tables(made["throughput"]) if one.key == "throughput"]
    at = [column.title for column in table.columns].index(FPS.titled)
    for result, row in zip(source.shown, table.rows, strict=True):
        estimate = result.metrics[FPS.name]
        assert not isinstance(estimate.value, Missing)
        assert row.cells[0].text == source.names[result.label]
        cell = row.cells[at]
        assert (cell.value, cell.ci95) == (estimate.value, estimate.ci95 or None)


def test_what_was_timed_stands_once_below_the_table(made: dict[str, Section]) -> None:
    """Say it of a simulator where all of its groups were timed alike, and of groups where they were not."""
    paths = [RECORDINGS / "h200" / f"{one}-inclined-collision-n16-r0.mcap" for one in ("mjx-jax", "warp")]
    paths += sorted(
        (RECORDINGS / "prices-h100").glob("mjx-jax-*.mcap")
    )  # two levels, of a later version of the recorder
    mixed = throughput.section(Source(evaluate_files(paths), False, "gsb-eval"))
    assert isinstance(mixed, Section)
    found = [
        [line.partition(": ")[0] for table in tables(one) for line in table.legend if line.startswith("between the ")]
        for one in (made["throughput"], mixed)
    ]
    assert found[0] == ["between the clocks, mujoco"]
    assert len(found[1]) == 3 and "between the clocks, warp" in found[1]
    assert "between the clocks, mjx [default], mjx [run-to-run]" in found[1]


def test_the_summary_of_throughput_names_nobody_where_one_simulator_is_alone(made: dict[str, Section]) -> None:
    assert "mujoco" not in made["throughput"].summary


def test_counts_of_distinct_runs_are_good_only_where_all_runs_are_identical(
    source: Source, made: dict[str, Section]
) -> None:
    (table,) = [one for one in tables(made["variability"]) if one.key == "variability"]
    at = [column.title for column in table.columns].index(DISTINCT_RUNS.title)
    expected = {True: Tone.GOOD, False: Tone.BAD, None: Tone.PLAIN}
    for result, row in zip(source.shown, table.rows, strict=True):
        holds = identical(result.metrics[DISTINCT_RUNS.name]).holds
        assert row.cells[at].tone in {expected[holds], Tone.QUIET}, result.label


def test_sections_without_content_are_a_line_each(tmp_path: Path) -> None:
    """Show no heading over nothing: of a run that captured no states, sections that need bodies are reasons."""
    path = write_recording(tmp_path, None, elapsed_s=None)
    source = Source(evaluate_files([path]), False, "gsb-eval")
    reasons = [made.reason for section in SECTIONS if isinstance(made := section(source), Missing)]
    assert len(reasons) == 4
    *sections, last = [block for block in report(source).blocks if isinstance(block, Section)]
    titles = [section.title for section in sections]
    assert last.key == "left-out"
    assert [item.text for block in last.blocks if isinstance(block, Items) for item in block.items] == reasons
    assert {reason.partition(":")[0] for reason in reasons} == {
        "Mechanics", "Throughput and memory", "Density maps", "Consistency matrices",
    }  # fmt: skip
    assert not {reason.partition(":")[0] for reason in reasons} & set(titles)


def test_all_that_speaks_against_others_stands_beside_a_pick(source: Source) -> None:
    """List who is not recommended and why, each group once, in the order of the reasons."""
    need = Guideline(
        "speed", "a", "fastest", "2", disqualified=("b",), unmeasured=("c",), barred=("d (sank)",), unranked=("e",)
    )
    comparison = replace(source.evaluation.comparison, guidelines=(need,))
    made = guidelines(Source(replace(source.evaluation, comparison=comparison), False, ""))
    assert made is not None
    (shown,) = tables(made)
    cell = shown.rows[0].cells[-1]
    assert (cell.text, *cell.notes) == (
        "qualifies too, not ranked: e", "do not qualify: b", "lack a figure: c", "barred: d (sank)",
    )  # fmt: skip


def test_points_of_sweeps_are_no_groups_of_probes(tmp_path: Path) -> None:
    """Count groups that stand in the scaling section as those of sweeps alone."""
    write_sweep(tmp_path, (16, 64, 256), scene="free-fall")
    evaluated = Source(evaluate_files(sorted(tmp_path.glob("*.mcap"))), False, "")
    said = " ".join(text_of(evaluated.evaluation).split())
    assert "groups of sweeps, 16 to 256 envs" in said
    assert "gsb-probe needs" not in said


def test_overflow_says_how_many_groups_do_not_report_it() -> None:
    """Say that no group had any, and of how many groups nothing is known where there are such."""
    warp = sorted((RECORDINGS / "sweeps-h100").glob("warp-free-fall-n512-r*.mcap"))
    for more, notes in (([], ()), ([RECORDINGS / "mujoco-amd-r0.mcap"], ("not reported by 1 group",))):
        results = evaluate_files([*warp, *more]).results
        cell = validity._overflows(results)
        assert (cell.text, cell.notes) == ("none in 1 group", notes)
