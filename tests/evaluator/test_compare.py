"""gsb-compare as a user calls it, on recordings whose answer is known."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusimbench.evaluator.cli.compare import main
from gpusimbench.evaluator.statistics import exchange
from gpusimbench.schemas.provenance import PROVENANCE, SIMULATION
from tests.synthetic import Shown, changing, cubes_field, grid, write_recording

ROOT = Path(__file__).resolve().parents[2]
RECORDINGS = ROOT / "recordings"
TURNS = "ABBAABBAABBA"
NOISE = np.array([0.01, -0.02, 0.015, -0.005, 0.0, 0.02])
EXPECT_SAME = "--expect-same"
EDITED = changing(SIMULATION, "scene", sha256="ed" * 32)


def stamped(second: int, host: dict[str, Any] | None = None) -> Any:
    """A change of the provenance: made at that second, on that host."""

    def change(name: str, record: dict[str, Any]) -> None:
        if name == PROVENANCE:
            record["created_utc"] = f"2026-01-01T00:{second // 60:02d}:{second % 60:02d}Z"
            record["host"] = host or record["host"]

    return change


def write_sides(
    folder: Path, base: Sequence[dict[str, Any]], head: Sequence[dict[str, Any]], order: str = TURNS, **common: Any
) -> tuple[Path, Path]:
    """Two folders of recordings that were made in that order, a second apart; one dictionary a run."""
    sides = {"A": list(base), "B": list(head)}
    folders = {"A": folder / "base", "B": folder / "head"}
    for place in folders.values():
        place.mkdir(parents=True)
    counted = {"A": 0, "B": 0}
    for second, letter in enumerate(order):
        keywords = {"final": None, **common, **sides[letter][counted[letter]]}
        host = keywords.pop("host", None)
        write_recording(folders[letter], run=counted[letter], change=stamped(second, host), **keywords)
        counted[letter] += 1
    assert counted == {name: len(side) for name, side in sides.items()}
    return folders["A"], folders["B"]


def timed(factor: float = 1.0, **more: Any) -> list[dict[str, Any]]:
    """Six runs that take about a second, times a factor."""
    return [{"elapsed_s": factor * float(np.exp(noise)), **more} for noise in NOISE]


def compared(*arguments: object, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any]]:
    """Exit code and JSON of the command."""
    code = main([*map(str, arguments), "--json", "-", "--no-cache"])
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert found["exit_code"] == code
    return code, found


def finding(document: dict[str, Any], name: str, index: int = 0) -> dict[str, Any]:
    """The finding of that name."""
    (found,) = [f for f in document["compared"][index]["findings"] if f["name"] == name]
    return dict(found)


def test_head_that_is_slower(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 4 for a fifth more time, and give ratio, interval and p."""
    code, document = compared(*write_sides(tmp_path, timed(), timed(1.2)), capsys=capsys)
    fps = finding(document, "fps")
    assert (code, fps["change"], fps["fails"]) == (4, "regression", True)
    assert fps["ratio"] == pytest.approx(1 / 1.2)
    assert fps["base"] == pytest.approx(1000 / np.exp(np.mean(NOISE)))  # env-steps in about a second
    assert fps["head"] == pytest.approx(fps["base"] / 1.2)
    assert fps["ci95"][0] < fps["ratio"] < fps["ci95"][1] < 1
    assert fps["p_value"] == pytest.approx(2 / 64)  # of six pairs
    assert document["compared"][0]["order"] == TURNS
    assert document["verdict"].startswith("REGRESSION: throughput")


def test_head_that_is_faster_never_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 0 for a gain, however large, and say so; only who expects the same is told otherwise."""
    sides = write_sides(tmp_path, timed(), timed(0.2))
    code, document = compared(*sides, capsys=capsys)
    assert (code, finding(document, "fps")["change"]) == (0, "improvement")
    code, document = compared(*sides, EXPECT_SAME, capsys=capsys)
    assert (code, document["verdict"].split(":")[0]) == (4, "NOT THE SAME")


def test_a_certain_change_below_the_threshold(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Show a change of 1 % that is certain, but let it pass; the threshold may be smaller."""
    quiet = [{"elapsed_s": 1.0 + 1e-5 * i} for i in range(6)]
    slower = [{"elapsed_s": 1.01 + 1e-5 * i} for i in range(6)]
    sides = write_sides(tmp_path, quiet, slower)
    code, document = compared(*sides, capsys=capsys)
    assert (code, finding(document, "fps")["change"]) == (0, "below threshold")
    code, document = compared(*sides, "--threshold", "0.5%", capsys=capsys)
    assert (code, finding(document, "fps")["change"]) == (4, "regression")


def test_noise_is_no_change(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 0 for the same runs in another order, with the interval around one."""
    mixed = [timed()[i] for i in (3, 1, 5, 0, 2, 4)]
    sides = write_sides(tmp_path, timed(), mixed)
    for arguments in ((), (EXPECT_SAME,)):
        code, document = compared(*sides, *arguments, capsys=capsys)
        fps = finding(document, "fps")
        assert (code, fps["change"], fps["left_open"]) == (0, "within threshold", [])
        assert 1 / 1.05 < fps["ci95"][0] < 1 < fps["ci95"][1] < 1.05


def test_drift_that_turns_cancel(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """See 10 % through a clock that slows by half on the way, and warn where base came wholly before head."""
    order = TURNS * 2
    times = {"A": [], "B": []}  # type: ignore[var-annotated]
    for i, letter in enumerate(order):
        times[letter].append({"elapsed_s": (1 + i / len(order) / 2) * (1.1 if letter == "B" else 1.0)})
    code, document = compared(*write_sides(tmp_path / "turns", times["A"], times["B"], order), capsys=capsys)
    fps = finding(document, "fps")
    assert (code, fps["change"]) == (4, "regression")
    assert fps["ratio"] == pytest.approx(1 / 1.1, rel=0.01)
    assert "blocks of neighbours" in fps["test"]

    sides = write_sides(tmp_path / "row", timed(), timed(), "AAAAAABBBBBB")
    _, document = compared(*sides, capsys=capsys)
    assert not document["compared"][0]["interleaved"]
    assert document["compared"][0]["warnings"][1:] == [
        "base and head were not recorded in turn (AAAAAABBBBBB): drift of the machine cannot be told from a change"
    ]


@pytest.mark.parametrize(
    ("order", "words"), [("AAAAAABBBBBB", "improvement, or drift"), ("ABBAABBAABBA", "improvement")]
)
def test_an_order_that_leaves_two_causes(
    order: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Say of a throughput that rose that drift may be the cause, unless the sides were recorded in turn."""
    base, head = write_sides(tmp_path, timed(2.0), timed(), order)
    main(["--base", str(base), "--head", str(head)])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("throughput")]
    assert line.endswith(words)


def test_few_runs_that_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Count the runs of either side, and leave the amount of a change open that so few runs give no interval of."""
    sides = write_sides(tmp_path, timed()[:4], timed(2.0)[:3], "ABABABA")
    code, document = compared(*sides, "--alpha", "0.9", capsys=capsys)
    fps = finding(document, "fps")
    assert (fps["ci95"], fps["change"], fps["left_open"]) == (None, "near threshold", ["regression", "improvement"])
    said = "few complete runs (4 of base, 3 of head): record at least 6 a side"
    assert said in document["compared"][0]["warnings"]


def test_orders_that_are_worse_than_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Warn where one side always came first, and where all recordings are of one second."""
    _, document = compared(*write_sides(tmp_path / "first", timed(), timed(), "AB" * 6), capsys=capsys)
    assert document["compared"][0]["interleaved"]
    assert document["compared"][0]["warnings"][1:] == [
        "one side always came first (ABABABABABAB): a steady drift favours one; A B B A cancels it"
    ]
    for side in ("base", "head"):
        (tmp_path / side).mkdir()
        for run in timed():
            write_recording(tmp_path / side, None, change=stamped(0), **run)
    _, document = compared(tmp_path / "base", tmp_path / "head", capsys=capsys)
    assert not document["compared"][0]["interleaved"]
    assert any("do not say in which order" in line for line in document["compared"][0]["warnings"])


@pytest.mark.parametrize("more", [{}, {"host_bytes": (10**8, 2 * 10**8)}, {"final": grid(2)}], ids=len)
def test_few_runs_are_said_to_be_few(more: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 5 for three runs a side, a third slower, whatever else they agree in; warn with the smallest p there is."""
    base, head = ([{"elapsed_s": f * s, **more} for s in (1.0, 1.005, 0.995)] for f in (1.0, 1.515))
    sides = write_sides(tmp_path, base, head, "ABBAAB")
    code, document = compared(*sides, capsys=capsys)
    fps = finding(document, "fps")
    assert (code, fps["least_p"], fps["p_adjusted"], fps["undecided"]) == (5, 0.1, None, "too few runs")
    assert fps["ratio"] == pytest.approx(0.66, rel=1e-3)
    assert document["undecided"] == ["throughput"]
    assert document["verdict"].startswith("NOT DECIDED: throughput (1 finding")
    assert any("smallest p possible: 0.1" in line for line in document["compared"][0]["warnings"])


@pytest.mark.parametrize(
    ("slower", "noise", "code", "change"),
    [
        (1.0, 0.1, 0, "within threshold"), (1.03, 0.1, 0, "below threshold"), (1.051, 0.1, 5, "near threshold"),
        (1.06, 0.1, 4, "regression"), (1.06, 1.0, 5, "near threshold"), (1.2, 1.0, 4, "regression"),
        (1.0, 10.0, 5, "not distinguishable"), (1.2, 10.0, 5, "not distinguishable"),
        (1 / 1.051, 0.1, 0, "near threshold"), (1 / 1.2, 1.0, 0, "improvement"),
    ],
)  # fmt: skip
def test_the_interval_is_held_against_the_threshold(
    slower: float, noise: float, code: int, change: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Fail what lies wholly beyond the threshold, pass what lies wholly before it, and decide nothing between."""
    base, head = ([{"elapsed_s": f * float(np.exp(noise * n))} for n in NOISE] for f in (1.0, slower))
    found, document = compared(*write_sides(tmp_path, base, head[3:] + head[:3]), capsys=capsys)
    fps = finding(document, "fps")
    assert (found, fps["change"]) == (code, change)
    assert bool(fps["undecided"]) is (code == 5)
    assert document["undecided"] == (["throughput"] if code == 5 else [])
    low, high = fps["ci95"]
    assert {4: high < 1 / 1.05, 0: low > 1 / 1.05, 5: low < 1 / 1.05 < high}[code]


def test_a_gate_that_is_left_open_beside_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """End with 4 where another gate fails, with 5 where none does; leave out what has no gate or is on neither side."""
    noisy = [{"elapsed_s": run["elapsed_s"] ** 20} for run in timed()]
    gpu = [{**run, "gpu_bytes": (10**9, 2 * 10**9)} for run in noisy]
    code, document = compared(*write_sides(tmp_path / "open", noisy, noisy[::-1]), capsys=capsys)
    assert (code, document["undecided"]) == (5, ["throughput"])
    assert finding(document, "memory_peak_increment")["applies"] is False
    larger = [{**run, "host_bytes": (10**8, 3 * 10**8)} for run in noisy[::-1]]
    sides = write_sides(tmp_path / "fails", [{**run, "host_bytes": (10**8, 2 * 10**8)} for run in noisy], larger)
    code, document = compared(*sides, capsys=capsys)
    assert (code, document["undecided"]) == (4, ["throughput"])
    assert document["verdict"].endswith("; not decided: throughput")
    code, document = compared(*sides[::-1], "--gate", "memory", capsys=capsys)
    assert (code, document["undecided"]) == (0, [])
    one_side = write_sides(tmp_path / "one", gpu, noisy)
    code, document = compared(*one_side, "--gate", "memory", capsys=capsys)
    assert (code, finding(document, "memory_peak_increment")["applies"]) == (5, True)


def test_memory_that_others_spoilt_on_both_sides(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Leave GPU memory undecided where no run of either side can be used, and leave it out where there is no GPU."""
    shared = timed(gpu_bytes=(10**9, 2 * 10**9), others=(2, 2), host_bytes=(10**8, 2 * 10**8))
    code, document = compared(*write_sides(tmp_path / "gpu", shared, shared), capsys=capsys)
    memory = finding(document, "memory_peak_increment")
    assert (code, document["undecided"], memory["change"], memory["applies"]) == (5, ["memory"], "not compared", True)
    cpu = timed(host_bytes=(10**8, 2 * 10**8))
    code, document = compared(*write_sides(tmp_path / "cpu", cpu, cpu), capsys=capsys)
    assert (code, finding(document, "memory_peak_increment")["applies"]) == (0, False)


def test_four_runs_a_side(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Let four runs a side pass and fail by default, where one comparison counts, as docs/compare.md says."""
    for name, factor, codes in (("same", 1.0, (0, 0)), ("slower", 1.34, (5, 4))):
        more = [{"host_bytes": (10**8, 2 * 10**8 + 10**6 * i)} for i in range(4)]
        base, head = (
            [{"elapsed_s": f * float(np.exp(n / 10)), **m} for n, m in zip(NOISE[:4], more[::step], strict=True)]
            for f, step in ((1.0, 1), (factor, -1))
        )
        sides = write_sides(tmp_path / name, base, head, "ABBAABBA")
        for arguments, code in zip(((), ("--gate", "throughput")), codes, strict=True):
            found, document = compared(*sides, *arguments, capsys=capsys)
            assert found == code, (name, arguments, finding(document, "fps"))


def test_equal_bytes_are_no_statistics(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say that memory is the same, or another, where every run of a side has one value; a megabyte is nothing."""
    gpu = (10**9, 10**9 + 800_000_000)
    for name, more, change, code in (
        ("same", 0, "same", 0), ("more", 100_000_000, "regression", 4), ("less", -100_000_000, "improvement", 0),
        ("hardly", 30_000_000, "below threshold", 0),
    ):  # fmt: skip
        sides = write_sides(tmp_path / name, timed(gpu_bytes=gpu), timed(gpu_bytes=(gpu[0], gpu[1] + more)))
        found, document = compared(*sides, capsys=capsys)
        memory = finding(document, "memory_peak_increment")
        assert (found, memory["change"], memory["p_value"]) == (code, change, None), name
        assert memory["ratio"] == pytest.approx((800_000_000 + more) / 800_000_000)
        assert ("in 0.0022 of all cases" in memory["note"]) is (name != "same")
    little = write_sides(
        tmp_path / "little", timed(host_bytes=(10**8, 10**8 + 1000)), timed(host_bytes=(10**8, 10**8 + 9000))
    )
    code, document = compared(*little, capsys=capsys)
    assert (code, finding(document, "host_memory_peak_increment")["change"]) == (0, "below threshold")


def test_memory_that_was_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compare amounts where a logarithm cannot be had: from nothing to 50 MB, in some runs or in all."""
    none = timed(host_bytes=(10**8, 10**8))
    some = timed(host_bytes=(10**8, 15 * 10**7))
    code, document = compared(*write_sides(tmp_path / "all", none, some), capsys=capsys)
    host = finding(document, "host_memory_peak_increment")
    assert (code, host["change"], host["ratio"]) == (4, "regression", None)
    some[0]["host_bytes"] = (10**8, 10**8 + 49_000_000)
    code, document = compared(*write_sides(tmp_path / "most", none, some), capsys=capsys)
    host = finding(document, "host_memory_peak_increment")
    assert (code, host["change"], host["p_value"]) == (4, "regression", pytest.approx(2 / 216))


def test_runs_that_fail_now(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 4 for a run of head that is invalid, and 0 where it was one of base."""
    bad = [*timed()[:5], {**timed()[5], "status": "INVALID", "reason": "contacts were dropped", "cause": "BUFFER"}]
    code, document = compared(*write_sides(tmp_path / "worse", timed(), bad), capsys=capsys)
    assert (code, finding(document, "complete_runs")["change"]) == (4, "regression")
    assert "1 INVALID" in finding(document, "complete_runs")["said"]["head"]
    code, document = compared(*write_sides(tmp_path / "better", bad, timed()), capsys=capsys)
    assert (code, finding(document, "complete_runs")["change"]) == (0, "improvement")
    code, document = compared(*write_sides(tmp_path / "both", bad, bad), capsys=capsys)
    assert (code, finding(document, "complete_runs")["change"]) == (0, "not distinguishable")


def test_runs_that_fail_on_both_sides(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Call it a regression where one run of ten failed and nine do now, and an improvement the other way round."""
    broken = {"status": "INVALID", "reason": "contacts were dropped", "cause": "BUFFER"}
    few, many = ([broken if i < bad else {} for i in range(10)] for bad in (1, 9))
    for name, sides, ended, change in (
        ("worse", (few, many), (9, 1), "regression"),
        ("better", (many, few), (1, 9), "improvement"),
    ):
        _, document = compared(*write_sides(tmp_path / name, *sides, "AB" * 10), capsys=capsys)
        runs = finding(document, "complete_runs")
        assert (runs["base"], runs["head"], runs["change"]) == (*ended, change)


def test_contacts_that_are_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 4 for steps that are fast because they drop their contacts; a count beyond all measure is not compared."""

    def counted(values: Sequence[float]) -> list[dict[str, Any]]:
        return [
            {**run, "shown": Shown(counts={"timed": {"contacts": np.full((1, 1), value)}})}  # type: ignore[arg-type]
            for run, value in zip(timed(), values, strict=True)
        ]

    sides = write_sides(tmp_path / "lost", counted([27] * 6), counted([13] * 6))
    code, document = compared(*sides, capsys=capsys)
    assert (code, finding(document, "contacts")["change"], finding(document, "contacts")["p_value"]) == (
        4,
        "changed",
        None,
    )
    sides = write_sides(tmp_path / "absurd", counted([1e-300] * 6), counted([1.0] * 6))
    code, document = compared(*sides, capsys=capsys)
    assert (code, finding(document, "contacts")["change"]) == (5, "not compared")


def test_head_that_never_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Find the partner of a group of which nothing was built, and exit 4."""
    dead = [{"built": False, "status": "FAILED", "reason": "no memory", "cause": "DEVICE_MEMORY"}] * 6
    code, document = compared(*write_sides(tmp_path, timed(), dead), capsys=capsys)
    assert (code, finding(document, "complete_runs")["change"]) == (4, "regression")
    assert finding(document, "fps")["missing"] == "no run of this group is complete"


def spread(seed: int, by: float = 0.0, size: float = 0.003) -> Any:
    """Final positions of four environments, each its own draw of a size [m], cubes moved along x."""
    final = grid(4) + size * np.random.default_rng(seed).normal(size=(4, 27, 3))
    final[..., 0] += by
    return final


def test_outcomes_of_runs_that_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tell a shift of 1 cm from what runs of one law do, and say nothing where there is none."""
    base = [{"final": spread(i)} for i in range(6)]
    for name, by, code, change in (("shifted", 0.01, 4, "changed"), ("same", 0.0, 0, "not distinguishable")):
        head = [{"final": spread(i, by)} for i in range(6, 12)]
        found, document = compared(*write_sides(tmp_path / name, base, head, elapsed_s=None), capsys=capsys)
        outcome = finding(document, "outcome")
        assert (found, outcome["change"]) == (code, change)
        assert finding(document, "fps")["missing"] == "the timed phase was left out"
        assert "differ from each other" in finding(document, "states")["missing"]
    assert outcome["least_p"] == 2 / 924


@pytest.mark.parametrize(
    ("head", "said"),
    [((2, 3), "0 of their histories are"), ((0, 3), "1 of their histories is"), ((0, 1), "2 of their histories are")],
)
def test_histories_that_are_on_both_sides(
    head: tuple[int, int], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Count the histories that occur on both sides, where runs of one differ and no bits can be compared."""
    sides = [[{"final": spread(i)} for i in seeds] for seeds in ((0, 1), head)]
    _, document = compared(*write_sides(tmp_path, *sides, "ABBA", elapsed_s=None), capsys=capsys)
    assert finding(document, "states")["missing"] == f"runs of base differ from each other; {said} on both sides"


def test_other_numbers_of_cubes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say why ends cannot be compared where one side recorded fewer cubes, whichever side that is."""
    whole = cubes_field("float64")
    all_of_them = [{"final": spread(i)} for i in range(2)]
    fewer = [{"final": spread(i)[:, :26], "field": replace(whole, items=whole.items[:26])} for i in range(2, 4)]
    for name, sides in (("fewer", (all_of_them, fewer)), ("more", (fewer, all_of_them))):
        _, document = compared(*write_sides(tmp_path / name, *sides, "ABBA", elapsed_s=None), capsys=capsys)
        outcome = finding(document, "outcome")
        assert (outcome["change"], outcome["missing"]) == (
            "not compared",
            "the runs have different numbers of environments or bodies",
        )


def test_variability_that_falls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Call a tenth of the spread, between environments and between runs, an improvement."""
    sides = [
        [{"final": spread(i, size=size)} for i in runs] for size, runs in ((0.03, range(6)), (0.003, range(6, 12)))
    ]
    _, document = compared(*write_sides(tmp_path, *sides, elapsed_s=None), capsys=capsys)
    assert {finding(document, name)["change"] for name in ("w1_parallel", "w1_run_to_run")} == {"improvement"}


def test_exchanges_that_are_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Say how many ways to exchange the runs were drawn, where they are too many to go through."""
    monkeypatch.setattr(exchange, "MOST_DEALINGS", 100)
    sides = [[{"final": spread(i)} for i in runs] for runs in (range(6), range(6, 12))]
    _, document = compared(*write_sides(tmp_path, *sides, elapsed_s=None), capsys=capsys)
    for name in ("outcome", "w1_run_to_run"):
        assert f"({exchange.DRAWN} ways drawn with seed " in finding(document, name)["test"]


def test_outcomes_to_the_bit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say for certain that bits are the same or are not, and gate bits only where that is asked for."""
    base = [{"final": grid(3)}] * 2
    _, document = compared(*write_sides(tmp_path / "same", base, base, "ABBA"), EXPECT_SAME, capsys=capsys)
    assert finding(document, "outcome")["change"] == finding(document, "states")["change"] == "same"
    assert document["exit_code"] == 0
    nudged = grid(3)
    nudged[..., 2] = np.nextafter(nudged[..., 2], 1)  # heights are no part of the outcome
    sides = write_sides(tmp_path / "bits", base, [{"final": nudged}] * 2, "ABBA")
    code, document = compared(*sides, capsys=capsys)
    states = finding(document, "states")
    assert (code, states["change"], states["gated"]) == (0, "changed", False)
    assert states["said"]["head"] == "differ from step 5 on"
    for arguments in ((EXPECT_SAME,), ("--gate", "bits")):
        code, document = compared(*sides, *arguments, capsys=capsys)
        assert (code, finding(document, "states")["fails"]) == (4, True)


def test_determinism_that_is_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 4 where environments and runs were bit-identical and are not, and 0 the other way round."""
    alike, apart = [{"final": grid(4)}] * 3, [{"final": spread(i)} for i in range(3)]
    code, document = compared(*write_sides(tmp_path / "lost", alike, apart, "ABBAAB"), capsys=capsys)
    assert code == 4
    for name in ("distinct_envs", "distinct_runs"):
        assert finding(document, name)["change"] == "regression"
    note = "3 bit-identical runs: another one differs in some bit with a probability below 78 % (95 % confidence)"
    assert finding(document, "distinct_runs")["note"] == note  # 1 - 0.05^(1/2)
    code, document = compared(
        *write_sides(tmp_path / "won", apart, alike, "ABBAAB"), "--gate", "determinism", capsys=capsys
    )
    assert code == 0
    assert finding(document, "distinct_runs")["change"] == "improvement"


def test_one_environment_leaves_nothing_to_decide(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Leave no gate open because a single environment has no second one to be like; runs that are missing do."""
    one = [{"final": grid(1)}]
    dead = [{"built": False, "status": "FAILED", "reason": "no memory", "cause": "DEVICE_MEMORY"}]
    for name, base, head, order, undecided in (
        ("alike", one * 3, one * 3, "ABBAAB", {"distinct_envs": False}),
        ("few", one, one, "AB", {"distinct_envs": False, "distinct_runs": True}),
        ("dead", one * 2, dead * 2, "ABBA", {"distinct_envs": True, "distinct_runs": True}),
    ):
        _, document = compared(*write_sides(tmp_path / name, base, head, order, elapsed_s=None), capsys=capsys)
        for what, is_open in undecided.items():
            found = finding(document, what)
            assert (found["change"], bool(found["undecided"])) == ("not compared", is_open), (name, what)
        if name == "dead":
            between = finding(document, "w1_run_to_run")
            assert (between["change"], between["applies"]) == ("not compared", True)


def test_another_machine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Leave out speed and memory of other machines, and still compare bits."""
    head = timed(9.0, host={"cpu": "another"}, final=grid(2))
    code, document = compared(*write_sides(tmp_path, timed(final=grid(2)), head), capsys=capsys)
    assert (code, document["undecided"]) == (5, ["throughput"])
    assert compared(tmp_path / "base", tmp_path / "head", "--gate", "physics,bits", capsys=capsys)[0] == 0
    assert not document["compared"][0]["same_machine"]
    assert "different machines" in finding(document, "fps")["missing"]
    assert any(
        "gsb-eval BASE HEAD shows both machines side by side" in one for one in document["compared"][0]["warnings"]
    )
    assert finding(document, "states")["change"] == "same"


def test_what_has_no_partner(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """List groups that only one side has, exit 5 where that is all, and allow a difference that was named."""
    base, head = write_sides(tmp_path, timed(), timed(options={"cone": "pyramidal"}))
    code, document = compared(base, head, capsys=capsys)
    assert (code, document["verdict"], document["compared"]) == (5, "NOTHING COMPARED", [])
    assert {one["side"] for one in document["without_partner"]} == {"base", "head"}
    said = "the other side has no group of the same configuration; the most similar group differs in"
    reason = document["without_partner"][0]["reason"]
    assert reason == f"{said} cone: unset -> pyramidal; --across cone compares the two"
    far = write_recording(base, None, n_env=9, dt=0.5, change=stamped(97))
    of_far = compared(base, head, capsys=capsys)[1]["without_partner"][1]["reason"]
    across = "--across n_env --across dt --across cone"
    assert of_far == f"{said} n_env: 9 -> 1, dt: 0.5 -> 1.0, cone: unset -> pyramidal; {across} compares the two"
    told = compared(base, head, "--across", "dt", capsys=capsys)[1]["without_partner"][1]["reason"]
    assert told.endswith("cone: unset -> pyramidal; --across dt --across n_env --across cone compares the two")
    far.unlink()

    def begun_otherwise(name: str, record: dict[str, Any]) -> None:
        stamped(97)(name, record)
        if name == PROVENANCE:
            record["configuration"]["initial"] = "random:0.1"

    far = write_recording(base, None, n_env=9, change=begun_otherwise)
    of_far = compared(base, head, capsys=capsys)[1]["without_partner"][1]["reason"]
    assert "initial: " in of_far and "--across" not in of_far  # which takes no initial states
    far.unlink()
    more = write_recording(base, None, n_env=9, change=stamped(98))
    code, document = compared(base, head, "--across", "cone", capsys=capsys)
    assert (code, document["verdict"].rpartition("; ")[2]) == (0, "1 configuration without a partner")
    more.unlink()
    code, document = compared(base, head, "--across", "cone", capsys=capsys)
    assert code == 0
    assert document["compared"][0]["differs"] == ["cone: unset -> pyramidal"]
    write_recording(base, None, change=stamped(99), environment={"XLA_FLAGS": "--x"})
    write_recording(base, None, change=stamped(99), environment={"XLA_FLAGS": "--y"})
    code, document = compared(base, head, "--across", "cone", capsys=capsys)
    assert code == 5
    assert "several groups" in document["without_partner"][0]["reason"]


def test_an_edited_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compare two descriptions of a scene, and two scenes, where that is asked for: at one time, however long each is.

    Cubes move at the same speed in all runs, so that states that were sampled at different times would lie apart.
    """

    def moving(_: Any, step: int) -> Any:
        return grid(2) + np.array([0.01 * step, 0.0, 0.0])

    for run in range(2):
        sides: tuple[tuple[str, int, dict[str, Any]], ...] = (
            ("base", 3, {}), ("edited", 3, {"change": EDITED}), ("other", 4, {"scene": "free-fall"}),
        )  # fmt: skip
        for side, steps, changes in sides:
            (tmp_path / side).mkdir(exist_ok=True)
            common: dict[str, Any] = {"run": run, "steps": steps, "path_of": moving, "elapsed_s": None}
            write_recording(tmp_path / side, moving(None, steps), **common, **changes)
    code, document = compared(tmp_path / "base", tmp_path / "edited", capsys=capsys)
    assert (code, document["verdict"]) == (5, "NOTHING COMPARED")
    said = "the description of the scene differs on the other side; --across scene compares the two"
    assert document["without_partner"][0]["reason"] == said
    for head, differs in (("edited", 1), ("other", 2)):
        _, document = compared(tmp_path / "base", tmp_path / head, "--across", "scene", capsys=capsys)
        assert len(document["compared"][0]["differs"]) == differs
        assert finding(document, "outcome")["change"] == "same", head
        assert finding(document, "states")["change"] == "not compared"
    said = (
        "free-fall: positions are compared at 3 s, the last time that the recordings of all scenes have; none has 5 s"
    )
    assert said in document["notes"]


def test_several_edited_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compare each scene with its own edited version, though any scene may be compared with any other."""

    sides = (tmp_path / "base", tmp_path / "head")
    for side, changes in zip(sides, ({}, {"change": EDITED}), strict=True):
        side.mkdir()
        for run, scene in enumerate(("inclined-collision", "free-fall")):
            write_recording(side, grid(2), run=run, scene=scene, elapsed_s=None, **changes)
    _, document = compared(*sides, "--across", "scene", capsys=capsys)
    assert not document["without_partner"]
    assert [len(one["differs"]) for one in document["compared"]] == [1, 1]
    assert all("description of the scene" in one["differs"][0] for one in document["compared"])


def test_another_time_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compare two time steps where that is asked for: bodies at one time, and no bits; say that steps are not equal."""

    def moving(dt: float) -> Callable[[Any, int], Any]:
        return lambda _, step: grid(2) + np.array([step * dt, 0.0, 0.0])

    for run in range(2):
        for side, dt, steps in (("base", 0.01, 4), ("head", 0.005, 8)):
            (tmp_path / side).mkdir(exist_ok=True)
            write_recording(
                tmp_path / side, moving(dt)(None, steps), run=run, dt=dt, steps=steps, path_of=moving(dt), elapsed_s=1.0
            )
    code, document = compared(tmp_path / "base", tmp_path / "head", capsys=capsys)
    assert code == 5
    assert document["without_partner"][0]["reason"].endswith("dt: 0.01 -> 0.005; --across dt compares the two")
    _, document = compared(tmp_path / "base", tmp_path / "head", "--across", "dt", capsys=capsys)
    assert "dt: 0.01 -> 0.005" in document["compared"][0]["differs"]
    assert finding(document, "outcome")["change"] == "same"
    assert finding(document, "states")["change"] == "not compared"
    said = "throughput is NOT comparable: it counts steps of 0.01 s in base, and of 0.005 s in head"
    assert said in document["compared"][0]["warnings"]


def test_versions_are_what_is_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Pair groups whose environment variables and options in force differ, and say what does."""
    head = timed(environment={"XLA_FLAGS": "--new"}, switches={"precision": "high"})
    code, document = compared(*write_sides(tmp_path, timed(), head), capsys=capsys)
    assert code == 0
    assert set(document["compared"][0]["differs"]) == {"XLA_FLAGS: unset -> --new", "precision: unset -> high"}


def test_the_first_differences_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Name twelve switches that differ, and count the others."""
    switches = {f"switch{i:02d}": "on" for i in range(14)}
    for count, more in ((12, []), (14, ["and 2 more"])):
        head = timed(switches=dict(list(switches.items())[:count]))
        _, document = compared(*write_sides(tmp_path / str(count), timed(), head), capsys=capsys)
        expected = [f"switch{i:02d}: unset -> on" for i in range(12)]
        assert document["compared"][0]["differs"] == [*expected, *more]


def test_commits_of_the_recorder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Name at most three commits of a side, twelve digits of each, and mark those with changes of their own."""
    for side, letters in (("base", "aa"), ("head", "edcb")):
        (tmp_path / side).mkdir()
        for run, letter in enumerate(letters):
            recorder = {"commit": 40 * letter, "modified": letter == "b"}
            change = changing(PROVENANCE, software={"recorder": recorder})
            write_recording(tmp_path / side, None, run=run, change=change)
    _, document = compared(tmp_path / "base", tmp_path / "head", capsys=capsys)
    commits = f"{12 * 'b'}+, {12 * 'c'}, {12 * 'd'}"
    assert document["compared"][0]["differs"] == [f"commit of the recorder: {12 * 'a'} -> {commits}"]


def test_the_exit_codes_of_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 3 for a damaged file or a run that was cut short, 4 where a gate fails beside it."""
    base, head = write_sides(tmp_path / "good", timed(), timed())
    (base / "broken.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    code, document = compared(base, head, capsys=capsys)
    assert (code, document["unreadable"][0]["side"]) == (3, "base")
    assert finding(document, "fps")["change"] == "within threshold"
    base, head = write_sides(tmp_path / "slow", timed(), timed(2.0))
    write_recording(base, None, end=False, change=stamped(99))
    code, document = compared(base, head, capsys=capsys)
    assert (code, finding(document, "fps")["change"]) == (4, "regression")
    assert "6 of 7" in finding(document, "complete_runs")["said"]["base"]
    assert compared(base, head, "--gate", "bits", capsys=capsys)[0] == 3


@pytest.mark.parametrize(
    "arguments",
    [
        (), ("one",), ("one", "two", "three"), ("one", "--base", "a", "--head", "b"), ("--base", "a"),
        ("base", "head", "--gate", "speed"), ("base", "head", "--gate", ","), ("base", "head", "--alpha", "1"),
        ("base", "head", "--outcome", "-1"), ("base", "head", "--across", "nothing"), ("base", "base"),
        ("base", "empty"), ("base", "head", "--json", "x.mcap"), ("base", "head", "--junit", "nowhere/x.xml"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_wrong_usage(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 2 with one line that says what to do."""
    write_sides(tmp_path, timed()[:1], timed()[:1], "AB")
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    assert main([*arguments, "--no-cache"]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("gsb-compare: ")
    assert len(shown.err.splitlines()) == 1
    assert not shown.out


def test_lists_of_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Take lists of files, in any order, with the same result; a copy counts once."""
    base, head = write_sides(tmp_path, timed(), timed(1.3))
    (base / "copy.mcap").write_bytes(sorted(base.glob("*.mcap"))[0].read_bytes())
    _, folders = compared(base, head, capsys=capsys)
    assert folders["compared"][0]["base"]["n_run"] == 6
    files = [sorted(side.glob("*.mcap"), reverse=True) for side in (base, head)]
    _, lists = compared("--head", *files[1], "--base", *files[0], capsys=capsys)
    assert lists["compared"][0]["findings"] == folders["compared"][0]["findings"]


@pytest.mark.slow
def test_shipped_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Call another friction cone a change of physics, and two machines of one engine the same to the bit."""
    amd, xeon, other = (
        sorted(RECORDINGS.glob(f"mujoco-{name}-*.mcap")) for name in ("amd", "xeon", "pyramidal")
    )  # fmt: skip
    code, document = compared("--base", *amd, "--head", *other, "--across", "cone", capsys=capsys)
    assert (code, finding(document, "outcome")["change"]) == (4, "changed")
    assert finding(document, "states")["said"]["head"] == "differ from step 1 on"
    assert [f["axis"] for f in document["compared"][0]["findings"] if f["fails"]] == ["physics"]
    sides = ("--base", *amd, "--head", *xeon, EXPECT_SAME)
    assert compared(*sides, capsys=capsys)[0] == 5
    code, document = compared(*sides, "--gate", "physics,validity,determinism,bits", capsys=capsys)
    assert (code, finding(document, "states")["said"]["head"]) == (0, "bit-identical at 501 steps")


MIRRORED = {"regression": "improvement", "improvement": "regression"}


@settings(max_examples=15)
@given(
    st.lists(st.floats(0.8, 1.25), min_size=6, max_size=6),
    st.lists(st.floats(0.8, 1.25), min_size=6, max_size=6),
    st.sampled_from([TURNS, "AAAAAABBBBBB", "AABBAABBAABB"]),
    st.sampled_from([0, 5 * 10**6, 5 * 10**7]),
)
def test_exchanging_base_and_head_mirrors_every_verdict(
    tmp_path_factory: pytest.TempPathFactory, base: list[float], head: list[float], order: str, more: int
) -> None:
    """Turn every regression into an improvement and leave all else, and do not mind the order of files."""
    from gpusimbench.evaluator.compare.compare import compare, read_sides
    from gpusimbench.evaluator.compare.finding import Settings
    from gpusimbench.evaluator.compute.work import HERE
    from gpusimbench.evaluator.inputs.reader import Reader
    from gpusimbench.evaluator.read.addresses import expand

    folder = tmp_path_factory.mktemp("mirror")
    bad = {"status": "INVALID", "reason": "overflow", "cause": "BUFFER"}
    one, other = write_sides(
        folder,
        [{"elapsed_s": s, "host_bytes": (10**8, 10**8 + 10**8)} for s in base],
        [{"elapsed_s": s, "host_bytes": (10**8, 10**8 + 10**8 + more), **(bad if s > 1.2 else {})} for s in head],
        order,
    )
    places = expand([one]), expand([other])
    results = [
        compare(*read_sides(a, b, Reader(5.0), HERE), Settings(), HERE)
        for a, b in (places, (places[0][::-1], places[1][::-1]), (places[1], places[0]))
    ]
    forth, shuffled, back = ([(f.name, f.change.value) for f in result.findings] for result in results)
    assert shuffled == forth
    assert back == [(name, MIRRORED.get(change, change)) for name, change in forth]
