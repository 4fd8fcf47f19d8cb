"""gsb-compare --history as a user calls it, on folders whose history is known."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.cli.compare import main
from gpusimbench.evaluator.compare.history.words import percent
from gpusimbench.evaluator.render.figures.history import Dot, Level, Mark, history_chart
from tests.browser import Browser, needs_chromium
from tests.evaluator.test_compare import NOISE, RECORDINGS, stamped
from tests.synthetic import Shown, grid, write_recording

AMD = sorted(RECORDINGS.glob("mujoco-amd-r*.mcap"))
XEON = sorted(RECORDINGS.glob("mujoco-xeon-r*.mcap"))
GENESIS = sorted((RECORDINGS / "h200").glob("genesis-inclined-collision-n16-r*.mcap"))


def write_point(
    folder: Path, index: int, *, label: str = "", runs: int = 4, factor: float = 1.0, **common: Any
) -> Path:
    """A point of so many runs, whose times vary by a per cent or two, a minute behind the point before."""
    point = folder / (label or f"v{index}")
    point.mkdir(parents=True, exist_ok=True)
    shift = float(np.random.default_rng(index).normal(scale=0.004))
    for run in range(runs):
        keywords: dict[str, Any] = {"final": None, "version": f"{index}.0", **common}
        elapsed = factor * float(np.exp(shift + NOISE[run]))
        write_recording(point, run=run, change=stamped(60 * index + run), elapsed_s=elapsed, **keywords)
    return point


def history(folder: Path, *arguments: object, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any]]:
    """Exit code and JSON of the command."""
    code = main(["--history", str(folder), *map(str, arguments), "--json", "-", "--no-cache"])
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert found["exit_code"] == code
    return code, found


def curve(document: dict[str, Any], name: str, index: int = 0) -> dict[str, Any]:
    """The curve of that quantity."""
    (found,) = [c for c in document["configurations"][index]["curves"] if c["name"] == name]
    return dict(found)


def changes(document: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Label, quantity and verdict of every change that counts, of a configuration's curves and of its facts."""
    return sorted(
        (change["label"], what["name"], change["change"])
        for one in document["configurations"]
        for what, listed in [*((c, c["changes"]) for c in one["curves"]), *((f, [f]) for f in one["facts"])]
        for change in listed
        if change["change"] != "below threshold"
    )


def copied(folder: Path, points: Sequence[Sequence[Path]]) -> Path:
    """A history of copies of recordings."""
    for index, files in enumerate(points):
        point = folder / f"v{index}"
        point.mkdir(parents=True)
        for file in files:
            shutil.copy(file, point)
    return folder


def test_a_version_that_is_slower(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Mark the version, with ratio, interval and p; tell, and decide nothing."""
    for index in range(10):
        write_point(tmp_path, index, factor=1.2 if index >= 6 else 1.0)
    code, document = history(tmp_path, capsys=capsys)
    assert (code, changes(document)) == (0, [("v6", "fps", "regression")])
    (change,) = curve(document, "fps")["changes"]
    assert change["ratio"] == pytest.approx(1 / 1.2, rel=0.02)
    assert change["ci95"][0] < 1 / 1.2 < change["ci95"][1]
    assert 0 < change["p_value"] < 0.001
    assert (change["previous"], change["exact"]) == (5, False)
    assert [point["value"] > 0 and point["ci95"] is not None for point in curve(document, "fps")["samples"]] == [
        True
    ] * 10
    assert document["configurations"][0]["groups"][6]["version"] == "6.0"
    assert document["verdict"] == "1 regression over 10 points; none at the newest, v9"


def test_nothing_changes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Mark nothing where runs differ by a per cent or two, and say what the next point would have to be."""
    for index in range(8):
        write_point(tmp_path, index)
    code, document = history(tmp_path, capsys=capsys)
    assert (code, changes(document)) == (0, [])
    assert 1.0 < curve(document, "fps")["smallest_visible"] < 1.1
    assert document["verdict"] == "NO CHANGE found over 8 points"
    assert document["notes"] == []


@pytest.mark.parametrize(
    ("factor", "gate", "code", "verdict"),
    [
        (1.2, "throughput", 4, "FAILED at v9: throughput"),
        (0.8, "throughput", 0, "1 improvement over 10 points; at the newest, v9: throughput"),
        (1.2, "memory", 0, "1 regression over 10 points; at the newest, v9: throughput"),
        (1.0, "throughput", 0, "NO CHANGE"),
    ],
)
def test_a_gate_is_about_the_newest_point(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], factor: float, gate: str, code: int, verdict: str
) -> None:
    """Fail where a gated quantity became worse at the newest point."""
    for index in range(10):
        write_point(tmp_path, index, factor=factor if index == 9 else 1.0)
    found, document = history(tmp_path, "--gate", gate, capsys=capsys)
    assert (found, document["verdict"][: len(verdict)]) == (code, verdict)


@pytest.mark.parametrize("since", [1, 2, 3])
def test_a_gate_after_an_accepted_change(tmp_path: Path, capsys: pytest.CaptureFixture[str], since: int) -> None:
    """Pass the points that follow on a regression, by the noise of those before it; fail another regression."""
    last = 7 + since
    for index in range(last + 1):
        write_point(tmp_path, index, factor=1.2 if index >= 7 else 1.0)
    code, document = history(tmp_path, "--gate", "throughput", capsys=capsys)
    assert changes(document) == [("v7", "fps", "regression")]
    assert (code, document["undecided"]) == (0, [])
    write_point(tmp_path, last + 1, factor=1.2 * 1.2)
    code, document = history(tmp_path, "--gate", "throughput", capsys=capsys)
    assert (code, changes(document)[-1][1:]) == (4, ("fps", "regression"))
    assert {label for label, _, _ in changes(document)} == {"v7", f"v{last + 1}"}
    assert document["undecided"] == []


def test_a_gate_that_few_points_cannot_decide(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """End with 5 where the newest of three points could have changed without being marked."""
    for index in range(3):
        write_point(tmp_path, index, factor=1.0 + 0.01 * index)
    code, document = history(tmp_path, "--gate", "throughput", capsys=capsys)
    assert code == 5
    assert (
        document["undecided"][0]["reason"]
        == "points differ so much that a change above the threshold could not be seen"
    )
    assert history(tmp_path, capsys=capsys)[0] == 0


def test_memory_and_bits_are_facts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Mark what is the same in every run of a point exactly where it becomes another, without a p."""
    for index in range(4):
        write_point(
            tmp_path,
            index,
            final=grid(2) + (0.02 if index >= 2 else 0.0),
            host_bytes=(10**8, (2 + (index >= 1)) * 10**8),
        )
    code, document = history(tmp_path, capsys=capsys)
    assert (code, changes(document)) == (
        0,
        [
            ("v1", "host_memory_peak_increment", "regression"),
            ("v2", "outcome", "changed"),
            ("v2", "states", "changed"),
        ],
    )
    (change,) = curve(document, "host_memory_peak_increment")["changes"]
    assert (change["before"], change["after"], change["p_value"], change["ci95"]) == (100.0, 200.0, None, None)


def test_a_point_without_a_value_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Keep a point whose runs measured no memory among those that did, with the metric's own reason."""
    for index in range(3):
        write_point(tmp_path, index, host_bytes=None if index == 1 else (10**8, 2 * 10**8))
    _, document = history(tmp_path, capsys=capsys)
    told = [(p["value"], p["value_missing"]) for p in curve(document, "host_memory_peak_increment")["samples"]]
    assert told == [
        (100.0, ""),
        (None, "the timed phase was left out, or no memory was sampled in it"),
        (100.0, ""),
    ]


def test_states_of_single_runs_that_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say beside "no change" that states of points of one run differ, and not where two runs of a point tell."""
    for index in range(4):
        write_point(tmp_path / "once", index, runs=1, final=grid(4) + (index > 0) + (index > 1))
        write_point(tmp_path / "alike", index, runs=1, final=grid(4))
        write_point(tmp_path / "twice", index, runs=2, final=grid(4) + (index > 1))
    _, document = history(tmp_path / "once", capsys=capsys)
    assert document["verdict"] == "NO CHANGE found over 4 points"
    (note,) = document["notes"]
    assert "states of v2 differ from those of v1 from step " in note and "and so at 1 earlier point" in note
    assert note.endswith("whether runs of one point differ as well is not known: record two runs a point")
    _, document = history(tmp_path / "alike", capsys=capsys)
    assert document["notes"] == []
    _, document = history(tmp_path / "twice", capsys=capsys)
    assert document["notes"] == [] and ("v2", "states", "changed") in changes(document)


def test_runs_that_are_no_longer_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tell at which version runs stopped being bit-identical, and where they are again."""
    rng = np.random.default_rng(0)
    for index in range(3):
        point = tmp_path / f"v{index}"
        point.mkdir()
        for run in range(3):
            final = grid(2) + (1e-3 * rng.normal(size=(2, 1, 3)) if index == 1 else 0.0)
            write_recording(point, final, run=run, change=stamped(60 * index + run))
    _, document = history(tmp_path, "--gate", "determinism", capsys=capsys)
    found = [one for one in changes(document) if one[1] in ("distinct_runs", "distinct_envs")]
    assert found == [
        ("v1", "distinct_envs", "regression"),
        ("v1", "distinct_runs", "regression"),
        ("v2", "distinct_envs", "improvement"),
        ("v2", "distinct_runs", "improvement"),
    ]
    told = {(fact["label"], fact["name"]): fact["said"] for fact in document["configurations"][0]["facts"]}
    assert told["v1", "distinct_runs"] == {"before": "identical, all 3", "after": "3 of 3 distinct"}


def test_a_version_that_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tell a version whose runs fail before the simulator is built, and the version after it that works again."""
    for index in range(3):
        failed = {"status": "FAILED", "reason": "no", "built": False, "end": True} if index == 1 else {}
        write_point(tmp_path, index, **failed)
    code, document = history(tmp_path, capsys=capsys)
    told = [one for one in changes(document) if one[1] == "complete_runs"]
    assert told == [("v1", "complete_runs", "regression"), ("v2", "complete_runs", "improvement")]
    assert len(document["configurations"]) == 1
    assert code == 0


def test_points_stand_in_order_of_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Order by the earliest start of runs, whatever the folders are called, and read folders within a point."""
    for index, label in enumerate(("zeta", "alpha", "v10", "v9")):
        write_point(tmp_path, index, label=f"{label}/nested" if index == 2 else label)
    _, document = history(tmp_path, capsys=capsys)
    assert [point["label"] for point in document["points"]] == ["zeta", "alpha", "v10", "v9"]
    assert "earliest start time" in document["order"]


def test_devices_are_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Split the curve where the machine changes: real runs of two machines are two curves."""
    folder = copied(tmp_path, [[AMD[0]], [AMD[1]], [AMD[2]], XEON])
    code, document = history(folder, capsys=capsys)
    assert (code, changes(document)) == (0, [])
    assert [len(one["groups"]) for one in document["configurations"]] == [3, 1]
    assert len({one["device"] for one in document["configurations"]}) == 2
    (note,) = document["notes"]
    assert "device changed: the curve is split" in note
    assert "at v0 to v2 (3 points)" in note


@pytest.mark.slow
def test_real_runs_on_a_gpu(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """See in ten real runs, two a point, that the first compiled its kernels and the others did not."""
    folder = copied(tmp_path, [GENESIS[index : index + 2] for index in range(0, 10, 2)])
    code, document = history(folder, capsys=capsys)
    assert code == 0
    assert changes(document) == [("v1", "host_memory_peak_increment", "improvement")]
    assert curve(document, "fps")["changes"] == []


def test_another_scene_is_another_curve(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Take a description of the scene that changed for another scene."""
    from gpusimbench.schemas.provenance import SIMULATION

    for index in range(4):
        stamp = stamped(60 * index)

        def change(name: str, record: dict[str, Any], index: int = index, stamp: Any = stamp) -> None:
            stamp(name, record)
            if name == SIMULATION and index >= 2:
                record["scene"] = {**record["scene"], "sha256": "f" * 64}

        point = tmp_path / f"v{index}"
        point.mkdir()
        write_recording(point, None, change=change)
    _, document = history(tmp_path, capsys=capsys)
    assert [len(one["groups"]) for one in document["configurations"]] == [2, 2]
    assert any("machine or scene changed: the curve is split" in note for note in document["notes"])


@pytest.mark.parametrize(("other", "noted"), [(1.5, ["v5"]), (1.0, []), (0.7, [])])
def test_all_simulators_at_once_may_be_the_machine(
    other: float, noted: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Say so where every simulator on a device became slower at one point, and not where one did, or one faster."""
    for index in range(8):
        (tmp_path / f"v{index}").mkdir()
        left = ["left later"] if index < 3 else []  # recorded at no point from v3 on, where it says nothing
        for simulator in ("one", "other", *left):
            point = tmp_path / f"v{index}"
            slow = (other if simulator == "other" else 1.5) if index >= 5 else 1.0
            for run in range(3):
                elapsed = slow * float(np.exp(NOISE[run] / 5))
                name = f"{simulator}-{run}.mcap"
                write_recording(
                    point,
                    None,
                    run=run,
                    simulator=simulator,
                    elapsed_s=elapsed,
                    change=stamped(60 * index + run),
                    name=name,
                )
    _, document = history(tmp_path, capsys=capsys)
    slower = sum(factor > 1 for factor in (1.5, other))
    assert len([one for one in changes(document) if one == ("v5", "fps", "regression")]) == slower
    found = [note.partition(": ") for note in document["notes"] if "the machine may be what changed" in note]
    assert [point for point, _, _ in found] == noted
    assert all(note.startswith("the throughput of all 2 simulators on ") for _, _, note in found)


@pytest.mark.parametrize("make", ["missing", "file", "empty", "folders without recordings"])
def test_what_is_no_history(tmp_path: Path, capsys: pytest.CaptureFixture[str], make: str) -> None:
    """Refuse what has no folder with recordings, and say what the folder has to be."""
    folder = tmp_path / "history"
    if make == "file":
        folder.write_text("x")
    elif make != "missing":
        folder.mkdir()
    if make.startswith("folders"):
        (folder / "v1").mkdir()
        shutil.copy(AMD[0], folder)
    assert main(["--history", str(folder), "--no-cache"]) == 2
    assert "for each version or commit" in capsys.readouterr().err


def test_one_point(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compare nothing, and end with 5."""
    write_point(tmp_path, 0)
    code, document = history(tmp_path, capsys=capsys)
    assert (code, document["verdict"][:16]) == (5, "NOTHING COMPARED")


def test_files_that_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tell them and leave them out, with exit code 3; so folders without recordings and files beside folders."""
    for index in range(3):
        write_point(tmp_path, index)
    (tmp_path / "v1" / "broken.mcap").write_bytes(b"no recording")
    (tmp_path / "v2" / "short.mcap").write_bytes(AMD[1].read_bytes()[:-5000])
    (tmp_path / "v3").mkdir()
    shutil.copy(AMD[0], tmp_path)
    shutil.copy(AMD[1], tmp_path)
    code = main(["--history", str(tmp_path), "--no-cache", "--all"])
    shown = capsys.readouterr()
    assert code == 3
    assert "broken.mcap" in shown.err
    assert "broken.mcap" in "".join(shown.out.split())  # a long path takes several lines
    assert "v3 has no recordings" in shown.out
    assert "is incomplete" in " ".join(shown.out.split())
    assert "2 recordings that lie in" in shown.out
    (tmp_path / AMD[1].name).unlink()
    main(["--history", str(tmp_path), "--no-cache", "--all"])
    assert "1 recording that lies in" in capsys.readouterr().out
    code, document = history(tmp_path, capsys=capsys)
    assert [len(point["unreadable"]) for point in document["points"]] == [0, 1, 0]


def test_a_run_belongs_to_one_point(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse a run that lies in two folders."""
    folder = copied(tmp_path, [[AMD[0]], [AMD[0], AMD[1]]])
    assert main(["--history", str(folder), "--no-cache"]) == 2
    assert "are one run" in capsys.readouterr().err


@pytest.mark.parametrize(
    "more", [["base"], ["--base", "a.mcap"], ["--expect-same"], ["--across", "cone"], ["--junit", "x.xml"]]
)
def test_what_does_not_go_with_a_history(tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str]) -> None:
    """Refuse what belongs to two sets; and what belongs to a history, without one."""
    write_point(tmp_path, 0)
    assert main(["--history", str(tmp_path), *more]) == 2
    assert main([str(tmp_path), str(tmp_path), "--html", "page.html"]) == 2
    assert "--html needs --history" in capsys.readouterr().err


def test_the_terminal_says_the_verdict_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Print at most fifteen lines, the newest changes first, without what a stranger's names could do."""
    for index in range(12):
        count = np.full((1, 4), 7 + index, dtype=np.uint32)
        shown = Shown({"timed": {"contacts": count}})
        write_point(
            tmp_path, index, factor=1.3 if index >= 6 else 1.0, shown=shown, n_env=4, label=f"v{index}\x1b[31m",
            host_bytes=(10**8, (2 + index) * 10**8),
        )  # fmt: skip
    assert main(["--history", str(tmp_path), "--no-cache"]) == 0
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert len(lines) <= 15
    assert "over 12 points; at the newest" in lines[0]
    assert lines[1].startswith("v11")
    assert "more changes" in out
    assert "\x1b" not in out
    assert main(["--history", str(tmp_path), "--no-cache", "--all"]) == 0
    assert len(capsys.readouterr().out.splitlines()) > 30


def test_the_page(tmp_path: Path) -> None:
    """Draw a curve with its change, and nothing of what only a terminal needs."""
    for index in range(8):
        write_point(tmp_path / "history", index, factor=1.3 if index >= 4 else 1.0, label=f"v{index}<b>&")
    page = tmp_path / "page.html"
    assert main(["--history", str(tmp_path / "history"), "--no-cache", "--html", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert "<b>&" not in text
    assert text.count("<svg") == 1
    assert "v4&lt;b&gt;&amp;" in text
    assert "1 regression over 8 points" in text


def test_the_page_says_by_how_much(tmp_path: Path) -> None:
    """Give a change as a share of the level before, in the table and above the curve, and from zero as the level."""
    for index in range(8):
        memory = (10**8, (4 if index >= 4 else 1) * 10**8)
        write_point(tmp_path / "history", index, factor=1.3 if index >= 4 else 1.0, host_bytes=memory)
    page, document = tmp_path / "page.html", tmp_path / "history.json"
    arguments = ["--history", str(tmp_path / "history"), "--no-cache", "--html", str(page), "--json", str(document)]
    assert main(arguments) == 0
    (change,) = curve(json.loads(document.read_text(encoding="utf-8")), "fps")["changes"]
    slower = f"{(change['ratio'] - 1) * 100:+.3g} %"
    text = page.read_text(encoding="utf-8")
    for told in (slower, "to 300.00 MB"):
        assert f"v4: {told} (regression)" in text
        assert f"{told} at v4" in text


def test_the_page_gives_both_ends_of_a_curve(tmp_path: Path) -> None:
    """List of each quantity its first and its newest value, and count changes of curves and facts together."""
    for index in range(4):
        final, host = grid(2) + (0.02 if index >= 2 else 0.0), (10**8, (2 + (index >= 1)) * 10**8)
        write_point(tmp_path / "history", index, final=final, host_bytes=host)
    page = tmp_path / "page.html"
    assert main(["--history", str(tmp_path / "history"), "--no-cache", "--html", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    (memory,) = re.findall(r"<tr[^>]*>(?:(?!</tr>).)*?host memory increment \[MB\].*?</tr>", text, re.DOTALL)
    cells = [re.sub(r"<[^>]*>", "", cell).strip() for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", memory)]
    assert cells[:4] == ["host memory increment [MB]", "4", "100.00", "200.00"]
    assert "4 points, 3 changes" in text


@needs_chromium
def test_the_page_in_a_browser(tmp_path: Path, browser: Browser) -> None:
    """Open without a request or an error, and without a line wider than the page, also on a telephone."""
    for index in range(8):
        write_point(tmp_path / "history", index, factor=1.3 if index >= 4 else 1.0)
    page = tmp_path / "page.html"
    assert main(["--history", str(tmp_path / "history"), "--no-cache", "--html", str(page)]) == 0
    for width, dark in ((1280, False), (400, True)):
        browser.open(page, width=width, dark=dark)
        assert (browser.errors, browser.requests) == ([], [])
        assert browser.page.evaluate("document.documentElement.scrollWidth") <= width
        # a caption takes the room that its table has, also where rows are cards
        assert browser.page.evaluate("document.querySelector('caption').getBoundingClientRect().width") > 300


def test_curves_without_a_change_are_closed(tmp_path: Path) -> None:
    """Show the curve that changed, and close those that did not; say of each figure only what it draws."""
    for index in range(8):
        host = (10**8, 2 * 10**8 + (index * 37 % 11) * 10**5)
        write_point(tmp_path / "history", index, factor=1.3 if index >= 4 else 1.0, host_bytes=host)
    page = tmp_path / "page.html"
    assert main(["--history", str(tmp_path / "history"), "--no-cache", "--html", str(page)]) == 0
    before, closed, after = page.read_text(encoding="utf-8").partition("Quantities without a change that counts")
    assert closed
    assert "throughput [env-steps/s], higher is better" in before
    assert "Dashed: levels between changes." in before
    assert "host memory increment [MB], lower is better" in after
    assert "Dashed" not in after


@needs_chromium
def test_no_label_leaves_the_figure(tmp_path: Path, browser: Browser) -> None:
    """Keep the newest point's name within the drawing, however long it is."""
    for index in range(14):
        write_point(tmp_path / "history", index, factor=1 + index / 50, runs=2, label=f"release-2026.{index:02}")
    page = tmp_path / "page.html"
    assert main(["--history", str(tmp_path / "history"), "--no-cache", "--html", str(page)]) == 0
    browser.open(page)
    browser.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    outside = """[...document.querySelectorAll('svg text')].filter(one => {
        const [own, all] = [one.getBoundingClientRect(), one.ownerSVGElement.getBoundingClientRect()];
        return own.left < all.left - 1 || own.right > all.right + 1; }).map(one => one.textContent)"""
    assert browser.evaluate("document.querySelectorAll('svg text').length") > 5
    assert browser.evaluate(outside) == []


def test_the_figure() -> None:
    """Draw every value, interval and level, and words for each change: none on top of another."""
    dots = [Dot(i, 100.0 + i, 99.0 + i, 101.0 + i, f"v{i}") for i in range(9)]
    marks = [Mark(i, f"-{i} % at v{i}", worse=i % 2 == 0) for i in (3, 4, 5)]
    svg = history_chart(
        dots,
        [f"v{i}" for i in range(9)],
        value="x",
        tick=str,
        marks=marks,
        levels=[Level(0, 2, 101.0), Level(3, 8, 105.0)],
    )
    assert svg.count("<circle") == 9
    assert svg.count("whisker") == 9
    assert svg.count('class="cross"') == 1
    assert all(f"<title>-{i} % at v{i}</title>" in svg for i in (3, 4, 5))
    assert history_chart([], ["v0"], value="x", tick=str) == ""


@pytest.mark.parametrize("values", [(0.0, 0.0), (5.0, 5.0), (-1.0, 3.0), (1e-9, 1e9), (0.0, 1e99)])
def test_the_figure_of_odd_values(values: tuple[float, float]) -> None:
    """Draw values that are equal, zero, negative or far apart within the frame."""
    svg = history_chart([Dot(i, v) for i, v in enumerate(values)], ["a", "b"], value="x", tick=lambda v: f"{v:g}")
    assert svg.count("<circle") == 2


@pytest.mark.slow
def test_the_documents_figures_are_those_of_the_benchmark() -> None:
    """Find in docs/false-alarms.md the tables of real runs and of the largest noise; the whole takes minutes."""
    from benchmarks import history_alarms

    page = (RECORDINGS.parent / "docs" / "false-alarms.md").read_text(encoding="utf-8")
    quartiles = [float(np.quantile(history_alarms.deviations(), q)) for q in (0.25, 0.5, 0.75)]
    history_alarms.check(quartiles)
    assert ", ".join(f"{q:.1%}" for q in quartiles) in page
    for line in history_alarms.recorded():
        assert line in page


@pytest.mark.parametrize(
    ("ratio", "said"),
    [(0.9, "-10 %"), (1.05, "+5 %"), (9.99, "+899 %"), (10.0, "times 10"), (1e-3, "times 0.001"), (0.002, "-99.8 %")],
)
def test_a_ratio_in_words(ratio: float, said: str) -> None:
    """Tell a change in percent, and as a factor where percent would be hard to read."""
    assert percent(ratio) == said
