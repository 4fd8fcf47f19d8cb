"""The stage of a model file with MuJoCo's own attributes, which Isaac Lab's Newton reads; no engine is needed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gpusimbench.recorder.simulators.isaaclab.newton_model import NewtonModel
from tests.recorder.mixed_model import scene_of

SPRING = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 .1" friction=".8 .02 .003"/>
  <body name="r" pos="0 0 1"><joint name="j" axis="0 0 1" stiffness="5" damping="2" springref="40" ref="10"
    armature=".5"/>
    <geom type="sphere" size=".1" mass="1" condim="6" margin=".25"/></body></worldbody>
  <actuator><position joint="j" kp="7"/></actuator></mujoco>"""


def test_parameters_are_attributes(tmp_path: Path) -> None:
    """Write joints and geoms with the file's numbers, the spring relative to the reference state, the servo alone as a
    drive, and nothing beside the environment, so that each world of Newton's is whole."""
    scene = scene_of(SPRING, tmp_path)
    text = NewtonModel(scene, dt=scene.dt).usd({}, spacing=4.0, isaac_lab=True)

    def numbers(name: str) -> list[float]:
        return [float(x) for x in re.findall(rf" {re.escape(name)} = ([-0-9.e]+)$", text, re.MULTILINE)]

    assert numbers("mjc:stiffness") == [5.0]
    assert numbers("mjc:damping") == [2.0]
    assert numbers("mjc:armature") == [0.5]
    assert abs(numbers("mjc:springref")[0] - np.radians(30)) < 1e-6
    assert sorted(numbers("mjc:condim")) == [3, 6]
    assert sorted(numbers("mjc:margin")) == [0, 0, 0.25]  # of two geoms and the joint
    assert sorted(numbers("mjc:rollingfriction")) == [0.0001, 0.003]
    (drive,) = numbers("drive:angular:physics:stiffness")
    assert abs(drive - np.radians(7)) < 1e-6
    assert numbers("drive:angular:physics:damping") == [0.0]
    assert text.index('def Xform "env0"') < text.index("def Plane")
    assert text.index('def Xform "env0"') < text.index("def Material")
