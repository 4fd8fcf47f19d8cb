"""Programs that run several times: equal runs are equal, and a planted cause is the first thing that is named."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest

from gpusimbench import open_recording
from gpusimbench.recorder.programs.folder import VARIABLE, placed
from gpusimbench.schemas.errors import ExitCode, UsageError
from tests.conftest import call, has_ended, wait_for

ROOT = Path(__file__).resolve().parents[2]
REINFORCE = ROOT / "examples" / "reinforce" / "reinforce.py"

SMALL = """
import os
import sys
import numpy as np
from gpusimbench import RecordingWriter
from gpusimbench.schemas.fields import array_field

def record(path, value):
    with RecordingWriter(
        path, simulator="mine", version="1", scene="toy", n_env=2, dt=0.5, steps=1, seed=5,
        fields=(array_field("observation", "float64"),),
    ) as log:
        log.append(np.full((2, 2), float(value)))
        log.fingerprint("policy", np.full(3, float(value)))

"""
"""The beginning of programs that record a number."""


def program(folder: Path, text: str) -> list[str]:
    """A program of that text behind SMALL, as a command."""
    (folder / "small.py").write_text(SMALL + text, encoding="utf-8")
    return [sys.executable, "small.py"]


def gsb_run(folder: Path, words: list[str], *options: str, code: int = 0) -> tuple[str, dict[str, Any]]:
    """What gsb-run prints and writes as JSON."""
    options = (*options, "--json", "found.json")
    done = call("gsb-run", *options, "--", *words, cwd=folder, code=code)
    return " ".join(done.stdout.split()), json.loads((folder / "found.json").read_text())


def planted(folder: Path, before: str = "", after: str = "") -> list[str]:
    """Two updates of the example, with a part of its text replaced."""
    text = REINFORCE.read_text(encoding="utf-8")
    assert text.count(before) == 1 or not before
    (folder / "train.py").write_text(text.replace(before, after) if before else text, encoding="utf-8")
    return [sys.executable, "train.py", "3", "2"]


@pytest.mark.slow
def test_a_training_run_repeats_itself(tmp_path: Path) -> None:
    """Train twice with the same seed: every bit is the same, and provenance says what was run."""
    words = planted(tmp_path)
    said, found = gsb_run(tmp_path, words)
    assert said.startswith("The 2 runs are bit-identical: train.mcap.")
    assert "arrays batch (8 updates), gradient (8 updates), policy (9 updates)" in said
    assert (found["verdict"], found["all_compared"]) == ("bit-identical", True)
    assert found["command"] == words
    assert [run["status"] for run in found["runs"]] == ["ended", "ended"]
    assert all(run["peaks_bytes"]["host"] > 10 << 20 and run["seconds"] > 0 for run in found["runs"])
    assert (tmp_path / "program-runs/run-0/output.txt").read_text().startswith("update 0: episodes of")
    described = open_recording(tmp_path / "program-runs/run-1/train.mcap").attachment("program.json")
    assert described is not None
    assert json.loads(described)["command"] == words
    assert re.fullmatch("[0-9a-f]{64}", json.loads(described)["files"]["train.py"])


_CAUSES = {
    "batches in an unseeded order": (
        "rng.permutation(", "np.random.default_rng().permutation(", "program", "batch", 0, "the states of step 64",
    ),
    "a sum in another order": (
        "gradient = batch[\"observation\"].T @ score / len(score)",
        "products = batch[\"observation\"][:, :, None] * score[:, None]; "
        "gradient = np.random.default_rng().permutation(products).sum(axis=0) / len(score)",
        "program", "gradient", None, "batch at update",
    ),
    "a policy that begins elsewhere": (
        "0.1 * rng.normal(", "int.from_bytes(__import__('os').urandom(4)) / 2**40 + 0.1 * rng.normal(",
        "program", "policy", 0, "",
    ),
    "another seed of the environments": (
        "envs.reset(seed=seed)", "envs.reset(seed=__import__('os').getpid())", "simulator", "env/observation", None,
        "policy at update 0",
    ),
    "unseeded noise": (
        "rng.normal(size=(N_ENV,", "np.random.default_rng().normal(size=(N_ENV,", "action", "env/action", None,
        "the states of step 0",
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    "cause", [pytest.param(name, marks=() if at < 1 else pytest.mark.slow) for at, name in enumerate(_CAUSES)]
)
def test_a_planted_cause_is_named_first(tmp_path: Path, cause: str) -> None:
    """Change a line of the training program, so that one thing is not seeded: it is what differs first."""
    before, after, kind, name, update, last = _CAUSES[cause]
    said, found = gsb_run(tmp_path, planted(tmp_path, before, after), code=ExitCode.GATE_FAILED)
    assert said.startswith("Run 0 and run 1 first differ at ")
    (compared,) = found["compared"]
    program = compared["difference"]["program"]
    assert (program["first"]["kind"], program["first"]["name"]) == (kind, name)
    assert update is None or program["first"]["update"] == update
    assert program["last_same"].startswith(last)
    assert bool(program["same_before"]) == bool(last)


def test_runs_of_several_recordings(tmp_path: Path) -> None:
    """Compare two recordings of each run: one differs."""
    words = program(tmp_path, "record('same.mcap', 1); record('sub/other.mcap', os.environ['GSB_RUN'][-1])")
    said, found = gsb_run(tmp_path, words, "--out", "out", code=ExitCode.GATE_FAILED)
    assert "Run 0 and run 1 of sub/other.mcap first differ at step 0 (0 s) in env/observation" in said
    assert "Run 0 and run 1 of same.mcap are bit-identical" in said
    assert [(one["name"], one["difference"]["bit_identical"]) for one in found["compared"]] == [
        ("same.mcap", True), ("sub/other.mcap", False),
    ]  # fmt: skip


def test_a_program_that_fails(tmp_path: Path) -> None:
    """Say first that runs failed, then how and what they printed last; compare what they recorded, and end with 1."""
    words = program(tmp_path, "record('a.mcap', 1); sys.exit('no luck')")
    said, found = gsb_run(tmp_path, words, code=ExitCode.FAILURE)
    assert found["verdict"] == "bit-identical"
    assert said.startswith("2 of 2 runs failed; what the runs recorded in common is bit-identical: a.mcap.")
    reason = "ended with exit code 1; the last that it printed: no luck"
    assert [(run["status"], run["reason"]) for run in found["runs"]] == [("failed", reason)] * 2
    assert reason in said


def test_a_run_that_goes_on_is_announced(tmp_path: Path) -> None:
    """Name the file that a run prints into before the run ends."""
    done = call("gsb-run", "--", *program(tmp_path, "record('a.mcap', 1)"), cwd=tmp_path, code=0)
    begun, ended, *_ = done.stderr.splitlines()
    assert begun == "program-runs/run-0: begun; what the program prints goes to program-runs/run-0/output.txt"
    assert ended.startswith("program-runs/run-0: ended after")


@pytest.mark.parametrize(
    ("more", "verdict", "beginning"),
    [
        ("; record('a.mcap', 1)", "bit-identical", "The 2 runs are equal bit for bit as far as compared: a.mcap."),
        pytest.param("", None, "No verdict: the runs have no recordings to compare.", marks=pytest.mark.slow),
    ],
)
def test_not_all_is_compared(tmp_path: Path, more: str, verdict: str | None, beginning: str) -> None:
    """End with 5 where a recording is of one run alone, and name it."""
    words = program(tmp_path, f"record(os.environ['GSB_RUN'][-1] + '.mcap', 1){more}")
    said, found = gsb_run(tmp_path, words, code=ExitCode.NOTHING_COMPARABLE)
    assert found["verdict"] == verdict
    assert found["left_out"] == ["0.mcap: written by run 0 of 2 runs", "1.mcap: written by run 1 of 2 runs"]
    assert said.startswith(beginning)


def test_what_was_not_compared_is_said(tmp_path: Path) -> None:
    """Say of which states nothing is known where a run of equal ones has more of them, in a later recording."""
    later = """
record('a.mcap', 1)
more = int(os.environ['GSB_RUN'][-1])
with RecordingWriter(
    'b.mcap', simulator='mine', version='1', scene='toy', n_env=2, dt=0.5, steps=1 + more,
    fields=(array_field('observation', 'float64'),),
) as log:
    for _ in range(2 + more):
        log.append(np.ones(2))
"""
    said, found = gsb_run(tmp_path, program(tmp_path, later), code=ExitCode.NOTHING_COMPARABLE)
    assert said.startswith("The 2 runs are equal bit for bit as far as compared: a.mcap, b.mcap.")
    assert "not compared: states of b after its step 1, up to 2" in said and found["all_compared"] is False


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("print(1)", ExitCode.NOTHING_COMPARABLE),
        ("record(os.path.abspath('a.mcap'), 1)", ExitCode.FAILURE),  # the second run finds the first one's file
    ],
)
def test_a_program_that_records_nothing(tmp_path: Path, text: str, code: ExitCode) -> None:
    """Say what a program has to call, so that there is something to compare."""
    said, _ = gsb_run(tmp_path, program(tmp_path, text), code=code)
    assert "The program has to record: gpusimbench.wrap(envs, 'a.mcap'), or RecordingWriter" in " ".join(said.split())


@pytest.mark.slow
def test_a_program_is_stopped_with_all_that_it_started(tmp_path: Path) -> None:
    """Interrupt a run after its time; the recording says so, and a process that it left is gone."""
    text = """
import subprocess, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
open("child", "w").write(str(child.pid))
with RecordingWriter(
    "a.mcap", simulator="mine", version="1", scene="toy", n_env=1, dt=0.5, steps=9,
    fields=(array_field("observation", "float64"),),
) as log:
    time.sleep(1000)
"""
    words = program(tmp_path, text)
    _, found = gsb_run(tmp_path, words, "--time-limit", "6", code=ExitCode.FAILURE)
    assert [run["reason"] for run in found["runs"]] == ["did not end within 6 s"] * 2
    recording = open_recording(tmp_path / "program-runs/run-1/a.mcap")
    assert (recording.status, recording.reason.partition(":")[0]) == ("failed", "KeyboardInterrupt")
    with suppress(psutil.NoSuchProcess):
        child = psutil.Process(int((tmp_path / "child").read_text()))
        wait_for(lambda: has_ended(child))


def test_processes_in_sessions_of_their_own_end_with_the_run(tmp_path: Path) -> None:
    """Kill what a program started by setsid, also where the process between has ended."""
    asleep = ["sleep", f"5432.{os.getpid()}"]
    one = f"setsid -f {' '.join(asleep)}"  # whose parent ends at once
    text = f"{one}; setsid sh -c '{one}; exec {' '.join(asleep)}' & sleep 0.3"
    gsb_run(tmp_path, ["sh", "-c", text], code=ExitCode.NOTHING_COMPARABLE)
    left = running_as(asleep)
    for process in left:
        process.kill()
    assert left == []


@pytest.mark.skipif(
    sys.platform != "linux", reason="the kernel of Linux alone tells a process that its parent has ended"
)
@pytest.mark.parametrize("killed", ["gsb-run", "the process that waits"])
def test_a_program_ends_with_a_killed_command(killed: str, tmp_path: Path) -> None:
    """Leave nothing running where gsb-run is killed, by SIGKILL, nor the program where the process between is."""
    asleep = ["sleep", f"9876.{os.getpid()}"]
    last = f"setsid -f {' '.join(asleep)}; " if killed == "gsb-run" else ""
    command = [sys.executable, "-m", "gpusimbench.evaluator.cli.run", "--", "sh", "-c"]
    command.append(f"{last}exec {' '.join(asleep)}")
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as running:
        try:
            wait_for(lambda: len(running_as(asleep)) == 1 + bool(last))
            (between,) = psutil.Process(running.pid).children()
            (running if killed == "gsb-run" else between).kill()
            wait_for(lambda: not running_as(asleep) and has_ended(between))
        finally:
            running.kill()
            for process in running_as(asleep):
                process.kill()


def running_as(words: list[str]) -> list[psutil.Process]:
    """Processes of that command line."""
    return [process for process in psutil.process_iter(["cmdline"]) if process.info["cmdline"] == words]


_BAD = """
number = os.environ["GSB_RUN"][-1]
record("a.mcap", sys.argv[2] or number)
if number == sys.argv[1]:
    open(os.environ["GSB_RUN"] + "/b.mcap", "w").write("b")
else:
    record("b.mcap", 2)
"""


@pytest.mark.parametrize(
    ("bad", "other", "compared", "code"),
    [
        ("1", "1", [("a.mcap", 1)], ExitCode.DATA_LOST),
        pytest.param(
            "2", "1", [("a.mcap", 1), ("a.mcap", 2), ("b.mcap", 1)], ExitCode.DATA_LOST, marks=pytest.mark.slow
        ),
        pytest.param("0", "", [("a.mcap", 1)], ExitCode.GATE_FAILED, marks=pytest.mark.slow),
    ],
)
def test_a_file_that_is_no_recording(bad: str, other: str, compared: Any, code: ExitCode, tmp_path: Path) -> None:
    """Name the run that wrote it, compare all else, and end with 3, or with 4 where other recordings differ."""
    runs = "3" if bad == "2" else "2"
    said, found = gsb_run(tmp_path, [*program(tmp_path, _BAD), bad, other], "--runs", runs, code=code)
    assert [(one["name"], one["run"]) for one in found["compared"]] == compared
    (told,) = found["damaged"]
    assert told.startswith(f"run {bad}: ") and "b.mcap" in told and not found["all_compared"]
    assert f"no recording: {told}" in said


def test_wrong_usage(tmp_path: Path) -> None:
    """Refuse what cannot be run, leave no folder of it, and number runs on."""
    assert "there is no program nowhere" in call("gsb-run", "nowhere", cwd=tmp_path, code=ExitCode.USAGE).stderr
    assert list((tmp_path / "program-runs").iterdir()) == []
    for wrong in (("--runs", "1"), ("--time-limit", "-1")):
        call("gsb-run", *wrong, "--", "true", cwd=tmp_path, code=ExitCode.USAGE)
    for words in (("--", "true"), ("true", "--runs", "x")):  # options of the program need no dashes before it
        call("gsb-run", *words, cwd=tmp_path, code=ExitCode.NOTHING_COMPARABLE)
    assert sorted(path.name for path in (tmp_path / "program-runs").iterdir()) == [f"run-{i}" for i in range(4)]


@pytest.mark.slow
def test_an_interruption_ends_the_program(tmp_path: Path) -> None:
    """Interrupt gsb-run as a user does: the program ends, no further run begins, and the command says so."""
    words = program(tmp_path, "import time; open('begun', 'w'); time.sleep(1000)")
    command = [sys.executable, "-m", "gpusimbench.evaluator.cli.run", "--", *words]
    child = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    wait_for((tmp_path / "begun").exists)
    child.send_signal(2)
    _, said = child.communicate(timeout=300)
    assert child.returncode == ExitCode.FAILURE
    assert "gsb-run: interrupted" in said
    assert [path.name for path in (tmp_path / "program-runs").iterdir()] == ["run-0"]


def test_where_recordings_of_a_run_lie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put relative paths into the run's folder, and nothing outside of it."""
    monkeypatch.delenv(VARIABLE, raising=False)
    assert placed("a.mcap") == Path("a.mcap")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert placed("sub/a.mcap") == tmp_path / "sub" / "a.mcap"
    assert (tmp_path / "sub").is_dir()
    assert placed("/elsewhere/a.mcap") == Path("/elsewhere/a.mcap")
    with pytest.raises(UsageError, match="leads out of the folder of the run"):
        placed("../a.mcap")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording of a small program, by gsb-run."""
    folder = tmp_path_factory.mktemp("recorded")
    gsb_run(folder, program(folder, "record('a.mcap', sys.argv[1]); record('b.mcap', 1)") + ["5"])
    return folder


def audited(folder: Path, command: str, *options: str, code: int) -> tuple[str, dict[str, Any]]:
    """What gsb-audit says of a.mcap, and the only audit of its JSON."""
    file, options = "program-runs/run-0/a.mcap", (*options, "--json", "found.json")
    done = call("gsb-audit", file, "--command", command, *options, cwd=folder, code=code)
    (audit,) = json.loads((folder / "found.json").read_text())["audits"]
    return " ".join(done.stdout.split()), audit


def test_a_recording_that_was_not_ended(tmp_path: Path) -> None:
    """Say what ends it, where the program left it open."""
    leaves = "RecordingWriter.__exit__ = lambda *_: os._exit(0)\nrecord('a.mcap', 1)"
    said, _ = gsb_run(tmp_path, program(tmp_path, leaves), code=ExitCode.NOTHING_COMPARABLE)
    assert "a.mcap.partial: the recording was not ended: close the environment or the writer" in said


def test_an_audit_runs_the_program_again(recorded: Path) -> None:
    """Give the program the recorded seed, and find the recording of the same name."""
    said, audit = audited(recorded, f"{sys.executable} small.py {{seed}}", code=ExitCode.OK)
    assert said.startswith("Re-execution gives the same bits (bit-identical): a.mcap")
    assert audit["command"].endswith("small.py 5")
    assert audit["level"] == "bit-identical"
    assert Path(audit["compared"][0]["file"]).name == "a.mcap"


def test_an_audit_of_other_arrays_is_not_bit_identical(recorded: Path) -> None:
    """Change the hashed policy alone: states are the same, and the audit ends with 4 and names the policy."""
    text = (recorded / "small.py").read_text().replace("np.full(3, float(value))", "np.full(3, 7.0)")
    (recorded / "other.py").write_text(text)
    said, audit = audited(recorded, f"{sys.executable} other.py {{seed}}", code=ExitCode.GATE_FAILED)
    assert audit["difference"]["bit_identical"] is False
    assert audit["difference"]["program"]["first"]["name"] == "policy"
    assert {rung["level"]: rung["holds"] for rung in audit["rungs"]}["same-up-to-env-order"] is False
    assert "original and replay first differ at update 0 of policy, after step 1 (0.5 s)" in said


@pytest.mark.parametrize(
    ("command", "options", "outcome", "reason"),
    [
        ("{python} -c pass", (), "failed", "the program wrote 0 recordings"),
        pytest.param("{python} small.py", (), "failed", "the program ended with exit code 1", marks=pytest.mark.slow),
        ("{python} -c 'import time; time.sleep(99)'", ("--timeout", "0.3"), "stopped", "did not end within 0.3 s"),
    ],
)
def test_an_audit_without_a_replay(
    recorded: Path, command: str, options: tuple[str, ...], outcome: str, reason: str
) -> None:
    """Say why there is no verdict, and end with 5."""
    _, audit = audited(
        recorded, command.replace("{python}", sys.executable), *options, code=ExitCode.NOTHING_COMPARABLE
    )
    assert audit["outcome"] == outcome
    assert reason in audit["level_missing"]


@pytest.mark.parametrize("wrong", [("--command", "'a"), ("--command", " "), ("--command", "a", "--option", "x=1")])
def test_an_audit_of_no_command(recorded: Path, wrong: tuple[str, ...]) -> None:
    """Refuse a command that no shell takes, and options of a simulator beside a command."""
    done = call("gsb-audit", "program-runs/run-0/a.mcap", *wrong, cwd=recorded, code=ExitCode.USAGE)
    assert "--command" in done.stderr
    assert os.listdir(recorded)
