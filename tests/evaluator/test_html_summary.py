"""The report's first words: what the recordings say, computed."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpusimbench.evaluator.render.document import Cell, Facts, Section, Text, Tone
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.brief import brief
from gpusimbench.evaluator.report.document import render_html, report
from gpusimbench.evaluator.report.leaders import Fastest, fastest
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.report.timed import TOO_SHORT
from gpusimbench.evaluator.results.canonical import Law, laws
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.fidelity import DEMANDED
from gpusimbench.evaluator.runs.physics.facts import LawValues, PhysicsFacts
from gpusimbench.schemas.provenance import OverflowBit
from tests.synthetic import Shown, configured, grid, write_recording, write_sweep

VARIED = configured(vary="mass:0.1")


def evaluate(folder: Path) -> Evaluation:
    """A slow simulator whose bits agree, a fast one whose do not, a faster one that is invalid, an instrument."""
    rng = np.random.default_rng(1)
    for run in range(2):
        write_recording(folder, grid(2), run=run, simulator="slow", elapsed_s=4.0, name=f"a{run}.mcap", proven=True)
        final = grid(2) + rng.uniform(0.0, 1e-4, size=(2, 27, 3))
        write_recording(folder, final, run=run, simulator="fast", elapsed_s=1.0, name=f"b{run}.mcap", proven=True)
        write_recording(
            folder, grid(2), run=run, simulator="wrong", elapsed_s=0.1, status="INVALID", cause="BUFFER",
            reason="dropped", name=f"c{run}.mcap", proven=True,
        )  # fmt: skip
        write_recording(
            folder, grid(2), run=run, simulator="control", elapsed_s=0.1, switches={"instrument": True},
            name=f"d{run}.mcap",
        )  # fmt: skip
    return evaluate_files(sorted(folder.glob("*.mcap")))


def matrix(evaluation: Evaluation) -> dict[str, dict[str, Cell]]:
    """The verdicts on the first screen: by simulator, by question."""
    (found,) = [t for t in report(Source(evaluation, False, "")).tables() if t.key == "simulators"]
    titles = [column.title for column in found.columns]
    return {row.cells[0].text: dict(zip(titles, row.cells, strict=True)) for row in found.rows}


def test_verdicts_are_computed(tmp_path: Path) -> None:
    """Rank complete runs alone and no instrument; count bits, invalid runs and what was not compared."""
    evaluation = evaluate(tmp_path)
    (found,) = fastest(evaluation.results)
    assert found.first is not None and found.second is not None  # noqa: PT018
    assert found.first.result.group.key.simulator == "fast"
    assert found.second.result.group.key.simulator == "slow"
    shown = matrix(evaluation)
    assert list(shown)[-1] == "control"  # an instrument stands last
    assert (shown["slow"]["repeats itself"].tone, shown["slow"]["envs alike"].tone) == (Tone.GOOD, Tone.GOOD)
    assert (shown["fast"]["repeats itself"].tone, shown["fast"]["envs alike"].tone) == (Tone.BAD, Tone.BAD)
    assert shown["fast"]["repeats itself"].text.startswith("no, 0.0")
    assert shown["fast"]["repeats itself"].notes == ("2 distinct of 2",)
    assert shown["wrong"]["valid"] == Cell("no", notes=("2 of 2 INVALID",), tone=Tone.BAD)
    assert shown["wrong"]["repeats itself"].text == "not compared"


def test_the_page_begins_with_them(tmp_path: Path) -> None:
    """Show the question, what is wrong with the set, the verdicts and the fastest before any section."""
    evaluation = evaluate(tmp_path)
    text = render_html(evaluation, published=False, command="")
    plain = re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", text[text.index("<h1>") : text.index("<details")]))
    assert "What is wrong with this set: 2 runs of 8 failed, are INVALID or lost data" in plain
    assert "an instrument with known answers" in plain
    assert "The fastest valid simulator of each scene" in plain
    assert "cm: W1, the mean distance by which bodies must be moved to turn one outcome into another" in plain
    printed = _printed(evaluation)
    assert "Fastest valid simulator in inclined-collision on" in printed
    assert "no distance to reality: no reference" in printed
    signs = "-: not known or not reported; cm: W1, the mean distance by which bodies must be moved to turn one outcome "
    assert signs + "into another; x 0: no complete run" in " ".join(printed.split())


def test_faults_in_any_scene_bar_a_first_place(tmp_path: Path) -> None:
    """Name nobody first whose cubes sank, here or in another scene, and say who was faster and why it is not named."""
    for simulator, speed in (("fast", 4e5), ("slow", 1e5)):
        write_sweep(tmp_path, (512, 1024), simulator=simulator, scene="free-fall", speed=speed, proven=True)
        final = grid(2)
        final[:, :9, 2] = -1.0 if simulator == "fast" else 0.03
        seconds = 1.0 + (speed > 2e5)
        write_recording(tmp_path, final, simulator=simulator, gpu_bytes=(0, 10**9), elapsed_s=seconds, proven=True)
    found = {one.scene: one for one in fastest(evaluate_files(sorted(tmp_path.glob("*.mcap"))).results)}
    swept, collided = found["free-fall"], found["inclined-collision"]
    assert swept.first is not None and collided.first is not None  # noqa: PT018
    assert (swept.first.result.group.key.simulator, swept.second) == ("slow", None)
    ((speed_of, why),) = swept.faster
    assert speed_of.result.group.key.simulator == "fast"
    assert "9 of 27 bodies per env sank (inclined-collision)" in why
    assert collided.first.result.group.key.simulator == "slow"
    assert collided.faster == ()  # it is slower there


def test_a_broken_law_bars_a_first_place(tmp_path: Path) -> None:
    """Name the slower simulator first where the faster one breaks a law, and name the law with its figures."""
    evaluation = evaluate(tmp_path)
    values = LawValues("creep", "creep of the block", "m", (2e-3, 2e-3), (0.0, 0.0), 1e-3, "g dt^2", ())
    broken = laws("fast", [PhysicsFacts("sliding-block", 2, ((0, 1),), {}, laws=(values,))])
    kept = laws("fast", [PhysicsFacts("sliding-block", 2, ((0, 1),), {}, laws=(replace(values, tolerance=3e-3),))])

    def first(of_fast: tuple[Law, ...]) -> Fastest:
        given = {"fast": of_fast, "slow": kept}
        results = [replace(r, laws=given.get(r.group.key.simulator, ())) for r in evaluation.results]
        (found,) = fastest(results)
        return found

    assert _names(first(kept)) == ("fast", "slow")
    found = first(broken)
    assert _names(found) == ("slow", "")
    why = {speed.result.group.key.simulator: reason for speed, reason in found.faster}["fast"]
    said = "laws in closed form broken: creep of the block 0.002 m, predicted 0 m"
    assert why == f"{said} (inclined-collision)"


def _names(found: Fastest) -> tuple[str, str]:
    first, second = (one.result.group.key.simulator if one else "" for one in (found.first, found.second))
    return first, second


def test_nobody_is_named_where_all_are_wrong(tmp_path: Path) -> None:
    """Name nobody first where every simulator is INVALID in some scene."""
    for simulator in ("one", "two"):
        write_recording(tmp_path, grid(2), simulator=simulator, proven=True)
        write_recording(
            tmp_path, None, simulator=simulator, scene="free-fall", status="INVALID", cause="BUFFER", reason="dropped"
        )
    (found,) = fastest(evaluate_files(sorted(tmp_path.glob("*.mcap"))).results)
    assert (found.first, found.second) == (None, None)
    assert [why for _, why in found.faster] == 2 * ["1 of 1 run is INVALID (buffer) (free-fall)"]


def test_other_timed_steps_are_not_ranked(tmp_path: Path) -> None:
    """Rank among the steps that most were timed over."""
    for simulator, warmup, seconds in (("a", 100, 2.0), ("b", 100, 3.0), ("quick", 20, 0.1)):
        write_recording(tmp_path, grid(2), simulator=simulator, warmup=warmup, elapsed_s=seconds, proven=True)
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    (found,) = fastest(evaluation.results)
    assert found.first is not None and found.second is not None  # noqa: PT018
    assert (found.first.result.label, found.second.result.label) == ("a", "b")
    assert not found.faster
    assert "; not compared, timed over other steps: quick\n" in _printed(evaluation)
    page = render_html(evaluation, published=False, command="")
    assert "not compared, timed over other steps: quick: 20,000" in page


def test_a_slower_simulator_timed_over_other_steps_is_not_told(tmp_path: Path) -> None:
    """Name beside the fastest only what was faster; other conditions than timed steps are no reason to name a group."""

    for simulator, warmup, seconds in (("a", 100, 2.0), ("b", 100, 3.0), ("slow", 20, 40.0)):
        write_recording(tmp_path, grid(2), simulator=simulator, warmup=warmup, elapsed_s=seconds, proven=True)
    write_recording(tmp_path, grid(2), simulator="quick", elapsed_s=0.1, proven=True, change=VARIED)
    (found,) = fastest(evaluate_files(sorted(tmp_path.glob("*.mcap"))).results)
    assert found.other_steps == ()


def _printed(evaluation: Evaluation) -> str:
    """What gsb-eval prints, with unbroken lines."""
    terminal = io.StringIO()
    print_document(brief(evaluation), terminal)
    return terminal.getvalue().replace("\n    ", " ")


def test_varied_environments_are_not_ranked(tmp_path: Path) -> None:
    """Rank environments of the scene alone, whatever the number of others."""

    for simulator, seconds in (("a", 2.0), ("b", 3.0)):
        write_recording(tmp_path, grid(2), simulator=simulator, elapsed_s=seconds, proven=True)
    for simulator in ("quick", "b", "c"):
        write_recording(tmp_path, grid(2), simulator=simulator, elapsed_s=0.1, proven=True, change=VARIED)
    (found,) = fastest(evaluate_files(sorted(tmp_path.glob("*.mcap"))).results)
    assert found.first is not None and found.second is not None  # noqa: PT018
    assert (found.first.result.label, found.second.result.label) == ("a", "b")
    assert not found.faster


def test_an_idle_world_is_not_the_fastest(tmp_path: Path) -> None:
    """Name nobody first whose throughput is that of another window or has no evidence of work, and say why."""
    write_recording(tmp_path, grid(2), simulator="honest", elapsed_s=4.0, proven=True)
    write_recording(tmp_path, grid(2), simulator="unproven", elapsed_s=2.0, warmup=100)
    write_recording(tmp_path, grid(2), simulator="quick", elapsed_s=0.5, proven=True)
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    (found,) = fastest(evaluation.results)
    assert (found.first.result.label, found.second) == ("honest", None)
    why = {speed.result.label: reason for speed, reason in found.faster}
    assert why["quick"] == "protocol-2 not met: the timed phase takes less than 1 s"
    assert why["unproven"].startswith("protocol-2 not met: contacts are not counted at the beginning and the end")
    text = render_html(evaluation, published=False, command="")
    assert "protocol-2 not met: the timed phase takes less than 1 s" in text
    assert fastest_of(evaluation) == (
        "quick: 4,000; unproven: 1,000", ("protocol-2 not met: timed steps, or evidence of work",)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("quick", "other", "rival"),
    [
        ((4.0, 4.4, 4.2), (4.1, 4.3, 4.3), True),
        ((4.0, 4.1, 4.2), (8.0, 8.1, 8.2), False),
        ((4.0,), (4.1,), True),
        ((4.0,), (5.0,), False),
    ],
)
def test_who_is_as_fast(quick: tuple[float, ...], other: tuple[float, ...], rival: bool, tmp_path: Path) -> None:
    """Name the next where its runs do not show it to be slower."""
    for name, times in (("quick", quick), ("other", other)):
        for run, elapsed_s in enumerate(times):
            write_recording(tmp_path, grid(2), simulator=name, run=run, elapsed_s=elapsed_s, proven=True)
    said = " ".join(_printed(evaluate_files(sorted(tmp_path.glob("*.mcap")))).split())
    assert "Fastest valid simulator in inclined-collision on" in said and ": quick, " in said
    assert ("; not shown to be slower: other, " in said) == rival


def test_a_first_place_without_states_says_so(tmp_path: Path) -> None:
    """Say that mechanics were not checked, unless states of another scene were, and name points of sweeps first."""
    for simulator, speed in (("fast", 4e5), ("slow", 1e5)):
        write_sweep(tmp_path, (512, 1024, 2048), simulator=simulator, scene="free-fall", speed=speed, proven=True)
    write_recording(tmp_path, grid(2), simulator="slow", gpu_bytes=(0, 10**9), proven=True)
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    (swept,) = [one for one in fastest(evaluation.results) if one.scene == "free-fall"]
    assert swept.first is not None and swept.second is not None  # noqa: PT018
    assert (swept.first.unchecked, swept.second.unchecked) == (True, False)
    printed = _printed(evaluation)
    assert re.search(r"free-fall on [^:]*: fast [^;]*env-steps/s \(mechanics not checked\)", printed)
    document = report(Source(evaluation, False, ""))
    (section,) = [block for block in document.blocks if isinstance(block, Section) and block.key == "throughput"]
    assert "free-fall: fast" in section.summary


def test_each_faster_group_has_its_own_reason(tmp_path: Path) -> None:
    """Tell of a simulator's two faster configurations, barred for two reasons; the first screen says who was faster."""
    write_recording(tmp_path, grid(2), simulator="honest", elapsed_s=4.0, proven=True)
    sunk = grid(2)
    sunk[:, :9, 2] = -1.0
    write_recording(
        tmp_path, sunk, simulator="quick", options={"solver": "a"}, elapsed_s=1.5, name="sunk.mcap", proven=True
    )
    write_recording(
        tmp_path, grid(2), simulator="quick", options={"solver": "b"}, elapsed_s=0.5, name="short.mcap", proven=True
    )
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    (found,) = fastest(evaluation.results)
    assert {speed.result.label for speed, _ in found.faster} == {"quick [solver=a]", "quick [solver=b]"}
    said = " ".join(_printed(evaluation).split())
    assert re.search(
        r"Fastest valid simulator in inclined-collision on [^;]*: honest, 500 env-steps/s; faster, but not ranked: "
        r"quick \[solver=b\] \(protocol-2 not met: [^)]*\); "
        r"quick \[solver=a\] \(INVALID, misplaced contacts, or mechanics broken\)",
        said,
    ), said


def test_a_yes_says_what_it_leaves_out(tmp_path: Path) -> None:
    """Say beside a yes that other groups of the simulator do not report overflow, or could not be compared."""
    told = Shown(overflow={"capture": np.zeros((5, 2), np.uint32)}, bits=(OverflowBit(0, "full", fatal=True),))
    write_recording(tmp_path, grid(2), options={"solver": "a"}, shown=told, name="a.mcap")
    shown = matrix(evaluate_files(sorted(tmp_path.glob("*.mcap"))))["synthetic"]
    assert (shown["valid"].text, shown["valid"].notes) == ("yes", ())
    assert (shown["envs alike"].text, shown["envs alike"].notes) == ("yes", ("all 2 envs",))
    write_recording(tmp_path, grid(1), options={"solver": "b"}, name="b.mcap")
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    shown = matrix(evaluation)["synthetic"]
    assert shown["valid"] == Cell("yes", notes=("partly not reported",), tone=Tone.WARNING)
    assert (shown["envs alike"].text, shown["envs alike"].notes) == ("yes", ("all 2 envs, 1 group not compared",))
    few, more = sorted(result.fidelity.held for result in evaluation.results)
    assert 0 < few <= more < DEMANDED
    printed = _printed(evaluation)
    stands = few if few == more else f"{few} to {more}"
    assert f"physics-2: a yes stands for {stands} of 22 checks; the others could not be made" in printed
    assert "\n-: not known or not reported\n" in printed


def fastest_of(evaluation: Evaluation) -> tuple[str, tuple[str, ...]]:
    """Who is faster and not ranked on the first screen, and why."""
    (found,) = [t for t in report(Source(evaluation, False, "")).tables() if t.key == "fastest"]
    said = found.rows[0].cells[[c.title for c in found.columns].index("faster, not ranked")]
    return said.text, said.notes


def test_each_is_unranked_for_its_own_reason(tmp_path: Path) -> None:
    """Say of each faster simulator on the first screen what speaks against it, not one reason for all."""
    write_recording(tmp_path, grid(2), simulator="honest", elapsed_s=4.0, proven=True)
    write_recording(tmp_path, grid(2), simulator="quick", elapsed_s=0.5, proven=True)
    sunk = grid(2)
    sunk[:, :9, 2] = -1.0
    write_recording(tmp_path, sunk, simulator="sinks", elapsed_s=2.0, proven=True)
    assert fastest_of(evaluate_files(sorted(tmp_path.glob("*.mcap")))) == (
        "quick: 4,000; sinks: 1,000",
        (
            "quick: protocol-2 not met: timed steps, or evidence of work",
            "sinks: INVALID, misplaced contacts, or mechanics broken",
        ),
    )


def test_the_first_screen_qualifies_the_speed_of_one_simulator(tmp_path: Path) -> None:
    """Say beside the throughput of a single simulator that it was timed too briefly."""
    write_recording(tmp_path, grid(2), elapsed_s=0.5, proven=True)
    blocks = report(Source(evaluate_files(sorted(tmp_path.glob("*.mcap"))), False, "")).blocks
    (speeds,) = [block for block in blocks if isinstance(block, Facts)]
    assert [cell.notes[-1] for _, cell in speeds.pairs] == [TOO_SHORT]


def test_the_first_screen_asks_for_no_speed_that_nobody_measured(tmp_path: Path) -> None:
    """Ask how fast simulators are where one was timed, and say so where none was."""
    for name in ("one", "other"):
        write_recording(tmp_path, grid(2), simulator=name, elapsed_s=None)
    document = report(Source(evaluate_files(sorted(tmp_path.glob("*.mcap"))), False, ""))
    assert document.title == "Which simulator repeats itself, and which is right?"
    said = [one.text for one in document.blocks if isinstance(one, Text)]
    assert "Not compared: repeats itself (needs at least two complete runs)." in said
    assert "Throughput was not measured: no recording has a timed phase." in said


def test_a_speed_without_a_rival_is_on_the_first_screen(tmp_path: Path) -> None:
    """Show how fast the only simulator of a scene is, where others were timed in another scene."""
    for name, elapsed_s in (("slow", 4.0), ("fast", 2.0)):
        write_recording(tmp_path, grid(2), simulator=name, elapsed_s=elapsed_s, proven=True)
    write_recording(tmp_path, None, n_env=2, simulator="slow", scene="franka", elapsed_s=8.0)
    blocks = report(Source(evaluate_files(sorted(tmp_path.glob("*.mcap"))), False, "")).blocks
    (speeds,) = [block for block in blocks if isinstance(block, Facts)]
    assert [(name, cell.text) for name, cell in speeds.pairs] == [("throughput, franka [env-steps/s]", "250")]


def test_a_long_command_is_closed(tmp_path: Path) -> None:
    """Show how a command that names hundreds of files begins, and all of it to who opens it."""
    write_recording(tmp_path, grid(2))
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    command = "gsb-eval " + " ".join(f"runs/mujoco-{run}.mcap" for run in range(200))
    page = render_html(evaluation, published=False, command=command)
    (opened,) = re.findall(r"<details class=key><summary><code>(gsb-eval [^<]*)\u2026</code>.*?<pre>(.*?)</pre>", page)
    assert len(opened[0]) <= 60
    assert opened[1] == command
    assert "<pre>gsb-eval runs</pre>" in render_html(evaluation, published=False, command="gsb-eval runs")


def test_many_simulators_have_a_line_each(tmp_path: Path) -> None:
    """Show a line a simulator where there are many, and no column in which nothing was compared."""
    for index in range(5):
        write_recording(tmp_path, grid(2), simulator=f"s{index}", elapsed_s=4.0)
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    (found,) = [t for t in report(Source(evaluation, False, "")).tables() if t.key == "simulators"]
    assert found.compact
    assert [c.title for c in found.columns] == ["simulator", "envs alike", "valid", "mechanics, physics-2"]
    assert '<div class="table compact"' in render_html(evaluation, published=False, command="")


@pytest.mark.parametrize("runs", [1, 3])
def test_a_group_alone_takes_fifteen_lines_at_most(tmp_path: Path, runs: int) -> None:
    """Say first whether it repeats itself, then the rest, on a terminal's first half."""
    for run in range(runs):
        write_recording(tmp_path, grid(2), run=run, name=f"{run}.mcap", gpu_bytes=(0, 10**9))
    stream = io.StringIO()
    print_document(brief(evaluate_files(sorted(tmp_path.glob("*.mcap")))), stream)
    lines = stream.getvalue().splitlines()
    assert len(lines) <= 15
    first = "all 3 runs are bit-identical" if runs > 1 else "whether it repeats itself is not known"
    assert first in lines[0]


def test_groups_without_a_complete_run_say_why(tmp_path: Path) -> None:
    """Say on a terminal's first screen, of several groups, how many runs ended early, and what ended the first."""
    for index in range(3):
        for run in range(2):
            failed = {"status": "FAILED", "reason": f"out of memory {index}", "name": f"{index}-{run}.mcap"}
            write_recording(tmp_path, grid(2), run=run, simulator=f"s{index}", **failed)

    def shown() -> str:
        stream = io.StringIO()
        print_document(brief(evaluate_files(sorted(tmp_path.glob("*.mcap")))), stream)
        return stream.getvalue()

    assert "3 groups: no run is complete\n" in shown()
    assert "s1: 2 of 2 runs not complete: failed: out of memory 1\nand 1 more with such runs\n" in shown()
    write_recording(tmp_path, grid(2), run=2, simulator="s2")
    assert "3 groups: no group has several runs to compare\n" in shown()
    assert "s0: 2 of 2 runs not complete: failed: out of memory 0\n" in shown()
