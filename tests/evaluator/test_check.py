"""gsb-check as a user calls it, the rule sets that ship, and rule sets of one's own."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.rules.fact import Unknown
from gpusimbench.evaluator.check.rules.facts import CONDITIONS, FACTS, applies, fact_of
from gpusimbench.evaluator.check.rules.findings import check
from gpusimbench.evaluator.check.rules.predicates import FILE_PREDICATES, SET_PREDICATES
from gpusimbench.evaluator.check.rules.rule import SHIPPED, Scope, Severity, load_rules, parse_rules
from gpusimbench.evaluator.cli.check import main
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.commands import SCHEMA_VERSION
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import PROVENANCE, SIMULATION
from tests.conftest import Command
from tests.evaluator.damaged import BYTES, SCENE_CHANGED, whole
from tests.synthetic import Shown, changing, configured, grid, write_recording
from tests.test_docs import blocks, commands, shell

ROOT = Path(__file__).resolve().parents[2]
H200 = ROOT / "recordings" / "h200"
PROTOCOL = load_rules("protocol-1")


def broken(*paths: Path) -> set[str]:
    """Rules of protocol-1 that files break."""
    return {finding.rule.id for finding in check([examine(path) for path in paths], [PROTOCOL]).findings}


def test_a_whole_file(gsb_check: Command, small: Path) -> None:
    """Say on standard output alone that every rule holds, and end with 0."""
    done = gsb_check(small, code=0)
    assert not done.stderr
    *lines, status = done.stdout.splitlines()
    verdict = " ".join(" ".join(lines).split())
    assert verdict == f"PASSED: no error and no warning in {small.name} (rules: integrity-1 and recorders-1)"
    assert re.fullmatch(r"the run is complete; \d+ rules met", status)


@pytest.fixture(scope="module")
def gsb_check() -> Command:
    """Call gsb-check with the given arguments."""
    from tests.conftest import call

    return lambda *arguments, **keywords: call("gsb-check", *arguments, **keywords)


def test_a_set_that_follows_the_protocol() -> None:
    """Find no error in ten runs of a simulator on a GPU that were made as the protocol asks."""
    files = [examine(path) for path in sorted(H200.glob("genesis-inclined-collision-n16-r*.mcap"))]
    report = check(files, [load_rules("integrity-1"), PROTOCOL])
    assert len(files) == 10
    assert report.exit_code == ExitCode.OK
    assert report.count(Severity.error) == 0
    assert report.unchecked == ()
    fewer = check(files[:9], [PROTOCOL])
    assert [(f.rule.id, f.found) for f in fewer.findings if f.rule.level is Severity.error] == [
        ("runs", "9 of 9 files counted, 10 are needed")
    ]
    assert fewer.exit_code == ExitCode.GATE_FAILED


def test_copies_are_found(tmp_path: Path) -> None:
    """Find a run that is there twice, under another name, by its run id and by its content."""
    runs = sorted(H200.glob("genesis-inclined-collision-n16-r*.mcap"))[:2]
    copy = tmp_path / "another-run.mcap"
    shutil.copy(runs[0], copy)
    found = {f.rule.id: f for f in check([examine(path) for path in (*runs, copy)], [PROTOCOL]).findings}
    assert {"distinct-runs", "distinct-content", "distinct-numbers"} <= set(found)
    assert set(found["distinct-content"].files) == {runs[0], copy}


def test_one_run_id_and_two_contents(tmp_path: Path) -> None:
    """Call two contents under one run id damage: one of them is not what was recorded."""
    paths = [whole(tmp_path, run_id="the same", name=f"{name}.mcap", reason=name, status="INVALID") for name in "ab"]
    report = check([examine(path) for path in paths], [load_rules("integrity-1")])
    assert [finding.rule.id for finding in report.findings] == ["one-content-a-run"]
    assert report.exit_code == ExitCode.DATA_LOST
    for path in paths:  # whose run id is not known any more
        path.write_bytes(BYTES["an attachment"][1](path.read_bytes()))
    report = check([examine(path) for path in paths], [load_rules("integrity-1")])
    assert "one-content-a-run" not in {finding.rule.id for finding in report.findings}


_recorder = partial(changing, PROVENANCE, "software", "recorder")
_BROKEN: dict[str, dict[str, Any]] = {
    "scene": {"change": configured(scene="mine")},
    "scene-unchanged": {"change": changing(SIMULATION, "scene", sha256="0" * 64)},
    "environments": {},  # two
    "power-of-two": {"change": configured(scene="franka", n_env=12)},
    "trials": {"simulator": "real"},
    "dt": {},  # one second
    "dt-of-scene": SCENE_CHANGED,
    "throughput-timed": {"change": configured(scene="free-fall", phases=["capture"])},
    "outcome-captured": {"change": configured(phases=["timed"])},
    "sample-step": {"dt": 0.01, "change": configured(steps=500)},  # the states end at step 5
    "warm-up": {"change": configured(warmup=99)},
    "timed-steps": {"change": configured(timed_steps=999)},
    "timed-phases": {},  # no events
    "captured-phases": {},
    "host-memory": {},
    "gpu-memory": {"gpu_bytes": (1, 2)},
    "peak-sampled": {},
    "complete": {"status": "FAILED", "reason": "gone"},
    "recorder-known": {"change": _recorder(commit="")},
    "recorder-unmodified": {"change": _recorder(modified=True)},
    "runs": {},
}


@pytest.mark.parametrize("status", ["FAILED", "INVALID"])
def test_a_sample_step_that_was_only_asked_for(status: str, tmp_path: Path) -> None:
    """Look for the state at the sample step among the states of a run that ended before it, and of one that did not."""
    ended = {"status": status, "reason": "gone", "dt": 0.01}
    assert "sample-step" in broken(whole(tmp_path, **ended, change=configured(steps=500)))
    assert "sample-step" in broken(whole(tmp_path, **ended, steps=501, stride=3))
    assert "sample-step" not in broken(whole(tmp_path, **ended, steps=500))


def test_steps_that_were_only_asked_for(tmp_path: Path) -> None:
    """Count the clocks of the warm-up and of the timed steps of a complete run, not what was asked of it."""

    def clocked(intervals: int, **keywords: Any) -> set[str]:
        start = [2 * k for k in range(intervals)]
        message = message_class("gsb.v1.StepTiming")(
            steps_per_interval=10, start_ns=start, end_ns=[begin + 1 for begin in start]
        )
        raw = (("/timing/warmup", "gsb.v1.StepTiming", message),)
        return broken(whole(tmp_path, change=configured(warmup=100), shown=Shown(raw=raw), **keywords))

    rules = {"warm-up", "timed-steps"}
    assert clocked(10) & rules == set()
    assert clocked(9) & rules == {"warm-up"}
    assert clocked(10, elapsed_s=None, status="FAILED", reason="gone") & rules == set()
    untimed = whole(tmp_path, elapsed_s=None, change=configured(warmup=100, phases=["timed", "capture"]))
    assert broken(untimed) & rules == rules


@pytest.mark.parametrize("rule", _BROKEN)
def test_each_rule_of_the_protocol_can_be_broken(rule: str, tmp_path: Path) -> None:
    """Name the rule that a recording breaks."""
    assert rule in broken(whole(tmp_path, **_BROKEN[rule]))


_DIFFER: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "same-configuration": ({"run": 0}, {"run": 1, "change": configured(seed=1)}),
    "same-engine": ({"run": 0}, {"run": 1, "switches": {"precision": "float32"}}),
    "same-environment": ({"run": 0}, {"run": 1, "environment": {"XLA_FLAGS": "--fast"}}),
    "same-gpus": ({"run": 0}, {"run": 1, "gpu_bytes": (1, 2)}),
    "same-software": ({"run": 0}, {"run": 1, "change": _recorder(version="2")}),
    "distinct-numbers": ({"run": 3}, {"run": 3}),
}


@pytest.mark.parametrize("rule", _DIFFER)
def test_runs_that_do_not_belong_together(rule: str, tmp_path: Path) -> None:
    """Name what differs between two runs of a point."""
    assert rule in broken(*(whole(tmp_path, **keywords) for keywords in _DIFFER[rule]))


def test_another_machine(tmp_path: Path) -> None:
    """Name what differs between the machines of two runs, and the run that stands out."""

    other = changing(PROVENANCE, "host", cpu="another")
    paths = [whole(tmp_path, run=0), whole(tmp_path, run=1), whole(tmp_path, run=2, change=other)]
    (found,) = (f for f in check([examine(p) for p in paths], [PROTOCOL]).findings if f.rule.id == "same-machine")
    assert found.found == "cpu is test in 2 files, another in 1 file"
    assert found.files == (paths[2],)


def test_no_rule_is_without_a_test() -> None:
    """Break every rule of the protocol somewhere in this file."""
    elsewhere = {"same-machine", "distinct-runs", "distinct-content"}
    assert {rule.id for rule in PROTOCOL.rules} == set(_BROKEN) | set(_DIFFER) | elsewhere


def test_what_is_damage_and_what_is_a_warning() -> None:
    """Call a file damaged whose content is not what was recorded; of what it says of itself, some is only wrong, and
    what takes nothing from the data is a warning."""
    rules = [rule for name in ("integrity-1", "recorders-1") for rule in load_rules(name).rules]
    warnings = {"known-records", "crc-present", "confirmed", "observer", "misplaced-contacts", "known-errors"}
    wrong = {"hashes-at-every-step", "clocks", "consistent", "provenance"}
    assert {rule.id for rule in rules if rule.level is Severity.warning} == warnings
    assert {rule.id for rule in rules if not rule.damage} == warnings | wrong


def test_the_end_of_a_sweep_needs_no_complete_runs(tmp_path: Path) -> None:
    """Ask the point at which a sweep ended for no runs; the points below it for ten."""
    below = [write_recording(tmp_path, None, n_env=2, run=run) for run in range(10)]
    limit = write_recording(
        tmp_path, None, n_env=4, built=False, status="FAILED", reason="memory", cause="DEVICE_MEMORY"
    )
    assert "runs" not in broken(*below, limit)
    assert "runs" in broken(*below[:9], limit)
    assert "runs" in broken(limit)


def test_the_protocol_knows_the_scenes() -> None:
    """Hold the scenes' hashes of protocol-1 to the scenes that the recorder has."""
    (rule,) = (rule for rule in PROTOCOL.rules if rule.id == "scene-unchanged")
    for name in rule.scenes:
        assert make_scene(name).sha256() in rule.argument, f"{name} changed: recordings of it need another rule set"
        assert make_scene(name).dt == 0.01


def test_every_rule_of_the_protocol_says_what_is_wrong(gsb_check: Command, small: Path) -> None:
    """Print what is wrong and what to do of a broken rule, and not a sentence that reads as if the rule held."""
    assert all(rule.broken and rule.broken != rule.requires for rule in PROTOCOL.rules)
    said = " ".join(gsb_check("--protocol", small).stdout.split())
    assert "error runs: The point has fewer than 10 complete runs; 1 of 1 file counted, 10 are needed in" in said
    assert "error timed-steps: Fewer than 100 timed steps have clocks; found" in said
    assert "Fix: Record with --timed-steps 100 or more." in said
    assert "At least 100 steps are timed" not in said


def test_damage_and_broken_rules_together(gsb_check: Command, tmp_path: Path) -> None:
    """Report a damaged file, one that breaks a rule and one that is no recording; damage decides the exit code."""
    good = whole(tmp_path, name="good.mcap")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(BYTES["an attachment"][1](good.read_bytes()))
    (tmp_path / "text.mcap").write_text("no recording at all, and long enough")
    done = gsb_check("--protocol", good, damaged, tmp_path / "text.mcap", tmp_path / "missing.mcap")
    assert done.returncode == ExitCode.DATA_LOST
    for text in ("error attachment-crc", "error recording", "error window-begin", "not checked: ", "No such file"):
        assert text in " ".join(done.stdout.split()), text
    assert "Traceback" not in done.stderr
    assert all(len(line) <= 120 or str(tmp_path) in line for line in done.stdout.splitlines())
    assert gsb_check("--protocol", good).returncode == ExitCode.GATE_FAILED
    assert gsb_check(good).returncode == ExitCode.OK


def test_warnings_do_not_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tell a warning and end with 0."""
    path = whole(tmp_path)
    path.write_bytes(BYTES["no CRC"][1](path.read_bytes()))
    assert main([str(path)]) == 0
    assert "warning crc-present: the data section has no CRC" in capsys.readouterr().out


def test_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Write findings with rule, files, what was found and what to do, under a version."""
    path = whole(tmp_path, dropout="the disk was full")
    assert main([str(path), "--json", "-"]) == ExitCode.DATA_LOST
    document = json.loads(capsys.readouterr().out)
    assert (document["schema_version"], document["exit_code"]) == (SCHEMA_VERSION, 3)
    assert document["rule_sets"] == ["integrity-1", "recorders-1"]
    (finding,) = document["findings"]
    assert finding["rule"] == "no-dropouts"
    assert finding["files"] == [str(path)]
    assert "the disk was full" in finding["found"]
    assert main([str(path), "--json", str(tmp_path / "out.json")]) == ExitCode.DATA_LOST
    assert json.loads((tmp_path / "out.json").read_text()) == document


def test_files_without_findings_are_counted(gsb_check: Command, tmp_path: Path) -> None:
    """Say the verdict first, then what was found; list files without findings with --all alone."""
    good, other = (
        whole(tmp_path, name="good.mcap"),
        whole(tmp_path, name="other.mcap", status="FAILED", reason="it fell"),
    )
    assert gsb_check(good, other).stdout.splitlines() == [
        "PASSED: no error and no warning in 2 files; 1 run not complete (rules: integrity-1 and recorders-1)",
        "the run is failed: it fell (other.mcap)",
        "1 file without findings",
        "--all lists every finding of every file",
    ]
    every = gsb_check("--all", good, other).stdout
    assert every.startswith("PASSED: ")
    assert "good.mcap: complete" in every


def test_the_verdict_names_a_damaged_file(gsb_check: Command, tmp_path: Path) -> None:
    """Say of a file alone that it is damaged; of several, how many and which."""
    good = whole(tmp_path, name="good.mcap")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(BYTES["an attachment"][1](good.read_bytes()))
    counts = r"\d+ errors?, 0 warnings \(rules: integrity-1 and recorders-1\)"
    alone, beside = (gsb_check(*files).stdout.splitlines()[0] for files in ((damaged,), (good, damaged)))
    assert re.fullmatch(rf"FAILED: damaged\.mcap is damaged: {counts}", alone)
    assert re.fullmatch(rf"FAILED: 1 of 2 files is damaged \(damaged\.mcap\): {counts}", beside)
    lost = whole(tmp_path, name="lost.mcap", dropout="the disk was full")
    assert re.match(rf"FAILED: lost\.mcap has lost data: {counts}", gsb_check(lost).stdout)
    missing = gsb_check(tmp_path / "missing.mcap", lost, damaged).stdout
    assert " ".join(missing.split()).startswith(
        "FAILED: 1 of 3 files cannot be read (missing.mcap), 1 has lost data (lost.mcap), 1 is damaged (damaged.mcap): "
    )


def test_a_warning_of_ten_files_is_one_line(gsb_check: Command, tmp_path: Path) -> None:
    """Say once what ten files have, with their number; name them with --all."""
    for run in range(10):
        path = whole(tmp_path, run=run, name=f"run-{run}.mcap")
        path.write_bytes(BYTES["no CRC"][1](path.read_bytes()))
    short = gsb_check(tmp_path).stdout.splitlines()
    assert short[0] == "PASSED: no error in 10 files, 10 warnings (rules: integrity-1 and recorders-1)"
    assert [line for line in short if "crc-present" in line] == [
        "warning crc-present: the data section has no CRC (all 10 files)"
    ]
    assert len(short) == 5
    every = gsb_check(tmp_path, "--all").stdout
    assert all(f"run-{run}.mcap: complete" in every for run in range(10))
    assert every.count("warning crc-present") == 10


def test_findings_of_one_rule_stand_together(gsb_check: Command, tmp_path: Path) -> None:
    """Say the first finding of a rule and how many more there are; list all with --all."""
    rules = tmp_path / "mine.toml"
    rules.write_text(_MINE)
    paths = [whole(tmp_path, simulator=f"other-{n}", name=f"{n}.mcap") for n in (7, 8, 9)]
    short = " ".join(gsb_check("--rules", rules, *paths).stdout.split())
    assert short.count("error our-engine: ") == 1
    more = "; and 2 more findings of this rule (7.mcap, 8.mcap, 9.mcap)"
    assert f"error our-engine: found other-7{more} Required: The simulator is ours. Fix: Record with it." in short
    every = gsb_check("--rules", rules, "--all", *paths).stdout
    assert all(f"error our-engine: found other-{n}\n" in every for n in (7, 8, 9))


def test_no_rule_applies(gsb_check: Command, tmp_path: Path) -> None:
    """Call nothing passed of which nothing was checked."""
    rules = tmp_path / "mine.toml"
    rules.write_text(_MINE.replace('level = "error"', 'level = "error"\nscenes = ["franka"]'))
    done = gsb_check(whole(tmp_path, name="a.mcap"), "--rules", rules, code=0)
    assert done.stdout.startswith("NOTHING CHECKED: no rule applies to a.mcap (rules: mine-1)")


def test_terminal_sequences_are_made_visible(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Print a stranger's escape sequences as text, on the line that they belong to."""
    path = whole(tmp_path, status="FAILED", reason="\x1b[2Jgone\nerror: none", dropout="\x1b]0;owned\x07")
    main([str(path)])
    shown = capsys.readouterr().out
    assert "\x1b" not in shown
    assert "\\x1b[2Jgone error: none" in " ".join(shown.split())


def test_rules_are_listed(gsb_check: Command) -> None:
    """List every rule with what it requires, why and what to do, and the vocabulary; as JSON too."""
    done = gsb_check("--list-rules", code=0)
    rules = [rule for name in SHIPPED for rule in load_rules(name).rules]
    assert all(rule.id in done.stdout for rule in rules)
    assert all(name in done.stdout for name in (*FACTS, *FILE_PREDICATES, *SET_PREDICATES, *CONDITIONS))
    assert all(len(line) <= 120 for line in done.stdout.splitlines())
    document = json.loads(gsb_check("--list-rules", "--rules", "protocol-1", "--json", "-").stdout)
    assert [rule["id"] for s in document["rule_sets"] for rule in s["rules"]] == [rule.id for rule in PROTOCOL.rules]


_MINE = """
name = "mine-1"
title = "what our laboratory asks for"

[[rules]]
id = "our-engine"
level = "error"
fact = "simulator"
must = { equals = "synthetic" }
requires = "The simulator is ours."
why = "We compare versions of it."
do = "Record with it."
"""


def test_rules_of_ones_own(gsb_check: Command, tmp_path: Path) -> None:
    """Check against a set of rules from a file, alone or beside a shipped one."""
    rules = tmp_path / "mine.toml"
    rules.write_text(_MINE)
    path = whole(tmp_path)
    assert gsb_check(path, "--rules", rules).returncode == 0
    other = whole(tmp_path, simulator="other")
    done = gsb_check(path, other, "--rules", rules, "--rules", "integrity-1", code=ExitCode.GATE_FAILED)
    assert "error our-engine: found other" in done.stdout


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("name =", "name ="[:-1]), "is not TOML"),
        (('fact = "simulator"', 'fact = "os.system"'), "fact is one of"),
        (('must = { equals = "synthetic" }', 'must = { eval = "1" }'), "'eval' is nothing that can be required"),
        (('{ equals = "synthetic" }', "{ at_least = 3 }"), "cannot be required of simulator, which is a text"),
        (('{ equals = "synthetic" }', "{ equals = [1] }"), "equals does not take"),
        (('{ equals = "synthetic" }', '{ one_of = "synthetic" }'), "one_of does not take 'synthetic'"),
        (('{ equals = "synthetic" }', "{ one_of = [] }"), r"one_of does not take \[\]"),
        (('{ equals = "synthetic" }', '{ one_of = ["a", ["b"]] }'), "one_of does not take"),
        (('{ equals = "synthetic" }', '{ equals = "a", one_of = ["b"] }'), "exactly one requirement"),
        (('level = "error"', 'level = "fatal"'), "level is one of error, warning"),
        (('id = "our-engine"', 'id = ""'), "id is a text"),
        (('level = "error"', 'level = "error"\ncode = "import os"'), "a rule has no code"),
        (('level = "error"', 'level = "error"\nwhen = ["raining"]'), "when is one of"),
        (('level = "error"', 'level = "error"\nof = "world"'), "of is one of file, point, set"),
        (("[[rules]]", "[rules]"), "rules is a list"),
        (('title = "what our laboratory asks for"', "title = 3"), "title is a text"),
        ((_MINE[_MINE.index("[[rules]]") :], 2 * _MINE[_MINE.index("[[rules]]") :]), "two rules have the same id"),
    ],
)
def test_a_bad_file_of_rules(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    """Say which rule is wrong, and what would be right."""
    path = tmp_path / "mine.toml"
    path.write_text(_MINE.replace(*change, 1))
    with pytest.raises(UsageError, match=message):
        load_rules(str(path))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name the recordings"),
        (
            ("a.mcap", "--rules", "integrity-9"),
            "is no rule set (integrity-1, recorders-1, protocol-1, protocol-2), and",
        ),
        (("a.mcap", "--rules", "."), "is no rule set"),
        (("a.mcap", "--rules", "/dev/zero"), "larger than a file of rules can be|not a text"),
        (("a.mcap", "--polite"), "unrecognized arguments"),
    ],
)
def test_bad_arguments(gsb_check: Command, arguments: tuple[str, ...], message: str, tmp_path: Path) -> None:
    """End with 2 and one message."""
    done = gsb_check(*arguments, cwd=tmp_path, code=ExitCode.USAGE)
    assert any(part in done.stderr for part in message.split("|")) or re.search(message, done.stderr)
    assert "Traceback" not in done.stderr


def test_every_fact_of_a_whole_run_is_known(small: Path) -> None:
    """Give every fact and every condition of a complete run, of the type that it is said to be."""
    file = examine(small)
    for name, fact in FACTS.items():
        value = fact_of(name, file)
        if name == "timed_throttled_share":  # of a GPU alone
            assert isinstance(value, Unknown)
            continue
        if name == "recorder_modified" and not (ROOT / ".git").exists():  # of a checkout alone, not of an archive of it
            assert isinstance(value, Unknown)
            continue
        assert not isinstance(value, Unknown), name
        assert isinstance(value, (int, float) if fact.type.name == "number" else fact.type.value), name
        assert fact.meaning
    assert all(isinstance(applies(name, file), bool) for name in CONDITIONS)


def test_facts_of_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    """Give a reason instead of a fact; hold no rule for broken or kept."""
    path = tmp_path / "text.mcap"
    path.write_text("no recording at all, and long enough")
    file = examine(path)
    facts = {name: fact_of(name, file) for name in FACTS if not name.startswith("problems.")}
    assert all(isinstance(value, Unknown) and value.reason for value in facts.values())
    report = check([file], [PROTOCOL])
    assert report.findings == ()
    assert len(report.unchecked) == sum(rule.of is Scope.file for rule in PROTOCOL.rules)
    assert report.exit_code == ExitCode.DATA_LOST


@given(values=st.lists(st.integers(0, 3), min_size=1, max_size=8))
def test_set_predicates_agree_with_python(values: list[int]) -> None:
    """Find files that differ, and files that are alike, where Python's sets do; name none that is as most are."""
    named = {str(index): value for index, value in enumerate(values)}
    same = SET_PREDICATES["all_same"].found(named, True, lambda *_: None)
    assert bool(same) == (len(set(values)) > 1)
    if same:
        odd = {named[key] for key in same[0][1]}
        usual = set(values) - odd
        assert len(usual) == 1
        assert all(values.count(usual_value) >= values.count(v) for usual_value in usual for v in values)
    alike = SET_PREDICATES["all_distinct"].found(named, True, lambda *_: None)
    assert {key for _, keys in alike for key in keys} == {k for k, v in named.items() if values.count(v) > 1}
    for least in range(1, 9):
        found = SET_PREDICATES["true_in"].found(named, least, lambda *_: None)
        assert bool(found) == (sum(map(bool, values)) < least)
    parity = SET_PREDICATES["determined_by"].found(named, "n_env", lambda key, _: named[key] % 2)
    assert bool(parity) == ({0, 2} <= set(values) or {1, 3} <= set(values))


@given(value=st.integers(1, 1 << 30))
def test_file_predicates_agree_with_python(value: int) -> None:
    """Hold numbers to bounds and powers of two."""
    ask: Callable[[str, Any], tuple[str, ...]] = lambda name, argument: FILE_PREDICATES[name].found(  # noqa: E731
        value, argument, lambda _: value
    )
    assert bool(ask("power_of_two", True)) == (bin(value).count("1") != 1)
    assert FILE_PREDICATES["power_of_two"].found(value + 0.5, True, lambda _: None)
    assert (ask("at_least", value), ask("at_most", value), ask("equals", value)) == ((), (), ())
    assert ask("at_least", value + 1)
    assert ask("at_most", value - 1)
    assert ask("one_of", [value + 1])
    assert ask("same_as", "n_env") == ()


def test_nested_values_are_shown_in_brief(tmp_path: Path) -> None:
    """Compare options that a stranger nested deeply, without following them all the way down."""

    def nested(name: str, record: dict[str, Any]) -> None:
        deep: Any = 1
        for _ in range(40):
            deep = [deep]
        if name == SIMULATION:
            record["options"] = {"deep": deep}

    assert "same-engine" in broken(whole(tmp_path, run=0), whole(tmp_path, run=1, change=nested))


def test_a_gate_makes_a_run_contradict_itself(tmp_path: Path) -> None:
    """Break a rule, not the file, where a gate fired in a run that says it is complete."""
    event = message_class("gsb.v1.Event")(kind=4, phase="timed", text="dropped")
    path = whole(tmp_path, shown=Shown(raw=(("/run/event", "gsb.v1.Event", event),)))
    report = check([examine(path)], [load_rules("integrity-1")])
    assert report.exit_code == ExitCode.GATE_FAILED
    assert "a gate fired in phase timed: dropped" in report.findings[0].found


def test_rule_sets_say_what_they_are() -> None:
    """Name and title each shipped set; give every rule a requirement, a reason and a remedy that are sentences."""
    for name in SHIPPED:
        rules = load_rules(name)
        assert rules.name == name
        assert rules.title
        for rule in rules.rules:
            assert all(text[0].isupper() and text.endswith(".") for text in (rule.requires, rule.why, rule.do)), rule.id


def test_rules_need_no_recording() -> None:
    """Parse rules without opening any file of recordings."""
    assert parse_rules(_MINE, "mine").rules[0].argument == "synthetic"


@pytest.mark.slow
def test_document_commands(tmp_path: Path) -> None:
    """Run every command of the page on gsb-check and gsb-info with the exit code that it says."""
    shutil.copytree(ROOT / "recordings", tmp_path / "recordings", ignore=shutil.ignore_patterns("[i-z]*-n*.mcap", "b*"))
    lines = commands(ROOT / "docs" / "check.md")
    assert len(lines) >= 4
    for line in lines:
        assert shell(line, tmp_path).stdout


def test_document_rules(tmp_path: Path) -> None:
    """Load the page's own rules."""
    (block,) = blocks(ROOT / "docs" / "check.md", "toml")
    (rule,) = parse_rules(block, "docs/check.md").rules
    assert (rule.id, rule.argument) == ("long-enough", 5000)


def test_numbers_have_their_unit(tmp_path: Path) -> None:
    """Say what was found with the unit that the fact's meaning has, and without any where it has none."""
    path = write_recording(tmp_path, grid(2), dt=0.02, warmup=3)
    said = {finding.rule.id: finding.found for finding in check([examine(path)], [PROTOCOL]).findings}
    assert (said["dt"], said["dt-of-scene"]) == ("found 0.02 s", "found 0.02, not 0.01 s")
    assert said["warm-up"] == "found 3"
    assert (FACTS["timed_seconds"].unit, FACTS["timed_throttled_share"].unit, FACTS["scene"].unit) == ("s", "", "")
