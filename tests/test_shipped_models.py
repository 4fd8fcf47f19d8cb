"""The recordings of model files that ship, and what the documents beside them say."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.initial import GIVEN
from gpusimbench.schemas.treatment import CONTROLS
from tests.conftest import call
from tests.scripts import drawn, script
from tests.test_docs import FENCE, shows

RECORDINGS = Path(__file__).resolve().parent.parent / "recordings"
SMALL = {"ant": 3.1e6, "humanoid": 3.2e6, "manipulator": 2.1e6}
"""Folders, and what their recordings may take together [bytes]."""

ARM = ("arm_root", "arm_shoulder", "arm_elbow", "arm_wrist")
"""Joints of the manipulator from its root, 0.4 m above the ground, to its hand."""

ARM_M = np.array([0.18, 0.15, 0.12, 0.065])
"""From each of them to the next, and from the last to the middle of the palm [m]."""


@pytest.fixture(scope="module")
def models() -> ModuleType:
    """docs/make_models.py."""
    return script("make_models")


@pytest.mark.parametrize("folder", SMALL)
def test_the_table_is_that_of_the_files(models: ModuleType, folder: str) -> None:
    """Hold the table to the recordings; make figures redraws it."""
    assert list(models.TIMES) == list(SMALL)
    assert drawn(models.page(folder), "engines") == models.table(folder)


@pytest.mark.parametrize("folder", SMALL)
def test_the_recordings_are_whole_and_small(models: ModuleType, folder: str) -> None:
    """Verify each, of the recorder as it is in the history; the model's licence lies beside them."""
    runs = models.runs(folder)
    for run in runs:
        verify(run)
        assert (run.status, run.cause) in (("complete", ""), ("failed", "refused"))
        assert not run.provenance.software["recorder"]["modified"]
        given = [word for word in run.provenance.argv if word.startswith("/")]
        assert not given or (folder, run.simulation.device) == ("ant", "NVIDIA H100 80GB HBM3")
    assert sum(run.path.stat().st_size for run in runs) < SMALL[folder]
    notice = (RECORDINGS / folder / "LICENSE").read_text(encoding="utf-8")
    assert ("Apache License" if folder == "manipulator" else "Farama Foundation") in notice


def test_what_the_humanoid_shows(models: ModuleType) -> None:
    """The MuJoCo family stays within 9.1 um through the landing, but MJX on a GPU; in PhysX the knees give way."""
    reference, *others = models.runs("humanoid")
    for run in others:
        largest, bodies = models.off(run, reference)
        assert bodies
        family = run.configuration.simulator in ("warp", "newton", "mjx")
        assert (largest[-1] < 9.1e-6) == (family and not _tf32(run)), run.path.name
        assert largest[-1] < 6e-3 or not _tf32(run)
    step = 13  # 0.39 s
    assert _height(reference)[step] == pytest.approx(1.14, abs=0.005)
    in_physx = [_height(run)[step] for run in others if run.configuration.simulator == "physx"]
    assert in_physx == pytest.approx([0.85, 0.85], abs=0.005)


def _tf32(run: Recording) -> bool:
    # whether JAX may have rounded the factors of matrix products to TF32
    assert run.simulation is not None
    on_gpu = run.configuration.simulator == "mjx" and run.simulation.device != "cpu"
    return on_gpu and run.simulation.switches["matmul_precision"] == "default"


def test_what_the_precision_of_products_costs(models: ModuleType) -> None:
    """In the air, MJX on a GPU is as near to MuJoCo C as on a CPU, if JAX is asked for products in float32."""
    runs = models.runs("ant")
    reference = next(run for run in runs if run.configuration.simulator == "mujoco")
    found = {(models.device(run), models.precision(run)): run for run in runs if run.configuration.simulator == "mjx"}
    in_air = {key: models.off(run, reference)[0][1] for key, run in found.items()}  # at 0.1 s [m]
    assert in_air["CPU", ""] < 81e-9
    assert in_air["H100", "matmul_precision=highest"] < 81e-9
    assert in_air["H100", ""] == pytest.approx(11.6e-6, rel=0.01)
    assert [_tf32(run) for run in found.values()].count(True) == 1


def _height(run: Recording) -> np.ndarray:
    # of the torso of environment 0, at each recorded step [m]
    return np.asarray(run.state("bodies", "position")[:])[:, 0, 0, 2]


def test_the_inputs_of_the_hand(models: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The program of the page makes the first states and the controls that the recordings carry."""
    page = models.page("manipulator").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(re.findall(r"```python\n(.*?)```", page, re.DOTALL)[0], {})  # noqa: S102
    for run in models.runs("manipulator"):
        for name in (CONTROLS, GIVEN):
            data = run.attachment(name)
            assert data is not None
            kept = arrays.decode(name, data)
            made = arrays.decode(name, Path("controls.npz" if name == CONTROLS else "initial.npz").read_bytes())
            assert kept.keys() == made.keys()
            for key, array in made.items():
                np.testing.assert_array_equal(kept[key], array.astype(kept[key].dtype))


def test_what_the_hand_shows(models: ModuleType) -> None:
    """The hand keeps the ball on every engine that takes the model; the others name the constraint that they lack."""
    runs = models.runs("manipulator")
    taken = [run for run in runs if run.status == "complete"]
    engines = [run.configuration.simulator for run in taken]
    assert engines == ["mujoco", "warp", "warp", "newton", "newton", "mjx", "mjx"]
    for run in runs[len(taken) :]:
        assert "constraint of equality 'coupling'" in run.reason
    arms = [np.asarray(run.state("joints", "qpos")[:])[..., : len(ARM), 0] for run in taken]
    assert max(np.abs(arm - arms[0]).max() for arm in arms) < 1e-4
    most = [float(models.off(run, taken[0])[0].max()) for run in taken[1:]]  # on a CPU and on an H100
    assert max(most[:2]) < 5e-5
    assert most[2:4] == pytest.approx([0.023, 0.023], abs=5e-4)
    assert most[4:] == pytest.approx([0.0019, 0.0064], rel=0.03)
    for run in taken:
        names = next(field.items for field in run.simulation.fields if field.name == "joints/qpos")
        qpos = np.asarray(run.state("joints", "qpos")[:])[..., 0]
        angles = np.cumsum(qpos[..., [names.index(name) for name in ARM]], axis=-1)  # about -y
        palm = np.stack([-np.sin(angles) @ ARM_M, 0.4 + np.cos(angles) @ ARM_M], axis=-1)
        ball = qpos[..., [names.index("ball_x"), names.index("ball_z")]]
        assert np.linalg.norm(ball - palm, axis=-1).max() < 0.018
        assert np.linalg.norm(palm - palm[0], axis=-1).max() > 0.4  # the arm swings


def test_what_the_readme_shows() -> None:
    """The command of the README on a model's recordings prints what stands below it, and says of PhysX what follows."""
    text = (RECORDINGS.parent / "README.md").read_text(encoding="utf-8")
    section = text.partition("## Do engines agree on my robot?")[2].partition("\n## ")[0]
    (_, _, command), (_, _, printed) = FENCE.findall(section)
    _, first, second = command.partition("  # exit code ")[0].split()
    a, b = (RECORDINGS.parent / name for name in (first, second))
    assert shows(printed, call("gsb-diff", a, b, code=ExitCode.GATE_FAILED).stdout)
    other = call("gsb-diff", a, RECORDINGS / "humanoid" / "physx-cpu.mcap", code=ExitCode.GATE_FAILED).stdout
    assert "bodies up to 22.5 cm apart at 0.6 s, 1 mm reached by 0.15 s" in other
