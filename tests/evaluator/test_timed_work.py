"""What stands beside a throughput: in every output that shows one, and the same in all of them."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.rules.findings import check
from gpusimbench.evaluator.check.rules.rule import Scope, Severity, load_rules
from gpusimbench.evaluator.cli.compare import main as compare
from gpusimbench.evaluator.cli.eval import main as evaluate
from gpusimbench.evaluator.cli.share import main as share
from gpusimbench.evaluator.render.formats import Format
from gpusimbench.evaluator.render.table_files import table_files
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.document import render_html, report
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.report.parquet import METRICS, frames
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.timed_work import SHORT_S, TimedWork, Window
from tests.evaluator.sets import WORDS
from tests.pages import text_of
from tests.synthetic import grid, write_recording, write_sweep

ROOT = Path(__file__).resolve().parents[2]
SMALL = sorted((ROOT / "recordings").glob("*.mcap"))
ELLIPTIC = {"cone": "elliptic", "iterations": 100, "tolerance": 1e-8}
PYRAMIDAL = {"friction_cone": "pyramidal", "solver_iterations": 7, "tolerance": 1e-6}


def recorded(folder: Path, final: Any = ..., **more: Any) -> list[Path]:
    """Two simulators that were timed over other steps, in other settings, one of them too shortly."""
    found, final = [], grid(2) if final is ... else final
    for run in range(2):
        common = {"run": run, "gpu_bytes": (0, 10**9), "whole": True, "proven": True, **more}
        found.append(write_recording(folder, final, simulator="long", warmup=100, elapsed_s=2.0 + run / 4,
                                     in_force=ELLIPTIC, **common))  # fmt: skip
        found.append(write_recording(folder, final, simulator="short", warmup=20, timed_steps=100,
                                     elapsed_s=0.5 + run / 4, in_force=PYRAMIDAL, **common))  # fmt: skip
    return found


def evaluated(folder: Path) -> Evaluation:
    """Of everything in a folder."""
    return evaluate_files(sorted(folder.glob("*.mcap")))


def text(found: Evaluation) -> str:
    """All that the command shows, in one line."""
    return " ".join(text_of(found).split())


def files(found: Evaluation, kind: Format) -> dict[str, str]:
    """The tables as files, by name."""
    made = table_files(report(Source(found, False, "")), [kind])
    return {Path(name).stem: file.decode() for name, file in made.items()}


SAID = ("100 to 1,100", "20 to 120", "elliptic", "pyramidal", "1e-08", "1e-06", "(< 1 s)")
"""What two such groups have beside their throughputs, wherever these are shown."""


def test_tables_say_what_was_timed(tmp_path: Path) -> None:
    """Show window, seconds, settings of the solver and rules not met beside every throughput."""
    recorded(tmp_path)
    told = " ".join(text(evaluated(tmp_path)).split())
    assert [one for one in SAID if one not in told] == []
    assert "protocol-2" in told


@pytest.mark.parametrize("shown", [text, lambda e: render_html(e, published=False, command="")], ids=["text", "html"])
def test_other_steps_are_named_as_not_comparable(shown: Callable[[Evaluation], str], tmp_path: Path) -> None:
    """Name the rows that were timed over other steps, and those that were timed too shortly; say nothing without."""
    recorded(tmp_path)
    told = shown(evaluated(tmp_path))
    assert re.search(
        r"NOT comparable by throughput: the timed steps of .* are .*; those of all others are ", told, re.DOTALL
    )
    assert "timed for less than 1 s, which is too short to rely on: short" in told
    alone = tmp_path / "alone"
    alone.mkdir()
    for run in range(2):
        write_recording(alone, grid(2), simulator="a", run=run, elapsed_s=2.0)
        write_recording(alone, grid(2), simulator="b", run=run, elapsed_s=3.0)
    told = shown(evaluated(alone))
    assert "NOT comparable by throughput" not in told
    assert "too short to rely on" not in told


def test_the_most_common_steps_are_those_of_all_others(tmp_path: Path) -> None:
    """Name the rows with other steps once, and the rest, which is larger, as all others."""
    recorded(tmp_path)
    write_recording(tmp_path, grid(2), simulator="third", warmup=100, elapsed_s=2.0)
    (said,) = timed.incomparable(evaluated(tmp_path).results)
    assert said == (
        "NOT comparable by throughput: the timed steps of short are 20 to 120 (100); those of all others are 100 to "
        "1,100 (1,000)"
    )


def test_the_first_screen_marks_what_was_timed_too_briefly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Put a sign before a throughput of less than a second, or of too few steps; none elsewhere."""

    def shown(*files: Path) -> str:
        assert evaluate([*map(str, files), "--no-cache"]) == 0
        return " ".join(capsys.readouterr().out.split())

    short, long = recorded(tmp_path)[1::2], recorded(tmp_path)[::2]
    few = [
        write_recording(tmp_path, grid(2), simulator="few", run=run, timed_steps=99, elapsed_s=2.0, whole=True,
                        gpu_bytes=(0, 10**9), proven=True) for run in range(2)
    ]  # fmt: skip
    legend = f"* {timed.TOO_SHORT}"
    assert "* " not in shown(*long)
    for alone in (short, few):
        told = shown(*alone)
        assert "throughput [env-steps/s] * " in told and told.count(legend) == 1
    told = shown(*long, *short, *few)
    assert told.count(legend) == 1
    assert [name for name in ("long", "short", "few") if re.search(rf"{name} 2 x 2 [^*±]*\* [\d,]+ ± ", told)] == [
        "short", "few",
    ]  # fmt: skip


def test_programs_get_the_same(tmp_path: Path) -> None:
    """Give window, seconds, settings and rules in the JSON and the Parquet table of metrics."""
    recorded(tmp_path)
    found = evaluated(tmp_path)
    long, short = (group["timed"] for group in to_json(found)["groups"])
    assert long["windows"] == [{"first_step": 100, "last_step": 1100, "steps": 1000}]
    assert (long["seconds"], long["under_1_s"]) == ([2.0, 2.25], False)
    assert short["windows"] == [{"first_step": 20, "last_step": 120, "steps": 100}]
    assert (short["seconds"], short["under_1_s"]) == ([0.5, 0.75], True)
    assert short["settings"] == {"cone": "pyramidal", "iterations": "7", "tolerance": "1e-06"}
    assert short["protocol_not_met"].keys() - long["protocol_not_met"].keys() == {
        "timed-seconds",
        "window-begin",
        "same-window",
    }
    table = frames(found)[METRICS]
    speeds = {row["simulator"]: row for row in table.to_dicts() if row["metric"] == "fps"}
    assert (speeds["short"]["first_timed_step"], speeds["short"]["last_timed_step"]) == (20, 120)
    assert speeds["short"]["shortest_timed_s"] == 0.5
    assert speeds["long"]["protocol_findings"] == long["protocol_findings"]


def test_sweeps_and_their_charts_say_it(tmp_path: Path) -> None:
    """Mark short points of a sweep in the terminal, in files and behind the curves."""
    write_sweep(tmp_path, (16, 64, 256), scene="free-fall", warmup=100)
    found = evaluated(tmp_path)
    told = text(found)
    assert "0.16 (< 1 s)" in told
    assert "all rows: timed steps: 100 to 1,100 (1,000)" in told
    made = files(found, Format.CSV)
    assert "0.16 (< 1 s)" in made["scaling-points-free-fall-synthetic"]
    assert "steps 100 to 1,100 (1,000)" in made["capability-free-fall"]
    point = to_json(found)["sweeps"][0]["points"][0]
    assert point["timed"]["under_1_s"] is True


def test_ranked_apart_where_timed_apart(tmp_path: Path) -> None:
    """Give places of a leaderboard among the same timed steps alone, and say beside each what was timed."""
    runs, out = tmp_path / "runs", tmp_path / "board"
    runs.mkdir()
    recorded(runs, None)
    assert share(["leaderboard", str(runs), "--out", str(out), "--no-cache"]) == 0
    sections = json.loads((out / "leaderboard.json").read_text())["sections"]
    assert {s["timed"]: [(r["simulator"], r["place"]) for r in s["rows"]] for s in sections} == {
        "steps 100 to 1,100": [("long", 1)],
        "steps 20 to 120": [("short", None)],
    }
    page = (out / "index.html").read_text()
    assert "the timed window does not begin at step 100 of the scene; the timed phase takes less than 1 s" in page
    assert "20 to 120 (100)" in (out / "leaderboard.csv").read_text()


def test_cards_say_it(tmp_path: Path) -> None:
    """Show it in the card of a set, with what cannot be compared."""
    recorded(tmp_path)
    assert share(["card", str(tmp_path), *WORDS]) == 0
    card = (tmp_path / "README.md").read_text()
    assert "| timed steps | seconds timed | cone, iterations, tolerance | protocol-2 rules not met |" in card
    assert "20 to 120 (100)" in card
    assert "NOT comparable by throughput" in card


def test_comparisons_warn_where_sides_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Warn of sides that were timed over other steps, too shortly or in other settings; not of equal ones."""
    sides = [tmp_path / "base", tmp_path / "head"]
    for side, warmup, options in zip(sides, (20, 100), (ELLIPTIC, PYRAMIDAL), strict=True):
        side.mkdir()
        for run in range(3):
            write_recording(side, grid(2), run=run, warmup=warmup, elapsed_s=0.5, in_force=options)
    target = tmp_path / "found.json"
    compare([str(sides[0]), "--head", str(sides[1]), "--across", "warmup", "--json", str(target)])
    shown = " ".join(capsys.readouterr().out.split())
    (found,) = json.loads(target.read_text())["compared"]
    over = "base was timed over steps 20 to 1,020 of the scene, head over steps 100 to 1,100"
    assert over in shown
    warned = " ".join(found["warnings"])
    assert over in warned
    assert "too short to rely on: base (0.5 s), head (0.5 s)" in warned
    assert "base has elliptic, 100, 1e-08; head has pyramidal, 7, 1e-06" in warned
    assert found["base"]["timed"]["windows"][0]["first_step"] == 20
    alike = TimedWork((Window(1, 3),), (2.0, 3.0), {"cone": "elliptic"})
    assert timed.of_sides(alike, alike) == []


def test_info_marks_a_short_phase(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say of one file from which step on it was timed, and that this was too short."""
    from gpusimbench.evaluator.cli.info import main as info

    assert info([str(write_recording(tmp_path, grid(2), warmup=20, elapsed_s=0.5))]) == 0
    assert "1000 steps, from step 20, in 0.5 s (< 1 s)" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("seconds", [(0.9999, 0.9999), (SHORT_S, SHORT_S), (0.02, 3.0)])
def test_what_is_short_never_looks_long(seconds: tuple[float, float]) -> None:
    """Mark exactly what is below the limit, and round nothing up to it."""
    work = TimedWork((Window(0, 10),), seconds)
    assert ("(< 1 s)" in timed.seconds(work)) == (seconds[0] < SHORT_S)
    assert not re.match(r"1(\.0*)? \(<", timed.seconds(work))


@pytest.mark.parametrize("which", ["shipped", "synthetic"])
def test_rules_not_met_are_those_of_gsb_check(which: str, tmp_path: Path) -> None:
    """Count the errors of gsb-check --protocol, rule by rule, and lose none between the groups."""
    paths = SMALL if which == "shipped" else recorded(tmp_path, status="FAILED", reason="it broke")
    report = check([examine(path) for path in paths], [load_rules("protocol-2")])
    errors = [f for f in report.findings if f.rule.level is Severity.error and f.rule.of is not Scope.set]
    assert errors
    found = evaluate_files(paths)
    assert found.unmet.findings == Counter(f.rule.id for f in errors)
    assert sum(r.timed.unmet.count for r in found.results) >= found.unmet.count


def test_rules_of_points_are_those_of_their_groups(tmp_path: Path) -> None:
    """Hold too few runs of one simulator against no other: neither against one before nor one behind it by name."""
    for name, runs in (("a", 10), ("m", 1), ("z", 10)):
        for run in range(runs):
            write_recording(tmp_path, grid(2), simulator=name, run=run)
    found = {r.group.key.simulator: r.timed.unmet.findings for r in evaluated(tmp_path).results}
    assert {name: unmet.get("runs", 0) for name, unmet in found.items()} == {"a": 0, "m": 1, "z": 0}


def test_the_command_says_how_often(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Name the number of findings of the whole set below the tables."""
    paths = recorded(tmp_path)
    assert evaluate([*map(str, paths), "--no-cache"]) == 0
    count = evaluate_files(paths).unmet.count
    assert f"rules of protocol-2 {count} times" in " ".join(capsys.readouterr().out.split())
