"""GPU memory where other processes were on the device: whose figures enter, who is named, what is unknown."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.cli.compare import main as gsb_compare
from gpusimbench.evaluator.cli.eval import main as gsb_eval
from gpusimbench.evaluator.cli.info import main as gsb_info
from gpusimbench.evaluator.metrics.cotenants import BASELINE, Peers, Presence, cotenants, peers_of
from gpusimbench.evaluator.metrics.memory import Checkpoints, GpuMemory, Listing
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.cost_metrics import GPU_MEMORY, HOST_MEMORY, common_memory
from gpusimbench.evaluator.results.details import Memory, Throughput
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.metric import Estimate, missing
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.result import GroupResult
from tests.pages import part, rows_of, tables_of
from tests.synthetic import write_recording

SHIPPED = Path(__file__).resolve().parents[2] / "recordings"
MB = 10**6
GB = 10**9

CLEAN = (GB, 2 * GB)
RELEASED = (3 * GB, 2 * GB)
HELD = (3 * GB, 4 * GB)


def shipped(name: str, *runs: int) -> list[Path]:
    """Shipped recordings of one group."""
    return [SHIPPED / f"{name}-inclined-collision-n16-r{run}.mcap" for run in runs]


def only(files: list[Path]) -> GroupResult:
    """The one group of some files."""
    (result,) = evaluate_files(files).results
    return result


def presences(result: GroupResult) -> list[str]:
    """Of the runs, in order."""
    return [one.presence.value for one in result.metrics["fps"].of(Throughput).co_tenants or ()]


@pytest.mark.parametrize(
    ("name", "runs", "out", "increment", "process"),
    [
        ("h100/newton-mujoco", (0, 1, 2, 3), [1], 0.783, 0.774),
        ("h200/genesis", (0, 1, 2), [0], 1.798, 1.687),
    ],
)
def test_shipped_runs_with_a_co_tenant(
    name: str, runs: tuple[int, ...], out: list[int], increment: float, process: float
) -> None:
    """Leave the runs out that another process shared the GPU with, name them, and show the process's own figure."""
    result = only(shipped(name, *runs))
    device, own = (result.metrics[metric] for metric in GPU_MEMORY)
    assert device.value == pytest.approx(increment, abs=5e-4)
    assert [one.run for one in device.of(Memory).runs_left_out or ()] == out
    assert (device.n, device.of(Memory).source) == (len(runs) - len(out), "device")
    assert own.value == pytest.approx(process, abs=5e-4)
    assert (own.n, own.of(Memory).source) == (len(runs), "process")
    alone = "none" if name.startswith("h100") else "unknown"  # older recordings list no processes
    assert presences(result) == ["some" if run in out else alone for run in runs]
    for run in runs:
        assert any(note.startswith(f"run {run}: another process was on the GPU") for note in result.notes) is (
            run in out
        )


def test_no_zero_for_a_run_alone() -> None:
    """Give no increment of a run whose device held less at its peak than at the baseline, not 0.0."""
    result = only(shipped("h100/newton-mujoco", 1))
    device, own = (result.metrics[metric] for metric in GPU_MEMORY)
    assert (device.value, device.n) == (Missing("another process was on the GPU in 1 of 1 run"), 0)
    assert own.value == pytest.approx(0.774, abs=5e-4)


def test_a_run_on_a_cpu_has_no_co_tenants(tmp_path: Path) -> None:
    """Say nothing of other processes on a GPU that no run used."""
    result = only([write_recording(tmp_path, None, elapsed_s=2.0)])
    assert result.metrics["fps"].of(Throughput).co_tenants is None


def test_compared_by_the_process(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compare what the processes held where a run of a side had a co-tenant."""
    base, head = shipped("h100/newton-mujoco", 0, 1, 2), shipped("h100/newton-mujoco", 5, 6, 7)
    gsb_compare(["--base", *map(str, base), "--head", *map(str, head), "--json", "-", "--no-cache", "--no-verify"])
    (found,) = json.loads(capsys.readouterr().out)["compared"]
    by_name = {one["name"]: one for one in found["findings"]}
    assert "memory_peak_increment" not in by_name
    assert (by_name["process_memory_peak"]["ratio"], by_name["process_memory_peak"]["change"]) == (1.0, "same")
    assert [note[:12] for note in found["notes"] if "known error" not in note] == ["base: run 1:"]


def test_compared_by_what_is_left(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compare the device's increments of the other runs, where NVML told nothing of the processes."""
    base = [write_recording(tmp_path, None, run=r, gpu_bytes=g) for r, g in enumerate((CLEAN, CLEAN, RELEASED))]
    head = [write_recording(tmp_path, None, run=r, gpu_bytes=CLEAN) for r in range(3)]
    gsb_compare(["--base", *map(str, base), "--head", *map(str, head), "--json", "-", "--no-cache"])
    (found,) = json.loads(capsys.readouterr().out)["compared"]
    by_name = {one["name"]: one for one in found["findings"]}
    assert "process_memory_peak" not in by_name
    memory = by_name["memory_peak_increment"]
    assert (memory["ratio"], memory["base"], memory["n"]) == (1.0, GB, {"base": 2, "head": 3})


@pytest.mark.parametrize(
    ("gpu", "keywords", "presence", "moments"),
    [
        (CLEAN, {}, "unknown", []),
        (RELEASED, {}, "some", [BASELINE]),
        (CLEAN, {"process_bytes": 990 * MB}, "unknown", []),
        ((GB, GB), {"process_bytes": 990 * MB}, "some", [BASELINE]),
        (CLEAN, {"others": (0, 0)}, "unknown", []),
        (CLEAN, {"others": (0, 0), "reserved": GB - MB}, "none", []),
        (CLEAN, {"others": (0, 0), "reserved": GB // 2}, "some", [BASELINE]),
        (CLEAN, {"others": (2, None), "reserved": GB}, "some", [BASELINE, "timed", "final"]),
        (CLEAN, {"others": (None, None), "reserved": GB}, "unknown", []),
    ],
)
def test_what_one_file_tells(
    gpu: tuple[int, int],
    keywords: dict[str, Any],
    presence: str,
    moments: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Tell none, some and unknown apart: in gsb-info, in its JSON, and in the evaluation."""
    path = write_recording(tmp_path, None, gpu_bytes=gpu, **keywords)
    result = only([path])
    (told,) = result.metrics["fps"].of(Throughput).co_tenants or ()
    assert (told.presence.value, [sign.moment for sign in told.signs]) == (presence, moments)
    assert isinstance(result.metrics["memory_peak_increment"].value, Missing) is (presence == "some")
    assert gsb_info([str(path), "--json", "-"]) == 0
    (shown,) = json.loads(capsys.readouterr().out)["files"]
    assert (shown["co_tenants"]["presence"], len(shown["co_tenants"]["signs"])) == (presence, len(moments))
    gsb_info([str(path), "--all"])
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("  co-tenants"))
    said = line.removeprefix("  co-tenants").lstrip()
    assert said.startswith({"none": "none", "some": "another process", "unknown": "unknown"}[presence])


def test_who_stayed_is_told_by_other_runs(tmp_path: Path) -> None:
    """Find a process that stayed for the whole run by the baseline of another run, and only on the same driver."""
    run = {"elapsed_s": 1.0}
    stayed = write_recording(tmp_path, None, run=0, gpu_bytes=HELD, **run)
    alone = write_recording(tmp_path, None, run=1, gpu_bytes=CLEAN, **run)

    def another_driver(name: str, record: dict[str, Any]) -> None:
        if "gpus" in record:
            record["gpus"][0]["driver"] = "2"

    other = write_recording(tmp_path, None, run=2, gpu_bytes=CLEAN, change=another_driver, **run)
    assert presences(only([stayed])) == ["unknown"]
    assert presences(only([stayed, alone])) == ["some", "unknown"]
    assert {p for r in evaluate_files([stayed, other]).results for p in presences(r)} == {"unknown"}


def test_who_came_later_is_told_by_other_runs(tmp_path: Path) -> None:
    """Find a process that came behind the baseline by what runs of the same configuration leave to nobody."""
    files = [
        write_recording(tmp_path, None, run=run, gpu_bytes=(GB, peak), process_bytes=990 * MB)
        for run, peak in enumerate((2 * GB, 2 * GB + 100 * MB, 4 * GB))
    ]
    result = only(files)
    assert presences(result) == ["unknown", "unknown", "some"]
    assert result.metrics["memory_peak_increment"].value == pytest.approx(1.05)


def test_tables_and_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Name the runs beside throughput and memory, and which source a figure has."""
    files = [
        write_recording(tmp_path, None, run=run, gpu_bytes=gpu, process_bytes=990 * MB)
        for run, gpu in enumerate((CLEAN, RELEASED, CLEAN))
    ]
    page = tmp_path / "page"
    assert gsb_eval([*map(str, files), "--all", "--html", str(page), "--no-cache"]) == 0
    text = capsys.readouterr().out
    printed = " ".join(text.split())
    found = tables_of(evaluate_files(files))
    (speed,) = rows_of(found["throughput"]).values()
    assert speed["throughput [env-steps/s]"].notes == ("another process on the GPU: 1 of 3 runs: 1",)
    (costs,) = rows_of(found["costs"]).values()
    assert costs["GPU memory increment [GB]"].text == "1.00 ± 0.00"
    assert costs["GPU memory of the process [GB]"].text == "0.99 ± 0.00"
    assert "lower for it: synthetic (1 of 3 runs: 1)" in printed
    html = (page / "index.html").read_text()
    assert "another process on the GPU: 1 of 3 runs: 1" in html
    costs = part(html, "throughput")
    assert re.search(r"1\.00 ± 0\.00<small>of 2 runs</small>", costs)
    assert re.search(r"0\.99 ± 0\.00(?!<small>of)", costs)


def test_a_sweep_has_one_source(tmp_path: Path) -> None:
    """Fit the model to the processes' figures at all points, where one point has no run without a co-tenant."""
    for n_env in (64, 128, 256, 512):
        own = 500 * MB + n_env * MB
        gpu = (3 * GB, GB + own) if n_env == 256 else (GB, GB + own + 10 * MB)
        write_recording(tmp_path, None, n_env=n_env, gpu_bytes=gpu, process_bytes=own)
    (sweep,) = evaluate_files(sorted(tmp_path.glob("*.mcap"))).sweeps
    assert sweep.memory == "process_memory_peak"
    assert set(sweep.models) == {"process_memory_peak"}
    assert sweep.models["process_memory_peak"].fixed == pytest.approx(500 * MB)
    assert sweep.models["process_memory_peak"].per_env == pytest.approx(MB)


def test_a_price_has_one_source(tmp_path: Path) -> None:
    """Price a level by the processes' figures on both sides, where all runs of one had a co-tenant."""
    for level, gpu, own in (("default", CLEAN, 900 * MB), ("run-to-run", RELEASED, 990 * MB)):
        for run in range(3):
            asked = {"determinism": level, "switches": {"exact": level != "default"}}
            write_recording(tmp_path, None, run=run, gpu_bytes=gpu, process_bytes=own, **asked)
    (family,) = evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list
    assert family.prices[0].memory.ratio == pytest.approx(1.1)


_VALUES = st.none() | st.floats(0.1, 10)


@given(st.lists(st.fixed_dictionaries(dict.fromkeys((*GPU_MEMORY, HOST_MEMORY.name), _VALUES)), min_size=1, max_size=4))
def test_a_common_source(values: list[dict[str, float | None]]) -> None:
    """Choose a metric that all groups have, the published first, before one that only some have."""
    groups: list[Mapping[str, Estimate]] = [
        {
            name: missing(METRICS[name], "not sampled") if value is None else Estimate(METRICS[name], value)
            for name, value in one.items()
        }
        for one in values
    ]
    everyones = [name for name in GPU_MEMORY if all(one[name] is not None for one in values)]
    anyones = [name for name in GPU_MEMORY if any(one[name] is not None for one in values)]
    chosen = common_memory(groups)
    assert chosen == everyones[0] if everyones else chosen in (anyones or [HOST_MEMORY.name])


_AMOUNT = st.integers(0, 8 * GB)


@given(
    idle=st.integers(0, GB),
    others=st.lists(_AMOUNT, min_size=4, max_size=4),
    own=st.lists(_AMOUNT, min_size=3, max_size=3),
    beside=st.lists(st.integers(0, 200 * MB), min_size=3, max_size=3),
    told=st.booleans(),
    peer=st.none() | st.integers(0, GB),
)
def test_a_sign_is_true(
    idle: int, others: list[int], own: list[int], beside: list[int], told: bool, peer: int | None
) -> None:
    """Claim no more than others held, whatever the engine holds that NVML attributes to nobody."""
    held = [idle + others[0]] + [idle + o + p + b for o, p, b in zip(others[1:], own, beside, strict=True)]
    device = Checkpoints(held[0], held[1], held[2], max(held[2], held[3]), held[3])
    process = Checkpoints(None, own[0], own[1], max(own[1:]), own[2]) if told else None
    found = cotenants(GpuMemory(device, process), peers_of([], idle_bytes=None if peer is None else idle + peer))
    for sign in found.signs:
        assert sign.moment == BASELINE
        assert 0 < sign.bytes <= others[0]
    assert found.presence is (Presence.SOME if found.signs else Presence.UNKNOWN)


@given(st.lists(st.none() | st.integers(0, 3), min_size=4, max_size=4), st.booleans())
def test_unknown_is_not_none(counts: list[int | None], reserved: bool) -> None:
    """Say none only where every moment was looked at, and some wherever one was listed."""
    moments = ("baseline", "post-init", "timed", "final")
    listed = {m: Listing(c, None) for m, c in zip(moments, counts, strict=True) if c is not None}
    device = Checkpoints(GB, 2 * GB, None, 2 * GB, 2 * GB)
    found = cotenants(GpuMemory(device, None, listed, GB if reserved else None))
    expected = Presence.SOME if any(counts) else Presence.NONE if reserved and None not in counts else Presence.UNKNOWN
    assert found.presence is expected


@pytest.mark.parametrize("more", [0, 1])
def test_how_many_bytes_are_a_process(more: int) -> None:
    """Take 32 MiB at the baseline, and later 256 MiB beyond a like run, for what runs differ by; a byte more is one."""
    at_baseline = GB + (32 << 20) + more
    device = Checkpoints(at_baseline, 2 * GB, 2 * GB, 2 * GB, 2 * GB)
    found = cotenants(GpuMemory(device, None, {}, GB))
    assert [(sign.moment, sign.bytes) for sign in found.signs] == [(BASELINE, (32 << 20) + 1)] * more
    device = Checkpoints(GB, 2 * GB, 2 * GB, 3 * GB, 2 * GB + (256 << 20) + more)
    process = Checkpoints(None, GB, GB, GB, GB)
    found = cotenants(GpuMemory(device, process), Peers(None, {"post-init": GB, "final": GB}))
    assert [(sign.moment, sign.bytes) for sign in found.signs] == [("final", (256 << 20) + 1)] * more
