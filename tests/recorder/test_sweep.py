"""Sweeps over n_env: which runs are made, when it ends, what a second call finds, and what it says."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.recorder.sets.finished import Finished, locked, matching, read_folder
from gpusimbench.recorder.sets.sweep import CERTAIN, Outcome, Sweep, SweepRun, parse_points
from gpusimbench.schemas.commands import SCHEMA_VERSION
from gpusimbench.schemas.configuration import MAX_ENVS, RunConfiguration
from gpusimbench.schemas.errors import GsbError, UsageError
from tests.conftest import Command, command, distribution, wait_for
from tests.reading import verified

_TINY = ("--steps", "5", "--warmup", "1", "--timed-steps", "2", "--phases", "timed")

_PLUGIN = '''
"""A third party's simulator that cannot do more than so many environments."""
import os, time
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.simulators.base import Ability, Description, Simulator
from gpusimbench.schemas.fields import body_field

@dataclass(frozen=True)
class Options:
    mode: str = "memory"
    limit: int = 4

class Limited(Simulator):
    Options = Options
    abilities = frozenset(Ability)

    def build(self):
        if self.n_env >= self.options.limit:
            if self.options.mode == "memory":
                self.more = np.empty(1 << 56)
            if self.options.mode == "refuse":
                raise Refused("no such scene")
            if self.options.mode == "raise":
                raise RuntimeError("too many")
            if self.options.mode == "exit":
                os._exit(7)
            first = Path(os.environ["GSB_TEST_FOLDER"]) / "first"
            if self.options.mode == "once" and not first.exists():
                first.touch()
                raise RuntimeError("only this once")
        field = body_field("cubes", "position", "float32", ("a",))
        return Description("1.0", "cpu", {}, {}, (), (field,), timing_covers="nothing")

    def step(self, n_step):
        command = os.getppid()
        while "GSB_TEST_SLOW" in os.environ and self.n_env >= self.options.limit:
            time.sleep(0.01)
            if os.getppid() != command:
                os._exit(9)  # no test waits for it

    def state(self):
        return (np.zeros((self.n_env, 1, 3), dtype=np.float32),)
'''


@pytest.fixture
def limited(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which a third party's distribution offers the simulator "limited"."""
    folder = tmp_path_factory.mktemp("plugin")
    distribution(folder, "limited-simulator", "[gsb.simulators]\nlimited = limited_simulator:Limited\n", _PLUGIN)
    return {**os.environ, "PYTHONPATH": str(folder), "GSB_TEST_FOLDER": str(folder)}


# Plans, with nothing recorded


_powers = st.integers(0, 24).map(lambda exponent: 1 << exponent)


@given(_powers, _powers, st.integers(1, 24).map(lambda exponent: 1 << exponent))
def test_points_of_a_range(first: int, last: int, factor: int) -> None:
    """Go from the first to the last number in equal steps, but for the last step, which may be shorter."""
    if first > last:
        with pytest.raises(UsageError, match="goes upwards"):
            parse_points(f"{first}..{last}:{factor}")
        return
    points = parse_points(f"{first}..{last}:{factor}")
    assert (points[0], points[-1]) == (first, last)
    steps = [b // a for a, b in zip(points, points[1:], strict=False)]
    assert all(step == factor for step in steps[:-1])
    assert all(1 < step <= factor for step in steps)
    if factor == 2:
        assert parse_points(f"{first}..{last}") == points


def test_points_as_documented() -> None:
    """Multiply by 2 unless told otherwise, and always include the end."""
    assert parse_points("1..8") == (1, 2, 4, 8)
    assert parse_points("1..131072:4") == (1, 4, 16, 64, 256, 1024, 4096, 16384, 65536, 131072)
    assert parse_points("64..64") == (64,)
    assert parse_points(f"1..{MAX_ENVS}:{MAX_ENVS}") == (1, MAX_ENVS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "wants A..B"),
        ("8", "wants A..B"),
        ("1..", "wants A..B"),
        ("1..8:", "wants A..B"),
        ("1.. 8", "wants A..B"),
        ("-1..8", "wants A..B"),
        ("1..\u0664", "wants A..B"),
        ("1.." + "9" * 5000, "wants A..B"),
        ("0..8", "0 is none"),
        ("1..6", "6 is none"),
        ("8..4", "8 is more than 4"),
        ("1..8:3", "not by 3"),
        ("1..8:1", "not by 1"),
        ("1..8:0", "not by 0"),
        (f"1..{MAX_ENVS * 2}", f"ends at {MAX_ENVS} at most"),
    ],
)
def test_ranges_that_are_none(text: str, message: str) -> None:
    """Refuse what is no range of powers of two."""
    with pytest.raises(UsageError, match=message.replace(".", r"\.")):
        parse_points(text)


_outcomes = st.one_of(
    st.just(Outcome("complete")),
    st.builds(
        Outcome, st.sampled_from(["failed", "invalid"]), st.sampled_from([*CERTAIN, "ENGINE", "NOT_FINITE"]), st.text()
    ),
    st.just(Outcome("incomplete")),
)


@st.composite
def _sweeps(draw: st.DrawFn) -> tuple[Sweep, dict[SweepRun, Outcome]]:
    # a sweep, and how each of its runs would end
    points = parse_points(f"1..{1 << draw(st.integers(0, 4))}")
    runs = draw(st.integers(1, 3))
    places = [SweepRun(n_env, index) for n_env in points for index in range(runs)]
    good = draw(st.sets(st.sampled_from(places)))
    return Sweep(points, runs), {p: Outcome("complete") if p in good else draw(_outcomes) for p in places}


def _follow(sweep: Sweep, ends: dict[SweepRun, Outcome], known: dict[SweepRun, Outcome]) -> list[SweepRun]:
    made = []
    while places := sweep.next_places(known):
        place = places[0]
        assert place not in known, "a run is made twice"
        known[place] = ends[place]
        made.append(place)
    return made


@given(_sweeps())
def test_a_sweep_from_its_beginning(case: tuple[Sweep, dict[SweepRun, Outcome]]) -> None:
    """Make runs in order, up to the first number at which none is complete, and leave out none that could be."""
    sweep, ends = case
    known: dict[SweepRun, Outcome] = {}
    made = _follow(sweep, ends, known)
    assert made == sorted(made)
    reached = sweep.reached(known)
    assert {place.n_env for place in made} == set(reached)
    sustained = {n_env for n_env in sweep.points if any(o.good for p, o in known.items() if p.n_env == n_env)}
    assert set(reached) - sustained <= {reached[-1]}
    assert sweep.n_env_max(known) == max(sustained, default=None)
    for n_env in reached:
        count = sum(place.n_env == n_env for place in made)
        first = ends[SweepRun(n_env, 0)]
        certain = not first.good and first.cause in CERTAIN
        assert count == (1 if certain else sweep.runs)
        assert sweep.cut_short(n_env, known) == sweep.runs - count
    if reached[-1] in sustained:
        assert sweep.stopped(known) == f"{sweep.points[-1]} is the end of the sweep"
    else:
        assert sweep.stopped(known) == f"failed at {reached[-1]}: {ends[SweepRun(reached[-1], 0)].reason}"
    below = sweep.failed_below_the_last(known)
    assert sum(below.values()) == sum(not known[place].good for place in made if place.n_env != reached[-1])


@given(_sweeps(), st.data())
def test_a_sweep_that_goes_on(case: tuple[Sweep, dict[SweepRun, Outcome]], data: st.DataObject) -> None:
    """Come to the same end from any part of what was made, making just what is lacking."""
    sweep, ends = case
    whole: dict[SweepRun, Outcome] = {}
    made = _follow(sweep, ends, whole)
    there = data.draw(st.sets(st.sampled_from(made)))
    known = {place: ends[place] for place in there}
    assert set(_follow(sweep, ends, known)) == set(made) - there
    assert known == whole


@given(_sweeps(), st.data())
def test_what_lies_beyond_the_end_does_not_count(
    case: tuple[Sweep, dict[SweepRun, Outcome]], data: st.DataObject
) -> None:
    """End at the first number that fails, also where runs of larger ones were found."""
    sweep, ends = case
    known = {place: ends[place] for place in data.draw(st.sets(st.sampled_from(sorted(ends))))}
    _follow(sweep, ends, known)
    most, reached = sweep.n_env_max(known), sweep.reached(known)
    assert most is None or most in reached
    assert all(any(o.good for o in sweep.at(n_env, known)) for n_env in reached[:-1])


_WANTED = RunConfiguration("s", "free-fall", n_env=1, dt=0.01, steps=5, timeout=10)


def _finished(outcome: Outcome, name: str = "a", **changes: object) -> Finished:
    return Finished(Path(name), replace(_WANTED, **changes), outcome)  # type: ignore[arg-type]


def _places(found: Iterable[Finished], **wanted: object) -> dict[SweepRun, str]:
    matched = matching(found, replace(_WANTED, **wanted))  # type: ignore[arg-type]
    return {place: run.path.name for place, run in matched.items()}


@pytest.mark.parametrize(
    ("changes", "same"),
    [
        ({}, True),
        ({"compression": "zstd"}, True),
        ({"timeout": 0.0}, True),
        ({"dt": 0.005}, False),
        ({"steps": 6}, False),
        ({"stride": 5}, False),
        ({"warmup": 1}, False),
        ({"seed": 1}, False),
        ({"phases": ("timed",)}, False),
        ({"scene": "franka"}, False),
        ({"model": "0" * 64}, False),
        ({"simulator": "t"}, False),
        ({"determinism": "run-to-run"}, False),
        ({"options": {"solver": "CG"}}, False),
    ],
)
def test_which_runs_are_the_same(changes: dict[str, object], same: bool) -> None:
    """Take for a run of the sweep what was asked the same, however it was stored."""
    found = _finished(Outcome("complete"), n_env=64, run_index=3, **changes)
    assert _places([found]) == ({SweepRun(64, 3): "a"} if same else {})


@pytest.mark.parametrize(
    ("outcome", "asked", "settled"),
    [
        (Outcome("complete"), 0.0, True),
        (Outcome("invalid", "NOT_FINITE"), 0.0, True),
        (Outcome("failed", "DEVICE_MEMORY"), 0.0, True),
        (Outcome("failed", "INTERRUPTED"), 0.0, False),
        (Outcome("failed"), 0.0, False),
        (Outcome("failed", "TIMEOUT"), 10.0, True),
        (Outcome("failed", "TIMEOUT"), 9.0, True),
        (Outcome("failed", "TIMEOUT"), 11.0, False),
        (Outcome("failed", "TIMEOUT"), 0.0, False),
    ],
)
def test_which_runs_are_settled(outcome: Outcome, asked: float, settled: bool) -> None:
    """Make again what was interrupted, what failed for no known cause, and what would get more time now."""
    assert bool(_places([_finished(outcome)], timeout=asked)) == settled


def test_runs_of_another_machine_are_others() -> None:
    """Make again what was made with another processor, GPU or version."""
    complete = replace(_finished(Outcome("complete")), where="here")
    assert matching([complete], _WANTED, "here")
    assert not matching([complete], _WANTED, "there")


def test_a_complete_run_goes_first() -> None:
    """Prefer a complete run to another in the same place."""
    complete, failed = _finished(Outcome("complete"), "good"), _finished(Outcome("failed", "ENGINE"), "bad")
    assert _places([complete, failed]) == _places([failed, complete]) == {SweepRun(1, 0): "good"}


# Real runs


def _sweep(out: Path, *more: object) -> tuple[object, ...]:
    return ("--sim", "mujoco", "--scene", "free-fall", *_TINY, "--sweep", "1..8:4", "--runs", 2, "--out", out, *more)


def _made(folder: Path) -> list[tuple[int, int]]:
    found, _ = read_folder(folder)
    return sorted((run.configuration.n_env, run.configuration.run_index) for run in found)


@pytest.mark.slow
def test_a_sweep_and_its_continuation(gsb_record: Command, tmp_path: Path) -> None:
    """Make every run once; make again only what is gone, and say what else lies there."""
    every = [(n_env, index) for n_env in (1, 4, 8) for index in (0, 1)]
    first = gsb_record(*_sweep(tmp_path), code=0)
    assert _made(tmp_path) == every
    assert sorted(first.stdout.split()) == sorted(map(str, tmp_path.iterdir()))
    assert first.stderr.splitlines()[:3] == [
        "sweep of mujoco, free-fall, dt 0.01 s: 1 4 8 envs, 2 runs each", f"0 of 6 runs are in {tmp_path} already",
        "1 env",
    ]  # fmt: skip
    assert first.stderr.splitlines()[-1] == "N_env^max 8: 8 is the end of the sweep"
    for file in tmp_path.iterdir():
        verify(open_recording(file))

    files = sorted(tmp_path.iterdir())
    second = gsb_record(*_sweep(tmp_path, "--compression", "zstd"))
    assert (second.returncode, second.stdout) == (0, "")
    assert sorted(tmp_path.iterdir()) == files
    assert second.stderr.splitlines()[1:] == [
        f"6 of 6 runs are in {tmp_path} already", "N_env^max 8: 8 is the end of the sweep"
    ]  # fmt: skip

    (gone,) = tmp_path.glob("*-n4-r1-*.mcap")
    whole = gone.read_bytes()
    gone.write_bytes(whole[: len(whole) // 2])
    (tmp_path / "foreign.mcap").write_bytes(b"PK\3\4 something else")
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "killed.mcap.partial").write_bytes(whole[:-100])
    third = gsb_record(*_sweep(tmp_path, "--json"), code=0)
    assert f"5 of 6 runs are in {tmp_path} already" in third.stderr
    (ignored,) = (line for line in third.stderr.splitlines() if line.startswith("ignored"))
    assert "folder.mcap (not a file), foreign.mcap (unreadable: " in ignored
    assert ignored.endswith(" and 1 more")
    record = json.loads(third.stdout)
    assert record["schema_version"] == SCHEMA_VERSION
    assert record["sweep"] == {
        "n_env_max": 8,
        "ends": "8 is the end of the sweep",
        "points": [{"n_env": n_env, "n_run": 2, "n_recording": 2} for n_env in (1, 4, 8)],
    }
    assert [(run["n_env"], run["run"]) for run in record["runs"]] == every
    assert [(run["n_env"], run["run"]) for run in record["runs"] if not run["found"]] == [(4, 1)]
    assert {run["status"] for run in record["runs"]} == {"complete"}
    assert all(Path(run["file"]).exists() for run in record["runs"])


def test_a_set_and_its_continuation(gsb_record: Command, limited: dict[str, str], tmp_path: Path) -> None:
    """Make what a part of a set lacks, and a set more where it lacks nothing; let a sweep find the runs."""
    plain = ("--sim", "limited", *_TINY, "--n-env", 2, "--runs", 3, "--out", tmp_path)
    assert "already" not in gsb_record(*plain, code=0, env=limited).stderr
    (gone,) = tmp_path.glob("*-r1-*.mcap")
    gone.rename(gone.with_suffix(".mcap.partial"))
    done = gsb_record(*plain, "--json", code=0, env=limited)
    assert f"3 runs, 2 of them in {tmp_path} already" in done.stderr
    assert [(run["run"], run["found"]) for run in json.loads(done.stdout)["runs"]] == [(0, True), (1, False), (2, True)]
    assert _made(tmp_path) == [(2, 0), (2, 1), (2, 2)]
    more = gsb_record(*plain, "--runs", 1, code=0, env=limited)
    assert "already" not in more.stderr
    assert _made(tmp_path) == [(2, 0), (2, 0), (2, 1), (2, 2)]
    swept = gsb_record("--sim", "limited", *_TINY, "--sweep", "2..2", "--runs", 3, "--out", tmp_path, env=limited)
    assert f"3 of 3 runs are in {tmp_path} already" in swept.stderr


@pytest.mark.slow
def test_a_set_with_a_failure(gsb_record: Command, limited: dict[str, str], tmp_path: Path) -> None:
    """Fail for a failed run that is there, and make everything again after a refusal, or with other settings."""
    base = ("--sim", "limited", *_TINY, "--n-env", 4, "--out", tmp_path)
    gsb_record(*base, "--runs", 1, "--option", "mode=once", code=1, env={**limited, "GSB_TEST_FOLDER": str(tmp_path)})
    done = gsb_record(
        *base, "--runs", 2, "--option", "mode=once", "--json", code=1, env={**limited, "GSB_TEST_FOLDER": str(tmp_path)}
    )
    ended = [(run["status"], run["found"]) for run in json.loads(done.stdout)["runs"]]
    assert ended == [("failed", True), ("complete", False)]
    for _ in range(2):
        refused = gsb_record(*base, "--runs", 2, "--option", "mode=refuse", "--json", code=1, env=limited)
        assert [run["found"] for run in json.loads(refused.stdout)["runs"]] == [False]


@pytest.mark.slow
def test_more_environments_than_memory_holds(gsb_record: Command, tmp_path: Path) -> None:
    """Find the limit that the host's memory sets to MuJoCo, end well, and not try the limit again."""

    def little_memory() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))

    arguments = (
        "--sim", "mujoco", "--scene", "free-fall", "--option", "threads=1", *_TINY, "--runs", 1,
        "--sweep", "4..4194304:1048576", "--out", tmp_path,
    )  # fmt: skip
    done = gsb_record(*arguments, preexec_fn=little_memory, code=0)
    assert "N_env^max 4: failed at 4194304: " in done.stderr
    (file,) = tmp_path.glob("*-n4194304-*.mcap")
    recording = verified(file)
    assert recording.status == "failed"
    again = gsb_record(*arguments, "--json", preexec_fn=little_memory, code=0)
    record = json.loads(again.stdout)
    assert record["sweep"]["n_env_max"] == 4
    assert record["sweep"]["ends"] == f"failed at 4194304: {recording.reason}"
    assert all(run["found"] for run in record["runs"])


def _limited(
    gsb_record: Command, environment: dict[str, str], out: Path, mode: str, *more: object, code: int | None = None
) -> subprocess.CompletedProcess[str]:
    return gsb_record(
        "--sim", "limited", *_TINY, "--sweep", "2..8", "--runs", 2, "--option", f"mode={mode}", *more, "--out", out,
        env=environment, code=code,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("mode", "limit", "code", "made", "said"),
    [
        ("memory", 4, 0, [(2, 0), (2, 1), (4, 0)], "N_env^max 2: failed at 4: out of host memory in phase init"),
        ("memory", 2, 1, [(2, 0)], "N_env^max none: failed at 2: out of host memory in phase init"),
        pytest.param(
            "raise", 4, 0, [(2, 0), (2, 1), (4, 0), (4, 1)],
            "N_env^max 2: failed at 4: RuntimeError in phase init: too many", marks=pytest.mark.slow,
        ),
        pytest.param(
            "once", 4, 1, [(2, 0), (2, 1), (4, 0), (4, 1), (8, 0), (8, 1)],
            "runs failed below the last point: 1 of 2 at 4 envs\nN_env^max 8: 8 is the end of the sweep",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "once", 8, 0, [(2, 0), (2, 1), (4, 0), (4, 1), (8, 0), (8, 1)],
            "N_env^max 8: 8 is the end of the sweep", marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_where_a_sweep_ends(
    gsb_record: Command, limited: dict[str, str], tmp_path: Path,
    mode: str, limit: int, code: int, made: list[tuple[int, int]], said: str,
) -> None:  # fmt: skip
    """End behind the first number at which every run fails; repeat what would not fail for certain; say so."""
    done = _limited(gsb_record, limited, tmp_path, mode, "--option", f"limit={limit}", code=code)
    assert _made(tmp_path) == made
    assert done.stderr.endswith(said + "\n")
    spared = f"{limit} envs: 1 of 2 runs are not made: they would fail as the first did"
    assert (spared in done.stderr) == (mode == "memory")
    again = _limited(gsb_record, limited, tmp_path, mode, "--option", f"limit={limit}")
    assert (again.returncode, again.stdout) == (code, "")
    assert again.stderr.endswith(said + "\n")


@pytest.mark.parametrize(("mode", "made"), [("refuse", 1), pytest.param("raise", 3, marks=pytest.mark.slow)])
def test_a_set_ends_at_a_refusal(
    gsb_record: Command, limited: dict[str, str], tmp_path: Path, mode: str, made: int
) -> None:
    """Make no further run where the simulator refuses the first, and all of them where it crashes."""
    done = gsb_record(
        "--sim", "limited", *_TINY, "--n-env", 4, "--runs", 3, "--option", f"mode={mode}", "--out", tmp_path,
        code=1, env={**limited, "GSB_TEST_FOLDER": str(tmp_path)},
    )  # fmt: skip
    files = sorted(tmp_path.glob("*.mcap"))
    assert done.stdout.split() == list(map(str, files))
    assert [open_recording(file).status for file in files] == ["failed"] * made
    assert done.stderr.count("no such scene") == (mode == "refuse")
    spared = "2 of 3 runs are not made: they would be refused as this one was"
    assert (spared in done.stderr) == (mode == "refuse")


@pytest.mark.slow
def test_processes_that_die_at_the_end(gsb_record: Command, limited: dict[str, str], tmp_path: Path) -> None:
    """Take processes that die for a limit as well, but try them again, since their recordings have no end."""
    for _ in range(2):
        done = _limited(gsb_record, limited, tmp_path, "exit", code=0)
        assert "N_env^max 2: failed at 4: the run's process ended with exit code 7" in done.stderr
    assert _made(tmp_path) == [(2, 0), (2, 1)]
    assert len(list(tmp_path.glob("*-n4-*.partial"))) == 4
    _limited(gsb_record, limited, tmp_path, "exit", "--option", "limit=1", code=3)


@pytest.mark.slow
def test_an_interrupted_sweep_goes_on(gsb_record: Command, limited: dict[str, str], tmp_path: Path) -> None:
    """End at once on Ctrl-C with what there is, and make the interrupted run again on the next call."""
    process = subprocess.Popen(
        [*command("gsb-record"), "--sim", "limited", *_TINY, "--sweep", "2..8", "--runs", "2", "--option", "mode=none",
         "--json", "--out", str(tmp_path)],
        env={**limited, "GSB_TEST_SLOW": "1"}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        wait_for(lambda: any(b"provenance.json" in path.read_bytes() for path in tmp_path.glob("*-n4-*.partial")))
    finally:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=300)
    assert process.returncode == 1, err
    sweep = json.loads(out)["sweep"]
    assert (sweep["n_env_max"], sweep["points"][-1]) == (2, {"n_env": 4, "n_run": 0, "n_recording": 1})
    assert sweep["ends"] == "interrupted at 4; the same command goes on from there"
    assert _made(tmp_path) == [(2, 0), (2, 1), (4, 0)]
    done = _limited(gsb_record, limited, tmp_path, "none", code=0)
    assert f"2 of 6 runs are in {tmp_path} already" in done.stderr
    assert _made(tmp_path) == [(2, 0), (2, 1), (4, 0), (4, 0), (4, 1), (8, 0), (8, 1)]


@pytest.mark.slow
def test_two_sweeps_into_one_folder(gsb_record: Command, limited: dict[str, str], tmp_path: Path) -> None:
    """Refuse the second of two equal sweeps by the name of the first, let others in, and mind no lock of the dead."""
    first = subprocess.Popen(
        [*command("gsb-record"), "--sim", "limited", *_TINY, "--sweep", "2..8", "--runs", "2", "--option", "mode=none",
         "--out", str(tmp_path)],
        env={**limited, "GSB_TEST_SLOW": "1"}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        wait_for(lambda: any(b"provenance.json" in path.read_bytes() for path in tmp_path.glob("*-n4-*.partial")))
        before = set(tmp_path.iterdir())
        second = _limited(gsb_record, limited, tmp_path, "none")
        assert (second.returncode, second.stdout) == (1, "")
        assert second.stderr == (
            f"gsb-record: process {first.pid} on '{socket.gethostname()}' makes this sweep in {tmp_path} already: wait "
            "for its end, or choose another folder with --out\n"
        )
        assert set(tmp_path.iterdir()) == before
        gsb_record(*_sweep(tmp_path), code=0)
    finally:
        first.kill()
        first.wait()
    (lock,) = tmp_path.glob(".gsb-sweep-*.lock")
    for file in tmp_path.glob("mujoco-*"):
        file.unlink()
    _limited(gsb_record, limited, tmp_path, "none", code=0)
    assert not lock.exists()
    complete = [(r.configuration.n_env, r.configuration.run_index) for r in read_folder(tmp_path)[0] if r.outcome.good]
    assert sorted(complete) == [(2, 0), (2, 1), (4, 0), (4, 1), (8, 0), (8, 1)]


def _lock(folder: Path, where: str = "here", **changes: object) -> AbstractContextManager[None]:
    run = RunConfiguration("mujoco", "free-fall", 1, 0.01, 5)
    return locked(folder, replace(run, **changes), where)  # type: ignore[arg-type]


@pytest.mark.parametrize("word", ["", "{}", "[1]", '{"pid": "x"}', "\xff" * 5000, '{"pid": 5, "host": "a\\nb\\u202e"}'])
def test_a_lock_whose_file_says_anything(tmp_path: Path, word: str) -> None:
    """Hold and refuse by the operating system's lock alone, whatever its file says, and print none of that as it is."""
    with _lock(tmp_path):
        (file,) = tmp_path.iterdir()
        file.write_text(word)
        with pytest.raises(GsbError, match="makes this sweep") as refused, _lock(tmp_path, n_env=64, run_index=3):
            pass
        assert str(refused.value).isprintable()
        assert str(refused.value).isascii()
    file.write_text(word)
    with _lock(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_locks_of_other_sweeps(tmp_path: Path) -> None:
    """Keep apart what would not count for each other: another machine, another seed."""
    with _lock(tmp_path), _lock(tmp_path, "there"), _lock(tmp_path, seed=1):
        assert len(list(tmp_path.iterdir())) == 3
    assert not list(tmp_path.iterdir())


def test_a_file_system_without_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Make the sweep all the same, and say what cannot be told."""

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with _lock(tmp_path):
        assert not list(tmp_path.iterdir())
    assert "a file system without locks" in capsys.readouterr().err


def test_a_sweep_on_a_full_disk(gsb_record: Command, tmp_path: Path) -> None:
    """Give up with 3 where the disk takes no more, instead of taking it for the simulator's limit."""

    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))

    done = gsb_record(*_sweep(tmp_path), preexec_fn=small_disk, code=3)
    assert done.stderr.splitlines()[-1].startswith("N_env^max none: given up at 1: writing stopped: File too large")
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.slow
def test_a_sweep_on_a_terminal(tmp_path: Path) -> None:
    """Show a heading for each number of environments, and a line for each run."""
    spawn = "import os, pty, sys; sys.exit(os.waitstatus_to_exitcode(pty.spawn(sys.argv[1:])))"
    done = subprocess.run(
        [sys.executable, "-c", spawn, *command("gsb-record"), *map(str, _sweep(tmp_path))],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=300, env={**os.environ, "TERM": "xterm"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    for words in ("1 env", "4 envs", "8 envs", "run 2/2 complete in", "N_env^max 8: 8 is the end of the sweep"):
        assert words in done.stdout
