"""A folder stands for its recordings wherever files are taken."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from gpusimbench import evaluate
from gpusimbench.evaluator.read.addresses import expand, expand_paths, left_below
from gpusimbench.schemas.errors import UsageError
from tests.conftest import call

ROOT = Path(__file__).resolve().parents[2]
AMD = [ROOT / "recordings" / f"mujoco-amd-r{run}.mcap" for run in range(2)]
XEON = ROOT / "recordings" / "mujoco-xeon-r0.mcap"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two recordings, with another recording in a folder below it."""
    made = tmp_path_factory.mktemp("set")
    for path in AMD:
        os.link(shutil.copy(path, made / f"{path.name}.copy"), made / path.name)
    (made / "below").mkdir()
    shutil.copy(XEON, made / "below")
    (made / "being-made.mcap.partial").touch()
    return made


def test_what_a_folder_stands_for(folder: Path, tmp_path: Path) -> None:
    """Take the recordings directly in it, sorted, each once, and what a crash left, but not a name that is reserved."""
    inside = [folder / path.name for path in AMD]
    assert expand([folder]) == expand_paths([folder]) == inside
    assert expand([inside[1], folder]) == [inside[1], inside[0]]
    for name in ("b.mcap", "a.mcap", "c.mcap.partial", "d.txt"):
        (tmp_path / name).write_bytes(b"content")
    assert [path.name for path in expand([tmp_path])] == ["a.mcap", "b.mcap", "c.mcap.partial"]


def test_a_folder_without_recordings(folder: Path, tmp_path: Path) -> None:
    """Say so, and name a folder below that has some."""
    with pytest.raises(UsageError, match=r"is a folder without recordings \(\*\.mcap\)$"):
        expand([tmp_path])
    shutil.copytree(folder / "below", tmp_path / "runs")
    with pytest.raises(UsageError, match=rf"there are some in {tmp_path / 'runs'}: name that folder"):
        expand([tmp_path])
    shutil.copytree(folder / "below", tmp_path / "run-1")
    with pytest.raises(UsageError, match=rf"there are some in 2 folders below it: give {tmp_path}/\*/\*\.mcap$"):
        expand([tmp_path])


def test_what_a_folder_leaves_below(folder: Path) -> None:
    """Say how many recordings below a folder are not read, and where, unless their folder is given too."""
    (said,) = left_below([folder])
    assert "1 more are in folders below it, to be named as well: below" in said
    assert left_below([folder, folder / "below"]) == left_below([folder / "below", AMD[0]]) == []
    assert "to be named as well: below" in call("gsb-eval", folder).stderr


@pytest.mark.parametrize("name", ["eval", "check", "info"])
def test_commands_of_many_files(name: str, folder: Path) -> None:
    """Say of a folder what they say of its files."""
    more = ("--no-cache",) if name == "eval" else ()
    of_folder = call(f"gsb-{name}", folder, "--json", "-", *more)
    of_files = call(f"gsb-{name}", *(folder / path.name for path in AMD), "--json", "-", *more)
    assert of_folder.returncode == of_files.returncode == 0, of_folder.stderr
    assert json.loads(of_folder.stdout) == json.loads(of_files.stdout)


def test_commands_of_two_and_of_one(folder: Path) -> None:
    """Compare the two recordings of a folder, or one of each of two; take a reference from a folder that has one."""
    assert call("gsb-diff", folder).returncode == 0
    assert call("gsb-diff", folder / "below", folder / AMD[0].name).returncode in (0, 4)
    too_many = call("gsb-diff", folder, folder / "below", code=2)
    assert "3 recordings were given. gsb-eval says whether runs repeat" in too_many.stderr
    assert call("gsb-eval", folder, "--reference", folder / "below", "--json", "-").returncode == 0
    several = call("gsb-eval", folder, "--reference", folder, code=2)
    assert "stands for 2" in several.stderr


def test_other_commands(folder: Path, tmp_path: Path) -> None:
    """Pack, show and compare the recordings of folders, and refuse to audit a folder that has none."""
    assert call("gsb-share", "pack", folder, "--out", tmp_path / "packed").returncode == 0
    assert len(list((tmp_path / "packed").glob("*.mcap"))) == 2
    assert call("gsb-view", folder, "--no-open", "--out", tmp_path / "page.html").returncode == 0
    assert call("gsb-compare", folder / "below", folder, "--gate", "physics").returncode in (0, 5)
    (tmp_path / "empty").mkdir()
    for name in ("gsb-audit", "gsb-view", "gsb-eval", "gsb-check", "gsb-info", "gsb-diff"):
        done = call(name, tmp_path / "empty", code=2)
        assert "is a folder without recordings" in done.stderr


def test_python(folder: Path) -> None:
    """Evaluate a folder from Python."""
    (result,) = evaluate([folder]).results
    assert len(result.group.recordings) == 2
