"""Ranking simulators from recordings alone: who has a place and why not, what was reproduced, and nothing typed in."""

from __future__ import annotations

import csv
import html
import io
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.cli.share import main, parser
from gpusimbench.evaluator.compute.cache import Store, encode
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.templating import script
from gpusimbench.evaluator.share.dataset import contents
from gpusimbench.evaluator.share.leaderboard.make import gather
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.provenance import ReplayOf
from tests.conftest import call
from tests.evaluator.test_share_card import HOSTILE
from tests.synthetic import configured, grid, write_recording, write_sweep
from tests.test_docs import ROOT, commands, shell


def made(folder: Path, *sets: Path | str, code: int = 0) -> dict[str, Any]:
    """The document of a leaderboard of some recordings."""
    out = folder / "board"
    assert main(["leaderboard", *map(str, sets), "--out", str(out), "--no-cache"]) == code
    return json.loads((out / "leaderboard.json").read_text())


def rows(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """All rows by simulator and number of environments."""
    return {f"{row['simulator']} {row['n_env']}": row for section in document["sections"] for row in section["rows"]}


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder for recordings."""
    (tmp_path / "runs").mkdir()
    return tmp_path / "runs"


def write(folder: Path, final: Any = None, **keywords: Any) -> Path:
    """A recording that keeps every rule of integrity-1."""
    return write_recording(folder, final, **{"whole": True, "proven": True, **keywords})


def test_places_are_by_throughput_within_scene_and_device(runs: Path, tmp_path: Path) -> None:
    """Rank within a scene, a step and a device alone, the fastest first."""
    write(runs, simulator="slow", elapsed_s=2.0)
    write(runs, simulator="fast", elapsed_s=1.0)
    write(runs, simulator="elsewhere", elapsed_s=9.0, gpu_bytes=(10, 20))
    write(runs, simulator="other-scene", elapsed_s=9.0, scene="free-fall")
    write(runs, simulator="other-step", elapsed_s=9.0, dt=0.5)
    document = made(tmp_path, runs)
    places = {
        tuple(row["simulator"] for row in s["rows"]): [row["place"] for row in s["rows"]] for s in document["sections"]
    }
    assert places == {
        ("fast", "slow"): [1, 2], ("elsewhere",): [1], ("other-scene",): [1], ("other-step",): [1],
    }  # fmt: skip


def test_places_of_other_settings(runs: Path, tmp_path: Path) -> None:
    """Rank environments that differ in their parameters among themselves, and say so."""

    write(runs, simulator="slow", elapsed_s=2.0)
    write(runs, simulator="varied", elapsed_s=1.0, change=configured(vary="mass:0.1"))
    document = made(tmp_path, runs)
    found = [(s["settings"], [row["simulator"] for row in s["rows"]]) for s in document["sections"]]
    assert found == [({}, ["slow"]), ({"vary": "mass:0.1"}, ["varied"])]
    assert "mass:0.1" in (tmp_path / "board" / "index.html").read_text()


def test_places_that_may_be_one(runs: Path, tmp_path: Path) -> None:
    """Say of a place that its throughput is not shown to be lower than that of the place above."""
    for run, noise in enumerate((0.99, 1.0, 1.01)):
        for name, seconds in (("first", 2.0), ("second", 2.01), ("third", 2.2)):
            write(runs, simulator=name, run=run, elapsed_s=seconds * noise, name=f"{name}{run}.mcap")
    write(runs, simulator="once", elapsed_s=2.24)
    document = made(tmp_path, runs)
    (section,) = document["sections"]
    assert [(row["simulator"], row["place"], row["equals"]) for row in section["rows"]] == [
        ("first", 1, None), ("second", 2, 1), ("third", 3, None), ("once", 4, 3),
    ]  # fmt: skip
    page = (tmp_path / "board" / "index.html").read_text()
    assert page.count("not shown to be slower than place 1") == 2  # who is first, and the ranking
    assert "not shown to be slower than place 3" in page


def test_a_place_is_by_the_slowest_outcome(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Place runs whose throughput goes with their outcome by the slowest, though their mean is higher."""
    for run in range(10):
        slow = run % 2
        final = grid(4) + 1e-3 * slow
        write(runs, final, simulator="either", run=run, elapsed_s=1.0 + 2.0 * slow, name=f"either{run}.mcap")
    write(runs, grid(4), simulator="steady", elapsed_s=2.0)
    document = made(tmp_path, runs)
    (section,) = document["sections"]
    assert [(row["simulator"], row["place"]) for row in section["rows"]] == [("steady", 1), ("either", 2)]
    steady, either = (row["throughput"]["value"] for row in section["rows"])
    assert either > steady
    speeds = [row["speeds"] for row in section["rows"]]
    assert speeds[0] is None and speeds[1]["outcomes"][0]["low"] < steady
    assert "by outcome: 5 runs at" in (tmp_path / "board" / "index.html").read_text()
    capsys.readouterr()
    made(tmp_path, *sorted(runs.glob("either*.mcap")))
    assert "env-steps/s in the slowest of 2 outcomes" in capsys.readouterr().out


def test_a_shared_gpu_is_marked(runs: Path, tmp_path: Path) -> None:
    """Say beside a throughput in which runs another process was on the GPU, and rank memory without them."""
    for run, baseline in enumerate((10**9, 3 * 10**9, 10**9)):
        write(runs, run=run, gpu_bytes=(baseline, 2 * 10**9), process_bytes=10**9)
    row = rows(made(tmp_path, runs))["synthetic 1"]
    assert [one["presence"] for one in row["co_tenants"]] == ["unknown", "some", "unknown"]
    assert row["memory"]["value"] == 1.0
    assert "another process on the GPU: 1 of 3 runs: 1" in (tmp_path / "board" / "index.html").read_text()


def test_a_sweep_has_one_place(runs: Path, tmp_path: Path) -> None:
    """Give a simulator the place of the point at which it is fastest, with N_env^max and why it ends."""
    write_sweep(runs, (16, 64, 256, 1024), runs=1, speed=1e4, fails=1024, whole=True, proven=True, simulator="swept")
    write(runs, simulator="one", n_env=16, elapsed_s=160.0, gpu_bytes=(10, 20))
    document = made(tmp_path, runs)
    found = rows(document)
    assert [row["simulator"] for row in found.values() if row["place"]] == ["swept", "one"]
    best = next(row for row in found.values() if row["place"] == 1)
    assert best["n_env_max"] == 256
    assert "device memory" in best["sweep_ends"]
    page = (tmp_path / "board" / "index.html").read_text()
    assert "failed (device memory) at 1,024" in page
    assert "2 other points" in page


def test_who_has_no_place(runs: Path, tmp_path: Path) -> None:
    """Rank no INVALID run, none that breaks a rule, none whose states are not those of mechanics; and say why."""
    good = grid(2)
    write(runs, good, simulator="good", elapsed_s=5.0, steps=500, dt=0.01)
    write(runs, good, simulator="invalid", status="INVALID", reason="buffer overflow", cause="BUFFER")
    write(runs, good, simulator="invalid", run=1)
    write(runs, good, simulator="unsaid", whole=False)
    write(runs, None, simulator="failed", status="FAILED", reason="no memory")
    sunk = good.copy()
    sunk[..., 2] = -1.0
    write(runs, sunk, simulator="sunk", steps=500, dt=0.01)
    write(runs, good, simulator="untimed", elapsed_s=None)
    write(runs, good, simulator="control", elapsed_s=0.1, steps=500, dt=0.01, switches={"instrument": True})
    found = {row["simulator"]: row for row in rows(made(tmp_path, runs)).values()}
    assert found["good"]["place"] == 1
    why = {name: row["place_missing"] for name, row in found.items() if row["place"] is None}
    assert "1 of 2 runs INVALID: buffer overflow" in why["invalid"]
    assert "integrity-1" in why["unsaid"]
    assert "no memory" in why["failed"]
    assert "bodies through the floor per env (27 of 27)" in why["sunk"]
    assert "timed phase" in why["untimed"]
    assert "instrument" in why["control"]
    page = (tmp_path / "board" / "index.html").read_text()
    assert all(reason in page for reason in ("buffer overflow", "no memory", "through the floor"))
    top = page.partition("<caption>Who is first</caption>")[2].partition("</table>")[0]
    assert "<td>good: 400" in top
    rule = "breaks a rule of integrity-1"
    for name, reason in (
        ("invalid", "1 of 2 runs INVALID"),
        ("unsaid", rule),
        ("sunk", "states break mechanics (physics-2)"),
    ):
        assert f"<small>{name} (1 row): {reason}</small>" in top
    assert "untimed" not in top
    assert "control" not in top


def test_an_engine_that_is_wrong_elsewhere_has_no_place(runs: Path, tmp_path: Path) -> None:
    """Put nobody first whose mechanics break in another scene, and say at the top of the page what it is."""
    sunk = grid(2).copy()
    sunk[..., 2] = -1.0
    write(runs, sunk, simulator="wrong", steps=500, dt=0.01)
    write(runs, simulator="wrong", scene="free-fall", elapsed_s=0.1, steps=500, dt=0.01)
    write(runs, simulator="right", scene="free-fall", elapsed_s=9.0, steps=500, dt=0.01)
    document = made(tmp_path, runs)
    (free_fall,) = (section for section in document["sections"] if section["scene"] == "free-fall")
    assert [(row["simulator"], row["place"]) for row in free_fall["rows"]] == [("right", 1), ("wrong", None)]
    top = (tmp_path / "board" / "index.html").read_text().partition("</table>")[0]
    assert "wrong (1 row): elsewhere 27 of 27 bodies per env sank (inclined-collision)" in top


def test_rules_that_are_not_met_are_said_in_words(runs: Path, tmp_path: Path) -> None:
    """Name the rules of the protocol beside a row, and say below what they require and what was found.

    A throughput that misses the rules on its window or on evidence of work has no place, and the reason stands there.
    """
    write(runs, grid(2), timed_steps=7)
    write(runs, grid(2), simulator="unproven", timed_steps=7, proven=False, warmup=100)
    document = made(tmp_path, runs, code=ExitCode.NOTHING_COMPARABLE)
    reasons = {row["simulator"]: row["place_missing"] for row in rows(document).values()}
    assert reasons["synthetic"] == "protocol-2 not met: fewer than 100 timed steps have clocks"
    assert "clocks; contacts are not counted" in reasons["unproven"]
    page = (tmp_path / "board" / "index.html").read_text()
    assert re.search(r"<small>protocol-2 not met: .*timed steps.*</small>", page)
    assert re.search(r"Fewer than 100 timed steps have clocks: found 7 \(1 of 1\)", page)


def test_damaged_recordings_are_left_out(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compute nothing from a damaged file, name it, and end with 3."""
    write(runs, simulator="good")
    data = bytearray(write(runs, grid(2), simulator="bad", name="bad.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    (runs / "bad.mcap").write_bytes(data)
    document = made(tmp_path, runs, code=3)
    assert list(rows(document)) == ["good 1"]
    assert [Path(one["file"]).name for one in document["unreadable"]] == ["bad.mcap"]
    assert "bad.mcap is left out" in capsys.readouterr().err
    assert "bad.mcap" in (tmp_path / "board" / "index.html").read_text()


def test_copies_count_once(runs: Path, tmp_path: Path) -> None:
    """Count a run once, however often its file is there, named or packed otherwise."""
    path = write(runs, grid(2), name="a.mcap")
    (runs / "below").mkdir()
    shutil.copy(path, runs / "below" / "copy.mcap")
    assert main(["pack", str(path), "--out", str(runs / "packed")]) == 0
    (row,) = rows(made(tmp_path, runs, path)).values()
    assert len(row["recordings"]) == 1
    assert row["outcomes"]["complete"] == 1


def replay(folder: Path, original: Path, final: Any, **keywords: Any) -> Path:
    """A recording that says that it replays another."""
    opened = Recording(original)
    of = ReplayOf(opened.provenance.run_id, opened.content_hash)
    return write(folder, final, **{"replay_of": of, **keywords})


def test_reproduced_is_what_a_replay_shows(runs: Path, tmp_path: Path) -> None:
    """Count replays whose states are the original's bits, and the kinds of machines that they are from."""
    good = grid(2)
    original = write(runs, good, name="original.mcap", cpu="A")
    replay(runs, original, good, cpu="B")
    replay(runs, original, good, cpu="C")
    replay(runs, original, good, cpu="A")
    other = good.copy()
    other[0, 0, 0] = np.nextafter(other[0, 0, 0], 1)
    replay(runs, original, other, cpu="D")
    document = made(tmp_path, runs)
    row = next(
        row for section in document["sections"] for row in section["rows"]
        if any(entry["name"] == "original.mcap" for entry in row["recordings"])
    )  # fmt: skip
    found = row["reproduction"]
    assert found["reproduced"] == 1
    (replays,) = found["replays"].values()
    assert sorted((one["machine"][0], one["agrees"], one["other_machine"]) for one in replays) == [
        ("A", True, False), ("B", True, True), ("C", True, True), ("D", False, True),
    ]  # fmt: skip
    page = (tmp_path / "board" / "index.html").read_text()
    assert "1 of 1 reproduced bitwise, by 3 recordings on 3 kinds of machine, 2 other than its own" in page


@pytest.mark.parametrize("wrong", ["content_hash", "run_id"])
def test_a_replay_of_something_else_does_not_count(runs: Path, tmp_path: Path, wrong: str) -> None:
    """Ignore a replay whose original, by run and content hash, is not among the recordings."""
    original = write(runs, grid(2))
    opened = Recording(original)
    told = {"run_id": opened.provenance.run_id, "content_hash": opened.content_hash, wrong: "0" * 64}
    write(runs, grid(2), replay_of=ReplayOf(**told), cpu="B")
    assert all(not row["reproduction"]["replays"] for row in rows(made(tmp_path, runs)).values())


def test_a_replay_that_shows_nothing_does_not_count(runs: Path, tmp_path: Path) -> None:
    """Take for a reproduction no replay that is of another simulator or scene, or that breaks a rule."""
    original = write(runs, grid(2), name="original.mcap", simulator="mine")
    replay(runs, original, grid(2), simulator="another", cpu="B")
    replay(runs, original, grid(2), simulator="mine", scene="free-fall", cpu="C")
    replay(runs, original, grid(2), simulator="mine", cpu="D", whole=False)
    found = [row["reproduction"]["reproduced"] for row in rows(made(tmp_path, runs)).values()]
    assert found
    assert not any(found)


def test_nobody_takes_the_place_of_a_run(runs: Path, tmp_path: Path) -> None:
    """Count neither of two recordings of one run id with other contents, whichever name comes first."""
    write(runs, grid(2), name="b.mcap", run_id="one", simulator="theirs")
    write(runs, grid(2), name="a.mcap", run_id="one", simulator="theirs", elapsed_s=0.001)
    write(runs, grid(2), name="c.mcap", simulator="other")
    document = made(tmp_path, runs, code=3)
    assert [row["simulator"] for row in rows(document).values()] == ["other"]
    assert [Path(one["file"]).name for one in document["unreadable"]] == ["a.mcap", "b.mcap"]
    assert all("neither counts" in one["reason"] for one in document["unreadable"])


def test_what_an_audit_wrote_does_not_count(runs: Path, tmp_path: Path) -> None:
    """Take no file beside the recordings for an argument: an audit's document changes nothing."""
    path = write(runs, grid(2))
    before = made(tmp_path, runs)
    (runs / "audit.json").write_text(
        json.dumps({"schema_version": 2, "audits": [{"originals": [{"content_hash": Recording(path).content_hash}],
                                                     "level": "bit-identical", "meets_requirement": True}]})
    )  # fmt: skip
    assert made(tmp_path, runs) == before


def test_no_number_can_be_typed_in() -> None:
    """Have no option of the command that a figure of a row could come from."""
    verb = parser()._subparsers._group_actions[0].choices["leaderboard"]  # type: ignore[union-attr,index]
    options = {option for action in verb._actions for option in action.option_strings}
    assert options == {"-h", "--help", "--out", "--title", "--sample-time", "--cache", "--no-cache"}


def test_a_real_replay_counts(small: Path, tmp_path: Path) -> None:
    """Record, replay with the recorder, and find the original reproduced."""
    call("gsb-record", "--replay", small, "--out", tmp_path / "replays", code=0)
    document = made(tmp_path, small, tmp_path / "replays", code=ExitCode.NOTHING_COMPARABLE)  # its window is its own
    (row,) = rows(document).values()
    assert row["reproduction"]["reproduced"] == 1
    assert [entry["replay_of"] for entry in row["recordings"]].count("") == 1


class _Page(HTMLParser):
    """Tags, and attributes that load or run something."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.loaded: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.loaded += [str(value) for name, value in attrs if name in ("src", "href") or name.startswith("on")]


def test_text_of_strangers_is_text(runs: Path, tmp_path: Path) -> None:
    """Show names of simulators and reasons as text in the page, and as no formula in a spreadsheet."""
    write(runs, simulator=HOSTILE, name="<b>.mcap")
    for number, first in enumerate("=+-@\uff1d"):
        write(runs, simulator=f"{first}1+cmd|' /C calc'!A0", elapsed_s=float(number + 2), name=f"{first}x.mcap")
    write(runs, simulator="failed", status="FAILED", reason=HOSTILE)
    made(tmp_path, runs)
    page = _Page()
    text = (tmp_path / "board" / "index.html").read_text()
    page.feed(text)
    assert not page.tags & {"img", "iframe", "link", "form", "object"}
    assert text.count("<script") == 1
    assert str(script("page.js")) in text
    assert all(re.fullmatch(r"#content|#s\d+", target) for target in page.loaded), page.loaded
    assert "\x1b" not in text
    assert "default-src 'none'" in html.unescape(text)
    table = list(csv.DictReader(io.StringIO((tmp_path / "board" / "leaderboard.csv").read_text())))
    assert len(table) == 7
    for row in table:
        written = set(row.values()) - {"-"}
        assert not any(value.startswith(("=", "+", "-", "@", "\uff1d", "\t", "\r")) for value in written)


def test_the_same_recordings_give_the_same_bytes(runs: Path, tmp_path: Path) -> None:
    """Write the same page, table and document again; and over its own files, but over nobody else's."""
    write(runs, grid(2))
    made(tmp_path, runs)
    first = {path.name: path.read_bytes() for path in (tmp_path / "board").iterdir()}
    assert set(first) == {"index.html", "leaderboard.json", "leaderboard.csv"}
    made(tmp_path, runs)
    assert {path.name: path.read_bytes() for path in (tmp_path / "board").iterdir()} == first
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "index.html").write_text("mine")
    assert main(["leaderboard", str(runs), "--out", str(tmp_path / "mine")]) == 2
    assert (tmp_path / "mine" / "index.html").read_text() == "mine"


def test_nothing_to_rank(tmp_path: Path) -> None:
    """End with 5 where there are no recordings, or none has a place."""
    assert main(["leaderboard", str(tmp_path), "--out", str(tmp_path / "board")]) == 5
    write(tmp_path, status="FAILED", reason="no memory")
    assert main(["leaderboard", str(tmp_path), "--out", str(tmp_path / "board"), "--no-cache"]) == 5


def test_what_is_known_is_not_checked_again(runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check a file once, and again when it is another one."""
    path = write(runs, grid(2))
    work = Work(store=Store(tmp_path / "cache"))
    # as if it had been written long ago
    monkeypatch.setattr("gpusimbench.evaluator.read.addresses._SETTLED_NS", -(10**12))
    calls: list[Path] = []
    real = contents.examine
    monkeypatch.setattr(contents, "examine", lambda given: calls.append(given) or real(given))  # type: ignore[func-returns-value]
    (first,) = gather([path], 5.0, work)
    (second,) = gather([path], 5.0, work)
    assert calls == [path]
    assert first.checkup == second.checkup
    assert first.run and second.run
    assert encode(first.run) == encode(second.run)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    (again,) = gather([path], 5.0, work)
    assert again.checkup.outcome == "damaged"


@pytest.mark.slow
def test_the_commands_of_the_page(tmp_path: Path) -> None:
    """Run every command that docs/dataset.md shows, on a recording that ships."""
    for name in ("mujoco-amd-r0.mcap", "h200/warp-inclined-collision-n16-r0.mcap"):
        (tmp_path / "recordings" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "recordings" / name, tmp_path / "recordings" / name)
    lines = commands(ROOT / "docs" / "dataset.md")
    assert len(lines) >= 5
    for line in lines:
        shell(line, tmp_path)
    assert (tmp_path / "board" / "index.html").exists()
