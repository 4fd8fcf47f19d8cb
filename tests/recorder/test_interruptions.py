"""Ctrl-C at any moment: one line, the right exit code, and recordings that hold what was written."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify
from tests.conftest import Command, command, distribution, run_python, wait_for
from tests.reading import verified
from tests.recorder.conftest import folder_of

pytestmark = pytest.mark.slow

_INTERRUPTED_BETWEEN = '''
"""Interrupt a capture right after the digest of its n-th piece of a kind; print how it ended."""
import os, signal, sys
from pathlib import Path
from gpusimbench.recorder import interruption
from gpusimbench.recorder.run.run import Run
from gpusimbench.schemas import digest
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.provenance import Provenance

kind, path = sys.argv[1], Path(sys.argv[2])
original, calls = getattr(digest.ContentDigest, kind), []

def interrupting(self, *arguments):
    original(self, *arguments)
    calls.append(kind)
    if len(calls) == 4:
        os.kill(os.getpid(), signal.SIGINT)

setattr(digest.ContentDigest, kind, interrupting)
interruption.install()
configuration = RunConfiguration("mujoco", "inclined-collision", 70, 0.01, 200, phases=("capture",))
provenance = Provenance("r", "2026-01-01T00:00:00Z", (), configuration)
outcome = Run(provenance, path, progress=lambda *_: None, log=lambda: b"").record()
print(outcome.status, outcome.reason)
'''


@pytest.mark.parametrize("kind", ["attachment", "message", "state"])
def test_digests_and_bytes_go_together(tmp_path: Path, kind: str) -> None:
    """Verify after an interruption between the digest of something and its writing."""
    path = tmp_path / "x.mcap"
    done = run_python(_INTERRUPTED_BETWEEN, kind, path)
    assert done.stdout.startswith("FAILED interrupted in phase")
    recording = verified(path)
    assert recording.status == "failed"


@pytest.mark.parametrize(
    ("mode", "reason"),
    [("raise", "ValueError in phase capture: the solver gave up"), ("interrupt", "interrupted in phase capture")],
)
def test_a_strided_capture_that_ends_early(
    gsb_record: Command, plugin: dict[str, str], tmp_path: Path, mode: str, reason: str
) -> None:
    """Keep every state up to the end, also those that waited for a full block, in a recording that verifies."""
    gsb_record(
        "--sim", "faulty", "--n-env", 2, "--runs", 1, "--steps", 2000, "--stride", 20, "--phases", "capture",
        "--option", f"mode={mode}", "--option", "at=770", "--out", tmp_path, env=plugin, code=1,
    )  # fmt: skip
    (file,) = tmp_path.iterdir()
    recording = verified(file)
    assert (recording.status, recording.reason) == ("failed", reason)
    cubes = recording.state("cubes", "position")
    assert cubes.steps.tolist() == list(range(0, 751, 20))
    assert np.array_equal(cubes[:, 0, 0, 0], cubes.steps)
    hashes = recording.fingerprints("capture")
    assert len(hashes.steps) == 751


def test_an_interruption_at_any_moment_of_the_start(tmp_path: Path) -> None:
    """End with 1 and one line on Ctrl-C at 20 moments of the first second; files that are there are whole."""
    for number in range(20):
        out = tmp_path / str(number)
        process = subprocess.Popen(
            [sys.executable, "-c", _TELLING, "--sim", "mujoco", "--n-env", "2", "--runs", "3", "--steps", "3000",
             "--phases", "capture", "--out", str(out)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        process.stdout.readline()
        time.sleep(0.04 * number)
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=300)
        if "Exception ignored" in err:
            continue  # Python drops what is raised in a destructor, or while it forgets the lock of an import
        assert process.returncode == 1, err
        assert "Traceback" not in err
        assert "interrupted" in err
        for file in out.iterdir() if out.exists() else ():
            assert file.suffix == ".mcap"
            verify(open_recording(file))


# The interpreter's own start is not ours to guard: say when it is over.
_TELLING = """
import sys
try:
    print(flush=True)
    from gpusimbench.recorder.cli import main
    code = main()
except KeyboardInterrupt:  # the moment before main
    print("interrupted", file=sys.stderr)
    code = 1
sys.exit(code)
"""


def test_an_interruption_keeps_results(plugin: dict[str, str], tmp_path: Path) -> None:
    """Print the runs so far as JSON after an interruption."""
    process = subprocess.Popen(
        [*command("gsb-record"), "--sim", "faulty", "--n-env", "2", "--runs", "100", "--steps", "20", "--phases",
         "capture", "--json", "--out", str(tmp_path)],
        env=plugin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    wait_for(lambda: len(list(tmp_path.glob("*.mcap"))) >= 2)
    process.terminate()
    out, err = process.communicate(timeout=300)
    assert process.returncode == 1
    runs = json.loads(out)["runs"]
    assert f"interrupted: {len(runs)} of 100 runs were started" in err
    assert sorted(r["file"] for r in runs if r["file"]) == sorted(map(str, tmp_path.iterdir()))


def test_a_second_interruption_kills_the_run(plugin: dict[str, str], tmp_path: Path) -> None:
    """End at once on a second Ctrl-C when the engine does not let itself be interrupted."""
    process = subprocess.Popen(
        [*command("gsb-record"), "--sim", "faulty", "--n-env", "2", "--runs", "2", "--steps", "100000", "--phases",
         "capture", "--option", "mode=deaf", "--out", str(tmp_path)],
        env=plugin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    for word in ("deaf", "heeded"):
        wait_for(lambda word=word: any(folder_of(plugin).glob(f"{word}-*")))  # type: ignore[misc]
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 3
    assert "was killed by SIGKILL" in err
    assert out.strip().endswith(".partial")


def test_an_import_that_is_interrupted_is_no_broken_one(tmp_path: Path) -> None:
    """Say that it was interrupted, not that the simulator cannot be loaded, when Ctrl-C meets an import."""
    (tmp_path / "hasty.py").write_text(
        "import os, signal\n"
        "try:\n    os.kill(os.getpid(), signal.SIGINT)\n"
        "except KeyboardInterrupt:\n    raise ImportError('initialization failed') from None\n"
        "class Hasty: pass\n"
    )
    distribution(tmp_path, "hasty", "[gsb.simulators]\nhasty = hasty:Hasty\n")
    done = subprocess.run(
        [*command("gsb-record"), "--sim", "hasty", "--out", str(tmp_path / "out")],
        env={**os.environ, "PYTHONPATH": str(tmp_path)}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "gsb-record: interrupted\n"
