"""What `import gpusimbench` offers, and how it lives beside a user's own folders and older plug-ins."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import gpusimbench
from gpusimbench.schemas.errors import GsbError
from tests.conftest import finished, run_python
from tests.test_docs import ROOT, blocks

FUNCTIONS = ("compare", "diff", "evaluate", "open_recording", "record_rollout", "verify", "wrap")
CLASSES = ("RecordingWriter", "Scene", "Simulator")
LATER = (*CLASSES, "record_rollout", "wrap")


def test_the_public_names() -> None:
    """Offer these names and no others; a name that goes, or comes, is a decision."""
    errors = [name for name in gpusimbench.__all__ if name not in (*FUNCTIONS, *CLASSES)]
    assert sorted([*FUNCTIONS, *CLASSES, *errors]) == sorted(gpusimbench.__all__)
    assert errors == [
        "DamagedRecording", "DataLost", "GateFailed", "GsbError", "NotARecording", "NothingComparable",
        "RecordingError", "Unreachable", "UsageError",
    ]  # fmt: skip
    assert all(issubclass(getattr(gpusimbench, name), GsbError) for name in errors)
    with pytest.raises(AttributeError, match="has no attribute 'wrapp'"):
        _ = gpusimbench.wrapp


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_say_what_they_take_and_return(name: str) -> None:
    """Say of each function what it returns and raises, and of each of its parameters what it is."""
    function = getattr(gpusimbench, name)
    text = function.__doc__
    assert "Return" in text and "Raises" in text
    parameters = [p for p in function.__annotations__ if p != "return"]
    assert all(p in text for p in parameters)


@pytest.mark.parametrize("name", LATER)
def test_names_of_the_recorder_come_when_asked_for(name: str) -> None:
    """Load the recorder for its own names alone: evaluating needs none of it."""
    code = (
        f"import sys, gpusimbench; before = 'gpusimbench.recorder' in sys.modules; gpusimbench.{name}.__doc__.strip(); "
        "print(before, 'gpusimbench.recorder' in sys.modules)"
    )
    done = run_python(code)
    assert done.stdout.split() == ["False", "True"]


@pytest.mark.parametrize("page", ["README.md", pytest.param("docs/python.md", marks=pytest.mark.slow)])
def test_examples_run_beside_folders_of_the_user(page: str, tmp_path: Path) -> None:
    """Run the examples in a folder that has an evaluator/, a recorder/ and a schemas/ of its own."""
    for name in ("evaluator", "recorder", "schemas"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('this is the folder of the user')\n")
    (tmp_path / "recordings").mkdir()
    for path in (ROOT / "recordings").glob("*.mcap"):
        shutil.copy(path, tmp_path / "recordings")
    for block in blocks(ROOT / page, "python"):
        (tmp_path / "example.py").write_text(block)
        done = finished(
            [sys.executable, "example.py"], cwd=tmp_path, env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        )
        assert done.stdout


@pytest.mark.slow
def test_results_are_those_of_the_commands() -> None:
    """Evaluate, compare and diff shipped recordings from Python."""
    shipped = ROOT / "recordings"
    files = [str(shipped / "mujoco-amd-r*.mcap"), shipped / "mujoco-xeon-r0.mcap"]
    evaluation = gpusimbench.evaluate(files)
    assert sorted(len(result.group.recordings) for result in evaluation.results) == [1, 3]
    assert not evaluation.unreadable
    same = gpusimbench.diff(shipped / "mujoco-amd-r0.mcap", shipped / "mujoco-amd-r1.mcap")
    assert same.verdict.value == "bit-identical"
    within = gpusimbench.diff(shipped / "mujoco-amd-r0.mcap", envs=(0, 1))
    assert within.verdict.value == "bit-identical"
    found = gpusimbench.compare(
        [shipped / f"mujoco-amd-r{r}.mcap" for r in (0, 1)], [shipped / f"mujoco-pyramidal-r{r}.mcap" for r in (0, 1)],
        across=["cone"],
    )  # fmt: skip
    assert len(found.compared) == 1


def test_errors_reach_the_caller(tmp_path: Path) -> None:
    """Raise the error that a command would show."""
    path = tmp_path / "no.mcap"
    path.write_bytes(np.arange(64).tobytes())
    with pytest.raises(gpusimbench.NotARecording):
        gpusimbench.open_recording(path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(gpusimbench.UsageError):
        gpusimbench.compare([tmp_path / "empty"], [path])
    assert [str(lost.error) for lost in gpusimbench.evaluate([tmp_path / "none*.mcap"]).unreadable]
    with pytest.raises(gpusimbench.NotARecording):
        gpusimbench.evaluate([ROOT / "recordings" / "mujoco-amd-r0.mcap"], reference=path)


@pytest.mark.parametrize("package", ["recorder.simulators.base", "schemas.errors", "evaluator"])
@pytest.mark.parametrize(("group", "wanted"), [("gsb.simulators", "simulator"), ("gsb.scenes", "scene")])
def test_plugins_that_import_old_names(package: str, group: str, wanted: str, tmp_path: Path) -> None:
    """Say what to import now where an installed plug-in imports the packages by the names that they had."""
    (tmp_path / "old_plugin.py").write_text(f"import {package}\n")
    folder = tmp_path / "old_plugin-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: old-plugin\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text(f"[{group}]\nolden = old_plugin:make\n")
    asked = ["--sim", "olden"] if wanted == "simulator" else ["--sim", "mujoco", "--scene", "olden"]
    done = finished(
        [sys.executable, "-P", "-m", "gpusimbench.recorder.cli", *asked, "--out", str(tmp_path / "out")],
        code=2,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT / "src")])},
    )
    root = package.partition(".")[0]
    assert f"No module named '{root}'; import gpusimbench.{root}" in done.stderr
    assert "docs/python.md" in done.stderr
