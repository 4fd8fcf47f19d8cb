"""The pytest plugin, as a simulator's own suite meets it: in a process of its own, found by its entry point."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from gpusimbench import open_recording, verify
from tests.conftest import call
from tests.test_start_up import HEAVY

ROOT = Path(__file__).resolve().parent.parent

SUITE = """\
import numpy as np

class Drift:
    made = 0

    def __init__(self, n_env):
        self.n_env, self.run = n_env, Drift.made
        Drift.made += 1

    def reset(self, seed):
        self.at, self.x = 0, np.random.default_rng(seed).normal(size=(self.n_env, 2)).astype(np.float32)
        return self.state()

    def step(self, action):
        self.at += 1
        self.x = self.x * np.float32(1.5)
        if self.run % 2 and self.at == 3:
            self.x[-1, 0] = np.nan
        return self.state()

    def state(self):
        n = self.n_env
        return {"x": self.x, "at": np.full(n, self.at), "ok": np.ones(n, bool), "position": np.zeros((n, 3))}

def test_same(gsb):
    gsb.assert_identical(np.zeros((2, 2)), np.zeros((2, 2)))

def test_drift(gsb):
    gsb.assert_deterministic(lambda: Drift(3), 5)

def test_uneven(gsb):
    gsb.assert_identical({"x": np.zeros((3, 2)), "y": np.zeros((4, 2))}, {"x": np.ones((3, 2)), "y": np.zeros((4, 2))})

def test_files(gsb):
    gsb.assert_identical(AMD, PYRAMIDAL)

def test_number(gsb):
    gsb.assert_batch_invariant(Drift, steps=5, numbers=(1, 2))
"""


@pytest.fixture
def site(tmp_path: Path) -> str:
    """The PYTHONPATH with which the entry points of pyproject.toml are there, however old the installation is."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = tmp_path / "site" / "gpusimbench-0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: gpusimbench\nVersion: 0\n")
    points = project["entry-points"]["pytest11"].items()
    (info / "entry_points.txt").write_text("[pytest11]\n" + "".join(f"{name} = {module}\n" for name, module in points))
    return os.pathsep.join([str(tmp_path / "site"), str(ROOT / "src")])


def run(suite: str, folder: Path, site: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run pytest on a file of tests, in a folder of its own."""
    (folder / "suite").mkdir()
    (folder / "suite" / "test_mine.py").write_text(suite)
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments, "test_mine.py"],
        cwd=folder / "suite", capture_output=True, text=True, timeout=300,
        env={**os.environ, "PYTHONPATH": site, "COLUMNS": "200"},
    )  # fmt: skip


def test_it_costs_nothing_where_it_is_not_used(tmp_path: Path, site: str) -> None:
    """Load the plugin with pytest, and with it nothing heavy, the recorder or the evaluator."""
    heavy = (*HEAVY, "gpusimbench.recorder", "gpusimbench.evaluator", "gpusimbench.testing")
    names = ("gpusimbench.pytest_plugin", *heavy)
    suite = f"import sys\n\ndef test():\n    print([name for name in {names} if name in sys.modules])\n"
    done = run(suite, tmp_path, site, "-s", "-p", "no:xdist", "-p", "no:hypothesispytest", "-p", "no:anyio")
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^\['gpusimbench.pytest_plugin'\]", done.stdout, re.MULTILINE), done.stdout


@pytest.mark.slow
def test_failures_and_what_is_kept(tmp_path: Path, site: str) -> None:
    """Fail at the line of the suite, with the first difference, and keep both sides for gsb-diff."""
    files = {name.upper(): str(ROOT / "recordings" / f"mujoco-{name}-r0.mcap") for name in ("amd", "pyramidal")}
    suite = SUITE + "".join(f"\n{name} = {path!r}" for name, path in files.items())
    done = run(suite, tmp_path, site, "--gsb-keep", "kept")
    assert done.returncode == 1, done.stderr
    assert "4 failed, 1 passed" in done.stdout
    assert "run 0 and run 1 differ first at step 3, in env 2: x[0]: " in done.stdout
    assert "1 env alone and the same env among 2 differ first at step 3: x[0]: " in done.stdout
    lines = enumerate(SUITE.splitlines(), 1)
    calls = [str(number) for number, line in lines if line.startswith("    gsb.")][1:]  # the first passes
    assert re.findall(r"^test_mine.py:(\d+): AssertionError", done.stdout, re.MULTILINE) == calls
    assert "not kept: the arrays of a are not of one number of environments and steps" in done.stdout
    kept = tmp_path / "suite" / "kept"
    names = ("test_drift", "test_files", "test_number")
    assert sorted(path.name for path in kept.iterdir()) == [
        f"test_mine.py-{name}-{side}.mcap" for name in names for side in "ab"
    ]
    a, b = (open_recording(kept / f"test_mine.py-test_drift-{side}.mcap") for side in "ab")
    for recording in (a, b):
        verify(recording)
    assert (a.status, b.status) == ("complete", "invalid")
    assert b.reason == "a state is not finite: step 3, env 2, env/x"
    x = a.state("env", "x")[:]
    assert x.shape == (6, 3, 1, 2)
    expected = np.random.default_rng(0).normal(size=(3, 2)).astype(np.float32)
    for _ in range(5):
        expected = expected * np.float32(1.5)
    assert np.array_equal(x[-1, :, 0], expected)
    assert {f.field: (f.dtype, f.unit, f.note) for f in a.fields} == {
        "x": ("float32", "unknown", ""),
        "at": ("float64", "unknown", "recorded from int64"),
        "ok": ("float32", "unknown", "recorded from bool"),
        "position_array": ("float64", "unknown", ""),
    }
    evaluated = call("gsb-eval", a.path, b.path, code=0)
    assert "positions are compared" not in evaluated.stdout
    found = call("gsb-diff", a.path, b.path, code=4)
    assert "from step 3 (3 s) on, first in env 2: env/x[0]: " in found.stdout
    assert "items " not in found.stdout


@pytest.mark.slow
def test_recordings_of_failures_are_not_written_over(tmp_path: Path, site: str) -> None:
    """Keep the recordings of a test that fails twice, and nothing where nothing is to be kept."""
    suite = (
        "import numpy as np\n\ndef test(gsb):\n"
        "    for _ in range(2):\n        try:\n"
        "            gsb.assert_identical(np.zeros((2, 1)), np.ones((2, 1)))\n"
        "        except AssertionError as error:\n            print(error)\n"
    )
    done = run(suite, tmp_path, site, "-s", "--gsb-keep", "kept")
    assert done.returncode == 0
    assert len(re.findall("kept: gsb-diff", done.stdout)) == 2
    kept = tmp_path / "suite" / "kept"
    assert sorted(path.name for path in kept.iterdir()) == [
        f"test_mine.py-test-{name}.mcap" for name in ("2-a", "2-b", "a", "b")
    ]
    (tmp_path / "again").mkdir()
    done = run(suite, tmp_path / "again", site, "-s")
    assert "kept" not in done.stdout
    assert not (tmp_path / "again" / "suite" / "kept").exists()
