"""The drop of gsb-import: when a model touches the ground on an engine, and what the ground carries."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest

from gpusimbench.evaluator.imports.audit import Landing, landings
from gpusimbench.evaluator.missing import Missing
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene, model_scene
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.mujoco.trials import AFTER_S, dropped
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.imported import Drop
from gpusimbench.schemas.model_files import pack
from tests.conftest import call, has_ended, wait_for

pytest.importorskip("mujoco")

HEIGHT_M, RADIUS_M = 0.4, 0.05
BALL = f"""
<mujoco>
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="ball" pos="0 0 {HEIGHT_M}">
      <freejoint/>
      <geom name="ball" type="sphere" size="{RADIUS_M}" mass="0.2"/>
    </body>
  </worldbody>
</mujoco>
"""


def _scene(folder: Path, text: str, name: str = "ball") -> ModelScene:
    path = folder / f"{name}.xml"
    path.write_text(text)
    return model_scene(name, pack(path))


def _maker(given: ModelScene | None = None, engine: str = "mujoco") -> Callable[[Scene, int], Simulator]:
    # simulators of the scene that they are asked for, or of another that they are given instead
    adapter = find_simulator(engine).load()

    def make(scene: Scene, n_env: int) -> Simulator:
        of = given or scene
        return adapter(of, n_env=n_env, dt=of.dt, seed=0, options=adapter.parsed(engine, of, {}))

    return make


def _fallen(scene: ModelScene, make: Callable[[Scene, int], Simulator]) -> Drop:
    drop = dropped(scene, make, dt=scene.dt)
    return Drop.decoded(drop.encoded())


def test_a_ball(tmp_path: Path) -> None:
    """Touch the ground when Galileo says so, and carry the weight in the end."""
    scene = _scene(tmp_path, BALL)
    drop = _fallen(scene, _maker())
    assert drop.weight == pytest.approx(0.2 * 9.81)
    np.testing.assert_allclose(drop.height[:10], HEIGHT_M - 9.81 * drop.time[:10] ** 2 / 2, atol=2e-4)
    np.testing.assert_allclose(drop.momentum[:10], -drop.weight * drop.time[:10], atol=1e-9)
    found = landings(drop, drop)
    assert not isinstance(found, Missing)
    assert found.engine == found.reference
    falls = (2 * (HEIGHT_M - RADIUS_M) / 9.81) ** 0.5
    assert found.duration == pytest.approx(falls + AFTER_S, abs=2 * scene.dt)
    assert found.engine.time == pytest.approx(falls, abs=2 * scene.dt)
    assert found.engine.height == pytest.approx(RADIUS_M, abs=0.006)
    assert found.engine.carried == pytest.approx(1, abs=0.02)


def test_an_engine_that_loses_contacts(tmp_path: Path) -> None:
    """See that nothing carries the ball where the engine's copy of the model collides with nothing."""
    scene = _scene(tmp_path, BALL)
    lost = _scene(tmp_path, BALL.replace('mass="0.2"', 'mass="0.2" contype="0" conaffinity="0"'), "lost")
    found = landings(_fallen(scene, _maker()), _fallen(scene, _maker(lost)))
    assert not isinstance(found, Missing)
    assert found.engine.time == found.reference.time
    assert found.engine.carried == pytest.approx(0, abs=1e-6)
    high = _scene(tmp_path, BALL.replace(f"0 0 {HEIGHT_M}", "0 0 90"), "high")
    found = landings(_fallen(scene, _maker()), _fallen(scene, _maker(high)))
    assert not isinstance(found, Missing)
    assert isinstance(found.engine, Landing) and isinstance(found.engine.time, Missing)
    slower = _scene(tmp_path, BALL.replace("0.002", "0.004"), "slower")
    assert isinstance(landings(_fallen(scene, _maker()), _fallen(slower, _maker())), Missing)


@pytest.mark.parametrize(
    ("text", "instead"),
    [
        ("<freejoint/>", '<joint type="slide" axis="0 0 1"/>'),
        ('gravity="0 0 -9.81"', 'gravity="0 0 0"'),
        ('<geom type="plane" size="1 1 .1"/>', ""),
    ],
)
def test_models_that_do_not_fall(text: str, instead: str, tmp_path: Path) -> None:
    """Try no drop of a model on a base, without gravity, or above nothing."""
    assert text in BALL
    assert dropped(_scene(tmp_path, BALL.replace(text, instead)), _maker(), dt=0.002) is None


@pytest.mark.slow
def test_the_command_shows_the_drop(tmp_path: Path) -> None:
    """Record the drop on MuJoCo C and on MuJoCo Warp, which agree, and show both."""
    pytest.importorskip("mujoco_warp")
    path = tmp_path / "ball.xml"
    path.write_text(BALL)
    done = call("gsb-import", path, "--sim", "warp", "--out", tmp_path / "out", "--json", tmp_path / "found.json")
    assert done.returncode == 0, done.stderr
    assert "weight carried at the end" in done.stdout
    (engine,) = json.loads((tmp_path / "found.json").read_text())["engines"]
    ours, theirs = (engine["landings"][name] for name in ("reference", "engine"))
    assert theirs["time"] == pytest.approx(ours["time"], abs=0.003)  # a step
    assert theirs["carried"] == pytest.approx(ours["carried"], abs=0.01)


@pytest.mark.slow
def test_a_reference_that_fails(tmp_path: Path) -> None:
    """Say why MuJoCo C could not be recorded, here for the memory of collisions, and not that it was not asked."""
    path = tmp_path / "crowd.xml"
    still = "".join(f'<body pos="{at} 0 0"><geom size=".1"/></body>' for at in range(1000))
    fall = '<body pos="0 0 1"><freejoint/><geom size=".1"/></body>'
    path.write_text(f'<mujoco><size memory="1M"/><worldbody>{still}{fall}</worldbody></mujoco>')
    done = call("gsb-import", path, "--sim", "warp", cwd=tmp_path, code=ExitCode.FAILURE)
    assert "mujoco could not be recorded: failed: SimulationError in phase init: " in done.stderr
    assert "out of memory" in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(
    sys.platform != "linux", reason="the kernel of Linux alone tells a process that its parent has ended"
)
def test_a_run_ends_with_a_killed_command(tmp_path: Path) -> None:
    """Leave no process behind where gsb-import is killed while gsb-record records for it."""
    path = tmp_path / "ball.xml"
    path.write_text(BALL)
    command = [sys.executable, "-m", "gpusimbench.evaluator.cli.imported", str(path), "--sim", "warp"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL) as running:
        try:
            found: list[psutil.Process] = []
            wait_for(lambda: found.extend(psutil.Process(running.pid).children(recursive=True)) or len(set(found)) > 1)
        finally:
            running.kill()
    wait_for(lambda: all(map(has_ended, found)))
    assert not list(tmp_path.glob("imports/*.mcap")), "nothing looks complete"
