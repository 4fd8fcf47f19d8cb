"""What an audit says in words: every count and every cut of a text, on audits whose outcome is given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.audit.audit import Audit, Check, Outcome, judge_replays
from gpusimbench.evaluator.audit.distribution import LawTest, Unit
from gpusimbench.evaluator.audit.replays import DifferingSettings, Replays, sorted_out
from gpusimbench.evaluator.audit.sections import audit_document
from gpusimbench.evaluator.audit.verdict import AuditLevel, Match, ladder
from gpusimbench.evaluator.compute.recorder import Made
from gpusimbench.evaluator.diff.compare import compare
from gpusimbench.evaluator.diff.result import Setting
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import Code, Facts, Items, Table, Text, walk
from tests.synthetic import grid, write_recording

NO_FINDINGS = Check((), {}, {}, {})


@pytest.fixture(scope="module")
def five(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    """Five recordings of two environments; in the last, one cube of the second ends 2 m higher."""
    folder = tmp_path_factory.mktemp("five")
    moved = grid(2)
    moved[1, 3, 2] += 2.0
    finals = [grid(2), grid(2), grid(2), grid(2), moved]
    return [
        open_recording(write_recording(folder, final, run=run, name=f"{run}.mcap")) for run, final in enumerate(finals)
    ]


def lines(audit: Audit, checked: Check = NO_FINDINGS, *, every: bool = False) -> list[str]:
    """What a report says, without its layout: the verdict first; facts, remarks, rows and commands a line each."""
    found = []
    for block in walk(audit_document(audit, checked, every=every).blocks):
        if isinstance(block, Text):
            found.append(block.text.strip())
        elif isinstance(block, Facts):
            found += [f"{name}: {said}" for name, cell in block.pairs for said in cell.lines]
        elif isinstance(block, Items):
            found += [item.text.strip() for item in block.items]
        elif isinstance(block, Table):
            found += [" | ".join(cell.text for cell in row.cells) for row in block.rows]
        elif isinstance(block, Code):
            found += block.lines
    return found


def made(recordings: list[Recording]) -> Replays:
    """Replays that all came to their end."""
    return Replays("gsb-record --replay x", tuple(Made("complete", "", Path(str(r.path))) for r in recordings), "")


def test_the_set_and_its_files_are_counted(five: list[Recording]) -> None:
    """Count the other originals, and name three recordings of replays and how many more there are."""
    alone = lines(Audit((five[0],)))
    assert alone[0] == "No verdict: there is nothing to replay: 0.mcap"
    assert "recording: synthetic 1.0, inclined-collision, 2 envs, dt 1 s, complete" in alone
    assert lines(Audit((five[0], five[1])))[0].endswith(": 0.mcap and 1 more of its set")
    three = lines(Audit((five[0],), made(five[1:4]), tuple(five[1:4])))
    assert [line for line in three if "complete: " in line] == [f"replays: complete: {r.path}" for r in five[1:4]]
    assert not any(line.endswith(" more") for line in three)
    four = lines(Audit((five[0],), made(five[1:]), tuple(five[1:])))
    assert [line for line in four if "complete: " in line] == [f"replays: complete: {r.path}" for r in five[1:4]]
    assert "replays: and 1 more" in four
    every = lines(Audit((five[0],), made(five[1:]), tuple(five[1:])), every=True)
    assert {str(r.path) for r in five[1:]} <= set(every)


@pytest.mark.parametrize(("length", "shown"), [(200, "x" * 200), (201, "x" * 197 + "...")])
def test_a_long_command_is_cut(five: list[Recording], length: int, shown: str) -> None:
    """Show 200 characters of the command that made a recording."""
    original = open_recording(five[0].path)
    original.provenance = replace(original.provenance, argv=("x" * length,))
    assert [line for line in lines(Audit((original,)), every=True) if line.startswith("x")] == [shown]


def test_distinct_runs_are_counted(five: list[Recording]) -> None:
    """Tell the numbers of runs from those of distinct runs, there, here and together."""
    audit = Audit(tuple(five[:2]), made(five[2:]), tuple(five[2:]), distinct=(1, 2, 3))
    assert "runs: 2 originals, 1 distinct by state hashes; 3 replays, 2 distinct; 3 distinct together" in lines(audit)
    unknown = replace(audit, distinct=None)
    assert "runs: 2 originals, 3 replays; without state hashes, bits are not compared" in lines(unknown)
    assert not any(line.startswith("runs: ") for line in lines(Audit(tuple(five))))


def test_findings_come_once_each(five: list[Recording]) -> None:
    """Give a finding of several files once, broken rules before warnings, and say which of the two it is."""
    paths = [r.path for r in five[:2]]
    check = Check((), {}, dict.fromkeys(paths, ("it is broken",)), dict.fromkeys(paths, ("it is odd",)))
    text = lines(Audit(tuple(five[:2])), check)
    assert [line for line in text if line in ("check: it is broken", "check: it is odd")] == [
        "check: it is broken",
        "check: it is odd",
    ]
    assert "check: integrity-1 is broken" in text
    assert "; a file breaks integrity-1: " in text[0]
    warned = lines(Audit(tuple(five[:2])), replace(check, broken={}))
    assert "check: integrity-1 holds, with warnings" in warned
    assert "check: integrity-1 holds" in lines(Audit(tuple(five[:2])))
    assert any(line.startswith("content hash: ") for line in warned)


def test_the_first_difference_is_in_numbers(five: list[Recording]) -> None:
    """Give step, time, environment, cube, both values and their distance of what differs first."""
    audit = Audit((five[0],), made(five[4:]), (five[4],), compare(five[0], five[4]))
    text = lines(audit)
    assert "differs: from step 5 (5 s), first in env 1, in 1 env at that step" in text
    found = compare(five[0], five[4])
    assert found.first is not None
    strided = replace(audit, difference=replace(found, first=replace(found.first, after_step=0)))
    said = "from step 5 (5 s); equal up to step 0, no step in between is known; first in env 1, in 1 env at that step"
    assert f"differs: {said}" in lines(strided)
    (number,) = [line for line in text if "cubes/position" in line]
    assert ", z: 0.03 there, 2.03 here, " in number
    assert number.endswith(" ULP, 2 m")
    assert "settings: the same" in text


def test_a_number_of_an_array_without_bodies(five: list[Recording]) -> None:
    """Name it by field and component, as gsb-diff does, without a body or a unit that nobody knows."""
    found = compare(five[0], five[4])
    assert found.first is not None and found.first.state is not None
    number = replace(found.first.state.number, field="env/action", item="", component="0", unit="unknown")
    first = replace(found.first, state=replace(found.first.state, number=number))
    text = lines(Audit((five[0],), made(five[4:]), (five[4],), replace(found, first=first)))
    (said,) = [line for line in text if "env/action" in line]
    assert said.startswith("differs: env/action[0]: 0.03 there, 2.03 here, ") and said.endswith(" ULP, 2")


def test_a_replay_that_differs_is_the_one_shown(five: list[Recording]) -> None:
    """Show what differs, whichever of the replays it is, and the sameness where all are the same."""
    same, other = five[1], five[4]
    for found, alike in (((same, other), False), ((other, same), False), ((same, five[2]), True)):
        audit = judge_replays((five[0],), made(list(found)), found, max_ulps=4)
        assert audit.difference.bit_identical is alike
        assert audit.distinct == ((1, 1, 1) if alike else (1, 2, 2))


def test_an_original_that_did_not_come_out_again(five: list[Recording]) -> None:
    """Decide nothing of a set of which a file was not reproduced; of a single file, that it is another."""
    for originals, rungs, said in (
        ((five[0], five[2]), [True] * 4, "Re-execution gives the same bits (bit-identical)"),
        ((five[0], five[4]), [None] * 4, "Re-execution gives the same bits as far as compared; not everything was"),
        ((five[4],), [False, False, False, None], "Re-execution gives other bits; undecided whether of the same"),
    ):
        audit = judge_replays(originals, made(five[1:2]), (five[1],), max_ulps=4)
        assert [rung.holds for rung in audit.verdict.rungs] == rungs
        text = lines(audit)
        assert text[0].startswith(said)
        for rung in audit.verdict.rungs:  # a level that follows from the one reached is not said
            shown = any(line.endswith(f" {rung.level.value}: {rung.said}") for line in text)
            assert shown == (rung.holds is not True or rung.level is audit.verdict.level)


def test_settings_are_cut_and_counted(five: list[Recording]) -> None:
    """Cut a value of more than 60 characters to 60, list all settings of a difference, and count packages."""
    same, other = compare(five[0], five[1]), compare(five[0], five[4])
    settings = DifferingSettings((Setting("engine.cone", "a" * 60, "b" * 61),), 3)
    differing = lines(Audit((five[0],), made(five[4:]), (five[4],), other, settings), every=True)
    assert f"engine.cone | {'a' * 60} | {'b' * 57}..." in differing
    assert "settings: 1 differs: engine.cone; and 3 other installed packages" in differing
    equal = lines(Audit((five[0],), made(five[1:2]), (five[1],), same, settings))
    assert "settings: 1 differs, although the bits are the same: engine.cone; and 3 other installed packages" in equal
    assert not any("|" in line for line in equal)
    none = lines(Audit((five[0],), made(five[1:2]), (five[1],), same, DifferingSettings((), 3)))
    assert "settings: the same but for 3 other installed packages" in none
    many = DifferingSettings(tuple(Setting(f"environment.NAME_{number}", "a", "b") for number in range(20)))
    audit = Audit((five[0],), made(five[1:2]), (five[1],), same, many)
    named = "environment.NAME_0, environment.NAME_1, environment.NAME_2, environment.NAME_3 and 16 more"
    assert f"settings: 20 differ, although the bits are the same: {named}" in lines(audit)
    assert "environment.NAME_19 | a | b" in lines(audit, every=True)


@pytest.mark.parametrize(("count", "shown", "more"), [(0, 0, None), (4, 4, None), (5, 3, 2), (7, 3, 4)])
def test_notes_are_cut_and_counted(five: list[Recording], count: int, shown: int, more: int | None) -> None:
    """Show three notes of many and how many more there are, and no line that stands for one note alone."""
    notes = tuple(f"number {number}" for number in range(count))
    audit = Audit((five[0],), made(five[4:]), (five[4],), replace(compare(five[0], five[4]), notes=notes))
    text = lines(audit)
    assert [line for line in text if line.startswith("note: number")] == [f"note: {note}" for note in notes[:shown]]
    assert [line for line in text if "more notes" in line] == (
        [] if more is None else [f"and {more} more notes, printed with --all"]
    )
    assert {f"note: {note}" for note in notes} <= set(lines(audit, every=True))


def test_what_has_no_verdict_says_why(five: list[Recording]) -> None:
    """Say for each outcome why there is no verdict, and what ended the replays."""
    stopped = Replays("gsb-record", (Made("stopped", "memory", None),), "")
    failed = Replays("gsb-record", (Made("failed", "it broke", None), Made("complete", "", None)), "")
    refused = Replays("gsb-record", (), "no such engine")
    nothing, invalid = Audit(tuple(five)), Replays("gsb-record", (Made("invalid", "it slid", None),), "")
    outcomes = {
        Outcome.NOT_TRIED: nothing,
        Outcome.STOPPED: replace(nothing, replays=stopped),
        Outcome.FAILED: replace(nothing, replays=failed),
        Outcome.REFUSED: replace(nothing, replays=refused),
        Outcome.MADE: replace(nothing, replays=made(five[:1]), recordings=(five[0],)),
    }
    assert {outcome: audit.outcome for outcome, audit in outcomes.items()} == {outcome: outcome for outcome in outcomes}
    verdicts = [line for audit in outcomes.values() for line in lines(audit) if line.startswith("No verdict: ")]
    assert len(set(verdicts)) == 5
    assert "replays: failed: it broke" in lines(outcomes[Outcome.FAILED])
    assert {"refused:", "gsb-record"} <= set(lines(outcomes[Outcome.REFUSED]))
    assert {"run here:", "gsb-record"} <= set(lines(outcomes[Outcome.FAILED]))
    assert lines(replace(nothing, replays=invalid))[0].startswith("A replay is invalid, and the recording is not (diff")
    assert replace(nothing, replays=invalid).meets(AuditLevel.DIFFERENT) is False
    assert nothing.meets(AuditLevel.SAME_DISTRIBUTION) is None


def test_the_first_difference_names_each_number_once(five: list[Recording]) -> None:
    """Say that the signs differ beside both numbers, and do not repeat the numbers there."""
    found = compare(five[0], five[4])
    assert found.first is not None and found.first.state is not None
    number = replace(found.first.state.number, a="0.25", b="-0.25", distance=0.5, unit="m")
    first = replace(found.first, state=replace(found.first.state, number=number))
    audit = Audit((five[0],), made(five[4:]), (five[4],), replace(found, first=first))
    (named,) = (line for line in lines(audit) if " there, " in line)
    assert named.endswith(": 0.25 there, -0.25 here, the signs differ, 50 cm")


def said(*matches: Match, law: LawTest | str = "no positions", originals: int = 1) -> list[str]:
    """The sentences of a ladder, strongest level first, with 4 ULP allowed."""
    return [rung.said for rung in ladder(matches, lambda: law, max_ulps=4, originals=originals).rungs]


def test_replays_of_a_rung_are_counted() -> None:
    """Count the replays that reach a level among all, and give the largest distance over the fewest steps."""
    same, turned = Match(True, True, 0, steps=9), Match(False, True, 10**9, steps=8)
    near, far = Match(False, False, 3, steps=7), Match(False, False, 5000, steps=6)
    assert said(same, turned, far)[:3] == [
        "1 of 3 replays agree with an original in every bit",
        "2 of 3 replays have the environments of an original in any order",
        "largest distance 5,000 ULP over 6 recorded steps; 4 are allowed",
    ]
    assert said(same, turned, near)[2] == "largest distance 3 ULP over 7 recorded steps; 4 are allowed"
    turned_over = replace(far, signs_differ=True)
    assert said(turned_over)[2] == "numbers have opposite signs over 6 recorded steps; 4 ULP are allowed"
    assert said(replace(near, steps=0))[2] == "largest distance 3 ULP; 4 are allowed"
    assert ladder([replace(near, max_ulp=4)], lambda: "", max_ulps=4, originals=1).level is AuditLevel.WITHIN_ULPS
    assert said(turned)[2] == "follows from same-up-to-env-order"


LAW = LawTest(5.0, Unit.RUNS, 3, 4, 8, 8, 1.25, 2.5, 0.5, 0.01, 199, False, 0)


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        (LAW, "p = 0.5: 3 original and 4 replayed runs exchanged; not rejected at 0.05"),
        (replace(LAW, p_value=0.01), "p = 0.01: 3 original and 4 replayed runs exchanged"),
        (replace(LAW, envs_per_run=7), "replayed runs exchanged, 7 of 8 envs each; not rejected at 0.05"),
        (replace(LAW, least_p=0.1), "too few to show a difference (p is at least 0.1): give --runs 5"),
    ],
)
def test_the_test_of_one_law_in_words(law: LawTest, expected: str) -> None:
    """Give distance, floor, p-value, what was exchanged, and how many runs could decide."""
    words = said(Match(False, False, None), law=law, originals=2)[-1]
    assert words.startswith("W1 at 5 s: 1.25 cm (up to 2.5 cm in 95 % if they have one distribution), p = ")
    assert words.endswith(expected)


def test_missing_runs_have_a_price(five: list[Recording]) -> None:
    """Say how long the runs would take that the test asks for, from the time that the replays took."""
    replays = replace(made([five[4]] * 2), seconds=128.0)
    verdict = judge_replays((five[0],), replays, (five[4], five[4]), max_ulps=4).verdict
    assert verdict is not None and verdict.level is None
    assert verdict.rungs[-1].said.endswith("give --runs 19 (about 20 min 16 s on this machine)")


def test_levels_of_a_p_value_at_the_border() -> None:
    """Reject at exactly five per cent, and be able to at exactly that."""
    assert replace(LAW, p_value=0.05).rejects
    assert not replace(LAW, p_value=float(np.nextafter(0.05, 1))).rejects
    assert replace(LAW, least_p=0.05).can_reject


def test_packages_that_compute_decide() -> None:
    """Take for deciding what either recorder lists among what computes, and count other packages."""
    original, replay = (
        SimpleNamespace(provenance=SimpleNamespace(software={"packages": packages}))
        for packages in ({"numpy": "1"}, {"scipy": "1"})
    )
    names = ("numpy", "scipy", "black", "ruff")
    packages = tuple(Setting(f"software.packages.{name}", "1", "2") for name in names)
    others = tuple(Setting(name, "1", "2") for name in ("compression", "timeout", "host.cpu"))
    found = sorted_out((*packages, *others), original, replay)  # type: ignore[arg-type]
    assert found == DifferingSettings((*packages[:2], others[2]), 2)
