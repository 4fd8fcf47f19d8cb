"""gsb-record as a user calls it: files, phases, provenance, and clear refusals."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from gpusimbench import open_recording
from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.recorder.capture.ranges import env_block, steps_per_block
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.recorder.run.engine import Engine
from gpusimbench.recorder.run.given_actions import given
from gpusimbench.recorder.run.timed_phase import LEAST_STEPS, _timed_again
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC
from gpusimbench.schemas.commands import SCHEMA_VERSION
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.fields import BODY_FIELDS, body_field
from tests.conftest import SMALL, Command, distribution
from tests.reading import verified

_NAME = re.compile(r"mujoco-inclined-collision-n4-r(\d)-\d{8}T\d{6}Z\.mcap")


def test_one_whole_file_a_run(small_set: list[Path]) -> None:
    """Name files by simulator, scene, environments, run and time, and leave nothing else behind."""
    matches = [_NAME.fullmatch(p.name) for p in small_set]
    assert [m and m[1] for m in matches] == ["0", "1", "2"]
    assert {p.name for p in small_set[0].parent.iterdir()} == {p.name for p in small_set}
    recordings = [open_recording(p) for p in small_set]
    assert {r.status for r in recordings} == {"complete"}
    assert len({r.provenance.run_id for r in recordings}) == 3
    assert len({r.content_hash for r in recordings}) == 3
    for recording in recordings:
        verify(recording)


def test_provenance_is_complete(small: Path) -> None:
    """Say who, what, where and with what, without naming a user or a host."""
    recording = open_recording(small)
    provenance, simulation = recording.provenance, recording.simulation
    assert provenance.argv[:3] == ("gsb-record", "--sim", "mujoco")
    assert {"cpu", "usable_threads", "memory_bytes", "kernel"} <= provenance.host.keys()
    assert {"mujoco", "numpy", "protobuf", "mcap"} <= provenance.software["packages"].keys()
    assert "version" in provenance.software["recorder"]
    assert b"mujoco==" in (recording.attachment("pip-freeze.txt") or b"")
    assert b"<mujoco" in (recording.attachment("scene.xml") or b"")
    assert recording.scene["name"] == "inclined-collision"
    assert simulation.options["integrator"] == "implicitfast"
    assert simulation.switches["precision"] == "float64"
    assert {d.parameter for d in simulation.deviations} >= {"304 steel.restitution", "smooth wood.static_friction"}
    assert recording.configuration == RunConfiguration(
        "mujoco", "inclined-collision", n_env=4, dt=0.01, steps=100, warmup=10, timed_steps=20, view=(0,)
    )


def test_provenance_comes_first(small: Path) -> None:
    """Write provenance before anything of the run, so that a crash cannot take it away."""
    head = small.read_bytes()[:20_000]
    assert head.index(b"provenance.json") < head.index(b"pip-freeze.txt")
    assert b"/run/event" not in head[: head.index(b"pip-freeze.txt")]


def test_phases_in_order(small: Path) -> None:
    """Pass through all phases, each with its begin and end, clocks and memory."""
    recording = open_recording(small)
    marks = [(e.kind, e.phase) for e in recording.events]
    phases = ("baseline", "init", "warmup", "timed", "capture")
    assert marks == [(f"PHASE_{mark}", phase) for phase in phases for mark in ("BEGIN", "END")]
    with small.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    (channel,) = [c for c in summary.channels.values() if c.topic == "/timing/timed"]
    assert channel.metadata["covers"].startswith(recording.simulation.timing_covers)
    assert "memory is sampled from another thread at 100 Hz" in channel.metadata["covers"]
    times = [e.monotonic_ns for e in recording.events]
    assert times == sorted(times)
    assert len(recording.timing["warmup"].start_ns) == 10
    begins = {"warmup": (0, 1), "timed": (10, 1), "drain": (100, 1)}
    assert {p: (t.first_step, t.steps_per_interval) for p, t in recording.timing.items() if p in begins} == begins
    assert recording.timing["capture"].first_step == 0
    timed = recording.timing["timed"]
    assert (timed.first_step, len(timed.start_ns)) == (10, 20)
    assert (timed.end_ns >= timed.start_ns).all()
    assert (timed.start_ns[1:] >= timed.end_ns[:-1]).all()
    host = recording.memory["host"]
    checkpoints = [c for c in host.checkpoint if c]
    assert checkpoints == ["baseline", "post-init", "post-warmup", "final"]
    assert (np.diff(host.time_ns) >= 0).all()
    assert (host.used_bytes > 1e6).all()


@pytest.mark.parametrize("scene", ["cube-toss", pytest.param("franka", marks=pytest.mark.slow)])
def test_short_windows_are_timed_again(gsb_record: Command, tmp_path: Path, scene: str) -> None:
    """Time the same steps again, from the same states and with the same actions, until they took a second."""
    arguments = ["--scene", scene, "--n-env", "2", "--runs", "1", "--phases", "timed", "--warmup", "10"]
    assert gsb_record("--sim", "mujoco", *arguments, "--timed-steps", "100", "--out", str(tmp_path)).returncode == 0
    (path,) = tmp_path.glob("*.mcap")
    recording = open_recording(path)
    timed = recording.timing["timed"]
    times = timed.times_of(100)
    assert times is not None and times > 1
    last = timed.windows[-1]
    earlier = replace(timed, start_ns=timed.start_ns[:last], end_ns=timed.end_ns[:last], windows=timed.windows[:-1])
    assert earlier.elapsed_s < 1 <= timed.elapsed_s
    rate = evaluate_files([path]).results[0].metrics["fps"].value
    assert rate == pytest.approx(2 * 100 * times / timed.elapsed_s)
    assert [e.phase for e in recording.events].count("timed") == 2
    hashes = recording.fingerprints("timed")
    assert hashes is not None and hashes.steps.tolist() == [10, 110]
    assert not examine(path).problems.kinds()


def test_every_window_begins_and_ends_alike() -> None:
    """Bring an engine back to its initial states, those that were given included, and to the first actions."""
    scene = make_scene("franka")
    engine = Engine(lambda: MujocoC(scene, n_env=3, dt=0.01, seed=1, options=MujocoC.Options()), "random:0.3", None)
    with engine:
        engine.start()
        begins, ends = [], []
        for _ in range(3):
            begins.append([array.copy() for array in engine.simulator.state()])
            engine.simulator.prepare(scene.actions.draw(1, n_env=3, first_step=0, n_step=20))
            engine.simulator.step(20)
            ends.append([array.copy() for array in engine.simulator.state()])
            engine.begin_again()
    for found in (begins, ends):
        assert all(np.array_equal(a, b) for other in found[1:] for a, b in zip(found[0], other, strict=True))
    assert not np.array_equal(begins[0][0], ends[0][0])


def test_windows_are_timed_after_the_warm_up() -> None:
    """Time the same steps in every further window: those behind the warm-up, with its actions and their own."""
    scene, warmup, steps = make_scene("franka"), 7, LEAST_STEPS
    configuration = RunConfiguration("mujoco", scene.name, 2, 0.01, 0, warmup=warmup, timed_steps=steps, seed=1)
    with Engine(
        lambda: MujocoC(scene, n_env=2, dt=0.01, seed=1, options=MujocoC.Options()), "random:0.3", None
    ) as engine:
        engine.start()
        ends = []
        for first, count in ((0, warmup), (warmup, steps)):
            engine.simulator.prepare(given(engine.simulator, configuration, first, count))
            engine.simulator.step(count)
        ends.append([array.copy() for array in engine.simulator.state()])
        windows = _timed_again(engine, configuration, np.array([[0], [1]]))
        for _ in range(2):
            next(windows)
            ends.append([array.copy() for array in engine.simulator.state()])
    assert all(np.array_equal(a, b) for other in ends[1:] for a, b in zip(ends[0], other, strict=True))


def test_states_from_the_initial_one_on(small: Path) -> None:
    """Record step 0 as the scene describes it, then every step."""
    recording = open_recording(small)
    cubes = recording.state("cubes", "position")
    assert cubes.shape == (101, 4, 27, 3)
    assert cubes.dtype == np.float64
    assert cubes.steps.tolist() == list(range(101))
    bodies = {b.name: b for b in make_scene("inclined-collision").bodies}
    assert np.array_equal(cubes[0, 0], [bodies[n].position for n in cubes.field.items])
    assert recording.state("ball", "orientation").shape == (101, 4, 1, 4)
    hashes = recording.fingerprints("capture")
    assert hashes.hashes.shape == (101, 4)
    timed = recording.fingerprints("timed")
    assert timed.steps.tolist() == [10, 30]
    assert np.array_equal(timed.hashes, hashes.hashes[[10, 30]]), "capturing changed the states"


def test_stride_keeps_all_fingerprints(gsb_record: Command, tmp_path: Path, small: Path) -> None:
    """Store every 20th state, hash every one, and change none of them."""
    done = gsb_record(
        "--sim", "mujoco", "--n-env", 4, "--runs", 1, *SMALL, "--stride", 20, "--compression", "zstd",
        "--phases", "capture", "--out", tmp_path, code=0,
    )  # fmt: skip
    strided, whole = open_recording(done.stdout.strip()), open_recording(small)
    verify(strided)
    cubes = strided.state("cubes", "position")
    assert cubes.steps.tolist() == [0, 20, 40, 60, 80, 100]
    assert np.array_equal(np.asarray(cubes), whole.state("cubes", "position")[::20])
    a, b = strided.fingerprints("capture"), whole.fingerprints("capture")
    assert np.array_equal(a.hashes, b.hashes)
    assert set(strided.timing) - {"stall"} == {"build", "compile_capture", "capture", "drain"}


@pytest.mark.parametrize("stride", [1, 3, 7, 50, 120, 840])
def test_strided_rows_are_the_right_ones(tmp_path: Path, stride: int) -> None:
    """Keep rows 0, stride, 2 stride... whatever the sizes of the pieces that arrive."""
    from gpusimbench.recorder.capture.sink import Sink

    fields = [body_field("cubes", name, "float32", ("a", "b")) for name in BODY_FIELDS]
    rng = np.random.default_rng(stride)
    states = [rng.standard_normal((841, 3, 2, f.width)).astype(np.float32) for f in fields]
    sink = Sink(tmp_path / "x.mcap", compression="none")
    writer = StateWriter(sink, fields, n_env=3, dt=0.01, stride=stride)
    position = 0
    while position < 841:
        size = 1 if not position else int(rng.integers(1, 60))
        writer.feed([s[position : position + size] for s in states])
        position += size
    writer.flush()
    assert writer.last_step == 840
    assert writer.last_recorded_step == 840 // stride * stride
    path = _finish(sink, fields, stride, writer.last_recorded_step)
    recording = verified(path)
    for field, expected in zip(fields, states, strict=True):
        assert np.array_equal(np.asarray(recording.state(field.group, field.field)), expected[::stride])


def _finish(sink, fields, stride, last_step):  # type: ignore[no-untyped-def]
    from gpusimbench.schemas.provenance import PROVENANCE, SIMULATION, Provenance, Simulation

    configuration = RunConfiguration("s", "free-fall", n_env=3, dt=0.01, steps=840, stride=stride)
    sink.attach(PROVENANCE, "application/json", Provenance("i", "t", (), configuration).to_json().encode())
    simulation = Simulation(
        version="1", device="cpu", options={}, switches={}, deviations=(), fields=tuple(fields), scene={}
    )
    sink.attach(SIMULATION, "application/json", simulation.to_json().encode())
    return sink.finish("COMPLETE", "", last_step=last_step, peak_rss_bytes=0)


def test_block_sizes() -> None:
    """Keep topics few and messages of a few megabytes at most, from 1 to 131072 environments."""
    fields = [body_field("cubes", "position", "float64", tuple(map(str, range(27))))]
    for n_env in (1, 16, 64, 1000, 4096, 131072):
        blocks = -(-n_env // env_block(n_env))
        assert blocks <= 64
        size = steps_per_block(n_env, fields) * min(n_env, env_block(n_env)) * 27 * 3 * 8
        assert size <= 4 << 20


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--sim", "mujoco", "--n-env", "0"), "--n-env is at least 1, not 0"),
        (("--sim", "mujoco", "--n-env", "-3"), "--n-env is at least 1"),
        (("--sim", "mujoco", "--runs", "0"), "--runs is at least 1"),
        (("--sim", "mujoco", "--steps", "0"), "--steps is at least 1"),
        (("--sim", "mujoco", "--dt", "0"), "--dt is a step in seconds"),
        (("--sim", "mujoco", "--dt", "nan"), "--dt is a step in seconds"),
        (("--sim", "mujoco", "--dt", "9e-7"), "at least 1e-06 (times are recorded in whole nanoseconds)"),
        (("--sim", "mujoco", "--dt", "1e-320"), "at least 1e-06 (times are recorded in whole nanoseconds)"),
        (("--sim", "mujoco", "--phases", "timed,timed"), "each at most once, not 'timed,timed'"),
        (("--sim", "mujoco", "--trials", "t.csv"), "--trials is for --sim real; --sim mujoco does not use this option"),
        (("--sim", "mujoco", "--unit", "cm"), "--unit is for --sim real"),
        (("--sim", "mujoco", "--allow-model"), "--allow-model is for --replay FILE; --sim mujoco does not use this"),
        (("--sim", "mujoco", "--sample-time", "5"), "--sample-time is for --sim real"),
        (("--sim", "mujoco", "--stride", "3"), "--stride 3 does not divide --steps 500"),
        (("--sim", "mujoco", "--phases", "lunch"), "--phases takes timed, capture or import"),
        (("--sim", "mujoco", "--phases", ""), "--phases takes timed, capture or import"),
        (("--sim", "mujoco", "--timed-steps", "0"), "--timed-steps is at least 1"),
        (("--sim", "mujoco", "--warmup", "-1"), "--warmup is at least 0"),
        (("--sim", "mujoco", "--scene", "moon"), "there is no scene 'moon'; known scenes: inclined-collision"),
        (("--sim", "abacus"), "there is no simulator 'abacus'; known: mujoco"),
        (("--sim", "mujoco_warp"), "did you mean 'warp'?"),
        (("--sim", "mujoco,warp"), "a call records one simulator: call it again for each of the others"),
        (("--sim", "mujoco-mjx"), "did you mean 'mjx'?"),
        (("--sim", "ovphysx"), "did you mean 'physx'?"),
        (("--sim", "gymnasium"), "its tasks are recorded as a program steps them, by gpusimbench.wrap"),
        ((), "no simulator given: use --sim NAME"),
        (("--sim", "mujoco", "--option", "cone=square"), "cone is one of elliptic, pyramidal, not 'square'"),
        (("--sim", "mujoco", "--option", "colour=red"), "has no option 'colour'; it has: integrator"),
        (("--sim", "mujoco", "--option", "iterations=many"), "option 'iterations' of simulator 'mujoco' is a int"),
        (("--sim", "mujoco", "--option", "cone"), "--option wants NAME=VALUE"),
        (
            ("--sim", "mujoco", "--option", "ls-iterations=1", "--option", "ls_iterations=2"),
            "--option ls_iterations is given twice: 1 and 2",
        ),
        (("--sim", "mujoco", "--option", "solref="), "solref is 2 finite numbers, not ''"),
        (("--sim", "mujoco", "--option", "tolerance=nan"), "tolerance is a number from 0 on, not nan"),
        (("--sim", "mujoco", "--impl", "jax"), "simulator 'mujoco' has no option 'impl'; it has: integrator"),
        (("--sim", "mujoco", "--device", "cpu"), "simulator 'mujoco' has no option 'device'"),
        (("--sim", "mujoco", "--solver", "magic"), "solver is one of Newton, CG, PGS, not 'magic'"),
        (("--sim", "mujoco", "--solver", "CG", "--solver", "PGS"), "--option solver is given twice: CG and PGS"),
        (("--sim", "mujoco", "--option", "solver=CG", "--solver", "CG"), "--option solver is given twice: CG and CG"),
        (
            ("--sim", "mujoco", "--determinism", "total"),
            "simulator 'mujoco' has no determinism level 'total'; it has: default (the engine as it ships)",
        ),
        (("--sim", "mujoco", "--timeout", "-1"), "--timeout is a number of seconds up to 1e+09, 0 for never, not -1"),
        (("--sim", "mujoco", "--timeout", "nan"), "0 for never, not nan"),
        (("--sim", "mujoco", "--timeout", "inf"), "0 for never, not inf"),
        (("--sim", "mujoco", "--sweep", "1..8", "--n-env", "4"), "--sweep and --n-env cannot be used together"),
        (("--sim", "mujoco", "--sweep", "1..8", "--runs", "0"), "--runs is at least 1"),
        (("--sim", "mujoco", "--sweep", "1-8"), "--sweep wants A..B or A..B:FACTOR"),
        (("--sim", "real", "--sweep", "1..8"), "--sweep is for a simulator; --sim real does not use this option"),
        (("--sim", "real", "--impl", "jax"), "--impl is for a simulator"),
        (("--sim", "real", "--timeout", "5"), "--timeout is for a simulator"),
    ],
)
def test_what_cannot_be_is_refused(
    gsb_record: Command, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    """Say what is wrong in one line, end with exit code 2, and write nothing."""
    done = gsb_record(*arguments, "--out", tmp_path / "out", code=2)
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not done.stdout
    assert not (tmp_path / "out").exists()


def test_an_output_that_is_a_file(gsb_record: Command, tmp_path: Path) -> None:
    """Say that the output folder cannot be written."""
    (tmp_path / "taken").write_text("")
    done = gsb_record("--sim", "mujoco", "--out", tmp_path / "taken", code=1)
    assert "cannot write to" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_nothing_is_overwritten(gsb_record: Command, tmp_path: Path) -> None:
    """Find another name for a run that starts in the same second."""
    arguments = ("--sim", "mujoco", "--n-env", 1, "--runs", 1, "--steps", 1, "--phases", "capture", "--out", tmp_path)
    for _ in range(4):
        assert gsb_record(*arguments).returncode == 0
    assert len(list(tmp_path.glob("*.mcap"))) == 4


def test_list(gsb_record: Command) -> None:
    """Show simulators and scenes, for people and for programs."""
    text = gsb_record("--list", code=0)
    assert "mujoco" in text.stdout
    assert "free-fall" in text.stdout
    assert "devices: cpu; scenes: all" in text.stdout
    assert "devices: cuda, cpu; scenes: inclined-collision, free-fall, cube-toss" in text.stdout  # of brax
    record = json.loads(gsb_record("--list", "--json").stdout)
    assert record["schema_version"] == SCHEMA_VERSION
    known = {s["name"]: s for s in record["simulators"]}
    assert {"mujoco", "real"} <= known.keys()
    assert known["mujoco"]["devices"] == ["cpu"]
    assert known["mujoco"]["precision"] == ["float64"]
    assert known["mujoco"]["scenes"] == [s["name"] for s in record["scenes"]]
    assert known["mujoco"]["determinism"] == {"default": "the engine as it ships"}
    assert "determinism levels: default, no-autotune, exclude-nondeterministic, run-to-run" in text.stdout


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ("raise RuntimeError('no licence\\nfound')", "RuntimeError: no licence found"),
        ("class Odd: pass", "odd:Odd is no Simulator with Options"),
        ("import surely_not_installed", "No module named 'surely_not_installed'"),
    ],
)
def test_a_simulator_that_cannot_be_loaded_is_listed(
    gsb_record: Command, tmp_path: Path, source: str, problem: str
) -> None:
    """List a third party's simulator whose module fails, with what is wrong, and all others as ever."""
    (tmp_path / "odd.py").write_text(source + "\n")
    distribution(tmp_path, "odd", "[gsb.simulators]\nodd = odd:Odd\n")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    text = gsb_record("--list", env=environment, code=0)
    assert "installed, but simulator 'odd' cannot be loaded: " in text.stdout
    assert problem in text.stdout
    known = {s["name"]: s for s in json.loads(gsb_record("--list", "--json", env=environment).stdout)["simulators"]}
    assert problem in known["odd"]["problem"]
    assert known["mujoco"]["problem"] == ""


def test_switches_of_common_options(gsb_record: Command, tmp_path: Path) -> None:
    """Record what --solver, --determinism and --timeout ask for, the first as the option that it is short for."""
    done = gsb_record(
        "--sim", "mujoco", "--n-env", 1, "--runs", 1, "--steps", 1, "--phases", "capture", "--solver", "CG",
        "--option", "cone=pyramidal", "--determinism", "default", "--timeout", 600, "--out", tmp_path, code=0,
    )  # fmt: skip
    recording = open_recording(done.stdout.strip())
    asked = recording.configuration
    assert (asked.options, asked.determinism, asked.timeout) == ({"cone": "pyramidal", "solver": "CG"}, "default", 600)
    assert recording.simulation.options["solver"] == "CG"


def test_a_single_run_is_no_plural(gsb_record: Command, tmp_path: Path) -> None:
    """Announce one run of one environment, and two of two."""
    for count, said in ((1, "1 env, dt 0.01 s, 1 run"), (2, "2 envs, dt 0.01 s, 2 runs")):
        done = gsb_record("--sim", "mujoco", "--n-env", count, "--runs", count, *SMALL, "--out", tmp_path)
        assert done.stderr.splitlines()[0] == f"mujoco, inclined-collision, {said}"


def test_json_result(gsb_record: Command, tmp_path: Path) -> None:
    """Print results as JSON alone on standard output."""
    done = gsb_record("--sim", "mujoco", "--n-env", 1, "--runs", 2, *SMALL, "--json", "--out", tmp_path)
    runs = json.loads(done.stdout)["runs"]
    assert [(r["run"], r["n_env"], r["status"], r["cause"]) for r in runs] == [
        (0, 1, "complete", ""), (1, 1, "complete", ""),
    ]  # fmt: skip
    assert all(Path(r["file"]).exists() for r in runs)
