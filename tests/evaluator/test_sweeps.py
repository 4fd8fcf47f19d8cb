"""Sweeps: what belongs to one, how far it goes, what its memory costs, and where it is shown."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.metrics.radar import Axis
from gpusimbench.evaluator.missing import why_missing
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.brief import brief
from gpusimbench.evaluator.report.document import render_html
from gpusimbench.evaluator.report.sections.overview import asked_of
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.sweeps import Sweep
from tests.conftest import Command
from tests.pages import part, print_all, rows_of, tables_of
from tests.synthetic import grid, write_recording, write_sweep

SIZES = (1, 4, 16, 64, 256)


def evaluated(folder: Path) -> Evaluation:
    """All recordings of a folder."""
    return evaluate_files(sorted(folder.glob("*.mcap")))


def only(folder: Path) -> Sweep:
    """The only sweep of a folder."""
    (sweep,) = evaluated(folder).sweeps
    return sweep


def printed(evaluation: Evaluation) -> str:
    """What a terminal shows, in one line."""
    stream = io.StringIO()
    print_all(evaluation, stream)
    return " ".join(stream.getvalue().split())


def test_recordings_that_differ_in_n_env_alone(tmp_path: Path) -> None:
    """Join numbers of environments, and nothing that differs in more than that."""
    write_sweep(tmp_path, SIZES)
    write_sweep(tmp_path, (1, 4), determinism="full")
    write_sweep(tmp_path, (1, 4), options={"cone": "elliptic"})
    write_sweep(tmp_path, (1, 4), dt=0.5)
    write_sweep(tmp_path, (1, 4), environment={"XLA_FLAGS": "--deterministic"})
    write_sweep(tmp_path, (1,), simulator="alone")
    sweeps = evaluated(tmp_path).sweeps
    assert sorted(tuple(p.n_env for p in s.points) for s in sweeps) == [(1, 4)] * 4 + [SIZES]
    assert len({s.label for s in sweeps}) == 5
    assert any(s.label == "synthetic [determinism=full]" or "determinism=full" in s.label for s in sweeps)


def test_origins_follow_from_the_number(tmp_path: Path) -> None:
    """Join environments of one world, whose origins differ with their number."""
    for n_env in (1, 2, 4):
        write_recording(tmp_path, grid(n_env), origins=tuple((4.0 * i, 0.0, 0.0) for i in range(n_env)))
    assert [p.n_env for p in only(tmp_path).points] == [1, 2, 4]


@pytest.mark.parametrize("of_near", [1, 3])
def test_a_point_is_the_group_of_most_runs(tmp_path: Path, of_near: int) -> None:
    """Take, of groups of one number whose origins differ, that of the most complete runs; keep the other beside it."""
    for apart, runs in ((4.0, of_near), (8.0, 2)):
        for run in range(runs):
            write_recording(tmp_path, grid(2), run=run, origins=((0.0, 0.0, 0.0), (apart, 0.0, 0.0)))
    write_recording(tmp_path, grid(4), origins=tuple((4.0 * i, 0.0, 0.0) for i in range(4)))
    point = only(tmp_path).points[0]
    assert len(point.result.group.complete) == max(of_near, 2)
    assert [len(other.group.complete) for other in point.others] == [min(of_near, 2)]


def test_n_max_and_its_reason(tmp_path: Path) -> None:
    """End at the largest N with a complete run, for the reason of the next larger one, also of runs never built."""
    write_sweep(tmp_path, SIZES, fails=256)
    sweep = only(tmp_path)
    assert sweep.n_max == 64
    assert sweep.ends == "failed at 256: device memory: no memory for the contacts"
    assert [p.complete for p in sweep.points] == [2, 2, 2, 2, 0]
    assert sweep.points[-1].causes == ("failed (device memory)",)


def test_the_first_page_says_how_far_sweeps_go(tmp_path: Path) -> None:
    """Print the largest number and an environment's memory; of two runs without states, why they are not compared."""
    write_sweep(tmp_path, SIZES, fails=256)
    stream = io.StringIO()
    print_document(brief(evaluated(tmp_path)), stream)
    shown = " ".join(stream.getvalue().split())
    assert (
        "most environments (N_env^max) 64: failed at 256: device memory: no memory for the contacts; memory =" in shown
    )
    assert "per env, from 4 points" in shown
    assert "runs were not compared: no states were captured" in shown


def test_a_sweep_that_did_not_end(tmp_path: Path) -> None:
    """Say that nothing larger was tried."""
    write_sweep(tmp_path, (1, 4))
    sweep = only(tmp_path)
    assert (sweep.n_max, sweep.ends) == (4, "largest N in these recordings")


def test_a_partly_failed_point_counts(tmp_path: Path) -> None:
    """Take one complete run for enough, and name each way in which the next point ended."""
    write_sweep(tmp_path, (1, 4))
    write_sweep(tmp_path, (16,), runs=1)
    for run, (status, cause, reason) in enumerate(
        [("FAILED", "TIMEOUT", "took longer than 60 s"), ("INVALID", "BUFFER", "contacts were dropped")]
    ):
        outcome: dict[str, Any] = {"status": status, "cause": cause, "reason": reason}
        for n_env in (16, 64):
            write_recording(tmp_path, None, n_env=n_env, run=run + 1, gpu_bytes=(10**9, 2 * 10**9), **outcome)
    sweep = only(tmp_path)
    assert sweep.n_max == 16
    assert sweep.ends == ("failed at 64: timeout: took longer than 60 s; INVALID at 64: buffer: contacts were dropped")
    assert sweep.points[2].complete == 1
    runs = tables_of(evaluated(tmp_path))["scaling-points-inclined-collision-synthetic"].rows[2].cells[-1]
    assert runs.text == "1 of 3 complete"
    assert [note.split(":")[0] for note in runs.notes] == ["failed (timeout)", "INVALID (buffer)"]


def test_no_run_is_complete(tmp_path: Path) -> None:
    """Have no N_env^max where nothing ran."""
    for n_env in (1, 2):
        write_recording(tmp_path, None, n_env=n_env, status="FAILED", reason="no device", built=False)
    sweep = only(tmp_path)
    assert sweep.n_max is None
    assert sweep.ends == "failed at 1: no device"
    assert sweep.at_max is None
    (row,) = rows_of(tables_of(evaluated(tmp_path))["scaling-largest-inclined-collision"]).values()
    assert (row["N_env^max"].text, row["N_env^max"].notes) == ("-", ("no run is complete",))


def test_memory_model_of_a_device(tmp_path: Path) -> None:
    """Recover what each environment costs, by the monitor and by the allocator, each with its residuals."""
    for n_env in SIZES:
        write_sweep(tmp_path, (n_env,), fixed=5e8, per_env=2e6, allocator_peak=2 ** (25 + SIZES.index(n_env)))
    sweep = only(tmp_path)
    model = sweep.models["memory_peak_increment"]
    assert model.fixed == pytest.approx(5e8, rel=1e-6)
    assert model.per_env == pytest.approx(2e6, rel=1e-6)
    assert model.holds
    doubling = sweep.models["allocator_peak"]
    assert doubling.n == SIZES
    assert not doubling.holds
    assert "does NOT hold" in printed(evaluated(tmp_path))
    assert "host_memory_peak_increment" not in sweep.models


def test_memory_model_of_a_host(tmp_path: Path) -> None:
    """Use the resident set where the simulator ran on the CPU."""
    for n_env in (1, 10, 100):
        write_recording(tmp_path, None, n_env=n_env, host_bytes=(10**8, 10**8 + 3 * 10**6 + 10**5 * n_env))
    sweep = only(tmp_path)
    assert sweep.memory == "host_memory_peak_increment"
    assert sweep.models[sweep.memory].per_env == pytest.approx(1e5, rel=1e-6)


@pytest.mark.parametrize(
    ("sizes", "keywords", "why"),
    [
        ((1, 2), {}, "needs at least 3 numbers of environments with a complete run, got 2"),
        ((1, 2, 4), {"gpu_bytes": (10**9, 10**9)}, "no relative error"),
        ((1, 2, 4), {"gpu_bytes": None}, "no memory was sampled"),
    ],
)
def test_no_memory_model(tmp_path: Path, sizes: tuple[int, ...], keywords: dict[str, Any], why: str) -> None:
    """Give the reason instead of a model."""
    for n_env in sizes:
        write_recording(tmp_path, None, n_env=n_env, **{"gpu_bytes": (10**9, 2 * 10**9), **keywords})
    sweep = only(tmp_path)
    assert why in why_missing(sweep.models[sweep.memory])


def test_a_long_sweep_is_one_table(tmp_path: Path) -> None:
    """Print a row for each N of a sweep, and columns only for groups that say more."""
    write_sweep(tmp_path, SIZES, fails=256)
    write_recording(tmp_path, grid(16), gpu_bytes=(10**9, 2 * 10**9))
    write_sweep(tmp_path, (1, 4), simulator="short")
    evaluation = evaluated(tmp_path)
    found = tables_of(evaluation)
    furthest = rows_of(found["scaling-largest-inclined-collision"])["synthetic"]
    assert (furthest["N_env^max"].text, furthest["why it ends"].text[:30]) == ("64", "failed at 256: device memory: ")
    shown = [(row.cells[0].text, row.cells[1].text) for row in found["throughput"].rows]
    assert ("short", "1 x 2") in shown
    assert not [size for _, size in shown if size.startswith("64 x")]
    assert ("synthetic [float64]", "16 x 1") in shown  # it captured states
    page = render_html(evaluation, published=True, command="")
    throughput = part(page, "throughput")
    assert "64 x" not in throughput
    assert "of sweeps that captured no states" in throughput
    scaling = part(page, "scaling")
    assert "failed at 256: device memory: no memory for the contacts" in scaling
    assert scaling.count("<svg") == 2


def test_json_of_a_sweep(tmp_path: Path, gsb_eval: Command) -> None:
    """Write points, end and model for programs."""
    files = write_sweep(tmp_path, SIZES, fails=256, speed=5e4)
    done = gsb_eval(*files, "--json", "-", code=0)
    (sweep,) = json.loads(done.stdout)["sweeps"]
    assert (sweep["n_env_max"], sweep["simulator"], len(sweep["points"])) == (64, "synthetic", 5)
    assert sweep["points"][1]["fps"] == pytest.approx(5e4)
    assert sweep["points"][-1]["failures"] == [
        {"status": "failed", "cause": "device memory", "reason": "no memory for the contacts"}
    ]
    model = sweep["memory_models"]["memory_peak_increment"]
    assert model["per_env_bytes"] == pytest.approx(1e6, rel=1e-6)
    assert model["holds"] is True
    assert model["n_env"] == [1, 4, 16, 64]


def test_radar_at_n_max(tmp_path: Path) -> None:
    """Compare throughput and memory at each simulator's own N_env^max, and distances of another scene beside them."""
    write_sweep(tmp_path, (1, 4, 16, 64), simulator="wide", scene="free-fall", fails=64, speed=1e3, proven=True)
    write_sweep(tmp_path, (1, 4, 16), simulator="narrow", scene="free-fall", fails=16, speed=3e3, proven=True)
    for name, shift in (("wide", 0.0), ("narrow", 0.01)):
        for run in range(2):
            moved = grid(4) + np.array([shift * run, 0.0, 0.0])
            write_recording(tmp_path, moved, run=run, simulator=name, gpu_bytes=(10**9, 2 * 10**9))
    comparison = evaluated(tmp_path).comparison
    figures = {c.figures.name: c.figures for c in comparison.contenders}
    assert set(figures) == {"wide", "narrow"}
    assert (figures["wide"].n_max, figures["narrow"].n_max) == (16, 4)
    assert figures["narrow"].fps == pytest.approx(3e3)
    assert figures["wide"].memory_gb == pytest.approx(0.516)
    assert figures["narrow"].run_to_run == pytest.approx(1.0)
    assert comparison.radar.values["wide"][Axis.PARALLELISM] == 1.0
    picks = {g.need: g.pick for g in comparison.guidelines}
    assert picks["large parallelism with simple agents"] == "narrow"
    assert comparison.notes == ()


def test_a_sweep_that_merely_ended_is_not_compared(tmp_path: Path) -> None:
    """Leave out a simulator whose sweep was cut short, which would win on memory, and name it."""
    write_sweep(tmp_path, (1, 4), simulator="short")
    write_sweep(tmp_path, SIZES, simulator="long")
    write_sweep(tmp_path, SIZES, simulator="longer")
    comparison = evaluated(tmp_path).comparison
    assert {c.figures.name for c in comparison.contenders} == {"long", "longer"}
    assert any("short" in note for note in comparison.notes)


def test_radar_without_a_shared_sweep(tmp_path: Path) -> None:
    """Compare at the shared number of environments where only one simulator was swept, and claim no N_env^max."""
    write_sweep(tmp_path, (1, 4, 16), simulator="swept")
    write_sweep(tmp_path, (4,), simulator="single")
    comparison = evaluated(tmp_path).comparison
    assert [c.figures.n_max for c in comparison.contenders] == [None, None]
    assert {c.figures.name for c in comparison.contenders} == {"swept [n_env=4]", "single"}
    assert "no comparable sweep" in why_missing(comparison.contenders[0].metrics[Axis.PARALLELISM])
    assert "no comparable sweep" in render_html(evaluated(tmp_path), published=False, command="")


def test_guidelines_of_a_robot(tmp_path: Path) -> None:
    """Pick for articulated robots from the sweeps of a scene with one."""
    from gpusimbench.schemas.fields import StateField

    joints = StateField("robot", "qpos", "float32", ("j1",), ("angle",), "rad", "joint")
    for name, speed in (("one", 1e4), ("other", 2e4)):
        write_sweep(tmp_path, (1, 4), simulator=name, scene="franka", speed=speed, field=joints)
    comparison = evaluated(tmp_path).comparison
    picks = {g.need: g.pick for g in comparison.guidelines}
    assert picks["large parallelism with articulated robots"] == "other"
    assert not picks["large parallelism with simple agents"]


def test_a_real_sweep(tmp_path: Path, gsb_record: Command) -> None:
    """Sweep MuJoCo over three numbers of environments and see each of them."""
    for n_env in (1, 2, 4):
        gsb_record(
            "--sim", "mujoco", "--scene", "free-fall", "--phases", "timed", "--n-env", n_env, "--runs", 1,
            "--warmup", 5, "--timed-steps", 60, "--out", tmp_path, code=0,
        )  # fmt: skip
    sweep = only(tmp_path)
    assert (sweep.n_max, sweep.ends, sweep.label) == (4, "largest N in these recordings", "mujoco")
    assert set(sweep.models) == {"host_memory_peak_increment"}
    contacts = sweep.points[-1].result.validity.of("contacts")
    assert contacts.max > 0


def test_a_shipped_sweep_that_the_engine_ends() -> None:
    """Give the engine's reason as part of a sentence, and count no device for a run that was never built."""
    folder = Path(__file__).resolve().parents[2] / "recordings" / "sweeps-h100"
    found = evaluate_files(sorted(folder.glob("genesis-free-fall-*.mcap")))
    (sweep,) = found.sweeps
    assert sweep.ends.startswith("failed at 8,192: refused: Genesis does not accept this scene")
    assert sweep.ends.endswith(" is too large")
    assert asked_of(found) == "7 recordings, 1 simulator, 1 scene, 1 device."
