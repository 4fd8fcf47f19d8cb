"""Power cuts, full disks, two recorders at once, clocks that jump: what a recorder leaves behind in any case."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from gpusimbench import open_recording
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.errors import RecordingError
from gpusimbench.schemas.mcap.reader import Container
from tests.conftest import SMALL, Command, call, command, distribution
from tests.moments import descendants, has_worked, has_written, wait_until, whole
from tests.reading import verified

_KILLS = 50
_AT_ONCE = 4


def _messages(path: Path) -> dict[str, list[Message]]:
    """All whole messages by topic, as the official library reads a file from its beginning."""
    topics: dict[int, str] = {}
    found: dict[str, list[Message]] = {}
    with path.open("rb") as stream:
        records = StreamReader(stream, record_size_limit=None).records
        with suppress(McapError, EOFError):
            for record in records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    found.setdefault(topics[record.channel_id], []).append(record)
    return found


def _contents(path: Path) -> dict[str, list[bytes]]:
    return {topic: [message.data for message in found] for topic, found in _messages(path).items()}


def _ours(path: Path) -> dict[str, list[bytes]]:
    container = Container(path)
    found = {}
    for topic in container.channels:
        read = sorted((container.read(m) for m in container.messages(topic)), key=lambda pair: pair[0])
        assert [sequence for sequence, _ in read] == list(range(len(read)))
        found[topic] = [bytes(content) for _, content in read]
    return {topic: contents for topic, contents in found.items() if contents}


def _check_partial(path: Path, before: bytes, folder: Path) -> str:
    # what was in the file when the power went is there, and both readers find it
    after = path.read_bytes()
    assert after.startswith(before)
    (snapshot := folder / "before.mcap").write_bytes(before)
    try:
        recording = open_recording(path)
    except RecordingError:
        assert not _contents(path), "whole messages are there, and it cannot be opened"
        return "nothing yet"
    official, ours, seen = _contents(path), _ours(path), _contents(snapshot)
    assert ours == official
    for topic, contents in seen.items():
        assert official[topic][: len(contents)] == contents
    verify(recording)
    assert recording.status in ("incomplete", "complete")  # whole, where only the new name was missing
    for field in recording.fields:
        array = recording.state(field.group, field.field)
        assert len(array[:]) == len(array)
    hashes = recording.fingerprints("capture")
    # those of the block that was written last may be missing: its states come first
    assert hashes is None or hashes.steps.tolist() == list(range(len(hashes.steps)))
    return f"{recording.status} with states" if any(t.startswith("/state/") for t in ours) else recording.status


_TWO_RUNS = ("--sim", "mujoco", "--n-env", "2", "--runs", "2", *SMALL, "--out")


def _cut(process: subprocess.Popen[str], out: Path, how: signal.Signals, *, run_alone: bool) -> Counter[str]:
    files = list(out.glob("*.partial")) if out.exists() else []
    before = {}
    for file in files:
        with suppress(FileNotFoundError):
            before[file] = file.read_bytes()
    seen: Counter[str] = Counter()
    if how == signal.SIGKILL:
        if not run_alone and process.poll() is None:
            process.send_signal(signal.SIGSTOP)  # so that it starts none while they are looked for
        for each in (signal.SIGSTOP, signal.SIGKILL):  # at once for all: a run sees the end of its command
            for pid in descendants(process.pid)[run_alone:]:
                with suppress(ProcessLookupError):
                    os.kill(pid, each)
    else:
        process.send_signal(how)
    _, err = process.communicate(timeout=300)
    assert "Traceback" not in err
    for file in sorted(out.iterdir()) if out.exists() else ():
        assert file.suffix in (".mcap", ".partial"), file
        if file.suffix == ".mcap":
            recording = verified(file)
            assert recording.status == "complete" or (how == signal.SIGTERM and recording.status == "failed")
            seen[recording.status] += 1
        else:
            assert how == signal.SIGKILL, f"a command that could end its recording left {file}"
            (scratch := out.with_name(f"{out.name}-scratch")).mkdir(exist_ok=True)
            seen[_check_partial(file, before.get(file, b""), scratch)] += 1
    return seen


@pytest.mark.slow
def test_power_cuts(tmp_path: Path) -> None:
    """Leave, after SIGKILL or SIGTERM at 50 moments, whole files under final names, and all that was written; also
    where a run's process is killed and its command goes on."""
    seconds, content = whole([*command("gsb-record"), *_TWO_RUNS, str(tmp_path / "whole")], tmp_path / "whole")
    moments = random.Random(50)

    def cut(number: int) -> Counter[str]:
        out, share = tmp_path / f"{number}", 0.1 + 1.2 * moments.random()
        # half of them while the process starts, computes or ends, half while it writes
        process = subprocess.Popen(
            ["nice", *command("gsb-record"), *_TWO_RUNS, str(out)],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        if number % 2:
            wait_until(process, partial(has_worked, process.pid, share * seconds))
        else:
            wait_until(process, partial(has_written, out, share * content))
        how = signal.SIGTERM if number % 5 == 4 else signal.SIGKILL
        return _cut(process, out, how, run_alone=number % 5 == 2)

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        seen = sum(pool.map(cut, range(_KILLS)), Counter[str]())
    assert seen["complete"]
    assert seen["incomplete with states"], seen


_TINY = ("--steps", "20", "--warmup", "2", "--timed-steps", "5")


@pytest.mark.slow
def test_two_recorders_and_one_folder(tmp_path: Path) -> None:
    """Keep all recordings of two commands that write into one folder in the same seconds."""
    arguments = [*command("gsb-record"), "--sim", "mujoco", "--n-env", "2", "--runs", "5", *_TINY]
    both = [
        subprocess.Popen(
            [*arguments, "--out", str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    ended = [process.communicate(timeout=300) for process in both]
    assert [process.returncode for process in both] == [0, 0], ended
    told = [line for out, _ in ended for line in out.split()]
    assert len(set(told)) == 10
    assert sorted(told) == sorted(map(str, tmp_path.iterdir()))
    recordings = [open_recording(path) for path in told]
    for recording in recordings:
        verify(recording)
        assert recording.status == "complete"
    assert len({recording.provenance.run_id for recording in recordings}) == 10


_ON_A_SMALL_DISK = """
mount -t tmpfs -o size={size}k tmpfs {disk} || exit 77
{record} --out {disk}
code=$?
cp {disk}/* {kept}/
exit $code
"""


@pytest.mark.parametrize("size", [64, *(pytest.param(n, marks=pytest.mark.slow) for n in (8, 600)), 1500])
def test_a_disk_that_is_really_full(tmp_path: Path, size: int) -> None:
    """End with 3 and one clear message where the device has no space, and leave what is there readable."""
    disk, kept = tmp_path / "disk", tmp_path / "kept"
    disk.mkdir()
    kept.mkdir()
    record = " ".join([*command("gsb-record"), "--sim", "mujoco", "--n-env", "4", "--runs", "1", "--steps", "200",
                       "--warmup", "0", "--timed-steps", "5"])  # fmt: skip
    script = _ON_A_SMALL_DISK.format(size=size, disk=disk, kept=kept, record=record)
    if shutil.which("unshare") is None:
        pytest.skip("no unshare(1) to mount a small disk with")
    done = subprocess.run(
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip(f"no small disk can be mounted here: {done.stderr.strip()[-100:]}")
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("No space left on device") == 1, done.stderr
    (file,) = kept.iterdir()
    assert file.suffix == ".partial"
    try:
        recording = open_recording(file)
    except RecordingError:
        assert size <= 64
        return
    assert recording.status == "incomplete"
    verify(recording)
    if size >= 1500:
        array = recording.state("cubes", "position")
        assert len(array[:]) > 50


_CLOCKS = '''
"""A simulator on a machine whose clock is set back and forth while it steps."""
import time
from dataclasses import dataclass
import numpy as np
from gpusimbench.recorder.simulators.base import Ability, Description, Simulator
from gpusimbench.schemas.fields import body_field

_HOUR = 3600 * 10**9
_offset = 0
_time_ns = time.time_ns

@dataclass(frozen=True)
class Options:
    jumps: bool = True

class Jumping(Simulator):
    Options = Options
    abilities = frozenset(Ability)

    def build(self):
        global _offset
        if self.options.jumps:
            time.time_ns = lambda: _time_ns() + _offset
            time.time = lambda: time.time_ns() / 1e9
        self.k = 0
        names = tuple(f"cube{i}" for i in range(27))
        field = body_field("cubes", "position", "float32", names)
        return Description("1.0", "cpu", {}, {}, (), (field,), timing_covers="nothing")

    def step(self, n_step):
        global _offset
        for _ in range(n_step):
            self.k += 1
            if self.k % 7 == 0:
                _offset += (-5 if self.k % 2 else 4) * _HOUR

    def state(self):
        rows = np.arange(self.n_env * 27 * 3, dtype=np.float32).reshape(self.n_env, 27, 3)
        return (rows / 1000 + np.float32(self.k) / 100,)
'''


@pytest.fixture(scope="module")
def jumping(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment that offers the simulator "jumping"."""
    folder = tmp_path_factory.mktemp("jumping")
    return distribution(folder, "jumping-clock", "[gsb.simulators]\njumping = jumping_clock:Jumping\n", _CLOCKS)


def _record_jumps(gsb_record: Command, environment: dict[str, str], out: Path, jumps: bool) -> Recording:
    done = gsb_record("--sim", "jumping", "--n-env", 2, "--runs", 1, "--steps", 100, "--warmup", 10, "--timed-steps",
                      40, "--option", f"jumps={jumps}", "--out", out, env=environment, code=0)  # fmt: skip
    return verified(done.stdout.strip())


@pytest.mark.slow
def test_a_wall_clock_that_jumps(gsb_record: Command, jumping: dict[str, str], tmp_path: Path) -> None:
    """Record and evaluate the same while the wall clock is set back and forth by hours."""
    calm = _record_jumps(gsb_record, jumping, tmp_path / "calm", jumps=False)
    wild = _record_jumps(gsb_record, jumping, tmp_path / "wild", jumps=True)
    assert wild.status == "complete"
    messages = _messages(wild.path)
    written = [m.publish_time for ms in messages.values() for m in ms]
    assert max(written) - min(written) > 3600 * 10**9, "the clock did not jump; nothing was tried"
    for topic, found in messages.items():
        assert [m.sequence for m in found] == list(range(len(found))), topic
        assert all(a.log_time <= b.log_time for a, b in zip(found, found[1:], strict=False)), topic
    assert np.array_equal(wild.state("cubes", "position")[:], calm.state("cubes", "position")[:])
    assert 0 < wild.timing["timed"].elapsed_s < 60
    metrics = _metrics(wild)
    assert metrics["w1_parallel"] == pytest.approx(100 * 0.081 * 2**0.5, rel=1e-4)  # cm: environment 1 lies beside 0
    assert metrics == _metrics(calm)


def _metrics(recording: Recording) -> dict[str, object]:
    done = subprocess.run(
        [sys.executable, "-m", "gpusimbench.evaluator.cli.eval",
         str(recording.path), "--sample-time", "1", "--json", "-"],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (group,) = json.loads(done.stdout)["groups"]
    costs = (
        "fps",
        "build",
        "compile",
        "capture_slowdown",
        "memory",
        "host",
        "allocator",
    )  # clocks and bytes of this very run
    return {n: m["value"] for n, m in group["metrics"].items() if not n.startswith(costs)}


_BEFORE_1970 = """
import time
time.time_ns = lambda: {now}
time.time = lambda: time.time_ns() / 1e9
"""


@pytest.mark.parametrize(
    ("now", "said", "held"), [(-(10**17), "before 1970", 0), (2**63 + 5, "behind 2262", 2**63 - 1)]
)
def test_a_wall_clock_that_no_field_can_hold(
    gsb_record: Command, tmp_path: Path, now: int, said: str, held: int
) -> None:
    """Record with a clock before 1970, and far in the future, as with any other; say what stands for its times."""
    (tmp_path / "path").mkdir()
    (tmp_path / "path" / "sitecustomize.py").write_text(_BEFORE_1970.format(now=now))
    done = gsb_record("--sim", "mujoco", "--scene", "free-fall", "--n-env", 2, "--runs", 1, "--steps", 5, "--warmup", 1,
                      "--timed-steps", 2, "--out", tmp_path / "out",
                      env={**os.environ, "PYTHONPATH": str(tmp_path / "path")}, timeout=300, code=0)  # fmt: skip
    assert f"clock stands {said}" in done.stderr
    recording = verified(done.stdout.strip())
    assert recording.status == "complete"
    assert {event.unix_ns for event in recording.events} == {held}
    assert any(event.kind == "NOTE" and said in event.text for event in recording.events)
    assert {m.publish_time for ms in _messages(recording.path).values() for m in ms} == {held}
    assert {p.suffix for p in (tmp_path / "out").iterdir()} == {".mcap"}
    assert call("gsb-check", recording.path).returncode == 0
