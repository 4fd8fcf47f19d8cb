"""What is particular to the adapter of MuJoCo C; what every adapter must do is in recorder.conformance."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest

from gpusimbench.recorder.scenes.base import IDENTITY
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.errors import UsageError
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
        ("impratio", "0"), ("condim", "2"), ("threads", "-1"),
    ],
)  # fmt: skip
def test_values_that_mujoco_would_replace(name: str, value: str) -> None:
    """Refuse values for which MuJoCo has others, instead of recording what was not in force."""
    with pytest.raises(UsageError, match=name):
        build(make_scene("inclined-collision"), **{name: value})
