"""gsb-diff as a user calls it: what it prints, writes and exits with."""

from __future__ import annotations

import json
import re
import shlex
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.cli.diff import main
from gpusimbench.evaluator.diff.result import Change
from gpusimbench.evaluator.diff.words import amount, changes, ranges, sparkline
from gpusimbench.evaluator.render import console
from gpusimbench.evaluator.render.numbers import length
from gpusimbench.schemas.commands import SCHEMA_VERSION
from tests.synthetic import cubes_field, grid, write_recording

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "diff.md"
HOSTILE = "\x1b[31m<b>[bold]&\"'\u202e"


def moved(since: int, env: int = 1) -> Any:
    """Positions of which one environment is elsewhere, growing since a step."""

    def at(_: Any, step: int) -> Any:
        positions = grid(3)
        positions[env, 4, 0] += 1e-9 * np.exp(step - since) if step >= since else 0
        return positions

    return at


@pytest.fixture
def pair(tmp_path: Path) -> tuple[str, str]:
    """Two recordings that part at step 5."""
    a = write_recording(tmp_path, grid(3), steps=30, path_of=moved(99), name="a.mcap")
    b = write_recording(tmp_path, moved(5)(None, 30), steps=30, path_of=moved(5), name="b.mcap")
    return str(a), str(b)


def test_a_difference_in_words(pair: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 4, and name step, time, environment, body, component and both numbers."""
    assert main([*pair, "--all"]) == 4
    out = capsys.readouterr().out
    shown = " ".join(out.split())  # however lines are broken
    verdict = "The two recordings differ from step 5 (5 s) on, first in env 1: cubes/position of cube_0_1_1, x: "
    assert out.startswith(verdict)
    assert "1 of 3 pairs of envs differ at that step, first in env 1" in shown
    number = re.search(r"cubes/position of cube_0_1_1, x: (\S+) and (\S+) m \((\S+), (\S+)\): (\S+) ULP", shown)
    a, b = float(number[1]), float(number[2])
    assert (b - a, number[3]) == (pytest.approx(1e-9, rel=1e-6), f"0x{np.float64(a).view(np.uint64):016x}")
    assert float(number[5]) == pytest.approx((b - a) / np.spacing(a), rel=0.01)
    assert "growth rate: 1 /s" in shown
    assert "1 mm reached by 19 s" in shown
    assert "distinct states 1 from step 0, 2 from step 5" in shown
    assert "a 0-2; b 0, 2" in shown
    assert "settings the same configuration, " in shown


def test_in_short(pair: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    """Print a screen: the same verdict and the number, what is printed with --all by name, and none of its tables."""
    assert main([*pair]) == 4
    short = capsys.readouterr().out
    assert main([*pair, "--all"]) == 4
    long = capsys.readouterr().out
    assert short.splitlines()[0] == long.splitlines()[0]
    assert len(short.splitlines()) <= 17
    assert "first number  cubes/position of cube_0_1_1, x: " in short
    assert "trajectories  2 classes: a 0-2; b 0, 2 | b 1" in short
    assert "more with --all: fields, distances, equal environments\n" in short
    assert "\n  ULP: units in the last place\n" in short
    assert "max |a - b|" not in short
    assert "max |a - b|" in long


def test_no_difference_in_words(pair: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 0, over a stated extent; environments that do not differ are equal in both files."""
    assert main([*pair, "--env", "2"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("Env 2 of a and env 2 of b are bit-identical.\n")
    assert "31 recorded states from step 0 to 30" in shown
    assert main([pair[1], "--env", "0", "--env", "2"]) == 0
    assert main([pair[1], "--env", "0", "--env", "1"]) == 4
    assert main([pair[1]]) == 4


def test_what_was_not_compared_is_not_called_identical(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Keep the word for files of which all was compared."""
    runs = [
        write_recording(tmp_path, grid(3), steps=steps, path_of=moved(99), name=f"{steps}.mcap") for steps in (5, 9)
    ]
    assert main([*map(str, runs)]) == 0
    shown = capsys.readouterr().out
    verdict = "The two recordings are equal bit for bit as far as compared; not everything was compared.\n"
    assert shown.startswith(verdict)
    assert "bit-identical" not in shown
    assert "not compared: states of b after its step 5, up to 9" in shown
    assert main([*map(str, runs), "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["bit_identical"], found["all_compared"]) == (True, False)
    assert main([str(runs[0]), str(runs[0]), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["all_compared"] is True


def test_a_difference_that_ends(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say "on" only where the sides stay apart: here one -0.0 stands at step 7 alone, and one NaN at step 5."""

    def at(number: float, where: int) -> Any:
        def positions(_: Any, step: int) -> Any:
            found = grid(2)
            found[0, 0, 0] = number if step == where else 0.0
            return found

        return positions

    runs = [
        str(write_recording(tmp_path, made(None, 9), steps=9, path_of=made, name=name))
        for name, made in (("a.mcap", at(0.0, 7)), ("zero.mcap", at(-0.0, 7)), ("nan.mcap", at(np.nan, 5)))
    ]
    assert main([*runs[:2], "--all"]) == 4
    shown = capsys.readouterr().out
    assert shown.startswith("The two recordings differ first at step 7 (7 s), first in env 0: ")
    assert "1 of the differing numbers is 0.0 against -0.0" in shown
    assert main([runs[0], runs[2], "--all", "--json", str(tmp_path / "found.json")]) == 4
    shown = capsys.readouterr().out
    assert shown.startswith("The two recordings differ first at step 5 (5 s), first in env 0: ")
    assert re.search(r"^cubes/position .* not finite$", shown, re.MULTILINE)
    assert "of the differing numbers is not finite on a side, and in no distance" in shown
    assert "positions that are not finite, first at step 5, are left out" in shown
    assert json.loads((tmp_path / "found.json").read_text())["compared"]["fields"][0]["max_distance"] is None
    assert main([runs[0], runs[2]]) == 4  # "never reached" is of the finite ones alone
    short = " ".join(capsys.readouterr().out.split())
    assert "never reached, without positions that are not finite, first at step 5" in short


def test_a_difference_between_recorded_states(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say that steps without states are not known, unless state hashes of every step can be compared."""

    def run(name: str, dtype: str, *differ: int) -> str:
        def at(_: Any, step: int) -> Any:
            positions = grid(3).astype(dtype)
            positions[1, 4, 0] += step in differ
            return positions

        return str(write_recording(tmp_path, at(None, 30), steps=30, stride=10, path_of=at, name=name))

    def said(*recordings: str) -> str:
        assert main([*recordings]) == 4
        return " ".join(capsys.readouterr().out.split())

    alone, since, once = run("a.mcap", "float64"), range(13, 31), (20,)
    told = "The two recordings are equal at step 10 and differ {} the next state that both recorded"
    assert said(alone, run("b.mcap", "float32", *since)).startswith(
        f"{told.format('from')} on, step 20 (20 s), first in env 1: cubes/position of cube_0_1_1, x: "
    )
    assert said(alone, run("c.mcap", "float32", *once)).startswith(f"{told.format('first at')}, step 20 (20 s), first")
    hashed = said(alone, run("d.mcap", "float64", *since))
    assert hashed.startswith("The two recordings differ from step 13 (13 s) on, first in env 1; body and field are")


@pytest.mark.parametrize("width", [40, 60, 80])
def test_numbers_stay_whole_in_a_narrow_terminal(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Break no number of the table of fields, however narrow the terminal is: part of a number is another number."""
    monkeypatch.setattr(console, "_WIDTH_WITHOUT_TERMINAL", width)
    runs = [ROOT / "recordings" / "h200" / f"mjx-jax-inclined-collision-n16-r{run}.mcap" for run in (0, 1)]
    assert main([*map(str, runs), "--all"]) == 4
    shown = capsys.readouterr().out
    words = set(shown.split())
    assert {"2,592", "3,888", "250", "182,414", "0.0377"} <= words
    assert max(map(len, shown.splitlines())) <= max(width, 90)


def test_json_and_picture(pair: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Write the whole result as JSON, and a picture that is well-formed and fetches nothing."""
    assert main([*pair, "--json", "-", "--plot", str(tmp_path / "growth.svg")]) == 4
    found = json.loads(capsys.readouterr().out)
    assert (found["schema_version"], found["verdict"], found["bit_identical"]) == (SCHEMA_VERSION, "different", False)
    assert (found["first"]["step_a"], found["first"]["env_b"]) == (5, 1)
    assert found["first"]["state"]["number"]["item"] == "cube_0_1_1"
    assert found["splits"]["agreeing"] == [{"step": 0, "count": 3}, {"step": 5, "count": 2}]
    assert len(found["growth"]["max_spatial"]) == 31
    picture = (tmp_path / "growth.svg").read_text(encoding="utf-8")
    root = ET.fromstring(picture)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert "first difference: step 5, 5 s" in picture
    assert not re.search(r"href|@import|url\(", picture)
    assert main([*pair, "--json", str(tmp_path / "found.json")]) == 4
    assert json.loads((tmp_path / "found.json").read_text()) == found


def test_nothing_to_draw(pair: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Write no picture where nothing differs, and say so without failing."""
    assert main([*pair, "--env", "0", "--plot", str(tmp_path / "none.svg")]) == 0
    assert "no difference to draw" in capsys.readouterr().err
    assert not (tmp_path / "none.svg").exists()


def test_a_picture_of_hashes_alone(tmp_path: Path) -> None:
    """Draw which environments are equal where there are no distances."""
    runs = [ROOT / "recordings" / "sweeps-h100" / f"{name}-franka-n512-r0.mcap" for name in ("warp", "mjx")]
    assert main([*map(str, runs), "--plot", str(tmp_path / "hashes.svg")]) == 4
    assert "no distances: no positions of bodies" in (tmp_path / "hashes.svg").read_text()


def test_fallen_bodies_do_not_set_the_scale_of_the_picture(tmp_path: Path) -> None:
    """Draw the distances of bodies on the board where others fall for seconds; the legend lies below the curves."""
    runs = [ROOT / "recordings" / f"mujoco-{name}-r0.mcap" for name in ("xeon", "pyramidal")]
    assert main([*map(str, runs), "--plot", str(tmp_path / "cones.svg")]) == 4
    root = ET.fromstring((tmp_path / "cones.svg").read_text(encoding="utf-8"))
    written = {text.text: float(text.attrib["y"]) for text in root.iter("{http://www.w3.org/2000/svg}text")}
    lengths = [label for label in written if re.fullmatch(r"\d+ (m|cm|mm|µm)", str(label))]
    assert lengths
    assert not [label for label in lengths if str(label).endswith(" m")]
    assert written["max, 3D, without 32 fallen bodies"] > written["simulated time [s]"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["a", "b", "c"], "3 recordings were given"),
        (["a", "--env", "1"], "1 environment given: with"),
        (["a", "b", "--env", "1", "--env", "2", "--env", "3"], "3 environments given"),
        (["a", "b", "--plot", "growth.png"], "--plot draws SVG"),
        (["a", "--json", "b.mcap"], "named like a recording"),
    ],
)
def test_what_cannot_be_asked(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 2 before any file is opened, in one line."""
    monkeypatch.chdir(tmp_path)  # a folder "a" where tests run would be asked for its recordings
    assert main(arguments) == 2
    assert said in capsys.readouterr().err


def test_damaged_and_incomplete_files(pair: tuple[str, str], tmp_path: Path) -> None:
    """Exit 3 for a changed byte, for what is no recording, and for equal states of a file that was cut short."""
    data = bytearray(Path(pair[0]).read_bytes())
    data[len(data) // 2] ^= 1
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data)
    assert main([str(broken), pair[1]]) == 3
    assert main([str(DOCUMENT), pair[1]]) == 3
    cut = write_recording(tmp_path, grid(3), steps=30, path_of=moved(99), end=False)
    assert main([str(cut), pair[0]]) == 3
    assert main([str(cut), pair[1]]) == 4
    assert main([pair[0], str(write_recording(tmp_path, None, n_env=3))]) == 5


def test_names_of_strangers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Print and draw hostile names as text: no escape sequence, no markup."""
    field = replace(cubes_field("float64"), items=tuple(f"{HOSTILE}{i}" for i in range(27)))
    runs = [
        write_recording(tmp_path, at(None, 5), path_of=at, field=field, simulator=HOSTILE, name=name, options=options)
        for at, name, options in ((moved(99), "a.mcap", {HOSTILE: "1"}), (moved(2), "b.mcap", {HOSTILE: HOSTILE}))
    ]
    assert main([*map(str, runs), "--plot", str(tmp_path / "x.svg")]) == 4
    shown = capsys.readouterr().out
    assert "\x1b" not in shown
    assert "\\x1b[31m<b>[bold]" in shown
    picture = (tmp_path / "x.svg").read_text(encoding="utf-8")
    ET.fromstring(picture)
    assert "\x1b" not in picture
    assert "<b>" not in picture


def test_help_lists_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    """Show exit codes and examples."""
    with pytest.raises(SystemExit):
        main(["--help"])
    shown = capsys.readouterr().out
    assert [int(n) for n in re.findall(r"^  (\d)  ", shown, re.MULTILINE)] == [0, 1, 2, 3, 4, 5]
    assert "gsb-diff before.mcap after.mcap" in shown


def test_the_document_shows_what_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Run every command of docs/diff.md; where it shows an output, that is the output."""
    page = DOCUMENT.read_text(encoding="utf-8")
    found = re.findall(r"^```console\n(.*?)\n```\n(?:\n```text\n(.*?)\n```)?", page, re.DOTALL | re.MULTILINE)
    assert len(found) >= 4
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    monkeypatch.chdir(tmp_path)
    for line, expected in found:
        name, *arguments = shlex.split(line)
        assert name == "gsb-diff"
        assert main(arguments) in (0, 4)
        shown = capsys.readouterr().out
        assert shown
        if expected:
            assert "\n".join(text.rstrip() for text in shown.splitlines()).strip() == expected


def test_packages_that_compute_come_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Name what can explain numbers, and count the other packages of two Pythons behind it."""
    runs = [ROOT / "recordings" / f"mujoco-{machine}-r0.mcap" for machine in ("amd", "xeon")]
    assert main([*map(str, runs), "--json", str(tmp_path / "found.json")]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    found = json.loads((tmp_path / "found.json").read_text())
    names = [one["name"] for one in found["settings"]]
    deciding, others = names[: -found["other_packages"]], names[-found["other_packages"] :]
    assert (
        f"{len(names)} differ: {', '.join(deciding[:4])} and {len(deciding) - 4} more; and {len(others)} other" in shown
    )
    assert {"software.packages.numpy", "software.packages.jax", "software.python"} <= set(deciding)
    assert "software.packages.pytest" in others and all(name.startswith("software.packages.") for name in others)


def test_words() -> None:
    """Write lengths, runs of numbers, changes and bars as a reader expects them."""
    assert [length(d) for d in (None, 0.0, 5e-10, 2e-9, 3.5e-6, 0.00123, 0.0123, 1.5, 74.37, 2e6)] == [
        "-", "0", "5e-10 m", "2 nm", "3.5 µm", "1.23 mm", "1.23 cm", "1.5 m", "74.4 m", "2e+06 m",
    ]  # fmt: skip
    assert [amount(0.5, "rad/s"), amount(0.5, "unit quaternion"), amount(0.5, "m")] == ["0.5 rad/s", "0.5", "50 cm"]
    assert ranges([0, 1, 2, 5, 7, 8]) == "0-2, 5, 7-8"
    many = [Change(step, step + 1) for step in range(6)]
    assert changes(many, 3) == "1 from step 0, 2 from step 1, (3 changes), 6 from step 5"
    assert sparkline([None, 0.0, 0.5, 1.0], 4) == " ▁▅█"
    assert sparkline([0.0, 1.0, None, None], 2) == "█ "
