"""gsb-record --keep failing: the last states of the environments that went wrong."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import open_recording, verify
from gpusimbench.evaluator.read.failing import ONLY_FAILING, Failing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.plan import parse_keep
from gpusimbench.recorder.run.flight_phase import watch_of
from gpusimbench.recorder.simulators.flight import AFTER, BEFORE
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, ExitCode, UsageError
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import OverflowBit
from gpusimbench.schemas.treatment import MOST_METRES, Keep
from tests.conftest import call, run_python
from tests.forging import forge
from tests.reading import verified

_RUN = ("--sim", "mujoco", "--runs", "1", "--phases", "capture")
_POISONED = (*_RUN, "--n-env", "5", "--steps", "200", "--intervene", "poison@150")
_WITHIN = 0.6
_SPREAD = (*_RUN, "--n-env", "24", "--steps", "130", "--initial", "random:3", "--seed", "11")


def _record(folder: Path, *arguments: str, exit_code: int) -> Path:
    done = call("gsb-record", *arguments, "--out", folder, code=exit_code)
    return Path(done.stdout.strip())


@pytest.fixture(scope="module")
def poisoned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Environment 1 is made not finite behind step 150: a recording of failing environments, and of all states."""
    folder = tmp_path_factory.mktemp("poisoned")
    kept = _record(folder, *_POISONED, "--keep", "failing", exit_code=1)
    return kept, _record(folder, *_POISONED, "--no-view", exit_code=1)


@pytest.fixture(scope="module")
def spread(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Cubes that fly apart: a recording of what left its bounds, and of all states."""
    folder = tmp_path_factory.mktemp("spread")
    kept = _record(folder, *_SPREAD, "--keep", f"failing,within:{_WITHIN}", exit_code=1)
    return kept, _record(folder, *_SPREAD, "--no-view", exit_code=0)


def _failing(recording: Recording) -> Failing:
    assert recording.failing is not None
    return recording.failing


def _same_as_all(kept: Recording, every: Recording) -> None:
    for failure in _failing(kept).failures:
        last = kept.last_states(failure.env)
        steps = slice(failure.first_step, failure.first_step + failure.steps)
        assert last.steps.tolist() == list(range(failure.first_step, failure.first_step + failure.steps))
        for field in kept.fields:
            rows = every.state(field.group, field.field)[steps, failure.env]
            assert last.states[field.name].tobytes() == np.ascontiguousarray(rows).tobytes()


def test_not_finite(poisoned: tuple[Path, Path]) -> None:
    """Name environment, body, field, component and step of a planted NaN, with 100 steps before it and 10 after."""
    kept, every = map(open_recording, poisoned)
    failing = _failing(kept)
    (failure,) = failing.failures
    assert (failing.counts, failing.last_step) == ((1, 0, 0), 200)
    assert (failure.env, failure.step, failure.kind) == (1, 151, "not finite")
    assert (failure.field, failure.item, failure.component) == ("ball/position", "ball", "x")
    assert math.isnan(failure.value)
    assert (failure.first_step, failure.steps) == (151 - BEFORE, BEFORE + 1 + AFTER)
    states = kept.last_states(1).states["ball/position"]
    assert np.isfinite(states[:BEFORE]).all()
    assert not np.isfinite(states[BEFORE]).any()
    assert kept.status == "invalid"
    assert kept.cause == "not finite"
    assert kept.reason.startswith(
        "1 of 5 environments failed (1 not finite); first env 1 at step 151: ball/position x of ball is not finite"
    )
    with pytest.raises(KeyError, match="it has those of: 1"):
        kept.last_states(0)


def test_clocks_begin_with_the_first_step(poisoned: tuple[Path, Path]) -> None:
    """Clock blocks of steps from the first one on, and what is written behind the last one."""
    timing = open_recording(poisoned[0]).timing
    assert (timing["capture"].first_step, timing["drain"].first_step) == (0, 200)


def test_what_is_watched() -> None:
    """Watch for overflow bits that drop contacts, for the bounds that were asked for, from environments' origins."""
    bits = (OverflowBit(0, "NEFC", fatal=True), OverflowBit(3, "NCON", fatal=True), OverflowBit(9, "SLOW", fatal=False))
    described: Any = SimpleNamespace(fields=(), env_origins=((0.0, 1.0, 2.0),), overflow_bits=bits)
    watch = watch_of(RunConfiguration("mine", "cart", 1, 0.01, 0, keep=f"failing,within:{_WITHIN}"), described)
    assert (watch.fatal, watch.within) == (0b1001, _WITHIN)
    assert np.array_equal(watch.origins, [[0.0, 1.0, 2.0]])


def test_states_are_those_of_a_full_capture(poisoned: tuple[Path, Path], spread: tuple[Path, Path]) -> None:
    """Keep, bit for bit, what a capture of all states has at these steps."""
    for kept, every in (poisoned, spread):
        _same_as_all(open_recording(kept), open_recording(every))


def test_out_of_bounds(spread: tuple[Path, Path]) -> None:
    """Keep the first 16 environments whose bodies leave the bounds, and count the others."""
    kept, every = map(open_recording, spread)
    out = np.concatenate([np.abs(every.state(g, "position")[:]) > _WITHIN for g in ("ball", "cubes")], axis=2)
    left = out.any(axis=(2, 3))
    expected = sorted((int(left[:, env].argmax()), int(env)) for env in np.flatnonzero(left.any(axis=0)))
    assert len(expected) > 16
    failing = _failing(kept)
    assert failing.counts == (0, 0, len(expected))
    assert [(f.step, f.env) for f in failing.failures] == expected[:16]
    for failure in failing.failures:
        assert failure.first_step == max(0, failure.step - BEFORE)
        assert failure.first_step + failure.steps == min(failure.step + AFTER, 130) + 1
        assert abs(failure.value) > _WITHIN
        group, field = failure.field.split("/")
        row = every.state(group, field)[failure.step, failure.env]
        described = next(f for f in every.fields if f.name == failure.field)
        place = described.items.index(failure.item), described.components.index(failure.component)
        assert row[place] == failure.value
    assert kept.cause == "out of bounds"
    assert kept.reason.startswith(f"{len(expected)} of 24 environments failed ({len(expected)} out of bounds); first")


def test_nothing_fails(tmp_path: Path) -> None:
    """Call a run complete in which nothing fails, with the hashes of a full capture at its first and last step."""
    short = (*_RUN, "--n-env", "3", "--steps", "45")
    kept = open_recording(_record(tmp_path, *short, "--keep", "failing", exit_code=0))
    every = open_recording(_record(tmp_path, *short, exit_code=0))
    assert (kept.status, _failing(kept).total, _failing(kept).failures) == ("complete", 0, ())
    hashes, whole = kept.fingerprints("capture"), every.fingerprints("capture")
    assert hashes.steps.tolist() == [0, 45]
    assert np.array_equal(hashes.hashes, whole.hashes[[0, 45]])
    assert not kept.configuration.view
    done = call("gsb-diff", kept.path, every.path)
    assert "equal bit for bit as far as compared" in done.stdout, done.stdout
    assert call("gsb-check", kept.path).returncode == 0


def test_other_commands(poisoned: tuple[Path, Path], tmp_path: Path) -> None:
    """Check, describe and evaluate such a file, and name the environment."""
    kept = poisoned[0]
    done = call("gsb-check", kept)
    assert done.stdout.startswith("PASSED: no error and no warning"), done.stdout
    done = call("gsb-info", kept, "--json", tmp_path / "info.json")
    assert ONLY_FAILING in done.stdout
    assert "151  not finite  ball  ball/position x" in done.stdout
    (file,) = json.loads((tmp_path / "info.json").read_text())["files"]
    assert [f["env"] for f in file["failing"]["failures"]] == [1]
    done = call("gsb-eval", kept, "--all", "--json", tmp_path / "eval.json", code=ExitCode.NOTHING_COMPARABLE)
    assert "151  not finite  ball  ball/position x" in done.stdout
    (group,) = json.loads((tmp_path / "eval.json").read_text())["groups"]
    assert group["keep"] == "failing"
    done = call("gsb-view", kept, "--no-open", "--out", tmp_path / "view.html", code=ExitCode.NOTHING_COMPARABLE)
    assert "holds the last states of failing environments alone (--keep failing)" in done.stderr


def _other_env(listed: Any) -> None:
    listed.failures[0].env = 5


def _other_step(listed: Any) -> None:
    listed.failures[0].step = 150


def _other_window(listed: Any) -> None:
    listed.failures[0].steps -= 1


def _other_component(listed: Any) -> None:
    listed.failures[0].component = "w"


def _none_counted(listed: Any) -> None:
    listed.not_finite = 0


def _twice(listed: Any) -> None:
    listed.failures.append(listed.failures[0])
    listed.not_finite = 2


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (_other_env, "names an environment twice, or one that is not there"),
        (_other_step, "is said to be not finite at step 150, and its states there are"),
        (_other_window, "has other states than /run/failing says"),
        (_other_component, "is said to be not finite at step 151, and its states there are"),
        (_none_counted, "counts 0 of 5 environments"),
        (_twice, "names an environment twice, or one that is not there"),
    ],
)
def test_a_forged_list(poisoned: tuple[Path, Path], tmp_path: Path, change: Callable[[Any], None], why: str) -> None:
    """Call a file damaged whose list says something else than its states, whatever its digests say."""

    def forged(topic: str, data: bytes) -> bytes:
        if topic != topics.RUN_FAILING:
            return data
        listed = message_class("gsb.v1.FailingEnvs").FromString(data)
        change(listed)
        return bytes(listed.SerializeToString())

    file = forge(poisoned[0], tmp_path / "forged.mcap", lambda _: None, message=forged)
    with pytest.raises(DamagedRecording, match=why):
        verify(open_recording(file))
    done = call("gsb-check", file, code=ExitCode.DATA_LOST)
    assert why in " ".join(done.stdout.split())
    for command in ("gsb-info", "gsb-eval"):
        assert "Traceback" not in call(command, file).stderr


_EXPIRES = '''
"""Let the time of a run end behind its 100th step."""
import signal, sys
from pathlib import Path
from types import SimpleNamespace
from gpusimbench.recorder.run.run import Run
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.provenance import Provenance

def expire(phase, done, of):
    if phase == "capture" and done > 100:
        signal.raise_signal(signal.SIGALRM)

configuration = RunConfiguration("mujoco", "inclined-collision", 2, 0.01, 1_000_000, phases=("capture",),
                                 timeout=1e6, keep="failing", intervention="poison@30")
provenance = Provenance("r", "2026-01-01T00:00:00Z", ("x",), configuration)
Run(provenance, Path(sys.argv[1]), progress=expire, log=lambda: b"").record()
'''


def test_a_run_that_ends_early(tmp_path: Path) -> None:
    """Keep what failed until a run took too long."""
    run_python(_EXPIRES, tmp_path / "x.mcap")
    kept = open_recording(tmp_path / "x.mcap")
    assert (kept.status, kept.cause) == ("failed", "timeout")
    failing = _failing(kept)
    assert [(f.env, f.step) for f in failing.failures] == [(1, 31)]
    assert failing.last_step > 100
    assert len(kept.last_states(1).steps) == 31 + AFTER + 1
    assert call("gsb-check", kept.path).stdout.startswith("PASSED")


def test_metrics_are_missing(tmp_path: Path) -> None:
    """Say of metrics of states why they are not there."""
    kept = _record(tmp_path, *_RUN, "--n-env", "2", "--steps", "500", "--keep", "failing", exit_code=0)
    call("gsb-eval", kept, "--json", tmp_path / "eval.json", code=0)
    (group,) = json.loads((tmp_path / "eval.json").read_text())["groups"]
    assert group["metrics"]["w1_parallel"]["value_missing"] == ONLY_FAILING


def test_replay(spread: tuple[Path, Path], tmp_path: Path) -> None:
    """Make such a run again from its file, with the same content."""
    done = call("gsb-record", "--replay", spread[0], "--out", tmp_path, code=1)
    assert f"keep failing,within:{_WITHIN}" in done.stderr
    again, first = open_recording(done.stdout.strip()), open_recording(spread[0])
    assert again.configuration == first.configuration
    assert again.failing == first.failing
    _same_as_all(again, open_recording(spread[1]))


@given(st.floats(0, MOST_METRES, exclude_min=True))
def test_texts(within: float) -> None:
    """Read what was written, to the last bit."""
    assert Keep.parse(str(Keep(within))) == Keep(within)
    assert Keep.parse("failing") == Keep()


_WRONG = (
    "fail", "failing,", "failing,within:", "failing,within:0", "failing,within:-1", "failing,within:nan",
    "failing,within:inf", "failing,within:1e999", "failing,within:1,within:2", "failing\n", " failing",
    "failing,within:1\u0663", "failing,within:1_0", "failing,within:--1",
)  # fmt: skip


@pytest.mark.parametrize("text", _WRONG)
def test_wrong_texts(text: str) -> None:
    """Refuse what says nothing that could be kept, in a command and in a file."""
    with pytest.raises(UsageError, match="--keep is failing or failing,within:METRES"):
        parse_keep(text)
    record = RunConfiguration("mujoco", "free-fall", 1, 0.01, 1).to_json()
    assert "keep" not in record
    with pytest.raises(DamagedRecording, match="keep has an unknown value"):
        RunConfiguration.from_json({**record, "keep": text})


@pytest.mark.parametrize(
    ("given_too", "why"),
    [
        (("--stride", "2"), "leave --stride out"),
        (("--capture", "memory"), "leave --capture memory out"),
        (("--view-env", "0"), "leave --view-env out"),
        (("--phases", "timed"), "--phases has no capture"),
        (("--intervene", "reset@3"), "--intervene poison@STEP alone"),
    ],
)
def test_refused(given_too: tuple[str, ...], why: str, tmp_path: Path) -> None:
    """Refuse what does not go together with it."""
    done = call("gsb-record", "--sim", "mujoco", "--steps", "10", "--keep", "failing", *given_too, "--out", tmp_path)
    assert done.returncode == 2
    assert why in done.stderr


def test_no_bodies(tmp_path: Path) -> None:
    """Refuse bounds for a scene without free bodies."""
    arguments = ("--sim", "mujoco", "--scene", "franka", "--keep", "failing,within:1", "--out", tmp_path)
    done = call("gsb-record", *arguments, code=2)
    assert "has no free bodies" in done.stderr


_BLOWS_UP = """<mujoco><option timestep="0.02"/><worldbody><body pos="0 0 1"><joint name="hip" axis="0 1 0"/>
<geom type="capsule" size=".02 .3" mass=".1"/><body pos="0 0 .6"><joint name="knee" axis="0 1 0"/><geom type="capsule"
size=".02 .3"/></body></body></worldbody><actuator><position joint="hip" kp="5000"/><position joint="knee" kp="90000"/>
</actuator></mujoco>"""


def _explodes(folder: Path, *arguments: object) -> tuple[str, str]:
    (folder / "robot.xml").write_text(_BLOWS_UP)
    run = ("gsb-record", "--sim", "mujoco", "--model", folder / "robot.xml", "--n-env", 2, "--runs", 1, "--steps", 60)
    done = call(*run, *arguments, code=1)
    return done.stdout.strip(), done.stderr


_SHORT = ("--warmup", 5, "--timed-steps", 60)


def test_a_robot_that_explodes(tmp_path: Path) -> None:
    """Say what finds the environment, where only the timed phase is made, so that no state is captured."""
    (advice,) = (
        line.partition("60 timed steps: ")[2].partition(" tells")[0].split()
        for line in _explodes(tmp_path, "--phases", "timed", *_SHORT, "--out", tmp_path / "timed")[1].splitlines()
        if "not finite after" in line
    )
    path, _ = _explodes(tmp_path, *advice, "--out", tmp_path / "kept")
    first, *_ = _failing(open_recording(path)).failures
    assert first.kind == "not finite" and first.item in ("hip", "knee")


def test_states_up_to_the_explosion(tmp_path: Path) -> None:
    """Capture the states of a run whose timed phase already is not finite, up to the first that is not."""
    path, said = _explodes(tmp_path, *_SHORT, "--out", tmp_path)
    recording = verified(path)
    assert (recording.status, recording.cause) == ("invalid", "not finite")
    first, *warned, again = recording.reason.split("; ")
    step = int(first.removeprefix("a state is not finite: step ").partition(",")[0])
    states = recording.state("joints", "qpos")[:]
    assert np.isfinite(states[:step]).all() and not np.isfinite(states[step]).all()
    assert f"step {step}, env 0, joints/" in said
    # MuJoCo warns in all three phases, and each warning is said once
    names = [text.rpartition("MuJoCo warning ")[2].partition(":")[0] for text in warned]
    assert names and len(set(names)) == len(names)
    assert warned[0].startswith("phase warmup: MuJoCo warning mjWARN_BADQ")
    assert again in ("the same in phases timed and capture", "the same in phase capture")
    phases = {event.phase for event in recording.events if event.kind == "GATE" and "mjWARN" in event.text}
    assert phases == {"warmup", "timed", "capture"}


def test_a_capture_shorter_than_the_way_to_the_explosion(tmp_path: Path) -> None:
    """Say how many steps reach the state that is not finite, where the capture ends before."""
    _, said = _explodes(tmp_path, "--steps", 2, *_SHORT, "--out", tmp_path)
    assert "finite up to its last step, 2: --steps 65 captures as many as were stepped before" in said
