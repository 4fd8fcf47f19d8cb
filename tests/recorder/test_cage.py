"""What the run of a stranger's recording may take: evidence before it begins, a watch while it runs."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.recorder.cli import main
from gpusimbench.recorder.probes.host import memory_bytes
from gpusimbench.recorder.process import cage
from gpusimbench.recorder.process.cage import LEAST_MEMORY, Cage, Guard
from gpusimbench.recorder.process.planned_run import PlannedRun, provenance_now
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.sets import replay
from gpusimbench.recorder.sets.replay import check_room, read_source
from gpusimbench.recorder.sets.traces import content_bytes, peak_bytes
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import PROVENANCE, SCENE, SIMULATION
from tests.conftest import has_ended, wait_for
from tests.forging import forge
from tests.synthetic import Shown, grid, write_recording

_GB = 10**9


@given(peak=st.integers(0, 2**64), machine=st.integers(2**20, 2**50))
def test_memory_is_bounded_by_the_record_and_the_machine(peak: int, machine: int) -> None:
    """Allow twice what is recorded and LEAST_MEMORY in any case, and never more than 80 % of the machine."""
    may, why = Cage(peak, 0).memory(machine)
    assert 0 < may <= 0.8 * machine
    assert may <= max(2 * peak, LEAST_MEMORY)
    assert may in (2 * peak, LEAST_MEMORY, int(0.8 * machine))
    assert why


def test_the_machine_has_some_memory() -> None:
    """Know no more memory than the machine has, and some."""
    assert 0 < memory_bytes() <= psutil.virtual_memory().total


def _guarded(code: str, written: tuple[Path, ...] = ()) -> Guard:
    child = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)], start_new_session=True)
    try:
        with Guard(child, Cage(0, 0), written) as guard:
            child.wait(300)
    finally:
        child.kill()
    return guard


_TAKES = """
import subprocess, sys, time
work = "import time; x = bytearray(300 << 20); x[::4096] = b'x' * len(x[::4096]); time.sleep(300)"
{how}
time.sleep(300)
"""


@pytest.mark.parametrize(
    "how",
    [
        "exec(work)",
        "subprocess.Popen([sys.executable, '-c', work])",
        "subprocess.Popen(['sh', '-c', f'\"{sys.executable}\" -c \"{work}\" &'])",  # whose parent is gone
    ],
    ids=["itself", "child", "orphan"],
)
def test_memory_of_the_whole_tree_counts(monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    """End a process and what it started once all together are over the bound."""
    monkeypatch.setattr(cage, "memory_bytes", lambda: 256 << 20)
    before = set(psutil.pids())
    guard = _guarded(_TAKES.format(how=how))
    assert re.fullmatch(
        r"memory: it took 0\.\d\d GiB, and may take 0\.20 GiB, 80% of this machine's memory", guard.broken
    )
    assert guard.peak > 200 << 20
    # a process that was killed is there until the system has its memory back
    commands = [(p, " ".join(p.info["cmdline"] or ())) for p in psutil.process_iter(["cmdline"]) if p.pid not in before]
    killed = [process for process, command in commands if "bytearray(300" in command]
    wait_for(lambda: all(map(has_ended, killed)))


def test_threads_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """End a process with too many threads."""
    monkeypatch.setattr(cage, "most_threads", lambda: 20)
    guard = _guarded("""
        import threading, time
        for _ in range(30):
            threading.Thread(target=time.sleep, args=(300,), daemon=True).start()
        time.sleep(300)
    """)
    assert re.fullmatch(r"threads: it had (2[1-9]|3[01]), and may have 20 on this machine", guard.broken)


def test_what_is_written_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """End a process whose recording and whose folder hold too much together."""
    monkeypatch.setattr(cage, "_DISK", 1 << 20)
    (tmp_path / "scratch" / "deep").mkdir(parents=True)
    guard = _guarded(
        f"""
        import time
        for name in ("x.mcap.partial", "scratch/deep/cache"):
            open({str(tmp_path)!r} + "/" + name, "wb").write(bytes(600_000))
        time.sleep(300)
    """,
        (tmp_path / "x.mcap.partial", tmp_path / "scratch"),
    )
    assert guard.broken.startswith("disk: it wrote 0.00 GiB, and may write 0.00 GiB")


def test_a_process_that_keeps_to_its_bounds_is_left_alone() -> None:
    """Do nothing to others."""
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as child, Guard(child, Cage(0, 0), ()) as guard:
        wait_for(lambda: guard.peak > 1 << 20)
        child.communicate(timeout=300)
    assert (guard.broken, child.returncode) == ("", 0)


def _hostile(
    folder: Path, n_env: int, *, steps: int = 10, peak: int = 0, change: Callable[[Any], None] | None = None
) -> Path:
    """A small file that claims many environments: hashes that compress to nothing, clocks, and what it likes to say."""
    hashes = message_class("gsb.v1.FingerprintBlock")(first_step=0, stride=steps, steps=2, env_start=0, envs=n_env)
    hashes.hashes.extend([0] * (2 * n_env))
    clocks = message_class("gsb.v1.StepTiming")(
        first_step=0, steps_per_interval=1, start_ns=range(steps), end_ns=range(1, steps + 1)
    )

    def timed(name: str, document: dict[str, Any]) -> str | None:
        if name == PROVENANCE:
            document["configuration"]["phases"] = ["timed"]
            document["ballast"] = [hash((n_env, k)) for k in range(n_env // 32)]
        return make_scene("free-fall").to_json() if name == SCENE else None

    path = write_recording(
        folder, None, n_env=n_env, simulator="mujoco", scene="free-fall", timed_steps=steps, elapsed_s=None, whole=True,
        compression="zstd", change=timed,
        shown=Shown(raw=(
            (topics.timing("timed"), "gsb.v1.StepTiming", clocks),
            (topics.fingerprint("timed"), "gsb.v1.FingerprintBlock", hashes),
        )),
    )  # fmt: skip
    if not peak:
        return path

    def says(end: Any) -> None:
        end.peak_rss_bytes = peak

    return forge(path, folder / "says.mcap", lambda _: None, end=says)


@pytest.mark.alone
@pytest.mark.parametrize("peak", [0, 2**60])
def test_a_hostile_file_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], peak: int
) -> None:
    """Stop what takes too much, whatever the file says of itself; leave no file and say what can be done."""
    monkeypatch.setattr(cage, "memory_bytes", lambda: 400 << 20)
    hostile = _hostile(tmp_path, 200_000, peak=peak)
    assert main(["--replay", str(hostile), "--runs", "3", "--out", str(tmp_path / "out"), "--json"]) == 1
    said = capsys.readouterr()
    (run,) = json.loads(said.out)["runs"]
    assert (run["status"], run["file"]) == ("stopped", None)
    assert "memory: it took " in run["reason"]
    assert "80% of this machine's memory" in run["reason"]
    assert "gsb-record --sim has no such bounds" in run["reason"]
    assert not list((tmp_path / "out").iterdir())


def test_the_states_alone_are_too_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin nothing whose states alone are more than a replay may take."""
    source = read_source(_hostile(tmp_path, 20_000))
    check_room(source, 1, tmp_path)
    monkeypatch.setattr(replay, "memory_bytes", lambda: 4_000_000)
    said = "the states of 20000 environments alone are 0.01 GiB, and a replay may take 0.00 GiB of memory, 80% of this"
    with pytest.raises(UsageError, match=said):
        check_room(source, 1, tmp_path)


def test_a_disk_without_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin nothing whose recordings the disk has no room for, also in a folder that is not there yet."""
    source = read_source(_hostile(tmp_path, 20_000))
    wanted = source.cage.content_bytes
    assert wanted >= 20_000 * 16
    check_room(source, 2, tmp_path / "not" / "there")
    monkeypatch.setattr(replay, "free_bytes", lambda _: 2 * wanted - 1)
    check_room(source, 1, tmp_path)
    with pytest.raises(UsageError, match=r"2 recordings of it have about 0.00 GiB, and .* has 0.00 GiB free"):
        check_room(source, 2, tmp_path)


def test_environments_for_a_byte(tmp_path: Path) -> None:
    """Believe a file a few environments for each of its bytes, however well their hashes compress."""
    hostile = _hostile(tmp_path, 200_000)

    def lighter(document: dict[str, Any]) -> None:
        document["ballast"] = []

    light = forge(hostile, tmp_path / "light.mcap", lighter)
    read_source(hostile)
    assert light.stat().st_size * 4 < 200_000 < light.stat().st_size * 16
    with pytest.raises(UsageError, match="it asks for 200000 environments, and its"):
        read_source(light)


def test_states_are_evidence(tmp_path: Path) -> None:
    """Refuse a captured run whose file holds fewer bytes of states than its steps and environments have."""

    path = write_recording(tmp_path, grid(4), simulator="mujoco", elapsed_s=None, dt=0.01, steps=5, compression="zstd")
    source = read_source(path)
    rows = 4 * 27 * 3 * grid(4).itemsize
    assert source.cage.content_bytes >= 6 * rows

    def fewer(document: dict[str, Any]) -> None:
        document["fields"][0]["components"] += ["more"] * 3

    with pytest.raises(UsageError, match=r"and 6 rows of cubes/position, and has traces of 3 rows of cubes/position"):
        read_source(forge(path, tmp_path / "forged.mcap", fewer, attachment=SIMULATION))


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_memory_that_is_recorded(tmp_path: Path, compression: str) -> None:
    """Add up what a run took of the host and of its GPU, which a replay on the CPU takes of the host."""
    path = write_recording(
        tmp_path, None, host_bytes=(_GB, 3 * _GB), gpu_bytes=(_GB, 6 * _GB), allocator_peak=2 * _GB,
        compression=compression,
    )  # fmt: skip
    assert peak_bytes(Container(path), 0) == 8 * _GB
    assert peak_bytes(Container(path), 4 * _GB) == 9 * _GB


def test_every_shipped_recording_has_room() -> None:
    """Take no recording that was really made for a hostile one: evidence, and memory of a machine like its own."""
    folder = Path(__file__).parents[2] / "recordings"
    replayable = 0
    for path in sorted(folder.glob("*.mcap")):
        try:
            source = read_source(path)
        except UsageError as error:
            assert "traces" not in str(error), error
            continue
        replayable += 1
        assert source.cage.memory(1 << 50)[0] >= 2 * source.cage.peak_bytes
    assert replayable > 5


def test_a_cage_travels(tmp_path: Path) -> None:
    """Send a run's cage to where the run is made."""
    run = RunConfiguration("mujoco", "free-fall", 1, 0.01, 5)
    planned = PlannedRun(provenance_now(run, ()), cage=Cage(7, 9))
    assert PlannedRun.from_json(json.loads(json.dumps(planned.to_json()))) == planned
    assert PlannedRun.from_json(json.loads(json.dumps(replace(planned, cage=None).to_json()))).cage is None


def test_content_of_what_is_asked(tmp_path: Path) -> None:
    """Know how much a recording will hold: never less than its states and hashes."""
    path = write_recording(tmp_path, grid(4), elapsed_s=1.0, timed_steps=10, steps=5)
    c = replace(read_configuration(path), warmup=3)
    found = content_bytes(Container(path), replace(c, steps=500_000), ())
    assert found == 4 * 8 * 500_001 + 4 * 8 * 2 + 16 * 13


def read_configuration(path: Path) -> RunConfiguration:
    """Of a recording."""
    from gpusimbench.recorder.sets.finished import read_end

    return read_end(path).configuration
