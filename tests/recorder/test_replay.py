"""A recording's own configuration, run again: taken with the same checks as arguments, refused where it is not safe."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.sets.replay import read_source, replayed
from gpusimbench.schemas import topics
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.fields import body_field
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import PROVENANCE, SCENE, SIMULATION
from tests.conftest import Command, call
from tests.forging import forge
from tests.reading import verified
from tests.synthetic import Shown, write_recording

_SHORT = ("--n-env", "2", "--runs", "1", "--steps", "6", "--warmup", "3", "--timed-steps", "4")


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two environments of MuJoCo C, six captured steps, an option that is not the default."""
    folder = tmp_path_factory.mktemp("original")
    done = call("gsb-record", "--sim", "mujoco", *_SHORT, "--option", "cone=pyramidal", "--seed", "7", "--out", folder)
    assert done.returncode == 0, done.stderr
    return next(folder.glob("*.mcap"))


def _states(path: Path) -> list[bytes]:
    recording = open_recording(path)
    return [np.asarray(recording.state(f.group, f.field)).tobytes() for f in recording.fields]


def test_a_replay_runs_what_was_recorded(original: Path, gsb_record: Command, tmp_path: Path) -> None:
    """Make the same run again: the same configuration and bits, under another id, with its origin named."""
    done = gsb_record("--replay", original, "--runs", "2", "--out", tmp_path, code=0)
    there = open_recording(original)
    first, *_ = done.stderr.splitlines()
    assert f"replay of run {there.provenance.run_id[:8]}, content {there.content_hash[:12]}: mujoco, cone=" in first
    assert "2 envs, dt 0.01 s, seed 7, 3 + 4 timed steps and 6 captured steps; a run took" in first
    for index, path in enumerate(map(Path, done.stdout.split())):
        here = verified(path)
        assert here.configuration.to_json() == {**there.configuration.to_json(), "run_index": index}
        assert here.provenance.run_id != there.provenance.run_id
        of = here.provenance.replay_of
        assert (of.run_id, of.content_hash, of.changed) == (there.provenance.run_id, there.content_hash, {})
        assert _states(path) == _states(original)
    assert there.provenance.replay_of is None


def test_what_the_user_changes_is_recorded(original: Path, gsb_record: Command, tmp_path: Path) -> None:
    """Replace an option and leave a phase out: the new recording says what was otherwise there."""
    changes = ("--option", "cone=elliptic", "--solver", "CG", "--phases", "capture")
    done = gsb_record("--replay", original, *changes, "--out", tmp_path, "--json", code=0)
    here = open_recording(json.loads(done.stdout)["runs"][0]["file"])
    assert here.configuration.options == {"cone": "elliptic", "solver": "CG"}
    assert here.configuration.phases == ("capture",)
    assert here.provenance.replay_of.changed == {
        "options.cone": "pyramidal", "options.solver": "", "phases": "timed,capture"
    }  # fmt: skip
    assert _states(here.path) != _states(original)


@pytest.mark.parametrize(
    "given",
    [
        ("--sim", "mujoco"), ("--scene", "franka"), ("--n-env", "3"), ("--sweep", "1..4"), ("--dt", "0.01"),
        ("--seed", "0"), ("--determinism", "default"), ("--steps", "6"), ("--stride", "1"), ("--warmup", "3"),
        ("--timed-steps", "4"), ("--trials", "x.csv"), ("--unit", "m"), ("--sample-time", "1"), ("--list",),
        ("--setup", "genesis"),
    ],
    ids=lambda given: given[0],
)  # fmt: skip
def test_arguments_that_contradict_are_refused(
    original: Path, given: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Refuse whatever the recording says already, by name."""
    from gpusimbench.recorder.cli import main

    assert main(["--replay", str(original), *given]) == 2
    said = capsys.readouterr().err
    assert given[0] in said
    assert "--replay" in said


def _set(*keys: str, to: Any) -> Callable[[dict[str, Any]], None]:
    def change(document: dict[str, Any]) -> None:
        at = document["configuration"]
        for key in keys[:-1]:
            at = at[key]
        at[keys[-1]] = to

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_set("simulator", to="../../evil"), "there is no simulator '../../evil'"),
        (_set("simulator", to="os:system"), "there is no simulator 'os:system'"),
        (_set("simulator", to="a\x1b[2Jb"), "there is no simulator 'a\\x1b[2Jb'"),
        (_set("scene", to="/etc/passwd"), "there is no scene '/etc/passwd'"),
        (_set("scene", to="free-fall"), "scene 'free-fall' is another one here"),
        (_set("n_env", to=1 << 20), "traces of"),
        (_set("n_env", to=3), "traces of"),
        (_set("steps", to=10**12), "and 1000000000000 captured steps, and has traces of 6 captured steps"),
        (_set("warmup", to=10**12), "warmup steps"),
        (_set("timed_steps", to=10**12), "timed steps"),
        (_set("timed_steps", to=5), "asks for 2 environments and 5 timed steps, and has traces of 4"),
        (_set("stride", to=5), "does not divide"),
        (_set("dt", to=1e-9), "--dt is a step"),
        (_set("phases", to=[]), "--phases takes"),
        (_set("phases", to=["capture", "capture"]), "--phases takes"),
        (_set("options", to={"xml": "/tmp/model.xml"}), "has no option 'xml'; it has: integrator"),
        (_set("options", to={"iterations": "9" * 5000}), "option 'iterations'"),
        (_set("options", to={"module": "antigravity"}), "names code to be loaded; that is never taken from a file"),
        (_set("determinism", to="anything"), "has no determinism level 'anything'"),
    ],
)  # fmt: skip
def test_hostile_configurations_are_refused(
    original: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Any, said: str
) -> None:
    """Run nothing of a forged file whose configuration no user could ask for, or whose run shows less than it asks."""
    from gpusimbench.recorder.cli import main

    forged = forge(original, tmp_path / "forged.mcap", change)
    assert main(["--replay", str(forged), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "forged.mcap" in error
    assert "\x1b" not in error
    assert len(error) < 2000
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "change",
    [_set("n_env", to=-1), _set("n_env", to=2**80), _set("options", to=[]), _set("seed", to="x"), _set("dt", to=None)],
)
def test_impossible_configurations_are_damage(
    original: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Any
) -> None:
    """Call a file damaged whose configuration is of the wrong kind."""
    from gpusimbench.recorder.cli import main

    assert main(["--replay", str(forge(original, tmp_path / "forged.mcap", change))]) == 3
    assert "forged.mcap: provenance.json: " in capsys.readouterr().err


def test_a_changed_attachment_is_damage(original: Path, tmp_path: Path) -> None:
    """Refuse a configuration that is not the one that the end record's digests are of."""
    forged = forge(original, tmp_path / "forged.mcap", _set("seed", to=8), honest=False)
    with pytest.raises(DamagedRecording, match=r"provenance.json was changed since the recording was made"):
        read_source(forged)


def test_a_scene_that_is_another_one_here(original: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse a scene of the same name with other contents, and one that the simulator was not given."""
    from gpusimbench.recorder.cli import main

    def heavier(scene: dict[str, Any]) -> None:
        scene["gravity"] = [0.0, 0.0, -1.62]

    forged = forge(original, tmp_path / "forged.mcap", heavier, attachment=SCENE)
    assert main(["--replay", str(forged)]) == 3
    assert "its scene is not the one that its simulator was given" in capsys.readouterr().err

    scene = json.loads(open_recording(original).attachment(SCENE) or b"")
    heavier(scene)
    digest = hashlib.sha256(json.dumps(scene).encode()).hexdigest()
    both = forge(forged, tmp_path / "both.mcap", lambda s: s["scene"].update(sha256=digest), attachment=SIMULATION)
    assert main(["--replay", str(both)]) == 2
    assert "scene 'inclined-collision' is another one here" in capsys.readouterr().err


def test_trials_are_not_replayed(gsb_record: Command, tmp_path: Path) -> None:
    """Say that measured trials have no simulator."""
    cubes = len(make_scene("inclined-collision").groups()["cubes"])
    rows = "".join(f"1,{cube},0.1,{cube / 100}\n" for cube in range(cubes))
    (tmp_path / "trials.csv").write_text("trial,cube,x,y\n" + rows)
    made = gsb_record("--sim", "real", "--trials", tmp_path / "trials.csv", "--unit", "m", "--out", tmp_path, code=0)
    with pytest.raises(UsageError, match="measured trials: no simulator can replay them"):
        read_source(Path(made.stdout.strip()))


def test_logged_recordings_are_not_replayed(tmp_path: Path) -> None:
    """Refuse what a program logged itself, also under the name of a simulator that is there."""
    field = body_field("cubes", "position", "float32", ("a",))
    with RecordingWriter(
        tmp_path / "mine.mcap", simulator="mujoco", version="1", scene=make_scene("free-fall"), n_env=1, dt=0.01,
        steps=2, fields=(field,),
    ) as log:  # fmt: skip
        log.append(np.zeros((3, 1, 1, 3), dtype=np.float32))
    with pytest.raises(UsageError, match="a program logged it"):
        read_source(tmp_path / "mine.mcap")


def test_runs_that_failed_are_not_replayed(original: Path, tmp_path: Path, gsb_record: Command) -> None:
    """Refuse a run without an end and a failed one: neither shows a run that can be compared."""
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(original.read_bytes()[:-500])
    with pytest.raises(DamagedRecording, match="incomplete"):
        read_source(cut)
    # the time is over long before the steps are
    endless = ("--n-env", "2", "--runs", "1", "--steps", "1000000", "--phases", "capture", "--timeout", "0.5")
    made = gsb_record("--sim", "mujoco", "--scene", "free-fall", *endless, "--out", tmp_path, code=1)
    with pytest.raises(UsageError, match="its run failed, so that it shows no whole run: timeout"):
        read_source(Path(made.stdout.strip()))


def test_limits_of_the_recorded_run_are_not_taken_over(original: Path) -> None:
    """Take neither time limit nor compression from a file, and no phase that it has not."""
    source = read_source(original)
    made = replayed(source, options={}, phases=("capture",), timeout=3.0, compression="lz4")
    assert (made.timeout, made.compression, made.phases) == (3.0, "lz4", ("capture",))
    with pytest.raises(UsageError, match="has only timed,capture"):
        replayed(source, options={}, phases=("warmup",), timeout=0, compression="none")


def _bomb(folder: Path, *, n_env: int, intervals: int, length: int, hash_of: int) -> Path:
    """A recording of a timed phase whose traces compress to next to nothing: a million environments, 1e8 steps."""
    hashes = message_class("gsb.v1.FingerprintBlock")(first_step=0, stride=10**8, steps=2, env_start=0, envs=n_env)
    hashes.hashes.extend([hash_of] * (2 * n_env))
    begin = [i * length for i in range(intervals)]
    clocks = message_class("gsb.v1.StepTiming")(
        first_step=0, steps_per_interval=1000, start_ns=begin, end_ns=[at + length for at in begin]
    )

    def timed(name: str, document: dict[str, Any]) -> str | None:
        if name == PROVENANCE:
            document["configuration"]["phases"] = ["timed"]
        return make_scene("inclined-collision").to_json() if name == SCENE else None

    return write_recording(
        folder, None, n_env=n_env, simulator="mujoco", timed_steps=1000 * intervals, elapsed_s=None,
        compression="zstd", change=timed,
        shown=Shown(raw=(
            (topics.timing("timed"), "gsb.v1.StepTiming", clocks),
            (topics.fingerprint("timed"), "gsb.v1.FingerprintBlock", hashes),
        )),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("n_env", "intervals", "length", "said"),
    [
        (2, 1000, 0, "asks for 2 environments and 1000000 timed steps, and has traces of 0 timed steps"),
        (1 << 20, 2, 1000, "asks for 1048576 environments, and its "),
        (2, 100_000, 1, "asks for 100000000 steps, and its "),
    ],
    ids=["no-time", "environments", "steps"],
)
def test_compressed_nothing_asks_for_no_work(
    tmp_path: Path, n_env: int, intervals: int, length: int, said: str
) -> None:
    """Refuse traces that take no time, and more of them than the bytes of the file can be believed to hold."""
    bomb = _bomb(tmp_path, n_env=n_env, intervals=intervals, length=length, hash_of=0)
    assert bomb.stat().st_size < 1_000_000
    with pytest.raises(UsageError, match=re.escape(said)):
        read_source(bomb)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_pipe_is_no_recording(tmp_path: Path) -> None:
    """Refuse a pipe instead of waiting for its writer."""
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(Exception, match="not a file"):
        read_source(tmp_path / "pipe.mcap")
