"""Actuators and other parts of model files that engines without MuJoCo's own are given or refuse."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.simulators.mujoco.drives import Places, drives
from gpusimbench.recorder.simulators.physx.plan import plan

ARM = '<body name="r"><joint name="j" axis="0 1 0"{joint}/><geom size=".1" pos=".3 0 0"/></body>'
MOTORS = """<actuator><motor joint="j" gear="3" group="2"/>
  <motor joint="j" gear="5" ctrlrange="-.1 .1" ctrllimited="true"/></actuator>"""


def model_of(body: str, more: str = "", option: str = "") -> mujoco.MjModel:
    """A compiled model."""
    text = f"<mujoco>{option}<worldbody>{body}</worldbody>{more}</mujoco>"
    return mujoco.MjModel.from_xml_string(text)


@pytest.mark.parametrize(
    "option",
    [
        "",
        '<option actuatorgroupdisable="2"/>',
        '<option><flag actuation="disable"/></option>',
        '<option><flag clampctrl="disable"/></option>',
    ],
)
def test_what_options_switch_off(option: str) -> None:
    """Make MuJoCo's forces where groups of actuators, all of them, or the clamping of controls are switched off."""
    model = model_of(ARM.format(joint=""), MOTORS, option)
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.7, 0.4
    mujoco.mj_forward(model, data)
    made = drives(model, Places(model.jnt_qposadr, model.jnt_dofadr, model.nv), "it", remedy="")
    forces = np.clip(np.clip(data.ctrl, made.low, made.high) * made.gain, made.force_low, made.force_high)
    np.testing.assert_allclose(made.arms @ forces, data.qfrc_actuator, rtol=1e-6)


def test_a_tendon_with_a_range_of_forces() -> None:
    """Refuse the motor of a tendon whose sum of forces MuJoCo clamps."""
    tendon = """<tendon><fixed name="t" actuatorfrcrange="-.5 .5"><joint joint="j" coef="1"/></fixed></tendon>
      <actuator><motor name="pull" tendon="t"/></actuator>"""
    model = model_of(ARM.format(joint=""), tendon)
    with pytest.raises(Refused, match="'pull': .* fixed tendons without actuatorfrcrange"):
        drives(model, Places(model.jnt_qposadr, model.jnt_dofadr, model.nv), "it", remedy="")


FLEX = """<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".2 .2 .2" mass="1" radius=".02" dim="2">
  <elasticity young="3e4" thickness=".01" elastic2d="both"/></flexcomp>"""
COMPENSATED = ARM.format(joint=' actuatorgravcomp="true" actuatorfrcrange="-1 1"').replace(">", ' gravcomp="1">', 1)


@pytest.mark.parametrize(
    ("said", "body"),
    [
        ("flexible body 'cloth'", FLEX),
        ("gravity compensation of joint 'j' within its actuatorfrcrange", COMPENSATED),
    ],
)
def test_what_links_and_joints_do_not_have(said: str, body: str) -> None:
    """Refuse what would be missing from the links and joints of a USD stage."""
    with pytest.raises(Refused, match=f"PhysX and Isaac Lab are not given the {said}"):
        plan(model_of(body), "a.xml")


def test_an_actuator_of_several_controls() -> None:
    """Refuse by name an actuator that takes more than one control."""
    servo = '<dcmotor name="servo" joint="j" motorconst="1" resistance="1" input="pos vel" controller="10 0 5"/>'
    model = model_of(ARM.format(joint=""), f"<actuator>{servo}</actuator>")
    with pytest.raises(Refused, match="an engine cannot be given actuator 'servo', which has 2 controls; try another"):
        drives(model, Places(np.array([0]), np.array([0]), 1), "an engine", remedy="try another")
