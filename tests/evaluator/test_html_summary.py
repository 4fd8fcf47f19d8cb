"""The report's first words: what the recordings say, computed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gpusimbench.evaluator.report.html import render_html
from gpusimbench.evaluator.report.page import summary
from gpusimbench.evaluator.report.page.section import Source
from gpusimbench.evaluator.results.claims import Tally
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.evaluation import Evaluation
from tests.synthetic import grid, write_recording, write_sweep


def evaluate(folder: Path) -> Evaluation:
    """A slow simulator whose bits agree, a fast one whose do not, a faster one that is invalid, an instrument."""
    rng = np.random.default_rng(1)
    for run in range(2):
        write_recording(folder, grid(2), run=run, simulator="slow", elapsed_s=4.0, name=f"a{run}.mcap")
        final = grid(2) + rng.uniform(0.0, 1e-4, size=(2, 27, 3))
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
    assert (found["slow"].same_envs, found["slow"].same_runs) == (Tally(1, 1, 1), Tally(1, 1, 1))
    assert (found["fast"].same_envs, found["fast"].same_runs) == (Tally(0, 1, 1), Tally(0, 1, 1))
    assert found["wrong"].troubled == {"INVALID (buffer)": 2}
    assert (found["wrong"].speeds, found["wrong"].same_runs) == ((), Tally(0, 0, 1))
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


def test_faults_in_any_scene_bar_a_first_place(tmp_path: Path) -> None:
    """Name nobody first whose cubes sank, here or in another scene, and say who was faster and why it is not named."""
    for simulator, speed in (("fast", 4e5), ("slow", 1e5)):
        write_sweep(tmp_path, (64, 128), simulator=simulator, scene="free-fall", speed=speed)
        final = grid(2)
        final[:, :9, 2] = -1.0 if simulator == "fast" else 0.03
        write_recording(tmp_path, final, simulator=simulator, gpu_bytes=(0, 10**9), elapsed_s=1.0 + (speed > 2e5))
    text = render_html(evaluate_files(sorted(tmp_path.glob("*.mcap"))), published=False, command="")
    said = [re.sub(r"<[^>]*>", "", part) for part in re.findall(r"<li>Fastest in.*?</li>", text, re.DOTALL)]
    swept, collided = sorted(said)
    assert re.match(r"Fastest in free-fall on Test GPU: slow .*\. No other simulator qualifies\.", swept)
    assert re.search(r"Not named first: fast .*: 9 of 27 cubes per env sank \(inclined-collision\)", swept)
    assert re.match(r"Fastest in inclined-collision on Test GPU: slow \[inclined-collision\], ", collided)
    assert "Not named first" not in collided  # it is slower there


def test_nobody_is_named_where_all_are_wrong(tmp_path: Path) -> None:
    """Name nobody first where every simulator is INVALID in some scene."""
    for simulator in ("one", "two"):
        write_recording(tmp_path, grid(2), simulator=simulator)
        write_recording(
            tmp_path, None, simulator=simulator, scene="free-fall", status="INVALID", cause="BUFFER", reason="dropped"
        )
    text = render_html(evaluate_files(sorted(tmp_path.glob("*.mcap"))), published=False, command="")
    (said,) = re.findall(r"<li>Fastest in.*?</li>", text, re.DOTALL)
    assert "nobody is named" in said
    assert said.count("1 of 1 run is INVALID (buffer) (free-fall)") == 2


def test_other_timed_steps_are_not_ranked(tmp_path: Path) -> None:
    """Rank among the steps that most were timed over, and name the others beside it."""
    for simulator, warmup, seconds in (("a", 100, 2.0), ("b", 100, 3.0), ("quick", 20, 0.1)):
        write_recording(tmp_path, grid(2), simulator=simulator, warmup=warmup, elapsed_s=seconds)
    section = summary.section(Source(evaluate_files(sorted(tmp_path.glob("*.mcap"))), False, ""))
    assert section is not None
    (fastest,) = section.context["fastest"]
    assert (fastest.first.result.label, fastest.second.result.label) == ("a", "b")
    assert fastest.otherwise == (("quick", "steps 20 to 1,020"),)
