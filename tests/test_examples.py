"""The examples work as their documents say: as packages that are installed, and by the commands that are shown."""

from __future__ import annotations

import os
import shutil
import sys
import tomllib
from pathlib import Path

import pytest

from tests.conftest import finished, searched
from tests.reading import verified
from tests.test_docs import commands, shell

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
PACKAGE = EXAMPLES / "ballistic-simulator"


@pytest.fixture
def installed(tmp_path: Path) -> str:
    """The PYTHONPATH with which the package is there, with the entry points of its project file."""
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = tmp_path / "site" / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n", encoding="utf-8"
    )
    groups = "".join(
        f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in points.items())
        for group, points in project["entry-points"].items()
    )
    (info / "entry_points.txt").write_text(groups, encoding="utf-8")
    return searched(tmp_path / "site", PACKAGE / "src", EXAMPLES.parent)


@pytest.mark.slow
def test_the_packages_tests(installed: str, tmp_path: Path) -> None:
    """Pass the tests that come with the package, where it is installed."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(PACKAGE), str(PACKAGE)]
    environment = {**os.environ, "PYTHONPATH": installed, "PYTHONDONTWRITEBYTECODE": "1"}
    done = finished(command, cwd=tmp_path, env=environment, timeout=600)
    assert ", 13 skipped" in done.stdout


@pytest.mark.slow
def test_the_packages_commands(installed: str, tmp_path: Path) -> None:
    """Run what the package's document shows, and find its simulator, its scene and the tally of its checks."""
    document = PACKAGE / "README.md"
    printed = ""
    for line in commands(document):
        printed += shell(line, tmp_path, {"PYTHONPATH": installed}).stdout
    assert "three tilted dice fall" in printed
    assert "ballistic: 27 ok, 0 failed, 13 skipped" in printed
    text = document.read_text(encoding="utf-8")
    assert "27 checks hold. 13 are skipped" in " ".join(text.split())


@pytest.mark.slow
def test_a_program_that_logs(tmp_path: Path) -> None:
    """Run what the document shows beside the program, and evaluate its recordings."""

    shutil.copy(EXAMPLES / "log_your_own" / "log_states.py", tmp_path)
    for line in commands(EXAMPLES / "log_your_own" / "README.md"):
        done = shell(line, tmp_path, {"PYTHONPATH": searched(EXAMPLES.parent)})
    assert "three-balls" in done.stdout
    assert "throughput" in done.stdout
    recording = verified(tmp_path / "run-1.mcap")
    assert recording.status == "complete"
    assert recording.state("cubes", "position").shape == (101, 8, 3, 3)
