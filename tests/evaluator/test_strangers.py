"""Files from strangers: whatever one of them says, it is named, and the good ones are evaluated."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.recorder.capture import state_work
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.schemas.block_parts import fingerprint_parts
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.mcap.writer import Part
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import PROVENANCE, SCENE, SIMULATION, Buffer, OverflowBit
from gpusimbench.schemas.text import SIGNS
from tests.conftest import Command
from tests.reading import verified
from tests.synthetic import Shown, cubes_field, grid, metrics_of, write_recording

_CONFIGURATION: list[tuple[str, Any]] = [
    ("dt", "Infinity"), ("dt", "NaN"), ("dt", 10**400), ("dt", 0), ("dt", "0.01"), ("stride", 0), ("stride", True),
    ("n_env", 10**30), ("n_env", 2**34), ("n_env", True), ("n_env", -1), ("n_env", 0), ("timed_steps", 0),
    ("timed_steps", "1000"), ("seed", [1]), ("seed", -(2**63) - 1), ("seed", 2**64 + 1), ("steps", 2.5),
    ("warmup", [1]), ("scene", ["x"]), ("simulator", {"a": 1}),
    ("options", {"cone": 3}), ("phases", "timed"), ("phases", ["timed", "tea"]), ("run_index", None),
]  # fmt: skip


def _forge(attachment: str, path: tuple[str | int, ...], value: Any):  # type: ignore[no-untyped-def]
    def change(name: str, record: dict[str, Any]) -> str | None:
        if name != attachment:
            return None
        place: Any = record
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
        # Python's own NaN and Infinity, which are not JSON, are written without their quotes
        return json.dumps(record).replace('"Infinity"', "Infinity").replace('"NaN"', "NaN")

    return change


def _raw(topic: str, kind: str, *contents: dict[str, Any] | bytes) -> dict[str, Any]:
    make = message_class(f"gsb.v1.{kind}")
    messages = (c if isinstance(c, bytes) else make(**c) for c in contents)
    return {"shown": Shown(raw=tuple((topic, f"gsb.v1.{kind}", message) for message in messages))}


def _counts(**changed: Any) -> dict[str, Any]:
    good = {"first_step": 1, "stride": 1, "mean": [1.0, 2.0], "p95": [2.0, 3.0], "max": [3.0, 3.0]}
    return _raw("/count/capture/contacts", "StepCounts", {**good, **changed})


def _overflow(**changed: Any) -> dict[str, Any]:
    return _raw(
        "/overflow/capture", "Overflow", {"first_step": 1, "stride": 1, "bits": [0, 1], "envs": [0, 2]} | changed
    )


def _stream(**changed: Any) -> dict[str, Any]:
    return _raw("/action_stream/capture", "ActionStream", {"generator": "{}", "steps": 5, "envs": 2} | changed)


_HUGE = 2**64 - 1

_EVIDENCE: dict[str, dict[str, Any]] = {
    "counts lengths": _counts(mean=[1.0]),
    "counts not finite": _counts(mean=[1.0, float("nan")]),
    "counts infinite": _counts(max=[3.0, float("inf")]),
    "counts negative": _counts(p95=[2.0, -1.0]),
    "counts huge": _counts(mean=[1e300] * 2, p95=[1e300] * 2, max=[1e300] * 2),
    "counts mean above max": _counts(mean=[1.0, 4.0]),
    "counts percentile above max": _counts(p95=[4.0, 3.0]),
    "counts no stride": _counts(stride=0),
    "counts first step": _counts(first_step=_HUGE),
    "counts stride": _counts(first_step=2**40 - 1, stride=2**32 - 1),
    "counts repeated": _raw(
        "/count/capture/contacts", "StepCounts",
        *[{"first_step": 1, "stride": 1, "mean": [1.0], "p95": [1.0], "max": [1.0]}] * 2,
    ),
    "counts no message": _raw("/count/capture/contacts", "StepCounts", b"\xff\xff\xff"),
    "overflow lengths": _overflow(envs=[0]),
    "overflow no stride": _overflow(stride=0),
    "overflow more envs": _overflow(envs=[0, 3]),
    "overflow huge envs": _overflow(envs=[0, 2**32 - 1]),
    "overflow bits of no env": _overflow(envs=[0, 0]),
    "overflow envs of no bit": _overflow(envs=[1, 2]),
    "overflow first step": _overflow(first_step=_HUGE),
    "overflow no message": _raw("/overflow/capture", "Overflow", b"\x0a"),
    "stream envs": _stream(envs=3),
    "stream steps": _stream(steps=_HUGE),
    "stream digest": _stream(first_sha256="<script>"),
    "stream twice": _raw("/action_stream/capture", "ActionStream", *[{"envs": 2}] * 2),
    "buffer asked": {"change": lambda name, r: r.update(buffers=[{"name": "b", "asked": -1, "per": "env"}])
                     if name == SIMULATION else None},
    "buffer huge": {"change": lambda name, r: r.update(buffers=[{"name": "b", "asked": 10**40, "per": "env"}])
                    if name == SIMULATION else None},
    "overflow bit": {"change": lambda name, r: r.update(overflow_bits=[{"bit": 32, "name": "b"}])
                     if name == SIMULATION else None},
    "counters": {"change": lambda name, r: r.update(counters=[{"name": 3}]) if name == SIMULATION else None},
    "allocator": _raw("/memory/gpu0/allocator", "MemorySample", {"used_bytes": _HUGE}),
    "build clock": _raw("/timing/build", "StepTiming", {"start_ns": [5], "end_ns": [4]}),
    "floor": {"change": _forge(SCENE, ("bodies", 0, "position"), [0, 0])},
    "floor turned": {"change": _forge(SCENE, ("bodies", 0, "orientation"), ["up"])},
}  # fmt: skip

FORGERIES: dict[str, dict[str, Any]] = {
    **{
        f"configuration {key}={str(value)[:12]}": {"change": _forge(PROVENANCE, ("configuration", key), value)}
        for key, value in _CONFIGURATION
    },
    "run_id": {"change": _forge(PROVENANCE, ("run_id",), 7)},
    "environment": {"change": _forge(PROVENANCE, ("environment",), {"XLA_FLAGS": 1})},
    "provenance nested": {"change": lambda name, _: "[" * 200_000 if name == PROVENANCE else None},
    "scene nested": {"change": lambda name, _: "{" + '"a":{' * 100_000 if name == SCENE else None},
    "dtype": {"change": _forge(SIMULATION, ("fields", 0, "dtype"), "S99999999")},
    "other dtype": {"change": _forge(SIMULATION, ("fields", 0, "dtype"), "float32")},
    "items": {"change": _forge(SIMULATION, ("fields", 0, "items"), ["a"] * 26)},
    "unit": {"change": _forge(SIMULATION, ("fields", 0, "unit"), "cm")},
    "components": {"change": _forge(SIMULATION, ("fields", 0, "components"), ["z", "y", "x"])},
    "origins count": {"change": _forge(SIMULATION, ("env_origins",), [[0, 0, 0]])},
    "origins ragged": {"change": _forge(SIMULATION, ("env_origins",), [[0, 0], [0, 0, 0]])},
    "bodies": {"change": _forge(SCENE, ("bodies",), 5)},
    "bodies list": {"change": _forge(SCENE, ("bodies",), [5])},
    "board size": {"change": _forge(SCENE, ("bodies", 0, "shape"), {"size": [1, 2]})},
    "board name": {"change": _forge(SCENE, ("board",), "table")},
    "clock": {"elapsed_s": -1.0},
    **_EVIDENCE,
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_a_forged_file_is_named_and_the_rest_evaluated(forgery: str, tmp_path: Path) -> None:
    """Set the forged file aside with one clear message; the good one gets its numbers, the exit code is 3."""
    from gpusimbench.evaluator.cli.eval import main

    good = write_recording(tmp_path, grid(2), simulator="good")
    bad = write_recording(tmp_path, grid(2), simulator="bad", name="bad.mcap", **FORGERIES[forgery])
    target = tmp_path / "out.json"
    assert main([str(good), str(bad), "--json", str(target)]) == 3
    document = json.loads(target.read_text())
    assert [g["simulator"] for g in document["groups"]] == ["good"]
    assert document["groups"][0]["metrics"]["w1_parallel"]["value"] == 0
    (unreadable,) = (r for r in document["recordings"] if r["status"] == "unreadable")
    assert "bad.mcap" in unreadable["reason"]


def test_hashes_that_are_not_of_the_states(gsb_eval: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse hashes that call different environments equal, also where the digests are taken on trust."""
    monkeypatch.setattr(state_work, "fingerprint", lambda arrays: np.zeros(arrays[0].shape[:-2], dtype=np.uint64))
    final = grid(3)
    final[1] += 0.1
    path = write_recording(tmp_path, final)
    done = gsb_eval(path, code=3)
    assert "state hashes at step 0 are not those of the states" in done.stderr
    done = gsb_eval(path, "--no-verify", code=3)
    assert "the state hashes are equal, but the positions at the sample step are not" in done.stderr


def test_hashes_may_be_split_by_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assemble hashes by step and environment, in whatever blocks they come."""

    def split(hashes: Any, *, first_step: int) -> list[tuple[Part, ...]]:
        return [
            fingerprint_parts(hashes[:, start : start + 2], first_step=first_step, stride=1, env_start=start)
            for start in (0, 2)
        ]

    final = grid(3)
    final[2] += 0.1
    whole = open_recording(write_recording(tmp_path, final)).fingerprints("capture")
    monkeypatch.setattr(state_work, "hash_messages", split)
    recording = verified(write_recording(tmp_path, final))
    parts = recording.fingerprints("capture")
    assert np.array_equal(parts.hashes, whole.hashes)
    assert np.array_equal(parts.steps, whole.steps)


@pytest.mark.parametrize("shape", [(1, 0), (1, 7), (0, 3)])
def test_hashes_of_the_wrong_shape(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int]) -> None:
    """Refuse hashes of more or fewer environments than there are."""
    wrong = np.zeros(shape, dtype=np.uint64)
    monkeypatch.setattr(
        state_work, "hash_messages", lambda hashes, **_: [fingerprint_parts(wrong, first_step=0, stride=1)]
    )
    recording = open_recording(write_recording(tmp_path, grid(3)))
    with pytest.raises(DamagedRecording):
        verify(recording)


def test_overlapping_topics_expose_no_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse a second topic for the same environments instead of counting it for the missing ones."""
    from gpusimbench.schemas import topics

    monkeypatch.setattr(topics, "state", lambda group, field, start: f"/state/{group}/{field}/{start}")
    path = write_recording(tmp_path, grid(2))
    monkeypatch.undo()
    with pytest.raises(DamagedRecording, match="no name that the format gives"):
        np.asarray(open_recording(path).state("cubes", "position"))


def test_two_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse a run that ends twice, in whatever order."""
    finish = Sink.finish

    def twice(self: Sink, status: str, reason: str, **keywords: Any) -> Path:
        end = message_class("gsb.v1.RunEnd")(status=2, reason="the first end")
        self.channel("/run/end", "gsb.v1.RunEnd")
        self.write("/run/end", end.SerializeToString())
        return finish(self, status, reason, **keywords)

    monkeypatch.setattr(Sink, "finish", twice)
    path = write_recording(tmp_path, grid(1))
    with pytest.raises(DamagedRecording, match="ends 2 times"):
        open_recording(path)


def test_two_attachments_of_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse a file in which two tools would read different provenance."""
    attach = Sink.attach

    def twice(self: Sink, name: str, media_type: str, data: bytes) -> None:
        attach(self, name, media_type, data)
        if name == PROVENANCE:
            attach(self, name, media_type, data.replace(b"synthetic", b"different"))

    monkeypatch.setattr(Sink, "attach", twice)
    path = write_recording(tmp_path, grid(1))
    with pytest.raises(DamagedRecording, match="there twice"):
        open_recording(path)


def test_one_run_id_and_two_contents(gsb_eval: Command, tmp_path: Path) -> None:
    """Name a file that claims to be a run that is here already with another content."""
    write_recording(tmp_path, grid(2), run_id="the same", name="a.mcap")
    write_recording(tmp_path, grid(2) + 0.1, run_id="the same", name="b.mcap")
    done = gsb_eval(tmp_path / "a.mcap", tmp_path / "b.mcap", code=3)
    assert "has the run id of a.mcap and another content" in done.stderr


def test_a_pipe_is_no_file(gsb_eval: Command, tmp_path: Path) -> None:
    """Refuse a pipe instead of waiting for its writer."""
    os.mkfifo(tmp_path / "pipe.mcap")
    done = gsb_eval(tmp_path / "pipe.mcap", timeout=300, code=3)
    assert "is not a file" in done.stderr


@pytest.mark.parametrize(("encoding", "redirect"), [("ascii", False), ("utf-8", True)])
def test_poor_outputs(gsb_eval: Command, small: Path, encoding: str, redirect: bool) -> None:
    """Print what a poor terminal can show, and say in one line that a disk is full."""
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    if redirect:
        with Path("/dev/full").open("w") as full:
            done = gsb_eval(small, "--sample-time", 1, env=environment, capture_output=False, stdout=full, stderr=-1)
        assert done.returncode == 1
        assert "cannot write the results: No space left" in done.stderr
    else:
        done = gsb_eval(small, "--sample-time", 1, env=environment, encoding=encoding, code=0)
    assert "Traceback" not in done.stderr


def test_signs_that_an_encoding_lacks_keep_their_meaning(gsb_eval: Command) -> None:
    """Print a spread as a spread where there is no plus-minus sign, and no question mark in a number."""
    runs = sorted((Path(__file__).resolve().parents[2] / "recordings").glob("mujoco-amd-r*.mcap"))
    done = gsb_eval(*runs, env={**os.environ, "PYTHONIOENCODING": "ascii"}, encoding="ascii", code=0)
    assert "11,889 +- 906" in done.stdout
    assert "?" not in done.stdout


def test_marks_of_footnotes_in_ascii() -> None:
    """Print which footnote a row has, and what a file is called, and not a question mark."""
    assert "run-é ± 1".encode("ascii", SIGNS) == rb"run-\xe9 +- 1"
    assert "mjx ¹, warp ¹⁰, R² “a”".encode("ascii", SIGNS) == b'mjx ^1, warp ^1^0, R^2 "a"'


def test_env_local_positions_are_not_shifted_again(gsb_eval: Command, tmp_path: Path) -> None:
    """Leave coordinates alone that are declared relative to the env's origin."""
    origins = ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0))
    field: StateField = cubes_field("float64", frame="env")
    found = metrics_of(gsb_eval(write_recording(tmp_path, grid(2), origins=origins, field=field), "--json", "-").stdout)
    assert found["w1_parallel"]["value"] == 0
    assert found["left_board"]["value"] == 0


def test_environment_variables_separate_groups(gsb_eval: Command, tmp_path: Path) -> None:
    """Never call a difference between flags a difference between runs."""
    for run, flags in enumerate(("", "--xla_gpu_deterministic_ops=true")):
        write_recording(tmp_path, grid(2) + run, run=run, environment={"XLA_FLAGS": flags})
    done = gsb_eval(*tmp_path.glob("*.mcap"), "--json", "-")
    groups = json.loads(done.stdout)["groups"]
    assert [g["n_run"] for g in groups] == [1, 1]
    assert any("XLA_FLAGS=--xla_gpu_deterministic_ops=true" in g["label"] for g in groups)


def test_groups_far_apart_and_exploded(gsb_eval: Command, tmp_path: Path) -> None:
    """Evaluate groups that lie 10 m apart, and give a reason for one that blew up."""
    write_recording(tmp_path, grid(2), simulator="here")
    write_recording(tmp_path, grid(2) + [10.0, 0, 0], simulator="there")
    wild = grid(2)
    wild[0, 0] = 1e200
    write_recording(tmp_path, wild, simulator="wild")
    gsb_eval(*tmp_path.glob("*.mcap"), "--html", tmp_path / "report", "--json", tmp_path / "r.json", code=0)
    groups = {g["simulator"]: g["metrics"] for g in json.loads((tmp_path / "r.json").read_text())["groups"]}
    assert groups["here"]["w1_parallel"]["value"] == groups["there"]["w1_parallel"]["value"] == 0
    assert "blew up" in groups["wild"]["w1_parallel"]["value_missing"]
    assert "off the map" in (tmp_path / "report" / "index.html").read_text()


def test_trials_measured_at_another_time(gsb_record: Command, gsb_eval: Command, tmp_path: Path) -> None:
    """Refuse to compare positions at 4 s with trials measured at 5 s."""
    rows = [f"1,{c},{0.1 + 0.01 * c},0" for c in range(27)]
    (tmp_path / "t.csv").write_text("\n".join(["trial,cube,x,y", *rows]))
    made = gsb_record("--sim", "real", "--trials", tmp_path / "t.csv", "--unit", "m", "--out", tmp_path)
    simulated = write_recording(tmp_path, grid(1))
    document = metrics_of(gsb_eval(simulated, made.stdout.strip(), "--sample-time", 4, "--json", "-").stdout)
    assert "measured at 5 s, not at 4 s" in document["w1_real"]["value_missing"]
    alone = gsb_eval(made.stdout.strip(), code=5)
    assert "only real trials" in alone.stderr


def test_the_sampled_time_is_said(gsb_eval: Command, tmp_path: Path) -> None:
    """Say which step was sampled where the asked time falls between two."""
    path = write_recording(tmp_path, grid(2), dt=0.3, steps=20)
    assert "positions are those at 5.1 s, the step nearest to 5 s" in gsb_eval(path).stdout


def test_many_points_that_few_moved_of(gsb_eval: Command, tmp_path: Path) -> None:
    """Solve what moved alone, where runs of 21,600 points share all others."""
    one = grid(800)
    two = one.copy()
    two[0] += 0.01
    files = [write_recording(tmp_path, final, run=r) for r, final in enumerate((one, two))]
    found = metrics_of(gsb_eval(*files, "--json", "-").stdout)
    assert found["w1_run_to_run"]["value"] == pytest.approx(2**0.5 / 800)
    assert found["w1_run_to_run"]["exactness"] == "exact"
    assert "too many for a permutation" in found["w1_run_to_run"]["extra"]["permutation_test"]["w1_missing"]


def test_identical_runs_claim_no_interval(gsb_eval: Command, tmp_path: Path) -> None:
    """Print no interval of width zero: four equal runs do not exclude a rare difference."""
    files = [write_recording(tmp_path, grid(2), run=r) for r in range(4)]
    found = metrics_of(gsb_eval(*files, "--json", "-").stdout)
    for name in ("w1_parallel", "w1_run_to_run"):
        assert found[name]["ci95"] is None
        assert found[name]["ci95_missing"] == "no spread in 4 runs"


def test_a_recording_that_grows_while_it_is_read(tmp_path: Path) -> None:
    """Read a file that another process is writing as incomplete, again and again, without an error."""
    from gpusimbench.recorder.capture.states import StateWriter

    path = write_recording(tmp_path, grid(2), end=False)
    assert open_recording(path).status == "incomplete"
    stop = threading.Event()

    def grow() -> None:
        sink = Sink(tmp_path / "growing.mcap", compression="none")
        writer = StateWriter(sink, (cubes_field("float64"),), n_env=2, dt=0.01, stride=1)
        while not stop.is_set():
            writer.feed([np.zeros((2, 2, 27, 3))])
            stop.wait(0.002)  # slowly, because each look reads all that is there
        sink.abandon()

    thread = threading.Thread(target=grow)
    thread.start()
    try:
        for _ in range(50):
            try:
                open_recording(tmp_path / "growing.mcap.partial")
            except DamagedRecording as error:
                assert "cut short before its provenance" in str(error)
            except Exception as error:
                assert "No such file" in str(error) or "not an MCAP" in str(error)
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize(
    "forgery", [name for name in _EVIDENCE if name.startswith(("counts ", "overflow e", "stream"))]
)
def test_forged_evidence_of_a_run_that_failed(forgery: str, tmp_path: Path) -> None:
    """Set a damaged file aside also where no value is computed from it."""
    from gpusimbench.evaluator.results.evaluate import evaluate_files

    path = write_recording(tmp_path, grid(2), status="FAILED", reason="gone", **_EVIDENCE[forgery])
    evaluation = evaluate_files([path])
    assert (len(evaluation.results), len(evaluation.unreadable)) == (0, 1)


def test_strange_names_of_counters_and_buffers(tmp_path: Path) -> None:
    """Show counters, buffers and phases that nobody foresaw, as text."""
    from gpusimbench.evaluator.report.document import render_html
    from gpusimbench.evaluator.results.evaluate import evaluate_files

    evil = "<script>alert(1)</script>\x1b[2J"
    buffers = (Buffer(evil, 2**63, evil, "contacts", evil), Buffer("zero", 0, "env", "contacts"))
    shown = Shown(
        counts={"capture": {"contacts": np.ones((5, 2), dtype=int)}, "tea": {"biscuits": np.ones((5, 2), dtype=int)}},
        overflow={"tea": np.full((5, 2), 2, dtype=np.uint32)},
        bits=(OverflowBit(1, evil, fatal=False),),
        buffers=buffers,
    )
    path = write_recording(tmp_path, grid(2), shown=shown)
    (result,) = (evaluation := evaluate_files([path])).results
    assert [u.share for u in result.validity.buffers] == [pytest.approx(2 / 2**63), None]
    page = render_html(evaluation, published=False, command="")
    assert "<script>alert" not in page
    assert "\x1b" not in page
    assert "biscuits" not in {c.name for c in result.validity.counted if c.phase in ("capture", "timed")}


def test_clocks_without_a_tick(tmp_path: Path) -> None:
    """Accept a compilation that took no time: some engines compile nothing."""
    found = open_recording(write_recording(tmp_path, grid(1), clocks={"compile_timed": 0.0})).timing
    assert found["compile_timed"].elapsed_s == 0
