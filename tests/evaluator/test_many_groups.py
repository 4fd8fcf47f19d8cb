"""The report of more groups than a reader looks at: summaries first, lists closed below them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gpusimbench.evaluator.render.document import Facts, Items, Section, Table, Tone, walk
from gpusimbench.evaluator.report.document import report
from gpusimbench.evaluator.report.sections import provenance, throughput, validity
from gpusimbench.evaluator.report.sections.mechanics import remarks
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.fidelity import fidelity
from gpusimbench.evaluator.runs.physics.facts import Check, Measured, PhysicsFacts, measured
from tests.pages import rows_of
from tests.synthetic import Shown, grid, write_recording

SIZES = (1, 2, 3)
RUNS = 2


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Source:
    """Two simulators at three sizes, two runs each; one run is INVALID, and one scene has no complete run."""
    folder = tmp_path_factory.mktemp("many")
    for simulator in ("one", "other"):
        for n_env in SIZES:
            counts = {"capture": {"contacts": np.full((5, n_env), 7)}}
            for number in range(RUNS):
                write_recording(folder, grid(n_env), run=number, simulator=simulator, shown=Shown(counts))
    write_recording(
        folder, None, simulator="other", scene="free-fall", status="INVALID", cause="BUFFER", reason="dropped"
    )
    return Source(evaluate_files(sorted(folder.glob("*.mcap"))), False, "gsb-eval")


@pytest.fixture(scope="module")
def alone(source: Source) -> Source:
    """The groups of one simulator alone."""
    results = tuple(r for r in source.evaluation.results if r.group.key.simulator == "one")
    return Source(evaluate_files([run.path for r in results for run in r.group.recordings]), False, "gsb-eval")


def own(section: Section) -> dict[str, Table]:
    """Tables of a section that are seen when it is opened."""
    return {block.key: block for block in section.blocks if isinstance(block, Table)}


def closed(section: Section) -> list[Section]:
    """Closed parts of a section."""
    return [block for block in section.blocks if isinstance(block, Section) and block.folded]


def test_validity_shows_what_deviates_and_closes_the_list(source: Source) -> None:
    """Show the INVALID group and a row for each simulator; have all groups in a closed part."""
    section = validity.section(source)
    shown = own(section)
    assert list(shown) == ["validity-deviating", "validity-simulators"]
    (deviating,) = rows_of(shown["validity-deviating"]).values()
    assert (deviating["runs"].text, deviating["runs"].tone) == ("1 INVALID", Tone.BAD)
    by_simulator = rows_of(shown["validity-simulators"])
    assert by_simulator["one"]["runs"].text == "6 complete"
    assert by_simulator["other"]["runs"].text == "6 complete, 1 INVALID"
    assert by_simulator["one"]["contacts counted"].text == "in 3 of 3 groups"
    (listed,) = closed(section)
    (every,) = own(listed).values()
    assert (every.key, len(every.rows)) == ("validity", len(source.evaluation.results))


def test_validity_of_few_groups_is_one_table(alone: Source) -> None:
    """List three groups at once, with each counter on a line of its own."""
    section = validity.section(alone)
    assert list(own(section)) == ["validity"]
    assert not closed(section)
    (cell, *_) = [row["counted"] for row in rows_of(own(section)["validity"]).values()]
    assert cell.text == "contacts: 7 / 7 / 7 (capture)"
    assert cell.notes == ("counted in capture: 10 steps of 2 runs",)


def test_recordings_are_counted_by_simulator_and_listed_below(source: Source, alone: Source) -> None:
    """Count files and what is not complete; have every file with its hash in a closed part; list few at once."""
    section = provenance.every_file(source)
    assert section.summary == "13 files, 1 not complete"
    counted = rows_of(own(section)["recordings-simulators"])
    assert counted["other"]["status"].text == "6 complete, 1 INVALID (buffer)"
    (listed,) = closed(section)
    (every,) = own(listed).values()
    assert len(every.rows) == 13
    hashes = {run.content_hash for r in source.evaluation.results for run in r.group.recordings}
    assert {row.cells[4].text for row in every.rows} == hashes
    few = provenance.every_file(alone)
    assert list(own(few)) == ["recordings"]


def test_provenance_is_closed_by_simulator(source: Source, alone: Source) -> None:
    """Put the groups of a simulator into one closed part, unless one simulator is alone."""
    section = provenance.section(source)
    assert section is not None
    assert sorted((part.title, len(closed(part))) for part in closed(section)) == [("one", 3), ("other", 4)]
    few = provenance.section(alone)
    assert few is not None
    assert len(closed(few)) == 3


def test_runs_of_one_machine_are_named_by_ranges(tmp_path: Path) -> None:
    """Head the machine of many runs with the first and the last of them, not with a line of numbers."""
    for run in range(6):
        write_recording(tmp_path, grid(1), run=run, cpu="a" if run < 5 else "b")
    found = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    section = provenance.section(Source(found, False, ""))
    titles = [part.title for part in walk(section.blocks) if isinstance(part, Section)]
    said = [title for title in titles if title.startswith("Machine and software")]
    assert said == ["Machine and software of runs 0\u20134", "Machine and software of run 5"]


def test_a_scene_without_a_complete_run_has_no_table(source: Source) -> None:
    """Say in a line that nothing was timed, in place of tables of dashes."""
    section = throughput.section(source)
    assert {block.key for block in walk(section.blocks) if isinstance(block, Table)} == {
        "throughput",
    }
    said = [item.text for block in section.blocks if isinstance(block, Items) for item in block.items]
    assert "other [free-fall]: no throughput: no run of this group is complete" in said


def test_columns_that_are_empty_for_one_reason_share_a_line(alone: Source) -> None:
    """Name all columns that no group has anything in, once for each reason."""
    section = throughput.section(alone)
    lines = [item.text for block in section.blocks if isinstance(block, Items) for item in block.items]
    reasons = [line.partition(": ")[2] for line in lines if line.startswith("no ")]
    assert reasons
    assert len(reasons) == len(set(reasons))


def test_one_simulator_alone_is_asked_for_by_name(source: Source, alone: Source) -> None:
    """Ask of one simulator whether it repeats itself, and say on the first screen how fast it is."""
    assert report(source).title == "Which simulator repeats itself, which is right, and how fast is each?"
    document = report(alone)
    assert document.title == "Does one repeat itself, is it right, and how fast is it?"
    first = [block for block in document.blocks if not isinstance(block, Section)]
    (speeds,) = [block for block in walk(first) if isinstance(block, Facts)]
    assert [name for name, _ in speeds.pairs] == ["highest throughput, inclined-collision [env-steps/s]"]


def test_notes_of_several_runs_are_one_line() -> None:
    """Give the range of the numbers in which notes of a check differ; say a note of two checks once."""

    def found(note: str) -> Measured:
        fact = measured([0.0], low=None, high=0.0, tolerance=0.5, of="x", note=note)
        assert isinstance(fact, Measured)
        return fact

    runs = [
        PhysicsFacts("scene", 1, ((0, 0),), {Check.END_SPEED: found(note), Check.END_SPIN: found("seldom")})
        for note in ("9 of 432 cubes", "428 of 432 cubes", "424 of 432 cubes", "seldom")
    ]
    lines = remarks(fidelity("x", runs))
    assert f"{Check.END_SPEED.title}: 9 to 428 of 432 cubes" in lines
    assert f"{Check.END_SPEED.title}, {Check.END_SPIN.title}: seldom" in lines
