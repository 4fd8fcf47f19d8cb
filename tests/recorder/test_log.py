"""States of any program as a recording that the evaluator reads."""

from __future__ import annotations

import errno
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.cli.check import main as check
from gpusimbench.evaluator.cli.diff import main as diff
from gpusimbench.evaluator.cli.eval import main as evaluate
from gpusimbench.evaluator.cli.info import main as info
from gpusimbench.evaluator.cli.share import main as share
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.errors import DataLost, UsageError
from gpusimbench.schemas.fields import array_field, body_field
from tests.conftest import Command, run_python
from tests.reading import verified
from tests.synthetic import metrics_of

NAMES = ("red", "blue")
FIELDS = (body_field("cubes", "position", "float32", NAMES), body_field("cubes", "linear_velocity", "float32", NAMES))


def writer(path: Path, **others: Any) -> RecordingWriter:
    """A writer of four environments, two cubes, ten steps."""
    announced: dict[str, Any] = {
        "simulator": "mine", "version": "1.0", "scene": "toss", "n_env": 4, "dt": 0.1, "steps": 10, "fields": FIELDS,
    }  # fmt: skip
    return RecordingWriter(path, **{**announced, **others})


def states(n_step: int = 11) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of some steps, [step, env, item, 3]."""
    position = np.arange(n_step * 4 * 2 * 3, dtype=np.float32).reshape(n_step, 4, 2, 3) / 1000
    return position, np.ones_like(position)


_FORKS = """
import os, sys
from pathlib import Path
from gpusimbench.schemas.errors import DataLost
from tests.recorder.test_log import states, writer

path = Path(sys.argv[1])
with writer(path) as log:
    log.append(*(array[:4] for array in states()))
    if not os.fork():
        try:
            log.append(*(array[4:] for array in states()))
        except DataLost as error:
            print(error, flush=True)
        sys.exit(0)
    os.wait()
    assert not path.exists()
    log.append(*(array[4:] for array in states()))
"""


def test_a_program_that_forks(tmp_path: Path) -> None:
    """Leave the file to the process that began it: a copy of the process that ends writes no end into it."""
    told = run_python(_FORKS, tmp_path / "a.mcap")
    assert told.stdout.count(f"is a copy (os.fork) of the one that records {tmp_path / 'a.mcap'}: it writes") == 1
    recording = verified(tmp_path / "a.mcap")
    assert recording.status == "complete"
    assert np.array_equal(recording.state("cubes", "position")[:], states()[0])


def test_a_program_logs_its_states(tmp_path: Path) -> None:
    """Log state by state, reusing one array, and find every number and what was said of them."""
    position, velocity = states()
    reused = np.empty_like(position[0])
    with writer(tmp_path / "a.mcap", options={"drag": 0.1}, switches={"precision": "float32"}) as log:
        for step in range(11):
            reused[:] = position[step]
            log.append(reused, velocity[step])
    recording = verified(tmp_path / "a.mcap")
    assert (recording.status, recording.reason) == ("complete", "")
    assert np.array_equal(recording.state("cubes", "position")[:], position)
    assert np.array_equal(recording.state("cubes", "linear_velocity")[:], velocity)
    assert recording.configuration.options == {"drag": "0.1"}
    assert recording.configuration.phases == ("capture",)
    assert recording.simulation.options == {"drag": 0.1}
    assert recording.provenance.host["cpu"]
    assert recording.provenance.software["packages"]["numpy"] == np.__version__
    assert recording.provenance.argv
    assert b"numpy==" in (recording.attachment("pip-freeze.txt") or b"")
    assert recording.scene == {}


def test_an_argument_that_is_no_unicode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Record in a program that was given a path in another encoding, and write the bytes of it as escapes."""
    monkeypatch.setattr(sys, "argv", ["train.py", os.fsdecode(b"caf\xe9.npz")])
    path = tmp_path / "a.mcap"
    with writer(path) as log:
        log.append(*states())
    recording = verified(path)
    assert recording.provenance.argv == ("train.py", "caf\\udce9.npz")


def test_all_at_once_is_the_same(tmp_path: Path) -> None:
    """Give the same states in one call, and in two, and find the same identity of content."""
    position, velocity = states()
    for name, pieces in {"a": (slice(0, 11),), "b": (slice(0, 1), slice(1, 11))}.items():
        with writer(tmp_path / f"{name}.mcap", stride=5, attachments={"note.txt": ("text/plain", b"x")}) as log:
            for piece in pieces:
                log.append(position[piece], velocity[piece])
    one, other = open_recording(tmp_path / "a.mcap"), open_recording(tmp_path / "b.mcap")
    assert one.state("cubes", "position").steps.tolist() == [0, 5, 10]
    assert np.array_equal(one.state("cubes", "position")[:], other.state("cubes", "position")[:])
    assert one.attachment("note.txt") == b"x"


def test_runs_are_evaluated(tmp_path: Path, gsb_eval: Command) -> None:
    """Log three runs with clocks, and get variability, reproducibility and speed of one group."""
    scene = make_scene("free-fall")
    names = scene.groups()["cubes"]
    position = np.zeros((11, 4, 27, 3), dtype=np.float32)
    position[:, :, :, 2] = 0.5
    position[-1, :, :, 0] = np.arange(4, dtype=np.float32)[:, None] / 100
    begins = np.arange(20) * 1_000_000
    for run in range(3):
        with writer(
            tmp_path / f"{run}.mcap", scene=scene, run_index=run, warmup=2, timed_steps=20, timing_covers="a step",
            fields=(body_field("cubes", "position", "float32", names),),
        ) as log:  # fmt: skip
            log.clocks(begins, begins + 500_000)
            log.append(position)
    done = gsb_eval(*sorted(tmp_path.glob("*.mcap")), "--sample-time", "1", "--json", "-", code=0)
    assert len(json.loads(done.stdout)["groups"]) == 1
    metrics = metrics_of(done.stdout)
    assert metrics["fps"]["value"] == pytest.approx(4 * 20 / 0.0195)
    assert metrics["distinct_envs"]["value"] == 4
    assert metrics["distinct_runs"]["value"] == 1
    assert open_recording(tmp_path / "0.mcap").scene["name"] == "free-fall"


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"n_env": 0}, "^n_env is at least 1"),
        ({"n_env": 10**9}, "^n_env is at most"),
        ({"steps": 0}, "^steps is at least 1"),
        ({"stride": 3}, "^stride 3 does not divide steps 10"),
        ({"warmup": -1}, "^warmup is at least 0"),
        ({"timed_steps": -1}, "^timed_steps is at least 1"),
        ({"dt": 0.0}, "^dt is a step in seconds"),
        ({"view": (0, 0)}, "^view names at most 4 environments, each once"),
        ({"view": (4,)}, "^view is from 0 to 3, as n_env is 4"),
        ({"simulator": ""}, "a recording needs the name of its simulator"),
        ({"version": ""}, "a recording needs the name of its version"),
        ({"simulator": "real"}, "is the name of measured trials"),
        ({"compression": "rar"}, "compression is one of none, lz4, zstd"),
        ({"fields": ()}, "at least one field"),
        ({"env_origins": ((0.0, 0.0, 0.0),)}, "there are 1 env origins, and 4 environments"),
    ],
)
def test_what_cannot_be_recorded(tmp_path: Path, others: dict[str, Any], message: str) -> None:
    """Say so before a file is made."""
    with pytest.raises(UsageError, match=message):
        writer(tmp_path / "a.mcap", **others)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ((states()[0],), "there are 2 fields, and 1 arrays were given"),
        ((states()[0].astype(np.float64), states()[1]), "cubes/position is float64, and was announced as float32"),
        ((states()[0][:, :3], states()[1]), r"cubes/position has shape \(11, 3, 2, 3\), not"),
        ((states()[0][None], states()[1]), r"cubes/position has shape \(1, 11, 4, 2, 3\), not"),
        ((states(3)[0], states(4)[1]), r"different numbers of steps: \[3, 4\]"),
        ((states()[0][:0], states()[1][:0]), "the arrays have no step"),
        (states(12), "step 11 is given, and the recording was announced to end at step 10"),
    ],
)
def test_states_of_another_layout(tmp_path: Path, arrays: tuple[Any, ...], message: str) -> None:
    """Refuse them, and end the recording as failed, with the reason."""
    with pytest.raises(UsageError, match=message), writer(tmp_path / "a.mcap") as log:
        log.append(*arrays)
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.status == "failed"
    assert recording.reason.startswith("UsageError: ")


@pytest.mark.parametrize(
    ("start", "end", "interval", "message"),
    [
        ([0], [1], 1, "4 steps in intervals of 1 have 4 begins and ends"),
        ([0, 5], [4, 4], 2, "clocks run backwards"),
        ([0, 3], [4, 6], 2, "clocks run backwards"),
        ([0], [1], 0, "in intervals of 0"),
    ],
)
def test_clocks_that_cannot_be(tmp_path: Path, start: Any, end: Any, interval: int, message: str) -> None:
    """Refuse clocks of other steps, and of no order."""
    with pytest.raises(UsageError, match=message), writer(tmp_path / "a.mcap", timed_steps=4) as log:
        log.clocks(start, end, steps_per_interval=interval)


def test_clocks_of_nothing(tmp_path: Path) -> None:
    """Refuse clocks where no timed steps were announced, and clocks that are given twice."""
    with pytest.raises(UsageError, match="given once"), writer(tmp_path / "a.mcap") as log:
        log.clocks([0], [1])
    with pytest.raises(UsageError, match="given once"), writer(tmp_path / "b.mcap", timed_steps=1) as log:
        log.clocks([0], [1])
        log.clocks([0], [1])


def test_an_end_that_is_none(tmp_path: Path) -> None:
    """Record what is missing, what went wrong, and what the states are not worth."""
    position, velocity = states()
    with writer(tmp_path / "empty.mcap"):
        pass
    with writer(tmp_path / "short.mcap") as log:
        log.append(position[:4], velocity[:4])
    with writer(tmp_path / "untimed.mcap", timed_steps=5) as log:
        log.append(position, velocity)
    with pytest.raises(RuntimeError, match="no such device"), writer(tmp_path / "broken.mcap") as log:
        log.append(position[:4], velocity[:4])
        raise RuntimeError("no such device")
    with writer(tmp_path / "dropped.mcap") as log:
        log.append(position, velocity)
        log.invalid("the solver gave up")
    with writer(tmp_path / "nan.mcap") as log:
        spoiled = position.copy()
        spoiled[7, 2, 1, 0] = np.nan
        log.append(spoiled, velocity)
    found = {path.stem: open_recording(path) for path in tmp_path.glob("*.mcap")}
    assert {name: (r.status, r.reason) for name, r in found.items()} == {
        "empty": ("failed", "no state was given"),
        "short": ("failed", "states end at step 3 of 10"),
        "untimed": ("failed", "5 timed steps were announced, and no clocks were given"),
        "broken": ("failed", "RuntimeError: no such device"),
        "dropped": ("invalid", "the solver gave up"),
        "nan": ("invalid", "a state is not finite: step 7, env 2, cubes/position of blue"),
    }
    assert found["nan"].cause == "not finite"
    assert len(found["broken"].state("cubes", "position")) == 4


def test_the_first_state_that_is_not_finite(tmp_path: Path) -> None:
    """Name the first, and none of those that follow from it, however many blocks of states they are in."""
    position, velocity = states(301)
    position[70:, 2] = np.nan
    with writer(tmp_path / "nan.mcap", steps=300) as log:
        for step in range(301):
            log.append(position[step], velocity[step])
    reason = open_recording(tmp_path / "nan.mcap").reason
    assert reason == "a state is not finite: step 70, env 2, cubes/position of red"


def test_steps_that_are_not_announced(tmp_path: Path) -> None:
    """Record as many steps as were made, in the same file as if they had been announced; none made is a failure."""
    position, velocity = states()
    for name, steps, stride in (("told", 10, 2), ("open", None, 2), ("none", None, 1), ("first", None, 1)):
        with writer(tmp_path / f"{name}.mcap", steps=steps, stride=stride) as log:
            rows = {"none": 0, "first": 1}.get(name, len(position))
            for row in range(rows):
                log.append(position[row], velocity[row])
    found = {path.stem: open_recording(path) for path in tmp_path.glob("*.mcap")}
    for recording in found.values():
        verify(recording)
    assert found["open"].configuration == found["told"].configuration
    for field in FIELDS:
        one, other = (found[name].state(field.group, field.field) for name in ("open", "told"))
        assert one.steps.tolist() == [0, 2, 4, 6, 8, 10]
        assert np.array_equal(one[:], other[:])
    assert {name: (r.status, r.reason, r.configuration.is_open) for name, r in found.items()} == {
        "told": ("complete", "", False),
        "open": ("complete", "", False),
        "none": ("failed", "no state was given", False),
        "first": ("failed", "states end at step 0 of 1", False),
    }
    with pytest.raises(RuntimeError, match="hot"), writer(tmp_path / "broken.mcap", steps=None) as log:
        log.append(position[:4], velocity[:4])
        raise RuntimeError("hot")
    broken = open_recording(tmp_path / "broken.mcap")
    assert (broken.status, broken.configuration.steps) == ("failed", 3)


_KILLED = """
import os, sys
import numpy as np
from gpusimbench import RecordingWriter
from gpusimbench.schemas.fields import array_field

log = RecordingWriter(sys.argv[1], simulator="mine", version="1", scene="task", n_env=2, dt=0.1, steps=None,
                      fields=(array_field("reward", "float32"),))
log.__enter__()
for _ in range(120):
    log.append(np.zeros(2, np.float32))
os.kill(os.getpid(), 9)
"""


def test_a_killed_program_without_announced_steps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say of what is left that it is not complete, and read the blocks that are there."""
    run_python(_KILLED, tmp_path / "a.mcap", code=-9)
    left = tmp_path / "a.mcap.partial"
    recording = open_recording(left)
    assert (recording.status, recording.configuration.is_open) == ("incomplete", True)
    assert len(recording.state("env", "reward")) == 101  # the first, and blocks of 50
    assert check([str(left)]) == 3
    assert "error end: no end record" in capsys.readouterr().out
    assert info([str(left)]) == 3
    assert "an unannounced number of captured steps" in capsys.readouterr().out


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    """Refuse a name that is taken, and end a recording of which the program lost something with its words."""
    (tmp_path / "a.mcap").write_bytes(b"kept")
    with pytest.raises(UsageError, match="exists already"), writer(tmp_path / "a.mcap"):
        pass
    assert (tmp_path / "a.mcap").read_bytes() == b"kept"
    with pytest.raises(DataLost), writer(tmp_path / "b.mcap"):
        raise DataLost("rows are missing")
    recording = open_recording(tmp_path / "b.mcap")
    assert (recording.status, recording.reason) == ("failed", "DataLost: rows are missing")


def test_a_flush_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Warn of a file with an end record that did not reach the disk, though every byte of it can be read."""

    def failing(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", failing)
        with pytest.raises(DataLost, match="Input/output error"), writer(tmp_path / "a.mcap") as log:
            log.append(*states())
    left = tmp_path / "a.mcap.partial"
    assert check([str(left)]) == 0
    said = capsys.readouterr().out
    assert "warning confirmed: not confirmed by its recorder to be on the disk" in said
    assert "whole and unchanged" in (info([str(left)]), capsys.readouterr().out)[1]
    for given in ([str(left)], [str(tmp_path), "--all"]):
        evaluate(given)
        assert "not confirmed by its recorder to be on the disk" in " ".join(capsys.readouterr().out.split()), given
    assert diff([str(left), "--env", "0", "--env", "1"]) in (0, 4)
    assert "a.mcap.partial is not confirmed by its recorder" in " ".join(capsys.readouterr().out.split())
    assert share(["recover", str(left)]) == 2
    assert "nothing to recover; copy it under its final name, and check the copy" in capsys.readouterr().err
    left.rename(tmp_path / "a.mcap")
    assert check([str(tmp_path / "a.mcap")]) == 0
    assert "confirmed" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("others", "says"),
    [
        ({"attachments": {"provenance.json": ("application/json", b"{}")}}, "attachments named provenance.json"),
        ({"run_index": -1}, "run_index is at least 0"),
        ({"fields": (FIELDS[0], FIELDS[0])}, "two fields have the same group and name"),
        ({"fields": (body_field("cubes", "position", "float32", ("a", "a")),)}, "two items of .* have the same name"),
        ({"options": {"drag": np.float32(1)}}, "must be values of JSON"),
        ({"options": {"drag": float("nan")}}, "could not be read again: simulation.json is not JSON: NaN"),
        ({"steps": True}, "could not be read again: steps is not a whole number"),
    ],
)
def test_what_no_evaluator_would_read(tmp_path: Path, others: dict[str, Any], says: str) -> None:
    """Refuse at the beginning what would make a recording that is whole and yet refused."""
    with pytest.raises(UsageError, match=says):
        writer(tmp_path / "a.mcap", **others)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("start", "end", "says"),
    [([0.0, 1.0], [1.0, 2.0], "whole nanoseconds"), ([0, 5], [0, 9], "stand still"), ([0, 3], [4, 9], "backwards")],
)
def test_clocks_of_no_nanoseconds(tmp_path: Path, start: list[float], end: list[float], says: str) -> None:
    """Refuse clocks in seconds, clocks that stand still, and intervals that overlap."""
    with writer(tmp_path / "a.mcap", timed_steps=2) as log, pytest.raises(UsageError, match=says):
        log.clocks(start, end)


_INTERRUPTED = """
import os, signal, sys, threading
import numpy as np
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.schemas.fields import body_field

signal.signal(signal.SIGINT, signal.default_int_handler)
field = body_field("cubes", "position", "float32", tuple(map(str, range(20))))
try:
    threading.Timer(float(sys.argv[2]), lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    with RecordingWriter(sys.argv[1], simulator="mine", version="1", scene="toss", n_env=500, dt=0.01, steps=100000,
                         fields=(field,)) as log:
        while True:
            log.append(np.zeros((500, 20, 3), np.float32))
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.parametrize("seconds", [0.3, 0.35, 0.41, 0.48])
def test_an_interruption_leaves_a_good_file(tmp_path: Path, seconds: float) -> None:
    """End the recording as failed at any moment of a program's Ctrl-C, with all that it holds intact."""
    path = tmp_path / "x.mcap"
    done = run_python(_INTERRUPTED, path, seconds, code=None)
    assert done.stdout == "interrupted\n", done.stderr
    if path.exists():  # it may have come before the file was begun
        recording = verified(path)
        assert recording.status == "failed"


_INTERRUPTED_COMPILING = """
import signal, sys
import numba  # not while its calls are looked at: it has many
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.schemas.fields import body_field

def look(frame, event, argument):
    if event == "call" and frame.f_code.co_name == "_raw_object_cache_notify":
        sys.setprofile(None)
        print("compiling")
        signal.raise_signal(signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)
field = body_field("cubes", "position", "float32", tuple(map(str, range(20))))
writer = RecordingWriter(sys.argv[1], simulator="mine", version="1", scene="toss", n_env=500, dt=0.01, steps=100000,
                         fields=(field,))
sys.setprofile(look)
try:
    with writer:
        print("recording")
except KeyboardInterrupt:
    print("interrupted")
"""


def test_an_interruption_while_hashes_are_compiled(tmp_path: Path) -> None:
    """Heed a Ctrl-C that comes in a callback of the compiler, out of which no exception is raised."""
    compiles = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}  # which has nothing that was compiled before
    done = run_python(_INTERRUPTED_COMPILING, tmp_path / "x.mcap", env=compiles)
    assert done.stdout == "compiling\ninterrupted\n", done.stderr


def test_arrays_that_are_no_states_of_bodies(tmp_path: Path) -> None:
    """Log observations, rewards and flags under their names, in their own shape, one step or many at a time."""
    fields = (array_field("observation", "float64", (2, 3)), array_field("reward", "float32", unit="1"))
    seen = np.arange(5 * 4 * 2 * 3, dtype=np.float64).reshape(5, 4, 2, 3)
    reward = np.arange(20, dtype=np.float32).reshape(5, 4)
    with RecordingWriter(
        tmp_path / "a.mcap", simulator="mine", version="1", scene="task", n_env=4, dt=0.1, steps=4, fields=fields
    ) as log:
        log.append(seen[0], reward[0])
        log.append(seen[1:4], reward[1:4])
        with pytest.raises(UsageError, match="not .env, item, width. = .4, 1, 6."):
            log.append(seen[4, :3], reward[4])
        log.append(seen[4].reshape(4, 1, 6), reward[4])
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.status == "complete"
    assert np.array_equal(recording.state("env", "observation")[:].reshape(seen.shape), seen)
    assert np.array_equal(recording.state("env", "reward")[:, :, 0, 0], reward)
    described = {field.field: (field.unit, field.components, field.items) for field in recording.fields}
    assert described == {
        "observation": ("unknown", ("0_0", "0_1", "0_2", "1_0", "1_1", "1_2"), ("",)),
        "reward": ("1", ("",), ("",)),
    }
    with pytest.raises(UsageError, match="'qpos' is a state of bodies or joints"):
        array_field("qpos", "float32")
