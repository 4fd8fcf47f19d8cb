"""What is particular to the adapter of MuJoCo C; what every adapter must do is in recorder.conformance."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest

from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.recorder.scenes.base import IDENTITY
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.mujoco import model as model_module
from gpusimbench.recorder.simulators.mujoco import worlds
from gpusimbench.schemas.errors import UsageError
from tests.conftest import call
from tests.recorder import engines
from tests.recorder.engines import field

build = partial(engines.build, "mujoco")


def test_equals_a_plain_loop() -> None:
    """Give the bits of mj_step called by hand."""
    simulator, description = build(make_scene("inclined-collision"))
    model = mujoco.MjModel.from_xml_string(description.attachments["scene.xml"][1].decode())
    data = mujoco.MjData(model)
    for _ in range(80):
        mujoco.mj_step(model, data)
    simulator.step(80)
    cubes = field(description, simulator.state(), "cubes/position")
    expected = data.qpos.reshape(-1, 7)[1:, :3]  # the ball comes first
    assert all(cubes[env].tobytes() == np.ascontiguousarray(expected).tobytes() for env in range(2))


@pytest.mark.parametrize("scene", ["inclined-collision", "free-fall", "franka"])
def test_steps_without_the_batch_have_the_same_bits(scene: str) -> None:
    """Give the states, counts and hashes of the batch by mj_step of each environment, also after a restart."""
    found, steppings = [], []
    for stepping, threads in (("batch", 2), ("mj_step", 1), ("mj_step", 2)):
        simulator, description = build(make_scene(scene), n_env=5, stepping=stepping, threads=threads)
        actions = make_scene(scene).actions
        simulator.prepare(None if actions is None else actions.draw(7, n_env=5, first_step=0, n_step=140))
        captured = simulator.states(100)  # past the impact
        evidence = simulator.evidence()
        simulator.step(20)
        simulator.reset(np.array([1, 4]))
        simulator.step(20)
        counts = (evidence.counts[name] for name in ("contacts", "constraint_rows"))
        arrays = (*captured, *counts, *simulator.state())
        found.append([array.tobytes() for array in arrays])
        steppings.append(description.options.get("stepping", "batch"))
    assert found[1] == found[0]
    assert found[2] == found[0]
    assert steppings == ["batch", "mj_step", "mj_step"]


def test_releases_without_a_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Step by mj_step where MuJoCo has no batch, say so, and refuse a batch that is asked for."""
    monkeypatch.setattr(worlds, "find_spec", lambda name: None)
    _, description = build(make_scene("free-fall"))
    assert description.options["stepping"] == "mj_step"
    assert description.timing_covers.startswith("mj_step of each environment")
    with pytest.raises(UsageError, match="has no mujoco.batch; use stepping=mj_step"):
        build(make_scene("free-fall"), stepping="batch")


def test_releases_that_reset_bad_states(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Leave out the flag that older releases do not know, say so, and report the resets."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log to the working folder
    monkeypatch.setattr(model_module, "KNOWS_AUTORESET", False)
    scene = make_scene("free-fall")
    fast = replace(scene.bodies[1], linear_velocity=(1e12, 0.0, 0.0), orientation=IDENTITY)
    simulator, description = build(replace(scene, bodies=(scene.bodies[0], fast)), stepping="mj_step")
    assert description.switches == {"precision": "float64", "autoreset": "enable"}
    assert b"autoreset" not in description.attachments["scene.xml"][1]
    simulator.step(2)
    assert "mjWARN_BADQ" in simulator.gates()[0]


@pytest.mark.parametrize("threads", ["1", "3"])
def test_threads_change_nothing(threads: str) -> None:
    """Give the same bits on any number of threads."""
    states = []
    for count in ("2", threads):
        simulator, _ = build(make_scene("inclined-collision"), n_env=5, threads=count)
        states.append(simulator.states(60))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(*states, strict=True))


def test_a_warning_is_a_gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Report MuJoCo's own warnings, once."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log to the working folder
    scene = make_scene("free-fall")
    fast = replace(scene.bodies[1], linear_velocity=(1e12, 0.0, 0.0), orientation=IDENTITY)
    simulator, _ = build(replace(scene, bodies=(scene.bodies[0], fast)))
    simulator.step(2)
    (fired,) = simulator.gates()
    assert "mjWARN_BADQ" in fired
    assert simulator.gates() == []


FALLING = """
<mujoco model="falling"><size memory="{memory}"/><option timestep="0.002"/><worldbody><geom type="plane" size="2 2 .1"/>
<body pos="0 0 .20"><freejoint/><geom type="box" size=".05 .05 .05"/></body>
<body pos="0 0 .31"><freejoint/><geom type="box" size=".05 .05 .05"/></body>
<body pos="0 0 .42"><freejoint/><geom type="box" size=".05 .05 .05"/></body>
<body pos="0 0 .53"><freejoint/><geom type="box" size=".05 .05 .05"/></body></worldbody></mujoco>
"""


def _steps_that_drop(xml: str, n_step: int) -> dict[str, list[int]]:
    """By mj_step called by hand: the steps after which MuJoCo had counted another lack of room, by kind, if any."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    found: dict[str, list[int]] = {}
    for step in range(1, n_step + 1):
        before = data.warning.number.copy()
        mujoco.mj_step(model, data)
        for kind in (mujoco.mjtWarning.mjWARN_CONTACTFULL, mujoco.mjtWarning.mjWARN_CNSTRFULL):
            if data.warning[kind].number > before[kind]:
                found.setdefault(kind.name, []).append(step)
    return found


@pytest.mark.parametrize(("memory", "stepping"), [("16K", "batch"), ("16K", "mj_step"), ("1M", "batch")])
def test_dropped_constraints_are_told(memory: str, stepping: str, tmp_path: Path) -> None:
    """Tell at which steps MuJoCo's memory was too small, as MuJoCo's own counters do, and where it never was."""
    (tmp_path / "falling.xml").write_text(FALLING.format(memory=memory))
    dropping = _steps_that_drop(FALLING.format(memory=memory), 200)
    small = memory == "16K"
    assert len(dropping) == (2 if small else 0)
    asked = ("--model", "falling.xml", "--n-env", "2", "--runs", "1", "--phases", "capture", "--steps", "200")
    options = ("--option", f"stepping={stepping}", "--out", "out")
    said = call("gsb-record", "--sim", "mujoco", *asked, *options, cwd=tmp_path, code=1 if small else 0)
    (path,) = (tmp_path / "out").glob("*.mcap")
    (result,) = evaluate_files([path]).results
    assert result.validity.overflow_told.yes != small  # asked of complete runs
    assert result.validity.overflow is not None
    fired = {seen.name: (seen.fatal, seen.first_step, seen.rows, seen.envs) for seen in result.validity.overflow}
    assert fired == {name: (True, steps[0], len(steps), 2) for name, steps in dropping.items()}
    assert ("buffer overflow mjWARN_CNSTRFULL in 2 of 2 envs" in said.stderr) == small
    assert "MuJoCo warning" not in said.stderr


def test_options_are_those_in_force() -> None:
    """Record what the compiled model has, in the words of MJCF."""
    asked = {"integrator": "RK4", "solver": "CG", "iterations": "7", "tolerance": "1e-5", "impratio": "2.5",
             "solref": "-1e3 -2", "solimp": ".8 .9 1e-3 0.5 2", "condim": "4", "threads": "1"}  # fmt: skip
    _, description = build(make_scene("inclined-collision"), **asked)
    options = description.options
    assert options == {
        "integrator": "RK4", "cone": "elliptic", "solver": "CG", "iterations": 7, "ls_iterations": 50,
        "tolerance": 1e-5, "impratio": 2.5, "solref": "-1000 -2", "solimp": "0.8 0.9 0.001 0.5 2", "condim": 4,
        "threads": 1,
    }  # fmt: skip
    model = mujoco.MjModel.from_xml_string(description.attachments["scene.xml"][1].decode())
    assert (model.geom_solref == [-1000, -2]).all()
    assert (model.geom_condim == 4).all()
    _, description = build(make_scene("franka"))
    assert (description.options["solref"], description.options["solimp"]) == ("0.02 1", "0.9 0.95 0.001 0.5 2")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in ("tolerance", "impratio") for value in ("nan", "inf", "-1")),
        *((name, value) for name in ("iterations", "ls_iterations") for value in ("0", "-5")),
        *(("solref", v) for v in ("", "1", "nan 1", "inf 1", "0.02 -1", "0 1", "0.02 1 2", "-5 3")),
        *(("solimp", v) for v in ("", "0.9 0.95", "0 0.9 0.001 0.5 2", "0.9 1 0.001 0.5 2", "0.9 0.95 -1 0.5 2",
                                  "0.9 0.95 0.001 nan 2", "0.9 0.95 0.001 0.5 0.5")),
        ("impratio", "0"), ("condim", "2"), ("threads", "-1"), ("stepping", "rollout"),
    ],
)  # fmt: skip
def test_values_that_mujoco_would_replace(name: str, value: str) -> None:
    """Refuse values for which MuJoCo has others, instead of recording what was not in force."""
    with pytest.raises(UsageError, match=name):
        build(make_scene("inclined-collision"), **{name: value})
