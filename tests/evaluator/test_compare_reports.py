"""How gsb-compare shows what it found: table, Markdown, JUnit; its document and its workflow."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.cli.compare import main
from gpusimbench.evaluator.compare.finding import Change
from gpusimbench.schemas.provenance import PROVENANCE, SIMULATION
from tests.conftest import searched
from tests.evaluator.test_compare import NOISE, ROOT, compared, finding, stamped, timed, write_sides
from tests.synthetic import grid, write_recording
from tests.test_docs import command, shows

DOCUMENT, HISTORY, FIGURES = (ROOT / "docs" / name for name in ("compare.md", "history.md", "false-alarms.md"))
WORKFLOW = ROOT / "examples" / "github-actions" / "simulator-regression.yml"
HOSTILE = (
    "@team | `x` <script>alert(1)</script> [a](http://b.c) **b** #1 ![i](j) www.e.com :x: "
    "\x1b[31m\x00\u202e\ufffe &amp; |\n\n# h"
)


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A PATH on which gsb-compare is, whether or not it is installed."""
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "gsb-compare").write_text(
        f'#!/bin/sh\nexec {sys.executable} -m gpusimbench.evaluator.cli.compare "$@"\n'
    )
    (programs / "gsb-compare").chmod(0o755)
    return os.pathsep.join([str(programs), str(Path(command("gsb-eval")[0]).parent), os.environ["PATH"]])


def run(line: str, folder: Path, path: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run lines as a step of a workflow does: in bash, which ends with the first that fails."""
    return subprocess.run(
        ["bash", "-e", "-c", line], cwd=folder, capture_output=True, text=True, timeout=300,
        env={**os.environ, "PATH": path, "PYTHONPATH": searched(ROOT), **environment},
    )  # fmt: skip


def hostile(second: int) -> Any:
    """A change that puts text that others would obey wherever a recording has text that is shown."""

    def change(name: str, record: dict[str, Any]) -> None:
        stamped(second)(name, record)
        if name == PROVENANCE:
            record["configuration"] |= {"simulator": HOSTILE, "scene": HOSTILE}
            record["software"] = {"packages": {HOSTILE: HOSTILE}, "recorder": {"commit": HOSTILE}}
        if name == SIMULATION:
            record |= {"version": HOSTILE, "options": {HOSTILE: HOSTILE}}

    return change


def write_hostile(folder: Path) -> tuple[Path, Path]:
    """Two sides whose every text is hostile; head is slower, has a run that failed, and a group without a partner."""
    for second, (side, elapsed) in enumerate([("base", 1.0), ("head", 2.0), ("head", 2.0), ("base", 1.0)]):
        (folder / side).mkdir(exist_ok=True)
        write_recording(folder / side, None, elapsed_s=elapsed, change=hostile(second), name=f"{second}.mcap")
    write_recording(folder / "head", None, change=hostile(4), status="FAILED", reason=HOSTILE, name="failed.mcap")
    write_recording(folder / "head", None, change=hostile(5), n_env=3, name="alone.mcap")
    (folder / "head" / "@all|<b>.mcap").write_bytes(b"no recording")
    return folder / "base", folder / "head"


def test_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Print the verdict first, then what differs; with --all, each number's direction, method and runs."""
    sides = write_sides(tmp_path, timed(host_bytes=(10**8, 2 * 10**8)), timed(1.2, host_bytes=(10**8, 2 * 10**8)))
    assert main([*map(str, sides), "--no-cache"]) == 4
    verdict = "FAILED: head is worse than base in throughput (1 finding in 1 configuration)"
    runs = "6 complete runs of base, 6 of head, in the order ABBAABBAABBA (A base, B head)"
    brief = capsys.readouterr().out.splitlines()
    assert brief[0] == verdict
    assert " ".join(" ".join(brief[1:3]).split()).startswith(f"synthetic, inclined-collision, 1 env, dt 1 s: {runs}")
    assert any(line.startswith("throughput [env-steps/s] ") and line.rstrip().endswith("REGRESSION") for line in brief)
    assert any(line.startswith("the same: host memory increment") for line in brief)
    assert len(brief) <= 15
    assert main([*map(str, sides), "--no-cache", "--all"]) == 4
    shown = capsys.readouterr().out
    lines = shown.splitlines()
    assert lines[0] == verdict
    assert lines[2:4] == ["synthetic, inclined-collision, 1 env, dt 1 s: FAILED, 1 finding", runs]
    assert re.search(
        r"^throughput \[env-steps/s\] +\d+ +\d+ +0\.833 +\[0\.\d{3} to 0\.\d{3}\] +0\.031 +REGRESSION", shown, re.M
    )
    assert re.search(r"^host memory increment +100\.0 MB +100\.0 MB +1\.000 +- +- +same *$", shown, re.M)
    assert "throughput (higher is better): N_env * N_step / T_step" in shown
    assert "(all 64 ways); the interval inverts the test, n = 6 and 6" in " ".join(shown.split())


def test_a_finding_of_fewer_runs_says_of_how_many(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say beside a number that was not tested how many runs it is of, where these are not all runs of the sides."""
    whole = timed(host_bytes=(10**8, 2 * 10**8))
    for name, base, said in (("all", whole, []), ("five", [*whole[:5], timed()[5]], ["n = 5 and 6"])):
        assert main([*map(str, write_sides(tmp_path / name, base, whole)), "--no-cache", "--all"]) == 0
        shown = capsys.readouterr().out
        assert re.findall(r"^[^:]+: (n = .+)$", shown, re.M) == said


OPEN = {"change": Change.UNCLEAR, "left_open": (Change.REGRESSION,)}


def test_a_check_of_mechanics_that_is_broken_now(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 4 where cubes went through the floor, and 0 where they do not any more."""
    sunk = grid(2)
    sunk[..., 2] = -0.5
    sides = write_sides(tmp_path, [{"final": grid(2)}] * 2, [{"final": sunk}] * 2, "ABBA", elapsed_s=None)
    code_, document = compared(*sides, capsys=capsys)
    sank = finding(document, "mechanics.sank")
    assert (code_, sank["change"], sank["said"]["base"], sank["p_value"]) == (4, "regression", "held (physics-2)", None)
    assert sank["said"]["head"].startswith("BROKEN 4 of 4")
    code_, document = compared(*sides[::-1], capsys=capsys)
    assert finding(document, "mechanics.sank")["change"] == "improvement"


def ended(rng: np.random.Generator, *, sunk: bool) -> dict[str, Any]:
    """A run that ends with its cubes on the floor, or below the floor."""
    found = grid(2) + 0.001 * rng.normal(size=(2, 27, 3))
    found[:, :, 2] = -0.5 if sunk else 0.03
    return {"final": found}


def test_a_check_that_some_runs_break(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Count runs where they differ: one of six that breaks a check is no regression, all six are."""
    rng = np.random.default_rng(2)
    base = [ended(rng, sunk=False) for _ in range(6)]
    for count, change, p in ((1, "not distinguishable", 1.0), (6, "regression", 2 / 924)):
        head = [ended(rng, sunk=i < count) for i in range(6)]
        _, document = compared(*write_sides(tmp_path / str(count), base, head, elapsed_s=None), capsys=capsys)
        sank = finding(document, "mechanics.sank")
        assert (sank["change"], sank["p_value"]) == (change, pytest.approx(p))
        assert f"{count} of 6 of head" in sank["note"]


def test_checks_are_tested_however_broken_runs_fell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ask of a check that runs of both sides break, as of one that runs of one side do: the family is one."""
    rng = np.random.default_rng(3)
    for broken_base, broken_head, change, p in (
        (1, 1, "not distinguishable", 1.0), (1, 6, "regression", 14 / 924), (6, 1, "improvement", 14 / 924),
    ):  # fmt: skip
        base, head = ([ended(rng, sunk=i < count) for i in range(6)] for count in (broken_base, broken_head))
        sides = write_sides(tmp_path / f"{broken_base}-{broken_head}", base, head, elapsed_s=None)
        _, document = compared(*sides, "--outcome", "1e9", capsys=capsys)
        sank = finding(document, "mechanics.sank")
        assert (sank["change"], sank["p_value"]) == (change, pytest.approx(p))
    base, head = ([ended(rng, sunk=True) for _ in range(6)] for _ in range(2))
    _, document = compared(*write_sides(tmp_path / "every", base, head, elapsed_s=None), capsys=capsys)
    assert finding(document, "mechanics")["change"] == "same"


def test_junit_of_hostile_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Write XML 1.0 that any parser takes: a case for each axis, failures, what was skipped, and files as errors."""
    target = tmp_path / "report.xml"
    assert main([*map(str, write_hostile(tmp_path)), "--junit", str(target), "--no-cache"]) == 4
    capsys.readouterr()
    text = target.read_text(encoding="utf-8")
    assert not re.search("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", text)
    suites = ET.fromstring(text)
    cases = {case.get("name"): case for case in suites.iter("testcase")}
    failure = cases["throughput"].find("failure")
    assert failure.text  # the findings, line by line
    assert cases["validity"].find("failure") is not None
    assert cases["memory"].find("skipped") is not None
    assert [case.get("classname") for case in suites.iter("testcase") if case.find("error") is not None] == ["head"]
    for name, kind in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped"), ("tests", "testcase")):
        assert int(suites.get(name, "")) == len(list(suites.iter(kind)))
    assert "<script>alert(1)</script>" in (cases["throughput"].get("classname") or "")


@pytest.mark.parametrize(
    ("factor", "noise", "arguments", "code_", "mark", "kinds"),
    [
        (1.0, 0.1, (), 0, "PASSED", {"throughput": None, "memory": None, "build": "skipped"}),
        (1.2, 0.1, (), 4, "<b>FAILED", {"throughput": "failure", "memory": None}),
        (1.2, 20.0, (), 5, "NOT DECIDED", {"throughput": "error", "memory": None}),
        (1.2, 20.0, ("--gate", "memory"), 0, "PASSED", {"throughput": "skipped", "memory": None}),
        (1.2, 0.1, ("--across", "cone"), 5, "NOTHING COMPARED", {"compared": "error"}),
    ],
)
def test_reports_tell_undecided_from_passed(
    factor: float,
    noise: float,
    arguments: tuple[str, ...],
    code_: int,
    mark: str,
    kinds: dict[str, str | None],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Show a gate that is neither failed nor passed as an error of JUnit, and in the verdict of text and Markdown."""
    more = {"host_bytes": (10**8, 2 * 10**8)}
    base, head = ([{"elapsed_s": f * float(np.exp(noise * n)), **more} for n in NOISE] for f in (1.0, factor))
    head.reverse()
    if arguments == ("--across", "cone"):
        base, head, arguments = [{**base[0], "options": {"cone": "a"}}], [{**head[0], "options": {"x": "a"}}], ()
    folders = write_sides(tmp_path, base, head, "ABBAABBAABBA" if len(base) > 1 else "AB")
    junit, page = tmp_path / "report.xml", tmp_path / "summary.md"
    reports = ("--junit", str(junit), "--markdown", str(page), "--no-cache")
    assert main([*map(str, folders), *arguments, *reports]) == code_
    shown = " ".join(capsys.readouterr().out.split())
    suites = ET.fromstring(junit.read_text(encoding="utf-8"))
    cases = {case.get("name"): {part.tag for part in case} - {"system-out"} for case in suites.iter("testcase")}
    for name, kind in kinds.items():
        assert cases[name] == ({kind} if kind else set()), name
    assert int(suites.get("errors", "")) == sum("error" in found for found in cases.values())
    assert page.read_text(encoding="utf-8").startswith(mark)
    assert ("undecided: throughput: the interval contains a change of 5 % or more" in shown) is (
        "error" in cases.get("throughput", set())
    )


@pytest.mark.parametrize("apart", [0, 1])
def test_the_order_of_one_run_a_side(apart: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tell the order of two runs that were made a second apart, and none of two that were made in the same second."""
    for second, side in enumerate(("base", "head")):
        (tmp_path / side).mkdir()
        write_recording(tmp_path / side, change=stamped(second * apart), final=None)
    main([str(tmp_path / "base"), str(tmp_path / "head"), "--no-cache"])
    assert ("in the order AB" in capsys.readouterr().out) is bool(apart)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
@pytest.mark.parametrize("target", ["--json", "--markdown", "--junit"])
def test_a_report_that_cannot_be_written(target: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 1 with one line where a report cannot be written."""
    sides = write_sides(tmp_path, timed()[:1], timed()[:1], "AB")
    assert main([*map(str, sides), target, "/dev/full", "--no-cache"]) == 1
    assert capsys.readouterr().err.startswith("gsb-compare: cannot write /dev/full: ")


@pytest.mark.slow
@pytest.mark.parametrize(("document", "n_command"), [(DOCUMENT, 2), (HISTORY, 1)], ids=["compare", "history"])
def test_the_document_shows_what_is_printed(document: Path, n_command: int, tmp_path: Path, path: str) -> None:
    """Run every command of docs/compare.md and docs/history.md; where they show an output, that is the output."""
    page = document.read_text(encoding="utf-8")
    found = re.findall(r"^```console\n(.*?)\n```\n(?:\n```text\n(.*?)\n```)?", page, re.DOTALL | re.MULTILINE)
    assert len(found) >= n_command
    for name in ("recordings", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    for line, expected in found:
        done = run(line, tmp_path, path)
        assert done.returncode in (0, 4), done.stderr
        if expected:
            assert shows(expected, done.stdout), done.stdout


def test_the_document_shows_the_workflow() -> None:
    """Lead from the document to the workflow."""
    assert str(WORKFLOW.relative_to(ROOT)) in DOCUMENT.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_workflow_works(tmp_path: Path, path: str) -> None:
    """Parse the workflow, and run its steps that record, compare and show, with small numbers."""
    yaml = pytest.importorskip("yaml")
    document = yaml.safe_load(WORKFLOW.read_text(encoding="utf-8"))
    assert set(document) == {"name", True, "permissions", "jobs"}  # YAML 1.1 reads "on" as true
    job = document["jobs"]["compare"]
    steps = {step["name"]: step for step in job["steps"] if "name" in step}
    for side in ("base", "head"):
        (tmp_path / f"env-{side}").symlink_to(sys.prefix)
    environment = {
        **job["env"], "N_ENV": "2", "PAIRS": "2", "GITHUB_STEP_SUMMARY": str(tmp_path / "shown.md"),
        "RECORD": "--scene inclined-collision --steps 20 --warmup 5 --timed-steps 20",
    }  # fmt: skip
    # two runs a side decide nothing of throughput, which is no failure
    for name in ("Record base and head in turn", "Compare", "Show the comparison"):
        done = run(steps[name]["run"], tmp_path, path, **environment)
        assert done.returncode == 0, done.stdout + done.stderr
        assert ("::warning::gsb-compare could not decide" in done.stdout) == (name == "Compare")
    (tmp_path / "posted").mkdir()
    posting = tmp_path / "posted" / "gh"  # says what the command that GitHub's machines have would be given
    posting.write_text('#!/bin/sh\necho "$@"\n', encoding="utf-8")
    posting.chmod(0o755)
    done = run(steps["Comment on the pull request"]["run"], tmp_path, f"{posting.parent}{os.pathsep}{path}", NUMBER="7")
    assert done.stdout == "pr comment 7 --edit-last --create-if-none --body-file summary.md\n"
    assert [len(list((tmp_path / "runs" / side).glob("*.mcap"))) for side in ("base", "head")] == [2, 2]
    assert (tmp_path / "shown.md").read_text(encoding="utf-8").startswith("NOT DECIDED")
    assert ET.parse(tmp_path / "report.xml").getroot().get("failures") == "0"
    assert steps["Show the comparison"]["if"] == steps["Keep recordings and reports"]["if"] == "always()"
    kept = [name.rstrip("/") for name in job["steps"][-1]["with"]["path"].split()]
    assert kept == ["runs", "summary.md", "report.xml", "result.json"]
    assert all((tmp_path / name).exists() for name in kept)
    # what failed, or could not be compared at all, stays a failure
    for file in (tmp_path / "runs" / "head").iterdir():
        file.unlink()
    other = f"gsb-record --sim mujoco --n-env 3 --runs 1 {environment['RECORD']} --out runs/head"
    assert run(other, tmp_path, path).returncode == 0
    assert run(steps["Compare"]["run"], tmp_path, path, **environment).returncode == 5


@pytest.mark.slow
def test_the_documents_figures_are_those_of_the_runs() -> None:
    """Find in docs/false-alarms.md the benchmark's tables of recorded runs, and the first row of the simulated ones.

    The other rows take ten minutes: ``python -m benchmarks.false_alarms`` prints them.
    """
    from benchmarks.false_alarms import kept, recorded, simulated

    page = FIGURES.read_text(encoding="utf-8")
    for line in (*recorded(kept()), *islice(simulated(6, 400), 3)):
        assert line in page
