"""Which level planes of a model file hold its free bodies up, and what falls through them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.depth import count_sunk
from gpusimbench.recorder.simulators.mujoco.geometry import floors_of
from tests.conftest import call

_BALL = '<body name="ball" pos="0 0 .5"><freejoint/><geom size=".1" {ball}/>{more}</body>'
_PLANE = '<geom name="floor" type="plane" size="1 1 .1" pos="0 0 .25" {plane}/>'


def _model(plane: str = "", ball: str = "", more: str = "", rest: str = "", last: str = "") -> str:
    bodies = _PLANE.format(plane=plane) + _BALL.format(ball=ball, more=more) + rest
    return f"<mujoco><worldbody>{bodies}</worldbody>{last}</mujoco>"


_ARM = '<body pos="0 0 .3"><joint type="{joint}" axis="1 0 0" {limit}/><geom type="capsule" size=".05 .1"/></body>'


@pytest.mark.parametrize(
    ("given_model", "reach"),
    [
        ({}, 0.1),
        ({"more": _ARM.format(joint="hinge", limit="")}, 0.45),
        ({"more": _ARM.format(joint="hinge", limit='pos="0 0 .1"')}, 0.65),
        ({"more": _ARM.format(joint="slide", limit='range="-.2 .1" limited="true"')}, 0.65),
        ({"more": _ARM.format(joint="slide", limit="")}, None),  # reaches anywhere
        ({"plane": 'euler="1 0 0"'}, None),
        ({"plane": 'contype="2" conaffinity="2"'}, None),
        ({"plane": 'contype="0" conaffinity="1"'}, 0.1),
        ({"rest": '<body pos="0 0 2"><freejoint/><geom size=".2"/></body>'}, 0.2),
        ({"rest": '<body pos="0 0 2"><freejoint/><geom size=".2" contype="0" conaffinity="0"/></body>'}, None),
        ({"last": '<contact><exclude body1="world" body2="ball"/></contact>'}, None),
        ({"last": '<option><flag contact="disable"/></option>'}, None),
    ],
)
def test_planes_that_hold_free_bodies(given_model: dict[str, str], reach: float | None) -> None:
    """Find a plane that is level, fixed, and collides with every free body, and how far these reach."""
    found = floors_of(mujoco.MjModel.from_xml_string(_model(**given_model)))
    assert [floor["height"] for floor in found] == ([] if reach is None else [0.25])
    assert [floor["reach"] for floor in found] == ([] if reach is None else [pytest.approx(reach)])


def test_every_free_body_has_its_own_reach() -> None:
    """Tell how far each free body reaches, so that a small one sinks by its own size."""
    rest = '<body name="small" pos="0 0 2"><freejoint/><geom size=".01"/></body>'
    (floor,) = floors_of(mujoco.MjModel.from_xml_string(_model(rest=rest)))
    assert floor["reaches"] == pytest.approx({"ball": 0.1, "small": 0.01})


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["hinge", "slide", "ball"]))
def test_nothing_reaches_further(seed: int, joint: str) -> None:
    """Bound the distance of every point from the body's origin, in any position of the joints."""
    rng = np.random.default_rng(seed)
    x, y, z = rng.uniform(-0.5, 0.5, 3)
    limit = 'range="-.3 .2" limited="true"' if joint == "slide" else f'pos="{y} {z} {x}"'
    box = f'<geom type="box" size=".1 .2 .3" pos="{x} 0 {y}"/>'
    inner = f'<body pos="{z} {x} 0"><joint type="{joint}" {limit}/>{box}</body>'
    outer = f'<body pos="{x} {y} {z}"><joint axis="1 {x} 0" pos="0 {y} 0"/><geom size=".1"/>{inner}</body>'
    model = mujoco.MjModel.from_xml_string(_model(more=outer))
    (floor,) = floors_of(model)
    data = mujoco.MjData(model)
    for _ in range(10):
        data.qpos[:] = rng.normal(size=model.nq)
        if joint == "slide":
            data.qpos[-1] = rng.uniform(-0.3, 0.2)
        mujoco.mj_kinematics(model, data)
        far = np.linalg.norm(data.geom_xpos[1:] - data.xpos[1], axis=1) + model.geom_rbound[1:]
        assert far.max() <= floor["reach"] + 1e-9


def test_a_small_body_beside_a_large_one_is_counted(tmp_path: Path) -> None:
    """Count a ball of 1 cm that fell by 5 cm through the floor that holds one of 10 cm."""
    small = (
        '<body name="small" pos=".5 0 .27"><freejoint/>'
        '<geom name="soft" size=".01" solref="-.001 -.001" priority="1"/></body>'
    )
    path = tmp_path / "balls.xml"
    path.write_text(_model(rest=small))
    common = ("--n-env", "1", "--runs", "1", "--phases", "capture", "--steps", "60", "--no-view")
    call("gsb-record", "--sim", "mujoco", "--model", path, *common, "--out", tmp_path / "out", code=0)
    (file,) = (tmp_path / "out").glob("*.mcap")
    height = open_recording(file).state("bodies", "position").at_step(60)[0, 1, 2]
    assert 0.25 - 0.1 < height < 0.25 - 0.01
    found = count_sunk(open_recording(file))
    assert not isinstance(found, Missing)
    assert found.per_env == (1,)


@pytest.mark.parametrize(("contact", "sunk"), [('solref=".02 1"', 0), ('solref="-.001 -.001"', 1)])
def test_what_falls_through_the_floor_of_a_model_is_counted(tmp_path: Path, contact: str, sunk: int) -> None:
    """Count a ball that its contacts do not hold, and none that comes to rest."""
    path = tmp_path / "ball.xml"
    path.write_text(_model(plane=contact, ball=contact))
    common = ("--n-env", "2", "--runs", "1", "--phases", "capture", "--steps", "400", "--no-view")
    call("gsb-record", "--sim", "mujoco", "--model", path, *common, "--out", tmp_path / "out", code=0)
    (file,) = (tmp_path / "out").glob("*.mcap")
    found = count_sunk(open_recording(file))
    assert not isinstance(found, Missing)
    assert found.per_env == (sunk, sunk)
