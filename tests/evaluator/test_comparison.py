"""Which groups radar and guidelines compare, and whom they bar: instruments are ranked against none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gpusimbench.evaluator.metrics.guidelines import Guideline
from gpusimbench.evaluator.metrics.radar import Axis
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.faults import faults_anywhere
from gpusimbench.evaluator.results.ranking import Comparison
from tests.synthetic import grid, write_recording, write_sweep

REPRODUCIBLE = "reproducible and fair comparison, repeated runs"
NOTE = "radar and guidelines leave out instruments: control"


def compared(folder: Path) -> Comparison:
    """Of everything in a folder."""
    return evaluate_files(sorted(folder.glob("*.mcap"))).comparison


def need(found: Comparison, name: str) -> Guideline:
    """One row."""
    return next(g for g in found.guidelines if g.need == name)


def test_a_warm_up_of_its_own_is_no_reason_to_be_left_out(tmp_path: Path) -> None:
    """Compare distances whatever was timed, throughputs of the same timed steps alone; let both be reproducible."""
    for run in range(2):
        for simulator, warmup, seconds in (("a", 100, 2.0), ("b", 100, 3.0), ("quick", 20, 1.1)):
            write_recording(
                tmp_path, grid(2), simulator=simulator, run=run, warmup=warmup, elapsed_s=seconds, proven=True
            )
    found = compared(tmp_path)
    assert [c.figures.name for c in found.contenders] == ["a", "b", "quick"]
    quick = found.contenders[2]
    why = "timed over steps 20 to 1,020 of the scene, and others over steps 100 to 1,100"
    assert quick.metrics[Axis.THROUGHPUT] == Missing(why)
    assert quick.figures.run_to_run == 0
    assert need(found, REPRODUCIBLE).pick == "a"
    assert need(found, REPRODUCIBLE).unranked == (f"quick (W1 between runs 0.00 cm, W1 between envs 0.00 cm): {why}",)


def test_a_throughput_without_evidence_of_work_is_compared_with_none(tmp_path: Path) -> None:
    """Give the rule that is not met in place of the throughput, on the radar and to the guidelines."""
    for run in range(2):
        for simulator, proven in (("a", True), ("b", True), ("unproven", False)):
            write_recording(tmp_path, grid(2), simulator=simulator, run=run, warmup=100, elapsed_s=2.0, proven=proven)
    found = compared(tmp_path)
    speeds = {c.figures.name: c.metrics[Axis.THROUGHPUT] for c in found.contenders}
    assert not isinstance(speeds["a"], Missing) and not isinstance(speeds["b"], Missing)
    assert isinstance(speeds["unproven"], Missing) and "not met" in speeds["unproven"].reason
    (unranked,) = need(found, REPRODUCIBLE).unranked
    assert unranked.startswith("unproven ")


def test_figures_on_a_gpu_are_those_of_their_axes(tmp_path: Path) -> None:
    """Compare throughput, GPU memory and distances of simulators on a GPU, each by the metric that it is."""
    for simulator, seconds, used in (("a", 2.0, 3 * 10**9), ("b", 4.0, 5 * 10**9)):
        for run in range(2):
            moved = grid(2)
            moved[1] += [0.02, 0.0, 0.0]
            write_recording(
                tmp_path, moved, simulator=simulator, run=run, elapsed_s=seconds, proven=True,
                gpu_bytes=(10**9, 10**9 + used), host_bytes=(10**9, 2 * 10**9),
            )  # fmt: skip
    a, b = (c.figures for c in compared(tmp_path).contenders)
    assert (a.fps, b.fps) == (pytest.approx(2 * 1000 / 2.0), pytest.approx(2 * 1000 / 4.0))
    assert (a.memory_gb, b.memory_gb) == (pytest.approx(3.0), pytest.approx(5.0))
    assert a.run_to_run == b.run_to_run == 0.0
    assert a.parallel == b.parallel == pytest.approx(2.0)  # cm


@pytest.mark.parametrize("scenes", [("free-fall", "inclined-collision"), ("inclined-collision", "free-fall")])
def test_what_is_wrong_is_held_against_other_scenes_at_any_step(scenes: tuple[str, str], tmp_path: Path) -> None:
    """Hold a fault against the engine in other scenes whatever their step, and in its own at the same step alone."""
    wrong, other = scenes
    failed = {"status": "INVALID", "cause": "NOT_FINITE", "reason": "a state is not finite"}
    write_recording(tmp_path, None, scene=wrong, dt=0.02, **failed)
    for scene, dt in ((other, 0.02), (other, 0.01), (wrong, 0.02), (wrong, 0.01)):
        write_recording(tmp_path, None, scene=scene, dt=dt, n_env=64)
    results = evaluate_files(sorted(tmp_path.glob("*.mcap"))).results
    against = {
        (r.group.key.scene, r.group.key.dt): bool(faults_anywhere(r, results))
        for r in results
        if r.group.key.n_env == 64
    }
    assert against == {(other, 0.02): True, (other, 0.01): True, (wrong, 0.02): True, (wrong, 0.01): False}


def test_what_is_wrong_in_another_scene_bars_a_pick(tmp_path: Path) -> None:
    """Bar an engine that is INVALID in a scene that is not compared; not another of its levels or options."""
    for run in range(2):
        for options in ({}, {"solver": "b"}):
            write_recording(tmp_path, grid(2), simulator="wrong", run=run, elapsed_s=1.1, options=options, proven=True)
        write_recording(tmp_path, grid(2), simulator="right", run=run, elapsed_s=2.0, proven=True)
    write_recording(
        tmp_path, None, simulator="wrong", scene="free-fall", n_env=64, status="INVALID", cause="NOT_FINITE",
        reason="a state is not finite", environment={"SOME": "variable"},
    )  # fmt: skip
    found = need(compared(tmp_path), REPRODUCIBLE)
    assert found.pick and "solver=b" in found.pick
    (barred,) = found.barred
    assert barred.endswith("1 of 1 run is INVALID (not finite) (free-fall)")


def treated(**settings: str) -> Callable[[str, dict[str, Any]], None]:
    """What writes settings into the configuration of a recording."""

    def change(_: str, record: dict[str, Any]) -> None:
        if "configuration" in record:
            record["configuration"] |= settings

    return change


VARIED, SET, POISONED = {"vary": "mass:0.1"}, {"intervention": "set@2"}, {"intervention": "poison@2"}


@pytest.mark.parametrize(
    ("of_a", "of_b", "compared_with"),
    [
        ([{}, SET], [{}, VARIED], {}),
        ([{}, SET, VARIED], [{}, SET, VARIED], {}),
        ([SET, VARIED], [{}, VARIED], VARIED),
        ([SET], [{}], None),
        ([SET], [POISONED], None),
    ],
)
def test_treated_runs_are_compared_with_such_alone(
    tmp_path: Path, of_a: list[dict[str, str]], of_b: list[dict[str, str]], compared_with: dict[str, str] | None
) -> None:
    """Compare runs that were left alone, or else runs of one treatment, and say what is left out."""
    for name, treatments in (("a", of_a), ("b", of_b)):
        for number, treatment in enumerate(treatments):
            file = f"{name}{number}.mcap"
            write_recording(tmp_path, grid(4), simulator=name, change=treated(**treatment), name=file)
    found = compared(tmp_path)
    assert [c.group.group.key.settings for c in found.contenders if c.group] == (
        [] if compared_with is None else [tuple(compared_with.items())] * 2
    )
    said = [note for note in found.notes if note.startswith("radar and guidelines leave out what ran under other")]
    if compared_with is None:
        assert said == []
        return
    left = [treatment for treatment in (*of_a, *of_b) if treatment != compared_with]
    treated_ones = sum(map(bool, left))
    named = ["b"] if {} in left else []
    groups = f"{treated_ones} group{'s' if treated_ones > 1 else ''} with --initial, --vary or --intervene"
    assert said == [f"radar and guidelines leave out what ran under other conditions: {', '.join([*named, groups])}"]


@pytest.mark.parametrize("swept", [False, True], ids=["groups", "sweeps"])
def test_an_instrument_is_not_ranked(tmp_path: Path, swept: bool) -> None:
    """Compare the two engines without the instrument, which is faster than both, and say so."""
    for name, speed in (("fast", 2.0), ("slow", 1.0), ("control", 9.0)):
        switches = {"instrument": True} if name == "control" else None
        if swept:
            write_sweep(tmp_path, (1, 4, 16), simulator=name, speed=1e4 * speed, switches=switches)
        else:
            write_recording(tmp_path, grid(2), simulator=name, elapsed_s=1 / speed, switches=switches)
    comparison = compared(tmp_path)
    assert {c.figures.name for c in comparison.contenders} == {"fast", "slow"}
    assert all("control" not in (g.pick or "") + (g.evidence or "") for g in comparison.guidelines)
    assert comparison.notes == (NOTE,)


def test_an_engine_and_an_instrument_are_no_comparison(tmp_path: Path) -> None:
    """Draw no radar of one engine beside an instrument, and none of an instrument alone."""
    write_recording(tmp_path, grid(2), simulator="control", switches={"instrument": True})
    assert compared(tmp_path) == Comparison()
    write_recording(tmp_path, grid(2), simulator="engine")
    assert compared(tmp_path) == Comparison(notes=(NOTE,))
