"""The report's first words: what the recordings say, computed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from evaluator.evaluate import evaluate_files
from evaluator.report.html import render_html
from evaluator.report.page import summary
from evaluator.report.page.section import Source
from evaluator.results import Evaluation
from tests.synthetic import grid, write_recording, write_sweep


def evaluate(folder: Path) -> Evaluation:
    """A slow simulator whose bits agree, a fast one whose do not, a faster one that is invalid, an instrument."""
    rng = np.random.default_rng(1)
    for run in range(2):
        write_recording(folder, grid(2), run=run, simulator="slow", elapsed_s=4.0, name=f"a{run}.mcap")
        final = rng.uniform(0.0, 0.3, size=(2, 27, 3))
        write_recording(folder, final, run=run, simulator="fast", elapsed_s=1.0, name=f"b{run}.mcap")
        write_recording(
            folder, grid(2), run=run, simulator="wrong", elapsed_s=0.1, status="INVALID", cause="BUFFER",
            reason="dropped", name=f"c{run}.mcap",
        )  # fmt: skip
        write_recording(
            folder, grid(2), run=run, simulator="control", elapsed_s=0.1, switches={"instrument": True},
            name=f"d{run}.mcap",
        )  # fmt: skip
    return evaluate_files(sorted(folder.glob("*.mcap")))


def test_verdicts_are_computed(tmp_path: Path) -> None:
    """Rank complete runs alone and no instrument; count bits, invalid runs and what was not compared."""
    evaluation = evaluate(tmp_path)
    section = summary.section(Source(evaluation, False, ""))
    assert section is not None
    (fastest,) = section.context["fastest"]
    assert fastest.first.result.group.key.simulator == "fast"
    assert fastest.second.result.group.key.simulator == "slow"
    found = {one.name: one for one in section.context["simulators"]}
    assert (found["slow"].tested, found["slow"].same) == (1, 1)
    assert (found["fast"].tested, found["fast"].same, found["fast"].same_runs) == (1, 0, 0)
    assert found["wrong"].troubled == {"INVALID (buffer)": 2}
    assert (found["wrong"].speeds, found["wrong"].tested) == ((), 0)
    assert found["control"].instrument
    assert section.context["no_reference"] == evaluation.reference_note


def test_the_page_begins_with_them(tmp_path: Path) -> None:
    """Show the summary before any other section, with the verdicts in words."""
    text = render_html(evaluate(tmp_path), published=False, command="")
    first = re.search(r'<h2 id="(\w+)">', text)
    assert first is not None
    assert first[1] == "summary"
    plain = re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", text))
    assert re.search(r"Fastest in inclined-collision on [^:]+: fast", plain)
    assert "an instrument, not ranked" in plain
    assert "2 INVALID (buffer)" in plain
    assert "No distance to reality: no reference" in plain


def test_faults_elsewhere_stand_beside_a_first_place(tmp_path: Path) -> None:
    """Say beside the fastest, and the next, that cubes of the same settings sank, here or in another scene."""
    for simulator, speed in (("fast", 4e5), ("slow", 1e5)):
        write_sweep(tmp_path, (64, 128), simulator=simulator, scene="free-fall", speed=speed)
        final = grid(2)
        final[:, :9, 2] = -1.0 if simulator == "fast" else 0.03
        write_recording(tmp_path, final, simulator=simulator, gpu_bytes=(0, 10**9), elapsed_s=1.0 + (speed > 2e5))
    text = render_html(evaluate_files(sorted(tmp_path.glob("*.mcap"))), published=False, command="")
    said = [re.sub(r"<[^>]*>", "", line) for line in text.splitlines() if line.startswith("<li>Fastest in")]
    swept, collided = sorted(said)
    assert re.search(r"fast.*The same settings in inclined-collision: 9 of 27 cubes per env sank\. Next: slow", swept)
    assert "sank" not in swept.partition("Next")[2]
    assert "what mechanics demands" not in collided.partition("Next")[0]
    assert "what mechanics demands" in collided.partition("Next")[2]
