"""What recordings/ant/README.md says of the directions of friction, on the engines themselves.

MJX and MuJoCo Warp lay the tangents of a contact between a steep capsule and a plane otherwise than MuJoCo C.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.recorder.engines import needed

jax = needed("jax")
mjx = needed("mujoco.mjx")
mujoco_warp = needed("mujoco_warp")

pytestmark = pytest.mark.slow  # both engines compile


@cache
def mjx_forward() -> Any:
    """mjx.forward as one program: called by itself, it is hundreds of programs to compile."""
    return jax.jit(mjx.forward)


def capsule(lean_deg: float, cone: str) -> mujoco.MjModel:
    """A free capsule that leans by an angle [deg] from the normal of the plane that it stands on."""
    half = math.radians(lean_deg) / 2
    # its axis points to (1, 1, *): neither along an axis of the world nor along its tangent there
    x, y = -math.sin(half) / math.sqrt(2), math.sin(half) / math.sqrt(2)
    return mujoco.MjModel.from_xml_string(f"""<mujoco><option cone="{cone}"/><worldbody>
      <geom type="plane" size="5 5 1"/>
      <body pos="0 0 {0.1 * math.cos(2 * half) + 0.049}" quat="{math.cos(half)} {x} {y} 0"><freejoint/>
        <geom type="capsule" size="0.05 0.1" density="1000"/></body></worldbody></mujoco>""")


def first_tangents(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """The first tangent [3] of the deepest contact, by engine."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = {"mujoco": data.contact.frame[data.contact.dist.argmin()].reshape(3, 3)[1]}
    jax_data = mjx_forward()(mjx.put_model(model, impl="jax"), mjx.put_data(model, data, impl="jax"))
    contact = jax_data._impl.contact
    found["mjx"] = np.asarray(contact.frame)[np.asarray(contact.dist).argmin()][1]
    w_model, w_data = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data)
    mujoco_warp.forward(w_model, w_data)
    count = int(w_data.nacon.numpy()[0])
    found["warp"] = w_data.contact.frame.numpy()[w_data.contact.dist.numpy()[:count].argmin()][1]
    return found


@pytest.mark.parametrize("lean_deg, alike", [(40, True), (20, False)])
def test_a_steep_capsule_has_the_tangents_of_the_world(lean_deg: float, alike: bool) -> None:
    found = first_tangents(capsule(lean_deg, "pyramidal"))
    along = np.array([1, 1, 0]) / math.sqrt(2)
    assert abs(found["mujoco"] @ along) == pytest.approx(1, abs=1e-6)
    for engine in ("mjx", "warp"):
        assert abs(found[engine] @ along) == pytest.approx(1 if alike else math.sqrt(0.5), abs=1e-4), engine


@pytest.mark.parametrize("cone, alike", [("elliptic", True), ("pyramidal", False)])
def test_elliptic_cones_do_not_see_it(cone: str, alike: bool) -> None:
    model = capsule(20, cone)
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0  # slides along x: along a face of one pyramid, along an edge of the other
    mujoco.mj_forward(model, data)
    other = mjx_forward()(mjx.put_model(model, impl="jax"), mjx.put_data(model, data, impl="jax"))
    apart = np.abs(np.asarray(other.qacc)[:2] - data.qacc[:2]).max() / np.abs(data.qacc[:2]).max()
    assert (apart < 1e-3) == alike, apart
