"""Runs spread over a cluster: the same recordings as without one, whatever becomes of its nodes."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from gpusimbench import open_recording
from gpusimbench.recorder.cluster import agent, gathering
from gpusimbench.recorder.cluster.batch import TRIES, Batch, Ended, Said
from gpusimbench.recorder.cluster.connection import Node
from gpusimbench.recorder.cluster.gathering import Spoiled, Stopped, gather
from gpusimbench.recorder.cluster.node import code
from gpusimbench.recorder.cluster.seats import needs_gpu, spots
from gpusimbench.recorder.process.launch import Result
from gpusimbench.recorder.process.planned_run import PlannedRun, provenance_now
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import ExitCode, UsageError
from tests.conftest import call, command, run_python, wait_for
from tests.reading import verified
from tests.recorder.conftest import folder_of
from tests.test_docs import commands, shell

pytestmark = pytest.mark.alone

ROOT = Path(__file__).resolve().parent.parent.parent
TINY = ("--sim", "mujoco", "--scene", "free-fall", "--steps", "20", "--warmup", "2", "--timed-steps", "5")
RUN = RunConfiguration("mujoco", "free-fall", 2, 0.01, 20, warmup=2, timed_steps=5)


# Where runs are made


def test_a_seat_for_each_gpu() -> None:
    """Give each GPU a run, with its share of the node's CPUs, and leave out nodes without one."""
    nodes = [Node("a", "10.0.0.1", {"CPU": 16.0, "GPU": 4.0}), Node("b", "10.0.0.2", {"CPU": 8.0})]
    assert [(s.node.id, s.cpus, s.gpus) for s in spots(nodes, gpu=True)] == [("a", 4, 1)] * 4


def test_a_seat_for_each_node_without_gpus() -> None:
    """Give a run on the CPU all CPUs of its node, and leave out nodes that have none to give."""
    nodes = [
        Node("a", "10.0.0.1", {"CPU": 16.0, "GPU": 4.0}),
        Node("b", "10.0.0.2", {"CPU": 0.0}),
        Node("c", "10.0.0.3"),
    ]
    assert [(s.node.id, s.cpus, s.gpus) for s in spots(nodes, gpu=False)] == [("a", 16, 0)]


def test_nodes_are_chosen_by_resource() -> None:
    """Use only nodes that have the resource that was named."""
    nodes = [Node("a", "10.0.0.1", {"CPU": 2.0, "accelerator_type:H100": 1.0}), Node("b", "10.0.0.2", {"CPU": 2.0})]
    assert [s.node.id for s in spots(nodes, gpu=False, resource="accelerator_type:H100")] == ["a"]


@pytest.mark.parametrize(
    ("devices", "device", "gpus", "needed"),
    [
        (("cpu",), None, 8, False),
        (("cuda", "cpu"), "cpu", 8, False),
        (("cuda", "cpu"), "auto", 8, True),
        (("cuda", "cpu"), "auto", 0, False),
        (("cuda", "cpu"), "cuda", 8, True),
        (("cuda", "cpu"), "cuda:0", 8, True),
        ((), None, 8, True),
    ],
)
def test_which_runs_need_a_gpu(devices: tuple[str, ...], device: str | None, gpus: int, needed: bool) -> None:
    """Give a GPU to runs that step on one."""
    assert needs_gpu(RUN, devices, device, [Node("a", "10.0.0.1", {"CPU": 2, "GPU": gpus})]) is needed


@pytest.mark.parametrize(
    ("device", "gpus", "said"), [("cuda", 0, "no node has a GPU"), ("cuda:1", 8, "is cuda:0 to it")]
)
def test_a_gpu_that_no_run_gets(device: str, gpus: int, said: str) -> None:
    """Refuse a device that is on no node, or that Ray shows to no run."""
    with pytest.raises(UsageError, match=said):
        needs_gpu(RUN, ("cuda", "cpu"), device, [Node("a", "10.0.0.1", {"CPU": 2, "GPU": gpus})])


# Which runs are made


def _runs(count: int) -> list[RunConfiguration]:
    return [RunConfiguration("mujoco", "free-fall", 2, 0.01, 20, run_index=index) for index in range(count)]


def _good(run: RunConfiguration) -> Result:
    return Result(run.run_index, "complete", "", None, ExitCode.OK)


def test_nothing_is_kept_before_the_first_run_ended() -> None:
    """Hold the other runs back until it is known what became of the first."""
    batch = Batch(_runs(2))
    first, second = batch.take(), batch.take()
    assert first is not None and second is not None
    answers: list[bool] = []
    waiting = threading.Thread(target=lambda: answers.append(batch.wait_turn(second)))
    waiting.start()
    assert batch.wait_turn(first)
    waiting.join(0.1)
    assert waiting.is_alive()
    batch.end(first, _good(first), 1.0)
    batch.stop()
    waiting.join(300)
    assert answers == [False]


def test_a_lost_run_is_begun_again_so_often() -> None:
    """Begin a run again whose node died, at most so many times, and then say that it is lost."""
    batch = Batch(_runs(1))
    for _ in range(TRIES):
        run = batch.take()
        assert run is not None
        batch.lose(run, "node 10.0.0.1: it died", again=True, seconds=1.0)
    assert batch.take() is None
    assert batch.over
    said = [batch.news.get_nowait() for _ in range(TRIES)]
    assert all(isinstance(news, Said) for news in said[:-1])
    assert isinstance(said[-1], Ended)
    assert (said[-1].result.status, said[-1].result.exit_code) == ("incomplete", ExitCode.DATA_LOST)
    assert "lost 3 times" in said[-1].result.reason


def test_a_lost_first_run_is_not_waited_for() -> None:
    """Let a finished run go on when the first is lost: its seat may be the only one left for the first."""
    batch = Batch(_runs(2))
    first, second = batch.take(), batch.take()
    assert first is not None and second is not None
    batch.lose(first, "it died", again=True, seconds=1.0)
    assert batch.wait_turn(second)
    batch.end(second, _good(second), 1.0)
    assert batch.take() == first


def test_an_interruption_begins_no_further_run() -> None:
    """Leave out runs that wait, and wait for those that are being made."""
    batch = Batch(_runs(3))
    run = batch.take()
    assert run is not None
    batch.begin_no_more()
    assert not batch.over
    batch.end(run, _good(run), 1.0)
    assert batch.take() is None
    assert batch.over


def test_nobody_is_left() -> None:
    """Tell of every run that has not ended, begun or not, when there is nobody to make it."""
    batch = Batch(_runs(2))
    run = batch.take()
    batch.give_up("no node is left to make it")
    assert batch.over
    assert batch.take() is None
    ends = [batch.news.get_nowait() for _ in range(2)]
    assert [end.run for end in ends if isinstance(end, Ended)] == [run, _runs(2)[1]]
    assert all(isinstance(end, Ended) and end.result.exit_code == ExitCode.DATA_LOST for end in ends)


# How files come


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[PlannedRun, Path]:
    """A run that was made, and its recording."""
    folder = tmp_path_factory.mktemp("made")
    done = subprocess.run([*command("gsb-record"), *TINY, "--n-env", "2", "--runs", "1", "--out", folder], check=True)
    assert done.returncode == 0
    (path,) = folder.iterdir()
    said = open_recording(path).provenance
    return PlannedRun(said), path


def _hashed(path: Path) -> dict[str, Any]:
    return {"name": path.name, "size": path.stat().st_size, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def _read(path: str, offset: int, length: int) -> bytes:
    return Path(path).read_bytes()[offset : offset + length]


def test_a_file_comes_in_pieces(made: tuple[PlannedRun, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Copy a file in pieces, byte for byte, under the name that it would have had here."""
    monkeypatch.setattr(gathering, "PIECE_BYTES", 1000)
    planned, path = made
    here = gather(planned, [_hashed(path)], str(path.parent), tmp_path, _read, lambda: False)
    assert here == {path.name: tmp_path / path.name}
    assert here[path.name].read_bytes() == path.read_bytes()
    again = gather(planned, [_hashed(path)], str(path.parent), tmp_path, _read, lambda: False)
    assert again[path.name].name == path.name.replace(".mcap", "-2.mcap")
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("spoil", ["byte", "short", "unfinished", "another"])
def test_a_file_that_is_not_right_leaves_nothing(made: tuple[PlannedRun, Path], tmp_path: Path, spoil: str) -> None:
    """Refuse a file that changed on its way, came in part, has no end, or is of another run; and leave nothing."""
    planned, path = made
    source, out = tmp_path / "node", tmp_path / "out"
    source.mkdir()
    out.mkdir()
    content = path.read_bytes()
    (source / path.name).write_bytes(content[: len(content) // 2] if spoil == "unfinished" else content)
    described = _hashed(source / path.name)
    if spoil == "another":
        planned = replace(planned, provenance=replace(planned.provenance, run_id="another"))

    def read(name: str, offset: int, length: int) -> bytes:
        piece = _read(name, offset, length)
        if spoil == "byte":
            return bytes([piece[0] ^ 1]) + piece[1:]
        return piece[: len(piece) // 2] if spoil == "short" and offset == 0 else b"" if spoil == "short" else piece

    with pytest.raises(Spoiled):
        gather(planned, [described], str(source), out, read, lambda: False)
    assert not list(out.iterdir())


def test_a_second_file_that_is_not_right_takes_the_first_with_it(made: tuple[PlannedRun, Path], tmp_path: Path) -> None:
    """Leave nothing of what a killed run had written where the recording that says so does not come."""
    planned, path = made
    source, out = tmp_path / "node", tmp_path / "out"
    source.mkdir()
    out.mkdir()
    (source / path.name).write_bytes(path.read_bytes())
    (source / f"{path.name}.partial").write_bytes(b"cut short")
    described = [_hashed(file) for file in source.iterdir()]
    here = gather(planned, described, str(source), out, _read, lambda: False)
    assert {file.suffix for file in here.values()} == {".mcap", ".partial"}
    for file in here.values():
        file.unlink()
    (source / path.name).write_bytes(path.read_bytes()[:-1])
    with pytest.raises(Spoiled):
        gather(planned, described, str(source), out, _read, lambda: False)
    assert not list(out.iterdir())


def test_copying_can_be_given_up(made: tuple[PlannedRun, Path], tmp_path: Path) -> None:
    """Leave nothing of a file that was given up on its way."""
    planned, path = made
    with pytest.raises(Stopped):
        gather(planned, [_hashed(path)], str(path.parent), tmp_path, _read, lambda: True)
    assert not list(tmp_path.iterdir())


# The process on a node


def _node(tmp_path: Path, **wanted: Any) -> subprocess.Popen[str]:
    first = {"simulator": "mujoco", "scene": "free-fall", "python": "", "code": code().sha256, "run": None, **wanted}
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "gpusimbench.recorder.cluster.node"
         ], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env={
            **os.environ, "TMPDIR": str(tmp_path), "PYTHONPATH": str(ROOT / "src"),
            "GSB_ENVIRONMENTS": str(tmp_path / "none"),  # whatever this machine has
        },
    )  # fmt: skip
    process.stdin.write(json.dumps(first) + "\n")
    process.stdin.flush()
    return process


def _lines(process: subprocess.Popen[str]) -> Iterator[dict[str, Any]]:
    assert process.stdout is not None
    return (json.loads(line) for line in process.stdout if line.strip())


def test_a_node_with_other_code(tmp_path: Path) -> None:
    """Refuse to record with other modules than those of the command."""
    process = _node(tmp_path, code="0" * 64)
    said = next(_lines(process))
    process.communicate(timeout=300)
    assert "it has other code of this project than the command: gpusimbench" in said["error"]
    assert process.returncode == said["exit_code"] == ExitCode.USAGE


def test_a_node_without_the_engine(tmp_path: Path) -> None:
    """Say how to get an engine that a node does not have."""
    process = _node(tmp_path, simulator="maniskill")
    said = next(_lines(process))
    process.communicate(timeout=300)
    assert "simulator 'maniskill' needs" in said["error"]
    assert said["exit_code"] == ExitCode.USAGE


def test_a_node_that_nobody_listens_to_any_more(tmp_path: Path) -> None:
    """Kill the run, and leave nothing behind, when the input ends."""
    long = RunConfiguration("mujoco", "free-fall", 2, 0.01, 20, timed_steps=1_000_000_000)
    process = _node(tmp_path, run=PlannedRun(provenance_now(long, ("gsb-record",))).to_json())
    assert next(_lines(process))["phase"]
    assert list(tmp_path.iterdir())
    process.communicate(timeout=300)
    assert not list(tmp_path.iterdir())


_REPEATS = "import sys; print(sys.stdin.read(), end='')"


def test_an_interruption_as_a_process_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Say what is wanted before all else, also where another call comes between the start and the first line."""
    node = agent.Agent()
    start, others = threading.Thread.start, []

    def late(thread: threading.Thread) -> None:  # of the thread that reads what the process says
        start(thread)
        others.append(threading.Thread(target=node.say, args=("key", "1")))
        start(others[0])
        others[0].join(0.2)

    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", late)
        node.begin("key", ["-c", _REPEATS], "wanted")
    others[0].join(300)
    node.end()
    wait_for(lambda: node.lines(0)[1])
    assert node.lines(0)[0] == ["wanted", "1"]


# A cluster


class Nodes:
    """Two nodes of this machine, each with one CPU to give. A context manager.

    They are another process's, so that nothing of Ray lives in that of the tests.
    """

    def __init__(self, environment: dict[str, str]) -> None:
        self.environment = environment
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.recorder.cluster_nodes"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True, env={**os.environ, **environment}, cwd=ROOT,
        )  # fmt: skip

    def __enter__(self) -> Nodes:
        self.address = self._answer()
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self._process.communicate(timeout=300)
        finally:
            self._process.kill()

    def kill_one(self) -> None:
        """End the node that is not the head, as a machine that loses power."""
        self._process.stdin.write("kill\n")
        self._process.stdin.flush()
        self._answer()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        late = threading.Timer(300, self._process.kill)
        late.start()
        try:
            lines = iter(self._process.stdout.readline, "")
            said = next((line for line in lines if line.startswith("at ")), "")
        finally:
            late.cancel()
        assert said, "the cluster did not start, or did not answer within five minutes"
        return said.split()[1]


@pytest.fixture(scope="module")
def nodes(plugin: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """Two nodes on this machine, which know the simulator "faulty" as well."""
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed")
    folder = tmp_path_factory.mktemp("nodes")
    with tempfile.TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True) as short:  # names of sockets are short
        environment = {
            "PYTHONPATH": os.pathsep.join([plugin["PYTHONPATH"], str(ROOT / "src")]),
            "TMPDIR": str(folder),
            "RAY_TMPDIR": short,
            "RAY_AUTH_MODE": "disabled",
            "RAY_USAGE_STATS_ENABLED": "0",
            "RAY_health_check_period_ms": "500",
            "RAY_health_check_failure_threshold": "4",
        }
        with Nodes(environment) as cluster:
            yield cluster
            wait_for(lambda: not list(folder.glob("gsb-*")))  # whatever happened, nodes are left as they were


def _spread(nodes: Nodes, *arguments: object) -> subprocess.CompletedProcess[str]:
    return call("gsb-record", "--ray", nodes.address, *arguments, env={**os.environ, **nodes.environment}, timeout=300)


def _alone(nodes: Nodes, *arguments: object) -> subprocess.CompletedProcess[str]:
    return call("gsb-record", *arguments, env={**os.environ, **nodes.environment}, timeout=300)


def _names(folder: Path) -> list[str]:
    return sorted(re.sub(r"-[0-9]{8}T[0-9]{6}Z", "", path.name) for path in folder.iterdir())


def _states(path: Path) -> tuple[int, int, bytes]:
    recording = verified(path)
    hashes = recording.fingerprints("capture")
    c = recording.configuration
    return c.n_env, c.run_index, hashes.hashes.tobytes()


def _recorded(folder: Path) -> list[tuple[int, int, bytes]]:
    return sorted(_states(path) for path in folder.glob("*.mcap"))


@pytest.mark.slow
def test_a_sweep_is_what_it_is_without_a_cluster(nodes: Nodes, tmp_path: Path) -> None:
    """Make the same files with the same states in the same environment, and find them all when called again."""
    sweep = (*TINY, "--sweep", "1..2", "--runs", "2")
    done = _spread(nodes, *sweep, "--out", tmp_path / "spread")
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("2 runs at a time on 2 nodes of the cluster\n")
    assert done.stderr.endswith("N_env^max 2: 2 is the end of the sweep\n")
    assert sorted(done.stdout.split()) == sorted(str(path) for path in (tmp_path / "spread").iterdir())
    alone = _alone(nodes, *sweep, "--out", tmp_path / "alone")
    assert alone.returncode == 0, alone.stderr
    assert _names(tmp_path / "spread") == _names(tmp_path / "alone")
    assert _recorded(tmp_path / "spread") == _recorded(tmp_path / "alone")
    one, other = (open_recording(next((tmp_path / name).iterdir())).provenance for name in ("spread", "alone"))
    assert one.environment == other.environment
    assert (one.host, one.software) == (other.host, other.software)
    again = _spread(nodes, *sweep, "--json", "--out", tmp_path / "spread")
    assert all(run["found"] for run in json.loads(again.stdout)["runs"])
    assert "4 of 4 runs are in" in again.stderr


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["segfault", "memory"])
def test_runs_that_fail_are_recorded_as_without_a_cluster(nodes: Nodes, tmp_path: Path, mode: str) -> None:
    """Leave the same files, and say the same, where runs die, fail, or show that the others need not be made."""
    asked = ("--sim", "faulty", "--option", f"mode={mode}", "--sweep", "1..2", "--runs", "2", "--steps", "10")
    results = []
    for make, name in ((_spread, "spread"), (_alone, "alone")):
        done = make(nodes, *asked, "--json", "--out", tmp_path / name)
        found = json.loads(done.stdout)
        for run in found["runs"]:
            assert Path(run["file"]).exists()
            assert run["file"] in run["reason"] or mode != "segfault"
        told = re.sub(r"-[0-9]{8}T[0-9]{6}Z", "", json.dumps(found).replace(str(tmp_path / name), ""))
        results.append((done.returncode, told, _names(tmp_path / name)))
    assert results[0] == results[1]
    assert results[0][0] == (3 if mode == "segfault" else 1)
    assert len(results[0][2]) == (1 if mode == "memory" else 2)


def _begin(nodes: Nodes, out: Path, *arguments: str, mode: str = "slow") -> subprocess.Popen[str]:
    # returns once all seats have a run
    folder = Path(nodes.environment["TMPDIR"])
    before = _written(folder)  # of a test before this one; nodes remove it in their own time
    process = subprocess.Popen(
        [*command("gsb-record"), "--ray", nodes.address, "--sim", "faulty", "--option", f"mode={mode}",
         "--phases", "capture",
         *arguments, "--out", str(out)],
        env={**os.environ, **nodes.environment}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    wait_for(lambda: process.poll() is not None or len(_written(folder) - before) >= 2)
    assert process.poll() is None
    return process


def _written(folder: Path) -> set[Path]:
    found = set()
    for path in folder.glob("gsb-work-*/*.partial"):
        with suppress(FileNotFoundError):
            if path.stat().st_size:
                found.add(path)
    return found


@pytest.mark.slow
def test_an_interruption(nodes: Nodes, tmp_path: Path) -> None:
    """Bring all runs to their end on Ctrl-C, begin no further one, and keep what was recorded."""
    process = _begin(nodes, tmp_path, "--runs", "5", "--steps", "100000")
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 1, err
    assert "interrupted: 2 of 5 runs were started" in err
    assert len(out.split()) == 2
    for path in tmp_path.iterdir():
        recording = verified(path)
        assert recording.status == "failed"
        assert recording.reason.startswith("interrupted in phase ")


@pytest.mark.slow
def test_two_interruptions(nodes: Nodes, tmp_path: Path) -> None:
    """Kill all runs at the second Ctrl-C; what has a final name is whole and says that it was interrupted."""
    process = _begin(nodes, tmp_path, "--runs", "5", "--steps", "100000", mode="deaf")
    for word in ("deaf", "heeded"):
        wait_for(lambda word=word: len([*folder_of(nodes.environment).glob(f"{word}-*")]) == 2)  # type: ignore[misc]
        os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=300)
    # runs that heeded the first may have ended, and the second come while Python itself was ending, which it kills
    ended = process.returncode == -signal.SIGINT and "interrupted: " in err
    assert ended or process.returncode in (1, 3), err
    assert "Traceback" not in err
    for path in tmp_path.glob("*.mcap"):  # of a run that heeded the first
        recording = verified(path)
        assert recording.reason.startswith("interrupted in phase ")


@pytest.mark.slow
def test_a_command_that_dies(nodes: Nodes, tmp_path: Path) -> None:
    """Kill the runs of a command that is no more, and remove their files from the nodes."""
    process = _begin(nodes, tmp_path, "--runs", "2", "--steps", "100000")
    process.kill()
    process.communicate(timeout=300)
    wait_for(lambda: not list(Path(nodes.environment["TMPDIR"]).glob("gsb-*")))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_commands_of_the_guide(tmp_path: Path) -> None:
    """Run what the guide shows on this machine alone, with nothing of Ray's in the output, nor left behind."""
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed")
    (line,) = commands(ROOT / "docs" / "cluster.md")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    with tempfile.TemporaryDirectory(prefix="ray-") as short:
        own = {"PYTHONPATH": str(ROOT / "src"), "HOME": str(tmp_path), "RAY_ADDRESS": "", "TMPDIR": str(scratch)}
        done = shell(line, tmp_path, {**own, "RAY_TMPDIR": short})
        assert not [process for process in _processes() if short in process]
    assert sorted(done.stdout.split()) == sorted(
        str(path.relative_to(tmp_path)) for path in (tmp_path / "runs").iterdir()
    )
    said = done.stderr.splitlines()
    assert said[0] == "1 run at a time on 1 node of the cluster"
    assert said[-1] == "N_env^max 2: 2 is the end of the sweep"
    assert not [text for text in said if "ray" in text.lower() or "token" in text.lower()]
    assert not list(scratch.iterdir())


def _processes() -> list[str]:
    # command lines of all that run on this machine
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # it has ended meanwhile
            found.append(path.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
    return found


# What cannot be


@pytest.mark.parametrize("error", ["KeyboardInterrupt", "ConnectionError"])
def test_a_connection_that_is_not_made(error: str) -> None:
    """Leave the standard output as it was if connecting fails or is interrupted."""
    pytest.importorskip("ray")
    code = (
        "import sys, ray\n"
        "from gpusimbench.recorder.cluster.connection import Cluster\n"
        "def init(**_):\n"
        f"    raise {error}\n"
        "ray.init, before = init, sys.stdout\n"
        "try:\n"
        "    Cluster('local').__enter__()\n"
        "except BaseException as error:\n"
        "    print(type(error).__name__, sys.stdout is before)\n"
    )
    said = {"KeyboardInterrupt": "KeyboardInterrupt True", "ConnectionError": "UsageError True"}
    assert run_python(code).stdout.splitlines() == [said[error]]


def test_without_ray(tmp_path: Path) -> None:
    """Say how to get Ray where it is not installed."""
    (tmp_path / "ray.py").write_text("raise ImportError('no ray')\n")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT / 'src'}"}
    done = call("gsb-record", *TINY, "--ray", "local", "--out", tmp_path / "out", env=environment, timeout=300)
    assert done.returncode == ExitCode.USAGE
    assert done.stderr.startswith("gsb-record: --ray needs Ray, which is not installed: pip install 'gpusimbench[ray]'")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("module", ["gpusimbench.recorder.cluster.connection", "gpusimbench.evaluator.compute.cluster"])
def test_no_process_holds_the_output(module: str) -> None:
    """Let the output end with the command, though a process that Ray started lives on."""
    script = (
        f"import subprocess, sys\nfrom {module} import unheard\nprint('before')\nwith unheard():\n"
        "    print('within', file=sys.stderr)\n"
        "    child = subprocess.Popen(['sh', '-c', 'echo within; exec sleep 100'], stdin=subprocess.DEVNULL)\n"
        "print(child.pid)\nprint('after', file=sys.stderr)\nchild.returncode = 0\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    done = run_python(script, code=None, env=environment)
    before, pid = done.stdout.split()
    assert (before, done.stderr) == ("before", "after\n")
    os.kill(int(pid), signal.SIGTERM)  # it was there still


def test_a_resource_without_a_cluster(tmp_path: Path) -> None:
    """Refuse to choose among the nodes of no cluster."""
    done = call("gsb-record", *TINY, "--ray-resource", "x", "--out", tmp_path, code=ExitCode.USAGE)
    assert "--ray-resource needs --ray ADDRESS" in done.stderr


def test_no_room(nodes: Nodes, tmp_path: Path) -> None:
    """Say that no node has what runs need."""
    done = _spread(nodes, *TINY, "--ray-resource", "accelerator_type:H100", "--out", tmp_path / "out")
    assert done.returncode == ExitCode.USAGE
    assert "none of the 2 nodes" in done.stderr
    assert "the resource 'accelerator_type:H100'" in done.stderr
    assert not (tmp_path / "out").exists()


# A node fewer: nothing that needs both comes behind this


@pytest.mark.slow
def test_a_node_that_dies(nodes: Nodes, tmp_path: Path) -> None:
    """Make the run of a dead node again elsewhere: every run is there, once, and standard output names files alone."""
    process = _begin(nodes, tmp_path, "--runs", "2", "--steps", "150", mode="held")
    nodes.kill_one()
    # the run of the dead node may go on for a second: it must not end before the command knows
    late = threading.Timer(300, process.kill)
    late.start()
    assert process.stderr is not None
    assert any("is begun again: node" in line for line in process.stderr)
    late.cancel()
    (folder_of(nodes.environment) / "let-go").touch()
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert sorted(out.split()) == sorted(str(path) for path in tmp_path.iterdir())
    assert [index for _, index, _ in _recorded(tmp_path)] == [0, 1]
