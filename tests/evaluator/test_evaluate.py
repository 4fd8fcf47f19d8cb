"""Every metric against outcomes that are known by construction, through real files and the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import Command
from tests.synthetic import grid, metrics_of, write_recording


def evaluate(gsb_eval: Command, *arguments: object, code: int = 0) -> dict[str, Any]:
    """The JSON of gsb-eval."""
    done = gsb_eval(*arguments, "--json", "-", code=code)
    return json.loads(done.stdout)  # type: ignore[no-any-return]


def metrics(gsb_eval: Command, *arguments: object) -> dict[str, Any]:
    """The metrics of the only group."""
    document = evaluate(gsb_eval, *arguments)
    assert len(document["groups"]) == 1
    return document["groups"][0]["metrics"]  # type: ignore[no-any-return]


def test_all_equal(gsb_eval: Command, tmp_path: Path) -> None:
    """Find nothing where nothing varies: distance 0, one distinct env and run, Type 2."""
    files = [write_recording(tmp_path, grid(4), run=r) for r in range(3)]
    found = metrics(gsb_eval, *files)
    assert found["w1_parallel"]["value"] == 0
    assert found["w1_run_to_run"]["value"] == 0
    assert found["w1_run_to_run"]["n"] == 3
    assert found["distinct_envs"]["value"] == 1
    assert found["distinct_runs"]["value"] == 1
    assert found["regime_published"]["value"] == 2
    assert found["left_board"]["value"] == 0


def test_a_shifted_copy(gsb_eval: Command, tmp_path: Path) -> None:
    """Measure a shift of all cubes as the shift: 3 cm between runs, none between envs: Type 4."""
    shifted = grid(4) + [0.03, 0.0, 0.0]
    files = [write_recording(tmp_path, final, run=r) for r, final in enumerate((grid(4), shifted))]
    found = metrics(gsb_eval, *files, "--reference", write_recording(tmp_path, grid(4), simulator="other"))
    assert found["w1_run_to_run"]["value"] == pytest.approx(3.0, abs=1e-9)
    assert found["w1_parallel"]["value"] == 0
    assert found["w1_real"]["value"] == pytest.approx(1.5, abs=1e-9)
    assert found["w1_real"]["sd"] == pytest.approx(np.std([0, 3], ddof=1), abs=1e-9)
    assert found["regime_published"]["value"] == 4
    assert found["distinct_runs"]["value"] == 2


def test_swapped_cubes(gsb_eval: Command, tmp_path: Path) -> None:
    """Show what 0.00 does not mean: cubes that swapped places have distance 0 and are still distinct."""
    final = grid(2)
    final[1, [0, 26]] = final[1, [26, 0]]
    found = metrics(gsb_eval, write_recording(tmp_path, final))
    assert found["w1_parallel"]["value"] == 0
    assert found["distinct_envs"]["value"] == 2
    assert found["distinct_envs"]["extra"]["first_difference_step"] == 5


def test_one_moved_cube(gsb_eval: Command, tmp_path: Path) -> None:
    """Measure one cube of 27 that moved 1.35 cm in one env of 4 as 0.05 cm in 3 of 6 pairs: Type 1."""
    final = grid(4)
    final[2, 5, 0] += 0.0135
    files = [write_recording(tmp_path, final, run=r) for r in range(2)]
    found = metrics(gsb_eval, *files)
    assert found["w1_parallel"]["value"] == pytest.approx(0.025, abs=1e-9)
    assert found["distinct_envs"]["value"] == 2
    assert found["distinct_runs"]["value"] == 1
    assert found["regime_published"]["value"] == 1


def test_one_bit_of_one_env(gsb_eval: Command, tmp_path: Path) -> None:
    """Tell one last bit of one height in one env apart, where every distance is 0."""
    final = grid(16, "float32")
    final[11, 20, 2] = np.nextafter(final[11, 20, 2], np.float32(1))
    found = metrics(gsb_eval, write_recording(tmp_path, final, run=0), write_recording(tmp_path, final, run=1))
    assert found["w1_parallel"]["value"] == 0
    assert found["regime_published"]["value"] == 2
    assert found["distinct_envs"]["value"] == 2
    assert found["distinct_envs"]["extra"]["classes"][0][11] == 1


def test_both_vary(gsb_eval: Command, tmp_path: Path) -> None:
    """Class what varies in both ways as Type 3."""
    rng = np.random.default_rng(0)
    files = [write_recording(tmp_path, grid(3) + rng.normal(0, 0.01, (3, 27, 3)), run=r) for r in range(4)]
    found = metrics(gsb_eval, *files)
    assert found["regime_published"]["value"] == 3
    low, high = found["w1_run_to_run"]["ci95"]
    assert low < found["w1_run_to_run"]["value"] < high
    assert found["w1_run_to_run"]["n"] == 6
    floor = found["w1_run_to_run"]["extra"]["permutation_test"]["w1"]
    assert floor["p_value"] > 0.05, "all envs are of one law"
    assert floor["floor_mean_cm"] == pytest.approx(floor["observed_cm"], rel=0.5)


def test_throughput_and_memory(gsb_eval: Command, tmp_path: Path) -> None:
    """Compute FPS = N_env N_step / T_step and the memory increment per run, and average over runs."""
    files = [
        write_recording(
            tmp_path, grid(8), run=r, elapsed_s=elapsed, timed_steps=500, gpu_bytes=(10**9, 10**9 + peak * 10**6)
        )
        for r, (elapsed, peak) in enumerate([(2.0, 100), (4.0, 300)])
    ]
    found = metrics(gsb_eval, *files)
    assert found["fps"]["value"] == pytest.approx((8 * 500 / 2 + 8 * 500 / 4) / 2)
    assert found["fps"]["n"] == 2
    assert found["fps"]["direction"] == "higher"
    assert found["memory_peak_increment"]["value"] == pytest.approx(0.2)
    assert found["memory_peak_increment"]["unit"] == "GB"


def test_cubes_off_the_board(gsb_eval: Command, tmp_path: Path) -> None:
    """Count cubes beside the board and below it, though planar distances do not see a fall."""
    final = grid(2)
    final[0, 0] = (0.7, 0.0, 0.03)  # beyond the edge in x
    final[0, 1] = (0.3, -0.31, -4.0)  # beside it
    final[1, 2] = (0.3, 0.0, -40.0)  # through it
    found = metrics(gsb_eval, write_recording(tmp_path, final))
    assert found["left_board"]["value"] == 1.5
    assert found["left_board"]["extra"]["total"] == 3


def test_origins_are_subtracted(gsb_eval: Command, tmp_path: Path) -> None:
    """Compare environments at different origins in their own frames, but not by bits."""
    origins = ((0.0, 0.0, 0.0), (4.0, -8.0, 0.0))
    final = grid(2) + np.array(origins)[:, None]
    found = metrics(gsb_eval, write_recording(tmp_path, final, origins=origins))
    assert found["w1_parallel"]["value"] == pytest.approx(0.0, abs=1e-9)
    assert found["left_board"]["value"] == 0
    assert found["distinct_envs"]["value"] is None
    assert "different origins" in found["distinct_envs"]["value_missing"]


def test_unequal_counts_are_an_extension(gsb_eval: Command, tmp_path: Path) -> None:
    """Compare 4 envs with 16 trials by weighted transport, and say that the published definition does not."""
    found = metrics(
        gsb_eval, write_recording(tmp_path, grid(4) + [0.02, 0, 0]),
        "--reference", write_recording(tmp_path, grid(16), simulator="other"),
    )  # fmt: skip
    assert found["w1_real"]["value"] == pytest.approx(2.0, abs=1e-6)
    assert "not in the published definition" in found["w1_real"]["extra"]["extension"]


@pytest.mark.parametrize(
    ("keywords", "missing", "why"),
    [
        ({}, "w1_real", "no reference"),
        ({}, "w1_run_to_run", "needs at least two complete runs"),
        ({}, "distinct_runs", "needs at least two complete runs"),
        ({}, "memory_peak_increment", "no GPU on the machine"),
        ({}, "regime_published", "w1_run_to_run could not be computed"),
        ({"elapsed_s": None}, "fps", "the timed phase was left out"),
        ({"steps": 4}, "w1_parallel", "step 5 (5 s) was not recorded"),
        ({"status": "INVALID", "reason": "contacts were dropped"}, "fps", "no run of this group is complete"),
    ],
)
def test_what_cannot_be_computed_says_why(
    gsb_eval: Command, tmp_path: Path, keywords: dict[str, Any], missing: str, why: str
) -> None:
    """Give a reason and no number, in JSON and on the terminal."""
    path = write_recording(tmp_path, grid(2), **keywords)
    done = gsb_eval(path, "--json", "-", "--sample-time", 5)
    found = metrics_of(done.stdout)[missing]
    assert found["value"] is None
    assert found["exactness"] == "none"
    assert why in found["value_missing"]
    assert why in " ".join(gsb_eval(path, "--sample-time", 5, "--all").stdout.split())


def test_one_env(gsb_eval: Command, tmp_path: Path) -> None:
    """Have no parallel variability with one environment."""
    assert metrics(gsb_eval, write_recording(tmp_path, grid(1)))["w1_parallel"]["value_missing"] == (
        "needs at least two environments"
    )


def test_only_complete_runs_count(gsb_eval: Command, tmp_path: Path) -> None:
    """Leave failed, invalid, incomplete and lossy runs out of every mean, list them, and end with 3 for lost data."""
    good = [write_recording(tmp_path, grid(2), run=r) for r in range(2)]
    wild = grid(2) + 1.0
    failed = write_recording(tmp_path, wild, run=2, status="FAILED", reason="out of device memory")
    invalid = write_recording(tmp_path, wild, run=3, status="INVALID", reason="contacts were dropped")
    assert evaluate(gsb_eval, *good, failed, invalid)["groups"][0]["metrics"]["w1_run_to_run"]["value"] == 0
    lossy = write_recording(tmp_path, wild, run=4, dropout="the disk was slow")
    incomplete = write_recording(tmp_path, wild, run=5, end=False)
    document = evaluate(gsb_eval, *good, failed, invalid, lossy, incomplete, code=3)
    (group,) = document["groups"]
    assert (group["n_run"], group["n_recording"]) == (2, 6)
    assert group["metrics"]["w1_run_to_run"]["value"] == 0
    notes = " ".join(group["notes"])
    for reason in ("out of device memory", "contacts were dropped", "the disk was slow", "no end record"):
        assert reason in notes
    statuses = sorted(r["status"] for r in document["recordings"])
    assert statuses == ["complete"] * 3 + ["failed", "incomplete", "invalid"]


def test_groups_by_content_never_by_name(gsb_eval: Command, tmp_path: Path) -> None:
    """Separate simulators, dt, environment counts, switches and devices; join runs whatever their files are called."""
    write_recording(tmp_path, grid(2), run=0, name="a.mcap")
    write_recording(tmp_path, grid(2), run=1, name="zebra.mcap")
    write_recording(tmp_path, grid(2), dt=0.5, steps=10)
    write_recording(tmp_path, grid(3))
    write_recording(tmp_path, grid(2), switches={"deterministic": True})
    write_recording(tmp_path, grid(2), gpu_bytes=(1, 2))
    write_recording(tmp_path, grid(2), simulator="other")
    document = evaluate(gsb_eval, *tmp_path.glob("*.mcap"))
    assert sorted(g["n_run"] for g in document["groups"]) == [1, 1, 1, 1, 1, 2]
    labels = [g["label"] for g in document["groups"]]
    assert len(set(labels)) == 6
    assert any("deterministic=True" in label for label in labels)
    assert any("differ in dt" in note for note in document["notes"])


def test_a_copy_counts_once(gsb_eval: Command, tmp_path: Path) -> None:
    """Notice that two files are one run."""
    path = write_recording(tmp_path, grid(2))
    copy = tmp_path / "again.mcap"
    copy.write_bytes(path.read_bytes())
    document = evaluate(gsb_eval, path, copy, path)
    assert document["groups"][0]["n_run"] == 1
    assert any("copy" in note for note in document["notes"])


def test_radar_and_guidelines(gsb_eval: Command, tmp_path: Path) -> None:
    """Compare simulators of one scene: the faster is best in throughput, and no number is made up."""
    for name, elapsed in (("fast", 1.0), ("slow", 2.0)):
        for run in range(2):
            write_recording(tmp_path, grid(2), simulator=name, run=run, elapsed_s=elapsed, proven=True)
    document = evaluate(gsb_eval, *tmp_path.glob("*.mcap"))
    assert document["radar"]["fast"]["throughput"] == 1.0
    assert document["radar"]["slow"]["throughput"] == 0.0
    assert document["radar"]["fast"]["max parallelism"] is None
    picks = {g["need"]: g for g in document["guidelines"]}
    repeated = picks["reproducible and fair comparison, repeated runs"]
    assert repeated["pick"] == "fast"
    assert picks["sim-to-real, contact-rich, single run"]["pick"] is None


def test_a_real_set(gsb_eval: Command, small_set: list[Path]) -> None:
    """Evaluate what MuJoCo really did: one distinct env, one distinct run, capture without effect."""
    document = evaluate(gsb_eval, *small_set, "--sample-time", 1)
    (group,) = document["groups"]
    assert (group["simulator"], group["n_env"], group["n_run"]) == ("mujoco", 4, 3)
    found = group["metrics"]
    assert found["fps"]["value"] > 0
    assert found["distinct_envs"]["value"] == found["distinct_runs"]["value"] == 1
    assert found["capture_changes_states"]["value"] == 0
    assert found["capture_changes_states"]["n"] == 3
    assert found["host_memory_peak_increment"]["value"] > 0
    assert found["w1_parallel"]["value"] == 0
    assert {d["parameter"] for d in group["deviations"]} >= {"304 steel.restitution"}
    for name, metric in found.items():
        assert (metric["value"] is None) == bool(metric["value_missing"]), name
        assert metric["direction"] in ("higher", "lower", "neither")
